"""Posterior of combinations of the unknowns of a solver: loads ``g = T u`` at every sample."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .posterior import DensePosterior, Posterior, SpectralPosterior

Array = NDArray[np.float64]


class MappedPosterior:
    """Covariance of the loads ``g_k = T u_k``, made from that of the unknowns u.

    Parameters
    ----------
    base : Posterior
        Of the unknowns (samples, unknowns).
    T : array, shape (loads, unknowns)
    """

    kind = "mapped"

    def __init__(self, base: Posterior, T: NDArray) -> None:
        self.base, self.T = base, np.asarray(T, float)
        self._std: Array | None = None

    @property
    def std(self) -> Array:
        """Standard deviation, shape (samples, loads)."""
        if self._std is None:
            self._std = _std(self.base, self.T)
        return self._std

    def variance(self, w: NDArray) -> Array:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        return self.base.variance(np.asarray(w, float) @ self.T)

    @property
    def noise_std(self) -> None:
        """Not known at every sample: see `noise_variance`."""

    def noise_variance(self, w: NDArray) -> Array | None:
        """Variance of ``sum(w * load)`` from the noise alone; None where the unknowns do not tell."""
        base: Any = self.base
        found: Array | None = getattr(base, "noise_variance", lambda _: None)(np.asarray(w, float) @ self.T)
        return found

    def bias_weights(self, w: NDArray) -> Array | None:
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
    def from_arrays(cls, tree: dict) -> MappedPosterior:
        """From what `to_arrays` gave."""
        from .posterior import from_arrays

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
    from .statespace.covariance import spread

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
    return np.sqrt(np.maximum(np.einsum("kli,ij,klj->kl", scaled, correlation, scaled, optimize=True), 0.0))
