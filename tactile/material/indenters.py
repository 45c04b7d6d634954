"""Force and depth of rigid, frictionless indenters on a bonded elastic layer.

The pressure is written as p~(k) = int_0^a phi(t) cos(k t) dt. Abel's transform of w(r) = delta - r^2 / 2 R then leaves
a Fredholm equation of the second kind with a smooth kernel (Lebedev and Ufliand 1958), with c = 2 (1 - nu^2)/E and the
layer's G_zz = (1 - nu)/(mu k) (1 - Omega(k h)):

    c [phi(t) - (2/pi) int_0^a phi(s) int_0^inf Omega(k h) cos(k t) cos(k s) dk ds] = (2/pi) (delta - t^2 / R).

A sphere meets the layer where phi(a) = 0; the force is 2 pi int_0^a phi dt. Small strain; the sphere is a paraboloid.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals

from ..layer import Layer

Array = NDArray[np.float64]
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
        return np.where(x >= low[0], found, low[1] * (np.maximum(x, 0) / low[0]) ** 1.5)

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
    return np.cos(np.multiply.outer(np.array(alphas), np.outer(np.append(t, 1.0), x)))


@lru_cache(maxsize=64)
def _excess(nu: float) -> Array:
    """Omega: what the base takes from the compliance of a half-space, on the Gauss points of k h."""
    x, _ = _gauss(WAVES, END)
    unit = Layer(h=1.0, E=1.0, nu=nu)
    return 1 - unit.components(x).zz * unit.mu * x / (1 - nu)


@lru_cache(maxsize=8)
def _gauss(count: int, end: float) -> tuple[Any, Any]:
    x, w = np.polynomial.legendre.leggauss(count)
    return end / 2 * (x + 1), end / 2 * w
