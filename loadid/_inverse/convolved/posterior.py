"""Posterior behind a convolution: variances by displacement rank or probes, weighted sums, scalars of the path.

With A = H^T H + lambda^2 L^T L and B = A^-1, the difference between A and A shifted by one sample has the rank of the
sensors and of the stencils at the two ends, and that of B is not larger. So each diagonal of B, and of L B L^T, is a
running sum of products of a few columns, each one solve: variances of all samples and the trace of the influence
matrix come exactly, without probes. Kailath & Sayed, SIAM Review 37 (1995) 297 (displacement structure); the recursion
follows from block inversion and Woodbury's formula. Where data are missing, each edge of a gap adds a solve.

Traces by random signs (Hutchinson, Commun. Stat. Simul. Comput. 19 (1990) 433), the same at each lambda; the diagonal
of B by combs of random signs, which see each sample once and mistake only what is correlated over the distance between
their teeth (Tang & Saad, Numer. Linear Algebra Appl. 19 (2012) 485).

With f the filter factors, g_1 the solution and ``g_{k+1}`` what the same lambda makes of ``lambda^2 L^T L g_k``:
``dg_k/dt = (k - 1) g_k - k g_{k+1}`` in t = ln lambda^2, since df/dt = -f (1 - f). So three solves give every scalar of
the path with two derivatives or more, and a wide grid of lambdas is enough.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ..convolution import PenalizedConvolution
from ..penalties import stencil
from .pcg import Circulant, Reached, Sides, solve

Array = NDArray[np.float64]
Index = NDArray[np.int_]

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

    variance: Array
    rough: Array
    mismatch: float


@dataclass(frozen=True)
class Generators:
    """Vectors v with ``A - shifted A = sum sign v v^T``, (r, loads, samples), and the right sides of all columns.

    Order: last row of the penalty, the row that has half left the record at its start, edges of the data. Before them,
    among the right sides, stand unit vectors of the first and of the last sample.
    """

    operator: PenalizedConvolution
    falls: list[tuple[int, int, float]]
    v: Array
    sign: Array
    sides: Sides

    def complement(self, reached: Reached, f: Array) -> Array:
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


def edges(operator: PenalizedConvolution) -> list[tuple[int, int, float]]:
    """(Sample, sensor, fall) wherever the squared weight of the data falls or rises after a sample; the end counts."""
    w2 = np.ones((operator.sensors, operator.samples)) if operator.weight is None else operator.weight**2
    fall = w2 - np.pad(w2[:, 1:], ((0, 0), (0, 1)))
    return [(int(t), int(s), float(fall[s, t])) for s, t in np.argwhere(np.abs(fall) > 1e-14 * w2.max())]


def columns(operator: PenalizedConvolution) -> int:
    """Number of solves that `diagonals` takes."""
    return int(len(edges(operator)) + (2 + min(operator.order, 2)) * operator.loads)


def diagonals(operator: PenalizedConvolution, circulant: Circulant, tolerance: float = TOLERANCE) -> Diagonals:
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

    def steps(y: Array, w: Array, q: Array) -> Array:
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


def profile(operator: PenalizedConvolution, lam: float, tolerance: float = TOLERANCE) -> Diagonals:
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


def _level(x: Array) -> bool:
    """Whether x (loads, n) is level over its middle quarter."""
    n = x.shape[1]
    part = x[:, 3 * n // 8 : 5 * n // 8]
    return bool(np.all(np.ptp(part, axis=1) <= FLAT * np.abs(part).min(axis=1)))


def _stretched(x: Array, more: int) -> Array:
    half = x.shape[1] // 2
    return np.concatenate([x[:, :half], np.repeat(x[:, half : half + 1], more, axis=1), x[:, half:]], axis=1)


def _from_end(last: Array, change: Array) -> Array:
    """Entries with these differences that end at `last`."""
    later = np.cumsum(change[:, ::-1], axis=1)[:, ::-1]
    return last[:, None] - np.pad(later, ((0, 0), (0, 1)))


def _left(matrix: Array, columns: Array) -> Array:
    """Solve with a small matrix along the first axis of the columns."""
    flat: Array = np.asarray(np.linalg.solve(matrix, columns.reshape(len(columns), -1)))
    return flat.reshape(columns.shape)


def _products(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("cin,cin->in", a, b))


def _generators(operator: PenalizedConvolution, lam: float) -> Generators:
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


NUMBERS = 1 << 16  # random signs in all probes of a trace
FEWEST, MOST = 2, 32
TEETH = 64  # samples between the teeth of a comb
AT_ONCE = 16


def traces(operator: PenalizedConvolution, lam: float, tolerance: float) -> tuple[float, float, float]:
    """Part of the degrees of freedom that the penalty governs, the rest of the governed modes, and the trace of B.

    Signs on the rows of the penalty: part and rest are positive and add up to the number of rows, whatever the probes.
    The relative standard error of the part is about ``sqrt(2 / (probes * part))``.
    """
    rng = np.random.default_rng(0)
    p, N, o = operator.loads, operator.samples, operator.order
    count = int(np.clip(NUMBERS // (N * p), FEWEST, MOST))
    z, w = rng.choice([-1.0, 1.0], (count, p, N - o)), rng.choice([-1.0, 1.0], (count, p, N))
    none_z, none_w = np.zeros_like(z), np.zeros_like(w)
    sides = Sides(c=np.concatenate([z, none_z]), b=np.concatenate([none_w, w]))
    found = solve(operator, Circulant(operator, lam), sides, tolerance)
    part = float(np.sum(z * found.q[:count])) / count  # q = z - lam L x
    return part, float(z[0].size) - part, float(np.sum(w * found.x[count:])) / count


def variances(operator: PenalizedConvolution, lam: float) -> Array:
    """Diagonal of B, (loads, samples), by one comb for each load and each of `TEETH` places."""
    rng = np.random.default_rng(0)
    p, N = operator.loads, operator.samples
    sign, out = rng.choice([-1.0, 1.0], (p, N)), np.empty((p, N))
    circulant, teeth = Circulant(operator, lam), min(TEETH, N)
    combs = [(j, k) for j in range(p) for k in range(teeth)]
    for start in range(0, len(combs), AT_ONCE):
        some = combs[start : start + AT_ONCE]
        b = np.zeros((len(some), p, N))
        for i, (j, k) in enumerate(some):
            b[i, j, k::teeth] = sign[j, k::teeth]
        x = solve(operator, circulant, Sides(b=b), 1e-6).x
        for i, (j, k) in enumerate(some):
            out[j, k::teeth] = x[i, j, k::teeth] * sign[j, k::teeth]
    return np.maximum(out, 1e-3 * np.median(out))


@dataclass(frozen=True)
class Moments:
    """Sums over the modes, each of shape (k,) for k right sides y; beta are the coefficients of y.

    Parameters
    ----------
    rest : array, shape (2 * SOLVES, k)
        ``sum (1 - f)^j beta^2`` for j = 1, 2, ...: objective, squared residual, and what follows in the derivatives.
    drop : array, shape (2 * SOLVES, k)
        ``sum f (1 - f)^j beta^2`` for j = 0, 1, ...: differences of neighbours of `rest`, without cancellation.
    change2, change_slope : array
        ``|g_2|^2``, where g_2 = -dg/dt, and its derivative in t.
    residual, residual_slope : array, shape (k, sensors, samples)
        ``y - H g_1`` and its derivative in t.
    """

    rest: Array
    drop: Array
    change2: Array
    change_slope: Array
    residual: Array
    residual_slope: Array


SOLVES = 3  # of a chain: they give every scalar of the path with two derivatives or more


def chain(
    operator: PenalizedConvolution, circulant: Circulant, y: Array, tolerance: float, takeover: bool = True,
) -> tuple[list[Array], list[Array], list[Array]]:  # fmt: skip
    """g_1, g_2, ... for data y (k, sensors, samples), with their responses H g_j and roughnesses lambda L g_j."""
    loads, responses, roughs = [], [], []
    sides = Sides(y=y)
    for _ in range(SOLVES):
        found = solve(operator, circulant, sides, tolerance, takeover=takeover)
        rough = -found.q if sides.c is None else sides.c - found.q
        loads.append(found.x)
        responses.append((sides.y - found.r) if sides.y is not None else -found.r)
        roughs.append(rough)
        sides = Sides(c=rough)
    return loads, responses, roughs


def moments(y: Array, loads: list[Array], responses: list[Array], roughs: list[Array]) -> Moments:
    """Moments of data y (k, sensors, samples) from a `chain`."""
    rests = [y]
    for response in responses:
        rests.append(rests[-1] - response)
    rest, drop = [], [_dot(y, responses[0])]
    for k in range(1, SOLVES + 1):
        size = _dot(rests[k], rests[k])
        rest += [size + _dot(roughs[0], roughs[0]) if k == 1 else _dot(rests[k - 1], rests[k]), size]
        drop += [_dot(roughs[k - 1], roughs[k - 1])]
        if k < SOLVES:
            drop += [_dot(roughs[k - 1], roughs[k])]
    slope = 2 * (_dot(loads[1], loads[1]) - 2 * _dot(loads[1], loads[2]))
    return Moments(
        np.array(rest), np.array(drop), _dot(loads[1], loads[1]), slope, rests[1], responses[1],
    )  # fmt: skip


def slopes(drop: Array) -> list[Array]:
    """Each entry j of `drop` with the derivatives in t that those after it give: D_j' = j D_j - (j + 1) D_{j+1}."""
    table = [np.asarray(drop, float)]
    while len(table[-1]) > 1:
        last = table[-1]
        j = np.arange(len(last) - 1)
        table.append(j * last[:-1] - (j + 1) * last[1:])
    return [np.array([row[j] for row in table if j < len(row)]) for j in range(len(drop))]


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("kij,kij->k", a, b))


SLOPE = 1e-2  # step in ln lambda^2 for a derivative of fourth order


class ConvolvedPosterior:
    """Covariance ``sigma^2 (H^T H + lam^2 L^T L)^-1`` of a load history, never formed.

    `std` is exact to the tolerance of some solves, at both ends and between (`profile`); with many gaps in
    the data it is estimated, to some per cent where loads 64 samples apart are no longer correlated (`variances`).
    `noise_std` is its derivative in lambda by differences, good to about 1e-6; `variance`, `noise_variance` and
    `bias_weights` take one solve for each weighted sum.

    Parameters
    ----------
    operator : PenalizedConvolution
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data.
    """

    kind = "convolved"

    def __init__(self, operator: PenalizedConvolution, lam: float, sigma: float) -> None:
        if not (np.isfinite(sigma) and sigma >= 0):
            raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number >= 0")
        self.operator, self.lam, self.sigma = operator, float(lam), float(sigma)
        self.shape = (operator.samples, operator.loads)

    @cached_property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        return self.sigma * np.sqrt(np.maximum(self._variances(self.lam), 0.0))

    @cached_property
    def noise_std(self) -> Array:
        """Standard deviation from the noise alone: B H^T H B is the derivative of lam^2 B in lam^2."""
        steps = np.exp(0.5 * SLOPE * np.array([-2, -1, 1, 2]))
        parts = [x**2 * self._variances(self.lam * x) for x in steps]
        slope = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12 * SLOPE)
        return np.asarray(self.sigma * np.sqrt(np.maximum(slope, 0.0)))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        found, stacked, w = self._solve(w)
        value = self.sigma**2 * np.einsum("kij,kij->k", found.x, w)
        return np.asarray(value if stacked else value[0])

    def noise_variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)`` from the noise alone."""
        found, stacked, _ = self._solve(w)
        value = self.sigma**2 * np.einsum("kij,kij->k", found.r, found.r)
        return np.asarray(value if stacked else value[0])

    def bias_weights(self, w: Array) -> Array:
        """``(R - I)^T w`` in the shape of `w`: what regularisation takes from the weights, -lam^2 L^T L B w."""
        found, stacked, _ = self._solve(w)
        lost = np.swapaxes(self.lam * self.operator.rough_adjoint(found.q), 1, 2)  # q = -lam L B w
        return lost if stacked else lost[0]

    def to_arrays(self) -> dict[str, Any]:
        """Plain arrays, for a result file."""
        o = self.operator
        tree: dict[str, Any] = {
            "kind": self.kind, "h": o.responses, "samples": o.samples, "penalty": o.penalty,
            "lam": self.lam, "sigma": self.sigma,
        }  # fmt: skip
        return tree if o.weights is None else tree | {"weight": o.weights}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> ConvolvedPosterior:
        """From what `to_arrays` gave."""
        weight = None if tree.get("weight") is None else np.asarray(tree["weight"], float)
        operator = PenalizedConvolution(
            np.asarray(tree["h"], float), int(tree["samples"]), str(tree["penalty"]), weight
        )
        return cls(operator, float(tree["lam"]), float(tree["sigma"]))

    # -- inside -------------------------------------------------------------------------------------------------------
    def _variances(self, lam: float) -> Array:
        if columns(self.operator) > MANY:
            return np.ascontiguousarray(variances(self.operator, lam).T)
        return np.ascontiguousarray(profile(self.operator, lam).variance.T)

    def _solve(self, w: Array) -> tuple[Reached, bool, Array]:
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim not in (2, 3):
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        b = np.ascontiguousarray(np.swapaxes(w.reshape(-1, *self.shape), 1, 2))
        return solve(self.operator, Circulant(self.operator, self.lam), Sides(b=b)), w.ndim == 3, b
