"""Triangular roots of covariances by Householder reflections: nothing is squared, nothing is subtracted."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

NARROW, WIDE, LARGE = 4, 16, 100  # columns that `dtpqrt` reflects together, and the size from which it is the more


@lru_cache(maxsize=1)
def lapack() -> tuple[Any, Any, Any]:
    """``dgeqrf``, ``dtrtrs``, ``dtpqrt``, found once: numpy's QR copies and costs more than the work at these sizes.

    All are called by position, as names cost a microsecond: (a, lwork, overwrite), (a, b, lower, trans),
    (l, block, a, b, overwrite a, overwrite b).
    """
    from scipy.linalg.lapack import dgeqrf, dtpqrt, dtrtrs

    return dgeqrf, dtrtrs, dtpqrt


@lru_cache(maxsize=64)
def below(rows: int, columns: int) -> NDArray[np.float64]:
    """Ones on and below the diagonal."""
    ones = np.tril(np.ones((rows, columns)))
    ones.setflags(write=False)
    return ones


def reflected(wide: NDArray) -> NDArray[np.float64]:
    """``L`` with ``L L^T = wide wide^T`` in the lower triangle of what is returned; above it lie left-overs.

    Parameters
    ----------
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    made = lapack()[0](wide.T, 32 * max(len(wide), 1), 1)[0].T
    return made[:, : min(made.shape)]


def lower(*parts: NDArray) -> NDArray[np.float64]:
    """Lower triangular (trapezoidal) root of the sum of ``part part^T``; parts have shapes (n, any)."""
    wide = np.concatenate(parts, axis=1)
    if not wide.size:
        return np.zeros((len(wide), 0))
    made = reflected(np.ascontiguousarray(wide, float))
    return made * below(*made.shape)


def square(L: NDArray) -> NDArray[np.float64]:
    """The same root with columns of zeros up to a square."""
    out = np.zeros((len(L), len(L)))
    out[:, : L.shape[1]] = L
    return out


def joined(L: NDArray, wide: NDArray) -> NDArray[np.float64]:
    """Lower triangular root of ``L L^T + wide wide^T`` for a lower triangular L (n, n), which is half of the work.

    Parameters
    ----------
    L : array, shape (n, n), C-contiguous
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    if not wide.size:
        return L
    block = min(NARROW if len(L) < LARGE else WIDE, len(L))
    made: NDArray[np.float64] = lapack()[2](0, block, L.copy().T, wide.T, 1, 1)[0].T
    return made


def forward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-1 b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, 1)[0] if len(L) else np.array(b, float)


def backward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-T b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, 1, 1)[0] if len(L) else np.array(b, float)
