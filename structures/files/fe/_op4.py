"""Nastran OUTPUT4 files: dense and sparse matrices, as text and binary, of 4- and 8-byte words and either byte order.

Format: record after record as the DMAP module OUTPUT4 is documented in MSC Nastran's *DMAP Programmer's Guide*.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ._parts import CUT, ROWS, Matrix, Parts, data_of, refuse, text_of

Piece = tuple[int, int, NDArray[Any]]  # column and first row, from 0, and the terms below


@dataclass(frozen=True)
class _Head:
    columns: int
    rows: int
    big: bool
    kind: int
    name: str

    @classmethod
    def of(cls, numbers: list[int], name: str, where: str) -> _Head:
        columns, rows, _, kind = numbers
        if not (0 < columns <= ROWS and 0 < abs(rows) <= ROWS and 1 <= kind <= 4) or not name.isascii():
            refuse("no header of an OUTPUT4 matrix", where, f"{columns} x {rows}, type {kind}, {name!r}",
                   "columns, rows, form, type (1 to 4) and a name")  # fmt: skip
        return cls(columns, abs(rows), rows < 0, kind, name)

    @property
    def complex(self) -> bool:
        return self.kind > 2

    @property
    def per_term(self) -> int:
        """Numbers of a term."""
        return 2 if self.complex else 1

    @property
    def words_of_number(self) -> int:
        """Words of four bytes that strings of a text count for a number, by its precision."""
        return 2 if self.kind in (2, 4) else 1


def read(path: Path) -> Parts:
    """Matrices of an OUTPUT4 file.

    Raises
    ------
    InputError
        A file that is damaged, cut or of another kind; complex or rectangular matrices are passed over and said.
    """
    data = data_of(path)
    binary = data[:4] in _MARKS
    found = _binary(data, str(path)) if binary else _text(text_of(path), str(path))
    matrices: dict[str, Matrix] = {}
    notes = []
    for head, pieces in found:
        if head.complex or head.rows != head.columns:
            list(pieces)
            notes.append(f"{path.name}: {head.name} is {head.rows} x {head.columns}"
                         f"{', complex' * head.complex}, and is passed over")  # fmt: skip
            continue
        if head.name in matrices:
            refuse(f"two matrices of the name {head.name}", str(path), head.name, "one of each")
        matrices[head.name] = Matrix(_assembled(head, pieces))
    return Parts(matrices=matrices, notes=tuple(notes))


def _assembled(head: _Head, pieces: Iterator[Piece]) -> sparse.csr_array:
    i, j, x = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
    for column, row, values in pieces:
        i.append(np.arange(row, row + len(values)))
        j.append(np.full(len(values), column))
        x.append(values)
    entries = np.concatenate(x)
    made = sparse.coo_array((entries, (np.concatenate(i), np.concatenate(j))), shape=(head.rows, head.columns)).tocsr()
    made.eliminate_zeros()
    return made


def _checked(head: _Head, column: int, row: int, count: int, where: str) -> None:
    if not (1 <= column <= head.columns and row >= 1 and count >= 0 and row + count - 1 <= head.rows):
        refuse(CUT, where, f"{head.name}: {count} terms from row {row} of column {column}",
               f"within {head.rows} x {head.columns}")  # fmt: skip


# -- binary ------------------------------------------------------------------------------------------------------------
_MARKS = {(n).to_bytes(4, order): (order, n // 6) for n in (24, 48) for order in ("little", "big")}


def _binary(data: bytes, where: str) -> Iterator[tuple[_Head, Iterator[Piece]]]:
    order, word = _MARKS[data[:4]]
    sign = "<" if order == "little" else ">"
    at = 0
    while at < len(data):
        record, at = _record(data, at, sign, where)
        if len(record) != 6 * word:
            refuse(CUT, where, f"a record of {len(record)} bytes", f"the {6 * word} bytes of a header")
        numbers = np.frombuffer(record[: 4 * word], f"{sign}i{word}").tolist()
        head = _Head.of(numbers, record[4 * word :].decode("latin-1").strip(), where)
        pieces, at = _columns(data, at, sign, word, head, where)
        yield head, iter(pieces)


def _record(data: bytes, at: int, sign: str, where: str) -> tuple[bytes, int]:
    """The record that begins at a byte, and where the next does."""
    if at + 8 > len(data):
        refuse(CUT, where, f"{len(data)} bytes", "another record")
    size = int(np.frombuffer(data, f"{sign}i4", 1, at)[0])
    end = at + 4 + size
    if size < 0 or end + 4 > len(data) or int(np.frombuffer(data, f"{sign}i4", 1, end)[0]) != size:
        refuse(CUT, where, f"a record of {size} bytes at byte {at} of {len(data)}", "whole records")
    return data[at + 4 : end], end + 4


def _columns(data: bytes, at: int, sign: str, word: int, head: _Head, where: str) -> tuple[list[Piece], int]:
    out: list[Piece] = []
    single = head.kind in (1, 3) and word == 4
    real = np.dtype(f"{sign}f{4 if single else 8}")
    per = real.itemsize * head.per_term // word
    while True:
        record, at = _record(data, at, sign, where)
        if len(record) < 3 * word:
            refuse(CUT, where, f"a record of {len(record)} bytes", "a column")
        column, row, words = np.frombuffer(record[: 3 * word], f"{sign}i{word}").tolist()
        if column == head.columns + 1:
            return out, at
        body = record[3 * word :]
        if words * word != len(body):
            refuse(CUT, where, f"{head.name}: column {column} of {words} words in {len(body)} bytes", "all its words")
        if row > 0:
            _checked(head, column, row, words // per, where)
            out.append((column - 1, row - 1, _terms(body, real, head)))
            continue
        ints = np.frombuffer(body, f"{sign}i{word}")
        k = 0
        while k < words:
            size, first, k = _string(ints, k, head.big, where)
            _checked(head, column, first, size // per, where)
            out.append((column - 1, first - 1, _terms(body[k * word : (k + size) * word], real, head)))
            k += size


def _string(ints: NDArray[Any], k: int, big: bool, where: str) -> tuple[int, int, int]:
    """Words and first row of a string of terms, and where its terms begin."""
    if big:
        if k + 2 > len(ints):
            refuse(CUT, where, "a string without its row", "its length and its row")
        size, first, k = int(ints[k]) - 1, int(ints[k + 1]), k + 2
    else:
        size, first, k = (int(ints[k]) >> 16) - 1, int(ints[k]) & 0xFFFF, k + 1
    if size < 1 or k + size > len(ints):
        refuse(CUT, where, f"a string of {size} words", f"1 to {len(ints) - k} words")
    return size, first, k


def _terms(body: bytes, real: np.dtype[Any], head: _Head) -> NDArray[Any]:
    values = np.frombuffer(body[: len(body) // real.itemsize * real.itemsize], real).astype(float)
    return values[::2] + 1j * values[1::2] if head.complex else values


# -- text --------------------------------------------------------------------------------------------------------------
_FORM = re.compile(r"(\d+)[EDFG](\d+)\.\d+")


class _Lines:
    """Lines of a text, one after the other."""

    def __init__(self, text: str, where: str) -> None:
        self.lines, self.at, self.where = text.splitlines(), 0, where

    def __bool__(self) -> bool:
        return any(line.strip() for line in self.lines[self.at : self.at + 1])

    def next(self) -> str:
        if self.at >= len(self.lines):
            refuse(CUT, self.where, f"{len(self.lines)} lines", "more lines")
        self.at += 1
        return self.lines[self.at - 1]

    def ints(self, count: int) -> list[int]:
        line = self.next()
        words = [line[k : k + 8].strip() for k in range(0, 8 * count, 8)]
        if not all(re.fullmatch(r"-?\d+", word) for word in words) or (count < 4 and line[8 * count :].strip()):
            words = line.split()  # wider numbers
        if len(words) < count or not all(re.fullmatch(r"-?\d{1,18}", word) for word in words[:count]):
            refuse(CUT, f"{self.where}, line {self.at}", repr(line[:40]), f"{count} whole numbers")
        return [int(word) for word in words[:count]]

    def numbers(self, count: int, width: int, each: int) -> NDArray[np.float64]:
        """Numbers in columns of a width."""
        out: list[float] = []
        while len(out) < count:
            line = self.next()
            words = [line[k : k + width] for k in range(0, min(each, count - len(out)) * width, width)]
            try:
                out += [float(w.replace("D", "E")) for w in words]
            except ValueError:
                refuse(CUT, f"{self.where}, line {self.at}", repr(line[:60]), f"numbers of {width} characters")
        return np.array(out)


def _text(text: str, where: str) -> Iterator[tuple[_Head, Iterator[Piece]]]:
    lines = _Lines(text, where)
    while lines:
        line = lines.lines[lines.at]
        form = _FORM.search(line[32:])
        if form is None:
            refuse("no OUTPUT4 file", f"{where}, line {lines.at + 1}", repr(line[:60]),
                   "columns, rows, form, type, name and a format such as 1P,3E23.16")  # fmt: skip
        head = _Head.of(lines.ints(4), line[32:40].strip(), where)
        yield head, iter(_text_columns(lines, head, int(form[2]), int(form[1])))


def _text_columns(lines: _Lines, head: _Head, width: int, each: int) -> list[Piece]:
    out: list[Piece] = []
    if not 2 < width < 60 or not 0 < each < 40:
        refuse("no OUTPUT4 file", lines.where, f"numbers of {width} characters", "a format such as 1P,3E23.16")
    while True:
        column, row, words = lines.ints(3)
        if column == head.columns + 1:
            lines.numbers(max(words, 1), width, each)
            return out
        if row > 0:
            _checked(head, column, row, words // head.per_term, lines.where)
            out.append((column - 1, row - 1, _paired(lines.numbers(words, width, each), head)))
            continue
        while words > 0:
            if head.big:
                size, first = lines.ints(2)
                size, words = size - 1, words - 2
            else:
                (both,) = lines.ints(1)
                size, first, words = (both >> 16) - 1, both & 0xFFFF, words - 1
            if size < 1 or size > words:
                refuse(CUT, f"{lines.where}, line {lines.at}", f"a string of {size} words", f"1 to {words}")
            count = size // head.words_of_number
            _checked(head, column, first, count // head.per_term, lines.where)
            out.append((column - 1, first - 1, _paired(lines.numbers(count, width, each), head)))
            words -= size


def _paired(values: NDArray[np.float64], head: _Head) -> NDArray[Any]:
    return values[::2] + 1j * values[1::2] if head.complex else values
