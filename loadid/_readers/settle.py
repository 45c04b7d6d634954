"""From a table as the file holds it to a record: names, time column, step, units, in this order."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures import units as _units
from structures._advice import Advice, Option, either
from structures._channels import Channel
from structures.errors import InputError

from .._names import copy_of, find
from .clocks import clocked, gridded, positive
from .resampling import onto_one_clock
from .source import COLUMNS, RATE, NotStated, Options, RecordOutline, Source, Table
from .timebase import require_rising

TIME_NAMES = {"time", "t", "zeit", "temps", "tiempo", "tempo", "x_value", "seconds", "timestamp", "time stamp", "t_s"}
APART = 0.01  # relative difference of a stated and a recorded step that is a contradiction
TIME_LIKE = re.compile(r"\s*(t|time|zeit|timestamp)[\s_.\-(]", re.IGNORECASE)


def settled(table: Table, source: Source, options: Options) -> dict[str, Any]:
    """Arguments of the record of a table.

    Raises
    ------
    InputError
        Wrong names, no step, missing or unknown units, a time column that is not uniform.
    """
    if table.values.ndim != 2 or table.values.size == 0:
        source.refuse("the file holds no samples", f"{table.name}: shape {table.values.shape}".lstrip(": "), "numbers")
    if table.values.shape[1] > COLUMNS:
        source.refuse("too many columns", table.values.shape[1], f"at most {COLUMNS}")
    table, step = _stepped(_named(table, source, options), source, options)
    dt = _required(step, source)
    names = table.columns or ()
    _refuse_infinite(table, source)
    keep = _selection(names, source, options) if options.columns is not None else list(range(len(names)))
    stated, notes = _stated(names, source, options)
    texts = {i: stated.get(i, table.units[i] if table.units else None) for i in keep}
    _refuse_missing_units([names[i] for i, text in texts.items() if not text], source)
    described, recorded, columns = [], [], []
    for i, text in texts.items():
        unit = (_units.stated if i in stated else _units.parse)(text, channel=names[i], where=str(source.path))
        error = (
            np.nan if table.interpolation is None else float(np.ptp(_units.to_si(_ends(table.interpolation[i]), unit)))
        )
        described.append(Channel(label=names[i], quantity=unit.quantity, unit=unit.si,
                                 interpolation=error if 0 < error < np.inf else None))  # fmt: skip
        recorded.append(unit.symbol)
        columns.append(_units.to_si(table.values[:, i], unit))
    return {
        "values": np.column_stack(columns),
        "dt": dt,
        "channels": described,
        "units": recorded,
        "name": table.name,
        "source": str(source.path),
        "flags": table.flags,
        "notes": (*table.notes, *notes),
        "file_dt": None if options.fs is None else table.dt,
        "start": table.start,
    }


def _ends(size: float) -> NDArray[np.float64]:
    """Two values as far apart as a difference of that size: a unit may have a zero of its own."""
    return np.array([0.0, size])


def _refuse_missing_units(missing: list[str], source: Source) -> None:
    if missing:
        command = " ".join(f"--unit {shlex.quote(n)}=UNIT" for n in missing[:12])
        python = ", ".join(f'"{n}": "UNIT"' for n in missing[:12])
        source.refuse(
            "the file does not state the unit of " + ("a channel" if len(missing) == 1 else f"{len(missing)} channels"),
            ", ".join(missing[:50]),
            "a unit such as m/s^2, g, N, kN, mm, um/m, Pa, V",
            Advice("state it: ", either(f"units={{{python}}}", command), '; "arbitrary" is a unit'),
            NotStated,
        )


def check_unit_keys(tables: list[Table], source: Source, options: Options) -> None:
    """Nothing, if every key of ``units=`` is a column somewhere in the file.

    Raises
    ------
    InputError
        Lists the names and the nearest one.
    """
    known = [_channel_names(table, source, options) for table in tables]
    for key in options.units:
        if not any(_has(key, names) or key in times for names, times in known):
            # one list of names where all tables agree, else the longest: the message must show indices that count
            find(key, max((names for names, _ in known), key=len), what="channel", where=str(source.path))


def outlined(table: Table, source: Source, options: Options) -> RecordOutline:
    """A table under the names and indices that its record has, before units and step are stated.

    Raises
    ------
    InputError
        As for `settled`, but for missing units and a missing step.
    """
    table, dt = _stepped(_named(table, source, options), source, options)
    names = table.columns or ()
    stated, notes = _stated(names, source, options)
    units = tuple(stated.get(i, table.units[i] if table.units else None) for i in range(len(names)))
    return RecordOutline(
        table.name,
        len(table.values),
        names,
        tuple(u.symbol if isinstance(u, _units.Unit) else u for u in units),
        dt,
        (*table.notes, *notes),
        table.start,
    )


def _stated(names: tuple[str, ...], source: Source, options: Options) -> tuple[dict[int, Any], list[str]]:
    """Units that the caller states, by channel, and a note for each channel that was named by its index."""
    stated: dict[int, Any] = {}
    notes = []
    for key, unit in options.units.items():
        if not _has(key, names):
            continue
        i = find(key, names, what="channel", where=str(source.path))
        if i in stated:
            source.refuse(
                f"channel {names[i]!r} is given two units",
                f"{stated[i]} and {unit}",
                "one unit for each channel",
                "name every channel once; an index counts the channels from 0, without the time column",
            )
        stated[i] = unit
        if key not in names:
            notes.append(f"unit {unit} as stated is that of channel {i}, {names[i]}")
    return stated, notes


def _refuse_infinite(table: Table, source: Source) -> None:
    x = table.values
    if x.dtype.kind != "f" or not np.isinf(x).any():
        return
    row, column = (int(i) for i in np.argwhere(np.isinf(x))[0])
    name = (table.columns or ())[column]
    source.refuse("infinite values", f"{int(np.isinf(x).sum())}, the first in channel {name} at sample {row}",
                  "finite numbers, or NaN for recorded gaps",
                  "repair the record, or mark these samples as NaN")  # fmt: skip


def _channel_names(table: Table, source: Source, options: Options) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the channels of a table, and those that its time column or its stamps answer to."""
    try:
        named = _named(table, source, options)
    except InputError:  # names that do not fit this table are refused where it is read
        named = _named(table, source, replace(options, columns=None))
    names = named.columns or ()
    times = () if named.stamps is None else (named.clock, "time")
    times = (*times, "time") if named.begun else times
    if named.time is None:
        return names, times
    return tuple(n for i, n in enumerate(names) if i != named.time), (names[named.time], *times)


def _has(key: str | int, names: tuple[str, ...] | list[str]) -> bool:
    if isinstance(key, str) and key in names:
        return True
    text = str(key).strip()
    return (
        not isinstance(key, bool) and text.isascii() and text.isdecimal() and len(text) < 9 and int(text) < len(names)
    )


def _named(table: Table, source: Source, options: Options) -> Table:
    """The table with a name for every column and a decision which column is time."""
    if table.columns is not None:
        written = tuple(n.strip() for n in table.columns)
        time = table.time
        if time is None:
            likely = [i for i, n in enumerate(written) if n.lower() in TIME_NAMES and not _no_time(table, i)]
            nearly = [i for i, n in enumerate(written) if TIME_LIKE.match(n) and _looks_like_time(table.values[:, i])]
            time = next(iter(likely + nearly), None)
            _refuse_two_clocks(table, written, time, source)
        labels = distinct(written, time)
        changed = [f"{n!r} is read as {x!r}" for n, x in zip(written, labels, strict=True) if n != x]
        notes = (f"names that are empty or doubled: {', '.join(changed[:8])}",) if changed else ()
        return replace(table, columns=labels, time=time, notes=(*table.notes, *notes))
    columns = table.values.shape[1]
    time = table.time
    if time is None and columns > 1 and _looks_like_time(table.values[:, 0]):
        time = 0
        table = replace(table, notes=(*table.notes, "column 0 rises uniformly and is taken as time"))
    given = None if options.columns is None else list(options.columns)
    if given is None or not all(isinstance(c, str) for c in given) or all(c.isdecimal() for c in map(str, given)):
        number = iter(range(1, columns + 1))
        names = ["time" if i == time else f"ch{next(number)}" for i in range(columns)]
        return replace(table, columns=tuple(names), time=time)
    names = [str(c) for c in given]
    if len(names) == columns - 1 and time is not None:
        names.insert(time, "time")
    if len(names) != columns:
        source.refuse(
            "the column names do not fit the file",
            f"{len(names)} names {names} for {columns} columns"
            + ("" if time is None else f", of which {time} is time"),
            f"{columns} names",
            Advice("the file names no columns itself: ", Option("columns"), " names them all, in order"),
        )
    if len(set(names)) < len(names):
        source.refuse("column names are doubled", names, "unique names", "name every column once")
    named_time = [i for i, n in enumerate(names) if n.strip().lower() in TIME_NAMES]
    return replace(table, columns=tuple(names), time=named_time[0] if named_time else time)


def _no_time(table: Table, column: int) -> bool:
    """Whether a column has a unit that is none of time: T [mm] is a channel."""
    text = table.units[column] if table.units else None
    return bool(text and _units.known(text) and _units.parse(text).quantity != "time")


def _looks_like_time(x: NDArray[Any]) -> bool:
    if x.dtype.kind not in "fiu" or len(x) < 3 or not np.all(np.isfinite(x)):
        return False
    steps = np.diff(x.astype(float))
    return bool(steps.min() > 0 and np.ptp(steps) < 0.01 * steps.mean())


ONE_READING = 1.0  # s, the step of a record of one row, which nothing asks for


def _stepped(table: Table, source: Source, options: Options) -> tuple[Table, float | None]:
    """The table without its time column, and its step where the file or the caller states it."""
    table, clock = clocked(table, source, options)
    dt, single = table.dt, len(table.values) == 1
    if clock is not None and not single:
        table, dt = gridded(table, clock, source, options)
    notes = list(table.notes)
    if single and dt is None and options.fs is None:
        dt = ONE_READING
        notes.append("one row, which has no step: a reading")
    if options.fs is not None:
        rate = positive(options.fs, source)
        if dt is not None and not math.isclose(dt * rate, 1.0, rel_tol=1e-12):
            notes.append(replaced(dt, 1.0 / rate))
        table, dt = replace(table, dt=dt), 1.0 / rate
    if dt is not None and not (math.isfinite(dt) and dt > 0):
        source.refuse("the step is not positive", f"dt = {dt}", "seconds, > 0", RATE)
    return replace(table, notes=tuple(notes)), dt


def joined(tables: Sequence[Table], source: Source, options: Options) -> Table:
    """Several tables of a file as one, resampled to the rate that is stated.

    Raises
    ------
    InputError
        No ``fs=``, a table of no step, only some that state when they begin; as for `onto_one_clock`.
    """
    found = [clocked(_named(table, source, options), source, options) for table in tables]
    named = [table.name or f"record {i + 1}" for i, table in enumerate(tables)]
    times: list[NDArray[np.float64]] = []
    for name, (table, clock) in zip(named, found, strict=True):
        if clock is None and table.dt is None:
            source.refuse("the step of a record is not known", name, "records with a time column or a step",
                          "read this record alone", NotStated)  # fmt: skip
        own = clock.seconds if clock else np.arange(len(table.values), dtype=float) * (table.dt or 0.0)
        require_rising(own, source)
        times.append(own)
    starts = [table.start for table, _ in found]
    if None in starts and any(s is not None for s in starts):
        source.refuse("only some records state when they begin", ", ".join(
            n for n, s in zip(named, starts, strict=True) if s is None), "all of them, or none",
            "read each record alone")  # fmt: skip
    zero = starts[0] or 0.0
    times = [t - t[0] + ((s or zero) - zero) for t, s in zip(times, starts, strict=True)]
    if options.fs is None:
        rates = ", ".join(f"{n}: {1 / np.median(np.diff(t)):.6g} Hz" for n, t in zip(named, times, strict=True))
        source.refuse("several records are put onto one clock, whose rate is not stated", rates, "Hz", RATE, NotStated)
    table, _ = onto_one_clock([t for t, _ in found], times, named, source, positive(options.fs, source))
    together = () if starts[0] is not None else ("the records do not state when they begin: taken to begin together",)
    return replace(table, notes=(*table.notes, *together))


def replaced(own: float, dt: float) -> str:
    """Note on the step `own` of a file that a stated one replaced."""
    said = f"fs = {1 / dt:g} Hz as stated replaces the step {own:.9g} s ({1 / own:.6g} Hz) of the file"
    if not contradict(own, dt):
        return said
    return f"{said}: they contradict each other by {abs(own / dt - 1):.3g} of it, make sure which is right"


def contradict(own: float, dt: float) -> bool:
    """Whether the step of a file and the one that was stated are not the same."""
    return abs(own / dt - 1) > APART


def _required(dt: float | None, source: Source) -> float:
    if dt is None:
        source.refuse("the sampling frequency is not known", "no time column and no step in the file",
                      "a time column, or the sampling frequency in Hz", RATE, NotStated)  # fmt: skip
    return dt


def _selection(names: tuple[str, ...], source: Source, options: Options) -> list[int]:
    """Columns that ``columns=`` asks for, by name or index among the channels; a time column may be named too."""
    wanted = options.columns or ()
    if isinstance(wanted, str):
        wanted = [wanted]
    found = []
    for key in wanted:
        if isinstance(key, str) and key not in names and key.strip().lower() in TIME_NAMES:  # it is read anyway
            continue
        found.append(find(key, names, what="column", where=str(source.path)))
    if not found or len(set(found)) < len(found):
        raise InputError(
            "columns are doubled" if found else "no column is asked for", where=str(source.path), found=list(wanted),
            expected=f"some of {', '.join(names[:50])}", hint="name every channel once, by name or index from 0",
        )  # fmt: skip
    return found


def distinct(names: Sequence[str], time: int | None = None) -> tuple[str, ...]:
    """Names of columns with empty ones numbered as channels (ch1, ch2, ...).

    A name that stands over several columns names none of them: each is called by its place, ``acc (column 2)``. Only
    the time column keeps its own.
    """
    bases = [n or f"ch{i + 1 - (time is not None and time < i)}" for i, n in enumerate(names)]
    if time is not None:
        bases[time] = names[time] or "time"
    labels = [b if i == time or bases.count(b) == 1 else copy_of(b, i + 1) for i, b in enumerate(bases)]
    for i in range(len(labels)):  # a name that was written in just that form
        while labels.count(labels[i]) > 1:
            labels[i] = copy_of(labels[i], i + 1)
    return tuple(labels)


def _refuse_two_clocks(table: Table, names: tuple[str, ...], time: int | None, source: Source) -> None:
    """Nothing, unless the name of the time column stands over other numbers too, in whatever case."""
    if time is None:
        return
    own = table.values[:, time]
    same = [i for i, n in enumerate(names) if n.casefold() == names[time].casefold() and i != time]
    other = [i for i in same if not np.array_equal(own, table.values[:, i], equal_nan=own.dtype.kind == "f")]
    if names[time] and other:
        source.refuse("several columns with different numbers are named as time",
                      f"{names[time]!r} over columns {', '.join(str(i + 1) for i in (time, *other))}",
                      "one time column", "rename those that are no time of this record, or delete them")  # fmt: skip
