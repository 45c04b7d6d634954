"""Where the candidates are: spacing, neighbours, and the box in which a place is refined."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.model import Model
from structures.values import reals

from ...design.places import of_model

Array = NDArray[np.float64]
NEIGHBOUR = 1.5  # spacings within which candidates are neighbours: the diagonal of a square grid is one
FLAT = 1e-6  # extent over the largest below which all candidates agree in a coordinate
RIM = 0.05  # spacings that a place keeps from the end of the structure, where it may be held


@dataclass(frozen=True, eq=False)
class Grid:
    """Places of the candidates.

    Parameters
    ----------
    places : array, shape (candidates, dim)
        m.
    spacing : float
        Median distance to the nearest neighbour (m).
    used : array of int
        Coordinates in which the candidates differ.
    outline : array, shape (nodes, dim), or None
        Nodes of the structure.
    """

    places: Array
    spacing: float
    used: NDArray[np.intp]
    outline: Array | None

    @property
    def distance(self) -> Array:
        """Distances of the candidates in spacings, (candidates, candidates)."""
        return np.linalg.norm(self.places[:, None] - self.places, axis=2) / self.spacing

    @property
    def near(self) -> NDArray[np.bool_]:
        """Which candidates are neighbours; each is its own."""
        return self.distance <= NEIGHBOUR

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Box over the used coordinates: half a spacing beyond the candidates, but on the structure."""
        x = self.places[:, self.used]
        low, high = x.min(axis=0) - self.spacing / 2, x.max(axis=0) + self.spacing / 2
        if self.outline is not None:
            ends, rim = self.outline[:, self.used], RIM * self.spacing
            low = np.minimum(np.maximum(low, ends.min(axis=0) + rim), x.min(axis=0))
            high = np.maximum(np.minimum(high, ends.max(axis=0) - rim), x.max(axis=0))
        return low, high

    def full(self, used: Array) -> Array:
        """Places with all coordinates, from the used ones (n, used)."""
        out = np.tile(self.places[0], (len(used), 1))
        out[:, self.used] = used
        return out


def grid_of(model: Model, places: ArrayLike | None) -> Grid | None:
    """Places that the user or the model gives; None where neither knows them.

    Raises
    ------
    InputError
        Places that do not fit the candidates, or two candidates at one place.
    """
    _, own, outline = of_model(model)
    found = own if places is None else _given(places, len(model.loads))
    if found is None or len(found) < 2:
        return None
    distance = np.linalg.norm(found[:, None] - found, axis=2)
    np.fill_diagonal(distance, np.inf)
    extent = np.ptp(found, axis=0)
    if distance.min() <= FLAT * extent.max():
        i, j = np.unravel_index(int(np.argmin(distance)), distance.shape)
        if places is None:
            return None  # loads in several directions at one node: candidates without a distance
        raise InputError(
            "two candidates at one place", where="places", found=f"{model.loads[i].label} and {model.loads[j].label}",
            expected="distinct places", hint="one candidate for each place",
        )  # fmt: skip
    used = np.flatnonzero(extent > FLAT * extent.max())
    fits = outline is not None and outline.shape[1] == found.shape[1]
    return Grid(found, float(np.median(distance.min(axis=1))), used, outline if fits else None)


def _given(places: Any, count: int) -> Array:
    x = reals(places, what="the places are no real numbers", where="places")
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != count or not 1 <= x.shape[1] <= 3 or not np.all(np.isfinite(x)):
        raise InputError(
            "the places do not fit the candidates", where="places", found=f"shape {x.shape}",
            expected=f"finite, ({count},) to ({count}, 3), in m", hint="one place for each load of the model",
        )  # fmt: skip
    return x
