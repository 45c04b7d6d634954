"""Several loads that act at once: few of many groups of unknowns, each group the history of one candidate.

Group orthogonal matching pursuit (Eldar, Kuppinger & Boelcskei, IEEE Trans. Signal Process. 58 (2010) 3042) with joint
fits, and exchanges until no single exchange lowers the objective: the best few groups as far as single exchanges tell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .fits import Fit, Fitted

Array = NDArray[np.float64]
SHORTLIST = 8  # candidates that a single fit of the remainder puts first, and that are fitted jointly
SWEEPS = 6


@dataclass(frozen=True)
class Chosen:
    """Candidates that act together.

    Parameters
    ----------
    indices : tuple of int
    fitted : Fitted
        Their joint fit.
    scores : array, shape (loads, candidates)
        Squared residual of a single fit of each candidate to the data less the responses of the other loads.
    """

    indices: tuple[int, ...]
    fitted: Fitted
    scores: Array


def together(
    y: Array,
    count: int,
    fits: Sequence[Fit],
    joint: Callable[[Sequence[int]], Fit],
    responses: Callable[[int, Array], Array],
) -> Chosen:
    """The `count` candidates whose joint fit leaves the smallest objective.

    Parameters
    ----------
    y : array, shape (samples, sensors)
        Whitened data.
    count : int
    fits : sequence of Fit
        One for each candidate.
    joint : callable
        Indices -> fit of these candidates together.
    responses : callable
        Index and history (samples,) -> response (samples, sensors).
    """
    known: dict[tuple[int, ...], Fitted] = {}

    def fitted(indices: Sequence[int]) -> Fitted:
        key = tuple(sorted(indices))
        if key not in known:
            known[key] = joint(key).solve(y)
        return known[key]

    def objective(indices: Sequence[int]) -> float:
        return float(np.sum(fitted(indices).remainder ** 2))

    def shortlist(others: Sequence[int]) -> list[int]:
        rest = fitted(others).residual if others else y
        order = np.argsort([float(np.sum(f.solve(rest).remainder ** 2)) for f in fits], kind="stable")
        return [int(j) for j in order if j not in others][:SHORTLIST]

    chosen: list[int] = []
    for _ in range(count):
        chosen = min(([*chosen, j] for j in shortlist(chosen)), key=objective)
    for _ in range(SWEEPS if count > 1 else 0):
        before = objective(chosen)
        for _ in range(count):
            first, *others = chosen
            chosen = min(([*others, j] for j in {*shortlist(others), first}), key=objective)
        if objective(chosen) >= before:
            break
    key = tuple(sorted(chosen))
    final = fitted(key)
    scores = []
    for k in range(count):
        others_said = sum((responses(j, final.load[:, i]) for i, j in enumerate(key) if i != k), np.zeros_like(y))
        scores.append([f.solve(y - others_said).residual2 for f in fits])
    return Chosen(key, final, np.array(scores))
