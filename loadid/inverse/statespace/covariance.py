"""Posterior variance of the load at every sample, and the traces that the rules need, by a forward recursion.

    Var(g_k) = (E - K) X (E - K)^T + M^-1,      X <- (F - G K) X (F - G K)^T + G M^-1 G^T,

in units of the noise variance. X starts at 0, and at the inverse of P_0 in the free states. Where gains and covariance
have settled the rest of a run is counted, not computed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import Compiled
from .record import Record
from .riccati import Gains
from .settling import NEAR, NEVER, SETTLED, SHARE, STALLED, arrival, decay
from .small import multiply, multiply_by_transposed, solve_upper


@dataclass(frozen=True)
class Spread:
    """What is not known of the load, at unit noise.

    Parameters
    ----------
    variance : array, shape (samples, p), or None
        Of every sample.
    trace : float
        Sum of all variances, tr (H^T H + lam^2 L^T L)^-1.
    penalty : float
        lam^2 tr L (H^T H + lam^2 L^T L)^-1 L^T: unknowns minus effective degrees of freedom.
    """

    variance: NDArray[np.float64] | None
    trace: float
    penalty: float


def spread(record: Record, gains: Gains, every_sample: bool = True) -> Spread:
    """Variances of every sample, or their sum alone."""
    X = np.zeros((record.n, record.n))
    if len(record.free):
        X[np.ix_(record.free, record.free)] = gains.start @ gains.start.T
    variance = np.empty((record.samples if every_sample else 1, record.p))
    trace, penalty = _recursion(
        record.F,
        record.G,
        record.E,
        record.kind,
        gains.K,
        gains.R,
        gains.which,
        X,
        variance,
        every_sample,
        record.stride,
    )
    return Spread(variance if every_sample else None, float(trace), float(gains.lam**2 * penalty))


@Compiled
def _recursion(
    F: NDArray, G: NDArray, E: NDArray, kind: NDArray, K: NDArray, R: NDArray, which: NDArray, X: NDArray,
    variance: NDArray, every: bool, stride: int,
) -> tuple[float, float]:  # fmt: skip
    """Fill `variance` where wanted; sums of the variances of the loads and of the inputs."""
    n, p, samples = F.shape[1], G.shape[2], len(kind)
    half, eye = np.zeros((p, p)), np.eye(p)
    push, change, closed = np.zeros((n, p)), np.zeros((n, n)), np.zeros((n, n))
    rows, product, square = np.zeros((p, n)), np.zeros((p, n)), np.zeros((p, p))
    moved, fed, old, inner = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros((p, p))
    own, weight, work = np.zeros(p), np.zeros(n), np.zeros((n, n))
    trace, penalty, load, part, k, row, j = 0.0, 0.0, 0.0, 0.0, 0, -1, -1
    since, until, peak, before, opened = 0, -1, 0.0, np.inf, 0
    inputs_differ = bool(np.any(E != 0.0))
    while k < samples:
        if which[k] != row or kind[k] != j:
            row, j, since, until, peak, before, opened = which[k], kind[k], 0, -1, 0.0, np.inf, 0
            solve_upper(R[row], eye, half)
            multiply_by_transposed(half, half, inner)  # M^-1
            multiply(G[j], half, push)
            multiply_by_transposed(push, push, fed)
            multiply(G[j], K[row], change)
            closed[:] = F[j]
            closed -= change
            rows[:] = E
            rows -= K[row]
        multiply(rows, X, product)
        multiply_by_transposed(product, rows, square)
        load = 0.0
        for i in range(p):
            own[i] = square[i, i] + inner[i, i]
            load += own[i]
        if inputs_differ:
            multiply(K[row], X, product)
            multiply_by_transposed(product, K[row], square)
        part = 0.0
        for i in range(p):
            part += square[i, i] + inner[i, i]
        if every:
            variance[k] = own
        trace += load
        penalty += part
        k += 1
        if since % stride == 0:
            if since > 0:
                for i in range(n):  # of each state, what it does to a load or an input
                    weight[i] = max(np.abs(K[row, :, i]).max(), np.abs(rows[:, i]).max())
                gap, size = 0.0, np.abs(inner).max()
                for i in range(n):
                    for h in range(n):
                        gap = max(gap, weight[i] * weight[h] * abs(X[i, h] - old[i, h]))
                        size = max(size, weight[i] * weight[h] * abs(X[i, h]))
                if until < 0 and gap <= NEAR * size:
                    until = arrival(since, gap, size, decay(closed, moved, work), samples)
                steady = False
                if until == NEVER:
                    peak = max(peak, gap)
                    if since - opened > max(opened // 2, 16 * stride):
                        steady = peak <= STALLED * size and peak >= SHARE * before
                        peak, before, opened = 0.0, peak, since
                else:
                    steady = gap <= SETTLED * size or 0 <= until <= since
                if steady:
                    while k < samples and which[k] == row and kind[k] == j:
                        if every:
                            variance[k] = own
                        trace += load
                        penalty += part
                        k += 1
                    continue
            old[:] = X
        since += 1
        multiply(closed, X, moved)
        multiply_by_transposed(moved, closed, X)
        X += fed
    return trace, penalty
