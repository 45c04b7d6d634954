"""Can the sensors tell the loads apart? Judged on lines of the frequency response, for any length of record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

TAPS = 2048  # samples of the impulse response that are looked at
LINES = 200  # lines that are looked at


def apart(h: NDArray) -> tuple[float, NDArray[np.float64]]:
    """How well the best line tells all loads apart, and the combination of loads that is seen least over all lines.

    Parameters
    ----------
    h : array, shape (taps, sensors, loads)
        Impulse responses; their units do not count, every sensor and every load is scaled to its own size.

    Returns
    -------
    ratio : float
        Smallest over largest singular value of the lines, on the best of them; 0 with fewer sensors than loads.
    combination : array, shape (loads,)
        Of norm 1, in shares of the response that each load causes.
    """
    loads = h.shape[2]
    if loads == 1:
        return 1.0, np.ones(1)
    lines = np.fft.rfft(h[:TAPS], axis=0)
    lines = lines[:: max(len(lines) // LINES, 1)]
    tiny = np.finfo(float).tiny
    lines = lines / np.maximum(np.sqrt(np.mean(np.abs(lines) ** 2, axis=(0, 2), keepdims=True)), tiny)
    lines = lines / np.maximum(np.sqrt(np.mean(np.abs(lines) ** 2, axis=(0, 1), keepdims=True)), tiny)
    stacked = lines.reshape(-1, loads)
    least = np.linalg.svd(np.vstack([stacked.real, stacked.imag]), full_matrices=False)[2][-1]
    if h.shape[1] < loads:
        return 0.0, least
    s = np.linalg.svd(lines, compute_uv=False)
    return float(np.max(s[:, -1] / np.maximum(s[:, 0], tiny))), least
