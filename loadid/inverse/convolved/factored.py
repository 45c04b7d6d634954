"""Exact preconditioner of a short record, by one factorisation for all lambdas."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .operator import Operator


class Factored:
    """``A^-1 r`` for A = H^T H + lam^2 L^T L by the modes of (H, L), ``X diag(1 / (c^2 + lam^2 s^2)) X^T``.

    Conjugate gradients then take some steps, which give back the digits that a product with the inverse loses.

    Parameters
    ----------
    operator : Operator
    lam : float
        Absolute lambda.
    """

    def __init__(self, operator: Operator, lam: float) -> None:
        modes = operator.modes
        self.operator, self.lam = operator, lam
        self._X, self._size2 = modes.X, modes.c**2 + (lam * modes.s) ** 2

    def solve(self, r: NDArray) -> NDArray[np.float64]:
        """A^-1 r for loads (k, loads, samples)."""
        flat = np.swapaxes(r, 1, 2).reshape(len(r), -1)
        found = (flat @ self._X / self._size2) @ self._X.T
        return np.ascontiguousarray(np.swapaxes(found.reshape(len(r), r.shape[2], r.shape[1]), 1, 2))
