"""Noise of the places of dots, measured on frames of the unloaded pad."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import reals

from ..guards.vision import frozen

FEWEST = 3  # frames
NORMAL = 1.4826  # standard deviation over median absolute deviation of a normal law


@dataclass(frozen=True)
class Jitter:
    """Noise floor of the places.

    Parameters
    ----------
    std : array, shape (axes,)
        Standard deviation of one place per axis, in the unit of the places.
    per_marker : array, shape (N, axes)
        The same of every marker; NaN for one seen in too few frames.
    drift : array, shape (axes,)
        Median motion of the pattern from the first to the last frame.
    frames : int
    flags : tuple of Flag
        W406 where the frames repeat themselves.
    """

    std: NDArray[np.float64]
    per_marker: NDArray[np.float64]
    drift: NDArray[np.float64]
    frames: int
    flags: tuple[Flag, ...] = ()


def jitter(positions: ArrayLike) -> Jitter:
    """Noise of places over frames in which nothing moves.

    Differences of successive frames, less their median, leave steady drift out; their median absolute value leaves out
    what jumps.

    Parameters
    ----------
    positions : array, shape (T, N, axes)
        Places of the markers in every frame; NaN = lost.

    Raises
    ------
    InputError
        Fewer than three frames, or none in which markers are seen twice running.
    """
    x = reals(positions, where="jitter")
    if x.ndim != 3 or len(x) < FEWEST:
        raise InputError(
            "too few frames for a noise level",
            where="jitter",
            found=f"shape {x.shape}",
            expected=f"(frames, markers, axes) with at least {FEWEST} frames",
        )
    steps = np.diff(x, axis=0)
    known = np.isfinite(steps).all(axis=2)
    if not known.any():
        raise InputError("no marker is seen in two frames running", where="jitter")
    drifting = np.median(steps[known], axis=0)
    std = NORMAL / np.sqrt(2) * np.median(np.abs(steps[known] - drifting), axis=0)
    still = float(np.mean(~steps[known].any(axis=1)))
    flag = frozen(still)
    return Jitter(std, _each(steps - drifting), _drift(x), len(x), (flag,) if flag else ())


def _each(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Root of half the mean square step of every marker, NaN below two steps."""
    seen = np.isfinite(steps)
    count = seen.sum(axis=0)
    total = np.where(seen, steps, 0.0) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count >= 2, np.sqrt(0.5 * total.sum(axis=0) / count), np.nan)


def _drift(x: NDArray[Any]) -> NDArray[np.float64]:
    moved = x[-1] - x[0]
    both = np.isfinite(moved).all(axis=1)
    return np.median(moved[both], axis=0) if both.any() else np.full(x.shape[2], np.nan)
