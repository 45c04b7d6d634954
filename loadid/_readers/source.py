"""What a reader is given, what it hands back, how much of a file it may unpack, and which reader takes which file."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, either
from structures._flags import Evidence, Flag
from structures.errors import InputError

BUDGET = 2**31  # bytes that one file may hold when unpacked
EXPANSION = 100  # a file that unpacks to more than this multiple of its size is not a log ...
FREE = 2**26  # ... once it takes more than this many bytes
COLUMNS = 4096


RATE = Advice("state it: ", either("fs=HZ", "--fs HZ"))


class NotStated(InputError):
    """The file is sound, but something must be stated before it can be read: a unit, or the sampling frequency."""


@dataclass(frozen=True)
class Source:
    """A file that is being read.

    Parameters
    ----------
    path : Path
    size : int
        Bytes on disk.
    head : bytes
        The first 4096 bytes, for sniffing.
    place : Path, optional
        Where the file is opened, when that differs from the path that messages name.
    """

    path: Path
    size: int
    head: bytes
    place: Path | None = None

    def data(self) -> bytes:
        """The whole file.

        Raises
        ------
        InputError
            If it exceeds the byte budget.
        """
        self.allow(self.size)
        return self.path.read_bytes()

    def allow(self, declared: int, what: str = "the file") -> None:
        """Nothing, if so many bytes may be unpacked from this file.

        Raises
        ------
        InputError
            If the declared size exceeds the budget, or is out of proportion to the file.
        """
        limit = min(BUDGET, max(FREE, EXPANSION * self.size))
        if declared > limit:
            self.refuse(f"{what} declares more than may be read", f"{declared} bytes", f"at most {limit} bytes")

    def refuse(
        self,
        what: str,
        found: object = None,
        expected: object = None,
        hint: str = "export or transfer the file again",
        kind: type[InputError] = InputError,
    ) -> NoReturn:
        """Raise an InputError that names this file."""
        raise kind(what, where=str(self.path), found=found, expected=expected, hint=hint)


@dataclass(frozen=True)
class Options:
    """What the caller of `read` stated; see there."""

    fs: float | None = None
    columns: Sequence[str | int] | None = None
    axis: int | None = None
    units: Mapping[str | int, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class RecordOutline:
    """What is known of a record before its units and its step are stated; channels without the time column.

    Parameters
    ----------
    name : str
    samples : int
    labels : tuple of str
    units : tuple of (str or None)
    dt : float or None
        Step in s.
    notes : tuple of str
    start : float or None
        When the first sample was taken, in s since 1970 (UTC).
    """

    name: str
    samples: int
    labels: tuple[str, ...]
    units: tuple[str | None, ...]
    dt: float | None
    notes: tuple[str, ...] = ()
    start: float | None = None


@dataclass(frozen=True)
class Table:
    """One record as the file holds it: nothing named, scaled or left out yet.

    Parameters
    ----------
    values : array, shape (samples, columns)
        Numbers as recorded, a time column included.
    name : str
        Name of the record within the file.
    columns : tuple of str or None
        Names of the columns; None where the file gives none.
    units : tuple of (str or None) or None
        Unit texts of the columns, None where the file gives none.
    dt : float or None
        Step that the file states, in s.
    time : int or None
        Column that is known to be time; None: to be recognised.
    flags : tuple of Flag
    notes : tuple of str
        What was decided.
    start : float or None
        When the file says that the record began, in s since 1970 (UTC): the first sample or, where there is a time
        column, its zero. Where `begun` is given, the seconds after it.
    begun : str
        Date and time from which `start` counts, as the file writes them: in their own zone, else in the one that is
        stated for ``time``, else in UTC.
    stamps : array, shape (samples,), or None
        When each sample was taken: texts, or ``datetime64``; in the place of a time column.
    clock : str
        Name of the column of the stamps.
    aware : bool
        Stamps of kind ``datetime64`` are in UTC (else in local time, of a zone that the file does not name).
    interpolation : tuple of float or None
        Rms error of each column that was interpolated, as recorded; NaN where it is not known.
    """

    values: NDArray[Any]
    name: str = ""
    columns: tuple[str, ...] | None = None
    units: tuple[str | None, ...] | None = None
    dt: float | None = None
    time: int | None = None
    flags: tuple[Flag, ...] = ()
    notes: tuple[str, ...] = ()
    start: float | None = None
    begun: str = ""
    stamps: NDArray[Any] | None = None
    clock: str = "time"
    aware: bool = False
    interpolation: tuple[float, ...] | None = None


def time_first(table: Table, source: Source, options: Options) -> Table:
    """A table from a bare array with time along its first axis; says which axis was taken.

    Raises
    ------
    InputError
        More than two axes, none at all, or a square array without ``axis=``.
    """
    x, known = table.values, table.columns
    if x.ndim == 1:
        return replace(table, values=x[:, None])
    if x.ndim != 2 or x.size == 0:
        source.refuse(
            "the array is no record", f"{table.name or 'array'}: shape {x.shape}", "(samples,) or (samples, channels)"
        )
    axis, long = options.axis, int(np.argmax(x.shape))
    if axis is None and known is not None and x.shape.count(len(known)) == 1:
        axis, said = 1 - x.shape.index(len(known)), "the other one fits the channel names"
    elif axis is None:
        if x.shape[0] == x.shape[1]:
            source.refuse("the array is square: either axis may be time", f"shape {x.shape}",
                          "axis=0 (rows are samples) or axis=1 (columns are samples)",
                          "state it: --axis 0 or --axis 1")  # fmt: skip
        axis, said = long, "the longer one"
    else:
        said = "as stated"
    note = f"axis {axis} of {x.shape} is time ({said}; state the axis to change it)"
    return replace(table, values=x.T if axis == 1 else x, notes=(*table.notes, note))


def truncated(delivered: int, declared: int, what: str = "samples") -> Flag:
    """Flag W209: a file that ends before what it declares."""
    return Flag(
        "W209",
        Evidence("delivered", float(delivered), float(declared)),
        f"truncated: {delivered} of {declared} {what}",
    )


def since(stamps: NDArray[np.datetime64]) -> tuple[NDArray[np.float64], float | None]:
    """Seconds after the first of some time stamps, exact to the nanosecond, and that first one in s since 1970.

    NaN where a stamp is missing; no first one where all are.
    """
    good = ~np.isnat(stamps)
    if not good.any():
        return np.full(len(stamps), np.nan), None
    first = stamps[good][0].astype("datetime64[ns]")
    away = (stamps.astype("datetime64[ns]") - first).astype(np.int64)
    return np.where(good, away / 1e9, np.nan), seconds_of(int(first.astype(np.int64)))


def seconds_of(nanoseconds: int) -> float:
    """Nanoseconds since 1970 in s, to the last bit: as a float they are counted in steps of 256."""
    whole, part = divmod(nanoseconds, 10**9)
    return whole + part / 1e9


Loader = Callable[[Source, Options], list[Table]]


@dataclass(frozen=True)
class Format:
    """One format: its name, its suffixes, whether some first bytes can be it, and its reader.

    A generic format (plain text) is asked after those that have a mark of their own. A native one is parsed by a C
    library and therefore in a child process, which must read so many bytes per second at least. The library is a
    module of the extra ``io`` that the reader imports.
    """

    name: str
    suffixes: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    load: Loader
    generic: bool = False
    native: bool = False
    library: str = ""
    speed: float = 1e7


_FORMATS: dict[str, Format] = {}


def register(
    name: str,
    *,
    suffixes: tuple[str, ...],
    sniff: Callable[[bytes], bool],
    generic: bool = False,
    native: bool = False,
    library: str = "",
    speed: float = 1e7,
) -> Callable[[Loader], Loader]:
    """Decorator that adds a reader, a function (source, options) -> list of tables.

    Parameters
    ----------
    name : str
        Name of the format, for messages.
    suffixes : tuple of str
        With the dot, lower case.
    sniff : function
        First 4096 bytes -> whether the file can be of this format.
    generic : bool
        The format has no mark of its own.
    native : bool
        A C library parses it: run it where it can be killed.
    library : str
        Module that the reader imports, of a package of the extra ``io``; a file is refused in words where it lacks.
    speed : float
        Bytes per second that a native reader must at least make; what is slower is taken to hang.

    Raises
    ------
    InputError
        If a format of this name is there.
    """

    def add(load: Loader) -> Loader:
        if name in _FORMATS:
            raise InputError("a format of this name is registered", where="readers", found=name)
        taken = tuple(s.lower() for s in suffixes)
        _FORMATS[name] = Format(name, taken, sniff, load, generic, native, library, speed)
        return load

    return add


def formats() -> tuple[Format, ...]:
    """All formats, those with a mark of their own first."""
    return tuple(sorted(_FORMATS.values(), key=lambda f: f.generic))


def known_suffixes() -> tuple[str, ...]:
    """All suffixes, sorted."""
    return tuple(sorted({s for f in _FORMATS.values() for s in f.suffixes}))


def recognise(source: Source) -> Format:
    """Format of a file whose suffix is known: of that suffix if the content agrees, else what the content says.

    Raises
    ------
    InputError
        If the content is of no format that the suffix allows and of no other one either, or the library that reads it
        is not installed.
    """
    form = _form(source)
    if form.library and importlib.util.find_spec(form.library) is None:
        source.refuse(f"{form.name} files are read by a package that is not installed", f"no {form.library}",
                      form.library, "pip install 'loadid[io]'")  # fmt: skip
    return form


def _form(source: Source) -> Format:
    suffix = source.path.suffix.lower()
    for form in formats():
        if suffix in form.suffixes and form.sniff(source.head):
            return form
    can = [f for f in formats() if f.sniff(source.head)]
    if marked := [f for f in can if not f.generic]:
        return marked[0]
    expected = next(f.name for f in formats() if suffix in f.suffixes)
    return source.refuse(f"the content is not {expected}", "plain text" if can else f"first bytes {source.head[:16]!r}",
                         f"{expected}, as the suffix {suffix} says", "rename or export the file again")  # fmt: skip
