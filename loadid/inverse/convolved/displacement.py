"""Diagonals of the posterior covariance from a few solves: its displacement rank is small.

With A = H^T H + lambda^2 L^T L and B = A^-1, the difference between A and A shifted by one sample has the rank of the
sensors and of the stencils at the two ends, and that of B is not larger. So each diagonal of B, and of L B L^T, is a
running sum of products of a few columns, each one solve: variances of all samples and the trace of the influence
matrix come exactly, without probes. Kailath & Sayed, SIAM Review 37 (1995) 297 (displacement structure); the recursion
follows from block inversion and Woodbury's formula. Where data are missing, each edge of a gap adds a solve.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..penalties import stencil
from .circulant import Circulant
from .operator import Operator
from .pcg import Reached, Sides, solve

TOLERANCE = 1e-13  # of the columns: the differences of their products lose digits
SWEPT, MANY = 12, 24  # columns beyond which probes cost less: at each node of a path, and at one lambda
SHORTEST = 2048  # samples of the first record that is tried in place of a long one
FLAT = 1e-6  # relative change of a plateau over a quarter of the record


@dataclass(frozen=True)
class Diagonals:
    """What the columns give at one lambda; times sigma^2 for a covariance.

    Parameters
    ----------
    variance : array, shape (loads, samples)
        Diagonal of B.
    rough : array, shape (loads, samples - order)
        Diagonal of ``lambda^2 L B L^T``, between 0 and 1: the share of each row of the penalty that is prior.
    mismatch : float
        Largest relative difference, in the middle of the record, between the sums from its start and from its end.
    """

    variance: NDArray[np.float64]
    rough: NDArray[np.float64]
    mismatch: float


@dataclass(frozen=True)
class Generators:
    """Vectors v with ``A - shifted A = sum sign v v^T``, (r, loads, samples), and the right sides of all columns.

    Order: last row of the penalty, the row that has half left the record at its start, edges of the data. Before them,
    among the right sides, stand unit vectors of the first and of the last sample.
    """

    operator: Operator
    falls: list[tuple[int, int, float]]
    v: NDArray[np.float64]
    sign: NDArray[np.float64]
    sides: Sides

    def complement(self, reached: Reached, f: NDArray) -> NDArray[np.float64]:
        """``diag(sign) - v^T B v``; where that is small, from the residuals of the solves, which have its digits."""
        p = self.operator.loads
        x, out = reached.x[2 * p :], np.diag(self.sign)
        ends = len(self.sign) - len(self.falls)
        if ends:
            out[:p] = reached.q[2 * p :, :, -1].T
            out[p:ends] -= np.einsum("rin,cin->rc", self.v[p:ends], x)
        for k, (t, s, fall) in enumerate(self.falls, ends):
            weight = 1.0 if self.operator.weight is None else float(self.operator.weight[s, t])
            if not weight:
                out[k] -= np.einsum("in,cin->c", self.v[k], x)
                continue
            share = np.sqrt(abs(fall)) / weight  # H x at this datum is y minus the residual
            out[k, k] -= share**2
            out[k] += share * reached.r[2 * p :, s, t]
        return out


def edges(operator: Operator) -> list[tuple[int, int, float]]:
    """(Sample, sensor, fall) wherever the squared weight of the data falls or rises after a sample; the end counts."""
    w2 = np.ones((operator.sensors, operator.samples)) if operator.weight is None else operator.weight**2
    fall = w2 - np.pad(w2[:, 1:], ((0, 0), (0, 1)))
    return [(int(t), int(s), float(fall[s, t])) for s, t in np.argwhere(np.abs(fall) > 1e-14 * w2.max())]


def columns(operator: Operator) -> int:
    """Number of solves that `diagonals` takes."""
    return len(edges(operator)) + (2 + min(operator.order, 2)) * operator.loads


def diagonals(operator: Operator, circulant: Circulant, tolerance: float = TOLERANCE) -> Diagonals:
    """Diagonals of B and of the roughness covariance at the lambda of the preconditioner."""
    p, N, o = operator.loads, operator.samples, operator.order
    made = _generators(operator, circulant.lam)
    reached = solve(operator, circulant, made.sides, tolerance)
    x = reached.x
    f = -reached.q if made.sides.c is None else made.sides.c - reached.q  # lam L x, without cancellation
    first, last, X = slice(0, p), slice(p, 2 * p), slice(2 * p, None)
    corner, end = x[first, :, 0].T, x[last, :, -1].T  # B at the first and at the last sample, (loads, loads)
    take = _left(end, x[X, :, -1].T).T  # (r, loads): multiples of the last columns that make the last sample zero
    Q = x[X] - np.tensordot(take, x[last], 1)
    inner = made.complement(reached, f) + x[X, :, -1] @ _left(end, x[X, :, -1].T)
    inner = 0.5 * (inner + inner.T)

    def steps(y: NDArray, w: NDArray, q: NDArray) -> NDArray:
        """Differences of neighbouring diagonal entries, (loads, entries - 1)."""
        return (
            _products(y[..., 1:], _left(corner, y[..., 1:]))
            - _products(w[..., :-1], _left(end, w[..., :-1]))
            + _products(q[..., :-1], _left(inner, q[..., :-1]))
        )

    change, half = steps(x[first], x[last], Q), N // 2
    forward = np.diag(corner)[:, None] + np.cumsum(np.pad(change, ((0, 0), (1, 0))), axis=1)
    backward = _from_end(np.diag(end), change)
    mismatch = float(np.max(np.abs(forward[:, half] / backward[:, half] - 1)))
    variance = np.concatenate([forward[:, :half], backward[:, half:]], axis=1)
    if o == 0:
        return Diagonals(variance, circulant.lam**2 * variance, mismatch)
    rows = steps(f[first], f[last], f[X] - np.tensordot(take, f[last], 1))
    tail = np.diagonal(f[2 * p : 3 * p, :, -1])  # of the last row of the penalty
    return Diagonals(variance, _from_end(tail, rows), mismatch)


def profile(operator: Operator, lam: float, tolerance: float = TOLERANCE) -> Diagonals:
    """`diagonals` of a record of any length: beyond the memory of the problem they do not change along the record.

    Records of 2048, 8192, ... samples are tried; where both diagonals are level over the middle quarter of one, what
    lies before and after its middle is taken for the ends, and the level for all between. Data with weights, and
    problems that remember the whole record, are solved whole.
    """
    samples = SHORTEST
    while operator.weight is None and 2 * samples <= operator.samples:
        short = operator.cut(samples)
        found = diagonals(short, Circulant(short, lam), tolerance)
        if _level(found.variance) and _level(1.0 - found.rough):
            more = operator.samples - samples
            return Diagonals(_stretched(found.variance, more), _stretched(found.rough, more), found.mismatch)
        samples *= 4
    return diagonals(operator, Circulant(operator, lam), tolerance)


def _level(x: NDArray) -> bool:
    """Whether x (loads, n) is level over its middle quarter."""
    n = x.shape[1]
    part = x[:, 3 * n // 8 : 5 * n // 8]
    return bool(np.all(np.ptp(part, axis=1) <= FLAT * np.abs(part).min(axis=1)))


def _stretched(x: NDArray, more: int) -> NDArray[np.float64]:
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], np.repeat(x[:, half : half + 1], more, axis=1), x[:, half:]], axis=1)


def _from_end(last: NDArray, change: NDArray) -> NDArray[np.float64]:
    """Entries with these differences that end at `last`."""
    later = np.cumsum(change[:, ::-1], axis=1)[:, ::-1]
    return last[:, None] - np.pad(later, ((0, 0), (0, 1)))


def _left(matrix: NDArray, columns: NDArray) -> NDArray[np.float64]:
    """Solve with a small matrix along the first axis of the columns."""
    flat = np.linalg.solve(matrix, columns.reshape(len(columns), -1))
    return flat.reshape(columns.shape)


def _products(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    return np.einsum("cin,cin->in", a, b)


def _generators(operator: Operator, lam: float) -> Generators:
    """Generators at an absolute lambda."""
    p, N, o, m = operator.loads, operator.samples, operator.order, operator.sensors
    falls, difference = edges(operator), stencil(operator.order)
    ends = 2 * p if o else 0
    r = ends + len(falls)
    v, sign = np.zeros((r, p, N)), np.ones(r)
    b, c, y = np.zeros((2 * p + r, p, N)), np.zeros((2 * p + r, p, N - o)), np.zeros((2 * p + r, m, N))
    each = np.arange(p)
    b[each, each, 0] = b[p + each, each, -1] = 1.0
    if o:
        for k in each:
            v[k, k, N - 1 - o :] = lam * difference
            v[p + k, k, :o] = lam * difference[1:]
            c[2 * p + k, k, -1] = 1.0
            b[3 * p + k, k, :o] = lam * difference[1:]
        sign[p : 2 * p] = -1.0
    taps = operator.h.shape[-1]
    for row, (t, s, fall) in enumerate(falls, ends):
        size, reach = np.sqrt(abs(fall)), min(t + 1, taps)
        v[row, :, t + 1 - reach : t + 1] = size * operator.h[s, :, reach - 1 :: -1]
        sign[row] = np.sign(fall)
        weight = 1.0 if operator.weight is None else operator.weight[s, t]
        if weight:
            y[2 * p + row, s, t] = size / weight
        else:
            b[2 * p + row] = v[row]
    return Generators(operator, falls, v, sign, Sides(y, c, b))
