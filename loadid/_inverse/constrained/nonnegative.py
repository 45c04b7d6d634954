"""Non-negative Tikhonov of a record: ``min |H g - y|^2 + lambda^2 |L g|^2`` for loads that only push; its lambda.

The sign is knowledge about the load, so that less smoothing is needed than without it: at the lambda that a rule chose
without the sign, the residual of the constrained load exceeds the noise. Over lambda that residual rises monotonically.
On the half-sine benchmark (tests/benchmarks/nonnegative.py) the load error at this lambda is at most that at the lambda
of the unconstrained discrepancy, for every width of pulse and both noise levels. Its price: some more solutions.

    problem = NonNegativeRecord(path.record, signed)              # path: a StateSpacePath
    found = problem.solve(lam * float(path.scale))                # at the lambda that the path chose
    chosen = discrepancy(problem, found.lam, sigma, warm=found)   # where the noise level is known

The posterior std of the path without signs is an upper bound for loads that push, held or free
(`NonNegativeRecord.face_covariance` says why); the std of the face alone tells what noise does while the active set
stays, is 0 where a load is held, and is no confidence.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable

from ..convolution import PenalizedConvolution
from ..gaussian.record import WhitenedRecord
from ..rules import discrepancy_level
from .condensed import BlockNormal, CondensedRecord, FaceCovariance, cut, face_covariance
from .normal import ConvolvedNormal, Exchanged, NormalFactor, RecordNormal, exchange, gap, interior, projected

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

CONVERGED = 1e-6  # relative duality gap of a solution
ROUNDING = 1e-12  # gap at which loads that still change sides do so by rounding
PACE = 0.7  # loads on the wrong side must fall at this rate; else the interior-point method is faster
GRADIENTS = (1000, 3000, 9000)  # steps of the projected gradient before each exchange

Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class NonNegativeSolution:
    """Loads that push, with what shows that they are the minimum.

    Parameters
    ----------
    load : array, shape (samples, loads)
        >= 0 where signed; held loads are exactly 0.
    held : array of bool, shape (samples, loads)
        The active set: loads at 0 that would pull if they could.
    multiplier : array, shape (samples, loads)
        Half the derivative of the objective by a load: >= 0 where held, 0 where free.
    gap : float
        Objective minus a lower bound of its minimum, over ``|y|^2 / 2``; `exchange.gap` says how.
    converged : bool
        The gap is below 1e-6.
    steps : int
        Factorisations.
    solver : str
    residual2, penalty2 : float
        Squared norms of ``y - H g`` and of ``L g``.
    lam : float
        Absolute lambda.
    start : array
        States of the model and of the load at the first sample, those that were unknown.
    """

    load: Array
    held: Mask
    multiplier: Array
    gap: float
    converged: bool
    steps: int
    solver: str
    residual2: float
    penalty2: float
    lam: float
    start: Array


class NonNegativeRecord:
    """A record whose loads, or some of them, only push; solved at one lambda after another, each start warm.

    Parameters
    ----------
    record : WhitenedRecord
        Whitened data over a state space with its penalty (`loadid._inverse.gaussian.record`): several sensors and
        loads, missing data and an unknown start are in it. `NonNegativeRecord.convolved` takes impulse responses.
    signed : array of bool or of int, optional
        Loads that only push, as a mask (loads,) or their numbers; default all. The others take either sign.

    Raises
    ------
    InputError
        Numbers of loads that are not there.

    Attributes
    ----------
    m : int
        Number of data.
    signed : array of bool, shape (loads,)
    """

    def __init__(self, record: WhitenedRecord, signed: ArrayLike | None = None) -> None:
        self.blocks: CondensedRecord | None = cut(record)
        self._set(partial(BlockNormal, self.blocks), (record.samples, record.p), len(record.free), record.data, signed)

    @classmethod
    def convolved(
        cls, h: Array, y: Array, penalty: str = "identity", *, weight: Array | None = None,
        signed: ArrayLike | None = None,
    ) -> NonNegativeRecord:  # fmt: skip
        """A record behind impulse responses: the same answers by FFT products and conjugate gradients.

        Each step costs some tens to hundreds of products; where a state space is at hand it is much faster.

        Parameters
        ----------
        h : array, shape (taps, sensors, loads)
            Impulse responses, whitened.
        y : array, shape (samples, sensors)
            Whitened data.
        penalty : str
            Named penalty, ends free.
        weight : array, shape (samples, sensors), optional
            What each datum is multiplied by; 0 where it is missing (it may be NaN there).
        signed : array, optional
            As of the constructor.
        """
        used = np.ones(y.shape, bool) if weight is None else weight != 0
        data = np.where(used, y, 0.0) * (1.0 if weight is None else weight)
        if not np.all(np.isfinite(data)):
            raise InputError("NaN or inf in the data", where="loads that push", expected="finite numbers",
                             hint="weight 0 where a sample is missing")  # fmt: skip
        made = cls.__new__(cls)
        made.blocks = None
        operator = PenalizedConvolution(h, len(y), penalty, weight)
        made._set(
            partial(ConvolvedNormal, operator, data), (len(y), operator.loads), 0, int(np.count_nonzero(used)), signed
        )
        return made

    def _set(
        self, normal: Callable[[float], RecordNormal], shape: tuple[int, int], start: int, m: int,
        signed: ArrayLike | None,
    ) -> None:  # fmt: skip
        self.normal, self.shape, self.start, self.m = normal, shape, start, m
        self.signed = _loads(signed, shape[1])
        self._signed = np.concatenate([np.zeros(start, bool), np.tile(self.signed, shape[0])])

    def solve(
        self, lam: float, warm: NonNegativeSolution | None = None, progress: Progress | None = None
    ) -> NonNegativeSolution:
        """Solution at the absolute `lam`, from the active set of `warm` or of the unconstrained solution.

        Parameters
        ----------
        lam : float
            Absolute lambda, > 0: that which the unconstrained path chose will do (see `loadid._inverse.nonnegative`).
        warm : NonNegativeSolution, optional
            Of a lambda or of data nearby.
        progress : callable, optional
            Called as ``progress(fraction, text)``.

        Raises
        ------
        InputError
            A lambda that is not positive.
        NotIdentifiable
            If lambda is so small that the equations have no solution in these numbers.
        """
        if not (np.isfinite(lam) and lam > 0):
            raise InputError("no absolute lambda", where="lambda", found=lam, expected="a finite number > 0")
        normal, shape = self.normal(float(lam)), self.shape
        held = None if warm is None else np.concatenate([np.zeros(normal.start, bool), warm.held.reshape(-1)])
        found = minimise(normal, self._signed, held, progress)
        g = found.v[normal.start :]
        residual2, penalty2 = normal.norms(found.v)
        return NonNegativeSolution(
            g.reshape(shape), found.held[normal.start :].reshape(shape),
            np.where(found.held, np.maximum(found.gradient, 0.0), 0.0)[normal.start :].reshape(shape),
            found.gap, found.gap <= CONVERGED, found.steps, found.solver, residual2, penalty2, float(lam),
            found.v[: normal.start],
        )  # fmt: skip

    def face_covariance(self, lam: float, held: Mask | None = None) -> FaceCovariance:
        """Variance at unit noise and degrees of freedom with the `held` loads (samples, loads) held; None: none.

        With the held loads of a solution this is what noise moves while the active set stays as it is. Without any it
        is the posterior of the record without signs: cutting a Gaussian to a convex set lowers its covariance in every
        direction (Brascamp & Lieb, J. Funct. Anal. 22 (1976) 366), so that it bounds the spread of loads that push.

        Raises
        ------
        InputError
            Behind impulse responses: there is no covariance recursion.
        """
        if self.blocks is None:
            raise InputError(
                "no covariance behind impulse responses", where="loads that push", expected="a state space",
                hint="take the posterior of the path without signs: it is a bound",
            )  # fmt: skip
        normal = BlockNormal(self.blocks, float(lam))
        weight = np.zeros(normal.size)
        if held is not None:
            weight[normal.start :] = np.where(held.reshape(-1), np.inf, 0.0)
        return face_covariance(normal.factor(weight))


@dataclass(frozen=True, eq=False)
class Minimum:
    """Unknowns, gradient, held unknowns, relative duality gap, factorisations, and what solved it."""

    v: Array
    gradient: Array
    held: Mask
    gap: float
    steps: int
    solver: str


def minimise(normal: RecordNormal, signed: Mask, held: Mask | None = None, progress: Progress | None = None) -> Minimum:
    """Minimum of ``v^T Q v / 2 - q^T v`` with v >= 0 where `signed`.

    Loads change between free and held as long as that goes fast. Else an interior-point method (where factors are
    cheap) or a projected gradient finds the active set, and the exchange ends it with exact zeros. Of all points seen,
    that with the smallest gap is returned.
    """
    report, lower = _reporter(progress), np.where(signed, 0.0, -np.inf)
    unbounded, free = _unconstrained(normal)
    held = signed & (free < 0) if held is None else held & signed
    steps, found, solver = 0, list[Minimum](), "active set"
    pace, guesses = PACE if normal.direct else 1.0, _guesses(normal, signed, free, report)
    while True:
        end = exchange(normal, lower, None, held, step=report, pace=pace)
        steps += end.steps
        found.append(_certified(normal, unbounded, signed, end, steps, solver))
        if found[-1].gap <= (CONVERGED if end.settled else ROUNDING):
            break
        guess = next(guesses, None)
        if guess is None:
            break
        v, held, more, name = guess
        steps, pace, solver = steps + more, 1.0, f"{name}, active set"
        found.append(_certified(normal, unbounded, signed, Exchanged(v, v, held, False, 0), steps, name))
    return min(found, key=lambda m: m.gap)


def _guesses(
    normal: RecordNormal, signed: Mask, free: Array, report: Callable[[], None]
) -> Iterator[tuple[Array, Mask, int, str]]:
    """Points near the minimum, what they hold, their factorisations and what found them, one better than the other."""
    if normal.direct:
        inner = interior(normal, signed, free, report)
        held = signed & (inner.s * np.linalg.norm(inner.v) > inner.v * np.linalg.norm(inner.s))
        yield np.where(held, 0.0, inner.v), held, inner.steps, "interior point"
        return
    for count in GRADIENTS:
        free = projected(normal, signed, free, count, report)
        yield free, signed & (free == 0), 0, "projected gradient"


def _unconstrained(normal: RecordNormal) -> tuple[NormalFactor, Array]:
    """Factors of Q and the minimum without signs."""
    try:
        with np.errstate(all="ignore"):  # judged by what comes out
            factor = normal.factor()
            free = factor.solve(normal.q)
    except np.linalg.LinAlgError:
        free = np.array([np.nan])
    if not np.all(np.isfinite(free)):
        raise NotIdentifiable(
            "the normal equations cannot be solved in these numbers: lambda is too small",
            advice="take a larger lambda", code="LID-E306",
        )  # fmt: skip
    return factor, free


def _certified(
    normal: RecordNormal, free: NormalFactor, signed: Mask, found: Exchanged, steps: int, solver: str
) -> Minimum:
    """A point made admissible, with its gap; no load at all where rounding has made it none."""
    finite = bool(np.all(np.isfinite(found.v)))
    v = np.where(signed, np.maximum(found.v, 0.0), found.v) if finite else np.zeros(normal.size)
    gradient = found.gradient if found.settled and finite else normal.gradient(v)
    return Minimum(v, gradient, found.held, gap(normal, free, v, gradient, signed), steps, solver)


def _reporter(progress: Progress | None) -> Callable[[], None]:
    """Counts steps; how many there will be is not known, so that the fraction only approaches 1."""
    steps = 0

    def report() -> None:
        nonlocal steps
        steps += 1
        if progress is not None:
            progress(1 - 0.9**steps, f"loads that push, step {steps}")

    return report


def _loads(signed: ArrayLike | None, p: int) -> Mask:
    """Mask (loads,) of the loads that only push."""
    if signed is None:
        return np.ones(p, bool)
    given = np.atleast_1d(np.asarray(signed))
    if given.dtype == bool and given.shape == (p,):
        return given.copy()
    mask = np.zeros(p, bool)
    if (
        given.dtype == bool
        or given.ndim != 1
        or not np.issubdtype(given.dtype, np.integer)
        or np.any((given < 0) | (given >= p))
    ):
        raise InputError("these are no loads of the record", where="signed", found=signed,
                         expected=f"a mask ({p},), or numbers from 0 to {p - 1}")  # fmt: skip
    mask[given] = True
    return mask


STRIDE = 3.0  # between two lambdas until they bracket the noise
REACH = 1e3  # ratio to the first lambda beyond which nothing is searched
CLOSE = 0.2  # of the scatter of the residual: nearer need not be
CAP = 12  # solutions


@dataclass(frozen=True, eq=False)
class NonNegativeChoice:
    """Solution at the lambda that was found; `met` if its residual is that of the noise; every (lambda, residual^2)."""

    solution: NonNegativeSolution
    met: bool
    target: float
    tried: tuple[tuple[float, float], ...]


def discrepancy(
    record: NonNegativeRecord, lam: float, sigma: float, *, warm: NonNegativeSolution | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> NonNegativeChoice:  # fmt: skip
    """Largest lambda at which loads that push explain the data to the noise, with the margin of the unconstrained rule.

    Parameters
    ----------
    record : NonNegativeRecord
    lam : float
        Absolute lambda to begin with: the unconstrained choice.
    sigma : float
        Noise level of the whitened data.
    warm : NonNegativeSolution, optional
        Solution at or near `lam`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Returns
    -------
    NonNegativeChoice
        Where no lambda down to ``lam / 1000`` explains the data (loads that pull, a wrong model, a noise level that is
        too low), the solution at `lam` itself, with `met` False.

    Raises
    ------
    InputError
        No noise level.
    """
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError("no noise level", where="sigma", found=sigma, expected="a finite number > 0")
    target = discrepancy_level(record.m, sigma)
    close = CLOSE * np.sqrt(2 * record.m) * sigma**2
    found: list[NonNegativeSolution] = []

    def at(value: float) -> float:
        near = min(found, key=lambda s: abs(np.log(s.lam / value)), default=warm)
        report = None if progress is None else _part(progress, len(found))
        found.append(record.solve(value, near, report))
        return found[-1].residual2 - target

    a, fa = lam, at(lam)
    b, fb = a, fa
    while fa * fb > 0 and abs(fb) > close and len(found) < CAP and 1 / REACH < b / lam < REACH:
        a, fa = b, fb
        b = b / STRIDE if fb > 0 else b * STRIDE
        fb = at(b)
    if fa * fb > 0 and abs(fb) > close:
        explained = fb < 0  # even much smoothing leaves less than the noise
        return NonNegativeChoice(found[-1] if explained else found[0], explained, target, _tried(found))
    while min(abs(s.residual2 - target) for s in found) > close and len(found) < CAP:
        # regula falsi in ln lambda; the end that stays counts half (Illinois)
        middle = float(np.exp((np.log(a) * fb - np.log(b) * fa) / (fb - fa)))
        fm = at(middle)
        if fm * fb > 0:
            b, fb, fa = middle, fm, fa / 2
        else:
            a, fa, b, fb = b, fb, middle, fm
    best = min(found, key=lambda s: abs(s.residual2 - target))
    return NonNegativeChoice(best, True, target, _tried(found))


def _tried(found: list[NonNegativeSolution]) -> tuple[tuple[float, float], ...]:
    return tuple((s.lam, s.residual2) for s in found)


def _part(progress: Callable[[float, str], None], done: int) -> Callable[[float, str], None]:
    """Progress of one solution out of those that there may be."""
    return lambda fraction, text: progress((done + fraction) / CAP, text)
