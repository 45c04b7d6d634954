"""How static readings and a transfer matrix become a problem with a path; draws, and whether all is determined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Spelling
from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model
from structures.errors import InputError

from ... import _guards as guards
from ..._inverse import marginal
from ..._inverse import sweep as whiteness
from ..._inverse.choice import Choice, choose
from ..._inverse.constrained.path import ConstrainedPath
from ..._inverse.constrained.solver import ConstrainedSolution, ConstrainedSolver, soft
from ..._inverse.diagnosis import diagnose, identifiability
from ..._inverse.path import Solution
from ..._inverse.problem import NOT_KNOWN, LinearProblem, whiten
from ..._inverse.svd import SVDPath
from ...constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from ...settings import Noise
from .. import noise as noises
from ..data import Readings
from ..noise import noise_level

if TYPE_CHECKING:
    pass

DRAWS = 100  # loads of which a band under constraints is made: its std is right to 7 %
MODEL, CHANCE = 0.03, 0.01  # relative error that every model has; of noise that leaves so little without constraints
EASED = 0.1  # of the lambda at which a free load explains the data: there the prior no longer holds the load down
MOST_DRAWN = 400  # values beyond which they would take too long


@dataclass(frozen=True)
class StaticProblem:
    """A static problem as posed.

    Parameters
    ----------
    H : array, shape (used sensors, loads)
        Transfer matrix in the units of the sensors.
    base : SVDPath
        Path of the problem without its constraints.
    path : RegularizationPath
        With them.
    noise : NoiseLevel
    full : (kappa, rank, nullity) or None
        Conditioning with all sensors of the model, where only some are used.
    channels : tuple of Channel
        The used sensors.
    """

    H: NDArray[np.float64]
    base: SVDPath
    path: Any
    noise: noises.NoiseLevel
    full: tuple[float, int, int] | None
    channels: tuple[Channel, ...]

    @property
    def constrained(self) -> bool:
        """Whether there are constraints."""
        return self.path is not self.base

    @property
    def rank(self) -> int:
        """Rank of the whitened transfer matrix."""
        return self.base.rank

    @property
    def layout(self) -> tuple[float, int, int]:
        """Condition number of the visible part, rank and nullity."""
        return identifiability.layout(self.base.singular_values, self.H.shape[1])

    @property
    def solved_by(self) -> str:
        """Which path it is."""
        first = "SVD" if self.base.problem.L is None else "generalised SVD"
        return f"{first}, then constraints by active sets" if self.constrained else first

    def level(self, choice: Choice, sigma: float) -> float | None:
        """The noise level `sigma` where somebody stated it and the readings do not contradict."""
        return sigma if self.noise.known and choice.shown is None else None

    def solution(self, choice: Choice, sigma: float, *, chosen: bool) -> Solution:
        """Load with its posterior: over all lambdas by their evidence where it was `chosen` from the readings.

        Under constraints the band is that of draws, where these are no more than a few seconds' work.
        """
        lam, level = choice.lam, self.level(choice, sigma)
        found: Solution = self.path.solution(lam, sigma)
        if self.drawn:
            draws = marginal.draws(self.path, level if chosen else sigma, DRAWS, seed=0, lam=None if chosen else lam)
            return replace(found, posterior=marginal.about(found.load, draws, found.posterior))
        if self.constrained or not (chosen and self.base.smooth and sigma > 0):
            return found
        return replace(found, posterior=marginal.posterior(self.base, lam, level))

    @property
    def drawn(self) -> bool:
        """Whether the band is that of draws under the constraints."""
        return self.constrained and self.path.problem.H.shape[1] * (self.path.problem.frames or 1) <= MOST_DRAWN

    def band(self, chosen: bool) -> str:
        """What the band holds, in words."""
        if self.drawn:
            return "noise and prior under the constraints, by draws; a load that does not fit the prior may lie outside"
        if self.constrained:
            return (
                "noise and prior on the active face of the constraints: an active-set approximation; a load that a "
                "constraint holds shows no spread, which does not say that it is known"
            )
        if not self.base.smooth:
            return "noise only: what the cut-off leaves out is not in the band"
        over = " at every lambda, by its evidence" if chosen else ""
        return f"noise and Gaussian prior{over}; a load that does not fit the prior may lie outside"

    @property
    def soft(self) -> bool:
        """Whether measured resultants weigh against the readings."""
        return self.constrained and bool(soft(self.path.constraints))

    @property
    def correlated(self) -> Flag | None:
        """W203 of the noise covariance."""
        R = self.noise.level
        if not self.noise.known or not isinstance(R, np.ndarray) or R.ndim == 1:
            return None
        size = np.sqrt(np.diag(R))
        found = whiteness.effective_number(np.eye(len(R)), R / size / size[:, None])
        return guards.interpolated(found.nominal, found.effective, found.rank, self.base.problem.dropped)

    def facts(self, solution: Solution, diagnosis: diagnose.Diagnosis, *, chosen: bool) -> dict[str, Any]:
        """What is known of a solution beyond what its path tells."""
        load = solution.load
        expected = getattr(solution.posterior, "expected", None)
        return {
            **({} if expected is None else {"expected_error": expected}),
            "path": self.solved_by, "m": len(self.H), "n": self.H.shape[1], "band": self.band(chosen),
            "frames": 1 if load.ndim == 1 else len(load), "noise_share": _noise_share(solution.posterior, load),
            "resolution": diagnosis.width, "resolution_unit": diagnosis.width_unit, "peak_bias": diagnosis.peak_bias,
        }  # fmt: skip

    def fought(self, choice: Choice, sigma: float) -> list[Flag | None]:
        """What the constraints did: W308 where they fight the data, W410 where the solver ended on its limit.

        A lambda that was chosen under constraints that are wrong is large, and hides what they do: they are judged
        where the load without them explains the data.
        """
        if not self.constrained:
            return []
        solution, lam, level = self.path.solve(choice.lam), *self._explained(choice)
        judged = solution if lam >= choice.lam else self.path.solve(lam)
        return [
            guards.fighting(judged, self.path.constraints, level, self.path.m),
            guards.stopped(solution, sigma, self.path.m),
        ]

    def _explained(self, choice: Choice) -> tuple[float, float]:
        """Lambda at which the data are explained without constraints, and the noise level that says so.

        Of noise that nobody stated: what the fit without constraints leaves may be this little by chance, and errors of
        the model leave some of the response.
        """
        free, sigma = self.path.unconstrained, self.noise.sigma
        if sigma is None:
            own = choose(free)
            error = MODEL * float(np.sqrt(np.mean(free.problem.y**2)))
            return min(choice.lam, EASED * own.lam), max(_noise_at_most(free, own.lam), error)
        low, high = free.range
        lam = np.geomspace(low, high, 40)
        good = lam[np.asarray(free.at(lam).residual2) <= sigma**2 * free.m]
        return min(choice.lam, EASED * float(good[-1]) if len(good) else choice.lam), sigma

    @property
    def whitening(self) -> NDArray[np.float64]:
        """Matrix that whitens readings."""
        return whiten(np.eye(len(self.H)), self.noise.level, axis=0)

    def inverse(self, lam: float) -> NDArray[np.float64]:
        """Regularised inverse (loads, sensors) of readings in their own units, without constraints."""
        return self.base.inverse(lam) @ self.whitening

    def solver(self, lam: float) -> Callable[..., NDArray[np.float64]]:
        """Solver of one reading after another under the constraints, each started from the one before."""
        return _Warm(self.path.prepare(lam), self.whitening)


@dataclass(eq=False)
class _Warm:
    """A solver that starts each reading (sensors,) from the solution of the one before."""

    prepared: ConstrainedSolver
    whitening: NDArray[np.float64]
    last: ConstrainedSolution | None = None

    def __call__(self, y: NDArray[np.float64], resultants: Sequence[ArrayLike] | None = None) -> NDArray[np.float64]:
        found = self.prepared.solve(self.whitening @ y, warm=self.last, resultants=resultants)
        self.last = found
        return np.asarray(found.load)


def transfer(model: Model, allow: Sequence[str]) -> NDArray[np.float64]:
    """Static transfer matrix of a model, checked.

    Raises
    ------
    InputError
        If it has no coupling at all (LID-E102): each sensor would paint force where there is motion.
    """
    H = np.asarray(model.static(), float)
    refusal = guards.diagonal(H)
    if refusal is not None and "LID-E102" not in allow:
        raise refusal
    return H


def pose(
    model: Model,
    given: Readings,
    *,
    H: NDArray[np.float64],
    L: NDArray[np.float64] | None,
    truncated: bool,
    constraints: Sequence[Any],
    noise: Noise,
) -> StaticProblem:
    """Whiten, factorise, constrain.

    Raises
    ------
    InputError
        A sensor that no load moves, noise that does not fit, constraints that do not fit.
    NotIdentifiable
        Loads that neither the sensors nor the penalty see.
    """
    rows = H[given.rows]
    _refuse_silent(rows, given.channels)
    level = noises.steady(noise, model, given)
    y = given.values[0] if given.axis is None else given.values
    labels = [c.label for c in model.loads]
    base = SVDPath(LinearProblem.whitened(rows, y, level.level, L), truncated=truncated, labels=labels)
    path = ConstrainedPath(base, constraints, sigma=level.sigma or _shown(base)) if constraints else base
    full = None
    if len(rows) < len(H):
        scale = np.sqrt(np.mean(H**2, axis=1))
        seen = H[scale > 0] / scale[scale > 0, None]
        full = identifiability.layout(np.linalg.svd(seen, compute_uv=False), H.shape[1])
    return StaticProblem(rows, base, path, level, full, given.channels)


def _noise_at_most(path: SVDPath, lam: float) -> float:
    """Noise level that leaves a residual as small as this one with a chance of `CHANCE`."""
    from scipy.special import gammaincinv

    point = path.at(lam)
    assert point.left is not None
    least = 2 * float(gammaincinv(float(point.left) / 2, CHANCE))
    return float(np.sqrt(point.residual2 / least)) if least > 0 else np.inf


def _shown(base: SVDPath) -> float:
    """Noise level that the data show without constraints: what soft resultants weigh against if nobody stated it."""
    return noise_level(base, choose(base), noises.NoiseLevel(None, False, NOT_KNOWN)) or 1.0


def _refuse_silent(H: NDArray[np.float64], channels: Sequence[Channel]) -> None:
    """Rows of zeros: what such a sensor reads is no answer to any load."""
    silent = [c.label for c, row in zip(channels, H, strict=True) if not np.any(row)]
    if silent:
        other = "leave them out (", Spelling("sensors=[...]", "--sensors"), ")"
        if len(silent) == len(channels):
            other = "ask for a history (", Spelling("Deconvolution", "--family deconvolution"), ")"
        raise InputError(
            f"{len(silent)} sensor{'s see' if len(silent) > 1 else ' sees'} no static load", where="transfer matrix",
            found=", ".join(silent[:8]) + (", ..." if len(silent) > 8 else ""),
            expected="strains or displacements that a load moves",
            hint=Advice(*other, "; velocity, acceleration and AC-coupled sensors see no constant load"),
        )  # fmt: skip


def drawn(
    posed: StaticProblem, choice: Choice, sigma: float, draws: int, seed: int, *, chosen: bool
) -> NDArray[np.float64]:
    """See `StaticInversion.sample`.

    Raises
    ------
    InputError
        If the number of draws is no positive integer.
    """
    if isinstance(draws, bool) or not isinstance(draws, int | np.integer) or draws < 1:
        raise InputError("no number of draws", where="sample", found=repr(draws)[:40], expected="a positive integer")
    if chosen and posed.base.smooth:
        return marginal.draws(posed.path, posed.level(choice, sigma), int(draws), seed=seed)
    return marginal.draws(posed.path, sigma, int(draws), seed=seed, lam=choice.lam)


def _noise_share(posterior: Any, load: NDArray[np.float64]) -> float | None:
    """Share of the variance of the largest load that is noise; None where the posterior does not tell."""
    noise = getattr(posterior, "noise_std", None)
    if noise is None:
        return None
    at = np.unravel_index(int(np.argmax(np.abs(load))), load.shape)
    noise, std = np.broadcast_to(noise, load.shape), np.broadcast_to(posterior.std, load.shape)
    return float((noise[at] / std[at]) ** 2) if std[at] > 0 else None


MEETING = float(np.sqrt(np.finfo(float).eps))  # of [H/|H|; L/|L|], below which no minimiser stands out
PUSH = 1e-9  # of the largest gradient at rest, below which a constraint holds a load by chance


def missing(posed: StaticProblem) -> int:
    """Load patterns that neither the readings nor the constraints fix without regularisation; 0 is what it must be.

    Resultants count as readings. A sign or a bound fixes a load only where the data push against it: a load that may
    move inside its bounds is bounded, not determined.
    """
    problem, n = posed.base.problem, posed.H.shape[1]
    rows, free = [problem.H / np.linalg.norm(problem.H)], np.ones(n, bool)
    solution = posed.path.solve(0.0)
    least = PUSH * float(np.max(np.abs(problem.H.T @ problem.y), initial=0.0))
    for c, push, active in zip(posed.path.constraints, solution.multipliers, solution.active, strict=True):
        if isinstance(c, Resultant):
            C = np.asarray(c.C, float)
            rows.append(C / np.linalg.norm(C, axis=1, keepdims=True))
        elif isinstance(c, Support):
            free &= np.isin(np.arange(n), np.asarray(c.loads))
        elif isinstance(c, NonNegative | Bounds):
            held = (np.asarray(active, bool) & (np.abs(push) > least)).reshape(-1, push.shape[-1]).all(axis=0)
            loads = np.arange(n) if c.loads is None else np.asarray(c.loads)
            free[loads[held]] = False
        elif isinstance(c, FrictionCone):
            contacts = np.asarray(c.contacts)
            is_open = (np.asarray(active) == 0).reshape(-1, len(contacts)).all(axis=0)
            free[contacts[is_open].ravel()] = False
    count = int(free.sum())
    return count - int(np.linalg.matrix_rank(np.vstack(rows)[:, free])) if count else 0
