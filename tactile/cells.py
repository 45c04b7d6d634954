"""Means of a round traction over polygons: sectors about its centre, one for each edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from .profiles import Profile
from .quadrature import drawn

Array = NDArray[np.float64]
NODES = 16  # a side of each crossing; the square root of the traction at r = 1 is smooth in the angle that places them


def polygon_means(profile: Profile, corners: Array) -> Array:
    """Mean over each polygon of a round traction of unit radius about the origin.

    Parameters
    ----------
    profile : Profile
        The traction.
    corners : ndarray, (polygons, corners, 2)
        Corners in turn, counter-clockwise.

    Returns
    -------
    ndarray, (polygons,)

    Raises
    ------
    InputError
        If the corners are no polygons with an area.

    Notes
    -----
    By Green's theorem the integral is the sum over the edges of int F(r) dphi, 2 pi F(r) being the share of the
    resultant within r: outside the contact an angle, inside a smooth integrand.
    """
    if corners.ndim != 3 or corners.shape[1] < 3 or corners.shape[2] != 2 or not np.isfinite(corners).all():
        raise InputError(
            "cells are no polygons",
            where="cells",
            found=f"shape {corners.shape}",
            expected="(cells, corners, 2), finite",
        )
    start, end = corners, np.roll(corners, -1, axis=1)
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    area = cross.sum(axis=1) / 2
    if not (area > 0).all():
        raise InputError(
            "a cell has no area, or its corners run clockwise",
            where="cells",
            found=f"{np.count_nonzero(~(area > 0))} of {len(area)}",
            expected="corners counter-clockwise",
        )
    low, high = _inside(start, end)
    first, last = start + low[..., None] * (end - start), start + high[..., None] * (end - start)
    last = np.where((high == 1)[..., None], end, last)  # rounding at the axis of the press would be an angle of its own
    outside = _angle(start, first) + _angle(last, end)
    t, dt = drawn(NODES)
    at = first[..., None, :] + t[:, None] * (last - first)[..., None, :]
    square = np.maximum((at**2).sum(axis=-1), 1e-24)
    swept = ((high - low) * cross)[..., None] * profile.within(np.sqrt(square)) / square
    return ((swept @ dt + outside).sum(axis=1) / (2 * np.pi)) / area


def _inside(start: Array, end: Array) -> tuple[Array, Array]:
    """The part low <= t <= high of each edge within r < 1; low = high where there is none."""
    step = end - start
    a, b, c = (step**2).sum(-1), (start * step).sum(-1), (start**2).sum(-1) - 1
    root = np.sqrt(np.clip(b**2 - a * c, 0, None))
    a = np.where(a == 0, 1.0, a)
    return np.clip((-b - root) / a, 0, 1), np.clip((-b + root) / a, 0, 1)


def _angle(start: Array, end: Array) -> Array:
    """Angle swept about the origin from start to end; zero where they coincide."""
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    return np.arctan2(cross, (start * end).sum(axis=-1))
