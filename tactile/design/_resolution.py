"""What a bonded layer lets through and how it strains under a press; by how much plain bricks are too stiff.

Wave numbers k are in rad/m, wavelengths 2 pi / k in m. Everything scales with the thickness; E is a pure gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from structures._elements import solids
from structures._elements.hexfield import HexField
from structures._elements.members import Material
from structures._system.factor import Factor
from structures.errors import InputError, integer, number, positive, reals, shown

from .._arrays import Array
from .._closed.layer import Components, HalfSpace, Layer, turned

NAMES = {"zz": "pressure", "kk": "shear along the wave", "tt": "shear across the wave"}


@dataclass(frozen=True)
class CompliancePeak:
    """The wave that moves the surface most: its compliance (m/Pa) and wavelength (m), infinite for uniform traction.

    `uniform` is the compliance under uniform traction over that of the peak: 0 means that the layer does not see it.
    """

    compliance: float
    wavelength: float
    uniform: float


def peak(layer: Layer, component: str = "zz") -> CompliancePeak:
    """The strongest wave of a layer under pressure (zz), shear along the wave (kk), or shear across it (tt)."""
    from scipy.optimize import minimize_scalar

    h = layer.h
    x = np.geomspace(1e-3, 100, 400)
    values = _one(layer, component, x / h)
    still = float(_one(layer, component, np.zeros(1))[0])
    i = int(values.argmax())
    if i == 0 or values[i] <= still * (1 + 1e-12):
        return CompliancePeak(still, np.inf, 1.0)
    best = minimize_scalar(
        lambda s: -_one(layer, component, np.array([s / h]))[0] / values[i],
        bounds=(x[i - 1], x[i + 1]),
        method="bounded",
        options={"xatol": 1e-10},
    ).x
    top = float(_one(layer, component, np.array([best / h]))[0])
    return CompliancePeak(top, float(2 * np.pi * h / best), still / top)


def cutoff(layer: Layer, component: str = "zz", share: float = 0.1) -> float:
    """The wavelength (m) below which a component moves the surface less than `share` of its strongest wave."""
    from scipy.optimize import brentq

    share = positive("share", share, where="cutoff")
    if share >= 1:
        raise InputError("share must be below 1", where="cutoff", found=share, expected="0 < share < 1")
    top = peak(layer, component)
    least = share * top.compliance
    low = np.log(1e-6) if np.isinf(top.wavelength) else np.log(2 * np.pi * layer.h / top.wavelength)
    # beyond its peak a component falls at least as 1/k of the half-space, from at most 4 times its value
    high = np.log(8 / share) + max(low, 0.0)
    found = brentq(lambda s: _one(layer, component, np.exp([s]) / layer.h)[0] / least - 1, low, high, xtol=1e-12)
    return float(2 * np.pi * layer.h * np.exp(-found))


def sign_change(layer: Layer) -> float | None:
    """The wave number k (rad/m) at which pressure changes the way it drags the surface sideways; None: nowhere.

    Longer waves push the surface out from under the pressure, shorter ones draw it in as on a half-space. Below
    nu = 0.25 all waves draw in, at nu = 0.5 all push out.
    """
    from scipy.optimize import brentq

    gain = layer.kappa * (1 - 2 * layer.nu)
    if gain <= 0 or gain >= 1:
        return None
    # sinh(x) / x = gain^(-1/2)
    target = gain**-0.5
    end = 2.0
    while np.sinh(end) / end < target:
        end *= 2
    return float(brentq(lambda x: np.sinh(x) / x - target, 1e-9, end, xtol=1e-12) / layer.h)


def sideways(layer: Layer | HalfSpace, k: ArrayLike) -> Array:
    """|C| / G_zz at wave numbers k > 0: sideways motion caused by a wave of pressure over its normal motion."""
    f = layer.components(k)
    return np.abs(f.kz) / f.zz


def mistaken_shear(layer: Layer | HalfSpace, k: ArrayLike) -> Array:
    """|C| / G_kk at wave numbers k > 0: shear read per pressure when the in-plane motion is inverted with t_z = 0."""
    f = layer.components(k)
    return np.abs(f.kz) / f.kk


def noise_std(
    layer: Layer, pitch: float, sigma_u: float, sigma_z: float, *, coupled: bool = True, nodes: int = 64
) -> tuple[float, float]:
    """Noise of an unregularised traction map on a square grid: std of one shear component and of the pressure (Pa).

    From stds `sigma_u`, `sigma_z` of the motion of a node in the plane and along the normal (m); `coupled` inverts
    shear and pressure together, else each by its own compliance, as if the other were absent. Noise goes as 1/pitch:
    each wave costs its stiffness, which grows with k. For pitches well below h and uncoupled it is mu k_rms times
    sigma_u (1/2 + 1/2 (1 - nu)^-2)^(1/2), and sigma_z / (1 - nu), k_rms = (2/3)^(1/2) pi / pitch.
    """
    pitch = positive("pitch", pitch, where="noise_std", unit="m")
    spread = [number(name, s, where="noise_std", unit="m") for name, s in (("sigma_u", sigma_u), ("sigma_z", sigma_z))]
    if min(spread) < 0:
        raise InputError("a std must not be negative", where="noise_std", found=min(spread), expected="metres")
    n = integer("nodes", nodes, where="noise_std", limit=4096)
    k = 2 * np.pi * np.fft.fftfreq(n, pitch)
    kx, ky = (c.ravel()[1:] for c in np.meshgrid(k, k))  # uniform motion costs nothing, or has no bound at nu = 0.5
    if coupled:
        K = layer.stiffness(kx, ky)
    else:
        f = layer.components(np.hypot(kx, ky))
        none = np.zeros_like(f.kk)
        K = turned(kx, ky, Components(kk=1 / f.kk, zz=1 / f.zz, kz=none, zk=none, tt=1 / f.tt))
    variance = (np.abs(K) ** 2).sum(axis=0) / n**2 @ np.array([spread[0], spread[0], spread[1]]) ** 2
    return float(np.sqrt(variance[0])), float(np.sqrt(variance[2]))


def _one(layer: Layer, component: str, k: Array) -> Array:
    if component not in NAMES:
        raise InputError(
            "no component of the compliance", where="component", found=shown(component),
            expected=", ".join(f"{name} ({what})" for name, what in NAMES.items()),
        )  # fmt: skip
    return np.asarray(getattr(layer.components(k), component))


LEVELS, RADII = 20, 24
SHALLOWEST = 0.03  # of the thickness: above it the integrals need ever shorter waves
STEP = 1e-5  # of the thickness, for derivatives along the height


def strains(layer: Layer, radius: float, r: ArrayLike, z: float) -> Array:
    """Strain under a Hertz press of 1 N, (points, 4): radial, hoop, normal, and shear e_rz.

    Parameters
    ----------
    layer : Layer
    radius : float
        Radius of the contact (m).
    r : array (points,)
        Distances from its axis (m).
    z : float
        Height above the base (m), at most 0.97 h.

    Raises
    ------
    InputError
        A height too near to the surface or below the base.
    """
    a = positive("radius", radius, where="design.strains", unit="m")
    if not 0 <= z <= (1 - SHALLOWEST) * layer.h * (1 + 1e-12):
        raise InputError(
            "no height inside the layer", where="design.strains, z", found=z,
            expected=f"0 to {(1 - SHALLOWEST) * layer.h:g} m", hint="height above the base, in m",
        )  # fmt: skip
    at = np.atleast_1d(reals(r, where="design.strains"))
    return _Axis.of(layer, a, at).at(z)


def largest_strain(layer: Layer, radius: float) -> float:
    """Largest principal strain, by size, per N of a Hertz press (1/N), between the base and 0.97 of the thickness."""
    return _largest_strain(layer, positive("radius", radius, where="design.largest_strain", unit="m"))


@lru_cache(maxsize=64)
def _largest_strain(layer: Layer, a: float) -> float:
    r = np.concatenate([np.linspace(0, 1.5 * a, RADII), np.linspace(1.6 * a, 1.6 * a + layer.h, RADII // 3)])
    near = 1 - np.geomspace(SHALLOWEST, 1.0, LEVELS)
    heights = np.unique(np.concatenate([near, np.linspace(0, 0.2, LEVELS // 4)])) * layer.h
    axis = _Axis.of(layer, a, r)
    return max(float(np.max(np.abs(_principal(axis.at(float(z)))))) for z in heights)


@dataclass(frozen=True, eq=False)
class _Axis:
    """Waves of one press and their Bessel functions at some distances from its axis."""

    layer: Layer
    k: Array
    weight: Array  # k dk / 2 pi times the transform of a Hertz pressure of 1 N
    J0: Array
    J1: Array
    ratio: Array  # J1(x)/x

    @classmethod
    def of(cls, layer: Layer, a: float, r: Array) -> _Axis:
        """Gauss points so close that no wave turns by more than 4 rad between two pieces."""
        from scipy.special import j0, j1

        end = 40 / (SHALLOWEST * layer.h)  # e^{-k depth} there: nothing is left
        pieces = int(np.ceil(end * (a + float(r.max()) + layer.h) / 4))
        x, v = np.polynomial.legendre.leggauss(6)
        edges = np.linspace(0, end, pieces + 1)
        half = np.diff(edges)[:, None] / 2
        k = (edges[:-1, None] + half * (x + 1)).ravel()
        s = k * a
        safe = np.where(s < 1e-2, 1.0, s)
        p = np.where(s < 1e-2, 1 - s**2 / 10, 3 * (np.sin(safe) - safe * np.cos(safe)) / safe**3)
        kr = np.outer(r, k)
        J1 = j1(kr)
        ratio = np.where(kr > 1e-8, J1 / np.where(kr > 1e-8, kr, 1.0), 0.5)
        return cls(layer, k, (half * v).ravel() * k / (2 * np.pi) * p, j0(kr), J1, ratio)

    def at(self, z: float) -> Array:
        """The four strains at one height; a pressure is a traction -p."""
        e = STEP * self.layer.h
        low, high = max(z - e, 0.0), z + e
        here, below, above = (self.layer.components(self.k, v) for v in (z, low, high))
        zz_z, kz_z = (above.zz - below.zz) / (high - low), (above.kz - below.kz) / (high - low)
        sideways = self.weight * self.k * here.kz
        return np.stack(
            [
                -(self.J0 - self.ratio) @ sideways,
                -self.ratio @ sideways,
                -self.J0 @ (self.weight * zz_z),
                0.5 * self.J1 @ (self.weight * (self.k * here.zz - kz_z)),
            ],
            axis=1,
        )


def _principal(e: Array) -> Array:
    """Principal strains (points, 3)."""
    middle, half = (e[:, 0] + e[:, 2]) / 2, (e[:, 0] - e[:, 2]) / 2
    reach = np.hypot(half, e[:, 3])
    return np.stack([middle + reach, middle - reach, e[:, 1]], axis=1)


def locking(
    nu: float, *, size: float = 16e-3, thickness: float = 4e-3, elements: tuple[int, int, int] = (16, 16, 4),
    side: float = 6e-3,
) -> float:  # fmt: skip
    """Depth of a pressed patch of a bonded pad of plain Hex-8 bricks over that of B-bar bricks on the same mesh.

    Parameters
    ----------
    nu : float
        Poisson's ratio, below 0.5.
    size, thickness : float
        Of the square pad (m).
    elements : (nx, ny, nz)
        Bricks along X, Y, Z.
    side : float
        Of the pressed square in the middle (m).

    Returns
    -------
    float
        1 where plain bricks do as well; towards 0 as they lock. No modulus and no force enters.
    """
    a = positive("size", size, where="design.locking", unit="m")
    half = positive("side", side, where="design.locking", unit="m") / 2
    depths = []
    for element in ("standard", "bbar"):
        block = solids.block(
            lengths=(a, a, positive("thickness", thickness, where="design.locking", unit="m")), elements=elements,
            material=Material(E=1e5, rho=1e3, nu=nu), element=element, origin=(-a / 2, -a / 2, 0.0), allow=("E109",),
        )  # fmt: skip
        assert isinstance(block.field, HexField)
        f = block.field.traction("top", ((-half, half), (-half, half)), 3)[block.free]
        depths.append(float(f @ Factor(block.K_free, check=False).solve(f)))
    return depths[0] / depths[1]
