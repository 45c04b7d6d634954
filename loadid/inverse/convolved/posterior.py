"""Posterior of a load history behind a convolution: variances by displacement, any weighted sum by one solve."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from . import probes
from .circulant import Circulant
from .displacement import MANY, columns, profile
from .operator import Operator
from .pcg import Reached, Sides, solve

SLOPE = 1e-2  # step in ln lambda^2 for a derivative of fourth order


class ConvolvedPosterior:
    """Covariance ``sigma^2 (H^T H + lam^2 L^T L)^-1`` of a load history, never formed.

    `std` is exact to the tolerance of some solves, at both ends and between (`displacement.profile`); with many gaps in
    the data it is estimated, to some per cent where loads 64 samples apart are no longer correlated (`probes`).
    `noise_std` is its derivative in lambda by differences, good to about 1e-6; `variance`, `noise_variance` and
    `bias_weights` take one solve for each weighted sum.

    Parameters
    ----------
    operator : Operator
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data.
    """

    kind = "convolved"

    def __init__(self, operator: Operator, lam: float, sigma: float) -> None:
        if not (np.isfinite(sigma) and sigma >= 0):
            raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number >= 0")
        self.operator, self.lam, self.sigma = operator, float(lam), float(sigma)
        self.shape = (operator.samples, operator.loads)

    @cached_property
    def std(self) -> NDArray[np.float64]:
        """Standard deviation, shape (samples, loads)."""
        return self.sigma * np.sqrt(np.maximum(self._variances(self.lam), 0.0))

    @cached_property
    def noise_std(self) -> NDArray[np.float64]:
        """Standard deviation from the noise alone: B H^T H B is the derivative of lam^2 B in lam^2."""
        steps = np.exp(0.5 * SLOPE * np.array([-2, -1, 1, 2]))
        parts = [x**2 * self._variances(self.lam * x) for x in steps]
        slope = (parts[0] - 8 * parts[1] + 8 * parts[2] - parts[3]) / (12 * SLOPE)
        return self.sigma * np.sqrt(np.maximum(slope, 0.0))

    def variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)``; `w` is (samples, loads) or (k, samples, loads)."""
        found, stacked, w = self._solve(w)
        value = self.sigma**2 * np.einsum("kij,kij->k", found.x, w)
        return value if stacked else value[0]

    def noise_variance(self, w: NDArray) -> NDArray[np.float64]:
        """Variance of ``sum(w * load)`` from the noise alone."""
        found, stacked, _ = self._solve(w)
        value = self.sigma**2 * np.einsum("kij,kij->k", found.r, found.r)
        return value if stacked else value[0]

    def bias_weights(self, w: NDArray) -> NDArray[np.float64]:
        """``(R - I)^T w`` in the shape of `w`: what regularisation takes from the weights, -lam^2 L^T L B w."""
        found, stacked, _ = self._solve(w)
        lost = np.swapaxes(self.lam * self.operator.rough_adjoint(found.q), 1, 2)  # q = -lam L B w
        return lost if stacked else lost[0]

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        o = self.operator
        tree: dict[str, object] = {
            "kind": self.kind, "h": np.moveaxis(o.h, -1, 0), "samples": o.samples, "penalty": o.penalty,
            "lam": self.lam, "sigma": self.sigma,
        }  # fmt: skip
        return tree if o.weight is None else tree | {"weight": o.weight.T}

    @classmethod
    def from_arrays(cls, tree: dict) -> ConvolvedPosterior:
        """From what `to_arrays` gave."""
        weight = None if tree.get("weight") is None else np.asarray(tree["weight"], float)
        operator = Operator(np.asarray(tree["h"], float), int(tree["samples"]), str(tree["penalty"]), weight)
        return cls(operator, float(tree["lam"]), float(tree["sigma"]))

    # -- inside -------------------------------------------------------------------------------------------------------
    def _variances(self, lam: float) -> NDArray[np.float64]:
        if columns(self.operator) > MANY:
            return np.ascontiguousarray(probes.variances(self.operator, lam).T)
        return np.ascontiguousarray(profile(self.operator, lam).variance.T)

    def _solve(self, w: NDArray) -> tuple[Reached, bool, NDArray]:
        w = np.asarray(w, float)
        if w.shape[-2:] != self.shape or w.ndim not in (2, 3):
            raise InputError("the weights do not fit the load", where="w", found=f"shape {w.shape}",
                             expected=f"shape {self.shape}, or a stack of such")  # fmt: skip
        b = np.ascontiguousarray(np.swapaxes(w.reshape(-1, *self.shape), 1, 2))
        return solve(self.operator, Circulant(self.operator, self.lam), Sides(b=b)), w.ndim == 3, b
