"""Arrays in a NumPy archive: headers are checked before anything of their size is read, and nothing is unpickled."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .container import BUDGET, Container

MEMBERS = 10_000


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
    except (zipfile.BadZipFile, OSError, EOFError, ValueError, NotImplementedError) as error:
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
    arrays: dict[str, Callable[[], NDArray]] = {
        m.filename.removesuffix(".npy"): partial(_read, path, m) for m in members if m.filename.endswith(".npy")
    }
    return Container(str(path), arrays, {})


def _read(path: Path, member: zipfile.ZipInfo) -> NDArray:
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
    return np.load(io.BytesIO(data), allow_pickle=False)


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
