"""Contact of a rigid sphere with a half-space: Hertz, and partial slip after Cattaneo and Mindlin.

On a bonded pad with a contact radius above a tenth of the thickness both are shapes to impose as loads
(`Hertz.press`, `Mindlin.presses`), not solutions of the contact problem: name the thickness and the guards say so.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import number, pair, positive, reals

from .guards.closed import thin_pad
from .layer import HalfSpace
from .presses import Press, Presses

Array = NDArray[np.float64]


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
                "friction cannot hold this shear",
                where="Mindlin",
                found=f"{Q:g} N",
                expected=f"0 to {limit:g} N (friction x force)",
                hint="above that the contact slides: use Press(shear=...) with shear = friction x force",
            )
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
