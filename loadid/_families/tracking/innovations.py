"""Innovations in service: means, which tell of offsets and of loads that stay, and their power over stretches.

Means of pieces tell the standard error of the whole where innovations are correlated
(`loadid._guards.tracking.biases`). A stream has no length: where there are too many pieces, two are made one, and the
pieces are as long as it needs.

A prior that is too small for the loads in service leaves innovations that are too large and alike from sample to sample
(R. K. Mehra, IEEE Transactions on Automatic Control 15 (1970) 175), for as long as these loads act. So sums of some
neighbours are looked at, and of the hops of a stretch the median: single events are for the gate.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..._inverse.gaussian.roots import Array
from ..._inverse.gaussian.steady import SteadyFilter
from .bank import HOP

PIECES = 40  # at most, then half as many, twice as long
SHORTEST = 10  # samples of a piece
FEWEST = 16  # pieces, from which a mean is judged
ROUNDING = 1e-9  # of a number, below which it is none
SHOWN = 1e-3  # stds of an innovation that a load as large as its prior must add to the mean, to be taken for a mean
HOPS = 16  # of a stretch
TOGETHER = 4  # samples of a sum
STRETCH = HOPS * HOP  # samples


def constant(settled: SteadyFilter) -> Array:
    """Mean normalised innovations (m, p) of loads that stay, as large as their prior says.

    A prior that returns to zero predicts less of them.
    """
    model = settled.model
    nx, n = model.nx, model.n
    z = np.linalg.lstsq(model.Cp[:, nx:], np.eye(model.p), rcond=None)[0]
    x = np.linalg.lstsq(np.eye(nx) - model.F[:nx, :nx], model.F[:nx, nx:] @ z, rcond=None)[0]
    y = model.H @ np.vstack([x, z])
    ahead = np.linalg.lstsq(np.eye(n) - model.F @ (np.eye(n) - settled.K @ model.H), model.F @ settled.K @ y,
                            rcond=None)[0]  # fmt: skip
    size = np.linalg.norm(model.Cp @ model.L0, axis=1)
    return np.asarray((y - model.H @ ahead) * size / settled.innovation_std[:, None], float)


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

    def add(self, e: Array) -> None:
        """Take up normalised innovations (samples, m); NaN where there is none."""
        k, there = 0, np.isfinite(e)
        whole = np.count_nonzero(there) == there.size
        values = e if whole else np.where(there, e, 0.0)
        while k < len(e):
            part = slice(k, k + self.length - self.filled)
            # one after the other: blocks of any length give the same bits
            self.sums[-1] = np.add.accumulate(np.concatenate([self.sums[-1:], values[part]]))[-1]
            more = min(part.stop, len(e)) - k
            self.counts[-1] += more if whole else there[part].sum(axis=0)
            self.filled, k = self.filled + more, k + more
            if self.filled == self.length:
                self._next()

    def _next(self) -> None:
        """A new piece."""
        if len(self.sums) == PIECES:
            self.sums, self.counts = (x[0::2] + x[1::2] for x in (self.sums, self.counts))
            self.length *= 2
        self.filled, none = 0, np.zeros((1, self.sums.shape[1]))
        self.sums, self.counts = np.vstack([self.sums, none]), np.vstack([self.counts, none])

    def errors(self, loads: Array | None = None) -> Array:
        """Standard errors by which the mean of each channel lies off zero (m,); 0 where there are too few pieces.

        `loads` (m, any): means that are no offset but a load (`constant`); what is left beside them is judged.
        """
        out, there = np.zeros(self.sums.shape[1]), self.counts[:-1] > 0
        seen = there.sum(axis=0) >= FEWEST
        whole = there[:, seen].all(axis=1)
        if not seen.any() or whole.sum() < FEWEST:
            return out
        means = self.sums[:-1][np.ix_(whole, seen)] / self.counts[:-1][np.ix_(whole, seen)]
        if loads is not None:
            U, s, _ = np.linalg.svd(loads[seen], full_matrices=False)
            U = U[:, s > SHOWN]
            means = means - means @ U @ U.T
        off = means - means.mean(axis=0)
        power = np.maximum(np.sum(off**2, axis=0), np.finfo(float).tiny)
        alike = np.clip(np.sum(off[1:] * off[:-1], axis=0) / power, 0.0, 0.99)  # neighbours, of a filter that is slow
        error = np.sqrt((1 + alike) / (1 - alike)) * means.std(axis=0, ddof=1) / np.sqrt(len(means))
        told = error > ROUNDING * np.abs(self.sums[:-1]).max(initial=1.0)
        out[seen] = np.where(told, means.mean(axis=0) / np.where(told, error, 1.0), 0.0)
        return out

    def to_tree(self) -> dict[str, Any]:
        """Everything, as plain arrays and numbers."""
        return {"length": self.length, "filled": self.filled, "sums": self.sums.copy(), "counts": self.counts.copy()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.length, self.filled = int(tree["length"]), int(tree["filled"])
        self.sums, self.counts = np.array(tree["sums"], float), np.array(tree["counts"], float)


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
