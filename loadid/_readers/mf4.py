"""MDF files (.mf4, .mdf, versions 3 and 4) of measurement systems in vehicles: channel groups as records.

ASAM MDF 4.2: the master channel of a group is its time (synchronisation type 1); its other masters (angle, distance,
index) and text are passed over. Conversions to physical values are applied.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag

from .source import COLUMNS, Options, Source, Table, register, truncated

MARKS = (b"MDF     ", b"UnFinMF ")
TIME = 1  # synchronisation type of a master


@register(
    "MDF",
    suffixes=(".mf4", ".mdf"),
    sniff=lambda head: head.startswith(MARKS),
    native=True,
    library="asammdf",
    speed=1e6,
)
def load(source: Source, options: Options) -> list[Table]:
    """Channel groups with a time master as records."""
    from asammdf import MDF

    tables, passed = [], []
    with MDF(source.place or source.path) as file:
        source.allow(sum(_size(g) for g in file.groups), "the file")
        start = file.start_time.timestamp()
        for index in range(len(file.groups)):
            table = _table(file, index, source)
            if isinstance(table, Table):
                tables.append(replace(table, start=start))
            elif table:
                passed.append(table)
    if source.head.startswith(MARKS[1]):
        note = "the file was not finalised by its writer: its last samples may lack"
        tables = [replace(t, notes=(*t.notes, note)) for t in tables]
    if passed and tables:
        note = f"passed over: {', '.join(passed[:20])}"
        tables = [replace(t, notes=(*t.notes, note)) for t in tables]
    if passed and not tables:
        source.refuse("the file holds no record over time", ", ".join(passed[:20]), "channel groups with a time master")
    return tables


def _size(group: Any) -> int:
    """Bytes that the records of a channel group declare, or those that its channels become, whichever are more."""
    about = group.channel_group
    record = about.samples_byte_nr + getattr(about, "invalidation_bytes_nr", 0)
    return int(about.cycles_nr) * max(int(record), 8 * len(group.channels))


def _table(file: Any, index: int, source: Source) -> Table | str:
    """Record of one channel group; of what is none, its name and why."""
    group = file.groups[index]
    about = group.channel_group
    name = str(getattr(about, "acq_name", "") or about.comment or "").strip().split("\n")[0]
    if not name or name.startswith("<") or len(name) > 80:
        name = f"group {index}"
    count = int(about.cycles_nr)
    if not count:
        return ""
    master = file.masters_db.get(index)
    wanted = [(None, index, i) for i in range(len(group.channels)) if i != master]
    signals = file.select(wanted, copy_master=False, ignore_value2text_conversions=True) if wanted else []
    kept = [s for s in signals if s.samples.dtype.kind in "fiub" and s.samples.ndim == 1]
    if not kept:
        return f"{name} (no numbers)"
    if master is None or kept[0].master_metadata[1] != TIME:
        return f"{name} (no time)"
    if len(kept) + 1 > COLUMNS:
        source.refuse("too many channels", len(kept), f"at most {COLUMNS}")
    time = np.asarray(kept[0].timestamps, float)
    there = min(len(time), *(len(s.samples) for s in kept))
    flags: tuple[Flag, ...] = (truncated(there, count),) if there < count else ()
    invalid = sum(int(np.sum(s.invalidation_bits[:there])) for s in kept if s.invalidation_bits is not None)
    notes = [f"{invalid} samples that the file marks as invalid are NaN"] if invalid else []
    texts = [s.name for s in signals if not any(s is k for k in kept)]
    notes += [f"passed over: {', '.join(texts[:20])} (no numbers)"] if texts else []
    clock = group.channels[master].name or "time"
    return Table(
        np.column_stack([time[:there], *(_samples(s, there) for s in kept)]),
        name=name,
        columns=(clock, *(s.name for s in kept)),
        units=("s", *(str(s.unit).strip() or None for s in kept)),
        time=0,
        flags=flags,
        notes=tuple(notes),
    )


def _samples(signal: Any, count: int) -> NDArray[np.float64]:
    """Physical values, NaN where the file says that they are invalid."""
    values = np.array(signal.samples[:count], float)
    if signal.invalidation_bits is not None:
        values[np.asarray(signal.invalidation_bits[:count], bool)] = np.nan
    return values
