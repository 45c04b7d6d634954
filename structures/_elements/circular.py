"""Thin circular and annular plates: radial Hermite elements for every circumferential harmonic.

The deflection is w(r, theta) = sum of f(r) times 1, cos theta, sin theta, cos 2 theta, sin 2 theta, ... Harmonics do
not couple in a round plate: its matrices are one band per harmonic. Each f has the unknowns f and f' at the rings.

Node k (elements + 1) + i is ring i (from the inside) of harmonic k: 0 is the axisymmetric one, 2 n - 1 is cos n theta,
2 n is sin n theta. Its ``+Z`` is the amplitude f (m), its ``-RY`` the slope f' towards the rim; the coordinates are
where this harmonic is largest, and a force at such a DOF is the generalised force on the amplitude. Places on the plate
are ``at=(x, y)``. What a plate cannot do at its centre is left out of the table: f' of the axisymmetric harmonic, f of
the first, and both of all others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Dof, direction_code, direction_label
from .._system.damping import Damping, settled
from .._system.fields import Line, Span, field_of_kind, gauss, shape
from .._system.loads import Load, upright
from .._system.sensors import fixed_quantity
from .._system.structure import Structure
from ..errors import InputError, integer, one_of, pair, positive, real, shown
from .circularfield import CircularField
from .members import Material, a_material, thin

__all__ = ["EDGES", "CircularField", "Pressure", "plate"]

EDGES = ("clamped", "supported", "free")
Z, SLOPE = 3, -5
HARMONICS = 200
RINGS = 5000
POINTS = 400  # Gauss points per element, at most
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Pressure(Load):
    """Uniform pressure (Pa) on a circular plate: on all of it, a disc, a ring or a sector of one.

    Parameters
    ----------
    radius : (r0, r1), optional
        From which radius to which (m, from the centre); the whole plate where not given.
    angle : (a0, a1), optional
        From which angle to which (rad, from X towards Y); all round where not given.
    direction : {"+Z", "-Z"}
        Sense of a positive pressure.
    label : str, optional
        The region where not given.

    Attributes
    ----------
    measure : float or None
        Area (m^2) where the radii are given: pressure times area is the resultant. `area` knows that of any plate.

    Raises
    ------
    InputError
        If a region is empty or more than a full turn; in `shape`, if it leaves the plate or the structure is none.
    """

    _: KW_ONLY
    radius: Span | None = None
    angle: Span | None = None
    direction: str = "+Z"
    label: str = ""
    quantity: str = "pressure"
    unit: str = "Pa"

    def __post_init__(self) -> None:
        fixed_quantity(self, "pressure")
        for name, turn in (("radius", math.inf), ("angle", 2 * math.pi * (1 + 1e-12))):
            given = getattr(self, name)
            if given is not None:
                a, b = pair(name, given, where="Pressure")
                if not 0 < b - a <= turn or (name == "radius" and a < 0):
                    raise InputError(
                        f"no span of the {name}",
                        where=f"Pressure, {name}",
                        found=shown(given),
                        expected="(start, stop), start < stop" + (", at most a full turn" if name == "angle" else ""),
                        hint="radius=(0, 0.1) in m, angle=(0, 3.14) in rad",
                    )
                object.__setattr__(self, name, (a, b))
        code = upright("a pressure", "Pressure", self.direction)
        object.__setattr__(self, "direction", direction_label(code))
        spans = [f"{k}={v[0]:.9g}..{v[1]:.9g}" for k, v in (("r", self.radius), ("angle", self.angle)) if v]
        object.__setattr__(self, "label", self.label or " ".join(["pressure", *spans]))
        if self.radius is not None:
            start, stop = self.angle or (0.0, 2 * math.pi)
            (a, b) = self.radius
            object.__setattr__(self, "measure", (stop - start) / 2 * (b - a) * (b + a))
        super().__post_init__()

    def _spans(self, structure: Structure) -> tuple[CircularField, Span, Span]:
        field = field_of_kind(
            structure,
            CircularField,
            self.label,
            what="a circular.Pressure acts on a circular plate",
            expected="a structure of circular.plate",
            hint="loads.Patch(x=, y=) on a rectangular plate",
        )
        rim = (field.line.origin, field.line.origin + field.line.length)
        return field, self.radius or rim, self.angle or (0.0, 2 * math.pi)

    def area(self, structure: Structure) -> float:
        """Area (m^2): pressure times area is the resultant."""
        _, (a, b), (start, stop) = self._spans(structure)
        return (stop - start) / 2 * (b - a) * (b + a)

    def region(self, structure: Structure) -> tuple[Span, ...]:
        """The radii that it covers, along X from the centre."""
        field, (a, b), _ = self._spans(structure)
        x, y = field.centre
        return (x + a, x + b), (y, y)

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        field, radius, angle = self._spans(structure)
        return math.copysign(1, direction_code(self.direction)) * field.pressure(radius, angle)


def plate(
    *,
    radius: float,
    thickness: float,
    material: Material,
    edge: str = "clamped",
    inner: tuple[float, str] | None = None,
    elements: int = 20,
    harmonics: int = 8,
    damping: Damping | float | None = None,
    centre: tuple[float, float] = (0.0, 0.0),
) -> Structure:
    """Thin (Kirchhoff) circular plate, or an annular one.

    Parameters
    ----------
    radius : float
        Of the rim (m).
    thickness : float
        m.
    material : Material
        E, rho, nu.
    edge : {"clamped", "supported", "free"}
        The rim; supported holds the deflection and lets the slope go.
    inner : (radius, edge), optional
        A hole: its radius (m) and how its edge is held.
    elements : int
        Equal elements along the radius; the frequency error falls with the fourth power of their length.
    harmonics : int
        Highest order n of cos n theta and sin n theta. A force off the centre needs several: what they leave out of
        the deflection under it falls with 1 / n^2.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.
    centre : (x0, y0)
        Coordinates of the centre (m). Places are given in the same coordinates; matrices do not depend on it.

    Returns
    -------
    Structure
        DOFs ``n+Z, n-RY``: amplitude and slope of the harmonics at the rings, numbered as this module's head says.

    Raises
    ------
    InputError
        If a value is not possible, an edge is unknown, or the plate is too thick.

    Notes
    -----
    Bending energy in polar coordinates: S. P. Timoshenko, S. Woinowsky-Krieger, *Theory of Plates and Shells*, 2nd ed.
    (1959), article 62. Gauss points are as many as integrate the 1 / r^3 of the energy to rounding: around the centre
    the integrands are polynomials, further out their pole lies off the element.
    """
    a = positive("radius", radius, where="circular plate", unit="m")
    b, hole = _inner(inner, a)
    held = [(0, _edge("inner edge", hole))] if inner is not None else []
    count = integer("elements", elements, where="circular plate", limit=RINGS)
    held.append((count, _edge("edge", edge)))
    thin(thickness, (a - b) / 3, "circular plate", f"radius {a:g} m, hole {b:g} m", "width")
    a_material(material, "circular plate")
    line = Line(a - b, count, b, "r")
    top = integer("harmonics", harmonics, where="circular plate", limit=HARMONICS)
    field = CircularField(line, top, pair("centre", centre, where="circular plate", unit="m"), thickness / 2)
    D, mass = material.E * thickness**3 / 12 / (1 - material.nu**2), material.rho * thickness
    family, place = np.divmod(field.kept, line.size)
    nodes = family * (count + 1) + place // 2
    table = tuple(Dof(int(n), SLOPE if k % 2 else Z) for n, k in zip(nodes, place, strict=True))
    axes = {"clamped": (Z, SLOPE), "supported": (Z,), "free": ()}
    supports = [
        Dof(k * (count + 1) + ring, axis) for k in range(field.families) for ring, kind in held for axis in axes[kind]
    ]
    return Structure(
        K=D * _over_harmonics(field, [bending(line, n, material.nu) for n in range(top + 1)]),
        M=mass * _over_harmonics(field, [inertia(line)] * (top + 1)),
        dofs=table,
        coordinates=field.places(np.unique(nodes)),
        supports=tuple(supports),
        damping=settled(damping),
        field=field,
    )


def _edge(name: str, edge: Any) -> str:
    return one_of(f"unknown {name}", edge, EDGES, where="circular plate", hint='edge="clamped"')


def _inner(inner: Any, radius: float) -> tuple[float, Any]:
    """Radius of the hole and its edge; 0 for a full plate."""
    if inner is None:
        return 0.0, None
    items = list(inner) if isinstance(inner, Sequence) and not isinstance(inner, str) else []
    hole = real(items[0]) if len(items) == 2 else None
    if hole is None or not 0 < hole < radius:
        raise InputError(
            "no hole",
            where="circular plate, inner",
            found=shown(inner),
            expected=f"(radius, edge) with a radius between 0 and {radius:g} m",
            hint='inner=(0.05, "free"); leave it out for a full plate',
        )
    return hole, items[1]


def _points(line: Line) -> int:
    """Gauss points that integrate 1 / r^3 over the element next to the inside to rounding.

    The error falls as rho^(-2 points), rho the ellipse through the pole r = 0 (in a full plate, of the second element).
    """
    z = 3.0 if line.origin == 0 else 1 + 2 * line.origin / line.h
    return min(max(math.ceil(18 * math.log(10) / math.log(z + math.sqrt(z * z - 1)) / 2), 6) + 3, POINTS)


def _stations(line: Line) -> tuple[Array, Array, list[Array]]:
    """Radii (elements, points), their weights r dr, and shapes with two derivatives at xi, (points, 4) each."""
    xi, weights = gauss(_points(line))
    r = line.origin + line.h * (np.arange(line.elements)[:, None] + xi)
    rows = [np.array([shape(float(x), line.h, order) for x in xi]) for order in range(3)]
    return r, weights * line.h * r, rows


def bending(line: Line, n: int, nu: float) -> sparse.csr_array:
    """Bending stiffness along the radius of the harmonic n for unit rigidity, before the integral round the plate.

    Curvatures of f cos n theta: f'', f' / r - n^2 f / r^2, and the twist n (f' / r - f / r^2).
    """
    r, weights, (f, slope, radial) = _stations(line)
    r = r[:, :, None]
    hoop, twist = slope / r - n * n * f / r**2, n * (slope / r - f / r**2)
    if line.origin == 0:  # shapes that the centre cannot have are no DOFs; their energy is infinite
        gone = [1] if n == 0 else [0] if n == 1 else [0, 1]
        hoop[0][:, gone] = twist[0][:, gone] = 0.0
    radial = np.broadcast_to(radial, hoop.shape)
    total = radial + hoop
    sums = ((1.0, total, total), (-(1 - nu), radial, hoop), (-(1 - nu), hoop, radial), (2 * (1 - nu), twist, twist))
    return line.assemble(sum(c * np.einsum("ep,epi,epj->eij", weights, A, B, optimize=True) for c, A, B in sums))


def inertia(line: Line) -> sparse.csr_array:
    """Integral of f^2 r dr along the radius."""
    _, weights, (f, _, _) = _stations(line)
    return line.assemble(np.einsum("ep,pi,pj->eij", weights, f, f, optimize=True))


def _over_harmonics(field: CircularField, radial: list[sparse.csr_array]) -> sparse.csr_array:
    """Matrix of all DOFs from one per order: the integral round the plate is 2 pi for n = 0, else pi."""
    blocks = [2 * np.pi * radial[0]] + [np.pi * radial[n] for n in range(1, field.harmonics + 1) for _ in "cs"]
    whole = sparse.csr_array(sparse.block_diag(blocks, format="csr"))
    return whole[field.kept][:, field.kept].tocsr()
