"""A sparse problem over mu: a path on which rules choose; least squares on a support and its covariance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .. import Array, Indices, rules
from ..path import PathPoint, RegularizationPath
from ..sweep import Sweep
from . import TOLERANCE
from . import groups as grouped
from . import lasso as workingset
from .atoms import Atoms
from .groups import Groups
from .lasso import L1, SparseSolution, largest

COARSE = 1e-4  # of a step of a sweep
GRID = np.geomspace(0.7, 1e-4, 28)  # relative mu of a sweep
PATIENCE = 6  # points of the sweep without a better criterion after which it ends
DENSE = 0.5  # share of the data, or of the dictionary, beyond which nothing is sparse and a criterion says nothing
SMALL = 0.05  # share of the largest coefficient below which one is left out of the least squares
MARGIN = 1.05  # by which the residual of what is left may exceed the noise
SHARP = 0.15  # of Candes' epsilon: share of the largest coefficient below which reweighting holds down


class SparsePath(RegularizationPath):
    """Sparse solutions of one record over relative mu, by name `lam` in the contract.

    Parameters
    ----------
    atoms : Atoms
    y : array, shape (samples, sensors) or (m,)
        Whitened data, zero where missing.
    nonnegative : bool
    groups : Groups, optional
        Coefficients that are zero together.
    weights : array, optional
        Of the coefficients, or of the groups.
    data : int, optional
        Number of data that are not missing.

    Attributes
    ----------
    scale : array, shape ()
        Smallest mu at which everything is zero.
    """

    smooth, dear, margin, null = False, True, None, 0

    def __init__(
        self,
        atoms: Atoms,
        y: Array,
        *,
        nonnegative: bool = False,
        groups: Groups | None = None,
        weights: Array | None = None,
        data: int | None = None,
    ) -> None:
        y = np.asarray(y, float)
        self.layout = (len(y), -1)
        self.atoms, self.y, self.nonnegative, self.weights = atoms, y.reshape(-1), nonnegative, weights
        self.groups = groups if groups is None or weights is None else Groups(groups.labels, weights)
        self.m = atoms.m if data is None else data
        self._solver = workingset.Solver(atoms, self.y)
        self._last: Array | None = None
        if self.groups is None:
            self.scale = np.asarray(largest(atoms, self.y, weights, nonnegative))
        else:
            self.scale = np.asarray(grouped.largest(atoms, self.y, self.groups))

    def solve(self, ratio: float, tol: float = TOLERANCE) -> SparseSolution:
        """Solution at a relative mu, started from the last one that was asked for."""
        mu = ratio * float(self.scale)
        if self.groups is None:
            return self._solver.solve(L1(mu, self.weights, self.nonnegative), tol=tol)
        found = grouped.solve(self.atoms, self.y, mu, self.groups, tol=tol, start=self._last)
        self._last = found.x
        return found

    def reweighted(self, x: Array) -> SparsePath:
        """The problem whose penalty holds down what is small in x.

        Candes, Wakin & Boyd, J. Fourier Anal. Appl. 14 (2008) 877.
        """
        size = np.abs(x) if self.groups is None else self.groups.norms(x)
        weights = 1 / (1 + size / (SHARP * max(float(size.max()), 1e-300)))
        return SparsePath(
            self.atoms,
            self.y.reshape(self.layout),
            nonnegative=self.nonnegative,
            groups=self.groups,
            weights=weights,
            data=self.m,
        )

    def penalty(self, x: Array) -> float:
        """Value of the penalty without mu."""
        if self.groups is not None:
            return float(self.groups.weights @ self.groups.norms(x))
        return float(np.abs(x).sum() if self.weights is None else self.weights @ np.abs(x))

    # -- the contract -----------------------------------------------------------------------------------------------
    @property
    def range(self) -> tuple[float, float]:
        """Relative mu of the grid."""
        return float(GRID[-1]), 1.0

    def at(self, lam: ArrayLike) -> PathPoint:
        """Scalars at relative mu: as degrees of freedom count the atoms of the support."""
        found = [self._scalars(float(x)) for x in np.ravel(lam)[::-1]]
        return self._point(np.array(found)[::-1].T.reshape(3, *np.shape(lam)))

    def residual(self, lam: float) -> Array:
        """Whitened residual, in the layout of the data."""
        return self.solve(lam, COARSE).residual.reshape(self.layout)

    def residuals(self, lams: Array) -> Iterable[Array]:
        """Whitened residuals, computed from the largest mu down."""
        return [self.residual(float(lam)) for lam in lams[::-1]][::-1]

    def _scalars(self, lam: float) -> tuple[float, float, float]:
        """Squared residual, squared penalty and size of the support."""
        if lam >= 1:
            return float(self.y @ self.y), 0.0, 0.0
        return self._measured(self.solve(lam, COARSE))

    def _measured(self, s: SparseSolution) -> tuple[float, float, float]:
        return float(s.residual @ s.residual), self.penalty(s.x) ** 2, float(len(s.support))

    def _point(self, scalars: Array) -> PathPoint:
        residual2, penalty2, count = scalars
        return PathPoint(residual2, penalty2, count, left=self.m - count)

    # -- sweeps -----------------------------------------------------------------------------------------------------
    def sweep(self, sigma: float | None) -> Sweep:
        """The path down to where the information criterion has long passed its minimum; empty where all is dense."""
        rows: list[tuple[float, ...]] = []
        scores: list[float] = []
        for ratio in GRID:
            s = self.solve(float(ratio), COARSE)
            k = len(s.support)
            if k > DENSE * min(self.m, self.atoms.n):
                break
            fitted2, count = self.fitted(s.x, 0.0).residual2, log_supports(self.atoms.n, k)
            rows.append((float(ratio), *self._measured(s), fitted2, count))
            scores.append(float(rules.information(fitted2, k, count, self.m, sigma)))
            if len(rows) - int(np.argmin(scores)) > PATIENCE:
                break
        columns = np.array(rows[::-1]).reshape(-1, 6).T
        point = replace(self._point(columns[1:4]), fitted2=columns[4], log_supports=columns[5])
        return Sweep(self, columns[0], point, sigma)

    def to_noise(self, sigma: float) -> Sweep:
        """The path from where everything is zero down to the noise, where the discrepancy rule looks no further."""
        level = rules.discrepancy_level(self.m, sigma, self.margin)
        lams, rows = [1.0], [self._scalars(1.0)]
        while rows[-1][0] > level and len(rows) <= len(GRID):
            lams.append(float(GRID[len(rows) - 1]))
            rows.append(self._scalars(lams[-1]))
        return Sweep(self, np.array(lams[::-1]), self._point(np.array(rows[::-1]).T), sigma)

    # -- amplitudes -------------------------------------------------------------------------------------------------
    def fitted(self, x: Array, small: float = SMALL, sigma: float | None = None) -> SupportFit:
        """Least squares on the coefficients of x that exceed a share `small` of the largest.

        Where the noise level is known, that share is halved until the fit explains the data.
        """
        size = np.abs(x) if self.groups is None else self.groups.norms(x)[self.groups.labels] * (x != 0)
        while True:
            kept = np.flatnonzero((size > 0) & (size >= small * size.max(initial=0.0)))
            found = fit(self.atoms, self.y, kept, signs=np.ones(len(kept)) if self.nonnegative else None)
            enough = sigma is None or found.residual2 <= MARGIN * sigma**2 * self.m
            if enough or small < 1e-3 or not small:
                return found
            small /= 2


def log_supports(atoms: int, count: int) -> float:
    """Logarithm of the number of supports of a size, ln C(atoms, count)."""
    from scipy.special import gammaln

    return float(gammaln(atoms + 1) - gammaln(count + 1) - gammaln(atoms - count + 1))


FACTORISED = 4_000_000  # entries of the columns of a support up to which they are factorised; beyond, their Gram matrix
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
    if atoms.m * len(support) <= FACTORISED:
        both = np.column_stack([atoms.columns(support), y])  # Q^T y is the last column of its R: no Q is formed
        R = np.asarray(np.linalg.qr(both, mode="r"))[: len(support)]
        return _sound(R[:, :-1]), R[:, -1]
    from scipy.linalg import cholesky, solve_triangular

    # the columns do not fit: `SWEEPS` refinements by the operator keep all digits up to a condition number of 1e5
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
    for _ in range(SWEEPS if atoms.m * len(support) > FACTORISED else 0):
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
