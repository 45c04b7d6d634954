"""Nastran bulk data, punched or written by hand: matrices on DMIG cards, and the places of GRID points.

Fields of 8 and 16 characters and free fields are read as MSC Nastran's *Quick Reference Guide* describes them; other
cards are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ._parts import CUT, Matrix, Parts, labelled, refuse, text_of

_REAL = re.compile(r"([+-]?(?:\d+\.?\d*|\.\d+))(?:[EDed]?([+-]?\d+))?")
Card = tuple[str, list[str], int]
SUPPORTS = ("SPC", "SPC1")
READ = ("DMIG", "GRID", *SUPPORTS)


def read(path: Path) -> Parts:
    """Matrices and nodes of bulk data.

    Raises
    ------
    InputError
        A card that is damaged: its line is named; neither a DMIG card nor a GRID point.
    """
    where = str(path)
    matrices: dict[str, _Entries] = {}
    grids: dict[int, tuple[float, ...]] = {}
    elsewhere, turned, single = 0, 0, 0
    for name, fields, line in _cards(text_of(path), where):
        at = f"{where}, line {line}"
        if name == "DMIG":
            _dmig(fields, matrices, at)
        elif name in SUPPORTS:
            single += 1
        else:
            node = _whole(fields[0], at)
            places = tuple(_real(_field(fields, k), at) for k in (2, 3, 4))
            if node in grids:
                refuse("a GRID point twice", at, node, "each once", "leave one out")
            elsewhere += _field(fields, 1) not in ("", "0")
            turned += _field(fields, 5) not in ("", "0")
            single += _field(fields, 6) not in ("", "0")
            grids[node] = places
    found = {name: m.matrix(name, where) for name, m in matrices.items() if m.square}
    if not found and not grids:
        refuse("neither DMIG cards nor GRID points", where, "other cards", "a punch file of matrices, or bulk data",
               "in Nastran: PARAM,EXTOUT,DMIGPCH or EXTSEOUT(DMIGPCH) punches K and M")  # fmt: skip
    notes = [f"{path.name}: {m} is rectangular, and is passed over" for m, e in matrices.items() if not e.square]
    if elsewhere:
        notes.append(f"{path.name}: {elsewhere} GRID points stand in a coordinate system of their own: no places read")
    if single:
        notes.append(f"{path.name}: {single} supports (SPC, SPC1, PS of a GRID) are not applied: name those that K of "
                     "the g-set needs as supports")  # fmt: skip
    if turned:
        notes.append(f"{path.name}: {turned} GRID points have directions of their own (CD): labels follow these")
    nodes, unplaced = ([], sorted(grids)) if elsewhere else (sorted(grids), [])
    return Parts(
        matrices=found, nodes=np.array(nodes, np.int64), unplaced=np.array(unplaced, np.int64), notes=tuple(notes),
        places=np.array([grids[n] for n in nodes], float).reshape(-1, 3),
    )  # fmt: skip


@dataclass
class _Entries:
    """Entries of one DMIG matrix as they come."""

    form: int
    kind: int
    rows: list[tuple[int, int]] = field(default_factory=list)
    columns: list[tuple[int, int]] = field(default_factory=list)
    values: list[float] = field(default_factory=list)

    @property
    def square(self) -> bool:
        return self.form in (1, 6)

    def matrix(self, name: str, where: str) -> Matrix:
        if not self.values:
            refuse(CUT, f"{where}, DMIG {name}", "no entry", "its columns")
        i, j = np.array(self.rows, np.int64), np.array(self.columns, np.int64)
        x = np.array(self.values)
        made = labelled(i, j, x)
        both = len(np.unique(np.column_stack([i, j]), axis=0)) < len(x)
        if both:
            refuse("an entry of a DMIG matrix twice", f"{where}, DMIG {name}", f"{len(x)} entries", "each once")
        return made


def _dmig(fields: list[str], matrices: dict[str, _Entries], at: str) -> None:
    name = _field(fields, 0)
    if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,7}", name):
        refuse(CUT, at, repr(name), "the name of a DMIG matrix")
    if _field(fields, 1) == "0" and name not in matrices:
        form, kind = _whole(_field(fields, 2), at), _whole(_field(fields, 3), at)
        if form not in (1, 2, 6, 9) or kind not in (1, 2, 3, 4):
            refuse("no header of a DMIG matrix", at, f"form {form}, type {kind}", "form 1, 2, 6 or 9, type 1 to 4")
        if kind > 2 and form in (1, 6):
            refuse("a complex matrix", f"{at}, {name}", "complex entries", "real K, M and C",
                   "give structural damping as damping=Structural(eta)")  # fmt: skip
        matrices[name] = _Entries(form, kind)
        return
    if name not in matrices:
        refuse(CUT, at, f"a column of {name} before its header", f"DMIG, {name}, 0, form, type first")
    entries = matrices[name]
    if not entries.square:
        return
    column = (_whole(_field(fields, 1), at), _component(_field(fields, 2), at))
    rest = fields[4:]
    while rest and not any(rest[-1:]):
        rest = rest[:-1]
    for k in range(0, len(rest), 4):
        entries.rows.append((_whole(_field(rest, k), at), _component(_field(rest, k + 1), at)))
        entries.columns.append(column)
        entries.values.append(_real(_field(rest, k + 2), at, blank=False))


def _field(fields: list[str], k: int) -> str:
    return fields[k] if k < len(fields) else ""


def _whole(text: str, at: str) -> int:
    if not re.fullmatch(r"\d{1,12}", text):
        refuse(CUT, at, repr(text), "a whole number")
    return int(text)


def _component(text: str, at: str) -> int:
    code = 0 if text == "" else _whole(text, at)
    if code > 6:
        refuse("no component of a node", at, text, "0 to 6")
    return code


def _real(text: str, at: str, blank: bool = True) -> float:
    """A number as Nastran writes it: ``1.5``, ``1.5D+3``, ``1.5+3``."""
    if text == "" and blank:
        return 0.0
    match = _REAL.fullmatch(text)
    if match is None:
        refuse(CUT, at, repr(text), "a number")
    value = float(f"{match[1]}e{match[2] or 0}")
    if not np.isfinite(value):
        refuse(CUT, at, repr(text), "a finite number")
    return value


def _cards(text: str, where: str) -> Iterator[Card]:
    """The cards that are read: name, fields without it, and the line where they begin."""
    name, fields, start = "", [""], 0
    for number, raw in enumerate(text.splitlines(), 1):
        line = raw.split("$", 1)[0].rstrip().upper()
        if not line:
            continue
        words = _fields(line, where, number)
        head = words[0].rstrip("*")
        if head and head[0] not in "+":
            if name:
                yield name, fields, start
            name, fields, start = (head, [], number) if head in READ else ("", [], number)
            if head == "ENDDATA":
                return
        if name:
            fields += words[1:]
    if name:
        yield name, fields, start


def _fields(line: str, where: str, number: int) -> list[str]:
    """First field of a line, and its data: four of 16 characters, or eight of 8."""
    if "," in line:
        words = [word.strip() for word in line.split(",")]
        size = 4 if words[0].endswith("*") or words[0] == "*" else 8
        if len(words) > size + 2:
            refuse(CUT, f"{where}, line {number}", f"{len(words)} fields", f"at most {size + 2}")
        return [*words, *[""] * size][: size + 1]
    if "\t" in line:
        line = line.expandtabs(8)
    first = line[:8].strip()
    width, size = (16, 4) if first.endswith("*") else (8, 8)
    return [first, *(line[8 + width * k : 8 + width * (k + 1)].strip() for k in range(size))]
