"""Assembled real Harwell-Boeing matrices, as Ansys writes them (HBMAT), and the mapping of their rows.

Format: I. S. Duff, R. G. Grimes, J. G. Lewis, *Users' Guide for the Harwell-Boeing Sparse Matrix Collection*,
TR/PA/92/86, CERFACS (1992). SciPy reads the unsymmetric ones alone; stiffness and mass are symmetric.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ._parts import CUT, ROWS, Matrix, Parts, refuse, square, text_of

_FORMAT = re.compile(r"\(?\s*(?:\d+P\s*,?\s*)?(\d+)\s*\(?\s*[IEDFG](\d+)(?:\.\d+)?(?:E\d+)?\s*\)*", re.IGNORECASE)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[Ee][+-]?\d+)?")
_NAMES = {"UX": 1, "UY": 2, "UZ": 3, "ROTX": 4, "ROTY": 5, "ROTZ": 6}


def read(path: Path) -> Parts:
    """Matrix of a Harwell-Boeing file.

    Raises
    ------
    InputError
        A file that is cut or damaged; a matrix that is complex, a pattern, not assembled, or not square.
    """
    where, lines = str(path), text_of(path).splitlines()
    if len(lines) < 5:
        refuse(CUT, where, f"{len(lines)} lines", "four lines of header, and the matrix")
    counts = _ints(lines[1], where, 2)
    kind, *sizes = lines[2].split()
    if kind.upper() not in ("RSA", "RUA") or len(sizes) < 3:
        refuse("a Harwell-Boeing matrix of another kind", f"{where}, line 3", repr(lines[2][:40]),
               "RSA or RUA: real, symmetric or not, assembled",
               "in Ansys: HBMAT, name, ext, , ASCII, STIFF")  # fmt: skip
    rows, columns, entries = _ints(" ".join(sizes), where, 3)[:3]
    if not 0 < rows == columns <= ROWS or entries < 1:
        refuse("no square matrix", f"{where}, line 3", f"{rows} x {columns}, {entries} entries", "rows = columns")
    forms = [_FORMAT.fullmatch(word.strip()) for word in (lines[3][:16], lines[3][16:32], lines[3][32:52])]
    if not all(forms):
        refuse("formats that are none", f"{where}, line 4", repr(lines[3]), "such as (8I10) (8I10) (4E20.12)")
    at = 4 + (len(counts) > 4 and counts[4] > 0)
    total = at + sum(counts[1:4])
    if len(lines) < total or min(counts[1:4]) < 0:
        refuse(CUT, where, f"{len(lines)} lines", f"{total} lines, as its header says")
    blocks = []
    for form, size, count in zip(forms, counts[1:4], (columns + 1, entries, entries), strict=True):
        assert form is not None
        blocks.append(_block(lines[at : at + size], int(form[2]), count, f"{where}, line {at + 1}"))
        at += size
    starts, index, values = blocks
    return Parts(matrices={_quantity(path): Matrix(_matrix(starts, index, values, rows, kind.upper(), where))})


def _matrix(starts: Any, index: Any, values: Any, n: int, kind: str, where: str) -> sparse.csr_array:
    if starts[0] != 1 or starts[-1] != len(index) + 1 or np.any(np.diff(starts) < 0) or np.any(starts % 1):
        refuse(CUT, where, "pointers that do not rise from 1 to the number of entries", "one for each column")
    if np.any(index % 1) or index.min() < 1 or index.max() > n:
        refuse(CUT, where, "an entry outside the matrix", f"rows 1 to {n}")
    i = index.astype(np.int64) - 1
    j = np.repeat(np.arange(n), np.diff(starts).astype(np.int64))
    if kind == "RSA" and np.any(i < j) and np.any(i > j):
        refuse("a symmetric file that holds both triangles", where, "entries on both sides", "one triangle, or RUA")
    if kind == "RSA":
        return square(i, j, values, n)
    return sparse.coo_array((values, (i, j)), shape=(n, n)).tocsr()


def _ints(line: str, where: str, number: int) -> list[int]:
    words = line.split()
    if not all(re.fullmatch(r"-?\d{1,15}", w) for w in words):
        words = [line[k : k + 14].strip() for k in range(0, 70, 14)]
    if len([w for w in words if w]) < 3 or not all(re.fullmatch(r"-?\d{1,15}", w) for w in words if w):
        refuse("no Harwell-Boeing header", f"{where}, line {number}", repr(line[:60]), "whole numbers")
    return [int(w) for w in words if w]


def _block(lines: list[str], width: int, count: int, where: str) -> NDArray[np.float64]:
    """Numbers in fields of a width, or apart by blanks where that gives as many."""
    words = " ".join(lines).replace("D", "E").replace("d", "e").split()
    if len(words) != count:
        text = [line[k : k + width].strip() for line in lines for k in range(0, len(line.rstrip()), width)]
        words = [w.replace("D", "E") for w in text]
    if len(words) != count or any(_NUMBER.fullmatch(w) is None for w in words):
        words = _NUMBER.findall(" ".join(lines).replace("D", "E"))  # fields narrower than they are said to be
    if len(words) != count:
        refuse(CUT, where, f"{len(words)} numbers", f"{count}, as the header says")
    try:
        values = np.array(words, dtype=float)
    except ValueError as error:
        refuse(CUT, where, str(error)[:100], "numbers")
    if not np.isfinite(values).all():
        refuse("NaN or infinity", where, f"{int(np.sum(~np.isfinite(values)))} numbers", "finite numbers")
    return values


def _quantity(path: Path) -> str:
    return path.stem


def mapping(path: Path) -> Parts:
    """Labels of the rows, as HBMAT writes them: equation, node, degree of freedom.

    Raises
    ------
    InputError
        A line that is none, equations that do not run from 1 on.
    """
    where = str(path)
    out: dict[int, tuple[int, int]] = {}
    for number, line in enumerate(text_of(path).splitlines(), 1):
        words = line.split()
        if len(words) != 3 or not words[0].isdigit():
            if out:
                refuse(CUT, f"{where}, line {number}", repr(line[:40]), "equation, node, degree of freedom")
            continue
        if not words[1].isdigit() or words[2].upper() not in _NAMES:
            refuse("no degree of freedom that is a motion", f"{where}, line {number}", repr(line[:40]),
                   f"a node, and one of {', '.join(_NAMES)}")  # fmt: skip
        out[int(words[0])] = (int(words[1]), _NAMES[words[2].upper()])
    if not out or sorted(out) != list(range(1, len(out) + 1)):
        refuse(CUT, where, f"{len(out)} equations", "equations 1, 2, 3, ... without a gap")
    return Parts(rows=np.array([out[k] for k in sorted(out)], np.int64))
