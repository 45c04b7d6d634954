"""Deconvolution: load histories from response histories, Tikhonov or truncated SVD, any length of record."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.advice import Advice, Option
from structures.errors import InputError, NotIdentifiable
from structures.flags import Flag, codes
from structures.model import Model, as_model

from .. import guards
from ..guards import families as told
from ..guards.inversion import windows_apart
from ..inverse import rules
from ..inverse.choice import Choice, choose, given, residual_level, unexplained
from ..inverse.diagnosis import diagnose
from ..inverse.penalties import order
from ..inverse.statespace.coarse import confirm
from ..results.archive import provenance
from ..results.estimate import Axis, LoadEstimate
from ..settings import ChoiceLike, Guards, Lambda, Noise, Penalty, takes
from . import histories
from .data import Data, gather, health
from .histories import facts as pushing_facts
from .histories import flags as pushing_flags
from .histories import half_width, kurtosis, push, signs, without_offsets
from .noise import graded, noise_level, unexplained_by
from .posing import UNUSABLE, Posed, PosingSettings, diagonal, pose

PROCESS = (
    "a load of zero mean and constant variance, white in time",
    "a random walk in time",
    "an integrated random walk in time",
)  # which a penalty on differences of that order is the prior of


class Deconvolution:
    """Load histories from response histories.

    Minimises ``|R^(-1/2) (h * g - y)|^2 + lambda^2 |L g|^2`` over whole records (Jacquelin, Bennani & Hamelin, J. Sound
    Vib. 265 (2003) 81, for the problem; Hansen, SIAM 1998, for the method), exactly and at any length: short records by
    SVD, longer ones by recursions over the state space of the model, or by convolution where it has none, in windows
    beyond 50 000 samples, with a bound on what that changes; the result says which. Measured models go line by line
    over the zero-padded spectrum, which carries the errors of their FRFs and is right where the response decays within
    the record (flag W505 says when it does not).

    Parameters
    ----------
    model : Model
        Anything that gives ``impulse_response`` (and ``frf`` for measured models).
    penalty : str, array, None or Penalty
        ``identity, first_difference, second_difference`` (``gradient``, ``laplacian``), a matrix of shape
        (rows, samples * loads), or None for plain least squares, refused where the data do not determine the load;
        beside it, what else holds the load: `loadid.Penalty`.
    choice : str, callable, float, None or Lambda
        Rule, or relative lambda; None chooses as `loadid.inverse.choice.choose` says. Truncation in place of Tikhonov
        and the solver: `loadid.Lambda`.
    initial : ``"rest"``, ``"unknown"`` or array (states,)
        State of the model at the first sample: at rest, an unknown of the data, or known. State-space path only.
    constraints : sequence of NonNegative
        Loads that only push (`loadid.inverse.constraints.NonNegative`). Lambda is then the largest at which such a load
        explains the data, where no rule was asked for by name; the std stays that of the load without signs, a bound.
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
        penalty=(Penalty, "size leak from_zero"),
        choice=(Lambda, "method path"),
        noise=(Noise, "source"),
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
        self.settings = PosingSettings(Noise.of(noise), lam, held, told_of.codes, hold, initial, signs(constraints))
        self.model = as_model(model, "Deconvolution", "impulse_response")
        self.choice = 0.0 if held.L is None else lam.choice
        self.sensors, self.coverage, self.load_class = sensors, told_of.coverage, told_of.load_class
        self._progress = progress or (lambda fraction, text: None)

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
        posed = pose(self.model, data, self.settings)
        self._refuse_undetermined(posed)
        self._progress(0.5, "choosing lambda")
        choice = self._choose(posed)
        self._progress(0.9, "estimating the load")
        posed.path.precompute(choice.lam, lambda f, t: self._progress(0.9 + 0.09 * f, t))
        # a residual above the stated noise is model error: the band must not be narrower than what is seen
        sigma = noise_level(posed.path, choice, posed.noise)
        pushed = None
        if (signed := self.settings.signed) is not False:
            keep = self.choice is not None
            pushed, choice = push(posed, choice, sigma, signed, keep, lambda f, t: self._progress(0.7 + 0.2 * f, t))
        solution = posed.path.solution(choice.lam, sigma)
        load = solution.load if pushed is None else pushed.load
        response, residual = posed.compare(load, choice.lam, None if pushed is None else pushed.start)
        facts = self._facts(posed, choice, sigma, data.dt, load)
        facts |= {"missing": data.gaps} if data.gaps else {}
        own_flags: tuple[Flag, ...] = ()
        if pushed is not None:
            facts |= pushing_facts(pushed, posed.path.m, posed.noise.known)
            own_flags = pushing_flags(pushed, posed, choice, sigma)
        else:
            own_flags = self._impacts(load, facts, data.dt)
        assert solution.posterior is not None
        std = solution.posterior.std
        if (bound := posed.path.bound(choice.lam)) is not None:
            facts["window_bound"] = bound / float(np.linalg.norm(std))
            own_flags = guards.collect([*own_flags, windows_apart(facts["window_bound"])])
        bias = diagnose.hidden(posed.path, choice.lam, load, std)
        self._progress(1.0, "done")
        estimate = LoadEstimate(
            load=load,
            # the posterior holds the bias of an average sample; where more is expected to be hidden, that counts
            std=np.maximum(std, np.abs(bias)),
            bias=bias,
            labels=[c.label for c in self.model.loads],
            units=[c.unit for c in self.model.loads],
            axis=Axis(name="time", unit="s", values=np.asarray(np.arange(len(load)) * data.dt, float)),
            choice=choice,
            response=response,
            residual=residual,
            sensors=[c.label for c in data.channels],
            sensor_units=[c.unit for c in data.channels],
            flags=guards.collect([*own_flags, *self._flags(posed, choice, data, facts, residual)]),
            allowed=self.settings.allow,
            certificate=self.model.certificate,
            posterior=solution.posterior,
            facts=facts,
            provenance=provenance(
                self.name,
                settings=self._settings(posed),
                inputs={data.record.source or data.record.name or "record": data.record.sha256},
                model=self.model.fingerprint,
                prior=_prior(self.settings) + ("" if pushed is None else "; it only pushes"),
            ),
        )
        if pushed is None or posed.noise.sigma is None:
            return graded(estimate, unexplained_by(posed.path, choice.lam, posed.noise))
        return graded(estimate, unexplained(pushed.residual2, posed.path.m, posed.noise.sigma))

    def _choose(self, posed: Posed) -> Choice:
        """Lambda by the rules: of a long record on windows first, then on the whole."""
        sigma, source = posed.noise.sigma, posed.noise.source
        if not isinstance(self.choice, str | bool | None) and posed.path.coefficients is None:
            return given(posed.path, self.choice, sigma=sigma, source=source)
        choice = choose(posed.judged, self.choice, sigma=sigma, source=source)
        if posed.judged is posed.path:
            return choice
        self._progress(0.6, "confirming lambda on the whole record")
        return confirm(posed.path, choice, self.choice, sigma=sigma, source=source)

    # -- saying -----------------------------------------------------------------------------------------------------
    def _refuse_undetermined(self, posed: Posed) -> None:
        if self._free and posed.rank < posed.unknowns and "LID-E306" not in self.settings.allow:
            raise NotIdentifiable(
                f"without regularisation the load is not determined: rank {posed.rank} of {posed.unknowns} "
                f"unknowns from {posed.path.m} data",
                advice=Advice("add sensors, use a penalty (", Option("penalty", "identity"), "), or give lambda > 0"),
                code="LID-E306",
            )

    @property
    def _free(self) -> bool:
        """Without regularisation."""
        return self.settings.free

    def _impacts(self, load: NDArray, facts: dict[str, Any], dt: float) -> tuple[Flag, ...]:
        """W510 and W311: whether the load is one of impacts that this prior smears."""
        prior, g = _prior(self.settings), load[:, int(np.argmax(np.max(np.abs(load), axis=0)))]
        peaked = None if self.load_class is None else told.impulsive(kurtosis(load), prior)
        width = facts["resolution"] / dt
        peaked = peaked or told.smeared(kurtosis(g), half_width(g), width, facts["peak_bias"], prior)
        return guards.collect([told.declared_class(self.load_class, "tikhonov"), peaked])

    def _overridden(self, posed: Posed) -> list[Flag]:
        """Refusals that `allow` took away."""
        found = []
        if "LID-E506" in self.settings.allow and (ratio := diagonal(posed.h)) <= UNUSABLE:
            found.append(guards.overridden("E506", "|h(0)| / max |h|", ratio, UNUSABLE))
        if "LID-E306" in self.settings.allow and self._free and posed.rank < posed.unknowns:
            found.append(guards.overridden("E306", "rank", posed.rank, posed.unknowns))
        return found

    def _facts(self, posed: Posed, choice: Choice, sigma: float, dt: float, load: NDArray) -> dict[str, Any]:
        path = posed.path
        kappa, rank, nullity = posed.layout
        width, bias = diagnose.resolution(path, choice.lam, load)
        point = path.at(choice.lam)
        return {
            "path": posed.name,
            "m": int(path.m),
            "n": posed.unknowns,
            "rank": rank,
            "nullity": nullity,
            "kappa": kappa,
            "edf": None if point.edf is None else float(point.edf),
            "residual_to_noise": residual_level(path, choice.lam) if posed.noise.known else None,
            "noise_level": float(sigma),
            **posed.noise.source.facts,
            "resolution": width * dt,
            "resolution_unit": "s",
            "peak_bias": bias,
        }

    @staticmethod
    def _end(posed: Posed, residual: NDArray) -> Flag | None:
        """W505 of what the padded transform cannot represent."""
        return guards.unfinished(posed.values, residual) if posed.path.zero_padded else None

    def _beginning(self, posed: Posed, choice: Choice, data: Data, sigma: float) -> Flag | None:
        """W518 of a record that starts in motion, where the model starts at rest."""
        if not isinstance(self.settings.initial, str) or self.settings.initial != "rest":
            return None
        missing = data.missing[-len(posed.values) :] if data.missing.any() else None
        lam, penalty = choice.lam * choice.scale, self.settings.penalty.L
        return histories.beginning(posed.h, posed.values, posed.noise.level, lam, penalty, sigma, missing)

    def _flags(
        self, posed: Posed, choice: Choice, data: Data, facts: dict[str, Any], residual: NDArray
    ) -> tuple[Flag, ...]:
        model, lost = self.model, [s.label for i, s in enumerate(self.model.sensors) if i not in data.rows]
        bound = self.settings.penalty.leak is not None or self.settings.penalty.size is not None
        layout = histories.layout(model, data, posed.h, self.settings.penalty.L, bound)
        after = (facts["kappa"], facts["rank"], facts["nullity"])
        penalty = self.settings.penalty.L if isinstance(self.settings.penalty.L, str) else "user matrix"
        return guards.collect(
            [
                *self._overridden(posed),
                *model.flags,
                guards.not_verified(model.certificate),
                *health(data),
                histories.determined(model, facts["m"], facts["n"], facts["rank"], posed.h),
                None if posed.full is None else guards.lost_channels(posed.full, after, lost),
                guards.mixed_kinds(data.channels, posed.noise.known),
                *layout,
                None if "W505" in codes(layout) else self._end(posed, residual),
                self._beginning(posed, choice, data, facts["noise_level"]),
                *guards.parameter(choice, lambda factor: _discrepancy(posed, factor)),
                guards.inverse_crime(data.record.simulated_by, model.fingerprint),
                guards.no_coverage(self.coverage),
                guards.used_for_training("the record", data.fingerprints & model.training),
                guards.resolution(facts["nullity"], penalty, facts["resolution"], "s", facts["peak_bias"]),
            ]
        )

    def _settings(self, posed: Posed) -> dict[str, Any]:
        s = self.settings
        return {
            "method": s.lam.method,
            "penalty": s.penalty.L if isinstance(s.penalty.L, str | None) else "matrix",
            "size": None if s.penalty.size is None else np.asarray(s.penalty.size, float).tolist(),
            "choice": self.choice,
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


def _discrepancy(posed: Posed, factor: float) -> float | None:
    """Lambda of the discrepancy rule at a multiple of the noise level."""
    return rules.discrepancy(rules.Sweep.over(posed.judged, posed.noise.sigma), factor).lam
