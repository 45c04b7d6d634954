"""The two passes of a solve: backward from the data to what drives the inputs, forward to inputs, loads and responses.

With the gains of `riccati` and L g = w,

    backward  s = G^T v + D^T y + a,   u = M^-1 s,   v <- F^T v + C^T y + E^T a - K^T s,
    forward   w = u - K xi,   g = E xi + w,   r = C xi + D w,   xi <- F xi + G w,

where a is a linear term on the load (0 for a plain solve). Where the gains have settled both are filters that do not
change with time, and run as products of blocks of samples (`blocks`); the rest goes sample by sample (`loops`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from . import blocks, loops
from .record import Record
from .riccati import Gains

STEADY = 4096  # samples with one gain from which blocks pay
PART = 1 << 14  # samples of a temporary


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


def refined(record: Record, gains: Gains, first: Solved) -> Solved:
    """A solve corrected by the solve of what it leaves, ``min |y - r - H d|^2 + lam^2 |w + L d|^2``.

    The two passes work with products of the operator, as normal equations do; the correction gives back the digits that
    this costs at a small lambda. Bjorck, Numerical Methods for Least Squares Problems, SIAM 1996, sec. 2.9.
    """
    blind = replace(record, E=np.zeros_like(record.E))  # a linear term on the inputs alone
    u, v, _ = backward(blind, gains, record.y - first.response, -(gains.lam**2) * first.inputs)
    start = np.zeros(record.n)
    if len(record.free):
        start[record.free] = gains.start @ (gains.start.T @ v[record.free])
    w, g, response = forward(record, gains, u, start)
    return Solved(first.inputs + w, first.load + g, first.response + response, first.start + start, first.value)


def backward(record: Record, gains: Gains, y: NDArray, a: NDArray | None) -> tuple[NDArray, NDArray, float]:
    """Drive u (samples, p), v at the first sample, and the sum of s^T u."""
    y, a = np.ascontiguousarray(y, float), None if a is None else np.ascontiguousarray(a, float)
    u, v, value = np.empty((record.samples, record.p)), np.zeros(record.n), 0.0
    for first, length, steady in reversed(runs(record, gains)):
        part = slice(first, first + length)
        data = y[part], None if a is None else a[part]
        if steady:
            v = _backward_steady(record, gains, first, *data, u[part], v)
            value += _to_inputs(gains.R[gains.which[first]], u[part])
        else:
            v, more = loops.backward(record, gains, part, *data, u[part], v)
            value += more
    return u, v, value


def forward(record: Record, gains: Gains, u: NDArray, start: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """Inputs, load and response, (samples, p), (samples, p), (samples, m)."""
    w, r, x = np.empty_like(u), np.empty((record.samples, record.m)), np.array(start, float)
    g = np.empty_like(u) if record.E.any() else w
    for first, length, steady in runs(record, gains):
        part = slice(first, first + length)
        walk = _forward_steady if steady else loops.forward
        x = walk(record, gains, part, u[part], x, w[part], g[part], r[part])
    return w, g, r


def runs(record: Record, gains: Gains) -> list[tuple[int, int, bool]]:
    """First sample, length, and whether all of it has the same matrices and gains: long runs, and what lies between."""
    if record.samples < STEADY:
        return [(0, record.samples, False)]
    which, kind = gains.which, record.kind
    changes = np.flatnonzero((which[1:] != which[:-1]) | (kind[1:] != kind[:-1])) + 1
    edges = np.concatenate([[0], changes, [record.samples]])
    long = np.flatnonzero(np.diff(edges) >= STEADY)
    out, at = [], 0
    for first, end in zip(edges[long].tolist(), edges[long + 1].tolist(), strict=True):
        if first > at:
            out.append((at, first - at, False))
        out.append((first, end - first, True))
        at = end
    if at < record.samples:
        out.append((at, record.samples - at, False))
    return out


def _backward_steady(
    record: Record, gains: Gains, first: int, y: NDArray, a: NDArray | None, s: NDArray, v: NDArray
) -> NDArray[np.float64]:
    """Fill s of a run, and return v before it."""
    j, K = record.kind[first], gains.K[gains.which[first]]
    F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
    into, feed, inputs = (C - D @ K).T, D.T, [y]
    if a is not None:
        into, feed, inputs = np.hstack([into, (E - K).T]), np.hstack([feed, np.eye(record.p)]), [y, a]
    return blocks.run(blocks.Filter((F - G @ K).T, into, G.T, feed), v, inputs, [s], backwards=True)


def _to_inputs(R: NDArray, s: NDArray) -> float:
    """Overwrite s (samples, p) by u = M^-1 s; the sum of s^T u."""
    from scipy.linalg import solve_triangular

    value = 0.0
    for k in range(0, len(s), PART):
        part = s[k : k + PART]
        z = part.T / R[0, 0] if len(R) == 1 else solve_triangular(R, part.T, trans="T")
        value += float(np.vdot(z, z))
        part[:] = (z / R[0, 0] if len(R) == 1 else solve_triangular(R, z)).T
    return value


def _forward_steady(
    record: Record, gains: Gains, part: slice, u: NDArray, x: NDArray, w: NDArray, g: NDArray, r: NDArray
) -> NDArray[np.float64]:
    """Fill inputs, load and response of a run, and return the state after it."""
    j, K, p = record.kind[part.start], gains.K[gains.which[part.start]], record.p
    F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
    seen, fed, outputs = [-K, C - D @ K], [np.eye(p), D], [w, r]
    if g is not w and E.any():
        seen, fed, outputs = [*seen, E - K], [*fed, np.eye(p)], [*outputs, g]
    return blocks.run(blocks.Filter(F - G @ K, G, np.vstack(seen), np.vstack(fed)), x, [u], outputs)
