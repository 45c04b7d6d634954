"""Materials, cross-sections, and the closed forms of one straight Timoshenko element.

Local axes: x along the member, z towards the reference, y = z x x. The twelve local unknowns are (u, v, w, rx, ry, rz)
at the start and at the end; rotations are right-handed, so that without shear rz = v' and ry = -w'. Phi is the shear
parameter 12 E I / (kappa G A L^2); Phi = 0 is Euler-Bernoulli.

J. S. Przemieniecki, *Theory of Matrix Structural Analysis* (1968), chapters 5, 11 and 15; I. Friedman, J. B. Kosmatka,
"An improved two-node Timoshenko beam finite element", Computers & Structures 47 (1993) 473-481.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, pair, positive, real, shown


@dataclass(frozen=True)
class Material:
    """A linear elastic, isotropic material.

    Parameters
    ----------
    E : float
        Young's modulus (Pa).
    rho : float
        Density (kg/m^3).
    nu : float
        Poisson's ratio, between -1 and 0.5.

    Raises
    ------
    InputError
        If a value is not possible.
    """

    E: float
    rho: float
    nu: float = 0.3

    def __post_init__(self) -> None:
        positive("E", self.E, where="material", unit="Pa")
        positive("rho", self.rho, where="material", unit="kg/m^3")
        nu = real(self.nu)
        if nu is None or not -1 < nu < 0.5:
            raise InputError(
                "Poisson's ratio is not possible",
                where="material",
                found=shown(self.nu),
                expected="-1 < nu < 0.5",
                hint="most metals have 0.3",
            )


steel = Material(E=210e9, rho=7850.0, nu=0.30)
aluminium = Material(E=70e9, rho=2700.0, nu=0.33)


SERIES = 60  # odd terms of the torsion series: the next one is below 1e-10 of the sum


def a_material(material: Any, where: str) -> Material:
    """A material.

    Raises
    ------
    InputError
        If it is none.
    """
    if not isinstance(material, Material):
        raise InputError(
            "no material",
            where=f"{where}, material",
            found=shown(material),
            expected="a Material",
            hint="beams.materials.steel, or beams.Material(E=, rho=, nu=)",
        )
    return material


def thin(thickness: Any, most: float, where: str, sides: str, of: str) -> float:
    """Thickness of a plate (m), at most `most`.

    Raises
    ------
    InputError
        If it is none, or too thick for Kirchhoff theory.
    """
    found = positive("thickness", thickness, where=where, unit="m")
    if found > most:
        raise InputError(
            "the plate is too thick to be a plate: it would shear, not bend",
            where=where,
            found=f"thickness {found:g} m, {sides}",
            expected=f"a thickness of at most a third of the {of}; a twentieth is usual",
            hint="check the units of thickness (m); Kirchhoff theory has no shear",
        )
    return found


@dataclass(frozen=True)
class Section:
    """A cross-section with the principal axes y (width) and z (height).

    A beam bends over the height z and needs the first three values only; a plane frame with shear also needs `shear`,
    and a space frame needs `I_z` and `J`.

    Parameters
    ----------
    A : float
        Area (m^2).
    I : float
        Second moment of area about y: bending over the height z, as of a beam and a plane frame (m^4).
    c : float
        Distance of the outer fibre along z from the neutral axis (m); where a strain gauge sits.
    I_z : float, optional
        Second moment of area about z: bending over the width y (m^4).
    c_y : float, optional
        Distance of the outer fibre along y (m).
    J : float, optional
        Torsion constant of St Venant (m^4).
    shear : (float, float), optional
        Shear factors kappa along y and z: the stiffness against shear is kappa G A.

    Raises
    ------
    InputError
        If a value is not positive.

    Notes
    -----
    The shear factors of the ready shapes are those of G. R. Cowper, "The shear coefficient in Timoshenko's beam
    theory", J. Appl. Mech. 33 (1966) 335-340, at nu = 0: 5/6, 6/7, and 1/2 for a thin tube.
    """

    A: float
    I: float  # noqa: E741  (the field's symbol)
    c: float
    I_z: float | None = None
    c_y: float | None = None
    J: float | None = None
    shear: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for name in ("A", "I", "c", "I_z", "c_y", "J"):
            value = getattr(self, name)
            if value is not None or name in ("A", "I", "c"):
                _positive(name, value)
        if self.shear is not None:
            factors = pair("shear", self.shear, where="section")
            for factor in factors:
                _positive("a shear factor", factor)
            object.__setattr__(self, "shear", factors)

    @classmethod
    def rectangle(cls, width: float, height: float) -> Section:
        """Solid rectangle, `width` along y and `height` along z (m)."""
        _positive("width", width)
        _positive("height", height)
        return cls(
            A=width * height,
            I=width * height**3 / 12,
            c=height / 2,
            I_z=height * width**3 / 12,
            c_y=width / 2,
            J=_torsion(max(width, height), min(width, height)),
            shear=(5 / 6, 5 / 6),
        )

    @classmethod
    def circle(cls, diameter: float) -> Section:
        """Solid circle of `diameter` (m)."""
        _positive("diameter", diameter)
        return cls._round(math.pi * diameter**2 / 4, math.pi * diameter**4 / 64, diameter, 0.0)

    @classmethod
    def tube(cls, diameter: float, wall: float) -> Section:
        """Round tube of outer `diameter` and `wall` thickness (m)."""
        _positive("diameter", diameter)
        _positive("wall", wall)
        if wall > diameter / 2:
            raise InputError(
                "the wall is thicker than the radius",
                where="section",
                found=wall,
                expected=f"<= {diameter / 2:g} m",
                hint="give the outer diameter; Section.circle is the solid one",
            )
        # written as products: the difference of two fourth powers would cancel for a thin wall
        inner = diameter - 2 * wall
        area = math.pi * wall * (diameter - wall)
        return cls._round(area, area * (diameter**2 + inner**2) / 16, diameter, inner / diameter)

    @classmethod
    def _round(cls, area: float, second: float, diameter: float, ratio: float) -> Section:
        """Section that is the same about every axis; `ratio` is the inner over the outer diameter."""
        a = (1 + ratio**2) ** 2
        kappa = 6 * a / (7 * a + 20 * ratio**2)
        return cls(area, second, diameter / 2, second, diameter / 2, 2 * second, (kappa, kappa))


def _torsion(long: float, short: float) -> float:
    """Torsion constant of a rectangle.

    S. P. Timoshenko, J. N. Goodier, *Theory of Elasticity*, 3rd ed. (1970), article 109: exact, as a series.
    """
    ratio = long / short
    odd = range(1, 2 * SERIES, 2)
    series = sum(math.tanh(n * math.pi * ratio / 2) / n**5 for n in odd)
    return long * short**3 / 3 * (1 - 192 / math.pi**5 / ratio * series)


def _positive(name: str, value: float | None) -> None:
    positive(name, value, where="section", unit="m, m^2 or m^4")


AXIAL, TWIST = [0, 6], [3, 9]
V, W = [1, 5, 7, 11], [2, 4, 8, 10]  # (v, rz) and (w, ry) at both ends
TURN = np.array([1.0, -1.0, 1.0, -1.0])  # ry = -w'
PLANE = [0, 2, 4, 6, 8, 10]  # X, Z, RY at both ends
Array = NDArray[np.float64]


def _pattern(a: float, b: float, c: float, d: float) -> Array:
    """The sign pattern that rotary mass and geometric stiffness share."""
    return np.array([[a, b, -a, b], [b, c, -b, -d], [-a, -b, a, -b], [b, -d, -b, c]])


def bending_stiffness(EI: float, h: float, phi: float = 0.0) -> Array:
    """Stiffness of (v1, r1, v2, r2) of an element of length `h`, (4, 4)."""
    a, b, c, d = 12.0, 6 * h, (4 + phi) * h * h, (2 - phi) * h * h
    return EI / (h**3 * (1 + phi)) * np.array([[a, b, -a, b], [b, c, -b, d], [-a, -b, a, -b], [b, d, -b, c]])


def bending_mass(mass: float, h: float, phi: float = 0.0) -> Array:
    """Consistent mass of the translation, `mass` per length (kg/m), (4, 4)."""
    p2 = phi * phi
    m1, m3 = 13 / 35 + 7 * phi / 10 + p2 / 3, 9 / 70 + 3 * phi / 10 + p2 / 6
    m2, m4 = (11 / 210 + 11 * phi / 120 + p2 / 24) * h, (13 / 420 + 3 * phi / 40 + p2 / 24) * h
    m5, m6 = (1 / 105 + phi / 60 + p2 / 120) * h * h, (1 / 140 + phi / 60 + p2 / 120) * h * h
    table = np.array([[m1, m2, m3, -m4], [m2, m5, m4, -m6], [m3, m4, m1, -m2], [-m4, -m6, -m2, m5]])
    return mass * h / (1 + phi) ** 2 * table


def rotary_mass(inertia: float, h: float, phi: float = 0.0) -> Array:
    """Consistent mass of the rotation of the sections, `inertia` = rho I (kg m), (4, 4)."""
    p2 = phi * phi
    table = _pattern(
        6 / 5, (1 / 10 - phi / 2) * h, (2 / 15 + phi / 6 + p2 / 3) * h * h, (1 / 30 + phi / 6 - p2 / 6) * h * h
    )
    return inertia / (h * (1 + phi) ** 2) * table


def tension_stiffness(T: float, h: float, phi: float = 0.0) -> Array:
    """Geometric stiffness of an axial force `T` (N, positive in tension), (4, 4)."""
    p2 = phi * phi
    table = _pattern(
        6 / 5 + 2 * phi + p2, h / 10, (2 / 15 + phi / 6 + p2 / 12) * h * h, (1 / 30 + phi / 6 + p2 / 12) * h * h
    )
    return T / (h * (1 + phi) ** 2) * table


def deflection(xi: float, h: float, phi: float = 0.0) -> Array:
    """Shape functions of the deflection at ``xi = x / h``, (4,)."""
    n3 = xi * xi * (3 - 2 * xi) + phi * xi
    bow = phi / 2 * xi * (1 - xi)
    n2, n4 = h * (xi * (1 - xi) ** 2 + bow), h * (xi * xi * (xi - 1) - bow)
    return np.array([1 + phi - n3, n2, n3, n4]) / (1 + phi)


def rotation(xi: float, h: float, phi: float = 0.0) -> Array:
    """Shape functions of the rotation of the section (v' without shear), (4,)."""
    n1 = 6 * xi * (xi - 1) / h
    n2, n4 = (1 - xi) * (1 - 3 * xi + phi), xi * (3 * xi - 2 + phi)
    return np.array([n1, n2, -n1, n4]) / (1 + phi)


def curvature(xi: float, h: float, phi: float = 0.0) -> Array:
    """Derivative of `rotation` in x, (4,)."""
    n1 = 6 * (2 * xi - 1)
    return np.array([n1, h * (6 * xi - 4 - phi), -n1, h * (6 * xi - 2 + phi)]) / (h * h * (1 + phi))


@dataclass(frozen=True)
class Element:
    """One element of a member; all elements of a member are equal.

    Parameters
    ----------
    h : float
        Length (m).
    section, material : Section and Material
        Properties; a plane frame needs no `I_z` and no `J` of the section.
    shear : bool
        Timoshenko (with rotary inertia) instead of Euler-Bernoulli.
    """

    h: float
    section: Section
    material: Material
    shear: bool

    @property
    def G(self) -> float:
        """Shear modulus (Pa)."""
        return self.material.E / (2 * (1 + self.material.nu))

    @property
    def seconds(self) -> tuple[float, float]:
        """Second moments of bending along y and along z: I_z and I_y; a plane frame takes one for both."""
        return self.section.I_z or self.section.I, self.section.I

    @property
    def phi(self) -> tuple[float, float]:
        """Shear parameters of bending along y and along z."""
        if not self.shear or self.section.shear is None:
            return 0.0, 0.0
        factor = 12 * self.material.E / (self.G * self.section.A * self.h**2)
        (I_z, I_y), (ky, kz) = self.seconds, self.section.shear
        return factor * I_z / ky, factor * I_y / kz

    def stiffness(self) -> Array:
        """Stiffness in local axes, (12, 12)."""
        s, E, h = self.section, self.material.E, self.h
        blocks = [bending_stiffness(E * second, h, phi) for second, phi in zip(self.seconds, self.phi, strict=True)]
        bar = np.array([[1.0, -1.0], [-1.0, 1.0]]) / h
        return _assembled(blocks, E * s.A * bar, self.G * (s.J or 0.0) * bar)

    def mass(self) -> Array:
        """Consistent mass in local axes, (12, 12); rotary inertia of the bending only with shear."""
        s, rho, h = self.section, self.material.rho, self.h
        blocks = [bending_mass(rho * s.A, h, phi) for phi in self.phi]
        if self.shear:
            parts = zip(blocks, self.seconds, self.phi, strict=True)
            blocks = [block + rotary_mass(rho * second, h, phi) for block, second, phi in parts]
        bar = rho * h / 6 * np.array([[2.0, 1.0], [1.0, 2.0]])
        return _assembled(blocks, s.A * bar, sum(self.seconds) * bar)

    def tension(self, T: float) -> Array:
        """Geometric stiffness of an axial force in local axes, (12, 12)."""
        none = np.zeros((2, 2))
        return _assembled([tension_stiffness(T, self.h, phi) for phi in self.phi], none, none)

    def motion(self, xi: float) -> Array:
        """Local (u, v, w, rx, ry, rz) at ``xi`` from the twelve unknowns, (6, 12)."""
        rows, (py, pz) = np.zeros((6, 12)), self.phi
        rows[0, AXIAL] = rows[3, TWIST] = 1 - xi, xi
        rows[1, V], rows[5, V] = deflection(xi, self.h, py), rotation(xi, self.h, py)
        rows[2, W], rows[4, W] = TURN * deflection(xi, self.h, pz), -TURN * rotation(xi, self.h, pz)
        return rows

    def gradient(self, xi: float) -> Array:
        """Local (u', ry', rz') at ``xi``: what strains the fibres, (3, 12)."""
        rows, (py, pz) = np.zeros((3, 12)), self.phi
        rows[0, AXIAL] = -1 / self.h, 1 / self.h
        rows[1, W], rows[2, V] = -TURN * curvature(xi, self.h, pz), curvature(xi, self.h, py)
        return rows


def _assembled(bending: list[Array], axial: Array, torsion: Array) -> Array:
    """Twelve by twelve from bending along y, bending along z (turned), axial and torsional parts."""
    A = np.zeros((12, 12))
    A[np.ix_(V, V)] = bending[0]
    A[np.ix_(W, W)] = TURN[:, None] * bending[1] * TURN
    A[np.ix_(AXIAL, AXIAL)] = axial
    A[np.ix_(TWIST, TWIST)] = torsion
    return A
