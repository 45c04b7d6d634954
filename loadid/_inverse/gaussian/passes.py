"""The two passes of a solve, backward from the data and forward to the loads, in blocks; and how exactly it solved.

    x <- A x + B u,   out = C x + D u

A block of b samples is one row: its outputs are a Toeplitz matrix times its inputs and an observability matrix times
the state at its start. These states advance by A^b, all those of a stretch together in log2 steps (Hillis & Steele,
Commun. ACM 29 (1986) 1170). All is a matrix product, and no temporary is longer than a stretch.

With the `gains` and L g = w,

    backward  s = G^T v + D^T y + a,   u = M^-1 s,   v <- F^T v + C^T y + E^T a - K^T s,
    forward   w = u - K xi,   g = E xi + w,   r = C xi + D w,   xi <- F xi + G w,

where a is a linear term on the load (0 for a plain solve). Where the gains have settled both are filters that do not
change with time, and run as products of blocks of samples (`run_blocks`); the rest goes sample by sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .compiled import Compiled, dot
from .gains import Gains, feedback
from .record import WhitenedRecord
from .roots import Array

STRETCH = 256  # blocks that advance together
SMALLEST, LARGEST = 8, 64  # samples of a block


@dataclass(frozen=True)
class Filter:
    """Matrices of ``x <- A x + B u, out = C x + D u``: (n, n), (n, inputs), (outputs, n), (outputs, inputs)."""

    A: Array
    B: Array
    C: Array
    D: Array


def run_blocks(
    system: Filter, x: Array, inputs: Sequence[Array], outputs: Sequence[Array], backwards: bool = False
) -> Array:
    """Fill the outputs from the state `x` at the first sample, and return the state after the last.

    Parameters
    ----------
    inputs, outputs : sequence of array, each (samples, columns)
        Columns of u and of out, side by side.
    backwards : bool
        From the last sample to the first.
    """
    samples, width = len(inputs[0]), _width(system)
    done = samples // width * width
    parts = (
        (slice(0, done), slice(done, samples))
        if not backwards
        else (slice(samples - done, samples), slice(0, samples - done))
    )
    if done:
        x = _blocks(system, x, [u[parts[0]] for u in inputs], [o[parts[0]] for o in outputs], width, backwards)
    return _rest(system, x, [u[parts[1]] for u in inputs], [o[parts[1]] for o in outputs], backwards)


def _width(system: Filter) -> int:
    """Samples of a block, a power of two: near the least work of the products."""
    n, (outputs, inputs) = len(system.A), system.D.shape
    best = np.log2(max(3.0 * n / np.sqrt(max(inputs * outputs, 1)), 1.0))
    return int(np.clip(2 ** round(best), SMALLEST, LARGEST))


def _blocks(
    system: Filter, x: Array, inputs: Sequence[Array], outputs: Sequence[Array], width: int, backwards: bool
) -> Array:
    """Whole blocks, a stretch of them at a time."""
    n, (outs, ins) = len(x), system.D.shape
    made, pushed, jump = _matrices(system, width, backwards)
    count, order = len(inputs[0]) // width, slice(None, None, -1 if backwards else 1)
    jumps = _jumps(jump, min(STRETCH, count))
    for first in range(0, count, STRETCH):
        size = min(STRETCH, count - first)
        low = (count - first - size if backwards else first) * width
        part = slice(low, low + size * width)
        rows = np.empty((size, width * ins + n))  # inputs of a block, and the state at its start
        fed = rows[:, : width * ins]
        fed.reshape(size, width, ins)[:] = np.concatenate([u[part] for u in inputs], axis=1).reshape(size, width, ins)[
            order
        ]
        rows[:, width * ins :], x = _advance(jumps, x, fed @ pushed)
        found = (rows @ made).reshape(size, width, outs)[order]
        column = 0
        for out in outputs:
            out[part] = found[:, :, column : column + out.shape[1]].reshape(size * width, -1)
            column += out.shape[1]
    return x


def _matrices(system: Filter, width: int, backwards: bool) -> tuple[Array, Array, Array]:
    """From inputs and state of a block to its outputs; from its inputs to the next state; A to the power of a block.

    Samples stand in the order of the record.
    """
    A, B, C, D = system.A, system.B, system.C, system.D
    n, (outs, ins) = len(A), D.shape
    powers = [np.eye(n)]
    for _ in range(width):
        powers.append(A @ powers[-1])
    before = np.stack(powers[:width])
    order = slice(None, None, -1 if backwards else 1)
    toeplitz, answer = np.zeros((width, ins, width, outs)), np.concatenate([D[None], C @ before[:-1] @ B])
    for k in range(width):
        toeplitz[k, :, k:] = answer[: width - k].transpose(2, 0, 1)
    direct = toeplitz[order, :, order].reshape(width * ins, width * outs)
    observe = (C @ before)[order].transpose(2, 0, 1).reshape(n, width * outs)
    reach = (before[::-1] @ B)[order].transpose(0, 2, 1).reshape(width * ins, n)
    return np.vstack([direct, observe]), reach, powers[width]


def _jumps(A: Array, most: int) -> list[Array]:
    """Transposes of A, A^2, A^4, ... for states up to `most` steps apart."""
    out = [A]
    while 1 << len(out) < most:
        out.append(out[-1] @ out[-1])
    return [np.ascontiguousarray(P.T) for P in out]


def _advance(jumps: list[Array], x: Array, pushed: Array) -> tuple[Array, Array]:
    """States (rows, n) before each push, and the one after the last: ``x <- A x + pushed[i]``."""
    pushed[0] += x @ jumps[0]
    for k, jump in enumerate(jumps):
        step = 1 << k
        if step < len(pushed):
            pushed[step:] += pushed[:-step] @ jump
    return np.vstack([x, pushed[:-1]]), pushed[-1]


def _rest(system: Filter, x: Array, inputs: Sequence[Array], outputs: Sequence[Array], backwards: bool) -> Array:
    """The states sample by sample, then all outputs."""
    u = np.concatenate(inputs, axis=1)
    pushed, states = u @ system.B.T, np.empty((len(u), len(x)))
    for k in range(len(u) - 1, -1, -1) if backwards else range(len(u)):
        states[k] = x
        x = system.A @ x + pushed[k]
    found, column = states @ system.C.T + u @ system.D.T, 0
    for out in outputs:
        out[:] = found[:, column : column + out.shape[1]]
        column += out.shape[1]
    return x


def backward_by_samples(
    record: WhitenedRecord, gains: Gains, part: slice, y: Array, a: Array | None, u: Array, v: Array
) -> tuple[Array, float]:
    """Fill u of some samples; v before them, and the sum of s^T u."""
    kind, which = record.kind[part], gains.which[part]
    v, linear = np.array(v), a is not None
    value = _backward(*record.entries, record.G, record.C, record.D, record.E, kind, gains.K, gains.R, which, y,
                      y[:0] if a is None else a, linear, u, v)  # fmt: skip
    return v, float(value)


def forward_by_samples(
    record: WhitenedRecord, gains: Gains, part: slice, u: Array, x: Array, w: Array, g: Array, r: Array
) -> Array:
    """Fill inputs, load and response of some samples; the state after them."""
    kind, which = record.kind[part], gains.which[part]
    x = np.array(x)
    _forward(*record.entries, record.G, record.C, record.D, record.E, kind, gains.K, which, u, x, w, g, r)
    return x


@Compiled
def _backward(
    at: Array, F: Array, G: Array, C: Array, D: Array, E: Array, kind: Array, K: Array, R: Array,
    which: Array, y: Array, a: Array, linear: bool, u: Array, v: Array,
) -> float:  # fmt: skip
    """Fill u and v; F holds its entries at the places `at` (rows, columns) only. The sum of s^T u."""
    n, p, m, entries = G.shape[1], G.shape[2], C.shape[1], at.shape[1]
    s, new, value, Gt = np.empty(p), np.empty(n), 0.0, np.ascontiguousarray(G.transpose(0, 2, 1))
    for k in range(len(kind) - 1, -1, -1):
        j, row = kind[k], which[k]
        for i in range(p):
            s[i] = dot(Gt[j, i], v) + (a[k, i] if linear else 0.0)
            for q in range(m):
                s[i] += D[j, q, i] * y[k, q]
        new[:] = 0.0
        for q in range(m):
            for i in range(n):
                new[i] += y[k, q] * C[j, q, i]
        for q in range(p):
            for i in range(n):
                new[i] -= s[q] * K[row, q, i]
        for q in range(p if linear else 0):
            for i in range(n):
                new[i] += a[k, q] * E[q, i]
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
    at: Array, F: Array, G: Array, C: Array, D: Array, E: Array, kind: Array, K: Array,
    which: Array, u: Array, x: Array, w: Array, g: Array, r: Array,
) -> None:  # fmt: skip
    """Fill inputs, load and response from the state x at the first sample."""
    n, p, m, entries = G.shape[1], G.shape[2], C.shape[1], at.shape[1]
    new, any_load = np.empty(n), bool(np.any(E != 0.0))
    for k in range(len(kind)):
        j, row = kind[k], which[k]
        for i in range(p):
            w[k, i] = u[k, i] - dot(K[row, i], x)
            g[k, i] = dot(E[i], x) + w[k, i] if any_load else w[k, i]
        for i in range(m):
            total = dot(C[j, i], x)
            for q in range(p):
                total += D[j, i, q] * w[k, q]
            r[k, i] = total
        new[:] = 0.0
        for q in range(p):
            for i in range(n):
                new[i] += w[k, q] * G[j, i, q]
        for e in range(entries):
            new[at[0, e]] += F[j, e] * x[at[1, e]]
        for i in range(n):
            x[i] = new[i]


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

    inputs: Array
    load: Array
    response: Array
    start: Array
    value: float


def solve(record: WhitenedRecord, gains: Gains, y: Array | None = None, a: Array | None = None) -> Solved:
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


def refined(record: WhitenedRecord, gains: Gains, first: Solved) -> Solved:
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


def backward(
    record: WhitenedRecord, gains: Gains, y: Array, a: Array | None, last: Array | None = None
) -> tuple[Array, Array, float]:
    """Drive u (samples, p), v at the first sample, and the sum of s^T u; `last` is v after the last sample."""
    y, a = np.ascontiguousarray(y, float), None if a is None else np.ascontiguousarray(a, float)
    u, v, value = np.empty((record.samples, record.p)), np.zeros(record.n) if last is None else last, 0.0
    for first, length, steady in reversed(runs(record, gains)):
        part = slice(first, first + length)
        data = y[part], None if a is None else a[part]
        if steady:
            v = _backward_steady(record, gains, first, *data, u[part], v)
            value += _to_inputs(gains.R[gains.which[first]], u[part])
        else:
            v, more = backward_by_samples(record, gains, part, *data, u[part], v)
            value += more
    return u, v, value


def forward(record: WhitenedRecord, gains: Gains, u: Array, start: Array) -> tuple[Array, Array, Array]:
    """Inputs, load and response, (samples, p), (samples, p), (samples, m)."""
    w, r, x = np.empty_like(u), np.empty((record.samples, record.m)), np.array(start, float)
    assert x.shape == (record.n,), f"a start of shape {x.shape} for {record.n} states"
    g = np.empty_like(u) if record.E.any() else w
    for first, length, steady in runs(record, gains):
        part = slice(first, first + length)
        walk = _forward_steady if steady else forward_by_samples
        x = walk(record, gains, part, u[part], x, w[part], g[part], r[part])
    return w, g, r


def without_sensors(record: WhitenedRecord) -> WhitenedRecord:
    """The record for passes that get no data and whose response nobody asks for."""
    return replace(record, C=record.C[:, :0], D=record.D[:, :0], y=record.y[:, :0])


def runs(record: WhitenedRecord, gains: Gains) -> list[tuple[int, int, bool]]:
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
    record: WhitenedRecord, gains: Gains, first: int, y: Array, a: Array | None, s: Array, v: Array
) -> Array:
    """Fill s of a run, and return v before it."""
    j, K = record.kind[first], gains.K[gains.which[first]]
    F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
    into, feed, inputs = (C - D @ K).T, D.T, [y]
    if a is not None:
        into, feed, inputs = np.hstack([into, (E - K).T]), np.hstack([feed, np.eye(record.p)]), [y, a]
    return run_blocks(Filter((F - G @ K).T, into, G.T, feed), v, inputs, [s], backwards=True)


def _to_inputs(R: Array, s: Array) -> float:
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
    record: WhitenedRecord, gains: Gains, part: slice, u: Array, x: Array, w: Array, g: Array, r: Array
) -> Array:
    """Fill inputs, load and response of a run, and return the state after it."""
    j, K, p = record.kind[part.start], gains.K[gains.which[part.start]], record.p
    F, G, C, D, E = record.F[j], record.G[j], record.C[j], record.D[j], record.E
    seen, fed, outputs = [-K, C - D @ K], [np.eye(p), D], [w, r]
    if g is not w and E.any():
        seen, fed, outputs = [*seen, E - K], [*fed, np.eye(p)], [*outputs, g]
    return run_blocks(Filter(F - G @ K, G, np.vstack(seen), np.vstack(fed)), x, [u], outputs)


def gradient(record: WhitenedRecord, lam: float, solved: Solved) -> float:
    """Norm of ``H^T (H g - y) + lam^2 L^T L g`` over that of ``H^T y``, by inputs and free states."""
    still, free = feedback(record), record.free
    rest, start, _ = backward(record, still, solved.response - record.y, None)
    whole, first, _ = backward(record, still, record.y, None)
    rest += lam**2 * solved.inputs
    size = np.hypot(np.linalg.norm(whole), np.linalg.norm(first[free]))
    return float(np.hypot(np.linalg.norm(rest), np.linalg.norm(start[free])) / max(size, np.finfo(float).tiny))
