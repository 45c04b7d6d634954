"""Files to records: one module per format, found by suffix and content.

A new format is one file in this folder. It registers a function that turns the file into tables; names, time column,
step, units and errors are then treated as in every other format::

    # loadid/_readers/myformat.py
    from .source import Options, Source, Table, register

    @register("my format", suffixes=(".my",), sniff=lambda head: head.startswith(b"MYFT"))
    def load(source: Source, options: Options) -> list[Table]:
        values = ...                                        # (samples, columns), as recorded
        return [Table(values, name="run 1", columns=("F", "a"), units=("N", "g"), dt=1e-3)]

Where a format writes the date of every sample, its texts or ``datetime64`` go into ``stamps`` and no column of the
values; where it writes when the record began, that goes into ``start`` (s since 1970, UTC).

A reader compares what a file declares with what it delivers (`truncated` gives the flag), asks `source.allow(bytes)`
before it unpacks, and never evaluates or unpickles anything. `rows_of` (`rows.py`) turns lines of text into
numbers and names the line and the cell that is none. Whatever else a reader raises leaves `read` as an InputError.

A package of the extra ``io`` is named by its module (``library="nptdms"``) and imported inside the function: where it
lacks, the registry refuses the file with the line that installs it.

With ``native=True`` it runs in a child process (`structures/files/_child.py`): a damaged file may hang or crash a
parser that is a C library.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar, Unpack

import numpy as np

from structures import units as _units
from structures._advice import Advice, either
from structures._flags import Flag
from structures.errors import InputError
from structures.files._child import apart

from .._names import find
from .._record import Record
from .settle import check_unit_keys, joined, outlined, settled
from .source import (
    Format,
    NotStated,
    Options,
    RecordOutline,
    Source,
    Table,
    formats,
    known_suffixes,
    recognise,
    register,
    truncated,
)

__all__ = [
    "Format", "NotStated", "Options", "RecordOutline", "Source", "Table", "formats", "outline", "read", "read_all",
    "read_folder", "register", "scan", "truncated",
]  # fmt: skip

if TYPE_CHECKING:
    from .._folders import Folder

T = TypeVar("T")

for _module in pkgutil.iter_modules(__path__):  # a format is found because its file lies here
    importlib.import_module(f".{_module.name}", __name__)


class Stated(TypedDict, total=False):
    """What may be stated of a file; see `read`."""

    fs: float | None
    columns: Sequence[str | int] | None
    axis: int | None
    units: Mapping[str | int, Any] | None


def read(
    path: str | os.PathLike[str],
    record: str | int | Sequence[str | int] | None = None,
    *,
    fs: float | None = None,
    columns: Sequence[str | int] | None = None,
    axis: int | None = None,
    units: Mapping[str | int, Any] | None = None,
) -> Record:
    """The record of a file, in SI.

    Parameters
    ----------
    path : path
        A file, or a folder of files that follow one another in time and make one record (`loadid.read_folder`): CSV
        and other text tables, NPY, NPZ, HDF5, MAT, universal files (UFF, UNV), LabVIEW LVM, TDMS, MDF (MF4), WAV,
        Parquet, Arrow and Feather, Excel, MCAP, ROS bags, miniSEED: docs/formats.md says what is read of each.
    record : str or int, or sequence of them, optional
        Which record of a file that holds several: its name, or its index from 0. Several are resampled to ``fs`` over
        the time that all of them cover.
    fs : float, optional
        Sampling frequency in Hz; replaces what the file says. Where the stamps of the samples are uneven, the rate to
        which they are resampled, by cubic splines: intervals of more than 4 times those around them become NaN, a rate
        below that of the samples is refused, and ``notes`` rank the channels by the error of the interpolation.
    columns : sequence of str or int, optional
        Where the file names its columns: the ones to read. Where it does not: the names of all of them, in order.
    axis : int, optional
        Axis of an array that is time; default the longer one (said in ``record.notes``).
    units : dict, optional
        ``{channel: unit}``, replaces what the file says; "arbitrary" is a unit. A time column takes one too, default s,
        or the epoch that its size tells; a column of time stamps takes the order of its dates (``"DD/MM/YYYY"``,
        ``"MM/DD/YYYY"``), its time zone (``"Europe/Berlin"``, ``"UTC+1"``), or both, parted by a blank.
        A number before the unit is what 1 in the file stands for: ``"100 g"`` for a WAV file with 100 g at full scale,
        ``"2e-6 m/s^2"`` for counts.

    Returns
    -------
    Record
        With ``flags`` (W209 where the file ends early, W220 where it was resampled coarsely) and ``notes`` (what was
        decided).

    Raises
    ------
    InputError
        Whatever is wrong with the file or with what was asked of it; no other exception leaves a reader.
    """
    if is_folder(path):
        if isinstance(record, Sequence) and not isinstance(record, str):
            raise InputError("a folder makes one record of one in each of its files", where=str(path),
                             found=f"records {', '.join(map(str, record))}", expected="one of them",
                             hint="read each of them, or its files one by one")  # fmt: skip
        return read_folder(path, record, fs=fs, columns=columns, axis=axis, units=units).record()
    found, source, options = _scan(path, fs=fs, columns=columns, axis=axis, units=units)
    return guarded(source, lambda: _settle(_chosen(found, record, source, options), source, options, found))


def read_all(path: str | os.PathLike[str], **stated: Unpack[Stated]) -> tuple[Record, ...]:
    """All records of a file; arguments and errors as for `read`."""
    if is_folder(path):
        return (read(path, **stated),)
    found, source, options = _scan(path, **stated)
    return guarded(source, lambda: tuple(_settle(table, source, options, found) for table in found))


def read_folder(path: str | os.PathLike[str], record: str | int | None = None, **stated: Unpack[Stated]) -> Folder:
    """A folder of files that follow one another, whose samples are read when they are asked for.

    Every file is read once to see what it holds and when it begins. Files are ordered by the time of their first
    sample; where no file states one, by name, numbers in it counted as such, and taken to follow one another without
    a gap. Hidden files, files of other formats than most and what is named README or the like are passed over, which
    ``outline.notes`` say.

    Parameters
    ----------
    path : path
        Of the folder; folders within it are passed over.
    record : str or int, optional
        Which record of each file, where it holds several.
    **stated
        ``fs``, ``columns``, ``axis`` and ``units`` of every file, as for `loadid.read`.

    Returns
    -------
    Folder

    Raises
    ------
    InputError
        No file that is read, one that is damaged, several that begin at the same time, files of which only some state
        when they begin, other steps, channels or units than the first, naming the file.
    """
    from .._folders import folder_of

    return folder_of(path, record, stated, read, outline)


def is_folder(path: object) -> bool:
    """Whether a path is that of a folder."""
    try:
        return isinstance(path, str | os.PathLike) and bool(os.fspath(path)) and Path(path).expanduser().is_dir()
    except (OSError, TypeError, ValueError, RuntimeError):
        return False


def scan(path: str | os.PathLike[str], *, axis: int | None = None) -> tuple[Table, ...]:
    """Raw tables of a file, before names, steps and units are settled: nothing need be stated for it.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    return tuple(_scan(path, axis=axis)[0])


def outline(path: str | os.PathLike[str], **stated: Unpack[Stated]) -> tuple[RecordOutline, ...]:
    """What a file holds, under the names and indices that `read` takes, where units or the step are not stated.

    Raises
    ------
    InputError
        Whatever else is wrong with the file.
    """
    if is_folder(path):
        return (read_folder(path, **stated).outline,)
    found, source, options = _scan(path, **stated)
    return guarded(source, lambda: tuple(outlined(table, source, options) for table in found))


def _scan(
    path: str | os.PathLike[str],
    *,
    fs: float | None = None,
    columns: Sequence[str | int] | None = None,
    axis: int | None = None,
    units: Mapping[str | int, Any] | None = None,
) -> tuple[list[Table], Source, Options]:
    source = _open(path)
    if isinstance(columns, str):
        columns = [c.strip() for c in columns.split(",")]
    try:
        listed = None if columns is None else [c if isinstance(c, str) else int(c) for c in columns]
    except (TypeError, ValueError):
        source.refuse("columns are no names", repr(columns), "names or indices of columns")
    if axis is not None and (not isinstance(axis, int | np.integer) or axis not in (0, 1, -1, -2)):
        source.refuse("there is no such axis", f"axis = {axis!r}", "0 or 1")
    axis = None if axis is None else int(axis) % 2
    options = Options(fs=fs, columns=listed, axis=axis, units=_units.as_mapping(units))
    form = recognise(source)
    if form.native:
        found = load_apart(form, source, options)
    else:
        found = guarded(source, lambda: form.load(source, options), form.name)
    if not found:
        source.refuse("the file holds no record", "nothing", f"samples in {form.name} form")
    return found, source, options


def _open(path: str | os.PathLike[str]) -> Source:
    if not isinstance(path, str | os.PathLike):
        raise InputError(
            "this is no path", where="read", found=f"an object of type {type(path).__name__}", expected="a file name",
            hint="an array is no file: Record(values, dt, labels) makes a record of it",
        )  # fmt: skip
    if not os.fspath(path):
        raise InputError("the path is empty", where="read", found="''", expected="a file name", hint="name a file")
    if (
        scheme := re.match(r"([A-Za-z][A-Za-z0-9+.-]+)://", os.fspath(path) if isinstance(path, str) else "")
    ) is not None:
        raise InputError("an address is no file here", where=str(path), found=f"{scheme[1]}://", expected="a file name",
                         hint="download it and name the file")  # fmt: skip
    try:
        place = Path(path).expanduser()
        if not place.exists():
            near = _neighbours(place)
            raise InputError(
                "there is no such file", where=str(place), hint=f"did you mean {near}?" if near else "check the path"
            )
        if not place.is_file():
            raise InputError("this is no file", where=str(place), found="a folder or a device", expected="a file",
                             hint="name a file in it")  # fmt: skip
        with place.open("rb") as file:
            source = Source(place, os.fstat(file.fileno()).st_size, file.read(4096))
    except (OSError, TypeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError("the file cannot be opened", where=repr(path), found=str(error)) from None
    if source.head.startswith(b"loadid-hdf5"):
        _refuse_own(source)
    if place.suffix.lower() not in known_suffixes():
        likely = [f.name for f in formats() if not f.generic and f.sniff(source.head)]
        source.refuse("unknown suffix", place.suffix or "no suffix", f"one of {', '.join(known_suffixes())}",
                      f"the content looks like {likely[0]}: rename the file" if likely
                      else "export the record in one of these formats")  # fmt: skip
    if source.size == 0:
        source.refuse("the file is empty", "0 bytes", "a record")
    return source


def _refuse_own(source: Source) -> None:
    """A model or a result is given where a log is read."""
    kind = next((x[5:].decode("latin-1") for x in source.head.split(b"\n")[:4] if x.startswith(b"kind ")), "file")
    word = {"measured model": "model", "load estimate": "result"}.get(kind, kind)
    source.refuse(f"this is a loadid {word}, not a log", kind, "a log", "give the file with the recorded samples")


def _neighbours(place: Path) -> str:
    import difflib

    try:
        names = [p.name for p, _ in zip(place.parent.iterdir(), range(1000), strict=False)]
    except OSError:
        return ""
    return next(iter(difflib.get_close_matches(place.name, names, n=1, cutoff=0.75)), "")


def _chosen(
    found: list[Table], record: str | int | Sequence[str | int] | None, source: Source, options: Options
) -> Table:
    if isinstance(record, Sequence) and not isinstance(record, str):
        chosen = [_chosen(found, one, source, options) for one in dict.fromkeys(record)]
        return chosen[0] if len(chosen) == 1 else joined(chosen, source, options)
    names = [t.name or f"record_{i + 1}" for i, t in enumerate(found)]
    if record is not None:
        return found[find(record, names, what="record", where=str(source.path))]
    if len(found) > 1:
        listed = [
            f"{i}: {n} {'x'.join(map(str, t.values.shape))}" for i, (n, t) in enumerate(zip(names, found, strict=True))
        ]
        source.refuse("the file holds several records", ", ".join(listed[:50]) + (", ..." if len(listed) > 50 else ""),
                      "one of them, by name or index",
                      Advice("choose: ", either("record=NAME or read_all", "--record NAME")))  # fmt: skip
    return found[0]


def _settle(table: Table, source: Source, options: Options, found: list[Table]) -> Record:
    check_unit_keys(found, source, options)
    return record_of(table, source, options)


def record_of(table: Table, source: Source, options: Options) -> Record:
    """The record of a table, its names, step and units settled.

    Raises
    ------
    InputError
        Wrong names, no step, missing or unknown units, a time column that is not uniform.
    """
    return Record(**settled(table, source, options))


def guarded(source: Source, action: Callable[[], T], form: str = "a record") -> T:
    """Run a reader; damage that it did not foresee is still bad input, and says where."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return action()
    except InputError:
        raise
    except Exception as error:
        kind = type(error).__name__
        raise InputError(f"the file cannot be read as {form}", where=str(source.path),
                         found=f"{kind}: {str(error)[:300]}", expected="an undamaged file",
                         hint="transfer or export it again") from error  # fmt: skip


# -- formats that are read in a child process --------------------------------------------------------------------------
def load_apart(form: Format, source: Source, options: Options) -> list[Table]:
    """Tables that the reader of a format finds, read in the child.

    Raises
    ------
    InputError
        What the reader raised; or the library crashed or did not come back in time.
    """
    request = {
        "form": form.name,
        "library": form.library,
        "path": str(source.path.resolve()),
        "shown": str(source.path),
        "axis": options.axis,
    }
    entries, arrays = apart(
        f"{__name__}:asked_for", request, reader=form.name, where=str(source.path), size=source.size, speed=form.speed
    )
    left = iter(arrays)
    return [_unpacked(entry, next(left), next(left) if entry["stamps"] else None) for entry in entries]


def asked_for(request: dict[str, Any]) -> tuple[list[dict[str, Any]], list[np.ndarray[Any, Any]]]:
    """Tables of a file that `load_apart` asks the child for: what is said of them, and their arrays."""
    place, shown = Path(request["path"]), Path(request["shown"])
    try:
        with place.open("rb") as file:
            source = Source(shown, os.fstat(file.fileno()).st_size, file.read(4096), place)
    except OSError as error:
        raise InputError("the file cannot be opened", where=str(shown), found=str(error)) from None
    form = next(f for f in formats() if f.name == request["form"])
    tables: list[Table] = guarded(source, lambda: form.load(source, Options(axis=request["axis"])), form.name)
    entries = [
        {k: v for k, v in vars(t).items() if k != "values"}
        | {"flags": [f.to_dict() for f in t.flags], "stamps": t.stamps is not None}
        for t in tables
    ]
    return entries, [x for t in tables for x in (t.values, t.stamps) if x is not None]


def _unpacked(entry: dict[str, Any], values: np.ndarray[Any, Any], stamps: np.ndarray[Any, Any] | None) -> Table:
    flags = tuple(Flag.from_dict(f) for f in entry["flags"])
    said: dict[str, Any] = {
        k: tuple(v) if isinstance(v, list) else v for k, v in entry.items() if k not in ("flags", "stamps")
    }
    return Table(values, flags=flags, stamps=stamps, **said)
