"""From what a user hands over to what a family inverts: the channels of the model, in its order, checked."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.channels import Channel
from structures.errors import InputError
from structures.flags import Flag
from structures.measured import MeasuredModel, digests
from structures.model import Model

from ..record import Record

SHORTEST = 4  # samples


@dataclass(frozen=True)
class Data:
    """The channels that are inverted.

    Parameters
    ----------
    values : array, shape (samples, used sensors)
    dt : float
    rows : array of int
        Rows of the model that are used.
    channels : tuple of Channel
        Of the record, in the order of `rows`.
    record : Record
        All channels of the record.
    """

    values: NDArray[np.float64]
    dt: float
    rows: NDArray[np.int_]
    channels: tuple[Channel, ...]
    record: Record

    @property
    def duration(self) -> float:
        """Length of the record in s."""
        return len(self.values) * self.dt

    @property
    def fingerprints(self) -> set[str]:
        """Digests of the used channels: a model made from hits knows those of its training."""
        return set(digests(self.values))


def gather(record: Any, dt: float | None, model: Model, sensors: Sequence[str | int] | None) -> Data:
    """Match a record to the sensors of a model: by label, or by position for bare arrays.

    Raises
    ------
    InputError
        A missing step or channel, units that do not fit, samples that are missing.
    """
    rows = rows_of(sensors, model)
    if not isinstance(record, Record) and np.iscomplexobj(record):
        raise InputError("a record of time is real", where="estimate", found="complex numbers", expected="real samples")
    if not isinstance(record, Record):
        record = _record(record, dt, model, rows)
    elif dt is not None and abs(dt / record.dt - 1) > 1e-9:
        raise InputError(
            "the record has its own step", where="estimate", found=f"dt = {dt}", expected=f"dt = {record.dt}"
        )
    wanted = [model.sensors[i] for i in rows]
    columns = [_column(s, record) for s in wanted]
    picked = record.select(columns)
    if len(picked.values) < SHORTEST:
        raise InputError(
            "too few samples",
            where=record.source or "record",
            found=len(picked.values),
            expected=f"at least {SHORTEST}",
        )
    for row, channel in zip(wanted, picked.channels, strict=True):
        # arrays without units are taken as they come; a model that states its unit wants it stated
        stated = row.unit != "arbitrary" or isinstance(model, MeasuredModel)
        if stated and row.unit != channel.unit:
            raise InputError(
                "the unit of a channel does not fit the sensor of the model",
                where=f"channel {channel.label}",
                found=channel.unit,
                expected=row.unit,
                hint=f"state the unit of the channel (--unit {channel.label}={row.unit})",
            )
    from ..quality import require_finite

    require_finite(picked)
    return Data(np.asarray(picked.values), record.dt, rows, picked.channels, record)


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
    return (*data.record.flags, *used.health())


def _record(values: Any, dt: float | None, model: Model, rows: NDArray) -> Record:
    if dt is None:
        raise InputError("the step of a bare array is not known", where="estimate", found="no dt", expected="dt= in s")
    table = np.asarray(values, float)
    table = table[:, None] if table.ndim == 1 else table
    wanted = [
        model.sensors[i]
        for i in (rows if table.ndim == 2 and table.shape[1] == len(rows) else range(len(model.sensors)))
    ]
    if table.ndim != 2 or table.shape[1] != len(wanted):
        raise InputError(
            "the record does not fit the model",
            where="estimate",
            found=f"shape {table.shape}",
            expected=f"(samples, {len(rows)}): {[model.sensors[i].label for i in rows]}",
        )
    return Record(table, dt, [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in wanted])


def _row(sensor: str | int, model: Model) -> int:
    labels = [s.label for s in model.sensors]
    if sensor in labels:
        return labels.index(str(sensor))
    if isinstance(sensor, int | np.integer) and not isinstance(sensor, bool) and -len(labels) <= sensor < len(labels):
        return sensor % len(labels)
    raise InputError("the model has no such sensor", where="sensors", found=repr(sensor), expected=f"one of {labels}")


def _column(sensor: Channel, record: Record) -> str:
    if sensor.label in record.labels:
        return sensor.label
    near = difflib.get_close_matches(sensor.label, record.labels, 1)
    raise InputError(
        "the record has no channel for a sensor of the model",
        where=record.source or "record",
        found=f"channels {list(record.labels)}",
        expected=f"a channel {sensor.label!r}",
        hint=(f"did you mean {near[0]!r}? " if near else "")
        + "name the columns (--columns), or leave the sensor out (sensors=[...])",
    )
