"""The place of hits by their evidence, over the states of a model whose loads can be put anywhere."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._models.statespace import StateSpace

from ..._inverse.convolved.early import AFTER, EarlyResponse, early_places, early_response
from ..._inverse.gaussian.record import WhitenedRecord, augment, measured
from ..._inverse.local_place import EvidentPlace, evident_place
from ..._inverse.local_prior import UNKNOWN
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
class HitProblem:
    """A record whose loads may be moved, over the states of the model.

    Parameters
    ----------
    posed : LocationProblem
    grid : Grid
    hold : str or None
    """

    posed: LocationProblem
    grid: Grid
    hold: str | None

    @property
    def box(self) -> Array:
        """Bounds of the places, (used coordinates, 2)."""
        return np.stack(self.grid.bounds, axis=1)

    def system(self, at: Array) -> StateSpace | None:
        """State space with loads at places."""
        return state_space_of(self.posed.candidates.at(at), self.posed.data.dt, self.hold)

    def over(self, samples: int) -> Callable[[StateSpace, Array], WhitenedRecord]:
        """State space and factors of its sensors -> the record over its first samples."""
        data, level = self.posed.data, self.posed.noise.level

        def heard(one: StateSpace, factors: Array) -> WhitenedRecord:
            rows, scale = data.rows, factors[:, None]
            augmented = augment(one.A, one.B, one.C[rows] * scale, one.D[rows] * scale)
            return measured(augmented, data.values[:samples], level)

        return heard

    def found(self, starts: Sequence[Array], samples: int, *, early: bool) -> EvidentPlace | None:
        """The places of the largest evidence, from clipped starts."""
        clipped = [np.clip(one, *self.box.T) for one in starts]
        record, stated = self._record(samples), self.posed.noise.known and not early
        return evident_place(clipped, record, self.box, self.grid.spacing, stated=stated, early=early)

    def placed(self, best: EvidentPlace, samples: int, stated: Mapping[str, float]) -> tuple[Array, Array, bool]:
        """Places, second moments with errors of the model, and whether one is on the rim."""
        model, there = self.posed.candidates.at(best.place), self.system(best.place)
        assert there is not None
        wrong = nuisances(model, there, self.posed.data.rows, stated, True, self.over(samples))
        return best.place, best.covariance(self._record(samples), wrong, self.box, self.grid.spacing), best.edge

    def early(self) -> tuple[EarlyResponse, list[tuple[float, Array]]] | None:
        """The data about the onset, and the places of one load that they tell; None where nothing begins."""
        posed, grid = self.posed, self.grid
        early = early_response(posed.y, None if posed.sigma is None else posed.sigma**2)
        if early is None:
            return None
        return early, early_places(early, grid.places[:, grid.used], posed.h, posed.whitened, self.box, grid.spacing)

    def _record(self, samples: int) -> Callable[[Array], WhitenedRecord]:
        heard, ones = self.over(samples), np.ones(len(self.posed.data.rows))

        def record(at: Array) -> WhitenedRecord:
            moved = self.system(at)
            assert moved is not None
            return heard(moved, ones)

        return record


def by_evidence(
    posed: LocationProblem, grid: Grid, found: Array, residual_to_noise: float | None,
    rivals: Sequence[tuple[int, Array]], stated: Mapping[str, float], hold: str | None,
) -> Placed | None:  # fmt: skip
    """Places of hits from those found by residuals; None where the record asks for no hits, or the model has no states.

    Where errors of the model hide a single hit in the whole record, the first part of its response places it.

    Parameters
    ----------
    posed : LocationProblem
    grid : Grid
    found : array, shape (loads, used coordinates)
    residual_to_noise : float or None
        Of the places found.
    rivals : sequence of (load, place)
        Other places of single loads.
    stated : mapping of str to float
        Relative std of errors of the model.
    hold : str or None
    """
    problem, samples = HitProblem(posed, grid, hold), len(posed.data.values)
    if samples > LONGEST or not posed.candidates.at(found).gives("state_space"):
        return None
    system = problem.system(found)
    if system is None or system.moving or len(system.A) > MOST:
        return None
    wrong = residual_to_noise is None or residual_to_noise > NEAR
    first = problem.early() if wrong and len(found) == 1 else None
    starts = list(_starts(found, grid.spacing, rivals))
    if first is not None:
        starts = [*(place[None] for _, place in first[1]), *starts]
    best = problem.found(starts, samples, early=False)
    if first is not None and (best is None or best.prior.misfit > UNKNOWN):
        early, told = first
        samples = early.onset + AFTER
        sooner = problem.found([place[None] for _, place in told], samples, early=True)
        if sooner is not None:
            beside = _rivals(posed, early, told, sooner.place, grid)
            told_by = "first part of its response", beside, sooner.prior.misfit
            return Placed(*problem.placed(sooner, samples, stated), *told_by)
    return None if best is None else Placed(*problem.placed(best, samples, stated), "evidence of hits")


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
