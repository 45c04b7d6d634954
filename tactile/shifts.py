"""Presses repeated a little beside their place: the shift found from the map, and taken out of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

Array = NDArray[np.float64]
FEWEST = 6
NEIGHBOURS, STEP = 40, 0.02  # neighbours that carry a derivative; its difference, over the distance of neighbours


def tangents(points: ArrayLike, maps: Array) -> Array:
    """Derivatives of maps (presses, N, C) along X and Y, (presses, N, C, 2), by cubic radial functions.

    Parameters
    ----------
    points : array (N, 2 or 3)
        Places (m), on a grid or not.
    maps : array (presses, N, C)

    Raises
    ------
    InputError
        Places that do not fit the maps, or fewer than six.
    """
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import cKDTree

    x = reals(points, where="GelMonitor, points")
    if x.ndim != 2 or x.shape[1] not in (2, 3) or len(x) != maps.shape[1] or len(x) < FEWEST:
        raise InputError("places do not fit the maps", where="GelMonitor, points", found=f"shape {x.shape}",
                         expected=f"({maps.shape[1]}, 2), at least {FEWEST}", hint="markers, in m")  # fmt: skip
    x = x[:, :2]
    near = float(np.median(cKDTree(x).query(x, k=2)[0][:, 1]))
    x = x / near
    values = maps.transpose(1, 0, 2).reshape(len(x), -1)
    surface = RBFInterpolator(x, values, neighbors=min(len(x), NEIGHBOURS), kernel="cubic", degree=2)
    found = []
    for e in np.eye(2) * STEP:
        slope = (surface(x + e) - surface(x - e)) / (2 * STEP * near)
        found.append(slope.reshape(len(x), len(maps), -1).transpose(1, 0, 2))
    return np.stack(found, axis=-1)


def taken_out(reference: Array, found: Array, tangent: Array) -> tuple[Array, tuple[float, float]]:
    """One map (N, C) with the shift of its press taken out, and that shift (m).

    A map moved by d is reference - d . grad(reference), to first order; gain and shift are fitted together.
    """
    A = np.concatenate([reference.reshape(-1, 1), tangent.reshape(-1, 2)], axis=1)
    size = np.linalg.norm(A, axis=0)
    size[size == 0] = 1.0
    gain, *moved = np.linalg.lstsq(A / size, found.ravel(), rcond=None)[0] / size
    if gain == 0:
        return found, (0.0, 0.0)
    return found - tangent @ np.array(moved), (float(-moved[0] / gain), float(-moved[1] / gain))
