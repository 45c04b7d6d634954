"""Complex amplitudes on one frequency line: as they are given, or as a record shows them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._flags import collect
from structures.errors import InputError

from .._guards import families as guards
from .._inverse.problem import STATED, NoiseSource
from ..settings import Noise
from .answer import Amplitudes
from .data import Data
from .noise import NoiseLevel

Array = NDArray[Any]

NEAR, FAR = 2, 5  # lines on either side that show the noise of an amplitude, in steps of 1 / length of the record
CHANCE = 0.01  # that white noise alone makes these lines so large
ROUNDING = 1e-12  # noise of an amplitude, over the largest, below which it is rounding
RESIDUAL = NoiseSource("residual")


@dataclass(frozen=True, eq=False)
class LineReadings:
    """What is inverted on a line.

    Parameters
    ----------
    values : array (sensors,), complex
        ``y(t) = Re[values exp(i 2 pi f t)]``.
    measured : Amplitudes
        Where they come from.
    noise : NoiseLevel or None
        Std of the real and of the imaginary part of each; None where the amplitudes alone cannot show it.
    explained : float or None
        Share of the power of a record, about its mean, that these amplitudes explain.
    """

    values: NDArray[np.complex128]
    measured: Amplitudes
    noise: NoiseLevel | None = None
    explained: float | None = None


def of_record(data: Data, frequency: float, noise: Noise) -> LineReadings:
    """Amplitude of every channel over a whole record, by least squares with a constant.

    White noise of std s leaves the amplitude a std ``2 s / sqrt(samples)``; s is stated, or what the fit leaves. What
    is not white, a transient or another load, shows on the lines beside this one: where these are larger than such
    noise makes them, they are the noise of the amplitude.

    Raises
    ------
    InputError
        A frequency that the record does not hold, a channel of zeros, noise that does not fit the sensors.
    """
    y, samples = data.values, len(data.values)
    if not 1 / data.duration <= frequency < 0.5 / data.dt:
        raise InputError("the record does not hold this frequency", where="frequency", found=f"{frequency:g} Hz",
                         expected=f"{1 / data.duration:.4g} Hz to below {0.5 / data.dt:.4g} Hz")  # fmt: skip
    t = np.arange(samples) * data.dt
    A = np.column_stack([np.cos(2 * np.pi * frequency * t), -np.sin(2 * np.pi * frequency * t), np.ones(samples)])
    x = np.linalg.lstsq(A, y, rcond=None)[0]
    rest, found = y - A @ x, x[0] + 1j * x[1]
    dead = [c.label for c, column in zip(data.channels, (y - y.mean(axis=0)).T, strict=True) if not column.any()]
    if dead:
        raise InputError("a channel does not move", where="record", found=", ".join(dead), expected="a response",
                         hint="leave it out")  # fmt: skip
    white = 2 * _level(noise, rest) / np.sqrt(samples)
    beside, freedom = _beside(rest, t, frequency, data)
    excess = beside > _margin(freedom) * white
    std = np.maximum(np.where(excess, beside, white), ROUNDING * np.max(np.abs(found)))
    source = (noise.origin or STATED) if noise.stated and not excess.any() else RESIDUAL
    explained = _explained(y - y.mean(axis=0), rest, [c.unit for c in data.channels])
    findings = collect([*data.findings, guards.little_explained(explained, frequency)])
    measured = Amplitudes(data.channels, data.rows, data.inputs, data.fingerprints, data.simulated_by, findings)
    return LineReadings(found, measured, NoiseLevel(std / np.sqrt(2), True, source), explained)


def _level(noise: Noise, rest: Array) -> Array:
    """Std of a sample of every channel."""
    if not noise.stated:
        return np.asarray(np.sqrt(np.sum(rest**2, axis=0) / max(len(rest) - 3, 1)))
    level = np.asarray(noise.std, float)
    if level.shape not in ((), (rest.shape[1],)) or np.any(level <= 0):
        raise InputError("the noise does not fit the sensors", where="noise", found=str(noise.std)[:80],
                         expected=f"a positive number, or ({rest.shape[1]},)")  # fmt: skip
    return np.broadcast_to(level, (rest.shape[1],))


def _beside(rest: Array, t: Array, frequency: float, data: Data) -> tuple[Array, int]:
    """Amplitude (rms) of what is left on the lines beside this one, and its degrees of freedom."""
    steps = np.arange(NEAR, FAR + 1) / data.duration
    lines = frequency + np.concatenate([-steps[::-1], steps])
    lines = lines[(lines > 0.5 / data.duration) & (lines < (0.5 - 1 / len(t)) / data.dt)]
    if not len(lines):
        return np.zeros(rest.shape[1]), 1
    shown = 2 / len(t) * np.exp(-2j * np.pi * lines[:, None] * t) @ rest
    return np.asarray(np.sqrt(np.mean(np.abs(shown) ** 2, axis=0))), 2 * len(lines)


def _margin(freedom: int) -> float:
    """How far above its mean a chance of `CHANCE` lifts the rms of so many numbers."""
    from scipy.special import gammaincinv

    return float(np.sqrt(2 * gammaincinv(freedom / 2, 1 - CHANCE) / freedom))


def _explained(whole: Array, rest: Array, units: list[str]) -> float:
    """Share of the power that is not left, of each unit by itself, on average."""
    kinds = [[i for i, u in enumerate(units) if u == unit] for unit in sorted(set(units))]
    return float(np.mean([1 - np.sum(rest[:, k] ** 2) / np.sum(whole[:, k] ** 2) for k in kinds]))
