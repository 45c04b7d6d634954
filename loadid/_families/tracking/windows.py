"""How likely each channel is wrong, over windows of hops that end now.

What is kept of a hop are sums over its samples, of the innovations of each filter: `said`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..._inverse.gaussian.roots import Array
from .bank import HOP, WINDOWS, Lifted

MIDDLE = np.arange(HOP) - (HOP - 1) / 2
LOUD = 1e9  # -2 log of a ratio, at most
TOP = 1e6  # normalised innovation, beyond which it is no larger


@dataclass(frozen=True, eq=False)
class Usual:
    """What the record of a fit gave.

    Parameters
    ----------
    squares : array (filters,)
        Mean normalised square of an innovation.
    own : array (filters,)
        Of the channel that is left out.
    most : array (m,)
        Largest likelihood ratio against each channel.
    loudest : float
        Largest normalised squares of a window, over their mean.
    calm : array (windows, any), optional
        `bank.bounds`; without them nothing sleeps.
    """

    squares: Array
    own: Array
    most: Array
    loudest: float
    calm: Array | None = None


def of_others(known: Usual, bank: Lifted, other: Lifted) -> Usual:
    """What is usual for the filters of another bank, of which each channel that is there has its own in both."""
    rows = np.array([bank.groups[i + 1, int(np.any(other.out[:k] == i))] for k, i in enumerate(other.out)])
    found = rows < len(bank.out)
    squares, own = (np.where(found, x[np.minimum(rows, len(bank.out) - 1)], 1.0) for x in (known.squares, known.own))
    return Usual(squares, own, known.most, known.loudest)


def said(z: Array, Y: Array, out: NDArray[np.int_]) -> tuple[Array, Array, Array]:
    """Squares and number of the innovations of used channels; number, sum, squares, moment of left-out ones."""
    there = np.isfinite(Y)
    if not there.all() or not np.abs(z).max() < TOP:
        z = np.clip(np.nan_to_num(z, nan=TOP), -TOP, TOP)
    number, left = there.sum(axis=0), out >= 0
    own = z[np.arange(len(z)), :, np.maximum(out, 0)] * left[:, None]
    squares = np.einsum("ij,ij->i", own, own)
    counts = np.where(left, number[np.maximum(out, 0)], 0)
    total = np.einsum("ijk,ijk->i", z, z) - squares
    return total, number.sum() - counts, np.array([counts, own.sum(axis=1), squares, own @ MIDDLE])


class Windows:
    """The last hops, as far as the longest window goes.

    Parameters
    ----------
    bank : Lifted
        Whose filters (q,) say what they make of the hops.
    usual : Usual
        What they said at the fit.
    """

    def __init__(self, bank: Lifted, usual: Usual) -> None:
        q = len(bank.out)
        self.bank, self.usual = bank, usual
        self.squares, self.counts = np.zeros((0, q)), np.zeros((0, q))  # of used channels
        self.apart = np.zeros((0, 4, q))  # of left-out ones: how many, sums, squares, moments about the middle
        self._hops = np.array(WINDOWS)
        self._level = np.log(usual.squares)
        self._own = np.where(bank.out < 0, 0.0, 2 * np.log(bank.own) + 1)

    def clear(self) -> None:
        """Begin new windows."""
        self.squares, self.counts, self.apart = self.squares[:0], self.counts[:0], self.apart[:0]

    def to_tree(self) -> dict[str, Array]:
        """What `restore` takes."""
        return {"squares": self.squares, "counts": self.counts, "apart": self.apart}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.squares, self.counts, self.apart = (np.array(tree[name]) for name in ("squares", "counts", "apart"))

    def keep(self, squares: Array, counts: Array, apart: Array) -> None:
        """One more hop, of the last ones that windows ask for."""
        most = max(WINDOWS) - 1
        self.squares = np.concatenate([self.squares[-most:], squares[None]])
        self.counts = np.concatenate([self.counts[-most:], counts[None]])
        self.apart = np.concatenate([self.apart[-most:], apart[None]])

    def ratios(self) -> tuple[Array, float, Array]:
        """Against each channel in each window, how loud the samples are, and without each channel: (windows, m)."""
        bank, u = self.bank, self.usual
        hops = self._hops[self._hops <= len(self.squares)]
        squares, counts, apart = (np.add.accumulate(x[::-1])[hops - 1] for x in (self.squares, self.counts, self.apart))
        cost = squares / u.squares + counts * self._level + (hops * HOP)[:, None] * bank.constant
        spread = np.log(np.maximum(apart[:, 2] / np.maximum(apart[:, 0], 1), u.own)) + self._own
        cost = np.concatenate([cost + apart[:, 0] * spread, np.full((len(hops), 1), np.inf)], axis=1)
        level = np.concatenate([squares / np.maximum(counts * u.squares, 1), np.full((len(hops), 1), np.inf)], axis=1)
        best, level = cost[:, bank.groups].min(axis=2), level[:, bank.groups].min(axis=2)
        found, explained = np.zeros((2, len(WINDOWS), len(best[0]) - 1))
        found[: len(hops)], explained[: len(hops)] = np.maximum(best[:, :1] - best[:, 1:], -LOUD), level[:, 1:]
        explained[len(hops) :] = level[-1, 1:]
        return found, float(level[-1, 0]) if len(self.squares) > 1 else 0.0, explained

    def last(self) -> float:
        """How loud the last hop is."""
        level = self.squares[-1] / np.maximum(self.counts[-1] * self.usual.squares, 1)
        return float(level[self.bank.out < 0].min())

    def beyond(self, i: int, window: int) -> Array:
        """What the hops of a window have of a channel beyond chance, in squares of its prediction."""
        its = self.bank.out == i
        some = self.apart[-max(WINDOWS[window], 2) :][:, :, its]
        return np.asarray(np.maximum(some[:, 2] / self.usual.own[its] - some[:, 0], 0).min(axis=1))
