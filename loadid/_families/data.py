"""From what a user hands over, records or static readings, to what a family inverts: channels matched and checked."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Option, Spelling
from structures._channels import Channel
from structures._flags import Flag
from structures._model import Model
from structures._models.statespace import STABLE
from structures.errors import InputError, digests, plain, real, reals, shown

from .. import _objects
from .._quality import WITHOUT_GAPS, beyond_linear, require_finite
from .._record import Record, refuse_copies
from .._results.estimate import Axis

Array = NDArray[Any]

SHORTEST = 4  # samples of a history
LARGEST = 1e100  # of a reading, in any unit: its square must stay a number
SAME = 1e-6  # relative difference of two steps that is rounding of a file
WITH_GAPS = "Deconvolution of a model with state_space() or impulse_response() takes records with gaps"
WITHOUT_SENSOR = Spelling("leave the sensor out (sensors=[...])", "calibrate a model without this sensor")
AS_RECORDED = Spelling("give the step as recorded (dt=)", "give the sampling rate as recorded (--fs)")
LEFT_OUT = "nothing to do: they are left out of the fit, not filled in, and the std of the load shows what that costs"


@dataclass(frozen=True)
class Data:
    """The channels that are inverted.

    Parameters
    ----------
    values : array, shape (samples, used sensors)
        Zero where a sample is missing.
    dt : float
    rows : array of int
        Rows of the model that are used.
    channels : tuple of Channel
        Of the record, in the order of `rows`.
    record : Record
        All channels of the record.
    missing : array of bool, shape (samples, used sensors)
        Samples that were not recorded (NaN in the record); all False unless the family takes gaps.
    offsets : tuple of float
        What was subtracted from each channel; empty where nothing was.
    flags : tuple of Flag
        What was done to the values.
    filled : array of bool, shape (samples, used sensors), optional
        Samples that were not recorded and for which the response to a load stands; none of them is `missing`.
    """

    values: NDArray[np.float64]
    dt: float
    rows: NDArray[np.int_]
    channels: tuple[Channel, ...]
    record: Record
    missing: NDArray[np.bool_]
    offsets: tuple[float, ...] = ()
    flags: tuple[Flag, ...] = ()
    filled: NDArray[np.bool_] | None = None

    @property
    def duration(self) -> float:
        """Length of the record in s."""
        return len(self.values) * self.dt

    @property
    def floating(self) -> NDArray[np.int_]:
        """Used channels whose offset was subtracted, what is left of which is an unknown."""
        return np.flatnonzero(self.offsets)

    @property
    def rms(self) -> NDArray[np.float64]:
        """Root mean square of the recorded samples of every channel, shape (used sensors,)."""
        return np.asarray(np.sqrt(np.sum(self.values**2, axis=0) / np.maximum(np.sum(~self.missing, axis=0), 1)))

    @cached_property
    def gaps(self) -> str:
        """Missing samples in words, ``"40 of 1200 samples of s0, 2 of s1"``; "" where none is missing."""
        lost = np.sum(self.missing if self.filled is None else self.filled, axis=0)
        said = [(n, c.label) for n, c in zip(lost.tolist(), self.channels, strict=True) if n]
        if not said:
            return ""
        first, *others = said
        return ", ".join(
            [f"{first[0]} of {len(self.values)} samples of {first[1]}", *(f"{n} of {c}" for n, c in others)]
        )

    @property
    def fingerprints(self) -> set[str]:
        """Digests of the used channels: a model made from hits knows those of its training."""
        return set(digests(self.values))

    @property
    def inputs(self) -> dict[str, str]:
        """Name of the record -> its sha256."""
        return {self.record.source or self.record.name or "record": self.record.sha256}

    @property
    def simulated_by(self) -> str:
        """Fingerprint of the model that made the record; "" where it was measured."""
        return self.record.simulated_by

    @property
    def findings(self) -> tuple[Flag, ...]:
        """What reading found, and the health of the channels that are used."""
        return health(self)


def gather(
    record: Any,
    dt: float | None,
    model: Model,
    sensors: Sequence[str | int] | None,
    *,
    allow_missing: bool = False,
    timed: bool = True,
) -> Data:
    """Match a record to the sensors of a model: by label, or by position for bare arrays.

    Parameters
    ----------
    allow_missing : bool
        NaN marks a sample that was not recorded; else it is refused. A channel of NaN alone is refused by name.
    timed : bool
        The model is asked for histories: its step must be that of the record. False for static readings.

    Raises
    ------
    InputError
        A missing step or channel, units that do not fit, samples that are missing, an unstable model.
    """
    require_stable(model)
    rows = rows_of(sensors, model)
    if _objects.tabled(record):
        record = _of_table(record, dt, model)
    if not isinstance(record, Record):
        record = _record(record, dt, model, rows)
    elif dt is not None and not (real(dt) and abs(dt / record.dt - 1) < 1e-9):
        raise InputError(
            "the record has its own step", where="estimate", found=f"dt = {shown(dt)}",
            expected=f"dt = {record.dt:.9g} s", hint="leave dt out",
        )  # fmt: skip
    if timed:
        require_step(model, record.dt)
    wanted = [model.sensors[i] for i in rows]
    columns = [_column(s, record) for s in wanted]
    picked = record.select(columns)
    if len(picked.values) < (SHORTEST if timed else 1):
        raise InputError(
            "too few samples", where=record.source or "record", found=len(picked.values),
            expected=f"at least {SHORTEST if timed else 1}",
        )  # fmt: skip
    for row, channel in zip(wanted, picked.channels, strict=True):
        # arrays without units are taken as they come; a model that states its unit wants it stated
        stated = row.unit != "arbitrary" or model.sampled
        if stated and row.unit != channel.unit:
            raise InputError(
                "the unit of a channel does not fit the sensor of the model", where=f"channel {channel.label}",
                found=channel.unit, expected=row.unit,
                hint=_of_another_unit(channel, row),
            )  # fmt: skip
    return _settled(picked, rows, record, allow_missing)


def _of_another_unit(channel: Channel, sensor: Channel) -> str:
    """What to do with a channel in another unit than its sensor: a unit is advised only where the file states none."""
    if channel.quantity in (sensor.quantity, "arbitrary"):
        return f"state the unit of the channel (--unit {channel.label}={sensor.unit})"
    return (f"the channel is recorded as {channel.quantity} and the sensor measures {sensor.quantity}: take the "
            "channel of that sensor, or correct the unit where the file has it wrong")  # fmt: skip


def _settled(picked: Record, rows: NDArray[np.int_], record: Record, allow_missing: bool) -> Data:
    """The picked channels, with their gaps marked or refused."""
    missing = np.isnan(picked.values)
    empty = [c.label for c, lost in zip(picked.channels, missing.T, strict=True) if lost.all()]
    if empty:
        raise InputError(
            "a channel holds no number: every sample is missing (NaN)",
            where=record.source or "record",
            found=", ".join(empty),
            expected="samples on every channel that is inverted",
            hint=Advice(
                Spelling(
                    "leave the channel out (sensors=[...] with the others)", "calibrate a model without this channel"
                ),
                ", or repair the record",
            ),
        )
    if np.nanmax(np.abs(picked.values)) > LARGEST:
        raise InputError(
            "the readings are beyond the range of numbers", where=record.source or "record",
            found=f"{np.nanmax(np.abs(picked.values)):.3g}", expected=f"at most {LARGEST:g}", hint="check the units",
        )  # fmt: skip
    if not allow_missing:
        require_finite(picked, hint=Advice(WITHOUT_GAPS, "; ", WITH_GAPS))
    values = np.where(missing, 0.0, picked.values) if missing.any() else np.asarray(picked.values)
    return Data(values, record.dt, rows, picked.channels, record, missing)


def require_stable(model: Model) -> None:
    """Nothing, unless the model is a state space with a pole outside the unit circle.

    Raises
    ------
    InputError
        Names the pole: what grows without end cannot be told from the load.
    """
    if model.radius > STABLE:
        raise InputError(
            "the model is unstable: its response grows without end, and no load can be told from it",
            where="StateSpace", found=f"an eigenvalue of A of modulus {model.radius:.6g}", expected="at most 1",
            hint="check A and its step dt, and that it is discrete, not continuous (expm(A dt))",
        )  # fmt: skip


def require_step(model: Model, dt: float) -> None:
    """Nothing, unless the model was made for another step (s) than `dt`.

    Raises
    ------
    InputError
        Both steps.
    """
    own = model.dt
    if own is not None and abs(dt / own - 1) > SAME:
        raise InputError(
            "the record and the model have different steps", where="estimate", found=f"dt = {dt:.9g} s",
            expected=f"dt = {own:.9g} s", hint=Advice(AS_RECORDED, ", resample, or make the model for this step"),
        )  # fmt: skip


def rows_of(sensors: Sequence[str | int] | None, model: Model) -> NDArray[np.int_]:
    """Rows of the model that are used; None is all of them.

    Raises
    ------
    InputError
        If one is unknown or chosen twice.
    """
    if sensors is not None and (isinstance(sensors, str) or not hasattr(sensors, "__iter__")):
        raise InputError(
            "no list of sensors", where="sensors", found=repr(sensors)[:80], expected=f"a list, such as [{sensors!r}]"
        )
    rows = np.arange(len(model.sensors)) if sensors is None else np.array([_row(s, model) for s in sensors])
    if len(rows) == 0 or len(set(rows.tolist())) != len(rows):
        raise InputError(
            "choose each sensor once", where="sensors", found=sensors, expected="distinct sensors of the model"
        )
    return rows


def health(data: Data) -> tuple[Flag, ...]:
    """What reading found, and the health of the channels that are used."""
    used = data.record.select([c.label for c in data.channels])
    if data.offsets:
        used = replace(used, values=used.values - data.offsets)
    found = (*data.flags, *used.health())
    if data.gaps:  # what is refused elsewhere has been dealt with
        found = tuple(replace(f, advice=LEFT_OUT) if f.evidence.name == "missing" else f for f in found)
    return (*data.record.flags, *found)


def _of_table(values: Any, dt: float | None, model: Model) -> Record:
    """Record of a DataFrame or a DataArray: columns by name, in the units of the sensors where they state none."""
    return Record(**_objects.of_table(values, dt, {c.label: c.unit for c in model.sensors}))


def _record(values: Any, dt: float | None, model: Model, rows: Array) -> Record:
    if dt is None:
        raise InputError("the step of a bare array is not known", where="estimate", found="no dt", expected="dt= in s")
    table = numbers(values, "the record is no table of real numbers")
    table = table[:, None] if table.ndim == 1 else table
    wanted = [
        model.sensors[i]
        for i in (rows if table.ndim == 2 and table.shape[1] == len(rows) else range(len(model.sensors)))
    ]
    if table.ndim != 2 or table.shape[1] != len(wanted):
        raise InputError(
            "the record does not fit the model", where="estimate", found=f"shape {table.shape}",
            expected=f"(samples, {len(rows)}): {[model.sensors[i].label for i in rows]}",
        )  # fmt: skip
    return Record(table, dt, [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in wanted])


def numbers(values: Any, what: str) -> NDArray[np.float64]:
    """An array of real numbers; texts are refused even where they read as numbers, as their units are not known.

    Raises
    ------
    InputError
        With `what`.
    """
    values = plain(values)
    try:
        texts = np.asarray(values).dtype.kind in "US"
    except (TypeError, ValueError):  # rows of different lengths: `reals` says so
        texts = False
    if texts:
        hint = "read the file with loadid.read, or convert the texts to numbers"
        raise InputError(what, where="estimate", found="texts", expected="real numbers", hint=hint)
    return reals(values, what=what, where="estimate")


def _row(sensor: str | int, model: Model) -> int:
    labels = [s.label for s in model.sensors]
    if isinstance(sensor, str) and sensor in labels:
        return labels.index(sensor)
    if isinstance(sensor, int | np.integer) and not isinstance(sensor, bool) and -len(labels) <= sensor < len(labels):
        return sensor % len(labels)
    raise InputError("the model has no such sensor", where="sensors", found=repr(sensor), expected=f"one of {labels}")


def _column(sensor: Channel, record: Record) -> str:
    if sensor.label in record.labels:
        return sensor.label
    refuse_copies(sensor.label, record.labels, what="sensor", where=record.source or "record")
    near = difflib.get_close_matches(sensor.label, record.labels, 1)
    raise InputError(
        "the record has no channel for a sensor of the model",
        where=record.source or "record",
        found=f"channels {list(record.labels)}",
        expected=f"a channel {sensor.label!r}",
        hint=Advice(
            f"did you mean {near[0]!r}? " if near else "",
            "name the columns (",
            Option("columns"),
            "), or ",
            WITHOUT_SENSOR,
        ),
    )


@dataclass(frozen=True)
class Readings:
    """What is inverted.

    Parameters
    ----------
    values : array, shape (frames, used sensors)
    rows : array of int
        Rows of the model that are used.
    channels : tuple of Channel
        In the order of `rows`.
    axis : Axis or None
        Time or frame number; None for a single reading.
    name, sha256 : str
        Of the input, for the provenance.
    findings : tuple of Flag
        What was found while reading.
    data : Data or None
        The record behind it, where there is one.
    """

    values: NDArray[np.float64]
    rows: NDArray[np.int_]
    channels: tuple[Channel, ...]
    axis: Axis | None
    name: str
    sha256: str
    findings: tuple[Flag, ...] = ()
    data: Data | None = None

    @property
    def fingerprints(self) -> set[str]:
        """Digests of the used channels of a record."""
        return set() if self.data is None else self.data.fingerprints

    @property
    def inputs(self) -> dict[str, str]:
        """Name -> sha256."""
        return {self.name: self.sha256}

    @property
    def simulated_by(self) -> str:
        """Fingerprint of the model that made the record behind them; "" where there is none."""
        return "" if self.data is None else self.data.simulated_by


def readings(found: Any, model: Model, sensors: Sequence[str | int] | None) -> Readings:
    """Match readings to the sensors of a model: by label, or by position for bare arrays.

    Parameters
    ----------
    found : array (sensors,) or (frames, sensors), mapping of label to number(s), or Record
        In the units of the sensors.

    Raises
    ------
    InputError
        A missing sensor, shapes or units that do not fit, NaN.
    """
    if isinstance(found, Readings):
        return found
    if _objects.tabled(found):
        found = _frames(found, model)
    if isinstance(found, Record):
        data = gather(found, None, model, sensors, timed=False)
        times = np.asarray(np.arange(len(data.values)) * data.dt, float)
        over = None if len(times) == 1 else Axis("time", "s", times)
        name = found.source or found.name or "record"
        return Readings(data.values, data.rows, data.channels, over, name, found.sha256, health(data), data)
    rows = rows_of(sensors, model)
    channels = tuple(model.sensors[i] for i in rows)
    table = _mapping(found, channels) if isinstance(found, Mapping) else _array(found, rows, model)
    bad = np.flatnonzero(~np.all(np.isfinite(np.atleast_2d(table)), axis=0))
    if bad.size:
        raise InputError(
            "NaN or infinity in the readings", where="estimate", found=[channels[i].label for i in bad],
            expected="a finite number per sensor", hint="leave a lost sensor out: sensors=[...] with the others",
        )  # fmt: skip
    if np.max(np.abs(table)) > LARGEST:
        raise InputError(
            "the readings are beyond the range of numbers", where="estimate", found=f"{np.max(np.abs(table)):.3g}",
            expected=f"at most {LARGEST:g}", hint="check the units",
        )  # fmt: skip
    single = table.ndim == 1
    axis = None if single else Axis("frame", "", np.arange(float(len(table))))
    table = np.atleast_2d(table)
    strange = tuple(f for c, x in zip(channels, table.T, strict=True) for f in beyond_linear(c, float(np.abs(x).max())))
    return Readings(table, rows, channels, axis, "readings", _digest(table, channels), strange)


def _frames(found: Any, model: Model) -> Any:
    """A table of readings: its columns by name, or the record that it is where it has a time."""
    if _objects.home(found) == "xarray" or _objects.timed(found):
        return _of_table(found, None, model)
    known = {c.label for c in model.sensors}
    return (
        {str(n): found[n].to_numpy() for n in found.columns}
        if known & {str(n) for n in found.columns}
        else (found.to_numpy())
    )


def _mapping(found: Mapping[str, Any], channels: Sequence[Channel]) -> NDArray[np.float64]:
    """Columns of a mapping from label to reading."""
    have = {str(k): v for k, v in found.items()}
    for channel in channels:
        if channel.label not in have:
            near = difflib.get_close_matches(channel.label, have, 1)
            raise InputError(
                "there is no reading of a sensor of the model", where="estimate", found=list(have),
                expected=f"a reading {channel.label!r}",
                hint=(f"did you mean {near[0]!r}? " if near else "") + "leave a lost sensor out: sensors=[...]",
            )  # fmt: skip
    known = {c.label for c in channels}
    extra = [k for k in have if k not in known]
    if extra:
        raise InputError(
            "a reading belongs to no sensor", where="estimate", found=extra[:8], expected=f"only {sorted(known)[:12]}",
            hint="take it out, or add the sensor to the model",
        )  # fmt: skip
    columns = [numbers(have[c.label], f"the reading {c.label!r} is no real number") for c in channels]
    shapes = {column.shape for column in columns}
    if len(shapes) > 1 or columns[0].ndim > 1 or columns[0].size == 0:
        raise InputError(
            "the readings have no common number of frames", where="estimate", found=f"shapes {sorted(shapes)}",
            expected="one number per sensor, or (frames,) of the same length for each",
        )  # fmt: skip
    return np.stack(columns, axis=-1)


def _array(found: Any, rows: NDArray[np.int_], model: Model) -> NDArray[np.float64]:
    """A bare array of all sensors of the model, or of the used ones."""
    table = numbers(found, "the readings are no numbers")
    wanted = (len(rows), len(model.sensors))
    if table.ndim not in (1, 2) or table.size == 0 or table.shape[-1] not in wanted:
        raise InputError(
            "the readings do not fit the model", where="estimate", found=f"shape {table.shape}",
            expected=f"({len(rows)},) or (frames, {len(rows)}): {[model.sensors[i].label for i in rows][:12]}",
            hint="one number per sensor, in the order of model.sensors",
        )  # fmt: skip
    return table if table.shape[-1] == len(rows) else table[..., rows]


def _digest(table: NDArray[np.float64], channels: Sequence[Channel]) -> str:
    digest = hashlib.sha256(table.astype("<f8").tobytes())
    digest.update(repr((table.shape, [c.label for c in channels])).encode())
    return digest.hexdigest()
