"""Tests of a material as they are recorded: force against motion, with the sizes that turn them into a modulus."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from structures.errors import InputError, positive, reals

from .._arrays import Array
from .._closed.contact import WIDEST, flat_stiffness, sphere_law, sphere_limit
from .._closed.layer import Layer

DEEPEST = 5.5  # depth times radius of a sphere over thickness squared: contact of some 3.5 thicknesses
FEWEST = 5  # points of a curve: modulus, offset, curvature, and something left to see the noise


@dataclass(frozen=True, eq=False)
class Tensile:
    """Tensile test at one speed.

    Parameters
    ----------
    elongation, force : array (n,)
        Elongation of the gauge length (m) and force (N), positive in tension.
    length, area : float
        Gauge length (m) and cross-section (m^2) at rest.
    speed : float
        Of the elongation (m/s).
    contraction : array (n,), optional
        Shortening of the width (m), positive in tension: gives Poisson's ratio.
    width : float, optional
        Width at rest (m), with `contraction`.
    name : str

    Raises
    ------
    InputError
        Arrays that do not fit, fewer than five points, NaN, sizes that are not positive.
    """

    elongation: Any
    force: Any
    length: float
    area: float
    speed: float
    contraction: Any = None
    width: float | None = None
    name: str = ""

    def __post_init__(self) -> None:
        _settle(self, ("elongation", "force"), ("length", "area", "speed"))
        if (self.contraction is None) != (self.width is None):
            raise InputError(
                "lateral strain needs contraction and width", where=f"Tensile {self.name}", found="one of them",
                expected="both, or none", hint="width= is the width at rest, in m",
            )  # fmt: skip
        if self.contraction is not None:
            _settle(self, ("elongation", "contraction"), ("width",))

    @property
    def motion(self) -> Array:
        """Abscissa of the curve (m)."""
        return np.asarray(self.elongation)

    @property
    def rate(self) -> float:
        """Strain rate (1/s)."""
        return self.speed / self.length

    @property
    def strain(self) -> float:
        """Largest strain of the test."""
        return float(np.ptp(self.elongation)) / self.length

    def shape(self, motion: Array, nu: float | None) -> Array:
        """Force over modulus (m^2) at elongations (m)."""
        return self.area / self.length * motion


@dataclass(frozen=True, eq=False)
class Indentation:
    """Indentation of a bonded layer at one speed.

    Parameters
    ----------
    depth, force : array (n,)
        Depth (m) and force (N), positive when pressed. Where the depth is zero does not matter: the contact point is
        fitted.
    radius : float
        Of the sphere, or of the flat-ended cylinder (m).
    thickness : float
        Of the layer (m).
    speed : float
        Of the indenter (m/s).
    indenter : {"sphere", "flat"}
    name : str

    Raises
    ------
    InputError
        Arrays that do not fit, fewer than five points, NaN, sizes that are not positive, another indenter.
    """

    depth: Any
    force: Any
    radius: float
    thickness: float
    speed: float
    indenter: str = "sphere"
    name: str = ""

    def __post_init__(self) -> None:
        _settle(self, ("depth", "force"), ("radius", "thickness", "speed"))
        if self.indenter not in ("sphere", "flat"):
            raise InputError("unknown indenter", where=f"Indentation {self.name}", found=repr(self.indenter),
                             expected='"sphere" or "flat"', hint="a flat-ended cylinder is flat")  # fmt: skip
        flat = self.indenter == "flat"
        reach = self.radius / self.thickness if flat else np.ptp(self.depth) * self.radius / self.thickness**2
        if reach > (WIDEST if flat else DEEPEST):
            raise InputError(
                "contact too wide for this layer", where=f"Indentation {self.name}".strip(),
                found=f"{'radius over thickness' if flat else 'depth times radius over thickness squared'} {reach:.3g}",
                expected=f"at most {WIDEST if flat else DEEPEST:g}", hint="depth, radius and thickness in m",
            )  # fmt: skip

    @property
    def motion(self) -> Array:
        """Abscissa of the curve (m)."""
        return np.asarray(self.depth)

    @property
    def rate(self) -> float:
        """Speed over thickness (1/s)."""
        return self.speed / self.thickness

    @property
    def strain(self) -> float:
        """Depth over thickness: an order of magnitude of the strain."""
        return float(np.ptp(self.depth)) / self.thickness

    def shape(self, motion: Array, nu: float | None) -> Array:
        """Force over modulus (m^2) at depths (m) below the contact point."""
        assert nu is not None
        if self.indenter == "flat":
            return flat_stiffness(Layer(h=self.thickness, E=1.0, nu=nu), self.radius) * motion
        x = motion * self.radius / self.thickness**2  # a search may look deeper than the record: not beyond the law
        return sphere_law(nu)(np.minimum(x, sphere_limit(nu))) * self.thickness**3 / self.radius


Curve = Tensile | Indentation


def _settle(curve: Any, arrays: tuple[str, str], sizes: tuple[str, ...]) -> None:
    """Arrays copied and checked, sizes to floats."""
    where = f"{type(curve).__name__} {curve.name}".strip()
    for name in sizes:
        object.__setattr__(curve, name, positive(name, getattr(curve, name), where=where))
    found = [reals(getattr(curve, name), where=f"{where}, {name}") for name in arrays]
    x, y = found
    if x.ndim != 1 or x.shape != y.shape or len(x) < FEWEST or not (np.isfinite(x).all() and np.isfinite(y).all()):
        raise InputError(
            "no curve", where=where, found=f"{arrays[0]} {x.shape}, {arrays[1]} {y.shape}",
            expected=f"two finite arrays of the same length, at least {FEWEST} points", hint="cut off what is missing",
        )  # fmt: skip
    if np.ptp(x) == 0:
        raise InputError(f"{arrays[0]} does not move", where=where, found=f"{x[0]:.4g} at every point",
                         expected="a loading curve", hint="pass motion first, then force")  # fmt: skip
    for name, array in zip(arrays, found, strict=True):
        array.setflags(write=False)
        object.__setattr__(curve, name, array)
