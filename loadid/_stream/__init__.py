"""Loads of a running structure from a stream of samples: a growing file, standard input, a socket.

A tracker on a stream reads, tracks, writes, and can be killed at any moment. A checkpoint holds the filter, the place
in the source and the length of the output, and is written after all of that output is on the disk. What was written
later is made again at the next start, bit for bit; where its samples do not come again it stays, and a mark follows it
(`output`). A state is held by one run, and knows its output.
"""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from structures.errors import InputError

from .._families.tracking import tracker as checkpoint
from .._families.tracking.tracker import Tracker
from .following import Following, Watch
from .output import Output, StateLock, swept
from .sources import ByteSource, open_source

__all__ = ["StreamSummary", "follow", "open_source"]

EVERY = 20_000  # samples from one checkpoint to the next: a tenth of a second of reading a file
SECONDS = 5.0  # and the longest time, where something has come
LOOK = 0.1  # s that a source is waited for before the clock is looked at
STANDS = 2.0  # s without data after which it is said that a file is waited for
WAITS = (
    "%s: %d samples are answered, and the run waits for the file to grow; Ctrl-C ends it and keeps every answer, "
    "--idle S ends it by itself"
)
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class StreamSummary:
    """What came of a stream.

    Parameters
    ----------
    samples : int
        Tracked in this run, those without data among them.
    seconds : float
    resumed : bool
    ended : str
    counts : dict of str to int
        Of the whole stream, earlier runs among them; only what is not zero.
    phase : str
        Of the tracker.
    alarm : tuple of (float, int, int), optional
        Time from which the rows have had the alarm of the last one, its code and channel (from 1; 0 for none).
    """

    samples: int
    seconds: float
    resumed: bool
    ended: str
    counts: dict[str, int]
    phase: str
    alarm: tuple[float, int, int] | None = None


def follow(
    tracker: Tracker,
    source: str,
    out: str | BinaryIO,
    *,
    state: str | os.PathLike[str] | None = None,
    stream: dict[str, Any] | None = None,
    every: int = EVERY,
    idle: float | None = None,
    stop: threading.Event | None = None,
    watch: Watch | None = None,
    units: Mapping[str, str] | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> StreamSummary:
    """Track a stream until it ends.

    Parameters
    ----------
    tracker : Tracker
    source : str
        A file that grows, ``-``, or ``tcp://HOST:PORT``.
    out : str or binary file
        Name of a file that is new, empty or that of the state, or an open pipe: a line a sample with time, loads,
        stds, and the number of the guard that holds there with its channel (from 1), 0 where there is none.
    state : path or StateLock, optional
        File of the checkpoints; none are written where it is left out.
    stream : dict, optional
        Where an earlier run stood (`loadid._families.tracking.tracker.read`).
    every : int
        Samples between checkpoints.
    idle : float, optional
        Seconds without data after which a file counts as ended; never by default.
    stop : threading.Event, optional
        Ends the run from outside.
    watch : callable, optional
        Called with times, loads and stds of every piece.
    units : mapping of str to str, optional
        Units of columns, by the names of their sensors, where a header does not state them or states wrong ones.
    progress : callable, optional
        Called with the share of a file that is read, 0 to 1, and a text.

    Raises
    ------
    InputError
        A source, a state or an output that cannot be used, a header without a sensor of the tracker or its unit, a
        connection that broke off. What came before is answered and in the state.
    """
    with ExitStack() as held:
        if state is not None and not isinstance(state, StateLock):
            state = held.enter_context(StateLock(state))
        run = held.enter_context(closing(_Run(tracker, source, out, state, stream, units)))
        return run.go(every, idle, stop or threading.Event(), watch, progress or (lambda share, text: None))


class _Run:
    def __init__(
        self, tracker: Tracker, source: str, out: str | BinaryIO, state: str | os.PathLike[str] | None,
        stream: dict[str, Any] | None, units: Mapping[str, str] | None,
    ) -> None:  # fmt: skip
        self.state, self.name = state, source
        self.claimed = state is None or stream is not None
        before = stream or {}
        same = before.get("source") == _identity(source)
        self.follows = follows = Following(tracker, before, units, same)
        self.source: ByteSource = open_source(source, before.get("place") if same else None, follows.another, units)
        self.source.counts.update(before.get("waits") or {})
        follows.clock.again = follows.resumed and not (same and self.source.seekable)
        if follows.clock.again:
            follows.another()
        try:
            self.output = Output(out, follows.head, before.get("output"))
        except BaseException:
            self.source.close()
            raise
        if state is not None:
            swept(Path(state))  # now that no other run is known to write it

    def go(
        self, every: int, idle: float | None, stop: threading.Event, watch: Watch | None,
        progress: Callable[[float, str], None],
    ) -> StreamSummary:  # fmt: skip
        begun = told = last = time.monotonic()
        samples = fresh = 0
        waits = idle is None and self.source.share is not None  # a file that may grow for ever
        ended, broken, follows = "stopped", None, self.follows
        while not stop.is_set():
            try:
                data = self.source.read(LOOK if idle is None else min(LOOK, idle))
                stamps, values = follows.lines.push(data or b"")
            except InputError as error:
                broken = error
                break
            now = time.monotonic()
            if data is None:
                ended = "the source has ended"
                break
            if data:
                if len(values):
                    self._claim()
                count = follows.take(stamps, values, self.output, watch)
                samples, fresh, last = samples + count, fresh + count, now
                if (share := self.source.share) is not None:
                    progress(share, f"{samples} samples tracked")
            elif waits and now - last >= STANDS:
                waits = False
                log.warning(WAITS, self.name, samples)
            elif idle is not None and now - last >= idle:
                ended = f"nothing has come for {idle:g} s"
                break
            if fresh >= every or (fresh and now - told >= SECONDS):
                self.save()
                fresh, told = 0, now
        if samples or broken is None:
            self.save()
        if broken is not None:
            raise broken
        counts = self.counts | ({"unfinished": 1} if follows.lines.rest.strip() else {})
        return StreamSummary(
            samples, time.monotonic() - begun, follows.resumed, ended, counts, follows.tracker.phase, follows.alarm
        )

    def close(self) -> None:
        self.source.close()
        self.output.close()

    @property
    def counts(self) -> dict[str, int]:
        """Everything that was counted."""
        return self.follows.counts | {k: int(v) for k, v in self.source.counts.items() if v}

    def save(self) -> None:
        """A checkpoint, after the output is on the disk."""
        self._claim()
        self.output.sync()
        if self.state is None:
            return
        stream = {
            **self.follows.to_tree(),
            "source": _identity(self.name),
            "place": self.source.place(len(self.follows.lines.rest)),
            "waits": dict(self.source.counts),
            "output": self.output.place(),
        }
        checkpoint.save(self.follows.tracker, self.state, stream)

    def _claim(self) -> None:
        """Before the first answer the state says which output is its own: what stands there is then known as such."""
        if not self.claimed:
            assert self.state is not None
            stream = {"output": self.output.place(), "alarms": self.follows.alarms}
            checkpoint.save(self.follows.tracker, self.state, stream)
            self.claimed = True


def _identity(source: str) -> str:
    """Name of a source that does not depend on the folder of the process."""
    return source if source == "-" or source.startswith("tcp://") else os.path.abspath(source)
