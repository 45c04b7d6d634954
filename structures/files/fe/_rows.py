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
_ROUND = re.compile(r"SYSTEM *= *[CS]", re.IGNORECASE)  # cylindrical or spherical


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
        A line of a node that is none; no nodes; a number at two places.
    """
    where, word = str(path), ""
    moved = own = turned = False
    found: dict[int, tuple[float, ...]] = {}
    for number, line in enumerate(text_of(path).splitlines(), 1):
        bare, at = line.strip(), f"{where}, line {number}"
        if not bare or bare.startswith("**"):
            continue
        if bare.startswith("*"):
            word = "*NODE" if _NODE.match(bare) else re.split(r"[ ,]", bare.upper())[0]
            own = own and word != "*SYSTEM"  # one without data ends the one before
            moved |= word == "*NODE" and (own or bool(_ROUND.search(bare)))
            turned |= word == "*TRANSFORM"
            if word == "*NODE" and re.search(r"INPUT *=", bare, re.IGNORECASE):
                refuse("nodes in another file", at, bare[:80], "nodes with their places", "put them into this file")
        elif word == "*NODE":
            node, place = _node(bare, at)
            if found.setdefault(node, place) != place:
                refuse("a node at two places", at, f"node {node}", "each number once",
                       "write the input without parts and instances")  # fmt: skip
        elif word in ("*SYSTEM", "*INSTANCE"):
            own, moved = own or word == "*SYSTEM", moved or word == "*INSTANCE"
    if not found:
        refuse("no *NODE block", where, "other keywords", "nodes with their places", "give the file that has the mesh")
    notes = [f"{path.name}: nodes stand in a coordinate system of their own (SYSTEM, INSTANCE): no places read"] * moved
    notes += [f"{path.name}: *TRANSFORM turns directions of its nodes: labels follow these"] * turned
    every = np.array(sorted(found), np.int64)
    if moved:
        return Parts(unplaced=every, notes=tuple(notes))
    return Parts(nodes=every, places=np.array([found[n] for n in every.tolist()]), notes=tuple(notes))


def _node(bare: str, at: str) -> tuple[int, tuple[float, ...]]:
    """Number and place of a node; coordinates that are left out are zero."""
    words = [w.strip() for w in bare.split(",")][:4]
    values = table(",".join(w or "0" for w in words) + "\n", len(words), at)[0]
    place = tuple([*values[1:4].tolist(), 0.0, 0.0, 0.0][:3])
    return int(whole(values[:1], at)[0]), place


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
