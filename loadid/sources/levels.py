"""Levels in decibels: of lines, of a whole spectrum, and running over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import as_array, positive

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


def weighted(error: NDArray, level: NDArray) -> Array:
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
    return np.sqrt(_moving_sum(x**2, half) / count.reshape(-1, *[1] * (x.ndim - 1)))


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
    return np.sqrt(np.maximum(lfilter([1 - decay], [1, -decay], x**2, axis=0), 0))


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
