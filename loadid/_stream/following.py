"""One tracker behind one stream: from bytes to rows of a table, and all that has to be known to go on with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from .._families.tracking.running import TrackedRows
from .._families.tracking.tracker import Tracker
from .clock import REGULAR, Behind, Clock
from .framing import Lines
from .header import ColumnLayout

Array = NDArray[np.float64]
Watch = Callable[[Array, Array, Array], None]

DIGITS = 4  # of a NIS, behind the point
LARGEST = 62  # channels that a whole number tells apart
ROWS = 256  # rows placed in time at once: each may stand for a gap


class RowWriter(Protocol):
    """What takes the rows: a file that grows, a pipe, messages."""

    def write(self, times: Array, load: Array, std: Array, alarms: NDArray[np.int_] | None = None) -> None:
        """TrackedRows: times (rows,), loads and stds (rows, any), and whole numbers (rows, any) behind them."""


class Following:
    """What a tracker makes of a stream.

    Parameters
    ----------
    tracker : Tracker
    before : mapping, optional
        Where an earlier run stood (`to_tree`).
    units : mapping of str to str, optional
        Units of columns, by the names of their sensors.
    same : bool
        The stream goes on where the earlier run left it; else it may begin with a header.
    regular : int
        As for `Clock`.
    told : bool
        Rows of a new table tell all.

    Attributes
    ----------
    alarm : tuple of (float, int, int) or None
        Time from which the rows have had the alarm of the last one, its code and channel (from 1; 0 for none).
    alarms, told : bool
        Rows end with the code and the channel of their alarm; and have the NIS for each channel behind the loads, at
        their end the phase (0 starting, 1 settled, 2 open loop) and the channels that are kept out, the first as 1, the
        second as 2, then 4, 8, ...
    """

    def __init__(
        self, tracker: Tracker, before: Mapping[str, Any] | None = None, units: Mapping[str, str] | None = None,
        same: bool = True, regular: int = REGULAR, told: bool = False,
    ) -> None:  # fmt: skip
        f, before = tracker.fitted, before or {}
        self.tracker, layout, heading = tracker, before.get("layout"), before.get("heading")
        self.resumed = "clock" in before  # else it says only which output it belongs to
        self.alarms = bool(before.get("alarms", not self.resumed))  # outputs of 0.1 have no columns of them
        self.told = bool(before.get("told", told))
        self.lines = Lines(f.sensors, None if layout is None else ColumnLayout.from_tree(layout), units)
        self.clock = Clock(f.dt, tracker.replay, regular)
        since = before.get("alarm")
        self.alarm = None if since is None else (float(since[0]), int(since[1]), int(since[2]))
        self.waiting = np.array(before.get("waiting", []), float)  # times of samples that are answered later
        if not same or heading:  # of a line whose units may still come
            self.lines.another()
        if self.resumed:
            self.lines.counts.update(before["lines"])
            self.lines.skipping = bool(before["skipping"]) and same
            self.lines.heading = list(heading) if same and heading else None
            self.clock.restore(before["clock"])

    @property
    def head(self) -> list[str]:
        """Names of the columns of the rows."""
        f = self.tracker.fitted
        return [
            "time [s]",
            *(f"{c.label} [{c.unit}]" for c in f.loads),
            *(["NIS"] if self.told else []),
            *(f"std of {c.label} [{c.unit}]" for c in f.loads),
            *(["alarm", "alarm channel"] if self.alarms else []),
            *(["phase", "kept out"] if self.told else []),
        ]

    @property
    def counts(self) -> dict[str, int]:
        """Everything that was counted, and is not zero."""
        found = {**self.lines.counts, **self.clock.counts, **self.tracker.counts}
        return {k: int(v) for k, v in found.items() if v}

    def to_tree(self) -> dict[str, Any]:
        """Where it stands, beside the tracker; what has come of a line that has not ended is not in it."""
        layout = self.lines.layout or self.lines.before
        return {
            "layout": None if layout is None else layout.to_tree(),
            "skipping": self.lines.skipping,
            "heading": self.lines.heading,
            "lines": dict(self.lines.counts),
            "clock": self.clock.to_tree(),
            "waiting": self.waiting,
            "alarms": self.alarms,
            "told": self.told,
            "alarm": None if self.alarm is None else list(self.alarm),
        }

    def another(self) -> None:
        """What follows comes from another file or connection: it may begin with a header, or repeat itself."""
        self.lines.another()

    def take(self, stamps: Array | None, values: Array, table: RowWriter, watch: Watch | None = None) -> int:
        """Track rows that `lines` has read; how many samples they are, those without data among them.

        Raises
        ------
        InputError
            As `Clock.place` and the table's `write`.
        """
        count = 0
        for k, (begin, end) in enumerate(pairwise([0, *self.lines.headings, len(values)])):
            if k:
                self.clock.anew()
            for a in range(begin, end, ROWS):
                part = slice(a, min(a + ROWS, end))
                count += self._placed(None if stamps is None else stamps[part], values[part], table, watch)
        return count

    # -- inside -----------------------------------------------------------------------------------------------------
    def _placed(self, stamps: Array | None, values: Array, table: RowWriter, watch: Watch | None) -> int:
        times, Y = self.clock.place(stamps, values)
        rows, alarms = self._tracked(Y, self.clock.behind)
        if len(Y):
            self._heard(times, alarms)
            times, load, std = self._answered(times, rows.load, rows.std)
            now = slice(len(Y) - len(times), None)
            if self.told:
                nis = np.round(self.tracker.nis(rows.e[now]), DIGITS)
                marks = np.column_stack([alarms[now], _phases(rows)[now], _kept_out(Y, rows.e)[now]])
                table.write(times, np.column_stack([load, nis]), std, marks)
            else:
                table.write(times, load, std, alarms[now] if self.alarms else None)
            if watch is not None and len(times):
                watch(times, load, std)
        return len(Y)

    def _heard(self, times: Array, alarms: NDArray[np.int_]) -> None:
        """Since when every row has had the alarm of the last one."""
        code, channel = (int(x) for x in alarms[-1])
        others = np.flatnonzero(np.any(alarms != alarms[-1], axis=1))
        goes_on = not len(others) and self.alarm is not None and self.alarm[1:] == (code, channel)
        if not goes_on:
            self.alarm = (float(times[int(others[-1]) + 1 if len(others) else 0]), code, channel) if code else None

    def _tracked(self, Y: Array, behind: Sequence[Behind]) -> tuple[TrackedRows, NDArray[np.int_]]:
        """Rows and alarms of samples, each late one put in its place when it comes: answers that are out stay."""
        out, alarms, k = (
            TrackedRows.of(len(Y), len(self.tracker.fitted.loads), Y.shape[1]),
            np.zeros((len(Y), 2), int),
            0,
        )
        for after, row, ago in [*behind, Behind(len(Y), np.empty(0), -1)]:
            if after > k:
                out[k:after].take(self.tracker.rows(Y[k:after]))
                alarms[k:after] = self.tracker.row_alarms
            if ago >= 0:
                self.tracker.insert(row, ago)
            k = after
        return out, alarms

    def _answered(self, times: Array, load: Array, std: Array) -> tuple[Array, Array, Array]:
        """Answers with their own times: a tracker with a lag speaks of samples that lie back, at first of none."""
        lag = self.tracker.lag
        every = np.concatenate([self.waiting, times])
        answered = max(len(every) - lag, 0)
        self.waiting = every[answered:]
        first = len(times) - answered
        return every[:answered], load[first:], std[first:]


def _phases(rows: TrackedRows) -> NDArray[np.int_]:
    """0 starting or gone from a settled gain, 1 settled, 2 open loop: no channel was used (samples,)."""
    return np.where(np.isfinite(rows.e).any(axis=1), rows.settled, 2)


def _kept_out(Y: Array, e: Array) -> NDArray[np.int_]:
    """Channels that came and were not used, the first as 1, the second as 2, then 4, 8, ... (samples,)."""
    out = np.isfinite(Y) & ~np.isfinite(e)
    return out[:, :LARGEST] @ (1 << np.arange(min(Y.shape[1], LARGEST)))
