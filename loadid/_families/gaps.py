"""What may stand in the gaps of a record until a load is known: the signal that goes on as it does around them.

A structure that rings is an autoregressive process: every sample follows from those before it, but for the load.
Coefficients are fitted around the gap, and the samples in it are those that leave the least of such errors (A. J. E. M.
Janssen, R. N. J. Veldhuis & L. B. Vries, IEEE Trans. Acoust. Speech Signal Process. 34 (1986) 317). Where a load acts
errors are large: they are weighed by their size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]

ORDER = 40  # samples before each
REACH = 1500  # samples on either side of a gap that tell how the signal goes on
TURNS = 5  # of coefficients and of what they make of a gap
BESIDE, HIDING = 12, 6  # samples, of a pulse and of a gap that a pulse may lie in
LEAST = 1e-12  # of the largest sample: an error below is rounding


def bridged(values: Array, missing: NDArray[np.bool_]) -> Array:
    """Signals (samples, channels) with numbers for what is missing."""
    out = np.array(values, float)
    for x, lost in zip(out.T, missing.T, strict=True):
        if lost.any():
            t = np.arange(len(x))
            x[lost] = np.interp(t[lost], t[~lost], x[~lost])
            ends = np.flatnonzero(np.diff(np.concatenate([[0], lost.astype(int), [0]])))
            for start, end in ends.reshape(-1, 2):
                near = slice(max(start - REACH, 0), end + REACH)
                x[near] = _going_on(x[near], lost[near], start - near.start, end - near.start)
    return out


def near_gaps(load: Array, missing: NDArray[np.bool_]) -> float:
    """Largest share of the energy of a load (samples, p) in a gap (samples, channels) or within a pulse of one.

    Gaps of fewer than `HIDING` samples hide no hit.
    """
    from scipy.ndimage import binary_opening

    hiding = binary_opening(missing.any(axis=1), np.ones(HIDING, bool))
    near = np.convolve(hiding, np.ones(2 * BESIDE + 1), "same") > 0.5
    energy = np.asarray(load) ** 2
    return float(np.max(energy[near].sum(axis=0) / np.maximum(energy.sum(axis=0), np.finfo(float).tiny)))


def _going_on(x: Array, lost: NDArray[np.bool_], start: int, end: int) -> Array:
    """A signal with the samples from `start` to `end` as the others go on; lost ones tell no coefficients."""
    order = min(ORDER, (len(x) - (end - start)) // 6)
    if order < 2:
        return x
    out = x.copy()
    size = LEAST * max(float(np.abs(x).max()), np.finfo(float).tiny)
    told = ~np.convolve(lost, np.ones(order + 1), "full")[order : len(x)].astype(bool)  # rows that no gap is in
    if told.sum() < 2 * order:
        return x
    first, last = max(start - order, 0), min(end, len(told))  # rows that hold this one
    weight = np.ones(len(told))
    for _ in range(TURNS):
        rows = np.lib.stride_tricks.sliding_window_view(out, order + 1)[:, ::-1]
        some = weight[told, None]
        a = np.linalg.lstsq(some * rows[told, 1:], some[:, 0] * rows[told, 0], rcond=1e-10)[0]
        error = np.abs(rows @ np.concatenate([[1.0], -a]))
        usual = max(float(np.median(error[told])), size)
        weight = usual / np.maximum(error, usual)
        T = np.zeros((last - first, len(out)))  # their errors, linear in the samples
        for i in range(last - first):
            T[i, first + i : first + i + order + 1] = np.concatenate([-a[::-1], [1.0]])
        known = out.copy()
        known[start:end] = 0.0
        out[start:end] = np.linalg.lstsq(T[:, start:end], -(T @ known), rcond=1e-12)[0]
    return out
