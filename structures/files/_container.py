"""A file as named arrays that are read when asked for, and the matrices found among them; NumPy archives."""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..errors import InputError, finite

BUDGET = 4 * 2**30  # bytes that one array, or all of an archive, may take in memory
ROWS = 20_000_000  # DOFs of a matrix
FAILED = "export it again: a solver that failed leaves such entries"
SPELLINGS = {"K": ("stiffness", "stiff"), "M": ("mass",), "C": ("damping", "damp")}
_PARTS = {"data", "indices", "indptr", "row", "col", "ir", "jc", "shape", "format"}


@dataclass(frozen=True)
class Container:
    """Named arrays of one file.

    Parameters
    ----------
    path : str
        For messages.
    arrays : dict of str to callable
        Reads one array.
    shapes : dict of str to int
        Number of rows that a sparse group states, where the format has a place for it.
    """

    path: str
    arrays: dict[str, Callable[[], NDArray[Any]]]
    shapes: dict[str, int]

    def named(self, wanted: str, own: str | None = None) -> str | None:
        """Name under which a matrix is stored: `own`, else K, k, stiffness and so on; None where there is none.

        Raises
        ------
        InputError
            If `own` is not there, or two names would do.
        """
        known = self.matrices()
        if own is not None:
            if own in known:
                return own
            raise self.missing(wanted, own)
        if wanted in known:
            return wanted
        near = [name for name in known if name.lower() in (wanted.lower(), *SPELLINGS[wanted])]
        if len(near) > 1:
            raise InputError(
                f"two matrices may be {wanted}",
                where=self.path,
                found=", ".join(near),
                expected="one",
                hint=f'say which: names={{"{wanted}": "{near[0]}"}}',
            )
        return near[0] if near else None

    def missing(self, wanted: str, name: str) -> InputError:
        """The refusal where a matrix is not in the file."""
        known = self.matrices() or list(self.arrays)
        words = {"K": "stiffness", "M": "mass", "C": "damping"}[wanted]
        return InputError(
            f"no {words} matrix {name}",
            where=self.path,
            found=", ".join(known[:12]) + (", ..." if len(known) > 12 else "") or "nothing",
            expected=f"a matrix named {name}",
            hint=f'say how it is called: names={{"{wanted}": "{(known or ["..."])[0]}"}}',
        )

    def matrices(self) -> list[str]:
        """Names of all matrices: an array each, or a group of parts (``K_data``, ``K/indptr``); "" where bare."""
        found = []
        for name in self.arrays:
            stem, part = split(name)
            if part is None or not {"data"} <= self._parts(stem):
                stem = name
            if stem not in found:
                found.append(stem)
        return found

    def _parts(self, stem: str) -> set[str]:
        return {part for name in self.arrays for s, part in [split(name)] if s == stem and part}

    def array(self, name: str) -> NDArray[Any] | None:
        """An array by its name, whatever its case; None where there is none."""
        match = [key for key in self.arrays if key.lower().rsplit("/", 1)[-1] == name]
        return self.arrays[match[0]]() if match else None

    def matrix(self, name: str) -> Any:
        """A matrix, dense or sparse, square and real as far as its storage tells.

        Raises
        ------
        InputError
            If it is no matrix, not square, holds other things than numbers, or its sparse parts contradict each other.
        """
        where = f"{self.path}, {name or 'matrix'}"
        if name in self.arrays:
            return numbers(self.arrays[name](), where, square=True)
        parts: dict[str, NDArray[Any]] = {}
        for key, get in self.arrays.items():
            stem, part = split(key)
            if stem == name and part and part != "format":
                parts[part] = get()
        return assembled(parts, self._format(name), self.shapes.get(name), where)

    def _format(self, name: str) -> str:
        for key, get in self.arrays.items():
            if split(key) == (name, "format"):
                value = get()
                item = value.item() if value.size == 1 else ""
                return item.decode("ascii", "replace") if isinstance(item, bytes) else str(item)
        return ""


def split(name: str) -> tuple[str, str | None]:
    """``K_data``, ``K/data`` and ``K.data`` as ("K", "data"); ("name", None) for anything else."""
    match = re.fullmatch(r"(?:(.*)[/_.])?([a-z]+)", name)
    if match and match[2] in _PARTS:
        return match[1] or "", match[2]
    return name, None


def numbers(values: NDArray[Any], where: str, *, square: bool = False) -> NDArray[Any]:
    """An array of finite real numbers, in the byte order of this machine.

    Raises
    ------
    InputError
        If it is none, or not a square matrix where that is asked.
    """
    if values.dtype.kind == "c" and not np.any(values.imag):
        values = values.real
    if values.dtype.kind not in "fiu":
        raise InputError(
            "no real numbers",
            where=where,
            found=f"values of type {values.dtype}",
            expected="real numbers",
            hint="damping that is complex stiffness goes into loadid as ratios: damping=0.02",
        )
    if square and (values.ndim != 2 or values.shape[0] != values.shape[1] or values.size == 0):
        raise InputError(
            "not a square matrix",
            where=where,
            found=f"shape {values.shape}",
            expected="(n, n), n > 0",
            hint="supports stay in the matrices; name them with supports=",
        )
    finite(values, where=where, hint=FAILED)
    return values.astype(values.dtype.newbyteorder("="), copy=False)  # scipy.sparse takes no other order of bytes


def assembled(parts: dict[str, NDArray[Any]], form: str, rows: int | None, where: str) -> Any:
    """Sparse matrix of its parts: CSR or CSC (data, indices, indptr), COO (data, row, col), MATLAB (data, ir, jc).

    Raises
    ------
    InputError
        If parts are missing, differ in length, or point outside the matrix.
    """
    if {"ir", "jc"} <= set(parts):
        parts = {"data": parts["data"], "indices": parts["ir"], "indptr": parts["jc"], **_only(parts, "shape")}
        form = "csc"
    compressed, listed = {"indices", "indptr"} <= set(parts), {"row", "col"} <= set(parts)
    if "data" not in parts or not (compressed or listed):
        raise InputError(
            "parts of a sparse matrix are missing",
            where=where,
            found=", ".join(sorted(parts)),
            expected="data with indices and indptr (CSR), or data with row and col (COO)",
            hint="scipy.sparse.save_npz writes all of them",
        )
    if form not in ("", "csr", "csc", "coo"):
        raise InputError(
            "a sparse format that is not read",
            where=where,
            found=form,
            expected="csr, csc or coo",
            hint="sparse.csr_array(K) converts any of them",
        )
    data = numbers(np.ravel(parts["data"]), where)
    index = {name: _indices(part, f"{where}, {name}") for name, part in parts.items() if name != "data"}
    shape = tuple(index["shape"].tolist()) if "shape" in index else None
    if shape is None:
        n = rows or (
            len(index["indptr"]) - 1 if compressed else 1 + max(int(index[k].max(initial=0)) for k in ("row", "col"))
        )
        shape = (n, n)
    if len(shape) != 2 or shape[0] != shape[1] or not 0 < shape[0] <= ROWS:
        raise InputError(
            "not a square matrix",
            where=where,
            found=f"shape {shape}",
            expected=f"(n, n), 0 < n <= {ROWS}",
            hint="supports stay in the matrices; name them with supports=",
        )
    n = shape[0]
    _consistent(index, len(data), n, compressed, where)
    if compressed:
        kind = sparse.csc_array if form == "csc" else sparse.csr_array
        return sparse.csr_array(kind((data, index["indices"], index["indptr"]), shape=shape))
    return sparse.coo_array((data, (index["row"], index["col"])), shape=shape).tocsr()


def _only(parts: dict[str, NDArray[Any]], name: str) -> dict[str, NDArray[Any]]:
    return {name: parts[name]} if name in parts else {}


def _indices(values: NDArray[Any], where: str) -> NDArray[Any]:
    flat = np.ravel(values)
    if flat.dtype.kind == "f" and flat.size and np.all(np.isfinite(flat)) and np.all(flat == np.rint(flat)):
        flat = flat.astype(np.int64) if np.abs(flat).max() < 2**53 else flat
    if flat.dtype.kind not in "iu" and flat.size:
        raise InputError(
            "no indices",
            where=where,
            found=f"values of type {values.dtype}",
            expected="integers",
            hint="the file is damaged, or holds something else under this name",
        )
    return flat.astype(np.int64)


def _consistent(index: dict[str, NDArray[Any]], count: int, n: int, compressed: bool, where: str) -> None:
    names = ("indices",) if compressed else ("row", "col")
    wrong = ""
    for name in names:
        places = index[name]
        if len(places) != count:
            wrong = f"{count} entries and {len(places)} {name}"
        elif count and (places.min() < 0 or places.max() >= n):
            wrong = f"{name} from {places.min()} to {places.max()} in a matrix of {n} rows"
            if places.min() >= 1 and places.max() == n:
                wrong += ": counted from one"
    if compressed and not wrong:
        starts = index["indptr"]
        if len(starts) != n + 1 or starts[0] != 0 or starts[-1] != count or np.any(np.diff(starts) < 0):
            wrong = f"indptr of {len(starts)} values that do not rise from 0 to {count}, for {n} rows"
    if wrong:
        raise InputError(
            "the parts of a sparse matrix contradict each other",
            where=where,
            found=wrong,
            expected=f"indices from 0 to {n - 1}, one for each entry",
            hint="subtract one where they count from one; otherwise the file is damaged",
        )


MEMBERS = 10_000
ZIP_END = 22 + 2**16  # bytes in which the end of an archive lies, with its longest comment


def open_npz(path: Path) -> Container:
    """The arrays of an archive.

    Raises
    ------
    InputError
        If it is no archive, is damaged, or claims more than fits into memory.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _require_all(path, len(members))
            for member in members:  # a name that is damaged in one of its two places is another array, or none
                archive.open(member).close()
    except (zipfile.BadZipFile, OSError, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
        raise _damaged(path, error) from None
    size = sum(m.file_size for m in members)
    if len(members) > MEMBERS or size > BUDGET:
        raise InputError(
            "the archive is too large",
            where=str(path),
            found=f"{len(members)} arrays, {size} bytes",
            expected=f"at most {MEMBERS} arrays and {BUDGET} bytes",
            hint="store large matrices sparse: sparse.save_npz",
        )
    arrays: dict[str, Callable[[], NDArray[Any]]] = {
        m.filename.removesuffix(".npy"): partial(_read, path, m) for m in members if m.filename.endswith(".npy")
    }
    return Container(str(path), arrays, {})


def _require_all(path: Path, found: int) -> None:
    """Nothing, if the directory of an archive has as many entries as its end declares (2^16 - 1: said elsewhere).

    Raises
    ------
    zipfile.BadZipFile
    """
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - ZIP_END))
        tail = file.read()
    declared = int.from_bytes(tail[(at := tail.rfind(b"PK\x05\x06") + 10) : at + 2], "little")
    if declared not in (found, 2**16 - 1):
        raise zipfile.BadZipFile(f"{found} of {declared} entries of the directory")


def _read(path: Path, member: zipfile.ZipInfo) -> NDArray[Any]:
    where = f"{path}, {member.filename.removesuffix('.npy')}"
    try:
        with zipfile.ZipFile(path) as archive:
            data = archive.read(member)
        shape, dtype, start = _header(data)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, NotImplementedError, RuntimeError) as error:
        raise _damaged(Path(where), error) from None
    if dtype.hasobject:
        raise InputError(
            "a pickled object, which is never read",
            where=where,
            found="an array of Python objects, such as np.savez makes of a sparse matrix",
            expected="plain numbers",
            hint="K=K.toarray(), or of a CSR matrix K_data=K.data, K_indices=K.indices, K_indptr=K.indptr",
        )
    expected = int(np.prod(shape, dtype=object)) * dtype.itemsize
    if expected != len(data) - start:
        raise InputError(
            "the array is not as long as its header says",
            where=where,
            found=f"{len(data) - start} bytes",
            expected=f"{expected} bytes for shape {shape}",
            hint="transfer or export it again",
        )
    return np.asarray(np.load(io.BytesIO(data), allow_pickle=False))


def _header(data: bytes) -> tuple[tuple[int, ...], np.dtype, int]:
    stream = io.BytesIO(data)
    version = np.lib.format.read_magic(stream)
    read: Any = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(stream)
    return shape, dtype, stream.tell()


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(
        "no NumPy archive, or a damaged one",
        where=str(path),
        found=f"{type(error).__name__}: {error}"[:160],
        expected="a file of np.savez or sparse.save_npz",
        hint="transfer or export it again",
    )
