"""What a channel that is wrong does: offset, drift, stuck, dead, swapped with another one, or wrong in another way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..._inverse.gaussian.roots import Array
from .bank import Bits
from .windows import MIDDLE

KINDS = ("wrong", "offset", "drift", "stuck", "dead", "swapped")


@dataclass(frozen=True)
class ChannelFault:
    """A channel that is wrong.

    Parameters
    ----------
    channel : int
    other : int
        With which it is swapped, else -1.
    kind : str
        One of `KINDS`.
    sample : int
        Before which it was named.
    """

    channel: int
    other: int
    kind: str
    sample: int


def stopped(past: Array, there: Bits, roots: Array) -> int | None:
    """The one channel that has stopped to move: no other one need tell.

    Parameters
    ----------
    past : array (hops, samples, m)
    there : array (m,)
        Channels that are.
    roots : array (m, m)
        Lower factor of the covariance of the noise.
    """
    noise = np.linalg.norm(roots, axis=1)
    past = np.where(there, past, 0.0)
    last, early = past[-1], past[: len(past) // 2]
    if len(past) < 4 or not np.isfinite(last).all() or not np.isfinite(early).all():
        return None
    moved = np.sqrt(np.median(np.var(early, axis=1), axis=0)) > 5 * noise
    still = moved & ((np.ptp(last, axis=0) < 1e-3 * noise) | (np.std(last, axis=0) < 1.5 * noise))
    found = np.flatnonzero(still)
    return int(found[0]) if len(found) == 1 else None


def kind_of(past: Array, noise: float, sums: Array, own: float) -> str:
    """What a channel does, in a word of `KINDS`.

    Parameters
    ----------
    past : array (hops, samples)
        Of the channel.
    noise : float
        Its std.
    sums : array (2, 4)
        Of its innovations in the last two hops: how many, sum, squares, moment about the middle.
    own : float
        Their usual mean square.
    """
    last = past[-1][np.isfinite(past[-1])]
    if len(last) < 2:
        return "wrong"
    before = past[: max(len(past) // 2, 1)]
    before = before[np.isfinite(before)]
    spread = float(np.std(before)) if len(before) else 0.0
    if np.ptp(last) <= 1e-3 * noise:
        return "dead" if abs(float(last[0])) <= 1e-3 * noise else "stuck"
    if np.std(last) < 2 * noise and spread > 5 * noise and abs(np.mean(last)) < 2 * noise:
        return "dead"
    number, total, squares, moment = sums.T
    number = np.maximum(number, 1)
    mean = total / number
    rest = (squares - moment**2 / float(MIDDLE @ MIDDLE)) / number - mean**2
    if np.all(rest <= 3 * own) and np.all(np.abs(mean) > 1):
        moved = abs(mean[-1] - mean[0])
        return "drift" if moved > 4 * np.sqrt(own * 2 / number[-1]) else "offset"
    return "wrong"
