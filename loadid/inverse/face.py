"""The face of the feasible set on which a load lies, and least squares on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import cones
from .feasible import Feasible


@dataclass(frozen=True, eq=False)
class Face:
    """Face of the intervals and cones near a point, in turned unknowns: on a cone along the ray, across, outward.

    Parameters
    ----------
    point : array, shape (n,)
        Projection of the point, not turned.
    share : array, shape (n,)
        Derivative of the projection along each turned unknown: 1 free, 0 held.
    turns : tuple of (index (k, dim), axes (k, dim, dim))
        Cones that are turned; the other unknowns stay as they are.
    status : tuple of array
        Per group of cones: 0 open, 1 sliding, 2 sticking.
    """

    point: NDArray[np.float64]
    share: NDArray[np.float64]
    turns: tuple[tuple[NDArray[np.int_], NDArray[np.float64]], ...]
    status: tuple[NDArray[np.int_], ...]

    @classmethod
    def near(cls, feasible: Feasible, v: NDArray) -> Face:
        """The face to which `v` projects."""
        point = np.clip(v, feasible.lower, feasible.upper)
        share = ((v > feasible.lower) & (v < feasible.upper)).astype(float)
        turns, status = [], []
        for c in feasible.cones:
            w = v[c.index]
            found = cones.faces(w, c.mu, c.facets)
            point[c.index], share[c.index] = cones.project(w, found), found.share
            side = found.status == 1
            if np.any(side):
                turns.append((c.index[side], found.axes[side]))
            status.append(found.status)
        return cls(point, share, tuple(turns), tuple(status))

    @property
    def held(self) -> NDArray[np.bool_]:
        """Turned unknowns that the face holds."""
        return self.share == 0

    def curvature(self, tau: NDArray) -> NDArray[np.float64]:
        """Second derivative that the curved sides of round cones add to half the objective, along each unknown."""
        a = self.share
        return np.divide(1 - a, a * tau, out=np.zeros(len(a)), where=(a > 0) & (a < 1))

    def turn(self, x: NDArray) -> NDArray[np.float64]:
        """Turned unknowns, along the first axis."""
        out = x.copy()
        for index, axes in self.turns:
            out[index] = np.einsum("kij,ki...->kj...", axes, x[index])
        return out

    def back(self, x: NDArray) -> NDArray[np.float64]:
        """Inverse of `turn`, along the first axis."""
        out = x.copy()
        for index, axes in self.turns:
            block = x[index.ravel()].reshape(*index.shape, -1)
            out[index.ravel()] = np.matmul(axes, block).reshape(index.size, *x.shape[1:])
        return out

    def columns(self, A: NDArray) -> NDArray[np.float64]:
        """Columns of a matrix for the turned unknowns."""
        out = A.copy(order="F")
        for index, axes in self.turns:
            _turn(out, index, axes)
        return out

    def gram(self, G: NDArray, f: NDArray) -> NDArray[np.float64]:
        """Rows and columns `f` of a symmetric matrix for the turned unknowns."""
        if not self.turns:
            return np.asfortranarray(G[np.ix_(f, f)])
        used = np.zeros(len(G), bool)
        used[f] = True
        for index, _ in self.turns:
            used[index] = True
        place = np.cumsum(used) - 1
        M = np.asfortranarray(G[np.ix_(used, used)])
        for _ in range(2):
            for index, axes in self.turns:
                _turn(M, place[index], axes)
            M = np.asfortranarray(M.T)
        return np.asfortranarray(M[np.ix_(place[f], place[f])])


def _turn(A: NDArray, index: NDArray, axes: NDArray) -> None:
    """Turn some columns of a Fortran-ordered matrix, in place."""
    flat = index.ravel()
    rows = A.T[flat].reshape(*index.shape, len(A))
    A.T[flat] = np.matmul(axes.transpose(0, 2, 1), rows).reshape(index.size, len(A))
