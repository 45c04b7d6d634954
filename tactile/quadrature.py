"""Gauss rules, worked out once."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@lru_cache(maxsize=64)
def gauss(n: int) -> tuple[Array, Array]:
    """Places and weights of the Gauss-Legendre rule of n points on 0 ... 1, read-only."""
    from scipy.special import roots_legendre

    x, w = roots_legendre(n)
    x, w = (x + 1) / 2, w / 2
    x.flags.writeable = w.flags.writeable = False
    return x, w


def drawn(n: int) -> tuple[Array, Array]:
    """The same, drawn to both ends by t = (1 - cos) / 2: square roots and logarithms there do no harm."""
    x, w = gauss(n)
    return (1 - np.cos(np.pi * x)) / 2, np.pi / 2 * w * np.sin(np.pi * x)
