"""The cheap part of the watch over the sensors, which is always on: is there anything to look at?

The settled filter with all channels alone, over hops of samples. Its whitened innovations are summed over windows that
end now: the squares of each and of all, and the square of their mean; the load is held against those of the fit. As
long as these stay below what the record of the fit gave, or what white noise gives once in a long time, and well below
what any channel must cost before it is named, no hypothesis of `watch` wins, and none of them is followed. Otherwise
they all go on from a prediction of this filter some hops back, over the samples since, which are kept.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._inverse.gaussian.loop import Loop
from ..._inverse.gaussian.roots import Array
from .bank import HOP, Lifted

WINDOWS = (1, 2, 4, 8)  # hops
BEFORE = WINDOWS[-1] - 1  # hops of which the sums are kept
GRID = 16  # hops from one prediction that is kept to the next
BEHIND = 17  # hops at least over which the hypotheses are followed when they are woken
REST = WINDOWS[-1]  # hops in a row without anything, after which the hypotheses sleep
CHUNK = 64  # hops that are looked at together
ALL = np.ones(HOP)  # samples of a hop
TOP = 1e6  # innovation over its std, from which there is something, as where it is no number
RARELY = 4.5  # std of a Gaussian: as rarely is white noise beyond the bounds
ABOVE = 1.25  # times what the record of the fit gave beyond its mean
BELOW = 0.5  # of what a channel must cost to be named
SHARE = 0.8  # of the load that is a reason to look
SHOWN = 20  # samples over which a load shows
ENDS = np.array([[float(k >= WINDOWS[-1] - w) for k in range(WINDOWS[-1])] for w in WINDOWS])  # what a window adds up


def bounds(seen: Array, loads: int, least: float) -> Array:
    """Of the sums of each window (windows, own + 3), below which there is nothing to look at.

    Parameters
    ----------
    seen : array (hops, windows, own + 3)
        What the record of a fit gave.
    loads : int
    least : float
        What a channel must cost to be named, -2 log of the likelihood ratio.
    """
    own, n, mean = seen.shape[2] - 3, np.array(WINDOWS) * HOP, seen.mean(axis=0)
    free = np.column_stack([np.outer(n, np.r_[np.ones(own), own + loads]), np.full((len(n), 2), [max(own, 1), loads])])
    rare = mean * (1 - 2 / (9 * free) + RARELY * np.sqrt(2 / (9 * free))) ** 3  # Wilson and Hilferty
    cost = np.full(mean.shape, least)
    cost[:, -2:] *= n[:, None]  # of sums, not of means
    above = np.minimum(ABOVE * (seen.max(axis=0) - mean), BELOW * cost)
    above[:, -1] = cost[:, -1]  # another load than at the fit: no channel is named for it
    return np.asarray(np.maximum(rare, mean + above))


def _turned(A: Array, WH: Array, LQ: Array, p: int) -> Array:
    """Whitened innovations turned so that those in which a load shows most are the last p."""
    ways = [LQ]
    for _ in range(SHOWN):
        ways.append(A @ ways[-1])
    return np.linalg.svd(WH @ np.hstack(ways))[0].T[::-1]


class Standby:
    """The filter with all channels, and what it has seen.

    Parameters
    ----------
    bank : Lifted
    LQ : array (n, any)
        What a sample adds to the states, root of its covariance.
    bounds : array (windows, any), optional
        Infinite by default.
    most : array (p,), optional
        Largest loads at the end of a hop; infinite by default.
    """

    def __init__(self, bank: Lifted, LQ: Array, bounds: Array | None = None, most: Array | None = None) -> None:
        A, B, G, H = bank.A[0], bank.B[0], bank.G[0], bank.H
        W, self.own = _turned(A, bank.W[0] @ H, LQ, len(bank.Cp)) @ bank.W[0], max(len(H) - len(bank.Cp), 0)
        p, self.m = len(bank.Cp), len(H)
        rows = np.vstack([np.hstack([bank.Cp - G @ H, G]), np.hstack([-W @ H, W]), np.hstack([A, B])])
        self.loop = Loop(rows, p, self.m, bank.x0, np.full(self.m, TOP))
        self.bounds = np.full((len(WINDOWS), self.own + 3), np.inf) if bounds is None else bounds
        self.reach = None if most is None or np.all(np.isinf(most)) else most
        self.parts = np.zeros((2 * self.m, self.own + 3))
        self.parts[: self.own, -2] = self.parts[self.own : self.m, -1] = self.parts[self.m :, self.own] = 1.0
        self.parts[self.m : self.m + self.own, : self.own] = np.eye(self.own)
        self.sums = np.zeros((BEFORE, 2 * self.m))  # of the last hops: of the innovations, and of their squares
        self.hops: deque[Array] = deque(maxlen=BEHIND + GRID)
        self.starts: deque[Array | None] = deque(maxlen=BEHIND + GRID)  # predictions before them, where known
        self.slept = 0  # hops since it is alone
        self.found = np.zeros((0, len(WINDOWS), self.own + 3))  # of the last samples

    def begin(self, x: Array, hops: Array, starts: Array) -> None:
        """Be alone from a prediction on, after hops (hops, HOP, m) and the predictions before them."""
        self.loop.x, self.slept = x, 0
        self.hops.clear()
        self.starts.clear()
        self.hops.extend(hops)
        self.starts.extend(starts)

    def back(self) -> tuple[Array, list[Array]]:
        """A prediction some hops back, and the hops since."""
        known = [k for k, x in enumerate(self.starts) if x is not None]
        k = max((k for k in known if len(self.hops) - k >= BEHIND), default=known[0])
        start = self.starts[k]
        assert start is not None
        return start, list(self.hops)[k:]

    def look(self, x: Array, Y: Array) -> bool:
        """Whether there is anything in a hop (HOP, m) that begins at a prediction."""
        self.loop.x = x
        load, z = np.empty((HOP, self.loop.p)), np.empty(Y.shape)
        return self._judged(load, z, self.loop.block(Y, load, z))[1]

    def take(self, Y: Array) -> tuple[int, bool]:
        """Hops (hops HOP, m) up to the first in which there is anything: how many, and whether there is."""
        load, z, marks, done = np.empty((len(Y), self.loop.p)), np.empty(Y.shape), {}, 0
        while done < len(Y):
            ahead = -(self.slept + done // HOP) % GRID
            if ahead == 0:
                marks[done // HOP], ahead = self.loop.x, GRID
            part = slice(done, min(done + ahead * HOP, len(Y)))
            done += self.loop.block(Y[part], load[part], z[part])
            if done < part.stop:
                break
        taken, strange = self._judged(load, z, done)
        for k in range(max(taken - BEHIND - GRID, 0), taken):
            self.hops.append(np.array(Y[k * HOP : (k + 1) * HOP]))
            self.starts.append(marks.get(k))
        self.slept += taken
        return taken, strange

    def windows(self, z: Array) -> Array:
        """Sums (hops, windows, own + 3) over the windows that end with each hop of innovations (hops HOP, m).

        Squares of each that a load does not explain, and of all; of the sums of the former and of the others.
        """
        m, h = self.m, len(z) // HOP
        z = z[: h * HOP].reshape(h, HOP, m)
        self.sums = new = np.concatenate([self.sums, np.empty((h, 2 * m))])
        new[BEFORE:, :m], new[BEFORE:, m:] = np.matmul(ALL, z), np.matmul(ALL, z * z)
        over = np.matmul(ENDS, np.ndarray((h, len(ENDS[0]), 2 * m), float, new, 0, (new.strides[0], *new.strides)))
        means = over[:, :, :m]
        np.multiply(means, means, out=means)
        return np.asarray(np.matmul(over, self.parts))

    # -- inside -----------------------------------------------------------------------------------------------------
    def _judged(self, load: Array, z: Array, done: int) -> tuple[int, bool]:
        """Hops up to the first in which there is anything, of which so many samples were taken."""
        whole, total = done // HOP, len(z) // HOP
        self.found = self.windows(z[:done])
        within, first = self.found <= self.bounds, whole
        if np.count_nonzero(within) < within.size:
            first = int(np.argmin(within.all(axis=(1, 2))))
        if self.reach is not None:
            ends = np.abs(load[HOP - 1 : done : HOP]) <= self.reach
            if np.count_nonzero(ends) < ends.size:
                first = min(first, int(np.argmin(ends.all(axis=1))))
        strange = first < total
        self.sums = self.sums[: BEFORE + first + 1][-BEFORE:]
        if first == whole < total:  # no numbers, or none that are finite
            self.sums = np.concatenate([self.sums[1:], np.full((1, 2 * self.m), TOP**2)])
        return first + strange, strange

    # -- files ------------------------------------------------------------------------------------------------------
    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        starts = [np.full(len(self.loop.x), np.nan) if x is None else x for x in self.starts]
        return {"x": self.loop.x, "sums": self.sums.copy(), "hops": np.array(self.hops), "starts": np.array(starts),
                "slept": self.slept}  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.begin(np.asarray(tree["x"], float), np.asarray(tree["hops"], float), np.zeros((0, 0)))
        known: NDArray[Any] = np.asarray(tree["starts"], float)
        self.starts.extend(None if np.isnan(x).any() else x for x in known)
        self.sums, self.slept = np.array(tree["sums"], float), int(tree["slept"])
