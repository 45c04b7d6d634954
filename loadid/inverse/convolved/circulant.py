"""Circulant preconditioner: the normal operator of an unending record, line by line, cut to the record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .operator import Operator


class Circulant:
    """``P^-1 r``: pad, transform, solve a (loads x loads) system on each line, transform back, cut. SPD for lambda > 0.

    Chan & Ng, SIAM Review 38 (1996) 427. Where neither the sensors nor the penalty see a line (a constant under a
    difference penalty) the penalty of half a line's spacing is a floor.

    Parameters
    ----------
    operator : Operator
    lam : float
        Absolute lambda.
    """

    def __init__(self, operator: Operator, lam: float) -> None:
        self.operator, self.lam = operator, lam
        p, H = operator.loads, operator.lines
        share = 1.0 if operator.weight is None else float(np.mean(operator.weight**2))
        G = np.empty((p, p, H.shape[-1]), complex)
        for i in range(p):
            for j in range(i + 1):
                G[i, j] = share * np.sum(H[:, i].conj() * H[:, j], axis=0)
        half = np.maximum(np.arange(H.shape[-1]), 0.5) * np.pi / operator.padded
        damping = lam**2 * (2 * np.sin(half)) ** (2 * operator.order)
        for i in range(p):
            G[i, i] += damping
        self.lower, self.pivots = _factor(G)

    def solve(self, r: NDArray) -> NDArray[np.float64]:
        """P^-1 r for loads (k, loads, samples)."""
        R, L, p = self.operator.transform(r), self.lower, self.operator.loads
        for i in range(p):
            for j in range(i):
                R[:, i] -= L[i, j] * R[:, j]
        R *= self.pivots
        for i in range(p - 1, -1, -1):
            for j in range(i + 1, p):
                R[:, i] -= L[j, i].conj() * R[:, j]
        return self.operator.record(R)


def _factor(G: NDArray) -> tuple[NDArray, NDArray]:
    """Unit lower factors (p, p, lines) and reciprocal pivots (p, lines) of Hermitian matrices, lower half given."""
    p = len(G)
    L, d = np.zeros_like(G), np.empty((p, G.shape[-1]))
    for j in range(p):
        d[j] = G[j, j].real - sum((np.abs(L[j, k]) ** 2 * d[k] for k in range(j)), np.zeros(G.shape[-1]))
        for i in range(j + 1, p):
            L[i, j] = (G[i, j] - sum(L[i, k] * L[j, k].conj() * d[k] for k in range(j))) / d[j]
    return L, 1.0 / d
