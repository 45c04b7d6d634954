"""Bounds alone: loads change between free and held in blocks, with as little work per step as there can be."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .feasible import Feasible

if TYPE_CHECKING:
    from .quadratic import Quadratic

PATIENCE = 12
EAGER = 0.5  # loads pulled less than this share of the most pulled one wait: many of them need not move at all


def exchange(q: Quadratic, b: NDArray, s: Feasible, aim: NDArray, cap: int) -> tuple[NDArray, NDArray, int]:
    """Load, the point that projects to it, and steps: from the face of `aim`, until no load changes sides.

    Kunisch & Rendl, SIAM J. Optim. 14 (2003) 35: on a face the free loads solve the normal equations; loads beyond
    their bound are held next, held loads that are pulled inside are freed. Runs on the Gram matrix; the caller checks
    the result with the gradient formed from A, and takes another route where it fails.
    """
    from scipy.linalg import lapack

    G, tau, lower, upper = q.G, q.tau, s.lower, s.upper
    right = b @ q.A
    root = np.sqrt(tau)
    slack = 1e-14 * float(np.linalg.norm(b)) * root
    two_sided = bool(np.any(np.isfinite(upper)))
    low, high = aim <= lower, aim >= upper
    least, since, steps = len(aim) + 1, 0, 0
    x = np.clip(aim, lower, upper)
    while steps < cap:
        held = low | high
        f = np.flatnonzero(~held)
        x = np.zeros(len(aim))
        x[low], x[high] = lower[low], upper[high]
        if len(f):
            pull = right - G @ x if np.any(x) else right
            M = G.take(f, axis=0).take(f, axis=1).T  # symmetric: the transpose is in the order that LAPACK wants
            factor, info = lapack.dpotrf(M, overwrite_a=1, clean=0)
            if info:
                break
            x[f] = lapack.dpotrs(factor, pull[f])[0]
        steps += 1
        aim = x + tau * (right - G @ x)
        aim[f] = x[f]
        now_low = np.where(held, aim <= lower + slack, aim < lower)
        now_high = np.where(held, aim >= upper - slack, aim > upper) if two_sided else high
        freed = held & ~(now_low | now_high)
        moved = int(np.count_nonzero(now_low != low)) + int(np.count_nonzero(now_high != high) if two_sided else 0)
        if moved == 0:
            break
        if moved < least:
            least, since = moved, 0
        since += 1
        if since > PATIENCE:
            break
        if np.any(freed):
            pulled = np.where(freed, np.abs(aim - x) / root, 0.0)
            late = freed & (pulled < EAGER * pulled.max())
            now_low |= late & low
            now_high = now_high | (late & high)
        low, high = now_low, now_high
    return np.clip(x, lower, upper), aim, steps
