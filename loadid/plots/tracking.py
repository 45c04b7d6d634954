"""Picture of tracked loads with their bands over a whole stream."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from .style import BLUE, INK, SKY, new_figure, text, tidy, unit


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
