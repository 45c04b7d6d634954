"""The load with its band, over its axis or as points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from loadid.summary import pulse_window
from structures.errors import InputError

from .fields import field, has_field
from .spectra import draw_spectrum, has_lines, spectrum_figure
from .style import (
    BLUE,
    DENSE,
    GREY,
    INK,
    NARROW,
    SKY,
    known_load,
    largest,
    legend_above,
    mark,
    new_figure,
    readable,
    text,
    tidy,
    titled,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from loadid.estimate import LoadEstimate


def load_figure(
    estimate: LoadEstimate,
    *,
    truth: ArrayLike | None = None,
    level: float = 0.95,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Load with its band, one row per load; a panel beside it enlarges a pulse that is short against the record.

    A narrow figure is for a phone: its panels stand below each other, the one around the peak first.
    """
    figure = figure or new_figure()
    if has_lines(estimate):
        return spectrum_figure(estimate, truth=truth, level=level, figure=figure, narrow=narrow)
    known = known_load(estimate, truth)
    if estimate.axis is None and has_field(estimate):
        return field(estimate, truth=truth, level=level, figure=figure, narrow=narrow)
    if estimate.axis is None:
        figure.set_size_inches(NARROW if narrow else max(6.0, min(14.0, 2 + 0.35 * len(estimate.labels))), 4.2)
        _draw_static(figure.subplots(), estimate, known, level)
    else:
        _draw_rows(figure, estimate, known, level, narrow)
    mark(figure, estimate)
    return figure


def draw_load(
    ax: Axes,
    estimate: LoadEstimate,
    load: int = 0,
    *,
    truth: NDArray | None = None,
    level: float = 0.95,
    window: tuple[float, float] | None = None,
) -> None:
    """Draw one load over its axis, or over a part of it, into `ax`."""
    if estimate.axis is None:
        raise InputError("a static load has no axis", where="draw_load", hint="use load_figure")
    if has_lines(estimate):
        draw_spectrum(ax, estimate, load, truth=truth, level=level)
        ax.set_xlabel("frequency [Hz]")
        return
    scale, name = readable(estimate, window)
    x = estimate.axis.values * scale
    lower, upper = estimate.band(level)
    dense = len(x) > DENSE
    ax.axhline(0, color=GREY, lw=0.6)
    ax.fill_between(
        x, lower[:, load], upper[:, load], color=SKY, alpha=0.45, lw=0, label=f"{level:.0%} band", rasterized=dense
    )
    if truth is not None:
        ax.plot(x, truth[:, load], color=INK, lw=1.4, ls=(0, (4, 2)), label="truth", rasterized=dense)
    ax.plot(x, estimate.load[:, load], color=BLUE, lw=1.2, label="estimate", rasterized=dense)
    ax.set_title(text(estimate.labels[load]), loc="left", fontsize=9)
    ax.set_ylabel(f"load [{unit(estimate.units[load])}]")
    ax.set_xlabel(titled(estimate.axis.name, name))
    if estimate.axis.name == "frame":
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.margins(x=0.01)
    if window is not None:
        ax.set_xlim(window[0] * scale, window[1] * scale)
    tidy(ax)


def _draw_rows(figure: Figure, estimate: LoadEstimate, truth: NDArray | None, level: float, narrow: bool) -> None:
    shown = largest(estimate)
    if narrow:
        _draw_stack(figure, estimate, truth, level, shown)
        return
    figure.set_size_inches(10, 1.1 + 2.3 * len(shown) if len(shown) > 1 else 4.0)
    grid = figure.add_gridspec(len(shown), 5)
    alike = len(set(estimate.units)) == 1  # one scale then, so that noise on a quiet load does not look like a load
    first = None
    for row, j in enumerate(shown):
        window = pulse_window(estimate, j)
        ax = figure.add_subplot(grid[row, :3] if window else grid[row, :], sharey=first if alike else None)
        draw_load(ax, estimate, j, truth=truth, level=level)
        if row < len(shown) - 1:
            ax.set_xlabel("")
        if window:
            near = figure.add_subplot(grid[row, 3:], sharey=ax)
            draw_load(near, estimate, j, truth=truth, level=level, window=window)
            near.set_title("around the peak", loc="left", fontsize=9)
            near.set_ylabel("")
            scale = readable(estimate)[0]
            ax.axvspan(window[0] * scale, window[1] * scale, color=GREY, alpha=0.15, lw=0)
        if first is None:
            first = ax
            legend_above(ax)
    if len(shown) < len(estimate.labels):
        figure.supylabel(f"{len(shown)} largest of {len(estimate.labels)} loads", fontsize=9)


def _draw_stack(figure: Figure, estimate: LoadEstimate, truth: NDArray | None, level: float, shown: list[int]) -> None:
    """Panels below each other: of every load the part around its peak, then its whole record."""
    panels = [
        (j, w) for j in shown for w in ([pulse_window(estimate, j)] if pulse_window(estimate, j) else []) + [None]
    ]
    figure.set_size_inches(NARROW, 0.9 + 2.3 * len(panels))
    axes = figure.subplots(len(panels), 1, squeeze=False)[:, 0]
    for ax, (j, window) in zip(axes, panels, strict=True):
        draw_load(ax, estimate, j, truth=truth, level=level, window=window)
        part = "around the peak" if window else "whole record"
        ax.set_title(f"{text(estimate.labels[j])}, {part}", loc="left", fontsize=9)
    axes[0].legend(loc="best", fontsize=8, frameon=False)


def _draw_static(ax: Axes, estimate: LoadEstimate, truth: NDArray | None, level: float) -> None:
    x = np.arange(len(estimate.labels))
    lower, upper = estimate.band(level)
    ax.axhline(0, color=GREY, lw=0.6)
    bars = np.stack([estimate.load - lower, upper - estimate.load])
    ax.errorbar(x, estimate.load, bars, fmt="o", color=BLUE, capsize=3, label=f"estimate, {level:.0%} band")
    if truth is not None:
        ax.plot(x, truth, ls="none", marker="D", mfc="none", ms=9, color=INK, label="truth")
    few = range(len(x)) if len(x) <= 24 else range(0, len(x), -(-len(x) // 12))
    names = [text(estimate.labels[i]) for i in few]
    ax.set_xticks(few, names, rotation=45 if max(map(len, names)) * len(few) > 60 else 0)
    units = sorted(set(estimate.units))
    ax.set_ylabel(f"load [{', '.join(unit(u) for u in units)}]")
    ax.legend(fontsize=8)
    tidy(ax)
