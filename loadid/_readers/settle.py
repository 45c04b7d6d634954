"""From a table as the file holds it to a record: names, time column, step, units, in this order."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures import units as _units
from structures._advice import Advice, Option, either
from structures._channels import Channel
from structures.errors import InputError

from .._record import Record, copy_of, find
from .source import COLUMNS, RATE, NotStated, Options, RecordOutline, Source, Table

TIME_NAMES = {"time", "t", "zeit", "temps", "tiempo", "tempo", "x_value", "seconds", "timestamp", "time stamp", "t_s"}
APART = 0.01  # relative difference of a stated and a recorded step that is a contradiction
TIME_LIKE = re.compile(r"\s*(t|time|zeit|timestamp)[\s_.\-(]", re.IGNORECASE)
JITTER = 0.01  # deviation from the grid, in steps, that is still uniform
MISSING = 0.25  # share of dropped samples on the full grid beyond which a column is no time column


def settle(table: Table, source: Source, options: Options) -> Record:
    """The record of a table.

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
        described.append(Channel(label=names[i], quantity=unit.quantity, unit=unit.si))
        recorded.append(unit.symbol)
        columns.append(_units.to_si(table.values[:, i], unit))
    return Record(
        np.column_stack(columns),
        dt,
        described,
        units=recorded,
        name=table.name,
        source=str(source.path),
        flags=table.flags,
        notes=(*table.notes, *notes),
        file_dt=None if options.fs is None else table.dt,
    )


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
        if not any(_has(key, names) or key == time for names, time in known):
            # one list of names where all tables agree, else the longest: the message must show indices that count
            find(key, max((names for names, _ in known), key=len), what="channel", where=str(source.path))


def outlined(table: Table, source: Source, options: Options) -> RecordOutline:
    """A table under the names and indices that its record has, before units and step are stated.

    Raises
    ------
    InputError
        As for `settle`, but for missing units and a missing step.
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


def _channel_names(table: Table, source: Source, options: Options) -> tuple[tuple[str, ...], str | None]:
    """Names of the channels of a table, and that of its time column."""
    try:
        named = _named(table, source, options)
    except InputError:  # names that do not fit this table are refused where it is read
        named = _named(table, source, replace(options, columns=None))
    names = named.columns or ()
    if named.time is None:
        return names, None
    return tuple(n for i, n in enumerate(names) if i != named.time), names[named.time]


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


def _stepped(table: Table, source: Source, options: Options) -> tuple[Table, float | None]:
    """The table without its time column, and its step where the file or the caller states it."""
    dt, notes, values = table.dt, list(table.notes), table.values
    if table.time is not None:
        column, names = table.time, table.columns or ()
        stated = [u for k, u in options.units.items() if k == names[column]]
        text = stated[0] if stated else (table.units[column] if table.units else None)
        scale = _units.check(text, "time", channel=names[column]).factor if text else 1.0
        base = timebase(values[:, column].astype(float) * scale, source)
        values = fill(np.delete(values, column, axis=1), base)
        if base.missing:
            many = "samples are" if base.missing > 1 else "sample is"
            notes.append(f"{base.missing} {many} missing in the time column {names[column]}, first after sample "
                         f"{base.first}: set to NaN")  # fmt: skip
        if dt is None or options.fs is None:
            notes.append(
                f"step {base.dt:.9g} s from the time column {names[column]}" + ("" if text else ", taken as seconds")
            )
        dt = base.dt
        keep = [i for i in range(len(names)) if i != column]
        unit_texts = tuple(table.units[i] for i in keep) if table.units else None
        table = replace(table, values=values, columns=tuple(names[i] for i in keep), units=unit_texts, time=None)
        if not keep:
            source.refuse("there is a time column and nothing else", names, "at least one channel")
    if options.fs is not None:
        rate = _positive(options.fs, source)
        if dt is not None and not math.isclose(dt * rate, 1.0, rel_tol=1e-12):
            notes.append(replaced(dt, 1.0 / rate))
        table, dt = replace(table, dt=dt), 1.0 / rate
    if dt is not None and not (math.isfinite(dt) and dt > 0):
        source.refuse("the step is not positive", f"dt = {dt}", "seconds, > 0", RATE)
    return replace(table, notes=tuple(notes)), dt


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


def _positive(fs: object, source: Source) -> float:
    try:
        rate = float(fs)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        rate = math.nan
    if isinstance(fs, bool) or not (math.isfinite(rate) and rate > 0 and math.isfinite(1 / rate)):
        source.refuse("the sampling frequency is not positive", f"fs = {fs!r}", "Hz, > 0", RATE)  # fmt: skip
    return rate


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


# -- the step of a time column -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Base:
    """Step in s, the place of every sample on the grid, how many are missing and after which sample first."""

    dt: float
    place: NDArray[np.int64]
    missing: int = 0
    first: int = 0


def timebase(t: NDArray[np.float64], source: Source) -> Base:
    """Step of a column of time stamps in s.

    Stamps that were rounded on writing still give the step that the instrument had: of the steps that fit all stamps,
    the one whose frequency is a whole number is taken, else the one with the fewest digits. Whole samples that are
    missing are kept as gaps; anything else that is not uniform is refused.

    Raises
    ------
    InputError
        NaN, stamps that do not rise, a step that is not constant.
    """
    n = len(t)
    if n < 2 or not np.all(np.isfinite(t)):
        bad = "one stamp" if n < 2 else f"{int((~np.isfinite(t)).sum())} stamps that are no numbers"
        source.refuse("the time column gives no step", bad, "finite, rising stamps",
                      "repair the time column, or leave it out and state --fs HZ")  # fmt: skip
    steps = np.diff(t)
    if not steps.min() > 0:
        i = int(np.argmin(steps))
        source.refuse("time does not rise", f"{t[i]:.9g} s, then {t[i + 1]:.9g} s after sample {i}", "rising stamps",
                      "sort or repair the time column, or leave it out and state --fs HZ")  # fmt: skip
    rounding = _resolution(t)
    typical = float(np.median(steps))
    if rounding > 0.2 * typical:  # steps of 0.000, 0.001, 0.001: only the whole column tells the step
        typical = float(t[-1] - t[0]) / (n - 1)
    slack = max(JITTER * typical, 1.01 * rounding, 8 * np.finfo(float).eps * float(np.abs(t).max()))
    dt, place = _grid(t, _single(steps, typical), slack)
    wrong = np.abs(t - t[0] - place * dt - np.median(t - t[0] - place * dt)) > slack
    if wrong.any() or np.diff(place).min() < 1:
        i = int(np.argmax(np.abs(steps - typical)))
        source.refuse("time is not uniform", f"step {steps[i]:.6g} s after sample {i}, {typical:.6g} s elsewhere",
                      "a constant step", "resample the record, or state --fs HZ without a time column")  # fmt: skip
    missing = int(place[-1]) + 1 - n
    if missing > MISSING * (n + missing):
        source.refuse("too many samples are missing", f"{missing} missing, {n} there", f"at most {MISSING:.0%}",
                      "cut the record at the gap")  # fmt: skip
    first = int(np.argmax(np.diff(place) > 1)) if missing else 0
    return Base(_snap(dt, float(place[-1]), slack_of(t, dt, place), n), place, missing, first)


def fill(values: NDArray[Any], base: Base) -> NDArray[np.float64]:
    """Samples on the full grid, NaN where one is missing."""
    if not base.missing:
        return np.asarray(values, dtype=float)
    full = np.full((int(base.place[-1]) + 1, values.shape[1]), np.nan)
    full[base.place] = values
    return full


def slack_of(t: NDArray[np.float64], dt: float, place: NDArray[np.int64]) -> float:
    """Largest distance of a stamp from its grid, with the rounding of the numbers themselves."""
    away = t - t[0] - place * dt
    return float(np.ptp(away)) + 4 * float(np.spacing(np.abs(t).max()))


def _single(steps: NDArray[np.float64], typical: float) -> float:
    """Mean of the steps without a gap: the median or the mean of all is off by rounding or by the gaps themselves."""
    for _ in range(4):
        alone = steps[np.rint(steps / typical) == 1]
        if not len(alone) or typical == alone.mean():
            break
        typical = float(alone.mean())
    return typical


def _grid(t: NDArray[np.float64], typical: float, slack: float) -> tuple[float, NDArray[np.int64]]:
    """Step and place of every stamp; the steps are counted one by one so that an error of the step does not add up."""
    counts = np.maximum(np.rint(np.diff(t) / typical), 1.0)
    if counts.max() > 1e6 * len(t):
        counts = np.minimum(counts, 1e6)
    place = np.concatenate(([0.0], np.cumsum(counts))).astype(np.int64)
    dt = float(t[-1] - t[0]) / float(place[-1])
    return dt, place


def _snap(dt: float, count: float, away: float, samples: int) -> float:
    """The simplest step that fits the stamps: a whole frequency, else few digits."""
    within = min(2.0 * away / count, 0.005 * dt)
    whole = round(1.0 / dt)
    if whole >= 1 and abs(1.0 / whole - dt) <= within:
        return 1.0 / whole
    for digits in range(1, 12):
        simple = float(f"{dt:.{digits - 1}e}")
        if abs(simple - dt) <= within:
            return simple
    return dt


def _resolution(t: NDArray[np.float64]) -> float:
    """Decimal place to which stamps were rounded, in s; 0 when they were not."""
    part = t[:: max(1, len(t) // 2000)]
    eps = 4 * np.finfo(float).eps * float(np.abs(part).max())
    for digits in range(13):
        place = 10.0**-digits
        if eps > 0.1 * place:
            break
        if np.all(np.abs(part - np.round(part, digits)) <= eps):
            return place
    return 0.0
