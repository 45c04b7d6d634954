"""The gel pad as finite elements: bonded base, free edges, any number of layers, seen from its loaded surface.

x and y lie in the plane of the pad with the origin at its centre, z = 0 is the bonded base, z = h the surface.

A mesh from a file is turned into a pad (which face is bonded, which is pressed, frame and unit), or rebuilt by layers
of bricks.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from structures import bases
from structures._elements import solids
from structures._elements.cells import CELLS, upright
from structures._elements.members import Material
from structures._elements.meshfield import MeshField
from structures._elements.surfaces import Surface
from structures._flags import Flag, canonical
from structures._system.structure import Structure
from structures.errors import InputError, integer, positive, shown

from .. import _guards as guards
from .._arrays import Array, Index, Mask
from .._closed.layer import Layer
from . import meshfiles
from .body import Body, cap, edges, extruded, locking_allowed, of_a_pad, polygon, rectangle
from .meshfiles import MeshFile
from .padfile import SensorFile, read
from .stiffness import Loaded
from .table import TomlTable

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
LARGE = 0.5  # a pad that measures more than this in its file's unit was drawn in mm
PLANE = 1e-6  # of the size: a bonded base is flat to this
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PadMesh:
    """A mesh in the frame of the pad: base at z = 0, surface towards +Z, origin at the centre; m.

    Nodes (nodes, 3), cells (cells, 8 or 10) of a `kind` ("C3D8", "C3D10"), the bonded nodes (`base`), the faces of the
    loaded surface (`top`), its file, and what was assumed of it: unit, axis, which end is bonded.
    """

    nodes: Array
    cells: Index
    kind: str
    base: Index
    top: Index
    source: str
    says: str

    def __repr__(self) -> str:
        return f"{len(self.cells)} {self.kind} of {self.source}: {self.says}"

    @property
    def dimensions(self) -> dict[str, Any]:
        """Sides and thickness (m)."""
        a, b, h = np.ptp(self.nodes, axis=0)
        return {"size": (float(a), float(b)), "thickness": float(h), "elements": None}

    def built(self, material: Material, element: str, allow: Sequence[str]) -> Body:
        """Structure and loaded surface."""
        structure = solids.mesh(
            self.nodes,
            self.cells,
            material=material,
            kind=self.kind,
            element=element,
            fixed=self.base,
            allow=locking_allowed(allow),
            where=self.source,
        )
        field: Any = structure.field
        known = {tuple(sorted(face)): i for i, face in enumerate(field.boundary[:, : field.cell.corners].tolist())}
        faces = np.array([known[tuple(sorted(face))] for face in self.top.tolist()], np.intp)
        surface = field.surface("top", faces)
        layers = _through(self.nodes, surface.nodes) if self.kind == "C3D8" else 0
        return Body(structure, surface, {**self.dimensions, "layers": layers}, field.flags, layered=layers > 0)


def placed(
    file: MeshFile,
    *,
    unit: str | None = None,
    axis: str | None = None,
    base: str | None = None,
    top: str | None = None,
    allow: Sequence[str] = (),
) -> PadMesh:
    """The mesh of a file in the frame of the pad.

    Parameters
    ----------
    unit : {"m", "cm", "mm", "um"}, optional
        Unit of the file, which does not name it. Taken as mm where the largest side is more than half a unit, else m.
    axis : str, optional
        Outward direction of the loaded surface in the file, "+Z" or "-Y". Found otherwise: along the shortest side,
        away from the end that is flat (both flat: the lower end is bonded).
    base, top : str, optional
        Node sets of the bonded base and of the loaded surface. Found otherwise: the flat end, and all faces of the
        boundary that look along the axis, tilted by less than 60 degrees.
    allow : sequence of str
        ``("E110",)`` takes a solid with holes or tunnels.
    """
    cell = CELLS[file.kind]
    _used(file)
    field = MeshField(file.nodes, file.cells, cell)
    upright(cell, file.nodes[file.cells], where=file.path)
    _closed(
        field.boundary[:, : cell.corners], 2, "the boundary of the mesh is no closed surface without holes", file.path,
        "look for seams of double nodes, cells that touch at an edge, tunnels; allow=('E110',) takes it", allow,
    )  # fmt: skip
    scale, unit_said = _scale(file, unit)
    end, axis_said = _end(field, axis, file.path)
    turn = _turn(end)
    nodes = file.nodes @ turn.T
    boundary = field.boundary[:, : cell.corners]
    normals = field.face_normals @ turn.T
    size = np.ptp(nodes, axis=0).max()
    if base is None:
        low = np.all(nodes[boundary][:, :, 2] < nodes[:, 2].min() + PLANE * size, axis=1)
        held = np.unique(field.boundary[low])
    else:
        held = file.named(base)
        low = np.all(np.isin(boundary, held), axis=1)
    if not len(held):
        raise InputError(
            "the mesh has no flat base to bond", where=file.path, found="no face in its lowest plane",
            expected="a flat end opposite to the loaded surface",
            hint='base="NAME" of a node set, or axis="+Z" for the outward direction of the surface',
        )  # fmt: skip
    if top is None:
        faces = boundary[(normals[:, 2] > 0.5) & ~low]
    else:
        faces = boundary[np.all(np.isin(boundary, file.named(top)), axis=1) & ~low]
    if not len(faces):
        raise InputError(
            "the mesh has no loaded surface", where=file.path, found="no face of the boundary",
            expected="faces that look along the axis, or all of whose nodes are in the set",
            hint="name the node set of the whole surface, sides and corners included",
        )  # fmt: skip
    _closed(
        faces, 1, "the loaded surface is not one piece without holes", file.path,
        "name its node set with top=, or take it with allow=('E110',)", allow,
    )  # fmt: skip
    lower, upper = nodes[held].min(axis=0), nodes[held].max(axis=0)
    origin = np.array([(lower[0] + upper[0]) / 2, (lower[1] + upper[1]) / 2, nodes[:, 2].min()])
    says = f"{unit_said}; {axis_said}"
    _LOG.info("%s: %s", file.path, says)
    return PadMesh(scale * (nodes - origin), file.cells, file.kind, held, faces, file.path, says)


def rebuilt(mesh: PadMesh, pitch: float, layers: int, material: Material, element: str, allow: Sequence[str]) -> Body:
    """The same body by columns of bricks: its base, of one piece, as outline, its height over each node."""
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    step = positive("the pitch", pitch, where="Pad.from_mesh", unit="m")
    corners = _rim(mesh)
    reach = 2 * np.abs(corners).max(axis=0)
    counts = [max(1, round(side / step)) for side in reach]
    places, quads = polygon(corners).on((float(reach[0]), float(reach[1])), (counts[0], counts[1]))
    nodes = mesh.nodes[np.unique(mesh.top)]
    height = LinearNDInterpolator(nodes[:, :2], nodes[:, 2])(places)
    beside = ~np.isfinite(height)
    height[beside] = NearestNDInterpolator(nodes[:, :2], nodes[:, 2])(places[beside])
    dimensions = {**mesh.dimensions, "pitch": step, "layers": layers}
    return extruded(places, quads, 1.0, layers, material, element, allow, dimensions, height=height)


def _used(file: MeshFile) -> None:
    """Refuse nodes without a cell, by their number in the file."""
    loose = np.setdiff1d(np.arange(len(file.nodes)), file.cells)
    if loose.size:
        x, y, z = file.nodes[loose[0]]
        raise InputError(
            f"{loose.size} of {len(file.nodes)} nodes belong to no cell",
            where=f"{file.path}, node {file.names[loose[0]]}",
            found=f"at ({x:.6g}, {y:.6g}, {z:.6g})",
            expected="every node in a cell",
            hint="leave out nodes of other parts, such as the reference point of an indenter",
        )


def _closed(faces: Index, want: int, what: str, path: str, hint: str, allow: Sequence[str]) -> None:
    """E110: V - E + F is 2 over the boundary of a solid without holes, 1 over a surface in one piece without holes."""
    corners = len(np.unique(faces))
    found = corners - len(edges(faces)[0]) + len(faces)
    if found != want and "LID-E110" not in {canonical(code) for code in allow}:
        raise InputError(
            what, where=path, found=f"vertices - edges + faces = {found} ({corners} vertices, {len(faces)} faces)",
            expected=f"{want} (Euler's formula)", hint=hint, code="LID-E110",
        )  # fmt: skip


def _scale(file: MeshFile, unit: str | None) -> tuple[float, str]:
    """Metres in a unit of the file, and what was taken for it."""
    largest = float(np.ptp(file.nodes, axis=0).max())
    if unit is not None:
        if unit not in UNITS:
            raise InputError("unknown unit", where="Pad.from_mesh, unit", found=shown(unit), expected=", ".join(UNITS))
        return UNITS[unit], f"in {unit}, as stated"
    name = "mm" if largest > LARGE else "m"
    return UNITS[name], f"in {name}, assumed from its largest side of {largest:.4g}"


def _end(field: MeshField, axis: str | None, path: str) -> tuple[Array, str]:
    """Outward direction of the loaded surface."""
    names = [sign + letter for letter in "XYZ" for sign in "+-"]
    if axis is not None:
        if str(axis).upper() not in names:
            raise InputError("no axis", where="Pad.from_mesh, axis", found=shown(axis), expected=", ".join(names))
        chosen = str(axis).upper()
        return _unit(chosen), f"surface towards {chosen}, as stated"
    places = field.coordinates
    k = int(np.argmin(np.ptp(places, axis=0)))
    corners = places[field.boundary[:, : field.cell.corners]]
    slack = PLANE * np.ptp(places, axis=0).max()
    spans = corners[:, :, (k + 1) % 3], corners[:, :, (k + 2) % 3]
    areas = np.prod([np.ptp(s, axis=1) for s in spans], axis=0)
    low = areas[np.all(corners[:, :, k] < places[:, k].min() + slack, axis=1)].sum()
    high = areas[np.all(corners[:, :, k] > places[:, k].max() - slack, axis=1)].sum()
    if max(low, high) == 0:
        raise InputError(
            "no end of the mesh is flat",
            where=path,
            found=f"no face in the planes {'XYZ'[k]} = {places[:, k].min():.6g} and {places[:, k].max():.6g}",
            expected="a flat bonded base across the shortest side",
            hint='axis="+Z" for the outward direction of the surface, base="NAME" for the bonded node set',
        )
    chosen = ("-" if high > low * (1 + 1e-6) else "+") + "XYZ"[k]
    why = (
        "the lower end of the shortest side taken as base"
        if abs(high - low) <= 1e-6 * low
        else "the flat end is the base"
    )
    return _unit(chosen), f"surface towards {chosen}, {why}"


def _unit(name: str) -> Array:
    return np.asarray((1.0 if name[0] == "+" else -1.0) * np.eye(3)["XYZ".index(name[1])], float)


def _turn(up: Array) -> Array:
    """Rotation whose third row is the outward direction and whose first is the first coordinate axis across it."""
    first = np.eye(3)[next(k for k in range(3) if up[k] == 0)]
    return np.array([first, np.cross(up, first), up])


def _through(nodes: Array, top: Index) -> int:
    """Cells through the thickness of a mesh by layers: nodes over surface nodes, less one; 0 if it has none."""
    layers, rest = divmod(len(nodes), len(top))
    return layers - 1 if rest == 0 else 0


def _rim(mesh: PadMesh) -> Array:
    """Outline of the base (n, 2), in cyclic order."""
    cell = CELLS[mesh.kind]
    field = MeshField(mesh.nodes, mesh.cells, cell)
    faces = field.boundary[:, : cell.corners]
    faces = faces[np.all(np.isin(faces, mesh.base), axis=1)]
    sides = np.stack([faces.ravel(), np.roll(faces, -1, axis=1).ravel()], axis=1)
    _, first, times = np.unique(np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True)
    follows = dict(sides[first[times == 1]].tolist())
    start = at = next(iter(follows), -1)
    ring = []
    for _ in follows:
        ring.append(at)
        at = follows.get(at, -1)
    if at != start or len(set(ring)) != len(ring) or len(ring) < 3:
        raise InputError(
            "the base of the mesh has no outline of one piece", where=mesh.source,
            found=f"{len(follows)} sides on its rim", expected="one closed ring",
            hint="leave pitch= out: the mesh is then used as it is",
        )  # fmt: skip
    return mesh.nodes[ring][:, :2]


if TYPE_CHECKING:
    from structures.bases import Basis


@dataclass(frozen=True, eq=False, kw_only=True)
class Pad(Loaded):
    """A gel pad bonded to a rigid window.

    Parameters
    ----------
    size : (a, b)
        Sides along x and y (m); those of the mesh where one is given.
    thickness : float
        From the bonded base to the surface (m); likewise.
    E, nu : float
        Young's modulus (Pa) and Poisson's ratio.
    pitch : float, optional
        Side of the cells in the plane (m); a side that it does not divide gets the nearest number of cells. A quarter
        of the thickness where neither `pitch` nor `elements` is given.
    elements : (nx, ny), optional
        Or the number of cells along each side.
    layers : int
        Cells through the thickness.
    element : {"bbar", "standard", "incompatible"}
        B-bar unless history is to be repeated: one layer of ``"standard"`` bricks is the baseline of the field, whose
        map of tractions is wrong by half (W115).
    outline : optional
        What is left of the rectangle, `tactile._pad.body`.
    curvature : float, optional
        Radius of curvature of a domed surface (m), whose apex lies over the centre at the thickness; `Pad.dome` finds
        it from height and plinth.
    rim : {"free", "bonded"}
        Whether the sides are free, or held by a ring or box that the gel is cast in: up to one layer under the surface,
        all of whose nodes may be loaded.
    density : float
        kg/m^3; static maps do not ask for it.
    material : str
        ``"elastomer"`` questions a modulus that none has (W111), and refuses what is of another scale than any gel pad,
        as another unit makes it; another word does not.
    allow : sequence of str
        ``("E109",)``: plain bricks above nu = 0.49, flagged; ``("W115",)``: few layers that were compared with many.
    mesh : optional
        A mesh instead of dimensions: `Pad.from_mesh`.
    counts : (cells, nodes), optional
        Published counts of the mesh that this pad stands for: refused where no mesh of so many layers has them (E110),
        never built from.

    Attributes
    ----------
    structure : Structure
        The finite elements, base bonded.
    surface : Surface
        The loaded surface: nodes, cells, areas, boundary mass.
    flags : tuple of Flag
        What the guards of material and mesh found.

    Raises
    ------
    InputError
        If a value is not possible, or the mesh is none.

    Notes
    -----
    Vectors at points are flattened with the point first, 3 * point + component. Forces are consistent nodal forces (N);
    `surface.tractions` turns them into Pa. What base and rim carry is `reactions` and never part of a load.
    """

    E: float
    nu: float
    size: tuple[float, float] = (0.0, 0.0)
    thickness: float = 0.0
    pitch: float | None = None
    elements: tuple[int, int] | None = None
    layers: int = 4
    element: str = "bbar"
    outline: Any = None
    curvature: float | None = None
    rim: str = "free"
    density: float = 1000.0
    material: str = "elastomer"
    allow: Sequence[str] = ()
    mesh: Any = None
    counts: tuple[int, int] | None = None
    structure: Structure = field(init=False, repr=False)
    surface: Surface = field(init=False, repr=False)
    flags: tuple[Flag, ...] = field(init=False, repr=False)
    _levels: Index | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        def fix(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        material = Material(E=self.E, rho=self.density, nu=self.nu)
        of_a_pad(self)
        fix("allow", (self.allow,) if isinstance(self.allow, str) else tuple(self.allow))
        if self.counts is not None:
            guards.published(self.counts, self.layers)
        body = rectangle(self, material) if self.mesh is None else self._meshed(material)
        for name, value in body.dimensions.items():
            fix(name, value)
        of_a_pad(self)
        fix("structure", body.structure)
        fix("_levels", body.levels)
        fix("surface", body.surface)
        fix("flags", self._found(body))

    def _meshed(self, material: Material) -> Body:
        if self.rim != "free" or self.curvature is not None:
            raise InputError(
                "a mesh has its own shape and supports", where="Pad.from_mesh", found="rim or curvature",
                expected="neither", hint='base="NAME" of a node set holds the sides too',
            )  # fmt: skip
        if self.pitch is None:
            body: Body = self.mesh.built(material, self.element, self.allow)
            return body
        layers = integer("layers", self.layers, where="Pad, layers", limit=100)
        return rebuilt(self.mesh, self.pitch, layers, material, self.element, self.allow)

    @classmethod
    def dome(
        cls, radius: float, height: float, *, plinth: float, E: float, nu: float, pitch: float | None = None,
        **settings: Any,
    ) -> Pad:  # fmt: skip
        """A spherical cap on a plinth, bonded to a flat window by its disc.

        Parameters
        ----------
        radius : float
            Of the bonded disc (m).
        height : float
            Of the apex over the window (m).
        plinth : float
            Height at the rim (m): the cylinder under the cap, less than `height`.
        E, nu, pitch, **settings
            As of `Pad`; ``layers`` go from base to surface everywhere, thinner towards the rim.

        Raises
        ------
        InputError
            As `Pad`; a cap steeper than 60 degrees at its rim, or that comes down to the base.

        Notes
        -----
        Loads are tractions along X, Y and Z at the nodes of the curved surface; its normals are ``surface.normals``.
        """
        curvature, outline = cap(radius, height, plinth)
        return cls(size=(2 * radius, 2 * radius), thickness=height, curvature=curvature, outline=outline, E=E, nu=nu,
                   pitch=pitch, **settings)  # fmt: skip

    @classmethod
    def from_mesh(
        cls,
        file: str | os.PathLike[str],
        *,
        E: float,
        nu: float,
        pitch: float | None = None,
        layers: int = 4,
        unit: str | None = None,
        axis: str | None = None,
        base: str | None = None,
        top: str | None = None,
        element: str = "bbar",
        **settings: Any,
    ) -> Pad:
        """Pad from a mesh file: Abaqus or CalculiX ``.inp``, also with ``.gz``, or arrays in NPZ or HDF5.

        Parameters
        ----------
        file : path
            `tactile._pad.meshfiles.read` says what it may hold.
        E, nu : float
            Pa; `tactile._pad.meshfiles.elastic` reads them from an input file.
        pitch, layers : optional
            With a pitch (m), rebuild the body from columns of B-bar bricks: outline of the base, height of the surface.
            Without, the cells of the file are used as they are; the loads of ten-node tetrahedra are then tractions
            that fall linearly from a corner to its neighbours, of 1 N each.
        unit, axis, base, top : optional
            As in `tactile._pad.pad.placed`: what the file does not say is found, and told by ``repr(pad.mesh)``.
        element : str
            Of hexahedra.
        **settings
            Other settings of `Pad`.

        Raises
        ------
        InputError
            If the file holds no mesh of a pad; code LID-E110 where Euler's formula says so.
        """
        allow = settings.get("allow", ())
        allow = (allow,) if isinstance(allow, str) else tuple(allow)
        mesh = placed(meshfiles.read(file), unit=unit, axis=axis, base=base, top=top, allow=allow)
        return cls(E=E, nu=nu, mesh=mesh, pitch=pitch, layers=layers, element=element, **settings)

    @classmethod
    def from_toml(cls, file: str | os.PathLike[str]) -> Pad:
        """Pad of a TOML file: its table ``[pad]``; `tactile._pad.padfile` says what it may hold.

        Raises
        ------
        InputError
            If it holds no pad, or as `Pad`.
        """
        return cls.from_settings(read(file))

    @classmethod
    def from_settings(cls, given: SensorFile, *, allow: Sequence[str] = ()) -> Pad:
        """Pad of a sensor that `tactile._pad.padfile.read` gave; `allow` overrides guards of model and mesh.

        Raises
        ------
        InputError
            As `Pad`; the message names the file.
        """
        settings = dict(given.body)
        allowed = [*settings.pop("allow", ()), *allow]
        with TomlTable(given.path, "pad", {}).named():
            if "mesh" in settings:
                return cls.from_mesh(settings.pop("mesh"), allow=allowed, **settings)
            return cls(allow=allowed, **settings)

    def _found(self, body: Body) -> tuple[Flag, ...]:
        """What the guards of mesh and material found."""
        found = [guards.modulus(self.E) if self.material == "elastomer" else None]
        if body.layered:
            found.append(guards.too_coarse(self.layers, self.nu, self.element))
        waived = {str(code).upper().removeprefix("LID-") for code in self.allow}
        kept = [f for f in found if f is not None and f.code.removeprefix("LID-") not in waived]
        return (*body.flags, *kept)

    def __repr__(self) -> str:
        a, b = (1e3 * side for side in self.size)
        cells = f"{len(self.surface.cells)} cells x {self.layers} layers" if self.mesh is None else repr(self.mesh)
        return f"Pad({a:g} x {b:g} x {1e3 * self.thickness:g} mm, E={self.E:g} Pa, nu={self.nu:g}, {cells})"

    # -- geometry -------------------------------------------------------------------------------------------------
    @cached_property
    def edge(self) -> Mask:
        """Whether a surface node lies on the rim (P,)."""
        sides, times = edges(self.surface.cells)
        out = np.zeros(self.points, bool)
        out[sides[(times == 1) & (sides[:, 0] != sides[:, 1])].ravel()] = True
        return out

    @cached_property
    def layer(self) -> Layer:
        """The bonded layer of the same thickness and material, without edges."""
        return Layer(self.thickness, self.E, self.nu)

    @cached_property
    def basis(self) -> Basis:
        """Nodal forces on the surface along X, Y and Z: what `ForwardModel` takes as loads.

        Raises
        ------
        InputError
            For ten-node tetrahedra.
        """
        if self._quadratic:
            raise InputError(
                "ten-node tetrahedra have no load basis", where="Pad, basis", found=repr(self.mesh),
                expected="hexahedra",
                hint="Pad.from_mesh(file, pitch=) rebuilds the body from bricks; solve and transfer serve both",
            )  # fmt: skip
        return bases.nodal(self.structure, self.surface, components=("+X", "+Y", "+Z"))
