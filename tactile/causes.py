"""What has changed in a layer, if one thing has: E, thickness or Poisson's ratio, fitted to the change of the maps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from .layer import Layer
from .presses import Press

Array = NDArray[np.float64]
STEP = 1e-4  # of a value's range, for its derivative


@dataclass(frozen=True)
class Cause:
    """One change that would explain the maps, if it were the only one.

    Parameters
    ----------
    name : {"E", "thickness", "nu"}
    value, std : float
        New value (SI) and its std.
    change : float
        Relative to the calibration; for nu, the difference.
    misfit : float
        Rms of what is left, over the noise: about 1 where the cause explains the maps.
    """

    name: str
    value: float
    std: float
    change: float
    misfit: float


def attributed(
    moved: Array, sigma: float, layer: Layer, presses: Sequence[Press], points: ArrayLike
) -> tuple[Cause, ...]:
    """Causes, the best one first, for a change of displacements (presses, N, C) in m of noise std `sigma`.

    Raises
    ------
    InputError
        Presses or points that do not fit the maps.
    """
    kept = np.isfinite(moved)
    moved = np.where(kept, moved, 0.0)

    def motion(ground: Layer) -> Array:
        return np.array([p.displacement(ground, points)[:, : moved.shape[2]] for p in presses])

    start = motion(layer)
    if start.shape != moved.shape:
        raise InputError("presses and points do not fit the maps", where="GelMonitor.attribute",
                         found=f"{len(presses)} presses", expected=f"maps of shape {moved.shape}",
                         hint="one press for each map, one point for each marker")  # fmt: skip

    def alone(name: str, value: float, low: float, high: float, make: Callable[[float], Any]) -> Cause:
        def change(v: float) -> Array:
            return np.where(kept, motion(make(v)) - start, 0.0)

        return _alone(name, value, (low, high), change, moved, sigma, int(kept.sum()))

    causes = (
        alone("E", layer.E, 0.2 * layer.E, 5 * layer.E, lambda v: replace(layer, E=v)),
        alone("thickness", layer.h, 0.3 * layer.h, 2 * layer.h, lambda v: replace(layer, h=v)),
        alone("nu", layer.nu, 0.0, 0.4999, lambda v: replace(layer, nu=v)),
    )
    return tuple(sorted(causes, key=lambda c: c.misfit))


def _alone(
    name: str,
    start: float,
    limits: tuple[float, float],
    change: Callable[[float], Array],
    moved: Array,
    sigma: float,
    count: int,
) -> Cause:
    """Fit one value by Gauss-Newton, to a fiftieth of its std."""
    value, step = start, STEP * (limits[1] - limits[0])
    for _ in range(6):
        here = change(value)
        ahead = step if value + step <= limits[1] else -step
        slope = (change(value + ahead) - here) / ahead
        size = float(np.sum(slope**2))
        after = float(np.clip(value + np.sum(slope * (moved - here)) / size, *limits))
        done, value = abs(after - value) < 0.02 * sigma / np.sqrt(size), after
        if done:
            break
    left = moved - change(value)
    misfit = float(np.sqrt(np.sum(left**2) / max(count - 1, 1))) / sigma
    relative = value - start if name == "nu" else value / start - 1
    return Cause(name, value, sigma / float(np.sqrt(size)), relative, misfit)
