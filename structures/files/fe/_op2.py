"""Nastran OUTPUT2 files: real modes (LAMA, OUGV1), GRID points (GEOM1) and square matrices; all else is passed over.

Format: records between keys as the DMAP module OUTPUT2 is documented in MSC Nastran's *DMAP Programmer's Guide*; words
of 4 or 8 bytes, little or big endian.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ._parts import CUT, ROWS, Matrix, Parts, data_of, refuse
from ._shapes import Mode, together

GRID = (4501, 45)
MOTIONS = (1, 7)  # table codes of displacements and eigenvectors
MODES, COMPLEX = 2, 9  # analysis codes
_SHAPES = ("OUGV1", "OUG1", "BOUGV1", "BOPHIG", "OPHIG", "OUGV1PAT", "OPHSA")
_LAMA = ("LAMA", "LAMAS", "BLAMA", "LAMAF", "BLAMAF", "CLAMA")


@dataclass
class _Found:
    """What the tables of a file have told so far."""

    heads: dict[int, tuple[float, float]] = field(default_factory=dict)  # mode: Hz and modal mass
    shapes: dict[int, tuple[float, NDArray[np.int64], NDArray[np.float64]]] = field(default_factory=dict)
    grids: dict[int, tuple[float, ...]] = field(default_factory=dict)
    elsewhere: int = 0
    turned: int = 0
    matrices: dict[str, Matrix] = field(default_factory=dict)


def read(path: Path) -> Parts:
    """Modes, nodes and matrices of an OUTPUT2 file.

    Raises
    ------
    InputError
        A file that is cut or damaged, complex modes, none of these tables.
    """
    where = str(path)
    tape = _Tape(data_of(path), where)
    found = _Found()
    while tape.more():
        name, trailer = tape.block()
        if tape.kind == 0:
            records = list(tape.records())
            if name.startswith("GEOM1"):
                _grids(records, tape, found)
            elif name in _LAMA:
                _eigenvalues(records, tape, found)
            elif name in _SHAPES:
                _eigenvectors(records, tape, found)
        else:
            made = tape.matrix(name, trailer)
            if made is not None:
                found.matrices[name] = Matrix(made)
    modes = [
        Mode(*found.heads.get(k, (f, 0.0)), 0.0, labels, values) for k, (f, labels, values) in found.shapes.items()
    ]
    if not modes and not found.grids and not found.matrices:
        refuse("neither modes nor nodes nor matrices", where, "other tables", "LAMA with OUGV1, GEOM1, or matrices",
               "in Nastran: SOL 103 with PARAM,POST,-1 and DISPLACEMENT(PLOT)=ALL")  # fmt: skip
    notes = []
    if found.elsewhere:
        notes.append(f"{path.name}: {found.elsewhere} GRID points stand in a coordinate system of their own: no places")
    if found.turned:
        notes.append(f"{path.name}: {found.turned} GRID points have directions of their own (CD): labels follow these")
    nodes, unplaced = ([], sorted(found.grids)) if found.elsewhere else (sorted(found.grids), [])
    return Parts(
        matrices=found.matrices, nodes=np.array(nodes, np.int64), unplaced=np.array(unplaced, np.int64),
        notes=tuple(notes),
        places=np.array([found.grids[n] for n in nodes], float).reshape(-1, 3),
        modes=together(modes, where) if modes else None,
    )  # fmt: skip


class _Tape:
    """Keys and records of a file, one after the other."""

    def __init__(self, data: bytes, where: str) -> None:
        self.data, self.where, self.at, self.kind = data, where, 0, 0
        sizes = {n.to_bytes(4, order): (order, n) for n in (4, 8) for order in ("little", "big")}
        if data[:4] not in sizes:
            refuse("no OUTPUT2 file", where, repr(data[:8]), "a record of 4 or 8 bytes first",
                   "export it with PARAM,POST,-1")  # fmt: skip
        order, self.word = sizes[data[:4]]
        self.sign = "<" if order == "little" else ">"
        if self._key() == 3:  # the label of the tape
            for _ in range(3):
                self._record()
                if (key := self._key()) < 0:
                    break
            if key != -1:
                refuse(CUT, where, f"key {key}", "the end of the label of the tape")
            self._expect(0)
        else:
            self.at = 0

    def _record(self) -> bytes:
        at = self.at
        if at + 8 > len(self.data):
            refuse(CUT, self.where, f"{len(self.data)} bytes", "another record")
        size = int(np.frombuffer(self.data, f"{self.sign}i4", 1, at)[0])
        end = at + 4 + size
        if size < 0 or end + 4 > len(self.data) or self.data[end : end + 4] != self.data[at : at + 4]:
            refuse(CUT, self.where, f"a record of {size} bytes at byte {at} of {len(self.data)}", "whole records")
        self.at = end + 4
        return self.data[at + 4 : end]

    def _key(self) -> int:
        body = self._record()
        if len(body) != self.word:
            refuse(CUT, self.where, f"{len(body)} bytes before byte {self.at}", f"a key of {self.word} bytes")
        return int(np.frombuffer(body, f"{self.sign}i{self.word}")[0])

    def _expect(self, *keys: int) -> None:
        for key in keys:
            found = self._key()
            if found != key:
                refuse(CUT, f"{self.where}, byte {self.at}", f"key {found}", f"key {key}")

    def more(self) -> bool:
        """Whether another block begins: the file ends with a key 0, or there."""
        if self.at >= len(self.data):
            refuse(CUT, self.where, "no end mark", "a key 0 at the end")
        begin = self.at
        if self._key() == 0:
            if self.at < len(self.data):
                return self.more()
            return False
        self.at = begin
        return True

    def block(self) -> tuple[str, list[int]]:
        """Name and trailer of the block that begins here; `kind` says whether it is a table (0) or a matrix (1)."""
        self._expect(2)
        name = self._letters(self._record())
        self._expect(-1, 7)
        trailer = np.frombuffer(self._sized(7), f"{self.sign}i{self.word}").tolist()
        self._expect(-2, 1, 0)
        self._key()
        self._record()
        self._expect(-3, 1)
        self.kind = self._key()
        if self.kind not in (0, 1):
            refuse(CUT, f"{self.where}, byte {self.at}", f"a block of kind {self.kind}", "a table (0) or a matrix (1)")
        return name, trailer

    def _letters(self, body: bytes) -> str:
        if self.word == 8:  # eight bytes hold four letters
            body = b"".join(body[k : k + 4] for k in range(0, len(body), 8))
        return body.decode("latin-1").strip()

    def _sized(self, words: int) -> bytes:
        body = self._record()
        if len(body) != words * self.word:
            refuse(CUT, f"{self.where}, byte {self.at}", f"{len(body)} bytes", f"{words} words")
        return body

    def records(self) -> Iterator[bytes]:
        """Records of a table, each joined from its parts."""
        key, number = self._key(), -4
        while key > 0:
            parts = []
            while key > 0:
                parts.append(self._sized(key))
                key = self._key()
            if key != number:
                refuse(CUT, f"{self.where}, byte {self.at}", f"key {key}", f"key {number}, the end of a record")
            self._expect(1, 0)
            yield b"".join(parts)
            key, number = self._key(), number - 1
        if key != 0:
            refuse(CUT, f"{self.where}, byte {self.at}", f"key {key}", "the end of a table")

    def matrix(self, name: str, trailer: list[int]) -> sparse.csr_array | None:
        """Matrix of a block; None where it is complex or not square."""
        columns, rows, kind = trailer[1], trailer[2], trailer[4]
        if not (0 < columns <= ROWS and 0 < rows <= ROWS and 1 <= kind <= 4):
            refuse(CUT, f"{self.where}, {name}", f"{columns} x {rows}, type {kind}", "sizes, and a type from 1 to 4")
        real = np.dtype(f"{self.sign}f{4 if kind in (1, 3) and self.word == 4 else 8}")
        i, j, x = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
        column, number, going = 0, -4, 1
        while going:
            key = self._key()
            while key > 0:
                body = self._sized(key)
                first = int(np.frombuffer(body[: self.word], f"{self.sign}i{self.word}")[0])
                if (len(body) - self.word) % real.itemsize:
                    refuse(CUT, f"{self.where}, {name}", f"{len(body)} bytes", "whole numbers of a column")
                values = np.frombuffer(body[self.word :], real).astype(float)
                if kind > 2:
                    values = values[::2]
                if first < 1 or first + len(values) - 1 > rows or column >= columns:
                    refuse(CUT, f"{self.where}, {name}", f"{len(values)} terms from row {first} of column {column + 1}",
                           f"within {rows} x {columns}")  # fmt: skip
                i.append(np.arange(first - 1, first - 1 + len(values)))
                j.append(np.full(len(values), column))
                x.append(values)
                key = self._key()
            if key != number:
                refuse(CUT, f"{self.where}, {name}", f"key {key}", f"key {number}, the end of a column")
            self._expect(1)
            going = self._key()
            column, number = column + 1, number - 1
        if self._key() != 0:
            refuse(CUT, f"{self.where}, {name}", "another key", "the end of a matrix")
        if rows != columns or kind > 2:
            return None
        entries = (np.concatenate(x), (np.concatenate(i), np.concatenate(j)))
        return sparse.coo_array(entries, shape=(rows, columns)).tocsr()


# -- tables ------------------------------------------------------------------------------------------------------------
def _words(body: bytes, tape: _Tape) -> tuple[NDArray[Any], NDArray[Any]]:
    whole = body[: len(body) // tape.word * tape.word]
    return np.frombuffer(whole, f"{tape.sign}i{tape.word}"), np.frombuffer(whole, f"{tape.sign}f{tape.word}")


def _grids(records: list[bytes], tape: _Tape, found: _Found) -> None:
    for body in records:
        ints, reals = _words(body, tape)
        if len(ints) < 3 or tuple(ints[:2]) != GRID:
            continue
        if (len(ints) - 3) % 8:
            refuse(CUT, f"{tape.where}, GEOM1", f"{len(ints) - 3} words of GRID points", "eight for each")
        for k in range(3, len(ints), 8):
            found.elsewhere += int(ints[k + 1]) != 0
            found.turned += int(ints[k + 5]) > 0
            found.grids[int(ints[k])] = tuple(reals[k + 2 : k + 5].tolist())


def _eigenvalues(records: list[bytes], tape: _Tape, found: _Found) -> None:
    for body in records[1::2]:
        ints, reals = _words(body, tape)
        if len(ints) % 7:
            refuse(CUT, f"{tape.where}, LAMA", f"{len(ints)} words", "seven for each mode")
        for k in range(0, len(ints), 7):
            found.heads[int(ints[k])] = (float(reals[k + 4]), float(reals[k + 5]))


def _eigenvectors(records: list[bytes], tape: _Tape, found: _Found) -> None:
    for head, body in zip(records[::2], records[1::2], strict=False):
        ints, reals = _words(head, tape)
        if len(ints) < 12:
            refuse(CUT, f"{tape.where}, eigenvectors", f"{len(ints)} words", "146 words in front of a mode")
        if int(ints[1]) % 1000 not in MOTIONS or int(ints[0]) // 10 not in (MODES, COMPLEX):
            continue  # results of another analysis
        if int(ints[9]) != 8 or int(ints[0]) // 10 == COMPLEX:
            refuse("complex modes", tape.where, f"{int(ints[9])} words for each node", "8: real modes (SOL 103)")
        mode = int(ints[4])
        entries, values = (a.reshape(-1, 8) for a in _eights(*_words(body, tape), tape.where))
        node, scalar = entries[:, 0] // 10, entries[:, 1] == 2
        code = np.tile(np.arange(1, 7), (len(node), 1))
        kept = np.ones(code.shape, bool)
        code[scalar], kept[scalar, 1:] = 0, False
        labels = np.column_stack([np.repeat(node, 6), code.ravel()])[kept.ravel()]
        f = float(np.sqrt(max(reals[5], 0.0)) / (2 * np.pi))
        found.shapes[mode] = (f, labels.astype(np.int64), values[:, 2:].ravel()[kept.ravel()].astype(float))


def _eights(ints: NDArray[Any], reals: NDArray[Any], where: str) -> tuple[NDArray[Any], NDArray[Any]]:
    if len(ints) % 8 or not len(ints):
        refuse(CUT, f"{where}, eigenvectors", f"{len(ints)} words", "eight for each node")
    return ints, reals
