"""The place of hits by their evidence, over the states of a model whose loads can be put anywhere."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._models.statespace import StateSpace

from ..._inverse.gaussian.record import WhitenedRecord, augment, measured
from ..._inverse.local_place import evident_place
from .locating import Grid, LocationProblem
from .model_errors import nuisances
from .paths import MOST, state_space_of

Array = NDArray[np.float64]
LONGEST = 8192  # samples over states
BESIDE = (-1.0, -0.5, 0.5, 1.0)  # spacings from the best, of further starts


@dataclass(frozen=True, eq=False)
class Placed:
    """Places (loads, used coordinates), their second moments (loads, used, used), and whether one is on the rim."""

    place: Array
    covariance: Array
    edge: bool


def by_evidence(
    posed: LocationProblem, grid: Grid, found: Array, rivals: Sequence[tuple[int, Array]], stated: Mapping[str, float],
    hold: str | None,
) -> Placed | None:  # fmt: skip
    """Places of hits from those found by residuals; None where the record asks for no hits, or the model has no states.

    Parameters
    ----------
    posed : LocationProblem
    grid : Grid
    found : array, shape (loads, used coordinates)
    rivals : sequence of (load, place)
        Other places of single loads.
    stated : mapping of str to float
        Relative std of errors of the model.
    hold : str or None
    """
    data, level, candidates = posed.data, posed.noise.level, posed.candidates
    first = candidates.at(found)
    if len(data.values) > LONGEST or not first.gives("state_space"):
        return None
    system = state_space_of(first, data.dt, hold)
    if system is None or system.moving or len(system.A) > MOST:
        return None

    def heard(one: StateSpace, factors: Array) -> WhitenedRecord:
        rows, scale = data.rows, factors[:, None]
        return measured(augment(one.A, one.B, one.C[rows] * scale, one.D[rows] * scale), data.values, level)

    def record(at: Array) -> WhitenedRecord:
        moved = state_space_of(candidates.at(at), data.dt, hold)
        assert moved is not None
        return heard(moved, np.ones(len(data.rows)))

    box = np.stack(grid.bounds, axis=1)
    starts = [np.clip(one, box[:, 0], box[:, 1]) for one in _starts(found, grid.spacing, rivals)]
    best = evident_place(starts, record, box, grid.spacing, stated=posed.noise.known)
    if best is None:
        return None
    model = candidates.at(best.place)
    there = state_space_of(model, data.dt, hold)
    assert there is not None
    wrong = nuisances(model, there, data.rows, stated, True, heard)
    return Placed(best.place, best.covariance(record, wrong, box, grid.spacing), best.edge)


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
