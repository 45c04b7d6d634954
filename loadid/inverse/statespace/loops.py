"""The passes sample by sample, where gains or matrices change."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compiled import Compiled
from .record import Record
from .riccati import Gains


def backward(
    record: Record, gains: Gains, part: slice, y: NDArray, a: NDArray | None, u: NDArray, v: NDArray
) -> tuple[NDArray[np.float64], float]:
    """Fill u of some samples; v before them, and the sum of s^T u."""
    kind, which = record.kind[part], gains.which[part]
    v, linear = np.array(v), a is not None
    value = _backward(*record.entries, record.G, record.C, record.D, record.E, kind, gains.K, gains.R, which, y,
                      y[:0] if a is None else a, linear, u, v)  # fmt: skip
    return v, float(value)


def forward(
    record: Record, gains: Gains, part: slice, u: NDArray, x: NDArray, w: NDArray, g: NDArray, r: NDArray
) -> NDArray[np.float64]:
    """Fill inputs, load and response of some samples; the state after them."""
    kind, which = record.kind[part], gains.which[part]
    x = np.array(x)
    _forward(*record.entries, record.G, record.C, record.D, record.E, kind, gains.K, which, u, x, w, g, r)
    return x


@Compiled
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
            for q in range(n):
                total += G[j, q, i] * v[q]
            for q in range(m):
                total += D[j, q, i] * y[k, q]
            s[i] = total
        for i in range(n):
            total = 0.0
            for q in range(m):
                total += C[j, q, i] * y[k, q]
            for q in range(p):
                total -= K[row, q, i] * s[q]
            if linear:
                for q in range(p):
                    total += E[q, i] * a[k, q]
            new[i] = total
        for e in range(entries):
            new[at[1, e]] += F[j, e] * v[at[0, e]]
        for i in range(n):
            v[i] = new[i]
        for i in range(p):  # R^T z = s
            z = s[i]
            for q in range(i):
                z -= R[row, q, i] * u[k, q]
            u[k, i] = z / R[row, i, i]
            value += u[k, i] * u[k, i]
        for i in range(p - 1, -1, -1):  # R u = z
            z = u[k, i]
            for q in range(i + 1, p):
                z -= R[row, i, q] * u[k, q]
            u[k, i] = z / R[row, i, i]
    return value


@Compiled
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
            for q in range(n):
                total -= K[row, i, q] * x[q]
                load += E[i, q] * x[q]
            w[k, i] = total
            g[k, i] = load + total
        for i in range(m):
            total = 0.0
            for q in range(n):
                total += C[j, i, q] * x[q]
            for q in range(p):
                total += D[j, i, q] * w[k, q]
            r[k, i] = total
        for i in range(n):
            total = 0.0
            for q in range(p):
                total += G[j, i, q] * w[k, q]
            new[i] = total
        for e in range(entries):
            new[at[0, e]] += F[j, e] * x[at[1, e]]
        for i in range(n):
            x[i] = new[i]
