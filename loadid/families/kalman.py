"""Online loads: joint estimation of the state of a structure and of what acts on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable, number, real
from structures.flags import Flag
from structures.model import Model, as_model
from structures.models.statespace import StateSpace

from .. import guards
from ..guards import tracking as told
from ..inverse.gaussian.lag import fixed_lag
from ..inverse.gaussian.model import words as near_rest_in_words
from ..inverse.gaussian.observe import Observability, observability
from ..inverse.gaussian.priors import OU, Matern32, Matern52
from ..inverse.gaussian.steady import SteadyFilter, steady
from ..inverse.noise_source import NoiseSource, NoiseSourceLike
from ..record import Record
from . import noise as noises
from .data import Data, gather, health
from .tracking.certificate import TrackCertificate, banded, certify
from .tracking.engine import Engine
from .tracking.filters import Named, Posing, leaky, named, restricted
from .tracking.fit import Recipe, TrackerFit, storable
from .tracking.judging import GATE
from .tracking.running import ENGINES
from .tracking.samples import ranges, within
from .tracking.tracker import Tracker
from .tracking.tuning import LONGEST, numbers_of

Array = NDArray[Any]

PARAMETERS = ("stiffness", "mass", "damping")
MOST, FAR, NEARLY = 1000, 50, 1.05  # of a lag; where it is judged, and how near to that is near enough
JOINT = ("ou", "matern32", "matern52")
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
    prior : str, prior, or one of them per load
        ``"matern32"`` (default), ``"matern52"``, ``"ou"``, ``"random_walk"``, ``"white"``: their numbers are found by
        likelihood. A prior of `loadid.inverse.gaussian.priors` is taken as it is.
    noise : float or array (sensors,), optional
        Noise std of the sensors. Where nobody states it, it is found with the prior.
    noise_source : NoiseSource, str or (str, str), optional
        As in `Deconvolution`.
    hold : {"joint", "foh", "zoh"}, optional
        How the load runs between samples. By default as its prior says (joint), where that has a length and the model
        has modes; else that of the model.
    scales : sequence of str
        Parameters of the model that are tuned too (``"stiffness"``, ``"mass"``, ``"damping"``).
    model_error : mapping of str to float, optional
        Relative std of parameters of the model: the variance between the models is added to the band.
    state_noise : float
        Std that a sample adds to each state of the structure.
    ambient : Ambient, optional
        Other loads, unknown and white, that disturb structure and sensors alike: the noises are then correlated
        (`loadid.inverse.gaussian.augment.Ambient`).
    bias : float or array (sensors of the model,)
        Std that a second adds to the offset of a sensor; 0: it does not drift.
    start : float, array or ``"static"``
        Std of the states before the first sample: at rest by default, or carrying the first load in equilibrium.
    dummy : float, optional
        Std in m within which displacements at the loads are believed to stay near zero, at every sample: a prior that
        holds the mean of loads which accelerometers alone let drift, and no measurement (flag W525).
    lag : int or "auto"
        Samples by which the answers come late, with what was measured meanwhile. ``"auto"``: as few as bring the std
        within 5 % of that at 50.
    allow_drift : bool
        Run although no sensor sees a constant load; the std then grows as it should (flag E501 stays).
    gate : float or None
        Std of an innovation beyond which a channel is kept out, or an event of the load taken up, whichever is the
        likelier; None believes every number.
    limits : number, sequence (sensors,) or mapping of label to one, optional
        Ends of the range of the sensors that are used, L for -L to L or (low, high): a sample at them counts as
        missing, in the fit and after it.
    replay : int, optional
        Samples by which a sample may come late and still be put in its place (`Tracker.insert`); the lag if left out.
    engine : {"own", "filterpy"}
        What runs the fitted filter. filterpy is slower, believes every number and answers at once: `gate` is without
        effect, `lag` and `model_error` are refused.
    sensors : sequence of str or int, optional
    allow, coverage, progress
        As in `Deconvolution`.

    Raises
    ------
    InputError
        Settings that do not fit.
    """

    name = "load tracking"

    def __init__(
        self,
        model: Model,
        *,
        prior: Any = "matern32",
        noise: ArrayLike | None = None,
        noise_source: NoiseSourceLike = None,
        hold: str | None = None,
        scales: Sequence[str] = (),
        model_error: Mapping[str, float] | None = None,
        state_noise: float = 0.0,
        ambient: Any = None,
        bias: ArrayLike = 0.0,
        start: ArrayLike | str = 0.0,
        dummy: float | None = None,
        lag: int | str = 0,
        allow_drift: bool = False,
        gate: float | None = GATE,
        limits: Any = None,
        replay: int | None = None,
        engine: str = "own",
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] = (),
        coverage: Any = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        as_model(model, "LoadTracker", "state_space")
        given = list(prior) if isinstance(prior, list | tuple) else [prior] * len(model.loads)
        if len(given) != len(model.loads):
            raise InputError("one prior for each load", where="prior", found=f"{len(given)} priors",
                             expected=f"{len(model.loads)}, for {', '.join(c.label for c in model.loads)}")  # fmt: skip
        self.given = tuple(named(g) for g in given)
        if model_error is not None and not isinstance(model_error, Mapping):
            raise InputError("no declared error of the model", where="model_error", found=repr(model_error)[:80],
                             expected="a mapping, such as {'stiffness': 0.02}")  # fmt: skip
        errors = dict(model_error or {})
        for name, std in errors.items():
            if name not in PARAMETERS or not 0 < (real(std) or 0.0) < 0.5:
                raise InputError("no declared error of the model", where="model_error", found=f"{name!r}: {std!r}",
                                 expected=f"a relative std between 0 and 0.5 of {', '.join(PARAMETERS)}")  # fmt: skip
        listed = isinstance(scales, list | tuple)
        if not listed or any(s not in PARAMETERS for s in scales) or len(set(scales)) != len(scales):
            raise InputError("no parameter of the model", where="scales", found=repr(scales)[:80],
                             expected=f"a list of some of {', '.join(PARAMETERS)}, each once")  # fmt: skip
        counted = isinstance(lag, int | np.integer) and not isinstance(lag, bool) and 0 <= lag <= MOST
        if not counted and lag != "auto":
            raise InputError("no lag", where="lag", found=repr(lag), expected=f"0 to {MOST} samples, or 'auto'")
        if lag and errors:
            raise InputError("late answers know nothing of errors of the model", where="lag", found="model_error given",
                             expected="lag=0", hint="tune the model instead (scales=)")  # fmt: skip
        self.lag = lag
        whole = isinstance(replay, int | np.integer) and not isinstance(replay, bool) and 0 <= replay <= MOST
        if replay is not None and not whole:
            raise InputError("no count of samples", where="replay", found=repr(replay), expected=f"0 to {MOST}")
        if engine not in ENGINES:
            raise InputError("no such engine", where="engine", found=repr(engine)[:80], expected=", ".join(ENGINES))
        if engine != "own" and (lag or errors):
            raise InputError("filterpy answers at once, with one model", where="engine",
                             found="lag or model_error", expected="neither", hint="take the own engine")  # fmt: skip
        self.limits, self.replay, self.engine = limits, replay, engine
        if gate is not None and not (real(gate) or 0) > 0:
            raise InputError("no gate", where="gate", found=repr(gate), expected="a number of stds > 0, or None")
        self.model, self.noise, self.noise_source, self.hold = model, noise, NoiseSource.of(noise_source), hold
        self.scales, self.errors = tuple(scales), errors
        self.state_noise = number("state_noise", state_noise, where="LoadTracker")
        self.around = {"ambient": ambient, "bias": bias, "start": start, "dummy": dummy}
        self.allow_drift, self.gate, self.sensors = bool(allow_drift), gate, sensors
        self.allow, self.coverage = guards.allowed(allow), coverage
        self._progress = progress or (lambda fraction, text: None)

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
            `allow_drift`.
        """
        data = gather(record, dt, self.model, self.sensors, allow_missing=True)
        limits = ranges(self.limits, [self.model.sensors[i].label for i in data.rows])
        data = within(data, limits)
        noise = noises.resolve(self.noise, self.noise_source, self.model, data)
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
        certificate, e = self._certified(model, settled, data)
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
        )
        self._progress(1.0, "done")
        tracker = Tracker(fitted, self.gate, self._lag(settled), replay=self.replay, engine=self.engine)
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
        if self.lag != "auto":
            return int(self.lag)
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
        told.refused(told.drifting(found), self.allow_drift or "LID-E501" in self.allow)
        return found

    def _settled(self, model: Any, dt: float) -> SteadyFilter | None:
        try:
            return steady(model, dt)
        except NotIdentifiable:
            if self.allow_drift or "LID-E501" in self.allow:
                return None
            raise

    def _certified(self, model: Any, settled: SteadyFilter | None, data: Data) -> tuple[TrackCertificate, Array]:
        Y = np.where(data.missing, np.nan, data.values)[:LONGEST]
        engine = Engine(model, settled, None)
        load, std, e = np.empty((len(Y), model.p)), np.empty((len(Y), model.p)), np.full(Y.shape, np.nan)
        engine.block(Y, load, std, e)
        first = min(max(len(Y) // 20, 10), len(Y) - 1)
        labels = [c.label for c in data.channels]
        constant = np.inf if settled is None else settled.time_constant
        nis = _nis(settled, e[first:])
        found = certify(e[first:], nis, _left_out(model, data, first), labels, constant)
        return banded(found, settled, [c.label for c in self.model.loads], data.dt), e[first:]

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
            "dummy": self.around["dummy"], "allow_drift": self.allow_drift, "gate": self.gate, "engine": self.engine,
        }  # fmt: skip


def _nis(settled: SteadyFilter | None, e: Array) -> NDArray[np.float64]:
    """Normalised squares of the samples; of complete ones by the covariance of the innovation."""
    own = np.nansum(e**2, axis=1)
    if settled is None:
        return own
    from ..inverse.gaussian.roots import solve_lower

    whole = np.isfinite(e).all(axis=1)
    white = solve_lower(settled.Se_root, (e[whole] * settled.innovation_std).T)
    own[whole] = np.sum(white**2, axis=0)
    return np.asarray(own)


def _left_out(model: Any, data: Data, first: int) -> list[float | None]:
    """Share of each channel inside the 95 % band that the others predict; None where they cannot."""
    Y = data.values[:LONGEST]
    found: list[float | None] = []
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
        x = _states(other, Y[:, rest])
        row = model.H[i]
        spread = float(np.sqrt(np.sum((row @ other.L) ** 2) + np.sum(model.LR[i] ** 2)))
        found.append(float(np.mean(np.abs(Y[first:, i] - x[first:] @ row) < 1.96 * spread)))
    return found


def _states(filtered: SteadyFilter, Y: Array) -> NDArray[np.float64]:
    """Filtered states (samples, n) of a complete record."""
    x, out = filtered.model.x0, np.empty((len(Y), filtered.model.n))
    F, H, T = filtered.part.F, filtered.part.H, filtered.part.T
    for k in range(len(Y)):
        if k:  # where noises are correlated a sample tells of what moved the state after it
            x = F @ x if T is None else F @ x + T @ Y[k - 1]
        x = x + filtered.K @ (Y[k] - H @ x)
        out[k] = x
    return out
