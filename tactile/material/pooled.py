"""Numbers of several curves brought together, with the scatter from run to run in their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
SMALLEST = 1e-9  # std of a noise-free number, so that its weight stays finite


@dataclass(frozen=True)
class Pooled:
    """Weighted least squares over curves.

    Parameters
    ----------
    value, std : array (p,)
        Coefficients and their std, widened by the scatter between curves where that exceeds the noise of each.
    dof : int
        Curves minus coefficients; 0 leaves the scatter between runs unseen.
    excess : float
        Scatter between curves over what their own noise explains.
    """

    value: Array
    std: Array
    dof: int
    excess: float

    def half_width(self, i: int = 0, level: float = 0.95) -> float:
        """Half of the interval of coefficient i, by Student's t."""
        from scipy.special import ndtri, stdtrit

        q = 0.5 + level / 2
        return float((stdtrit(self.dof, q) if self.dof > 0 else ndtri(q)) * self.std[i])

    def p_value(self, i: int) -> float:
        """Probability of a coefficient at least that large where it is zero."""
        from scipy.special import ndtr, stdtr

        z = -abs(float(self.value[i] / self.std[i]))
        return float(2 * (stdtr(self.dof, z) if self.dof > 0 else ndtr(z)))


def pool(values: ArrayLike, stds: ArrayLike, design: ArrayLike) -> Pooled:
    """Fit values = design @ coefficients with weights 1/std^2; the Birge ratio, where above one, widens the std.

    Parameters
    ----------
    values, stds : array (n,)
    design : array (n, p)
    """
    y, s, X = np.asarray(values, float), np.maximum(np.asarray(stds, float), SMALLEST), np.asarray(design, float)
    A, b = X / s[:, None], y / s
    q, r = np.linalg.qr(A)
    value = np.linalg.solve(r, q.T @ b)
    dof = len(y) - X.shape[1]
    misfit = float(np.sum((b - A @ value) ** 2))
    excess = float(np.sqrt(misfit / dof)) if dof > 0 else 1.0
    rows = np.linalg.solve(r.T, np.eye(X.shape[1]))
    return Pooled(value, np.sqrt(np.sum(rows**2, axis=0)) * max(1.0, excess), dof, excess)
