"""Waves of traction on a bonded layer: five functions of the wave number, with decaying exponentials only.

Fields go as exp(i (kx x + ky y)); the traction acts on the body, z points out of it. In the frame (along k, normal) a
wave of traction moves the material by

    u_k = kk t_k - i kz t_z,    u_z = i zk t_k + zz t_z,    u_t = tt t_t,

five real functions of k and of the height (`Components`); on the loaded surface kz = zk. Those of the layer follow from
the four modes of elasticity, two of which meet u = 0 at the base. x stands for k h, y for k z.
"""

from __future__ import annotations

from math import factorial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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
