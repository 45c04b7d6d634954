"""Nodal forces from the displacements that are known, where all other nodes of the surface carry no load."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

if TYPE_CHECKING:
    from .pad import Pad

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Completion:
    """The surface of a pad of which some displacements are given: ``F = K U``, the others condensed as free of load.

    Parameters
    ----------
    known : int array (k,)
        DOFs of the surface, 3 * node + component, whose displacement is given.
    stiffness : sparse or array (k, k)
        Forces on them from their displacements.
    others : int array (3 P - k,)
        The DOFs that carry no load.
    follow : array (3 P - k, k) or None
        How those move with the known ones.
    """

    known: NDArray[np.intp]
    stiffness: Any
    others: NDArray[np.intp]
    follow: Any

    @classmethod
    def of(cls, pad: Pad, known: NDArray[np.bool_], K: Any = None) -> Completion:
        """Of a pad, with a mask (P, 3) of the displacements that are given; `K` is its surface stiffness if at hand."""
        from structures.factor import Factor

        K = surface_stiffness(pad) if K is None else K
        flat = np.asarray(known, bool).ravel()
        k, o = np.flatnonzero(flat), np.flatnonzero(~flat)
        if o.size == 0:
            return cls(k, K, o, None)
        rows = K[o]
        follow = -Factor(sparse.csc_array(rows[:, o])).solve(np.asarray(_dense(rows[:, k])))
        return cls(k, _dense(K[k][:, k]) + _dense(K[k][:, o]) @ follow, o, follow)

    def forces(self, U: Array) -> Array:
        """Nodal forces (3 P,) in N from the known displacements (k,) in m."""
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = self.stiffness @ U
        return out

    def displacements(self, U: Array) -> Array:
        """All displacements of the surface (3 P,) in m."""
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = U
        if self.follow is not None:
            out[self.others] = self.follow @ U
        return out

    def spread(self, half: Any) -> Array:
        """Std of the nodal forces (3 P,), where `half` (k, r) is a factor of the covariance of the known motion."""
        moved = self.stiffness @ half
        moved = moved.toarray() if sparse.issparse(moved) else moved
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = np.sqrt(np.sum(np.asarray(moved) ** 2, axis=1))
        return out


def surface_stiffness(pad: Pad) -> Any:
    """Stiffness of the surface (3 P, 3 P): sparse for a single layer, whose surface has no interior under it."""
    if pad.structure.free.size == pad.dofs.size:
        order = np.searchsorted(pad.structure.free, pad.dofs)
        return pad.structure.K_free[order][:, order].tocsr()
    return pad.stiffness


def _dense(A: Any) -> Array:
    return np.asarray(A.toarray() if sparse.issparse(A) else A, float)
