"""Round loads on a layer or a half-space: Hankel integrals, exact to about 1e-10 of the largest motion.

The motion of the half-space is known in closed form (`tactile.profiles`). What the rigid base takes from it decays as
exp(-k (2 h - d)) at depth d, so that its Hankel integrals need a short Gauss rule only, and are so smooth in r and z
that a Chebyshev interpolant carries them to any number of points.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain, positive, reals

from .layer import HalfSpace, Layer
from .profiles import Profile, profile
from .quadrature import gauss
from .waves import Components

Array = NDArray[np.float64]
HEIGHTS = 21  # Chebyshev points over the thickness, where points have more heights than that: 1e-12
TABLE = 4096  # points of a cubic spline in its stead for a great many distances: 1e-11
BATCH = 20_000  # points at a time
DECAY = 40.0  # where the integrals end: exp(-40) of their start


def radial(ground: Layer | HalfSpace, shape: str, radius: float, r: ArrayLike, z: ArrayLike | None = None) -> Array:
    """Five radial functions of a round load of unit resultant (m/N), (points, 5).

    With f_m[X] = (1/2 pi) int X(k) g(k a) J_m(k r) k dk and the five functions of `tactile.layer.Components`:
    f_0[zz], f_1[kz], f_1[zk], f_0[(kk + tt)/2], f_2[(kk - tt)/2]. `moved` makes displacements of them.

    Parameters
    ----------
    ground : Layer or HalfSpace
        What is pressed.
    shape : str
        ``"hertz"``: sqrt(1 - r^2/a^2), or ``"uniform"``.
    radius : float
        Radius a of the load (m).
    r : array_like, (points,)
        Distances from its axis (m).
    z : array_like, (points,), optional
        Heights (m), as `Layer` and `HalfSpace` count them; None: on the surface.

    Raises
    ------
    InputError
        If distances or heights are no finite numbers or lie outside the body.
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
    return np.einsum("pij,j->pi", matrices(functions, offsets), np.asarray(plain(force), float))


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


def _half_space(ground: Layer | HalfSpace, form: Profile, a: float, r: Array, depth: Array) -> Array:
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
    return CubicSpline(at, chebyshev.chebvander(2 * at / reach - 1, degree) @ coefficients)(r)


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
        return J @ np.column_stack([w * part(f) for f in waves])

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
            "points outside the body",
            where="z",
            found=f"{z.min():g} to {z.max():g} m",
            expected=f"{bottom:g} to {ground.top:g} m",
            hint="z is the height above the bonded base of a layer, and minus the depth in a half-space",
        )
    return np.abs(r), np.clip(z, bottom, ground.top)
