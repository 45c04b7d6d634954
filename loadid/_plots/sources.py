"""Pictures of sources and paths: contributions, measured against synthesised responses, correlation of shapes."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .._results.shown import PANELS, titled
from ..sources._levels import time_weighted
from ..sources._synthesis import row_of, unit_of
from .style import (
    BLUE,
    DENSE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    few_labels,
    finished,
    legend_above,
    mark,
    new_figure,
    text,
    tidy,
    unit,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..sources._comparison import ResponseComparison
    from ..sources._contributions import Contributions, Shares

Array = NDArray[Any]


YELLOW, BROWN = "#E69F00", "#7f5539"
COLOURS = (BLUE, ORANGE, GREEN, PURPLE, YELLOW, SKY, BROWN)
DYNAMIC = 50.0  # dB of a map
NAMED = 14  # labels of bands on an axis
FLOOR = 1e-30


# -- contributions -----------------------------------------------------------------------------------------------------
def draw_contributions(
    c: Contributions,
    kind: str = "stacked",
    *,
    sensor: int | str | None = None,
    fraction: int = 3,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Figure of contributions; see `Contributions.plot`."""
    kinds: dict[str, Callable[[Figure, Contributions, list[int], int], None]] = {"stacked": _stacked, "map": _map}
    if kind not in kinds:
        raise InputError("no such picture", where="plot", found=repr(kind), expected=f"one of {', '.join(kinds)}")
    figure = new_figure(show)
    size = c.shares().rms[0]
    best = [int(i) for i in np.sort(np.argsort(-size, kind="stable")[: PANELS if kind == "stacked" else 1])]
    kinds[kind](figure, c, best if sensor is None else [c.index(sensor)], fraction)
    return _finished(figure, c, path, show)


def _stacked(figure: Figure, c: Contributions, shown: list[int], fraction: int) -> None:
    """Shares of the loads in each band, stacked to one, above the level of the band."""
    shares = c.shares(fraction)
    assert shares.bands is not None
    figure.set_size_inches(9, 1.1 + 2.1 * len(shown))
    grid = figure.subplots(len(shown), 1, squeeze=False, sharex=True)[:, 0]
    x, order = np.arange(len(shares.bands)), _listed(c)
    first = grid[0]
    for ax, i in zip(grid, shown, strict=True):
        base = np.zeros(len(x))
        for rank, j in enumerate(order):
            share = 100 * shares.share[:, i, j]
            ax.bar(x, share, 0.92, bottom=100 * base, color=COLOURS[rank], lw=0, label=text(c.loads[j].label))
            doubtful = _doubtful(shares, i, j)
            if doubtful.any():
                ax.bar(
                    x[doubtful], share[doubtful], 0.92, bottom=100 * base[doubtful], color="none", edgecolor="white",
                    hatch="////", lw=0,
                )  # fmt: skip
            base += shares.share[:, i, j]
        if np.any(base < 0.999):
            rest = np.where(shares.rms[:, i] > 0, 1 - base, 0)
            ax.bar(x, 100 * rest, 0.92, bottom=100 * base, color="#dddddd", lw=0, label="other loads")
        level = ax.twinx()
        level.plot(x, 20 * np.log10(np.maximum(shares.rms[:, i], FLOOR)), color=INK, lw=1, marker="o", ms=3)
        level.set_ylabel(f"rms [dB re 1 {unit(c.sensors[i].unit)}]", fontsize=8)
        level.tick_params(labelsize=8)
        level.spines["top"].set_visible(False)
        ax.set_title(f"{text(c.sensors[i].label)}; line: level, hatched: within its own std", loc="left", fontsize=9)
        ax.set(ylim=(0, 100), ylabel="share [%]")
        tidy(ax)
    first.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=6, fontsize=8, frameon=False, borderaxespad=0.1)
    _band_axis(grid[-1], shares.bands.names, shares.bands.title)
    if 1 < len(shown) < len(c.sensors):
        figure.supylabel(f"{len(shown)} largest of {len(c.sensors)} sensors", fontsize=9)


def _doubtful(shares: Shares, sensor: int, load: int) -> NDArray[np.bool_]:
    """Bands in which the share of a load is not twice what its std alone would make."""
    share = shares.share[:, sensor, load]
    if shares.uncertain is None:
        return np.zeros(len(share), bool)
    return (share > 0.01) & (share < 2 * shares.uncertain[:, sensor, load])


def _map(figure: Figure, c: Contributions, shown: list[int], fraction: int) -> None:
    """Level of the response to each load, load by line, of one sensor; the whole and the measured level below."""
    i = shown[0]
    levels, whole, x, name, of = _levels(c, i, fraction)
    top = float(np.max(levels))
    figure.set_size_inches(9, 3.4 + 0.32 * len(c.loads))
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[1 + 0.25 * len(c.loads), 2])
    edges = _edges(x)
    mesh = upper.pcolormesh(
        edges, np.arange(len(c.loads) + 1), levels.T, vmin=top - DYNAMIC, vmax=top, cmap="viridis", rasterized=True
    )
    upper.set_yticks(np.arange(len(c.loads)) + 0.5, [text(load.label) for load in c.loads])
    upper.tick_params(labelsize=8)
    upper.invert_yaxis()
    upper.set_title(f"response of {text(c.sensors[i].label)} to each load alone", loc="left", fontsize=9)
    bar = figure.colorbar(mesh, ax=upper, pad=0.01)
    bar.set_label(f"dB re 1 {unit(of)}", fontsize=8)
    bar.ax.tick_params(labelsize=8)
    measured = c.measured[i] if c.measured else None
    if measured is not None:
        lower.plot(x, _measured_level(c, measured), color=PALE, lw=3.5, label="measured", rasterized=len(x) > DENSE)
    lower.plot(x, whole, color=INK, lw=1, label="all loads", rasterized=len(x) > DENSE)
    for rank, j in enumerate(_listed(c)[:3]):
        lower.plot(
            x, levels[:, j], color=COLOURS[rank], lw=0.8, label=text(c.loads[j].label), rasterized=len(x) > DENSE
        )
    if c.trusted is not None:
        _shade(lower, edges, ~c.trusted[:, i])
    lower.set_ylim(top - DYNAMIC, max(top, float(np.max(whole))) + 5)
    lower.set_ylabel(f"level [dB re 1 {unit(of)}]")
    lower.set_xlabel(name)
    lower.margins(x=0)
    lower.legend(fontsize=8, frameon=False, ncols=6, loc="lower right", bbox_to_anchor=(1, 1), borderaxespad=0.1)
    tidy(lower)


def _levels(c: Contributions, i: int, fraction: int) -> tuple[Array, Array, Array, str, str]:
    """Levels in dB of each load and of all at one sensor, over an axis with its name, and the unit they refer to."""
    if c.kind != "histories":
        alone, whole = _db(np.abs(c.values[:, i]), c.kind), _db(np.abs(c.total[:, i]), c.kind)
        return alone, whole, c.axis.values, titled(c.axis.name, c.axis.unit), c.units[i]
    alone, whole = (20 * np.log10(np.maximum(time_weighted(x[:, i], c.axis.step), FLOOR)) for x in (c.values, c.total))
    return alone, whole, c.axis.values, titled("time", "s") + ", fast time weighting", c.units[i]


def _measured_level(c: Contributions, measured: Array) -> Array:
    if c.kind != "histories":
        return _db(np.abs(measured), c.kind)
    return 20 * np.log10(np.maximum(time_weighted(measured, c.axis.step), FLOOR))


def _shade(ax: Axes, edges: Array, mask: Array) -> None:
    """Grey behind the lines of a mask."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]))).reshape(-1, 2)
    for k, (a, b) in enumerate(ends):
        ax.axvspan(edges[a], edges[b], color=GREY, alpha=0.25, lw=0, label=None if k else "not trusted")


def _listed(c: Contributions) -> list[int]:
    """Loads with a colour of their own: the largest ones."""
    labels = [load.label for load in c.loads]
    return [labels.index(name) for name, _ in c.ranking()][: len(COLOURS)]


# -- measured against synthesised --------------------------------------------------------------------------------------
def draw_comparison(
    c: ResponseComparison,
    kind: str = "bands",
    *,
    sensor: int | str | None = None,
    fraction: int = 3,
    window: str | float = "fast",
    level: float = 0.95,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Figure of a comparison; see `ResponseComparison.plot`."""
    if kind not in ("bands", "running"):
        raise InputError("no such picture", where="plot", found=repr(kind), expected="'bands' or 'running'")
    shown = list(range(min(len(c.sensors), 4))) if sensor is None else [row_of(sensor, c.sensors)]
    figure = new_figure(show)
    if kind == "bands":
        _bands(figure, c, shown, fraction, level)
    else:
        _running(figure, c, shown, window)
    if len(shown) < len(c.sensors) and sensor is None:
        figure.supylabel(f"first {len(shown)} of {len(c.sensors)} sensors", fontsize=9)
    return _finished(figure, c, path, show)


def _bands(figure: Figure, c: ResponseComparison, shown: list[int], fraction: int, level: float) -> None:
    """Responses with their band, left; error in dB per band, right."""
    banded = c.bands(fraction)
    figure.set_size_inches(11, 1.1 + 2.4 * len(shown))
    grid = figure.subplots(len(shown), 2, squeeze=False, sharex="col", width_ratios=[3, 2])
    places = np.arange(len(banded.bands))
    for (left, right), i in zip(grid, shown, strict=True):
        _response(left, c, i, level)
        error = banded.error[:, i]
        right.axhspan(-3, 3, color=GREY, alpha=0.15, lw=0)
        right.bar(places, error, 0.8, color=[ORANGE if abs(e) > 3 else BLUE for e in error], lw=0)
        right.axhline(0, color=INK, lw=0.6)
        top = max(4.0, 1.1 * float(np.abs(banded.error[:, shown]).max()))
        right.set(ylim=(-top, top), ylabel="error [dB]")
        right.set_title(f"overall {c.overall[i]:+.2f} dB; grey: within 3 dB", loc="left", fontsize=9)
        tidy(right)
    legend_above(grid[0][0])
    grid[-1][0].set_xlabel(titled(c.axis.name, c.axis.unit))
    _band_axis(grid[-1][1], banded.bands.names, banded.bands.title)


def _response(ax: Axes, c: ResponseComparison, i: int, level: float) -> None:
    x, dense = c.axis.values, len(c.axis.values) > DENSE
    over = c.kind != "histories"
    measured, made = (np.abs(v[:, i]) if over else v[:, i] for v in (c.measured, c.synthesised))
    ax.plot(x, measured, color=PALE, lw=3.5, label="measured", rasterized=dense)
    if c.std is not None and len(c.points):
        factor = np.sqrt(-np.log1p(-level)) if c.kind == "spectra" else NormalDist().inv_cdf(0.5 + level / 2)
        low, high = made[c.points] - factor * c.std[:, i], made[c.points] + factor * c.std[:, i]
        if over:
            ax.fill_between(x[c.points], np.maximum(low, FLOOR), high, color=ORANGE, alpha=0.3, lw=0, rasterized=dense)
        else:
            ax.errorbar(
                x[c.points], made[c.points], factor * c.std[:, i], fmt="none", ecolor=INK, capsize=2, lw=1,
                label=f"{level:.0%} band",
            )  # fmt: skip
        if over:
            ax.fill_between([], [], [], color=ORANGE, alpha=0.3, lw=0, label=f"{level:.0%} band")
    ax.plot(x, made, color=ORANGE, lw=0.8, label="synthesised", rasterized=dense)
    if over:
        ax.set_yscale("log")
        seen = measured[measured > 0]
        ax.set_ylim(max(float(seen.min()) / 3, float(seen.max()) * 1e-6), 3 * float(max(measured.max(), made.max())))
        few_labels(ax.yaxis)
    match, name = c.correlation, {"spectra": "FRAC", "histories": "TRAC"}.get(c.kind, "")
    ax.set_title(text(c.sensors[i]) + ("" if match is None else f", {name} {match[i]:.3f}"), loc="left", fontsize=9)
    ax.set_ylabel(f"[{unit(_value_unit(c, i))}]")
    ax.margins(x=0.01)
    tidy(ax)


def _running(figure: Figure, c: ResponseComparison, shown: list[int], window: str | float) -> None:
    """Levels over time, left; their difference in dB where the level is worth it, right."""
    run = c.running(window)
    figure.set_size_inches(11, 1.1 + 2.2 * len(shown))
    grid = figure.subplots(len(shown), 2, squeeze=False, sharex=True, width_ratios=[3, 2])
    dense = len(run.time) > DENSE
    for (left, right), i in zip(grid, shown, strict=True):
        for values, colour, width, name in (
            (run.measured, PALE, 3.5, "measured"),
            (run.synthesised, ORANGE, 1.0, "synthesised"),
        ):
            left.plot(run.time, 20 * np.log10(np.maximum(values[:, i], FLOOR)), color=colour, lw=width, label=name)
        top = 20 * np.log10(run.measured[:, i].max())
        left.set_ylim(top - DYNAMIC, top + 6)
        left.set_ylabel(f"level [dB re 1 {unit(c.units[i])}]")
        left.set_title(f"{text(c.sensors[i])}, {_weighting(run.window)}", loc="left", fontsize=9)
        right.axhspan(-3, 3, color=GREY, alpha=0.15, lw=0)
        right.plot(run.time, np.where(run.loud[:, i], run.error[:, i], np.nan), color=BLUE, lw=1, rasterized=dense)
        right.set_ylabel("error [dB]")
        right.set_title(f"rms {run.rms_error[i]:.2f} dB, where within 40 dB of the top", loc="left", fontsize=9)
        for ax in (left, right):
            ax.margins(x=0.01)
            tidy(ax)
    legend_above(grid[0][0])
    for ax in grid[-1]:
        ax.set_xlabel("time [s]")


def _weighting(window: str) -> str:
    return f"{window} time weighting" if window in ("fast", "slow") else f"rms over {window}"


# -- correlation of shapes ---------------------------------------------------------------------------------------------
def mac_figure(
    matrix: ArrayLike,
    *,
    rows: Sequence[str] | None = None,
    columns: Sequence[str] | None = None,
    path: str | os.PathLike[str] | None = None,
    show: bool = False,
) -> Figure:
    """Picture of a MAC matrix with its numbers.

    Parameters
    ----------
    matrix : array, shape (shapes, others)
        From `loadid.sources.mac`.
    rows, columns : sequence of str, optional
        Names of the shapes: modes, frequencies.
    path, show
        As in `LoadEstimate.plot`.

    Raises
    ------
    InputError
        No matrix of numbers from 0 to 1, or names that do not fit.
    """
    m = np.asarray(matrix, float)
    if m.ndim != 2 or not m.size or not np.all((m >= -1e-12) & (m <= 1 + 1e-12)):
        raise InputError(
            "no MAC matrix", where="mac_figure", found=f"shape {m.shape}", expected="numbers from 0 to 1",
            hint="loadid.sources.mac(shapes, others)",
        )  # fmt: skip
    names = [rows or [str(i + 1) for i in range(m.shape[0])], columns or [str(i + 1) for i in range(m.shape[1])]]
    if (len(names[0]), len(names[1])) != m.shape:
        raise InputError(
            "names do not fit the matrix", where="mac_figure", found=[len(n) for n in names], expected=m.shape
        )
    figure = new_figure(show)
    figure.set_size_inches(2.2 + 0.5 * m.shape[1], 1.6 + 0.45 * m.shape[0])
    ax = figure.subplots()
    mesh = ax.imshow(m, vmin=0, vmax=1, cmap="Blues", aspect="auto")
    if m.size <= 400:
        for (i, j), value in np.ndenumerate(m):
            ax.text(j, i, f"{value:.2f}", ha="center", va="center", fontsize=7, color="white" if value > 0.6 else INK)
    ax.set_xticks(range(m.shape[1]), [text(n) for n in names[1]], rotation=45 if max(map(len, names[1])) > 4 else 0)
    ax.set_yticks(range(m.shape[0]), [text(n) for n in names[0]])
    ax.tick_params(labelsize=8)
    bar = figure.colorbar(mesh, ax=ax)
    bar.set_label("MAC [1]", fontsize=9)
    bar.ax.tick_params(labelsize=8)
    return _finished(figure, None, path, show)


# -- shared ------------------------------------------------------------------------------------------------------------
def _db(values: Array, kind: str) -> Array:
    """Levels in dB of amplitudes, or of densities, which are powers."""
    return (10 if kind == "densities" else 20) * np.log10(np.maximum(values, FLOOR))


def _edges(x: Array) -> Array:
    if len(x) == 1:
        return np.array([x[0] - 0.5, x[0] + 0.5])
    middle = (x[1:] + x[:-1]) / 2
    return np.concatenate([[2 * x[0] - middle[0]], middle, [2 * x[-1] - middle[-1]]])


def _band_axis(ax: Axes, names: Sequence[str], title: str) -> None:
    step = max(1, -(-len(names) // NAMED))
    ticks = range(0, len(names), step)
    ax.set_xticks(ticks, [names[k] for k in ticks], rotation=45 if len(names) > 6 else 0)
    ax.set_xlabel(f"{title} band [Hz]")


def _value_unit(c: ResponseComparison, i: int) -> str:
    return unit_of(c.units[i], c.kind)


def _finished(
    figure: Figure, c: Contributions | ResponseComparison | None, path: str | os.PathLike[str] | None, show: bool
) -> Figure:
    estimate = getattr(c, "estimate", None)
    if estimate is not None:
        mark(figure, estimate)
    return finished(figure, path, show)
