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
    sample, j = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    unit = np.zeros(load.shape)
    unit[sample, j] = 1.0
    spread = path.resolve(unit, lam)[:, j]
    if spread[sample] <= 0:
        return float(len(load)), 1.0
    return width(spread, int(sample)), float(1 - spread[sample])


def hidden(path: SVDPath | SpectralPath, lam: float, load: NDArray, std: NDArray) -> NDArray[np.float64]:
    """What regularisation is expected to hide, (R - I) g for the part of the estimate that stands out of its noise.

    The estimate itself has lost it already (low frequencies that accelerometers do not see come back as a slow
    undershoot); its clear part, above three standard deviations and a tenth of the peak, still holds it. Zero for an
    estimate that is all noise.
    """
    size = np.abs(load)
    clear = np.where(size > np.maximum(3 * std, 0.1 * size.max(axis=0)), load, 0.0)
    return path.resolve(clear, lam) - clear
