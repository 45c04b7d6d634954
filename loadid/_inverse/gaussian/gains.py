"""Gains of the linear-quadratic problem of a record: backward Riccati recursion in square-root form.

It carries information, not covariance: a free start and lambda -> 0 have the one and not the other (see the package).

Columns lie contiguous (arrays are transposed), only the columns of the inputs are eliminated at every step, and the
root of the cost is allowed some rows more than columns until all of it is made triangular. Its product with F takes the
entries that are not zero: few in modal form.

One QR factorisation of a small matrix for each sample, without differences of large numbers (P = Gamma^T Gamma):

    [ D         C       ]        [ M^1/2   M^1/2 K ]
    [ lam I     0       ]  =  Q  [ 0       Gamma_k ]
    [ Gamma G   Gamma F ]        [ 0       0       ]

Where the matrices do not change the gains settle (`compiled.settled`), and the recursion ends. Kailath, Sayed &
Hassibi, Linear Estimation, Prentice Hall 2000, ch. 12, for the array form; Anderson & Moore, Optimal Control, 1990, for
the problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .compiled import KEPT, Compiled, begin, multiply, settled, subtract
from .record import WhitenedRecord
from .roots import Array

SPARE = 4  # rows by which a root may grow


def spare(m: int) -> int:
    """Rows of a root beyond its columns, for m data in a sample."""
    return m * max(SPARE // max(m, 1), 1)


@Compiled
def step(
    at: Array, entries: Array, F: Array, G: Array, C: Array, D: Array, lam: float,
    root: Array, height: int, stack: Array, K: Array, R: Array,
) -> int:  # fmt: skip
    """Overwrite the root by that of the sample before, fill its gains; rows of the new root.

    Parameters
    ----------
    at, entries : array, shapes (2, entries), (entries,)
        Places and values of what is not zero in F.
    root : array, shape (n, at least height)
        Transpose of Gamma.
    stack : array, shape (p + n, rows)
        To work in; its rows bound those of the root.
    K, R : array, shapes (p, n), (p, p)
        To be filled.
    """
    n, p, m = G.shape[0], G.shape[1], C.shape[0]
    top, rows = m + p, m + p + height
    for c in range(p + n):
        for i in range(m):
            stack[c, i] = D[i, c] if c < p else C[i, c - p]
        for i in range(m, rows):
            stack[c, i] = 0.0
    for c in range(p):
        stack[c, m + c] = lam
        for h in range(n):
            g = G[h, c]
            for i in range(height):
                stack[c, top + i] += g * root[h, i]
    for e in range(at.shape[1]):
        c, h, f = p + at[1, e], at[0, e], entries[e]
        for i in range(height):
            stack[c, top + i] += f * root[h, i]
    if rows - p < root.shape[1]:
        height = rows - p
        _eliminate(stack, rows, p)
    else:
        height = n
        _eliminate(stack, rows, p + n)
    for c in range(n):
        for i in range(height):
            root[c, i] = stack[p + c, p + i]
    for i in range(p - 1, -1, -1):
        for c in range(n):
            total = stack[p + c, i]
            for q in range(i + 1, p):
                total -= stack[q, i] * K[q, c]
            K[i, c] = total / stack[i, i]
        for q in range(p):
            R[i, q] = stack[q, i] if q >= i else 0.0
    return height


@Compiled
def _eliminate(A: Array, rows: int, steps: int) -> None:
    """Householder reflections of the first `rows` rows of a matrix whose transpose is A, for its first columns."""
    for j in range(steps):
        norm2 = 0.0
        for i in range(j + 1, rows):
            norm2 += A[j, i] * A[j, i]
        if norm2 == 0.0:
            continue
        d = A[j, j]
        alpha = np.sqrt(norm2 + d * d)
        if d > 0.0:
            alpha = -alpha
        first = d - alpha
        scale = 2.0 / (norm2 + first * first)
        end = rows
        while A[j, end - 1] == 0.0:
            end -= 1
        A[j, j] = first
        for c in range(j + 1, A.shape[0]):
            s0, s1, s2, s3, i = 0.0, 0.0, 0.0, 0.0, j  # four sums: none waits for another
            while i + 4 <= end:
                s0 += A[j, i] * A[c, i]
                s1 += A[j, i + 1] * A[c, i + 1]
                s2 += A[j, i + 2] * A[c, i + 2]
                s3 += A[j, i + 3] * A[c, i + 3]
                i += 4
            while i < end:
                s0 += A[j, i] * A[c, i]
                i += 1
            w = scale * ((s0 + s1) + (s2 + s3))
            for i in range(j, end):
                A[c, i] -= w * A[j, i]
        A[j, j] = alpha
        for i in range(j + 1, rows):
            A[j, i] = 0.0


@dataclass(frozen=True)
class Gains:
    """Feedback of every sample at one lambda.

    Parameters
    ----------
    lam : float
        Absolute lambda.
    K : array, shape (rows, p, n)
        Distinct gains, the last sample's first.
    R : array, shape (rows, p, p)
        Upper triangular factors, M = R^T R.
    which : array of int, shape (samples,)
        Row of each sample.
    root : array, shape (n, n)
        Factor of the cost of the initial state, P_0 = root^T root.
    logdet : float
        ln det of the precision of inputs and free states together, that is of (H^T H + lam^2 L^T L).
    start : array, shape (free, free)
        Upper triangular root of the covariance of the free states, start start^T at unit noise.
    """

    lam: float
    K: Array
    R: Array
    which: NDArray[np.int32]
    root: Array
    logdet: float
    start: Array


def gains(record: WhitenedRecord, lam: float) -> Gains:
    """Gains of a record at one absolute lambda."""
    rows = 4096
    while True:
        rows = min(rows, record.samples)
        K, R = np.empty((rows, record.p, record.n)), np.empty((rows, record.p, record.p))
        which = np.empty(record.samples, np.int32)
        used, root, logdet = _recursion(
            *record.entries, record.F, record.G, record.C, record.D, record.kind, float(lam), K, R, which,
            record.stride, spare(record.m),
        )  # fmt: skip
        if used <= rows:
            break
        rows *= 4
    square = np.asarray(np.linalg.qr(root, mode="r"))
    root = np.vstack([square, np.zeros((record.n - len(square), record.n))])
    start = np.zeros((0, 0))
    if len(record.free):
        from scipy.linalg import solve_triangular

        corner = np.linalg.qr(root[:, record.free], mode="r")
        start = solve_triangular(corner, np.eye(len(corner)))
        logdet += 2 * float(np.sum(np.log(np.abs(np.diag(corner)))))
    return Gains(float(lam), K[:used], R[:used], which, root, logdet, start)


def feedback(record: WhitenedRecord, K: Array | None = None) -> Gains:
    """One feedback for all samples (default none), with M = I: for passes that solve nothing."""
    p = record.p
    K = np.zeros((p, record.n)) if K is None else K
    return Gains(0.0, K[None], np.eye(p)[None], np.zeros(record.samples, np.int32), np.empty(0), 0.0, np.zeros((0, 0)))


@Compiled
def _recursion(
    at: Array, entries: Array, F: Array, G: Array, C: Array, D: Array, kind: Array, lam: float,
    K: Array, R: Array, which: Array, stride: int, spare: int,
) -> tuple[int, Array, float]:  # fmt: skip
    """Fill K, R and which from the end; rows used (one more than there are if they do not suffice), root, sum ln M."""
    n, p, m = F.shape[1], G.shape[2], C.shape[1]
    stack, root, height = np.zeros((p + n, m + p + n + spare)), np.zeros((n, n + spare + 1)), n
    closed, right, work, weight = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    row, logdet, last, steady, since, kept = -1, 0.0, 0.0, False, 0, np.empty(KEPT)
    begin(kept)
    for k in range(len(kind) - 1, -1, -1):
        j = kind[k]
        if k + 1 < len(kind) and j != kind[k + 1]:
            steady, since = False, 0
            begin(kept)
        if steady:
            which[k] = row
            logdet += last
            continue
        row += 1
        if row == len(K):
            return row + 1, root[:, :height].T, logdet
        height = step(at, entries[j], F[j], G[j], C[j], D[j], lam, root, height, stack, K[row], R[row])
        which[k], last = row, 0.0
        for i in range(p):
            last += 2.0 * np.log(abs(R[row, i, i]))
        logdet += last
        since += 1
        if since <= stride or since % stride != 0:
            continue
        # gains in the units of states that cost the same: no answer depends on the units of a state
        change, size = 0.0, 0.0
        for i in range(n):
            weight[i] = 0.0
            for h in range(height):
                weight[i] += root[i, h] ** 2
            weight[i] = 1.0 / np.sqrt(weight[i]) if weight[i] > 0.0 else 0.0
            for h in range(p):
                change = max(change, weight[i] * abs(K[row, h, i] - K[row - stride, h, i]))
                size = max(size, weight[i] * abs(K[row, h, i]))
        multiply(G[j], K[row], closed)
        subtract(F[j], closed, closed)
        steady = settled(kept, since, stride, change, size, closed, right, work, len(kind))
    return row + 1, root[:, :height].T, logdet
