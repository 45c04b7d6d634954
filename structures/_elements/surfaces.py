"""Faces of solids: nodes, cells, normals, areas, boundary mass; tractions on them as loads."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import direction_code, direction_label
from .._readonly import ReadOnly
from .._system.factor import Factor
from .._system.fields import Span, assembled, field_of, gauss
from .._system.loads import Load
from .._system.sensors import fixed_quantity
from ..errors import InputError, numbers, plain, shown

if TYPE_CHECKING:
    from .._system.structure import Structure


Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface(ReadOnly):
    """A face of a solid, divided into bilinear quadrilaterals.

    Parameters
    ----------
    name : str
        "top", for example.
    nodes : int array (P,)
        Node numbers in the structure.
    coordinates : array (P, 3)
        Places (m).
    cells : int array (F, 4)
        Corners of each quadrilateral as indices into `nodes`, counter-clockwise seen from outside.
    normals : array (P, 3)
        Outward unit normals.
    areas : array (P,)
        Tributary areas (m^2): the row sums of `mass`.
    mass : sparse (P, P)
        Boundary mass of one component (m^2), exact for bilinear functions: consistent forces are ``mass @ tractions``.
    """

    name: str
    nodes: NDArray[np.intp]
    coordinates: Array
    cells: NDArray[np.intp]
    normals: Array
    areas: Array
    mass: sparse.csr_array

    @property
    def area(self) -> float:
        """Area (m^2)."""
        return float(self.areas.sum())

    def _on_nodes(self, values: ArrayLike, what: str) -> Array:
        found = numbers(values)
        if found.shape != (len(self.nodes), 3) or not np.all(np.isfinite(found)):
            raise InputError(
                f"the {what} do not fit the surface",
                where=f"surface {self.name}",
                found=f"shape {found.shape}" if np.all(np.isfinite(found)) else "NaN or infinity",
                expected=f"finite numbers, ({len(self.nodes)}, 3): a vector for each node",
                hint="rows in the order of surface.nodes, columns X, Y, Z",
            )
        return found

    def forces(self, tractions: ArrayLike) -> Array:
        """Consistent nodal forces (P, 3) in N of nodal tractions (P, 3) in Pa.

        Raises
        ------
        InputError
            If the tractions do not fit or are not finite.
        """
        return np.asarray(self.mass @ self._on_nodes(tractions, "tractions"), float)

    def tractions(self, forces: ArrayLike) -> Array:
        """Nodal tractions (P, 3) in Pa whose consistent forces are `forces` (P, 3) in N; inverse of `forces`.

        Raises
        ------
        InputError
            If the forces do not fit or are not finite.
        """
        return Factor(self.mass).solve(self._on_nodes(forces, "forces"))

    def traction_resultant(self, tractions: ArrayLike, about: ArrayLike | None = None) -> Array:
        """Force and moment of nodal tractions: (Fx, Fy, Fz, Mx, My, Mz) in N and N m.

        Parameters
        ----------
        tractions : array (P, 3)
            Pa.
        about : (x, y, z), optional
            Point of reference (m); the origin of coordinates where not given.

        Raises
        ------
        InputError
            If the tractions or the point do not fit or are not finite.
        """
        f = self.forces(tractions)
        place = np.zeros(3) if about is None else np.asarray(plain(about), float)
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise InputError(
                "no point",
                where=f"surface {self.name}, about",
                found=repr(about),
                expected="finite (x, y, z) in m",
                hint="leave it out for the origin of coordinates",
            )
        return np.concatenate([f.sum(axis=0), np.cross(self.coordinates - place, f).sum(axis=0)])


Index = NDArray[np.intp]
# integrals over a triangle of area 1 of the quadratic functions (corners, middles of 12, 23, 31) times the linear ones
_TRIANGLE = np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2], [8, 8, 4], [4, 8, 8], [8, 4, 8]]) / 60


def at_nodes(places: Array, cells: Index) -> Array:
    """Unit normals (P, 3) at places (P, 3), means over the cells (F, 4 or 3) between them by their areas."""
    p = places[cells]
    a, b, c, d = (p[:, k % p.shape[1]] for k in range(4))  # of a triangle the last is the first again
    normal = np.cross(c - a, d - b)
    found = np.zeros((len(places), 3))
    np.add.at(found, cells.ravel(), np.repeat(normal / 2, cells.shape[1], axis=0))
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def flat(name: str, faces: Index, coordinates: Array) -> Surface:
    """Surface of quadrilaterals or triangles between the nodes of `faces` (F, 4 or 3), with its mass."""
    nodes, local = np.unique(faces, return_inverse=True)
    cells = local.reshape(faces.shape)
    p = coordinates[faces]
    if faces.shape[1] == 3:
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) / 2
        mass = np.linalg.norm(normal, axis=1)[:, None, None] * (np.ones((3, 3)) + np.eye(3)) / 12
    else:
        mass = np.zeros((len(faces), 4, 4))
        points, weights = gauss(4)  # exact in the plane, and to many digits on a curved face
        for a, wa in zip(points, weights, strict=True):
            for b, wb in zip(points, weights, strict=True):
                N = np.array([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
                u = (1 - b) * (p[:, 1] - p[:, 0]) + b * (p[:, 2] - p[:, 3])
                v = (1 - a) * (p[:, 3] - p[:, 0]) + a * (p[:, 2] - p[:, 1])
                mass += wa * wb * np.linalg.norm(np.cross(u, v), axis=1)[:, None, None] * np.outer(N, N)
    M = assembled(mass, cells, len(nodes))
    return Surface(
        name,
        nodes,
        coordinates[nodes],
        cells,
        at_nodes(coordinates[nodes], cells),
        np.asarray(M.sum(axis=1)).ravel(),
        M,
    )


def spread(surface: Surface, faces: Index, size: int) -> sparse.csc_array:
    """Consistent nodal loads (size, P) of tractions that fall linearly from one corner to its neighbours, in m^2.

    Parameters
    ----------
    surface : Surface
        Of quadrilaterals or triangles.
    faces : int array (F, n)
        All nodes of its faces, corners first and in any cyclic order; sides 12, 23, 31 of triangles.
    size : int
        Nodes of the mesh.
    """
    if faces.shape[1] <= 4:
        columns = surface.mass.tocoo()
        where = surface.nodes[columns.coords[0]], columns.coords[1]
        return sparse.coo_array((columns.data, where), shape=(size, len(surface.nodes))).tocsc()
    corners = faces[:, :3]
    local = np.searchsorted(surface.nodes, corners)
    p = surface.coordinates[local]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    data = area[:, None, None] * _TRIANGLE
    rows, columns = np.broadcast_arrays(faces[:, :, None], local[:, None])
    return sparse.coo_array((data.ravel(), (rows.ravel(), columns.ravel())), shape=(size, len(surface.nodes))).tocsc()


@dataclass(frozen=True)
class FacePatch(Load):
    """Uniform traction (Pa) on a rectangle of a face of a solid, partial elements included.

    Parameters
    ----------
    face : str
        "top", "bottom", "left", "right", "front" or "back".
    spans : ((u0, u1), (v0, v1)), optional
        The rectangle (m) over the two coordinates of the face, in the order x, y, z. The whole face where not given.
    direction : str
        Sense of a positive traction along X, Y or Z: "-Z" on the top face presses.
    label : str, optional
        Face and spans where not given.

    Raises
    ------
    InputError
        If a span or a direction is none; in `shape`, if this is no solid.
    """

    face: str = "top"
    spans: tuple[Span, Span] | None = None
    _: KW_ONLY
    direction: str = "+Z"
    label: str = ""
    quantity: str = "pressure"
    unit: str = "Pa"

    def __post_init__(self) -> None:
        if self.spans is not None:
            object.__setattr__(self, "spans", _rectangle(self.spans))
        code = direction_code(self.direction)
        if abs(code) not in (1, 2, 3):
            raise InputError(
                "a traction acts along X, Y or Z",
                where="FacePatch",
                found=self.direction,
                expected="+X, -X, +Y, -Y, +Z or -Z",
                hint="-Z on the top face is a pressure",
            )
        fixed_quantity(self, "pressure")
        place = "" if self.spans is None else " " + " ".join(f"{a:.9g}..{b:.9g}" for a, b in self.spans)
        object.__setattr__(self, "direction", direction_label(code))
        object.__setattr__(self, "label", self.label or f"{self.face}{place} {self.direction}")
        super().__post_init__()

    def _on(self, structure: Structure) -> tuple[Any, tuple[Span, ...]]:
        """The field of a solid, and the rectangle."""
        field: Any = field_of(structure, f"load {self.label}")
        if not hasattr(field, "face_lines"):
            raise InputError(
                "this structure has no faces",
                where=f"load {self.label}",
                found=type(field).__name__,
                expected="a structure of structures.solids",
                hint="loads.Patch loads a beam or a plate",
            )
        whole = ((line.origin, line.origin + line.length) for line in field.face_lines(self.face))
        return field, self.spans or tuple(whole)

    def region(self, structure: Structure) -> tuple[Span, ...]:
        """The rectangle as three spans."""
        field, spans = self._on(structure)
        return tuple(field.face_region(self.face, spans))

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        field, spans = self._on(structure)
        code = direction_code(self.direction)
        return np.asarray(math.copysign(1, code) * field.traction(self.face, spans, abs(code)), float)


def _rectangle(spans: Any) -> tuple[Span, Span]:
    """Two spans, checked."""
    found = numbers(spans)
    if found.shape != (2, 2) or not np.all(np.isfinite(found)) or np.any(found[:, 0] >= found[:, 1]):
        raise InputError(
            "no rectangle",
            where="FacePatch, spans",
            found=shown(spans),
            expected="((u0, u1), (v0, v1)) in m, each start below its stop",
            hint="the two coordinates of the face, in the order x, y, z",
        )
    (a, b), (c, d) = found.tolist()
    return (a, b), (c, d)
