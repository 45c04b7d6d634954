"""Two records of one event by two clocks: when the second began, how fast its clock runs, and both on one clock.

A stretch of the first record is searched in the second one at every lag and for clock ratios up to 2 %, by normalised
cross-correlation. From there windows over the whole overlap give a delay each, by the peak of their correlation below a
sample; a line through these delays is offset and ratio, and the scatter about it their covariance (Carter, IEEE Trans.
ASSP 29 (1981) 463 on delays; Theil and Sen for the first line, least squares for the last).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._readonly import ReadOnly
from structures.errors import InputError

from ._record import Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]
SKEW = 0.02  # largest relative difference of two clocks that is searched
CYCLES = 200  # of the mean frequency, in the stretch that is searched
STRETCHES = 8  # that are tried, the loudest first: the second record may not cover all of the first
TAPS = 32  # samples on each side that an interpolated one is made of
TAPER = 10.0  # of the Kaiser window over them: 1e-5 up to nine tenths of the band
WINDOWS = 48  # over the overlap
LEFT = 3e-3  # of a step: what interpolation leaves of signals that fill their band (hits), in all windows alike


@dataclass(frozen=True, eq=False)
class Alignment(ReadOnly):
    """A time t of the second record is ``offset + ratio * t`` of the first. Immutable.

    Parameters
    ----------
    offset, offset_std : float
        When the second record began on the clock of the first, in s after the first one began.
    ratio, ratio_std : float
        Seconds of the first clock in one of the second.
    correlation, chance : float
        Of the common channels over the overlap, and the largest that unrelated records would have had in the search.
    record : Record
        Both records on the clock of the first one; NaN where the second one has no samples.
    times, delays : array (windows,)
        Middle of each window (s, first clock), and how much later the second record has it than the line says.
    """

    offset: float
    offset_std: float
    ratio: float
    ratio_std: float
    correlation: float
    chance: float
    record: Record = field(repr=False)
    times: Array = field(repr=False)
    delays: Array = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"Alignment(offset {self.offset:.9g} +- {self.offset_std:.2g} s, ratio 1 {self.ratio - 1:+.3e} +- "
            f"{self.ratio_std:.1e}, correlation {self.correlation:.3f})"
        )

    def plot(self) -> Figure:
        """Delays of the windows about the line, in us."""
        from matplotlib.figure import Figure

        figure = Figure(figsize=(7, 3), layout="constrained")
        axes = figure.add_subplot()
        axes.plot(self.times, 1e6 * self.delays, ".")
        axes.axhline(0.0, color="0.5", linewidth=0.8)
        axes.set(xlabel="time of the first clock in s", ylabel="delay left in us", title=repr(self))
        return figure


def align(a: Record, b: Record, *, channel: str | int | tuple[str | int, str | int]) -> Alignment:
    """Offset and clock ratio of two records that share a channel, and both records on one clock.

    Parameters
    ----------
    a, b : Record
        The first one keeps its clock.
    channel : str, int or (of a, of b)
        What both recorded: best the same quantity at one place. A pair of different names or quantities does where
        their spectra differ by real factors alone, as an accelerometer and a strain gauge on one lightly damped
        structure; what delays one of them stands in the offset, and a force does not stand for its response.

    Returns
    -------
    Alignment

    Raises
    ------
    InputError
        Records that are too short, or nothing in common beyond chance: in the search, or in four windows.
    """
    one, other = channel if isinstance(channel, tuple) else (channel, channel)
    x, y = _centred(a, one), _centred(b, other)
    mean = _mean_frequency(x, a.dt)
    shift, rate, correlation, chance, centre = _searched(x, y, a.dt, b.dt, mean)
    reach = 0.5 * min(CYCLES / mean, a.duration)
    while True:
        for _ in range(3):
            begin, end = max(0.0, -shift / rate), min(a.duration, (b.duration - shift) / rate)
            first, last = max(begin, centre - reach), min(end, centre + reach)
            times, delays, weights = _delays(x, y, a.dt, b.dt, (shift, rate), (first, last), mean)
            line, covariance = _line(times, delays, weights)
            shift, rate = shift + rate * line[0], rate * (1.0 + line[1])
        if first <= begin and last >= end:
            break
        reach *= 2.0
    offset, ratio = -shift / rate, 1.0 / rate
    slopes = np.array([[-1.0, -offset], [0.0, -ratio]])  # of offset and ratio over the two numbers of the line
    covariance = covariance + np.diag([LEFT * a.dt, LEFT * a.dt / (end - begin)]) ** 2
    std = np.sqrt(np.diag(slopes @ covariance @ slopes.T))
    left = delays - line[0] - line[1] * times
    record = _merged(a, b, (shift, rate))
    return Alignment(offset, float(std[0]), ratio, float(std[1]), correlation, chance, record, times, left)


def interpolated(values: Array, positions: Array, cutoff: float = 1.0) -> Array:
    """Band-limited values between samples: windowed sinc, NaN where a tap lies outside or is missing.

    Parameters
    ----------
    values : array, shape (samples,) or (samples, channels)
    positions : array, shape (m,)
        In samples.
    cutoff : float
        Of the low-pass, over the Nyquist frequency of the samples: below 1 where the new step is the longer one.
    """
    table = values[:, None] if values.ndim == 1 else values
    half = int(np.ceil(TAPS / cutoff))
    out = np.full((len(positions), table.shape[1]), np.nan)
    base = np.floor(positions).astype(np.int64)
    inside = np.flatnonzero((base - half + 1 >= 0) & (base + half < len(table)))
    taps = np.arange(1 - half, half + 1)
    for part in np.array_split(inside, max(1, len(inside) * 2 * half // 2**20)):
        away = taps - (positions[part] - base[part])[:, None]
        weight = cutoff * np.sinc(cutoff * away) * np.i0(TAPER * np.sqrt(np.clip(1 - (away / half) ** 2, 0, 1)))
        weight /= weight.sum(axis=1, keepdims=True)
        out[part] = np.einsum("mt,mtc->mc", weight, table[base[part][:, None] + taps])
    return out[:, 0] if values.ndim == 1 else out


def _centred(record: Record, channel: str | int) -> Array:
    """A channel without its mean, 0 where samples are missing."""
    y = record[channel]
    if np.isfinite(y).sum() < 8 * TAPS or not np.nanstd(y) > 0:
        raise InputError("too little to align", where=f"channel {channel}",
                         found=f"{int(np.isfinite(y).sum())} samples, std {np.nanstd(y):.3g}",
                         expected=f"at least {8 * TAPS} samples that move")  # fmt: skip
    return np.nan_to_num(y - np.nanmean(y))


def _mean_frequency(x: Array, dt: float) -> float:
    """Root mean square frequency in Hz."""
    power = np.abs(np.fft.rfft(x)) ** 2
    return float(np.sqrt(np.sum(power * np.fft.rfftfreq(len(x), dt) ** 2) / np.sum(power)))


def _searched(x: Array, y: Array, dt: float, other: float, mean: float) -> tuple[float, float, float, float, float]:
    """Time of the second clock at 0 of the first, its rate, correlation, that of chance, middle of the stretch."""
    size = min(max(8 * TAPS, round(CYCLES / mean / dt)), len(x), max(8 * TAPS, round(0.9 * len(y) * other / dt)))
    energy = np.cumsum(np.concatenate(([0.0], x**2)))
    starts = np.arange(0, len(x) - size + 1, max(1, size // 2))
    loudest = starts[np.argsort(energy[starts] - energy[starts + size], kind="stable")]
    worst = (0.0, 1.0)
    for begin in loudest[:STRETCHES].tolist():
        correlation, at, rate, chance = _stretch(x[begin : begin + size], y, dt, other, mean)
        if correlation > chance:
            first = (begin + TAPS) * dt
            return at * other - rate * first, rate, correlation, chance, first + 0.5 * size * dt
        worst = max(worst, (correlation, chance), key=lambda one: one[0] / one[1])
    raise InputError("the records have nothing in common", where="align",
                     found=f"a largest correlation of {worst[0]:.3f}",
                     expected=f"more than {worst[1]:.3f}, which unrelated records reach by chance",
                     hint="name a channel that both recorded, over a time that both cover")  # fmt: skip


def _stretch(part: Array, y: Array, dt: float, other: float, mean: float) -> tuple[float, int, float, float]:
    """Largest correlation of a stretch with the second record, its sample there, its rate, and that of chance."""
    size = len(part)
    step = 2.0 / (np.pi * max(mean * size * dt, 1.0))
    rates = 1.0 + step * np.arange(-np.ceil(SKEW / step), np.ceil(SKEW / step) + 1)
    trials = len(rates) * (len(y) + size) * STRETCHES
    chance = _chance(part, trials)
    sums = np.cumsum(np.concatenate(([0.0], y**2)))
    best = (0.0, 0, 1.0)
    length = 1 << int(len(y) + 2 * size * dt / other).bit_length()
    spectrum = np.fft.rfft(y, length)
    for rate in rates:
        count = int((size - 2 * TAPS) * dt * rate / other)
        if count < TAPS or count > len(y):
            continue
        places = TAPS + np.arange(count) * other / rate / dt
        stretched = np.nan_to_num(interpolated(part, places, min(1.0, dt * rate / other)))
        found = np.fft.irfft(spectrum * np.conj(np.fft.rfft(stretched, length)), length)[: len(y) - count + 1]
        under = sums[count:] - sums[: len(sums) - count]
        norm = np.sqrt(np.sum(stretched**2) * np.maximum(under, 1e-3 * under.max()))
        at = int(np.argmax(np.abs(found) / norm))
        best = max(best, (float(abs(found[at]) / norm[at]), at, float(rate)))
    return (*best, chance)


def _delays(
    x: Array, y: Array, dt: float, other: float, clock: tuple[float, float], over: tuple[float, float], mean: float
) -> tuple[Array, Array, Array]:
    """Middle, delay (s) and weight of each window: the peak of its correlation with the second record."""
    reach = int(np.ceil(0.5 / mean / dt))
    lags = reach + TAPS + 1
    first, last = int(np.ceil(over[0] / dt)) + 1, int(over[1] / dt)
    count = int(np.clip((last - first) * dt * mean / 10.0, 8, WINDOWS))
    edges = np.linspace(first, last, count + 1).astype(int)
    times, delays, weights = [], [], []
    for begin, end in pairwise(edges):
        t = np.arange(begin - lags, end + lags) * dt
        z = interpolated(y, (clock[0] + clock[1] * t) / other, min(1.0, other / dt / clock[1]))
        part = x[begin:end]
        if end - begin < 2 or not np.all(np.isfinite(z)) or not np.any(part):
            continue
        energy = np.cumsum(np.concatenate(([0.0], z**2)))
        energy = energy[len(part) :] - energy[: len(z) + 1 - len(part)]
        c = np.correlate(z, part, "valid") / np.sqrt(np.maximum(energy, 1e-3 * energy.max()))  # ends count for nothing
        sign = (
            1.0
            if abs(c[lags - reach : lags + reach + 1].max()) >= abs(c[lags - reach : lags + reach + 1].min())
            else -1.0
        )
        fine = lags + np.arange(-reach, reach + 1e-9, 1 / 16)
        peak = sign * interpolated(c, fine)
        k = int(np.argmax(peak))
        if not 0 < k < len(fine) - 1:
            continue
        down, mid, up = peak[k - 1 : k + 2]
        bend = down - 2 * mid + up
        size = float(np.sqrt(np.sum(part**2)))
        if bend >= 0 or mid < size * _chance(part, 2 * reach):
            continue
        delays.append((fine[k] - lags + 0.5 * (down - up) / bend / 16) * dt)
        times.append(0.5 * (begin + end - 1) * dt)
        weights.append(-bend)
    if len(times) < 4:
        raise InputError("too little of the records overlaps, or the channels are too unlike", where="align",
                         found=f"{len(times)} of {count} windows in which they correlate beyond chance",
                         expected="4 or more", hint="take records that cover more of one event, or name another pair "
                         "of channels")  # fmt: skip
    return np.array(times), np.array(delays), np.array(weights)


def _chance(x: Array, trials: float) -> float:
    """The largest correlation that unrelated samples of this spectrum have in so many trials."""
    power = np.abs(np.fft.rfft(x)) ** 2
    return float(np.sqrt(np.sum(power**2) / np.sum(power) ** 2 * np.log(trials)))


def _line(t: Array, d: Array, weights: Array) -> tuple[Array, Array]:
    """Intercept and slope of delays over time, and their covariance; windows far off the line are left out."""
    keep = np.ones(len(t), bool)
    for _ in range(4):
        A = np.column_stack([np.ones(int(keep.sum())), t[keep]]) * np.sqrt(weights[keep])[:, None]
        left, right = np.linalg.qr(A)
        line = np.linalg.solve(right, left.T @ (d[keep] * np.sqrt(weights[keep])))
        away = (d - line[0] - line[1] * t) * np.sqrt(weights)
        spread = 1.4826 * float(np.median(np.abs(away[keep])))
        kept = np.abs(away) <= 5.0 * max(spread, 1e-300)
        if np.array_equal(kept, keep) or kept.sum() < 4:
            break
        keep = kept
    inverse = np.linalg.solve(right, np.eye(2))
    return line, inverse @ inverse.T * float(np.sum(away[keep] ** 2)) / (int(keep.sum()) - 2)


def _merged(a: Record, b: Record, clock: tuple[float, float]) -> Record:
    """The channels of both on the clock of the first."""
    moved = interpolated(np.asarray(b.values), (clock[0] + clock[1] * a.time) / b.dt, min(1.0, b.dt / a.dt / clock[1]))
    labels = [n if n not in a.labels else f"{n} ({b.name or 'second'})" for n in b.labels]
    channels: list[Channel] = [replace(c, label=n) for c, n in zip(b.channels, labels, strict=True)]
    note = f"{', '.join(labels)}: resampled from a clock that runs {1 / clock[1]:.9g} times as fast"
    return replace(
        a,
        values=np.column_stack([a.values, moved]),
        channels=(*a.channels, *channels),
        units=(*a.units, *b.units),
        flags=(*a.flags, *b.flags),
        notes=(*a.notes, *b.notes, note),
    )
