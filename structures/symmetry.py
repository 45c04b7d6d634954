"""Mirror symmetry of a structure: its stiffness falls into uncoupled blocks of a half or a quarter of the DOFs."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .factor import Factor
from .structure import Structure
from .values import plain

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
        return X
