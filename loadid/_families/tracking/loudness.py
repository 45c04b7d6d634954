"""How large innovations are over stretches of samples, beside what the filter says of them.

A prior that is too small for the loads in service leaves innovations that are too large and alike from sample to sample
(R. K. Mehra, IEEE Transactions on Automatic Control 15 (1970) 175), for as long as these loads act. So sums of some
neighbours are looked at, and of the hops of a stretch the median: single events are for the gate.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._inverse.gaussian.roots import Array
from .bank import HOP

HOPS = 16  # of a stretch
TOGETHER = 4  # samples of a sum
STRETCH = HOPS * HOP  # samples


def loudness(z: Array) -> Array:
    """Mean squares of sums of neighbours over their number, in the middle hop of each stretch (stretches,).

    Of normalised innovations (samples, m), NaN where a channel is missing; about 1 where the filter is right, and NaN
    where half of the hops of a stretch hold nothing. Samples beyond the last whole stretch are left.
    """
    pieces = z[: len(z) // STRETCH * STRETCH].reshape(-1, HOPS, HOP // TOGETHER, TOGETHER, z.shape[1])
    power = pieces.sum(axis=3) ** 2 / TOGETHER
    there = np.isfinite(power)
    count = there.sum(axis=(2, 3))
    mean = np.where(there, power, 0.0).sum(axis=(2, 3)) / np.maximum(count, 1)
    ranked = np.sort(np.where(count > 0, mean, np.inf), axis=1)
    known = (count > 0).sum(axis=1)
    middle = ranked[np.arange(len(ranked)), np.maximum(known - 1, 0) // 2]
    return np.where(2 * known > HOPS, middle, np.nan)


class Loudness:
    """The loudest stretch of innovations that come in blocks.

    Parameters
    ----------
    m : int
        Channels.
    """

    def __init__(self, m: int) -> None:
        self.rest = np.zeros((0, m))  # of the stretch that is not whole
        self.most = 0.0

    def add(self, z: Array) -> None:
        """Take up normalised innovations (samples, m); NaN where there is none."""
        rows = np.concatenate([self.rest, z])
        if len(rows) >= STRETCH:
            found = loudness(rows)
            self.most = float(np.nanmax(found, initial=self.most))
            rows = rows[len(found) * STRETCH :]
        self.rest = np.array(rows)

    def to_tree(self) -> dict[str, Any]:
        """Everything, as plain arrays and numbers."""
        return {"rest": self.rest.copy(), "most": self.most}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.rest, self.most = np.array(tree["rest"], float).reshape(-1, self.rest.shape[1]), float(tree["most"])
