"""A sparse problem over mu, and the rules that choose it: discrepancy and information criterion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from . import groups as grouped
from . import workingset
from .atoms import Atoms
from .debias import SupportFit, fit
from .groups import Groups
from .lasso import L1, SparseSolution, largest

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
