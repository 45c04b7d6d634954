"""Presses: known tractions on the surface of a pad, with the exact motion that they cause.

A press is a round load with pressure and shear of the same shape. Its displacements come from the kernels of a layer or
of a half-space (`tactile.radial`), never from a mesh: the truth that force maps are held against.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import integer, number, pair, positive, reals, shown

from .cells import polygon_means
from .layer import HalfSpace, Layer
from .profiles import profile
from .radial import moved, radial

Array = NDArray[np.float64]


class _Sum:
    """Loads add up: ``first + second`` and ``sum(loads)`` are `Presses`."""

    parts: tuple[Press, ...]

    def __add__(self, other: Press | Presses) -> Presses:
        return Presses(self.parts + other.parts) if isinstance(other, _Sum) else NotImplemented

    def __radd__(self, other: int) -> Presses:
        return Presses(self.parts) if other == 0 else NotImplemented


@dataclass(frozen=True)
class Press(_Sum):
    """A round load on the surface: pressure of resultant `force`, shear of resultant `shear`, one shape for both.

    Parameters
    ----------
    at : tuple of two floats
        Centre (m), in the plane of the pad.
    radius : float
        Radius of the contact (m).
    force : float
        Normal force (N), positive when it presses; 0 for shear alone.
    shear : tuple of two floats
        Tangential force on the pad, X and Y (N).
    profile : {"hertz", "uniform"}
        sqrt(1 - r^2/a^2), or constant.

    Raises
    ------
    InputError
        If a value is not possible.
    """

    at: tuple[float, float] = (0.0, 0.0)
    radius: float = 2.5e-3
    force: float = 1.0
    shear: tuple[float, float] = (0.0, 0.0)
    profile: str = "hertz"

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        set_(self, "at", pair("at", self.at, where="Press", unit="m"))
        set_(self, "radius", positive("radius", self.radius, where="Press", unit="m"))
        set_(self, "force", number("force", self.force, where="Press", unit="N"))
        set_(self, "shear", pair("shear", self.shear, where="Press", unit="N"))
        profile(self.profile)

    @property
    def parts(self) -> tuple[Press, ...]:  # type: ignore[override]
        """Itself alone: what a sum is made of."""
        return (self,)

    @property
    def vector(self) -> tuple[float, float, float]:
        """Resultant on the pad, X, Y, Z (N)."""
        return (*self.shear, -self.force)

    @property
    def peak(self) -> float:
        """Largest pressure (Pa)."""
        return float(self.force * profile(self.profile).shape(np.zeros(1))[0] / self.radius**2)

    def traction(self, points: ArrayLike) -> Array:
        """Traction on the pad (Pa), (n, 3), at points (n, 2) or (n, 3) of the surface (m)."""
        r = np.hypot(*self._offsets(_points(points)).T)
        shape = profile(self.profile).shape(r / self.radius) / self.radius**2
        return np.multiply.outer(shape, self.vector)

    def displacement(self, ground: Layer | HalfSpace, points: ArrayLike) -> Array:
        """Motion of points of the body (m), (n, 3).

        Parameters
        ----------
        ground : Layer or HalfSpace
            What is pressed.
        points : array_like, (n, 2) or (n, 3)
            Points of the surface, or anywhere in the body with their heights (m).

        Raises
        ------
        InputError
            If points are not finite or lie outside the body.
        """
        points = _points(points)
        offsets = self._offsets(points)
        heights = points[:, 2] if points.shape[1] == 3 else None
        found = radial(ground, self.profile, self.radius, np.hypot(*offsets.T), heights)
        return moved(found, offsets, self.vector)

    def resultant(self, about: Sequence[float] = (0.0, 0.0)) -> Array:
        """Fx, Fy, Fz (N) and Mx, My, Mz (N m) on the pad, moments about a point of the surface (m)."""
        x, y = (a - b for a, b in zip(self.at, pair("about", about[:2], where="resultant", unit="m"), strict=True))
        fx, fy, fz = self.vector
        return np.array([fx, fy, fz, y * fz, -x * fz, x * fy - y * fx])

    def mean_tractions(self, cells: ArrayLike) -> Array:
        """Mean traction (Pa) over polygons, (n, 3), exact to 1e-9 of the peak.

        Parameters
        ----------
        cells : array_like, (n, corners, 2)
            Corners of each cell in turn, counter-clockwise (m).
        """
        corners = reals(cells, where="cells")
        means = polygon_means(profile(self.profile), (corners - np.asarray(self.at)) / self.radius)
        return np.multiply.outer(means / self.radius**2, self.vector)

    def _offsets(self, points: Array) -> Array:
        return points[:, :2] - np.asarray(self.at)


@dataclass(frozen=True)
class Presses(_Sum):
    """Several presses at once; everything adds up.

    Parameters
    ----------
    parts : tuple of Press
        At least one.
    """

    parts: tuple[Press, ...]

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts or not all(isinstance(part, Press) for part in parts):
            raise InputError("no presses", where="Presses", found=shown(self.parts), expected="one Press or more")
        object.__setattr__(self, "parts", parts)

    def traction(self, points: ArrayLike) -> Array:
        """As `Press.traction`."""
        return np.sum([part.traction(points) for part in self.parts], axis=0)

    def displacement(self, ground: Layer | HalfSpace, points: ArrayLike) -> Array:
        """As `Press.displacement`."""
        return np.sum([part.displacement(ground, points) for part in self.parts], axis=0)

    def resultant(self, about: Sequence[float] = (0.0, 0.0)) -> Array:
        """As `Press.resultant`."""
        return np.sum([part.resultant(about) for part in self.parts], axis=0)

    def mean_tractions(self, cells: ArrayLike) -> Array:
        """As `Press.mean_tractions`."""
        return np.sum([part.mean_tractions(cells) for part in self.parts], axis=0)


def press_and_slide(
    *,
    force: float = 1.0,
    shear: tuple[float, float] = (0.25, 0.0),
    radius: float = 2.5e-3,
    at: tuple[float, float] = (0.0, 0.0),
    travel: tuple[float, float] = (0.0, 0.0),
    frames: int = 40,
    pressing: float = 0.5,
    profile: str = "hertz",
) -> list[Press]:
    """Frames of a press that grows and then slides.

    Parameters
    ----------
    force : float
        Normal force at the end of the press, held after it (N).
    shear : tuple of two floats
        Tangential force at the last frame (N), grown in proportion after the press.
    radius : float
        Contact radius under `force` (m); it grows with the cube root of the force, as under a sphere.
    at, travel : tuple of two floats
        Centre of the contact, and how far it goes while it slides (m).
    frames : int
        Number of frames, all of them loaded.
    pressing : float
        Share of the frames in which the force grows, above 0 and up to 1.
    profile : {"hertz", "uniform"}
        Shape of pressure and shear.

    Raises
    ------
    InputError
        If a value is not possible.
    """
    frames = integer("frames", frames, where="press_and_slide", limit=100_000)
    share = positive("pressing", pressing, where="press_and_slide")
    if share > 1:
        raise InputError("no share of the frames", where="pressing", found=share, expected="0 < pressing <= 1")
    final = Press(at=at, radius=radius, force=force, shear=shear, profile=profile)
    end = np.asarray(pair("travel", travel, where="press_and_slide", unit="m"))
    pressed = max(1, round(share * frames))
    found = []
    for i in range(frames):
        grown, slid = min(1.0, (i + 1) / pressed), max(0.0, (i + 1 - pressed) / max(1, frames - pressed))
        x, y = np.asarray(final.at) + slid * end
        found.append(
            replace(
                final,
                at=(float(x), float(y)),
                radius=final.radius * grown ** (1 / 3),
                force=final.force * grown,
                shear=(final.shear[0] * slid, final.shear[1] * slid),
            )
        )
    return found


def _points(points: ArrayLike) -> Array:
    found = np.atleast_2d(reals(points, where="points"))
    if found.ndim != 2 or found.shape[1] not in (2, 3) or not np.isfinite(found).all():
        raise InputError(
            "points must be finite, two or three coordinates each",
            where="points",
            found=f"an array of shape {found.shape}",
            expected="(n, 2) or (n, 3), in metres",
        )
    return found
