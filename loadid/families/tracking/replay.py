"""The last samples of a tracker, so that one that comes late is put in its place and the filter runs again from there.

Two anchors, a window apart, hold the whole state of the tracker; the samples since the older one are kept. That is one
copy of a row a sample, and a window behind the newest sample is always within reach.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


class Replay:
    """Anchors and samples.

    Parameters
    ----------
    window : int
        Samples behind the newest one that a late sample may lie.
    """

    def __init__(self, window: int) -> None:
        self.window = window
        self.count = 0  # samples taken
        self.anchors: list[tuple[int, dict[str, Any]]] = []  # samples taken before it, and the state then
        self.samples: list[NDArray[np.float64]] = []  # since the older anchor

    def cuts(self, more: int) -> list[int]:
        """Where a block of `more` samples is cut: at the anchors that single samples would leave behind, and there."""
        stop = self.count + more
        last = stop - 1 - (stop - 1) % self.window
        wanted = [k for k in (last - self.window, last) if self.count <= k < stop]
        if not self.anchors:
            wanted.append(self.count)
        return [*sorted({k - self.count for k in wanted}), more]

    def anchor(self, tree: dict[str, Any]) -> None:
        """The state before the next sample."""
        if self.anchors and self.anchors[-1][0] == self.count:
            return
        self.anchors = [*self.anchors[-1:], (self.count, tree)]
        self.samples = self.samples[self.anchors[0][0] - self._first :]
        self._first = self.anchors[0][0]

    _first = 0

    def push(self, rows: NDArray) -> None:
        """Samples (samples, sensors) that the tracker has taken."""
        self.samples.extend(np.array(rows, float))
        self.count += len(rows)

    def place(self, ago: int) -> int | None:
        """Index among the kept samples of the one with `ago` samples after it; None where it is out of reach."""
        found = len(self.samples) - 1 - ago
        return found if ago < self.window and found >= 0 else None

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {
            "count": self.count, "first": self._first, "samples": np.array(self.samples),
            "anchors": [[k, tree] for k, tree in self.anchors],
        }  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.count, self._first = int(tree["count"]), int(tree["first"])
        self.samples = list(np.asarray(tree["samples"], float))
        self.anchors = [(int(k), anchor) for k, anchor in tree["anchors"]]
