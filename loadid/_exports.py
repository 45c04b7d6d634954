"""Records as files of other tools: text, Parquet, universal files and MAT; what `loadid.read` reads back bit for bit.

All numbers are written in SI. A file is written whole or not at all.
"""

from __future__ import annotations

import io
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._channels import Dof
from structures.errors import InputError
from structures.files import _storage as storage

from . import _stamps
from ._objects import clock, needed

if TYPE_CHECKING:
    from ._record import Record

SPECIFIC = {"displacement": 8, "velocity": 11, "acceleration": 12, "force": 13, "strain": 3, "pressure": 15}
NAME = 20  # characters that a universal file holds of the name of an axis


def _target(path: str | os.PathLike[str], *suffixes: str) -> Path:
    place = Path(path).expanduser()
    if place.suffix.lower() not in suffixes:
        raise InputError("the suffix says another format", where=str(path), found=place.suffix or "no suffix",
                         expected=" or ".join(suffixes), hint="name the file by its format")  # fmt: skip
    return place


def to_csv(record: Record, path: str | os.PathLike[str]) -> None:
    """See `Record.to_csv`."""
    import csv

    place = _target(path, ".csv", ".txt")
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    stamped = record.start is not None
    units = [f"{c.label} [{c.unit}]" for c in record.channels]
    writer.writerow(["time" if stamped else "time [s]", *units])
    times = [f"{t}Z" for t in clock(record.start, record.time)] if stamped else map(repr, record.time.tolist())
    for time, row in zip(times, record.values.tolist(), strict=True):
        writer.writerow([time, *("" if x != x else repr(x) for x in row)])
    storage.replace(place, text.getvalue().encode())


def to_parquet(record: Record, path: str | os.PathLike[str]) -> None:
    """See `Record.to_parquet`."""
    place = _target(path, ".parquet", ".pq")
    pa = needed("pyarrow", "a Parquet file")
    parquet = needed("pyarrow.parquet", "a Parquet file")
    stamped = record.start is not None
    kind = pa.timestamp("ns", tz="UTC") if stamped else pa.float64()
    time = clock(record.start, record.time)
    columns = [pa.array(time.astype(np.int64) if stamped else time).cast(kind)]
    fields = [pa.field("time", kind, metadata={"unit": "s"})]
    for i, channel in enumerate(record.channels):
        columns.append(pa.array(record.values[:, i]))
        fields.append(pa.field(channel.label, pa.float64(), metadata={"unit": channel.unit}))
    about = {"dt": repr(record.dt), "name": record.name}
    if record.start is not None:
        about["start"] = _stamps.iso(record.start)
    file = io.BytesIO()
    parquet.write_table(pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=about)), file,
                        write_page_checksum=True)  # fmt: skip
    storage.replace(place, file.getvalue())


def to_mat(record: Record, path: str | os.PathLike[str]) -> None:
    """See `Record.to_mat`."""
    from scipy.io import savemat

    place = _target(path, ".mat")
    variables: dict[str, Any] = {
        "data": record.values, "dt": record.dt, "channels": "\n".join(record.labels),
        "units": "\n".join(c.unit for c in record.channels),
    }  # fmt: skip
    if record.start is not None:
        variables["start"] = _stamps.iso(record.start)
    file = io.BytesIO()
    savemat(file, variables, do_compression=True)
    storage.replace(place, file.getvalue())


def to_uff(record: Record, path: str | os.PathLike[str]) -> None:
    """See `Record.to_uff`."""
    place = _target(path, ".uff", ".unv", ".ufb")
    long = [
        n for n in record.labels if len(n.encode()) > NAME or n.upper() == "NONE" or "  " in n or not n.isprintable()
    ]
    if long:
        raise InputError("a label does not fit into a universal file", where=f"channel {long[0]!r}",
                         found=f"{len(long[0].encode())} bytes", expected=f"at most {NAME}, in one line",
                         hint="name the channels anew, or write another format")  # fmt: skip
    storage.replace(place, b"".join([_units_164(), *(_function_58(record, i) for i in range(len(record.labels)))]))


def _set(*lines: str) -> bytes:
    return "".join(f"{line}\n" for line in (f"{-1:6d}", *lines, f"{-1:6d}")).encode("latin-1", "replace")


def _units_164() -> bytes:
    """The SI as the units of the file."""
    factors = f"{1.0:25.17E}{1.0:25.17E}{1.0:25.17E}".replace("E", "D")
    return _set(f"{164:6d}", f"{1:10d}{'SI: Meter (newton)':20s}{2:10d}", factors, f"{273.15:25.17E}".replace("E", "D"))


def _function_58(record: Record, i: int) -> bytes:
    """Data set 58b of a channel: its samples in double precision, its step in the header where that holds it."""
    from structures.files._uff_datasets import unrounded

    channel, values = record.channels[i], np.asarray(record.values[:, i], "<f8")
    text = f"{record.dt:13.5E}"
    even = unrounded(float(text), text.strip()) == record.dt
    data = (values if even else np.column_stack([record.time, values])).astype("<f8").tobytes()
    name, node, way = _place(channel.label)
    begun = "NONE" if record.start is None else _stamps.iso(record.start)
    lines = [f"{x:80.80s}" for x in (record.name or "NONE", "NONE", begun, "NONE", "NONE")]
    lines.append(f"{1:5d}{0:10d}{0:5d}{0:10d} {name:10s}{node:10d}{way:4d} {'NONE':10s}{0:10d}{0:4d}")
    step = text if even else f"{0:13.5E}"
    lines.append(f"{4:10d}{len(values):10d}{int(even):10d}{0:13.5E}{step}{0:13.5E}")
    kind = SPECIFIC.get(channel.quantity, 0)
    axes = [(17, "time", "s"), (kind, channel.label, channel.unit), (0, "NONE", "NONE"), (0, "NONE", "NONE")]
    lines += [f"{k:10d}{0:5d}{0:5d}{0:5d} {label:20s} {unit:20s}" for k, label, unit in axes]
    head = f"{-1:6d}\n{58:6d}b{1:6d}{2:6d}{11:12d}{len(data):12d}{0:6d}{0:6d}{0:12d}{0:12d}\n"
    return (head + "".join(f"{line}\n" for line in lines)).encode() + data + f"\n{-1:6d}\n".encode()


def _place(label: str) -> tuple[str, int, int]:
    """Entity, node and direction of a label: those of a degree of freedom where it is one."""
    try:
        dof = Dof.parse(label)
    except InputError:
        return "NONE", 0, 0
    return ("NONE", dof.node, dof.direction) if str(dof) == label and dof.direction else ("NONE", 0, 0)
