"""The family and the prior that the data prefer: the plain one, unless another is clearly better; which, and why.

What is known of model and data decides the family: readings without time are static, tables of FRFs and spectra are
frequency lines, records are histories. Within it one question is asked, by a criterion that knows no truth:

- Histories that act throughout: is the load smooth over some samples? The evidence says over how many; taken where it
  states an error below `SURE` and below `SMALLER` of that of the plain prior, and the sensors tell slow loads apart.
  Impacts are asked for by `Deconvolution` itself.
- Static readings of loads with places: is the field smooth? Each sensor is predicted from the others; taken where the
  errors of these predictions are below `FORETOLD` of those of the plain prior.

``python -m tests.benchmarks.auto`` prints what that is worth: error and cost beside the plain prior and beside the best
in hindsight.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures._models.arrays import MatrixModel
from structures._testing.welch import CrossSpectra
from structures.errors import InputError, NotIdentifiable

from .._guards.inversion import UNSEEN
from .._inverse.svd import SVDPath
from .._record import Record, Spectra
from .._results.estimate import LoadEstimate
from .._results.facts import Facts
from .._spellings import Progress, takes
from ..settings import Guards, Noise, Penalty, Signal
from .data import Readings, gather, readings
from .deconvolution import Deconvolution
from .frequency import FrequencyInversion
from .posing.paths import LONGEST
from .static import StaticInversion

Array = NDArray[np.float64]

SURE = 0.45  # stated error of a smooth load, relative, up to which it may stand for the plain one
SMALLER = 0.7  # of what the plain one states
MIXED = 100.0  # condition number of the static responses, rows and columns scaled, up to which loads are told apart
FORETOLD = 0.6  # of the error of predicted sensors
FIELDS = ("gradient", "laplacian")  # penalties of static loads that know their places
FEWEST = 4  # sensors from which each is predicted from the others


@dataclass(frozen=True)
class Chosen:
    """An estimate, and why it was taken.

    Parameters
    ----------
    estimate : LoadEstimate
    family, because : str
        As it is called, and in words.
    """

    estimate: LoadEstimate
    family: str
    because: str


class AutomaticInversion:
    """Loads by the family and the prior that model and data ask for.

    It costs up to about three times the plain estimate, which it returns where nothing is clearly better;
    ``estimate.facts.chosen`` says what was taken and why.

    Parameters
    ----------
    model : Model
        Anything that one of the families takes.
    support, constraints, hold
        As in `Deconvolution`; constraints of static readings as in `StaticInversion`. With any of them the prior stays
        the plain one.
    signal, band
        As in `FrequencyInversion`, for records behind a table of FRFs.
    noise, sensors, allow, progress
        As in `Deconvolution`.

    Raises
    ------
    InputError
        Settings that do not fit the family which model and data decide.
    """

    name = "automatic"

    @takes(
        signal=(Signal, "window segment overlap"),
        noise=(Noise, "source"),
        allow=(Guards, "coverage load_class"),
    )
    def __init__(
        self,
        model: Model | ArrayLike,
        *,
        support: ArrayLike | None = None,
        constraints: Sequence[Any] = (),
        hold: str | None = None,
        signal: str | Signal | None = None,
        band: tuple[float, float] | None = None,
        noise: ArrayLike | Noise | None = None,
        sensors: Sequence[str | int] | None = None,
        allow: Sequence[str] | Guards = (),
        progress: Callable[[float, str], None] | None = None,
    ) -> None:
        self.model = model if isinstance(model, Model) else MatrixModel.of(model)
        self.histories: dict[str, Any] = {"support": support, "constraints": constraints, "hold": hold}
        self.lines: dict[str, Any] = {"signal": signal, "band": band}
        self.common: dict[str, Any] = {"noise": noise, "sensors": sensors, "allow": allow}
        self._progress = Progress(progress)

    def estimate(self, record: Any, dt: float | None = None) -> LoadEstimate:
        """Rebuild the loads behind a record, static readings, spectra or cross spectra.

        Parameters
        ----------
        record : Record, Spectra, CrossSpectra, array or mapping
            As the family takes it that `kind_of` names.
        dt : float, optional
            Step in s of a bare array; without it an array is static readings.

        Returns
        -------
        LoadEstimate

        Raises
        ------
        InputError, NotIdentifiable
            From the family.
        """
        kind = kind_of(self.model, record, dt)
        chosen = {"static": self._static, "lines": self._by_lines, "history": self._history}[kind](record, dt)
        self._progress(1.0, "done")
        facts = Facts.of({**chosen.estimate.facts, "chosen": f"{chosen.family}: {chosen.because}"})
        return replace(chosen.estimate, facts=facts)

    # -- each kind of data ------------------------------------------------------------------------------------------
    def _by_lines(self, found: Any, dt: float | None) -> Chosen:
        self._refuse(self.histories, "frequency lines")
        told = {**self.lines, **self.common, "allow": self._allowed("coverage")}
        own = FrequencyInversion(self.model, **told, progress=self._part(0.0, 1.0, "lines")).estimate(found, dt)
        return Chosen(own, "FrequencyInversion", "spectra, or a model that is a table of FRFs: each line with the "
                      "variances of its neighbours")  # fmt: skip

    def _static(self, found: Any, dt: float | None) -> Chosen:
        self._refuse({**self.lines, "support": self.histories["support"], "hold": self.histories["hold"]},
                     "static readings")  # fmt: skip
        told = {**self.common, "constraints": self.histories["constraints"], "allow": self._allowed("coverage")}
        given = readings(found, self.model, self.common["sensors"])

        def of(penalty: str) -> StaticInversion:
            return StaticInversion(self.model, penalty=penalty, **told)

        if told["constraints"] or self.model.basis is None or len(given.rows) < FEWEST:
            return Chosen(of("identity").estimate(given), _static_name("identity"), "static readings; no smooth field "
                          "is tried: the loads know no places, constraints were given, or fewer than "
                          f"{FEWEST} sensors are there to predict each other")  # fmt: skip
        tried = {name: _tried(of(name), given) for name in ("identity", *FIELDS)}
        best = min(tried, key=lambda name: tried[name].error)
        told_of = ", ".join(f"{name} {one.error:.2g}" for name, one in tried.items())
        because = f"static readings; tried by predicting each sensor from the others, errors over readings: {told_of}"
        if not tried[best].error < FORETOLD * tried["identity"].error:
            best, because = "identity", f"{because}; a field that is smooth is not clearly better"
        return Chosen(tried[best].estimate(), _static_name(best), because)

    def _history(self, found: Any, dt: float | None) -> Chosen:
        self._refuse(self.lines, "records of histories")
        told = {**self.histories, **self.common}
        plain = Deconvolution(self.model, **told, progress=self._part(0.0, 0.5, "plain prior")).estimate(found, dt)
        variance = plain.facts.get("variance")
        if variance == "local":
            return Chosen(
                plain, "Deconvolution", "the record asks for a load whose variance changes with time: impacts"
            )
        if self._asked:
            return Chosen(plain, "Deconvolution", "the plain prior, with which windows and constraints of a load go")
        tried = (
            "tried: the plain prior, and hits (a variance that changes with time), which the record does not ask for"
        )
        if variance != "constant":
            return Chosen(plain, "Deconvolution", "the plain prior, the only one that this model takes")
        if lacking := self._lacking(found, dt, len(plain.load)):
            return Chosen(plain, "Deconvolution", f"the plain prior; {tried}; not tried: a load that is smooth, as "
                          f"{lacking}")  # fmt: skip
        try:
            smooth = Deconvolution(
                self.model, penalty=Penalty(variance="smooth"), **told, progress=self._part(0.5, 1.0, "smooth load")
            ).estimate(found, dt)
        except (InputError, NotIdentifiable):  # no states, or too many: the plain prior stands
            return Chosen(plain, "Deconvolution", f"the plain prior; {tried}; a load that is smooth was refused")
        own, other = stated(plain), stated(smooth)
        memory = f"a load that is smooth over {smooth.facts['memory']:g} samples"
        if lost := _lost(smooth):
            return Chosen(plain, "Deconvolution", f"the plain prior; {tried}; {memory} leaves {', '.join(lost)} within "
                          "its own error, with a variance that was learned away")  # fmt: skip
        if other < min(SURE, SMALLER * own):
            return Chosen(smooth, "Deconvolution(penalty=Penalty(variance='smooth'))", f"the load acts throughout, and "
                          f"{memory} states an error of {other:.1%}, the plain prior {own:.1%}")  # fmt: skip
        return Chosen(plain, "Deconvolution", f"the plain prior; {tried}, and {memory}, which states an error of "
                      f"{other:.1%} where the plain prior states {own:.1%}: not clearly better")  # fmt: skip

    # -- inside -----------------------------------------------------------------------------------------------------
    @property
    def _asked(self) -> bool:
        """Something was asked for that holds with the plain prior alone."""
        return self.histories["support"] is not None or bool(_listed(self.histories["constraints"]))

    def _lacking(self, found: Any, dt: float | None, samples: int) -> str:
        """Why no smooth load is tried, in words; "" where one is.

        A process over states must be learned, by sensors that see constant loads and tell them apart: a load that is
        smooth has a slow part, which small noise would fit to errors of the model where they do not.
        """
        model = self.model
        if model.sampled or model.moving or not model.gives("state_space"):
            return "the model has no fixed states to learn one over"
        if samples > LONGEST:
            return f"the record is longer than {LONGEST} samples"
        data = gather(found, dt, model, self.common["sensors"], allow_missing=True)
        unseen = "no sensor sees the constant part of a load (a displacement or a strain would)"
        try:
            static = np.asarray(model.static()[data.rows], float)
        except (InputError, NotIdentifiable):
            return unseen
        hold = str(self.histories["hold"] or model.default_hold)
        h = model.impulse_response(data.dt, len(data.values), hold)
        whole = np.maximum(np.sum(np.abs(h[:, data.rows]), axis=0), np.finfo(float).tiny)
        if not np.all(np.max(np.abs(static) / whole, axis=0) >= UNSEEN):
            return unseen
        rows = static / np.maximum(np.linalg.norm(static, axis=1, keepdims=True), np.finfo(float).tiny)
        apart = np.linalg.cond(rows / np.linalg.norm(rows, axis=0)) <= MIXED
        return "" if apart else "the sensors do not tell constant loads at these places apart"

    def _allowed(self, *fields: str) -> Guards:
        """The guards without the fields that a family does not know."""
        own = Guards.of(self.common["allow"])
        return Guards(own.allow, **{name: getattr(own, name) for name in fields})

    def _part(self, low: float, high: float, what: str) -> Callable[[float, str], None]:
        """Progress of one of the families that are tried, said with its name: when it is done, the choice is not."""
        return lambda fraction, text: self._progress(low + (high - low) * fraction, f"{what}: {text}")

    def _refuse(self, given: dict[str, Any], kind: str) -> None:
        """Refuse settings of another kind of data."""
        for name, value in given.items():
            if value is not None and not (isinstance(value, list | tuple) and not len(value)):
                raise InputError(f"{kind} know no such setting", where=name, found=repr(value)[:80],
                                 expected="nothing", hint="leave it out, or name the family")  # fmt: skip


def kind_of(model: Model, found: Any, dt: float | None = None) -> str:
    """What data are to a model: ``"static"`` readings, frequency ``"lines"`` or a ``"history"``.

    Raises
    ------
    InputError
        Data that no family takes with this model.
    """
    if isinstance(found, Spectra | CrossSpectra) or (
        isinstance(found, list) and found and isinstance(found[0], Record)
    ):
        return "lines"
    timed = isinstance(found, Record) and len(found.values) > 1
    if model.gives("impulse_response") and (timed or dt is not None):
        return "history"
    if timed and not model.gives("static") and model.gives("frf"):
        return "lines"
    if model.gives("static"):
        return "static"
    if model.gives("frf") and isinstance(found, Record):
        return "lines"
    raise InputError("no family takes these data with this model", where="auto", found=type(found).__name__,
                     expected="a record for a model of histories, readings for one with static(), spectra for FRFs",
                     hint="state the step of a bare array (dt=)")  # fmt: skip


def stated(estimate: LoadEstimate) -> float:
    """Root mean square std over that of the load."""
    size = float(np.sqrt(np.mean(np.abs(estimate.load) ** 2)))
    return float(np.sqrt(np.mean(estimate.std**2))) / size if size > 0 else float("inf")


def _lost(estimate: LoadEstimate) -> list[str]:
    """Loads that are smaller than their std (rms): the likeliest variance of a load that little tells may be none."""
    size, std = (np.sqrt(np.mean(np.abs(x) ** 2, axis=0)) for x in (estimate.load, estimate.std))
    return [label for label, gone in zip(estimate.labels, size < std, strict=True) if gone]


@dataclass(frozen=True)
class _Tried:
    """A static family at the lambda of all sensors, and how well it predicts each sensor from the others.

    `estimate` answers from what was posed and chosen for the trial.
    """

    error: float
    estimate: Callable[[], LoadEstimate]


def _tried(family: StaticInversion, given: Readings) -> _Tried:
    try:
        posed = family.pose(given)
        family.refuse_undetermined(posed)
        choice = family.choose(posed)
    except (InputError, NotIdentifiable):  # a penalty that these loads or sensors do not take
        return _Tried(float("inf"), partial(family.estimate, given))
    return _Tried(_foretold(posed.base, choice.lam), partial(family.kept, given, posed, choice))


def _foretold(path: SVDPath, lam: float) -> float:
    """Error of each sensor as the others predict it, rms over that of the readings, whitened; at one lambda.

    With the hat matrix A of the path the prediction of a datum without itself leaves r_i / (1 - A_ii) (D. Allen,
    Technometrics 16 (1974) 125).
    """
    passed = path.filter_factors(lam)[: path.U.shape[1]]
    own = np.einsum("ik,k,ik->i", path.U, passed, path.U)
    rest = np.asarray(path.residual(lam)).reshape(-1, len(own))
    data = np.atleast_2d(path.problem.y.T)
    left = rest / np.maximum(1 - own, np.finfo(float).eps)
    return float(np.linalg.norm(left) / max(float(np.linalg.norm(data)), np.finfo(float).tiny))


def _static_name(penalty: str) -> str:
    return f"StaticInversion(penalty={penalty!r})"


def _listed(given: Any) -> list[Any]:
    return list(given) if isinstance(given, list | tuple) else [given]
