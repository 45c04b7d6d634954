"""Solids: blocks of eight-node bricks (B-bar, plain, incompatible), and any mesh of hexahedra or tetrahedra.

The X-Y plane is the plane of the pad, Z its thickness. Node n = i + (nx + 1) (j + (ny + 1) k), at column i along X, j
along Y, k along Z, has the DOFs ``n+X, n+Y, n+Z``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof
from .._flags import Flag
from .._system.damping import Damping, settled
from .._system.fields import Line, assembled
from .._system.structure import Structure
from ..errors import InputError, as_array, integer, number, one_of, plain, positive, shown
from .cells import CELLS, ELEMENTS, Brick, Cell, mass_matrix, masses, stiffnesses, upright
from .hexfield import WARN, HexField, codes_of, known_face, locking, of_a_pad, too_stiff
from .members import Material, a_material
from .meshfield import MeshField, in_space
from .surfaces import FacePatch

__all__ = [
    "FacePatch",
    "block",
    "mesh",
]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
MESH_ELEMENTS = ("bbar", "standard")
LIMIT = 50_000


def mesh(
    nodes: ArrayLike,
    cells: ArrayLike,
    *,
    material: Material,
    kind: str = "C3D8",
    element: str = "bbar",
    fixed: Any = "bottom",
    damping: Damping | float | None = None,
    allow: Iterable[str] = (),
    where: str = "solids.mesh",
) -> Structure:
    """Solid of hexahedra or quadratic tetrahedra.

    Parameters
    ----------
    nodes : array (nodes, 3)
        Places (m).
    cells : int array (cells, 8 or 10)
        Node indices from 0, in the order of Abaqus and VTK.
    material : Material
        E, rho, nu.
    kind : {"C3D8", "C3D10"}
        Hexahedra with eight nodes, tetrahedra with ten.
    element : {"bbar", "standard"}
        Mean dilatation or plain integration; of hexahedra only.
    fixed : "bottom", "top", sequence of node indices, or None
        Held nodes, all three DOFs: those of the faces that look along -Z or +Z, or any.
    damping : optional
        As in `structures._elements.solids.block`.
    allow : iterable of str
        ``("E109",)`` builds plain hexahedra above nu = 0.49; a flag stays.
    where : str
        Named in errors: the file.

    Returns
    -------
    Structure
        ``structure.field.surface("top")`` is a face of it.

    Raises
    ------
    InputError
        If nodes or cells are none, a node belongs to no cell, a cell is inverted, a face has more than two cells, the
        mesh falls apart, nothing is held where something should be; code LID-E109 for plain hexahedra above nu = 0.49.
    """
    cell = _kind(kind, element, where)
    places, table = _checked(nodes, cells, cell, where)
    X = places[table]
    upright(cell, X, where=where)
    field = MeshField(places, table, cell, _locking(cell, element, material.nu, allow, where))
    _connected(field, where)
    K = material.E * stiffnesses(cell, X, material.nu, bbar=cell.name == "C3D8" and element == "bbar")
    held = held_nodes(field, fixed, where)
    return Structure(
        K=assembled(K, (3 * table[:, :, None] + np.arange(3)).reshape(len(table), -1), field.size),
        M=sparse.csr_array(sparse.kron(assembled(masses(cell, X, material.rho), table, len(places)), np.eye(3))),
        dofs=tuple(Dof(node, axis) for node in range(len(places)) for axis in (1, 2, 3)),
        coordinates=places,
        supports=tuple(Dof(int(node), axis) for node in held for axis in (1, 2, 3)),
        damping=settled(damping),
        field=field,
    )


def _kind(kind: Any, element: Any, where: str) -> Cell:
    if kind not in CELLS or element not in MESH_ELEMENTS:
        raise InputError(
            "unknown cells",
            where=where,
            found=f"kind={shown(kind)}, element={shown(element)}",
            expected=f"kind {', '.join(CELLS)}; element {', '.join(MESH_ELEMENTS)}",
            hint='"C3D8" with "bbar" for every gel',
        )
    return CELLS[kind]


def _checked(nodes: Any, cells: Any, cell: Cell, where: str) -> tuple[Array, Index]:
    """Nodes and cells as arrays, every index in range, every node used."""
    places = in_space(nodes, "nodes", where=f"{where}, nodes", hint="an array (nodes, 3) in m")
    table = as_array(cells, where=f"{where}, cells")
    if table.ndim != 2 or table.shape[-1:] != (cell.nodes,) or table.dtype.kind not in "iu" or not len(table):
        raise InputError(
            f"no cells of kind {cell.name}",
            where=f"{where}, cells",
            found=f"{table.dtype} {table.shape}",
            expected=f"integers (cells, {cell.nodes})",
        )
    if len(table) > LIMIT:
        raise InputError(
            "too many cells for this machine's memory", where=where, found=len(table), expected=f"at most {LIMIT}"
        )
    outside = np.flatnonzero(np.any((table < 0) | (table >= len(places)), axis=1))
    if outside.size:
        raise InputError(
            "a cell has a node that does not exist",
            where=f"{where}, cell {outside[0]}",
            found=f"nodes {table[outside[0]].tolist()}",
            expected=f"0..{len(places) - 1}",
            hint="indices count from 0",
        )
    loose = np.setdiff1d(np.arange(len(places)), table)
    if loose.size:
        x, y, z = places[loose[0]]
        raise InputError(
            f"{loose.size} of {len(places)} nodes belong to no cell",
            where=f"{where}, node {loose[0]}",
            found=f"at ({x:.6g}, {y:.6g}, {z:.6g})",
            expected="every node in a cell",
            hint="leave out nodes of other parts, such as reference points of an indenter",
        )
    return places, table.astype(np.intp)


def _locking(cell: Cell, element: str, nu: float, allow: Iterable[str], where: str) -> tuple[Flag, ...]:
    """W108 and E109 for plain hexahedra, with the figures of a pad."""
    allowed = codes_of(allow)
    if cell.name != "C3D8" or element != "standard" or nu <= WARN:
        return ()
    return too_stiff(nu, *of_a_pad(nu), allowed, where)


def _connected(field: MeshField, where: str) -> None:
    """Refuse a mesh of several parts."""
    from scipy.sparse.csgraph import connected_components

    count, first = len(field.coordinates), field.cells[:, :1]
    i, j = np.repeat(first, field.cell.nodes - 1, axis=1).ravel(), field.cells[:, 1:].ravel()
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), shape=(count, count))
    parts, label = connected_components(graph, directed=False)
    if parts == 1:
        return
    sizes = np.bincount(label)
    small = int(np.argmin(sizes))
    x, y, z = field.coordinates[np.flatnonzero(label == small)[0]]
    raise InputError(
        f"the mesh falls into {parts} parts that share no node",
        where=where,
        found=f"the smallest has {sizes[small]} nodes, one at ({x:.6g}, {y:.6g}, {z:.6g})",
        expected="one connected solid",
        hint="merge double nodes, or leave out the other parts",
    )


def held_nodes(field: MeshField, fixed: Any, where: str) -> Index:
    """Indices of the held nodes.

    Raises
    ------
    InputError
        If a face or a node does not exist, or nothing is held.
    """
    if fixed is None:
        return np.empty(0, np.intp)
    if isinstance(fixed, str):
        faces = field.facing((0, 0, -1 if fixed == "bottom" else 1)) if fixed in ("bottom", "top") else np.empty(0, int)
        nodes = np.unique(field.boundary[faces])
    else:
        nodes = np.unique(np.asarray(plain(fixed)))
    if not nodes.size or nodes.dtype.kind not in "iu" or nodes.min() < 0 or nodes.max() >= len(field.coordinates):
        raise InputError(
            "the mesh has no such base",
            where=f"{where}, fixed",
            found=shown(fixed),
            expected='"bottom", "top", or indices of nodes',
            hint="name the node set of the bonded base",
        )
    return nodes.astype(np.intp)


MOST_CELLS = 50_000  # matrices of half a GB, a factor of many GB


def block(
    *,
    lengths: tuple[float, float, float],
    elements: tuple[int, int, int],
    material: Material,
    element: str = "bbar",
    fixed: str | Iterable[str] | None = "bottom",
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    damping: Damping | float | None = None,
    allow: Iterable[str] = (),
) -> Structure:
    """Rectangular block: a pad, a thick plate, a short beam.

    Parameters
    ----------
    lengths : (a, b, c)
        Sides along X, Y and Z (m).
    elements : (nx, ny, nz)
        Equal cells along X, Y and Z.
    material : Material
        E, rho, nu.
    element : {"bbar", "standard", "incompatible"}
        Mean dilatation (pads and other soft solids, any nu), the plain brick (locks for nu > 0.45), or incompatible
        modes (thin parts in bending: the other two are several times too stiff there).
    fixed : face or faces
        Bonded faces, all three DOFs held: "bottom" and "top" (Z), "left" and "right" (X), "front" and "back" (Y). None
        for a free body; ``with_supports`` adds rollers and points.
    origin : (x0, y0, z0)
        Coordinates of the first corner (m). Points are given in the same coordinates; matrices do not depend on it.
    damping : Rayleigh, Modal, Structural or float, optional
        Damping; a number is the ratio of every mode.
    allow : iterable of str
        ``("E109",)`` builds plain bricks above nu = 0.49; a flag stays.

    Returns
    -------
    Structure
        ``structure.field.surface("top")`` is a face of it; ``structure.field.flags`` what the guards found.

    Raises
    ------
    InputError
        If a value is not possible, a name is unknown, or there are too many cells; code LID-E109 for plain bricks above
        nu = 0.49.

    Notes
    -----
    Elements: see `structures._elements.cells`. The mass is that of the plain brick for all of them.
    """
    hint = '"bbar" for pads and rubber, "incompatible" for thin parts in bending'
    one_of("unknown element", element, ELEMENTS, where="solids.block, element", hint=hint)
    a_material(material, "solids.block")
    lines = _lines(lengths, elements, origin)
    h = np.array([line.h for line in lines])
    field = HexField(*lines, cell=Brick(h, material.nu, element))
    faces = _faces(fixed)
    field = replace(field, flags=locking(field, faces, allow))
    held = sorted({int(node) for face in faces for node in field.face_nodes(face).ravel()})
    return Structure(
        K=field.assemble(material.E * field.cell.stiffness),
        M=field.assemble(mass_matrix(h, material.rho)),
        dofs=tuple(Dof(node, axis) for node in range(field.grid.size) for axis in (1, 2, 3)),
        coordinates=field.coordinates,
        supports=tuple(Dof(node, axis) for node in held for axis in (1, 2, 3)),
        damping=settled(damping),
        field=field,
    )


def _three(name: str, value: Any) -> list[Any]:
    items = list(value) if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) else []
    if len(items) != 3:
        raise InputError(
            f"{name} must be three numbers",
            where="solids.block",
            found=shown(value),
            expected="one for each of X, Y, Z",
            hint=f"{name}=(20e-3, 20e-3, 4e-3)" if name != "elements" else "elements=(20, 20, 4)",
        )
    return items


def _lines(lengths: Any, elements: Any, origin: Any) -> tuple[Line, Line, Line]:
    """The divisions along X, Y and Z, checked."""
    sides = [positive("a length", v, where="solids.block, lengths", unit="m") for v in _three("lengths", lengths)]
    corner = [number("the origin", v, where="solids.block, origin", unit="m") for v in _three("origin", origin)]
    counts = [
        integer("elements", n, where=f"solids.block, mesh along {name}", limit=MOST_CELLS)
        for n, name in zip(_three("elements", elements), "XYZ", strict=True)
    ]
    cells = counts[0] * counts[1] * counts[2]
    if cells > MOST_CELLS:
        dofs = 3 * (counts[0] + 1) * (counts[1] + 1) * (counts[2] + 1)
        raise InputError(
            "too many cells for this machine's memory",
            where="solids.block, elements",
            found=f"{' x '.join(map(str, counts))} = {cells} cells, {dofs} DOFs, {cells * 576 * 12 / 1e9:.2g} GB each "
            "for K and M, and a factor of many times that",
            expected=f"at most {MOST_CELLS} cells",
            hint="a coarser mesh: two to four layers are enough for a pad with B-bar",
        )
    x, y, z = (Line(s, n, o, name) for s, n, o, name in zip(sides, counts, corner, "xyz", strict=True))
    return x, y, z


def _faces(fixed: str | Iterable[str] | None) -> tuple[str, ...]:
    """Names of the fixed faces, checked, without repeats."""
    names = [fixed] if isinstance(fixed, str) else list(fixed or ())
    return tuple(dict.fromkeys(known_face(name) for name in names))
