"""Uniform traction on a rectangle of the surface of an elastic half-space: displacements anywhere, in closed form."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.values import positive

from .halfspace import split
from .layer import HalfSpace

Array = NDArray[np.float64]


def rectangle(ground: HalfSpace, offsets: ArrayLike, sides: tuple[float, float]) -> Array:
    """Displacement per uniform traction on a rectangle (m/Pa).

    Parameters
    ----------
    ground : HalfSpace
        The body, at z <= 0.
    offsets : array_like, (..., 2) or (..., 3)
        Point minus centre of the rectangle (m); without a height, on the surface.
    sides : tuple of two floats
        Lengths along X and Y (m).

    Returns
    -------
    ndarray, (..., 3, 3)
        Motion X, Y, Z per traction X, Y, Z.

    Raises
    ------
    InputError
        If offsets or sides are not possible.

    Notes
    -----
    Corner sums of the antiderivatives of the kernels of `tactile.halfspace`; on the surface those of Love (1929).
    """
    a, b = (positive("sides", side, where="rectangle", unit="m") / 2 for side in sides)
    scale = max(a, b)
    x, y, d = (c / scale for c in split(offsets))
    total = np.zeros((*x.shape, 3, 3))
    for sx in (1, -1):
        for sy in (1, -1):
            total += sx * sy * _corner(x + sx * a / scale, y + sy * b / scale, d, ground.nu)
    return total * scale / (4 * np.pi * ground.mu)


def _corner(X: Array, Y: Array, d: Array, nu: float) -> Array:
    """Antiderivative in x and y of 4 pi mu times the motion under a point force."""
    m, R = 1 - 2 * nu, np.sqrt(X**2 + Y**2 + d**2)
    bulge = d * np.arctan(_over(X * Y, d * R))
    log_x, log_y = (X, Y**2 + d**2), (Y, X**2 + d**2)
    lift_x, lift_y = _lift(X, Y, d, R), _lift(Y, X, d, R)
    mass = _times_log(X, *log_y, R) + _times_log(Y, *log_x, R) - bulge  # of 1/r
    found = np.empty((*R.shape, 3, 3))
    found[..., 0, 0] = 2 * mass - _times_log(X, *log_y, R) + m * (_times_log(X, *log_y, R) - d * lift_x)
    found[..., 1, 1] = 2 * mass - _times_log(Y, *log_x, R) + m * (_times_log(Y, *log_x, R) - d * lift_y)
    height = _times_log(d, R, np.zeros_like(R), d)
    found[..., 0, 1] = found[..., 1, 0] = -R + m * (R - height)
    found[..., 2, 2] = bulge + 2 * (1 - nu) * mass
    for i, (edge, log, across, lift) in enumerate(((Y, log_y, X, lift_x), (X, log_x, Y, lift_y))):
        leaning = -_times_log(d, *log, R)  # of c d / r^3
        turning = _times_log(edge, R, np.zeros_like(R), d) - leaning + across * lift  # of c / (r (r + d))
        found[..., i, 2] = m * turning - leaning
        found[..., 2, i] = -m * turning - leaning
    return found


def _times_log(factor: Array, y: Array, rest: Array, R: Array) -> Array:
    """The product factor ln(y + R) with R^2 = y^2 + rest, which cancels for y < 0; 0 where the factor is."""
    straight = np.where(factor != 0, y + R, 1.0)
    safe = np.where((factor != 0) & (y < 0), rest, 1.0)
    mirrored = np.log(np.where(safe > 0, safe, 1.0)) - np.log(np.where(y < 0, R - y, 1.0))
    return factor * np.where(y < 0, mirrored, np.log(np.where(straight > 0, straight, 1.0)))


def _lift(X: Array, Y: Array, d: Array, R: Array) -> Array:
    """atan(Y / X) - atan(Y d / (X R)); 0 at X = 0."""
    return np.arctan(_over(Y, X)) - np.arctan(_over(Y * d, X * R))


def _over(a: Array, b: Array) -> Array:
    return np.divide(a, b, out=np.zeros_like(a), where=b != 0)
