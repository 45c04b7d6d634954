"""Posterior of a load history over a state space: variances by recursion, any weighted sum by one solve."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .covariance import spread
from .passes import Solved, forward, solve
from .record import Record
from .riccati import Gains, feedback, gains

SLOPE = 1e-3  # relative step of lambda for a derivative of fourth order


class StateSpacePosterior:
    """Covariance ``sigma^2 (H^T H + lam^2 L^T L)^-1`` of a load history, never formed.

    Parameters
    ----------
    record : Record
        Its data are not used.
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data.
    held : Gains, optional
        Gains at `lam`, where they are at hand.
    """

    kind = "statespace"

    def __init__(self, record: Record, lam: float, sigma: float, held: Gains | None = None) -> None:
        self.record, self.lam, self.sigma = record, float(lam), float(sigma)
        self._held = held
        self.shape = (record.samples, record.p)

    @cached_property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, shape (samples, loads)."""
        return self.sigma * np.sqrt(self._variances(self.held))

    @cached_property
    def noise_std(self) -> NDArray[np.float64]:
        """Standard deviation from the noise alone: the derivative of lam^2 times the variance in lam^2."""
        step = np.exp(SLOPE * np.array([-2, -1, 1, 2]))
        parts = [x**2 * self._variances(gains(self.record, self.lam * x)) for x in step]
        slope = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (24 * SLOPE)
        return self.sigma * np.sqrt(np.maximum(slope, 0.0))

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        return self._each(w, lambda one: np.asarray(self.sigma**2 * self._solve(one).value))

    def noise_variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)`` from the noise alone."""

        def own(one: NDArray) -> NDArray:
            solved = self._solve(one)
            return np.asarray(self.sigma**2 * max(solved.value - self.lam**2 * float(np.sum(solved.inputs**2)), 0.0))

        return self._each(w, own)

    def bias_weights(self, w: NDArray) -> NDArray[np.float64]:
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
    def from_arrays(cls, tree: dict) -> StateSpacePosterior:
        """From what `to_arrays` gave."""
        matrices = {name: np.asarray(tree[name], float) for name in "FGCDE"}
        kind = np.asarray(tree["samples"]).astype(np.int32)
        y = np.zeros((len(kind), matrices["C"].shape[1]))
        free = np.asarray(tree["free"]).astype(int).reshape(-1)
        return cls(Record(**matrices, kind=kind, y=y, free=free, data=int(tree["data"])), tree["lam"], tree["sigma"])

    # -- inside -------------------------------------------------------------------------------------------------------
    @property
    def held(self) -> Gains:
        """Gains of the recursion at its lambda, computed when they are asked for first."""
        if self._held is None:
            self._held = gains(self.record, self.lam)
        return self._held

    def _variances(self, held: Gains) -> NDArray[np.float64]:
        found = spread(self.record, held).variance
        assert found is not None
        return found

    def _solve(self, w: NDArray) -> Solved:
        return solve(self.record, self.held, np.zeros((self.record.samples, self.record.m)), w)

    def _each(self, w: NDArray, ask: Callable[[NDArray], NDArray]) -> NDArray[np.float64]:
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim > 3:
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        return ask(w) if w.ndim == 2 else np.array([ask(one) for one in w])

    def _penalty_adjoint(self, w: NDArray) -> NDArray[np.float64]:
        """L^T w: the difference that the penalty takes, backwards in time."""
        pulse = np.zeros((min(3, len(w)), self.record.p))
        pulse[0] = 1.0
        short = replace(self.record, kind=self.record.kind[: len(pulse)], y=self.record.y[: len(pulse)])
        steps = forward(short, feedback(short, self.record.E), pulse, np.zeros(self.record.n))[0]
        out = np.array(w)
        for j in range(1, len(steps)):
            out[:-j] += steps[j] * w[j:]
        return out
