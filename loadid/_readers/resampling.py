"""Samples that were taken at uneven times, or by several clocks, on one even grid, and what the interpolation costs.

A cubic spline through the samples of each channel (not-a-knot; de Boor, A Practical Guide to Splines, 1978, chapter IV)
between its gaps. Its error is measured on the samples themselves: every second one is left out and interpolated from
the others, and so again with every second of these. The error of cubic splines falls by 2^4 with half the step where
the signal is smooth, and less near the end of the band: it is taken to fall once more as it fell from the second of
these errors to the first, and never by more than 2^4. Noise of the samples is part of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, either
from structures._flags import Evidence, Flag

from .source import BUDGET, Source, Table

Array = NDArray[np.float64]
GAP = 4.0  # times the usual interval of its neighbours: nothing was recorded there
NEIGHBOURS = 21  # intervals
KNOTS = 4  # of a cubic spline
LEAST = 16  # samples between gaps whose error is looked at
ROUNDING = 1e-6  # of a step
SLOWER = 1.05  # times the usual interval of the samples that a step may be: beyond it, what is faster would fold
MISSING = 0.25  # share of the grid in gaps beyond which a record is cut there
WORST = 0.01  # of the std of a channel: an interpolation error that is flagged


@dataclass(frozen=True)
class Resampled:
    """Channels on a grid.

    Parameters
    ----------
    values : array, shape (times, channels)
        NaN in gaps and where a channel has no samples.
    error : array (channels,)
        Root mean square error of the interpolation, in the unit of the values; NaN where too few samples tell it.
    gaps : int
        Intervals in which nothing was recorded or samples are missing, of the channel that has most.
    longest, after : float
        The longest of them (s), and the time of the sample before it.
    """

    values: Array
    error: Array
    gaps: int
    longest: float
    after: float


def onto_one_clock(
    tables: Sequence[Table], clocks: Sequence[Array], names: Sequence[str], source: Source, rate: float
) -> tuple[Table, float]:
    """Tables as one on an even grid over the time that all of them cover, and its step in s.

    Parameters
    ----------
    tables : sequence of Table
        Named, without their time columns.
    clocks : sequence of array (samples,)
        Rising times of their samples, in s of one clock.
    names : sequence of str
        What each clock is called.
    rate : float
        Hz.

    Raises
    ------
    InputError
        A rate below that of the samples, times that do not overlap, a grid that does not fit into memory or lies mostly
        in gaps.
    """
    begin, end = max(float(t[0]) for t in clocks), min(float(t[-1]) for t in clocks)
    count = (end - begin) * rate
    size = 8 * count * sum(t.values.shape[1] for t in tables)
    if not (count >= KNOTS and size <= BUDGET):
        source.refuse("no grid to resample to", f"{begin:.9g} to {end:.9g} s at {rate:g} Hz, {size:.3g} bytes",
                      f"{KNOTS} samples or more, at most {BUDGET} bytes",
                      "cut the record, or check its time stamps")  # fmt: skip
    usual = [float(np.median(np.diff(t))) for t in clocks]
    for name, step in zip(names, usual, strict=True):
        if 1 / rate > SLOWER * step:
            least = f"{1 / step:.4g}"
            source.refuse("a lower rate than that of the samples: what is faster would fold into the band",
                          f"{rate:g} Hz, {name} at {least} Hz", f"{least} Hz or more",
                          Advice("state it: ", either(f"fs={least}", f"--fs {least}"),
                                 "; low-pass the record before fewer samples of it are taken"))  # fmt: skip
    if len(tables) == 1:  # before a damaged stamp, years later, costs a grid of all the time before it
        steps = np.diff(clocks[0])
        lost = float(steps[_gaps(clocks[0], np.arange(len(steps) + 1))].sum())
        _require_few(lost * rate, count, source)
    grid = begin + np.arange(int(count + ROUNDING) + 1) / rate
    found = [resampled(t, np.asarray(x.values, float), grid) for t, x in zip(clocks, tables, strict=True)]
    if len(tables) == 1:
        _require_few(np.isnan(found[0].values).any(axis=1).sum(), len(grid), source)
    labels = [n for t in tables for n in t.columns or ()]
    columns = [n if labels.count(n) == 1 else f"{n} ({t.name})" for t in tables for n in t.columns or ()]
    values = np.column_stack([one.values for one in found])
    error = np.concatenate([_relative(one.error, x.values) for one, x in zip(found, tables, strict=True)])
    notes = [note for t in tables for note in t.notes]
    for name, clock, one in zip(names, clocks, found, strict=True):
        notes += _said(name, clock, one, grid, rate)
    order = sorted(range(len(columns)), key=lambda i: -np.nan_to_num(error[i], nan=np.inf))
    told = {i: f"{error[i]:.2g}" if error[i] >= 0 else "not known" for i in order[:8]}
    ranked = ", ".join(f"{columns[i]} {text}" for i, text in told.items())
    notes.append(f"interpolation error over the std of the channel, by leaving out every second sample: {ranked}")
    flags = [f for t in tables for f in t.flags]
    if not error[order[0]] <= WORST:
        flags.append(Flag("W220", Evidence("interpolation error over std", float(error[order[0]]), WORST),
                          f"resampled to {rate:g} Hz: the interpolation error over the std of the channel is "
                          f"{ranked}"))  # fmt: skip
    start = tables[0].start
    table = Table(
        values, name=", ".join(dict.fromkeys(t.name for t in tables if t.name)), columns=tuple(columns),
        units=tuple(u for t in tables for u in t.units or [None] * t.values.shape[1]), dt=1 / rate,
        interpolation=tuple(np.concatenate([one.error for one in found]).tolist()), flags=tuple(flags),
        notes=tuple(notes), start=None if start is None else start + begin - float(clocks[0][0]),
    )  # fmt: skip
    return table, 1 / rate


def _require_few(gone: float, samples: float, source: Source) -> None:
    """Nothing, unless too many samples of a grid lie in gaps."""
    if gone > MISSING * samples:
        source.refuse("too many samples are missing", f"{gone:.0f} of {samples:.0f} in gaps", f"at most {MISSING:.0%}",
                      "cut the record at the gap, or repair the time stamp after it")  # fmt: skip


def _said(name: str, t: Array, found: Resampled, grid: Array, rate: float) -> list[str]:
    """Notes on one clock."""
    steps, missing = np.diff(t), int(np.isnan(found.values).any(axis=1).sum())
    usual = f"{steps.min():.4g} to {steps.max():.4g} s, {np.median(steps):.6g} s in the median"
    notes = [f"resampled to {rate:g} Hz by cubic splines from {name}, whose steps are {usual}"]
    if found.gaps or missing:
        notes.append(f"{found.gaps} gaps in {name}, the longest of {found.longest:.4g} s after "
                     f"{found.after - t[0]:.6g} s: {missing} samples set to NaN")  # fmt: skip
    cut = (grid[0] - t[0], t[-1] - grid[-1])
    if max(cut) > 1.5 / rate:
        ends = f"{cut[0]:.6g} s at the start and {cut[1]:.6g} s at the end of {name}"
        notes.append(f"{ends} are left out: other channels have no samples there")
    return notes


def _relative(error: Array, values: NDArray[np.generic]) -> Array:
    """Errors over the std of their channels."""
    std = np.array([np.std(x[np.isfinite(x)]) if np.isfinite(x).any() else 0.0 for x in np.asarray(values, float).T])
    return np.asarray(np.where(error > 0, error / np.where(std > 0, std, 1.0), error))


def resampled(t: Array, values: Array, grid: Array) -> Resampled:
    """Channels at the times of a grid.

    Parameters
    ----------
    t : array (samples,)
        Rising times.
    values : array, shape (samples, channels)
        NaN where a sample is missing.
    grid : array (times,)
        Rising times; those outside the samples become NaN.
    """
    out = np.full((len(grid), values.shape[1]), np.nan)
    error = np.full(values.shape[1], np.nan)
    gaps, longest, after = 0, 0.0, float(t[0])
    there = np.isfinite(values)
    alike: dict[bytes, list[int]] = {}  # channels that lack the same samples go together
    for column, mask in enumerate(there.T):
        alike.setdefault(mask.tobytes(), []).append(column)
    for mine in alike.values():
        some = there[:, mine[0]]
        if some.sum() < 2:
            continue
        times, table = t[some], values[some][:, mine]
        ends = _gaps(times, np.flatnonzero(some))
        parts = np.split(np.arange(len(times)), ends + 1)
        for part in parts:
            if len(part) >= KNOTS:
                slack = ROUNDING * (times[part[-1]] - times[part[0]]) / len(part)
                low, high = np.searchsorted(grid, (times[part[0]] - slack, times[part[-1]] + slack))
                at = np.clip(grid[low:high], times[part[0]], times[part[-1]])
                out[low:high, mine] = _spline(times[part], table[part], at)
        error[mine] = _error([(times[p], table[p]) for p in parts if len(p) >= LEAST], len(mine))
        if len(ends) and len(ends) >= gaps:
            wide = np.diff(times)[ends]
            gaps, longest, after = len(ends), float(wide.max()), float(times[ends[np.argmax(wide)]])
    return Resampled(out, error, gaps, longest, after)


def _gaps(t: Array, place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Intervals that are longer than `GAP` times the median of those around them, or in which a sample is missing."""
    from scipy.ndimage import median_filter

    steps = np.diff(t)
    return np.flatnonzero((steps > GAP * median_filter(steps, NEIGHBOURS, mode="mirror")) | (np.diff(place) > 1))


def _spline(t: Array, values: Array, at: Array) -> Array:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(t - t[0], values)(at - t[0]))


def _error(parts: list[tuple[Array, Array]], channels: int) -> Array:
    """Root mean square error of a spline through the samples of some stretches, for each channel."""
    if not parts:
        return np.full(channels, np.nan)
    once, twice = (_left_out(parts, step) for step in (2, 4))
    with np.errstate(divide="ignore", invalid="ignore"):
        fall = np.where(twice > 0, once / twice, 1.0)
    return np.asarray(once * np.clip(fall, 1 / 16, 1.0))


def _left_out(parts: list[tuple[Array, Array]], step: int) -> Array:
    """Error of splines through every `step`-th sample at the samples midway between them."""
    squares, count = 0.0, 0
    for t, y in parts:
        knots = np.arange(0, len(t), step)
        between = knots[:-1] + step // 2
        squares = squares + np.sum((_spline(t[knots], y[knots], t[between]) - y[between]) ** 2, axis=0)
        count += len(between)
    return np.asarray(np.sqrt(squares / count))
