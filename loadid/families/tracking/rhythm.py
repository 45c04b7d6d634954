"""Channels of several rates, or lost for good: sets of channels that repeat, recognised in what comes, and their gains.

A channel that is sampled every tenth time is missing in nine of ten samples. Where the sets of channels of the last
samples repeat with a period, the gains do too (`loadid.inverse.kalman.periodic`): they are solved for once, and from
there on a sample is one product again.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ...inverse.kalman.periodic import periodic
from ...inverse.kalman.squareroot import SquareRoot, State
from ...inverse.kalman.steady import Steady

LONGEST = 128  # samples of a period
REPEATED = 2  # periods that show one
LEAST = 32  # samples that show one
FOR_GOOD = 256  # samples without a channel that show that it will not come back
NAMES = 1024  # sets of channels that are told apart
KEPT = 8  # rhythms whose gains are kept
SHOWN = np.maximum(REPEATED * np.arange(1, LONGEST + 1), LEAST)  # samples that show each period
SHOWN[0] = FOR_GOOD


class Rhythm:
    """The filters of a period.

    Parameters
    ----------
    core : SquareRoot
    masks : array of bool, shape (phases, m)

    Raises
    ------
    NotIdentifiable
        No filter settles on these channels.
    """

    def __init__(self, core: SquareRoot, masks: NDArray[np.bool_]) -> None:
        self.masks, self.filters = masks, periodic(core.model, masks)
        self.variances = [np.sum(f.L**2, axis=1) for f in self.filters.phases]
        self.std, self.absent = self.filters.std, np.sum(~masks, axis=1)
        self.std.setflags(write=False)
        zero, last = np.zeros(core.model.n), np.roll(masks, 1, axis=0)
        self.ahead = [  # root of the prediction of each phase
            core.predict(State(zero, self.filters.phases[t - 1].L, np.where(last[t], 0.0, np.nan))).L
            for t in range(len(masks))
        ]

    @property
    def period(self) -> int:
        """Samples."""
        return len(self.masks)

    def pair(self, phase: int) -> tuple[Steady, Steady]:
        """Filters of the phase before, and of this one; phases count on."""
        phases, T = self.filters.phases, self.period
        return phases[(phase - 1) % T], phases[phase % T]


class Listener:
    """Recognises a period in the sets of channels that come.

    Parameters
    ----------
    core : SquareRoot
    """

    def __init__(self, core: SquareRoot) -> None:
        self.core = core
        self._known: dict[bytes, Rhythm | None] = {}
        self.clear()

    def clear(self) -> None:
        """Forget what has come."""
        self.heard = 0
        self._last: tuple[tuple[int, int], Rhythm | None, int] | None = None
        self._names: dict[bytes, int] = {}  # of masks, in the ring
        self._ring = np.full(2 * LONGEST, -1)  # the last ones, the newest first, twice: they lie side by side
        self.runs = np.zeros(LONGEST, int)  # samples in a row that were as those 1, 2, ... samples before

    def hear(self, mask: NDArray[np.bool_]) -> None:
        """Channels present in the next sample."""
        if len(self._names) >= NAMES:  # sets that never come again
            self._rename()
        name = self._names.setdefault(mask.tobytes(), len(self._names))
        at = LONGEST - self.heard % LONGEST  # the ring runs backwards
        self.runs += 1
        self.runs *= self._ring[at : at + LONGEST] == name
        self._ring[at - 1] = self._ring[at - 1 + LONGEST] = name
        self.heard += 1

    def _rename(self) -> None:
        """Names of the sets in the ring alone."""
        used, ring = np.unique(self._ring, return_inverse=True)
        known = list(self._names)
        gone = int(used[0] == -1)  # nothing has come there
        self._names = {known[old]: new for new, old in enumerate(used[gone:])}
        self._ring = ring.reshape(-1) - gone

    def past(self, count: int) -> NDArray[np.bool_]:
        """Masks of the last samples (count, m), the oldest first."""
        at = LONGEST - (self.heard - 1) % LONGEST - 1
        masks = [np.frombuffer(name, bool) for name in self._names]
        return np.array([masks[i] for i in self._ring[at : at + count][::-1]]).reshape(count, self.core.model.m)

    def found(self) -> tuple[Rhythm, int] | None:
        """The rhythm of what came last, and the phase of the last sample; None where there is none that settles."""
        shown = self.runs >= SHOWN
        if not shown.any():
            return None
        period = int(np.argmax(shown)) + 1
        if self._last is not None and self._last[0] == (self.heard - 1, period):  # it goes on
            rhythm, phase = self._last[1], (self._last[2] + 1) % period
            self._last = (self.heard, period), rhythm, phase
            return None if rhythm is None else (rhythm, phase)
        masks = self.past(period)  # the last one is that of now
        turn = min(range(period), key=lambda t: np.roll(masks, -t, axis=0).tobytes())
        rhythm = self.solved(np.roll(masks, -turn, axis=0))
        phase = (period - 1 - turn) % period
        self._last = (self.heard, period), rhythm, phase
        return None if rhythm is None else (rhythm, phase)

    def solved(self, masks: NDArray[np.bool_]) -> Rhythm | None:
        """Filters of a period, solved for once; None where none settles."""
        key = masks.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.clear()
            try:
                self._known[key] = Rhythm(self.core, masks) if masks.any() else None
            except (NotIdentifiable, InputError):
                self._known[key] = None
        return self._known[key]

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {"heard": self.heard, "past": self.past(min(self.heard, LONGEST)), "runs": self.runs.copy()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.clear()
        past = np.array(tree["past"], bool).reshape(-1, self.core.model.m)
        self.heard = int(tree["heard"]) - len(past)
        for mask in past:
            self.hear(mask)
        self.runs = np.array(tree["runs"], int)
