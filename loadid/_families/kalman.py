"""Online loads: joint estimation of the state of a structure and of what acts on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model
from structures._models.statespace import StateSpace
from structures.errors import InputError, NotIdentifiable, real

from .. import _guards as guards
from .._guards import tracking as told
from .._inverse.gaussian.lag import fixed_lag
from .._inverse.gaussian.model import SquareRoot
from .._inverse.gaussian.model import words as near_rest_in_words
from .._inverse.gaussian.observe import Observability, observability
from .._inverse.gaussian.records import NEAR
from .._inverse.gaussian.roots import solve_lower
from .._inverse.gaussian.steady import SteadyFilter, steady
from .._inverse.problem import NoiseSource
from .._record import Record
from .._spellings import Progress, takes
from ..priors import OU, Matern32, Matern52
from ..settings import Guards, ModelErrors, Noise, Online, Priors
from . import noise as noises
from .data import Data, gather, health
from .detection import of_track
from .tracking.beginning import MovingStart, beginning
from .tracking.certificate import TrackCertificate, banded, certify
from .tracking.engine import Engine
from .tracking.filters import Named, Posing, leaky, named, restricted
from .tracking.fit import Recipe, TrackerFit, storable
from .tracking.judging import GATE
from .tracking.samples import ranges, within
from .tracking.tracker import Tracker
from .tracking.tuning import LONGEST, numbers_of
from .tracking.watch import usual

Array = NDArray[Any]

FAR, NEARLY = 50, 1.05  # where a lag is judged, and how near to that is near enough
JOINT = ("ou", "matern32", "matern52")
NOTHING = 1.2  # by which a std may be too small: chance, in a record of some hundred samples
LITTLE = 0.05  # of the variance of a load, that all sensors together take away one by one: they tell nothing of it
AS_EVER = 0.02  # of the variances, within which a filter is as sure as in the long run
INNOVATIONS = NoiseSource("residual", "likelihood of the innovations")
UNKNOWN = 0.01  # of the rms of a channel: its noise, to begin with, where nobody states it


class LoadTracker:
    """Loads of a structure in service, with a std that can be believed, sample by sample.

    The load is a Gaussian process that a few states carry; structure and load are one linear system, filtered in
    square-root form: with a random walk the augmented Kalman filter of Lourens et al. (Mech. Syst. Signal Process. 27
    (2012) 446), with Matern priors the latent-force model of Nayek et al. (ibid. 128 (2019) 497), with an infinitely
    wide white load that of Gillijns and De Moor (Automatica 43 (2007) 934).

    Parameters
    ----------
    model : Model
        With a state space.
    prior : str, prior, one of them per load, or Priors
        ``"matern32"`` (default), ``"matern52"``, ``"ou"``, ``"random_walk"``, ``"white"``: their numbers are found by
        likelihood. A prior of `loadid.priors` is taken as it is. What is believed of the start and of
        displacements: `loadid.Priors`.
    noise : float, array (sensors,) or Noise, optional
        Noise std of the sensors, with where it comes from and how offsets drift: `loadid.Noise`. Where nobody states
        it, it is found with the prior.
    hold : {"joint", "foh", "zoh"}, optional
        How the load runs between samples. By default as its prior says (joint), where that has a length and the model
        has modes; else that of the model.
    model_error : mapping of str to float, or ModelErrors, optional
        Relative std of parameters of the model, as ``{"stiffness": 0.02}``: the variance between the models is added to
        the band. Parameters that are tuned, noise of the states, ambient loads: `loadid.ModelErrors`.
    gate : float or None
        Std of an innovation beyond which a channel is kept out, or an event of the load taken up, whichever is the
        likelier; None believes every number.
    online : Online
        Late answers, late samples, ranges of the sensors, what runs the filter: `loadid.Online`.
    sensors : sequence of str or int, optional
    allow : sequence of str, or Guards
        As in `Deconvolution`; ``"LID-E501"`` runs although no sensor sees a constant load: the std then grows as it
        should, and the flag stays.
    progress
        As in `Deconvolution`.

    Raises
    ------
    InputError
        Settings that do not fit.
    """

    name = "load tracking"

    @takes(
        codes={"allow_drift": "LID-E501"},
        prior=(Priors, "start dummy"),
        noise=(Noise, "source bias"),
        model_error=(ModelErrors, "scales state_noise ambient"),
        online=(Online, "lag replay limits engine"),
        allow=(Guards, "coverage"),
    )
    def __init__(
        self,
        model: Model,
        *,
        prior: Any = "matern32",
        noise: ArrayLike | Noise | None = None,
        hold: str | None = None,
        model_error: Mapping[str, float] | ModelErrors | None = None,
        gate: float | None = GATE,
        online: Online = Online(),  # noqa: B008 -- immutable
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        as_model(model, "LoadTracker", "state_space")
        believed, wrong, told_of = Priors.of(prior), ModelErrors.of(model_error), Guards.of(allow)
        given = believed.load if isinstance(believed.load, tuple) else (believed.load,) * len(model.loads)
        if len(given) != len(model.loads):
            raise InputError("one prior for each load", where="prior", found=f"{len(given)} priors",
                             expected=f"{len(model.loads)}, for {', '.join(c.label for c in model.loads)}")  # fmt: skip
        self.given = tuple(named(g) for g in given)
        self.online, errors = Online.of(online), dict(wrong.relative or {})
        if self.online.lag and errors:
            raise InputError("late answers know nothing of errors of the model", where="lag", found="model_error given",
                             expected="lag=0", hint="tune the model instead: ModelErrors(scales=...)")  # fmt: skip
        if self.online.engine != "own" and (self.online.lag or errors):
            raise InputError("filterpy answers at once, with one model", where="engine",
                             found="lag or model_error", expected="neither", hint="take the own engine")  # fmt: skip
        if gate is not None and not (real(gate) or 0) > 0:
            raise InputError("no gate", where="gate", found=repr(gate), expected="a number of stds > 0, or None")
        self.model, self.noise, self.hold, self.gate, self.sensors = model, Noise.of(noise), hold, gate, sensors
        self.scales, self.errors, self.state_noise = tuple(wrong.scales), errors, wrong.state_noise
        self.around = {"ambient": wrong.ambient, "bias": self.noise.bias, "start": believed.start,
                       "dummy": believed.dummy}  # fmt: skip
        self.allow, self.coverage = told_of.codes, told_of.coverage
        self._progress = Progress(progress)

    def fit(self, record: Any, dt: float | None = None) -> Tracker:
        """Settle noise, prior and gain on a record, and test what they are worth.

        Parameters
        ----------
        record : Record or array (samples, sensors)
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        Tracker
            Before its first sample.

        Raises
        ------
        InputError
            A record that does not fit the model.
        NotIdentifiable
            No sensor sees a constant part of a load, and its prior does not return to zero (LID-E501): unless
            it is allowed.
        """
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)
        limits = ranges(self.online.limits, [self.model.sensors[i].label for i in data.rows])
        data = within(data, limits)
        noise = noises.resolve(self.noise, self.model, data)
        if np.ndim(noise.level) != 1:
            raise InputError("a tracker takes a noise std per sensor", where="noise", found="a matrix",
                             expected="a number or (sensors,)")  # fmt: skip
        level = noise.level if noise.known else UNKNOWN * data.rms
        for name in (*self.scales, *self.errors):
            self.model.perturbed(name, 1.0)  # refused now, not after the search
        held = self.state_noise > 0 or any(not isinstance(g, Named) for g in self.given)
        posing = Posing(
            self.model, data.dt, data.rows, level, self.given, self._hold(), self.scales, self.state_noise,
            free_noise=held and not noise.known, around=self.around,
        )  # fmt: skip
        self._progress(0.02, "checking what the sensors can tell")
        size = self._size(posing, data)
        seen = self._observed(posing, size, data)
        # a walk that nobody sees has no steady filter: its rate is found with one that forgets slowly
        searched = posing if not seen.drifting else replace(posing, given=tuple(leaky(g, data.dt) for g in self.given))
        tuned = numbers_of(
            searched, data, size, noise.known, lambda s: self._progress(0.1 + 0.75 * s, "tuning by likelihood")
        )
        x, scale = tuned.x, tuned.scale
        model = posing.build(x, scale)
        settled = self._settled(model, data.dt)
        bank = tuple((w, m, self._settled(m, data.dt)) for w, m in posing.bank(x, self.errors, scale))
        self._progress(0.9, "testing the innovations")
        lengths = [float(length) / data.dt if isinstance(g, Named) and (length := tuned.words.get(name)) else None
                   for name, g in ((f"length of load {j + 1}", g) for j, g in enumerate(self.given))]  # fmt: skip
        certificate, e, wider, most = self._certified(model, settled, data, lengths)
        said = of_track(model, np.where(data.missing, np.nan, data.values), noise.known, self.model.loads)
        certificate = replace(certificate, told=said is None)
        fitted = TrackerFit(
            model=model,
            settled=settled,
            bank=bank,
            dt=data.dt,
            sensors=tuple(self.model.sensors[i] for i in data.rows),
            loads=tuple(self.model.loads),
            words="; ".join([*(p.words for p in posing.priors(x, scale)), *self._beliefs()]),
            numbers=tuned.words,
            noise_source=noise.source if noise.known else INNOVATIONS,
            certificate=certificate,
            flags=self._flags(data, seen, model, settled, certificate, e, tuned.flags),
            fingerprint=self.model.fingerprint,
            settings=self._settings(),
            inputs={data.record.source or data.record.name or "record": data.record.sha256},
            limits=limits,
            recipe=self._recipe(posing, x, scale),
            usual=usual(model, np.where(data.missing, np.nan, data.values)[:LONGEST]),
            wider=wider,
            most=most,
        )
        self._progress(1.0, "done")
        tracker = Tracker(fitted, self.gate, self._lag(settled), replay=self.online.replay, engine=self.online.engine)
        tracker.made_of(posing.scaled(x))
        return tracker

    def estimate(self, record: Any, dt: float | None = None) -> Any:
        """Fit to a record and track it from its first sample; see `Tracker.track`."""
        tracker = self.fit(record, dt)
        if isinstance(record, Record):
            return tracker.track(record)
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)  # a bare table may hold all sensors
        return tracker.track(np.where(data.missing, np.nan, data.values), dt)

    # -- inside -----------------------------------------------------------------------------------------------------
    def _hold(self) -> str | None:
        if self.hold is not None or self.model.structure is None:
            return self.hold
        smooth = all(getattr(g, "name", "") in JOINT or isinstance(g, OU | Matern32 | Matern52) for g in self.given)
        return "joint" if smooth else None

    def _beliefs(self) -> list[str]:
        """What is believed beside the priors of the loads, in words."""
        dummy = self.around["dummy"]
        return [] if dummy is None else [near_rest_in_words(dummy)]

    def _recipe(self, posing: Posing, x: Array, scale: float) -> Recipe | None:
        """How the filter is made of a model; None where that cannot be kept."""
        priors = posing.priors(x)
        if self.around["ambient"] is not None or not storable(priors):
            return None
        noise = np.ones(len(self.model.sensors))
        noise[posing.rows] = posing.factor(x) * posing.noise
        return Recipe(
            priors, noise, posing.rows, posing.hold, self.state_noise, self.around["bias"], self.around["start"],
            scale, dict(self.errors), self.around["dummy"],
        )  # fmt: skip

    def _lag(self, settled: SteadyFilter | None) -> int:
        if self.online.lag != "auto":
            return int(self.online.lag)
        if settled is None:
            return 0
        std = fixed_lag(settled, FAR).std
        return int(np.argmax(np.all(std <= NEARLY * std[-1], axis=1)))

    def _size(self, posing: Posing, data: Data) -> float:
        """Size of a load that makes the sensors move as they do: white, from rest."""
        h = self.model.impulse_response(data.dt, min(len(data.values), 4096), self.model.default_hold)[:, data.rows]
        gain = np.sqrt(np.sum(h**2, axis=(0, 2)))
        told = gain > 0
        if not told.any():
            raise NotIdentifiable("no sensor sees any load", advice="add a sensor that moves", code="LID-W201")
        return float(np.median(data.rms[told] / gain[told]))

    def _observed(self, posing: Posing, size: float, data: Data) -> Observability:
        priors = [g.make(*np.exp(g.starts(size, data.dt, len(data.values))[0])) if isinstance(g, Named) else g
                  for g in self.given]  # fmt: skip
        model = posing.filter(self.model, priors)
        space = self.model.state_space(data.dt, self.model.default_hold)
        rows = data.rows
        part = StateSpace(space.A, space.B, space.C[rows], space.D[rows], space.dt, space.hold,
                          sensors=[self.model.sensors[i] for i in rows], loads=self.model.loads)  # fmt: skip
        loads = [c.label for c in self.model.loads]
        found = observability(model, part, np.full(len(loads), size), loads=loads)
        told.refused(told.drifting(found), "LID-E501" in self.allow)
        return found

    def _settled(self, model: Any, dt: float) -> SteadyFilter | None:
        try:
            return steady(model, dt)
        except NotIdentifiable:
            if "LID-E501" in self.allow:
                return None
            raise

    def _certified(
        self, model: Any, settled: SteadyFilter | None, data: Data, lengths: Sequence[float | None]
    ) -> tuple[TrackCertificate, Array, Array | None, Array]:
        Y = np.where(data.missing, np.nan, data.values)[:LONGEST]
        engine = Engine(model, settled, None)
        if (start := beginning(model, settled, Y)) is not None:
            engine.ready = start.state(model)
        load, std, e = np.empty((len(Y), model.p)), np.empty((len(Y), model.p)), np.full(Y.shape, np.nan)
        engine.block(Y, load, std, e)
        first = min(max(len(Y) // 20, 10), len(Y) - 1)
        labels = [c.label for c in data.channels]
        constant = np.inf if settled is None else settled.time_constant
        nis = _nis(settled, e[first:])
        shares, wider = _left_out(model, data, first, settled, load, start)
        found = certify(e[first:], nis, shares, labels, constant, lengths)
        banded_one = banded(found, settled, [c.label for c in self.model.loads], data.dt)
        return banded_one, e[first:], wider, np.max(np.abs(load[first:]) + std[first:], axis=0)

    def _flags(
        self, data: Data, seen: Observability, model: Any, settled: SteadyFilter | None, certificate: TrackCertificate,
        e: Array, more: tuple[Flag, ...],
    ) -> tuple[Flag, ...]:  # fmt: skip
        tuned = any(isinstance(g, Named) for g in self.given)
        return guards.collect(
            [
                *self.model.flags,
                *health(data),
                guards.not_verified(self.model.certificate),
                told.drifting(seen),
                told.supposed(seen),
                told.unbalanced(model, self.state_noise),
                None if settled is None else told.slow(settled.time_constant, data.duration),
                told.untuned(certificate.nis, tuned=tuned),
                told.overconfident(certificate.nis, e, certificate.sensors),
                told.contradicting(certificate.left_out, certificate.sensors),
                told.believed(self.around["dummy"]),
                *more,
                guards.inverse_crime(data.record.simulated_by, self.model.fingerprint),
                guards.no_coverage(self.coverage),
            ]
        )

    def _settings(self) -> dict[str, Any]:
        return {
            "prior": [g.name if isinstance(g, Named) else g.words for g in self.given], "hold": self.hold,
            "scales": list(self.scales), "model_error": dict(self.errors), "state_noise": self.state_noise,
            "dummy": self.around["dummy"], "allow_drift": "LID-E501" in self.allow, "gate": self.gate,
            "engine": self.online.engine,
        }  # fmt: skip


def _nis(settled: SteadyFilter | None, e: Array) -> NDArray[np.float64]:
    """Normalised squares of the samples; of complete ones by the covariance of the innovation."""
    own = np.asarray(np.nansum(e**2, axis=1))
    if settled is None:
        return own
    whole = np.isfinite(e).all(axis=1)
    white = solve_lower(settled.Se_root, (e[whole] * settled.innovation_std).T)
    own[whole] = np.sum(white**2, axis=0)
    return own


def _left_out(
    model: Any, data: Data, first: int, settled: SteadyFilter | None, load: Array, start: MovingStart | None
) -> tuple[list[float | None], Array | None]:
    """Share of each channel inside the 95 % band that the others predict; None where they cannot.

    And by what the std of each load is too small: an optimal filter and the same with less data differ by a process of
    variance V_less - V. What the record has of it, over that, with the share of V_less that the channel takes away as
    weight; None where that is not more than `NOTHING`.
    """
    Y = data.values[:LONGEST]
    found: list[float | None] = []
    ratios, weights = np.zeros(model.p), np.zeros(model.p)
    for i in range(model.m):
        rest = np.delete(np.arange(model.m), i)
        if not len(rest) or data.missing.any():
            found.append(None)
            continue
        try:
            other = steady(restricted(model, rest))
        except (NotIdentifiable, InputError):
            found.append(None)
            continue
        x, arrived = _states(other, Y[:, rest], start)
        begin = max(first, arrived)
        if begin > len(Y) // 2:  # of a start that nothing tells: its spread is not the settled one
            found.append(None)
            continue
        row = model.H[i]
        spread = float(np.sqrt(np.sum((row @ other.L) ** 2) + np.sum(model.LR[i] ** 2)))
        found.append(float(np.mean(np.abs(Y[begin:, i] - x[begin:] @ row) < 1.96 * spread)))
        if settled is not None:
            more = np.maximum(other.std**2 - settled.std**2, 0.0)
            ratios += np.mean((x @ model.Cp.T - load)[begin:] ** 2, axis=0) / other.std**2
            weights += more / other.std**2
    wider = np.sqrt(np.divide(ratios, weights, out=np.ones(model.p), where=weights > LITTLE))
    return found, np.maximum(wider, 1.0) if np.any(wider > NOTHING) else None


def _states(filtered: SteadyFilter, Y: Array, start: MovingStart | None) -> tuple[NDArray[np.float64], int]:
    """Filtered states (samples, n) of a complete record, and the sample at which they are as sure as ever.

    At the settled gain; before it, those of a moving start.
    """
    x, out, first, arrived = filtered.model.x0, np.empty((len(Y), filtered.model.n)), 0, 0
    if start is not None:
        core = SquareRoot(filtered.model)
        state = core.update(start.state(filtered.model), Y[0])[0]
        while first < len(Y) - 1 and (far := filtered.distance(state.L)) > NEAR:
            out[first] = state.x
            first += 1
            arrived = first if far > AS_EVER else arrived
            state = core.advance(state, Y[first])[0]
        out[first] = x = state.x
        first += 1
    F, H, T = filtered.part.F, filtered.part.H, filtered.part.T
    for k in range(first, len(Y)):
        if k:  # where noises are correlated a sample tells of what moved the state after it
            x = F @ x if T is None else F @ x + T @ Y[k - 1]
        x = x + filtered.K @ (Y[k] - H @ x)
        out[k] = x
    return out, arrived
