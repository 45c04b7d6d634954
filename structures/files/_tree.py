"""Nested dictionaries as HDF5, and as plain data with arrays beside it, as a child process hands them over."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

BLOCK = 512  # smallest user block that HDF5 allows
_DEPTH = 64
_FLETCHER32 = 3  # HDF5's number of that filter; the only one that is written or read
_SCALARS = {bool: "bool", int: "int", float: "float", complex: "complex", str: "str"}


# -- tree to HDF5 -----------------------------------------------------------------------------------------------------
def encode(tree: Mapping[str, Any], where: str) -> bytes:
    """All of a file but its first `BLOCK` bytes.

    Raises
    ------
    InputError
        What cannot be stored.
    """
    import h5py

    # HDF5 writes into memory: a full disk is then met by plain file calls, which fail cleanly
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", userblock_size=BLOCK, track_order=True) as file:
        file.attrs["is"] = "dict"
        _put_all(file, tree, where, 0)
    return buffer.getvalue()[BLOCK:]


def _put_all(group: Any, tree: Mapping[str, Any], where: str, depth: int) -> None:
    if depth > _DEPTH:
        raise InputError("nested too deeply", where=where, found=f"more than {_DEPTH} levels")
    for key, value in tree.items():
        if not isinstance(key, str):
            raise InputError("a key is not text", where=where, found=repr(key), expected="text")
        try:
            _put(group, _escape(key), value, f"{where}/{key}", depth)
        except UnicodeError as error:
            raise InputError("text that is not Unicode", where=f"{where}/{key!r}", found=str(error)) from error


def _put(group: Any, name: str, value: Any, where: str, depth: int) -> None:
    import h5py

    if isinstance(value, np.generic):
        value = value.item()
    if value is None:
        _dataset(group, name, "none", data=h5py.Empty("f8"))
    elif isinstance(value, np.ndarray):
        _put_array(group, name, value, where)
    elif isinstance(value, Mapping):
        child = group.create_group(name, track_order=True)
        child.attrs["is"] = "dict"
        _put_all(child, value, where, depth + 1)
    elif isinstance(value, list | tuple):
        _put_list(group, name, list(value), where, depth)
    elif type(value) in _SCALARS:
        _dataset(group, name, _SCALARS[type(value)], data=_atom(value, where))
    else:
        raise InputError(
            "a value of this type cannot be stored",
            where=where,
            found=type(value).__name__,
            expected="an array, text, a number, None, a dictionary or a list of these",
        )


def _put_array(group: Any, name: str, value: np.ndarray, where: str) -> None:
    if value.dtype.kind not in "biufc":
        raise InputError(
            "an array of this type cannot be stored", where=where, found=value.dtype, expected="numbers or booleans"
        )
    chunked = value.ndim > 0 and value.size > 0  # HDF5 has checksums on chunks only; the sha256 covers the rest
    _dataset(group, name, "array", data=value, **({"fletcher32": True, "chunks": True} if chunked else {}))


def _put_list(group: Any, name: str, value: list[Any], where: str, depth: int) -> None:
    """A list of numbers or of text of one type is one dataset; any other list is a group of numbered items."""
    value = [v.item() if isinstance(v, np.generic) else v for v in value]
    types = {type(v) for v in value}
    if len(types) == 1 and types <= set(_SCALARS):
        kind = types.pop()
        dtype = {bool: "?", int: "i8", float: "f8", complex: "c16"}.get(kind)
        data = [_atom(v, where) for v in value]
        if dtype is None:
            _dataset(group, name, "list of str", data=data)
        else:
            _dataset(group, name, f"list of {_SCALARS[kind]}", data=np.array(data, dtype), fletcher32=True, chunks=True)
        return
    child = group.create_group(name, track_order=True)
    child.attrs["is"] = "list"
    _put_all(child, {str(i): v for i, v in enumerate(value)}, where, depth + 1)


def _atom(value: Any, where: str) -> Any:
    if type(value) is int and not -(2**63) <= value < 2**63:
        raise InputError("an integer is too large to store", where=where, found=value, expected="64 bits")
    if type(value) is str and "\0" in value:
        raise InputError("text with a NUL character cannot be stored", where=where, found=repr(value[:60]))
    return value


def _dataset(group: Any, name: str, kind: str, **settings: Any) -> None:
    group.create_dataset(name, **settings).attrs["is"] = kind


def _escape(key: str) -> str:
    """A key as an HDF5 link name: no slash, no lone dot, not empty."""
    if key in ("", ".", "..") or any(c in key for c in "%/\0"):
        return "%" + key.replace("%", "%25").replace("/", "%2F").replace("\0", "%00")
    key.encode()  # raises here, with the name of the key, where the text is no Unicode
    return key


def _unescape(name: str) -> str:
    return name[1:].replace("%00", "\0").replace("%2F", "/").replace("%25", "%") if name.startswith("%") else name


# -- HDF5 to tree -----------------------------------------------------------------------------------------------------
def decode(data: bytes, where: str) -> dict[str, Any]:
    """Tree of verified bytes. A hash is no signature: whoever made the file, it may only hold what `encode` makes.

    Raises
    ------
    InputError
        Anything else.
    """
    import h5py

    try:
        with h5py.File(io.BytesIO(data), "r") as file:
            tree: dict[str, Any] = _get(
                file["/"], where, set()
            )  # the file itself lists its members by name in h5py 3.11
            return tree
    except InputError:
        raise
    except Exception as error:  # HDF5 raises OSError, KeyError, RuntimeError, ValueError, ... on what it cannot read
        raise InputError("HDF5 cannot read it", where=where, found=f"{type(error).__name__}: {error}") from error


def _get(item: Any, where: str, seen: set[int]) -> Any:
    import h5py

    address = h5py.h5o.get_info(item.id).addr
    if address in seen or len(seen) > 10**6:
        raise InputError("an object is linked twice", where=where, expected="a tree")
    seen.add(address)
    kind = item.attrs.get("is")
    if isinstance(item, h5py.Dataset):
        return _get_dataset(item, kind, where)
    if not isinstance(item, h5py.Group) or kind not in ("dict", "list"):
        raise InputError("not an object that this package writes", where=where, found=f"{item!r}, {kind!r}")
    children: dict[str, Any] = {}
    for name in item:
        if not isinstance(item.get(name, getlink=True), h5py.HardLink):
            raise InputError("a link that may leave the file", where=f"{where}/{name}", expected="a hard link")
        children[_unescape(name)] = _get(item[name], f"{where}/{name}", seen)
    return children if kind == "dict" else list(children.values())


def _get_dataset(item: Any, kind: Any, where: str) -> Any:
    settings = item.id.get_create_plist()
    filters = [settings.get_filter(i)[0] for i in range(settings.get_nfilters())]
    if item.external or item.is_virtual or any(f != _FLETCHER32 for f in filters):
        raise InputError("data that lie elsewhere or are compressed", where=where, expected="plain data")
    if kind == "none":
        return None
    if item.size * item.dtype.itemsize > item.id.get_storage_size():  # before anything of that size is allocated
        raise InputError(
            "it claims more data than it holds",
            where=where,
            found=f"{item.id.get_storage_size()} bytes",
            expected=f"{item.size} x {item.dtype.itemsize} bytes",
        )
    if kind == "array" and item.dtype.kind in "biufc":
        return item[...]
    if kind in ("str", "list of str"):
        return item.asstr()[()] if kind == "str" else item.asstr()[()].tolist()
    if kind in {*_SCALARS.values(), *(f"list of {name}" for name in _SCALARS.values())}:
        return item[()].tolist()
    raise InputError("not an object that this package writes", where=where, found=repr(kind))


# -- tree to plain data and arrays -------------------------------------------------------------------------------------
def taken_apart(tree: Any) -> tuple[Any, list[NDArray[Any]]]:
    """A tree as what JSON takes, and its arrays in order; `put_together` is its inverse."""
    arrays: list[NDArray[Any]] = []
    return _plain(tree, arrays), arrays


def _plain(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, dict):
        return {"dict": [[k, _plain(v, arrays)] for k, v in value.items()]}
    if isinstance(value, list):
        return [_plain(v, arrays) for v in value]
    if isinstance(value, complex):
        return {"complex": [value.real, value.imag]}
    if isinstance(value, np.ndarray | np.generic):
        arrays.append(np.asarray(value))
        return {"array": None}
    return value


def put_together(data: Any, arrays: list[NDArray[Any]]) -> Any:
    """The tree that was `taken_apart`."""
    return _tree(data, iter(arrays))


def _tree(data: Any, arrays: Iterator[NDArray[Any]]) -> Any:
    if isinstance(data, list):
        return [_tree(v, arrays) for v in data]
    if not isinstance(data, dict):
        return data
    if "complex" in data:
        return complex(*data["complex"])
    return next(arrays) if "array" in data else {k: _tree(v, arrays) for k, v in data["dict"]}
