"""From a candidate to the place between candidates by Gauss-Newton, and several loads that act at once.

Variable projection (Golub & Pereyra, SIAM J. Numer. Anal. 10 (1973) 413; Kaufman, BIT 15 (1975) 49, for the Jacobian)
of the Tikhonov objective: the histories are fitted anew at every place, and ``-(I - P) dH/dx g`` is what a step of the
place does to the remainder.

Two starts, and the better one improved: group orthogonal matching pursuit (Eldar, Kuppinger & Boelcskei, IEEE Trans.
Signal Process. 58 (2010) 3042), and the best combination of the groups that the group lasso (Yuan & Lin, J. R. Stat.
Soc. B 68 (2006) 49) puts first. Then single groups are exchanged until none lowers the objective of the joint fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..convolution import Convolution
from .fits import FittedHistory, HistoryFit, norm

Array = NDArray[np.float64]
STEPS = 12
TRIED = 3  # steps before a start is given up as hopeless
LONGEST = 0.5  # step of a place, in spacings of the candidates
SETTLED = 1e-4  # step below which the place stands, in spacings
DIFFERENCE = 1e-3  # step of the differences of the impulse responses, in spacings
HALVINGS = 6
PROBES = 12  # draws of noise from which its share of the curvature is estimated


@dataclass(frozen=True)
class Refined:
    """Places with their histories at the minimum of the objective.

    Parameters
    ----------
    place : array, shape (loads, dim)
    fitted : FittedHistory
    curvature : array, shape (loads * dim, loads * dim)
        Upper triangular R: ``R^T R`` is the curvature of half the objective over the places.
    noise, scaled : callable
        Make `chance` and `gains`, which cost as much as the search and are asked of the winner alone.
    edge : bool
        A place came to rest on the bounds.
    settled : bool
        The steps came to rest.
    """

    place: Array
    fitted: FittedHistory
    curvature: Array
    noise: Callable[[], Array]
    scaled: Callable[[], Array]
    edge: bool
    settled: bool

    @cached_property
    def chance(self) -> Array:
        """Curvature that noise of unit level makes by itself: the histories that it feigns are moved too."""
        return self.noise()

    @cached_property
    def gains(self) -> Array:
        """What the data of each sensor add to the slope of half the objective, (loads * dim, sensors)."""
        return self.scaled()

    @property
    def objective(self) -> float:
        """Squared residual plus penalty."""
        return float(np.sum(self.fitted.remainder**2))

    def covariance(self, sigma: float, gain: float = 0.0) -> Array:
        """Covariance of the places (loads, dim, dim) at noise level `sigma`; infinite where the data tell nothing.

        With A the curvature and S what is left of it without the share of the noise, the slope of the objective at the
        true place scatters by ``sigma^2 A``, and the place by ``sigma^2 S^-1 A S^-1``. Sensors whose gains are off by
        independent errors of this relative std move it by ``S^-1`` times what each adds to the slope.
        """
        loads, dim = self.place.shape
        signal = np.einsum("ki,kj->ij", self.curvature, self.curvature) - sigma**2 * self.chance
        low, high = np.linalg.eigvalsh(signal)[[0, -1]]
        if low <= 1e-12 * max(high, np.finfo(float).tiny):
            return np.full((loads, dim, dim), np.inf)
        moved = [sigma * self.curvature.T, *([gain * self.gains] if gain else [])]
        half = np.linalg.solve(signal, np.hstack(moved))
        full = (half @ half.T).reshape(loads, dim, loads, dim)
        return np.array([full[k, :, k] for k in range(loads)])


def refine(
    start: Array, y: Array, lam: Array, responses: Callable[[Array], Array],
    fit: Callable[[Array, Array], HistoryFit], bounds: tuple[Array, Array], spacing: float, *,
    hopeless: float | None = None,
) -> Refined:  # fmt: skip
    """Refine the places of loads that act at once.

    Parameters
    ----------
    start : array, shape (loads, dim)
    y : array, shape (samples, sensors)
        Whitened data.
    lam : array, shape (loads,)
        Absolute lambda of each load.
    responses : callable
        Places (n, dim) -> whitened impulse responses (samples, sensors, n).
    fit : callable
        Impulse responses and lambda -> HistoryFit.
    bounds : (low, high), arrays of shape (dim,)
        Box that holds the places.
    spacing : float
        Of the candidates.
    hopeless : float, optional
        Objective above which the search is given up after a few steps.
    """
    loads, dim = start.shape
    place, settled = np.clip(start, *bounds), False
    model = _at(place, responses, spacing, bounds)
    solver = fit(model.h, lam)
    fitted = solver.solve(y)
    for step_number in range(STEPS):
        if hopeless is not None and step_number >= TRIED and np.sum(fitted.remainder**2) > hopeless:
            break
        J = _jacobian(model, solver, fitted)
        step = np.linalg.lstsq(J, -fitted.remainder, rcond=None)[0].reshape(loads, dim)
        step *= min(1.0, LONGEST * spacing / max(float(np.abs(step).max()), np.finfo(float).tiny))
        taken = 0.0
        for _ in range(HALVINGS):
            trial = np.clip(place + step, *bounds)
            taken = float(np.abs(trial - place).max())
            if taken < SETTLED * spacing:
                break
            new = _at(trial, responses, spacing, bounds)
            other = fit(new.h, lam)
            better = other.solve(y)
            if np.sum(better.remainder**2) < np.sum(fitted.remainder**2):
                place, model, solver, fitted = trial, new, other, better
                break
            step, taken = step / 2, 0.0
        if taken < SETTLED * spacing:
            settled = True
            break
    J = _jacobian(model, solver, fitted)
    curvature = np.asarray(np.linalg.qr(J, mode="r"))
    edge = bool(np.any((place <= bounds[0]) | (place >= bounds[1])))
    return Refined(
        place, fitted, curvature, partial(_chance, model, solver, y.shape), partial(_gains, J, solver, y), edge, settled
    )


@dataclass(frozen=True)
class _Model:
    """Impulse responses at the places (samples, sensors, loads), and their slopes (..., loads, dim)."""

    h: Array
    slope: Array


def _at(place: Array, responses: Callable[[Array], Array], spacing: float, bounds: tuple[Array, Array]) -> _Model:
    """Responses at the places and central differences around them, one-sided at the bounds."""
    loads, dim = place.shape
    step = DIFFERENCE * spacing * np.eye(dim)
    ahead = np.clip(place[:, None] + step, *bounds)
    behind = np.clip(place[:, None] - step, *bounds)
    h = responses(np.concatenate([place, ahead.reshape(-1, dim), behind.reshape(-1, dim)]))
    moved = h[..., loads:].reshape(*h.shape[:2], 2, loads, dim)
    width = np.einsum("ldd->ld", ahead - behind)
    return _Model(h[..., :loads], (moved[:, :, 0] - moved[:, :, 1]) / width)


def _jacobian(model: _Model, solver: HistoryFit, fitted: FittedHistory) -> Array:
    """Change of the remainder with each coordinate of each load, (remainder, loads * dim)."""
    _, _, loads, dim = model.slope.shape
    columns = []
    for k in range(loads):
        for d in range(dim):
            change = Convolution(model.slope[:, :, k, d, None]).apply(fitted.load[:, k, None])
            columns.append(-solver.solve(change).remainder)
    return np.column_stack(columns)


def _chance(model: _Model, solver: HistoryFit, shape: tuple[int, ...]) -> Array:
    """Curvature that unit noise makes by itself, over a few draws of it (fixed, so that two runs agree)."""
    rng = np.random.default_rng(0)
    draws = [_jacobian(model, solver, solver.solve(rng.standard_normal(shape))) for _ in range(PROBES)]
    return np.asarray(np.mean([np.einsum("ki,kj->ij", J, J) for J in draws], axis=0))


def _gains(J: Array, solver: HistoryFit, y: Array) -> Array:
    """See `Refined.gains`: the remainder is linear in the data."""
    own = (np.where(np.arange(y.shape[1]) == s, y, 0.0) for s in range(y.shape[1]))
    return np.column_stack([J.T @ solver.solve(one).remainder for one in own])


SHORTLIST = 5  # candidates that a single fit of the remainder puts first, and that are fitted jointly
POOL = 6  # groups of the lasso whose combinations are fitted
COMBINED = 20  # combinations at most
SWEEPS = 6
SHARE = 0.01  # of the weight of the lasso at which every group is zero: small, so that no group is missed
MOST_STEPS = 300


@dataclass(frozen=True)
class CandidateSet:
    """Candidates that act together.

    Parameters
    ----------
    indices : tuple of int
    fitted : FittedHistory
        Their joint fit.
    scores : array, shape (loads, candidates)
        Squared residual of a single fit of each candidate to the data less the responses of the other loads.
    """

    indices: tuple[int, ...]
    fitted: FittedHistory
    scores: Array


class Joint:
    """Joint fits of one set of data, each made once.

    Parameters
    ----------
    y : array, shape (samples, sensors)
        Whitened data.
    h : array, shape (samples, sensors, candidates)
        Whitened impulse responses, each over its lambda.
    singles : sequence of HistoryFit
        One for each candidate.
    joint : callable
        Indices -> fit of these candidates together.
    """

    def __init__(
        self, y: Array, h: Array, singles: Sequence[HistoryFit], joint: Callable[[Sequence[int]], HistoryFit]
    ) -> None:
        self.y, self.h, self.singles, self._joint = y, h, singles, joint
        self._known: dict[tuple[int, ...], FittedHistory] = {}

    def fitted(self, indices: Sequence[int]) -> FittedHistory:
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


def together(problem: Joint, count: int) -> CandidateSet:
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
    return CandidateSet(key, final, np.array(scores))


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
    mu = share * float(np.linalg.norm(operator.apply_transposed(y), axis=0).max())
    x = z = np.zeros((operator.samples, operator.loads))
    pace = 1.0
    for _ in range(MOST_STEPS):
        g = z - operator.apply_transposed(operator.apply(z) - y) / bound
        size = np.linalg.norm(g, axis=0)
        new = g * np.maximum(1 - mu / bound / np.maximum(size, np.finfo(float).tiny), 0.0)
        if np.sum((z - new) * (new - x)) > 0:  # the momentum points uphill
            pace = 1.0
        faster = (1 + np.sqrt(1 + 4 * pace**2)) / 2
        x, z, pace = new, new + (pace - 1) / faster * (new - x), faster
    return np.asarray(np.linalg.norm(x, axis=0))


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


def _responses(problem: Joint, key: Sequence[int], final: FittedHistory) -> Array:
    """Response of each load alone, (loads, samples, sensors); `h` is over lambda, its history times lambda."""
    scaled = final.penalty.reshape(-1, len(key))  # -lambda g
    return np.array([Convolution(problem.h[:, :, j, None]).apply(-scaled[:, i, None]) for i, j in enumerate(key)])
