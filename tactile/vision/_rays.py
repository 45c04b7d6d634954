"""A homography between a plane and an image, and rays from a camera through a flat window to the markers.

Heights are measured from the plane of the markers at rest, positive away from the camera (along the pad's +Z); gel and
window have one index of refraction. A ray that crosses the plane at rest in q is at q + height * slope elsewhere, with
the slope tan(beta) along its direction in the plane, sin(beta) = sin(alpha) / gamma.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, number, pair, positive, reals

from .._arrays import BEHIND, DISTANCE, PLANE, Array, shaped

FEWEST = 4
DEGENERATE = 1e-8  # smallest singular value that is not the solution, over the largest


@dataclass(frozen=True)
class Homography:
    """Projective map of a plane to pixels.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        (x, y, 1) on the plane to (column, row, 1), up to a factor.
    unit : float
        Metres of the matrix's unit of length.

    Raises `InputError`: Another shape, NaN, or a matrix without an inverse.
    """

    matrix: Array
    unit: float = 1.0

    def __post_init__(self) -> None:
        matrix = shaped(self.matrix, (3, 3), where="homography", what="no homography")
        positive("unit", self.unit, where="homography", unit="m")
        rows = np.linalg.norm(matrix, axis=1, keepdims=True)
        if not rows.all() or np.linalg.cond(matrix / rows) > 1 / np.finfo(float).eps:
            raise InputError("a homography without an inverse", where="homography", found=matrix.tolist())
        object.__setattr__(self, "matrix", matrix)

    def to_pixels(self, points: Array) -> Array:
        """Pixels of points of the plane (m), shape (N, 2)."""
        return _flat(np.column_stack([points / self.unit, np.ones(len(points))]) @ self.matrix.T)

    def to_plane(self, pixels: Array) -> Array:
        """Points of the plane (m) that pixels show, shape (N, 2)."""
        seen = np.column_stack([pixels, np.ones(len(pixels))])
        return self.unit * _flat(np.linalg.solve(self.matrix, seen.T).T)


def fitted(points: ArrayLike, pixels: ArrayLike) -> Homography:
    """Homography of corresponding points (n, 2), by the normalised direct linear transform (Hartley 1997).

    At least four, no three of them on a line; points that leave the map open are refused.
    """
    what = "no corresponding points"
    p = shaped(points, PLANE, where="homography", what=what, fewest=FEWEST)
    q = shaped(pixels, p.shape, where="homography", what=what)
    (P, T), (Q, S) = _normalised(p), _normalised(q)
    one, zero = np.ones((len(p), 1)), np.zeros((len(p), 3))
    A = np.hstack([P, one])
    system = np.vstack([np.hstack([A, zero, -Q[:, :1] * A]), np.hstack([zero, A, -Q[:, 1:] * A])])
    _, values, vectors = np.linalg.svd(system)
    if values[7] < DEGENERATE * values[0]:
        raise InputError(
            "the points leave the homography open",
            where="homography",
            expected="four points of which no three are on a line",
        )
    matrix = np.linalg.solve(S, vectors[8].reshape(3, 3)) @ T
    return Homography(matrix / np.abs(matrix).max())


def _normalised(points: Array) -> tuple[Array, Array]:
    """Points about their mean at a mean distance of sqrt 2, and the matrix that makes them so."""
    mean = points.mean(axis=0)
    size = np.hypot(*(points - mean).T).mean() / np.sqrt(2)
    if size == 0:
        raise InputError("all points are one", where="homography")
    matrix = np.array([[1 / size, 0, -mean[0] / size], [0, 1 / size, -mean[1] / size], [0, 0, 1]])
    return (points - mean) / size, matrix


def _flat(homogeneous: NDArray[Any]) -> Array:
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


ITERATIONS = 60
EXACT = 1e-15


def bend(alpha: ArrayLike, gamma: float) -> Array:
    """Angle beta inside of a ray that meets the face at alpha (rad): sin(beta) = sin(alpha) / gamma."""
    angle = reals(alpha, where="alpha")
    if not (np.abs(angle) < np.pi / 2).all():
        raise InputError("no viewing angle", where="alpha", found=alpha, expected="less than 90 degrees, in rad")
    return np.arcsin(np.sin(angle) / _index(gamma))


def projection_shift(d: ArrayLike, alpha: ArrayLike, gamma: float) -> Array:
    """In-plane shift that a normal motion d seems to be: d tan(beta), sin(beta) = sin(alpha) / gamma (Ma et al. 2019).

    It has the unit of d; alpha is the viewing angle in rad from the normal of the window, gamma >= 1 the index of
    refraction of gel and window over that outside.
    """
    return reals(d, where="d") * np.tan(bend(alpha, gamma))


@dataclass(frozen=True)
class Parallel:
    """Rays of one direction: a camera far away.

    Parameters
    ----------
    alpha : float
        Viewing angle outside, rad from the normal.
    gamma : float
        Relative index of refraction.
    azimuth : float
        Direction in the plane of the pad in which the rays travel away from the camera, rad from +X.
    """

    alpha: float
    gamma: float = 1.0
    azimuth: float = 0.0

    def __post_init__(self) -> None:
        bend(number("alpha", self.alpha, where="Parallel", unit="rad"), self.gamma)
        number("azimuth", self.azimuth, where="Parallel", unit="rad")

    @classmethod
    def from_press(cls, apparent: ArrayLike, normal: ArrayLike, gamma: float) -> Parallel:
        """Rays that explain the apparent motion of a flat press without shear, by least squares: angle and sign.

        `apparent` (N, 2) is the motion that the image shows (m), NaN where lost; `normal` that along the normal (m),
        negative where pressed. Refused: no normal motion, or an apparent one that no ray shows.
        """
        seen = reals(apparent, where="apparent motion")
        height = np.broadcast_to(reals(normal, where="normal motion"), seen.shape[:1])
        known = np.isfinite(height) & np.isfinite(seen).all(axis=1)
        total = float(np.sum(height[known] ** 2))
        if total == 0:
            raise InputError("a press without normal motion tells nothing of the rays", where="normal motion")
        slope = -(height[known] @ seen[known]) / total
        sine = _index(gamma) * np.sin(np.arctan(np.hypot(*slope)))
        if sine >= 1:
            raise InputError(
                "no ray shows this motion",
                where="apparent motion",
                found=f"{np.hypot(*slope):.3g} m per m of normal motion",
                expected=f"below {np.tan(np.arcsin(1 / gamma)) if gamma > 1 else np.inf:.3g} for an index of {gamma:g}",
                hint="press flat and without shear, and check the index and the unit of the normal motion",
            )
        return cls(float(np.arcsin(sine)), gamma, float(np.arctan2(slope[1], slope[0])))

    def slope(self, xy: Array, height: Array) -> Array:
        """In-plane motion of the ray through each point per unit of height, shape (N, 2)."""
        direction = np.array([np.cos(self.azimuth), np.sin(self.azimuth)])
        return np.broadcast_to(np.tan(bend(self.alpha, self.gamma)) * direction, xy.shape)


@dataclass(frozen=True)
class Window:
    """Rays through one point, the centre of the lens, bent at a flat face.

    Parameters
    ----------
    eye : (float, float)
        x and y of the centre of the lens in the plane of the pad, m.
    distance : float
        From the lens to the face, m.
    depth : float
        From the face to the markers at rest, m: window and gel.
    gamma : float
        Relative index of refraction.
    """

    eye: tuple[float, float]
    distance: float
    depth: float
    gamma: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "eye", pair("eye", self.eye, where="Window", unit="m"))
        DISTANCE.positive("distance", self.distance, where="Window")
        if number("depth", self.depth, where="Window", unit="m") < 0:
            raise InputError("depth must not be negative", where="Window", found=self.depth)
        if self.depth:
            BEHIND.inside("depth", self.depth, where="Window")
        _index(self.gamma)

    def slope(self, xy: Array, height: Array) -> Array:
        """In-plane motion of the ray through each point per unit of height, shape (N, 2)."""
        offset, radius = self._from_eye(xy)
        return offset * _ratio(self.inside(self.outside(radius, height)), radius)

    def direction(self, xy: Array) -> Array:
        """Direction (dx, dy, 1) outside of the ray from the lens to each marker at rest, shape (N, 3)."""
        offset, radius = self._from_eye(xy)
        sideways = offset * _ratio(self.outside(radius, np.zeros(len(xy))), radius)
        return np.column_stack([sideways, np.ones(len(xy))])

    def reached(self, direction: Array) -> Array:
        """Points at rest, shape (N, 2), that rays (dx, dy, 1) from the lens reach."""
        tangent = np.hypot(direction[:, 0], direction[:, 1])[:, None]
        out = direction[:, :2] * self.distance
        return np.array(self.eye) + out + direction[:, :2] * _ratio(self.depth * self.inside(tangent), tangent)

    def inside(self, tangent: Array) -> Array:
        """tan(beta) of tan(alpha)."""
        return tangent / np.sqrt(self.gamma**2 + (self.gamma**2 - 1) * tangent**2)

    def outside(self, radius: Array, height: Array) -> Array:
        """tan(alpha) of the ray to points at a distance in the plane from the lens, shape (N, 1).

        The radius grows with tan(alpha), concavely: Newton's method from zero climbs to the root without passing it.
        """
        depth = self.depth + height[:, None]
        if not (depth > 0).all() and not (depth == 0).all():
            raise InputError(
                "a marker lies on the face of the window or outside", where="height",
                found=f"{float(height.min()):g} m", expected=f"above {-self.depth:g} m",
            )  # fmt: skip
        t, n2 = np.zeros_like(radius), self.gamma**2
        for _ in range(ITERATIONS):
            root = np.sqrt(n2 + (n2 - 1) * t**2)
            step = (radius - self.distance * t - depth * t / root) / (self.distance + depth * n2 / root**3)
            t = t + step
            if (np.abs(step) <= EXACT * (1 + t)).all():
                break
        return t

    def _from_eye(self, xy: Array) -> tuple[Array, Array]:
        offset = xy - np.array(self.eye)
        return offset, np.hypot(offset[:, 0], offset[:, 1])[:, None]


def _ratio(a: Array, b: Array) -> Array:
    """Quotient, 0 where b is 0: a ray along the normal is not bent."""
    return np.divide(a, b, out=np.zeros_like(a), where=b > 0)


def _index(gamma: float) -> float:
    found = positive("gamma", gamma, where="index of refraction")
    if found < 1:
        raise InputError(
            "an index below 1", where="gamma", found=found,
            expected="index of gel and window over that outside, at least 1 (1.4 to air)",
        )  # fmt: skip
    return found
