"""The job of a guide as objects: its model, its log, the records that are named as evidence, and estimates of them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures import Channel
from structures.errors import InputError, digests
from structures.files import _storage as storage

from .._commands import _inputs as inputs
from .._commands import load_model
from .._commands._job import OUTPUTS, resolved
from .._commands._job import read as read_job
from .._commands._settings import OPTIONS, known
from .._commands.identify import identify, plain_family

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._certificate import Certificate
    from structures._model import Model

    from .._record import Record
    from .._results.estimate import LoadEstimate

GROUP = "loadid.guide"  # entry points: suffix of a model file -> what a job of such a model is
SAMPLES = 8  # from which equal columns are the same record, and no coincidence
MODELS = (".h5", ".hdf5")
AMPLITUDES = ("harmonic",)  # families whose loads are amplitudes with a phase
SUM = "sum"  # resultant of loads of one unit, where no basis names others


@dataclass(frozen=True)
class Reading:
    """How records that are named as evidence are read.

    Parameters
    ----------
    given : mapping
        Keyword arguments of `loadid.read`; where there are none, those of the job.
    record : str or list of str, optional
        Record of a file that holds several.
    truth : sequence of str
        Channels of the known loads, in the order of the loads of the model; default those of the same names.
    """

    given: Mapping[str, Any]
    record: str | Sequence[str] | None = None
    truth: Sequence[str] = ()

    def said(self) -> dict[str, Any]:
        """What of it a signature keeps; empty where nothing was said."""
        record = {} if self.record is None else {"record": self.record}
        truth = {"truth": list(self.truth)} if self.truth else {}
        return {**self.given, **record, **truth}


def require_frozen(family: str) -> str:
    """The family, if it has a lambda that can be frozen, or a tuning.

    Raises
    ------
    InputError
        It has none, or finds a place before a load.
    """
    if family != "tracker" and ("choice" not in known(family) or family == "location"):
        raise InputError(
            "this family has no lambda that could be frozen", where="family of the job", found=family,
            expected="static, deconvolution, field, sparse, frequency, harmonic or tracker",
            hint="find the place first, with loadid identify --family location: its load is a job of deconvolution",
        )  # fmt: skip
    return family


Job = dict[str, Any]  # what a job file says, checked


def kind_of(job: Mapping[str, Any]) -> type[GuidedJob]:
    """What a job is by its model: a `GuidedJob`, or what another package names for model files of that suffix."""
    suffix = Path(str(job.get("model", ""))).suffix.lower().removeprefix(".")
    for point in entry_points(group=GROUP, name=suffix) if suffix else ():
        found: type[GuidedJob] = point.load()
        return found
    return GuidedJob


class GuidedJob:
    """A job as files: read when they are asked for, once.

    Parameters
    ----------
    job : mapping
        As `loadid._commands._job.read` gives it.
    reading : Reading
        Of evidence.
    certificate : Certificate, optional
        Of step 2: carried by the model in every estimate.
    """

    def __init__(self, job: Mapping[str, Any], reading: Reading, certificate: Any = None) -> None:
        self.job, self.reading, self._certificate = dict(job), reading, certificate

    over_time = True  # whether a record may tell of its channels whether they are sound

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Job:
        """What the file of a job says, its paths from the folder of the job on.

        Raises
        ------
        InputError
            As `loadid._commands._job.read`.
        """
        return read_job(path)

    @cached_property
    def model(self) -> Model:
        """The model of the job, with its certificate.

        Raises
        ------
        InputError
            It is missing, damaged, or no model.
        """
        model: Model = load_model(self.job["model"])
        if self._certificate is not None:
            model.certificate = self._certificate
        return model

    @cached_property
    def log(self) -> Any:
        """The log of the job: a Record, or readings by sensor.

        Raises
        ------
        InputError
            It is missing, damaged, or no log.
        """
        labels = [s.label for s in self.model.sensors]
        if self.model.gives("static") and not (self.job.get("record") or self.job.get("reading")):
            table = inputs.sensor_table(self.job["log"], labels)
            if table is not None:
                return table
        from .._readers import read

        return read(self.job["log"], record=self.job.get("record"), **self.job.get("reading", {}))

    @cached_property
    def family(self) -> str:
        """The family of the job; where it names none, the plain one of its data: a frozen lambda needs one family.

        Raises
        ------
        InputError
            One without a lambda that can be frozen.
        """
        named = str(self.job.get("family", "auto"))
        return require_frozen(plain_family(self.model, self.log) if named == "auto" else named)

    @cached_property
    def inverted(self) -> frozenset[str]:
        """Digests of the responses of the log: those that lambda was chosen on; of a single reading none."""
        from .._record import Record

        if not isinstance(self.log, Record) or len(self.log) < SAMPLES:
            return frozenset()
        return frozenset(digests(self.responses(self.log).values))

    @property
    def options(self) -> dict[str, Any]:
        """Settings of the family, as the job gives them."""
        return {name: value for name, value in self.job.items() if name in OPTIONS}

    def estimate(self, found: Any = None, *, tracker: Path | None = None, **override: Any) -> LoadEstimate:
        """The load of the log, or of a record, with some settings in place of those of the job, or by a tuned tracker.

        Raises
        ------
        InputError, NotIdentifiable
            From the family.
        """
        if tracker is not None:
            from .._families.tracking.tracker import Tracker

            return Tracker.load(tracker, self.model).track(self.responses(self.log if found is None else found))
        options = {**self.options, **override}
        if found is not None:  # its readings are averaged already
            options = {name: value for name, value in options.items() if name not in ("at", "mean")}
            found = self._as_read(found)
        return self._identified(self.log if found is None else found, options)

    def _identified(self, found: Any, options: Mapping[str, Any]) -> LoadEstimate:
        answer: LoadEstimate = identify(found, self.model, family=self.family, responses=self.job.get("responses"),
                                        **options)  # fmt: skip
        return answer

    def described(self) -> dict[str, Any]:
        """Figures of step 1 that the model itself does not state."""
        return {}

    def frozen_text(self, frozen: Mapping[str, Any], folder: Path) -> str:
        """The job with what was frozen, as a file."""
        job = {**self.job, **dict.fromkeys(OUTPUTS), "family": self.family}
        return resolved({**job, **frozen}, folder)

    def _as_read(self, record: Record) -> Any:
        """A record as a family takes it: a single reading by sensor."""
        if not self.static or len(record) > 1:
            return record
        responses = self.responses(record)
        return dict(zip(responses.labels, responses.values[0].tolist(), strict=True))

    # -- evidence -----------------------------------------------------------------------------------------------------
    def records(self, evidence: Sequence[Path]) -> list[Path]:
        """Evidence that is a log: what a reader knows by its suffix; anything else is attached as it is."""
        from .._readers.source import known_suffixes

        return [path for path in evidence if path.suffix.lower() in known_suffixes()]

    def certified(self, record: Record) -> Certificate | None:
        """A certificate that a kind of job makes in its own way; None where `checks.certified` does."""
        return None

    def resultants(self) -> dict[str, NDArray[np.float64]]:
        """Resultants (loads,) of the loads, by name: those of their basis, else the sum of loads of one unit."""
        model = self.model
        if model.basis is not None:
            return dict(zip(model.basis.resultant_labels, np.asarray(model.basis.resultant(), float), strict=True))
        return {SUM: np.ones(len(model.loads))} if len({c.unit for c in model.loads}) == 1 else {}

    def record(self, path: Path) -> Record:
        """A record that is named as evidence; of static readings the mean that the job takes.

        Raises
        ------
        InputError
            No log, or damaged.
        """
        from .._readers import read
        from .._readers.settle import ONE_READING
        from .._record import Record

        channels = {SUM: Channel(label=SUM)} | {c.label: c for c in (*self.model.sensors, *self.model.loads)}
        own = path.resolve() == storage.as_path(self.job.get("log") or ".").resolve()
        name = self.reading.record or (self.job.get("record") if own else None)
        given = dict(self.reading.given or self.job.get("reading", {}))
        if name is None and not given and (table := inputs.sensor_table(path, [*channels])) is not None:
            return Record(np.array([[*table.values()]]), ONE_READING, [channels[label] for label in table],
                          name=path.name, source=path.name)  # fmt: skip
        record = read(path, record=name, **given)
        return self._mean(record) if self.static else record

    @property
    def static(self) -> bool:
        """Whether records are static readings."""
        return self.job.get("family") == "static" or not (
            self.model.gives("impulse_response") or self.model.frequencies is not None
        )

    def _mean(self, record: Record) -> Record:
        settings: dict[str, Any] = {name: self.job[name] for name in ("at", "mean") if name in self.job}
        if not settings:
            return record
        means = inputs.reading(record, settings)
        return replace(record, values=np.array([[means[label] for label in record.labels]]))

    def responses(self, record: Record) -> Record:
        """The channels of the sensors of the model.

        Raises
        ------
        InputError
            One is missing, or of another unit.
        """
        return inputs.responses_of(record, self.model, self.job.get("responses"))

    def loads(self, record: Record) -> NDArray[np.float64] | None:
        """Known loads (samples, loads); loads that a record does not name are zero; None where it names none.

        Raises
        ------
        InputError
            Another number of channels than loads, another unit, a gap.
        """
        loads, truth = self.model.loads, list(self.reading.truth)
        if not truth and self.job.get("truth") is not None and len(loads) == 1:
            truth = [str(self.job["truth"])]
        if truth and len(truth) != len(loads):
            raise InputError("one channel per load is needed", where="--truth", found=", ".join(truth),
                             expected=f"{len(loads)}, for the loads {', '.join(c.label for c in loads)[:200]}",
                             hint="or name the channels of the record as the loads, and leave --truth out")  # fmt: skip
        named = dict(zip((c.label for c in loads), truth, strict=True)) if truth else {
            c.label: c.label for c in loads if c.label in record.labels
        }  # fmt: skip
        if not named:
            return None
        values = np.zeros((len(record.values), len(loads)))
        for j, load in enumerate(loads):
            if load.label in named:
                values[:, j] = _column(record, named[load.label], load)
        return values


def _column(record: Record, label: str, load: Any) -> NDArray[np.float64]:
    k = record.index(label)
    channel, column = record.channels[k], record.values[:, k]
    if "arbitrary" not in (channel.unit, load.unit) and channel.unit != load.unit:
        raise InputError(
            f"channel {label!r} is in another unit than the load {load.label!r}",
            where=record.name,
            found=channel.unit,
            expected=load.unit,
            hint=f"name the channel of the load (--truth), or its unit (--unit {label}={load.unit})",
        )
    if not np.all(np.isfinite(column)):
        raise InputError(f"the known load {label!r} has gaps", where=record.name,
                         found=f"{int(np.sum(~np.isfinite(column)))} missing samples", expected="a complete channel",
                         hint="name another record, or cut it to a part without gaps")  # fmt: skip
    return np.asarray(column, float)
