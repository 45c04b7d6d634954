"""Several loads that act at once: few of many groups of unknowns, each group the history of one candidate.

Two starts, and the better one improved: group orthogonal matching pursuit (Eldar, Kuppinger & Boelcskei, IEEE Trans.
Signal Process. 58 (2010) 3042), and the best combination of the groups that the group lasso (Yuan & Lin, J. R. Stat.
Soc. B 68 (2006) 49) puts first. Then single groups are exchanged until none lowers the objective of the joint fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..convolution import Convolution
from .fits import Fit, Fitted, norm

Array = NDArray[np.float64]
SHORTLIST = 5  # candidates that a single fit of the remainder puts first, and that are fitted jointly
POOL = 6  # groups of the lasso whose combinations are fitted
COMBINED = 20  # combinations at most
SWEEPS = 6
SHARE = 0.01  # of the weight of the lasso at which every group is zero: small, so that no group is missed
STEPS = 300


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


class Joint:
    """Joint fits of one set of data, each made once.

    Parameters
    ----------
    y : array, shape (samples, sensors)
        Whitened data.
    h : array, shape (samples, sensors, candidates)
        Whitened impulse responses, each over its lambda.
    singles : sequence of Fit
        One for each candidate.
    joint : callable
        Indices -> fit of these candidates together.
    """

    def __init__(self, y: Array, h: Array, singles: Sequence[Fit], joint: Callable[[Sequence[int]], Fit]) -> None:
        self.y, self.h, self.singles, self._joint = y, h, singles, joint
        self._known: dict[tuple[int, ...], Fitted] = {}

    def fitted(self, indices: Sequence[int]) -> Fitted:
        """Joint fit of some candidates, in ascending order."""
        key = tuple(sorted(indices))
        if key not in self._known:
            self._known[key] = self._joint(key).solve(self.y)
        return self._known[key]

    def objective(self, indices: Sequence[int]) -> float:
        """Squared residual plus penalty."""
        return float(np.sum(self.fitted(indices).remainder ** 2))

    def shortlist(self, others: Sequence[int]) -> list[int]:
        """Candidates that explain best what a fit of the others leaves."""
        rest = self.fitted(others).residual if others else self.y
        left = [float(np.sum(f.solve(rest).remainder ** 2)) for f in self.singles]
        return [int(j) for j in np.argsort(left, kind="stable") if j not in others][:SHORTLIST]


def together(problem: Joint, count: int) -> Chosen:
    """The `count` candidates whose joint fit leaves the smallest objective, as far as the exchanges tell."""
    starts = [_greedy(problem, count), *_combined(problem, count)]
    chosen = _exchanged(problem, min(starts, key=problem.objective))
    key = tuple(sorted(chosen))
    final = problem.fitted(key)
    response = _responses(problem, key, final)
    scores = [
        [f.solve(problem.y - response.sum(axis=0) + response[k]).residual2 for f in problem.singles]
        for k in range(count)
    ]
    return Chosen(key, final, np.array(scores))


def group_norms(h: Array, y: Array, share: float = SHARE) -> Array:
    """Norms of the groups of ``1/2 |H x - y|^2 + mu sum_j |x_j|``, one group per candidate, (candidates,).

    Accelerated proximal gradients with restart (Beck & Teboulle, SIAM J. Imaging Sci. 2 (2009) 183); a ranking, not the
    last digits.

    Parameters
    ----------
    h : array, shape (samples, sensors, candidates)
    y : array, shape (samples, sensors)
    share : float
        mu over the one at which every group is zero.
    """
    operator = Convolution(h)
    bound = 1.01 * norm(operator) ** 2
    mu = share * float(np.linalg.norm(operator.adjoint(y), axis=0).max())
    x = z = np.zeros((operator.samples, operator.loads))
    pace = 1.0
    for _ in range(STEPS):
        g = z - operator.adjoint(operator.apply(z) - y) / bound
        size = np.linalg.norm(g, axis=0)
        new = g * np.maximum(1 - mu / bound / np.maximum(size, np.finfo(float).tiny), 0.0)
        if np.sum((z - new) * (new - x)) > 0:  # the momentum points uphill
            pace = 1.0
        faster = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        x, z, pace = new, new + (pace - 1) / faster * (new - x), faster
    return np.linalg.norm(x, axis=0)


def _greedy(problem: Joint, count: int) -> list[int]:
    chosen: list[int] = []
    for _ in range(count):
        chosen = min(([*chosen, j] for j in problem.shortlist(chosen)), key=problem.objective)
    return chosen


def _combined(problem: Joint, count: int) -> list[list[int]]:
    """Combinations of the groups that the lasso puts first."""
    order = np.argsort(-group_norms(problem.h, problem.y), kind="stable")
    pool = [int(j) for j in order[: max(POOL, count)]]
    return [list(c) for c in combinations(pool, count)][:COMBINED]


def _exchanged(problem: Joint, chosen: list[int]) -> list[int]:
    for _ in range(SWEEPS):
        before = problem.objective(chosen)
        for _ in chosen:
            first, *others = chosen
            chosen = min(([*others, j] for j in {*problem.shortlist(others), first}), key=problem.objective)
        if problem.objective(chosen) >= before:
            break
    return chosen


def _responses(problem: Joint, key: Sequence[int], final: Fitted) -> Array:
    """Response of each load alone, (loads, samples, sensors); `h` is over lambda, its history times lambda."""
    scaled = final.penalty.reshape(-1, len(key))  # -lambda g
    return np.array([Convolution(problem.h[:, :, j, None]).apply(-scaled[:, i, None]) for i, j in enumerate(key)])
