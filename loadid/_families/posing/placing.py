"""The place of hits by their evidence, over the states of a model whose loads can be put anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures._models.statespace import StateSpace

from ..._inverse.convolved.early import EarlyResponse, early_places, early_response
from ..._inverse.gaussian.record import WhitenedRecord, augment, measured
from ..._inverse.local_place import EvidentPlace, evident_place
from ..._inverse.local_prior import UNKNOWN, local_prior, with_misfit
from ..._results.location import Rival
from .locating import NEAR, Grid, LocationProblem
from .model_errors import nuisances
from .paths import LONGEST, MOST, state_space_of

Array = NDArray[np.float64]
BESIDE = (-1.0, -0.5, 0.5, 1.0)  # spacings from the best, of further starts


@dataclass(frozen=True, eq=False)
class Placed:
    """Places of hits.

    Parameters
    ----------
    place : array, shape (loads, used coordinates)
    covariance : array, shape (loads, used, used)
        Second moments.
    edge : bool
        One is on the rim.
    by : str
        What told them.
    rivals : tuple of Rival, or None
        Other places; None where the residuals tell them.
    misfit : float or None
        Error of the model over the response in the part that told them; None where that is all.
    """

    place: Array
    covariance: Array
    edge: bool
    by: str
    rivals: tuple[Rival, ...] | None = None
    misfit: float | None = None


@dataclass(frozen=True, eq=False)
class PlaceProblem:
    """A part of a record whose loads may be moved, over the states of the model; everything rests before it.

    Parameters
    ----------
    posed : LocationProblem
    grid : Grid
    hold : str or None
    part : slice
        Its samples.
    stated : bool
        The noise is stated.
    """

    posed: LocationProblem
    grid: Grid
    hold: str | None
    part: slice
    stated: bool

    @property
    def box(self) -> Array:
        """Bounds of the places, (used coordinates, 2)."""
        return np.stack(self.grid.bounds, axis=1)

    def possible(self, at: Array) -> bool:
        """Whether the model has few enough states for these samples; they do not change with time."""
        if not self.posed.candidates.at(at).gives("state_space"):
            return False
        system, samples = self._system(at), self.part.stop - self.part.start
        return system is not None and not system.moving and samples * len(system.A) ** 2 <= LONGEST * MOST**2

    def found(self, starts: Sequence[Array], *, early: bool) -> EvidentPlace | None:
        """The places of the largest evidence, from clipped starts."""
        clipped = [np.clip(one, *self.box.T) for one in starts]
        return evident_place(clipped, self._record, self.box, self.grid.spacing, stated=self.stated, early=early)

    def misfit(self, at: Array) -> float:
        """Error of the model over the response, by loads at places."""
        return with_misfit(local_prior(self._record(at), stated=self.stated)).misfit

    def placed(self, best: EvidentPlace, errors: Mapping[str, float]) -> Placed:
        """With second moments that hold errors of the model, of relative std as stated."""
        model, there = self.posed.candidates.at(best.place), self._system(best.place)
        assert there is not None
        wrong = nuisances(model, there, self.posed.data.rows, errors, True, self._heard)
        spread = best.covariance(self._record, wrong, self.box, self.grid.spacing)
        return Placed(best.place, spread, best.edge, "evidence of hits")

    def _system(self, at: Array) -> StateSpace | None:
        """With loads at places."""
        return state_space_of(self.posed.candidates.at(at), self.posed.data.dt, self.hold)

    def _heard(self, system: StateSpace, factors: Array) -> WhitenedRecord:
        """The record over a state space with factors of its sensors."""
        data, scale = self.posed.data, factors[:, None]
        C, D = system.C[data.rows] * scale, system.D[data.rows] * scale
        return measured(augment(system.A, system.B, C, D), data.values[self.part], self.posed.noise.level)

    def _record(self, at: Array) -> WhitenedRecord:
        moved = self._system(at)
        assert moved is not None
        return self._heard(moved, np.ones(len(self.posed.data.rows)))


def by_evidence(
    posed: LocationProblem, grid: Grid, found: Array, residual_to_noise: float | None,
    rivals: Sequence[tuple[int, Array]], errors: Mapping[str, float], hold: str | None,
) -> Placed | None:  # fmt: skip
    """Places of hits from those found by residuals; None where the record asks for no hits, or the model has no states.

    Where errors of the model hide a single hit in the whole record, or that is too long, the first part of its response
    places it.

    Parameters
    ----------
    posed : LocationProblem
    grid : Grid
    found : array, shape (loads, used coordinates)
    residual_to_noise : float or None
        Of the places found.
    rivals : sequence of (load, place)
        Other places of single loads.
    errors : mapping of str to float
        Relative std of errors of the model.
    hold : str or None
    """
    whole = PlaceProblem(posed, grid, hold, slice(0, len(posed.data.values)), posed.noise.known)
    possible = whole.possible(found)
    wrong = residual_to_noise is None or residual_to_noise > NEAR
    sought = len(found) == 1 and (wrong or not possible)
    early = early_response(posed.y, None if posed.sigma is None else posed.sigma**2) if sought else None
    near, told = whole if early is None else replace(whole, part=early.part, stated=False), []
    if early is not None and near.possible(found):
        places = grid.places[:, grid.used]
        told = early_places(early, places, posed.h, posed.whitened, whole.box, grid.spacing)
    starts = [place[None] for _, place in told]
    sooner = near.found(starts, early=True) if told else None
    best = None
    if possible and (sooner is None or whole.misfit(sooner.place) <= UNKNOWN):
        best = whole.found([*starts, *_starts(found, grid.spacing, rivals)], early=False)
    if early is not None and sooner is not None and (best is None or best.prior.misfit > UNKNOWN):
        beside = _rivals(posed, early, told, sooner.place, grid)
        return replace(near.placed(sooner, errors), by="first part of its response", rivals=beside,
                       misfit=sooner.prior.misfit)  # fmt: skip
    return None if best is None else whole.placed(best, errors)


def _rivals(
    posed: LocationProblem, early: EarlyResponse, told: Sequence[tuple[float, Array]], found: Array, grid: Grid
) -> tuple[Rival, ...]:
    """Places elsewhere than that found, with the ratio of residuals that would tell as much of white noise."""
    best, labels, out = told[0][0], [c.label for c in posed.candidates.model.loads], []
    for evidence, place in told:
        if float(np.linalg.norm(place - found)) > grid.spacing:
            nearest = int(np.argmin(np.linalg.norm(grid.places[:, grid.used] - place, axis=1)))
            ratio = float(np.exp((best - evidence) / early.y.size))
            out.append(Rival(tuple(float(v) for v in grid.full(place[None])[0]), labels[nearest], ratio, 0))
    return tuple(out)


def _starts(found: Array, spacing: float, rivals: Sequence[tuple[int, Array]]) -> Iterator[Array]:
    """The places found; with each coordinate moved by up to a spacing; with each rival in the place of its load."""
    yield found
    for k in np.ndindex(found.shape):
        for step in BESIDE:
            moved = np.array(found)
            moved[k] += step * spacing
            yield moved
    for load, place in rivals:
        moved = np.array(found)
        moved[load] = place
        yield moved
