"""Condensation of a solid made of layers: level by level from the base, and by mirror symmetry where there is one.

The nodes of a block lie on levels, and a level is coupled with its two neighbours only. Eliminating level after level
costs one dense factor for each; a sparse factor with a right-hand side for every surface DOF costs several times that.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .condensation import compliance, schur
from .factor import Factor
from .structure import Structure
from .symmetry import blocks, reflections

STRIP = 256  # rows at once: no second copy of the whole
Array = NDArray[np.float64]
Index = NDArray[np.intp]


def condense(structure: Structure, surface: Any, levels: ArrayLike | None = None) -> tuple[Array, Array]:
    """Stiffness and compliance of some DOFs of a solid, all others unloaded.

    Parameters
    ----------
    structure : Structure
        Any; a block or another mesh of levels is served level by level.
    surface : int array (s,)
        DOFs that stay, as rows of the structure: on the uppermost level where it has levels.
    levels : int array (nodes,), optional
        Level of each node from the base up; by height where not given. Levels that couple more than neighbours are not
        used.

    Returns
    -------
    stiffness, compliance : array (s, s)

    Raises
    ------
    NotIdentifiable
        If the structure is a mechanism.
    InputError
        If a block of the stiffness is not positive definite.

    Notes
    -----
    Block elimination of a symmetric positive definite matrix is as stable as its Cholesky factor. With two mirror
    planes there are four problems of a quarter of the size.
    """
    K, free = structure.K_free, structure.free
    stays = np.searchsorted(free, np.asarray(surface))
    level = _levels(structure, levels)
    if level is not None and np.any(level[stays] != level.max()):
        level = None
    mirrors = [G for G in reflections(structure) if np.isin(G.indices[stays], stays).all()]
    parts = blocks(mirrors, free.size)
    stiffness, flexible = (np.zeros((stays.size, stays.size)) for _ in range(2))
    for T, stands in parts:
        on_top = np.isin(stands, stays)
        if not on_top.any():
            continue
        block = sparse.csr_array(T.T @ K @ T)
        S = _condensed(block, np.flatnonzero(on_top), None if level is None else level[stands])
        A = compliance(S.copy(order="F"))
        share = T[stays][:, np.flatnonzero(on_top)].tocsr()
        _spread(stiffness, share, S)
        _spread(flexible, share, A)
    return stiffness, flexible


def _levels(structure: Structure, known: ArrayLike | None) -> Index | None:
    """Level of every free DOF from the base up; None where the stiffness couples more than neighbours."""
    places = structure.coordinates
    if places is None or places.shape[1] != 3 or structure.n != 3 * len(places):
        return None
    heights = np.round(places[:, 2] / np.ptp(places[:, 2]) * 1e6) if known is None else np.asarray(known)
    _, level = np.unique(heights, return_inverse=True)
    found = np.repeat(level.ravel(), 3)[structure.free]
    K = structure.K_free.tocoo()
    if len(np.unique(found)) > 64 or np.any(np.abs(found[K.coords[0]] - found[K.coords[1]]) > 1):
        return None
    return found


def _condensed(K: sparse.csr_array, stays: Index, level: Index | None) -> Array:
    """Schur complement on `stays`, the whole uppermost level."""
    if level is None or np.any(level[stays] != level.max()) or np.count_nonzero(level == level.max()) != len(stays):
        return schur(K, stays, Factor)
    below: Array | None = None
    rows: Index = np.empty(0, np.intp)
    for height in np.unique(level):
        here = np.flatnonzero(level == height)
        S = K[here][:, here].toarray(order="F")
        if below is not None:
            C = K[here][:, rows].tocsr()
            S -= C @ (C @ compliance(below)).T  # the inverse is symmetric
            S = (S + S.T) / 2
        below, rows = np.asfortranarray(S), here
    assert below is not None
    return below


def _spread(out: Array, share: sparse.csr_array, block: Array) -> None:
    """Add ``share @ block @ share.T``, each row of `share` with one entry at most; whole rows at a time."""
    across = np.ascontiguousarray((share @ block).T)
    there = np.flatnonzero(np.diff(share.indptr))
    for start in range(0, len(there), STRIP):
        strip = slice(start, start + STRIP)
        out[there[strip]] += across[share.indices[strip]] * share.data[strip, None]
