"""Elastic grounds in the Fourier plane: the layer bonded to a rigid base, and the half-space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import number, positive, real, reals, shown

from .waves import Components, inside, on_surface, parts, turned

Array = NDArray[np.float64]


class _Ground:
    """What layer and half-space share: E, nu, and the turn from the frame of a wave to x, y, z."""

    E: float
    nu: float

    def __post_init__(self) -> None:
        where = type(self).__name__
        object.__setattr__(self, "E", positive("E", self.E, where=where, unit="Pa"))
        nu = real(self.nu)
        if nu is None or not -1 < nu <= 0.5:
            raise InputError(
                "Poisson's ratio is not possible",
                where=where,
                found=shown(self.nu),
                expected="-1 < nu <= 0.5",
                hint="elastomers have 0.45 to 0.5; one published gel 0.3223",
            )
        object.__setattr__(self, "nu", nu)

    @property
    def mu(self) -> float:
        """Shear modulus (Pa)."""
        return self.E / (2 * (1 + self.nu))

    @property
    def kappa(self) -> float:
        """3 - 4 nu."""
        return 3 - 4 * self.nu

    @property
    def top(self) -> float:
        """Height of the loaded surface (m)."""
        raise NotImplementedError

    def components(self, k: ArrayLike, z: float | None = None) -> Components:
        """The five functions of the wave number k >= 0 (rad/m) at height z (m); None: the loaded surface."""
        raise NotImplementedError

    def kernel(self, kx: ArrayLike, ky: ArrayLike) -> NDArray[np.complex128]:
        """Surface compliance.

        Parameters
        ----------
        kx, ky : array_like
            Wave numbers (rad/m), shapes that broadcast to (...).

        Returns
        -------
        ndarray, (..., 3, 3)
            Displacement X, Y, Z (m) per traction X, Y, Z (Pa); Hermitian and positive definite.
        """
        return self.interior(kx, ky, None)

    def interior(self, kx: ArrayLike, ky: ArrayLike, z: float | None) -> NDArray[np.complex128]:
        """Displacement at height z (m) per traction on the loaded surface; shapes as `kernel`."""
        kx, ky = np.broadcast_arrays(_waves(kx), _waves(ky))
        k = np.hypot(kx, ky)
        return turned(kx, ky, self.components(k, z))


@dataclass(frozen=True)
class Layer(_Ground):
    """Elastic layer of thickness h, bonded to a rigid base at z = 0 and loaded at z = h.

    Parameters
    ----------
    h : float
        Thickness (m).
    E : float
        Young's modulus (Pa): a pure gain, every compliance goes as 1/E.
    nu : float
        Poisson's ratio, above -1 and up to 0.5 inclusive.

    Raises
    ------
    InputError
        If a value is not possible.
    """

    h: float
    E: float
    nu: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "h", positive("h", self.h, where="Layer", unit="m"))
        super().__post_init__()

    @property
    def top(self) -> float:
        """Height of the loaded surface: h (m)."""
        return self.h

    @cached_property
    def half_space(self) -> HalfSpace:
        """The half-space of the same material: the limit of short waves."""
        return HalfSpace(E=self.E, nu=self.nu)

    def components(self, k: ArrayLike, z: float | None = None) -> Components:
        """The five functions of the wave number k >= 0 (rad/m) at height 0 <= z <= h (m); None: the surface.

        Raises
        ------
        InputError
            If z lies outside the layer.
        """
        k = _waves(k)
        z = self.h if z is None else _height(z, self.h)
        found = on_surface(k * self.h, self.nu) if z == self.h else inside(k * self.h, k * z, self.nu)
        still = Components(  # the limit k -> 0: simple shear, and compression without lateral strain
            kk=np.array(z / self.mu),
            zz=np.array(z * (1 - 2 * self.nu) / (2 * self.mu * (1 - self.nu))),
            kz=np.array(0.0),
            zk=np.array(0.0),
            tt=np.array(z / self.mu),
        )
        scale = 1 / (self.mu * np.where(k == 0, 1.0, k))
        return Components(*(np.where(k == 0, s, scale * f) for s, f in zip(still, found, strict=True)))

    def stiffness(self, kx: ArrayLike, ky: ArrayLike) -> NDArray[np.complex128]:
        """Surface traction (Pa) per displacement of the surface (m), (..., 3, 3), without a subtraction of near equals.

        Raises
        ------
        InputError
            At k = 0 of an incompressible layer, which no even pressure can compress.
        """
        kx, ky = np.broadcast_arrays(_waves(kx), _waves(ky))
        k = np.hypot(kx, ky)
        if self.nu == 0.5 and not k.all():
            raise InputError(
                "an incompressible bonded layer has no finite stiffness at k = 0",
                where="Layer.stiffness",
                found="nu = 0.5, k = 0",
                hint="use the compliance, or leave k = 0 out",
            )
        x, still = k * self.h, k == 0
        x = np.where(still, 1.0, x)
        p = parts(x, self.nu)
        a, nu = self.mu * np.where(still, 1.0, k), self.nu
        C = 2 * a * p.C / p.N
        found = Components(
            kk=4 * (1 - nu) * a * p.zz / p.N, zz=4 * (1 - nu) * a * p.kk / p.N, kz=-C, zk=-C, tt=a / np.tanh(x)
        )
        shear = self.mu / self.h
        press = np.inf if nu == 0.5 else 2 * shear * (1 - nu) / (1 - 2 * nu)
        limit = (shear, press, 0.0, 0.0, shear)
        return turned(kx, ky, Components(*(np.where(still, s, f) for s, f in zip(limit, found, strict=True))))


@dataclass(frozen=True)
class HalfSpace(_Ground):
    """Elastic half-space. Its surface is z = 0 and the body lies at z <= 0: a depth d is z = -d.

    Parameters
    ----------
    E : float
        Young's modulus (Pa).
    nu : float
        Poisson's ratio, above -1 and up to 0.5 inclusive.

    Raises
    ------
    InputError
        If a value is not possible.
    """

    E: float
    nu: float

    @property
    def top(self) -> float:
        """Height of the loaded surface: 0."""
        return 0.0

    def components(self, k: ArrayLike, z: float | None = None) -> Components:
        """The five functions of the wave number k > 0 (rad/m) at height z <= 0 (m); None: the surface.

        Raises
        ------
        InputError
            At k = 0, where the motion has no bound, or above the surface.
        """
        k = _waves(k)
        z = 0.0 if z is None else number("z", z, where="HalfSpace", unit="m")
        if z > 0:
            raise InputError("a height above the half-space", where="z", found=z, expected="z <= 0: a depth is -z")
        if not k.all():
            raise InputError(
                "a half-space has no finite mean displacement",
                where="HalfSpace",
                found="k = 0",
                hint="leave k = 0 out, or use a Layer, whose base stands still",
            )
        q, nu = -k * z, self.nu
        a = np.exp(-q) / (2 * self.mu * k)
        return Components(
            kk=a * (2 * (1 - nu) - q),
            zz=a * (2 * (1 - nu) + q),
            kz=a * (1 - 2 * nu - q),
            zk=a * (1 - 2 * nu + q),
            tt=2 * a,
        )

    def stiffness(self, kx: ArrayLike, ky: ArrayLike) -> NDArray[np.complex128]:
        """Surface traction (Pa) per displacement of the surface (m), (..., 3, 3); k = 0 gives none."""
        kx, ky = np.broadcast_arrays(_waves(kx), _waves(ky))
        a = 2 * self.mu * np.hypot(kx, ky) / self.kappa
        C, diagonal = -a * (1 - 2 * self.nu), 2 * a * (1 - self.nu)
        return turned(kx, ky, Components(kk=diagonal, zz=diagonal, kz=C, zk=C, tt=a * self.kappa / 2))


def _waves(k: ArrayLike) -> Array:
    found = reals(k, where="wave number", what="wave numbers are no real numbers")
    if not np.isfinite(found).all():
        raise InputError("wave numbers must be finite", where="k", found="NaN or infinity", expected="rad/m")
    return found


def _height(z: Any, h: float) -> float:
    found = number("z", z, where="Layer", unit="m")
    if not -1e-9 * h <= found <= (1 + 1e-9) * h:
        raise InputError(
            "a height outside the layer",
            where="z",
            found=found,
            expected=f"0 (the base) to {h:g} m (the surface)",
            hint="heights are in metres above the bonded base",
        )
    return min(max(found, 0.0), h)
