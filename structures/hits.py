"""Hammer hits: which records of an impact test may enter an FRF, and why the others may not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SECOND_HIT = 0.2  # share of the main peak that a separate later pulse must reach
RAIL = 3  # consecutive samples at the extreme that count as clipped


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
        Digest of each response, so that a later test can tell whether it was used for training.
    """

    name: str
    used: bool
    reason: str
    peak: float
    digests: tuple[str, ...] = ()


def judge(force: NDArray, responses: NDArray) -> str:
    """Reason to reject a hit, or "".

    Parameters
    ----------
    force : array, shape (samples,)
    responses : array, shape (samples, sensors)
    """
    if not (np.all(np.isfinite(force)) and np.all(np.isfinite(responses))):
        return "NaN or inf in the record"
    k = int(np.argmax(np.abs(force)))
    peak = abs(force[k])
    tail = force[len(force) // 2 :]
    if peak == 0 or peak < 8 * np.std(tail):
        return f"no hit: peak {peak:.3g} is less than 8 times the scatter {np.std(tail):.3g} of the second half"
    run = flat_run(force, k)
    if run >= RAIL:
        return f"clipped force: {run} consecutive samples at the peak {force[k]:.4g}"
    second = second_pulse(force, k)
    if second is not None:
        return f"double hit: a second pulse of {abs(force[second]) / peak:.0%} at sample {second}"
    for j in range(responses.shape[1]):
        top = int(np.argmax(np.abs(responses[:, j])))
        run = flat_run(responses[:, j], top)
        if run >= RAIL:
            return f"overload: response {j} has {run} consecutive samples at {responses[top, j]:.4g}"
    return ""


def flat_run(x: NDArray, k: int) -> int:
    """Number of consecutive samples equal to ``x[k]`` around sample k."""
    same = x == x[k]
    left = k - int(np.argmin(same[k::-1])) if not same[: k + 1].all() else -1
    right = k + int(np.argmin(same[k:])) if not same[k:].all() else len(x)
    return right - left - 1


def second_pulse(force: NDArray, k: int) -> int | None:
    """Sample of a later or earlier pulse of the same sign that is separate from the one at k, or None.

    Separate: more than three widths away (at least 8 samples, so that the ringing of an anti-alias filter is not taken
    for a hit).
    """
    x = np.sign(force[k]) * force
    above = x > 0.5 * x[k]
    width = flat_run(np.where(above, 1.0, 0.0), k)
    gap = max(8, 3 * width)
    far = np.abs(np.arange(len(x)) - k) > gap
    candidates = np.flatnonzero(far & (x > SECOND_HIT * x[k]))
    return None if len(candidates) == 0 else int(candidates[np.argmax(x[candidates])])
