"""Diagnostics of any path: conditioning with rank and nullity, resolution width, Picard."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .svd import SVDPath
from .toeplitz import SpectralPath


def layout(singular_values: NDArray, n: int) -> tuple[float, int, int]:
    """Conditioning of the observed subspace with its rank and nullity: (kappa, rank, nullity)."""
    s = np.sort(np.asarray(singular_values, float))[::-1]
    tol = max(len(s), n) * np.finfo(float).eps * s[0]
    rank = int(np.sum(s > tol))
    return float(s[0] / s[rank - 1]), rank, max(n - rank, 0)


def width(spread: NDArray, peak: int) -> float:
    """Full width at half maximum of a point spread around its peak, in samples, interpolated."""
    x = np.abs(spread) / abs(spread[peak])

    def reach(y: NDArray) -> float:
        below = np.flatnonzero(y < 0.5)
        if len(below) == 0:
            return float(len(y))
        k = int(below[0])
        return k - 1 + (y[k - 1] - 0.5) / (y[k - 1] - y[k])

    return max(1.0, reach(x[peak:]) + reach(x[peak::-1]))


def resolution(path: SVDPath | SpectralPath, lam: float, load: NDArray) -> tuple[float, float]:
    """Width in samples of the answer to a single-sample load at the peak, and the share of its height that is lost."""
    if isinstance(path, SpectralPath):
        spread = np.roll(path.point_spread(lam), len(load))
        peak = len(load)
    else:
        k = int(np.argmax(np.abs(load)))
        loads = load.shape[1]
        spread = path.resolution_column(lam, k)[k % loads :: loads]
        peak = k // loads
    if spread[peak] <= 0:
        return float(len(load)), 1.0
    return width(spread, peak), float(1 - spread[peak])
