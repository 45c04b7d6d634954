"""Static readings as a user hands them over: one number per sensor, or one row per frame, matched and checked."""

from __future__ import annotations

import difflib
import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.channels import Channel
from structures.errors import InputError
from structures.flags import Flag
from structures.model import Model

from ..estimate import Axis
from ..record import Record
from .data import LARGEST, Data, gather, health, numbers, rows_of


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
    flags : tuple of Flag
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
    flags: tuple[Flag, ...] = ()
    data: Data | None = None

    @property
    def fingerprints(self) -> set[str]:
        """Digests of the used channels of a record."""
        return set() if self.data is None else self.data.fingerprints


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
    if isinstance(found, Record):
        data = gather(found, None, model, sensors, timed=False)
        over = Axis("time", "s", np.asarray(np.arange(len(data.values)) * data.dt, float))
        name = found.source or found.name or "record"
        return Readings(data.values, data.rows, data.channels, over, name, found.sha256, health(data), data)
    rows = rows_of(sensors, model)
    channels = tuple(model.sensors[i] for i in rows)
    table = _mapping(found, channels) if isinstance(found, Mapping) else _array(found, rows, model)
    bad = np.flatnonzero(~np.all(np.isfinite(np.atleast_2d(table)), axis=0))
    if bad.size:
        raise InputError(
            "NaN or infinity in the readings",
            where="estimate",
            found=[channels[i].label for i in bad],
            expected="a finite number per sensor",
            hint="leave a lost sensor out: sensors=[...] with the others",
        )
    if np.max(np.abs(table)) > LARGEST:
        raise InputError(
            "the readings are beyond the range of numbers",
            where="estimate",
            found=f"{np.max(np.abs(table)):.3g}",
            expected=f"at most {LARGEST:g}",
            hint="check the units",
        )
    single = table.ndim == 1
    axis = None if single else Axis("frame", "", np.arange(float(len(table))))
    table = np.atleast_2d(table)
    return Readings(table, rows, channels, axis, "readings", _digest(table, channels))


def _mapping(found: Mapping[str, Any], channels: Sequence[Channel]) -> NDArray[np.float64]:
    """Columns of a mapping from label to reading."""
    have = {str(k): v for k, v in found.items()}
    for channel in channels:
        if channel.label not in have:
            near = difflib.get_close_matches(channel.label, have, 1)
            raise InputError(
                "there is no reading of a sensor of the model",
                where="estimate",
                found=list(have),
                expected=f"a reading {channel.label!r}",
                hint=(f"did you mean {near[0]!r}? " if near else "") + "leave a lost sensor out: sensors=[...]",
            )
    known = {c.label for c in channels}
    extra = [k for k in have if k not in known]
    if extra:
        raise InputError(
            "a reading belongs to no sensor",
            where="estimate",
            found=extra[:8],
            expected=f"only {sorted(known)[:12]}",
            hint="take it out, or add the sensor to the model",
        )
    columns = [numbers(have[c.label], f"the reading {c.label!r} is no real number") for c in channels]
    shapes = {column.shape for column in columns}
    if len(shapes) > 1 or columns[0].ndim > 1 or columns[0].size == 0:
        raise InputError(
            "the readings have no common number of frames",
            where="estimate",
            found=f"shapes {sorted(shapes)}",
            expected="one number per sensor, or (frames,) of the same length for each",
        )
    return np.stack(columns, axis=-1)


def _array(found: Any, rows: NDArray[np.int_], model: Model) -> NDArray[np.float64]:
    """A bare array of all sensors of the model, or of the used ones."""
    table = numbers(found, "the readings are no numbers")
    wanted = (len(rows), len(model.sensors))
    if table.ndim not in (1, 2) or table.size == 0 or table.shape[-1] not in wanted:
        raise InputError(
            "the readings do not fit the model",
            where="estimate",
            found=f"shape {table.shape}",
            expected=f"({len(rows)},) or (frames, {len(rows)}): {[model.sensors[i].label for i in rows][:12]}",
            hint="one number per sensor, in the order of model.sensors",
        )
    return table if table.shape[-1] == len(rows) else table[..., rows]


def _digest(table: NDArray[np.float64], channels: Sequence[Channel]) -> str:
    digest = hashlib.sha256(table.astype("<f8").tobytes())
    digest.update(repr((table.shape, [c.label for c in channels])).encode())
    return digest.hexdigest()
