"""Strain in a bonded layer under a round press, by Hankel integrals of the interior kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals

from ..layer import Layer

Array = NDArray[np.float64]
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
    a = positive("radius", radius, where="design.largest_strain", unit="m")
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
