"""Patterns of dots and fields that move them, for the tests of vision."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tactile import View
from tactile.vision._images import grid

PITCH = 23.0  # px
ROWS, COLUMNS = 20, 26


def pattern(seed: int = 0) -> NDArray[np.float64]:
    """520 dots of a 640 x 480 image, not quite on a grid, shape (520, 2)."""
    wobble = np.random.default_rng(seed).uniform(-1.0, 1.0, (ROWS * COLUMNS, 2))
    return grid(ROWS, COLUMNS, PITCH, centre=(319.5, 239.5)) + wobble


def pressed(points: NDArray[np.float64], press: float, shear: float = 0.0) -> NDArray[np.float64]:
    """Places after a press that drives the dots apart by at most `press` px, and a shear of `shear` px."""
    offset = (points - np.array([330.0, 250.0])) / 60.0
    near = np.exp(-0.5 * (offset**2).sum(axis=1, keepdims=True))
    return points + press * np.exp(0.5) * offset * near + np.array([shear, 0.3 * shear]) * near**0.25


def camera() -> View:
    """A tilted camera under 3 mm of gel and 6 mm of window, 640 x 480 px, about 27 px/mm."""
    return View.camera(
        focal=1000.0, centre=(319.5, 239.5), distance=0.03, depth=0.009, gamma=1.4, tilt=0.25, azimuth=0.6
    )


def errors(found: NDArray[np.float64], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """Error of the dot nearest to each true place, shape (N, 2); as many dots as places, one each."""
    distance, index = cKDTree(found).query(truth)
    assert len(found) == len(truth)
    assert len(np.unique(index)) == len(truth)
    assert distance.max() < 3
    return found[index] - truth
