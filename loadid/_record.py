"""What was measured, in SI, with a name and a unit for every column."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import units as _units
from structures._channels import Channel
from structures._flags import Flag
from structures._readonly import ReadOnly
from structures.errors import InputError, plain

from . import _exports, _objects, _stamps
from . import _quality as quality
from ._names import find
from ._names import refuse_copies as refuse_copies
from ._spectra import Spectra as Spectra

if TYPE_CHECKING:
    from datetime import datetime


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Record(ReadOnly):
    """Samples of some channels at a constant step.

    Parameters
    ----------
    values : array, shape (samples, channels) or (samples,)
        SI (or arbitrary) numbers; kept as read-only float64. NaN, and what a masked array hides, is a recorded gap,
        which `health` flags; infinite numbers are refused. A quantity of pint is converted and its unit kept; columns
        of a DataFrame keep their names.
    dt : float
        Step in s, or a quantity of pint.
    channels : sequence of Channel or str, or one of them
        One per column, with unique labels; a bare label is a channel in arbitrary units. None names them ch1, ch2, ...
    units : sequence of str, optional
        Unit in which each channel was recorded; default the unit of each channel.
    name, source : str
        Name of the record; file it came from.
    simulated_by : str
        Fingerprint of the model that simulated it; "" for measured records.
    flags : tuple of Flag
        What was found while reading.
    notes : tuple of str
        What was decided while reading (which axis is time, where the step comes from).
    file_dt : float, optional
        Step in s that the file states, where another one was stated in its place.
    start : float, str or datetime, optional
        When the first sample was taken: seconds since 1970 (UTC), an ISO 8601 text or a datetime, in UTC where they
        name no zone. Kept in seconds; None where it is not known.

    Raises
    ------
    InputError
        Empty or infinite values, a step that is not positive, labels that are missing or doubled.
    """

    values: NDArray[np.float64]
    dt: float
    channels: tuple[Channel, ...]
    units: tuple[str, ...]
    name: str
    source: str
    simulated_by: str
    flags: tuple[Flag, ...]
    notes: tuple[str, ...]
    file_dt: float | None
    start: float | None

    def __init__(
        self,
        values: ArrayLike,
        dt: float,
        channels: Sequence[Channel | str] | Channel | str | None = None,
        *,
        units: Sequence[str] | None = None,
        name: str = "",
        source: str = "",
        simulated_by: str = "",
        flags: Sequence[Flag] = (),
        notes: Sequence[str] = (),
        file_dt: float | None = None,
        start: float | str | datetime | None = None,
    ) -> None:
        values, names, unit = _objects.opened(values)
        table, dt = _table(values), _objects.seconds(dt)
        if channels is None:
            _refuse_transposed(table)
        described = _objects.in_unit(unit, _channels(names if channels is None else channels, table.shape[1]))
        recorded = tuple(c.unit for c in described) if units is None else tuple(units)
        if len(recorded) != len(described):
            raise InputError(
                "units do not fit the channels", where="record", found=recorded, expected=f"{len(described)}"
            )
        _refuse_infinite(table, described)
        settled: dict[str, Any] = {
            "values": table, "dt": _step(dt), "channels": described, "units": recorded, "name": str(name),
            "source": str(source), "simulated_by": str(simulated_by), "flags": tuple(flags), "notes": tuple(notes),
            "file_dt": None if file_dt is None else _step(file_dt),
            "start": _stamps.utc(start, "record, start"),
        }  # fmt: skip
        for key, value in settled.items():
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        what = ", ".join(f"{c.label} [{c.unit}]" for c in self.channels[:8]) + (
            ", ..." if len(self.channels) > 8 else ""
        )
        name = f"{self.name!r}: " if self.name else ""
        begun = "" if self.start is None else f" from {_stamps.iso(self.start)}"
        return f"Record({name}{len(self)} samples at {1 / self.dt:g} Hz{begun}, {what})"

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, channel: str | int) -> NDArray[np.float64]:
        return self.values[:, self.index(channel)]

    @property
    def fs(self) -> float:
        """Sampling frequency in Hz."""
        return 1.0 / self.dt

    @property
    def duration(self) -> float:
        """Number of samples times the step, in s."""
        return len(self) * self.dt

    @property
    def time(self) -> NDArray[np.float64]:
        """Time of each sample in s, from 0, shape (samples,)."""
        return np.arange(len(self), dtype=np.float64) * self.dt

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the channels."""
        return tuple(c.label for c in self.channels)

    @cached_property
    def sha256(self) -> str:
        """Digest of values, step and labels."""
        import hashlib

        digest = hashlib.sha256(self.values.astype("<f8").tobytes())
        digest.update(repr((self.values.shape, self.dt, self.labels)).encode())
        return digest.hexdigest()

    def index(self, channel: str | int) -> int:
        """Column of a channel, given by its label or by its index from 0 (also as text, ``"2"``).

        Raises
        ------
        InputError
            If there is none; the message lists the channels and the nearest one.
        """
        return find(channel, self.labels, what="channel", where=self.source or "record")

    def select(self, channels: Sequence[str | int] | str | int) -> Record:
        """Record of some channels, in the order given.

        Raises
        ------
        InputError
            A channel that is not there, or named twice.
        """
        wanted = [channels] if isinstance(channels, str | int | np.integer) else list(channels)
        columns = [self.index(c) for c in wanted]
        return replace(
            self,
            values=self.values[:, columns],
            channels=tuple(self.channels[i] for i in columns),
            units=tuple(self.units[i] for i in columns),
        )

    def window(self, start: float = 0.0, stop: float | None = None) -> Record:
        """Samples with start <= time < stop (s) as a record of their own, whose time runs from 0.

        Raises
        ------
        InputError
            If the window holds no sample.
        """
        stop = self.duration if stop is None else stop
        try:
            start, stop = float(start), float(stop)
        except (TypeError, ValueError):
            raise InputError(
                "the window is not a number", where="window", found=repr((start, stop))[:80], expected="seconds"
            ) from None
        if math.isnan(start) or math.isnan(stop):
            raise InputError("the window is not a number", where="window", found=(start, stop), expected="seconds")
        # A sample belongs to the window when its time is the limit up to rounding.
        first, last = (
            min(max(math.ceil(min(max(t / self.dt, -1.0), 2.0**53) - 1e-6), 0), len(self)) for t in (start, stop)
        )
        if first >= last:
            raise InputError("the window holds no sample", where="window", found=f"{start:g} to {stop:g} s",
                             expected=f"a part of 0 to {self.duration:g} s")  # fmt: skip
        begun = None if self.start is None else self.start + first * self.dt
        return replace(self, values=self.values[first:last], start=begun)

    def apply_units(self, units: Mapping[str | int, str]) -> Record:
        """The same recorded numbers with other units: ``record.apply_units({"F": "kN"})`` says what was recorded.

        Raises
        ------
        InputError
            Unknown channel or unit.
        """
        wanted = {self.index(key): _units.stated(u, channel=str(key)) for key, u in _units.as_mapping(units).items()}
        values, channels, recorded = np.array(self.values), list(self.channels), list(self.units)
        for i, unit in wanted.items():
            values[:, i] = _units.to_si(_units.from_si(values[:, i], _units.stated(recorded[i])), unit)
            channels[i] = replace(channels[i], unit=unit.si, quantity=unit.quantity)
            recorded[i] = unit.symbol
        return replace(self, values=values, channels=tuple(channels), units=tuple(recorded))

    @classmethod
    def from_dataframe(
        cls, frame: Any, *, fs: float | None = None, units: Mapping[str | int, Any] | None = None
    ) -> Record:
        """Record of a DataFrame of pandas or polars, settled as the columns of a file are.

        Parameters
        ----------
        frame : DataFrame
            The time is its DatetimeIndex or TimedeltaIndex, a named index, a column of stamps, or one named time.
            Units stand in the names, ``acc [g]``, or in ``frame.attrs["units"]`` by name.
        fs, units : optional
            As for `loadid.read`.

        Raises
        ------
        InputError
            No DataFrame, doubled names, no step, a unit that is not stated.
        """
        return cls(**_objects.of_frame(frame, fs, units))

    @classmethod
    def from_xarray(
        cls, array: Any, *, fs: float | None = None, units: Mapping[str | int, Any] | None = None
    ) -> Record:
        """Record of a DataArray of xarray with the dimension ``time`` and at most one other.

        Parameters
        ----------
        array : xarray.DataArray
            Names are the coordinate of the other dimension, units a coordinate ``unit`` along it or the attribute
            ``units``.
        fs, units : optional
            As for `loadid.read`.

        Raises
        ------
        InputError
            No DataArray, other dimensions, doubled names, no step, a unit that is not stated.
        """
        return cls(**_objects.of_xarray(array, fs, units))

    def to_dataframe(self) -> Any:
        """DataFrame of pandas, a column for each channel in SI; ``attrs`` hold units, step, name and start.

        The index is the time in s, or UTC stamps where `start` is known.
        """
        return _objects.to_dataframe(self)

    def to_xarray(self) -> Any:
        """DataArray (time, channel) in SI with the units as a coordinate; time as in `to_dataframe`."""
        return _objects.to_xarray(self)

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write a text table that `loadid.read` and spreadsheets read, every number to its last bit.

        Raises
        ------
        InputError
            Another suffix than .csv or .txt, or a file that cannot be written.
        """
        _exports.to_csv(self, path)

    def to_parquet(self, path: str | os.PathLike[str]) -> None:
        """Write a Parquet file: a column for the time and one for each channel, units in the metadata (pyarrow).

        Raises
        ------
        InputError
            Another suffix than .parquet or .pq, or a file that cannot be written.
        """
        _exports.to_parquet(self, path)

    def to_mat(self, path: str | os.PathLike[str]) -> None:
        """Write a MAT file (level 5): ``data``, ``dt``, ``channels`` and ``units`` (a line each), ``start``.

        Raises
        ------
        InputError
            Another suffix than .mat, or a file that cannot be written.
        """
        _exports.to_mat(self, path)

    def to_uff(self, path: str | os.PathLike[str]) -> None:
        """Write a universal file in SI (data sets 164 and 58b), a time response for each channel.

        Labels that name a degree of freedom (``12+Z``) are written as one.

        Raises
        ------
        InputError
            Another suffix than .uff, .unv or .ufb, a label of more than 20 bytes, or a file that cannot be written.
        """
        _exports.to_uff(self, path)

    def health(self) -> tuple[Flag, ...]:
        """Findings on the channels: clipped, saturated, flat, held and missing samples, offsets (W206)."""
        return quality.health(self)


def _table(values: ArrayLike) -> NDArray[np.float64]:
    try:
        raw = np.asarray(plain(values))
        if raw.dtype.kind not in "fiub":
            raise TypeError(f"numbers of type {raw.dtype}")
        table = np.array(raw, dtype=np.float64, order="C")  # a copy: the caller's array stays writable, ours does not
    except (TypeError, ValueError) as error:
        raise InputError(
            "values are no table of real numbers", where="record", found=str(error), expected="numbers"
        ) from None
    if table.ndim == 1:
        table = table[:, None]
    if table.ndim != 2 or table.size == 0:
        raise InputError(
            "values are no table", where="record", found=f"shape {table.shape}", expected="(samples, channels)"
        )
    table.setflags(write=False)
    return table


def _refuse_transposed(table: NDArray[np.float64]) -> None:
    """More columns than any instrument has channels, and fewer rows: an array that lies on its side."""
    rows, columns = table.shape
    if columns > max(rows, 64):
        raise InputError("more channels than samples: the array is probably transposed", where="record",
                         found=f"{rows} samples of {columns} channels", expected="(samples, channels)",
                         hint="transpose it (values.T), or name the channels if it is right")  # fmt: skip


def _step(dt: float) -> float:
    try:
        step = float(dt)
    except (TypeError, ValueError):
        step = math.nan
    if not (math.isfinite(step) and step > 0 and math.isfinite(1 / step)):
        raise InputError("the step is not positive", where="record", found=f"dt = {dt!r}", expected="seconds, > 0")
    return step


def _channels(given: Sequence[Channel | str] | Channel | str | None, columns: int) -> tuple[Channel, ...]:
    if given is None:
        given = [f"ch{i + 1}" for i in range(columns)]
    listed = [given] if isinstance(given, str | Channel) else list(given)
    channels = tuple(c if isinstance(c, Channel) else Channel(label=str(c)) for c in listed)
    labels = [c.label for c in channels]
    if len(labels) != columns:
        raise InputError("the labels do not fit the columns", where="record", found=f"{len(labels)} labels: {labels}",
                         expected=f"{columns}")  # fmt: skip
    double = {n: [i + 1 for i, m in enumerate(labels) if m == n] for n in labels if labels.count(n) > 1}
    if double or not all(n.strip() for n in labels):
        what = "labels are doubled" if double else "a label is empty"
        found = "; ".join(f"{n!r} over columns {', '.join(map(str, at))}" for n, at in double.items())
        raise InputError(what, where="record", found=found or labels, expected="unique names")
    return channels


def _refuse_infinite(table: NDArray[np.float64], channels: tuple[Channel, ...]) -> None:
    bad = np.isinf(table)
    if bad.any():
        row, column = (int(i) for i in np.argwhere(bad)[0])
        raise InputError("infinite values", where=f"channel {channels[column].label}",
                         found=f"{int(bad.sum())}, the first at sample {row}",
                         expected="finite numbers, or NaN for recorded gaps",
                         hint="repair the record, or mark these samples as NaN")  # fmt: skip
