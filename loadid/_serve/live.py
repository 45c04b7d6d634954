"""One live structure: its tracker, what it has taken from its source, its tables, its checkpoints."""

from __future__ import annotations

import logging
import time
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .._families.tracking import tracker as checkpoint
from .._stream.clock import REGULAR
from .._stream.following import Following
from .._stream.output import swept
from .brokers import RECENT
from .inputs import Feed, Received
from .journal import JournalEntry
from .plan import BROKERS, LiveAsset
from .sinks import Sinks

MESSAGES = 1000  # late rows in a row that show a clock that was put back: fewer are messages out of order,
OVERTAKEN = 4  # as are those of fewer messages of the longest kind
ROW = tuple(b"%c" % c for c in b"+-.0123456789")  # how a message without a line of names begins
Array = NDArray[np.float64]
log = logging.getLogger(__name__)


@dataclass
class Last:
    """What the last rows said.

    Parameters
    ----------
    time : float
        Of the last row, in s; NaN before the first.
    load, std : array, shape (loads,)
    heard : float
        When something came, on the clock of `time.monotonic`.
    """

    time: float = float("nan")
    load: Array = field(default_factory=lambda: np.empty(0))
    std: Array = field(default_factory=lambda: np.empty(0))
    heard: float = 0.0


class LiveStructure:
    """A structure that is tracked.

    Parameters
    ----------
    asset : LiveAsset
    state : Path
        File of its checkpoints.
    sinks : callable
        Makes its `Sinks` from the names of columns and where they stood.

    Attributes
    ----------
    halted : str
        Why nothing more of it is tracked; "" where it is. What comes stays in the journal, or where it comes from,
        and is tracked by the run that goes on.
    dirty : bool
        Something was taken since the last checkpoint.

    Raises
    ------
    InputError
        A model that is no fitted tracker, a state of another one, sinks that cannot be used, units of no sensor.
    """

    def __init__(
        self, asset: LiveAsset, state: Path, sinks: Callable[[LiveAsset, Sequence[str], dict[str, Any] | None], Sinks]
    ) -> None:
        self.asset, self._state = asset, state
        there = state.exists()
        tracker, stream = checkpoint.read(state if there else asset.model)
        if there and checkpoint.fit_of(asset.model) != checkpoint.fit_of(state):
            raise InputError("the state belongs to another tracker than the model", where=str(state),
                             expected=f"a state of {asset.model}",
                             hint="move the state and the tables away, or name the model of before")  # fmt: skip
        before = stream if there and stream is not None else {}
        same = before.get("source") == str(asset.source)
        regular = MESSAGES if asset.source.scheme in BROKERS else REGULAR
        self.follows = Following(tracker, before, asset.unit, same, regular, told=True)
        self.follows.clock.again = self.follows.resumed and not same
        self.place = before.get("place") if same else None
        self.serial = int(before.get("serial", 0))  # pieces that were taken
        self.reached = self.serial  # of them, those that the checkpoint holds
        self._recent = _Recent(before.get("recent", []))
        if same and (rest := before.get("rest")) is not None:
            self.follows.lines.rest = bytes(np.asarray(rest, np.uint8))
        self.halted, self.dirty, self.rows, self.checked = "", False, 0, time.monotonic()
        self.last = Last(heard=time.monotonic())
        self.feed: Feed | None = None
        self.sinks = sinks(asset, self.follows.head, before.get("sinks"))
        swept(state)
        if not there:
            try:
                self._save()  # which tables are its own is known before anything stands in them
            except BaseException:
                self.sinks.close()
                raise

    def knows(self, piece: Received) -> bool:
        """Whether a message is sent again that was taken before.

        Its broker says so, or it holds the same rows with the same time stamps.
        """
        layout = self.follows.lines.layout
        stamped = layout is not None and layout.time is not None and piece.data[:1] in ROW
        if not piece.key or not (piece.again or stamped):
            return False
        return self._recent.has(piece.key, numbered=not stamped)

    def entry(self, piece: Received) -> JournalEntry:
        """A piece as it goes into the journal; it is numbered by this."""
        found = JournalEntry(piece.to, self.serial, piece.key, piece.data, piece.fresh)
        self.serial += 1
        self._recent.add([found.key] if found.key else [])  # the same may come once more in this round
        return found

    def take(self, entries: Sequence[JournalEntry]) -> int:
        """Track what has come; how many samples it was. A stream that cannot be read halts the structure alone.

        Raises
        ------
        InputError
            A table that cannot be written.
        """
        if not entries:
            return 0
        self._recent.add(entry.key for entry in entries if entry.key)
        self.last.heard = time.monotonic()
        if self.halted:
            return 0
        self.dirty, count, begin = True, 0, 0
        if self.asset.source.scheme in BROKERS:
            longest = max(entry.data.count(b"\n") for entry in entries)
            self.follows.clock.regular = max(self.follows.clock.regular, OVERTAKEN * longest)
        for k, entry in enumerate(entries):
            if entry.fresh:
                count += self._read(entries[begin:k])
                self.another()
                begin = k
        return count + self._read(entries[begin:])

    def another(self) -> None:
        """What follows comes from another file or connection; a connection may repeat what came, a file does not."""
        self.follows.another()
        if self.feed is None or not self.feed.lasting:
            self.follows.clock.again = self.follows.clock.grid is not None

    def checkpoint(self) -> None:
        """Put on the disk where it stands, after its rows.

        Raises
        ------
        InputError
            Files that cannot be written.
        """
        if self.halted:
            return
        self.sinks.sync()
        self._save()

    def close(self) -> None:
        """Let go of its tables."""
        self.sinks.close()

    def _save(self) -> None:
        rest = self.follows.lines.rest
        place = self.place if self.feed is None else self.feed.place(self.asset.name, len(rest))
        journal = self.feed is not None and not self.feed.lasting
        stream = {
            **self.follows.to_tree(),
            "source": str(self.asset.source),
            "place": place,
            "serial": self.serial,
            "recent": self._recent.keys,
            "rest": np.frombuffer(rest, np.uint8) if journal else None,
            "sinks": self.sinks.place(),
        }
        checkpoint.save(self.follows.tracker, self._state, stream)
        self.reached, self.dirty, self.checked = self.serial, False, time.monotonic()
        if self.feed is not None:
            self.feed.saved(self.asset.name, place)

    def _read(self, entries: Sequence[JournalEntry]) -> int:
        data = b"".join(entry.data for entry in entries)
        if self.halted or not data:
            return 0
        rows, count = _Rows(), 0
        try:
            stamps, values = self.follows.lines.push(data)
            count = self.follows.take(stamps, values, rows)
            if self.follows.lines.refused is not None:
                raise self.follows.lines.refused
        except Exception as error:  # one that nobody expected stops nobody else either
            known = isinstance(error, InputError)
            self.halted = str(error) if known else f"{type(error).__name__}: {error}"
            log.error("%s is halted: %s", self.asset.name, self.halted, exc_info=not known)
        if rows.parts:
            times, load, std, *alarms = rows.whole()
            self.sinks.write(times, load, std, *alarms)
            self.last = Last(float(times[-1]), load[-1, : std.shape[1]], std[-1], self.last.heard)
            self.rows += len(times)
        return count


class _Recent:
    """Keys of the last messages, ``NUMBER:DIGEST``: the number by which a broker knows it, and what it holds."""

    def __init__(self, keys: Iterable[str]) -> None:
        self._keys: dict[str, None] = {}
        self._held: Counter[str] = Counter()
        self.add(keys)

    @property
    def keys(self) -> list[str]:
        """The oldest first."""
        return list(self._keys)

    def add(self, keys: Iterable[str]) -> None:
        """Messages that were taken."""
        for key in keys:
            if key not in self._keys:
                self._keys[key] = None
                self._held[_digest(key)] += 1
        while len(self._keys) > RECENT:
            oldest = next(iter(self._keys))
            del self._keys[oldest]
            self._held[_digest(oldest)] -= 1
            if not self._held[_digest(oldest)]:
                del self._held[_digest(oldest)]

    def has(self, key: str, numbered: bool) -> bool:
        """Whether a message was taken: of this number, or any that held the same."""
        return key in self._keys if numbered else _digest(key) in self._held


def _digest(key: str) -> str:
    return key.partition(":")[2]


class _Rows:
    """Keeps rows, to be written at once."""

    def __init__(self) -> None:
        self.parts: list[tuple[NDArray[Any], ...]] = []

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """More rows."""
        if len(times):
            self.parts.append((times, load, std) if alarms is None else (times, load, std, alarms))

    def whole(self) -> tuple[NDArray[Any], ...]:
        """All of them."""
        if len(self.parts) == 1:
            return self.parts[0]
        return tuple(np.concatenate(column) for column in zip(*self.parts, strict=True))
