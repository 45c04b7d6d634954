"""Standard deviations and covariances as settings give them, as roots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals, shown

OPEN = 1e3  # noise stds of a sensor's offset before the first sample, where none is stated
SAME = 1e-9  # asymmetry of a matrix, against its size, that is rounding


def noise_root(noise: ArrayLike, m: int) -> NDArray[np.float64]:
    """Lower triangular root of the noise of the sensors."""
    LR = covariance_root(noise, m, "noise")
    if np.any(np.diag(LR) <= 0):
        raise InputError("a sensor without noise", where="noise", found="a std of zero", expected="above zero",
                         hint="the std of its quantisation, step / sqrt(12), if nothing else is known")  # fmt: skip
    return LR


def covariance_root(given: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    """Lower triangular root of a covariance given as stds or as a matrix."""
    array = reals(given, where=name)
    if array.ndim < 2:
        return np.diag(levels(array, count, name))
    scale = np.sqrt(np.abs(np.diag(array))) if array.shape == (count, count) else np.zeros(0)
    unit = np.where(scale > 0, scale, 1.0)
    if (
        array.shape != (count, count)
        or not np.all(np.isfinite(array))
        or (np.abs(array - array.T).max() > SAME * np.abs(array).max())
    ):
        raise InputError("no covariance", where=name, found=f"shape {array.shape}",
                         expected=f"({count},) stds, or ({count}, {count}), symmetric and finite")  # fmt: skip
    try:  # in units of the stds: channels differ by many decades
        return unit[:, None] * np.linalg.cholesky(array / unit[:, None] / unit)
    except np.linalg.LinAlgError:
        raise InputError("a covariance that is not positive definite", where=name, found=shown(given),
                         expected="positive definite", hint="is one a copy of another?") from None  # fmt: skip


def spread_root(given: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    """Root (count, any) from a std, stds, or a root; columns of zeros are left out."""
    array = reals(given, where=name)
    if array.ndim == 2 and len(array) == count and np.all(np.isfinite(array)):
        return array
    stds = levels(array, count, name)
    return np.diag(stds)[:, stds > 0]


def levels(given: ArrayLike, count: int, name: str) -> NDArray[np.float64]:
    """Stds (count,), none negative."""
    array = reals(given, where=name)
    if array.shape not in ((), (count,)) or not np.all(np.isfinite(array)) or np.any(array < 0):
        raise InputError("the stds do not fit", where=name, found=shown(given),
                         expected=f"{count} finite numbers, none negative")  # fmt: skip
    return np.array(np.broadcast_to(array, (count,)))


@dataclass(frozen=True, eq=False)
class Offsets:
    """Offsets of sensors in multiples of their noise: noise of a step, start, rows."""

    LQ: NDArray[np.float64]
    L0: NDArray[np.float64]
    rows: NDArray[np.float64]


def offsets(bias: ArrayLike, start: ArrayLike | None, noise: NDArray, dt: float) -> Offsets:
    """Of the sensors that drift (std that a second adds, `bias`) or start anywhere (std, `start`), all (sensors,)."""
    m = len(noise)
    rate = levels(bias, m, "bias")
    first = np.where(rate > 0, OPEN * noise, 0.0) if start is None else levels(start, m, "bias_start")
    some = np.flatnonzero((rate > 0) | (first > 0))
    rows = np.zeros((m, len(some)))
    rows[some, np.arange(len(some))] = noise[some]
    return Offsets(np.diag(rate[some] / noise[some] * math.sqrt(dt)), np.diag(first[some] / noise[some]), rows)
