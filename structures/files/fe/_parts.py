"""What the file of a solver holds, as it stands there: matrices with their labels, places of nodes, modes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ...errors import InputError

Array = NDArray[np.float64]
Labels = NDArray[np.int64]  # (n, 2): node and code of the direction
LARGEST = 8_000_000_000  # bytes of a file
ROWS = 20_000_000
CUT = "the file is cut or damaged"
AGAIN = "transfer the file again, or export it again"


@dataclass(frozen=True, eq=False)
class Matrix:
    """One matrix of a file.

    Parameters
    ----------
    A : sparse (n, n)
    labels : array (n, 2), or None where the file does not name its rows
    sized : bool
        The file states how many rows there are; else the last that is not zero ends them.
    """

    A: sparse.csr_array
    labels: Labels | None = None
    sized: bool = True


@dataclass(frozen=True, eq=False)
class Shapes:
    """Modes of a file, in the units of the file.

    Parameters
    ----------
    frequencies : array (modes,)
        Hz, ascending.
    shapes : array (n, modes)
    labels : array (n, 2)
    mass : array (modes,), or None where the file does not say it
        Modal masses.
    damping : array (modes,) or None
        Ratios.
    """

    frequencies: Array
    shapes: Array
    labels: Labels
    mass: Array | None = None
    damping: Array | None = None


@dataclass(frozen=True, eq=False)
class Parts:
    """Everything that one file holds.

    Parameters
    ----------
    matrices : dict
        By the name in the file; "" where it has none.
    nodes, places : array (nodes,), (nodes, 3)
        Numbers, and where they are.
    unplaced : array (unplaced,)
        Numbers of nodes whose places are in a coordinate system of their own.
    modes : Shapes or None
    held : array (held, 2)
        Degrees of freedom that the file holds.
    rows : array (n, 2) or None
        Labels of the rows of matrices of other files.
    scale : (length, force) or None
        Metres and newtons of the units that the file states.
    notes : tuple of str
    """

    matrices: dict[str, Matrix] = field(default_factory=dict)
    nodes: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    places: Array = field(default_factory=lambda: np.empty((0, 3)))
    unplaced: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    modes: Shapes | None = None
    held: Labels = field(default_factory=lambda: np.empty((0, 2), np.int64))
    rows: Labels | None = None
    scale: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()


def refuse(what: str, where: str, found: object, expected: object, hint: str = AGAIN) -> NoReturn:
    """Raise the one error of readers."""
    raise InputError(what, where=where, found=found, expected=expected, hint=hint)


def data_of(path: Path) -> bytes:
    """All bytes of a file.

    Raises
    ------
    InputError
        A file that cannot be read, is empty, or is too large.
    """
    try:
        size = os.path.getsize(path)
        if size > LARGEST:
            refuse("the file is too large", str(path), f"{size} bytes", f"at most {LARGEST}", "reduce the model first")
        data = path.read_bytes()
    except OSError as error:
        refuse("the file cannot be read", str(path), error.strerror or error, "a file that may be read", "check it")
    if not data.strip():
        refuse("the file is empty", str(path), f"{len(data)} bytes", "matrices, nodes or modes")
    return data


def text_of(path: Path) -> str:
    """A text file whose last line has its end: one that lacks it was cut.

    Raises
    ------
    InputError
        As `data_of`; bytes that are no text; a last line without its end.
    """
    data = data_of(path)
    if b"\0" in data[:4096]:
        refuse("a binary file where a text is expected", str(path), repr(data[:8]), "a text file",
               "export the model as text (ASCII)")  # fmt: skip
    if data[-1:] not in b"\r\n":
        refuse(CUT, str(path), f"a last line without its end, {data[-24:]!r}", "a line end after the last line")
    return data.decode("latin-1")


def table(text: str, columns: int, where: str) -> Array:
    """Numbers of a text with the same count in every line, (lines, columns); commas count as blanks.

    Raises
    ------
    InputError
        A word that is no number, lines of other lengths, NaN.
    """
    clean = text.replace(",", " ").replace("D", "E").replace("d", "e")
    lines = sum(1 for line in clean.splitlines() if line.strip())
    try:
        values = np.array(clean.split(), dtype=float) if lines < 1000 else np.fromstring(clean, sep=" ")
    except (ValueError, DeprecationWarning) as error:
        refuse("a line holds what is no number", where, str(error)[:120], f"{columns} numbers in every line")
    if values.size != lines * columns or not lines:
        refuse(CUT, where, f"{values.size} numbers in {lines} lines", f"{columns} numbers in every line")
    if not np.isfinite(values).all():
        refuse("NaN or infinity", where, f"{int(np.sum(~np.isfinite(values)))} numbers", "finite numbers")
    return values.reshape(lines, columns)


def whole(values: Array, where: str, least: int = 1) -> NDArray[np.int64]:
    """Integers among numbers that were read.

    Raises
    ------
    InputError
        Fractions, or what lies below `least` or above 2^53.
    """
    if np.any(values != np.rint(values)) or np.any(values < least) or np.any(values > 2**53):
        bad = values[(values != np.rint(values)) | (values < least) | (values > 2**53)]
        refuse("no number of a row, a node or a direction", where, f"{bad[0]:g}", f"whole numbers from {least} on")
    return values.astype(np.int64)


def square(i: NDArray[Any], j: NDArray[Any], x: Array, n: int) -> sparse.csr_array:
    """Matrix of entries, completed where they fill one triangle alone."""
    if n > ROWS:
        raise InputError("the matrix is too large", found=f"{n} rows", expected=f"at most {ROWS}")
    apart = i != j
    if np.any(apart) and (np.all(i >= j) or np.all(i <= j)):
        i, j, x = np.concatenate([i, j[apart]]), np.concatenate([j, i[apart]]), np.concatenate([x, x[apart]])
    return sparse.coo_array((x, (i, j)), shape=(n, n)).tocsr()


def labelled(rows: Labels, columns: Labels, x: Array) -> Matrix:
    """Matrix of entries that name node and direction of their row and column; rows ascend by node and direction."""
    keys = np.concatenate([_key(rows), _key(columns)])
    known, index = np.unique(keys, return_inverse=True)
    i, j = np.split(index.ravel(), 2)
    return Matrix(square(i, j, x, len(known)), np.column_stack([known >> 4, known & 15]))


def _key(labels: Labels) -> NDArray[np.int64]:
    return (labels[:, 0] << 4) | labels[:, 1]


def keyed(labels: Labels) -> NDArray[np.int64]:
    """One number for each label, ascending by node and direction."""
    return _key(np.asarray(labels, np.int64))


def named_parts(found: Sequence[Parts]) -> dict[str, Matrix]:
    """Matrices of several files by their names; a name twice is refused."""
    out: dict[str, Matrix] = {}
    for part in found:
        for name, matrix in part.matrices.items():
            if name in out:
                refuse(f"two matrices of the name {name}", "read_fe", name, "one of each", "leave one file out")
            out[name] = matrix
    return out
