"""A sparse problem over mu with the rules that choose it; least squares on its support, and their covariance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import groups as grouped
from . import lasso as workingset
from .atoms import Atoms
from .groups import Groups
from .lasso import L1, SparseSolution, largest

DENSE_SUPPORT = (
    4_000_000  # entries of the columns of a support up to which they are factorised; beyond, their Gram matrix
)
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

    support: NDArray[np.int_]
    x: NDArray[np.float64]
    residual2: float
    factor: NDArray[np.float64]

    def full(self, n: int) -> NDArray[np.float64]:
        """Coefficients (n,)."""
        x = np.zeros(n)
        x[self.support] = self.x
        return x

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation of `x` for noise of unit level, (k,)."""
        return np.sqrt(np.sum(self.spread**2, axis=1))

    @property
    def spread(self) -> NDArray[np.float64]:
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


def fit(atoms: Atoms, y: NDArray, support: NDArray, *, signs: NDArray | None = None) -> SupportFit:
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


def _factor(atoms: Atoms, y: NDArray, support: NDArray) -> tuple[NDArray, NDArray]:
    """R of the columns of the support, and Q^T y."""
    if atoms.m * len(support) <= DENSE_SUPPORT:
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


def _sound(R: NDArray) -> NDArray[np.float64]:
    """R with a diagonal that can be divided by: columns that are equal to rounding share an amplitude."""
    diagonal, floor = np.diag(R), 1e-14 * np.linalg.norm(R, axis=0).max(initial=0.0)
    small = np.abs(diagonal) < floor
    return R + np.diag(np.where(small, floor, 0.0)) if small.any() else R


def _back(R: NDArray, z: NDArray) -> NDArray[np.float64]:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(R, z, check_finite=False))


def _done(atoms: Atoms, y: NDArray, support: NDArray, x: NDArray, R: NDArray) -> SupportFit:
    """The fit, refined by residuals of the operator where R comes from the Gram matrix."""
    from scipy.linalg import solve_triangular

    residual = y - _response(atoms, support, x)
    for _ in range(SWEEPS if atoms.m * len(support) > DENSE_SUPPORT else 0):
        c = atoms.adjoint(residual)[support]
        x = x + _back(R, solve_triangular(R, c, trans="T", check_finite=False))
        residual = y - _response(atoms, support, x)
    return SupportFit(support, x, float(residual @ residual), R)


def _response(atoms: Atoms, support: NDArray, x: NDArray) -> NDArray[np.float64]:
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

    def __init__(self, basis: Any, spread: NDArray, shape: tuple[int, ...]) -> None:
        self.basis, self.spread, self.shape = basis.tocsr(), np.asarray(spread, float), tuple(int(i) for i in shape)

    @classmethod
    def of(cls, basis: Any, loads: NDArray, count: int, spread: NDArray, shape: tuple[int, ...]) -> SupportPosterior:
        """From histories (samples * len(loads), k) of some of `count` loads."""
        from scipy.sparse import coo_matrix

        found = basis.tocoo()
        time, column = np.divmod(found.row, len(loads))
        rows = time * count + np.asarray(loads)[column]
        return cls(coo_matrix((found.data, (rows, found.col)), (int(np.prod(shape)), found.shape[1])), spread, shape)

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation (samples, loads); zero where no atom of the support reaches."""
        std = np.zeros(int(np.prod(self.shape)))
        rows = np.flatnonzero(np.diff(self.basis.indptr))
        for start in range(0, len(rows), 1024):
            part = rows[start : start + 1024]
            std[part] = np.linalg.norm(self.basis[part] @ self.spread, axis=1)
        return std.reshape(self.shape)

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        w = np.asarray(w, float)
        flat = w.reshape(*w.shape[: w.ndim - len(self.shape)], -1)
        return np.sum((np.asarray(flat @ self.basis) @ self.spread) ** 2, axis=-1)

    def noise_variance(self, w: NDArray) -> NDArray[np.float64]:
        """The same: there is no prior in it."""
        return self.variance(w)

    def bias_weights(self, w: NDArray) -> None:
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
    def from_arrays(cls, tree: dict) -> SupportPosterior:
        """What `to_arrays` gave."""
        from scipy.sparse import coo_matrix

        shape, spread = tuple(int(i) for i in tree["shape"]), np.asarray(tree["spread"], float)
        at = np.asarray(tree["rows"], int), np.asarray(tree["columns"], int)
        basis = coo_matrix((np.asarray(tree["values"], float), at), (int(np.prod(shape)), len(spread)))
        return cls(basis, spread, shape)


TOLERANCE = 1e-6  # duality gap of an answer, over 1/2 |y|^2
COARSE = 1e-4  # of a step of a sweep
GRID = np.geomspace(0.7, 1e-4, 28)  # relative mu of a sweep
PATIENCE = 6  # points of the sweep without a better criterion after which it ends
DENSE = 0.5  # share of the data, or of the dictionary, beyond which nothing is sparse and a criterion says nothing
SMALL = 0.05  # share of the largest coefficient below which one is left out of the least squares
MARGIN = 1.05  # by which the residual of what is left may exceed the noise
SHARP = 0.15  # of Candes' epsilon: share of the largest coefficient below which reweighting holds down


@dataclass(frozen=True)
class Sweep:
    """A sparse path over relative mu, all arrays (points,).

    Parameters
    ----------
    ratio : array
        Over the smallest mu at which everything is zero, descending.
    residual2, penalty : array
        Squared norm of the whitened residual, and value of the penalty without mu.
    count : array
        Size of the support.
    fitted2 : array
        Squared residual of the least squares on the support.
    ebic : array
        Extended Bayesian information criterion of those.
    """

    ratio: NDArray[np.float64]
    residual2: NDArray[np.float64]
    penalty: NDArray[np.float64]
    count: NDArray[np.int_]
    fitted2: NDArray[np.float64]
    ebic: NDArray[np.float64]

    @property
    def best(self) -> int:
        """Point of the smallest criterion."""
        return int(np.argmin(self.ebic))


class SparsePath:
    """Sparse solutions of one record over relative mu.

    Parameters
    ----------
    atoms : Atoms
    y : array, shape (m,)
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
    scale : float
        Smallest mu at which everything is zero.
    """

    def __init__(
        self,
        atoms: Atoms,
        y: NDArray,
        *,
        nonnegative: bool = False,
        groups: Groups | None = None,
        weights: NDArray | None = None,
        data: int | None = None,
    ) -> None:
        self.atoms, self.y, self.nonnegative, self.weights = atoms, np.asarray(y, float), nonnegative, weights
        self.groups = groups if groups is None or weights is None else Groups(groups.labels, weights)
        self.data = atoms.m if data is None else data
        self._solver = workingset.Solver(atoms, self.y)
        self._last: NDArray | None = None
        if self.groups is None:
            self.scale = largest(atoms, self.y, weights, nonnegative)
        else:
            self.scale = grouped.largest(atoms, self.y, self.groups)

    def at(self, ratio: float, tol: float = TOLERANCE) -> SparseSolution:
        """Solution at a relative mu, started from the last one that was asked for."""
        mu = ratio * self.scale
        if self.groups is None:
            return self._solver.solve(L1(mu, self.weights, self.nonnegative), tol=tol)
        found = grouped.solve(self.atoms, self.y, mu, self.groups, tol=tol, start=self._last)
        self._last = found.x
        return found

    def reweighted(self, x: NDArray) -> SparsePath:
        """The problem whose penalty holds down what is small in x.

        Candes, Wakin & Boyd, J. Fourier Anal. Appl. 14 (2008) 877.
        """
        size = np.abs(x) if self.groups is None else self.groups.norms(x)
        weights = 1 / (1 + size / (SHARP * max(float(size.max()), 1e-300)))
        return SparsePath(
            self.atoms, self.y, nonnegative=self.nonnegative, groups=self.groups, weights=weights, data=self.data
        )

    def penalty(self, x: NDArray) -> float:
        """Value of the penalty without mu."""
        if self.groups is not None:
            return float(self.groups.weights @ self.groups.norms(x))
        return float(np.abs(x).sum() if self.weights is None else self.weights @ np.abs(x))

    # -- rules ------------------------------------------------------------------------------------------------------
    def sweep(self, sigma: float | None) -> Sweep:
        """The path down to where the information criterion has long passed its minimum."""
        rows: list[tuple[float, ...]] = []
        for ratio in GRID:
            s = self.at(float(ratio), COARSE)
            k = len(s.support)
            if k > DENSE * min(self.data, self.atoms.n):
                break
            fitted = self.fitted(s.x, 0.0)
            value = ebic(fitted.residual2, k, self.data, self.atoms.n, sigma)
            rows.append((float(ratio), float(s.residual @ s.residual), self.penalty(s.x), k, fitted.residual2, value))
            best = int(np.argmin([r[-1] for r in rows]))
            if len(rows) - best > PATIENCE:
                break
        columns = [np.array(c) for c in zip(*rows, strict=True)] if rows else [np.zeros(0)] * 6
        return Sweep(columns[0], columns[1], columns[2], columns[3].astype(int), columns[4], columns[5])

    def discrepancy(self, sigma: float) -> tuple[float, bool]:
        """Largest relative mu whose residual is no more than the noise; and whether it lies at the end of the grid."""
        target = sigma**2 * self.data
        above, high = float(self.y @ self.y), 1.0
        if above <= target:
            return 1.0, True
        for low in GRID:
            below = self._residual2(float(low))
            if below <= target:
                return self._crossing(target, (high, above), (float(low), below)), False
            above, high = below, float(low)
        return float(GRID[-1]), True

    def _crossing(self, target: float, high: tuple[float, float], low: tuple[float, float]) -> float:
        """Relative mu between two at which the squared residual meets a target, to one per cent in the residual."""
        for _ in range(12):
            if high[1] - low[1] <= 0.01 * target or low[1] > 0.995 * target:
                break
            share = np.log(target / low[1]) / np.log(high[1] / low[1])
            ratio = float(low[0] * (high[0] / low[0]) ** np.clip(share, 0.1, 0.9))
            value = self._residual2(ratio)
            high, low = ((ratio, value), low) if value > target else (high, (ratio, value))
        return low[0]

    def _residual2(self, ratio: float) -> float:
        s = self.at(ratio, COARSE)
        return float(s.residual @ s.residual)

    # -- amplitudes -------------------------------------------------------------------------------------------------
    def fitted(self, x: NDArray, small: float = SMALL, sigma: float | None = None) -> SupportFit:
        """Least squares on the coefficients of x that exceed a share `small` of the largest.

        Where the noise level is known, that share is halved until the fit explains the data.
        """
        size = np.abs(x) if self.groups is None else self.groups.norms(x)[self.groups.labels] * (x != 0)
        while True:
            kept = np.flatnonzero((size > 0) & (size >= small * size.max(initial=0.0)))
            found = fit(self.atoms, self.y, kept, signs=np.ones(len(kept)) if self.nonnegative else None)
            enough = sigma is None or found.residual2 <= MARGIN * sigma**2 * self.data
            if enough or small < 1e-3 or not small:
                return found
            small /= 2


def ebic(residual2: float, count: int, data: int, atoms: int, sigma: float | None) -> float:
    """Extended Bayesian information criterion (Chen & Chen, Biometrika 95 (2008) 759, gamma = 1).

    ``|r|^2 / sigma^2``, or ``m ln(|r|^2 / m)`` where sigma is not known, plus ``k ln m + 2 ln C(n, k)``.
    """
    from scipy.special import gammaln

    choices = gammaln(atoms + 1) - gammaln(count + 1) - gammaln(atoms - count + 1)
    misfit = data * np.log(max(residual2, 1e-300) / data) if sigma is None else residual2 / sigma**2
    return float(misfit + count * np.log(data) + 2 * choices)
