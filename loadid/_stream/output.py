"""The table that a stream of loads is written to: it only grows, no whole line is ever cut off, one run a file.

What stands behind the place where a checkpoint saw it was written by a run that was killed. It stays where the run that
goes on makes it again; from the first line that it does not make again it stays too, and a `mark` follows it.
"""

from __future__ import annotations

import glob
import hashlib
import io
import os
import re
import sys
from collections.abc import Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]


class StateLock:
    """Holds the file of a state for one run, until it is closed; stands for its path meanwhile.

    A state is replaced as a whole by every checkpoint, so what is locked is a file beside it.

    Parameters
    ----------
    path : path

    Raises
    ------
    InputError
        Another run holds it, or its folder cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self._beside = self.path.parent.resolve() / f".{self.path.name}.lock"
        self._file = self._held()

    def __fspath__(self) -> str:
        return os.fspath(self.path)

    def __enter__(self) -> StateLock:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of it."""
        with suppress(OSError):  # a system that keeps open files keeps an empty one, which holds nobody up
            self._beside.unlink()
        self._file.close()

    def _held(self) -> BinaryIO:
        while True:
            try:
                file = self._beside.open("ab")
            except OSError as error:
                raise InputError("the state cannot be written", where=str(self.path),
                                 found=error.strerror or str(error), hint="check the path") from None  # fmt: skip
            if not taken(file):
                file.close()
                raise InputError("another run goes on from this state", where=str(self.path),
                                 expected="one run for each state",
                                 hint="end that run first, or take another state")  # fmt: skip
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(file.fileno()), self._beside.stat()):
                    return file
            file.close()  # the run that held it took it away meanwhile


def taken(file: BinaryIO) -> bool:
    """Whether no other process holds the file; this one does from now on, where the system has locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # a file system without locks
        pass
    return True


def swept(path: Path) -> None:
    """Remove what a run that was killed while it replaced a file has left beside it; no other run may write it now."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*.tmp"):
        left.unlink(missing_ok=True)


TAIL = 256  # bytes before the end by which an output is known again
LINE = 1 << 20  # bytes within which a line ends
NUMBERS = re.compile(rb"[-+.,einfa\d]*")  # of a row, whole or not


class Output:
    """A file, or a pipe.

    Parameters
    ----------
    where : str or binary file
        An open file is taken for a pipe, which cannot be read again and is left open; so is the name of a device or of
        a named pipe.
    head : sequence of str
        Names of the columns.
    place : dict, optional
        Where a checkpoint saw it (`place`).

    Raises
    ------
    InputError
        A file with a content that no checkpoint saw, or that is not, or no longer, what the checkpoint saw; that cannot
        be written; that another run writes.
    """

    def __init__(self, where: str | BinaryIO, head: Sequence[str], place: dict[str, Any] | None = None) -> None:
        self.path: Path | None = None
        self.at, self._tail, self._made = 0 if place is None else int(place["at"]), b"", False
        self._own, self._width = isinstance(where, str), len(head)
        self._first = b"" if self.at else ",".join(map(_quoted, head)).encode() + b"\n"
        self._ahead: BinaryIO | None = None  # what an earlier run wrote behind the place
        if not isinstance(where, str) or (Path(where).exists() and not Path(where).is_file()):
            if place is not None:
                _require_same("-", place)
            self._file: BinaryIO = where if not isinstance(where, str) else _opened(Path(where), "wb")
            return
        self.path = path = Path(where)
        if place is not None and not (holds(path, place) and not Path(place["where"]).exists()):  # else it was moved
            _require_same(str(path.resolve()), place)
        self._made = not path.exists()
        if place is not None and self.at and self._made:
            raise InputError("the output of the checkpoint is gone", where=str(path), expected=f"{self.at} bytes of it",
                             hint="put it back, or name the file that it was moved to")  # fmt: skip
        self._file = _opened(path, "ab" if self._made else "r+b")
        try:
            self._go_on(path, place)
        except BaseException:
            self._file.close()
            raise

    def _go_on(self, path: Path, place: dict[str, Any] | None) -> None:
        """From where the checkpoint saw the file; refuses another content."""
        size = path.stat().st_size
        if place is None and size:
            raise InputError("the output exists, and no state says that this run wrote it", where=str(path),
                             found=f"{size} bytes", expected="a new or an empty file",
                             hint="move it away, or name another file")  # fmt: skip
        begin = self._read(0, len(self._first))
        if not self._first.startswith(begin) or (self.at and not holds(path, place or {})):
            raise InputError("the output is not the one that the checkpoint saw", where=str(path),
                             found=f"{size} bytes", expected=f"at least {self.at}, as they were written",
                             hint="put it back, or name the file that it was moved to")  # fmt: skip
        self._tail = self._read(max(self.at - TAIL, 0), self.at)
        if not NUMBERS.fullmatch(self._unfinished()) and size > len(begin):
            raise InputError("the output ends in a line that no run has written", where=str(path),
                             found="no row, and no end of a line", expected="rows of numbers",
                             hint="end that line, or take it out")  # fmt: skip
        if size > self.at:
            self._ahead = path.open("rb")
            self._ahead.seek(self.at)
        self._file.seek(self.at)

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """One line a sample: time, loads, stds, with all their digits; whole numbers of its alarm, where given."""
        if len(times):
            self._begin()
            std = np.ascontiguousarray(std, float)
            ends = std.view(np.int64) if alarms is None else np.column_stack([std.view(np.int64), alarms])
            cuts = np.flatnonzero(np.any(ends[1:] != ends[:-1], axis=1)) + 1
            rows = np.column_stack([times, load]).tolist()
            tails = (
                std.tolist() if alarms is None else [a + b for a, b in zip(std.tolist(), alarms.tolist(), strict=True)]
            )
            if 4 * len(cuts) > len(rows):  # nearly each has its own end
                text = [_lines([row + tail for row, tail in zip(rows, tails, strict=True)], [])]
            else:
                parts = pairwise([0, *cuts.tolist(), len(rows)])
                text = [_lines(rows[begin:stop], tails[begin]) for begin, stop in parts]
            self._put("".join(text).encode())

    def sync(self) -> None:
        """Everything is on the disk when this returns."""
        self._begin()
        self._file.flush()
        if self.path is not None:
            try:
                os.fsync(self._file.fileno())
            except OSError as error:
                raise self._full(error) from None

    def place(self) -> dict[str, Any] | None:
        """Where it ends now."""
        if self.path is None:
            return {"where": "-", "at": self.at, "tail": ""}
        return {"where": str(self.path.resolve()), "at": self.at, "tail": _digest(self._tail)}

    def close(self) -> None:
        """Close the file; one that nothing was written to, and that was not there before, is taken away."""
        if self._ahead is not None:
            self._ahead.close()
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
            self._put(first)

    def _put(self, data: bytes) -> None:
        if self._ahead is not None:
            data = self._beyond(data)
        left = memoryview(data)
        try:
            while left:  # a raw file may take less than it is given
                left = left[self._file.write(left) :]
        except BrokenPipeError:
            raise
        except OSError as error:
            raise self._full(error) from None
        if self.path is None:
            self._file.flush()
        self._passed(data)

    def _full(self, error: OSError) -> InputError:
        return InputError("the output cannot be written", where=str(self.path or "output"),
                          found=error.strerror or str(error),
                          hint="make room and start again: a state goes on where it was")  # fmt: skip

    def _passed(self, data: bytes) -> None:
        self.at += len(data)
        self._tail = (self._tail + data[-TAIL:])[-TAIL:]

    # -- what an earlier run wrote ----------------------------------------------------------------------------------
    def _beyond(self, data: bytes) -> bytes:
        """Lines less those that stand in the file already; from the first that does not on, with a mark before it."""
        assert self._ahead is not None
        lines = io.BytesIO(data)
        for line in lines:
            old = self._ahead.readline()
            if old == line:
                self._passed(line)
                continue
            kept = b""
            if old.endswith(b"\n"):
                kept = mark(_last_time(self._read(max(self.at - LINE, 0), self.at)), self._width)
                self.at = os.fstat(self._file.fileno()).st_size - len(self._unfinished())
                self._tail = self._read(max(self.at - TAIL, 0), self.at)
            self._ahead.close()
            self._ahead = None
            self._file.truncate(self.at)  # the begin of a row that was broken off is none
            self._file.seek(self.at)
            return kept + line + lines.read()
        return b""

    def _unfinished(self) -> bytes:
        """What stands behind the last end of a line."""
        size = os.fstat(self._file.fileno()).st_size
        return self._read(max(size - LINE, 0), size).rpartition(b"\n")[2]

    def _read(self, begin: int, end: int) -> bytes:
        """Bytes of the file."""
        assert self.path is not None
        with self.path.open("rb") as file:
            file.seek(begin)
            return file.read(end - begin)


def _lines(rows: list[list[float]], end: list[float]) -> str:
    """One line a row, all with the same end: lists as `repr` writes them, each number with all its digits."""
    last = "".join(f", {number!r}" for number in end) + "\n"
    return (repr(rows)[2:-2].replace("], [", last) + last).replace(", ", ",")


def mark(time: float, width: int) -> bytes:
    """Row without answers: a run went on from its state at this time; the rows before the mark that are later stay.

    The run that went on did not make them again alike, as it did not get their samples.

    Parameters
    ----------
    time : float
        Of the last answer that both runs share; NaN where there is none.
    width : int
        Columns of the table.
    """
    return (",".join([repr(time), *["nan"] * (width - 1)]) + "\n").encode()


def _last_time(rows: bytes) -> float:
    """First number of the last line; NaN where that is the head."""
    try:
        return float(rows.rstrip(b"\n").rpartition(b"\n")[2].partition(b",")[0])
    except ValueError:
        return float("nan")


def holds(path: Path, place: dict[str, Any]) -> bool:
    """Whether a file holds what a checkpoint has written, wherever it lies now."""
    at = int(place["at"])
    if not at or not path.is_file() or path.stat().st_size < at:
        return False
    with path.open("rb") as file:
        file.seek(max(at - TAIL, 0))
        return bool(_digest(file.read(min(at, TAIL))) == place["tail"])


def _require_same(where: str, place: dict[str, Any]) -> None:
    """The output is the one of the state."""
    own = place["where"]
    if where == own:
        return
    name, words = ("- or another pipe", "standard output or another pipe") if own == "-" else (own, own)
    raise InputError("the state belongs to another output", where=f"--out {where}", expected=words,
                     hint=f"name {name} with --out (a file that was moved is known by its content), or begin a new "
                     "output with a new --state")  # fmt: skip


def _opened(path: Path, mode: str) -> BinaryIO:
    """A raw file that no other run writes."""
    try:
        file: BinaryIO = path.open(mode, buffering=0)  # type: ignore[assignment]
    except OSError as error:
        raise InputError("the output cannot be written", where=str(path), found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip
    if os.name == "posix" and path.is_file() and not taken(file):  # elsewhere a lock would keep readers out
        file.close()
        raise InputError("another run writes to this file", where=str(path), expected="one run for each output",
                         hint="end that run first, or name another file")  # fmt: skip
    return file


def _quoted(name: str) -> str:
    """A name as a cell of a table."""
    return '"' + name.replace('"', '""') + '"' if set(name) & set(',"\n') else name


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
