"""Arrays in HDF5 files, of this package or of others; MAT files as named arrays with the axes of MATLAB."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from . import _storage as storage
from ._child import NoChildError, apart
from ._container import BUDGET, Container
from ._mat_level5 import LEVEL5_BUDGET, is_level5, read_level5
from ._storage import as_path

SIGNATURE = b"\x89HDF\r\n\x1a\n"
KIND = "structure"
MODELS = ("forward model", "state space", "modal model", "measured model", "table of FRFs")
OBJECTS = 10_000
TEXT = 16  # bytes that a dataset holds of a text that lies elsewhere
_FILTERS = (1, 2, 3)  # deflate, shuffle, fletcher32: compiled in; any other would load a library from the disk


def open_hdf5(path: Path) -> Container:
    """The arrays of a file.

    Raises
    ------
    InputError
        If it is no HDF5 file, is cut or damaged, or holds what is not read (links out of the file, plug-in filters).
    """
    kind = storage.kind_of(path)
    if kind in MODELS:
        raise InputError("another kind of file: this is a model, not a structure", where=str(path), found=kind,
                         expected=KIND, hint="structures.files.load_model reads it")  # fmt: skip
    if kind is not None:
        tree = storage.read(path, KIND)
        arrays: dict[str, Callable[[], NDArray[Any]]] = {}
        _flatten(tree, "", arrays)
        return Container(str(path), arrays, {})
    _signed(path)
    _tried(path)
    names, shapes = _guarded(path, _list)
    return Container(str(path), {name: partial(_guarded, path, partial(_get, name=name)) for name in names}, shapes)


def _flatten(tree: dict[str, Any], prefix: str, out: dict[str, Callable[[], NDArray[Any]]]) -> None:
    for name, value in tree.items():
        if isinstance(value, dict):
            _flatten(value, f"{prefix}{name}/", out)
        elif value is not None:
            out[prefix + name] = partial(np.asarray, value)


def _signed(path: Path) -> None:
    """Signature, and a file as long as its superblock says, before the library sees it."""
    size = path.stat().st_size
    with path.open("rb") as file:
        start, at = -1, 0
        while at < size and at <= 2**20:
            file.seek(at)
            if file.read(8) == SIGNATURE:
                start = at
                break
            at = max(512, 2 * at)
        head = file.read(64) if start >= 0 else b""
    if start < 0 or len(head) < 48:
        raise InputError(
            "no HDF5 file, or damaged in its first bytes",
            where=str(path),
            found=f"{size} bytes without the signature of HDF5",
            expected="a file that begins with it",
            hint="save it in MATLAB with -v7 or -v7.3"
            if path.suffix.lower() == ".mat"
            else "transfer or export it again",
        )
    end = _end(head)
    if end is not None and end + (start if end + start <= size else 0) > size:
        raise InputError(
            "the file is cut",
            where=str(path),
            found=f"{size} bytes",
            expected=f"{end} bytes, as its superblock says",
            hint="transfer it again, or close it properly where it is written",
        )


def _end(head: bytes) -> int | None:
    """End-of-file address of a superblock, from the bytes after the signature; None where it is unusual."""
    version = head[0]
    if version in (0, 1) and head[5] == 8:
        at = (24 if version == 0 else 28) - 8 + 16
    elif version in (2, 3) and head[1] == 8:
        at = 4 + 16
    else:
        return None
    value = int.from_bytes(head[at : at + 8], "little")
    return None if value == 2**64 - 1 else value


def _tried(path: Path) -> None:
    """Let a child read the file first: it dies or hangs in place of the caller, where the library does."""
    request = {"path": str(path.resolve()), "library": "h5py"}
    with contextlib.suppress(NoChildError):
        apart(TRIAL, request, reader="HDF5", where=str(path), size=path.stat().st_size)


TRIAL = f"{__name__}:touched"


def touched(request: Mapping[str, Any]) -> tuple[None, list[NDArray[Any]]]:
    """Read all that `_get` would read; what cannot be read is refused in words by the caller."""
    import h5py

    length = Path(request["path"]).stat().st_size

    def touch(name: str, item: Any) -> None:
        dict(item.attrs)
        if isinstance(item, h5py.Dataset) and not item.external and not item.is_virtual:
            settings = item.id.get_create_plist()
            filters = [settings.get_filter(i)[0] for i in range(settings.get_nfilters())]
            size = (item.size or 0) * item.dtype.itemsize
            held = filters or (size <= item.id.get_storage_size() and _texts_claim(item) <= length)
            if set(filters) <= set(_FILTERS) and size <= BUDGET and held:
                item[()]

    with contextlib.suppress(Exception), h5py.File(request["path"], "r") as file:
        file.visititems(touch)
    return None, []


def _texts_claim(item: Any) -> int:
    """Bytes that texts of any length say they have; the library takes them for each before it looks where they lie.

    Of each the dataset holds length, address and index (HDF5 File Format Specification 3.0, "Variable-length Data").
    """
    import h5py

    told = h5py.check_string_dtype(item.dtype)
    if told is None or told.length is not None or not item.size:
        return 0
    if item.chunks is None:
        parts = [(item.id.get_offset(), item.id.get_storage_size())]
    else:
        chunks = map(item.id.get_chunk_info, range(item.id.get_num_chunks()))
        parts = [(one.byte_offset, one.size) for one in chunks]
    total = 0
    with open(item.file.filename, "rb") as file:
        for at, size in parts:
            if at is not None:
                file.seek(at)
                words = np.frombuffer(file.read(size // TEXT * TEXT), "<u4")
                total += int(words[:: TEXT // 4].sum(dtype=np.int64))
    return total


def _guarded(path: Path, work: Callable[[Any], Any]) -> Any:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return work(file)
    except InputError:
        raise
    except Exception as error:  # HDF5 raises OSError, KeyError, RuntimeError, ValueError, ... on what it cannot read
        raise InputError(
            "HDF5 cannot read it",
            where=str(path),
            found=f"{type(error).__name__}: {error}"[:200],
            expected="an undamaged file",
            hint="transfer or export it again",
        ) from None


def _list(file: Any) -> tuple[list[str], dict[str, int]]:
    """Paths of all datasets, and the number of rows that MATLAB states for a sparse group."""
    import h5py

    names: list[str] = []
    shapes: dict[str, int] = {}
    queue = [("", file)]
    seen = 0
    while queue:
        prefix, group = queue.pop(0)
        for name in group:
            seen += 1
            if seen > OBJECTS:
                raise InputError(
                    "too many objects",
                    where=file.filename,
                    found=f"more than {OBJECTS}",
                    expected="a file of a few matrices",
                    hint="export K, M and C into a file of their own",
                )
            if not isinstance(group.get(name, getlink=True), h5py.HardLink) or name.startswith("#"):
                continue  # a link may leave the file, or lead in a circle
            item = group[name]
            if isinstance(item, h5py.Dataset):
                names.append(prefix + name)
            elif isinstance(item, h5py.Group) and prefix.count("/") < 8:
                if "MATLAB_sparse" in item.attrs:
                    shapes[prefix + name] = int(item.attrs["MATLAB_sparse"])
                queue.append((f"{prefix}{name}/", item))
    return names, shapes


def _get(file: Any, name: str) -> NDArray[Any]:
    item = file[name]
    where = f"{file.filename}, {name}"
    settings = item.id.get_create_plist()
    filters = [settings.get_filter(i)[0] for i in range(settings.get_nfilters())]
    if item.external or item.is_virtual or not set(filters) <= set(_FILTERS):
        raise InputError(
            "data that lie elsewhere, or are compressed by a plug-in",
            where=where,
            found=f"filters {filters}" if not set(filters) <= set(_FILTERS) else "external or virtual storage",
            expected="plain data, or gzip",
            hint="h5repack -f GZIP=4 rewrites the file",
        )
    size = item.size * item.dtype.itemsize if item.size else 0
    if size > BUDGET or (not filters and size > item.id.get_storage_size()):
        raise InputError(
            "it claims more data than it holds, or than fits",
            where=where,
            found=f"{size} bytes claimed, {item.id.get_storage_size()} stored",
            expected=f"at most {BUDGET} bytes, all of them stored",
            hint="store large matrices sparse (data, indices, indptr); otherwise the file is damaged",
        )
    import h5py

    if h5py.check_string_dtype(item.dtype) is not None:
        claimed, length = 0 if filters else _texts_claim(item), os.path.getsize(file.filename)
        if claimed > length:
            raise InputError("its texts claim more than the file holds", where=where, found=f"{claimed} bytes",
                             expected=f"at most {length}", hint="transfer or export it again")  # fmt: skip
        text = item.asstr(errors="replace")[()]
        return np.atleast_1d(np.array(text, dtype=str))
    if item.dtype.names == ("real", "imag"):  # how MATLAB writes complex numbers
        pair = item[()]
        values = np.empty(np.shape(pair), np.result_type(pair["real"], np.complex64))
        values.real, values.imag = pair["real"], pair["imag"]
        return values
    if item.dtype.kind not in "biufcS":
        raise InputError(
            "values of a type that is not read",
            where=where,
            found=str(item.dtype)[:80],
            expected="numbers or text",
            hint="write plain arrays",
        )
    return np.asarray(item[()])


HDF5_MARKS = (b"\x00\x02IM", b"\x02\x00MI")


@dataclass(frozen=True, eq=False)
class MatFile:
    """Arrays of a MAT file.

    Parameters
    ----------
    path : str
    arrays : dict of str to array
        Numbers, real or complex, and texts.
    others : dict of str to str
        Variables that are no such arrays (cell, struct, ...) and what they are.
    """

    path: str
    arrays: dict[str, NDArray[Any]]
    others: dict[str, str] = field(default_factory=dict)

    def named(self, name: str, what: str) -> NDArray[Any]:
        """An array of numbers by its name.

        Raises
        ------
        InputError
            If there is none of this name, or it holds no numbers; the message lists those that there are.
        """
        found = self.arrays.get(name)
        if found is not None and found.dtype.kind in "fiuc":
            return found
        word = self.others.get(name, "text" if found is not None else "")
        listed = [f"{k} {'x'.join(map(str, v.shape))}" for k, v in self.arrays.items() if v.dtype.kind in "fiuc"]
        raise InputError(
            f"{name} is a {word}, no array of numbers" if word else f"there is no array {name}",
            where=self.path,
            found=", ".join(listed[:20]) or "no array of numbers",
            expected=f"the array of the {what}",
            hint="save plain arrays: H = FRF.H; save('x.mat', 'H', 'f')" if word else "name one of these",
        )


def is_mat73(head: bytes) -> bool:
    """Whether the first 128 bytes are those of a MAT file of version 7.3, which is an HDF5 file."""
    return len(head) >= 128 and head[124:128] in HDF5_MARKS


def read_mat(path: str | os.PathLike[str]) -> MatFile:
    """Arrays of a MAT file (-v6, -v7, -v7.3).

    Raises
    ------
    InputError
        The file is missing, truncated or damaged, of level 4, or unpacks to more than may be read.
    """
    place = as_path(path)
    try:
        with place.open("rb") as file:
            head = file.read(128)
            size = place.stat().st_size
            data = head + file.read() if is_level5(head) and size <= LEVEL5_BUDGET else b""
    except OSError as error:
        raise InputError(
            "the file cannot be read", where=str(place), found=error.strerror or error, hint="check the path"
        ) from None
    if data:
        return MatFile(str(place), *read_level5(data, str(place)))
    if not is_mat73(head):
        raise InputError(
            "no MAT file that is read",
            where=str(place),
            found=f"{size} bytes that begin with {head[:20]!r}",
            expected="a MAT file of version 6, 7 or 7.3",
            hint="save it again: save('x.mat', '-v7')",
        )
    container = open_hdf5(place)
    arrays: dict[str, NDArray[Any]] = {}
    others: dict[str, str] = {}
    for name, get in container.arrays.items():
        if "/" in name:
            others[name.partition("/")[0]] = "struct"
            continue
        try:
            arrays[name] = np.asarray(get()).T  # MATLAB writes its columns first
        except InputError as error:
            if "of a type that is not read" not in error.what:
                raise
            others[name] = "cell or object"
    return MatFile(str(place), arrays, others)
