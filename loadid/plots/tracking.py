"""Pictures of tracking: loads with their bands over a whole stream, the L-curve of the noise of the loads."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .style import BLUE, GREEN, GREY, INK, ORANGE, SKY, new_figure, text, tidy, unit


class Swept(Protocol):
    """What a picture asks of a sweep (`loadid.families.tracking.sweep.QSweep`)."""

    @property
    def factors(self) -> NDArray[np.float64]:
        """On the std of the loads."""

    @property
    def residual(self) -> NDArray[np.float64]:
        """What is left of the data, over noise."""

    @property
    def roughness(self) -> NDArray[np.float64]:
        """Steps of the loads."""

    @property
    def nis(self) -> NDArray[np.float64]:
        """Per channel."""

    @property
    def loglik(self) -> NDArray[np.float64]:
        """Of every point."""

    @property
    def corner(self) -> int | None:
        """Its point."""

    @property
    def plateau(self) -> int:
        """First point of it."""

    @property
    def likely(self) -> int:
        """Point of the likelihood."""


def tracked_figure(
    labels: Sequence[str], units: Sequence[str], times: NDArray, bins: NDArray, note: str = ""
) -> Figure:
    """Loads with their bands over a whole stream.

    Parameters
    ----------
    labels, units : sequence of str
        Of the loads; the largest six are drawn.
    times : array, shape (bins,)
    bins : array, shape (bins, 4, loads)
        Mean, lower and upper end of the 95 % band, mean std of every stretch of time.
    note : str
        What the picture must not travel without: flags, counts.
    """
    size = np.abs(bins[:, 0]).max(axis=0) if len(bins) else np.zeros(len(labels))
    shown = sorted(int(j) for j in np.argsort(-size, kind="stable")[:6])
    figure = new_figure()
    figure.set_size_inches(9.0, 0.9 + 2.2 * len(shown))
    axes = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
    for ax, j in zip(axes, shown, strict=True):
        ax.fill_between(times, bins[:, 1, j], bins[:, 2, j], color=SKY, alpha=0.45, lw=0, label="95 % band")
        ax.plot(times, bins[:, 0, j], color=BLUE, lw=1.0, label="load")
        ax.axhline(0, color=INK, lw=0.5)
        ax.set_ylabel(f"{text(labels[j])} [{unit(units[j])}]")
        tidy(ax)
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize=8, frameon=False, borderaxespad=0.1)
    axes[-1].set_xlabel("time [s]")
    if note:
        lines = "\n".join(textwrap.wrap(note, 120))
        figure.suptitle(lines, fontsize=8, color=INK, x=0.01, ha="left")
    return figure


def sweep_figure(sweep: Swept) -> Figure:
    """L-curve of the variance of the loads, and what the innovations say of it.

    Left: what the loads leave of the data against how rough they are; right: NIS per channel and the likelihood below
    its largest, over the std of the loads.
    """
    figure = new_figure()
    figure.set_size_inches(9.0, 3.8)
    left, right = figure.subplots(1, 2)
    left.loglog(sweep.residual, sweep.roughness, ".-", color=BLUE, lw=1.0, ms=4)
    right.semilogx(sweep.factors, sweep.nis, ".-", color=BLUE, lw=1.0, ms=4, label="NIS per channel")
    right.axhline(1.0, color=GREY, lw=0.8)
    right.set_yscale("log")
    points = {"likelihood": (sweep.likely, GREEN, "o"), "corner": (sweep.corner, ORANGE, "s")}
    if sweep.corner is None:
        points["one arm: alike from here on"] = (sweep.plateau, ORANGE, "s")
    for name, (k, color, shape) in points.items():
        if k is not None:
            style = {"color": color, "marker": shape, "ms": 8, "mfc": "none", "mew": 1.8, "ls": "none", "label": name}
            left.plot(sweep.residual[k], sweep.roughness[k], **style)
            right.plot(sweep.factors[k], sweep.nis[k], **style | {"label": None})
    lost = right.twinx()
    lost.semilogx(sweep.factors, sweep.loglik - sweep.loglik.max(), color=INK, lw=1.0, ls="--")
    lost.set_yscale("symlog", linthresh=10.0)
    lost.set_ylabel("log-likelihood below its largest (dashed)", fontsize=9)
    lost.tick_params(labelsize=8)
    left.set(xlabel="rms of what is left of the data, over noise", ylabel="rms step of the loads [of the likelihood's]")
    right.set(xlabel="factor on the std of the loads", ylabel="NIS per channel")
    for ax in (left, right):
        tidy(ax)
    left.legend(loc="best", fontsize=8, frameon=False)
    return figure
