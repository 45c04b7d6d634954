"""Loads of a running structure from a stream of samples: a growing file, standard input, a socket.

A tracker on a stream reads, tracks, writes, and can be killed at any moment. A checkpoint holds the filter, the place
in the source and the length of the output, and is written after all of that output is on the disk. What was written
later is made again at the next start, bit for bit; where its samples do not come again it stays, and a mark follows it
(`output`). A state is held by one run, and knows its output.
"""

from __future__ import annotations

import glob
import os
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .._families.tracking import tracker as checkpoint
from .._families.tracking.tracker import Tracker
from .clock import Behind, Clock
from .framing import Lines
from .header import ColumnLayout
from .output import Output, StateLock
from .sources import ByteSource, open_source

__all__ = ["StreamSummary", "follow", "open_source"]


Array = NDArray[np.float64]

EVERY = 20_000  # samples from one checkpoint to the next: a tenth of a second of reading a file
SECONDS = 5.0  # and the longest time, where something has come
LOOK = 0.1  # s that a source is waited for before the clock is looked at
ROWS = 256  # rows placed in time at once: each may stand for a gap
Watch = Callable[[Array, Array, Array], None]


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
        return run.go(every, idle, stop or threading.Event(), watch or (lambda times, load, std: None))


class _Run:
    def __init__(
        self, tracker: Tracker, source: str, out: str | BinaryIO, state: str | os.PathLike[str] | None,
        stream: dict[str, Any] | None, units: Mapping[str, str] | None,
    ) -> None:  # fmt: skip
        self.tracker, self.state, self.name = tracker, state, source
        self.claimed = state is None or stream is not None
        f = tracker.fitted
        before = stream or {}
        self.resumed = "clock" in before  # else it says only which output it belongs to
        self.alarms = bool(before.get("alarms", not self.resumed))  # outputs of 0.1 have no columns of them
        layout = before.get("layout")
        self.lines = Lines(f.sensors, None if layout is None else ColumnLayout.from_tree(layout), units)
        self.clock = Clock(f.dt, tracker.replay)
        since = before.get("alarm")
        self.alarm = None if since is None else (float(since[0]), int(since[1]), int(since[2]))
        self.waiting = np.array(before.get("waiting", []), float)  # times of samples that are answered later
        same = before.get("source") == _identity(source)
        heading = before.get("heading")  # of a line whose units may still come
        if not same or heading:
            self.lines.another()
        if self.resumed:
            self.lines.counts.update(before["lines"])
            self.lines.skipping = bool(before["skipping"]) and same
            self.lines.heading = list(heading) if same and heading else None
            self.clock.restore(before["clock"])
        self.source: ByteSource = open_source(source, before.get("place") if same else None, self.lines.another)
        self.source.counts.update(before.get("waits") or {})
        self.clock.again = self.resumed and not (same and self.source.seekable)
        if self.clock.again:
            self.lines.another()
        head = [
            "time [s]",
            *(f"{c.label} [{c.unit}]" for c in f.loads),
            *(f"std of {c.label} [{c.unit}]" for c in f.loads),
            *(["alarm", "alarm channel"] if self.alarms else []),
        ]
        try:
            self.output = Output(out, head, before.get("output"))
        except BaseException:
            self.source.close()
            raise
        if state is not None:
            _swept(Path(state))  # now that no other run is known to write it

    def go(self, every: int, idle: float | None, stop: threading.Event, watch: Watch) -> StreamSummary:
        begun = told = last = time.monotonic()
        samples = fresh = 0
        ended, broken = "stopped", None
        while not stop.is_set():
            try:
                data = self.source.read(LOOK if idle is None else min(LOOK, idle))
                stamps, values = self.lines.push(data or b"")
            except InputError as error:
                broken = error
                break
            now = time.monotonic()
            if data is None:
                ended = "the source has ended"
                break
            if data:
                count = self._taken(stamps, values, watch)
                samples, fresh, last = samples + count, fresh + count, now
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
        counts = self.counts | ({"unfinished": 1} if self.lines.rest.strip() else {})
        return StreamSummary(
            samples, time.monotonic() - begun, self.resumed, ended, counts, self.tracker.phase, self.alarm
        )

    def close(self) -> None:
        self.source.close()
        self.output.close()

    @property
    def counts(self) -> dict[str, int]:
        """Everything that was counted."""
        found = {**self.lines.counts, **self.clock.counts, **self.source.counts, **self.tracker.counts}
        return {k: int(v) for k, v in found.items() if v}

    def save(self) -> None:
        """A checkpoint, after the output is on the disk."""
        self._claim()
        self.output.sync()
        if self.state is None:
            return
        layout = self.lines.layout or self.lines.before
        stream = {
            "source": _identity(self.name),
            "place": self.source.place(len(self.lines.rest)),
            "layout": None if layout is None else layout.to_tree(),
            "skipping": self.lines.skipping,
            "heading": self.lines.heading,
            "lines": dict(self.lines.counts),
            "clock": self.clock.to_tree(),
            "waiting": self.waiting,
            "waits": dict(self.source.counts),
            "output": self.output.place(),
            "alarms": self.alarms,
            "alarm": None if self.alarm is None else list(self.alarm),
        }
        checkpoint.save(self.tracker, self.state, stream)

    def _claim(self) -> None:
        """Before the first answer the state says which output is its own: what stands there is then known as such."""
        if not self.claimed:
            assert self.state is not None
            checkpoint.save(self.tracker, self.state, {"output": self.output.place(), "alarms": self.alarms})
            self.claimed = True

    def _taken(self, stamps: Array | None, values: Array, watch: Watch) -> int:
        if len(values):
            self._claim()
        count = 0
        for k, (begin, end) in enumerate(pairwise([0, *self.lines.headings, len(values)])):
            if k:
                self.clock.anew()
            for a in range(begin, end, ROWS):
                part = slice(a, min(a + ROWS, end))
                count += self._placed(None if stamps is None else stamps[part], values[part], watch)
        return count

    def _placed(self, stamps: Array | None, values: Array, watch: Watch) -> int:
        times, Y = self.clock.place(stamps, values)
        load, std, alarms = self._tracked(Y, self.clock.behind)
        if len(Y):
            self._heard(times, alarms)
            answers = self._answered(times, load, std)
            self.output.write(*answers, alarms[len(Y) - len(answers[0]) :] if self.alarms else None)
            if len(answers[0]):
                watch(*answers)
        return len(Y)

    def _heard(self, times: Array, alarms: NDArray[np.int_]) -> None:
        """Since when every row has had the alarm of the last one."""
        code, channel = (int(x) for x in alarms[-1])
        others = np.flatnonzero(np.any(alarms != alarms[-1], axis=1))
        goes_on = not len(others) and self.alarm is not None and self.alarm[1:] == (code, channel)
        if not goes_on:
            self.alarm = (float(times[int(others[-1]) + 1 if len(others) else 0]), code, channel) if code else None

    def _tracked(self, Y: Array, behind: list[Behind]) -> tuple[Array, Array, NDArray[np.int_]]:
        """Loads, stds, alarms of samples, each late row put in its place when it comes: answers that are out stay."""
        p, k = len(self.tracker.fitted.loads), 0
        load, std, alarms = np.empty((len(Y), p)), np.empty((len(Y), p)), np.zeros((len(Y), 2), int)
        for after, row, ago in [*behind, Behind(len(Y), np.empty(0), -1)]:
            if after > k:
                load[k:after], std[k:after], _ = self.tracker.run(Y[k:after])
                alarms[k:after] = self.tracker.row_alarms
            if ago >= 0:
                self.tracker.insert(row, ago)
            k = after
        return load, std, alarms

    def _answered(self, times: Array, load: Array, std: Array) -> tuple[Array, Array, Array]:
        """Answers with their own times: a tracker with a lag speaks of samples that lie back, at first of none."""
        lag = self.tracker.lag
        every = np.concatenate([self.waiting, times])
        answered = max(len(every) - lag, 0)
        self.waiting = every[answered:]
        first = len(times) - answered
        return every[:answered], load[first:], std[first:]


def _swept(state: Path) -> None:
    """Remove what a run that was killed while it wrote a checkpoint has left beside it."""
    for left in state.parent.glob(f".{glob.escape(state.name)}.*.tmp"):
        left.unlink(missing_ok=True)


def _identity(source: str) -> str:
    """Name of a source that does not depend on the folder of the process."""
    return source if source == "-" or source.startswith("tcp://") else os.path.abspath(source)
