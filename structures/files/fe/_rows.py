"""Matrices as lines of text: Abaqus ``*MATRIX OUTPUT`` (.mtx) and CalculiX ``MATRIXSTORAGE`` (.sti, .mas, .dof)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._parts import ROWS, Matrix, Parts, labelled, refuse, square, table, text_of, whole

HELD = 1e35  # what Abaqus puts on the diagonal of a degree of freedom that is held
_NODE = re.compile(r"\*NODE\b(?! *(PRINT|FILE|OUTPUT|RESPONSE))", re.IGNORECASE)


def abaqus(path: Path) -> Parts:
    """Matrix of ``*MATRIX OUTPUT``, FORMAT=MATRIX INPUT or LABELS (five columns), or COORDINATE (three).

    Raises
    ------
    InputError
        Lines of other lengths, a file that is cut, degrees of freedom without a node (Lagrange multipliers).
    """
    where = str(path)
    lines = [line for line in text_of(path).splitlines() if line.strip() and not line.lstrip().startswith("*")]
    if not lines:
        refuse("no entry of a matrix", where, "comments alone", "lines: node, direction, node, direction, entry")
    columns = len(lines[0].replace(",", " ").split())
    if columns not in (3, 5):
        refuse("no matrix of *MATRIX OUTPUT", where, f"{columns} numbers in a line",
               "5 (FORMAT=MATRIX INPUT or LABELS) or 3 (FORMAT=COORDINATE)",
               "*MATRIX OUTPUT, STIFFNESS, MASS, FORMAT=LABELS")  # fmt: skip
    values = table("\n".join(lines), columns, where)
    name = _quantity(path)
    if columns == 3:
        i, j = (whole(values[:, k], where) - 1 for k in (0, 1))
        return Parts(matrices={name: Matrix(_square(i, j, values[:, 2], where), sized=False)})
    if np.any(values[:, [0, 2]] < 1):
        refuse("degrees of freedom without a node (Lagrange multipliers)", where,
               f"{int(np.sum(np.any(values[:, [0, 2]] < 1, axis=1)))} entries", "nodes from 1 on",
               "use displacement elements without hybrid formulation, and contact without multipliers")  # fmt: skip
    codes = np.where(values[:, [1, 3]] == 0, 0, values[:, [1, 3]])
    if np.any(codes > 6):
        refuse("a degree of freedom that is no motion", where, f"direction {codes.max():g}", "1 to 6",
               "leave pressure, temperature and warping out")  # fmt: skip
    rows = np.column_stack([whole(values[:, 0], where), whole(codes[:, 0], where, 0)])
    cols = np.column_stack([whole(values[:, 2], where), whole(codes[:, 1], where, 0)])
    made = labelled(rows, cols, values[:, 4])
    return _released(name, made, path)


def _released(name: str, made: Matrix, path: Path) -> Parts:
    """The matrix without the huge entries that stand for supports, and these as supports."""
    stiff = made.A.diagonal() >= HELD
    if not stiff.any() or made.labels is None:
        return Parts(matrices={name: made})
    A = made.A.tolil()
    A.setdiag(np.where(stiff, 1.0, made.A.diagonal()))
    note = f"{path.name}: {int(stiff.sum())} degrees of freedom are held (1e36 on the diagonal)"
    return Parts(matrices={name: Matrix(A.tocsr(), made.labels)}, held=made.labels[stiff], notes=(note,))


def _quantity(path: Path) -> str:
    """What a file of Abaqus holds, by the end of its name: JOB_STIF2.mtx, JOB_MASS2.mtx, JOB_DMPV2.mtx."""
    match = re.search(r"_(STIF|MASS|DMPV|DMPS)\d*$", path.stem, re.IGNORECASE)
    return match[1].upper() if match else path.stem


def inp(path: Path) -> Parts:
    """Nodes of an input file of Abaqus or CalculiX.

    Raises
    ------
    InputError
        A line of a node that is none; no nodes.
    """
    where, inside = str(path), False
    found: dict[int, tuple[float, ...]] = {}
    for number, line in enumerate(text_of(path).splitlines(), 1):
        bare = line.strip()
        if not bare or bare.startswith("**"):
            continue
        if bare.startswith("*"):
            inside = bool(_NODE.match(bare))
            continue
        if inside:
            values = table(bare + "\n", len([w for w in bare.split(",") if w.strip()]), f"{where}, line {number}")[0]
            node = int(whole(values[:1], f"{where}, line {number}")[0])
            found[node] = tuple([*values[1:4].tolist(), 0.0, 0.0, 0.0][:3])
    if not found:
        refuse("no *NODE block", where, "other keywords", "nodes with their places", "give the file that has the mesh")
    nodes = sorted(found)
    return Parts(nodes=np.array(nodes, np.int64), places=np.array([found[n] for n in nodes]))


# -- CalculiX ----------------------------------------------------------------------------------------------------------
def calculix(path: Path) -> Parts:
    """One of the three files that ``*FREQUENCY, SOLVER=MATRIXSTORAGE`` writes: .sti, .mas or .dof.

    Raises
    ------
    InputError
        Lines of other lengths, a file that is cut, a degree of freedom that is none.
    """
    suffix, where = path.suffix.lower(), str(path)
    if suffix == ".dof":
        return Parts(rows=_dofs(text_of(path), where))
    values = table(text_of(path), 3, where)
    i, j = (whole(values[:, k], where) - 1 for k in (0, 1))
    name = "K" if suffix == ".sti" else "M"
    return Parts(matrices={name: Matrix(_square(i, j, values[:, 2], where), sized=False)})


def _dofs(text: str, where: str) -> NDArray[np.int64]:
    words = text.split()
    for number, word in enumerate(words, 1):
        if not re.fullmatch(r"\d{1,12}\.[1-6]", word):
            refuse("no degree of freedom", f"{where}, line {number}", repr(word[:30]), "node.direction, such as 12.3")
    return np.array([word.split(".") for word in words], np.int64)


def _square(i: NDArray[Any], j: NDArray[Any], x: NDArray[np.float64], where: str) -> Any:
    n = int(max(i.max(), j.max())) + 1
    if n > ROWS:
        refuse("the matrix is too large", where, f"{n} rows", f"at most {ROWS}")
    return square(i, j, x, n)
