"""Where the rows of a structure go: tables on the disk, messages, listeners.

Rows of a data set of files (``.parquet``, ``.h5``: a folder of parts) are written with every checkpoint, as a part that
is named by its first row; a run that goes on makes the same part again, or a longer one, under the same name.
"""

from __future__ import annotations

import importlib
import io
import socket
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.files import _storage as storage

from .._stream.output import Output, holds
from .brokers import PUBLISHERS, Publisher
from .plan import Address, LiveAsset

KIND = "tracked loads"
LISTENERS = 32  # of one structure
BEHIND = 1 << 20  # bytes that a listener may be behind, before it is left
Array = NDArray[np.float64]


class Sink(Protocol):
    """Takes rows as `Output` does."""

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """More rows."""

    def sync(self) -> None:
        """Everything is on the disk, or on its way, when this returns."""

    def place(self) -> Any:
        """Where it stands, for a checkpoint."""

    def close(self) -> None:
        """Let go of it."""


class PartFiles:
    """A folder of files, each with the rows between two checkpoints.

    Parameters
    ----------
    folder : path
    head : sequence of str
        Names of the columns.
    rows : int or None
        Rows before the first that comes, as a checkpoint knows them.

    Raises
    ------
    InputError
        A folder that cannot be made, or one with parts of which no checkpoint knows.
    """

    def __init__(self, folder: Path, head: Sequence[str], rows: int | None = None) -> None:
        self.folder, self.head, self.rows = folder, list(head), rows or 0
        self._held: list[Array] = []
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError("the folder cannot be made", where=str(folder), found=error.strerror or str(error),
                             hint="check the path") from None  # fmt: skip
        if rows is None and any(folder.glob(f"part-*{folder.suffix}")):
            raise InputError("the folder has parts, and no state says that this run wrote them", where=str(folder),
                             expected="a new or an empty folder",
                             hint="move it away, or name another one")  # fmt: skip
        for left in folder.glob(".part-*.tmp"):  # of a run that was killed while it wrote one
            left.unlink(missing_ok=True)
        if folder.suffix == ".parquet":
            _arrow(folder)

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """Keep rows for the next part."""
        self._held.append(np.column_stack([times, load, std, *([] if alarms is None else [alarms])]))

    def sync(self) -> None:
        """One more part."""
        if not sum(map(len, self._held)):
            return
        table = np.concatenate(self._held)
        path = self.folder / f"part-{self.rows:012d}{self.folder.suffix}"
        columns = {name: table[:, k] for k, name in enumerate(self.head)}
        if self.folder.suffix == ".parquet":
            arrow = _arrow(self.folder)
            data = io.BytesIO()
            arrow.write_table(importlib.import_module("pyarrow").table(columns), data)
            storage.replace(path, data.getvalue())
        else:
            storage.write(path, columns, KIND)
        self.rows += len(table)
        self._held = []

    def place(self) -> Any:
        """Rows that parts hold."""
        return self.rows

    def close(self) -> None:
        """Rows without a part are made again by the run that goes on."""


def _arrow(folder: Path) -> Any:
    try:
        return importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise InputError("Parquet needs pyarrow", where=str(folder), found="it is not installed",
                         expected="the extra 'cluster'",
                         hint="pip install 'loadid[cluster]', or name a table .csv or .h5") from None  # fmt: skip


class _Text:
    """Rows as text, the names of the columns first."""

    def __init__(self, head: Sequence[str]) -> None:
        self._head = head

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """Send rows on."""
        if not len(times):
            return
        pipe = io.BytesIO()
        Output(pipe, self._head).write(times, load, std, alarms)
        self.send(pipe.getvalue())

    def send(self, data: bytes) -> None:
        """A text that begins with the names."""
        raise NotImplementedError

    def sync(self) -> None:
        """They are on their way."""

    def place(self) -> Any:
        """Nowhere."""
        return None

    def close(self) -> None:
        """Let go of it."""


class Messages(_Text):
    """A message for each round, to a topic of a broker."""

    def __init__(self, publisher: Publisher, topic: str, head: Sequence[str]) -> None:
        super().__init__(head)
        self._publisher, self._topic = publisher, topic

    def send(self, data: bytes) -> None:
        """One message."""
        self._publisher.send(self._topic, data)


class Listeners(_Text):
    """A port to which anybody on its address may connect: names first, then rows.

    Who reads too slowly is left, and so is who comes when `LISTENERS` are there.
    """

    def __init__(self, address: Address, head: Sequence[str], counts: Counter[str]) -> None:
        super().__init__(head)
        self._counts, self._waiting = counts, dict[socket.socket, bytearray]()
        try:
            self._server = socket.create_server((address.host, address.port))
        except OSError as error:
            raise InputError("nobody can listen there", where=str(address), found=error.strerror or str(error),
                             expected="an address of this machine and a port that is free",
                             hint="name another one") from None  # fmt: skip
        self._server.setblocking(False)

    def send(self, data: bytes) -> None:
        """To all who have come."""
        rows = data.partition(b"\n")[2]
        for waiting in self._waiting.values():
            waiting += rows
        with suppress(OSError):  # nobody else is there, or he has left
            while True:
                made, _ = self._server.accept()
                if len(self._waiting) >= LISTENERS:
                    self._counts["undelivered"] += 1
                    made.close()
                    continue
                made.setblocking(False)
                self._waiting[made] = bytearray(data)
        for made, waiting in list(self._waiting.items()):
            try:
                with suppress(BlockingIOError):
                    while waiting:
                        del waiting[: made.send(waiting)]
            except OSError:
                waiting += bytes(BEHIND)
            if len(waiting) > BEHIND:
                self._counts["undelivered"] += 1
                made.close()
                del self._waiting[made]

    def close(self) -> None:
        """Leave everybody."""
        for made in (*self._waiting, self._server):
            made.close()


class Sinks:
    """All sinks of a structure, as one.

    Parameters
    ----------
    asset : LiveAsset
    head : sequence of str
        Names of the columns.
    before : mapping, optional
        Where they stood (`place`).
    publishers : dict
        Connections to brokers, which structures share.
    """

    def __init__(
        self, asset: LiveAsset, head: Sequence[str], before: Mapping[str, Any] | None,
        publishers: dict[tuple[str, str, int, str], Publisher],
    ) -> None:  # fmt: skip
        self.counts: Counter[str] = Counter()
        self._each: dict[str, Sink] = {}
        before = before or {}
        named = {str(address) for address in asset.sinks}
        moved = [place for where, place in before.items() if isinstance(place, dict) and where not in named]
        for address in asset.sinks:
            where = str(address)
            path = Path(address.path)
            if address.scheme == "file" and path.suffix == ".csv":
                known = next((place for place in moved if holds(path, place)), None)
                self._each[where] = _table(path, head, before.get(where, known))
            elif address.scheme == "file":
                self._each[where] = PartFiles(path, head, before.get(where))
            elif address.scheme == "tcp":
                self._each[where] = Listeners(address, head, self.counts)
            else:
                if address.broker not in publishers:
                    publishers[address.broker] = PUBLISHERS[address.scheme](address)
                self._each[where] = Messages(publishers[address.broker], address.path, head)

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """More rows, to every sink."""
        for sink in self._each.values():
            sink.write(times, load, std, alarms)

    def sync(self) -> None:
        """Everything is on the disk when this returns."""
        for sink in self._each.values():
            sink.sync()

    def place(self) -> dict[str, Any]:
        """Where each stands."""
        return {where: sink.place() for where, sink in self._each.items()}

    def close(self) -> None:
        """Let go of all."""
        for sink in self._each.values():
            sink.close()


def _table(path: Path, head: Sequence[str], before: Any) -> Output:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(path.parent), found=error.strerror or str(error),
                         hint="check the path") from None  # fmt: skip
    return Output(str(path), head, before)
