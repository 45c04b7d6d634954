"""The l1 problem and its certificate: objective, dual point and duality gap."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .atoms import Atoms


@dataclass(frozen=True)
class SparseSolution:
    """Minimum of ``1/2 |A x - y|^2 + mu sum w |x|``, with what proves it.

    Parameters
    ----------
    x : array, shape (n,)
    support : array of int
        Coefficients that are not zero, ascending.
    residual : array, shape (m,)
        y - A x.
    mu : float
    gap : float
        Duality gap over ``1/2 |y|^2``: the objective is above its minimum by no more than this.
    objective : float
        Over ``1/2 |y|^2``.
    steps : int
        Newton steps (factorisations).
    converged : bool
        Whether the gap that was asked for is reached.
    """

    x: NDArray[np.float64]
    support: NDArray[np.int_]
    residual: NDArray[np.float64]
    mu: float
    gap: float
    objective: float
    steps: int
    converged: bool


@dataclass(frozen=True)
class L1:
    """The penalty ``mu sum w_j |x_j|``, or the same over ``x >= 0``.

    Parameters
    ----------
    mu : float
    weights : array, shape (n,), or None for ones
    nonnegative : bool
    """

    mu: float
    weights: NDArray[np.float64] | None = None
    nonnegative: bool = False

    def levels(self, n: int) -> NDArray[np.float64]:
        """Bound of each correlation, mu w_j, (n,)."""
        return np.full(n, self.mu) if self.weights is None else self.mu * self.weights

    def excess(self, c: NDArray) -> NDArray[np.float64]:
        """How far the correlations c = A^T r exceed their levels: positive where a zero should not stay zero."""
        return (c if self.nonnegative else np.abs(c)) - self.levels(len(c))

    def dual_scale(self, c: NDArray) -> float:
        """Largest factor up to 1 that makes the residual a feasible dual point."""
        size = c if self.nonnegative else np.abs(c)
        worst = float(np.max(size / self.levels(len(c)), initial=0.0))
        return 1.0 if worst <= 1 else 1 / worst

    def value(self, x: NDArray, which: NDArray) -> float:
        """The penalty of some coefficients `x` at the places `which`."""
        size = np.abs(x)
        return float(self.mu * (size.sum() if self.weights is None else self.weights[which] @ size))


def largest(atoms: Atoms, y: NDArray, weights: NDArray | None = None, nonnegative: bool = False) -> float:
    """Smallest mu at which everything is zero."""
    c = atoms.adjoint(y)
    c = c if weights is None else c / weights
    return float(np.max(c if nonnegative else np.abs(c), initial=0.0))


def gap(y: NDArray, residual: NDArray, penalty: float, scale: float) -> tuple[float, float]:
    """Objective, and its distance from the dual objective at ``scale * residual``, both over ``1/2 |y|^2``.

    The gap is formed from differences of vectors, so that it can fall to the rounding of the objective itself.
    """
    half = 0.5 * float(y @ y)
    if half == 0:
        return 0.0, 0.0
    primal = 0.5 * float(residual @ residual) + penalty
    # 1/2|r|^2 + pen - (1/2|y|^2 - 1/2|y - s r|^2) = 1/2 (1 - s)^2 |r|^2 + pen - s r'(y - r)
    distance = 0.5 * (1 - scale) ** 2 * float(residual @ residual) + penalty - scale * float(residual @ (y - residual))
    return primal / half, max(distance, 0.0) / half
