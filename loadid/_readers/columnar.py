"""Parquet, and Arrow IPC files (Feather): columns of numbers as channels, a column of time stamps as time.

The unit of a column is the entry ``unit`` of its metadata, or the entry of its name in ``units`` among the metadata of
the file (JSON, as pandas keeps ``DataFrame.attrs``); else it stands in the name, ``acc [m/s^2]``. The step is ``fs`` or
``dt`` among the metadata of the file, which hold the name of the record, too.
"""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import RATES, STEPS
from .csv_table import name_and_unit
from .settle import TIME_NAMES
from .source import COLUMNS, Options, Source, Table, register, since


@register(
    "Parquet",
    suffixes=(".parquet", ".pq"),
    sniff=lambda head: head.startswith(b"PAR1"),
    native=True,
    library="pyarrow",
)
def load_parquet(source: Source, options: Options) -> list[Table]:
    """The one record of the file."""
    from pyarrow import parquet

    with parquet.ParquetFile(source.place or source.path, page_checksum_verification=True) as file:
        about = file.metadata
        source.allow(8 * about.num_rows * about.num_columns)
        table = file.read()
        declared = int(about.num_rows)
    return [_table(table, declared, source)]


@register(
    "Arrow",
    suffixes=(".arrow", ".feather", ".ipc"),
    sniff=lambda head: head.startswith((b"ARROW1", b"FEA1")),
    native=True,
    library="pyarrow",
)
def load_arrow(source: Source, options: Options) -> list[Table]:
    """The one record of the file."""
    from pyarrow import feather, ipc

    place = source.place or source.path
    if source.head.startswith(b"FEA1"):
        table = feather.read_table(place, memory_map=False)
        return [_table(table, table.num_rows, source)]
    with ipc.open_file(place.read_bytes()) as file:
        total, batches = 0, []
        for k in range(file.num_record_batches):
            batch = file.get_batch(k)
            batch.validate(full=True)
            total += 8 * batch.num_rows * batch.num_columns
            source.allow(total)
            batches.append(batch)
        import pyarrow as pa

        table = pa.Table.from_batches(batches, file.schema)
    return [_table(table, table.num_rows, source)]


def _table(table: Any, declared: int, source: Source) -> Table:
    import pyarrow.types as types

    table.validate(full=True)
    if table.num_rows != declared:
        source.refuse(f"truncated: {table.num_rows} of {declared} rows", None, "all that the file declares")
    if table.num_columns > COLUMNS:
        source.refuse("too many columns", table.num_columns, f"at most {COLUMNS}")
    texts = _about(table.schema.metadata)
    kept = [
        i for i, f in enumerate(table.schema)
        if types.is_integer(f.type) or types.is_floating(f.type) or types.is_temporal(f.type)
        or types.is_decimal(f.type)
    ]  # fmt: skip
    if not kept or not table.num_rows:
        found = ", ".join(f"{f.name} ({f.type})" for f in table.schema)[:300] or "no column"
        source.refuse("the file holds no numbers", found, "columns of numbers")
    stamps = [i for i in kept if types.is_temporal(table.schema.field(i).type)]
    times = {i: _seconds(table.column(i)) for i in stamps}
    names, units, columns = [], [], []
    units_of = texts.get("units")
    stated = units_of if isinstance(units_of, dict) else {}
    for i in kept:
        field = table.schema.field(i)
        name, written = name_and_unit(field.name) if field.name else ("", None)
        own = {k.decode("utf-8", "replace"): v.decode("utf-8", "replace") for k, v in (field.metadata or {}).items()}
        said = own.get("unit") or own.get("units") or stated.get(field.name) or written
        names.append(field.name if not written else name)
        units.append("s" if i in stamps else str(said) if said else None)
        columns.append(times[i][0] if i in times else _numbers(table.column(i)))
    passed = [f"{f.name} ({f.type})" for i, f in enumerate(table.schema) if i not in kept]
    notes = [f"passed over: {', '.join(passed[:20])}"] if passed else []
    dated = _dated(table, stamps[0]) if stamps else {}
    dt, title = _step(texts, source), texts.get("name")
    clock = kept.index(stamps[0]) if stamps else next((i for i, n in enumerate(names) if n.lower() in TIME_NAMES), None)
    if dated and clock is not None:  # dates are settled where a zone can be stated for them
        del names[clock], units[clock], columns[clock]
        clock = None
    if clock is not None and dt is not None and _even(columns[clock], dt):  # the step as it was written is exact
        del names[clock], units[clock], columns[clock]
        clock = None
    if not columns:
        source.refuse("there is a time column and nothing else", ", ".join(f.name for f in table.schema),
                      "at least one channel")  # fmt: skip
    return Table(
        np.column_stack(columns),
        name=title if isinstance(title, str) and title else source.path.stem,
        columns=tuple(names),
        units=tuple(units),
        dt=dt if clock is None else None,
        time=clock,
        notes=tuple(notes),
        start=times[stamps[0]][1] if stamps else None,
        **dated,
    )


def _dated(table: Any, column: int) -> dict[str, Any]:
    """Stamps with a date, the name of their column, and whether they are in UTC; nothing for times of day."""
    import pyarrow.types as types

    field = table.schema.field(column)
    if not (types.is_timestamp(field.type) or types.is_date(field.type)):
        return {}
    stamps = table.column(column).cast("timestamp[ns]", safe=False).to_numpy().astype("datetime64[ns]")
    return {"stamps": stamps, "clock": field.name or "time", "aware": bool(getattr(field.type, "tz", None))}


def _even(time: NDArray[np.float64], dt: float) -> bool:
    """Whether a time column holds multiples of a step, to a nanosecond or a millionth of it."""
    away = np.abs(time - time[0] - np.arange(len(time)) * dt)
    return bool(np.all(away <= max(1.01e-9, 1e-6 * dt)))


def _about(metadata: dict[bytes, bytes] | None) -> dict[str, Any]:
    """Metadata of a file with its JSON read: of pandas, what it keeps of ``DataFrame.attrs``."""
    found: dict[str, Any] = {}
    for key, value in (metadata or {}).items():
        if len(value) > 2**20 or key.startswith(b"ARROW:"):
            continue
        text = value.decode("utf-8", "replace")
        try:
            found[key.decode("utf-8", "replace")] = json.loads(text)
        except ValueError:
            found[key.decode("utf-8", "replace")] = text
    inner = [found.pop(k, None) for k in ("pandas", "PANDAS_ATTRS")]
    for tree in (inner[0].get("attributes") if isinstance(inner[0], dict) else None, inner[1]):
        if isinstance(tree, dict):
            found = {**tree, **found}
    return found


def _step(texts: dict[str, Any], source: Source) -> float | None:
    """Step in s that the metadata of the file state."""
    for key, value in texts.items():
        if key.lower() in (*RATES, *STEPS) and isinstance(value, int | float) and not isinstance(value, bool):
            if not (math.isfinite(value) and value > 0):
                source.refuse("the step is not positive", f"{key} = {value}", "> 0")
            return float(value) if key.lower() in STEPS else 1.0 / value
    return None


def _numbers(column: Any) -> NDArray[np.float64]:
    """A column as float64, NaN where nothing is."""
    return np.asarray(column.cast("float64", safe=False).to_numpy(), dtype=float)


def _seconds(column: Any) -> tuple[NDArray[np.float64], float | None]:
    """Stamps in s after the first one, and that one in s since 1970; times of day and durations, which have none."""
    import pyarrow.types as types

    kind = column.type
    if types.is_timestamp(kind) or types.is_date(kind):
        return since(column.cast("timestamp[ns]", safe=False).to_numpy().astype("datetime64[ns]"))
    scale = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}[kind.unit]
    counts = column.cast("int32" if kind.bit_width == 32 else "int64").to_numpy().astype(float)
    return (counts - counts[0]) * scale, None
