"""Result and model files: nested dictionaries in HDF5, written whole or not at all, and never read when damaged.

A file is a 512-byte block of text (name of the format, version, kind, sha256) followed by plain HDF5, which any HDF5
tool opens. The hash covers the kind and everything after the block; it is checked before HDF5 sees a byte.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import secrets
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

MAGIC = "loadid-hdf5"
VERSION = 1
HDF5 = (".h5", ".hdf5")  # suffixes of files that `write` writes; a name without any is taken too
BLOCK = 512  # smallest user block that HDF5 allows
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")  # of the net; a drive of Windows has one letter
_DEPTH = 64
_FLETCHER32 = 3  # HDF5's number of that filter; the only one that is written or read
_SCALARS = {bool: "bool", int: "int", float: "float", complex: "complex", str: "str"}


def write(path: str | os.PathLike[str], tree: Mapping[str, Any], kind: str) -> None:
    """Write a nested dictionary to one file, whole or not at all.

    Parameters
    ----------
    path : path
        File to write or to replace. On any error the old file stays as it was and nothing new is left.
    tree : dict
        Keys are text; values are arrays (bool, integer, real, complex), text, numbers, None, dictionaries, and lists
        or tuples of these. Tuples are read back as lists; everything else comes back as it was, bit for bit.
    kind : str
        What the file is, ``"estimate"`` or ``"measured model"`` for example; `read` asks for it.

    Raises
    ------
    InputError
        If something in the tree cannot be stored, the name ends in another suffix than `HDF5`, or the file cannot be
        written.
    """
    path = as_path(path)
    require_suffix(path, HDF5)
    body = _encode(tree, str(path))
    replace(path, _block(kind, _digest(kind, body)) + body)


def read(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Read a file that `write` wrote.

    Raises
    ------
    InputError
        If the file is missing, is of another kind or version, or differs from what was written by a single bit.
    """
    found, data = _verified(as_path(path))
    if found != kind:
        article = {"load estimate": "a result", "measured model": "a model"}
        words = article.get(found, found), article.get(kind, kind)
        raise InputError(
            f"another kind of file: this is {words[0]}, not {words[1]}",
            where=str(path),
            found=found,
            expected=kind,
            hint=f"give the file of {words[1]}",
        )
    return _decode(data, str(path))


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Kind of a file that `write` wrote, or None where it is some other file.

    Raises
    ------
    InputError
        If the file is missing or damaged.
    """
    path = as_path(path)
    if not _bytes(path, BLOCK).startswith(MAGIC.encode()):
        return None
    return _verified(path)[0]


def as_path(path: str | os.PathLike[str]) -> Path:
    """The argument as a path; ``~`` is the home of who asks, also where no shell has put it in.

    Raises
    ------
    InputError
        If it is none, or empty, or an address of the net.
    """
    if not isinstance(path, str | os.PathLike):
        raise InputError(
            "this is no path",
            where="path",
            found=f"an object of type {type(path).__name__}",
            expected="a file name",
            hint="name a file",
        )
    if not os.fspath(path):
        raise InputError("the path is empty", where="path", expected="a file name", hint="name a file")
    text = os.fsdecode(path)
    if ADDRESS.match(text):
        raise InputError("this is an address, not a file", where=text, expected="a file on this machine",
                         hint="download it first, and name the file")  # fmt: skip
    try:
        return Path(text).expanduser()
    except RuntimeError:  # ~name of nobody
        return Path(text)


def require_suffix(path: Path, suffixes: Sequence[str], *, where: str = "") -> None:
    """Nothing, if a name ends as what is written there does, or has no suffix.

    Raises
    ------
    InputError
        Another suffix: the file would be taken for what it is not.
    """
    if path.suffix and path.suffix.lower() not in suffixes:
        raise InputError(
            "the suffix is not that of what is written",
            where=where or str(path),
            found=path.suffix,
            expected=" or ".join(suffixes),
            hint=f"name it {path.with_suffix(suffixes[0]).name}",
        )


def require_target(path: Path, *, where: str = "") -> None:
    """Nothing, if `replace` may put a file there: nothing is there yet, or a plain file.

    Raises
    ------
    InputError
        A folder; a device, a pipe or a socket, which a file would replace; a link, which would be parted from its file.
    """
    try:
        mode = path.lstat().st_mode
    except OSError:  # not there, or not to be seen: `replace` meets it
        return
    if stat.S_ISREG(mode):
        return
    kinds = {stat.S_IFDIR: "a folder", stat.S_IFLNK: "a link", stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket"}
    kind = kinds.get(stat.S_IFMT(mode), "a device")
    hint = {"a folder": "add a file name", "a link": f"name the file itself: {path.resolve()}"}
    raise InputError(
        f"this is {kind}",
        where=where or str(path),
        expected="a file to write, new or to be replaced",
        hint=hint.get(kind, "name a file"),
    )


# -- the file as bytes ------------------------------------------------------------------------------------------------
def _block(kind: str, digest: str) -> bytes:
    if not kind or "\n" in kind or not kind.isascii() or len(kind) > 64:
        raise InputError("no name for a kind of file", where="kind", found=repr(kind), expected="1 to 64 ASCII letters")
    text = f"{MAGIC}\nformat {VERSION}\nkind {kind}\nsha256 {digest}\n"
    return text.encode().ljust(BLOCK, b"\0")


def _digest(kind: str, body: bytes | memoryview) -> str:
    hasher = hashlib.sha256(kind.encode() + b"\n")
    hasher.update(body)
    return hasher.hexdigest()


def _bytes(path: Path, size: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(size)
    except FileNotFoundError:
        raise InputError("no such file", where=str(path), hint="check the path") from None
    except OSError as error:
        raise InputError(
            "the file cannot be read",
            where=str(path),
            found=error.strerror or error,
            hint="name a file that may be read",
        ) from error


def _verified(path: Path) -> tuple[str, bytes]:
    """Kind and bytes of a file whose every bit is as written."""
    damaged = "write it again from its source, or take a copy"
    head = _bytes(path, BLOCK)
    lines = head.split(b"\n")
    if lines[0] != MAGIC.encode() or len(lines) < 5:
        raise InputError(
            "not a file of this package, or damaged in its first bytes",
            where=str(path),
            found=repr(head[:16]),
            expected=f"a file that begins with {MAGIC!r}",
            hint="give a model of loadid calibrate or a result of loadid identify; " + damaged,
        )
    if lines[1] != f"format {VERSION}".encode():
        raise InputError(
            "unknown format version",
            where=str(path),
            found=repr(lines[1].decode("latin-1")),
            expected=f"'format {VERSION}'",
            hint="a newer release of the package may have written it; otherwise it is damaged: " + damaged,
        )
    data = _bytes(path)
    kind = lines[2].removeprefix(b"kind ").decode("latin-1")
    body = data[BLOCK:]
    try:
        expected = _block(kind, _digest(kind, body))
    except (InputError, UnicodeError):
        expected = b""
    if data[:BLOCK] != expected:
        raise InputError(
            "the file is damaged: its sha256 is not the one written with it",
            where=str(path),
            found=f"{len(data)} bytes",
            hint=damaged,
        )
    return kind, data


def replace(path: Path, data: bytes) -> None:
    """Put `data` at `path`, whole or not at all: temporary file, fsync, rename, fsync of the folder.

    Raises
    ------
    InputError
        If the file cannot be written, the old one is untouched; if something that is no plain file is there.
    """
    path = as_path(path)
    require_target(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        try:
            with temporary.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            os.replace(temporary, path)
            _sync_folder(path.parent)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise InputError(
            "the file cannot be written",
            where=str(path),
            found=error.strerror or error,
            hint="check that the folder exists, may be written and has space; the old file, if any, is untouched",
        ) from error


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":  # folders cannot be opened elsewhere
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


# -- tree to HDF5 -----------------------------------------------------------------------------------------------------
def _encode(tree: Mapping[str, Any], where: str) -> bytes:
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
def _decode(data: bytes, where: str) -> dict[str, Any]:
    """Tree of verified bytes. A hash is no signature: whoever made the file, it may only hold what `write` makes."""
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
    if kind == "array":
        return item[...]
    if kind in ("str", "list of str"):
        return item.asstr()[()] if kind == "str" else item.asstr()[()].tolist()
    if kind in {*_SCALARS.values(), *(f"list of {name}" for name in _SCALARS.values())}:
        return item[()].tolist()
    raise InputError("not an object that this package writes", where=where, found=repr(kind))
