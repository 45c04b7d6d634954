"""When samples were taken: a column of numbers, stamps or a start, and from them the samples on an even grid."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures import units as _units

from .. import _stamps
from .resampling import onto_one_clock
from .source import RATE, Options, Source, Table
from .timebase import Base, UnevenStampsError, fill, timebase


@dataclass(frozen=True)
class Clock:
    """When the samples of a table were taken: seconds, of a column of some name; `rounding` is what they lost before.

    `said` is what was decided of its unit.
    """

    seconds: NDArray[np.float64]
    name: str
    rounding: float = 0.0
    said: str = ""


def clocked(table: Table, source: Source, options: Options) -> tuple[Table, Clock | None]:
    """The table without its time column or its stamps, and what they say; None where it has neither.

    Raises
    ------
    InputError
        Stamps that are none, a time column and nothing else.
    """
    table, options = _begun(table, source, options)
    if table.stamps is not None:
        return _by_stamps(table, table.stamps, source, options)
    return (table, None) if table.time is None else _by_time(table, table.time, source, options)


def _begun(table: Table, source: Source, options: Options) -> tuple[Table, Options]:
    """The table with its start in UTC, and what is stated of other things than the zone of a start."""
    if not table.begun:
        return table, options
    zone = options.units.get("time")
    stated = None if zone is None or _units.known(str(zone)) else str(zone)
    plain = replace(table, begun="", start=None)
    if stated is None and _stamps.seconds(table.begun) is None:
        return replace(plain, notes=(*table.notes, f"when it began is not read: {table.begun!r}")), options
    found = _stamps.of_texts([table.begun], f"{source.path}, start", stated)
    said = f"begins at {table.begun} as the file says"
    start = None if found.start is None else found.start + (table.start or 0.0)
    if stated is not None:
        options = replace(options, units={k: u for k, u in options.units.items() if k != "time"})
    return replace(plain, start=start, notes=(*table.notes, said, *found.notes)), options


def _by_time(table: Table, column: int, source: Source, options: Options) -> tuple[Table, Clock]:
    """A table with a column of numbers that are time: without it, and its clock."""
    names = table.columns or ()
    stated = [u for k, u in options.units.items() if k == names[column]]
    text = stated[0] if stated else (table.units[column] if table.units else None)
    unit = _units.check(text, "time", channel=names[column]) if text else None
    raw, start = table.values[:, column], table.start
    since = _stamps.epoch(raw[np.isfinite(raw)], unit.symbol if unit else None)
    scale = since[1] if since else unit.factor if unit else 1.0
    taken = "" if text else ", taken as seconds"
    if since is not None and np.isfinite(raw[0]):  # the difference of whole numbers is exact where they are not
        start, raw = float(raw[0]) * scale, raw - raw[0]
        taken = "" if text else f", {since[0]} since 1970 by their size"
    elif start is not None and np.isfinite(raw[0]):
        start += float(raw[0]) * scale
    rounding = float(np.spacing(abs(float(table.values[0, column])))) * scale if since else 0.0
    clock = Clock(raw.astype(float) * scale, names[column], rounding, f" from the time column {names[column]}{taken}")
    keep = [i for i in range(len(names)) if i != column]
    if not keep:
        source.refuse("there is a time column and nothing else", names, "at least one channel")
    units = tuple(table.units[i] for i in keep) if table.units else None
    table = replace(table, values=table.values[:, keep], columns=tuple(names[i] for i in keep), units=units, time=None)
    return replace(table, start=start), clock


def _by_stamps(table: Table, stamps: NDArray[Any], source: Source, options: Options) -> tuple[Table, Clock]:
    """A table whose samples have time stamps: without them, and its clock, which a column of numbers rules."""
    stated = next((str(u) for k, u in options.units.items() if str(k) in (table.clock, "time")), None)
    where = f"{source.path}, column {table.clock}"
    if stamps.dtype.kind == "M":
        found = _stamps.of_datetimes(stamps, where, stated, table.aware)
    else:
        found = _stamps.of_texts(stamps.tolist(), where, stated)
    table = replace(table, stamps=None, start=found.start, notes=(*table.notes, *found.notes))
    if table.time is not None:
        column = table.values[:, table.time]
        zero = column - column[0] if len(column) and np.isfinite(column[0]) else column
        values = np.column_stack([zero if i == table.time else x for i, x in enumerate(table.values.T)])
        return _by_time(replace(table, values=values), table.time, source, options)
    return table, Clock(found.seconds, table.clock, said=f" from the time stamps in {table.clock}")


def gridded(table: Table, clock: Clock, source: Source, options: Options) -> tuple[Table, float]:
    """Samples on the even grid that their clock means or, where it means none, on the one that the caller states.

    Raises
    ------
    InputError
        Stamps that do not rise, or that are uneven and no ``fs=``.
    """
    try:
        base = timebase(clock.seconds, source, clock.rounding, table.dt)
    except UnevenStampsError:
        if options.fs is None:
            raise
        return onto_one_clock([table], [clock.seconds], [clock.name], source, positive(options.fs, source))
    notes = [] if dt_stated(table, options) else [f"step {base.dt:.9g} s{clock.said}"]
    return _on_grid(table, base, clock.name, notes), base.dt


def dt_stated(table: Table, options: Options) -> bool:
    """Whether both the file and the caller state the step, so that the time column gives none."""
    return table.dt is not None and options.fs is not None


def _on_grid(table: Table, base: Base, clock: str, notes: list[str]) -> Table:
    """Samples on the full grid, and what is said of those that are missing."""
    if base.missing:
        many = "samples are" if base.missing > 1 else "sample is"
        gone = f"{base.missing} {many} missing in the time column {clock}, first after sample {base.first}: set to NaN"
        notes = [gone, *notes]
    return replace(table, values=fill(table.values, base), notes=(*table.notes, *notes))


def positive(fs: object, source: Source) -> float:
    """A sampling frequency.

    Raises
    ------
    InputError
        No number above 0.
    """
    try:
        rate = float(fs)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        rate = math.nan
    if isinstance(fs, bool) or not (math.isfinite(rate) and rate > 0 and math.isfinite(1 / rate)):
        source.refuse("the sampling frequency is not positive", f"fs = {fs!r}", "Hz, > 0", RATE)  # fmt: skip
    return rate
