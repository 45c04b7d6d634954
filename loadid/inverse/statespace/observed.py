"""The part of an unknown start that the sensors see: states that have died before the first samples tell nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

HORIZON = 4096  # samples over which a state may show itself
UNSEEN = 1e-10  # of the largest singular value of the free responses


def observed_first(A: NDArray, B: NDArray, C: NDArray, samples: int) -> tuple[NDArray, NDArray, NDArray, int]:
    """The same system in coordinates whose first ones are what the sensors see of the state at the first sample.

    Parameters
    ----------
    A, B, C : array, shapes (n, n), ([samples,] n, p), (m, n)
        C in units of the noise.
    samples : int
        Length of the record.

    Returns
    -------
    A, B : array
        In the new coordinates z, x = back z; unchanged where all states are seen.
    back : array, shape (n, n)
    seen : int
    """
    rows, block = [], np.array(C)
    for _ in range(min(samples, HORIZON)):
        rows.append(block)
        block = block @ A
    free = np.concatenate(rows)
    size = np.linalg.norm(free, axis=0)
    size = np.maximum(size, 1e-12 * size.max(initial=1e-300))
    _, s, Vt = np.linalg.svd(free / size, full_matrices=False)
    seen = int(np.sum(s > UNSEEN * s.max(initial=0.0)))
    if seen == len(A):
        return A, B, np.eye(len(A)), seen
    to, back = Vt * size, Vt.T / size[:, None]
    return to @ A @ back, to @ B, back, seen
