"""Wrong samples of a record: single numbers of one sensor that no load explains.

An innovation cannot tell a wrong number from an impact, as both surprise. What the smoother leaves of the data can: it
has seen what came later, and a load that is there moves all sensors, so that little is left; of a wrong number nearly
all is left, in one channel alone.

Source: A. C. Harvey, S. J. Koopman, J. Business & Economic Statistics 10 (1992) 377-389 (auxiliary residuals).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...inverse.kalman.steady import Steady

BEYOND = 8.0  # stds of what is left of a channel, and of its noise
AHEAD = 3.0  # times what is left of the other channels around: no load moves one sensor only
AROUND = 2  # samples before and after, in which they are asked
APART = 10  # samples, within which only the largest is taken at once: a wrong number spoils what is left around it
MOST = 0.02  # of the samples of a record that may be wrong: more is no matter of single samples
TURNS = 12  # in which new ones are looked for
ROUNDS = 3  # of the numbers that stand in for wrong ones
SMALLEST = 1e-3  # share of a number that is left of it: less is no matter of one sample
QUARTILE = 0.6745  # of a normal number's size, which has the median one


@dataclass(frozen=True, eq=False)
class Wrong:
    """Wrong samples, and the record as the others have it.

    Parameters
    ----------
    mask : array of bool, shape (samples, m)
    values : array, shape (samples, m)
        The record; where the mask holds, what all other samples say of it.
    """

    mask: NDArray[np.bool_]
    values: NDArray[np.float64]

    @property
    def count(self) -> int:
        """Of all channels."""
        return int(self.mask.sum())


def wrong_samples(settled: Steady, Y: NDArray) -> Wrong:
    """Numbers of a complete record Y (samples, m) that no load explains, by a smoother at the numbers of a filter.

    Where the load itself moves as it seldom does (an impact, a step) a prior may fit it badly, and that is left alone.
    """
    none = np.zeros(Y.shape, bool)
    mask, kept, values, share = none, none, Y, None
    for _ in range(TURNS):
        new = _apart(settled, left(settled, values)[0]) & ~mask & ~kept
        if not new.any():
            return Wrong(mask, values)
        mask = mask | new
        if mask.any(axis=1).mean() > MOST:
            break
        if share is None:
            share = own_share(settled, len(Y))
        values = _replaced(settled, Y, mask, values, share)
        moved = mask & _event(left(settled, values)[1])[:, None]
        if moved.any():
            mask, kept = mask & ~moved, kept | moved
            values = _replaced(settled, Y, mask, values, share)
    return Wrong(none, Y)


def _replaced(settled: Steady, Y: NDArray, mask: NDArray, values: NDArray, share: NDArray) -> NDArray[np.float64]:
    """The record with what all others say where the mask holds: numbers that the smoother leaves nothing of."""
    values = np.where(mask, values, Y)
    for _ in range(ROUNDS):
        values = np.where(mask, values - left(settled, values)[0] / share, Y)
    return values


def _event(load: NDArray) -> NDArray[np.bool_]:
    """Where a load (samples, p) moves within a few samples as it seldom does (samples,)."""
    moved = np.zeros(load.shape)
    moved[AROUND:-AROUND] = np.abs(load[2 * AROUND :] - load[: -2 * AROUND])
    usual = np.median(moved, axis=0) / QUARTILE
    return np.any(moved > BEYOND * usual, axis=1)


def own_share(settled: Steady, samples: int) -> NDArray[np.float64]:
    """What is left of a one amid a record of zeros, for each channel (m,)."""
    m, at = len(settled.Se_root), samples // 2
    found = np.empty(m)
    for i in range(m):
        one = np.zeros((samples, m))
        one[at, i] = 1.0
        found[i] = left(settled, one)[0][at, i]
    return np.maximum(found, SMALLEST)


def left(settled: Steady, Y: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What a smoother at the settled gain leaves of a complete record (samples, m), and its loads (samples, p)."""
    from ...inverse.kalman.loops import Loop
    from ...inverse.kalman.records import back_mean

    model = settled.model
    load, change = np.empty((len(Y), model.p)), np.empty((len(Y), model.p))
    e, rest = np.empty(Y.shape), np.empty(Y.shape)
    loop = Loop(settled.rows(), model.p, model.m, model.x0)
    loop.compile()
    loop.block(Y, load, e)
    back_mean(settled, e, np.zeros(model.n), change, rest)
    return rest, load - change


def _apart(settled: Steady, rest: NDArray) -> NDArray[np.bool_]:
    """Where one channel is far out, alone and more so than the samples around (samples, m)."""
    from scipy.ndimage import maximum_filter1d

    noise = np.linalg.norm(settled.model.LR, axis=1)
    usual = np.median(np.abs(rest), axis=0) / QUARTILE
    size = np.abs(rest) / np.maximum(np.where(usual > 0, usual, np.inf), noise)
    around = maximum_filter1d(size, 2 * AROUND + 1, axis=0)
    ranked = np.sort(around, axis=1)
    others = np.where(around == ranked[:, -1:], ranked[:, -2:-1] if size.shape[1] > 1 else 0.0, ranked[:, -1:])
    highest = maximum_filter1d(size.max(axis=1), 2 * APART + 1)[:, None]
    return (size > BEYOND) & (size >= highest) & (size > AHEAD * others)
