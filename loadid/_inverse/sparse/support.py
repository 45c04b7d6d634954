"""Least squares on the support of a sparse solution, and the covariance of the load that it makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..arrays import Array, Indices
from .atoms import Atoms

DENSE = 4_000_000  # entries of the columns of a support up to which they are factorised; beyond, their Gram matrix
RIDGE = 1e-13  # of its diagonal
SWEEPS = 3  # refinements of a solution from the Gram matrix by residuals of the operator


@dataclass(frozen=True)
class SupportFit:
    """Least squares on some atoms.

    Parameters
    ----------
    support : array of int, shape (k,)
        Ascending; with non-negativity those that stayed positive.
    x : array, shape (k,)
    residual2 : float
        Squared norm of the whitened residual.
    factor : array, shape (k, k)
        Upper triangular R with ``R^T R = A_S^T A_S``: the covariance for noise of unit level is ``R^-1 R^-T``.
    """

    support: Indices
    x: Array
    residual2: float
    factor: Array

    def full(self, n: int) -> Array:
        """Coefficients (n,)."""
        x = np.zeros(n)
        x[self.support] = self.x
        return x

    @property
    def std(self) -> Array:
        """Standard deviation of `x` for noise of unit level, (k,)."""
        return np.asarray(np.sqrt(np.sum(self.spread**2, axis=1)))

    @property
    def spread(self) -> Array:
        """Factor R^-1 of the covariance, (k, k)."""
        from scipy.linalg import solve_triangular

        if not len(self.x):
            return np.zeros((0, 0))
        return np.asarray(solve_triangular(self.factor, np.eye(len(self.x)), check_finite=False))

    @property
    def kappa(self) -> float:
        """Condition number of the columns of the support, each scaled to unit length."""
        if not len(self.x):
            return 1.0
        singular = np.linalg.svd(self.factor / np.linalg.norm(self.factor, axis=0), compute_uv=False)
        return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")


def fit(atoms: Atoms, y: Array, support: Indices, *, signs: Array | None = None) -> SupportFit:
    """Least squares on a support, by QR of its columns, or by refinement where these are too many to hold.

    Parameters
    ----------
    atoms : Atoms
    y : array, shape (m,)
    support : array of int, shape (k,)
    signs : array, shape (k,), optional
        Signs (1 or -1) that the amplitudes must keep; those that would change are left out.
    """
    support = np.sort(np.asarray(support, int))
    if not len(support):
        return SupportFit(support, np.zeros(0), float(y @ y), np.zeros((0, 0)))
    R, z = _factor(atoms, y, support)
    if signs is None:
        return _done(atoms, y, support, _back(R, z), R)
    from scipy.optimize import nnls

    size = np.linalg.norm(R, axis=0)
    size = np.where(size > 0, size, 1.0)
    positive = nnls(R * (signs / size), z)[0]
    kept = positive > 1e-12 * positive.max(initial=0.0)
    if kept.all():
        return _done(atoms, y, support, _back(R, z), R)
    return fit(atoms, y, support[kept])


def _factor(atoms: Atoms, y: Array, support: Indices) -> tuple[Array, Array]:
    """R of the columns of the support, and Q^T y."""
    if atoms.m * len(support) <= DENSE:
        Q, R = np.linalg.qr(atoms.columns(support))
        return _sound(R), Q.T @ y
    from scipy.linalg import cholesky, solve_triangular

    G, ridge = atoms.gram(support, support), RIDGE
    while True:
        try:
            R = cholesky(G + np.diag(ridge * np.diag(G)), check_finite=False)
            return R, solve_triangular(R, atoms.adjoint(y)[support], trans="T", check_finite=False)
        except np.linalg.LinAlgError:
            ridge *= 100


def _sound(R: Array) -> Array:
    """R with a diagonal that can be divided by: columns that are equal to rounding share an amplitude."""
    diagonal, floor = np.diag(R), 1e-14 * np.linalg.norm(R, axis=0).max(initial=0.0)
    small = np.abs(diagonal) < floor
    return R + np.diag(np.where(small, floor, 0.0)) if small.any() else R


def _back(R: Array, z: Array) -> Array:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(R, z, check_finite=False))


def _done(atoms: Atoms, y: Array, support: Indices, x: Array, R: Array) -> SupportFit:
    """The fit, refined by residuals of the operator where R comes from the Gram matrix."""
    from scipy.linalg import solve_triangular

    residual = y - _response(atoms, support, x)
    for _ in range(SWEEPS if atoms.m * len(support) > DENSE else 0):
        c = atoms.adjoint(residual)[support]
        x = x + _back(R, solve_triangular(R, c, trans="T", check_finite=False))
        residual = y - _response(atoms, support, x)
    return SupportFit(support, x, float(residual @ residual), R)


def _response(atoms: Atoms, support: Indices, x: Array) -> Array:
    full = np.zeros(atoms.n)
    full[support] = x
    return atoms.apply(full)


class SupportPosterior:
    """Covariance ``B S S^T B^T`` of a load ``B x`` that is made of the few atoms of a support.

    It holds the noise on this support. Whether the support is the right one, it does not say.

    Parameters
    ----------
    basis : sparse matrix, shape (samples * loads, k)
        Histories of the atoms of the support.
    spread : array, shape (k, k)
        S, with the level of the noise in it.
    shape : tuple
        (samples, loads).
    """

    kind = "support"
    noise_std = None

    def __init__(self, basis: Any, spread: Array, shape: tuple[int, ...]) -> None:
        self.basis, self.spread, self.shape = basis.tocsr(), np.asarray(spread, float), tuple(int(i) for i in shape)

    @classmethod
    def of(cls, basis: Any, loads: Indices, count: int, spread: Array, shape: tuple[int, ...]) -> SupportPosterior:
        """From histories (samples * len(loads), k) of some of `count` loads."""
        from scipy.sparse import coo_matrix

        found = basis.tocoo()
        time, column = np.divmod(found.row, len(loads))
        rows = time * count + np.asarray(loads)[column]
        return cls(coo_matrix((found.data, (rows, found.col)), (int(np.prod(shape)), found.shape[1])), spread, shape)

    @property
    def std(self) -> Array:
        """Standard deviation (samples, loads); zero where no atom of the support reaches."""
        std = np.zeros(int(np.prod(self.shape)))
        rows = np.flatnonzero(np.diff(self.basis.indptr))
        for start in range(0, len(rows), 1024):
            part = rows[start : start + 1024]
            std[part] = np.linalg.norm(self.basis[part] @ self.spread, axis=1)
        return std.reshape(self.shape)

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        w = np.asarray(w, float)
        flat = w.reshape(*w.shape[: w.ndim - len(self.shape)], -1)
        return np.asarray(np.sum((np.asarray(flat @ self.basis) @ self.spread) ** 2, axis=-1))

    def noise_variance(self, w: Array) -> Array:
        """The same: there is no prior in it."""
        return self.variance(w)

    def bias_weights(self, w: Array) -> None:
        """Not known: the support was chosen by the data."""

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        found = self.basis.tocoo()
        return {
            "kind": self.kind,
            "rows": np.asarray(found.row, np.int64),
            "columns": np.asarray(found.col, np.int64),
            "values": found.data,
            "spread": self.spread,
            "shape": list(self.shape),
        }

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> SupportPosterior:
        """What `to_arrays` gave."""
        from scipy.sparse import coo_matrix

        shape, spread = tuple(int(i) for i in tree["shape"]), np.asarray(tree["spread"], float)
        at = np.asarray(tree["rows"], int), np.asarray(tree["columns"], int)
        basis = coo_matrix((np.asarray(tree["values"], float), at), (int(np.prod(shape)), len(spread)))
        return cls(basis, spread, shape)
