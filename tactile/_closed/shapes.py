"""Rigid shapes as heights over their lowest point: what a `RigidBody` is made of.

Each takes points (..., 2) and gives heights (...) in m, inf where there is no body. Several bodies on one holder are
``numpy.minimum`` of theirs, one of them higher by what it hangs back. All lengths in m, angles in rad.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, number, pair, positive, reals

from .._arrays import Array

Place = tuple[float, float]


def sphere(points: ArrayLike, radius: float, at: Place = (0.0, 0.0)) -> Array:
    """A sphere."""
    return _round(np.hypot(*_local(points, at)), positive("radius", radius, where="sphere", unit="m"))


def cylinder(
    points: ArrayLike, radius: float, at: Place = (0.0, 0.0), angle: float = 0.0, length: float = np.inf
) -> Array:
    """A lying cylinder whose axis is turned by `angle` from X; it ends half its length to both sides."""
    along, across = _local(points, at, angle)
    height = _round(np.abs(across), positive("radius", radius, where="cylinder", unit="m"))
    return height + _ended(along, length)


def flat(points: ArrayLike, radius: float, at: Place = (0.0, 0.0)) -> Array:
    """The flat end of a standing cylinder."""
    return _filled(np.hypot(*_local(points, at)) <= positive("radius", radius, where="flat", unit="m"))


def ring(points: ArrayLike, outer: float, inner: float, at: Place = (0.0, 0.0)) -> Array:
    """The flat end of a tube.

    Raises
    ------
    InputError
        If the inner radius is not less than the outer one.
    """
    outer, inner = (positive(n, r, where="ring", unit="m") for n, r in (("outer", outer), ("inner", inner)))
    if inner >= outer:
        raise InputError("no ring", where="ring", found=f"inner radius {inner:g} m", expected=f"less than {outer:g} m")
    r = np.hypot(*_local(points, at))
    return _filled((r <= outer) & (r >= inner))


def bar(points: ArrayLike, sides: Place, at: Place = (0.0, 0.0), angle: float = 0.0) -> Array:
    """The flat end of a bar of two sides, the first turned by `angle` from X."""
    a, b = (positive("a side", s, where="bar", unit="m") for s in pair("sides", sides, where="bar", unit="m"))
    x, y = np.abs(_local(points, at, angle))
    return _filled((x <= a / 2) & (y <= b / 2))


def edge(points: ArrayLike, slope: float, at: Place = (0.0, 0.0), angle: float = 0.0, length: float = np.inf) -> Array:
    """A wedge whose edge is turned by `angle` from X, and whose sides rise by `slope`; it ends as a cylinder does."""
    along, across = _local(points, at, angle)
    return positive("slope", slope, where="edge") * np.abs(across) + _ended(along, length)


def cone(points: ArrayLike, slope: float, at: Place = (0.0, 0.0)) -> Array:
    """A cone on its tip, whose side rises by `slope`."""
    return np.asarray(positive("slope", slope, where="cone") * np.hypot(*_local(points, at)))


def polygon(points: ArrayLike, corners: Sequence[Place]) -> Array:
    """The flat end of a prism, by its corners (n, 2) in order.

    Raises
    ------
    InputError
        If the corners are fewer than three, or not finite.
    """
    from matplotlib.path import Path

    outline = reals(corners, where="polygon")
    if outline.ndim != 2 or outline.shape[1] != 2 or len(outline) < 3 or not np.isfinite(outline).all():
        raise InputError("no polygon", where="polygon", found=f"shape {outline.shape}",
                         expected="three corners (x, y) or more, finite")  # fmt: skip
    x, y = _local(points, (0.0, 0.0))
    inside = Path(outline).contains_points(np.column_stack([x.ravel(), y.ravel()]))
    return _filled(inside.reshape(x.shape))


def _local(points: ArrayLike, at: Place, angle: float = 0.0) -> tuple[Array, Array]:
    """Coordinates of points in the frame of a body."""
    places = reals(points, where="points")
    if places.ndim < 1 or places.shape[-1] != 2 or not np.isfinite(places).all():
        raise InputError("no points", where="points", found=f"shape {places.shape}", expected="(..., 2), finite")
    x, y = np.moveaxis(places - np.array(pair("at", at, where="shape", unit="m")), -1, 0)
    turn = number("angle", angle, where="shape", unit="rad")
    return x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)


def _round(r: Array, radius: float) -> Array:
    return np.where(r < radius, radius - np.sqrt(np.maximum(radius**2 - r**2, 0.0)), np.inf)


def _ended(along: Array, length: float) -> Array:
    if length != np.inf:
        positive("length", length, where="shape", unit="m")
    return _filled(np.abs(along) <= length / 2)


def _filled(inside: ArrayLike) -> Array:
    return np.where(inside, 0.0, np.inf)
