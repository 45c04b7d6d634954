"""NumPy files (.npy, .npz): arrays of real numbers, never unpickled, sizes checked before anything is unpacked."""

from __future__ import annotations

import io
import zipfile
from pathlib import PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrays import tables_of
from .registry import register
from .source import Options, Source, Table, time_first

MEMBERS = 4096


@register("NPY", suffixes=(".npy",), sniff=lambda head: head.startswith(b"\x93NUMPY"))
def load_npy(source: Source, options: Options) -> list[Table]:
    """The array as one record."""
    x = array_of(source.data(), source, source.path.name)
    if x.dtype.kind not in "fiu":
        source.refuse("the array holds no real numbers", f"dtype {x.dtype}", "float or integer")
    return [time_first(Table(x, name=source.path.stem), source, options)]


@register("NPZ", suffixes=(".npz",), sniff=lambda head: head.startswith(b"PK\x03\x04"))
def load_npz(source: Source, options: Options) -> list[Table]:
    """Every 2-D array as a record; 1-D arrays of one length together as one record."""
    arrays: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(source.path) as archive:
        members = archive.infolist()
        if len(members) > MEMBERS:
            source.refuse("too many arrays", len(members), f"at most {MEMBERS}")
        source.allow(sum(m.file_size for m in members), "the archive")
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
        source.refuse(
            f"truncated: {there // dtype.itemsize} of {count} numbers"
            if short
            else "more bytes than the header declares",
            f"{what}: {there} bytes of data",
            f"{declared} bytes: shape {shape} of {dtype}",
            "transfer or export the file again",
        )
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
