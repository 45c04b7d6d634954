"""A sparse problem over mu: a path on which rules choose, each of its points a solution."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from .. import rules
from ..arrays import Array
from ..path import PathPoint, RegularizationPath
from ..sweep import Sweep
from . import TOLERANCE
from . import groups as grouped
from . import lasso as workingset
from .atoms import Atoms
from .groups import Groups
from .lasso import L1, SparseSolution, largest
from .support import SupportFit, fit

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
