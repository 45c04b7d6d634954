"""Learned maps: loads by a map that was learned from examples, and by the physics where readings are not like these."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures._model import Model, as_model, convolved, impulse_of
from structures._models.arrays import MatrixModel
from structures._readonly import ReadOnly
from structures.errors import InputError, one_of

from .. import _guards as guards
from .._learning import outputs as outs
from .._learning.adaptation import Adaptation, adapted, bias_of
from .._learning.calibration import Factors, calibrated, grown, halved, require_draws
from .._learning.checking import MapCheck, checked
from .._learning.engine import ENGINES, Engine, engine
from .._learning.linear import SPAN, span_facts
from .._learning.novelty import Novelty, Verdict
from .._learning.outputs import Outputs
from .._learning.posterior import HistoryPosterior, StaticPosterior, of_sums, over_time
from .._learning.training import Lesson, drawn, has_gaps, require_drawn, require_fit, require_model, scale_of
from .._results.estimate import Axis, LoadEstimate
from .._results.facts import Facts, provenance
from .._spellings import Progress
from .answer import over_time as along_time
from .data import gather, readings
from .deconvolution import Deconvolution
from .detection import PULSE, NotTold, half_sine, of_map
from .smoothness import geometry
from .static import StaticInversion

Array = NDArray[np.float64]

NAME = "learned map"
HOLDS = ("zoh", "foh")
PARTS = (0.7, 0.1, 0.2)  # of the draws: for parameters, for what is chosen beside them, for the std and the alarm


class LearnedMap:
    """Loads by a map learned from examples that physics wrote.

    `fit` learns it; what it returns answers. Readings unlike the examples are answered by `physics` instead, and said
    to be (LID-W609).

    Parameters
    ----------
    model : Model, or array (sensors, loads)
        The forward model that predicts what the load explains of the readings.
    engine : ``"linear"`` or ``"torch"``
        The best linear map of the ensemble, in closed form; or a network (extra ``learn``).
    output : ``"load"`` or ``"resultant"``
        What is mapped: every load, or their resultants.
    physics : a family, optional
        Answers where the map must not; default `StaticInversion` for static readings, `Deconvolution` for histories.
    hold : ``"zoh"`` or ``"foh"``, optional
        How loads run between samples, as in `Deconvolution`; default that of the model.
    coverage : float
        Of the band to which the std is calibrated.
    seed : int
        Of the parts of the training set.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        Unknown settings, or loads without a resultant where resultants are asked for.
    """

    name = NAME

    def __init__(
        self,
        model: Model | ArrayLike,
        *,
        engine: str = "linear",
        output: str = "load",
        physics: Any = None,
        hold: str | None = None,
        coverage: float = 0.95,
        seed: int = 0,
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.model = as_model(MatrixModel.of(model), "LearnedMap")
        self.engine = one_of("no such engine", engine, ENGINES, where="engine")
        self.output = one_of("no such output", output, ("load", "resultant"), where="output")
        if not (isinstance(coverage, float) and 0.5 <= coverage < 1):
            raise InputError("no coverage", where="coverage", found=coverage, expected="0.5 or more, below 1")
        self.hold = self.model.default_hold if hold is None else one_of("no such hold", hold, HOLDS, where="hold")
        self.physics, self.coverage, self.seed = physics, coverage, seed
        self.outputs = Outputs.of(self.model, self.output)
        self._progress = Progress(progress)

    def fit(
        self,
        training: Any,
        *,
        more: Sequence[tuple[Any, Any]] | None = None,
        unseen: Sequence[str] = (),
        **settings: Any,
    ) -> FittedMap:
        """Learn the map from a training set.

        Parameters
        ----------
        training : loadid.generate.TrainingSet
            Static readings or histories of the sensors and loads of the model.
        more : sequence of (record, known), optional
            As in `FittedMap.adapted`.
        unseen : sequence of str, optional
            Parameters of the draws that no reading tells, as the modulus of a gel: on either side of the median of
            each, the band of static loads that act holds as often as it says.
        **settings
            Of the engine.

        Returns
        -------
        FittedMap

        Raises
        ------
        InputError
            A set of other sensors, loads, units or model, with NaN, too small, or one that does not span the loads;
            names of no parameters.
        """
        require_fit(training, self.model)
        require_model(training, self.model)
        require_drawn(training, unseen)
        parts = training.split(PARTS, self.seed)
        require_draws(len(parts[2]))
        dt = training.dt
        self.model.require("static" if dt is None else "impulse_response", family="LearnedMap")
        scale = scale_of(training, self.model)
        lesson = Lesson(parts[0], parts[1], parts[2], scale, self.outputs.matrix, dt, tuple(unseen))
        learned = engine(self.engine).learn(lesson, progress=lambda f, t: self._progress(0.7 * f, t), **settings)
        self._progress(0.7, "what the examples are like")
        novelty = Novelty.learn(lesson)
        self._progress(0.8, "calibrating the std and the alarm")
        map_ = FittedMap(
            self.model, learned, self.outputs, Factors.none(self.outputs.group_of), novelty, lesson.scale, dt,
            self.physics,
            {"coverage": self.coverage, "draws": len(training), "training": training.fingerprint,
             "gaps": has_gaps(training), "hold": self.hold, **span_facts(learned, self.outputs.labels)},
        )  # fmt: skip
        map_ = _calibrated(map_, lesson, self.coverage)
        self._progress(1.0, "done")
        return map_ if more is None else map_.adapted(more)


@dataclass(frozen=True, eq=False)
class Prediction(ReadOnly):
    """What a map says of readings, before it is decided who answers.

    Parameters
    ----------
    mean, std : array (n, [samples,] outputs)
    residual : array (n, [samples,] sensors) or None
        Readings less the model's response to the load, SI; None of resultants.
    verdicts : tuple of Verdict
        One of each reading or record.
    shared : array (n, [samples,] k, outputs)
        Errors of unit std that all loads have in common, which are in the std: of the gains and of the bias that real
        records told.
    """

    mean: Array
    std: Array
    residual: Array | None
    verdicts: tuple[Verdict, ...]
    shared: Array

    @property
    def own(self) -> Array:
        """Std of each load without what all share."""
        return np.asarray(np.sqrt(np.maximum(self.std**2 - np.sum(self.shared**2, axis=-2), 0.0)))


@dataclass(frozen=True, eq=False)
class FittedMap(ReadOnly):
    """A map that was learned. Immutable; `LearnedMap.fit` makes it, `save` and `loadid.load_map` keep it.

    Parameters
    ----------
    model : Model
    engine : Engine
    outputs : Outputs
        What it answers.
    factors : Factors
        Of the std of the engine, by calibration.
    novelty : Novelty
    scale : array (sensors,)
        Std of the noise of each sensor, by which readings are divided.
    dt : float or None
        Step in s of the histories; None of static readings.
    physics : a family, or None
        Who answers instead; None for the default.
    facts : mapping
        Coverage, draws and fingerprint of the training set, whether readings are missing there; hold.
    adaptation : Adaptation, optional
        What real records told.
    along : array (lags, outputs, outputs), optional
        How errors of histories go along from sample to sample.
    sums : float
        What the std of sums over samples is multiplied with, by calibration.
    """

    model: Model
    engine: Engine
    outputs: Outputs
    factors: Factors
    novelty: Novelty
    scale: Array
    dt: float | None
    physics: Any
    facts: Mapping[str, Any]
    adaptation: Adaptation = field(default=None)  # type: ignore[assignment]
    along: Array | None = None
    sums: float = 1.0

    def __post_init__(self) -> None:
        if self.adaptation is None:
            none = Adaptation.none(len(self.outputs.labels), np.zeros(len(self.scale)))
            object.__setattr__(self, "adaptation", none)

    @cached_property
    def span_flags(self) -> list[Flag]:
        """LID-W616 of a map whose examples do not tell all loads apart."""
        known = {name: self.facts[name] for name in SPAN if name in self.facts}
        return guards.not_in_the_set(**known) if known else []

    # -- answering ----------------------------------------------------------------------------------------------------
    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Loads behind a record or static readings.

        Parameters
        ----------
        record : Record, array or mapping
            As `Deconvolution` (histories) and `StaticInversion` (static readings) take it.
        dt : float, optional
            Step in s of a bare array.

        Returns
        -------
        LoadEstimate
            ``facts.novelty`` above 1 is an alarm: the load is that of the physics then, with its std and LID-W609.

        Raises
        ------
        InputError
            Readings of other sensors, units or step, NaN; from the physics.
        """
        if self.dt is None:
            given = readings(record, self.model, None)
            values, axis, lost = given.values, given.axis, False
        else:
            data = gather(record, dt, self.model, None, allow_missing=True)
            self._require_step(data.dt)
            lost = bool(data.missing.any()) and not self.facts["gaps"]
            given = data  # type: ignore[assignment]
            values, axis = data.values[None], along_time(len(data.values), data.dt)
        told = self.predict(values)
        alarms = np.array([v.alarm or lost for v in told.verdicts])
        own = self._assembled(given, values, axis, told)
        if not alarms.any():
            return own
        fallback = self._physics().estimate(record) if dt is None else self._physics().estimate(record, dt)
        return _answered_by_physics(own, self.outputs.of_estimate(fallback), told.verdicts, alarms, lost)

    def predict(self, values: Array) -> Prediction:
        """What the map says of readings (frames, sensors) or records (n, samples, sensors), in SI."""
        clean = values - self.adaptation.bias
        mean, std = self.engine.predict(clean / self.scale)
        left = self.residual(clean, mean)
        white = None if left is None else left / self.scale
        verdicts = tuple(
            self.novelty.verdict(one / self.scale, None if white is None else white[i]) for i, one in enumerate(clean)
        )
        told = self.adaptation
        own, shared = self.factors.applied(mean, std) * np.abs(told.gain) * told.spread, told.shared(mean)
        std = np.hypot(own, np.linalg.norm(shared, axis=-2))
        return Prediction(mean * told.gain + told.offset, std, left, verdicts, shared)

    def mean(self, values: Array) -> Array:
        """Outputs (n, [samples,] outputs) alone of readings in SI."""
        found = self.engine.predict((values - self.adaptation.bias) / self.scale)[0]
        return np.asarray(found * self.adaptation.gain + self.adaptation.offset)

    def residual(self, values: Array, mean: Array) -> Array | None:
        """Readings (n, [samples,] sensors) less the response to outputs; None where the outputs are no loads."""
        if self.outputs.matrix is not None:
            return None
        if self.dt is None:
            return np.asarray(values - mean @ self.model.static().T)
        h = impulse_of(self.model, self.dt, values.shape[1], self.facts["hold"])
        return np.stack([v - convolved(h, m) for v, m in zip(values, mean, strict=True)])

    def check(
        self, held_out: Any, *, draws: int | None = None, progress: Callable[[float, str], None] | None = None
    ) -> MapCheck:
        """Errors, coverage and alarms on a training set that the map has not seen, kind by kind.

        Parameters
        ----------
        held_out : loadid.generate.TrainingSet
            Of another seed.
        draws : int, optional
            Only so many, the first ones.

        Raises
        ------
        InputError
            A set of other sensors, loads or step, or the one that it was learned from.
        """
        return checked(self, held_out, Progress(progress), draws)

    # -- real records -------------------------------------------------------------------------------------------------
    def adapted(
        self, more: Sequence[tuple[Any, Any]], *, of_sums: Callable[[Array, Array], Array] | None = None
    ) -> FittedMap:
        """The map with gain, bias, noise and alarm adapted to a few real records of known force.

        What a gain and a bias are off by is in the std afterwards.

        Parameters
        ----------
        more : sequence of (record, known)
            Known loads (loads,) or (samples, loads), or a mapping from the label of a resultant to its value (N, N m).
            Records of no load (all zero) tell the bias of the sensors.
        of_sums : callable, optional
            Std of the resultants (resultants,), of outputs and their std (outputs,), where it is known better.

        Raises
        ------
        InputError
            No records, or known loads that do not fit.
        """
        if not more:
            raise InputError("no records with known force", where="more", expected="pairs of a record and its load")
        read = [(self._values(record), self.outputs.known(given)) for record, given in more]
        unloaded = [values for values, known in read if not known.any]
        outputs, bias, off = len(self.outputs.labels), self.adaptation.bias, np.zeros((0, len(self.scale)))
        if unloaded:
            bias, std = bias_of(unloaded, self.scale, history=self.dt is not None)
            off = np.diag(std / self.scale)
        alone = Adaptation.none(outputs, bias, off @ self.engine.of_constant)
        plain = replace(self, adaptation=replace(alone, fixed=np.zeros((0, outputs)), by_gain=np.zeros((0, outputs))))
        loaded = [(plain.predict(values), known) for values, known in read if known.any]
        if not loaded:
            return replace(self, adaptation=alone)
        together = 1.0 if self.dt is None else 2.0 * self.engine.reach + 1
        found, W = alone, self._correlation
        for _ in range(2):  # errors are as large as the gain makes them
            size = np.abs(found.gain)
            told = [known.against(p.mean, p.std * size, W, together, of_sums) for p, known in loaded]
            found = adapted(told, self.outputs.groups, replace(alone, fixed=alone.fixed * size))
        seen = [v.scores for p, _ in loaded for v in p.verdicts]
        return replace(self, adaptation=found, novelty=self.novelty.widened(seen))

    @cached_property
    def _correlation(self) -> Array | None:
        """Factor of the correlation of errors of one static load or sample, where the engine knows it."""
        W = getattr(self.engine, "covariance", None)
        if W is None:
            return None
        size = np.linalg.norm(W, axis=0)
        return np.asarray(W / np.where(size > 0, size, 1.0))

    # -- files --------------------------------------------------------------------------------------------------------
    def save(self, path: Any) -> None:
        """Write the map to an HDF5 file, whole or not at all, with its model and no code.

        Raises
        ------
        InputError
            A model that is not kept in a file, or no place to write to.
        """
        from .._learning import file

        file.save(self, path)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _values(self, record: Any) -> Array:
        if self.dt is None:
            return readings(record, self.model, None).values
        data = gather(record, self.dt if not hasattr(record, "dt") else None, self.model, None)
        self._require_step(data.dt)
        return data.values[None]

    def _require_step(self, dt: float) -> None:
        if self.dt is not None and abs(dt / self.dt - 1) > 1e-6:
            raise InputError("the record and the map have different steps", where="estimate", found=f"dt = {dt:.9g} s",
                             expected=f"dt = {self.dt:.9g} s",
                             hint="resample, or learn a map for this step")  # fmt: skip

    def _physics(self) -> Any:
        if self.physics is not None:
            return self.physics
        if self.dt is None:
            return StaticInversion(self.model)
        return Deconvolution(self.model, hold=self.facts["hold"])

    def _assembled(self, given: Any, values: Array, axis: Axis | None, told: Prediction) -> LoadEstimate:
        """The answer of the map alone."""
        single = self.dt is not None or axis is None
        load, std = (x[0] if single else x for x in (told.mean, told.std))
        response = values[0] if single else values
        residual = None if told.residual is None else (told.residual[0] if single else told.residual)
        worst = max(told.verdicts, key=lambda v: v.value)
        model, basis = self.model, self.model.basis
        nothing = None if worst.alarm else self._not_told(values)
        flags = guards.collect([
            *([] if nothing is None else [nothing.flag]),
            *model.flags, guards.not_verified(model.certificate), *given.findings,
            guards.inverse_crime(given.simulated_by, model.fingerprint),
            guards.used_for_training("the record", given.fingerprints & model.training),
            *self.span_flags,
        ])  # fmt: skip
        facts = {
            "m": int(values.size), "n": int(load.size), "novelty": worst.value, "novelty_by": outs.words(worst),
            "answered_by": NAME, "engine": self.engine.name,
            "band": f"error of the map on draws kept apart, coverage {self.facts['coverage']:.0%}",
            **({} if nothing is None else nothing.facts),
        }  # fmt: skip
        settings = {"engine": self.engine.name, "adapted": self.adaptation.records, **self.facts}
        return LoadEstimate(
            load=load, std=std, axis=axis, labels=self.outputs.labels, units=self.outputs.units,
            response=None if residual is None else response, residual=residual,
            sensors=[c.label for c in given.channels], sensor_units=[c.unit for c in given.channels],
            flags=flags, certificate=model.certificate,
            geometry=None if basis is None or self.outputs.matrix is not None else geometry(basis),
            posterior=self._posterior(told, single), facts=Facts.of(facts),
            provenance=provenance(NAME, settings=settings, inputs=given.inputs, model=model.fingerprint,
                                  prior=f"loads like those of {self.facts['draws']} examples"),
        )  # fmt: skip

    def _not_told(self, values: Array) -> NotTold | None:
        """Whether the linear map finds a load in readings at all: one alone, or a hit in the middle of the record."""
        linear: Any = getattr(self.engine, "linear", self.engine)
        loads = self.model.loads
        if self.dt is None:
            seen, what = self.model.static().T, "a load of {} alone"
        else:
            samples = values.shape[1]
            hit, width = np.zeros((samples, 1)), min(PULSE, samples - samples // 2)
            hit[samples // 2 : samples // 2 + width, 0] = half_sine(width)
            h = impulse_of(self.model, self.dt, samples, self.facts["hold"])
            seen = np.stack([convolved(h[:, :, [j]], hit) for j in range(len(loads))])
            what = f"a hit (half sine of {1e3 * width * self.dt:.3g} ms) of {{}}"
        return of_map(linear, (values - self.adaptation.bias) / self.scale, seen / self.scale, loads, what)

    def _posterior(self, told: Prediction, single: bool) -> Any:
        W, sign = self._correlation, np.sign(self.adaptation.gain)
        own, shared = (x[0] if single else x for x in (told.own, told.shared))
        if self.dt is None:
            return None if W is None else StaticPosterior(W * sign, own, shared)
        if self.along is None:
            return None
        return HistoryPosterior(self.along * sign[:, None] * sign, own, shared, self.sums)


def _calibrated(map_: FittedMap, lesson: Lesson, coverage: float) -> FittedMap:
    """With factors of the std and limits of the alarm from the draws kept apart."""
    errors, means, stds, scores = [], [], [], []
    plain = Factors.none(map_.outputs.group_of, _share(map_, lesson, coverage))
    if lesson.dt is not None:
        map_ = replace(map_, novelty=_settled(map_, lesson))
    for data, truth in lesson.batches(lesson.calibrating):
        mean, std = map_.engine.predict(data)
        errors.append(mean - truth)
        means.append(mean)
        stds.append(plain.grown(mean, std))
        white = _white(map_, lesson, data, mean)
        scores += [map_.novelty.scores(x, None if white is None else white[i]) for i, x in enumerate(data)]
        samples = 0 if lesson.dt is None else data.shape[1]
    reach = None if lesson.dt is None else map_.engine.reach
    off, mean, std = np.concatenate(errors), np.concatenate(means), np.concatenate(stds)
    halves = halved(drawn(lesson.calibrating, lesson.unseen))
    found = calibrated(off, mean, std, map_.outputs.group_of, coverage, reach, plain.share, halves)
    if lesson.dt is not None:
        std = found.multiplied(mean, std)
        along = over_time(np.divide(off, std, out=np.zeros_like(off), where=std > 0))
        map_ = replace(map_, along=along, sums=1.0 if along is None else of_sums(off, std, along, coverage))
    return replace(map_, factors=found, novelty=map_.novelty.judged(scores, samples))


def _share(map_: FittedMap, lesson: Lesson, coverage: float) -> Array:
    """How errors grow with the load, by the examples that choose."""
    found = [(truth, *map_.engine.predict(data)) for data, truth in lesson.batches(lesson.choosing)]
    truth, mean, std = (np.concatenate(column) for column in zip(*found, strict=True))
    return grown(mean - truth, std, mean, map_.outputs.group_of, coverage)


def _settled(map_: FittedMap, lesson: Lesson) -> Novelty:
    """With what a record's mean is like among the examples that choose."""
    means, samples = [], 0
    for data, _ in lesson.batches(lesson.choosing):
        left = _white(map_, lesson, data, map_.engine.predict(data)[0])
        means += list((data if left is None else left).mean(axis=1))
        samples = data.shape[1]
    return map_.novelty.settled(means, samples)


def _white(map_: FittedMap, lesson: Lesson, data: Array, mean: Array) -> Array | None:
    """Residual of whitened data, in noise."""
    left = map_.residual(data * lesson.scale, mean)
    return None if left is None else left / lesson.scale


def _answered_by_physics(
    own: LoadEstimate, fallback: LoadEstimate, verdicts: Sequence[Verdict], alarms: NDArray[np.bool_], lost: bool
) -> LoadEstimate:
    """The estimate of the physics, in frames with an alarm or in all; with what was found."""
    worst = max(verdicts, key=lambda v: v.value)
    flag = guards.outside_training(worst.worst, outs.words(worst), worst.scores[worst.worst],
                                   worst.limits[worst.worst], int(alarms.sum()), len(alarms), lost)  # fmt: skip
    facts = {"novelty": worst.value, "novelty_by": outs.words(worst), "answered_by": "physics",
             "engine": own.facts["engine"]}  # fmt: skip
    if alarms.all():
        notes = {**fallback.provenance, "learned": dict(own.provenance)}
        return replace(fallback, flags=(flag, *fallback.flags), provenance=notes,
                       facts=Facts.of({**fallback.facts, **facts}))  # fmt: skip
    rows = alarms[:, None]
    residual = None
    if own.residual is not None and fallback.residual is not None:
        residual = np.where(rows, fallback.residual, own.residual)
    facts["answered_by"] = f"physics in {int(alarms.sum())} of {len(alarms)} frames"
    return replace(
        own, load=np.where(rows, fallback.load, own.load), std=np.where(rows, fallback.std, own.std),
        residual=residual, flags=(flag, *own.flags), posterior=None, facts=Facts.of({**own.facts, **facts}),
    )  # fmt: skip


def load_map(path: Any, *, model: Model | None = None, physics: Any = None) -> FittedMap:
    """Read a learned map that `FittedMap.save` wrote.

    Parameters
    ----------
    path : path
    model : Model, optional
        In place of the one in the file: it must be the same.
    physics : a family, optional
        Who answers where the map must not.

    Raises
    ------
    InputError
        A file that is missing, damaged, of another kind or version; a model that the map was not learned for.
    """
    from .._learning import file

    parts = file.load(path, model)
    return FittedMap(**parts, physics=physics)


def map_alone(path: Any) -> FittedMap:
    """A learned map to be held against examples, also where its file keeps no more of the model than its response.

    Raises
    ------
    InputError
        As `load_map`, but for that model.
    """
    from .._learning import file

    return FittedMap(**file.load(path, None, alone=True), physics=None)
