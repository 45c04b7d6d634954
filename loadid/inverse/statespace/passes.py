"""The two passes of a solve: backward from the data to what drives the inputs, forward to inputs, loads and responses.

With the gains of `riccati` and L g = w,

    backward  s = G^T v + D^T y + a,   u = M^-1 s,   v <- F^T v + C^T y + E^T a - K^T s,
    forward   w = u - K xi,   g = E xi + w,   r = C xi + D w,   xi <- F xi + G w,

where a is a linear term on the load (0 for a plain solve). Where the gains have settled both are filters that do not
change with time: without compiled loops they run as products of blocks of samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..compiled import AVAILABLE, compiled
from .record import Record
from .riccati import Gains

BLOCK = 64  # samples in one product
STEADY = 256  # samples with one gain from which blocks pay


@dataclass(frozen=True)
class Solved:
    """One solve.

    Parameters
    ----------
    inputs : array, shape (samples, p)
        w = L g; the first differences of a free start are 0.
    load : array, shape (samples, p)
    response : array, shape (samples, m)
        H g with the start of the record, 0 where data are missing.
    start : array, shape (n,)
        State at the first sample.
    value : float
        ``q^T (H^T H + lam^2 L^T L)^-1 q`` for the right-hand side q = H^T y + a.
    """

    inputs: NDArray[np.float64]
    load: NDArray[np.float64]
    response: NDArray[np.float64]
    start: NDArray[np.float64]
    value: float


def solve(record: Record, gains: Gains, y: NDArray | None = None, a: NDArray | None = None) -> Solved:
    """Minimise ``|y - H g|^2 + lam^2 |L g|^2 - 2 a^T g`` over the load and the free states.

    Parameters
    ----------
    y : array, shape (samples, m), optional
        Whitened data; default those of the record.
    a : array, shape (samples, p), optional
    """
    u, v, value = backward(record, gains, record.y if y is None else y, a)
    start = np.zeros(record.n)
    if len(record.free):
        half = gains.start.T @ v[record.free]
        start[record.free] = gains.start @ half
        value += float(half @ half)
    w, g, response = forward(record, gains, u, start)
    return Solved(w, g, response, start, value)


def backward(record: Record, gains: Gains, y: NDArray, a: NDArray | None) -> tuple[NDArray, NDArray, float]:
    """u (samples, p), v at the first sample, and the sum of s^T u."""
    linear = a is not None
    a = np.zeros((1, record.p)) if a is None else np.ascontiguousarray(a, float)
    if AVAILABLE:
        u, v = np.empty((record.samples, record.p)), np.zeros(record.n)
        value = _backward(*record.entries, record.G, record.C, record.D, record.E, record.kind, gains.K, gains.R,
                          gains.which, np.ascontiguousarray(y), a, linear, u, v)  # fmt: skip
        return u, v, float(value)
    return _backward_in_blocks(record, gains, y, a, linear)


def forward(record: Record, gains: Gains, u: NDArray, start: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Inputs, load and response, (samples, p), (samples, p), (samples, m)."""
    if AVAILABLE:
        w, g, r = np.empty_like(u), np.empty_like(u), np.empty((record.samples, record.m))
        _forward(*record.entries, record.G, record.C, record.D, record.E, record.kind, gains.K, gains.which, u,
                 np.array(start), w, g, r)  # fmt: skip
        return w, g, r
    return _forward_in_blocks(record, gains, u, start)


# -- compiled loops ---------------------------------------------------------------------------------------------------
@compiled
def _backward(
    at: NDArray, F: NDArray, G: NDArray, C: NDArray, D: NDArray, E: NDArray, kind: NDArray, K: NDArray, R: NDArray,
    which: NDArray, y: NDArray, a: NDArray, linear: bool, u: NDArray, v: NDArray,
) -> float:  # fmt: skip
    """Fill u and v; F holds its entries at the places `at` (rows, columns) only. The sum of s^T u."""
    n, p, m, entries = G.shape[1], G.shape[2], C.shape[1], at.shape[1]
    s, new, value = np.empty(p), np.empty(n), 0.0
    for k in range(len(kind) - 1, -1, -1):
        j, row = kind[k], which[k]
        for i in range(p):
            total = a[k, i] if linear else 0.0
            for l in range(n):
                total += G[j, l, i] * v[l]
            for l in range(m):
                total += D[j, l, i] * y[k, l]
            s[i] = total
        for i in range(n):
            total = 0.0
            for l in range(m):
                total += C[j, l, i] * y[k, l]
            for l in range(p):
                total -= K[row, l, i] * s[l]
            if linear:
                for l in range(p):
                    total += E[l, i] * a[k, l]
            new[i] = total
        for e in range(entries):
            new[at[1, e]] += F[j, e] * v[at[0, e]]
        for i in range(n):
            v[i] = new[i]
        for i in range(p):  # R^T z = s
            z = s[i]
            for l in range(i):
                z -= R[row, l, i] * u[k, l]
            u[k, i] = z / R[row, i, i]
            value += u[k, i] * u[k, i]
        for i in range(p - 1, -1, -1):  # R u = z
            z = u[k, i]
            for l in range(i + 1, p):
                z -= R[row, i, l] * u[k, l]
            u[k, i] = z / R[row, i, i]
    return value


@compiled
def _forward(
    at: NDArray, F: NDArray, G: NDArray, C: NDArray, D: NDArray, E: NDArray, kind: NDArray, K: NDArray,
    which: NDArray, u: NDArray, x: NDArray, w: NDArray, g: NDArray, r: NDArray,
) -> None:  # fmt: skip
    """Fill inputs, load and response from the state x at the first sample."""
    n, p, m, entries = G.shape[1], G.shape[2], C.shape[1], at.shape[1]
    new = np.empty(n)
    for k in range(len(kind)):
        j, row = kind[k], which[k]
        for i in range(p):
            total, load = u[k, i], 0.0
            for l in range(n):
                total -= K[row, i, l] * x[l]
                load += E[i, l] * x[l]
            w[k, i] = total
            g[k, i] = load + total
        for i in range(m):
            total = 0.0
            for l in range(n):
                total += C[j, i, l] * x[l]
            for l in range(p):
                total += D[j, i, l] * w[k, l]
            r[k, i] = total
        for i in range(n):
            total = 0.0
            for l in range(p):
                total += G[j, i, l] * w[k, l]
            new[i] = total
        for e in range(entries):
            new[at[0, e]] += F[j, e] * x[at[1, e]]
        for i in range(n):
            x[i] = new[i]


# -- blocks -----------------------------------------------------------------------------------------------------------
def runs(record: Record, gains: Gains) -> list[tuple[int, int]]:
    """First sample and length of every run of samples with the same matrices and gains."""
    changes = np.flatnonzero((np.diff(gains.which) != 0) | (np.diff(record.kind) != 0)) + 1
    starts = np.concatenate([[0], changes])
    return list(zip(starts.tolist(), np.diff(np.append(starts, record.samples)).tolist(), strict=True))


def _backward_in_blocks(
    record: Record, gains: Gains, y: NDArray, a: NDArray, linear: bool
) -> tuple[NDArray, NDArray, float]:
    from scipy.linalg import solve_triangular

    v, s = np.zeros(record.n), np.empty((record.samples, record.p))
    for first, length in reversed(runs(record, gains)):
        j, K = record.kind[first], gains.K[gains.which[first]]
        F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
        part = slice(first, first + length)
        data = np.hstack([y[part], a[part]]) if linear else y[part]
        into = np.hstack([(C - D @ K).T, (E - K).T]) if linear else (C - D @ K).T
        feed = np.hstack([D.T, np.eye(record.p)]) if linear else D.T
        s[part], v = _filter((F - G @ K).T, into, G.T, feed, v, data, backwards=True)
    u = np.empty_like(s)
    value = 0.0
    for first, length in runs(record, gains):
        part, R = slice(first, first + length), gains.R[gains.which[first]]
        z = solve_triangular(R, s[part].T, trans="T")
        value += float(np.sum(z**2))
        u[part] = solve_triangular(R, z).T
    return u, v, value


def _forward_in_blocks(
    record: Record, gains: Gains, u: NDArray, start: NDArray
) -> tuple[NDArray, NDArray, NDArray]:
    x, p = np.array(start), record.p
    out = np.empty((record.samples, 2 * p + record.m))
    for first, length in runs(record, gains):
        j, K = record.kind[first], gains.K[gains.which[first]]
        F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
        part = slice(first, first + length)
        rows, feed = np.vstack([-K, E - K, C - D @ K]), np.vstack([np.eye(p), np.eye(p), D])
        out[part], x = _filter(F - G @ K, G, rows, feed, x, u[part], backwards=False)
    return out[:, :p].copy(), out[:, p : 2 * p].copy(), out[:, 2 * p :].copy()


def _filter(
    A: NDArray, B: NDArray, C: NDArray, D: NDArray, x: NDArray, u: NDArray, backwards: bool
) -> tuple[NDArray, NDArray]:
    """``out = C x + D u``, ``x <- A x + B u`` over samples of one run; outputs and the last state."""
    if backwards:
        out, x = _filter(A, B, C, D, x, u[::-1], False)
        return out[::-1], x
    samples, inputs, outputs, n = len(u), B.shape[1], len(C), len(A)
    blocks = samples // BLOCK
    done = 0
    out = np.empty((samples, outputs))
    if samples >= STEADY:
        powers = [np.eye(n)]
        for _ in range(BLOCK):
            powers.append(A @ powers[-1])
        observe = np.concatenate([C @ P for P in powers[:-1]])  # (BLOCK outputs, n)
        reach = np.concatenate([P @ B for P in powers[-2::-1]], axis=1)  # (n, BLOCK inputs)
        answer = np.concatenate([D, *(C @ P @ B for P in powers[:-2])]).reshape(BLOCK, outputs, inputs)
        toeplitz = np.zeros((BLOCK, outputs, BLOCK, inputs))
        for k in range(BLOCK):
            toeplitz[k:, :, k] = answer[: BLOCK - k]
        done = blocks * BLOCK
        rows = np.ascontiguousarray(u[:done]).reshape(blocks, BLOCK * inputs)
        pushed, states = rows @ reach.T, np.empty((blocks, n))
        for i in range(blocks):
            states[i] = x
            x = powers[-1] @ x + pushed[i]
        direct = rows @ toeplitz.reshape(BLOCK * outputs, BLOCK * inputs).T
        out[:done] = (direct + states @ observe.T).reshape(done, outputs)
    for k in range(done, samples):
        out[k] = C @ x + D @ u[k]
        x = A @ x + B @ u[k]
    return out, x
