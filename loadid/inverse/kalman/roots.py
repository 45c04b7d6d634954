"""Triangular roots of covariances by Householder reflections: nothing is squared, nothing is subtracted."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray


@lru_cache(maxsize=1)
def lapack() -> tuple[Any, Any]:
    """``dgeqrf`` and ``dtrtrs``, found once: numpy's own QR copies, and costs more than the work at these sizes."""
    from scipy.linalg.lapack import dgeqrf, dtrtrs

    return dgeqrf, dtrtrs


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
    made = lapack()[0](wide.T, lwork=32 * max(len(wide), 1), overwrite_a=1)[0].T
    return made[:, : min(made.shape)]


def lower(*parts: NDArray) -> NDArray[np.float64]:
    """Lower triangular (trapezoidal) root of the sum of ``part part^T``; parts have shapes (n, any)."""
    wide = np.concatenate(parts, axis=1)
    if not wide.size:
        return np.zeros((len(wide), 0))
    made = reflected(np.ascontiguousarray(wide, float))
    return made * below(*made.shape)


def forward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-1 b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, lower=1)[0] if len(L) else np.array(b, float)


def backward(L: NDArray, b: NDArray) -> NDArray[np.float64]:
    """``L^-T b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    return lapack()[1](L, b, lower=1, trans=1)[0] if len(L) else np.array(b, float)
