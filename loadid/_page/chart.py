"""Charts of a page: curves over one axis as SVG that suits any width, and their numbers for the script that zooms.

Places inside a chart are shares of its width and height, so that one drawing serves a phone, a screen and a sheet of
paper; letters and lines keep their size. Of more samples than a screen has columns the extremes of every column are
drawn: what is seen is what all of them would show.
"""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Range = tuple[float, float]

WIDE, HIGH = 2000, 1000  # units of the drawing, far finer than a screen
COLUMNS = 720  # of a drawing: more lines than that nobody sees
MOST = 20_000  # numbers of a curve that travel with the page; of more, the extremes of stretches
FEW = 60  # samples in view up to which each of them is marked
AT_END = 0.8  # share of the width beyond which the name of a line stands on its left
MARGIN = 0.05  # of the height, above and below the curves


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve of a chart.

    Parameters
    ----------
    name : str
        As the key of the chart says it.
    y : array (points,)
        NaN leaves a gap.
    look : str
        Class of its style: ``"estimate"``, ``"truth"``, ``"measured"``, ``"predicted"``, ``"residual"``, ``"naive"``,
        ``"level"`` or ``"other0"`` to ``"other5"``; colours never stand alone, each look has its dashes or its width.
    dots : bool
        Points that no line joins.
    low, high : array (points,), optional
        Its band; of dots bars.
    x : array (points,), optional
        Places of its own instead of those of the chart.
    """

    name: str
    y: Array
    look: str = "estimate"
    dots: bool = False
    low: Array | None = None
    high: Array | None = None
    x: Array | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Chart:
    """Curves over one axis.

    Parameters
    ----------
    title, x_name, y_name : str
        Names of the axes with their units.
    x : array (points,)
        Ascending.
    curves : sequence of Curve
        The first is the one that the overview shows.
    said : str
        What the chart shows, in words, for who does not see it.
    x_log, y_log : bool
    window : (float, float), optional
        Part that is shown first, with the whole as a strip below.
    y_range : (float, float), optional
        Of the whole, where the curves do not say it.
    lines : sequence of (float, str)
        Vertical lines and what they mean.
    shades : sequence of (float, float)
        Stretches of the axis that are shaded, and `shaded`: what that means.
    names : sequence of str
        Of the points, where the axis counts them.
    """

    title: str
    x_name: str
    y_name: str
    x: Array
    curves: Sequence[Curve]
    said: str
    x_log: bool = False
    y_log: bool = False
    window: Range | None = None
    y_range: Range | None = None
    lines: Sequence[tuple[float, str]] = ()
    shades: Sequence[Range] = ()
    shaded: str = ""
    names: Sequence[str] = ()

    @property
    def whole(self) -> Range:
        """First and last place; of one point or of names with room beside it."""
        seen = [self.x, *(c.x for c in self.curves if c.x is not None)]
        first, last = min(float(np.nanmin(x)) for x in seen), max(float(np.nanmax(x)) for x in seen)
        if first == last and self.x_log:
            return first / 2, last * 2
        if self.names or first == last:
            return first - 0.5, last + 0.5
        if any(c.dots for c in self.curves):  # a dot at the end is seen whole
            if self.x_log:
                room = (last / first) ** 0.03
                return first / room, last * room
            return first - 0.03 * (last - first), last + 0.03 * (last - first)
        return first, last


# -- numbers ----------------------------------------------------------------------------------------------------------
def written(value: float) -> str:
    """A number at a tick: ``"0.25"``, ``"2e-5"``, ``"12000"``."""
    if 1e3 <= abs(value) < 1e5:
        return f"{value:.0f}"
    text = f"{value:.4g}" if 1e-3 <= abs(value) < 1e5 or value == 0 else f"{value:.3e}"
    head, mark, power = text.partition("e")
    if not mark:
        return "0" if float(head) == 0 else head
    return f"{head.rstrip('0').rstrip('.') if '.' in head else head}e{int(power)}"


def ticks(low: float, high: float, *, log: bool = False, most: int = 6) -> list[float]:
    """Round numbers from `low` to `high`: steps of 1, 2 or 5; over decades their powers of ten."""
    if log:
        first, last = math.ceil(math.log10(low) - 1e-9), math.floor(math.log10(high) + 1e-9)
        if last - first >= 1:
            stride = max(1, -(-(last - first + 1) // most))
            return [float(f"1e{k}") for k in range(first, last + 1, stride)]
        found = [m * 10.0**k for k in range(first - 2, last + 2) for m in (1, 2, 5) if low <= m * 10.0**k <= high]
        return found if len(found) > 1 else ticks(low, high, most=most)
    size = 10.0 ** math.floor(math.log10((high - low) / most))
    step = next(m * size for m in (1, 2, 5, 10) if (high - low) / (m * size) <= most)
    if math.floor(high / step) <= math.ceil(low / step):  # one number tells no scale
        step /= 2
    return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def shares(values: Array, ends: Range, *, log: bool = False) -> Array:
    """Places on an axis as shares of its length; NaN where a log axis has none."""
    low, high = ends
    if not log:
        return np.asarray((values - low) / (high - low))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = (np.log(values) - math.log(low)) / (math.log(high) - math.log(low))
    return np.where(np.isfinite(found), found, np.nan)


def height(chart: Chart, view: Range) -> Range:
    """Lowest and highest of what the curves show in a view, with a margin."""
    if chart.y_range is not None:
        return chart.y_range
    seen: list[Array] = []
    for curve in chart.curves:
        x = chart.x if curve.x is None else curve.x
        inside = (x >= view[0]) & (x <= view[1]) if curve.dots else _around(x, view)
        seen += [part[inside] for part in (curve.y, curve.low, curve.high) if part is not None]
    values = np.concatenate(seen) if seen else np.zeros(1)
    values = values[np.isfinite(values) & ((values > 0) if chart.y_log else True)]
    if not len(values):
        return (0.1, 1.0) if chart.y_log else (-1.0, 1.0)
    low, high = float(values.min()), float(values.max())
    if chart.y_log:
        room = max((high / low) ** MARGIN, 1.1)
        return low / room, high * room
    room = MARGIN * (high - low) or 0.5 * abs(high) or 1.0
    return low - room, high + room


# -- thinning ---------------------------------------------------------------------------------------------------------
def columns(u: Array, count: int) -> NDArray[np.intp]:
    """Where the columns of ascending places `u` (shares of the width) begin."""
    at = np.floor(np.clip(u, 0, 1) * count)
    return np.flatnonzero(np.diff(at, prepend=-1.0))


def extremes(u: Array, y: Array, count: int = COLUMNS) -> tuple[Array, Array]:
    """Points that draw like all: of every column the first, the lowest, the highest and the last; few stay as they are.

    Parameters
    ----------
    u : array (points,)
        Ascending places, shares of the width.
    y : array (points,)
        A column without a finite one stays a gap.
    count : int
        Columns.
    """
    if len(y) <= 4 * count:
        return u, y
    start = columns(u, count)
    stop = np.append(start[1:], len(y)) - 1
    with np.errstate(invalid="ignore"):
        low, high = np.fmin.reduceat(y, start), np.fmax.reduceat(y, start)
    middle = (u[start] + u[stop]) / 2
    return np.column_stack([u[start], middle, middle, u[stop]]).ravel(), np.column_stack(
        [y[start], low, high, y[stop]]
    ).ravel()


def _drawn(u: Array, v: Array) -> str:
    """Path through places that are shares of the width and of the height from below; gaps where there are none."""
    good = np.isfinite(u) & np.isfinite(v)
    x = np.rint(np.where(good, u, 0) * WIDE).astype(int)
    y = np.rint((1 - np.clip(np.where(good, v, 0), -1, 2)) * HIGH).astype(int)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int))).reshape(-1, 2)
    texts = []
    for a, b in edges:
        points = np.column_stack([x[a:b], y[a:b]])
        kept = np.append(True, np.any(np.diff(points, axis=0) != 0, axis=1))
        texts.append("M" + " ".join(map(str, points[kept].ravel().tolist())) + ("h0" if b - a == 1 else ""))
    return "".join(texts)


def _band(u: Array, low: Array, high: Array) -> str:
    """Path around a band."""
    if len(u) > 2 * COLUMNS:
        start = columns(u, COLUMNS)
        with np.errstate(invalid="ignore"):
            u, low, high = u[start], np.fmin.reduceat(low, start), np.fmax.reduceat(high, start)
    good = np.isfinite(u) & np.isfinite(low) & np.isfinite(high)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]]).astype(int))).reshape(-1, 2)
    there = [np.concatenate([part[a:b], part[a:b][::-1]]) for a, b in edges for part in (u,)]
    back = [np.concatenate([low[a:b], high[a:b][::-1]]) for a, b in edges]
    return "".join(_drawn(x, y) + "z" for x, y in zip(there, back, strict=True))


# -- what a template draws --------------------------------------------------------------------------------------------
def picture(chart: Chart) -> dict[str, Any]:
    """All that the template draws: paths, dots, ticks and strip."""
    view = chart.window or chart.whole
    ends = height(chart, view)
    found = _view(chart, view, ends)
    found["strip"] = None if chart.window is None else _strip(chart)
    found["chart"] = chart
    return found


def _view(chart: Chart, view: Range, ends: Range) -> dict[str, Any]:
    bands, paths, dots, bars = [], [], [], []
    for curve in chart.curves:
        x = chart.x if curve.x is None else curve.x
        inside = slice(None) if curve.dots else _around(x, view)
        u = shares(x[inside], view, log=chart.x_log)
        v = shares(curve.y[inside], ends, log=chart.y_log)
        if curve.low is not None and curve.high is not None:
            low, high = (
                shares(np.maximum(e[inside], ends[0]) if chart.y_log else e[inside], ends, log=chart.y_log)
                for e in (curve.low, curve.high)
            )
            if curve.dots:
                bars.append((curve.look, [(a, b, c) for a, b, c in zip(*_percent(u, low, high), strict=True)]))
            else:
                bands.append((curve.look, _band(u, low, high)))
        if curve.dots:
            dots.append((curve.look, list(zip(*_percent(u, v), strict=True))))
            continue
        paths.append((curve.look, _drawn(*extremes(u, v))))
        if np.count_nonzero((u >= 0) & (u <= 1)) <= FEW:
            dots.append((f"{curve.look} small", list(zip(*_percent(u, v), strict=True))))
    return {
        "bands": bands, "paths": paths, "dots": dots, "bars": bars, "zero": _zero(chart, ends),
        "x_ticks": _named(chart, view) if chart.names else _ticks(view, chart.x_log, 7),
        "y_ticks": [(_place(1 - share), text) for share, text in _shared(ends, chart.y_log, 8)],
        "lines": [
            (_place(share), name, share > AT_END)
            for at, name in chart.lines
            for share in [float(shares(np.array(at), view, log=chart.x_log))]
            if 0 <= share <= 1
        ],
        "shades": [
            tuple(_place(float(s)) for s in (a, b - a))
            for pair in chart.shades
            for a, b in [np.clip(shares(np.array(pair, float), view, log=chart.x_log), 0, 1)]
            if b > a
        ],
    }  # fmt: skip


def _around(x: Array, view: Range) -> slice:
    """The samples in view and one on each side."""
    first, last = np.searchsorted(x, view[0], "left"), np.searchsorted(x, view[1], "right")
    return slice(max(int(first) - 1, 0), int(last) + 1) if np.all(np.diff(x) > 0) else slice(None)


def _percent(u: Array, *heights: Array) -> list[list[str]]:
    good = (u > -1e-9) & (u < 1 + 1e-9) & np.all([np.isfinite(v) for v in heights], axis=0)
    return [[_place(s) for s in u[good]], *([_place(1 - s) for s in np.clip(v[good], -0.02, 1.02)] for v in heights)]


def _place(share: float) -> str:
    return f"{100 * share:.2f}%"


def _shared(ends: Range, log: bool, most: int) -> list[tuple[float, str]]:
    found = np.array(ticks(*ends, log=log, most=most))
    return [(float(s), written(v)) for s, v in zip(shares(found, ends, log=log), found.tolist(), strict=True)]


def _ticks(view: Range, log: bool, most: int) -> list[tuple[str, str]]:
    return [(_place(share), text) for share, text in _shared(view, log, most)]


def _named(chart: Chart, view: Range) -> list[tuple[str, str]]:
    step = -(-len(chart.names) // 8)
    at = shares(chart.x[::step], view)
    return [(_place(float(s)), _short(name)) for s, name in zip(at, chart.names[::step], strict=True)]


def _short(name: str, most: int = 14) -> str:
    return name if len(name) <= most else name[: most - 1] + "…"


def _zero(chart: Chart, ends: Range) -> str | None:
    return None if chart.y_log or not ends[0] < 0 < ends[1] else _place(1 - (0 - ends[0]) / (ends[1] - ends[0]))


def _strip(chart: Chart) -> dict[str, Any]:
    """The whole as a small picture, with the part that is shown."""
    assert chart.window is not None
    first = chart.curves[0]
    u, ends = shares(chart.x, chart.whole, log=chart.x_log), height(chart, chart.whole)
    a, b = (float(s) for s in shares(np.array(chart.window), chart.whole, log=chart.x_log))
    path = _drawn(*extremes(u, shares(first.y, ends, log=chart.y_log)))
    return {"look": first.look, "path": path, "from": _place(a), "wide": _place(b - a)}


# -- numbers for the script -------------------------------------------------------------------------------------------
def numbers(chart: Chart) -> str:
    """The numbers of a chart as JSON: arrays as little-endian bytes in base64, float32 for heights, float64 for places.

    Of more than `MOST` samples the extremes of stretches travel, and their length as ``every``.
    """
    parts = []
    every = 1
    for curve in chart.curves:
        x = chart.x if curve.x is None else curve.x
        arrays = {"y": curve.y, "low": curve.low, "high": curve.high}
        if len(x) > MOST:
            every = -(-len(x) // (MOST // 4))
            x, arrays = _thinned(x, arrays, every)
        wide = any(_beyond(a) for a in arrays.values() if a is not None)
        parts.append({
            "name": curve.name, "look": curve.look, "dots": curve.dots, "x": _places(x),
            "wide": wide, **{key: _packed(a, "<f8" if wide else "<f4") for key, a in arrays.items() if a is not None},
        })  # fmt: skip
    told = {
        "title": chart.title, "xName": chart.x_name, "yName": chart.y_name, "xLog": chart.x_log, "yLog": chart.y_log,
        "whole": chart.whole, "window": chart.window, "range": chart.y_range, "names": [*chart.names],
        "lines": [[at, name] for at, name in chart.lines], "shades": [[*pair] for pair in chart.shades],
        "every": every, "curves": parts,
    }  # fmt: skip
    return json.dumps(told, separators=(",", ":"))


def _thinned(x: Array, arrays: dict[str, Array | None], every: int) -> tuple[Array, dict[str, Array | None]]:
    start = np.arange(0, len(x), every)
    stop = np.append(start[1:], len(x)) - 1

    def of(key: str, a: Array | None) -> Array | None:
        if a is None:
            return None
        with np.errstate(invalid="ignore"):
            low, high = np.fmin.reduceat(a, start), np.fmax.reduceat(a, start)
        pair = {"low": (low, low), "high": (high, high)}.get(key, (low, high))
        return np.column_stack([a[start], *pair, a[stop]]).ravel()

    middle = (x[start] + x[stop]) / 2
    return np.column_stack([x[start], middle, middle, x[stop]]).ravel(), {key: of(key, a) for key, a in arrays.items()}


def _places(x: Array) -> Any:
    """An even axis as first place, step and count; another as its numbers."""
    step = (float(x[-1]) - float(x[0])) / (len(x) - 1) if len(x) > 1 else 1.0
    if np.allclose(x, x[0] + step * np.arange(len(x)), rtol=0, atol=1e-6 * abs(step)):
        return [float(x[0]), step, len(x)]
    return _packed(x, "<f8")


def _beyond(a: Array) -> bool:
    """Whether the largest number of a curve leaves what float32 holds."""
    top = float(np.max(np.abs(a), initial=0.0, where=np.isfinite(a)))
    return top > 1e37 or 0 < top < 1e-30


def _packed(a: Array, kind: str) -> str:
    return base64.b64encode(np.ascontiguousarray(a, kind).tobytes()).decode()
