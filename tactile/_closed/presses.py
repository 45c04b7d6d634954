"""Presses: known tractions on the surface of a pad, with the exact motion that they cause, by Hankel integrals.

The motion of the half-space is known in closed form (`tactile._closed.profiles`). What the rigid base takes from it
decays as exp(-k (2 h - d)) at depth d, so that its Hankel integrals need a short Gauss rule only, and are so smooth in
r and z that a Chebyshev interpolant carries them to any number of points.

A press is a round load with pressure and shear of the same shape. Its displacements come from the kernels of a layer or
of a half-space (`tactile._closed.presses`), never from a mesh: the truth that force maps are held against.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, integer, number, pair, plain, positive, reals, shown

from .._arrays import PLANE, SPACE, Array, shaped
from .layer import Components, HalfSpace, Layer
from .profiles import PressureProfile, gauss, polygon_means, profile

HEIGHTS = 21  # Chebyshev points over the thickness, where points have more heights than that: 1e-12
TABLE = 4096  # points of a cubic spline in its stead for a great many distances: 1e-11
BATCH = 20_000  # points at a time
DECAY = 40.0  # where the integrals end: exp(-40) of their start


def radial(ground: Layer | HalfSpace, shape: str, radius: float, r: ArrayLike, z: ArrayLike | None = None) -> Array:
    """Five radial functions of a round load of unit resultant (m/N), (points, 5).

    With f_m[X] = (1/2 pi) int X(k) g(k a) J_m(k r) k dk and the five functions of `tactile._closed.layer.Components`:
    f_0[zz], f_1[kz], f_1[zk], f_0[(kk + tt)/2], f_2[(kk - tt)/2]. `moved` makes displacements of them. Distances r from
    the axis and heights z (None: on the surface) are (points,) in m, as `Layer` and `HalfSpace` count them.
    """
    form, a = profile(shape), positive("radius", radius, where="radial", unit="m")
    r, z = _places(ground, r, z)
    depth = ground.top - z
    found = _half_space(ground, form, a, r, depth)
    if isinstance(ground, Layer) and r.size:
        found = found + _base(ground, form.transform, a, r, z)
    return found


def unit_point(layer: Layer, r: ArrayLike, z: ArrayLike | None = None) -> Array:
    """Functions of a unit point force on a layer less those on a half-space, (points, 5): finite at r = 0."""
    r, z = _places(layer, r, z)
    return _base(layer, np.ones_like, 0.0, r, z)


def moved(functions: Array, offsets: Array, force: ArrayLike) -> Array:
    """Displacements (points, 3) at horizontal offsets (points, 2) from the axis of a load of resultant (X, Y, Z)."""
    return np.asarray(np.einsum("pij,j->pi", matrices(functions, offsets), np.asarray(plain(force), float)))


def matrices(functions: Array, offsets: Array) -> Array:
    """Motion X, Y, Z per resultant X, Y, Z (m/N), (points, 3, 3), from the five functions at horizontal offsets."""
    zz, kz, zk, mean, split = functions.T
    r = np.hypot(*offsets.T)
    x, y = offsets.T / np.where(r == 0, 1.0, r)
    found = np.empty((len(r), 3, 3))
    found[:, 0, 0] = mean - split * (x**2 - y**2)
    found[:, 1, 1] = mean + split * (x**2 - y**2)
    found[:, 0, 1] = found[:, 1, 0] = -2 * split * x * y
    found[:, 2, 2] = zz
    found[:, 0, 2], found[:, 1, 2] = kz * x, kz * y
    found[:, 2, 0], found[:, 2, 1] = -zk * x, -zk * y
    return found


def _half_space(ground: Layer | HalfSpace, form: PressureProfile, a: float, r: Array, depth: Array) -> Array:
    H0, H1 = np.zeros((2, len(r), 3))
    top = depth == 0
    H0[top] = form.surface(r[top] / a) / a
    if not top.all():
        found = form.below(r[~top] / a, depth[~top] / a)
        H0[~top], H1[~top] = found[0] / a, found[1] / a**2
    nu, q = ground.nu, depth[:, None] * H1
    return np.column_stack([
        2 * (1 - nu) * H0[:, 0] + q[:, 0],
        (1 - 2 * nu) * H0[:, 1] - q[:, 1],
        (1 - 2 * nu) * H0[:, 1] + q[:, 1],
        (2 - nu) * H0[:, 0] - q[:, 0] / 2,
        -nu * H0[:, 2] - q[:, 2] / 2,
    ]) / (4 * np.pi * ground.mu)  # fmt: skip


def _base(layer: Layer, transform: Callable[[Array], Array], a: float, r: Array, z: Array) -> Array:
    """Layer minus half-space, interpolated over r, and over z where there are many heights."""
    heights = np.unique(z)
    reach = float(r.max(initial=0.0))
    if len(heights) <= HEIGHTS:
        found = np.empty((len(r), 5))
        for height in heights:
            here = z == height
            found[here] = _over_distance(layer, transform, a, r[here], height, reach)
        return found
    return _over_both(layer, transform, a, r, z, reach)


def _over_both(layer: Layer, transform: Callable[[Array], Array], a: float, r: Array, z: Array, reach: float) -> Array:
    """Layer minus half-space at many heights: a table of Chebyshev coefficients in r and z."""
    from numpy.polynomial import chebyshev

    h, degree = layer.h, _degree(layer.h, max(reach, layer.h))
    reach = max(reach, h)
    heights, x = (chebyshev.chebpts1(HEIGHTS) + 1) * h / 2, chebyshev.chebpts1(degree + 1)
    values = _integrals(layer, transform, a, (x + 1) * reach / 2, heights)
    values = _coefficients(np.moveaxis(_coefficients(values), -1, 0))
    table, found = np.moveaxis(values, 0, -1).reshape(degree + 1, -1), np.empty((len(r), 5))
    for i in range(0, len(r), BATCH):
        part = slice(i, i + BATCH)
        rows = (chebyshev.chebvander(2 * r[part] / reach - 1, degree) @ table).reshape(-1, 5, HEIGHTS)
        found[part] = np.einsum("pjh,ph->pj", rows, chebyshev.chebvander(2 * z[part] / h - 1, HEIGHTS - 1))
    return found


def _coefficients(values: Array) -> Array:
    """Chebyshev coefficients along the first axis, from values at the points of the first kind."""
    from numpy.polynomial import chebyshev

    n = len(values)
    rows = chebyshev.chebvander(chebyshev.chebpts1(n), n - 1).T * (2 / n)
    rows[0] /= 2
    return np.tensordot(rows, values, axes=1)


def _degree(gap: float, reach: float) -> int:
    """Chebyshev degree over 0 <= r <= reach of functions that are singular at r = +- i gap only, to 1e-13."""
    b = 2 * gap / max(reach, 1e-9 * gap)
    return 12 + int(30 / np.log(b + np.hypot(b, 1)))


def _over_distance(
    layer: Layer, transform: Callable[[Array], Array], a: float, r: Array, z: float, reach: float
) -> Array:
    """Layer minus half-space at one height: directly at few distances, else by Chebyshev points in 0 <= r <= reach."""
    from numpy.polynomial import chebyshev

    here = np.array([z])
    degree = _degree(layer.h + z, reach)  # the image of the load in the base lies at r = +- i (2 h - d)
    if len(r) <= degree + 1:
        return _integrals(layer, transform, a, r, here)[..., 0]
    x = chebyshev.chebpts1(degree + 1)
    coefficients = _coefficients(_integrals(layer, transform, a, (x + 1) * reach / 2, here)[..., 0])
    if len(r) < 4 * TABLE:
        return chebyshev.chebvander(2 * r / reach - 1, degree) @ coefficients
    from scipy.interpolate import CubicSpline

    at = np.linspace(0, reach, 1 + TABLE * max(1, round(reach / 16 / (layer.h + z))))
    return np.asarray(CubicSpline(at, chebyshev.chebvander(2 * at / reach - 1, degree) @ coefficients)(r))


def _integrals(layer: Layer, transform: Callable[[Array], Array], a: float, r: Array, heights: Array) -> Array:
    """Layer minus half-space at every distance and height, (distances, 5, heights), by one Gauss rule."""
    from scipy.special import j0, j1

    end = DECAY / (layer.h + heights.min())
    nodes = 160 + int(0.55 * end * (a + r.max(initial=0.0)))
    x, w = gauss(32 * (nodes // 32 + 1))
    k = x * end
    w = w * end * k * transform(k * a) / (2 * np.pi)
    kr = np.multiply.outer(r, k)
    J0, J1 = j0(kr), j1(kr)
    J2 = np.divide(2 * J1, kr, out=np.zeros_like(kr), where=kr > 0) - np.where(kr > 0, J0, 0.0)
    waves = [_difference(layer, k, z) for z in heights]

    def summed(J: Array, part: Callable[[Components], Array]) -> Array:
        return np.asarray(J @ np.column_stack([w * part(f) for f in waves]))

    return np.stack([
        summed(J0, lambda f: f.zz),
        summed(J1, lambda f: f.kz),
        summed(J1, lambda f: f.zk),
        summed(J0, lambda f: (f.kk + f.tt) / 2),
        summed(J2, lambda f: (f.kk - f.tt) / 2),
    ], axis=1)  # fmt: skip


def _difference(layer: Layer, k: Array, z: float) -> Components:
    ours, limit = layer.components(k, z), layer.half_space.components(k, z - layer.h)
    return Components(*(f - g for f, g in zip(ours, limit, strict=True)))


def _places(ground: Layer | HalfSpace, r: ArrayLike, z: ArrayLike | None) -> tuple[Array, Array]:
    r = np.atleast_1d(reals(r, where="r"))
    z = np.full(r.shape, ground.top) if z is None else np.broadcast_to(reals(z, where="z"), r.shape)
    if not (np.isfinite(r).all() and np.isfinite(z).all()):
        raise InputError("places must be finite", where="points", found="NaN or infinity", expected="metres")
    bottom, slack = (0.0, 1e-9 * ground.h) if isinstance(ground, Layer) else (-np.inf, 0.0)
    if r.size and (z.min() < bottom - slack or z.max() > ground.top + slack):
        raise InputError(
            "points outside the body", where="z", found=f"{z.min():g} to {z.max():g} m",
            expected=f"{bottom:g} to {ground.top:g} m",
            hint="z is the height above the bonded base of a layer, and minus the depth in a half-space",
        )  # fmt: skip
    return np.abs(r), np.clip(z, bottom, ground.top)


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
        return np.asarray(points[:, :2] - np.asarray(self.at))


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
        return np.asarray(np.sum([part.traction(points) for part in self.parts], axis=0))

    def displacement(self, ground: Layer | HalfSpace, points: ArrayLike) -> Array:
        """As `Press.displacement`."""
        return np.asarray(np.sum([part.displacement(ground, points) for part in self.parts], axis=0))

    def resultant(self, about: Sequence[float] = (0.0, 0.0)) -> Array:
        """As `Press.resultant`."""
        return np.asarray(np.sum([part.resultant(about) for part in self.parts], axis=0))

    def mean_tractions(self, cells: ArrayLike) -> Array:
        """As `Press.mean_tractions`."""
        return np.asarray(np.sum([part.mean_tractions(cells) for part in self.parts], axis=0))


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
    return shaped(np.atleast_2d(reals(points, where="points")), PLANE, SPACE, where="points", hint="metres")
