"""Records out of named arrays: NumPy files (.npy, .npz), never unpickled; HDF5 files in a plain layout.

HDF5 is walked so that nothing outside is touched. Datasets are 2-D (a record each) or 1-D (the channels of their
group). Attributes ``fs`` or ``dt``, ``channels`` and ``units`` stand on the dataset, on its group or on the root;
``unit`` on a 1-D dataset. Archives of SDynPy are read by `curves`.
"""

from __future__ import annotations

import io
import math
import zipfile
from dataclasses import replace
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import _stamps
from .curves import of_sdynpy
from .settle import TIME_NAMES, distinct
from .source import COLUMNS, RATE, Options, Source, Table, register, time_first

RATES = ("fs", "sampling_rate", "sample_rate", "sampling_frequency")
STEPS = ("dt", "delta_t", "step")
NAMES = ("channels", "labels", "columns", "names", "channel_names")
UNITS = ("units", "unit")
STARTS = ("start", "start_time")


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
    dt, begun = step_of(arrays, source), begun_of(arrays)
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
        table = time_first(Table(x, name=key, columns=names, dt=dt, begun=begun), source, options)
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
            source.refuse("arrays of different length", str(lengths)[:300], "channels of one record, equally long",
                          "save arrays of one length")  # fmt: skip
        if len({len(x) for x in channels.values()}) == 1 and len(channels) <= COLUMNS:
            joined = _joined(channels, clock, name or source.path.stem, dt, units, unit_of or {})
            tables.append(replace(joined, begun=begun))
    return tables


def begun_of(values: dict[str, Any]) -> str:
    """When a record began, of an entry named start that is a text with a date and a time; "" where there is none."""
    texts = [str(np.asarray(x).reshape(-1)[0]) for k, x in values.items() if k.lower() in STARTS and np.size(x) == 1]
    return next((text.strip() for text in texts if _stamps.form(text) in ("stamp", "date")), "")


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
        if len(flat) == 1 and isinstance(flat[0], str) and "\n" in flat[0]:  # a text with a line for each
            flat = flat[0].split("\n")
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


MEMBERS = 4096


@register("NPY", suffixes=(".npy",), sniff=lambda head: head.startswith(b"\x93NUMPY"))
def load_npy(source: Source, options: Options) -> list[Table]:
    """The array as one record."""
    x = array_of(source.data(), source, source.path.name)
    if x.dtype.kind not in "fiu":
        source.refuse("the array holds no real numbers", f"dtype {x.dtype}", "float or integer")
    return [time_first(Table(x, name=source.path.stem), source, options)]


@register("NPZ", suffixes=(".npz",), sniff=lambda head: head.startswith(b"PK\x03\x04") and b".xml" not in head[30:200])
def load_npz(source: Source, options: Options) -> list[Table]:
    """Every 2-D array as a record; 1-D arrays of one length together as one record."""
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(source.path) as archive:
        members = archive.infolist()
        if len(members) > MEMBERS:
            source.refuse("too many arrays", len(members), f"at most {MEMBERS}")
        source.allow(sum(m.file_size for m in members), "the archive")
        if {"data.npy", "function_type.npy"} <= {m.filename for m in members}:
            return of_sdynpy(source)
        for member in members:
            arrays[_key(member.filename, arrays, source)] = array_of(
                _unpacked(archive, member, source), source, member.filename
            )
    return tables_of(arrays, source, options)


def array_of(data: bytes, source: Source, what: str) -> NDArray[Any]:
    """Array of the bytes of an NPY file, which must be as many as its header declares.

    Raises
    ------
    InputError
        Objects (pickled), a damaged header, fewer or more bytes than declared.
    """
    file = io.BytesIO(data)
    try:
        version = np.lib.format.read_magic(file)
        readers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
        if version not in readers:
            source.refuse("unknown version of the NPY format", f"{what}: {version}", "1.0 or 2.0")
        shape, fortran, dtype = readers[version](file, max_header_size=10_000)
    except Exception as error:  # the header is parsed by the tokenizer of Python: anything may come
        source.refuse("the NPY header is damaged", f"{what}: {str(error)[:200]}", "an undamaged file")
    if dtype.hasobject:
        source.refuse("the array holds Python objects, which are never unpickled", what, "numbers or text")
    if dtype.kind not in "fiubUS" or dtype.itemsize == 0:
        source.refuse("the array holds no numbers", f"{what}: dtype {dtype}", "float or integer")
    if any(n < 0 for n in shape):
        source.refuse("the NPY header is damaged", f"{what}: shape {shape}", "sizes, not negative")
    count = 1
    for n in shape:
        count *= n
    declared, there = count * dtype.itemsize, len(data) - file.tell()
    if there != declared:
        short = there < declared
        source.refuse(f"truncated: {there // dtype.itemsize} of {count} numbers" if short
                      else "more bytes than the header declares", f"{what}: {there} bytes of data",
                      f"{declared} bytes: shape {shape} of {dtype}", "transfer or export the file again")  # fmt: skip
    flat = np.frombuffer(data, dtype=dtype, count=count, offset=file.tell())
    return flat.reshape(shape[::-1]).T if fortran else flat.reshape(shape)


def _key(name: str, taken: dict[str, Any], source: Source) -> str:
    parts = PurePosixPath(name).parts
    if name.startswith("/") or "\\" in name or ".." in parts or ":" in name or not name.endswith(".npy"):
        source.refuse("a member of the archive is no array", repr(name[:80]), "names such as F.npy")
    key = name.removesuffix(".npy")
    if key in taken or not key:
        source.refuse("a member of the archive has no name of its own", repr(name[:80]), "unique names")
    return key


def _unpacked(archive: zipfile.ZipFile, member: zipfile.ZipInfo, source: Source) -> bytes:
    """Bytes of a member: never more than it declares, and with the right checksum."""
    if member.flag_bits & 1:
        source.refuse("the archive is encrypted", member.filename, "a plain archive")
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        source.refuse("unknown compression", f"{member.filename}: method {member.compress_type}", "stored or deflated")
    with archive.open(member) as file:
        data = file.read(member.file_size + 1)  # at its end the checksum is compared
        if len(data) != member.file_size:
            source.refuse("truncated archive", f"{member.filename}: {len(data)} bytes", f"{member.file_size} bytes")
    return data


# -- HDF5 --------------------------------------------------------------------------------------------------------------
# deflate, shuffle, fletcher32, szip, lzf: what the library itself brings, and nothing that loads a plug-in
FILTERS = {1, 2, 3, 4, 32000}
DEPTH = 16
OBJECTS = 10_000
ATTRIBUTE_BYTES = 65_536


@register(
    "HDF5", suffixes=(".h5", ".hdf5", ".hdf"), sniff=lambda head: head.startswith(b"\x89HDF\r\n\x1a\n"), native=True
)
def load(source: Source, options: Options) -> list[Table]:
    """All records of the file, named by their place in it."""
    import h5py

    with h5py.File(source.place or source.path, "r") as file:
        walk = Walk(source, options)
        walk.group(file, "", {}, 0)
    said = (f"left out, as they are no record: {', '.join(walk.passed[:8])}",) if walk.passed else ()
    return [replace(table, notes=(*table.notes, *said)) for table in walk.tables]


class Walk:
    """One pass over a file, from the root, one name at a time."""

    def __init__(self, source: Source, options: Options) -> None:
        self.source, self.options = source, options
        self.tables: list[Table] = []
        self.passed: list[str] = []  # a damaged dataset may look like something else: what is not read is said
        self.unpacked = self.parts = 0
        self.seen: set[Any] = set()

    def group(self, group: Any, path: str, above: dict[str, Any], depth: int) -> None:
        """Records of a group and of those below it; `above` are the attributes that it inherits."""
        import h5py

        if depth > DEPTH:
            self.source.refuse("groups are nested too deep", path, f"at most {DEPTH} levels")
        about = {**above, **self.attributes(group, path)}
        arrays: dict[str, NDArray[Any]] = {}
        own: dict[str, dict[str, Any]] = {}
        below = []
        for name in group:
            place = f"{path}/{name}"
            link = group.get(name, getlink=True)
            if isinstance(link, h5py.SoftLink):
                continue  # what it points to is found in its own place, or lies behind a link that is not followed
            if not isinstance(link, h5py.HardLink):
                self.source.refuse("a link leaves the file", place, "a file that holds its own data")
            item = group[name]
            address = (h5py.h5o.get_info(item.id).addr, type(item).__name__)
            if address in self.seen:
                continue
            self.seen.add(address)
            if len(self.seen) > OBJECTS:
                self.source.refuse("too many groups and datasets", f"more than {OBJECTS}", f"at most {OBJECTS}",
                                   "export the channels of one test into a file of their own")  # fmt: skip
            if isinstance(item, h5py.Group):
                below.append((item, place))
            elif not isinstance(item, h5py.Dataset):
                self.passed.append(f"{place} (a data type)")
            elif (values := self.dataset(item, place)) is not None:
                arrays[name], own[name] = values, self.attributes(item, place)
            else:
                self.passed.append(f"{place} ({'x'.join(map(str, item.shape or ())) or 'no'} values of {item.dtype})")
        self.collect(arrays, own, path, about)
        for item, place in below:
            self.group(item, place, about, depth + 1)

    def collect(
        self, arrays: dict[str, NDArray[Any]], own: dict[str, dict[str, Any]], path: str, about: dict[str, Any]
    ) -> None:
        """Tables of the datasets of one group."""
        flat = {k: x for k, x in arrays.items() if x.ndim < 2 or x.dtype.kind in "US"}
        for name, x in arrays.items():
            if x.ndim == 2 and x.dtype.kind in "fiu":
                clocks = {
                    k: y
                    for k, y in flat.items()
                    if y.ndim == 1 and y.dtype.kind in "fiu" and k.lower() in ("time", "t")
                }
                texts = {k: y for k, y in flat.items() if y.dtype.kind in "US" or y.ndim == 0}
                self.add({**_plain({**about, **own[name]}), **clocks, **texts, f"{path}/{name}".lstrip("/"): x}, "")
        channels = {k: x for k, x in flat.items() if x.ndim == 1 and x.dtype.kind in "fiu"}
        if channels and not any(x.ndim == 2 for x in arrays.values()):
            units = {k: t[0] for k in channels if (t := texts_of(_plain(own[k]), UNITS, self.source))}
            attributes = {
                k: v for k in channels for k, v in _plain(own[k]).items() if step_of({k: v}, self.source) is not None
            }
            inherited = {k: v for k, v in _plain(about).items() if k.lower() not in NAMES}
            self.add({**inherited, **attributes, **flat}, path.lstrip("/") or self.source.path.stem, units)

    def add(self, arrays: dict[str, NDArray[Any]], name: str, units: dict[str, str] | None = None) -> None:
        """Tables of some arrays and of what is said about them."""
        self.tables += tables_of(arrays, self.source, self.options, name=name, unit_of=units)

    def dataset(self, item: Any, place: str) -> NDArray[Any] | None:
        """Numbers or texts of a dataset that lies wholly in this file; None for kinds that are no record."""
        import h5py

        if item.external or item.is_virtual:
            self.source.refuse("a dataset lies outside the file", place, "a file that holds its own data")
        plist = item.id.get_create_plist()
        filters = {plist.get_filter(i)[0] for i in range(plist.get_nfilters())}
        if not filters <= FILTERS:
            self.source.refuse(
                "unknown compression", f"{place}: filter {sorted(filters - FILTERS)}", "gzip, lzf or szip"
            )
        if item.shape is None or item.ndim > 2 or 0 in item.shape:
            return None
        text = h5py.check_string_dtype(item.dtype) is not None
        both = item.dtype.names == ("real", "imag")  # how MATLAB writes complex numbers
        if not text and not both and item.dtype.kind not in "fiu":
            return None
        count = math.prod(item.shape)
        if text and count > ATTRIBUTE_BYTES:
            return None
        self.unpacked += count * max(item.dtype.itemsize, 8)
        self.source.allow(self.unpacked, f"dataset {place}")
        self.complete(item, place)
        if text:
            return np.asarray(item.asstr(errors="replace")[()], dtype=str)
        values = np.asarray(item[()])
        return values["real"] + 1j * values["imag"] if both else values

    def complete(self, item: Any, place: str) -> None:
        """Refuse a dataset of which parts were never written: the library would make numbers up."""
        if item.chunks is not None:
            declared = math.prod(-(-n // c) for n, c in zip(item.shape, item.chunks, strict=True))
            stored = int(item.id.get_num_chunks())
            what = "chunks"
        else:
            declared, what = math.prod(item.shape) * item.dtype.itemsize, "bytes"
            stored = int(item.id.get_storage_size())
        if stored < declared:
            self.source.refuse(f"truncated: {stored} of {declared} {what}", place, "all that the dataset declares")
        if stored > declared and what == "bytes" and item.dtype.kind in "fiu":
            self.source.refuse(f"damaged: {stored} bytes are stored, {declared} declared", place, "as many as declared")

    def attributes(self, item: Any, place: str) -> dict[str, Any]:
        """Numbers and texts that stand on an object, of those names that mean something here."""
        import h5py

        found: dict[str, Any] = {}
        for name in item.attrs:
            if name.lower() not in (*NAMES, *UNITS, *RATES, *STARTS, "dt"):
                continue
            attribute = item.attrs.get_id(name)
            size = math.prod(attribute.shape) * max(attribute.dtype.itemsize, 1)
            if size > ATTRIBUTE_BYTES:
                self.source.refuse(
                    "an attribute is too large", f"{place} {name}: {size} bytes", f"{ATTRIBUTE_BYTES} bytes"
                )
            if attribute.dtype.kind in "fiuSU" or h5py.check_string_dtype(attribute.dtype) is not None:
                found[name] = item.attrs[name]
        return found


def _plain(attributes: dict[str, Any]) -> dict[str, NDArray[Any]]:
    """Attributes as arrays of numbers or texts; "F,a" is two names."""
    plain = {}
    for name, value in attributes.items():
        x = np.asarray(value)
        if x.dtype.kind == "O":
            x = np.array([t.decode("utf-8", "replace") if isinstance(t, bytes) else str(t) for t in x.reshape(-1)])
        elif x.dtype.kind == "S":
            x = np.char.decode(x, "utf-8", "replace")
        if x.dtype.kind == "U" and x.size == 1 and "," in str(x.reshape(-1)[0]):
            x = np.array([t.strip() for t in str(x.reshape(-1)[0]).split(",")])
        plain[name] = x
    return plain
