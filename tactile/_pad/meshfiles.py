"""Meshes of pads from files: Abaqus and CalculiX ``.inp`` (also packed with gzip), and arrays in NPZ or HDF5."""

from __future__ import annotations

import gzip
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from structures._elements.cells import CELLS
from structures.errors import InputError
from structures.files._container import open_npz
from structures.files._hdf5 import open_hdf5

from .._arrays import Array, Index

LARGEST = 256_000_000  # bytes, unpacked
ALIASES = {"C3D8R": "C3D8", "C3D8I": "C3D8", "C3D8H": "C3D8", "C3D10M": "C3D10", "C3D10H": "C3D10", "C3D10I": "C3D10"}


@dataclass(frozen=True, eq=False)
class MeshFile:
    """What a file says: nothing turned, scaled or guessed.

    Nodes (nodes, 3) in the file's unit, with their numbers there (`names`); cells (cells, 8 or 10) of a `kind`, "C3D8"
    or "C3D10", and node sets by name in capitals, as indices from 0.
    """

    path: str
    nodes: Array
    cells: Index
    kind: str
    names: Index
    sets: dict[str, Index] = field(default_factory=dict)

    def named(self, name: str) -> Index:
        """A node set; a name that is not there is refused."""
        found = self.sets.get(str(name).upper())
        if found is None:
            raise InputError(
                "the mesh file has no such node set", where=self.path, found=repr(name),
                expected=", ".join(sorted(self.sets)) or "it has no node sets",
                hint="leave base and top out: they are found by the shape of the pad",
            )  # fmt: skip
        return found


def read(path: str | os.PathLike[str]) -> MeshFile:
    """Mesh of a file; the line of what is none of these, or holds no solid cells or several kinds of them, is named.

    ``.inp`` or ``.inp.gz`` with C3D8 or C3D10 cells; ``.npz``, ``.h5`` or ``.hdf5`` with the arrays ``nodes`` (nodes,
    3) and ``cells`` (cells, 8 or 10), indices from 0 in the order of Abaqus.
    """
    place = Path(os.fspath(path))
    if not place.is_file():
        raise InputError(
            "no such file", where=str(place), found="nothing", expected="a mesh file", hint="check the path"
        )
    suffix = "".join(place.suffixes[-2:]) if place.suffix == ".gz" else place.suffix
    if suffix.lower() in (".inp", ".inp.gz"):
        return _Inp(str(place)).read(_text(place))
    if suffix.lower() in (".npz", ".h5", ".hdf5"):
        return _arrays(place)
    raise InputError(
        "no mesh format that is read here", where=str(place), found=suffix or "no suffix",
        expected=".inp, .inp.gz, .npz, .h5, .hdf5", hint="meshio converts others to Abaqus .inp",
    )  # fmt: skip


def _text(path: Path) -> str:
    try:
        with gzip.open(path, "rb") if path.suffix.lower() == ".gz" else open(path, "rb") as file:
            data = file.read(LARGEST + 1)
    except (OSError, EOFError) as error:
        raise InputError(
            "the file cannot be read", where=str(path), found=str(error), expected="a whole file, packed or not"
        ) from None
    if len(data) > LARGEST:
        raise InputError("the file is too large", where=str(path), found="more", expected=f"at most {LARGEST} bytes")
    return data.decode("utf-8", errors="replace")


def _arrays(path: Path) -> MeshFile:
    container = open_npz(path) if path.suffix.lower() == ".npz" else open_hdf5(path)
    nodes, cells = container.array("nodes"), container.array("cells")
    if nodes is None or cells is None or cells.ndim != 2:
        raise InputError(
            "the file holds no mesh", where=str(path),
            found=f"nodes {None if nodes is None else nodes.shape}, cells {None if cells is None else cells.shape}",
            expected="arrays nodes (nodes, 3) and cells (cells, 8 or 10)", hint="np.savez(path, nodes=..., cells=...)",
        )  # fmt: skip
    kind = next((name for name, cell in CELLS.items() if cell.nodes == cells.shape[1]), "")
    if not kind or cells.dtype.kind not in "iu":
        raise InputError(
            "cells of no known kind", where=f"{path}, cells", found=f"{cells.dtype} {cells.shape}",
            expected="integers, 8 or 10 to a cell",
        )  # fmt: skip
    return MeshFile(str(path), np.asarray(nodes, float), cells.astype(np.intp), kind, np.arange(len(nodes)))


class _Inp:
    """Reader of the keywords that hold a mesh; all others are passed over."""

    def __init__(self, path: str) -> None:
        self.path = path
        self.nodes: dict[int, tuple[float, ...]] = {}
        self.cells: dict[str, dict[int, list[int]]] = {}
        self.sets: dict[str, list[int]] = {}

    def read(self, text: str) -> MeshFile:
        """The mesh; refused where there is none, or a line is none."""
        for at, keyword, options, lines in _sections(text):
            if keyword == "NODE":
                self._nodes(lines, options)
            elif keyword == "ELEMENT":
                self._elements(lines, options, at)
            elif keyword == "NSET":
                self._set(lines, options, at)
        return self._whole()

    def _nodes(self, lines: list[tuple[int, str]], options: dict[str, str]) -> None:
        for at, line in lines:
            words = [w for w in line.split(",") if w.strip()]
            number, *xyz = self._numbers(words, at)
            if len(xyz) != 3 or number != int(number):
                self._refuse("a node needs a number and three coordinates", at, line)
            if int(number) in self.nodes:
                self._refuse(f"node {int(number)} is given twice", at, line)
            self.nodes[int(number)] = tuple(xyz)
            if "NSET" in options:
                self.sets.setdefault(options["NSET"].upper(), []).append(int(number))

    def _elements(self, lines: list[tuple[int, str]], options: dict[str, str], start: int) -> None:
        kind = options.get("TYPE", "").upper()
        kind = ALIASES.get(kind, kind)
        if kind not in CELLS:
            if kind.startswith("C3D"):
                self._refuse(f"cells of kind {kind}", start, "*ELEMENT", "C3D8 or C3D10")
            return  # shells, springs, rigid surfaces of an indenter
        table, want, words = self.cells.setdefault(kind, {}), CELLS[kind].nodes + 1, []
        for at, line in lines:
            words += [
                int(v) if v == int(v) else -1 for v in self._numbers([w for w in line.split(",") if w.strip()], at)
            ]
            if len(words) < want:
                continue  # goes on in the next line
            if len(words) > want:
                self._refuse(f"a cell of kind {kind} has {want - 1} nodes", at, line, found=f"{len(words) - 1}")
            if words[0] in table:
                self._refuse(f"cell {words[0]} is given twice", at, line)
            table[words[0]], words = words[1:], []
        if words:
            self._refuse(f"a cell of kind {kind} has {want - 1} nodes", lines[-1][0], lines[-1][1], found="fewer")

    def _set(self, lines: list[tuple[int, str]], options: dict[str, str], start: int) -> None:
        name = options.get("NSET", options.get("NAME", "")).upper()
        if not name:
            self._refuse("a node set without a name", start, "*NSET")
        out = self.sets.setdefault(name, [])
        for at, line in lines:
            words = [w.strip() for w in line.split(",") if w.strip()]
            if "GENERATE" in options:
                first, last, *step = (int(v) for v in self._numbers(words, at))
                out.extend(range(first, last + 1, step[0] if step and step[0] > 0 else 1))
                continue
            for word in words:
                if word.upper() in self.sets:
                    out.extend(self.sets[word.upper()])
                else:
                    out.extend(int(v) for v in self._numbers([word], at))

    def _whole(self) -> MeshFile:
        kinds = [kind for kind, table in self.cells.items() if table]
        if not self.nodes or len(kinds) != 1:
            raise InputError(
                "the file holds no mesh of one kind of solid cells", where=self.path,
                found=f"{len(self.nodes)} nodes, cells of {', '.join(kinds) or 'no kind'}",
                expected="*NODE, and *ELEMENT, TYPE=C3D8 or C3D10", hint="write the gel alone, without the indenter",
            )  # fmt: skip
        names = np.array(sorted(self.nodes), np.intp)
        place = {int(n): i for i, n in enumerate(names)}
        table = self.cells[kinds[0]]
        for number, cell in table.items():
            missing = [n for n in cell if n not in place]
            if missing:
                self._refuse(f"cell {number} has a node that does not exist", 0, "", found=f"node {missing[0]}")
        cells = np.array([[place[n] for n in table[number]] for number in sorted(table)], np.intp)
        sets = {
            name: np.array(sorted({place[n] for n in ids if n in place}), np.intp) for name, ids in self.sets.items()
        }
        return MeshFile(self.path, np.array([self.nodes[int(n)] for n in names]), cells, kinds[0], names, sets)

    def _numbers(self, words: list[str], at: int) -> list[float]:
        try:
            found = [float(word) for word in words]
        except ValueError:
            self._refuse("a line of the mesh holds no numbers", at, ",".join(words))
        if not np.all(np.isfinite(found)):
            self._refuse("a line of the mesh holds NaN or infinity", at, ",".join(words))
        return found

    def _refuse(
        self, what: str, at: int, line: str, expected: str = "numbers with commas between", found: str = ""
    ) -> NoReturn:
        raise InputError(
            what, where=f"{self.path}, line {at}" if at else self.path, found=found or repr(line[:60]),
            expected=expected, hint="an Abaqus or CalculiX input file with *NODE and *ELEMENT",
        )  # fmt: skip


def _sections(text: str) -> Iterator[tuple[int, str, dict[str, str], list[tuple[int, str]]]]:
    """Line number, keyword, options and data lines of each section; comments (**) are passed over."""
    keyword, options, start, lines = "", {}, 0, []  # type: tuple[str, dict[str, str], int, list[tuple[int, str]]]
    for at, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        if not line or line.startswith("**"):
            continue
        if line.startswith("*"):
            yield start, keyword, options, lines
            words = [w.strip() for w in line[1:].split(",")]
            keyword, start, lines = words[0].upper(), at, []
            options = {w.split("=")[0].strip().upper(): w.partition("=")[2].strip() for w in words[1:]}
        else:
            lines.append((at, line))
    yield start, keyword, options, lines


def elastic(path: str | os.PathLike[str], name: str | None = None) -> dict[str, Any]:
    """Elastic constants of an Abaqus or CalculiX input file: ``{"name", "E", "nu", "source"}``, E in the file's unit.

    Those of the material of a name, or of the first that has any. ``*ELASTIC`` gives E and nu. ``*HYPERELASTIC, NEO
    HOOKE`` gives C10 and D1: mu = 2 C10, bulk modulus 2 / D1, and at small strain E0 = 9 K mu / (3 K + mu), which is 6
    C10 for an incompressible one (D1 = 0); nu is then None.
    """
    current, found = "", []
    for at, keyword, options, lines in _sections(_text(Path(os.fspath(path)))):
        if keyword == "MATERIAL":
            current = options.get("NAME", "")
        if keyword not in ("ELASTIC", "HYPERELASTIC") or not lines:
            continue
        values = _Inp(os.fspath(path))._numbers([w for w in lines[0][1].split(",") if w.strip()], lines[0][0])
        if keyword == "ELASTIC" and len(values) >= 2:
            found.append({"name": current, "E": values[0], "nu": values[1], "source": f"*ELASTIC, line {at}"})
        elif "NEO HOOKE" in options and values:
            mu, D1 = 2 * values[0], values[1] if len(values) > 1 else 0.0
            K = 2 / D1 if D1 > 0 else np.inf
            nu = None if D1 <= 0 else (3 * K - 2 * mu) / (2 * (3 * K + mu))
            E = 6 * values[0] if D1 <= 0 else 9 * K * mu / (3 * K + mu)
            found.append({"name": current, "E": E, "nu": nu, "source": f"neo-Hooke C10, line {at}"})
    chosen = [m for m in found if name is None or str(m["name"]).upper() == name.upper()]
    if not chosen:
        raise InputError(
            "the file holds no such elastic material",
            where=os.fspath(path),
            found=", ".join(str(m["name"]) for m in found) or "none",
            expected=name or "*ELASTIC or *HYPERELASTIC, NEO HOOKE",
        )
    return chosen[0]
