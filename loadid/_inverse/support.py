"""Loads that act on some of their unknowns only: the path of the columns that are left, and its posterior."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import Array
from .noise_level import unexplained
from .path import Solution
from .posterior import DensePosterior, Posterior, from_arrays
from .problem import LinearProblem
from .svd import SVDPath

TOLD = 3.0  # degrees of freedom from which a residual tells a level


class SupportedPath(SVDPath):
    """Dense path of a record whose load is zero outside a window; loads have the length of the record.

    Parameters
    ----------
    problem : LinearProblem
        Of the columns that are left.
    acting : array of bool, shape (samples, loads)
        The unknowns that these are.
    truncated : bool
        As of `SVDPath`.
    """

    def __init__(self, problem: LinearProblem, acting: NDArray[np.bool_], *, truncated: bool = False) -> None:
        super().__init__(problem, truncated=truncated)
        self.acting = acting

    def solution(self, lam: float, sigma: float | None) -> Solution:
        """Load (samples, loads), zero outside, and its posterior."""
        found = super().solution(lam, sigma)
        return Solution(self._whole(found.load), found.posterior)

    def resolve(self, load: Array, lam: float) -> Array:
        """What would be estimated from the noise-free response of that part of a load which acts."""
        return self._whole(super().resolve(load[self.acting], lam))

    def level_within(self, lam: float, sigma: float) -> float:
        """Noise level of the samples at which a load acts: `sigma`, or what their residual shows beyond all chance.

        Errors of a model are where its load is, while noise fills the record. Its variance is the residual over what
        the fit leaves of those data (the trace of I - A over them, A that which makes the fit of the data).
        """
        within = np.asarray(self.acting.any(axis=1))
        passed = 1.0 - self.rejected(np.array([lam]))[0, : self.U.shape[1]]
        left = (1.0 - (self.U**2) @ passed).reshape(len(within), -1)[within].sum()
        residual2 = float(np.sum(self.residual(lam)[within] ** 2))
        return sigma if left < TOLD else sigma * (unexplained(residual2, float(left), sigma) or 1.0)

    def _posterior(self, lam: float, sigma: float) -> DensePosterior:
        own = super()._posterior(lam, sigma)
        wide = [None if part is None else self._rows(part) for part in (own.factor, own.dual)]
        assert wide[0] is not None
        return DensePosterior(wide[0], self.acting.shape, passed=own.passed, dual=wide[1], orthogonal=own.orthogonal)

    def _rows(self, part: Array) -> Array:
        out = np.zeros((self.acting.size, part.shape[1]))
        out[self.acting.reshape(-1)] = part
        return out

    def _whole(self, part: Array) -> Array:
        out = np.zeros(self.acting.shape)
        out[self.acting] = part.reshape(-1)
        return out


class ActingPosterior:
    """The posterior of a load that is zero outside its window: it is known there, and has no spread.

    Parameters
    ----------
    own : Posterior
        Of the length of the record.
    acting : array of bool, the shape of the load
    """

    kind = "acting"

    def __init__(self, own: Posterior, acting: NDArray[np.bool_]) -> None:
        self.own, self.acting = own, np.asarray(acting, bool)

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the load."""
        return self.acting.shape

    @cached_property
    def std(self) -> Array:
        """Standard deviation, in the shape of the load; zero outside the window."""
        return np.where(self.acting, self.own.std, 0.0)

    def variance(self, w: Array) -> Array:
        """Variance of ``sum(w * load)``; `w` has the shape of the load, or (k,) + that shape."""
        return np.asarray(self.own.variance(np.asarray(w, float) * self.acting))

    def to_arrays(self) -> dict[str, object]:
        """Plain arrays, for a result file."""
        return {"kind": self.kind, "own": self.own.to_arrays(), "acting": self.acting}

    @classmethod
    def from_arrays(cls, tree: dict[str, Any]) -> ActingPosterior:
        """From what `to_arrays` gave."""
        return cls(from_arrays(tree["own"]), np.asarray(tree["acting"], bool))
