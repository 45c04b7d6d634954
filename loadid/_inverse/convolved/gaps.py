"""Samples that were not recorded, in a problem that goes line by line: unknowns that nothing is known of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from ..nuisances import Marginal

Array = NDArray[Any]
ROUNDING = 1e-13  # of what is told best, below which nothing is told


def unrecorded(
    filled: NDArray[np.bool_], weighing: Array, samples: int, padded: int,
    solve: Callable[[Array], tuple[Array, Array]], rest: Array,
) -> Marginal:  # fmt: skip
    """What stands at such samples is wrong by ``(E'QE)^-1 E'Q y``, with Q = K^-1 of all data and E of one at each.

    Parameters
    ----------
    filled : array of bool, shape (samples, m)
    weighing : array, shape (lines, m)
        What the transform of data is multiplied by; that has been divided by sqrt(samples) of unit noise.
    samples, padded : int
    solve : callable
        Lines of data (lines, m) -> K^-1 times them, and the load (samples, p) that is estimated from them.
    rest : array, shape (lines, m)
        K^-1 times the data.
    """
    at, sensors = np.nonzero(filled)
    turn = np.arange(len(weighing)) * (-2j * np.pi / padded)

    def there(lines: Array) -> Array:
        return np.asarray(samples * fft.irfft(weighing * lines, padded, axis=0)[at, sensors])

    known, pulled = np.empty((len(at),) * 2), []
    for i, (t, s) in enumerate(zip(at, sensors, strict=True)):
        lines = np.zeros(weighing.shape, complex)
        lines[:, s] = weighing[:, s] * np.exp(turn * t)
        left, load = solve(lines)
        known[i] = there(left)
        pulled.append(load)
    w, V = np.linalg.eigh((known + known.T) / 2)
    covariance = (V / np.maximum(w, ROUNDING * w[-1])) @ V.T
    wrong = covariance @ there(rest)
    return Marginal(wrong, covariance, wrong, np.array(pulled), 0.0, 1.0)
