"""Where the antiresonances are."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEEP = 0.5  # of the largest gain around it: a minimum below that counts as a zero


def nearest_zeros(frequencies: NDArray, gain: NDArray, half: int = 40) -> NDArray[np.float64]:
    """Frequency (Hz) of the antiresonance nearest to each line, for each load, (lines, loads); inf: there is none.

    An antiresonance is a local minimum of the gain below half of the largest gain within `half` lines.
    """
    from scipy.ndimage import maximum_filter1d

    around = maximum_filter1d(gain, 2 * half + 1, axis=0, mode="nearest")
    walled = np.pad(gain, ((1, 1), (0, 0)), constant_values=np.inf)
    low = (gain < walled[:-2]) & (gain <= walled[2:]) & (gain < DEEP * around)
    found = np.full(gain.shape, np.inf)
    for j in range(gain.shape[1]):
        zeros = frequencies[low[:, j]]
        if len(zeros):
            k = np.clip(np.searchsorted(zeros, frequencies), 1, len(zeros)) - 1
            right = zeros[np.minimum(k + 1, len(zeros) - 1)]
            nearer = np.abs(right - frequencies) < np.abs(zeros[k] - frequencies)
            found[:, j] = np.where(nearer, right, zeros[k])
    return found
