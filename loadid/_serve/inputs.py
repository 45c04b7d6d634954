"""Where samples come from: files that grow, sockets, and by `brokers` the messages of brokers. None of them waits."""

from __future__ import annotations

import errno
import logging
import os
import selectors
import socket
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from structures.errors import InputError

from .._stream.sources import GrowingFile
from .plan import Address, LiveAsset

PIECE = 1 << 16  # bytes read at once
MOST = 1 << 20  # bytes of one source in one round: the others have their turn
SOONEST, LATEST = 1.0, 30.0  # s from a lost connection to the next try, at first and at last
PATIENCE = 10.0  # s for a connection to be made
log = logging.getLogger(__name__)


class Received(NamedTuple):
    """Bytes that came for a structure.

    Parameters
    ----------
    to : str
        Name of the structure.
    data : bytes
    key : str
        By which a message is known again that is sent twice; "" for none.
    again : bool
        The broker says that it may have sent this message before.
    receipt : object
        What `Feed.confirm` takes.
    fresh : bool
        The first of a file or connection.
    """

    to: str
    data: bytes
    key: str = ""
    again: bool = False
    receipt: Any = None
    fresh: bool = False


class Feed:
    """A kind of source, of all structures that have it.

    Attributes
    ----------
    lasting : bool
        It can be read again from a place; else what comes goes through the journal.
    counts : Counter
        ``lost`` connections, ``refused`` messages, ``waited``: times that the network had to wait.
    """

    lasting = False

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def take(self) -> list[Received]:
        """What has come; does not wait."""
        raise NotImplementedError

    def confirm(self, pieces: Sequence[Received]) -> None:
        """These were answered, and the answers are in their tables."""

    def full(self) -> bool:
        """Whether more comes only after some is taken and confirmed."""
        return False

    def place(self, name: str, unread: int) -> Any:
        """Where the source of a structure stands, less the bytes that were not used; None where that means nothing."""

    def saved(self, name: str, place: Any) -> None:
        """A checkpoint on the disk holds this place."""

    def down(self) -> dict[str, str]:
        """Structures whose source is not there now, and why."""
        return {}

    def close(self) -> None:
        """Let go of everything."""


class Files(Feed):
    """Files that grow, and may not be there yet."""

    lasting = True

    def __init__(self, assets: Sequence[LiveAsset], places: dict[str, Any]) -> None:
        super().__init__()
        self._paths = {asset.name: Path(asset.source.path) for asset in assets}
        self._places = dict(places)
        self._open: dict[str, GrowingFile] = {}
        self._fresh: dict[str, bool] = {}
        self._down: dict[str, str] = {}
        self._next = 0.0

    def take(self) -> list[Received]:
        """What has come in each file."""
        self._opened()
        found = []
        for name, file in self._open.items():
            left = MOST
            try:
                while left > 0 and (data := file.read(0.0)):
                    found.append(Received(name, data, fresh=self._fresh.pop(name, False)))
                    left -= len(data)
                self._down.pop(name, None)
            except OSError as error:  # it is tried again in the next round
                self._down[name] = f"{error.strerror or error}: {self._paths[name]}"
        return found

    def place(self, name: str, unread: int) -> Any:
        """As `GrowingFile.place`; what is left of a line is none of a new file of which nothing has come yet."""
        if name not in self._open:
            return self._places.get(name)
        return self._open[name].place(0 if self._fresh.get(name) else unread)

    def down(self) -> dict[str, str]:
        """Files that are not there."""
        gone = [name for name in self._open if not self._paths[name].exists()]
        return {name: f"no such file any more: {self._paths[name]}" for name in gone} | self._down

    def close(self) -> None:
        """Close the files."""
        for file in self._open.values():
            file.close()

    def _opened(self) -> None:
        if len(self._open) == len(self._paths) or time.monotonic() < self._next:
            return
        self._next = time.monotonic() + SOONEST
        for name, path in self._paths.items():
            if name in self._open:
                continue
            if path.exists() and not path.is_file():  # to open a pipe waits for its sender
                self._down[name] = f"no file that grows: {path}"
                continue
            try:
                self._open[name] = GrowingFile(path, self._places.get(name), lambda n=name: self._turned(n))  # type: ignore[misc]
                self._down.pop(name, None)
            except InputError as error:
                self._down[name] = f"{error.found}: {path}"

    def _turned(self, name: str) -> None:
        self._fresh[name] = True


@dataclass
class _Line:
    """A connection, or the want of one."""

    name: str
    address: Address
    socket: socket.socket | None = None
    made: bool = False
    fresh: bool = True
    since: float = 0.0
    wait: float = 0.0
    tries: int = 0
    why: str = "not connected yet"


class Sockets(Feed):
    """Connections to ``tcp://HOST:PORT``, made again where they break."""

    def __init__(self, assets: Sequence[LiveAsset]) -> None:
        super().__init__()
        self._lines = {asset.name: _Line(asset.name, asset.source) for asset in assets}
        self._ready = selectors.DefaultSelector()

    def take(self) -> list[Received]:
        """What has come on all connections."""
        now, found = time.monotonic(), []
        for line in self._lines.values():
            if line.socket is None and now >= line.since:
                self._call(line, now)
            elif line.socket is not None and not line.made and now - line.since > PATIENCE:
                self._lose(line, "nobody answers")
        for key, _ in self._ready.select(0.0) if self._ready.get_map() else ():
            line = key.data
            if not line.made:
                self._answer(line)
                continue
            data = self._received(line)
            if data:
                found.append(Received(line.name, data, fresh=line.fresh))
                line.fresh = False
        return found

    def down(self) -> dict[str, str]:
        """Connections that are not there."""
        return {n: f"{line.why}: {line.address}" for n, line in self._lines.items() if not line.made}

    def close(self) -> None:
        """Close the connections."""
        for line in self._lines.values():
            if line.socket is not None:
                line.socket.close()
        self._ready.close()

    def _call(self, line: _Line, now: float) -> None:
        try:
            found = socket.getaddrinfo(line.address.host, line.address.port, type=socket.SOCK_STREAM)
            family, kind, protocol, _, where = found[line.tries % len(found)]  # a name may have several
            line.tries += 1
            line.socket, line.since = socket.socket(family, kind, protocol), now
            line.socket.setblocking(False)
            code = line.socket.connect_ex(where)
        except OSError as error:
            self._lose(line, error.strerror or str(error))
            return
        if code not in (0, errno.EINPROGRESS, errno.EWOULDBLOCK):
            self._lose(line, os.strerror(code).lower())
            return
        self._ready.register(line.socket, selectors.EVENT_WRITE, line)

    def _answer(self, line: _Line) -> None:
        assert line.socket is not None
        code = line.socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
        if code:
            self._lose(line, os.strerror(code).lower())
            return
        line.made, line.fresh, line.wait, line.why = True, True, 0.0, ""
        line.tries -= 1  # this one again
        self._ready.modify(line.socket, selectors.EVENT_READ, line)

    def _received(self, line: _Line) -> bytes:
        assert line.socket is not None
        parts, size = [], 0
        try:
            while size < MOST and (data := line.socket.recv(PIECE)):
                parts.append(data)
                size += len(data)
            if size < MOST:
                self._lose(line, "the other side has closed the connection")
        except BlockingIOError:
            pass
        except OSError as error:
            self._lose(line, error.strerror or str(error))
        return b"".join(parts)

    def _lose(self, line: _Line, why: str) -> None:
        if line.made:
            self.counts["lost"] += 1
            log.warning("%s: connection to %s lost: %s", line.name, line.address, why)
        elif line.wait == SOONEST:  # the second time: a name may have two addresses
            log.warning("%s: no connection to %s: %s; tried again until there is one", line.name, line.address, why)
        if line.socket is not None:
            with suppress(KeyError, ValueError):
                self._ready.unregister(line.socket)
            line.socket.close()
        line.socket, line.made, line.why = None, False, why
        line.wait = min(max(2 * line.wait, SOONEST), LATEST)
        line.since = time.monotonic() + line.wait
