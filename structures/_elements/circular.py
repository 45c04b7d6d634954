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
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof, direction_code, direction_label
from .._system import fields
from .._system.damping import Damping, settled
from .._system.fields import Line, Span, field_of_kind, gauss, shape
from .._system.loads import Load, upright
from .._system.sensors import fixed_quantity
from .._system.structure import Structure
from ..errors import InputError, integer, one_of, pair, positive, real, shown
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


CENTRE = 1e-9  # of an element length: the limit at the centre is taken here


@dataclass(frozen=True, eq=False)
class CircularField:
    """What lies between the rings of a circular plate.

    Parameters
    ----------
    line : Line
        The division of the radius, from the inner edge (or the centre) to the rim.
    harmonics : int
        Highest circumferential order.
    centre : (x0, y0)
        Centre of the plate (m).
    outer : float
        Half the thickness (m).
    """

    line: Line
    harmonics: int
    centre: tuple[float, float]
    outer: float

    @property
    def full(self) -> bool:
        """Whether the plate has a centre."""
        return self.line.origin == 0.0

    @property
    def families(self) -> int:
        """Number of harmonics, cosines and sines apart."""
        return 2 * self.harmonics + 1

    @cached_property
    def _orders(self) -> NDArray[np.intp]:
        """Circumferential order of every family."""
        return (np.arange(self.families) + 1) // 2

    @cached_property
    def kept(self) -> NDArray[np.intp]:
        """Positions, family by family, of the unknowns that are DOFs: all but those that the centre cannot have."""
        keep = np.ones((self.families, self.line.size), bool)
        if self.full:
            keep[0, 1] = False
            keep[1:3, 0] = False
            keep[3:, :2] = False
        return np.flatnonzero(keep)

    def _polar(self, at: ArrayLike) -> tuple[float, float]:
        x, y = fields.point(at, ("x", "y"))
        dx, dy = x - self.centre[0], y - self.centre[1]
        r = math.hypot(dx, dy)
        # a point on a ring is rounded in x and y, more than the line forgives of r
        slack = 1e-12 * self.line.h + 4 * np.finfo(float).eps * (abs(x) + abs(y))
        ring = float(self.line.nodes[self._ring(r)])
        return ring if abs(r - ring) <= slack else r, math.atan2(dy, dx)

    def _angular(self, theta: float, order: int = 0) -> Array:
        """1, cos theta, sin theta, ... or their derivative of `order` 0, 1, 2; (families,)."""
        n = self._orders[1::2]
        turn = n * theta + order * np.pi / 2  # every derivative turns by a quarter
        out = np.zeros(self.families)
        out[0] = order == 0
        out[1::2], out[2::2] = n**order * np.cos(turn), n**order * np.sin(turn)
        return out

    def _row(self, radial: Array, angular: Array) -> Array:
        """Row of all DOFs from a row along the radius, the same for all harmonics, and the factors of these."""
        return np.outer(angular, radial).ravel()[self.kept]

    def _gradient(self, r: float, theta: float, c: float, s: float) -> Array:
        """Row of the slope along (c, s); r = 0 is a limit that all directions share."""
        r = max(r, CENTRE * self.line.h) if self.full else r
        along, across = c * math.cos(theta) + s * math.sin(theta), s * math.cos(theta) - c * math.sin(theta)
        return along * self._row(self.line.row(r, 1), self._angular(theta)) + across / r * self._row(
            self.line.row(r), self._angular(theta, 1)
        )

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the deflection (Z) or a rotation (RX = w_y, RY = -w_x) at (x, y)."""
        r, theta = self._polar(at)
        if axis not in (3, 4, 5):
            _refuse("a plate moves along Z and turns about X and Y", direction_label(axis), "+Z, +RX or +RY")
        if axis == 3:
            return self._row(self.line.row(r), self._angular(theta))
        return self._gradient(r, theta, 0.0, 1.0) if axis == 4 else self._gradient(r, theta, -1.0, 0.0)

    def strain(self, at: ArrayLike, fibre: Any, angle: float, length: float | None) -> Array:
        """Row of the strain -z w_ss along s at `angle` from X, at z = `fibre`; or its mean over a gauge of `length`."""
        fields.within(fibre, self.outer)
        if length is not None:
            c, s = math.cos(angle), math.sin(angle)
            # the gradient is continuous: the mean of w_ss is the difference of w_s at the ends
            x, y = fields.point(at, ("x", "y"))
            ends = [self._polar((x + k * c * length / 2, y + k * s * length / 2)) for k in (1, -1)]
            rows = [self._gradient(r, theta, c, s) for r, theta in ends]
            return np.asarray(-fibre * (rows[0] - rows[1]) / length)
        r, theta = self._polar(at)
        if self.full and r < CENTRE * self.line.h:
            # of all harmonics only r^2 and r^2 cos 2 theta curve at the centre
            order = self._orders
            bend = np.where(order == 0, 1.0, np.where(order == 2, self._angular(angle), 0.0))
            return np.asarray(-fibre * self._row(self.line.row(0.0, 2), bend))
        c, s = math.cos(angle - theta), math.sin(angle - theta)
        w, slope = self.line.row(r), self.line.row(r, 1)
        none, once, twice = (self._angular(theta, order) for order in range(3))
        radial = self._row(self.line.row(r, 2), none)
        hoop = self._row(slope / r, none) + self._row(w / r**2, twice)
        twist = self._row(slope / r - w / r**2, once)
        return np.asarray(-fibre * (c * c * radial + s * s * hoop + 2 * c * s * twist))

    # -- regions --------------------------------------------------------------------------------------------------
    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses: a rectangle does not fit a round plate."""
        _refuse(
            "a circular plate takes pressure on rings and sectors", "a rectangle", "circular.Pressure(radius=, angle=)"
        )

    def pressure(self, radius: Span, angle: Span) -> Array:
        """Row of the integral of w over the sector between two radii and two angles, partial elements included."""
        a, b = self.line.station(radius[0]), self.line.station(radius[1])
        radial, (points, weights) = np.zeros(self.line.size), gauss(3)  # r times a cubic
        for cell in range(int(a), min(math.ceil(b), self.line.elements)):
            lo, hi = max(a - cell, 0.0), min(b - cell, 1.0)
            for xi, weight in zip(lo + (hi - lo) * points, weights, strict=True):
                r = self.line.origin + (cell + xi) * self.line.h
                part = weight * (hi - lo) * self.line.h * r
                radial[2 * cell : 2 * cell + 4] += part * shape(float(xi), self.line.h)
        # the integral of cos n theta is 2 / n sin(n width / 2) cos(n middle): it does not cancel on a thin sector
        width, middle = angle[1] - angle[0], (angle[0] + angle[1]) / 2
        factor = width * np.sinc(self._orders * width / (2 * np.pi))
        return self._row(radial, factor * self._angular(middle))

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node: where its harmonic is largest."""
        x, y = (float(v) for v in self.places(np.array([node]))[0])
        return (x, x), (y, y)

    def places(self, nodes: NDArray[np.intp]) -> Array:
        """Coordinates of nodes: on their ring, where their harmonic is largest, (nodes, 2)."""
        family, ring = np.divmod(nodes, self.line.elements + 1)
        order = (family + 1) // 2
        theta = np.where((family % 2 == 0) & (family > 0), np.pi / 2 / np.maximum(order, 1), 0.0)
        r = self.line.nodes[ring]
        return np.asarray(self.centre) + np.column_stack([r * np.cos(theta), r * np.sin(theta)])

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the rings of elements that a rectangle ((x0, x1), (y0, y1)) shares."""
        spans = [(lo - o, hi - o) for (lo, hi), o in zip(region, self.centre, strict=True)]
        inner = math.hypot(*(max(lo, -hi, 0.0) for lo, hi in spans))
        outer = math.hypot(*(max(-lo, hi) for lo, hi in spans))
        first, last = self.line.origin, self.line.origin + self.line.length
        slack = 1e-9 * self.line.h  # rounding of a place on a ring
        r = [min(max(v, first), last) for v in (inner, outer)]
        rings = [float(self.line.nodes[self._ring(v)]) for v in r]
        cells = self.line.cells(*(k if abs(v - k) < slack else v for v, k in zip(r, rings, strict=True)))
        unknowns = np.arange(2 * cells.start, 2 * cells.stop + 2)
        return np.flatnonzero(np.isin(self.kept % self.line.size, unknowns))

    def _ring(self, r: float) -> int:
        """Nearest ring."""
        return min(max(round((r - self.line.origin) / self.line.h), 0), self.line.elements)

    def inside(self, at: ArrayLike) -> bool:
        """Whether (x, y) lies on the plate."""
        return self.line.inside(self._polar(at)[0])

    def rigid(self) -> dict[str, Array]:
        """Translation and two rotations about the centre."""
        rows = self.line.elements + 1
        flat, far = np.tile([1.0, 0.0], rows), 2 * (self.line.origin + self.line.length)
        tilt = np.column_stack([self.line.nodes / far, np.full(rows, 1 / far)]).ravel()
        unit = np.eye(3, self.families)
        return {
            "translation Z": self._row(flat, unit[0]),
            "rotation RX": self._row(tilt, unit[2]),
            "rotation RY": self._row(-tilt, unit[1]),
        }


def _refuse(what: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where="sensor or load on a circular plate",
        found=found,
        expected=expected,
        hint="the plate lies in X-Y; places are (x, y) in m",
    )
