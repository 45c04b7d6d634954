"""Round tractions of unit resultant: shape, Hankel transform, means over polygons, Gauss rules.

A profile g(r) of radius a, unit resultant, has the transform g(k a) with g(0) = 1. On a half-space all motions are sums
of

    H0_m = int e^{-k d} g(k a) J_m(k r) dk,    H1_m = int k e^{-k d} g(k a) J_m(k r) dk,    m = 0, 1, 2,

at depth d, in closed form: both transforms are averages of cos(k a t) over 0 <= t <= 1, that is of the field of a point
load at the complex depth d - i a t.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from structures.errors import InputError, one_of

from .._arrays import Array, shaped


@lru_cache(maxsize=64)
def gauss(n: int) -> tuple[Array, Array]:
    """Places and weights of the Gauss-Legendre rule of n points on 0 ... 1, read-only."""
    from scipy.special import roots_legendre

    x, w = roots_legendre(n)
    x, w = (x + 1) / 2, w / 2
    x.flags.writeable = w.flags.writeable = False
    return x, w


def drawn(n: int) -> tuple[Array, Array]:
    """The same, drawn to both ends by t = (1 - cos) / 2: square roots and logarithms there do no harm."""
    x, w = gauss(n)
    return (1 - np.cos(np.pi * x)) / 2, np.pi / 2 * w * np.sin(np.pi * x)


SHALLOW = 0.05  # d/a below which the rules need more points


@dataclass(frozen=True)
class PressureProfile:
    """A round traction of unit radius and unit resultant, by functions of r/a and of s = k a.

    `shape` is the traction times a^2, `within` the share of the resultant inside r/a, `transform` the Hankel transform
    (1 at s = 0), `surface` H0_0, H0_1, H0_2 on the surface times a (n, 3), `weight` that of cos(s t), 0 <= t <= 1, in
    the transform.
    """

    name: str
    shape: Callable[[Array], Array]
    within: Callable[[Array], Array]
    transform: Callable[[Array], Array]
    surface: Callable[[Array], Array]
    weight: Callable[[Array], Array]

    def below(self, r: Array, d: Array) -> tuple[Array, Array]:
        """(H0, H1) at r/a and d/a > 0, times a and a^2; each (n, 3), to 1e-11."""
        H0, H1 = np.empty((2, len(r), 3))
        shallow = d < SHALLOW
        for here, nodes in ((shallow, 40), (~shallow, 24)):
            if here.any():
                H0[here], H1[here] = self._below(r[here], d[here], nodes)
        return H0, H1

    def _below(self, r: Array, d: Array, nodes: int) -> tuple[Array, Array]:
        """The Gauss rules are drawn together at t = r, next to the pole of the field of a point load, and at t = 1."""
        x, w = gauss(nodes)
        middle = np.minimum(r, 1.0)
        gap = np.hypot(d, np.maximum(r - 1, 0.0))
        H0, H1 = np.zeros((2, len(r), 3))
        for side in (-1, 1):
            reach = np.arcsinh((1 - middle if side > 0 else middle) / gap)
            # a root at t = 1 (far end of one side, near end of the other for r >= 1) is smooth in a square
            v = reach[:, None] * (1 - (1 - x) ** 2 if side > 0 else x**2)
            dv = reach[:, None] * 2 * (1 - x if side > 0 else x)
            t = middle[:, None] + side * gap[:, None] * np.sinh(v)
            weight = self.weight(t) * w * dv * gap[:, None] * np.cosh(v)
            z, rr = d[:, None] - 1j * t, r[:, None]
            R = np.sqrt(rr**2 + z * z)
            one, turn = 1 / R, rr / (R + z)
            cube = one * one * one
            fields = (one, turn * one, turn * turn * one)
            slopes = (z * cube, rr * cube, turn * turn * (2 * R + z) * cube)
            for m in range(3):
                H0[:, m] += np.einsum("pj,pj->p", weight, fields[m].real)
                H1[:, m] += np.einsum("pj,pj->p", weight, slopes[m].real)
        return H0, H1


def profile(name: str) -> PressureProfile:
    """The profile of a name, ``"hertz"`` or ``"uniform"``; another name is refused."""
    hint = '"hertz" for a sphere or for partial slip, "uniform" for a flat patch'
    return PROFILES[one_of("no profile of a press", name, PROFILES, where="profile", hint=hint)]


def _hertz_shape(r: Array) -> Array:
    return 1.5 / np.pi * np.sqrt(np.clip(1 - r**2, 0, None))


def _hertz_within(r: Array) -> Array:
    return np.asarray(-np.expm1(1.5 * np.log1p(-(np.minimum(r, 1.0 - 1e-16) ** 2))))


def _hertz_transform(s: Array) -> Array:
    small = np.minimum(np.abs(s), 0.3)
    series = 1 - small**2 / 10 * (1 - small**2 / 28 * (1 - small**2 / 54 * (1 - small**2 / 88)))
    big = np.where(np.abs(s) < 0.3, 1.0, s)
    return np.where(np.abs(s) < 0.3, series, 3 * (np.sin(big) - big * np.cos(big)) / big**3)


def _hertz_surface(r: Array) -> Array:
    """Inside r <= 1 polynomials, outside by the angle asin(1/r) (Hertz; the tangential terms by the same integral)."""
    out = np.maximum(r, 1.0)
    angle, root = np.arcsin(1 / out), np.sqrt(1 - 1 / out**2)
    safe = np.where(r == 0, 1.0, r)
    first = np.where(r < 1, 3 * np.pi / 8 * (2 - r**2), 0.75 * ((2 - out**2) * angle + out * root))
    second = np.where(r == 0, 0.0, _hertz_within(r) / safe)
    outer = np.sin(2 * angle) / 2 - out**2 * (np.sin(2 * angle) / 4 - angle / 4 - np.sin(4 * angle) / 16)
    third = np.where(r < 1, 3 * np.pi / 16 * r**2, 1.5 * outer)
    return np.stack([first, second, third], axis=-1)


def _hertz_weight(t: Array) -> Array:
    return 1.5 * (1 - t**2)


def _uniform_shape(r: Array) -> Array:
    return np.where(r <= 1, 1 / np.pi, 0.0)


def _uniform_within(r: Array) -> Array:
    return np.minimum(r, 1.0) ** 2


def _uniform_transform(s: Array) -> Array:
    from scipy.special import j1

    safe = np.where(s == 0, 1.0, s)
    return np.where(s == 0, 1.0, 2 * j1(safe) / safe)


def _uniform_surface(r: Array) -> Array:
    """Weber-Schafheitlin integrals of J_1 J_m / k."""
    from scipy.special import hyp2f1

    inner, out = np.minimum(r, 1.0), np.maximum(r, 1.0)
    m, M = inner**2, 1 / out**2
    first = np.where(r < 1, 2 * hyp2f1(0.5, -0.5, 1, m), hyp2f1(0.5, 0.5, 2, M) / out)
    second = np.where(r < 1, inner, 1 / out)
    third = np.where(r < 1, m * hyp2f1(1.5, 0.5, 3, m) / 4, hyp2f1(1.5, -0.5, 2, M) / out)
    return np.stack([first, second, third], axis=-1)


def _uniform_weight(t: Array) -> Array:
    return 4 / np.pi * np.sqrt(np.clip(1 - t**2, 0, None))


PROFILES = {
    "hertz": PressureProfile("hertz", _hertz_shape, _hertz_within, _hertz_transform, _hertz_surface, _hertz_weight),
    "uniform": PressureProfile(
        "uniform", _uniform_shape, _uniform_within, _uniform_transform, _uniform_surface, _uniform_weight
    ),
}


NODES = 16  # a side of each crossing; the square root of the traction at r = 1 is smooth in the angle that places them


def polygon_means(profile: PressureProfile, corners: Array) -> Array:
    """Mean over polygons (n, corners, 2), counter-clockwise, of a round traction of unit radius about the origin, (n,).

    By Green's theorem the integral is the sum over the edges of int F(r) dphi, 2 pi F(r) being the share of the
    resultant within r: outside the contact an angle, inside a smooth integrand.
    """
    corners = shaped(corners, (None, None, 2), where="cells", what="cells are no polygons")
    start, end = corners, np.roll(corners, -1, axis=1)
    cross = start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]
    area = cross.sum(axis=1) / 2
    if not (area > 0).all():
        raise InputError(
            "a cell has no area, or its corners run clockwise", where="cells",
            found=f"{np.count_nonzero(~(area > 0))} of {len(area)}", expected="corners counter-clockwise",
        )  # fmt: skip
    low, high = _inside(start, end)
    first, last = start + low[..., None] * (end - start), start + high[..., None] * (end - start)
    last = np.where((high == 1)[..., None], end, last)  # rounding at the axis of the press would be an angle of its own
    outside = _angle(start, first) + _angle(last, end)
    t, dt = drawn(NODES)
    at = first[..., None, :] + t[:, None] * (last - first)[..., None, :]
    square = np.maximum((at**2).sum(axis=-1), 1e-24)
    swept = ((high - low) * cross)[..., None] * profile.within(np.sqrt(square)) / square
    return np.asarray(((swept @ dt + outside).sum(axis=1) / (2 * np.pi)) / area)


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
    return np.asarray(np.arctan2(cross, (start * end).sum(axis=-1)))
