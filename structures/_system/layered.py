"""Condensation of layered solids: layer by layer from the base, and by mirror symmetry where there is one.

The nodes of a block lie on levels, and a level is coupled with its two neighbours only. Eliminating level after level
costs one dense factor for each; a sparse factor with a right-hand side for every surface DOF costs several times that.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import plain
from .factor import Factor, compliance, schur
from .structure import Structure

Array = NDArray[np.float64]
Index = NDArray[np.intp]
LATTICE = 1e-7  # of the longest side: nodes nearer to a mirror image are it
SILENT = 1e-14  # of a right-hand side: a part of another symmetry so small is rounding
SAME = 1e-10  # of the largest entry of K: what a mirror may change


def reflections(structure: Structure, axes: Sequence[int] = (0, 1)) -> list[sparse.csr_array]:
    """Mirrors about the middle planes that leave the stiffness of the free DOFs as it is.

    Parameters
    ----------
    structure : Structure
        With coordinates (nodes, 3) and the DOFs X, Y, Z at every node, in the order of the nodes.
    axes : sequence of int
        Normals of the planes that are tried: 0 for X, 1 for Y, 2 for Z.

    Returns
    -------
    list of sparse (free, free)
        Signed permutations; empty where there is no symmetry.
    """
    places = structure.coordinates
    if places is None or places.shape[1] != 3 or structure.n != 3 * len(places):
        return []
    size = np.ptp(places, axis=0).max()
    centre = (places.min(axis=0) + places.max(axis=0)) / 2
    found = []
    for axis in axes:
        image = (places - centre) / size
        order = _sorted(image)
        image[:, axis] *= -1
        other = _sorted(image)
        partner = np.empty(len(places), np.intp)
        partner[other] = order
        moved = (places - centre)[partner] / size
        if np.abs(moved - image).max() > LATTICE:
            continue
        G = _signed(structure, partner, axis)
        K = structure.K_free
        if G is not None and abs(G @ K @ G.T - K).max() <= SAME * abs(K).max():
            found.append(G)
    return found


def _sorted(image: Array) -> Index:
    """Order of the nodes by place, blind to rounding."""
    return np.lexsort(np.round(image / LATTICE / 2).T)


def _signed(structure: Structure, partner: Index, axis: int) -> sparse.csr_array | None:
    """The mirror on the free DOFs; None where it takes a free DOF to a supported one."""
    free = structure.free
    to = 3 * partner[free // 3] + free % 3
    place = np.searchsorted(free, to)
    if np.any(place >= free.size) or np.any(free[np.minimum(place, free.size - 1)] != to):
        return None
    sign = np.where(free % 3 == axis, -1.0, 1.0)
    return sparse.coo_array((sign, (np.arange(free.size), place)), shape=(free.size,) * 2).tocsr()


def blocks(mirrors: Sequence[sparse.csr_array], size: int) -> list[tuple[sparse.csc_array, Index]]:
    """Orthonormal motions of each kind of symmetry.

    Parameters
    ----------
    mirrors : sequence of sparse (n, n)
        Commuting signed permutations, each its own inverse.
    size : int
        n.

    Returns
    -------
    list of (sparse (n, m), int array (m,))
        For each choice of even and odd: motions as columns, and the DOF that stands for each. ``T.T @ K @ T`` are the
        blocks of K; all T side by side are orthogonal.

    Notes
    -----
    J.-P. Serre, *Linear Representations of Finite Groups* (Springer, 1977), section 2.6: projectors onto the isotypic
    parts of a representation of an Abelian group.
    """
    one = sparse.eye_array(size, format="csr")
    first = np.arange(size)
    orbit = first.copy()
    for choice in itertools.product((0, 1), repeat=len(mirrors)):
        moved = one
        for take, G in zip(choice, mirrors, strict=True):
            moved = G @ moved if take else moved
        orbit = np.minimum(orbit, moved.tocsr().indices)
    stands = np.flatnonzero(orbit == first)
    out = []
    for signs in itertools.product((1.0, -1.0), repeat=len(mirrors)):
        P = one
        for sign, G in zip(signs, mirrors, strict=True):
            P = (P + sign * (G @ P)) / 2
        P = P.tocsc()[:, stands]
        norms = np.sqrt(np.asarray(P.multiply(P).sum(axis=0)).ravel())
        kept = norms > 0.1  # orbits have 1, 2 or 4 members: norms are 1/2 and more, or zero
        T = sparse.csc_array(P[:, kept] @ sparse.diags_array(1 / norms[kept]))
        T.data[np.abs(T.data) < 1e-12] = 0.0
        T.eliminate_zeros()
        out.append((T, stands[kept]))
    return out


class SymmetricFactor:
    """Factors of the blocks of a symmetric matrix, each built when a right-hand side asks for it.

    Parameters
    ----------
    K : sparse (n, n)
        Symmetric and positive definite.
    mirrors : sequence of sparse (n, n)
        Signed permutations that leave it as it is (`reflections`); none gives one block.

    Notes
    -----
    Two mirror planes make four blocks of a quarter of the size: the factors are four times cheaper together, and a
    symmetric load needs one of them only.
    """

    def __init__(self, K: Any, mirrors: Sequence[sparse.csr_array] = ()) -> None:
        self.K = sparse.csr_array(K)
        self._motions = [T for T, _ in blocks(mirrors, self.K.shape[0])]
        self._factors: list[Factor | None] = [None] * len(self._motions)

    def solve(self, B: Any) -> Array:
        """Solution of ``K X = B`` for an array or sparse matrix (n,) or (n, k).

        Raises
        ------
        InputError, NotIdentifiable
            As `Factor`.
        """
        B = B.toarray() if sparse.issparse(B) else np.asarray(plain(B), float)
        X, size = np.zeros_like(B), np.abs(B).max(initial=0.0)
        for i, T in enumerate(self._motions):
            part = T.T @ B
            if T.shape[1] == 0 or np.abs(part).max(initial=0.0) <= SILENT * size:
                continue
            factor = self._factors[i]
            if factor is None:
                factor = self._factors[i] = Factor(T.T @ self.K @ T)
            X += T @ factor.solve(part)
        return np.asarray(X)


STRIP = 256  # rows at once: no second copy of the whole


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
