"""Deconvolution: load histories from response histories, Tikhonov or truncated SVD, any length of record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice, Option
from structures._flags import Flag, codes
from structures._model import Model, as_model
from structures._threads import one_thread
from structures.errors import InputError

from .. import _guards as guards
from .._guards import choice as told
from .._inverse.choice import Choice, checked, choose, given, moved, named
from .._inverse.constrained.nonnegative import NonNegativeSolution
from .._inverse.diagnosis import identifiability
from .._inverse.gaussian.coarse import confirm
from .._inverse.path import Solution
from .._inverse.penalties import order
from .._inverse.support import ActingPosterior
from .._results.again import Again, Quick
from .._results.estimate import LoadEstimate
from .._results.facts import Facts, expecting
from .._spellings import Progress, takes
from ..settings import ChoiceLike, Guards, Lambda, Noise, Penalty
from . import detection, histories, local_variance
from .answer import Overlooked, SolvedLoad, answer, beyond_noise, of_path, of_record, over_time, undetermined
from .data import Data, gather
from .gaps import bridged, near_gaps
from .histories import facts as pushing_facts
from .histories import flags as pushing_flags
from .histories import half_width, kurtosis, push, signs
from .noise import noise_level
from .offsets import Settled, settled, without_offsets
from .posing import UNUSABLE, Posed, PosingSettings, diagonal, on_states, pose
from .posing.paths import LONGEST

PROCESS = (
    "a load of zero mean and constant variance, white in time",
    "a random walk in time",
    "an integrated random walk in time",
)  # which a penalty on differences of that order is the prior of

MUCH = 0.05  # of the response, in the residual of a load in windows, that is looked into
FILLED, FILLED_VALUES = 600, 2**23  # samples that are filled at most; these times the size of the record
GONE = 0.5  # of a hit in a gap, which nothing tells but what rings on behind it
SHARE = 0.25  # of the record that is filled at most: the noise is told by the residual of all of it
FILLINGS = 2  # with a variance that is learned, whatever asks for it
LITTLE = 0.1  # of the response, in what windows leave beyond the noise, that errors of the model make


class Deconvolution:
    """Load histories from response histories.

    Minimises ``|R^(-1/2) (h * g - y)|^2 + lambda^2 |L g|^2`` over whole records (Jacquelin, Bennani & Hamelin, J. Sound
    Vib. 265 (2003) 81, for the problem; Hansen, SIAM 1998, for the method), exactly and at any length: short records by
    SVD, longer ones by recursions over the state space of the model, or by convolution where it has none, in windows
    beyond 50 000 samples, with a bound on what that changes; the result says which. Measured models go line by line
    over the zero-padded spectrum, which carries the errors of their FRFs and is right where the response decays within
    the record (flag W505 says when it does not); every sample of their gaps is an unknown, of up to 600 samples and a
    quarter of the record.

    Parameters
    ----------
    model : Model
        Anything that gives ``impulse_response`` (and ``frf`` for measured models).
    penalty : str, array, None or Penalty
        ``identity, first_difference, second_difference`` (``gradient``, ``laplacian``), a matrix of shape
        (rows, samples * loads), or None for plain least squares, refused where the data do not determine the load;
        beside it, what else holds the load, and whether its variance changes with time, as the data ask for where the
        load is one of impacts, or stays constant: `loadid.Penalty`.
    choice : str, callable, float, None or Lambda
        Rule by name or itself (`loadid.register_rule`), or relative lambda; None chooses as
        `loadid.paths.choose` says. Truncation in place of Tikhonov and the solver: `loadid.Lambda`.
    initial : ``"rest"``, ``"unknown"`` or array (states,)
        State of the model at the first sample: at rest, an unknown of the data, or known. State-space path only.
    constraints : sequence of NonNegative
        Loads that only push (`loadid.constraints.NonNegative`). Lambda is then the largest at which such a load
        explains the data, where no rule was asked for by name; the std stays that of the load without signs, a bound.
    support : (float, float) or sequence of such, optional
        Windows in s, from the first sample of the record, outside which the loads are zero ("the hammer touches for
        6 ms"): their unknowns are left out, exactly. Any penalty by a matrix up to 2000 unknowns; the identity also
        over the states of a model, at any length, with gaps, signs or a start that is not known.
    hold : {"foh", "zoh"}, optional
        How a load moves between samples; default the model's own, which is first order where it has a choice.
    noise : float, array or Noise, optional
        Noise std of the sensors, (sensors,) or a covariance (sensors, sensors); with where it comes from:
        `loadid.Noise`.
    sensors : sequence of str or int, optional
        Sensors of the model to use; default all.
    allow : sequence of str, or Guards
        Guard codes whose refusal is overridden; printed on everything made from the result. What else guards ask:
        `loadid.Guards`.
    progress : callable, optional
        Called as ``progress(fraction, text)``.
    """

    name = "deconvolution"

    @takes(
        penalty=(Penalty, "size leak from_zero variance"),
        choice=(Lambda, "method path"),
        noise=(Noise, "source errors"),
        allow=(Guards, "coverage load_class"),
    )
    def __init__(
        self,
        model: Model,
        *,
        penalty: str | ArrayLike | Penalty | None = "identity",
        choice: ChoiceLike = None,
        initial: str | ArrayLike = "rest",
        constraints: Sequence[Any] = (),
        support: ArrayLike | None = None,
        hold: str | None = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        held, lam, told_of = Penalty.of(penalty), Lambda.of(choice), Guards.of(allow)
        if held.L is None and lam.choice is not None and not lam.free:
            raise InputError(
                "without a penalty there is no lambda to choose", where="choice", found=lam.choice, expected="None"
            )
        self.settings = PosingSettings(
            Noise.of(noise), lam, held, told_of.codes, hold, initial, signs(constraints), support
        )
        self.model = as_model(model, "Deconvolution", "impulse_response")
        self.choice = 0.0 if held.L is None else checked(lam.choice)
        self.sensors, self.coverage, self.load_class = sensors, told_of.coverage, told_of.load_class
        self._progress = Progress(progress)

    @one_thread()
    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the loads that caused a record.

        Parameters
        ----------
        record : Record, or array of shape (samples, sensors)
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        LoadEstimate
            Loads (samples, loads) with std, flags, and what every rule said.

        Raises
        ------
        InputError
            A record that does not fit the model, or an impulse response without a usable diagonal (LID-E506).
        NotIdentifiable
            Without regularisation, where the data do not determine the load (LID-E306).
        """
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)
        data = without_offsets(data, self.model, at_rest=self.settings.resting, allow=self.settings.allow)
        self._progress(0.1, "posing the problem")
        fit = self._fit(self._filled(data))
        return replace(self._answered(fit), again=self._again(fit))

    def _fit(self, data: Data) -> Settled:
        return settled(self.model, data, self._pose, self._choose, self._in_motion)

    def _filled(self, data: Data) -> Data:
        """In gaps of a record of measured FRFs the response to the load that the rest tells.

        FRFs with their errors go by lines, which are of whole records; their solution takes what stands in the gaps for
        unknown.
        """
        s, lost = self.settings, int(data.missing.sum())
        free = not s.truncated and s.lam.path == "auto" and s.support is None and s.signed is False
        few = 0 < lost <= FILLED and lost * data.values.size <= FILLED_VALUES and lost <= SHARE * data.values.size
        if not (self.model.sampled and free and few):
            return data
        none = np.zeros_like(data.missing)
        whole = replace(data, values=bridged(data.values, data.missing), missing=none, filled=data.missing)
        hits = FILLINGS * ("local",) if s.unasked or s.local else ()
        for variance in (*hits, s.penalty.variance):
            made = self._quietly(whole, variance)
            expected = np.asarray(made.response) - made.residual
            whole = replace(whole, values=np.where(data.missing, expected, data.values))
        return whole

    def _quietly(self, data: Data, variance: str) -> LoadEstimate:
        """The answer with a variance of the load, whose progress nobody sees."""
        own = copy(self)
        own.settings = replace(self.settings, penalty=replace(self.settings.penalty, variance=variance))
        own._progress = Progress(None)
        return own._answered(own._fit(data))

    def _answered(self, fit: Settled) -> LoadEstimate:
        """The estimate of a problem whose lambda is chosen."""
        data, posed, choice = fit.data, fit.posed, fit.choice
        self._progress(0.9, "estimating the load")
        posed.path.precompute(choice.lam, lambda f, t: self._progress(0.9 + 0.09 * f, t))
        # a residual above the stated noise is model error: the band must not be narrower than what is seen
        sigma = noise_level(posed.path, choice, posed.noise)
        pushed = None
        if (signed := self.settings.signed) is not False:
            keep = self.choice is not None
            pushed, choice = push(posed, choice, sigma, signed, keep, lambda f, t: self._progress(0.7 + 0.2 * f, t))
        found = self._found(posed, choice, sigma, data, pushed)
        if fit.offsets is not None:
            found = replace(found, facts=Facts.of({**found.facts, "offsets": fit.offsets.words(data)}))
        states = cache(lambda: self._over_states(posed, data))
        anywhere = cache(partial(on_states, self.model, data, replace(self.settings, support=None)))
        local = local_variance.learned(posed, self.settings, found.load, states, anywhere)
        acting = self.settings.acting(len(found.load), data.dt)
        found = local_variance.replaced(found, local, choice, data.dt, acting)
        prior, pushes = local_variance.words(local), "" if pushed is None else "; it only pushes"
        if not local_variance.told(local):  # what was learned of hits is told by its evidence
            nothing = detection.of_history(posed, choice.lam, self.model.loads, data.dt, acting)
            found = replace(found, not_told=nothing)
        if prior and isinstance(local, local_variance.Learned | local_variance.Smooth):
            choice, posed = local_variance.unasked(choice, local), local.posed
        elif posed.gains is not None and (self.settings.unasked or acting is not None):
            found = local_variance.widened_by_gains(found, posed, choice)
        elif self.settings.unasked and len(found.load) <= LONGEST:
            found = local_variance.widened(found, states(), choice)
        found = self._held_to_windows(found, data, anywhere)
        self._progress(1.0, "done")
        told_hits = local_variance.told(local)
        lost = 0.0 if told_hits else self._lost(posed, data, found.load)
        beside = near_gaps(found.load, data.filled) if told_hits and data.filled is not None else 0.0
        made = answer(
            self, data, found, choice, known=posed.noise.known, settings=self._settings(posed),
            prior=prior or _prior(self.settings) + pushes,
            flags=[*self._flags(posed, choice, data, found), guards.lost_response(lost), guards.hit_beside_gap(beside)],
            searched=posed.judged, full=posed.full, free=self._free,
            solved=None if pushed is not None else posed.path, judged=not prior, spare=self._spare(posed, data),
        )  # fmt: skip
        gone = GONE if beside > guards.BESIDE_GAP else float(np.sqrt(lost))
        return expecting(made, gone) if gone else made

    def _lost(self, posed: Posed, data: Data, load: NDArray[np.float64]) -> float:
        """Share of the response to the load that was not recorded, which one variance for the whole record hides."""
        missing = (data.missing if data.filled is None else data.filled)[-len(posed.values) :]
        if not missing.any() or len(load) != len(missing):
            return 0.0
        return histories.lost_response(posed.h, missing, posed.noise.std, load)

    def _again(self, fit: Settled) -> Again | None:
        """The problem, to be asked at another lambda; None without regularisation and for loads that are learned."""
        if self._free or self.settings.local or fit.posed.path.stacked:
            return None
        quick = partial(self._quick, fit) if self.settings.signed is False else None
        return Again(fit.posed.path, partial(self._at, fit), quick)

    def _at(self, fit: Settled, lam: float) -> LoadEstimate:
        own = copy(self)
        own.choice, own._progress = lam, Progress(None)
        own.settings = replace(self.settings, lam=replace(self.settings.lam, choice=lam))
        asked = fit.posed.path.coefficients is not None  # where a sweep is dear, no rule is asked beside a given lambda
        choice = moved(fit.choice, fit.posed.judged, lam) if asked else own._choose(fit.posed)
        fit = replace(fit, choice=choice)
        with one_thread():
            return replace(own._answered(fit), again=self._again(fit))

    def _quick(self, fit: Settled, lam: float) -> Quick:
        posed, path = fit.posed, fit.posed.path
        sigma = noise_level(path, replace(fit.choice, lam=lam), posed.noise)
        solution = self._in_windows(path.solution(lam, path.level_within(lam, sigma)), fit.data.dt)
        assert solution.posterior is not None
        load, std = solution.load, np.broadcast_to(solution.posterior.std, solution.load.shape)
        bias = identifiability.hidden(path, lam, load, std)
        return Quick(load, np.maximum(std, np.abs(bias)))

    def _found(
        self, posed: Posed, choice: Choice, sigma: float, data: Data, pushed: NonNegativeSolution | None
    ) -> SolvedLoad:
        """The load with what is known of it; of loads that only push, that of the solver of signs."""
        path, level = posed.path, posed.path.level_within(choice.lam, sigma)
        solution = self._in_windows(path.solution(choice.lam, level), data.dt)
        load = solution.load if pushed is None else pushed.load
        response, residual = posed.compare(load, choice.lam, None if pushed is None else pushed.start)
        width, lost = identifiability.resolution(path, choice.lam, load)
        facts = {
            "path": posed.name, "n": posed.unknowns, "resolution": width * data.dt, "resolution_unit": "s",
            "peak_bias": lost, **({"window_level": level / sigma} if level > sigma else {}),
            **({"missing": data.gaps} if data.gaps else {}),
            **({} if pushed is None else pushing_facts(pushed, path.m, posed.noise.known)),
        }  # fmt: skip
        found = of_path(
            path, choice, solution, sigma, posed.noise, layout=posed.layout, axis=over_time(len(load), data.dt),
            response=response, residual=residual, facts=facts, load=load, hidden_by=path,
        )  # fmt: skip
        if pushed is None:
            return replace(found, flags=(*self._impacts(found, data.dt), *found.flags))
        excess = beyond_noise(pushed.residual2, path.m, posed.noise)
        return replace(found, excess=excess, flags=(*pushing_flags(pushed, posed, choice, sigma), *found.flags))

    def _in_windows(self, found: Solution, dt: float) -> Solution:
        """The solution of loads that act in windows alone: outside them they are known."""
        mask = self.settings.acting(len(found.load), dt)
        if mask is None or found.posterior is None:
            return found
        acting = np.repeat(mask[:, None], found.load.shape[1], 1)
        return Solution(np.where(acting, found.load, 0.0), ActingPosterior(found.posterior, acting))

    def _over_states(self, posed: Posed, data: Data) -> Posed | None:
        return posed if posed.record is not None else on_states(self.model, data, self.settings)

    def _held_to_windows(self, found: SolvedLoad, data: Data, anywhere: Callable[[], Posed | None]) -> SolvedLoad:
        """The load in windows against one at any time: W319 where that explains what the windows leave.

        Where it explains hardly more, and little is left, the windows are no contradiction (W412): a load at any time
        takes small errors of the model for itself, one in windows cannot.
        """
        acting = self.settings.acting(len(found.load), data.dt)
        rest, size = (float(np.linalg.norm(np.asarray(x))) for x in (found.residual, found.response))
        if acting is None or (found.excess is None and not rest > MUCH * size):
            return found
        if (whole := anywhere()) is None:
            return found
        choice = self._choose(whole)
        load = whole.path.solution(choice.lam, None).load
        left = float(np.linalg.norm(whole.compare(load, choice.lam, None)[1]))
        assert self.settings.support is not None
        ratio = rest / max(left, np.finfo(float).tiny)
        if (flag := histories.missed(load, acting, data.dt, self.settings.support, ratio)) is not None:
            return replace(found, flags=(flag, *found.flags))
        if found.excess is None or ratio > histories.BETTER or rest * np.sqrt(1 - found.excess**-2) > LITTLE * size:
            return found
        explained = beyond_noise(float(whole.path.at(choice.lam).residual2), whole.path.m, whole.noise) is None
        return replace(found, excess=None) if explained else found

    def _spare(self, posed: Posed, data: Data) -> Overlooked | None:
        """What the sensors tell of each other: of whole records that start at rest, as h says they do."""
        whole = not data.gaps and len(posed.values) == len(data.values)
        if not (whole and self.settings.resting and len(data.rows) > posed.h.shape[2]):
            return None
        return of_record(posed.h, data.values, data.dt, posed.noise, data.channels)

    def _pose(self, data: Data) -> Posed:
        posed = pose(self.model, data, self.settings)
        self._refuse_undetermined(posed)
        return posed

    def _in_motion(self, fit: Settled) -> bool:
        sigma = noise_level(fit.posed.path, fit.choice, fit.posed.noise)
        return self._beginning(fit.posed, fit.choice, fit.data, sigma) is not None

    def _choose(self, posed: Posed) -> Choice:
        """Lambda by the rules: of a long record on windows first, then on the whole."""
        self._progress(0.5, "choosing lambda")
        sigma, source = posed.noise.sigma, posed.noise.source
        if isinstance(self.choice, float) and posed.path.coefficients is None:
            return given(posed.path, self.choice, sigma=sigma, source=source)
        choice = choose(posed.judged, self.choice, sigma=sigma, source=source)
        if posed.judged is posed.path:
            return choice
        self._progress(0.6, "confirming lambda on the whole record")
        return confirm(posed.path, choice, self.choice, sigma=sigma, source=source)

    def _refuse_undetermined(self, posed: Posed) -> None:
        if self._free and posed.rank < posed.unknowns and "LID-E306" not in self.settings.allow:
            advice = Advice("add sensors, use a penalty (", Option("penalty", "identity"), "), or give lambda > 0")
            raise undetermined(posed.rank, f"{posed.unknowns} unknowns", f"{posed.path.m} data", advice)

    @property
    def _free(self) -> bool:
        """Without regularisation."""
        return self.settings.free

    @property
    def allow(self) -> tuple[str, ...]:
        """Guard codes whose refusal is overridden."""
        return self.settings.allow

    def _impacts(self, found: SolvedLoad, dt: float) -> tuple[Flag, ...]:
        """W510 and W311: whether the load is one of impacts that this prior smears."""
        load, prior = found.load, _prior(self.settings)
        g = load[:, int(np.argmax(np.max(np.abs(load), axis=0)))]
        peaked = None if self.load_class is None else told.impulsive(kurtosis(load), prior)
        width = found.facts["resolution"] / dt
        peaked = peaked or told.smeared(kurtosis(g), half_width(g), width, found.facts["peak_bias"], prior)
        return guards.collect([told.declared_class(self.load_class, "tikhonov"), peaked])

    def _beginning(self, posed: Posed, choice: Choice, data: Data, sigma: float) -> Flag | None:
        """W518 of a record that starts in motion, where the model starts at rest."""
        if not isinstance(self.settings.initial, str) or self.settings.initial != "rest":
            return None
        missing = data.missing[-len(posed.values) :] if data.missing.any() else None
        lam, penalty = choice.lam * choice.scale, self.settings.penalty.L
        return histories.beginning(posed.h, posed.values, posed.noise.level, lam, penalty, sigma, missing)

    def _flags(self, posed: Posed, choice: Choice, data: Data, found: SolvedLoad) -> list[Flag | None]:
        s, facts = self.settings, found.facts
        bound = s.penalty.leak is not None or s.penalty.size is not None
        layout = [
            guards.cut_off(flag, found.load, found.std) if flag.code == "LID-W505" else flag
            for flag in histories.layout(self.model, data, posed.h, s.penalty.L, bound, posed.path.zero_padded)
        ]
        # what the padded transform cannot represent
        cut = posed.path.zero_padded and "W505" not in codes(f for f in layout if f)
        ratio = diagonal(posed.h) if "LID-E506" in s.allow else np.inf
        penalty = s.penalty.L if isinstance(s.penalty.L, str) else "user matrix"
        return [
            guards.overridden("E506", "|h(0)| / max |h|", ratio, UNUSABLE) if ratio <= UNUSABLE else None,
            histories.determined(self.model, facts["m"], facts["n"], facts["rank"], posed.h),
            *layout,
            guards.unfinished(posed.values, np.asarray(found.residual)) if cut else None,
            self._beginning(posed, choice, data, facts["noise_level"]),
            guards.resolution(facts["nullity"], penalty, facts["resolution"], "s", facts["peak_bias"]),
        ]

    def _settings(self, posed: Posed) -> dict[str, Any]:
        s = self.settings
        return {
            "method": s.lam.method,
            "penalty": s.penalty.L if isinstance(s.penalty.L, str | None) else "matrix",
            "size": None if s.penalty.size is None else np.asarray(s.penalty.size, float).tolist(),
            "choice": named(self.choice),
            **({} if s.penalty.variance == "auto" else {"variance": s.penalty.variance}),
            **({} if s.support is None else {"support": [list(one) for one in s.support]}),
            "hold": s.hold,
            "path": posed.name,
            "noise_source": posed.noise.source.text,
            "sensors": None if self.sensors is None else [str(s) for s in self.sensors],
        }


def _prior(settings: PosingSettings) -> str:
    """The prior in words."""
    if isinstance(settings.penalty.L, str):
        return _process(order(settings.penalty.L)) + (
            "" if settings.penalty.size is None else ", its size held small beside its changes"
        )
    return "none" if settings.penalty.L is None else "a penalty of the user"


def _process(order: int) -> str:
    """The random process that a difference of this order makes white, in words."""
    return PROCESS[order] if order < len(PROCESS) else f"a random walk in time, integrated {order - 1} times"
