"""From time stamps to samples at the step of the tracker: gaps, duplicates, late samples, jitter and jumps.

A grid follows the stamps slowly, so that neither jitter nor a clock that runs a little fast adds up. A sample belongs
to the nearest point of the grid; points that nothing belongs to are samples without data, which the filter takes
exactly. A row that comes after its time, for a point where channels are still missing, is handed over as late.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]

FOLLOW = 0.05  # share of its distance to a stamp that the grid moves
JITTER = 0.1  # steps off the grid that are counted
LONGEST = 2000  # samples that a gap is filled with: the filter has forgotten by then, and a jump is no longer a gap
FEW, SEEN = 5, 40  # stamps that show at what step a stream comes
FASTEST, SLOWEST, SPARSE = 0.75, 20.5, 1.5  # of its steps over that of the tracker; from where it is said
REGULAR = 20  # late samples in a row that show a clock that was put back
log = logging.getLogger(__name__)


class Behind(NamedTuple):
    """A row (sensors,) of an earlier time: `ago` samples before the last one, after `after` samples of its block."""

    after: int
    row: Array
    ago: int


class Clock:
    """Places rows in time.

    Parameters
    ----------
    dt : float
        Step of the tracker in s.
    window : int
        Samples by which a row may come late and still be put in its place.
    regular : int
        Late samples in a row, a step apart from each other, that show a clock that was put back.

    Attributes
    ----------
    behind : list of Behind
        Rows of the last `place` that are to be put in their place.
    counts : Counter
        ``filled`` (samples without data put in), ``gaps``, ``duplicated``, ``late`` (left out, as their place is taken
        or too far back), ``again`` (sent again after a new start), ``jitter``, ``jumps``.
    """

    def __init__(self, dt: float, window: int = 0, regular: int = REGULAR) -> None:
        self.dt, self.regular = dt, regular
        self.there: deque[NDArray[np.bool_]] = deque(maxlen=window)  # channels of the last samples
        self.behind: list[Behind] = []
        self.grid: float | None = None  # time of the last sample
        self.samples = 0
        self.again = False  # the source was opened anew and may repeat itself
        self.begun = False  # a header came again: its clock may have been put back
        self.first: list[float] = []  # stamps of this run, until its step is known
        self.held: list[tuple[float, Array]] = []  # late ones that may be a clock put back
        self.counts: Counter[str] = Counter()

    def place(self, stamps: Array | None, values: Array) -> tuple[Array, Array]:
        """Times (samples,) and values (samples, sensors) of rows, NaN where there are no data; `behind` has the late.

        Raises
        ------
        InputError
            A stream that comes at another step than the tracker's, or whose stamps do not rise.
        """
        self.behind = []
        if stamps is None:
            times = np.asarray((self.samples + np.arange(len(values))) * self.dt, float)
            self.samples += len(values)
            return times, values
        self._look(stamps)
        empty = len(values)
        self._times: list[float] = []
        self._rows: list[int] = []  # of the values; -1 without data, -2 and on those that were held
        self._late: list[Array] = []
        self._seen = np.isfinite(values)
        listed, k = stamps.tolist(), 0
        while (k := self._regular(listed, k)) < empty:
            self._one(listed[k], k, values)
            k += 1
        if not self._rows:
            return np.empty(0), values[:0]
        pool = np.vstack([values, np.full((1, values.shape[1]), np.nan), *self._late])
        rows = np.array(self._rows)
        rows = np.where(rows < 0, empty - 1 - rows, rows)
        self.samples += len(rows)
        return np.array(self._times), np.ascontiguousarray(pool[rows])

    def anew(self) -> None:
        """A logger that began again: at what step it comes is looked at again, and it may count from another time."""
        self.first, self.begun = [], True

    def to_tree(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "grid": self.grid,
            "begun": self.begun,
            "samples": self.samples,
            "held": [[t, row.tolist()] for t, row in self.held],
            "there": [mask.tolist() for mask in self.there],
            "counts": dict(self.counts),
        }

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.grid, self.samples = tree["grid"], int(tree["samples"])
        self.begun = bool(tree.get("begun", False))
        self.held = [(t, np.array(row, float)) for t, row in tree["held"]]
        self.there.extend(np.array(mask, bool) for mask in tree.get("there", []))
        self.counts = Counter(tree["counts"])

    def _look(self, stamps: Array) -> None:
        """At what step the stream comes, once in a run and after each header."""
        if len(self.first) > SEEN:
            return
        self.first += stamps[: SEEN + 1 - len(self.first)].tolist()
        steps = np.diff(self.first)
        far = len(steps) >= FEW and bool(np.all(steps > SLOWEST * self.dt))  # each would be filled with thousands
        if len(steps) < SEEN and not far:
            return
        step = float(np.median(steps))
        if FASTEST <= step / self.dt <= SLOWEST:
            if step > SPARSE * self.dt:
                log.warning("a sample comes every %.4g s and the tracker's step is %.4g s: the steps between are "
                            "samples without data", step, self.dt)  # fmt: skip
            return
        turned = step <= 0
        raise InputError(
            "the time stamps do not rise" if turned else "the stream comes at another step than the tracker's",
            where="time stamps", found=f"a step of {step:.6g} s (median of the first {len(steps)})",
            expected=f"{self.dt:.6g} s",
            hint="check that the column of time is in seconds" + ("" if turned else "; or fit a tracker to this step"),
        )  # fmt: skip

    # -- rows, and one row ------------------------------------------------------------------------------------------
    def _regular(self, stamps: list[float], first: int) -> int:
        """Place rows from `first` on up to one that does not belong to the next point of the grid; which one it is."""
        if self.grid is None:
            return first
        grid, dt, k, off_grid = self.grid, self.dt, first, 0
        for t in stamps[first:] if first else stamps:
            off = (t - grid) / dt - 1
            if not (off >= -0.5 and off + 0.5 < 1):
                break
            grid += dt
            rest = t - grid
            off_grid += abs(rest) > JITTER * dt
            grid += FOLLOW * rest
            k += 1
        if k > first:
            self.again = self.begun = False
            self.held.clear()
            self.counts.update(filled=0, jumps=0, gaps=0, jitter=off_grid)
            self.grid = grid
            self.there.extend(self._seen[max(first, k - (self.there.maxlen or 0)) : k])
            self._times += stamps[first:k]
            self._rows += range(first, k)
        return k

    def _one(self, t: float, k: int, values: Array) -> None:
        if self.grid is None:
            self.grid = t
            self._put(t, k, self._seen[k])
            return
        off = (t - self.grid) / self.dt - 1
        if off < -0.5:
            self._back(t, off, k, values[k])
            return
        self.again = self.begun = False
        self.held.clear()
        jumped = off > LONGEST + 0.5
        skipped = LONGEST if jumped else int(np.floor(off + 0.5))
        self._fill(skipped, values.shape[1])
        self.counts["jumps"] += jumped
        self.counts["gaps"] += skipped > 0 and not jumped
        self._moved(t, jumped)
        self._put(t, k, self._seen[k])

    def _back(self, t: float, off: float, k: int, row: Array) -> None:
        """A sample of an earlier time: late, sent twice, or of a clock that was put back."""
        seen = self._seen[k]
        if self.again:
            if not self.counts["again"]:
                log.warning("a sender that begins again at %.6g s: what lies before %.6g s is taken as sent twice and "
                            "left out; if its clock was put back, begin with a new state", t, self.grid)  # fmt: skip
            self.counts["again"] += 1
            return
        ago = int(np.floor(-off - 0.5))
        if ago < len(self.there) and np.any(seen & ~self.there[-1 - ago]):
            self.there[-1 - ago] = seen | self.there[-1 - ago]
            self.held.clear()
            self.behind.append(Behind(len(self._rows), row.copy(), ago))
            return
        if off > -1.5:
            self.counts["duplicated"] += 1
            return
        if self.begun:
            self.begun = False
            self.counts["jumps"] += 1
            self._moved(t, True)
            self._put(t, k, seen)
            return
        self.counts["late"] += 1
        if self.held and abs((t - self.held[-1][0]) / self.dt - 1) > 0.5:
            self.held.clear()
        self.held.append((t, row.copy()))
        if len(self.held) < self.regular:
            return
        self.counts["late"] -= len(self.held)
        self.counts["jumps"] += 1
        for i, (stamp, late) in enumerate(self.held):
            self._moved(stamp, i == 0)
            self._late.append(late)
            self._put(stamp, -1 - len(self._late), np.isfinite(late))
        self.held.clear()

    def _moved(self, t: float, jumped: bool) -> None:
        """The grid one step on, and a little towards the stamp."""
        assert self.grid is not None
        self.grid += self.dt
        if jumped:
            self.grid = t
            self.there.clear()  # they stand at times of another clock
        self.counts["jitter"] += abs(t - self.grid) > JITTER * self.dt
        self.grid += FOLLOW * (t - self.grid)

    def _fill(self, count: int, width: int) -> None:
        assert self.grid is not None
        nothing = np.zeros(width, bool)
        for _ in range(count):
            self.grid += self.dt
            self._put(self.grid, -1, nothing)
        self.counts["filled"] += count

    def _put(self, t: float, row: int, seen: NDArray[np.bool_]) -> None:
        self.there.append(seen)
        self._times.append(t)
        self._rows.append(row)
