"""What is known of loads before any reading: that they are contacts.

The prior is the covariance of an ensemble of presses: anywhere on the surface, of any radius between two, flat
or round, with a shear of its own. Over places it is stationary, and a function of distance alone,

    k(d) = integral S(k) J0(k d) k dk,   S(k) = mean over the radii of |p(k)|^2,

with p(k) the transform of the pressure under one press. As `penalty=` it is one like any other: ``|L t|^2`` with
``L' L`` the inverse of this covariance. A ridge is the ensemble of presses that are points, a gradient that of presses
without bound; where normal motion is not seen, or hardly (in-plane markers on a nearly incompressible gel), what is
found of a press is what its prior says of it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular

from structures.errors import InputError, pair, positive

from .._arrays import Array, Index

RADII = 12  # of the ensemble, evenly on a logarithmic scale
WAVES, REACH = 6000, 60.0  # numbers over which S is summed, up to this over the smallest radius
DISTANCES = 600
NUGGET = 1e-3  # share of presses smaller than any cell


@dataclass(frozen=True)
class ContactPrior:
    """Loads are contacts: the covariance of an ensemble of presses, as a penalty.

    Parameters
    ----------
    radii : (smallest, largest), optional
        Radii of the presses (m), all sizes between them as likely on a logarithmic scale, and of like force over
        radius. A sixth of the thickness and the thickness, where not given.
    shear : float
        Std of the shear along each axis over that of the pressure.

    Raises
    ------
    InputError
        Radii that are not positive and ascending, a shear that is not positive.
    """

    radii: tuple[float, float] | None = None
    shear: float = 0.35

    def __post_init__(self) -> None:
        if self.radii is not None:
            low, high = pair("radii", self.radii, where="ContactPrior", unit="m")
            if not 0 < low < high:
                raise InputError("no range of radii", where="ContactPrior, radii", found=self.radii,
                                 expected="two radii in m, 0 < smallest < largest")  # fmt: skip
            object.__setattr__(self, "radii", (low, high))
        object.__setattr__(self, "shear", positive("the shear", self.shear, where="ContactPrior"))

    def correlation(self, distance: Array, thickness: float) -> Array:
        """Of pressures at such distances (m), on a gel of such thickness (m)."""
        low, high = self.radii or (thickness / 6, thickness)
        at, values = _correlations(high / low)
        return np.asarray(np.interp(np.asarray(distance) / low, at, values, right=0.0))

    def on(self, places: Array, thickness: float) -> PosedPrior:
        """The prior of tractions at places (P, 3) of a surface."""
        from scipy.spatial.distance import cdist

        C = self.correlation(cdist(places, places), thickness)
        C[np.diag_indices_from(C)] += NUGGET
        return PosedPrior(C, np.array([self.shear**2, self.shear**2, 1.0]))


def penalty(contact: Mapping[str, Any]) -> Any:
    """The penalty that the table ``[contact]`` of a pad file names: a contact prior by default, or a word."""
    word = contact.get("penalty", "contact")
    return ContactPrior() if word == "contact" else word


@lru_cache(maxsize=16)
def _correlations(ratio: float) -> tuple[Array, Array]:
    """Distances over the smallest radius, up to twice the largest, and the correlation there; `ratio` of the radii."""
    from scipy.special import j0, j1

    k = (np.arange(WAVES) + 0.5) * REACH / WAVES
    S = np.zeros(WAVES)
    for a in np.geomspace(1.0, ratio, RADII):
        s = k * a
        flat, round_ = 2 * j1(s) / s, 2 * (np.sin(s) - s * np.cos(s)) / s**3
        S += a**2 * (flat**2 + round_**2)
    d = np.linspace(0.0, 2 * ratio, DISTANCES)
    values = j0(np.outer(d, k)) @ (S * k)
    values = values / values[0]
    values[-1] = 0.0
    return d, values


@dataclass(frozen=True, eq=False)
class PosedPrior:
    """Covariance of tractions (3 P,) up to a factor: `matrix` (P, P) between places, `share` (3,) of the components."""

    matrix: Array
    share: Array

    @cached_property
    def variance(self) -> Array:
        """Of each traction (3 P,)."""
        return np.outer(np.diag(self.matrix), self.share).ravel()

    def times(self, rows: Array) -> Array:
        """Rows (k, 3 P) times the covariance."""
        return self._each(rows, self.matrix, self.share)

    def among(self, nodes: Index) -> PosedPrior:
        """The prior of some nodes (k,)."""
        return PosedPrior(self.matrix[np.ix_(nodes, nodes)], self.share)

    def penalty(self, nodes: Index) -> Array:
        """L (3 k, 3 k) of the tractions at some nodes (k,), where all others carry none."""
        W = solve_triangular(np.linalg.cholesky(self.matrix[np.ix_(nodes, nodes)]), np.eye(len(nodes)), lower=True)
        return np.kron(W, np.diag(1 / np.sqrt(self.share)))

    def modes(self, nodes: Index, count: int) -> Array:
        """The strongest patterns of tractions at some nodes (3 k, 3 count or fewer), times their std."""
        w, V = np.linalg.eigh(self.matrix[np.ix_(nodes, nodes)])
        strongest = np.sqrt(np.maximum(w[::-1][:count], 0.0)) * V[:, ::-1][:, :count]
        return np.kron(strongest, np.diag(np.sqrt(self.share)))

    @staticmethod
    def _each(rows: Array, matrix: Array, factor: Array) -> Array:
        out = np.empty_like(rows)
        for c, f in enumerate(factor):
            out[:, c::3] = f * (rows[:, c::3] @ matrix)
        return out
