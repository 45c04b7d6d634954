"""Result and model files: nested dictionaries in HDF5, written whole or not at all, and never read when damaged.

A file is a 512-byte block of text (name of the format, version, kind, sha256) followed by plain HDF5, which any HDF5
tool opens. The hash covers the kind and everything after the block; it is checked before HDF5 sees a byte.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError
from ._child import Arrays, NoChildError, apart
from ._tree import BLOCK, decode, encode, put_together, taken_apart

MAGIC = "loadid-hdf5"
VERSION = 1
HDF5 = (".h5", ".hdf5")  # suffixes of files that `write` writes; a name without any is taken too
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")  # of the net; a drive of Windows has one letter


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
    body = encode(tree, str(path))
    replace(path, _block(kind, _digest(kind, body)) + body)


def read(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Read a file that `write` wrote.

    Raises
    ------
    InputError
        If the file is missing, is of another kind or version, or differs from what was written by a single bit.
    """
    place = as_path(path)
    _headed(place)  # what is none of ours is refused before a child is started
    request = {"path": str(place.absolute()), "shown": str(path), "kind": kind, "library": "h5py"}
    try:
        found = apart(f"{__name__}:read_here", request, reader="HDF5", where=str(path), size=place.stat().st_size)
    except NoChildError:
        found = read_here(request)
    tree: dict[str, Any] = put_together(*found)
    return tree


def read_here(request: Mapping[str, Any]) -> tuple[Any, Arrays]:
    """What `read` asks its child for: the tree of a file, taken apart.

    Raises
    ------
    InputError
        As `read`.
    """
    path, kind = request["shown"], request["kind"]
    found, data = _verified(Path(request["path"]))
    if found != kind:
        article = {"load estimate": "a result", "measured model": "a model"}
        words = article.get(found, found), article.get(kind, kind)
        raise InputError(
            f"another kind of file: this is {words[0]}, not {words[1]}",
            where=path,
            found=found,
            expected=kind,
            hint=f"give the file of {words[1]}",
        )
    return taken_apart(decode(data, path))


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


def require_suffix(path: Path, suffixes: Sequence[str], *, where: str = "", bare: bool = True) -> None:
    """Nothing, if a name ends as what is written there does, or has no suffix where `bare` names are taken.

    Raises
    ------
    InputError
        Another suffix, or none: the file would be taken for what it is not.
    """
    if path.suffix.lower() not in (*suffixes, *([""] if bare else [])):
        raise InputError(
            "the suffix is not that of what is written" if path.suffix else "the name has no suffix",
            where=where or str(path),
            found=path.suffix or path.name,
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


DAMAGED = "write it again from its source, or take a copy"


def _headed(path: Path) -> bytes:
    """The first line that tells its kind, of a file whose first lines are those of this release."""
    head = _bytes(path, BLOCK)
    lines = head.split(b"\n")
    if lines[0] != MAGIC.encode() or len(lines) < 5:
        raise InputError(
            "not a file of this package, or damaged in its first bytes",
            where=str(path),
            found=repr(head[:16]),
            expected=f"a file that begins with {MAGIC!r}",
            hint="give a model of loadid calibrate or a result of loadid identify; " + DAMAGED,
        )
    if lines[1] != f"format {VERSION}".encode():
        raise InputError(
            "unknown format version",
            where=str(path),
            found=repr(lines[1].decode("latin-1")),
            expected=f"'format {VERSION}'",
            hint="a newer release of the package may have written it; otherwise it is damaged: " + DAMAGED,
        )
    return lines[2]


def _verified(path: Path) -> tuple[str, bytes]:
    """Kind and bytes of a file whose every bit is as written."""
    kind = _headed(path).removeprefix(b"kind ").decode("latin-1")
    data = _bytes(path)
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
            hint=DAMAGED,
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
