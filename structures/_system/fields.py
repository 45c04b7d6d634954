"""What lies between the nodes: rows of motion, strain or resultant anywhere, and cubic Hermite functions on a line."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NoReturn, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import InputError, integer, number, numbers, positive, real, shown

if TYPE_CHECKING:
    from .structure import Structure


Array = NDArray[np.float64]
F = TypeVar("F")
Span = tuple[float, float]
CARRIER = 1.25  # how far out a gauge on its glue and carrier may lie, over the outer fibre


class Field(Protocol):
    """The displacement field of a meshed structure; every row has one entry per DOF, supported ones included."""

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the motion along `axis` (direction code) at a point."""

    def strain(self, at: ArrayLike, fibre: Any, angle: float, length: float | None) -> Array:
        """Row of the strain of a fibre at the distance `fibre` from the neutral axis or mid-plane, along `angle`."""

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Row of the integral of the deflection over a region: the consistent load of one unit per length or area."""

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node, as a region without extent."""

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of all elements that the region shares."""

    def inside(self, at: ArrayLike) -> bool:
        """Whether a point lies on the structure."""

    def rigid(self) -> dict[str, Array]:
        """Rigid-body motions of the unsupported structure, by name; rotations have unit amplitude over the length."""


class Lumped:
    """The field of a lumped structure: nothing between its nodes, one rigid translation.

    Parameters
    ----------
    axis : str
        Direction of the motion.
    size : int
        Number of DOFs.
    """

    def __init__(self, axis: str, size: int) -> None:
        self.axis, self.size = axis, size

    def _refuse(self) -> NoReturn:
        raise InputError(
            "lumped masses have nothing between them",
            where="sensor or load",
            found="a place or region",
            expected="a DOF, such as 1+" + self.axis,
            hint="name the mass instead of a place",
        )

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Refuses."""
        self._refuse()

    def strain(self, at: ArrayLike, fibre: float, angle: float, length: float | None) -> Array:
        """Refuses."""
        self._refuse()

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses."""
        self._refuse()

    def box(self, node: int) -> tuple[Span, ...]:
        """No place: a lumped load acts on its mass alone."""
        return ()

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """No DOF: no shape function spreads a lumped load onto a support."""
        return np.empty(0, np.intp)

    def inside(self, at: ArrayLike) -> bool:
        """Never."""
        return False

    def rigid(self) -> dict[str, Array]:
        """One translation."""
        return {f"translation {self.axis}": np.ones(self.size)}


def field_of(structure: Structure, where: str) -> Field:
    """Field of a structure, or a refusal that says to name a DOF."""
    if structure.field is None:
        raise InputError(
            "this structure has no mesh that says what lies between its nodes",
            where=where,
            found="a structure built from matrices",
            expected="a DOF, such as " + str(structure.dofs[0]),
            hint="name the DOF instead of at=, x= or y=",
        )
    return structure.field


def field_of_kind(structure: Structure, kind: type[F], load: str, *, what: str, expected: str, hint: str) -> F:
    """Field of a structure, or a refusal where it is of another kind.

    Raises
    ------
    InputError
        If it is none of the `kind`.
    """
    field = field_of(structure, f"load {load}")
    if not isinstance(field, kind):
        raise InputError(what, where=f"load {load}", found=type(field).__name__, expected=expected, hint=hint)
    return field


def one_place(who: str, dof: Any, at: Any) -> None:
    """Refuse both a DOF and a place, and neither.

    Raises
    ------
    InputError
        If not exactly one is given.
    """
    if (dof is None) == (at is None):
        raise InputError(
            "one place is needed",
            where=who,
            found=f"dof={dof}, at={at}",
            expected="a DOF such as 12+Z, or at=",
            hint="pass one of the two",
        )


def point(at: ArrayLike, names: Sequence[str]) -> tuple[float, ...]:
    """Coordinates of a point, checked: one finite number per name.

    Raises
    ------
    InputError
        If their number or a value is wrong.
    """
    values = np.atleast_1d(numbers(at)).ravel()
    if values.size != len(names) or not np.all(np.isfinite(values)):
        raise InputError(
            "no point of this structure",
            where="sensor or load",
            found=f"at={at!r}",
            expected=f"finite {', '.join(names)} in m",
            hint=f"at=({', '.join(names)})" if len(names) > 1 else "at=0.31, for example",
        )
    return tuple(float(v) for v in values)


def within(fibre: Any, outer: float | None) -> None:
    """Refuse a fibre that lies outside the section; glue and carrier of a gauge are forgiven.

    Raises
    ------
    InputError
        If it lies further out than the outer fibre, by more than a quarter, or is a pair.
    """
    if np.ndim(fibre):
        raise InputError(
            "this structure bends over its height only",
            where="StrainGauge, fibre",
            found=f"fibre = {fibre}",
            expected="one distance from the neutral axis or mid-plane, in m",
            hint="a pair (y, z) is for members of a frame in space",
        )
    if outer is not None and abs(fibre) > CARRIER * outer:
        raise InputError(
            "the gauge lies outside the section",
            where="StrainGauge, fibre",
            found=f"fibre = {fibre:g} m",
            expected=f"at most {outer:g} m from the neutral axis or mid-plane",
            hint="half the height or thickness, not all of it; negative on the lower face",
        )


ELEMENTS = 100_000  # per line: beyond, rounding in the stiffness is larger than any error of the mesh
EPS = float(np.finfo(float).eps)


def shape(xi: float, h: float, order: int = 0) -> Array:
    """Hermite functions of (v1, v1', v2, v2') at ``xi = x / h``, or their derivative of `order` up to 2 in x; (4,)."""
    if order == 0:
        n2, n4 = xi * (1 - xi) ** 2, xi**2 * (xi - 1)
        n3 = xi**2 * (3 - 2 * xi)
        return np.array([1 - n3, h * n2, n3, h * n4])
    if order == 1:
        n1 = 6 * xi * (xi - 1) / h
        return np.array([n1, 1 - 4 * xi + 3 * xi**2, -n1, 3 * xi**2 - 2 * xi])
    return np.array([(12 * xi - 6) / h**2, (6 * xi - 4) / h, (6 - 12 * xi) / h**2, (6 * xi - 2) / h])


def mass_matrix(h: float) -> Array:
    """Integral of N N^T over one element, closed form, (4, 4)."""
    a, b, c, d = 22 * h, 13 * h, 4 * h * h, 3 * h * h
    return h / 420 * np.array([[156, a, 54, -b], [a, c, b, -d], [54, b, 156, -a], [-b, -d, -a, c]])


def slope_matrix(h: float) -> Array:
    """Integral of N' N'^T over one element, closed form, (4, 4)."""
    a, b, c = 3 * h, 4 * h * h, h * h
    return np.array([[36, a, -36, a], [a, b, -a, -c], [-36, -a, 36, -a], [a, -c, -a, b]]) / (30 * h)


def curvature_matrix(h: float) -> Array:
    """Integral of N'' N''^T over one element, closed form, (4, 4)."""
    a, b, c = 6 * h, 4 * h * h, 2 * h * h
    return np.array([[12, a, -12, a], [a, b, -a, c], [-12, -a, 12, -a], [a, c, -a, b]]) / h**3


def mixed_matrix(h: float) -> Array:
    """Integral of N'' N^T over one element: by parts, -slope_matrix plus the terms at the two ends; (4, 4)."""
    q = -slope_matrix(h)
    q[3, 2] += 1.0
    q[1, 0] -= 1.0
    return q


def gauss(points: int) -> tuple[Array, Array]:
    """Gauss points and weights on [0, 1]."""
    x, w = np.polynomial.legendre.leggauss(points)
    return np.asarray(x + 1, float) / 2, np.asarray(w, float) / 2


def assembled(blocks: Array, dofs: NDArray[Any], size: int) -> sparse.csr_array:
    """Sparse (size, size) matrix from one block (m, m) for all elements, or one for each, with DOFs (elements, m)."""
    i, j = np.broadcast_arrays(dofs[:, :, None], dofs[:, None, :])
    data = np.broadcast_to(blocks, i.shape)
    return sparse.coo_array((data.ravel(), (i.ravel(), j.ravel())), shape=(size, size)).tocsr()


@dataclass(frozen=True)
class Line:
    """A line of equal Hermite elements; node i carries the unknowns 2 i (value) and 2 i + 1 (slope).

    Everything is computed from the distance to `origin`, so that moving the line changes nothing.

    Parameters
    ----------
    length : float
        Length (m).
    elements : int
        Number of elements.
    origin : float
        Coordinate of node 0 (m).
    name : str
        Name of the coordinate, for messages.
    """

    length: float
    elements: int
    origin: float = 0.0
    name: str = "x"

    def __post_init__(self) -> None:
        where = f"mesh along {self.name}"
        integer("elements", self.elements, where=where, limit=ELEMENTS)
        positive("length", self.length, where=where, unit="m")
        number("origin", self.origin, where=where, unit="m")

    @property
    def h(self) -> float:
        """Element length."""
        return self.length / self.elements

    @property
    def size(self) -> int:
        """Number of unknowns."""
        return 2 * (self.elements + 1)

    @property
    def nodes(self) -> Array:
        """Coordinates of the nodes, origin included, (elements + 1,)."""
        return self.origin + self.local_nodes

    @property
    def local_nodes(self) -> Array:
        """Distances of the nodes from the first one, (elements + 1,)."""
        return np.asarray(np.arange(self.elements + 1) * self.h, float)

    # -- points ---------------------------------------------------------------------------------------------------
    def _rounding(self, x: float) -> float:
        """How far (in element lengths) rounding may have moved `x`: no more than that is forgiven."""
        return 1e-12 + 8 * EPS * (abs(x) + abs(self.origin)) / self.h

    def inside(self, x: float) -> bool:
        """Whether `x` lies on the line (rounding forgiven)."""
        s, slack = (x - self.origin) / self.h, self._rounding(x)
        return bool(-slack <= s <= self.elements + slack)

    def station(self, x: float) -> float:
        """Distance of `x` from the first node in element lengths; a point at a node is exactly an integer.

        Raises
        ------
        InputError
            If `x` lies outside, naming the range.
        """
        s = (x - self.origin) / self.h
        if not self.inside(x):
            raise InputError(
                "the point lies outside the structure",
                where=f"{self.name} = {x:.6g} m",
                found=f"{self.name} = {x:.9g}",
                expected=f"{self.origin:.9g} <= {self.name} <= {self.origin + self.length:.9g}",
                hint="give places in metres, in the frame that origin= fixes",
            )
        nearest = round(s)
        return float(nearest) if abs(s - nearest) <= self._rounding(x) else float(s)

    def row(self, x: float, order: int = 0) -> Array:
        """Row that gives the field, or its derivative of `order` 0, 1, 2, at `x` from the unknowns; (size,).

        The second derivative jumps from element to element: at a node it is the mean of both sides.
        """
        s = self.station(x)
        cells = [min(int(s), self.elements - 1)]
        if order == 2 and s == int(s) and 0 < s < self.elements:
            cells.insert(0, int(s) - 1)
        row = np.zeros(self.size)
        for cell in cells:
            row[2 * cell : 2 * cell + 4] += shape(s - cell, self.h, order) / len(cells)
        return row

    def integral(self, start: float, stop: float) -> Array:
        """Row of the integral of the field from `start` to `stop`, partial elements included; (size,)."""
        a, b = self.station(start), self.station(stop)
        row, (points, weights) = np.zeros(self.size), gauss(2)  # two points integrate the cubics exactly
        for cell in range(int(a), min(math.ceil(b), self.elements)):
            lo, hi = max(a - cell, 0.0), min(b - cell, 1.0)
            for xi, weight in zip(lo + (hi - lo) * points, weights, strict=True):
                row[2 * cell : 2 * cell + 4] += weight * (hi - lo) * self.h * shape(float(xi), self.h)
        return row

    def cells(self, start: float, stop: float) -> range:
        """Elements that a span shares; a point (``start == stop``) at a node belongs to both elements."""
        a, b = self.station(start), self.station(stop)
        first = math.ceil(a) - 1 if a == b else int(a)
        last = int(b) if a == b else math.ceil(b) - 1
        return range(max(first, 0), min(last, self.elements - 1) + 1)

    # -- matrices -------------------------------------------------------------------------------------------------
    def assemble(self, element: ArrayLike) -> sparse.csr_array:
        """Sparse (size, size) matrix from one element matrix for all, (4, 4), or one for each, (elements, 4, 4)."""
        return assembled(np.asarray(element, float), 2 * np.arange(self.elements)[:, None] + np.arange(4), self.size)

    def tension(self, T: float | Callable[[float], float]) -> sparse.csr_array:
        """Geometric stiffness of an axial force `T` (N), constant or a function of the coordinate."""
        if not callable(T):
            return self.assemble(number("tension", T, where="beam", unit="N") * slope_matrix(self.h))
        return self.varying(T, 1, "tension", "N")

    def varying(
        self, value: Callable[[float], float], order: int, name: str, unit: str, *, positive: bool = False
    ) -> sparse.csr_array:
        """Matrix of the integral of ``value(x)`` times the products of the `order`-th derivatives of the functions.

        Four Gauss points per element: one mid-point value would cost an order.
        """
        xi, weights = gauss(4)
        x = self.origin + self.h * (np.arange(self.elements)[:, None] + xi)
        factor = np.array([[_asked(value, float(at), name, unit, positive) for at in row] for row in x])
        shapes = np.array([shape(float(at), self.h, order) for at in xi])
        return self.assemble(self.h * np.einsum("ep,p,pi,pj->eij", factor, weights, shapes, shapes))


def _asked(function: Callable[[float], float], x: float, name: str, unit: str, positive: bool) -> float:
    """What a user's function of x gives, checked."""
    try:
        value: object = function(x)
    except Exception as error:  # whatever a user's function raises is about this argument
        value = error
    found = real(value)
    if found is None or (positive and found <= 0):
        raise InputError(
            f"the {name} is no function of x",
            where=f"beam, {name}",
            found=f"{shown(value)} at x = {x:.6g} m",
            expected=f"one finite{', positive' if positive else ''} number in {unit} for every x in m",
            hint="pass a number, or a function such as lambda x: 100.0 + 5.0 * x",
        )
    return found
