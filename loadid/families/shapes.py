"""What a load history looks like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def half_width(g: NDArray) -> float:
    """Width in samples of the largest pulse of a history at half its height."""
    size = np.abs(g)
    k = int(np.argmax(size))
    low = size < 0.5 * size[k]
    before, after = np.flatnonzero(low[:k]), np.flatnonzero(low[k:])
    left = k - (before[-1] if len(before) else -1)
    right = after[0] if len(after) else len(g) - k
    return float(left + right - 1)


def kurtosis(g: NDArray) -> float:
    """Fourth moment over the square of the second about zero; 3 for a Gaussian history, large for impacts."""
    power = float(np.mean(g**2))
    return float(np.mean(g**4)) / power**2 if power > 0 else 0.0
