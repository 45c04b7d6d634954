"""Posterior of a load history over a state space: variances by recursion, weighted sums, combinations g = T u.

    Var(g_k) = (E - K) X (E - K)^T + M^-1,      X <- (F - G K) X (F - G K)^T + G M^-1 G^T,

in units of the noise variance. X starts at 0, and at the inverse of P_0 in the free states. Where gains and covariance
have settled the rest of a run is counted, not computed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from structures.errors import InputError

from ..posterior import DensePosterior, Posterior, SpectralPosterior
from .compiled import (
    NEAR,
    NEVER,
    SETTLED,
    SHARE,
    STALLED,
    Compiled,
    arrival,
    decay,
    multiply,
    multiply_by_transposed,
    solve_upper,
)
from .gains import Gains, feedback, gains
from .passes import Solved, forward, solve
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


def spread(record: WhitenedRecord, gains: Gains, every_sample: bool = True) -> LoadVariances:
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
    return LoadVariances(variance if every_sample else None, float(trace), float(gains.lam**2 * penalty))


@Compiled
def _recursion(
    F: Array, G: Array, E: Array, kind: Array, K: Array, R: Array, which: Array, X: Array,
    variance: Array, every: bool, stride: int,
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
    """

    kind = "statespace"

    def __init__(self, record: WhitenedRecord, lam: float, sigma: float, held: Gains | None = None) -> None:
        self.record, self.lam, self.sigma = record, float(lam), float(sigma)
        self._held = held
        self.shape = (record.samples, record.p)

    @cached_property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        return self.sigma * np.sqrt(self._variances(self.held))

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

    def _variances(self, held: Gains) -> Array:
        found = spread(self.record, held).variance
        assert found is not None
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
        from ..posterior import from_arrays

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
    if base.kind.startswith("statespace"):
        return _over_states(base, T)
    return _asked(base, T)


def _over_states(base: Any, T: Array) -> Array:
    """Over a state space: the recursion of its own posterior in other coordinates of the load, where T is square."""
    record, held = base.record, base.held
    if T.shape[0] != T.shape[1]:
        return _every_sample(base, T)
    # with inputs T w the feedback is T K and the precision T^-T M T^-1, of which the recursion takes the root
    loads = replace(record, E=np.ascontiguousarray(T @ record.E), G=_right(record.G, T))
    upper = np.linalg.qr(_right(held.R, T), mode="r")
    turned = replace(held, K=np.ascontiguousarray(T @ held.K), R=np.ascontiguousarray(upper))
    variance = spread(loads, turned).variance
    assert variance is not None  # asked for every sample
    return np.asarray(base.sigma * np.sqrt(variance), float)


def _right(stack: Array, T: Array) -> Array:
    """``A T^-1`` of a stack of matrices A."""
    return np.ascontiguousarray(np.swapaxes(np.linalg.solve(T.T, np.swapaxes(stack, -1, -2)), -1, -2))


def _every_sample(base: Any, T: Array) -> Array:
    """``T [(E - K) X (E - K)^T + M^-1] T^T`` at every sample, by the recursion of the state's covariance X."""
    from scipy.linalg import solve_triangular

    record, held = base.record, base.held
    X, variance = np.zeros((record.n, record.n)), np.empty((record.samples, len(T)))
    if len(record.free):
        X[np.ix_(record.free, record.free)] = held.start @ held.start.T
    row = kind = -1
    for k in range(record.samples):
        if held.which[k] != row or record.kind[k] != kind:
            row, kind = int(held.which[k]), int(record.kind[k])
            own = solve_triangular(held.R[row], T.T, trans=1).T  # T R^-1
            push = solve_triangular(held.R[row], record.G[kind].T, trans=1).T
            closed, fed = record.F[kind] - record.G[kind] @ held.K[row], push @ push.T
            rows = T @ (record.E - held.K[row])
        variance[k] = np.einsum("in,in->i", rows @ X, rows) + np.sum(own**2, axis=1)
        X = closed @ X @ closed.T + fed
    return np.asarray(base.sigma * np.sqrt(variance), float)


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
