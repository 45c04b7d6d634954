"""Matrices as text: the plain DOF table (``node, direction[, x, y, z]``) and Matrix Market files, read strictly.

Format: R. F. Boisvert, R. Pozo, K. A. Remington, *The Matrix Market Exchange Formats: Initial Design*, NISTIR 5935
(1996).
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Dof
from ..errors import InputError, finite
from ._container import BUDGET, FAILED, ROWS

LONGEST = 500  # characters of a line


def read_table(path: Path) -> tuple[list[Dof], NDArray[np.float64] | None]:
    """DOFs in the order of the lines, and the coordinates of the nodes, ascending, where the table has them.

    Raises
    ------
    InputError
        If a line is none, or the coordinates of a node differ from line to line; it names the line.
    """
    try:
        text = path.read_text("utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(
            "the file cannot be read",
            where=str(path),
            found=error.strerror or error,
            expected="a text file",
            hint="check the path",
        ) from None
    dofs: list[Dof] = []
    places: dict[int, tuple[float, ...]] = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = _words(line)
        if not words:
            continue
        where = f"{path}, line {number}"
        if not dofs and not words[0][:1].isdigit():
            continue  # names of the columns
        dof, rest = _dof(words, where, line)
        dofs.append(dof)
        if rest and (at := _numbers(rest, where, line)) != places.setdefault(dof.node, at):
            _refuse("two places for one node", where, f"{at}", f"{places[dof.node]}, as above")
    if not dofs:
        _refuse("the DOF table is empty", str(path), "no line that begins with a node number", "node, direction")
    return dofs, _coordinates(dofs, places, str(path))


def _words(line: str) -> list[str]:
    bare = re.split(r"[#%!]", line[: LONGEST + 1], maxsplit=1)[0].strip()
    if len(line) > LONGEST or not bare:
        return ["?" * 10] if len(line) > LONGEST else []
    for mark in (";", ",", "\t"):
        if mark in bare:
            return [word.strip().strip("\"'") for word in bare.split(mark) if word.strip()]
    return [word.strip("\"'") for word in bare.split()]


def _dof(words: Sequence[str], where: str, line: str) -> tuple[Dof, Sequence[str]]:
    """The DOF that a line begins with, and what follows it."""
    try:
        if not words[0].isdigit():
            return Dof.parse(words[0]), words[1:]
        code: int | str = int(words[1]) if re.fullmatch(r"[+-]?\d", words[1]) else words[1].upper()
        return Dof(int(words[0]), code_of(code)), words[2:]
    except (InputError, IndexError):
        _refuse(
            "no line of a DOF table", where, repr(line[:60]), "node, direction[, x, y, z], such as 12, +Z, 0.1, 0.2"
        )


def code_of(code: int | str) -> Any:
    """Direction of ``UZ``, ``ROTX`` and ``DX`` too, as solvers write them."""
    if isinstance(code, str):
        match = re.fullmatch(r"([+-]?)(?:U|D|ROT)?(R?[XYZ]|XY|S)([+-]?)", code)
        if match and len(match[1] + match[3]) <= 1:
            turning = "ROT" in code and not match[2].startswith("R")
            return (match[1] or match[3] or "+") + ("R" if turning else "") + match[2]
    return code


def _numbers(words: Sequence[str], where: str, line: str) -> tuple[float, ...]:
    try:
        values = tuple(float(word) for word in words)
    except ValueError:
        values = ()
    if not 1 <= len(values) <= 3 or not np.all(np.isfinite(values)):
        _refuse("no coordinates", where, repr(line[:60]), "one to three finite numbers after the direction")
    return values


def _coordinates(dofs: Sequence[Dof], places: dict[int, tuple[float, ...]], where: str) -> NDArray[np.float64] | None:
    if not places:
        return None
    nodes = sorted({dof.node for dof in dofs})
    without = [node for node in nodes if node not in places]
    if without or len({len(p) for p in places.values()}) > 1:
        _refuse(
            "some nodes have coordinates and others have not, or fewer",
            where,
            f"{len(without)} nodes without: {without[:6]}" if without else "one to three numbers, differing",
            "the same number of coordinates for every node, on one of its lines at least",
        )
    return np.array([places[node] for node in nodes])


def from_arrays(
    dofs: NDArray[Any] | None, nodes: NDArray[Any] | None, directions: NDArray[Any] | None, where: str
) -> list[Dof] | None:
    """DOF table of a container: labels, or two columns (node, code), or two arrays.

    Raises
    ------
    InputError
        If an entry is no DOF; it names the row.
    """
    if dofs is None and nodes is not None and directions is not None:
        nodes, directions = np.ravel(nodes), np.ravel(directions)
        if len(nodes) != len(directions):
            _refuse("nodes and directions differ in length", where, f"{len(nodes)} and {len(directions)}", "one each")
        rows: list[Any] = list(zip(nodes.tolist(), directions.tolist(), strict=True))
    elif dofs is None:
        return None
    elif dofs.ndim == 2 and dofs.shape[1] == 2:
        rows = [tuple(row) for row in dofs.tolist()]
    else:
        rows = np.ravel(dofs).tolist()
    out = []
    for k, row in enumerate(rows):
        try:
            out.append(_entry(row))
        except (InputError, ValueError, TypeError, OverflowError):
            _refuse(
                "no DOF",
                f"{where}, row {k}",
                repr(row)[:60],
                "a label such as '12+Z', or a node and a code from -6 to 6",
            )
    return out


def _entry(row: Any) -> Dof:
    if isinstance(row, tuple):
        node, code = (_text(x) for x in row)
        if isinstance(code, str) and not re.fullmatch(r"[+-]?\d", code):
            return Dof(_whole(node), code_of(code.upper()))
        return Dof(_whole(node), _whole(code))
    return Dof.parse(_text(row))


def _text(value: Any) -> Any:
    return value.decode("ascii", "replace") if isinstance(value, bytes) else value


def _whole(value: Any) -> int:
    if float(value) != int(value):
        raise ValueError(value)
    return int(value)


def _refuse(what: str, where: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where=where,
        found=found,
        expected=expected,
        hint="one line per row of K, supported DOFs included, in the order of the rows",
    )


BANNER = "%%matrixmarket"


def read_market(path: Path) -> Any:
    """Square real matrix: sparse from ``coordinate``, dense from ``array``.

    Raises
    ------
    InputError
        If the banner, the sizes or an entry is wrong, or a symmetric file holds both triangles.
    """
    where = str(path)
    try:
        text = path.read_bytes().decode("ascii", "replace")
    except OSError as error:
        _refuse_matrix("the file cannot be read", where, str(error.strerror), "a file that may be read")
    form, symmetry = _banner(text.split("\n", 1)[0], where)
    body = text.split("\n", 1)[1] if "\n" in text else ""
    line, rest, number = _sizes(body)
    sizes = [int(word) if word.isdigit() else -1 for word in line.split()]
    if len(sizes) != (3 if form == "coordinate" else 2) or min(sizes) < 0 or not 0 < sizes[0] == sizes[1] <= ROWS:
        _refuse_matrix(
            "no size of a square matrix",
            f"{where}, line {number}",
            repr(line[:60]),
            "rows columns entries, rows = columns" if form == "coordinate" else "rows columns, equal",
        )
    n = sizes[0]
    if form == "array":
        return _dense(rest, n, symmetry, where)
    values = _table(rest, 3, where)
    if len(values) != sizes[2]:
        _refuse_matrix(
            "the file is cut, or its size line is wrong", where, f"{len(values)} entries", f"{sizes[2]} entries"
        )
    row, column = values[:, 0], values[:, 1]
    bad = np.flatnonzero((row != np.rint(row)) | (column != np.rint(column)) | (np.minimum(row, column) < 1))
    bad = bad if bad.size else np.flatnonzero(np.maximum(row, column) > n)
    if bad.size:
        k = int(bad[0])
        _refuse_matrix(
            "an entry lies outside the matrix",
            f"{where}, entry {k + 1}",
            f"({row[k]:g}, {column[k]:g})",
            f"1 to {n}",
        )
    i, j, x = row.astype(np.int64) - 1, column.astype(np.int64) - 1, values[:, 2]
    if symmetry == "symmetric":
        if np.any(i < j) and np.any(i > j):
            _refuse_matrix(
                "a symmetric file holds one triangle, and this one holds both",
                where,
                f"{int(np.sum(i < j))} entries above the diagonal, {int(np.sum(i > j))} below",
                "the lower triangle alone, or 'general' in the first line",
            )
        off = i != j
        i, j, x = np.concatenate([i, j[off]]), np.concatenate([j, i[off]]), np.concatenate([x, x[off]])
    return sparse.coo_array((x, (i, j)), shape=(n, n)).tocsr()


def _banner(line: str, where: str) -> tuple[str, str]:
    words = line.lower().split()
    if len(words) != 5 or words[0] != BANNER or words[1] != "matrix":
        _refuse_matrix(
            "no Matrix Market file",
            f"{where}, line 1",
            repr(line[:60]),
            "%%MatrixMarket matrix coordinate real symmetric",
        )
    form, field, symmetry = words[2:]
    if (
        form not in ("coordinate", "array")
        or field not in ("real", "double", "integer")
        or symmetry
        not in (
            "general",
            "symmetric",
        )
    ):
        _refuse_matrix(
            "a Matrix Market file of another kind",
            f"{where}, line 1",
            f"{form} {field} {symmetry}",
            "coordinate or array, real or integer, general or symmetric",
        )
    return form, symmetry


def _sizes(body: str) -> tuple[str, str, int]:
    """Size line, what follows it, and its number."""
    number = 1
    while body:
        line, _, body = body.partition("\n")
        number += 1
        if line.strip() and not line.lstrip().startswith("%"):
            return line.strip(), body, number
    return "", "", number


def _table(text: str, columns: int, where: str) -> NDArray[np.float64]:
    """Numbers of the body, (entries, columns); Fortran's D exponents are read too."""
    if not text.strip():
        return np.empty((0, columns))
    try:
        values = np.loadtxt(io.StringIO(text.replace("D", "E").replace("d", "e")), comments="%", ndmin=2)
    except ValueError as error:
        _refuse_matrix("an entry is no number", where, str(error)[:160], "one entry per line: row column value")
    if values.shape[1] != columns:
        _refuse_matrix("entries of another length", where, f"{values.shape[1]} numbers per line", f"{columns}")
    finite(values, where=where, hint=FAILED)
    if not text.endswith(("\n", "\r")):
        _refuse_matrix(
            "the file is cut inside its last line", where, repr(text[-24:]), "a line end after the last entry"
        )
    return values


def _dense(text: str, n: int, symmetry: str, where: str) -> NDArray[np.float64]:
    """Column-major values; of a symmetric matrix the lower triangle."""
    count = n * n if symmetry == "general" else n * (n + 1) // 2
    if 8 * n * n > BUDGET or 2 * count > len(text) + 1:
        _refuse_matrix(
            "the file is cut, or its size line is wrong", where, f"{len(text)} characters", f"{count} numbers"
        )
    values = _table(text, 1, where)[:, 0]
    if len(values) != count:
        _refuse_matrix(
            "the file is cut, or its size line is wrong", where, f"{len(values)} numbers", f"{count} numbers"
        )
    if symmetry == "general":
        return values.reshape(n, n).T.copy()
    full = np.zeros((n, n))
    j, i = np.triu_indices(n)  # the lower triangle, column by column
    full[i, j] = full[j, i] = values
    return full


def _refuse_matrix(what: str, where: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where=where,
        found=found,
        expected=expected,
        hint="scipy.io.mmwrite, or the export of the solver, writes it",
    )
