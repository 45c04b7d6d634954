"""Gains of the linear-quadratic problem of a record: backward Riccati recursion in square-root form.

It carries information, not covariance: a free start and lambda -> 0 have the one and not the other (see the package).

Columns lie contiguous (arrays are transposed), only the columns of the inputs are eliminated at every step, and the
root of the cost is allowed some rows more than columns until all of it is made triangular. Its product with F takes the
entries that are not zero: few in modal form.

One QR factorisation of a small matrix for each sample, without differences of large numbers (P = Gamma^T Gamma):

    [ D         C       ]        [ M^1/2   M^1/2 K ]
    [ lam I     0       ]  =  Q  [ 0       Gamma_k ]
    [ Gamma G   Gamma F ]        [ 0       0       ]

Where the matrices do not change the gains settle (`compiled.settled`), and the recursion ends. From the end of a record
up to where they change first, the cost only grows, by r = min(m, n) squares a sample, and these alone are carried
(Chandrasekhar's equations in array form: P_k - P_{k+1} = L_k L_k^T):

    [ M^1/2     M^1/2 K   ]  k+1       [ M^1/2   M^1/2 K ]  k
    [ L^T G     L^T F     ]       = Q  [ 0       L^T     ]

Kailath, Sayed & Hassibi, Linear Estimation, Prentice Hall 2000, ch. 11 and 12, for both; Anderson & Moore, Optimal
Control, 1990, for the problem.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .compiled import KEPT, NEAR, SETTLED, Compiled, arrival, begin, decay, multiply, settled, subtract
from .record import WhitenedRecord
from .roots import Array

SPARE = 4  # rows by which a root may grow
ROOM = 1 << 22  # numbers of distinct gains that room is made for at first; what is not used takes none


def spare(m: int) -> int:
    """Rows of a root beyond its columns, for m data in a sample."""
    return m * max(SPARE // max(m, 1), 1)


@Compiled
def step(
    at: Array, entries: Array, F: Array, G: Array, C: Array, D: Array, lam: float,
    root: Array, height: int, stack: Array, K: Array, R: Array,
) -> tuple[int, float]:  # fmt: skip
    """Overwrite the root by that of the sample before, fill its gains; rows of the new root, ln det M.

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
    return height, _gain(stack, K, R)


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
    logdet : float
        ln det of the precision of inputs and free states together, that is of (H^T H + lam^2 L^T L).
    start : array, shape (free, free)
        Upper triangular root of the covariance of the free states, start start^T at unit noise.
    """

    lam: float
    K: Array
    R: Array
    which: NDArray[np.int32]
    logdet: float
    start: Array


def gains(record: WhitenedRecord, lam: float) -> Gains:
    """Gains of a record at one absolute lambda."""
    n, p, samples, last = record.n, record.p, record.samples, _last_run(record.kind)
    D, C = record.D[record.kind[-1]], record.C[record.kind[-1]]
    begun = np.linalg.qr(np.block([[D, C], [lam * np.eye(p), np.zeros((p, n))]]), mode="r")
    columns = np.arange(n) if last < samples else record.free  # of the root, that are asked for
    rows = min(max(ROOM // (p * n), 4096), samples)
    while True:
        K, R, which = np.empty((rows, p, n)), np.empty((rows, p, p)), np.empty(samples, np.int32)
        grown = np.empty((min(rows, last) if len(columns) else 0, len(begun) - p, len(columns)))
        used, logdet = _chandrasekhar(
            *record.entries, record.F, record.G, record.kind[-1], last, begun, K, R, which, columns, grown,
            record.stride,
        )  # fmt: skip
        grown = grown[:used]
        root = np.linalg.qr(grown.reshape(grown.shape[0] * grown.shape[1], len(columns)), mode="r")
        if used <= rows and last < samples:
            used, logdet, root = _recursion(
                *record.entries, record.F, record.G, record.C, record.D, record.kind, float(lam), K, R, which,
                record.stride, spare(record.m), samples - last, root, used, logdet,
            )  # fmt: skip
            root = root[:, record.free]
        if used <= rows:
            break
        rows = min(4 * rows, samples)
    start = np.zeros((0, 0))
    if len(record.free):
        from scipy.linalg import solve_triangular

        corner = np.linalg.qr(root, mode="r")
        start = solve_triangular(corner, np.eye(len(corner)))
        logdet += 2 * float(np.sum(np.log(np.abs(np.diag(corner)))))
    return Gains(float(lam), K[:used], R[:used], which, logdet, start)


def _last_run(kind: NDArray[np.int32]) -> int:
    """Samples at the end of a record that are all of one kind."""
    changes = np.flatnonzero(np.diff(kind))
    return len(kind) - (int(changes[-1]) + 1 if len(changes) else 0)


def feedback(record: WhitenedRecord, K: Array | None = None) -> Gains:
    """One feedback for all samples (default none), with M = I: for passes that solve nothing."""
    p = record.p
    K = np.zeros((p, record.n)) if K is None else K
    return Gains(0.0, K[None], np.eye(p)[None], np.zeros(record.samples, np.int32), 0.0, np.zeros((0, 0)))


@Compiled
def _chandrasekhar(
    at: Array, entries: Array, F: Array, G: Array, kind: int, count: int, begun: Array,
    K: Array, R: Array, which: Array, columns: Array, grown: Array, stride: int,
) -> tuple[int, float]:  # fmt: skip
    """Fill the last `count` of K, R and which, and the rows by which the root grows; rows used, sum ln M.

    `begun` is the triangular factor of the last sample, (p + r, p + n); `grown` (rows, r, columns) has some columns.
    """
    n, p, r, samples = F.shape[1], G.shape[2], len(begun) - G.shape[2], len(which)
    F, G, entries = F[kind], G[kind], entries[kind]
    A, L = np.ascontiguousarray(begun.T), np.empty((n, r))
    cost, before, logdet, last, arrives = np.zeros(n), np.zeros(n), 0.0, 0.0, -1
    closed, right, work = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    for row in range(count):
        if row == len(K):
            return row + 1, logdet
        if row > 0:
            A[:, p:] = 0.0
            for c in range(p):
                for h in range(n):
                    g = G[h, c]
                    for i in range(r):
                        A[c, p + i] += g * L[h, i]
            for e in range(at.shape[1]):
                c, h, f = p + at[1, e], at[0, e], entries[e]
                for i in range(r):
                    A[c, p + i] += f * L[h, i]
            _eliminate(A, p + r, p)
        for c in range(n):
            for i in range(r):
                L[c, i] = A[p + c, p + i]
                cost[c] += L[c, i] ** 2
        if len(grown):
            for i in range(r):
                for c in range(len(columns)):
                    grown[row, i, c] = L[columns[c], i]
        last = _gain(A, K[row], R[row])
        which[samples - 1 - row] = row
        logdet += last
        if (row + 1) % stride != 0:
            continue
        change = 0.0  # of the cost, relative for each state: no answer depends on the units of a state
        for c in range(n):
            if cost[c] > 0.0:
                change = max(change, (cost[c] - before[c]) / cost[c])
            before[c] = cost[c]
        if arrives < 0 and change <= NEAR:
            multiply(G, K[row], closed)
            subtract(F, closed, closed)
            arrives = arrival(row, change, 1.0, decay(closed, right, work), samples)
        if change <= SETTLED or 0 <= arrives <= row:
            which[samples - count : samples - row] = row
            return row + 1, logdet + last * (count - row - 1)
    return count, logdet


@Compiled
def _gain(A: Array, K: Array, R: Array) -> float:
    """Fill K and R from the eliminated columns of the inputs of a matrix whose transpose is A; ln det M."""
    p, logdet = len(R), 0.0
    for i in range(p - 1, -1, -1):
        for c in range(K.shape[1]):
            total = A[p + c, i]
            for q in range(i + 1, p):
                total -= A[q, i] * K[q, c]
            K[i, c] = total / A[i, i]
        for q in range(p):
            R[i, q] = A[q, i] if q >= i else 0.0
        logdet += 2.0 * np.log(abs(A[i, i]))
    return logdet


@Compiled
def _recursion(
    at: Array, entries: Array, F: Array, G: Array, C: Array, D: Array, kind: Array, lam: float,
    K: Array, R: Array, which: Array, stride: int, spare: int, end: int, begun: Array, used: int, logdet: float,
) -> tuple[int, float, Array]:  # fmt: skip
    """Fill K, R and which before `end`; rows used (one more than there are if they do not suffice), sum ln M, root."""
    n, p, m = F.shape[1], G.shape[2], C.shape[1]
    stack, root, height = np.zeros((p + n, m + p + n + spare)), np.zeros((n, n + spare + 1)), len(begun)
    closed, right, work, weight = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n)), np.zeros(n)
    row, last, steady, since, kept = used - 1, 0.0, False, 0, np.empty(KEPT)
    for i in range(height):
        for c in range(n):
            root[c, i] = begun[i, c]
    begin(kept)
    for k in range(end - 1, -1, -1):
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
            return row + 1, logdet, root[:, :height].T
        height, last = step(at, entries[j], F[j], G[j], C[j], D[j], lam, root, height, stack, K[row], R[row])
        which[k] = row
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
    return row + 1, logdet, root[:, :height].T
