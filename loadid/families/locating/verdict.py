"""What the residuals say: runner-up, noise level, other basins, rivals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inverse.locating.refine import Refined
from ...inverse.locating.several import Chosen
from ...location import Rival
from .grid import Grid
from .posed import Posed

Array = NDArray[np.float64]
Solution = tuple[Refined, str, int]  # refined place, candidate from which it started, load that was moved


@dataclass(frozen=True)
class Said:
    """What the candidates alone say: best, runner-up, and the ratio of their residual norms."""

    best: int
    runner_up: int
    ratio: float


def said(posed: Posed, chosen: Chosen) -> Said:
    """Of the load for which the runner-up comes closest."""
    found = []
    for best, scores in zip(chosen.indices, chosen.scores, strict=True):
        taken = [j for j in chosen.indices if j != best]
        others = np.array([np.inf if j in {best, *taken} else s for j, s in enumerate(scores)])
        second = int(np.argmin(others))
        floor = np.finfo(float).eps * float(np.linalg.norm(posed.y))  # data without noise may leave nothing
        ratio = max(np.sqrt(others[second]), floor) / max(np.sqrt(scores[best]), floor)
        found.append(Said(best, second, float(ratio)))
    return min(found, key=lambda s: s.ratio)


def noise_level(posed: Posed, residual2: float, chosen: Chosen) -> float:
    """Noise level of the whitened data: as stated, or what the fit leaves where that is more or nothing is stated."""
    spent = sum(posed.fits[j].edf for j in chosen.indices)
    left = float(np.sqrt(residual2 / max(posed.y.size - spent, 1.0)))
    return left if posed.sigma is None else max(left, posed.sigma)


def basins(scores: Array, near: NDArray, best: int) -> tuple[list[int], list[int]]:
    """Neighbours of the best, and local minima of the scores outside its neighbourhood; both best first."""
    lowest = np.array([np.min(scores[near[j]]) for j in range(len(scores))])
    order = [int(j) for j in np.argsort(scores, kind="stable") if j != best]
    return [j for j in order if near[best, j]], [j for j in order if not near[best, j] and scores[j] <= lowest[j]]


def rivals_of(solutions: list[Solution], winner: Refined, grid: Grid) -> tuple[Rival, ...]:
    """Solutions at another place than the winner, closest in residual first."""
    floor = np.finfo(float).tiny
    found = []
    for one, label, load in solutions:
        away = float(np.linalg.norm(one.place - winner.place, axis=1).max())
        if one is not winner and away > grid.spacing:
            ratio = np.sqrt(one.fitted.residual2 / max(winner.fitted.residual2, floor))
            place = tuple(float(v) for v in grid.full(one.place)[load])
            found.append(Rival(place, label, float(ratio), load))
    return tuple(sorted(found, key=lambda r: r.ratio))
