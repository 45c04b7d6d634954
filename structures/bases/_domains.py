"""Where a distributed load acts: the span of a beam, the area of a plate, a face of a solid.

Each domain is a set of cells with coordinates along one or two axes. It gives quadrature points, exact for the
element's shape functions times polynomials, and the sparse rows of the motion there; a consistent load is then
``rows.T @ (weights * pressure)``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .._channels import Dof
from .._elements.beams import BeamField
from .._elements.plates import PlateField
from .._system.fields import gauss, shape
from .._system.structure import Structure
from ..errors import InputError
from ._grids import SNAP, merged

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Quadrature:
    """Quadrature points of a domain: cell, coordinates along its axes (Q, axes), places (Q, dim), weights (Q,)."""

    cell: Index
    along: Array
    places: Array
    weights: Array
    local: Array | None = None  # reference coordinates in general quadrilaterals


class Domain:
    """Cells of a mesh on which a load may be distributed.

    Attributes
    ----------
    lower, upper : array (cells, axes)
        Extent of each cell along the axes.
    nodes : int array (P,)
        Node numbers; `coordinates` (P, dim), `cells` (F, 2 or 4) of local indices, `normals` (P, 3) or None.
    names : tuple of str
        Names of the axes.
    directions : tuple of str
        Component labels that a load on it may have, without their sign.
    unit, quantity : str
        What a distributed load is there.
    """

    names: tuple[str, ...]
    unit: ClassVar[str]
    quantity: ClassVar[str]
    words: ClassVar[str]
    directions: tuple[str, ...] = ("Z",)
    lower: Array
    upper: Array
    nodes: Index
    coordinates: Array
    cells: Index
    normals: Array | None = None
    boxed: bool = True

    @cached_property
    def bounds(self) -> Array:
        """Extent along each axis, (axes, 2)."""
        return np.column_stack([self.lower.min(axis=0), self.upper.max(axis=0)])

    def project(self, places: Array) -> Array:
        """Coordinates along the axes of places (m, dim)."""
        return places

    def lift(self, along: Array) -> Array:
        """Places (m, dim) of coordinates along the axes."""
        return along

    def motion(self, rule: Quadrature, direction: str) -> sparse.csr_array:
        """Rows of the motion along a direction at quadrature points, sparse (Q, n)."""
        raise NotImplementedError

    def vectors(self, direction: str, rule: Quadrature | None = None) -> Array:
        """Unit vectors (nodes or Q, 3) of a direction."""
        count = len(self.nodes) if rule is None else len(rule.weights)
        return np.tile(np.eye(3)["XYZ".index(direction)], (count, 1))

    def node_hats(self, rule: Quadrature) -> sparse.csr_array:
        """Values of the (bi)linear function of every node at quadrature points, sparse (Q, nodes)."""
        lower, upper = self.lower[rule.cell], self.upper[rule.cell]
        size = upper - lower
        corners = self.project(self.coordinates)[self.cells[rule.cell]]  # (Q, corners, axes)
        values = np.prod(1 - np.abs(rule.along[:, None] - corners) / size[:, None], axis=-1)
        return self._spread(rule, values)

    def _spread(self, rule: Quadrature, values: Array) -> sparse.csr_array:
        corners = self.cells[rule.cell]
        row = np.repeat(np.arange(len(corners)), corners.shape[1])
        size = len(corners), len(self.nodes)
        return sparse.coo_array((values.ravel(), (row, corners.ravel())), shape=size).tocsr()

    def rule(self, window: Array, lines: list[Array] | None, degree: int, only: Index | None = None) -> Quadrature:
        """Gauss points for cubic shape functions times a load of `degree` along each axis.

        Parameters
        ----------
        window : array (axes, 2)
            Part that is loaded; cells are cut by it.
        lines : list of array or None
            Breaks along each axis at which the load is not smooth.
        degree : int
        only : int array, optional
            Cells that count.
        """
        xi, w = gauss((degree + 5) // 2)
        cell = np.arange(len(self.lower)) if only is None else only
        lower = np.maximum(self.lower[cell], window[:, 0])
        upper = np.minimum(self.upper[cell], window[:, 1])
        size = window[:, 1] - window[:, 0]
        inside = np.all(upper - lower > SNAP * size, axis=1)
        cell, lower, upper = cell[inside], lower[inside], upper[inside]
        starts, counts = [], []
        for k in range(lower.shape[1]):
            extra = [] if lines is None else [lines[k][(lines[k] > window[k, 0]) & (lines[k] < window[k, 1])]]
            cuts = merged(np.concatenate([lower[:, k], upper[:, k], *extra]), float(size[k]))
            first, last = (_nearest(cuts, ends[:, k]) for ends in (lower, upper))
            starts.append((cuts, first))
            counts.append(last - first)
        pieces = np.prod(counts, axis=0)
        part = np.repeat(np.arange(len(cell)), pieces)
        local = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
        along, weights = np.zeros((len(part), 1, 0)), np.ones((len(part), 1))
        for k, (cuts, first) in enumerate(starts):
            i = first[part] + local % counts[k][part]
            local = local // counts[k][part]
            steps = cuts[i + 1] - cuts[i]
            x = cuts[i, None] + steps[:, None] * xi
            old = along.shape[1]
            along = np.concatenate([np.tile(along, (1, len(xi), 1)), np.repeat(x, old, axis=1)[..., None]], axis=-1)
            weights = np.tile(weights, (1, len(xi))) * np.repeat(steps[:, None] * w, old, axis=1)
        each = along.shape[1]
        flat = along.reshape(-1, along.shape[-1])
        return Quadrature(np.repeat(cell[part], each), flat, self.lift(flat), weights.ravel())

    def cell_rule(self, cells: Index, degree: int) -> Quadrature:
        """Quadrature of some cells, uncut."""
        return self.rule(self.bounds, None, degree, cells)

    def node_hats_at(self, places: Array, cells: Index) -> sparse.csr_array:
        """Functions of the nodes at any places, zero beside the `cells`; sparse (m, nodes)."""
        along = self.project(places)
        slack = SNAP * np.ptp(self.bounds, axis=1)
        lower, upper = self.lower[cells] - slack, self.upper[cells] + slack
        found, first = np.zeros(len(along), bool), np.zeros(len(along), np.intp)
        step = max(1, 4_000_000 // len(cells))
        for start in range(0, len(along), step):
            part = along[start : start + step, None]
            on = np.all((part >= lower) & (part <= upper), axis=-1)
            found[start : start + step], first[start : start + step] = on.any(axis=1), on.argmax(axis=1)
        where = np.flatnonzero(found)
        rule = Quadrature(cells[first[where]], along[where], places[where], np.ones(len(where)))
        hats = self.node_hats(rule).tocoo()
        rows = where[hats.coords[0]]
        return sparse.coo_array((hats.data, (rows, hats.coords[1])), shape=(len(places), len(self.nodes))).tocsr()

    def _bad_direction(self, direction: str) -> InputError:
        return InputError(
            f"no such component of a load on {self.words}",
            where="components",
            found=repr(direction),
            expected=", ".join("+" + d for d in self.directions) + ", or with a minus sign",
            hint=f'components=("+{self.directions[-1]}",), for example',
        )


def _nearest(cuts: Array, values: Array) -> Index:
    """Index of the cut nearest to each value."""
    i = np.clip(np.searchsorted(cuts, values), 1, len(cuts) - 1)
    return np.where(values - cuts[i - 1] < cuts[i] - values, i - 1, i)


class Span(Domain):
    """The line of a beam, loaded along Z (N/m)."""

    unit, quantity, words = "N/m", "line_load", "a beam"

    def __init__(self, structure: Structure, field: BeamField) -> None:
        self.line, self.size, self.names = field.line, structure.n, (field.line.name,)
        x = self.line.nodes
        self.lower, self.upper = x[:-1, None], x[1:, None]
        self.nodes, self.coordinates = np.arange(len(x)), x[:, None]
        self.cells = np.column_stack([self.nodes[:-1], self.nodes[1:]])

    def motion(self, rule: Quadrature, direction: str) -> sparse.csr_array:
        """Rows of the deflection."""
        if direction not in self.directions:
            raise self._bad_direction(direction)
        values = _hermite(rule.along[:, 0], self.lower[rule.cell, 0], self.line.h)
        columns = 2 * rule.cell[:, None] + np.arange(4)
        row = np.repeat(np.arange(len(values)), 4)
        return sparse.coo_array((values.ravel(), (row, columns.ravel())), shape=(len(values), self.size)).tocsr()


class Sheet(Domain):
    """The area of a rectangular plate, loaded along Z (Pa)."""

    unit, quantity, words = "Pa", "pressure", "a plate"

    def __init__(self, structure: Structure, field: PlateField) -> None:
        self.x, self.y, self.size, self.names = field.x, field.y, structure.n, ("x", "y")
        j, i = np.divmod(np.arange(field.x.elements * field.y.elements), field.x.elements)
        x, y = field.x.nodes, field.y.nodes
        self.lower, self.upper = np.column_stack([x[i], y[j]]), np.column_stack([x[i + 1], y[j + 1]])
        first = i + (field.x.elements + 1) * j
        self.cells = np.column_stack([first, first + 1, first + field.x.elements + 2, first + field.x.elements + 1])
        self.nodes = np.arange(len(x) * len(y))
        jn, inn = np.divmod(self.nodes, len(x))
        self.coordinates = np.column_stack([x[inn], y[jn]])
        self.dof_at = np.argsort(field.order)  # DOF of each place in the Kronecker product
        self.i, self.j = i, j

    def motion(self, rule: Quadrature, direction: str) -> sparse.csr_array:
        """Rows of the deflection: products of Hermite functions of x and of y."""
        if direction not in self.directions:
            raise self._bad_direction(direction)
        i, j = self.i[rule.cell], self.j[rule.cell]
        u = _hermite(rule.along[:, 0], self.lower[rule.cell, 0], self.x.h)
        v = _hermite(rule.along[:, 1], self.lower[rule.cell, 1], self.y.h)
        values = (v[:, :, None] * u[:, None, :]).reshape(len(u), 16)
        place = (2 * j[:, None] + np.arange(4))[:, :, None] * self.x.size + (2 * i[:, None] + np.arange(4))[:, None, :]
        columns = self.dof_at[place.reshape(len(u), 16)]
        row = np.repeat(np.arange(len(u)), 16)
        return sparse.coo_array((values.ravel(), (row, columns.ravel())), shape=(len(u), self.size)).tocsr()


def _hermite(x: Array, start: Array, h: float) -> Array:
    """Hermite functions (points, 4) of cells that begin at `start`."""
    return shape((x - start) / h, h).T  # type: ignore[arg-type]


class FaceDomain(Domain):
    """A face of a solid: bilinear quadrilaterals, loaded along any direction (Pa).

    Parameters
    ----------
    structure : Structure
    surface : Surface
        `nodes`, `coordinates` (P, 3), `cells` (F, 4), `normals` (P, 3) outward.

    Notes
    -----
    The axes are the two coordinate axes that lie most nearly in the face. `T1` is the first of them laid into the
    face, `T2 = N x T1`. A face whose cells are rectangles along the axes is cut exactly by windows and grids; any other
    face is loaded by whole cells only.
    """

    unit, quantity, words = "Pa", "pressure", "a face of a solid"
    directions = ("X", "Y", "Z", "N", "T1", "T2")

    def __init__(self, structure: Structure, surface: Any) -> None:
        self.structure = structure
        self.nodes = np.asarray(surface.nodes, np.intp)
        self.coordinates = np.asarray(surface.coordinates, float)
        self.cells = np.asarray(surface.cells, np.intp)
        _fits(self.nodes, self.coordinates, self.cells, surface)
        self.normals = np.asarray(surface.normals, float)
        mean = self.normals.mean(axis=0)
        self.normal_axis = int(np.argmax(np.abs(mean)))
        self.axes = [k for k in range(3) if k != self.normal_axis]
        self.names = tuple("xyz"[k] for k in self.axes)
        corners = self.coordinates[self.cells]
        self.lower, self.upper = (f(corners, axis=1)[:, self.axes] for f in (np.min, np.max))
        self.level = float(self.coordinates[:, self.normal_axis].mean())
        self.boxed = self._boxed(corners)

    def _boxed(self, corners: Array) -> bool:
        """Whether the face is flat and its cells are rectangles along the axes."""
        slack = 1e-9 * np.ptp(self.coordinates, axis=0).max()
        flat = np.abs(self.coordinates[:, self.normal_axis] - self.level).max() <= slack
        plane, lower, upper = corners[..., self.axes], self.lower[:, None], self.upper[:, None]
        low, high = np.abs(plane - lower) <= slack, np.abs(plane - upper) <= slack
        kinds = np.sort(high[..., 0] * 1 + high[..., 1] * 2, axis=1)
        return bool(flat and np.all(low | high) and np.all(kinds == np.arange(4)))

    def project(self, places: Array) -> Array:
        """The two coordinates along the axes."""
        return places[:, self.axes]

    def lift(self, along: Array) -> Array:
        """Places on a flat face."""
        out = np.full((len(along), 3), self.level)
        out[:, self.axes] = along
        return out

    # -- general quadrilaterals ------------------------------------------------------------------------------------
    def cell_rule(self, cells: Index, degree: int) -> Quadrature:
        """Gauss points of some cells, whatever their shape."""
        xi, w = gauss(degree + 2)
        a, b = (m.ravel() for m in np.meshgrid(xi, xi, indexing="ij"))
        each = len(a)
        local = np.tile(np.column_stack([a, b]), (len(cells), 1))
        cell = np.repeat(cells, each)
        corners = self.coordinates[self.cells[cell]]
        places = np.einsum("qc,qcd->qd", bilinear(local), corners)
        area = np.linalg.norm(_area_vectors(local, corners), axis=1)
        weights = np.tile(np.outer(w, w).ravel(), len(cells)) * area
        return Quadrature(cell, self.project(places), places, weights, local)

    def node_hats(self, rule: Quadrature) -> sparse.csr_array:
        """Bilinear functions of the nodes."""
        return super().node_hats(rule) if rule.local is None else self._spread(rule, bilinear(rule.local))

    def motion(self, rule: Quadrature, direction: str) -> sparse.csr_array:
        """Rows of the motion along a coordinate axis, the normal or a tangent."""
        hats = self.node_hats(rule)
        vectors = self.vectors(direction, rule)
        used = [k for k in range(3) if np.any(np.abs(vectors[:, k]) > 1e-14)]
        parts = [sparse.diags_array(vectors[:, k]) @ hats @ self.selector(k) for k in used]
        return sparse.csr_array(sum(parts[1:], parts[0]))

    def selector(self, axis: int) -> sparse.csr_array:
        """Motion of every node along X, Y or Z from the DOFs, sparse (nodes, n)."""
        return selector(self.structure, self.nodes, axis + 1)

    def vectors(self, direction: str, rule: Quadrature | None = None) -> Array:
        """Unit vectors of a direction; the normal at a quadrature point is that of its cell there."""
        if direction not in self.directions:
            raise self._bad_direction(direction)
        if direction in ("X", "Y", "Z"):
            return super().vectors(direction, rule)
        assert self.normals is not None
        if rule is None:
            normals = self.normals
        elif rule.local is None:
            normals = self.node_hats(rule) @ self.normals
        else:
            corners = self.cells[rule.cell]
            normals = _area_vectors(rule.local, self.coordinates[corners])
            outward = np.sum(normals * self.normals[corners].mean(axis=1), axis=1)
            normals = normals * np.sign(outward)[:, None]
        return frames(normals, self.axes[0])[direction]


def _fits(nodes: Index, coordinates: Array, cells: Index, surface: Any) -> None:
    """Refuse what is no surface of quadrilaterals."""
    count = len(nodes)
    shapes = coordinates.shape == (count, 3) and np.shape(surface.normals) == (count, 3)
    if (
        not shapes
        or cells.ndim != 2
        or cells.shape[1] != 4
        or len(cells) == 0
        or cells.min() < 0
        or cells.max() >= count
    ):
        raise InputError(
            "no surface of quadrilaterals",
            where="region",
            found=f"{count} nodes, coordinates {coordinates.shape}, cells {cells.shape}",
            expected="coordinates and normals (P, 3), cells (F, 4) of local node indices",
            hint='structure.field.surface("top") gives one',
        )
    corners, square = coordinates[cells], np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    turns = np.stack([_area_vectors(np.tile(at, (len(cells), 1)), corners) for at in square])
    if np.any(np.sum(turns * turns.sum(axis=0), axis=-1) <= 0):
        raise InputError(
            "a cell of the surface is no convex quadrilateral",
            where="region",
            found="corners in crossed order, or a cell without area",
            expected="the corners of each cell in cyclic order",
            hint='structure.field.surface("top") gives them so',
        )


def frames(normals: Array, axis: int) -> dict[str, Array]:
    """Unit normal N, tangent T1 (the coordinate `axis` laid into the face) and T2 = N x T1, each (m, 3)."""
    N = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    first = np.eye(3)[axis] - N[:, [axis]] * N
    T1 = first / np.linalg.norm(first, axis=1, keepdims=True)
    return {"N": N, "T1": T1, "T2": np.cross(N, T1)}


def bilinear(local: Array) -> Array:
    """Bilinear functions of four corners in cyclic order at points (Q, 2) of the unit square, (Q, 4)."""
    a, b = local[:, 0], local[:, 1]
    return np.column_stack([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])


def _area_vectors(local: Array, corners: Array) -> Array:
    """Cross product of the two tangents of bilinear quadrilaterals, (Q, 3)."""
    a, b = local[:, :1], local[:, 1:]
    p = [corners[:, k] for k in range(4)]
    along_a = (1 - b) * (p[1] - p[0]) + b * (p[2] - p[3])
    along_b = (1 - a) * (p[3] - p[0]) + a * (p[2] - p[1])
    return np.cross(along_a, along_b)


def selector(structure: Structure, nodes: Index, axis: int) -> sparse.csr_array:
    """Motion of nodes along a direction code from the DOFs, polarity included, sparse (nodes, n).

    Raises
    ------
    InputError
        If a node has no such DOF.
    """
    columns = np.array([structure.index(Dof(int(node), axis)) for node in nodes], np.intp)
    signs = np.array([float(structure.dofs[i].sign) for i in columns])
    return sparse.coo_array((signs, (np.arange(len(nodes)), columns)), shape=(len(nodes), structure.n)).tocsr()


def domain_of(structure: Structure, surface: Any = None) -> Domain | None:
    """Domain of a structure that has one: a beam, a plate, or the named or given face of a solid."""
    field = structure.field
    if isinstance(field, BeamField):
        return Span(structure, field)
    if isinstance(field, PlateField):
        return Sheet(structure, field)
    if surface is None:
        return None
    return FaceDomain(structure, field.surface(surface) if isinstance(surface, str) else surface)  # type: ignore[union-attr]
