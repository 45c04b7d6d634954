"""Picture of skin designs: what a reading tells of each wave of traction, and what that means on a patch."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from loadid.plots.style import GREY, INK, new_figure, save, text

from .benchmark import LINES

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..design.judged import SkinDesign


def draw(designs: Sequence[SkinDesign], path: str | os.PathLike | None = None) -> Figure:
    """Above, the share of pressure and shear that is known of each wave; below, four numbers of each design."""
    figure = new_figure()
    figure.set_size_inches(11, 7.5)
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.25, 1))
    upper, lower = parts
    panels = upper.subplots(1, 2, sharey=True)
    for ax, kind in zip(panels, ("pressure", "shear"), strict=True):
        for i, one in enumerate(designs):
            color, line, _ = LINES[i % len(LINES)]
            wave = 2e3 * np.pi / one.spectrum.k
            ax.plot(wave, getattr(one.spectrum, kind), color=color, ls=line, lw=1.8, label=text(one.name))
            ax.axvline(2e3 * one.skin.pitch, color=color, ls=line, lw=0.7, alpha=0.6)
        ax.axhline(0.5, color=GREY, lw=0.8)
        ax.set_xscale("log")
        ax.set_xlim(0.2, 2e3 * max(max(d.skin.size) for d in designs))
        ax.set_ylim(0, 1.02)
        ax.set_title(f"{kind}: share of the expected variance that a reading tells", fontsize=10, loc="left")
        ax.set_xlabel("wavelength of the traction (mm); thin upright lines: two marker pitches", fontsize=9)
        _open(ax)
    panels[0].legend(fontsize=8, frameon=False, loc="lower right")
    _bars(lower, designs)
    if path is not None:
        save(figure, path)
    return figure


def _bars(figure: Any, designs: Sequence[SkinDesign]) -> None:
    patch = f"{1e3 * designs[0].skin.patch:g} mm patch"
    shown = (
        (f"std of pressure (kPa)\non a {patch}", [1e-3 * d.pressure_std for d in designs]),
        (f"std of shear (kPa)\non a {patch}", [1e-3 * d.shear_std for d in designs]),
        ("waves above\nnoise (%)", [100 * d.recoverable / d.waves for d in designs]),
        ("force (N) at\n10 % strain", [d.strain_load for d in designs]),
    )
    where = np.arange(len(designs))[::-1]
    for ax, (title, values) in zip(figure.subplots(1, 4, sharey=True), shown, strict=True):
        ax.barh(where, values, color=[LINES[i % len(LINES)][0] for i in range(len(designs))], height=0.6)
        for y, v in zip(where, values, strict=True):
            ax.text(v, y, f" {v:.3g}", va="center", fontsize=8, color=INK)
        ax.set_yticks(where, [text(d.name) for d in designs], fontsize=8)
        ax.set_xlim(0, 1.25 * max(values))
        ax.set_title(title, fontsize=9, loc="left")
        _open(ax)


def _open(ax: Any) -> None:
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
