"""Where samples come from: a growing file, a folder, standard input, a TCP socket. All give bytes as they come."""

from __future__ import annotations

import hashlib
import logging
import os
import queue
import socket
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from io import FileIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from structures.errors import InputError

from .._folders import listed

if TYPE_CHECKING:
    from .._folders import Folder

PIECE = 1 << 16  # bytes read at once
ROWS = 4096  # samples of a folder handed on at once
QUEUED = 64  # pieces that may wait between source and filter
WAITING = 0.02  # s between two looks at a file that has not grown
HEAD = 4096  # bytes by which a file is known again
PATIENCE = 10.0  # s for a connection to be made
log = logging.getLogger(__name__)


class ByteSource(Protocol):
    """Bytes as they come.

    Attributes
    ----------
    counts : Counter
        ``waited`` (times that the source had to wait for the filter), ``rotated`` files.
    seekable : bool
        Whether it can go on from where it stood; else what comes again is told by its time stamps.
    """

    counts: Counter[str]
    seekable: bool

    def read(self, timeout: float) -> bytes | None:
        """What has come, ``b""`` where nothing has within `timeout` s, None after the end.

        Raises
        ------
        InputError
            The source broke off; all that had come before was given.
        """

    @property
    def share(self) -> float | None:
        """How much of what is there has been read, 0 to 1; None where that is not known."""

    def place(self, unread: int) -> dict[str, Any] | None:
        """Where it stands, less the bytes that were not used; None where that means nothing."""

    def close(self) -> None:
        """Let go of it."""


def open_source(
    where: str, place: dict[str, Any] | None = None, fresh: Callable[[], None] | None = None,
    units: Mapping[str, str] | None = None,
) -> ByteSource:  # fmt: skip
    """A file or named pipe, a folder of files, ``-`` for standard input, or ``tcp://HOST:PORT``.

    Parameters
    ----------
    where : str
    place : dict, optional
        Where a file stood (`ByteSource.place`).
    fresh : callable, optional
        Called where another file begins under the same name.
    units : mapping, optional
        Units of the channels of a folder whose files do not state them.

    Raises
    ------
    InputError
        A file that is not there, a folder that makes no record, standard input that is closed, a socket that nobody
        serves.
    """
    if where == "-":
        pipe = _standard_input()
        return Pumped(lambda: os.read(pipe, PIECE), lambda: None, where=where)
    if where.startswith("tcp://"):
        return connected(where)
    if Path(where).is_dir():
        return Pumped(_pieced(Path(where), units), lambda: None, where=where)
    if _is_pipe(Path(where)):
        return Pumped(_received(Path(where)), lambda: None, where=where)
    return GrowingFile(Path(where), place, fresh)


def require_source(where: str) -> None:
    """Nothing, where `where` can be a source: said before anything takes time.

    Raises
    ------
    InputError
        A file that cannot be read, no address of a socket.
    """
    if where.startswith("tcp://"):
        _address(where)
    elif where == "-":
        _standard_input()
    elif Path(where).is_dir():
        listed(Path(where))
    elif not _is_pipe(Path(where)):  # to open that and leave it would end its sender
        _opened(Path(where)).close()


def _standard_input() -> int:
    """Its descriptor."""
    if sys.stdin is None:
        raise InputError("standard input is closed", where="-", expected="lines of numbers",
                         hint="send them through a pipe, or name a file")  # fmt: skip
    return sys.stdin.buffer.fileno()


def _received(path: Path) -> Callable[[], bytes]:
    """Reads a named pipe, and lets go of it at its end; it waits for a sender where it reads, not where it is made."""
    opened: list[FileIO] = []

    def receive() -> bytes:
        if not opened:
            opened.append(path.open("rb", buffering=0))
        data = opened[0].read(PIECE) or b""
        if not data:
            opened[0].close()
        return data

    return receive


def _pieced(path: Path, units: Mapping[str, str] | None) -> Callable[[], bytes]:
    """Reads the record that the files of a folder make, in pieces, as lines of text in the units of the files."""
    from .._readers import read_folder

    stated: dict[str | int, Any] = {str(name): unit for name, unit in (units or {}).items()}
    folder = read_folder(path, units=stated or None)
    for note in folder.outline.notes[1:]:  # the first one counts the files
        log.warning("%s: %s", path, note)
    lines = _lines(folder)

    def receive() -> bytes:
        try:
            return next(lines, b"")
        except InputError as error:
            raise OSError(str(error)) from error

    return receive


def _lines(folder: Folder) -> Iterator[bytes]:
    """A heading, then rows: UTC in s since 1970 where it is known, else s after the first sample; gaps have none."""
    from structures import units

    headed, seen = False, 0  # samples: files that state no start follow one another without gaps
    for piece in folder.pieces(ROWS):
        if not headed:
            names = [f"{label} [{unit}]" for label, unit in zip(piece.labels, piece.units, strict=True)]
            yield (",".join(["time [s]", *names]) + "\n").encode()
            headed = True
        read = [units.from_si(x, units.stated(u)) for x, u in zip(piece.values.T, piece.units, strict=True)]
        times = (seen * piece.dt if piece.start is None else piece.start) + piece.time
        seen += len(piece)
        rows = [
            ",".join([repr(t), *("" if x != x else repr(x) for x in row)])
            for t, row in zip(times.tolist(), np.column_stack(read).tolist(), strict=True)
            if any(x == x for x in row)
        ]
        yield ("\n".join(rows) + "\n").encode()


def _is_pipe(path: Path) -> bool:
    """Whether a name leads to a named pipe or a device: neither file nor folder."""
    return path.exists() and not path.is_file() and not path.is_dir()


def _opened(path: Path) -> FileIO:
    try:
        return path.open("rb", buffering=0)
    except OSError as error:
        raise InputError("the stream cannot be read", where=str(path), found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip


class GrowingFile:
    """A file that is read while it is written, rotated or emptied.

    A name that leads to another file, or to a shorter one, means a new file: the old one is read to its end first.
    """

    seekable = True

    def __init__(self, path: Path, place: dict[str, Any] | None = None, fresh: Callable[[], None] | None = None):
        self.path, self.counts = path, Counter()  # type: ignore[var-annotated]
        self._fresh = fresh or (lambda: None)
        self._file = _opened(path)
        self._at = 0
        if place is not None:
            at = int(place["at"])
            if self._head(at) == place["head"]:
                self._at = at
                self._file.seek(at)
            else:
                self.counts["rotated"] += 1
                self._fresh()
                log.warning("%s is another file than the one that was read before: it is read from its begin", path)

    def read(self, timeout: float) -> bytes | None:
        """As `ByteSource.read`; a file never ends."""
        end = time.monotonic() + timeout
        while True:
            data = self._file.read(PIECE)
            if data:
                self._at += len(data)
                return data
            if self._turned():
                continue
            if time.monotonic() >= end:
                return b""
            time.sleep(min(WAITING, max(end - time.monotonic(), 0.0)))

    @property
    def share(self) -> float:
        """As `ByteSource.share`."""
        return self._at / max(os.fstat(self._file.fileno()).st_size, 1)

    def place(self, unread: int) -> dict[str, Any] | None:
        """Offset, and what stands at the begin."""
        at = self._at - unread
        return {"at": at, "head": self._head(at)}

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _head(self, at: int) -> str:
        """Digest of the begin of the file, as far as it was read."""
        here = self._file.tell()
        self._file.seek(0)
        data = self._file.read(min(at, HEAD))
        self._file.seek(here)
        return f"{len(data)}:{hashlib.sha256(data).hexdigest()}"

    def _turned(self) -> bool:
        """Whether another file began, and is open now."""
        try:
            there, here = self.path.stat(), os.fstat(self._file.fileno())
            return self._another(there, here)
        except FileNotFoundError:  # between two files
            return False

    def _another(self, there: os.stat_result, here: os.stat_result) -> bool:
        if (there.st_ino, there.st_dev) != (here.st_ino, here.st_dev):
            if here.st_size > self._at:
                return True  # it grew before it was put aside
            file = self.path.open("rb", buffering=0)
            self._file.close()
            self._file = file
        elif here.st_size < self._at:
            self._file.seek(0)
        else:
            return False
        self._at = 0
        self.counts["rotated"] += 1
        self._fresh()
        return True


class Pumped:
    """A pipe or socket that a thread reads into a bounded queue.

    Where the queue is full the thread waits, and so does the sender; that is counted and said once.
    """

    seekable = False

    def __init__(
        self, receive: Callable[[], bytes], close: Callable[[], None], size: int = QUEUED, where: str = "stream"
    ) -> None:
        self.counts: Counter[str] = Counter()
        self.where, self._broken = where, ""
        self._receive, self._close = receive, close
        self._queue: queue.Queue[bytes | None] = queue.Queue(size)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._pump, name="stream", daemon=True)
        self._thread.start()

    def read(self, timeout: float) -> bytes | None:
        """As `ByteSource.read`."""
        try:
            data = self._queue.get(timeout=timeout) if timeout > 0 else self._queue.get_nowait()
        except queue.Empty:
            return b""
        if data is None:
            self._queue.put(None)  # for the next call
            if self._broken:
                raise InputError("the stream broke off", where=self.where, found=self._broken,
                                 hint="start the sender again, and then this command: a run with a state goes on "
                                 "where it was")  # fmt: skip
        return data

    @property
    def share(self) -> None:
        """As `ByteSource.share`: who sends does not say how much."""
        return

    def place(self, unread: int) -> dict[str, Any] | None:
        """Nowhere: a pipe cannot be read again."""
        return None

    def close(self) -> None:
        """Stop reading."""
        self._stop.set()
        self._close()

    def _pump(self) -> None:
        while not self._stop.is_set():
            try:
                data = self._receive()
            except OSError as error:
                self._broken = error.strerror or str(error)
                data = b""
            self._put(data or None)
            if not data:
                return

    def _put(self, data: bytes | None) -> None:
        try:
            self._queue.put_nowait(data)
            return
        except queue.Full:
            pass
        self.counts["waited"] += 1
        if self.counts["waited"] == 1:
            log.warning("samples come faster than they are tracked: the source is made to wait")
        while not self._stop.is_set():
            try:
                self._queue.put(data, timeout=0.1)
                return
            except queue.Full:
                continue


def connected(where: str) -> Pumped:
    """A connection to ``tcp://HOST:PORT``.

    Raises
    ------
    InputError
        No such address, nobody there.
    """
    try:
        made = socket.create_connection(_address(where), timeout=PATIENCE)
    except OSError as error:
        raise InputError("nobody answers at the socket", where=where, found=error.strerror or str(error),
                         hint="start the sender first, and check host and port") from None  # fmt: skip
    made.settimeout(None)

    def close() -> None:
        with suppress(OSError):
            made.shutdown(socket.SHUT_RDWR)
        made.close()

    return Pumped(lambda: made.recv(PIECE), close, where=where)


def _address(where: str) -> tuple[str, int]:
    """Host and port."""
    host, _, port = where.removeprefix("tcp://").rpartition(":")
    if not host or not (port.isascii() and port.isdecimal()) or not 0 < int(port) < 65536:
        raise InputError("no address of a socket", where=where, expected="tcp://HOST:PORT, with a port below 65536")
    return host.strip("[]"), int(port)
