"""What a load history looks like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def kurtosis(g: NDArray) -> float:
    """Fourth moment over the square of the second about zero; 3 for a Gaussian history, large for impacts."""
    power = float(np.mean(g**2))
    return float(np.mean(g**4)) / power**2 if power > 0 else 0.0
