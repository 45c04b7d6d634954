"""Means of innovations in service: of how many standard errors they lie off zero.

Means of pieces tell the standard error of the whole where innovations are correlated (`loadid.flags.tracking.biases`).
A stream has no length: where there are too many pieces, two are made one, and the pieces are as long as it needs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

PIECES = 40  # at most, then half as many, twice as long
SHORTEST = 10  # samples of a piece
FEWEST = 16  # pieces, from which a mean is judged


class Means:
    """Sums of the innovations of all channels, piece by piece.

    Parameters
    ----------
    m : int
        Channels.
    """

    def __init__(self, m: int) -> None:
        self.length, self.filled = SHORTEST, 0  # samples of a piece, and of the one that is not full
        self.sums, self.counts = np.zeros((1, m)), np.zeros((1, m))  # (pieces, m), the last is not full

    def add(self, e: NDArray) -> None:
        """Take up normalised innovations (samples, m); NaN where there is none."""
        k = 0
        while k < len(e):
            part = e[k : k + self.length - self.filled]
            there = np.isfinite(part)
            self.sums[-1] += np.where(there, part, 0.0).sum(axis=0)
            self.counts[-1] += there.sum(axis=0)
            self.filled, k = self.filled + len(part), k + len(part)
            if self.filled == self.length:
                self._next()

    def _next(self) -> None:
        """A new piece."""
        if len(self.sums) == PIECES:
            self.sums, self.counts = (x[0::2] + x[1::2] for x in (self.sums, self.counts))
            self.length *= 2
        self.filled, none = 0, np.zeros((1, self.sums.shape[1]))
        self.sums, self.counts = np.vstack([self.sums, none]), np.vstack([self.counts, none])

    def errors(self) -> NDArray[np.float64]:
        """Standard errors by which the mean of each channel lies off zero (m,); 0 where there are too few pieces."""
        out = np.zeros(self.sums.shape[1])
        for i, (sums, counts) in enumerate(zip(self.sums[:-1].T, self.counts[:-1].T, strict=True)):
            there = counts > 0
            if there.sum() < FEWEST:
                continue
            means = sums[there] / counts[there]
            error = max(float(means.std(ddof=1)), np.finfo(float).tiny) / np.sqrt(len(means))
            out[i] = float(means.mean()) / error
        return out

    def to_tree(self) -> dict[str, Any]:
        """Everything, as plain arrays and numbers."""
        return {"length": self.length, "filled": self.filled, "sums": self.sums.copy(), "counts": self.counts.copy()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.length, self.filled = int(tree["length"]), int(tree["filled"])
        self.sums, self.counts = np.array(tree["sums"], float), np.array(tree["counts"], float)
