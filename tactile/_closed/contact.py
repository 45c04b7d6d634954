"""Rigid bodies pressed on a pad: Hertz, Cattaneo and Mindlin, indenters on a bonded layer, imposed motion.

The pressure is written as p~(k) = int_0^a phi(t) cos(k t) dt. Abel's transform of w(r) = delta - r^2 / 2 R then leaves
a Fredholm equation of the second kind with a smooth kernel (Lebedev and Ufliand 1958), with c = 2 (1 - nu^2)/E and the
layer's G_zz = (1 - nu)/(mu k) (1 - Omega(k h)):

    c [phi(t) - (2/pi) int_0^a phi(s) int_0^inf Omega(k h) cos(k t) cos(k s) dk ds] = (2/pi) (delta - t^2 / R).

A sphere meets the layer where phi(a) = 0; the force is 2 pi int_0^a phi dt. Small strain; the sphere is a paraboloid.

On a bonded pad with a contact radius above a tenth of the thickness both are shapes to impose as loads
(`Hertz.press`, `Mindlin.presses`), not solutions of the contact problem: name the thickness and the guards say so.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from structures._flags import Flag
from structures.errors import InputError, number, pair, positive, reals

from .._arrays import Array, Mask
from .halfspace import thin_pad
from .layer import HalfSpace, Layer
from .presses import Press, Presses


class Indenter(Protocol):
    """What completes the normal motion of a surface from a known shape."""

    def normal(self, points: Array) -> tuple[Array, Mask]:
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

    def normal(self, points: Array) -> tuple[Array, Mask]:
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

    def normal(self, points: Array) -> tuple[Array, Mask]:
        """Motion u_z (n,) and where the cylinder lies under the surface at rest."""
        across = np.array([-np.sin(self.angle), np.cos(self.angle)])
        return _cap(np.abs((points - np.asarray(self.at)) @ across), self.radius, self.depth)


def _cap(r: Array, radius: float, depth: float) -> tuple[Array, Mask]:
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


NODES, WAVES, END = 32, 240, 30.0  # Gauss points over the contact and over k h; Omega(30) is 1e-23
WIDEST, NARROWEST = 4.0, 0.01  # contact radius over thickness
STEPS = 48


def flat_stiffness(layer: Layer, radius: float) -> float:
    """Force over depth (N/m) of a flat-ended cylinder.

    Raises
    ------
    InputError
        A radius that is not positive, or wider than 4 thicknesses.
    """
    a = positive("radius", radius, where="flat_stiffness", unit="m")
    if a > WIDEST * layer.h:
        raise InputError(
            "the punch is wider than what this solution resolves", where="flat_stiffness",
            found=f"a/h = {a / layer.h:.3g}", expected=f"at most {WIDEST:g}",
            hint="such a punch compresses the layer uniformly",
        )  # fmt: skip
    level = _solved((a / layer.h,), layer.nu)[0, 0]
    return float(2 * layer.E * a / (1 - layer.nu**2) * level)


def sphere_contact(layer: Layer, radius: float, contact: ArrayLike) -> tuple[Array, Array]:
    """Depth (m) and force (N) at which a sphere of some radius (m) touches up to contact radii `contact` (m).

    Raises
    ------
    InputError
        Radii that are not positive, or contact wider than 4 thicknesses.
    """
    R = positive("radius", radius, where="sphere_contact", unit="m")
    a = np.atleast_1d(reals(contact, where="sphere_contact"))
    if not np.isfinite(a).all() or (a <= 0).any() or (a > WIDEST * layer.h).any():
        raise InputError(
            "contact radius outside what this solution resolves", where="sphere_contact, contact",
            found=f"a/h to {np.max(a) / layer.h:.3g}", expected=f"0 < a/h <= {WIDEST:g}", hint="a radius in m",
        )  # fmt: skip
    found = _spheres(tuple((a.ravel() / layer.h).tolist()), layer.nu)
    shape = np.shape(contact)
    depth = found[:, 0] * layer.h**2 / R
    force = found[:, 1] * layer.E * layer.h**3 / R
    return depth.reshape(shape), force.reshape(shape)


def sphere_force(layer: Layer, radius: float, depth: ArrayLike) -> Array:
    """Force (N) of a sphere pressed to depths (m), zero where the depth is negative.

    Raises
    ------
    InputError
        Depths beyond contact of 4 thicknesses, or no numbers.
    """
    R = positive("radius", radius, where="sphere_force", unit="m")
    d = reals(depth, where="sphere_force")
    law = sphere_law(layer.nu)
    return law(d * R / layer.h**2) * layer.E * layer.h**3 / R


@lru_cache(maxsize=64)
def sphere_limit(nu: float) -> float:
    """Largest delta R / h^2 of `sphere_law`: 6.1 for an incompressible layer, more for others."""
    return float(_spheres((WIDEST,), nu)[0, 0])


@lru_cache(maxsize=64)
def sphere_law(nu: float) -> Callable[[Array], Array]:
    """F R / (E h^3) of delta R / h^2: one curve for all spheres and layers of one Poisson's ratio."""
    from scipy.interpolate import CubicSpline

    table = np.log(_spheres(tuple(np.geomspace(NARROWEST, WIDEST, STEPS).tolist()), nu))
    spline = CubicSpline(table[:, 0], table[:, 1])
    low, high = np.exp(table[0]), float(np.exp(table[-1, 0]))

    def law(x: Array) -> Array:
        x = np.asarray(x, float)
        if not np.isfinite(x).all() or np.any(x > high * (1 + 1e-9)):
            raise InputError(
                "depth beyond what this solution resolves", where="sphere on a layer",
                found=f"depth R / h^2 = {np.max(x):.3g}", expected=f"at most {high:.3g} (contact of 4 thicknesses)",
                hint="depth, radius and thickness in m",
            )  # fmt: skip
        inside = np.maximum(x, low[0])
        found = np.exp(spline(np.log(inside)))
        return np.asarray(np.where(x >= low[0], found, low[1] * (np.maximum(x, 0) / low[0]) ** 1.5))

    return law


def _spheres(alphas: tuple[float, ...], nu: float) -> Array:
    """Depth and force (n, 2), scaled as in `sphere_law`, at contact radii over thickness."""
    level, bowl, level_rim, bowl_rim = _solved(alphas, nu).T
    alpha = np.array(alphas)
    depth = alpha**2 * bowl_rim / level_rim
    return np.stack([depth, 2 * alpha / (1 - nu**2) * (depth * level - alpha**2 * bowl)], axis=1)


def _solved(alphas: tuple[float, ...], nu: float) -> Array:
    """Integrals over the contact and rim values of the solutions for the right-hand sides 1 and t^2, (n, 4)."""
    t, w = _gauss(NODES, 1.0)
    _, v = _gauss(WAVES, END)
    waves, scale = _cosines(alphas), (2 / np.pi) * np.array(alphas)[:, None, None]
    kernel = scale * ((waves * (v * _excess(nu))) @ waves[:, :-1].transpose(0, 2, 1)) * w
    right = np.stack([np.ones(NODES + 1), np.append(t, 1.0) ** 2], axis=1)
    chi = np.linalg.solve(np.eye(NODES) - kernel[:, :-1], np.broadcast_to(right[:-1], (len(alphas), NODES, 2)))
    rim = right[-1] + (kernel[:, -1:] @ chi)[:, 0]
    return np.concatenate([w @ chi, rim], axis=1)


@lru_cache(maxsize=8)
def _cosines(alphas: tuple[float, ...]) -> Array:
    """Waves on the Gauss points of the contact and on its rim, for each contact radius; the same for every material."""
    t, _ = _gauss(NODES, 1.0)
    x, _ = _gauss(WAVES, END)
    return np.asarray(np.cos(np.multiply.outer(np.array(alphas), np.outer(np.append(t, 1.0), x))))


@lru_cache(maxsize=64)
def _excess(nu: float) -> Array:
    """Omega: what the base takes from the compliance of a half-space, on the Gauss points of k h."""
    x, _ = _gauss(WAVES, END)
    unit = Layer(h=1.0, E=1.0, nu=nu)
    return np.asarray(1 - unit.components(x).zz * unit.mu * x / (1 - nu))


@lru_cache(maxsize=8)
def _gauss(count: int, end: float) -> tuple[Any, Any]:
    x, w = np.polynomial.legendre.leggauss(count)
    return end / 2 * (x + 1), end / 2 * w


@dataclass(frozen=True)
class Hertz:
    """A rigid sphere pressed on an elastic half-space without friction (Hertz 1882).

    Parameters
    ----------
    R : float
        Radius of the sphere (m).
    force : float
        Normal force (N).
    E, nu : float
        Young's modulus (Pa) and Poisson's ratio of the half-space.
    thickness : float, optional
        Of the bonded pad that the half-space stands for (m): flagged above a/t = 0.1, refused above 0.3.
    allow : iterable of str
        ``("E602",)`` uses it all the same, flagged.

    Raises
    ------
    InputError
        If a value is not possible.
    NotIdentifiable
        Code LID-E602, on a pad too thin.
    """

    R: float
    force: float
    E: float
    nu: float
    thickness: float | None = field(default=None, kw_only=True)
    allow: Iterable[str] = field(default=(), kw_only=True)
    flags: tuple[Flag, ...] = field(init=False, default=(), repr=False)

    def __post_init__(self) -> None:
        for name, unit in (("R", "m"), ("force", "N")):
            object.__setattr__(self, name, positive(name, getattr(self, name), where="Hertz", unit=unit))
        ground = self.ground  # settles E and nu
        if self.thickness is not None:
            flag = thin_pad(self.radius, self.thickness, ground.nu, what="Hertz formula", allow=self.allow)
            object.__setattr__(self, "flags", () if flag is None else (flag,))

    @property
    def ground(self) -> HalfSpace:
        """The half-space."""
        return HalfSpace(E=self.E, nu=self.nu)

    @property
    def stiffness(self) -> float:
        """E* = E / (1 - nu^2) (Pa)."""
        return self.E / (1 - self.nu**2)

    @property
    def radius(self) -> float:
        """Contact radius a (m), a^3 = 3 F R / 4 E*."""
        return float((0.75 * self.force * self.R / self.stiffness) ** (1 / 3))

    @property
    def peak(self) -> float:
        """Largest pressure p0 = 3 F / 2 pi a^2 (Pa)."""
        return float(1.5 * self.force / (np.pi * self.radius**2))

    @property
    def approach(self) -> float:
        """Depth of the sphere delta = a^2 / R (m)."""
        return self.radius**2 / self.R

    def pressure(self, r: ArrayLike) -> Array:
        """Pressure (Pa) at distances r (m) from the axis."""
        return self.peak * np.sqrt(np.clip(1 - (_distances(r) / self.radius) ** 2, 0, None))

    def depth(self, r: ArrayLike) -> Array:
        """Depth of the surface below its rest (m) at distances r (m) from the axis, inside and outside."""
        r, a = _distances(r), self.radius
        out = np.maximum(r, a)
        share = self.peak / (2 * self.stiffness * a)
        outside = (2 * a**2 - out**2) * np.arcsin(a / out) + out * a * np.sqrt(1 - (a / out) ** 2)
        return share * np.where(r < a, np.pi / 2 * (2 * a**2 - r**2), outside)

    def press(self, at: tuple[float, float] = (0.0, 0.0)) -> Press:
        """The same pressure as a load."""
        return Press(at=at, radius=self.radius, force=self.force)


@dataclass(frozen=True)
class Mindlin:
    """A pressed sphere under a growing tangential force below the limit of friction (Cattaneo 1938, Mindlin 1949).

    The middle r < c sticks, the ring c < r < a slips. Neglected, as in the sources: tangential motion caused by the
    pressure (none at nu = 0.5), and the small motion across the force in the ring.

    Parameters
    ----------
    hertz : Hertz
        The pressed sphere.
    shear : float
        Tangential force Q (N), 0 <= Q <= friction x force.
    friction : float
        Coefficient of friction f.

    Raises
    ------
    InputError
        If a value is not possible, or the force exceeds what friction can hold.
    """

    hertz: Hertz
    shear: float
    friction: float

    def __post_init__(self) -> None:
        f = positive("friction", self.friction, where="Mindlin")
        Q = number("shear", self.shear, where="Mindlin", unit="N")
        limit = f * self.hertz.force
        if not 0 <= Q <= limit * (1 + 1e-12):
            raise InputError(
                "friction cannot hold this shear", where="Mindlin", found=f"{Q:g} N",
                expected=f"0 to {limit:g} N (friction x force)",
                hint="above that the contact slides: use Press(shear=...) with shear = friction x force",
            )  # fmt: skip
        object.__setattr__(self, "friction", f)
        object.__setattr__(self, "shear", min(Q, limit))

    @property
    def radius(self) -> float:
        """Contact radius a (m)."""
        return self.hertz.radius

    @property
    def stick(self) -> float:
        """Radius c of the part that sticks (m), c / a = (1 - Q / f P)^(1/3)."""
        return float(self.radius * self._left ** (1 / 3))

    @property
    def shift(self) -> float:
        """Tangential motion of the sphere (m)."""
        mu, nu, limit = self.hertz.ground.mu, self.hertz.nu, self.friction * self.hertz.force
        return float(3 * limit * (2 - nu) / (16 * mu * self.radius) * (1 - self._left ** (2 / 3)))

    def traction(self, r: ArrayLike) -> Array:
        """Shear traction (Pa), along the force, at distances r (m) from the axis."""
        r, a, c = _distances(r), self.radius, self.stick
        found = np.sqrt(np.clip(1 - (r / a) ** 2, 0, None))
        if c > 0:
            found = found - c / a * np.sqrt(np.clip(1 - (r / c) ** 2, 0, None))
        return self.friction * self.hertz.peak * found

    def presses(self, at: tuple[float, float] = (0.0, 0.0), direction: tuple[float, float] = (1.0, 0.0)) -> Presses:
        """The same pressure and shear as loads: two round shears, the second taking back what sticks."""
        x, y = pair("direction", direction, where="Mindlin.presses")
        size = np.hypot(x, y)
        if not size > 0:
            raise InputError("no direction", where="Mindlin.presses", found="(0, 0)", expected="a vector")
        limit = self.friction * self.hertz.force
        full, back = limit / size, -limit * self._left / size
        parts = [Press(at=at, radius=self.radius, force=self.hertz.force, shear=(x * full, y * full))]
        if self.stick > 0:
            parts.append(Press(at=at, radius=self.stick, force=0.0, shear=(x * back, y * back)))
        return Presses(tuple(parts))

    @property
    def _left(self) -> float:
        """Share of the limit of friction that is not used, 1 - Q / f P."""
        return max(0.0, 1 - self.shear / (self.friction * self.hertz.force))


def _distances(r: ArrayLike) -> Array:
    return np.abs(reals(r, where="r"))
