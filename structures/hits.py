"""Hammer hits: which records of an impact test may enter an FRF, and why the others may not."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SECOND_HIT = 0.2  # share of the main peak that a separate later pulse must reach
RAIL = 3  # consecutive equal samples at the extreme that count as clipped
QUIET = 8  # peak over scatter of the second half, below which there is no hit


@dataclass(frozen=True)
class Hit:
    """One record of an impact test.

    Parameters
    ----------
    name : str
    used : bool
    reason : str
        Why it was rejected; "" when used.
    peak : float
        Force of largest modulus, signed.
    digests : tuple of str
        Digest of each response as recorded, so that a later test can tell whether it was used for training.
    """

    name: str
    used: bool
    reason: str
    peak: float
    digests: tuple[str, ...] = ()


def digests(columns: NDArray) -> tuple[str, ...]:
    """sha256 of the samples of each column of an array (samples, columns)."""
    return tuple(hashlib.sha256(np.ascontiguousarray(c, float).tobytes()).hexdigest() for c in np.asarray(columns).T)


def unusable(force: NDArray, responses: NDArray, labels: Sequence[str]) -> str:
    """Why no FRF at all can be made of a record: numbers that are missing, or a channel that never moves; else ""."""
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(responses))):
        return "NaN or inf in the record"
    if not np.any(force):
        return "no hit: the force is zero throughout"
    dead = [label for label, x in zip(labels, responses.T, strict=True) if np.ptp(x) == 0]
    return f"dead: {', '.join(dead)} never moves" if dead else ""


def judge(force: NDArray, responses: NDArray, labels: Sequence[str]) -> str:
    """Reason to reject a usable record, or "".

    Parameters
    ----------
    force : array, shape (samples,)
    responses : array, shape (samples, sensors)
    labels : sequence of str
        Names of the sensors.
    """
    k = int(np.argmax(np.abs(force)))
    peak, noise = abs(force[k]), scatter(force[len(force) // 2 :])
    if peak < QUIET * noise:
        return f"no hit: peak {peak:.3g} is less than {QUIET} times the scatter {noise:.3g} of the second half"
    run = clipped(force, force[k])
    if run:
        return f"clipped force: {run} consecutive samples at the peak {force[k]:.4g}"
    second = second_pulse(force, k, noise)
    if second is not None:
        return f"double hit: a second pulse of {abs(force[second]) / peak:.0%} at sample {second}"
    for label, x in zip(labels, responses.T, strict=True):
        for top in (x.max(), x.min()):
            run = clipped(x, top)
            if run:
                return f"overload: {label} has {run} consecutive samples at {top:.4g}"
    return ""


def scatter(x: NDArray) -> float:
    """Standard deviation of the noise in `x` from its inner nine tenths: a second hit in there does not count."""
    return float(np.quantile(np.abs(x - np.median(x)), 0.9) / 1.645)


def clipped(x: NDArray, top: float) -> int:
    """Length of the longest stretch of samples at the extreme `top`, 0 where it is no rail.

    The parabola of a crest whose `n` samples in the middle are hidden falls by 8 times the hidden height over the next
    `n` samples. A crest that is only as flat as the last bit hides one or two bits; a cut one hides more.
    """
    start, stop = max(stretches(x == top), key=np.ptp)
    n = stop - start
    if n < RAIL or n == len(x):
        return 0
    fall = max(abs(top - x[max(start - n, 0)]), abs(top - x[min(stop - 1 + n, len(x) - 1)]))
    return int(n) if fall / 8 > 2.5 * last_bit(x) else 0


def last_bit(x: NDArray) -> float:
    """Smallest step between the levels of a recorded signal, from above; 0 where two levels or one do not tell."""
    tiny = 1e-6 * float(np.ptp(x))
    steps = np.diff(np.unique(x))
    steps = np.unique(steps[steps > tiny])
    finer = np.diff(steps)  # on a grid of levels, steps and their differences are multiples of the last bit
    finer = finer[finer > tiny]
    return (
        float(min(steps[0], *finer)) if len(steps) and len(finer) else float(steps[0]) if len(np.unique(x)) > 2 else 0.0
    )


def stretches(mask: NDArray) -> NDArray[np.int_]:
    """First sample and end of every stretch of a mask, shape (stretches, 2)."""
    return np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]))).reshape(-1, 2)


def second_pulse(force: NDArray, k: int, noise: float = 0.0) -> int | None:
    """Sample of a later or earlier pulse of the same sign that is separate from the one at k, or None.

    Separate: more than three widths away (at least 8 samples, so that the ringing of an anti-alias filter is not taken
    for a hit). A pulse: a fifth of the peak, and above the noise.
    """
    x = np.sign(force[k]) * force
    width = next(stop - start for start, stop in stretches(x > 0.5 * x[k]) if start <= k < stop)
    far = np.abs(np.arange(len(x)) - k) > max(8, 3 * width)
    candidates = np.flatnonzero(far & (x > max(SECOND_HIT * x[k], 6 * noise)))
    return None if len(candidates) == 0 else int(candidates[np.argmax(x[candidates])])
