"""Records out of named arrays, for the formats that hold such: NPZ archives and HDF5 groups."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .settle import TIME_NAMES, distinct
from .source import COLUMNS, RATE, Options, Source, Table, time_first

RATES = ("fs", "sampling_rate", "sample_rate", "sampling_frequency")
STEPS = ("dt", "delta_t", "step")
NAMES = ("channels", "labels", "columns", "names", "channel_names")
UNITS = ("units", "unit")


def tables_of(
    arrays: dict[str, NDArray[Any]],
    source: Source,
    options: Options,
    *,
    name: str = "",
    unit_of: dict[str, str] | None = None,
) -> list[Table]:
    """Tables of some arrays that lie together.

    Every 2-D array of numbers is a record of its own; 1-D arrays of one length are the channels of one record; a 1-D
    array named time is the time of all that have its length. Scalars ``fs`` or ``dt`` give the step, text arrays
    ``channels`` and ``units`` describe columns. Arrays of more axes are passed over.

    Raises
    ------
    InputError
        1-D arrays of different length, descriptions that do not fit.
    """
    dt = step_of(arrays, source)
    names, units = texts_of(arrays, NAMES, source), texts_of(arrays, UNITS, source)
    numbers = {
        k: x for k, x in arrays.items() if x.dtype.kind in "fiu" and x.size and k.lower() not in (*RATES, *STEPS)
    }
    single = {k: x for k, x in numbers.items() if x.ndim == 1}
    times = {k: x for k, x in single.items() if k.lower() in TIME_NAMES}
    clock = next(iter(times.values()), None)
    tables = []
    for key, x in numbers.items():
        if x.ndim != 2:
            continue
        table = time_first(Table(x, name=key, columns=names, dt=dt), source, options)
        columns = table.values.shape[1]
        fits = names is not None and len(names) == columns
        table = replace(
            table, columns=names if fits else None, units=units if units and len(units) == columns else None
        )
        tables.append(_with_clock(table, clock))
    channels = {k: x for k, x in single.items() if k not in times}
    if channels:
        lengths = {k: len(x) for k, x in single.items()}
        if len(set(lengths.values())) > 1 and not tables:
            source.refuse(
                "arrays of different length",
                str(lengths)[:300],
                "channels of one record, equally long",
                "save arrays of one length",
            )
        if len({len(x) for x in channels.values()}) == 1 and len(channels) <= COLUMNS:
            tables.append(_joined(channels, clock, name or source.path.stem, dt, units, unit_of or {}))
    return tables


def step_of(values: dict[str, Any], source: Source) -> float | None:
    """Step in s from entries named fs or dt; None where there is none.

    Raises
    ------
    InputError
        If such an entry is no positive number.
    """
    for key, x in values.items():
        short = key.lower().rpartition("/")[2]
        if short not in (*RATES, *STEPS) or np.size(x) != 1 or np.asarray(x).dtype.kind not in "fiu":
            continue
        number = float(np.asarray(x).reshape(-1)[0])
        if not (np.isfinite(number) and number > 0 and np.isfinite(1 / number)):
            source.refuse("the step is not positive", f"{key} = {number}", "> 0", RATE)
        return number if short in STEPS else 1.0 / number
    return None


def texts_of(values: dict[str, Any], keys: tuple[str, ...], source: Source) -> tuple[str, ...] | None:
    """Texts of the first entry with one of some names."""
    for key, x in values.items():
        if key.lower() not in keys or np.asarray(x).dtype.kind not in "US":
            continue
        if np.size(x) > COLUMNS:
            source.refuse("too many names", f"{key}: {np.size(x)}", f"at most {COLUMNS}")
        flat = np.asarray(x).reshape(-1).tolist()
        return tuple(t.decode("utf-8", "replace") if isinstance(t, bytes) else str(t) for t in flat)
    return None


def _with_clock(table: Table, clock: NDArray[Any] | None) -> Table:
    if clock is None or len(clock) != len(table.values):
        return table
    columns = distinct(table.columns or ("",) * table.values.shape[1])  # counted before time comes to stand first
    return replace(
        table,
        values=np.column_stack((clock, table.values)),
        columns=("time", *columns),
        units=None if table.units is None else (None, *table.units),
        time=0,
    )


def _joined(
    channels: dict[str, NDArray[Any]],
    clock: NDArray[Any] | None,
    name: str,
    dt: float | None,
    units: tuple[str, ...] | None,
    unit_of: dict[str, str],
) -> Table:
    texts: tuple[str | None, ...] = tuple(unit_of.get(k) for k in channels)
    if units is not None and len(units) == len(channels) and not any(texts):
        texts = units
    values = np.column_stack([x.astype(float) for x in channels.values()])
    table = Table(values, name=name, columns=tuple(channels), units=texts, dt=dt)
    return _with_clock(table, clock)
