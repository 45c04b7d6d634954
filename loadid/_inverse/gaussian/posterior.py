"""Posterior of a load history over a state space: variances by recursion, weighted sums, combinations g = T u.

    Var(g_k) = (E - K) X (E - K)^T + M^-1,      X <- (F - G K) X (F - G K)^T + G M^-1 G^T,

in units of the noise variance. X starts at 0, and at the inverse of P_0 in the free states. Where gains and covariance
have settled the rest of a run is counted, not computed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from structures.errors import InputError

from ..posterior import DensePosterior, Posterior, SpectralPosterior, from_arrays
from .compiled import (
    KEPT,
    Compiled,
    begin,
    largest,
    multiply,
    multiply_by_transposed,
    scale,
    settled,
    solve_upper,
    subtract,
)
from .gains import Gains, feedback, gains
from .passes import Solved, backward, forward, solve, without_sensors
from .record import WhitenedRecord
from .roots import Array


@dataclass(frozen=True)
class LoadVariances:
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

    variance: Array | None
    trace: float
    penalty: float


def variances(
    record: WhitenedRecord, gains: Gains, every_sample: bool = True, combined: Array | None = None
) -> LoadVariances:
    """Variances of every sample, or their sum alone; of the loads, or of combinations (any, p) of those of a sample."""
    read = np.eye(record.p) if combined is None else np.ascontiguousarray(combined, float)
    if _is_cheap(record, gains):
        return _displaced(record, gains, every_sample, read)
    X = np.zeros((record.n, record.n))
    if len(record.free):
        X[np.ix_(record.free, record.free)] = gains.start @ gains.start.T
    variance = np.empty((record.samples if every_sample else 1, len(read)))
    trace, penalty = _recursion(
        *record.entries, record.F, record.G, record.E, read, record.kind, gains.K, gains.R, gains.which, X, variance,
        every_sample, record.stride,
    )  # fmt: skip
    return LoadVariances(variance if every_sample else None, float(trace), float(gains.lam**2 * penalty))


def _is_cheap(record: WhitenedRecord, gains: Gains) -> bool:
    """Whether the passes of `_displaced` cost less than the recursion; they need one kind of sample."""
    passes = 2 * record.m + record.p + len(record.free)
    fewer = passes < record.n and record.samples * passes < 4 * len(gains.K) * record.n  # measured
    return fewer and record.samples > 1 and bool(np.all(record.kind == record.kind[0]))


def _displaced(record: WhitenedRecord, gains: Gains, every_sample: bool, read: Array) -> LoadVariances:
    """Variances of a record whose samples are all of one kind, by some passes.

    With W the covariance of the inputs from a known start and Z the shift by a sample, W - Z W Z^T is a sum of p + m
    squares (`columns`), and the variances are running sums of these; loads are filtered inputs, with which Z commutes.
    Kailath, Kung & Morf, J. Math. Anal. Appl. 68 (1979) 395, for the displacement of an inverse.
    """
    trace, penalty, variance = 0.0, 0.0, np.zeros((record.samples if every_sample else 1, len(read)))
    for inputs, load, _, stays in columns(record, gains, heard=False):
        square, times = (load @ read.T) ** 2, np.arange(len(load), 0, -1.0)[:, None] if stays else 1.0
        trace += float(np.sum(times * square))
        penalty += float(np.sum(times * inputs**2))
        if every_sample:
            variance[record.samples - len(load) :] += np.cumsum(square, axis=0) if stays else square
    return LoadVariances(variance if every_sample else None, trace, float(gains.lam**2 * penalty))


def columns(record: WhitenedRecord, gains: Gains, *, heard: bool = True) -> Iterator[tuple[Array, Array, Array, bool]]:
    """Inputs, loads and responses whose squares make the variances, up to the last sample; whether they stay in later.

    The closed loop's response to the first input; what one more datum at the end would have told of the inputs before
    it; and, for its own sample alone, the response to what is not known of the start. Where they are not `heard`, the
    responses have no columns, and a pass costs half.
    """
    from scipy.linalg import solve_triangular

    n, p, m, still = record.n, record.p, record.m, np.zeros((record.samples, record.p))
    C, D, silent = record.C[record.kind[0]], record.D[record.kind[0]], without_sensors(record)
    record = record if heard else silent
    for first in np.linalg.solve(gains.R[gains.which[0]], np.eye(p)).T:
        yield *forward(record, gains, np.vstack([first, still[1:]]), np.zeros(n)), True
    short, fewer = replace(record, kind=record.kind[1:], y=record.y[1:]), replace(gains, which=gains.which[1:])
    alone = replace(silent, kind=short.kind, y=silent.y[1:])
    told = np.array([backward(alone, fewer, alone.y, None, last)[0] for last in C])
    scaled = np.einsum("kab,ikb->ika", gains.R[fewer.which], told, optimize=True).reshape(m, -1)
    root = np.linalg.qr(np.vstack([np.eye(m), D.T / gains.lam, scaled.T]), mode="r")  # of the datum's own variance
    for drive in solve_triangular(root, told.reshape(m, -1), trans="T").reshape(told.shape):
        yield *forward(short, fewer, drive, np.zeros(n)), True
    for start in gains.start.T:
        state = np.zeros(n)
        state[record.free] = start
        yield *forward(record, gains, still, state), False


@Compiled
def _closed_times(at: Array, entries: Array, G: Array, K: Array, X: Array, fed: Array, turned: Array) -> None:
    """Put ``X^T (F - G K)^T`` into `turned`, F by its entries, few in modal form; `fed` is for K X."""
    n, p = X.shape[0], G.shape[1]
    for i in range(n):
        for h in range(n):
            turned[i, h] = 0.0
    for e in range(len(entries)):
        one, to, of = entries[e], at[0, e], at[1, e]
        for h in range(n):
            turned[h, to] += one * X[of, h]
    multiply(K, X, fed)
    for h in range(n):
        for c in range(p):
            one = fed[c, h]
            for i in range(n):
                turned[h, i] -= one * G[i, c]


@Compiled
def _recursion(
    at: Array, entries: Array, F: Array, G: Array, E: Array, read: Array, kind: Array, K: Array, R: Array,
    which: Array, X: Array, variance: Array, every: bool, stride: int,
) -> tuple[float, float]:  # fmt: skip
    """Fill `variance` of the combinations where wanted; sums of their variances and of those of the inputs."""
    n, p, q, samples = F.shape[1], G.shape[2], len(read), len(kind)
    half, eye = np.zeros((p, p)), np.eye(p)
    push, change, closed = np.zeros((n, p)), np.zeros((n, n)), np.zeros((n, n))
    rows, product, square, news, alone = (
        np.zeros((q, n)), np.zeros((q, n)), np.zeros((q, q)), np.zeros((q, p)), np.zeros((q, q))
    )  # fmt: skip
    inner, fast, known = np.zeros((p, p)), np.zeros((p, n)), np.zeros((p, p))
    moved, fed, old = np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    own, weight, work = np.zeros(q), np.zeros(n), np.zeros((n, n))
    trace, penalty, load, part, k, row, j = 0.0, 0.0, 0.0, 0.0, 0, -1, -1
    since, kept = 0, np.empty(KEPT)
    inputs_differ = q != p or largest(E) != 0.0
    if not inputs_differ:
        subtract(read, eye, square)
        inputs_differ = largest(square) != 0.0
    while k < samples:
        if which[k] != row or kind[k] != j:
            row, j, since = which[k], kind[k], 0
            begin(kept)
            solve_upper(R[row], eye, half)
            multiply_by_transposed(half, half, inner)  # M^-1
            multiply(G[j], half, push)
            multiply_by_transposed(push, push, fed)
            multiply(G[j], K[row], change)
            subtract(F[j], change, closed)
            subtract(E, K[row], fast)
            multiply(read, fast, rows)
            multiply(read, half, news)
            multiply_by_transposed(news, news, alone)
        multiply(rows, X, product)
        multiply_by_transposed(product, rows, square)
        load = 0.0
        for i in range(q):
            own[i] = square[i, i] + alone[i, i]
            load += own[i]
        part = load
        if inputs_differ:
            multiply(K[row], X, fast)
            multiply_by_transposed(fast, K[row], known)
            part = 0.0
            for i in range(p):
                part += known[i, i] + inner[i, i]
        if every:
            variance[k] = own
        trace += load
        penalty += part
        k += 1
        if since % stride == 0:
            if since > 0:
                for i in range(n):  # of each state, what it does to a load or an input
                    weight[i] = 0.0
                    for h in range(p):
                        weight[i] = max(weight[i], abs(K[row, h, i]))
                    for h in range(q):
                        weight[i] = max(weight[i], abs(rows[h, i]))
                gap, size = 0.0, largest(alone)
                for i in range(n):
                    for h in range(n):
                        gap = max(gap, weight[i] * weight[h] * abs(X[i, h] - old[i, h]))
                        size = max(size, weight[i] * weight[h] * abs(X[i, h]))
                if settled(kept, since, stride, gap, size, closed, moved, work, samples):
                    while k < samples and which[k] == row and kind[k] == j:
                        if every:
                            variance[k] = own
                        trace += load
                        penalty += part
                        k += 1
                    continue
            scale(X, 1.0, old)
        since += 1
        _closed_times(at, entries[j], G[j], K[row], X, fast, moved)
        _closed_times(at, entries[j], G[j], K[row], moved, fast, X)
        for i in range(n):
            for h in range(n):
                X[i, h] += fed[i, h]
    return trace, penalty


SLOPE = 1e-3  # relative step of lambda for a derivative of fourth order


class StateSpacePosterior:
    """Covariance ``sigma^2 (H^T H + lam^2 L^T L)^-1`` of a load history, never formed.

    Parameters
    ----------
    record : WhitenedRecord
        Its data are not used.
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data.
    held : Gains, optional
        Gains at `lam`, where they are at hand.
    variance : array, shape (samples, loads), optional
        At unit noise, where it is at hand.
    """

    kind = "statespace"

    def __init__(
        self, record: WhitenedRecord, lam: float, sigma: float, held: Gains | None = None, variance: Array | None = None
    ) -> None:
        self.record, self.lam, self.sigma = record, float(lam), float(sigma)
        self._held, self._variance = held, variance
        self.shape = (record.samples, record.p)

    @cached_property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        return self.sigma * np.sqrt(self._variances(self.held) if self._variance is None else self._variance)

    @cached_property
    def noise_std(self) -> Array:
        """Standard deviation from the noise alone: the derivative of lam^2 times the variance in lam^2."""
        step = np.exp(SLOPE * np.array([-2, -1, 1, 2]))
        parts = [x**2 * self._variances(gains(self.record, self.lam * x)) for x in step]
        slope = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (24 * SLOPE)
        return np.asarray(self.sigma * np.sqrt(np.maximum(slope, 0.0)))

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        return self._each(w, lambda one: np.asarray(self.sigma**2 * self._solve(one).value))

    def noise_variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)`` from the noise alone."""

        def own(one: Array) -> Array:
            solved = self._solve(one)
            return np.asarray(self.sigma**2 * max(solved.value - self.lam**2 * float(np.sum(solved.inputs**2)), 0.0))

        return self._each(w, own)

    def bias_weights(self, w: Array) -> Array:
        """``(R - I)^T w`` in the shape of `w`: what regularisation takes from the weights, -lam^2 L^T L P w."""
        return self._each(w, lambda one: -(self.lam**2) * self._penalty_adjoint(self._solve(one).inputs))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        r = self.record
        return {
            "kind": self.kind, "F": r.F, "G": r.G, "C": r.C, "D": r.D, "E": r.E, "samples": r.kind, "free": r.free,
            "data": r.data, "lam": self.lam, "sigma": self.sigma,
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> StateSpacePosterior:
        """From what `to_arrays` gave."""
        matrices = {name: np.asarray(tree[name], float) for name in "FGCDE"}
        kind = np.asarray(tree["samples"]).astype(np.int32)
        y = np.zeros((len(kind), matrices["C"].shape[1]))
        free = np.asarray(tree["free"]).astype(int).reshape(-1)
        return cls(
            WhitenedRecord(**matrices, kind=kind, y=y, free=free, data=int(tree["data"])), tree["lam"], tree["sigma"]
        )

    # -- inside -------------------------------------------------------------------------------------------------------
    @property
    def held(self) -> Gains:
        """Gains of the recursion at its lambda, computed when they are asked for first."""
        if self._held is None:
            self._held = gains(self.record, self.lam)
        return self._held

    def combined_std(self, T: Array) -> Array:
        """Standard deviation of the combinations ``T g_k`` of every sample, shape (samples, rows of T)."""
        return np.asarray(self.sigma * np.sqrt(self._variances(self.held, T)))

    def _variances(self, held: Gains, combined: Array | None = None) -> Array:
        found = variances(self.record, held, combined=combined).variance
        assert found is not None  # asked for every sample
        return found

    def _solve(self, w: Array) -> Solved:
        return solve(self.record, self.held, np.zeros((self.record.samples, self.record.m)), w)

    def _each(self, w: Array, ask: Callable[[Array], Array]) -> Array:
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim > 3:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        return ask(w) if w.ndim == 2 else np.array([ask(one) for one in w])

    def _penalty_adjoint(self, w: Array) -> Array:
        """L^T w: the difference that the penalty takes, backwards in time."""
        pulse = np.zeros((min(3, len(w)), self.record.p))
        pulse[0] = 1.0
        short = replace(self.record, kind=self.record.kind[: len(pulse)], y=self.record.y[: len(pulse)])
        steps = forward(short, feedback(short, self.record.E), pulse, np.zeros(self.record.n))[0]
        out = np.array(w)
        for j in range(1, len(steps)):
            out[:-j] += steps[j] * w[j:]
        return out


class MappedPosterior:
    """Covariance of the loads ``g_k = T u_k``, made from that of the unknowns u.

    Parameters
    ----------
    base : Posterior
        Of the unknowns (samples, unknowns).
    T : array, shape (loads, unknowns)
    """

    kind = "mapped"

    def __init__(self, base: Posterior, T: Array) -> None:
        self.base, self.T = base, np.asarray(T, float)
        self._std: Array | None = None

    @property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        if self._std is None:
            self._std = _std(self.base, self.T)
        return self._std

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        return self.base.variance(np.asarray(w, float) @ self.T)

    @property
    def noise_std(self) -> None:
        """Not known at every sample: see `noise_variance`."""

    def noise_variance(self, w: Array) -> Array | None:
        """Variance of ``sum(w * load)`` from the noise alone; None where the unknowns do not tell."""
        base: Any = self.base
        found: Array | None = getattr(base, "noise_variance", lambda _: None)(np.asarray(w, float) @ self.T)
        return found

    def bias_weights(self, w: Array) -> Array | None:
        """``(R - I)^T w`` for the resolution R of the loads; None where fewer unknowns than loads define none."""
        base: Any = self.base
        loads, unknowns = self.T.shape
        told = getattr(base, "bias_weights", lambda _: None)(np.asarray(w, float) @ self.T)
        if told is None or loads != unknowns:
            return None
        return np.asarray(np.linalg.solve(self.T.T, np.swapaxes(told, -1, -2)).swapaxes(-1, -2), float)

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "base": self.base.to_arrays(), "T": self.T}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> MappedPosterior:
        """From what `to_arrays` gave."""
        return cls(from_arrays(tree["base"]), np.asarray(tree["T"], float))


def _std(base: Any, T: Array) -> Array:
    """Standard deviation (samples, loads), from whatever the solver keeps of the covariance of one sample."""
    if isinstance(base, DensePosterior):
        samples, unknowns = base.shape
        modes = base.factor.reshape(samples, unknowns, -1)
        return np.stack([np.sqrt(np.sum((T @ one) ** 2, axis=1)) for one in modes])
    if isinstance(base, SpectralPosterior):
        lines = np.einsum("iu,kuv,jv->kij", T, base.lines, T, optimize=True)
        return SpectralPosterior(lines, base.samples, base.padded).std
    if isinstance(base, StateSpacePosterior):
        return base.combined_std(T)
    return _asked(base, T)


def _asked(base: Any, T: Array) -> Array:
    """From a posterior that answers for sums only: correlations within a sample as at its middle.

    The std of every unknown at every sample is that of `base`; the correlation of the unknowns with each other is
    taken from the middle of the record, where it is stationary.
    """
    std = np.asarray(base.std, float)
    samples, unknowns = std.shape
    covariance = np.empty((unknowns, unknowns))
    for i in range(unknowns):
        for j in range(i + 1):
            w = np.zeros((samples, unknowns))
            w[samples // 2, i] += 1.0
            w[samples // 2, j] += 1.0 if i != j else 0.0
            covariance[i, j] = covariance[j, i] = np.asarray(base.variance(w)).item()
    own = np.diag(covariance).copy()
    covariance = (covariance - own[:, None] - own) / 2
    np.fill_diagonal(covariance, own)
    level = np.sqrt(np.maximum(own, np.finfo(float).tiny))
    correlation = covariance / level[:, None] / level
    scaled = std[:, None, :] * T
    return np.asarray(np.sqrt(np.maximum(np.einsum("kli,ij,klj->kl", scaled, correlation, scaled, optimize=True), 0.0)))
