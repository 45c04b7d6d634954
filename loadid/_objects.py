"""Tables of other libraries as records, and back: pandas, polars, xarray, pint; each is loaded by who uses it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures import units as _units
from structures._channels import Channel
from structures.errors import InputError, plain

from . import _stamps

if TYPE_CHECKING:
    from ._record import Record

FRAMES = ("pandas", "polars")
_BASE = {"[length]": "m", "[mass]": "kg", "[time]": "s", "[current]": "A", "[temperature]": "K"}


def home(value: Any) -> str:
    """Library that an object comes from: ``"pandas"``, ``"polars"``, ``"xarray"``, ``"pint"``, or ""."""
    names = {kind.__module__.partition(".")[0] for kind in type(value).__mro__}
    return next((name for name in ("pandas", "polars", "xarray", "pint") if name in names), "")


# -- quantities of pint ------------------------------------------------------------------------------------------------
def magnitude(quantity: Any, where: str) -> tuple[NDArray[np.float64], str]:
    """Numbers in SI of a quantity of pint, and the symbol of their unit; "" where it has no dimension.

    Raises
    ------
    InputError
        A unit beyond metre, kilogram, second, ampere and kelvin.
    """
    base = quantity.to_base_units()
    parts = dict(base.dimensionality)
    if any(name not in _BASE or power != int(power) for name, power in parts.items()):
        raise InputError("a quantity in a unit that is not read", where=where, found=str(quantity.units),
                         expected="a unit of length, mass, time, current and temperature",
                         hint="pass q.to(UNIT).magnitude and name the unit yourself")  # fmt: skip
    size = float((1.0 * base.units).to(" * ".join(f"{_PINT[n]} ** {p}" for n, p in parts.items()) or "").magnitude)
    text = "*".join(f"{_BASE[name]}^{int(power)}" for name, power in parts.items() if power)
    return np.asarray(plain(base.magnitude), float) * size, _units.parse(text).si if text else ""


_PINT = {"[length]": "meter", "[mass]": "kilogram", "[time]": "second", "[current]": "ampere",
         "[temperature]": "kelvin"}  # fmt: skip


def seconds(step: Any) -> Any:
    """A step as it is given, or in s where it is a quantity of pint.

    Raises
    ------
    InputError
        A quantity that is no time.
    """
    if home(step) != "pint":
        return step
    value, unit = magnitude(step, "record, dt")
    if unit != "s":
        raise InputError("the step is no time", where="record, dt", found=str(step), expected="a quantity of time")
    return float(value)


def in_unit(unit: str, channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
    """Channels of values that came with a unit of their own; "" is none."""
    if not unit:
        return channels
    said = _units.parse(unit)
    for c in channels:
        if c.unit != _units.ARBITRARY and _units.parse(c.unit).dimension != said.dimension:
            raise InputError("the values are in another unit than the channel", where=f"channel {c.label}", found=unit,
                             expected=c.unit)  # fmt: skip
    return tuple(
        replace(c, unit=said.si, quantity=said.quantity) if c.unit == _units.ARBITRARY else c for c in channels
    )


def opened(values: Any) -> tuple[Any, list[str] | None, str]:
    """Values of an object of another library, the names of its columns or None, and a unit of all of them or "".

    Raises
    ------
    InputError
        A table with a time of its own, which `Record.from_dataframe` and `Record.from_xarray` read.
    """
    kind = home(values)
    if kind == "pint":
        numbers, unit = magnitude(values, "record")
        return numbers, None, unit
    if kind == "xarray":
        _refuse("xarray.DataArray", "Record.from_xarray(array)")
    if kind in FRAMES and hasattr(values, "columns"):
        if timed(values):
            _refuse(f"{kind}.DataFrame", "Record.from_dataframe(frame)")
        return values.to_numpy(), [str(c) for c in values.columns], ""
    return (values.to_numpy() if kind in FRAMES else values), None, ""


def timed(frame: Any) -> bool:
    """Whether a DataFrame has an index or a column of time."""
    index = np.asarray(frame.index) if home(frame) == "pandas" else np.zeros(0)
    names = [str(c).strip().lower() for c in frame.columns]
    return index.dtype.kind in "mM" or any(n in ("time", "t", "timestamp") for n in names)


def _refuse(what: str, call: str) -> None:
    raise InputError("a table with a time of its own is no array", where="record", found=what, expected="values alone",
                     hint=f"{call} reads names and step too")  # fmt: skip


# -- in ----------------------------------------------------------------------------------------------------------------
def tabled(value: Any) -> bool:
    """Whether a value is a table with names of its own: a DataFrame of pandas or polars, or a DataArray of xarray."""
    kind = home(value)
    return (kind in FRAMES and hasattr(value, "columns")) or (kind == "xarray" and hasattr(value, "dims"))


def of_table(value: Any, dt: float | None, otherwise: Mapping[str, str]) -> dict[str, Any]:
    """Arguments of the record of a table, for one whose step and units may be known from elsewhere.

    Parameters
    ----------
    dt : float or None
        Step in s, where the table has no time of its own.
    otherwise : mapping
        Unit of each column that states none; arbitrary where it is not among them.
    """
    from ._readers.source import NotStated

    read = of_xarray if home(value) == "xarray" else of_frame
    try:
        return read(value, None, None, dt, otherwise)
    except NotStated:  # units are never asked for here
        raise InputError("the step of a table is not known", where="estimate", found="no time, and no dt",
                         expected="an index or a column of time, or dt= in s") from None  # fmt: skip


def of_frame(
    frame: Any, fs: float | None, units: Mapping[str | int, Any] | None, dt: float | None = None,
    otherwise: Mapping[str, str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Arguments of the record; see `Record.from_dataframe`, and `of_table` for the last two."""
    from ._readers.source import Options, Source, Table

    kind = home(frame)
    if kind not in FRAMES or not hasattr(frame, "columns"):
        raise InputError("this is no DataFrame", where="Record.from_dataframe", found=f"an object of type "
                         f"{type(frame).__name__}", expected="one of pandas or polars",
                         hint="Record(values, dt, labels) takes arrays")  # fmt: skip
    columns = {str(name): frame[name].to_numpy() for name in frame.columns}
    if len(columns) < len(frame.columns):
        raise InputError("column names are doubled", where="DataFrame", found=", ".join(map(str, frame.columns))[:300],
                         expected="unique names", hint="rename them: frame.columns = [...]")  # fmt: skip
    if kind == "pandas":
        named = str(frame.index.name or "time")
        aware = getattr(frame.index, "tz", None) is not None
        index = frame.index.tz_convert("UTC").tz_localize(None).to_numpy() if aware else frame.index.to_numpy()
        if index.dtype.kind in "mM" or frame.index.name is not None:
            columns = {named: index, **{n: x for n, x in columns.items() if n != named}}
        zones = {named} if aware else set()
        zones |= {str(n) for n in frame.columns if getattr(getattr(frame[n], "dt", None), "tz", None) is not None}
        columns = {n: _naive(frame[n]) if n in zones and n in frame.columns else x for n, x in columns.items()}
        attrs = dict(frame.attrs)
    else:
        zones = {n for n, t in frame.schema.items() if getattr(t, "time_zone", None)}
        attrs = {}
    stamps = next((n for n, x in columns.items() if x.dtype.kind == "M"), None)
    source = Source(Path("DataFrame"), 0, b"")
    made: dict[str, Any] = {}
    if stamps is not None:
        made = {"stamps": columns.pop(stamps), "clock": stamps, "aware": stamps in zones}
    attrs = attrs if dt is None else {**attrs, "dt": dt}
    return _settled(columns, attrs, source, Options(fs=fs, units=_units.as_mapping(units)), Table, made, otherwise)


def _naive(series: Any) -> NDArray[Any]:
    return np.asarray(series.dt.tz_convert("UTC").dt.tz_localize(None).to_numpy())


def of_xarray(
    array: Any, fs: float | None, units: Mapping[str | int, Any] | None, dt: float | None = None,
    otherwise: Mapping[str, str] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Arguments of the record; see `Record.from_xarray`, and `of_table` for the last two."""
    from ._readers.source import Options, Source, Table

    if home(array) != "xarray" or not hasattr(array, "dims"):
        raise InputError("this is no DataArray", where="Record.from_xarray", found=f"an object of type "
                         f"{type(array).__name__}", expected="an xarray.DataArray")  # fmt: skip
    if "time" not in array.dims or array.ndim > 2:
        raise InputError("the array has no time", where="DataArray", found=", ".join(map(str, array.dims)),
                         expected="time, and one for the channels", hint='array.rename({"...": "time"})')  # fmt: skip
    other = next((d for d in array.dims if d != "time"), None)
    table = array.transpose("time", other) if other is not None else array
    values = np.asarray(table.to_numpy(), float).reshape(len(table), -1)
    names = [str(n) for n in table[other].to_numpy()] if other is not None and other in table.coords else None
    names = names or ([str(array.name)] if other is None and array.name else None)
    names = names or [f"ch{i + 1}" for i in range(values.shape[1])]
    if len(set(names)) < len(names):
        raise InputError("channel names are doubled", where="DataArray", found=", ".join(names)[:300],
                         expected="unique names", hint="rename them in the coordinate")  # fmt: skip
    attrs: dict[str, Any] = {str(k): v for k, v in array.attrs.items()}
    if "unit" in array.coords:
        attrs["units"] = dict(zip(names, map(str, np.atleast_1d(array["unit"].to_numpy())), strict=True))
    elif isinstance(attrs.get("units"), str):
        attrs["units"] = dict.fromkeys(names, attrs["units"])
    columns: dict[str, NDArray[Any]] = dict(zip(names, values.T, strict=True))
    made: dict[str, Any] = {}
    if "time" in array.coords:
        time = array["time"].to_numpy()
        if time.dtype.kind == "M":
            made = {"stamps": time, "aware": "start" in attrs}  # numpy knows no zones; of a record they are in UTC
        else:
            columns = {"time": time, **columns}
    source = Source(Path("DataArray"), 0, b"")
    attrs = attrs if dt is None else {**attrs, "dt": dt}
    return _settled(columns, attrs, source, Options(fs=fs, units=_units.as_mapping(units)), Table, made, otherwise)


def _settled(
    columns: Mapping[str, NDArray[Any]], attrs: Mapping[str, Any], source: Any, options: Any, table: Any,
    made: dict[str, Any], otherwise: Mapping[str, str] | None,
) -> dict[str, Any]:  # fmt: skip
    """Arguments of a record of columns, settled as those of a file; `attrs` may hold units, dt, start and name."""
    from ._readers.csv_table import name_and_unit
    from ._readers.settle import TIME_NAMES, check_unit_keys, settled

    columns = {n: x / np.timedelta64(1, "s") if x.dtype.kind == "m" else x for n, x in columns.items()}
    passed = [n for n, x in columns.items() if x.dtype.kind not in "fiu"]
    kept = {n: x for n, x in columns.items() if n not in passed}
    if not kept:
        source.refuse("there are no columns of numbers", ", ".join(columns)[:300] or "nothing", "numbers",
                      "convert them: frame.astype(float)")  # fmt: skip
    stated = attrs.get("units")
    pairs = [name_and_unit(n) for n in kept]
    told = [stated.get(n) if isinstance(stated, Mapping) else None for n in kept]
    names = tuple(n if t else name for n, t, (name, _) in zip(kept, told, pairs, strict=True))
    said = [t or unit for t, (_, unit) in zip(told, pairs, strict=True)]
    notes = [f"passed over: {', '.join(passed[:20])} (no numbers)"] if passed else []
    if otherwise is not None:
        taken = [f"{n} [{otherwise[n]}]" for n, unit in zip(names, said, strict=True) if not unit and n in otherwise]
        notes += [f"in the unit of the sensor, as none is stated: {', '.join(taken[:20])}"] if taken else []
        times = [n.strip().lower() in TIME_NAMES for n in names]
        said = [
            u or (None if t else otherwise.get(n, _units.ARBITRARY))
            for n, u, t in zip(names, said, times, strict=True)
        ]  # fmt: skip
    dt = attrs.get("dt")
    found = table(
        np.column_stack(list(kept.values())),
        name=str(attrs.get("name") or ""),
        columns=names,
        units=tuple(said),
        dt=float(dt) if isinstance(dt, int | float) and np.isfinite(dt) and dt > 0 else None,
        start=_stamps.utc(attrs["start"]) if attrs.get("start") is not None else None,
        notes=tuple(notes),
        **made,
    )
    check_unit_keys([found], source, options)
    return settled(found, source, options)


# -- out ---------------------------------------------------------------------------------------------------------------
def clock(start: float | None, time: NDArray[np.float64]) -> NDArray[Any]:
    """Time of samples: in s, or as UTC ``datetime64[ns]`` where it is known when they began."""
    if start is None:
        return time
    return np.datetime64(_stamps.nanoseconds(start), "ns") + np.rint(time * 1e9).astype("timedelta64[ns]")


def to_frame(columns: Mapping[str, NDArray[Any]], index: NDArray[Any], name: str, attrs: Mapping[str, Any]) -> Any:
    """DataFrame of pandas with named columns over an index; stamps are in UTC."""
    pandas = needed("pandas", "a DataFrame")
    axis = (
        pandas.DatetimeIndex(index, tz="UTC", name=name) if index.dtype.kind == "M" else pandas.Index(index, name=name)
    )
    frame = pandas.DataFrame(dict(columns), index=axis, copy=True)
    frame.attrs.update(attrs)
    return frame


def needed(module: str, what: str) -> Any:
    """A library that only this needs.

    Raises
    ------
    InputError
        If it is not installed.
    """
    import importlib

    try:
        return importlib.import_module(module)
    except ImportError:
        raise InputError(f"{what} is made by a package that is not installed", where=module, found=f"no {module}",
                         expected=module, hint=f"pip install {module.partition('.')[0]}") from None  # fmt: skip


def to_dataframe(record: Record) -> Any:
    """See `Record.to_dataframe`."""
    index = clock(record.start, record.time)
    columns = {label: record.values[:, i] for i, label in enumerate(record.labels)}
    return to_frame(columns, index, "time" if index.dtype.kind == "M" else "time [s]", about(record))


def to_xarray(record: Record) -> Any:
    """See `Record.to_xarray`."""
    xarray = needed("xarray", "a DataArray")
    coords = {
        "time": ("time", clock(record.start, record.time)),
        "channel": list(record.labels),
        "unit": ("channel", [c.unit for c in record.channels]),
    }
    attrs = {k: v for k, v in about(record).items() if k != "units"}
    return xarray.DataArray(np.array(record.values), dims=("time", "channel"), coords=coords, name=record.name or None,
                            attrs=attrs)  # fmt: skip


def about(record: Record) -> dict[str, Any]:
    """What a record says beside its numbers, as plain values."""
    found: dict[str, Any] = {"dt": record.dt, "units": units_of(record.labels, [c.unit for c in record.channels])}
    if record.name:
        found["name"] = record.name
    if record.start is not None:
        found["start"] = _stamps.iso(record.start)
    return found


def units_of(labels: Sequence[str], units: Sequence[str]) -> dict[str, str]:
    """Units by label."""
    return dict(zip(labels, units, strict=True))
