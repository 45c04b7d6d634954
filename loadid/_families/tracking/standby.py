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

WINDOWS = (1, 2, 4, 8)  # hops, each twice the one before
BEFORE = WINDOWS[-1] - 1  # hops of which the sums are kept
GRID = 16  # hops from one prediction that is kept to the next
BEHIND = 17  # hops at least over which the hypotheses are followed when they are woken
CHUNK = 64  # hops that are looked at together
RARELY = 4.5  # std of a Gaussian: as rarely is white noise beyond the bounds
ABOVE = 1.25  # times what the record of the fit gave beyond its mean
BELOW = 0.5  # of what a channel must cost to be named
SHARE = 0.8  # of the load that is a reason to look


def bounds(seen: Array, least: float) -> Array:
    """Of the sums of each window (windows, m + 2), below which there is nothing to look at.

    Parameters
    ----------
    seen : array (windows, hops, m + 2)
        What the record of a fit gave.
    least : float
        What a channel must cost to be named, -2 log of the likelihood ratio.
    """
    m = seen.shape[2] - 2
    free = np.outer(np.array(WINDOWS) * HOP, np.r_[np.ones(m), m, 0])
    free[:, -1] = m
    mean = seen.mean(axis=1)
    rare = mean * (1 - 2 / (9 * free) + RARELY * np.sqrt(2 / (9 * free))) ** 3  # Wilson and Hilferty
    highest = mean + np.minimum(ABOVE * (seen.max(axis=1) - mean), BELOW * least)
    return np.asarray(np.maximum(rare, highest))


class Standby:
    """The filter with all channels, and what it has seen.

    Parameters
    ----------
    bank : Lifted
    bounds : array (windows, m + 2), optional
        Infinite by default.
    most : array (p,), optional
        Largest loads at the end of a hop; infinite by default.
    """

    def __init__(self, bank: Lifted, bounds: Array | None = None, most: Array | None = None) -> None:
        A, B, W, G, H = bank.A[0], bank.B[0], bank.W[0], bank.G[0], bank.H
        p, self.m = len(bank.Cp), len(H)
        rows = np.vstack([np.hstack([bank.Cp - G @ H, G]), np.hstack([-W @ H, W]), np.hstack([A, B])])
        self.loop = Loop(rows, p, self.m, bank.x0)
        self.bounds = np.full((len(WINDOWS), 1, self.m + 2), np.inf) if bounds is None else bounds[:, None]
        self.most = np.full(p, np.inf) if most is None else most
        self.sums = np.zeros((BEFORE, 2 * self.m))  # of the last hops: of the innovations, and of their squares
        self.hops: deque[Array] = deque(maxlen=BEHIND + GRID)
        self.starts: deque[Array | None] = deque(maxlen=BEHIND + GRID)  # predictions before them, where known
        self.slept = 0  # hops since it is alone
        self.found = np.zeros((len(WINDOWS), 0, self.m + 2))  # of the last samples

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
            self.hops.append(Y[k * HOP : (k + 1) * HOP].copy())
            self.starts.append(marks.get(k))
        self.slept += taken
        return taken, strange

    def windows(self, z: Array) -> Array:
        """Sums (windows, hops, m + 2) over the windows that end with each hop of innovations (hops HOP, m)."""
        m, h = self.m, len(z) // HOP
        z = z[: h * HOP].reshape(h, HOP, m)
        new = np.empty((BEFORE + h, 2 * m))
        new[:BEFORE] = self.sums
        np.einsum("ijk->ik", z, out=new[BEFORE:, :m])
        np.einsum("ijk,ijk->ik", z, z, out=new[BEFORE:, m:])
        self.sums = new
        found, one = np.empty((len(WINDOWS), h, m + 2)), new
        for i, w in enumerate(WINDOWS):
            if i:
                one = one[w // 2 :] + one[: -w // 2]
            last = one[len(one) - h :]
            found[i, :, :m] = last[:, m:]
            np.einsum("ij,ij->i", last[:, :m], last[:, :m] / (w * HOP), out=found[i, :, m + 1])
        np.einsum("ijk->ij", found[:, :, :m], out=found[:, :, m])
        return found

    # -- inside -----------------------------------------------------------------------------------------------------
    def _judged(self, load: Array, z: Array, done: int) -> tuple[int, bool]:
        """Hops up to the first in which there is anything, of which so many samples were taken."""
        whole, total = done // HOP, len(z) // HOP
        self.found = self.windows(z[:done])
        beyond = self.found > self.bounds
        first = whole
        if np.count_nonzero(beyond):
            first = int(np.argmax(beyond.any(axis=(0, 2))))
        ends = np.abs(load[HOP - 1 : done : HOP]) > self.most
        if np.count_nonzero(ends):
            first = min(first, int(np.argmax(ends.any(axis=1))))
        strange = first < total
        self.sums = self.sums[: BEFORE + first + 1][-BEFORE:]
        if first == whole < total:  # no numbers, or none that are finite
            self.sums = np.concatenate([self.sums[1:], np.full((1, 2 * self.m), np.inf)])
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
