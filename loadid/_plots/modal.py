"""Stabilisation picture of a modal test: poles over the orders on the FRFs that they explain."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from .style import BLUE, GREEN, GREY, INK, ORANGE, SKY, legend_above, new_figure, tidy, unit

if TYPE_CHECKING:
    from structures import MeasuredModes

LEVELS = (
    ("new", "x", GREY, 10), ("frequency stays", "o", SKY, 10), ("frequency and damping stay", "o", GREEN, 12),
    ("all stays", "o", BLUE, 12),
)  # fmt: skip


def stabilisation_figure(found: MeasuredModes, *, figure: Figure | None = None) -> Figure:
    """Poles of every order above the rms of all FRFs, measured and of the modes; chosen modes as lines."""
    figure = figure or new_figure()
    figure.set_size_inches(10, 6.2)
    top, below = figure.subplots(2, 1, sharex=True, height_ratios=(2, 1.4))
    s = found.stabilisation
    for level, (name, marker, colour, size) in enumerate(LEVELS):
        own = s.stable == level
        if own.any():
            face = "none" if marker == "o" and level == 1 else colour
            edge = {} if marker == "x" else {"edgecolors": colour}
            top.scatter(s.frequencies[own], s.order[own], s=size, marker=marker, c=face, lw=0.8, label=name, **edge)
    free, width = -np.inf, 0.075 * (found.band[1] - found.band[0])
    row = 0
    for f, z in zip(found.frequencies, found.damping, strict=True):
        for ax in (top, below):
            ax.axvline(f, color=ORANGE, lw=0.9, zorder=0)
        row = (row + 1) % 3 if f < free else 0
        free = f + width
        top.annotate(f"{f:.4g} Hz, {100 * z:.2g} %", (f, 1.0), xycoords=("data", "axes fraction"),
                     xytext=(2, -2 - 9 * row), textcoords="offset points", fontsize=6.5, va="top",
                     color=INK)  # fmt: skip
    top.set_ylabel("order of the polynomials")
    top.set_ylim(0, max(s.order.max(initial=1) * 1.22, 2))
    legend_above(top)
    f = found.frf.frequencies
    model = found.model().frf(f)
    for H, colour, width, name in ((found.frf.H, GREY, 1.6, "measured"), (model, BLUE, 0.9, "of the modes")):
        below.semilogy(f, np.sqrt(np.mean(np.abs(H) ** 2, axis=(1, 2))), color=colour, lw=width, label=name)
    kind = found.frf.sensors[0].unit
    per = found.frf.loads[0].unit
    below.set_ylabel(f"rms of the FRFs [{unit(kind)}/{unit(per)}]")
    below.set_xlabel("frequency [Hz]")
    below.set_xlim(*found.band)
    legend_above(below)
    for ax in (top, below):
        tidy(ax)
    codes = ", ".join(dict.fromkeys(flag.code.removeprefix("LID-") for flag in found.flags)) or "none"
    figure.suptitle(
        f"{len(found)} modes  |  poles left out: {s.unstable} that grow, {s.outside} without a frequency  |  "
        f"cautions: {codes}", fontsize=8, x=0.01, ha="left", color=INK,
    )  # fmt: skip
    return figure
