"""Maximum of a likelihood of innovations by scoring: steps by the information of the numbers, a model at a time.

The innovations e of a steady filter are white with covariance S. Their information of the numbers is
``sum_k de_k^T S^-1 de_k + samples / 2 tr(S^-1 dS S^-1 dS)``; a difference for each number gives it together with the
slope, so that a step costs one filter more than there are numbers. A common factor on all noises is at its optimum
everywhere; what it shares with the numbers is taken out of their information.

Source: N. K. Gupta, R. K. Mehra, IEEE Trans. Automat. Control 19 (1974) 774-783 (scoring for innovations).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NUDGE = 1e-4  # of a logarithm, for the differences
FARTHEST = 1.5  # by which a step moves a logarithm at most
ENOUGH = 1e-4  # of a log-likelihood: what a further step may promise
STEPS = 40
NEAR = 0.2  # of the logarithms, within which two ways end at one top
DAMPING, EASE, STIFFEN = 1e-3, 0.2, 5.0
GIVE_UP = 1e8  # of the damping

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Point:
    """What numbers are worth.

    Parameters
    ----------
    x : array
        Logarithms of the numbers.
    cost : float
        Negative log-likelihood.
    scale : float
        Common variance of the noises, at its optimum or 1.
    e : array, shape (samples, m)
        Innovations of the samples that count.
    root : array, shape (m, m)
        Lower triangular root of their covariance, positive diagonal.
    free : bool
        The scale is at its optimum.
    """

    x: Array
    cost: float
    scale: float
    e: Array
    root: Array
    free: bool


def climb(
    at: Callable[[Array], Point | None], start: Point, low: Array, high: Array, top: Point | None = None
) -> Point:
    """The best point that steps from a start reach between two bounds.

    Parameters
    ----------
    at : callable
        Point of logarithms; None where no filter exists.
    start : Point
    low, high : array
    top : Point, optional
        Where another start has ended: a way that comes near it is not gone to its end.
    """
    best, damping = start, DAMPING
    for _ in range(STEPS):
        if top is not None and np.abs(best.x - top.x).max() < NEAR and best.cost >= top.cost:
            return top
        slope, known = _expanded(at, best, high)
        free = ~(((best.x <= low) & (slope > 0)) | ((best.x >= high) & (slope < 0)))
        if not free.any():
            return best
        while damping < GIVE_UP:
            move = _step(slope, known, free, damping)
            x = np.clip(best.x + move, low, high)
            promised = -float(slope @ (x - best.x)) / 2
            if promised <= ENOUGH:
                return best
            found = at(x)
            if found is not None and found.cost < best.cost:
                best, damping = found, damping * EASE
                break
            damping *= STIFFEN
        else:
            return best
    return best


def _step(slope: Array, known: Array, free: NDArray[np.bool_], damping: float) -> Array:
    """Damped step of the numbers that are free to move."""
    some = np.ix_(free, free)
    size = np.diag(known)[free]
    part = known[some] + damping * np.diag(np.where(size > 0, size, 1.0))
    move = np.zeros(len(slope))
    move[free] = -np.linalg.lstsq(part, slope[free], rcond=1e-12)[0]
    return move / max(1.0, float(np.abs(move).max()) / FARTHEST)


def _expanded(at: Callable[[Array], Point | None], best: Point, high: Array) -> tuple[Array, Array]:
    """Slope of the cost and information of the numbers at a point; zero where a number cannot be moved."""
    from ...inverse.kalman.roots import forward

    count, samples = len(best.x), len(best.e)
    slope, nudges, news, roots = np.zeros(count), np.zeros(count), [], []
    for i in range(count):
        moved, h = None, NUDGE
        for h in (NUDGE, -NUDGE) if best.x[i] + NUDGE <= high[i] else (-NUDGE,):
            x = best.x.copy()
            x[i] += h
            moved = at(x)
            if moved is not None:
                break
        if moved is None:
            news.append(np.zeros(best.e.size))
            roots.append(np.zeros(best.root.shape))
            continue
        slope[i], nudges[i] = (moved.cost - best.cost) / h, h
        news.append(forward(best.root, ((moved.e - best.e) / h).T).ravel() / np.sqrt(best.scale))
        change = (moved.root @ moved.root.T - best.root @ best.root.T) / h
        roots.append(forward(best.root, forward(best.root, change).T))
    J, V = np.array(news), np.array(roots).reshape(count, -1)
    known = J @ J.T + samples / 2 * (V @ V.T)
    if best.free:  # the scale changes the covariance by itself, the innovations not at all
        shared = samples / 2 * np.array([np.trace(v) for v in roots])
        known -= np.outer(shared, shared) / (samples / 2 * len(best.root))
    return slope - nudges / 2 * np.diag(known), known  # a one-sided difference sees half a curvature too much
