"""Which prior fits a record, which family carries it, and a way to run it; Gaussian processes by their evidence.

Every prior of the tracker gives the record a density, all its numbers at their most likely: the product of what the
filter expected of each sample. Priors compare by it, with a price for each number that was tuned; a white load is the
prior of Tikhonov, and stands among them.

Processes in time (the tracker's smoother; Tikhonov, whose load is white) and waveforms (spikes, B-splines) are compared
by what each makes of the record: the evidence of a process at its most likely numbers, the extended information
criterion of a dictionary on its best support. Both are minus twice a log-likelihood plus a price for what was chosen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures._threads import one_thread
from structures.errors import InputError, NotIdentifiable

from .._guards import families as told
from .._guards.choice import IMPULSIVE
from .._inverse import rules
from .._inverse.gaussian.records import log_density
from .._inverse.sparse.atoms import KNOTS
from .._inverse.sweep import Sweep
from .._record import Record
from .._results.estimate import LoadEstimate
from .._spellings import Progress, takes
from ..settings import Lambda, Noise, Penalty, Sparsity
from .data import Data, gather
from .deconvolution import Deconvolution
from .histories import half_width, kurtosis
from .kalman import LoadTracker
from .offsets import without_offsets
from .posing import PosingSettings
from .posing.sparsity import Problem, Wanted, amplitude_share, choose, pose, score
from .sparse import SparseDeconvolution
from .tracking.tracker import Tracker

Array = NDArray[Any]

NAMES = ("white", "random_walk", "ou", "matern32", "matern52")
FEW = ("white", "matern32", "matern52")  # where loads are many, as each has numbers of its own
MANY = 4  # loads

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Process:
    """A prior that was tuned to a record.

    Parameters
    ----------
    name : str
        As `LoadTracker` takes it.
    tracker : Tracker
    criterion : float
        ``-2 log p(record) + numbers log data``: smaller is better; natural units of the record, so that it compares
        with `of_sparse`.
    """

    name: str
    tracker: Tracker
    criterion: float


def _names(model: Model) -> tuple[str, ...]:
    return NAMES if len(model.loads) <= MANY else FEW


def compared(model: Model, data: Data, samples: int, settings: Mapping[str, Any], say: Say) -> dict[str, Process]:
    """Every prior that a tracker of this model carries, on the first samples of a record; empty where it carries none.

    Parameters
    ----------
    model : Model
    data : Data
    samples : int
        From the start of the record.
    settings : mapping
        Of `LoadTracker`.
    say : callable
        Told of each prior before it is tuned.
    """
    Y = np.where(data.missing, np.nan, data.values)[:samples]
    found: dict[str, Process] = {}
    for name in _names(model):
        say(f"a load that is {name.replace('_', ' ')}")
        try:
            tracker = LoadTracker(model, prior=name, gate=None, **settings).fit(Y, data.dt)
            found[name] = Process(name, tracker, _criterion(tracker, Y))
        except (
            InputError,
            NotIdentifiable,
        ):  # no state space, a walk that nobody sees, a record with holes: another prior, or none
            continue
    return found


def of_sparse(score: float, problem: Problem, samples: int) -> float:
    """An information criterion of `loadid._inverse.rules` in the units of a `Process`.

    Samples before the response begins hold noise alone, which costs what noise of the stated level costs.
    """
    level = np.broadcast_to(np.asarray(problem.noise.level, float), (problem.values.shape[1],))
    present = (~problem.missing[: problem.samples]).sum(axis=0)
    early = max(samples - problem.samples, 0)
    logs = float(np.sum((present + early) * np.log(2 * np.pi * level**2)))
    free = problem.data if problem.noise.sigma is None else 0  # |r|^2 at its own level
    return score + logs + free + early * len(level)


def _criterion(tracker: Tracker, Y: Array) -> float:
    settled = tracker.fitted.settled
    if settled is None:
        raise InputError("a filter that never settles has no evidence", where="recommend", found="a drift",
                         expected="a settled gain")  # fmt: skip
    tuned = len([name for name in tracker.fitted.numbers if name != "log-likelihood"])
    density = float(np.sum(log_density(settled.model, Y, settled)))
    return -2 * density + tuned * float(np.log(np.isfinite(Y).sum()))


HALF_SINE = 1.5  # width of a half-sine pulse over its width at half height
PER_PULSE = 4  # knots per pulse width: the best spacing is a third to a fifth of it
CLASSES = {  # priors that hold such loads, the usual one first
    "impact": ("spikes", "pulses", "matern32", "ou"),
    "service": ("matern32", "matern52", "ou", "tikhonov", "random_walk"),
    "slow": ("matern52", "matern32", "random_walk"),
    "harmonic": ("matern52", "matern32"),
    "random": ("matern32", "ou", "matern52", "tikhonov"),
    "step": ("random_walk", "ou", "matern32"),
}
WAVEFORMS = ("spikes", "pulses")
WORDS = {
    "random_walk": "a random walk (steps, drifts)",
    "ou": "an Ornstein-Uhlenbeck process (rough, returns to zero)",
    "matern32": "a Matern-3/2 process (smooth once)",
    "matern52": "a Matern-5/2 process (smooth twice)",
    "tikhonov": "white in time (Tikhonov)",
    "spikes": "few spikes of one sample",
    "pulses": "few B-splines",
}


Run = Callable[[Any, float | None], LoadEstimate]


def _estimated(
    family: Callable[..., Any], model: Model, settings: Mapping[str, Any], record: Any, dt: float | None
) -> LoadEstimate:
    """Estimate of a record by a family that is made now."""
    estimate: LoadEstimate = family(model, **settings).estimate(record, dt)
    return estimate


@dataclass(frozen=True)
class Recommendation:
    """Which prior fits a record, and why.

    Parameters
    ----------
    prior : {"tikhonov", "random_walk", "ou", "matern32", "matern52", "spikes", "pulses"}
    family : str
        The call that uses it.
    reason : str
        With the numbers that decided.
    trusted : bool
        False where neither prior tells the heights: places are good, amplitudes are not.
    kurtosis : float
        Of the Tikhonov load, about zero; the largest of all loads.
    width : float
        Width of the largest pulse of the Tikhonov load, in samples: what the pulse has at most.
    knots : int or None
        Spacing of B-splines, by the information criterion; None where none was asked.
    scores : dict of int to float
        Information criterion of spikes (1) and of B-splines by spacing.
    evidence : dict of str to float
        Criterion of every prior that was compared, above that of the best; empty where the model carries no process.
    """

    prior: str
    family: str
    reason: str
    trusted: bool
    kurtosis: float
    width: float
    knots: int | None
    scores: dict[int, float]
    evidence: dict[str, float] = field(default_factory=dict)
    _run: Run | None = field(default=None, repr=False, compare=False)

    def __str__(self) -> str:
        return f"{self.family}: {self.reason}"

    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Loads of a record as recommended: with the same sensors and noise, numbers tuned to this record.

        Raises
        ------
        InputError
            A record that does not fit the model.
        """
        if self._run is None:
            raise InputError("a recommendation without a model", where="estimate", found="made by hand",
                             expected="one of recommend()")  # fmt: skip
        return self._run(record, dt)


class _Steps:
    """Progress in even steps; after the first one, what is left if the others take as long as those before."""

    def __init__(self, progress: Callable[[float, str], None] | None, total: int) -> None:
        self.progress, self.total, self.done, self.began = Progress(progress), total, 0, perf_counter()

    def __call__(self, text: str) -> None:
        """Before a step."""
        if self.done:
            left = (perf_counter() - self.began) / self.done * (self.total - self.done)
            text += f" (fit {self.done + 1} of {self.total}, about {left:.2g} s to go)"
        self.progress(self.done / self.total, text)
        self.done += 1


@takes(noise=(Noise, "source"))
@one_thread()
def recommend(
    model: Model,
    record: Any,
    dt: float | None = None,
    *,
    load_class: str | None = None,
    hold: str | None = None,
    noise: ArrayLike | Noise | None = None,
    sensors: Sequence[str | int] | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> Recommendation:
    """Compare the priors on a record.

    Processes are compared where the model has a state space, by evidence. The Tikhonov load tells by its kurtosis
    whether it may be made of impacts: then spikes of one sample and B-splines of several spacings are compared too, on
    the first part of a long record.

    Parameters
    ----------
    model, record, dt, hold, noise, sensors
        As for `SparseDeconvolution`.
    load_class : {"impact", "service", "slow", "harmonic", "random", "step"}, optional
        What is known of the load. It decides between priors that the record does not tell apart, and has waveforms
        compared for an impact; a record that says otherwise is believed, and the reason says so.
    progress : callable, optional
        Called as ``progress(fraction, text)`` before each fit; from the second one on the text holds how many there
        are, and the seconds that are left if they take as long as those before.

    Raises
    ------
    InputError
        A record that does not fit the model, an unknown class.
    """
    if load_class is not None and load_class not in CLASSES:
        raise InputError("unknown class of load", where="load_class", found=repr(load_class)[:80],
                         expected=", ".join(map(repr, CLASSES)))  # fmt: skip
    known = Noise.of(noise)
    settings: dict[str, Any] = {"hold": hold, "noise": known, "sensors": sensors}
    say = _Steps(progress, 1 + len(_names(model)))
    say("Tikhonov")
    smooth = Deconvolution(model, penalty=Penalty(variance="constant"), **settings).estimate(record, dt)
    peaked = [kurtosis(g) for g in smooth.load.T]
    worst = int(np.argmax(peaked))
    seen = _Seen(peaked[worst], pulse_width(smooth.load[:, worst]), 1 - (smooth.facts.peak_bias or 0.0))
    data = gather(record, dt, model, sensors, allow_missing=True)
    posing = PosingSettings(known, Lambda(), Penalty(), (), hold)
    problem = pose(model, data, posing)
    first = problem.beginning()
    impulsive = load_class == "impact" or not seen.kurtosis < IMPULSIVE
    say.total += len(_spacings(first)) + 1 if impulsive else 0  # spikes are fitted once more, for their heights
    samples = first.samples + len(data.values) - problem.samples
    processes = compared(model, data, samples, settings, say)
    criteria = {"tikhonov" if name == "white" else name: one.criterion for name, one in processes.items()}
    asked = _Asked(model, settings, seen, load_class)
    if not impulsive:
        found = asked.process(criteria, {})
    else:
        sweeps, shares = _swept(first, say)
        found = asked.either(criteria, _Waveforms(model, data, posing, problem, sweeps, shares), samples, say)
    say.progress(1.0, "done")
    return found


@dataclass(frozen=True)
class _Seen:
    """What the Tikhonov load looks like: kurtosis, width of its largest pulse (samples), share shown of a peak."""

    kurtosis: float
    width: float
    shown: float

    def __str__(self) -> str:
        if self.kurtosis < IMPULSIVE:
            return f"the load acts all the time (kurtosis {self.kurtosis:.3g}, impacts have more than {IMPULSIVE:g})"
        return f"the load looks impulsive (kurtosis {self.kurtosis:.3g})"


@dataclass(frozen=True, eq=False)
class _Asked:
    """A model, the settings of every family, what the Tikhonov load shows, the class of the load."""

    model: Model
    settings: Mapping[str, Any]
    seen: _Seen
    load_class: str | None

    def either(self, criteria: Mapping[str, float], waves: _Waveforms, samples: int, say: Say) -> Recommendation:
        """A process, or waveforms where they explain the first samples better."""
        scores, best = waves.scores, waves.best
        knots = min((k for k in scores if k > 1), key=lambda k: scores[k], default=None)
        every = dict(criteria)
        for k, value in scores.items() if criteria else ():
            name = "spikes" if k == 1 else "pulses"
            every[name] = min(of_sparse(value, waves.problem.beginning(), samples), every.get(name, np.inf))
        if (dense := waves.shares[best]) > told.DENSE:
            found = self.process(every, scores)
            reason = f"{'; ' if criteria else ', but '}{dense:.0%} of the best dictionary would be in use"
            return replace(found, reason=found.reason + reason, knots=knots)
        if every and _chosen(every, self.load_class) not in WAVEFORMS:
            return replace(self.process(every, scores), knots=knots)
        return replace(self.waveforms(every, waves, say), knots=knots)

    def process(self, criteria: Mapping[str, float], scores: dict[int, float]) -> Recommendation:
        """The best process: by the tracker's smoother, or Tikhonov."""
        own = {name: c for name, c in criteria.items() if name not in WAVEFORMS}
        taken = _chosen(own, self.load_class) if own else "tikhonov"
        reason = str(self.seen) + self._ranked(taken, criteria)
        if taken == "tikhonov":
            run = self._by(Deconvolution, self.settings)
            return self._answer(taken, "Deconvolution", reason, criteria, scores, run)
        family = f"LoadTracker(prior={taken!r}).fit(record).smooth(record)"
        tracker = LoadTracker(self.model, prior=taken, gate=None, **self.settings)
        return self._answer(taken, family, reason, criteria, scores, partial(smoothed, tracker))

    def waveforms(self, criteria: Mapping[str, float], waves: _Waveforms, say: Say) -> Recommendation:
        """Spikes (1), or B-splines of a spacing."""
        scores, best = waves.scores, waves.best
        ahead = min((scores[k] for k in scores if (k == 1) != (best == 1)), default=np.inf) - scores[best]
        if best > 1 and ahead > told.CLEARLY:
            reason = (
                f"{self.seen}, and B-splines with knots every {best} samples explain it best (criterion {ahead:.3g} "
                f"below that of spikes); the pulses are at most {self.seen.width:.0f} samples wide, which asks for "
                f"{knots_for(self.seen.width)}"
            )
            family = (
                f"SparseDeconvolution(dictionary='bspline', knots={best}), or Tikhonov with a load that only pushes"
            )
            settings = {**self.settings, "dictionary": "bspline", "knots": best}
            run = self._by(SparseDeconvolution, settings)
            return self._answer("pulses", family, reason + self._ranked("pulses", criteria), criteria, scores, run)
        say("heights of spikes")
        count, share = waves.spikes()
        reason = f"{self.seen}, and {count} spikes of one sample explain it best"
        trusted = share <= told.UNSURE and ahead > told.CLEARLY
        if not trusted:
            alike = "" if ahead > told.CLEARLY else f" or as well as pulses (criterion {ahead:.2g} apart)"
            reason += (
                f"{alike}; neither prior is to be trusted with heights: the places are good, the amplitudes are not "
                f"(± {share:.0%} if neighbouring samples act too; Tikhonov shows a single-sample peak at "
                f"{self.seen.shown:.0%} of its height)"
            )
        run = self._by(SparseDeconvolution, self.settings)
        reason += self._ranked("spikes", criteria)
        return replace(self._answer("spikes", "SparseDeconvolution", reason, criteria, scores, run), trusted=trusted)

    def _ranked(self, taken: str, criteria: Mapping[str, float]) -> str:
        """How far ahead a prior is, and what was declared of the load."""
        if not criteria:
            return ""
        others = sorted((c, name) for name, c in criteria.items() if name != taken)
        text = f"; of all priors {WORDS[taken]} explains the record best" if others else f"; taken: {WORDS[taken]}"
        if others:
            ahead = others[0][0] - criteria[taken]
            text += f" (criterion {abs(ahead):.3g} {'below' if ahead >= 0 else 'above'} that of {WORDS[others[0][1]]})"
        if self.load_class is not None and taken not in CLASSES[self.load_class]:
            text += f", although the load was declared as {self.load_class}"
        return text

    def _by(self, family: Callable[..., Any], settings: Mapping[str, Any]) -> Run:
        return partial(_estimated, family, self.model, dict(settings))

    def _answer(
        self, prior: str, family: str, reason: str, criteria: Mapping[str, float], scores: dict[int, float], run: Run
    ) -> Recommendation:
        least = min(criteria.values(), default=0.0)
        evidence = {name: float(c - least) for name, c in sorted(criteria.items(), key=lambda item: item[1])}
        return Recommendation(
            prior, family, reason, True, self.seen.kurtosis, self.seen.width, None, scores, evidence, run
        )


def smoothed(tracker: LoadTracker, record: Any, dt: float | None = None) -> LoadEstimate:
    """Fit a tracker to a record and smooth the whole of it."""
    fitted = tracker.fit(record, dt)
    if isinstance(record, Record):
        return fitted.smooth(record)
    data = gather(record, dt, tracker.model, tracker.sensors, allow_missing=True)  # a bare table may hold all sensors
    return fitted.smooth(np.where(data.missing, np.nan, data.values), data.dt)


def _chosen(criteria: Mapping[str, float], load_class: str | None) -> str:
    """The smallest criterion; between those that the record does not tell apart, one that holds the declared load."""
    best = min(criteria, key=lambda name: criteria[name])
    alike = [name for name in criteria if criteria[name] - criteria[best] <= told.CLEARLY]
    held = [name for name in alike if load_class is not None and name in CLASSES[load_class]]
    return min(held or [best], key=lambda name: criteria[name])


def _spacings(first: Problem) -> list[int]:
    return [k for k in KNOTS if k == 1 or k <= first.samples // 8]


def _swept(first: Problem, say: Say) -> tuple[dict[int, Sweep], dict[int, float]]:
    """Path over mu, and share in use at its best, of spikes (1) and of B-splines by spacing."""
    sweeps, shares = {}, {}
    for k in _spacings(first):
        say(f"knots every {k} samples" if k > 1 else "spikes")
        atoms = first.atoms("dirac" if k == 1 else "bspline", k)
        sweep = first.path(atoms, False).sweep(first.noise.sigma)
        if len(sweep.lam):
            sweeps[k] = sweep
            shares[k] = float(rules.need(sweep.point, "edf", "ebic")[rules.best_support(sweep)]) / atoms.n
    return sweeps, shares or {1: 1.0}


@dataclass(frozen=True, eq=False)
class _Waveforms:
    """What waveforms make of a record: see `_swept`."""

    model: Model
    data: Data
    posing: PosingSettings
    problem: Problem
    sweeps: dict[int, Sweep]
    shares: dict[int, float]

    @property
    def scores(self) -> dict[int, float]:
        """Information criterion by spacing."""
        return {k: score(sweep) for k, sweep in self.sweeps.items()} or {1: 0.0}

    @property
    def best(self) -> int:
        """Its spacing."""
        scores = self.scores
        return min(scores, key=lambda k: scores[k])

    def spikes(self) -> tuple[int, float]:
        """How many `SparseDeconvolution` finds, and the share by which neighbours make the largest unsure."""
        data, problem, sweeps = (
            without_offsets(self.data, self.model, at_rest=True, allow=()),
            self.problem,
            self.sweeps,
        )
        if data is not self.data:
            problem, sweeps = pose(self.model, data, self.posing), {}
        chosen = choose(problem, Wanted("dirac", None, Sparsity(), None), Progress(), sweeps)
        share = amplitude_share(chosen)
        return len(chosen.fit.x), 0.0 if share is None else share[0]


def pulse_width(g: Array) -> float:
    """Width in samples of the largest pulse of a history, as that of a half-sine of the same width at half height."""
    return HALF_SINE * half_width(g)


def knots_for(width: float) -> int:
    """Spacing of B-splines for pulses of a width in samples: a quarter of it, as a power of two from 2 to 16."""
    return int(2 ** np.clip(np.round(np.log2(max(width / PER_PULSE, 1.0))), 1, 4))
