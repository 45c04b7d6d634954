"""Known indenters: the normal motion that they impose where they touch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.values import number, positive

Array = NDArray[np.float64]


class Indenter(Protocol):
    """What completes the normal motion of a surface from a known shape."""

    def normal(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Motion u_z (n,) in m at points (n, 2), and where the shape lies under the surface at rest."""
        ...


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """A sphere pressed into the pad by `depth` at `at`: ``u_z = -(depth - R + sqrt(R^2 - r^2))``.

    Parameters
    ----------
    radius, depth : float
        m; the depth is less than the radius.
    at : (x, y)
        m.
    """

    radius: float
    depth: float
    at: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        _checked(self.radius, self.depth, self.at, "Sphere")

    def normal(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Motion u_z (n,) and where the sphere lies under the surface at rest."""
        r = np.hypot(points[:, 0] - self.at[0], points[:, 1] - self.at[1])
        return _cap(r, self.radius, self.depth)


@dataclass(frozen=True, kw_only=True)
class Cylinder:
    """A lying cylinder pressed into the pad by `depth`; its axis passes over `at` at `angle` (rad) from x."""

    radius: float
    depth: float
    at: tuple[float, float] = (0.0, 0.0)
    angle: float = 0.0

    def __post_init__(self) -> None:
        _checked(self.radius, self.depth, self.at, "Cylinder")
        number("the angle", self.angle, where="Cylinder", unit="rad")

    def normal(self, points: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Motion u_z (n,) and where the cylinder lies under the surface at rest."""
        across = np.array([-np.sin(self.angle), np.cos(self.angle)])
        return _cap(np.abs((points - np.asarray(self.at)) @ across), self.radius, self.depth)


def _cap(r: Array, radius: float, depth: float) -> tuple[Array, NDArray[np.bool_]]:
    under = depth - radius + np.sqrt(np.maximum(radius**2 - r**2, 0.0))
    inside = (r < radius) & (under > 0)
    return np.where(inside, -under, 0.0), inside


def _checked(radius: float, depth: float, at: tuple[float, float], where: str) -> None:
    positive("the radius", radius, where=where, unit="m")
    positive("the depth", depth, where=where, unit="m")
    if depth >= radius:
        raise InputError("pressed in deeper than its radius", where=where, found=f"{depth:g} m",
                         expected=f"less than {radius:g} m", hint="depth is how far it is pressed in")  # fmt: skip
    for value in at:
        number("the place", value, where=where, unit="m")
