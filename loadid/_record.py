"""What was measured, in SI, with a name and a unit for every column: a record, or spectra on frequency lines."""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import units as _units
from structures._channels import Channel
from structures._flags import Flag
from structures._readonly import ReadOnly
from structures.errors import InputError, plain, reals

from . import _quality as quality
from ._inverse.problem import NoiseSource, NoiseSourceLike


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Record(ReadOnly):
    """Samples of some channels at a constant step.

    Parameters
    ----------
    values : array, shape (samples, channels) or (samples,)
        SI (or arbitrary) numbers; kept as read-only float64. NaN marks a recorded gap, which `health` flags; infinite
        numbers are refused.
    dt : float
        Step in s.
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
    ) -> None:
        table = _table(values)
        if channels is None:
            _refuse_transposed(table)
        described = _channels(channels, table.shape[1])
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
        }  # fmt: skip
        for key, value in settled.items():
            object.__setattr__(self, key, value)

    def __repr__(self) -> str:
        what = ", ".join(f"{c.label} [{c.unit}]" for c in self.channels[:8]) + (
            ", ..." if len(self.channels) > 8 else ""
        )
        name = f"{self.name!r}: " if self.name else ""
        return f"Record({name}{len(self)} samples at {1 / self.dt:g} Hz, {what})"

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
        return replace(self, values=self.values[first:last])

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

    def health(self) -> tuple[Flag, ...]:
        """Findings on the channels: clipped, saturated, flat, held and missing samples, offsets (W206)."""
        return quality.health(self)


def find(key: str | int, names: Sequence[str], *, what: str, where: str) -> int:
    """Position of a name, or of an index from 0 (an int, or its text where no name is that text).

    Raises
    ------
    InputError
        If there is none; the message lists the names and the nearest one. A name that several columns of a file carry.
    """
    if isinstance(key, str):
        if key in names:
            return list(names).index(key)
        refuse_copies(key, names, what=what, where=where)
        if key.strip().isascii() and key.strip().isdecimal() and len(key) < 9:
            key = int(key)
    if isinstance(key, int | np.integer) and not isinstance(key, bool) and -len(names) <= key < len(names):
        return int(key) % len(names)
    near = difflib.get_close_matches(str(key), names, n=1, cutoff=0.5)
    same = [n for n in names if n.lower() == str(key).strip().lower()]
    listed = ", ".join(f"{i}: {n}" for i, n in enumerate(names[:50])) + (", ..." if len(names) > 50 else "")
    raise InputError(
        f"there is no {what} {key!r}",
        where=where,
        found=f"the {what}s {listed}",
        expected="one of their names or indices",
        hint=f"did you mean {(same or near)[0]!r}?" if same or near else f"name one of the {what}s",
    )


def copy_of(name: str, column: int) -> str:
    """Label of one of several columns (counted from 1) over which a file writes the same name."""
    return f"{name} (column {column})"


def refuse_copies(name: str, names: Sequence[str], *, what: str, where: str) -> None:
    """Nothing, unless several columns of a file carry the name: it says which of them is meant nowhere.

    Raises
    ------
    InputError
        The columns, and how one of them is named.
    """
    label = re.compile(re.escape(name.strip()) + r" \(column (\d+)\)")
    alike = {i: match[1] for i, n in enumerate(names) if (match := label.fullmatch(n))}
    if alike:
        raise InputError(f"the {what} {name!r} could be several columns", where=where,
                         found=f"the name over {'columns' if len(alike) > 1 else 'another column, and over column'} "
                         f"{' and '.join(alike.values())}", expected="a name of its own for every column that is used",
                         hint="rename the columns in the file, or name the one that is meant: "
                         + " or ".join(f"{i} (index) or {names[i]!r}" for i in alike))  # fmt: skip


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


@dataclass(frozen=True, eq=False)
class Spectra(ReadOnly):
    """Complex amplitudes of responses on frequency lines, ``y(t) = Re[Y exp(i 2 pi f t)]`` on each.

    Parameters
    ----------
    frequencies : array, shape (lines,)
        Hz, ascending.
    values : array, shape (lines, sensors) or (lines,)
        In the units of the channels.
    channels : sequence of str or Channel, optional
        Names of the columns; without them the columns are the sensors of the model in its order.
    noise : float, array (sensors,) or (lines, sensors), optional
        Standard deviation of the amplitudes, ``sqrt(E|error|^2)``.
    noise_source : NoiseSource, str or (str, str), optional
        Where that level comes from.
    name : str

    Raises
    ------
    InputError
        Shapes that do not fit, NaN, lines that do not ascend, a noise that is no standard deviation.
    """

    frequencies: NDArray[np.float64]
    values: NDArray[np.complex128]
    channels: Sequence[str | Channel] = ()
    noise: ArrayLike | None = None
    noise_source: NoiseSourceLike = None
    name: str = "spectra"
    labels: tuple[str, ...] = field(init=False, default=())

    def __post_init__(self) -> None:
        put = object.__setattr__
        put(self, "frequencies", _lines(self.frequencies))
        put(self, "values", _values(self.values, len(self.frequencies)))
        put(self, "channels", tuple(self.channels))
        labels = tuple(c if isinstance(c, str) else c.label for c in self.channels)
        count = self.values.shape[1]
        if labels and (len(labels) != count or len(set(labels)) != count):
            raise InputError("the channels do not fit the spectra", where="Spectra", found=labels,
                             expected=f"{count} different names")  # fmt: skip
        put(self, "labels", labels)
        put(self, "noise_source", NoiseSource.of(self.noise_source))
        if self.noise is not None:
            put(self, "noise", _noise(self.noise, self.values.shape))


def _lines(frequencies: ArrayLike) -> NDArray[np.float64]:
    f = np.atleast_1d(reals(frequencies, what="these are no frequency lines", where="Spectra, frequencies"))
    if f.ndim != 1 or not len(f) or not np.all(np.isfinite(f)) or f[0] < 0 or np.any(np.diff(f) <= 0):
        raise InputError("these are no frequency lines", where="Spectra, frequencies", found=f"shape {f.shape}",
                         expected="finite Hz, ascending, each line once, none negative",
                         hint="negative frequencies: give the one-sided spectrum")  # fmt: skip
    f.flags.writeable = False
    return f


def _values(values: ArrayLike, lines: int) -> NDArray[np.complex128]:
    try:
        x = np.array(plain(values), complex)
    except (TypeError, ValueError):
        raise InputError("these are no numbers", where="Spectra, values", expected="complex amplitudes") from None
    x = x[:, None] if x.ndim == 1 else x
    if x.ndim != 2 or len(x) != lines or not x.size:
        found = f"shape {x.shape} on {lines} lines"
        hint = "transpose it: lines come first" if x.ndim == 2 and x.shape[1] == lines else ""
        raise InputError("spectra and lines do not fit", where="Spectra, values", found=found,
                         expected=f"({lines}, sensors)", hint=hint)  # fmt: skip
    if not np.all(np.isfinite(x)):
        raise InputError("NaN or infinity", where="Spectra, values",
                         found=f"{int(np.sum(~np.isfinite(x)))} of {x.size} values", expected="finite numbers",
                         hint="leave out the lines that were not measured")  # fmt: skip
    x.flags.writeable = False
    return x


def _noise(noise: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    level = reals(noise, what="the noise is no real number", where="Spectra, noise")
    if level.shape not in ((), shape[1:], shape) or not np.all(np.isfinite(level)) or np.any(level <= 0):
        found = f"shape {level.shape}" if level.ndim else f"{float(level):g}"
        raise InputError("the noise does not fit the spectra", where="Spectra, noise", found=found,
                         expected=f"positive: one number, {shape[1:]} or {shape}")  # fmt: skip
    level.flags.writeable = False
    return level
