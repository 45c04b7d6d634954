"""Point forces on the surface of an elastic half-space: Boussinesq (normal) and Cerruti (tangential)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

from .layer import HalfSpace

Array = NDArray[np.float64]


def point_forces(ground: HalfSpace, offsets: ArrayLike) -> Array:
    """Displacement per unit point force on the surface (m/N).

    Parameters
    ----------
    ground : HalfSpace
        The body, at z <= 0.
    offsets : array_like, (..., 2) or (..., 3)
        Point minus point of the force (m); without a height, on the surface.

    Returns
    -------
    ndarray, (..., 3, 3)
        Motion X, Y, Z per force X, Y, Z, both outward.

    Raises
    ------
    InputError
        At the force itself, where the motion has no bound, and above the surface.

    Notes
    -----
    Boussinesq (1885) and Cerruti (1882), as in Johnson, Contact Mechanics, ch. 3.
    """
    x, y, d = split(offsets)
    r = np.sqrt(x**2 + y**2 + d**2)
    if not r.all():
        raise InputError(
            "the motion under a point force has no bound",
            where="offsets",
            found="a distance of 0",
            hint="spread the force over a patch (tactile.patches) or a press",
        )
    nu, m, s = ground.nu, 1 - 2 * ground.nu, r + d
    found = np.empty((*r.shape, 3, 3))
    found[..., 0, 0] = 1 / r + x**2 / r**3 + m * (1 / s - x**2 / (r * s**2))
    found[..., 1, 1] = 1 / r + y**2 / r**3 + m * (1 / s - y**2 / (r * s**2))
    found[..., 0, 1] = found[..., 1, 0] = x * y / r**3 - m * x * y / (r * s**2)
    found[..., 2, 2] = d**2 / r**3 + 2 * (1 - nu) / r
    for i, c in enumerate((x, y)):
        found[..., i, 2] = m * c / (r * s) - c * d / r**3
        found[..., 2, i] = -m * c / (r * s) - c * d / r**3
    return found / (4 * np.pi * ground.mu)


def split(offsets: ArrayLike) -> tuple[Array, Array, Array]:
    """Offsets (..., 2) or (..., 3) as x, y and the depth below the surface.

    Raises
    ------
    InputError
        If they are no finite offsets, or above the surface.
    """
    found = reals(offsets, where="offsets")
    if found.ndim == 0 or found.shape[-1] not in (2, 3) or not np.isfinite(found).all():
        raise InputError(
            "offsets must be finite, two or three coordinates each",
            where="offsets",
            found=f"an array of shape {found.shape}",
            expected="(..., 2) or (..., 3), in metres",
        )
    d = -found[..., 2] if found.shape[-1] == 3 else np.zeros(found.shape[:-1])
    if (d < 0).any():
        raise InputError("points above the half-space", where="z", found=-float(d.min()), expected="z <= 0")
    return found[..., 0], found[..., 1], d + 0.0
