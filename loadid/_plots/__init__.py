"""Pictures of a load estimate: the load with its band over time, frequency or points, and others.

Object interface of matplotlib only: no global state, no window unless asked for.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .._results.shown import PANELS, axis_label, has_field, known_load, largest, readable, titled
from .._results.summary import pulse_window
from .choosing import gcv, lcurve, path_figure
from .diagnosis import columns, filter_factors, modes, picard, resolution
from .fields import field, spacetime, zones
from .style import (
    BLUE,
    DENSE,
    GREEN,
    GREY,
    INK,
    NARROW,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    few_labels,
    finished,
    legend_above,
    mark,
    new_figure,
    picture_format,
    rendered,
    text,
    tidy,
    unit,
)
from .style import unit as readable_unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from .._results.estimate import LoadEstimate
    from .._results.functionals import LoadSpectrum

__all__ = [
    "columns", "field", "filter_factors", "gcv", "lcurve", "lines_figure", "load_figure", "modes", "path_figure",
    "picard", "picture_format", "plot", "rendered", "resolution", "response_figure", "spacetime", "spectrum_figure",
    "zones",
]  # fmt: skip

Array = NDArray[Any]
DECADES = 3.0  # of amplitude below the largest that a panel shows
SHADE = "#f3d9c9"


def has_lines(estimate: LoadEstimate) -> bool:
    """Whether the load itself is over frequency."""
    return estimate.spectrum is not None and estimate.axis is not None and estimate.axis.name == "frequency"


def spectrum_figure(
    estimate: LoadEstimate,
    *,
    truth: ArrayLike | None = None,
    level: float = 0.95,
    figure: Figure | None = None,
    narrow: bool = False,
) -> Figure:
    """Amplitude of every load over frequency with its band, one row per load.

    Lines that are not trusted are shaded and their estimate is left out; the least-squares answer runs through them.
    """
    figure = figure or new_figure()
    _need(estimate)
    known = known_load(estimate, truth)
    shown = largest(estimate)
    rows = len(shown) + 1
    figure.set_size_inches(NARROW if narrow else 10, 1.0 + 2.2 * rows)
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    for ax, j in zip(axes, shown, strict=False):
        draw_spectrum(ax, estimate, j, truth=known, level=level)
    legend_above(axes[0])
    _draw_predicted(axes[-1], estimate.spectrum, [estimate.labels[j] for j in shown], shown)
    axes[-1].set_xlabel("frequency [Hz]")
    if len(shown) < len(estimate.labels):
        figure.supylabel(f"{len(shown)} largest of {len(estimate.labels)} loads", fontsize=9)
    mark(figure, estimate)
    return figure


def lines_figure(estimate: LoadEstimate, *, figure: Figure | None = None) -> Figure:
    """What every line can tell: predicted relative std and gain of each load, condition of the line."""
    figure = figure or new_figure()
    _need(estimate)
    s: LoadSpectrum = estimate.spectrum
    shown = largest(estimate)
    names = [estimate.labels[j] for j in shown]
    panels = 3 if len(estimate.labels) > 1 else 2  # one load has no condition
    figure.set_size_inches(10, 2.4 * panels)
    predicted, gain, *condition = figure.subplots(panels, 1, sharex=True)
    _draw_predicted(predicted, s, names, shown)
    legend_above(predicted)
    for k, j in enumerate(shown):
        good = s.gain[:, j] > 0
        gain.semilogy(s.frequencies[good], s.gain[good, j], color=_colour(k), lw=1.0)
        zeros = np.unique(s.zeros[np.isfinite(s.zeros[:, j]), j])
        at = np.searchsorted(s.frequencies, zeros)
        gain.plot(zeros, np.maximum(s.gain[at, j], 1e-300), ls="none", marker="v", ms=5, mfc="none", color=_colour(k))
    gain.set_ylabel("gain [noise std per unit load]")
    gain.set_title("response that no other load can imitate; triangles: antiresonances", loc="left", fontsize=9)
    seen = np.isfinite(s.condition)
    for ax in condition:
        ax.semilogy(s.frequencies[seen], s.condition[seen], color=INK, lw=1.0)
        ax.set_ylabel("condition [-]")
        ax.set_title("condition of the line, loads of expected size", loc="left", fontsize=9)
    (condition or [gain])[-1].set_xlabel("frequency [Hz]")
    for ax in (gain, *condition):
        few_labels(ax.yaxis)
        tidy(ax)
        ax.margins(x=0.01)
    mark(figure, estimate)
    return figure


def draw_spectrum(ax: Axes, e: LoadEstimate, j: int = 0, *, truth: Array | None = None, level: float = 0.95) -> None:
    """Draw the amplitude of one load over frequency into `ax`."""
    s: LoadSpectrum = e.spectrum
    f, trusted = s.frequencies, s.trust()[:, j]
    size, std = np.abs(e.load[:, j]), e.std[:, j]
    lower, upper = (edge[:, j] for edge in e.band(level))
    naive = np.abs(s.naive[:, j]) ** (2 if s.cross is not None else 1)
    dense = len(f) > DENSE
    ax.fill_between(f, 0, 1, where=_beside(~trusted), transform=ax.get_xaxis_transform(), color=SHADE, lw=0, zorder=0,
                    step="mid", rasterized=dense, label=f"predicted error above {s.level:.0%}")  # fmt: skip
    top = float(np.max(np.where(trusted, size + std, 0.0), initial=0.0)) or float(size.max())
    ax.plot(f, naive, color=ORANGE, lw=0.7, label="least squares", rasterized=dense)
    ax.fill_between(f, np.maximum(lower, top * 10**-DECADES), upper, where=trusted, color=SKY, alpha=0.5, lw=0,
                    label=f"{level:.0%} band", rasterized=dense)  # fmt: skip
    if truth is not None:
        ax.plot(f, np.abs(truth[:, j]), color=INK, lw=1.2, ls=(0, (4, 2)), label="truth", rasterized=dense)
    ax.plot(f, np.where(trusted, size, np.nan), color=BLUE, lw=1.1, label="estimate, trusted lines", rasterized=dense)
    alone = trusted & ~np.roll(trusted, 1) & ~np.roll(trusted, -1)
    if alone.any():
        ax.plot(f[alone], size[alone], ls="none", marker=".", ms=4, color=BLUE)
    ax.set_yscale("log")
    ax.set_ylim(top * 10**-DECADES, 20 * top)
    few_labels(ax.yaxis)
    word = "autospectrum" if s.cross is not None else "amplitude"
    ax.set_ylabel(f"{word} [{readable_unit(e.units[j])}]")
    ax.set_title(text(e.labels[j]), loc="left", fontsize=9)
    ax.margins(x=0.01)
    tidy(ax)


def _draw_predicted(ax: Axes, s: LoadSpectrum, names: list[str], shown: list[int]) -> None:
    for k, (name, j) in enumerate(zip(names, shown, strict=True)):
        found = s.predicted[:, j]
        good = np.isfinite(found)
        ax.semilogy(s.frequencies[good], found[good], color=_colour(k), lw=0.9, label=text(name))
    ax.axhline(s.level, color=GREY, lw=1.0, ls=(0, (5, 3)), label=f"level {s.level:.0%}")
    ax.set_ylim(max(float(np.nanmin(s.predicted, initial=1.0)) / 2, 1e-6), 20)
    few_labels(ax.yaxis)
    ax.set_ylabel("predicted std / load [-]")
    ax.set_title("predicted relative error of least squares, from noise and FRF errors", loc="left", fontsize=9)
    ax.legend(loc="upper right", fontsize=7, frameon=False, ncols=3)
    ax.margins(x=0.01)
    tidy(ax)


def _need(estimate: LoadEstimate) -> None:
    if estimate.spectrum is None:
        raise InputError("this estimate has no frequency lines", where="plot", found="no spectrum",
                         expected="an estimate of FrequencyInversion")  # fmt: skip


def _beside(flagged: Array) -> NDArray[np.bool_]:
    """Flagged lines and the next one: a filled step needs both of its ends."""
    return np.asarray(flagged | np.concatenate([[False], flagged[:-1]]))


def _colour(k: int) -> str:
    return (BLUE, ORANGE, GREEN, PURPLE, INK, SKY)[k % 6]


def response_figure(estimate: LoadEstimate, *, figure: Figure | None = None, narrow: bool = False) -> Figure:
    """Measured against predicted response, and what is left, per sensor; below each other where it is narrow."""
    if estimate.response is None or estimate.residual is None or estimate.predicted is None:
        raise InputError("the estimate carries no response", where="plot", hint="use a family that keeps it")
    figure = figure or new_figure()
    if estimate.response.ndim == 1 or estimate.axis is None or len(estimate.axis.values) != len(estimate.response):
        figure.set_size_inches(NARROW if narrow else 7, 4)
        _draw_static_response(figure.subplots(), estimate)
        mark(figure, estimate)
        return figure
    shown = range(min(len(estimate.sensors), PANELS))
    if narrow:
        figure.set_size_inches(NARROW, 0.9 + 3.2 * len(shown))
        grid = figure.subplots(2 * len(shown), 1, squeeze=False, sharex=True).reshape(len(shown), 2)
    else:
        figure.set_size_inches(10, 1.1 + 2.0 * len(shown))
        grid = figure.subplots(len(shown), 2, squeeze=False, sharex=True, width_ratios=[3, 2])
    x = estimate.axis.values * readable(estimate)[0]
    dense, lines = len(x) > DENSE, estimate.axis.name == "frequency"
    for (left, right), j in zip(grid, shown, strict=True):
        measured, residual, predicted = (x[:, j] for x in (estimate.response, estimate.residual, estimate.predicted))
        if lines:  # of amplitudes the moduli, decades apart
            measured, residual, predicted = (np.abs(x) for x in (measured, residual, predicted))
            left.set_yscale("log")
            right.set_yscale("log")
        # broad and pale under thin and dark: where they agree, both are still seen
        left.plot(x, measured, color=PALE, lw=4.0, label="measured", rasterized=dense)
        left.plot(x, predicted, color=ORANGE, lw=0.8, label="predicted", rasterized=dense)
        right.plot(x, residual, color=GREEN, lw=0.7, rasterized=dense)
        norm = float(np.linalg.norm(measured))
        share = f"{np.linalg.norm(residual) / norm:.2%} of the signal" if norm > 0 else "the signal is zero"
        left.set_title(text(estimate.sensors[j]), loc="left", fontsize=9)
        right.set_title(f"residual, {share}", loc="left", fontsize=9)
        left.set_ylabel(f"[{unit(estimate.sensor_units[j])}]")
        for ax in (left, right):
            if lines:
                few_labels(ax.yaxis)
            ax.margins(x=0.01)
            tidy(ax)
    legend_above(grid[0][0])
    for ax in grid[-1][1:] if narrow else grid[-1]:
        ax.set_xlabel(axis_label(estimate))
    if len(shown) < len(estimate.sensors):
        figure.supylabel(f"first {len(shown)} of {len(estimate.sensors)} sensors", fontsize=9)
    mark(figure, estimate)
    return figure


def _draw_static_response(ax: Axes, estimate: LoadEstimate) -> None:
    measured, predicted = np.ravel(estimate.response), np.ravel(estimate.predicted)  # type: ignore[arg-type]
    ends = [min(measured.min(), predicted.min()), max(measured.max(), predicted.max())]
    ax.plot(ends, ends, color=GREY, lw=1, label="measured = predicted")
    ax.plot(measured, predicted, ls="none", marker="o", ms=5, mfc="none", color=ORANGE, label="sensors")
    units = ", ".join(unit(u) for u in sorted(set(estimate.sensor_units)))
    ax.set(xlabel=f"measured [{units}]", ylabel=f"predicted [{units}]")
    ax.legend(fontsize=8)
    tidy(ax)


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
    truth: Array | None = None,
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


def _draw_rows(figure: Figure, estimate: LoadEstimate, truth: Array | None, level: float, narrow: bool) -> None:
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


def _draw_stack(figure: Figure, estimate: LoadEstimate, truth: Array | None, level: float, shown: list[int]) -> None:
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


def _draw_static(ax: Axes, estimate: LoadEstimate, truth: Array | None, level: float) -> None:
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


# a known load can stand beside
_OF_LOADS: dict[str, Callable[..., Figure]] = {"load": load_figure, "field": field, "spacetime": spacetime}
_OTHERS: dict[str, Callable[..., Figure]] = {
    "response": response_figure,
    "path": path_figure,
    "lcurve": lcurve,
    "gcv": gcv,
    "picard": picard,
    "filter_factors": filter_factors,
    "resolution": resolution,
    "columns": columns,
    "lines": lines_figure,
}


def plot(
    estimate: LoadEstimate,
    kind: str = "load",
    *,
    truth: ArrayLike | None = None,
    ax: Axes | None = None,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Figure of an estimate; see `LoadEstimate.plot`."""
    if ax is not None:
        if not hasattr(ax, "fill_between"):
            raise InputError(
                "these are no axes", where="ax", found=f"an object of type {type(ax).__name__}",
                expected="matplotlib Axes", hint="figure, ax = matplotlib.pyplot.subplots()",
            )  # fmt: skip
        draw_load(ax, estimate, 0, truth=known_load(estimate, truth))
        return ax.get_figure(root=True)  # type: ignore[return-value]
    if kind not in (*_OF_LOADS, *_OTHERS):
        expected = ", ".join((*_OF_LOADS, *_OTHERS))
        raise InputError("no such picture", where="plot", found=repr(kind), expected=f"one of {expected}")
    figure = new_figure(show)
    if kind in _OF_LOADS:
        _OF_LOADS[kind](estimate, truth=truth, figure=figure)
    else:
        _OTHERS[kind](estimate, figure=figure)
    return finished(figure, path, show)
