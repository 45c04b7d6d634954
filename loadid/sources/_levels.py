"""Levels in decibels, running over time, and in octave bands and their fractions after IEC 61260-1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, as_array, integer, pair, positive

Vector = NDArray[np.float64]
RATIO = 10.0**0.3  # octave ratio G of base ten
REFERENCE = 1000.0  # Hz
PREFERRED = (1.0, 1.25, 1.6, 2.0, 2.5, 3.15, 4.0, 5.0, 6.3, 8.0)
FINEST = 96
APART = 1.5  # times the gap beside it, from which on a gap between lines is a hole and no step


@dataclass(frozen=True, eq=False)
class Bands:
    """Neighbouring bands of one width on a logarithmic scale.

    Parameters
    ----------
    fraction : int
        1 octave, 3 third octaves, 12 twelfth octaves.
    centres, lower, upper : array, shape (bands,)
        Exact midband and edge frequencies (Hz); the upper edge of a band is the lower one of the next.
    names : tuple of str
        Nominal midband frequencies as they are printed: ``"31.5"``, ``"1000"``.
    """

    fraction: int
    centres: Vector
    lower: Vector
    upper: Vector
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.centres)

    @property
    def title(self) -> str:
        """``"octave"``, ``"third octave"`` or ``"1/12 octave"``."""
        return {1: "octave", 3: "third octave"}.get(self.fraction, f"1/{self.fraction} octave")


@dataclass(frozen=True, eq=False)
class BandPower:
    """Power of spectra in bands.

    Parameters
    ----------
    bands : Bands
    power : array, shape (bands, ...)
        Mean square in each band, unit^2.
    coverage : array, shape (bands,)
        Share of the width of each band that the lines cover: a level of a half-covered band is the level of a half.
    """

    bands: Bands
    power: Vector
    coverage: Vector


def octave_bands(fraction: int = 3, low: float = 20.0, high: float = 20e3) -> Bands:
    """Bands of a fraction of an octave, from the one that holds `low` to the one that holds `high`.

    Parameters
    ----------
    fraction : int
        Bandwidth designator b: 1, 3, 6, 12, 24, ...
    low, high : float
        Hz.

    Raises
    ------
    InputError
        No fraction, or no range of frequencies above 0 Hz.

    Notes
    -----
    IEC 61260-1:2014, base ten: G = 10^(3/10), midband 1000 G^(x/b) Hz for odd b and 1000 G^((2x+1)/(2b)) Hz for even
    b, edges a factor G^(1/(2b)) below and above. Nominal frequencies after its annex E.
    """
    b = integer("fraction of an octave", fraction, where="octave_bands", limit=FINEST)
    low, high = pair("the range", (low, high), where="octave_bands", unit="Hz")
    if not 0 < low < high:
        raise InputError(
            "no range of frequencies", where="octave_bands", found=f"{low:g} to {high:g} Hz",
            expected="0 < low < high", hint="a band never reaches down to 0 Hz",
        )  # fmt: skip
    first, last = (int(_number(f, b)) for f in (low, high))
    numbers = np.arange(first, last + 1)
    centres = _midband(numbers, b)
    # edges from one formula, so that neighbours share them to the last bit
    edges = REFERENCE * RATIO ** ((2 * np.arange(first, last + 2) - 1 + (b % 2 == 0)) / (2 * b))
    names = tuple(f"{nominal(float(f), int(x), b):.7g}" for f, x in zip(centres, numbers, strict=True))
    return Bands(b, centres, edges[:-1], edges[1:], names)


def bands_of(frequencies: ArrayLike, fraction: int = 3) -> Bands:
    """Bands that hold some lines (Hz); 0 Hz is in none.

    Raises
    ------
    InputError
        No line above 0 Hz.
    """
    f = as_array(frequencies, where="bands_of", dtype=float)
    f = f[f > 0]
    if not f.size:
        raise InputError("no line above 0 Hz", where="octave bands", found="lines at 0 Hz", expected="lines in Hz")
    return octave_bands(fraction, float(f.min()), max(float(f.max()), float(f.min()) * (1 + 1e-12)))


def band_power(frequencies: ArrayLike, power: ArrayLike, bands: Bands, *, density: bool) -> BandPower:
    """Power that spectra hold in bands; a line at 0 Hz is in none.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    power : array, shape (lines, ...)
        One-sided density in unit^2/Hz, or the power of each line in unit^2.
    bands : Bands
    density : bool
        True: every line stands for a strip up to half way to its neighbours, and a strip across an edge is parted
        there, so that no power is lost or counted twice. False: a line is a tone and lies in one band.

    Raises
    ------
    InputError
        Lines that do not ascend or do not fit; one line of a density, which has no width.
    """
    f, p = (as_array(x, where="band_power", dtype=float) for x in (frequencies, power))
    if f.ndim != 1 or not len(f) or len(p) != len(f) or np.any(np.diff(f) <= 0) or not np.all(np.isfinite(p)):
        raise InputError(
            "lines and powers do not fit", where="band_power", found=f"{f.shape} lines, {p.shape} powers",
            expected="ascending lines (Hz) and a finite power for each", hint="lines first, then sensors",
        )  # fmt: skip
    if density and len(f) < 2:
        raise InputError(
            "one line of a density has no width", where="band_power", found=f"{f[0]:g} Hz",
            expected="two lines or more", hint="density=False where the line is a tone",
        )  # fmt: skip
    start, stop = _strips(f)
    inside = np.clip(
        np.minimum(stop, bands.upper[:, None]) - np.maximum(start, bands.lower[:, None]), 0, None
    )  # (bands, lines)
    coverage = inside.sum(axis=1) / (bands.upper - bands.lower)
    if density:
        weights = np.where(f > 0, inside, 0.0)
    else:
        weights = ((f >= bands.lower[:, None]) & (f < bands.upper[:, None])).astype(float)
    return BandPower(bands, np.tensordot(weights, p, axes=1), np.minimum(coverage, 1.0))


def widths(frequencies: ArrayLike) -> Vector:
    """Width (Hz) of the strip that each line of a density stands for; the mean square is the sum of width times it."""
    start, stop = _strips(np.asarray(frequencies, float))
    return stop - start


def nominal(centre: float, number: int, fraction: int) -> float:
    """Nominal midband frequency (Hz) of a band: preferred numbers for octaves and thirds, else rounded.

    Parameters
    ----------
    centre : float
        Exact midband frequency (Hz).
    number : int
        x, 0 at the band of 1 kHz.
    fraction : int
        1/b octave: three digits where the first one is below 5, else two (finer than 1/24: one digit more).
    """
    if fraction in (1, 3):
        tenth = number * (3 // fraction) + 30  # centre = 10^(tenth/10) Hz
        return PREFERRED[tenth % 10] * 10.0 ** (tenth // 10)
    decade = int(np.floor(np.log10(centre)))
    digits = (3 if fraction == 2 or centre / 10.0**decade < 5 else 2) + (fraction > 24)
    return float(f"{centre:.{digits - 1}e}")


def _midband(x: NDArray[np.int_], b: int) -> Vector:
    return REFERENCE * RATIO ** (x / b if b % 2 else (2 * x + 1) / (2 * b))


def _number(frequency: float, b: int) -> float:
    """Number x of the band that holds a frequency."""
    place = b * np.log(frequency / REFERENCE) / np.log(RATIO)
    return float(np.floor(place + 0.5 if b % 2 else place))


def _strips(f: Vector) -> tuple[Vector, Vector]:
    """Ends of the strip that each line stands for: half way to its neighbours, but not across a hole."""
    if len(f) == 1:
        return f, f
    gaps = np.diff(f)
    beside = np.full(len(gaps), np.inf)
    beside[1:] = gaps[:-1]
    beside[:-1] = np.minimum(beside[:-1], gaps[1:])
    half = np.where(gaps > APART * beside, beside, gaps) / 2
    left, right = np.concatenate([half[:1], half]), np.concatenate([half, half[-1:]])
    return np.maximum(f - left, 0.0), f + right


Array = NDArray[np.float64]
FLOOR = 1e-20  # of the largest measured power of a channel: 200 dB below it a power is taken for that floor
RANGE = 40.0  # dB below its largest level down to which a running level is compared
WEIGHTINGS = {"fast": 0.125, "slow": 1.0}  # s, IEC 61672-1


@dataclass(frozen=True, eq=False)
class RunningLevel:
    """Levels of measured and synthesised responses over time.

    Parameters
    ----------
    time : array, shape (samples,)
        s.
    measured, synthesised : array, shape (samples, sensors)
        Running rms, in the unit of each sensor.
    error : array, shape (samples, sensors)
        Synthesised over measured, dB.
    loud : array of bool, shape (samples, sensors)
        Where the measured level lies within `RANGE` dB of its largest: below, noise is compared with noise.
    window : str
        ``"fast"``, ``"slow"``, or the length in words.
    """

    time: Array
    measured: Array
    synthesised: Array
    error: Array
    loud: NDArray[np.bool_]
    window: str

    @property
    def rms_error(self) -> Array:
        """Rms of the error (dB) over the loud part of each sensor, shape (sensors,)."""
        count = self.loud.sum(axis=0)
        return np.asarray(np.sqrt(np.sum(np.where(self.loud, self.error, 0.0) ** 2, axis=0) / count), float)

    @property
    def global_error(self) -> Array:
        """Error (dB) over all sensors at each time, weighted by the squared level: MIL-STD-810H, method 525."""
        return weighted(self.error, self.measured)


def decibels(synthesised: ArrayLike, measured: ArrayLike) -> Array:
    """Ratio of two powers in dB over the first axis of lines, bands or samples; synthesised over measured.

    Powers below `FLOOR` times the largest measured one of their channel count as that: nothing on both sides is 0 dB,
    and no ratio is infinite.

    Parameters
    ----------
    synthesised, measured : array, shape (lines, ...)
        Mean squares or densities, not negative.

    Raises
    ------
    InputError
        Shapes that differ, powers that are negative or not finite, a channel measured as zero throughout.
    """
    s, m = (as_array(x, where="decibels", dtype=float) for x in (synthesised, measured))
    if s.shape != m.shape or not m.size or not (np.all(np.isfinite(s)) and np.all(np.isfinite(m))):
        raise InputError(
            "powers do not fit", where="decibels", found=f"shapes {s.shape} and {m.shape}",
            expected="two finite arrays of one shape", hint="synthesised and measured, lines first",
        )  # fmt: skip
    top = m.max(axis=0) if m.ndim else m
    if min(s.min(), m.min()) < 0 or np.any(top <= 0):
        raise InputError(
            "no level: a power is negative, or a channel was measured as zero", where="decibels",
            found=f"smallest {min(s.min(), m.min()):.3g}, {int(np.sum(top <= 0))} channels of zeros",
            expected="mean squares of channels that moved", hint="leave dead channels out",
        )  # fmt: skip
    return np.asarray(10 * np.log10(np.maximum(s / top, FLOOR) / np.maximum(m / top, FLOOR)), float)


def weighted(error: NDArray[Any], level: NDArray[Any]) -> Array:
    """Mean of errors (..., sensors) over the sensors, by the square of their level: ``sum w^2 e / sum w^2``."""
    top = level.max(axis=-1, keepdims=True)
    w = np.divide(level, top, out=np.ones_like(level), where=top > 0) ** 2
    return np.asarray(np.sum(w * error, axis=-1) / np.sum(w, axis=-1), float)


def running_rms(values: ArrayLike, dt: float, window: float) -> Array:
    """Rms over a centred window; at the ends over what the record holds of it.

    Parameters
    ----------
    values : array, shape (samples, ...)
    dt, window : float
        Step and length of the window, s; at least one sample is taken.

    Raises
    ------
    InputError
        NaN, or a step or a window that is not positive.
    """
    x, dt = _samples(values, "running_rms"), positive("the step", dt, where="running_rms", unit="s")
    half = int(positive("the window", window, where="running_rms", unit="s") / dt / 2)
    half = min(half, len(x) - 1)
    at = np.arange(len(x))
    count = np.minimum(at + half + 1, len(x)) - np.maximum(at - half, 0)
    return np.asarray(np.sqrt(_moving_sum(x**2, half) / count.reshape(-1, *[1] * (x.ndim - 1))))


def time_weighted(values: ArrayLike, dt: float, weighting: str | float = "fast") -> Array:
    """Rms under exponential time weighting, from rest: the pointer of a sound or vibration level meter.

    Parameters
    ----------
    values : array, shape (samples, ...)
    dt : float
        s.
    weighting : ``"fast"``, ``"slow"`` or float
        Time constant: 125 ms, 1 s (IEC 61672-1), or in s.

    Raises
    ------
    InputError
        NaN, no such weighting, or a step that is not positive.
    """
    from scipy.signal import lfilter

    x, dt = _samples(values, "time_weighted"), positive("the step", dt, where="time_weighted", unit="s")
    if isinstance(weighting, str) and weighting not in WEIGHTINGS:
        raise InputError(
            "no such time weighting", where="time_weighted", found=repr(weighting),
            expected=f"{', '.join(WEIGHTINGS)}, or a time constant in s", hint='weighting="fast"',
        )  # fmt: skip
    constant = WEIGHTINGS[weighting] if isinstance(weighting, str) else weighting
    decay = np.exp(-dt / positive("the time constant", constant, where="time_weighted", unit="s"))
    return np.asarray(np.sqrt(np.maximum(lfilter([1 - decay], [1, -decay], x**2, axis=0), 0)))


def running_level(measured: ArrayLike, synthesised: ArrayLike, dt: float, window: str | float = "fast") -> RunningLevel:
    """Levels of two responses over time and their difference in dB.

    Parameters
    ----------
    measured, synthesised : array, shape (samples, sensors)
    dt : float
        s.
    window : ``"fast"``, ``"slow"`` or float
        Exponential time weighting, or the length (s) of a centred window.

    Raises
    ------
    InputError
        As `running_rms`, `time_weighted` and `decibels`.
    """
    name = window if isinstance(window, str) else f"{window:g} s"
    if isinstance(window, str):
        m, s = (time_weighted(x, dt, window) for x in (measured, synthesised))
    else:
        m, s = (running_rms(x, dt, window) for x in (measured, synthesised))
    loud = m >= m.max(axis=0) * 10 ** (-RANGE / 20)
    return RunningLevel(np.asarray(np.arange(len(m)) * float(dt), float), m, s, decibels(s**2, m**2), loud, name)


def _moving_sum(x: Array, half: int) -> Array:
    """Sums over ``2 half + 1`` samples around each one, zeros beyond the ends.

    From sums that begin anew in every block, so that nothing large is subtracted: a quiet stretch after a loud one
    keeps its digits (M. van Herk, Pattern Recognition Letters 13 (1992) 517-521, for sums).
    """
    width = 2 * half + 1
    blocks = -(-(len(x) + 2 * half) // width)
    padded = np.zeros((blocks * width, *x.shape[1:]))
    padded[half : half + len(x)] = x
    shaped = padded.reshape(blocks, width, *x.shape[1:])
    ahead = np.cumsum(shaped, axis=1).reshape(padded.shape)
    back = np.cumsum(shaped[:, ::-1], axis=1)[:, ::-1].reshape(padded.shape)
    at = np.arange(len(x))
    whole = (at % width == 0).reshape(-1, *[1] * (x.ndim - 1))  # the window is one block: it would count twice
    return np.asarray(np.where(whole, back[at], back[at] + ahead[at + width - 1]), float)


def _samples(values: ArrayLike, where: str) -> Array:
    x = as_array(values, where=where)
    if x.dtype.kind not in "iuf" or x.ndim == 0 or not x.size or not np.all(np.isfinite(x)):
        raise InputError(
            "no finite samples", where=where, found=f"{x.dtype} of shape {x.shape}",
            expected="real numbers (samples, sensors)", hint="repair or leave out what is missing",
        )  # fmt: skip
    return x.astype(float)
