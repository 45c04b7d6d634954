"""MAT files of level 5 (-v6, -v7): plain arrays of numbers and texts, sizes checked before unpacking.

Only what a measured record needs is read: arrays, and where they are asked for (`read_structs`) structs and cells that
hold such, or sparse matrices (`read_sparse`); objects are listed and never built.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

LEVEL5_BUDGET = 2**31  # bytes that all arrays of a file may take
FREE, EXPANSION = 2**26, 100  # a file that unpacks to more than this multiple of its size is no record
VARIABLES = 10_000
HEADER = 128
MARKS = {b"\x00\x01IM": "<", b"\x01\x00MI": ">"}
_MATRIX, _COMPRESSED, _UTF8, _UTF16 = 14, 15, 16, 17
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
# class of an array in MATLAB -> what it becomes
_CLASSES = {6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8"}
_CHAR, _CELL, _STRUCT, _SPARSE = 4, 1, 2, 5
DEPTH = 12  # levels of structs and cells
PARTS = 100_000  # values within all structs of a file
_OTHERS = {1: "cell", 2: "struct", 3: "object", 5: "sparse", 16: "function", 17: "opaque object", 18: "object"}


@dataclass(frozen=True)
class Tag:
    """Header of a data element: its type, where its bytes begin, how many there are, where the next one begins."""

    type: int
    start: int
    size: int
    beyond: int


def is_level5(head: bytes) -> bool:
    """Whether the first 128 bytes are those of a MAT file of level 5."""
    return len(head) >= HEADER and head[124:128] in MARKS


def read_level5(data: bytes, path: str) -> tuple[dict[str, NDArray[Any]], dict[str, str]]:
    """Arrays of a file by their names, as MATLAB indexes them, and the kinds of the variables that are not read.

    A text becomes an array of one string, a matrix of characters one of a string for each row.

    Raises
    ------
    InputError
        No such file, an element that is cut or damaged, or one that unpacks to more than may be read.
    """
    if not is_level5(data):
        _refuse(path, "no MAT file of level 5", data[:20], "a file that MATLAB writes with -v6 or -v7")
    arrays: dict[str, NDArray[Any]] = {}
    others: dict[str, str] = {}
    for name, value in _variables(data, path):
        if name in arrays or name in others or len(arrays) + len(others) >= VARIABLES:
            _refuse(path, "a variable comes twice, or there are too many", name, f"{VARIABLES} names")
        if isinstance(value, str):
            others[name] = value
        else:
            arrays[name] = value
    return arrays, others


def read_structs(data: bytes, path: str) -> dict[str, Any]:
    """Structs of a file by their names: dictionaries of arrays, texts (str), dictionaries and lists.

    A struct array and a cell are lists; what else MATLAB has is None.

    Raises
    ------
    InputError
        As `read_level5`; structs that are nested too deep or hold too much.
    """
    return {name: v for name, v in _variables(data, path, "nested") if isinstance(v, dict | list)}


def read_sparse(data: bytes, path: str) -> dict[str, dict[str, NDArray[Any]]]:
    """Sparse matrices of a file by their names: ``ir`` (rows), ``jc`` (where columns begin), ``data`` and ``shape``.

    Raises
    ------
    InputError
        As `read_level5`.
    """
    return {name: v for name, v in _variables(data, path, "sparse") if isinstance(v, dict)}


def _variables(data: bytes, path: str, method: str = "matrix") -> Iterator[tuple[str, Any]]:
    """Names and values of all variables, as a method of the reader gives them."""
    reader = _Reader(path, MARKS[data[124:128]], min(LEVEL5_BUDGET, max(FREE, EXPANSION * len(data))))
    at = HEADER
    while at < len(data):
        tag = reader.tag(data, at, padded=False)
        body, inner = data, tag
        if tag.type == _COMPRESSED:
            body = reader.unpacked(data[tag.start : tag.start + tag.size], at)
            inner = reader.tag(body, 0, padded=False)
            if inner.start + inner.size != len(body):
                _refuse(path, "a compressed variable is damaged", f"{len(body)} bytes", f"{inner.size} and a tag", at)
        if inner.type != _MATRIX:
            _refuse(path, "no variable", f"data element of type {inner.type}", "an array", at)
        if inner.size:
            yield getattr(reader, method)(body, inner, at)
        at = tag.beyond


class _Reader:
    """One pass over a file: byte order, and how many bytes may still be unpacked."""

    def __init__(self, path: str, order: str, left: int) -> None:
        self.path, self.order, self.left, self.parts = path, order, left, PARTS

    def tag(self, data: bytes, at: int, *, padded: bool = True) -> Tag:
        """The data element at a byte, which must lie within the data."""
        if at + 8 > len(data):
            self.cut(at, len(data), at + 8)
        first, second = (int(x) for x in np.frombuffer(data, f"{self.order}u4", 2, at))
        if first >> 16:  # a small element: size and type in one word, the bytes in the next
            kind, size, start, beyond = first & 0xFFFF, first >> 16, at + 4, at + 8
            if size > 4:
                _refuse(self.path, "a damaged data element", f"{size} bytes in four", "at most 4", at)
        else:
            kind, size, start = first, second, at + 8
            beyond = start + (size + (-size % 8 if padded else 0))
        if start + size > len(data):
            self.cut(at, len(data), start + size)
        return Tag(kind, start, size, beyond)

    def cut(self, at: int, there: int, wanted: int) -> NoReturn:
        _refuse(self.path, "truncated", f"{there} bytes", f"{wanted}, as the data element there says", at)

    def allow(self, size: int, at: int) -> None:
        """Count bytes against the budget before they are unpacked."""
        self.left -= size
        if self.left < 0:
            _refuse(self.path, "the file unpacks to more than may be read", f"{size} bytes more", "a record", at)

    def unpacked(self, packed: bytes, at: int) -> bytes:
        """Bytes of a compressed element: never more than its first eight declare, and with the right checksum."""
        engine = zlib.decompressobj()
        try:
            head = engine.decompress(packed, 8)
            if len(head) < 8:
                _refuse(self.path, "a compressed variable is cut", f"{len(packed)} bytes", "a whole one", at)
            size = int(np.frombuffer(head, f"{self.order}u4", 2)[1])
            self.allow(size, at)
            body = head + engine.decompress(engine.unconsumed_tail, size + 1)
            if not engine.eof and not engine.unconsumed_tail:
                body += engine.decompress(b"", 1)
        except zlib.error as error:
            _refuse(self.path, "a compressed variable is damaged", str(error)[:100], "a whole one", at)
        if not engine.eof or engine.unused_data or len(body) != size + 8:
            _refuse(self.path, "a compressed variable is cut or damaged", f"{len(body)} bytes", f"{size + 8}", at)
        return body

    def sparse(self, data: bytes, whole: Tag, at: int) -> tuple[str, Any]:
        """Name and parts of a sparse matrix; of any other variable None."""
        data = data[: whole.start + whole.size]
        name, flags, sizes, start = self.head(data, whole, at)
        if flags & 0xFF != _SPARSE:
            return name, None
        parts: dict[str, NDArray[Any]] = {"shape": np.array(sizes)}
        for part in ("ir", "jc", "data", *(["imaginary"] if flags & 0x0800 else [])):
            tag = self.tag(data, start)
            self.allow(8 * tag.size, at)
            parts[part], start = self.values(data, tag, at), tag.beyond
        count = int(parts["jc"][-1]) if len(parts["jc"]) else 0
        for part in ("ir", "data"):  # room beyond the last column holds nothing
            if not 0 <= count <= len(parts[part]):
                _refuse(self.path, f"truncated: {len(parts[part])} of {count} numbers", repr(name), str(count), at)
            parts[part] = parts[part][:count]
        if "imaginary" in parts:
            parts["data"] = parts["data"] + 1j * parts.pop("imaginary")[:count]
        return name, parts

    def nested(self, data: bytes, whole: Tag, at: int, depth: int = 0) -> tuple[str, Any]:
        """Name and value of a variable or of a part of one, structs and cells with what they hold."""
        self.parts -= 1
        if depth > DEPTH or self.parts < 0:
            _refuse(self.path, "structs are nested too deep, or hold too much", f"level {depth}", f"{DEPTH} levels", at)
        if not whole.size:
            return "", None
        name, flags, sizes, beyond = self.head(data, whole, at)
        kind = flags & 0xFF
        if kind not in (_CELL, _STRUCT):
            _, value = self.matrix(data, whole, at)
            if isinstance(value, str):
                return name, None
            return name, value.item() if value.dtype.kind == "U" and value.size == 1 else value
        count, fields = math.prod(sizes), [""]
        if kind == _STRUCT:
            width_tag = self.tag(data, beyond)
            names_tag = self.tag(data, width_tag.beyond)
            widths, beyond = self.values(data, width_tag, at), names_tag.beyond
            width = int(widths[0]) if len(widths) == 1 and widths.dtype.kind in "iu" else 0
            raw = data[names_tag.start : names_tag.start + names_tag.size]
            if not 0 < width <= 64 or len(raw) % width:
                _refuse(self.path, "a struct is damaged", f"{name!r}: names of {width} bytes", "1 to 64 bytes", at)
            fields = [raw[i : i + width].split(b"\0")[0].decode("latin-1") for i in range(0, len(raw), width)]
        if count * len(fields) > self.parts:
            _refuse(self.path, "a struct holds too much", f"{name!r}: {count * len(fields)} parts", f"{PARTS}", at)
        found: list[Any] = []
        for _ in range(count):
            row: dict[str, Any] = {}
            for field in fields:
                tag = self.tag(data, beyond)
                if tag.type != _MATRIX or tag.start + tag.size > whole.start + whole.size:
                    _refuse(
                        self.path, "a struct is damaged", f"{name!r}: type {tag.type}", "an array in each field", at
                    )
                row[field], beyond = self.nested(data, tag, at, depth + 1)[1], tag.beyond
            found.append(row if kind == _STRUCT else row[""])
        return name, found[0] if kind == _STRUCT and count == 1 else found

    def head(self, data: bytes, whole: Tag, at: int) -> tuple[str, int, tuple[int, ...], int]:
        """Name, flags and sizes of an array, and where its values begin."""
        flags_tag = self.tag(data, whole.start)
        flags = self.values(data, flags_tag, at)
        sizes_tag = self.tag(data, flags_tag.beyond)
        sizes = tuple(int(n) for n in self.values(data, sizes_tag, at))
        name_tag = self.tag(data, sizes_tag.beyond)
        name = data[name_tag.start : name_tag.start + name_tag.size].decode("latin-1")
        if len(flags) != 2 or not (2 <= len(sizes) <= 32) or min(sizes) < 0:
            _refuse(
                self.path, "the header of a variable is damaged", f"{name!r}, sizes {sizes}", "two sizes or more", at
            )
        return name, int(flags[0]), sizes, name_tag.beyond

    def matrix(self, data: bytes, whole: Tag, at: int) -> tuple[str, NDArray[Any] | str]:
        """Name and numbers of an array; of what is none, the word for it."""
        data = data[: whole.start + whole.size]
        name, flags, sizes, start = self.head(data, whole, at)
        kind = flags & 0xFF
        if kind in _OTHERS:
            return name, _OTHERS[kind]
        if kind not in _CLASSES and kind != _CHAR:
            _refuse(self.path, "a variable of an unknown class", f"{name!r}: class {kind}", "an array of numbers", at)
        count = math.prod(sizes)
        self.allow(16 * count, at)
        real_tag = self.tag(data, start)
        if kind == _CHAR:
            return name, self.text(data, real_tag, sizes)
        part = self.part(data, real_tag, count, kind, name, at)
        beyond = real_tag.beyond
        if flags & 0x0800:
            imag_tag = self.tag(data, beyond)
            both = np.empty(count, np.result_type(part, np.complex64))
            both.real, both.imag = part, self.part(data, imag_tag, count, kind, name, at)
            part = both
            beyond = imag_tag.beyond
        if beyond < whole.start + whole.size:
            _refuse(self.path, "a variable holds more than it declares", f"{name!r}", f"{count} numbers", at)
        return name, part.reshape(sizes, order="F")

    def part(self, data: bytes, tag: Tag, count: int, kind: int, name: str, at: int) -> NDArray[Any]:
        """Real or imaginary part of an array, as many numbers as it declares."""
        values = self.values(data, tag, at)
        if len(values) != count:
            _refuse(self.path, f"truncated: {len(values)} of {count} numbers", f"{name!r}", f"{count} numbers", at)
        return values.astype(_CLASSES[kind])

    def values(self, data: bytes, tag: Tag, at: int) -> NDArray[Any]:
        """Numbers of a data element."""
        if tag.type not in _NUMBERS:
            _refuse(self.path, "a data element holds no numbers", f"type {tag.type}", "a numeric type", at)
        dtype = np.dtype(self.order + _NUMBERS[tag.type])
        if tag.size % dtype.itemsize:
            _refuse(self.path, "a data element is cut", f"{tag.size} bytes", f"a multiple of {dtype.itemsize}", at)
        return np.frombuffer(data, dtype, tag.size // dtype.itemsize, tag.start)

    def text(self, data: bytes, tag: Tag, sizes: tuple[int, ...]) -> NDArray[Any]:
        """One string, or one for each row of a matrix of characters; what is no text in it is replaced."""
        raw = data[tag.start : tag.start + tag.size]
        wide = "utf-16-le" if self.order == "<" else "utf-16-be"
        text = raw.decode(wide if tag.type in (4, _UTF16) else "utf-8", "replace")
        if len(sizes) == 2 and sizes[0] > 1 and len(text) == sizes[0] * sizes[1]:  # stored by columns
            return np.array([text[k :: sizes[0]].rstrip(" \0") for k in range(sizes[0])])
        return np.array(text)


def _refuse(path: str, what: str, found: object, expected: object, at: int = 0) -> NoReturn:
    raise InputError(
        what,
        where=f"{path}, byte {at}",
        found=found,
        expected=expected,
        hint="transfer the file again, or save plain arrays again (save -v7)",
    )
