"""Matrix Market files (.mtx): text, read strictly, symmetric storage expanded.

Format: R. F. Boisvert, R. Pozo, K. A. Remington, *The Matrix Market Exchange Formats: Initial Design*, NISTIR 5935
(1996).
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..errors import InputError
from .container import BUDGET, ROWS, finite

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
        _refuse("the file cannot be read", where, str(error.strerror), "a file that may be read")
    form, symmetry = _banner(text.split("\n", 1)[0], where)
    body = text.split("\n", 1)[1] if "\n" in text else ""
    line, rest, number = _sizes(body)
    sizes = [int(word) if word.isdigit() else -1 for word in line.split()]
    if len(sizes) != (3 if form == "coordinate" else 2) or min(sizes) < 0 or not 0 < sizes[0] == sizes[1] <= ROWS:
        _refuse(
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
        _refuse("the file is cut, or its size line is wrong", where, f"{len(values)} entries", f"{sizes[2]} entries")
    row, column = values[:, 0], values[:, 1]
    bad = np.flatnonzero((row != np.rint(row)) | (column != np.rint(column)) | (np.minimum(row, column) < 1))
    bad = bad if bad.size else np.flatnonzero(np.maximum(row, column) > n)
    if bad.size:
        k = int(bad[0])
        _refuse(
            "an entry lies outside the matrix",
            f"{where}, entry {k + 1}",
            f"({row[k]:g}, {column[k]:g})",
            f"1 to {n}",
        )
    i, j, x = row.astype(np.int64) - 1, column.astype(np.int64) - 1, values[:, 2]
    if symmetry == "symmetric":
        if np.any(i < j) and np.any(i > j):
            _refuse(
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
        _refuse(
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
        _refuse(
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
        _refuse("an entry is no number", where, str(error)[:160], "one entry per line: row column value")
    if values.shape[1] != columns:
        _refuse("entries of another length", where, f"{values.shape[1]} numbers per line", f"{columns}")
    finite(values, where)
    return values


def _dense(text: str, n: int, symmetry: str, where: str) -> NDArray[np.float64]:
    """Column-major values; of a symmetric matrix the lower triangle."""
    count = n * n if symmetry == "general" else n * (n + 1) // 2
    if 8 * n * n > BUDGET or 2 * count > len(text) + 1:
        _refuse("the file is cut, or its size line is wrong", where, f"{len(text)} characters", f"{count} numbers")
    values = _table(text, 1, where)[:, 0]
    if len(values) != count:
        _refuse("the file is cut, or its size line is wrong", where, f"{len(values)} numbers", f"{count} numbers")
    if symmetry == "general":
        return values.reshape(n, n).T.copy()
    full = np.zeros((n, n))
    j, i = np.triu_indices(n)  # the lower triangle, column by column
    full[i, j] = full[j, i] = values
    return full


def _refuse(what: str, where: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where=where,
        found=found,
        expected=expected,
        hint="scipy.io.mmwrite, or the export of the solver, writes it",
    )
