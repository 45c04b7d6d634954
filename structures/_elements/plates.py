"""Thin rectangular plates: the Bogner-Fox-Schmit element on a rectangular mesh, in closed form.

Round ones are in `circular`.

A plate lies in the X-Y plane and deflects along Z. Node i + (nx + 1) j, at column i along x and row j along y, has
the unknowns w, w_x, w_y, w_xy. In a right-handed frame w_x turns about -Y and w_y about +X, so that the DOF table
prints them as ``n+Z``, ``n-RY``, ``n+RX`` and ``n+XY``; the last, the twist (1/m), is internal.

On a rectangular mesh the plate is a tensor product: its matrices are sums of Kronecker products of those of two lines.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import TWIST, Dof, direction_label
from .._system import fields
from .._system.damping import Damping, settled
from .._system.fields import Line, Span, curvature_matrix, mass_matrix, mixed_matrix, slope_matrix
from .._system.structure import Structure
from ..errors import InputError, integer, pair, shown
from . import circular as circular
from .members import Material, a_material, thin

# plates.circular.plate


AXES = (3, -5, 4, TWIST)  # w, w_x, w_y, w_xy
EDGES = ("x = 0", "y = 0", "x = a", "y = b")
CELLS = 100_000  # 400 000 unknowns: a few GB of factor
Array = NDArray[np.float64]


@dataclass(frozen=True)
class PlateField:
    """What lies between the nodes of a plate.

    Parameters
    ----------
    x, y : Line
        The divisions of the two sides.
    outer : float, optional
        Half the thickness (m).
    """

    x: Line
    y: Line
    outer: float | None = None

    @cached_property
    def order(self) -> NDArray[np.intp]:
        """Position in the Kronecker product (y outer, x inner) of each DOF, nodes first."""
        j, i, dy, dx = np.meshgrid(
            np.arange(self.y.elements + 1), np.arange(self.x.elements + 1), [0, 1], [0, 1], indexing="ij"
        )
        return np.asarray(((2 * j + dy) * self.x.size + 2 * i + dx).ravel())

    def _row(self, x: float, y: float, order: tuple[int, int] = (0, 0)) -> Array:
        return np.asarray(np.kron(self.y.row(y, order[1]), self.x.row(x, order[0]))[self.order], float)

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the deflection (Z) or a rotation (RX = w_y, RY = -w_x) at (x, y)."""
        x, y = fields.point(at, ("x", "y"))
        if axis not in (3, 4, 5):
            _refuse("a plate moves along Z and turns about X and Y", direction_label(axis), "+Z, +RX or +RY")
        if axis == 5:
            return -self._row(x, y, (1, 0))
        return self._row(x, y, (0, axis - 3))

    def _slope(self, x: float, y: float, c: float, s: float) -> Array:
        return c * self._row(x, y, (1, 0)) + s * self._row(x, y, (0, 1))

    def strain(self, at: ArrayLike, fibre: float, angle: float, length: float | None) -> Array:
        """Row of the strain -z w_ss along s at `angle` from X, at z = `fibre`; or its mean over a gauge of `length`."""
        x, y = fields.point(at, ("x", "y"))
        fields.within(fibre, self.outer)
        c, s = math.cos(angle), math.sin(angle)
        if length is None:
            bend = c * c * self._row(x, y, (2, 0)) + s * s * self._row(x, y, (0, 2))
            return -fibre * (bend + 2 * c * s * self._row(x, y, (1, 1)))
        # the field has a continuous gradient: the mean of w_ss is the difference of w_s at the ends, across cells too
        dx, dy = c * length / 2, s * length / 2
        return -fibre * (self._slope(x + dx, y + dy, c, s) - self._slope(x - dx, y - dy, c, s)) / length

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Row of the integral of w over a rectangle ((x0, x1), (y0, y1))."""
        if len(region) != 2:
            _refuse("a plate takes a pressure", "a span", "a rectangle x=(x0, x1), y=(y0, y1)")
        return np.asarray(np.kron(self.y.integral(*region[1]), self.x.integral(*region[0]))[self.order], float)

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node."""
        j, i = divmod(node, self.x.elements + 1)
        x, y = float(self.x.nodes[i]), float(self.y.nodes[j])
        return (x, x), (y, y)

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the cells that a rectangle shares."""
        columns, rows = self.x.cells(*region[0]), self.y.cells(*region[1])
        j, i = np.meshgrid(
            np.arange(rows.start, rows.stop + 1), np.arange(columns.start, columns.stop + 1), indexing="ij"
        )
        nodes = (j * (self.x.elements + 1) + i).ravel()
        return (4 * nodes[:, None] + np.arange(4)).ravel()

    def inside(self, at: ArrayLike) -> bool:
        """Whether (x, y) lies on the plate."""
        x, y = fields.point(at, ("x", "y"))
        return self.x.inside(x) and self.y.inside(y)

    def rigid(self) -> dict[str, Array]:
        """Translation and two rotations about the centre."""
        flat = [np.tile([1.0, 0.0], line.elements + 1) for line in (self.x, self.y)]
        turn = []
        for line in (self.x, self.y):
            steps = np.full(line.elements + 1, 1 / line.length)
            turn.append(np.column_stack([line.local_nodes / line.length - 0.5, steps]).ravel())
        return {
            "translation Z": np.kron(flat[1], flat[0])[self.order],
            "rotation RX": np.kron(turn[1], flat[0])[self.order],
            "rotation RY": np.kron(flat[1], turn[0])[self.order],
        }


def _refuse(what: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what, where="sensor or load on a plate", found=found, expected=expected, hint="the plate lies in X-Y"
    )


def plate(
    *,
    lengths: tuple[float, float],
    thickness: float,
    material: Material,
    elements: int | tuple[int, int] = (16, 16),
    edges: str = "SSSS",
    prestress: tuple[float, float] = (0.0, 0.0),
    damping: Damping | float | None = None,
    origin: tuple[float, float] = (0.0, 0.0),
) -> Structure:
    """Thin (Kirchhoff) rectangular plate.

    Parameters
    ----------
    lengths : (a, b)
        Sides along X and Y (m).
    thickness : float
        m.
    material : Material
        E, rho, nu.
    elements : (nx, ny) or int
        Equal cells along X and Y; one number serves both.
    edges : str
        Four letters for the edges x = 0, y = 0, x = a, y = b (round the plate, as the literature does): S simply
        supported, C clamped, F free. A cantilever plate is "CFFF".
    prestress : (Nx, Ny)
        In-plane forces per length (N/m), positive in tension; ``scaled("prestress", factor)`` changes them.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.
    origin : (x0, y0)
        Coordinates of the first corner (m). Points are given in the same coordinates; matrices do not depend on it.

    Returns
    -------
    Structure
        DOFs ``n+Z, n-RY, n+RX, n+XY`` (w, w_x, w_y, w_xy) of node n = i + (nx + 1) j.

    Raises
    ------
    InputError
        If a value is not possible, a letter is unknown, or the plate is thicker than a third of its shorter side.

    Notes
    -----
    Bogner, Fox & Schmit (1965); fourth order in the frequencies. A simply supported edge fixes the deflection and the
    slope along the edge; a clamped one fixes all four unknowns: fixing less would let the edge bow between the nodes.
    """
    if not (isinstance(edges, str) and len(edges) == 4 and set(edges) <= set("SCF")):
        raise InputError(
            "unknown edges",
            where="plate",
            found=repr(edges),
            expected=f"four letters S, C or F for {', '.join(EDGES)}",
            hint='"SSSS" is simply supported all round, "CFFF" a cantilever plate',
        )
    a, b = pair("lengths", lengths, where="plate", unit="m")
    x0, y0 = pair("origin", origin, where="plate", unit="m")
    stress = pair("prestress", prestress, where="plate", unit="N/m")
    nx, ny = _cells(elements)
    x, y = Line(a, nx, x0, "x"), Line(b, ny, y0, "y")
    thin(thickness, min(a, b) / 3, "plate", f"sides {a:g} m and {b:g} m", "shorter side")
    a_material(material, "plate")
    field = PlateField(x, y, thickness / 2)
    stiffness = material.E * thickness**3 / 12 / (1 - material.nu**2)
    K, terms = stiffness * _bending(field, material.nu), {}
    if any(stress):
        terms["prestress"] = _stress(field, stress)
        K = K + terms["prestress"]
    nodes = np.arange((x.elements + 1) * (y.elements + 1))
    j, i = np.divmod(nodes, x.elements + 1)
    return Structure(
        K=K,
        M=material.rho * thickness * _product(field, y.assemble(mass_matrix(y.h)), x.assemble(mass_matrix(x.h))),
        dofs=tuple(Dof(int(node), axis) for node in nodes for axis in AXES),
        coordinates=np.column_stack([x.nodes[i], y.nodes[j]]),
        supports=tuple(_supports(edges, x.elements, y.elements)),
        damping=settled(damping),
        field=field,
        terms=terms,
    )


def _cells(elements: int | tuple[int, int]) -> tuple[int, int]:
    """Cells along X and Y, checked; one number serves both."""
    both = (elements, elements) if np.ndim(elements) == 0 else tuple(elements)  # type: ignore[arg-type]
    if len(both) != 2:
        raise InputError(
            "elements must be one or two integers",
            where="plate",
            found=shown(elements),
            expected="(nx, ny), or one integer for both",
            hint="elements=(16, 16)",
        )
    nx, ny = (
        integer("elements", n, where=f"mesh along {name}", limit=CELLS) for n, name in zip(both, "xy", strict=True)
    )
    if nx * ny > CELLS:
        raise InputError(
            "too many elements",
            where="plate",
            found=f"{nx} x {ny} = {nx * ny}",
            expected=f"at most {CELLS} in all",
            hint="six elements per shortest wavelength are enough",
        )
    return nx, ny


def _product(field: PlateField, outer: sparse.csr_array, inner: sparse.csr_array) -> sparse.csr_array:
    """Kronecker product of a matrix along y and one along x, with the DOFs of a node together."""
    return sparse.csr_array(sparse.kron(outer, inner, format="csr"))[field.order][:, field.order].tocsr()


def _bending(field: PlateField, nu: float) -> sparse.csr_array:
    """Bending stiffness for unit rigidity: integral of (1 - nu) grad grad w : grad grad v + nu lap w lap v."""
    (H0x, H1x, H2x, Qx), (H0y, H1y, H2y, Qy) = (
        [line.assemble(form(line.h)) for form in (mass_matrix, slope_matrix, curvature_matrix, mixed_matrix)]
        for line in (field.x, field.y)
    )
    mixed = _product(field, Qy.T.tocsr(), Qx)
    return (
        _product(field, H0y, H2x)
        + _product(field, H2y, H0x)
        + nu * (mixed + mixed.T)
        + 2 * (1 - nu) * _product(field, H1y, H1x)
    ).tocsr()


def _stress(field: PlateField, prestress: Sequence[float]) -> sparse.csr_array:
    """Geometric stiffness of in-plane forces per length (Nx, Ny)."""
    (H0x, H1x), (H0y, H1y) = (
        [line.assemble(form(line.h)) for form in (mass_matrix, slope_matrix)] for line in (field.x, field.y)
    )
    return (prestress[0] * _product(field, H0y, H1x) + prestress[1] * _product(field, H1y, H0x)).tocsr()


def _supports(edges: str, nx: int, ny: int) -> list[Dof]:
    """Fixed DOFs: on a simply supported edge w and the slope along it, on a clamped one all four."""
    nodes = np.arange((nx + 1) * (ny + 1)).reshape(ny + 1, nx + 1)
    along_y, along_x = (3, 4), (3, -5)
    held = []
    for kind, line, tangential in zip(
        edges, (nodes[:, 0], nodes[0], nodes[:, -1], nodes[-1]), (along_y, along_x, along_y, along_x), strict=True
    ):
        axes = {"S": tangential, "C": AXES, "F": ()}[kind]
        held += [Dof(int(node), axis) for node in line for axis in axes]
    return held
