"""Elastic grounds in the Fourier plane: the layer bonded to a rigid base, the half-space, and their wave kernels.

Fields go as exp(i (kx x + ky y)); the traction acts on the body, z points out of it. In the frame (along k, normal) a
wave of traction moves the material by

    u_k = kk t_k - i kz t_z,    u_z = i zk t_k + zz t_z,    u_t = tt t_t,

five real functions of k and of the height (`Components`); on the loaded surface kz = zk. Those of the layer follow from
the four modes of elasticity, two of which meet u = 0 at the base. x stands for k h, y for k z.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import factorial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, number, positive, real, reals, shown

from .._arrays import Array


class Components(NamedTuple):
    """Motion (m) per unit wave of traction (Pa), in the frame (along k, normal): see the module. Shapes of k."""

    kk: Array
    zz: Array
    kz: Array
    zk: Array
    tt: Array


def turned(kx: ArrayLike, ky: ArrayLike, f: Components) -> NDArray[np.complex128]:
    """The five functions as matrices over X, Y, Z, (..., 3, 3), for waves along (kx, ky)."""
    kx, ky = np.broadcast_arrays(np.asarray(kx, float), np.asarray(ky, float))
    k = np.hypot(kx, ky)
    safe = np.where(k == 0, 1.0, k)
    cx, cy = np.where(k == 0, 1.0, kx / safe), ky / safe
    found = np.empty((*k.shape, 3, 3), complex)
    found[..., 0, 0] = f.kk * cx**2 + f.tt * cy**2
    found[..., 1, 1] = f.kk * cy**2 + f.tt * cx**2
    found[..., 0, 1] = found[..., 1, 0] = (f.kk - f.tt) * cx * cy
    found[..., 2, 2] = f.zz
    found[..., 0, 2], found[..., 1, 2] = -1j * f.kz * cx, -1j * f.kz * cy
    found[..., 2, 0], found[..., 2, 1] = 1j * f.zk * cx, 1j * f.zk * cy
    return found


class Parts(NamedTuple):
    """Terms of the surface compliance at x = k h > 0, each over e^{2x}, so that only decaying exponentials are left.

    G_kk, G_zz = (1 - nu)/(mu k) kk/M, zz/M;  C = C/(2 mu k M);  det G = N/(4 M (mu k)^2).
    """

    kk: Array
    zz: Array
    C: Array
    M: Array
    N: Array


def parts(x: Array, nu: float) -> Parts:
    """Terms of the compliance at x > 0; the rests of sinh and cosh by their series where they nearly cancel."""
    kappa, e = 3 - 4 * nu, np.exp(-2 * x)
    rise = -np.expm1(-2 * x)  # 1 - e
    return Parts(
        kk=kappa * rise * (1 + e) + 4 * x * e,
        zz=(kappa - 1) * rise * (1 + e) + _odd_rest(x),
        C=kappa * (1 - 2 * nu) * rise**2 - 4 * x**2 * e,
        M=kappa * (1 + e**2) + (4 * x**2 + kappa**2 + 1) * e,
        N=(kappa**2 - 1) * rise**2 + _even_rest(x),
    )


def on_surface(x: Array, nu: float) -> Components:
    """Compliance of the surface times mu k, at x = k h."""
    p = parts(x, nu)
    C = p.C / (2 * p.M)
    return Components(kk=(1 - nu) * p.kk / p.M, zz=(1 - nu) * p.zz / p.M, kz=C, zk=C, tt=np.tanh(x))


def inside(x: Array, y: Array, nu: float) -> Components:
    """Compliance at k z = y below a surface at k h = x, times mu k, the terms scaled by e^{-2x}."""
    kappa, d = 3 - 4 * nu, x - y
    near, far, e = np.exp(-d), np.exp(-(x + y)), np.exp(-2 * x)
    rise, rise_y = -np.expm1(-2 * x), -np.expm1(-2 * y)
    # e^{-2x} times: cosh and sinh of x + y; of d; cosh x sinh y and sinh x sinh y
    ch_sum, sh_sum = (near + e * far) / 2, (near - e * far) / 2
    ch_d, sh_d = (far + e * near) / 2, (far - e * near) / 2
    chsh, shsh = near * (1 + e) * rise_y / 4, near * rise * rise_y / 4
    # the double product x y sinh d underflows before it can overflow
    twice_D = kappa * (1 + e**2) + (4 * x**2 + kappa**2 + 1) * e
    level = kappa * (kappa + 1) * chsh - 2 * x * y * sh_d
    slope = kappa * d * ch_sum - (kappa * x + y) * ch_d
    same = kappa * (kappa - 1) * shsh - 2 * x * y * ch_d
    turn = kappa * d * sh_sum - (kappa * x - y) * sh_d
    zz = np.where(x < 1, _long_waves(np.minimum(x, 1.0), np.minimum(y, 1.0), kappa), (level + slope) / twice_D)
    return Components(
        kk=(level - slope) / twice_D,
        zz=zz,
        kz=(same - turn) / twice_D,
        zk=(same + turn) / twice_D,
        tt=near * rise_y / (1 + e),
    )


def _long_waves(x: Array, y: Array, kappa: float) -> Array:
    """The entry zz of `inside` for x <= 1 from the two modes that meet u = 0 at the base: no loss as nu -> 0.5."""
    ch, sh = np.cosh(x), np.sinh(x)
    sinking = (1 - kappa) * np.sinh(y) + y**3 * _series(y, [(2 * j + 2) / factorial(2 * j + 3) for j in range(9)])
    twice_D = 4 * x**2 + 1 + kappa**2 + 2 * kappa * np.cosh(2 * x)
    shear, press = 2 * x * ch + (1 - kappa) * sh, (1 + kappa) * ch + 2 * x * sh
    return (shear * y * np.sinh(y) - press * sinking) / twice_D


def _odd_rest(x: Array) -> Array:
    """2 e^{-2x} (sinh 2x - 2x), by its series where the two nearly cancel."""
    small, e = np.minimum(x, 0.5), np.exp(-2 * x)
    series = 2 * e * small**3 * _series(small, [2.0 ** (2 * j + 3) / factorial(2 * j + 3) for j in range(8)])
    return np.where(x < 0.5, series, -np.expm1(-4 * x) - 4 * x * e)


def _even_rest(x: Array) -> Array:
    """4 e^{-2x} (sinh(x)^2 - x^2), by its series where the two nearly cancel."""
    small, e = np.minimum(x, 0.5), np.exp(-2 * x)
    series = 4 * e * small**4 * _series(small, [2.0 ** (2 * j + 3) / factorial(2 * j + 4) for j in range(8)])
    return np.where(x < 0.5, series, np.expm1(-2 * x) ** 2 - 4 * x**2 * e)


def _series(x: Array, terms: list[float]) -> Array:
    """Horner's sum of terms[j] x^(2 j)."""
    total = np.zeros_like(x)
    for term in reversed(terms):
        total = total * x**2 + term
    return total


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
                "Poisson's ratio is not possible", where=where, found=shown(self.nu), expected="-1 < nu <= 0.5",
                hint="elastomers have 0.45 to 0.5; one published gel 0.3223",
            )  # fmt: skip
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
                "an incompressible bonded layer has no finite stiffness at k = 0", where="Layer.stiffness",
                found="nu = 0.5, k = 0", hint="use the compliance, or leave k = 0 out",
            )  # fmt: skip
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
                "a half-space has no finite mean displacement", where="HalfSpace", found="k = 0",
                hint="leave k = 0 out, or use a Layer, whose base stands still",
            )  # fmt: skip
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
            "a height outside the layer", where="z", found=found, expected=f"0 (the base) to {h:g} m (the surface)",
            hint="heights are in metres above the bonded base",
        )  # fmt: skip
    return min(max(found, 0.0), h)
