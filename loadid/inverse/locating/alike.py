"""Candidates whose loads leave the same data: known from the impulse responses, before anything is measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

ALIKE = 1e-3  # relative difference of impulse responses, up to a factor, below which no data tell them apart


def difference(h: NDArray) -> NDArray[np.float64]:
    """Smallest relative difference ``min_c |h_i - c h_j| / |h_i|`` of the responses of each pair, (loads, loads).

    Parameters
    ----------
    h : array, shape (samples, sensors, loads)
        Whitened impulse responses. The load is free, hence its factor c, of either sign.
    """
    flat = h.reshape(-1, h.shape[2])
    unit = flat / np.linalg.norm(flat, axis=0)
    cosine = np.einsum("ki,kj->ij", unit, unit)
    return np.sqrt(np.maximum(1 - cosine**2, 0.0))


def groups(h: NDArray, near: NDArray | None = None, tolerance: float = ALIKE) -> tuple[tuple[int, ...], ...]:
    """Groups of candidates at different places that leave the same data.

    Parameters
    ----------
    h : array, shape (samples, sensors, loads)
    near : array of bool, shape (loads, loads), optional
        Which candidates are neighbours: on a fine grid these are alike because they are one place, and such a patch
        alone is no group.
    tolerance : float
    """
    alike = difference(h) <= tolerance
    together, apart = _components(alike), _components(alike if near is None else alike & near)
    found = []
    for label in np.unique(together):
        members = np.flatnonzero(together == label)
        if len(members) > 1 and (near is None or len(np.unique(apart[members])) > 1):
            found.append(tuple(int(i) for i in members))
    return tuple(found)


def _components(linked: NDArray) -> NDArray[np.int_]:
    from scipy.sparse.csgraph import connected_components

    return np.asarray(connected_components(linked, directed=False)[1])
