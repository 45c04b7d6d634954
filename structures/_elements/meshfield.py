"""What lies between the nodes of a mesh: motion, strain, its boundary; and many points of a solid at once.

`Field.motion` answers for one point and one axis; a camera sees hundreds of markers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import direction_label
from .._flags import Flag
from .._system import fields
from .._system.fields import Span, field_of, gauss
from .._system.structure import Structure
from ..errors import InputError, one_of, plain, reals
from .cells import Cell, gradients, strain_matrices
from .surfaces import Surface, flat, spread

Array = NDArray[np.float64]
Index = NDArray[np.intp]
SNAP_BLOCK = 1e-9  # of a cell: points so far outside are on the surface


def motions(structure: Structure, points: ArrayLike, *, reach: float | None = None) -> sparse.csr_array:
    """Rows of the motion along X, Y, Z at many points of a solid.

    Parameters
    ----------
    structure : Structure
        A block or a mesh of `structures._elements.solids`.
    points : array (N, 3)
        Places in the solid or on its surface (m).
    reach : float, optional
        How far outside a cell of a general mesh a point may lie, in cells: near a curved surface.

    Returns
    -------
    sparse (3 N, n)
        Row 3 i + c is the motion of point i along axis c; columns are all DOFs, supported ones included.

    Raises
    ------
    InputError
        If a point is none or lies outside: the first such point is named.
    """
    nodes, values = interpolants(structure, points, reach=reach)
    count, corners = nodes.shape
    rows = 3 * np.arange(count)[:, None, None] + np.arange(3)
    columns = 3 * nodes[:, :, None] + np.arange(3)
    data = np.repeat(values.ravel(), 3)
    where = np.broadcast_to(rows, (count, corners, 3)).ravel(), columns.ravel()
    out = sparse.coo_array((data, where), shape=(3 * count, structure.n)).tocsr()
    out.eliminate_zeros()
    return out


def in_space(given: ArrayLike, what: str, *, where: str, hint: str) -> Array:
    """Places (N, 3) in m of the nodes or points of a solid; the first that is not finite is named.

    Raises
    ------
    InputError
        If they are none.
    """
    places = reals(given, where=where, hint=f"an array ({what}, 3) in m")
    flat = places.ndim == 2 and places.shape[1] == 3
    bad = np.flatnonzero(~np.isfinite(places).all(axis=1)) if flat else np.empty(0, int)
    if not flat or len(bad):
        raise InputError(
            f"no {what} of a solid",
            where=where + (f", {what.removesuffix('s')} {bad[0]}" if len(bad) else ""),
            found="NaN or infinity" if len(bad) else f"shape {places.shape}",
            expected=f"finite (x, y, z) in m, shape ({what}, 3)",
            hint=hint,
        )
    return places


def interpolants(structure: Structure, points: ArrayLike, *, reach: float | None = None) -> tuple[Index, Array]:
    """Nodes (N, m) whose motion makes that of each point, and their weights (N, m), which sum to one.

    Raises
    ------
    InputError
        As `motions`.
    """
    places = in_space(points, "points", where="points of a solid", hint="leave lost markers out")
    field: Any = field_of(structure, "points of a solid")
    held: tuple[Index, Array] = field.interpolants(places) if reach is None else field.interpolants(places, reach)
    return held


def outside(beyond: NDArray[np.bool_], places: Array, lower: Array, upper: Array) -> None:
    """Refuse points outside a solid, naming the first.

    Raises
    ------
    InputError
        If any is.
    """
    if not np.any(beyond):
        return
    first = int(np.flatnonzero(beyond)[0])
    spans = ", ".join(f"{name} {a:.6g}..{b:.6g}" for name, a, b in zip("xyz", lower, upper, strict=True))
    raise InputError(
        f"{int(beyond.sum())} of {len(places)} points lie outside the solid",
        where=f"point {first}",
        found="({:.6g}, {:.6g}, {:.6g}) m".format(*places[first]),
        expected=f"within {spans} m",
        hint="check the frame of the points, and their unit (m)",
    )


def strains(structure: Structure, u: ArrayLike) -> Array:
    """Strains at the centres of all cells.

    Parameters
    ----------
    structure : Structure
        A block or a mesh of `structures._elements.solids`.
    u : array (n,)
        Motion of all DOFs (m).

    Returns
    -------
    array (cells, 6)
        xx, yy, zz, yz, xz, xy; shear as angles, that is twice the tensor's component.
    """
    field: Any = field_of(structure, "strains of a solid")
    u = np.asarray(plain(u), float)
    if u.shape != (structure.n,) or not np.all(np.isfinite(u)):
        raise InputError(
            "the motion does not fit",
            where="strains of a solid",
            found=f"shape {u.shape}" if u.shape != (structure.n,) else "NaN or infinity",
            expected=f"({structure.n},), finite",
            hint="structure.expand completes the motion of the free DOFs",
        )
    found: Array = field.strains(u)
    return found


def largest_strain(strain: ArrayLike) -> Array:
    """Largest principal strain by size, with its sign, of strains (cells, 6) as `strains` gives them."""
    e = np.asarray(plain(strain), float)
    xx, yy, zz, yz, xz, xy = e.T
    tensor = np.stack([xx, xy / 2, xz / 2, xy / 2, yy, yz / 2, xz / 2, yz / 2, zz], axis=1).reshape(-1, 3, 3)
    values = np.linalg.eigvalsh(tensor)
    return np.where(-values[:, 0] > values[:, 2], values[:, 0], values[:, 2])


FLAT = 0.5  # cosine: a face belongs to the top or the bottom if it is tilted by less than 60 degrees
SNAP = 1e-6  # of a cell: points so far outside are on the surface
NEWTON = 20


def along(d: Array) -> Array:
    """What d^T eps d takes of the six strains, shears counted as angles, (6,)."""
    return np.concatenate([d**2, [d[1] * d[2], d[0] * d[2], d[0] * d[1]]])


class SolidField:
    """What blocks and meshes of solids share: motion at a point, rigid motions; DOFs 3 node + (0, 1, 2)."""

    coordinates: Array

    @property
    def size(self) -> int:
        """Number of DOFs."""
        return 3 * len(self.coordinates)

    def _held(self, at: ArrayLike) -> tuple[Index, Array]:
        """Nodes (m,) of the cell that holds a point, and their weights."""
        raise NotImplementedError

    def _centred(self) -> Array:
        """Places of the nodes from the centre, over the largest side."""
        raise NotImplementedError

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the motion along X, Y or Z at (x, y, z)."""
        if axis not in (1, 2, 3):
            raise InputError(
                "a point of a solid moves along X, Y and Z and has no rotation",
                where="sensor or load on a solid",
                found=direction_label(axis),
                expected="+X, +Y or +Z",
                hint="two forces some way apart make a couple, two displacements a rotation",
            )
        nodes, values = self._held(at)
        row = np.zeros(self.size)
        row[3 * nodes + axis - 1] = values
        return row

    def strain(self, at: ArrayLike, fibre: float, angle: float, length: float | None) -> Array:
        """Refuses: a solid has no neutral axis."""
        raise InputError(
            "a solid has no neutral axis from which a fibre could be counted",
            where="StrainGauge on a solid",
            found=f"fibre={fibre:g}",
            expected="sensors.SolidGauge",
            hint="sensors.SolidGauge(at=(x, y, z), direction=(1, 0, 0), length=2e-3)",
        )

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node."""
        return tuple((float(v), float(v)) for v in self.coordinates[node])

    def rigid(self) -> dict[str, Array]:
        """Three translations, and three rotations about the centre."""
        places = self._centred()
        out = {f"translation {name}": np.tile(np.eye(3)[k], len(places)) for k, name in enumerate("XYZ")}
        return out | {f"rotation R{name}": np.cross(np.eye(3)[k], places).ravel() for k, name in enumerate("XYZ")}


@dataclass(frozen=True, eq=False)
class MeshField(SolidField):
    """A mesh of equal kinds of cells; DOFs 3 node + (0, 1, 2).

    Parameters
    ----------
    coordinates : array (nodes, 3)
        Places (m).
    cells : int array (F, nodes of a cell)
        In the order of `structures._elements.cells`.
    cell : Cell
        Their kind.
    flags : tuple of Flag
        What the guards of the mesh found.
    """

    coordinates: Array
    cells: Index
    cell: Cell
    flags: tuple[Flag, ...] = ()

    @cached_property
    def _boxes(self) -> tuple[Array, Array]:
        X = self.coordinates[self.cells]
        lower, upper = X.min(axis=1), X.max(axis=1)
        slack = 0.05 * (upper - lower).max(axis=1, keepdims=True)  # curved cells bulge beyond their nodes
        return lower - slack, upper + slack

    # -- points ---------------------------------------------------------------------------------------------------
    def interpolants(self, points: ArrayLike, reach: float = SNAP) -> tuple[Index, Array]:
        """Nodes (N, m) of the cell that holds each point, and their weights (N, m); up to `reach` cells beside it.

        Raises
        ------
        InputError
            If a point lies outside.
        """
        places = np.asarray(plain(points), float)
        cell, xi, beyond = self._located(places)
        outside(beyond > reach, places, self.coordinates.min(axis=0), self.coordinates.max(axis=0))
        return self.cells[cell], self.cell.shape(xi)

    def _located(self, places: Array) -> tuple[Index, Array, Array]:
        """Cell, reference coordinates, and how far outside it each point lies."""
        count = len(places)
        best, cell, found = np.full(count, np.inf), np.zeros(count, np.intp), np.tile(self.cell.centre, (count, 1))
        lower, upper = self._boxes
        step = max(1, 20_000_000 // (3 * len(self.cells)))
        for start in range(0, count, step):
            part = places[start : start + step]
            near = np.all((part[:, None] >= lower) & (part[:, None] <= upper), axis=2)
            point, candidate = np.nonzero(near)
            xi = self._inverse(self.coordinates[self.cells[candidate]], part[point])
            far = np.where(np.isfinite(xi).all(axis=1), self.cell.beyond(xi), np.inf)
            order = np.lexsort((far, point))
            point, candidate, xi, far = point[order], candidate[order], xi[order], far[order]
            first = np.unique(point, return_index=True)[1]
            at = start + point[first]
            best[at], cell[at], found[at] = far[first], candidate[first], xi[first]
        return cell, found, best

    def _inverse(self, X: Array, places: Array) -> Array:
        """Reference coordinates of places (Q, 3) in cells with nodes at X (Q, m, 3), by Newton's method."""
        xi = np.tile(self.cell.centre, (len(places), 1))
        size = np.ptp(X, axis=1).max(initial=1e-300)
        for _ in range(NEWTON):
            rest = places - np.einsum("qn,qnx->qx", self.cell.shape(xi), X)
            J = np.einsum("qnr,qnx->qxr", self.cell.slopes(xi), X)
            sound = np.abs(np.linalg.det(J)) > 1e-14 * size**3
            step = np.zeros_like(xi)
            step[sound] = np.linalg.solve(J[sound], rest[sound, :, None])[..., 0]
            xi = np.clip(xi + step, -4, 4)
            if np.abs(step).max(initial=0.0) < 1e-13:
                break
        rest = np.linalg.norm(places - np.einsum("qn,qnx->qx", self.cell.shape(xi), X), axis=1)
        xi[rest > 1e-9 * size] = np.nan
        return xi

    def _held(self, at: ArrayLike) -> tuple[Index, Array]:
        nodes, values = self.interpolants(np.array([fields.point(at, "xyz")]))
        return nodes[0], values[0]

    def direct_strain(self, at: ArrayLike, direction: Array, length: float | None) -> Array:
        """Row of d^T eps d along the unit vector `direction`, at a point or its mean over a line of `length` about it.

        The mean is taken at eight Gauss points of the line: approximate where it passes from cell to cell.
        """
        centre, (stations, weights) = np.array(fields.point(at, "xyz")), gauss(8)
        if length is None:
            stations, weights = np.array([0.5]), np.ones(1)
        places = centre + (stations[:, None] - 0.5) * (length or 0.0) * direction
        cell, xi, beyond = self._located(places)
        outside(beyond > SNAP, places, self.coordinates.min(axis=0), self.coordinates.max(axis=0))
        share, row = along(direction), np.zeros(self.size)
        for c, local, weight in zip(cell, xi, weights, strict=True):
            g, _ = gradients(self.cell, self.coordinates[self.cells[[c]]], local[None])
            dofs = (3 * self.cells[c][:, None] + np.arange(3)).ravel()
            row[dofs] += weight * (share @ strain_matrices(g)[0, 0])
        return row

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses: a load acts on a surface of the mesh."""
        raise InputError(
            "a rectangle is no part of a general mesh",
            where="load on a solid",
            found=f"{len(region)} spans",
            expected="nodal forces or hats on a surface",
            hint='bases.nodal(structure, structure.field.surface("top"), components=("+X", "+Y", "+Z"))',
        )

    def inside(self, at: ArrayLike) -> bool:
        """Whether (x, y, z) lies in the mesh."""
        return bool(self._located(np.array([fields.point(at, "xyz")]))[2][0] <= SNAP)

    def near(self, region: tuple[Span, ...]) -> Index:
        """DOFs of the boundary faces that a box shares."""
        lower, upper = (np.array([span[k] for span in region]) for k in (0, 1))
        corners = self.coordinates[self.boundary]
        slack = 1e-9 * np.ptp(self.coordinates)
        axes = slice(0, len(region))
        low, high = corners.min(axis=1)[:, axes], corners.max(axis=1)[:, axes]
        shared = np.all((low <= upper + slack) & (high >= lower - slack), axis=1)
        return (3 * np.unique(self.boundary[shared])[:, None] + np.arange(3)).ravel()

    def _centred(self) -> Array:
        size = np.ptp(self.coordinates, axis=0).max()
        return np.asarray((self.coordinates - self.coordinates.mean(axis=0)) / size, float)

    def strains(self, u: Array) -> Array:
        """Strains (cells, 6) at the centres, from the motion of all DOFs (n,)."""
        out = np.empty((len(self.cells), 6))
        for start in range(0, len(self.cells), 4096):
            part = self.cells[start : start + 4096]
            g, _ = gradients(self.cell, self.coordinates[part], self.cell.centre[None])
            moved = u.reshape(-1, 3)[part].reshape(len(part), -1)
            out[start : start + 4096] = np.einsum("fki,fi->fk", strain_matrices(g)[:, 0], moved)
        return out

    # -- boundary -------------------------------------------------------------------------------------------------
    @cached_property
    def boundary(self) -> Index:
        """Faces that belong to one cell only, counter-clockwise from outside, (faces, n)."""
        faces = self.cells[:, self.cell.faces].reshape(-1, self.cell.faces.shape[1])
        corners = np.sort(faces[:, : self.cell.corners], axis=1)
        _, first, times = np.unique(corners, axis=0, return_index=True, return_counts=True)
        if times.max() > 2:
            worst = int(first[np.argmax(times)])
            x, y, z = self.coordinates[faces[worst]].mean(axis=0)
            raise InputError(
                "a face belongs to more than two cells",
                where=f"mesh, cell {worst // len(self.cell.faces)}",
                found=f"{times.max()} cells at ({x:.6g}, {y:.6g}, {z:.6g})",
                expected="a conforming mesh",
                hint="look for cells that are listed twice",
            )
        return np.asarray(faces[np.sort(first[times == 1])])

    @cached_property
    def face_normals(self) -> Array:
        """Outward unit normals of the boundary faces, (faces, 3)."""
        p = self.coordinates[self.boundary[:, : self.cell.corners]]
        turn = np.cross(p[:, 2] - p[:, 0], p[:, -1] - p[:, 1])
        return np.asarray(turn / np.linalg.norm(turn, axis=1, keepdims=True), float)

    def facing(self, direction: ArrayLike, cosine: float = FLAT) -> Index:
        """Boundary faces whose outward normal lies nearest to `direction`: tilted by less than ``acos(cosine)``."""
        d = np.asarray(plain(direction), float)
        return np.flatnonzero(self.face_normals @ (d / np.linalg.norm(d)) > cosine)

    def surface(self, name: str, faces: Index | None = None) -> Surface:
        """Some boundary faces as a surface: nodes, normals, areas, boundary mass.

        Parameters
        ----------
        name : str
            "top" or "bottom": the faces that look along +Z or -Z; any name with `faces`.
        faces : int array, optional
            Rows of `boundary`.

        Raises
        ------
        InputError
            If the name is unknown or there are no such faces.
        """
        if faces is None:
            hint = "surface(name, faces) takes rows of field.boundary"
            one_of("a mesh has no such face", name, ("top", "bottom"), where="face", hint=hint)
            faces = self.facing((0, 0, 1 if name == "top" else -1))
        chosen = self.boundary[faces]
        if len(chosen) == 0:
            raise InputError(
                "a surface without faces", where=f"surface {name}", found="none", expected="faces of the boundary"
            )
        return flat(name, chosen[:, : self.cell.corners], self.coordinates)

    def hats(self, surface: Surface) -> sparse.csc_array:
        """Consistent nodal loads (nodes, P) in m^2 of tractions that fall linearly from one corner to its neighbours.

        Of hexahedra these are the columns of the boundary mass; the middles of the sides of ten-node tetrahedra carry
        most of a load, their corners almost none.

        Raises
        ------
        InputError
            If the surface is none of this mesh.
        """
        corners = self.cell.corners
        wanted = np.sort(surface.nodes[surface.cells], axis=1)
        own = np.sort(self.boundary[:, :corners], axis=1)
        known = {tuple(face): i for i, face in enumerate(own.tolist())}
        faces = [known.get(tuple(face), -1) for face in wanted.tolist()]
        if min(faces, default=-1) < 0:
            raise InputError(
                "the surface is none of this mesh",
                where=f"surface {surface.name}",
                found=f"cell {faces.index(-1) if faces else 0} is no face of its boundary",
                expected="a surface of structure.field",
            )
        return spread(surface, self.boundary[faces], len(self.coordinates))
