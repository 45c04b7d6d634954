"""The table that a stream of loads is written to: it only grows, and is cut back to where a checkpoint saw it.

An old file under its name is replaced when the first answer comes, not before: a stream that cannot be read costs none.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

TAIL = 256  # bytes before the end by which an output is known again


class Output:
    """A file, or a pipe.

    Parameters
    ----------
    where : str or binary file
        An open file is taken for a pipe, which cannot be cut back and is left open; so is the name of a device or of a
        named pipe.
    head : sequence of str
        Names of the columns.
    place : dict, optional
        Where a checkpoint saw it (`place`): what was written later is cut off.

    Raises
    ------
    InputError
        A file that is not, or no longer, what the checkpoint saw; that cannot be written; that another run writes.
    """

    def __init__(self, where: str | BinaryIO, head: Sequence[str], place: dict[str, Any] | None = None) -> None:
        self.path: Path | None = None
        self.at, self._tail, self._made = 0, b"", False
        self._own = isinstance(where, str)
        self._first = b"" if place is not None else ",".join(map(_quoted, head)).encode() + b"\n"
        if not isinstance(where, str) or (Path(where).exists() and not Path(where).is_file()):
            self._file: BinaryIO = where if not isinstance(where, str) else _opened(Path(where), "wb")
            return
        self.path = path = Path(where)
        if place is not None and place["where"] == str(path.resolve()):
            self._file = _reopened(path, int(place["at"]), str(place["tail"]))
            self.at = int(place["at"])
            self._file.seek(max(self.at - TAIL, 0))
            self._tail = self._file.read()
            return
        self._first = ",".join(map(_quoted, head)).encode() + b"\n"
        self._made = not path.exists()
        self._file = _opened(path, "ab")

    def write(self, times: NDArray, load: NDArray, std: NDArray) -> None:
        """One line a sample: time, loads, stds, with all their digits."""
        if len(times):
            self._begin()
            table = np.column_stack([times, load, std]).tolist()
            self._put("".join([",".join(map(repr, row)) + "\n" for row in table]).encode())

    def sync(self) -> None:
        """Everything is on the disk when this returns."""
        self._begin()
        self._file.flush()
        if self.path is not None:
            os.fsync(self._file.fileno())

    def place(self) -> dict[str, Any] | None:
        """Where it ends now."""
        if self.path is None:
            return {"where": "-", "at": self.at, "tail": ""}
        return {"where": str(self.path.resolve()), "at": self.at, "tail": _digest(self._tail)}

    def close(self) -> None:
        """Close the file; one that nothing was written to, and that was not there before, is taken away."""
        if self._first and self._made and self.path is not None:
            self.path.unlink(missing_ok=True)
        if self._own:
            self._file.close()
        else:
            self._file.flush()

    def _begin(self) -> None:
        """The names of the columns, where they are not written yet."""
        first, self._first = self._first, b""
        if first:
            if self.path is not None:
                self._file.truncate(0)
            self._put(first)

    def _put(self, data: bytes) -> None:
        left = memoryview(data)
        try:
            while left:  # a raw file may take less than it is given
                left = left[self._file.write(left) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            raise InputError("the output cannot be written", where=str(self.path or "output"),
                             found=error.strerror or str(error),
                             hint="make room and start again: a state goes on where it was") from None  # fmt: skip
        if self.path is None:
            self._file.flush()
        self.at += len(data)
        self._tail = (self._tail + data[-TAIL:])[-TAIL:]


def _reopened(path: Path, at: int, tail: str) -> BinaryIO:
    if not path.exists():
        raise InputError("the output of the checkpoint is gone", where=str(path), expected=f"{at} bytes of it",
                         hint="put it back, or write to a file of another name") from None  # fmt: skip
    file = _opened(path, "r+b")
    file.seek(max(at - TAIL, 0))
    found = file.read(min(at, TAIL))
    if len(found) < min(at, TAIL) or _digest(found) != tail:
        file.close()
        raise InputError("the output is not the one that the checkpoint saw", where=str(path),
                         found=f"{path.stat().st_size} bytes", expected=f"at least {at}, as they were written",
                         hint="put it back, or write to a file of another name")  # fmt: skip
    file.truncate(at)
    return file


def _opened(path: Path, mode: str) -> BinaryIO:
    """A raw file that no other run writes.

    Raises
    ------
    InputError
        One that cannot be written, or is taken.
    """
    try:
        file: BinaryIO = path.open(mode, buffering=0)  # type: ignore[assignment]
    except OSError as error:
        raise InputError("the output cannot be written", where=str(path), found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip
    if os.name == "posix" and path.is_file():
        import fcntl

        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # let go of by the system, whatever ends the process
        except BlockingIOError:
            file.close()
            raise InputError("another run writes to this file", where=str(path), expected="one run for each output",
                             hint="end that run first, or name another file with --out") from None  # fmt: skip
        except OSError:  # a file system without locks
            pass
    return file


def _quoted(name: str) -> str:
    """A name as a cell of a table."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\n') else name


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
