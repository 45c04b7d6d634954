"""The search as posed: what is factorised once for all records of a length, and one record beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inverse.locating.fits import DenseFit, Fit, JointFit, LongFit
from ...inverse.whitening import whiten
from ..data import Data
from ..noise import Noise
from .candidates import Candidates

Array = NDArray[np.float64]
DENSE = 600  # unknowns up to which a fit is one factorisation


@dataclass(frozen=True)
class Factored:
    """What is made once for all records of a length: responses (whitened), a fit per candidate, groups alike."""

    candidates: Candidates
    h: Array
    fits: tuple[Fit, ...]
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Posed:
    """One record, whitened by relative noise levels, with the fits that it is shown to.

    `sigma` is the noise level of the whitened data where it is known; `at` holds the refined places.
    """

    data: Data
    noise: Noise
    sigma: float | None
    y: Array
    relative: Array
    candidates: Candidates
    h: Array
    fits: tuple[Fit, ...]
    groups: tuple[tuple[str, ...], ...]
    at: Array | None = None

    @property
    def dense(self) -> bool:
        """Every candidate has its factors: a fit costs less than handing it to a thread."""
        return isinstance(self.fits[0], DenseFit)

    def fit(self, h: Array, lam: Array) -> Fit:
        """A fit of its own for some responses."""
        return JointFit(h, lam) if len(h) * h.shape[2] <= DENSE else LongFit(h, lam)

    def joint(self, indices: Sequence[int]) -> Fit:
        """Some candidates together."""
        lam = np.array([float(self.fits[j].lam[0]) for j in indices])
        return self.fit(self.h[:, :, list(indices)], lam)

    def whitened(self, places: Array) -> Array:
        """Whitened responses (samples, sensors, n) of loads at places."""
        return whiten(self.candidates.responses(places)[:, self.data.rows], self.relative, axis=1)
