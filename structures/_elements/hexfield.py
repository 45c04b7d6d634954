"""What lies between the nodes of a block of bricks: motion, strain, face pressure; guards W108 and E109 of locking."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import direction_label
from .._flags import Evidence, Flag, canonical
from .._system import fields
from .._system.factor import Factor
from .._system.fields import Line, Span, gauss
from ..errors import InputError, one_of, plain
from .cells import Brick, shape
from .meshfield import SNAP_BLOCK, SolidField, along, outside
from .surfaces import Surface

FACES = {"bottom": (2, 0), "top": (2, 1), "left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1)}
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class HexField(SolidField):
    """A regular block of bricks; node n = i + (nx + 1) (j + (ny + 1) k), DOFs 3 n + (0, 1, 2).

    Parameters
    ----------
    x, y, z : Line
        The divisions of the three sides.
    cell : Brick
        The element that fills it.
    flags : tuple of Flag
        What the guards of the mesh found; every forward model on it carries them.
    """

    x: Line
    y: Line
    z: Line
    cell: Brick
    flags: tuple[Flag, ...] = ()

    @property
    def lines(self) -> tuple[Line, Line, Line]:
        """The three divisions."""
        return self.x, self.y, self.z

    @cached_property
    def grid(self) -> NDArray[np.intp]:
        """Node numbers by place, (nx + 1, ny + 1, nz + 1)."""
        counts = [line.elements + 1 for line in self.lines]
        return np.arange(math.prod(counts)).reshape(counts[::-1]).transpose(2, 1, 0)

    @cached_property
    def coordinates(self) -> Array:  # type: ignore[override]  # made when it is first asked for
        """Places of the nodes (nodes, 3), in the order of their numbers."""
        x, y, z = np.meshgrid(*(line.nodes for line in self.lines), indexing="ij")
        order = np.argsort(self.grid.ravel())
        return np.column_stack([x.ravel(), y.ravel(), z.ravel()])[order]

    def corners(self, i: ArrayLike, j: ArrayLike, k: ArrayLike) -> NDArray[np.intp]:
        """Nodes of the corners of cell (i, j, k), (..., 8)."""
        i, j, k = (np.asarray(v)[..., None] for v in (i, j, k))
        a = np.arange(8)
        return np.asarray(self.grid[i + (a & 1), j + (a >> 1 & 1), k + (a >> 2)])

    def assemble(self, element: Array) -> sparse.csr_array:
        """Sparse (n, n) matrix from the one matrix (24, 24) of every cell."""
        cells = np.meshgrid(*(np.arange(line.elements) for line in self.lines), indexing="ij")
        dofs = (3 * self.corners(*cells).reshape(-1, 8, 1) + np.arange(3)).reshape(-1, 24).astype(np.int32)
        return fields.assembled(element, dofs, self.size)

    # -- points ---------------------------------------------------------------------------------------------------
    def _cells(self, at: ArrayLike) -> list[tuple[NDArray[np.intp], Array]]:
        """Cells that share a point: the nodes of each, and the point in its unit cube."""
        stations = [line.station(v) for line, v in zip(self.lines, fields.point(at, "xyz"), strict=True)]
        choices = [line.cells(v, v) for line, v in zip(self.lines, fields.point(at, "xyz"), strict=True)]
        return [
            (self.corners(*cell), np.array([s - c for s, c in zip(stations, cell, strict=True)]))
            for cell in itertools.product(*choices)
        ]

    def _held(self, at: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        nodes, xi = self._cells(at)[0]
        return nodes, shape(xi)

    def interpolants(self, points: ArrayLike, reach: float = SNAP_BLOCK) -> tuple[NDArray[np.intp], Array]:
        """Nodes (N, 8) of the cell that holds each point, and their weights (N, 8).

        Raises
        ------
        InputError
            If a point lies outside.
        """
        places = np.asarray(plain(points), float)
        origin, steps = (np.array([getattr(line, name) for line in self.lines]) for name in ("origin", "h"))
        counts = np.array([line.elements for line in self.lines])
        stations = (places - origin) / steps
        beyond = np.any((stations < -SNAP_BLOCK) | (stations > counts + SNAP_BLOCK), axis=1)
        outside(beyond, places, origin, origin + counts * steps)
        cell = np.clip(np.floor(stations).astype(np.intp), 0, counts - 1)
        xi = np.clip(stations - cell, 0.0, 1.0)
        corners = np.arange(8)
        high = np.stack([corners & 1, corners >> 1 & 1, corners >> 2], axis=1).astype(bool)
        return self.corners(*cell.T), np.prod(np.where(high, xi[:, None], 1 - xi[:, None]), axis=2)

    def strains(self, u: Array) -> Array:
        """Strains (cells, 6) at the centres, from the motion of all DOFs (n,)."""
        cells = np.meshgrid(*(np.arange(line.elements) for line in self.lines[::-1]), indexing="ij")[::-1]
        nodes = self.corners(*(c.ravel() for c in cells))
        return np.asarray(u.reshape(-1, 3)[nodes].reshape(-1, 24) @ self.cell.strain(np.full(3, 0.5)).T, float)

    def direct_strain(self, at: ArrayLike, direction: Array, length: float | None) -> Array:
        """Row of d^T eps d along the unit vector `direction`, at a point or its mean over a line of `length` about it.

        Where cells meet the strain jumps, and the mean of all cells that share the point is taken.
        """
        centre = np.array(fields.point(at, "xyz"))
        if length is None:
            return self._strain(centre, direction)
        ends = centre - length / 2 * direction, centre + length / 2 * direction
        cuts = self._cuts(*ends)
        row, (points, weights) = np.zeros(self.size), gauss(3)  # the strain is quadratic along a line inside a cell
        for start, stop in itertools.pairwise(cuts):
            for t, weight in zip(start + (stop - start) * points, weights, strict=True):
                place = ends[0] + t * (ends[1] - ends[0])
                row += weight * (stop - start) * self._strain(place, direction)
        return row

    def _cuts(self, start: Array, stop: Array) -> list[float]:
        """Where a line passes from cell to cell: 0, shares of its length, 1."""
        shares = {0.0, 1.0}
        for line, a, b in zip(self.lines, start, stop, strict=True):
            s, e = line.station(float(a)), line.station(float(b))  # refuses ends outside
            if s != e:
                low, high = sorted((s, e))
                shares |= {(p - s) / (e - s) for p in range(math.floor(low) + 1, math.ceil(high))}
        found = sorted(shares)
        return [found[0], *(b for a, b in itertools.pairwise(found) if b - a > 1e-12)]

    def _strain(self, at: Array, d: Array) -> Array:
        weights, row, cells = along(d), np.zeros(self.size), self._cells(at)
        for nodes, xi in cells:
            dofs = (3 * nodes[:, None] + np.arange(3)).ravel()
            row[dofs] += weights @ self.cell.strain(xi) / len(cells)
        return row

    def inside(self, at: ArrayLike) -> bool:
        """Whether (x, y, z) lies in the block."""
        return all(line.inside(v) for line, v in zip(self.lines, fields.point(at, "xyz"), strict=True))

    # -- faces ----------------------------------------------------------------------------------------------------
    def face_nodes(self, face: str) -> NDArray[np.intp]:
        """Nodes of a face as a grid over its two coordinates, in the order x, y, z."""
        axis, end = FACES[known_face(face)]
        return np.asarray(np.take(self.grid, -end, axis=axis))

    def face_lines(self, face: str) -> tuple[Line, Line]:
        """The divisions of the two sides of a face."""
        axis, _ = FACES[known_face(face)]
        first, second = (line for k, line in enumerate(self.lines) if k != axis)
        return first, second

    def surface(self, name: str) -> Surface:
        """A face with its normals, areas and boundary mass.

        Raises
        ------
        InputError
            If there is no such face.
        """
        grid, (u, v) = self.face_nodes(name), self.face_lines(name)
        axis, end = FACES[name]
        nodes = grid.T.ravel()  # the first coordinate runs fastest, as in the block
        i, j = np.meshgrid(np.arange(u.elements), np.arange(v.elements), indexing="xy")
        first = (i + (u.elements + 1) * j).ravel()
        cells = first[:, None] + np.array([0, 1, u.elements + 2, u.elements + 1])
        # (x, y) and (y, z) turn about +Z and +X, (x, z) about -Y
        if (end == 0) != (axis == 1):
            cells = cells[:, ::-1]
        mass = sparse.csr_array(sparse.kron(_line_mass(v), _line_mass(u), format="csr"))
        normal = np.eye(3)[axis] * (1 if end else -1)
        return Surface(
            name,
            nodes,
            self.coordinates[nodes],
            np.ascontiguousarray(cells),
            np.tile(normal, (len(nodes), 1)),
            np.asarray(mass.sum(axis=1)).ravel(),
            mass,
        )

    def traction(self, face: str, spans: tuple[Span, ...], axis: int) -> Array:
        """Row of the integral of the motion along `axis` over a rectangle of a face: consistent forces of one Pa."""
        if len(spans) != 2 or axis not in (1, 2, 3):
            raise InputError(
                "no traction on a face",
                where="load on a solid",
                found=f"{len(spans)} spans, {direction_label(axis)}",
                expected="two spans, and +X, +Y or +Z",
                hint="spans over the two coordinates of the face, in the order x, y, z",
            )
        u, v = (_hat_integral(line, *span) for line, span in zip(self.face_lines(face), spans, strict=True))
        row = np.zeros(self.size)
        row[3 * self.face_nodes(face) + axis - 1] = np.outer(u, v)
        return row

    def face_region(self, face: str, spans: tuple[Span, ...]) -> tuple[Span, ...]:
        """A rectangle of a face as three spans."""
        axis, end = FACES[known_face(face)]
        level = float(self.lines[axis].nodes[-end])
        return (*spans[:axis], (level, level), *spans[axis:])

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Row of the integral of the motion along Z over a rectangle ((x0, x1), (y0, y1)) of the top face."""
        if len(region) != 2:
            raise InputError(
                "a patch on a solid acts on a rectangle",
                where="load on a solid",
                found=f"{len(region)} spans",
                expected="x=(x0, x1), y=(y0, y1) on the top face",
                hint='solids.FacePatch("left", ((y0, y1), (z0, z1)), direction="+X") loads another face',
            )
        return self.traction("top", region, 3)

    # -- neighbours, rigid motions ----------------------------------------------------------------------------------
    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the cells that a box shares; on a face of a pad, those of that face only.

        A support through the thickness is what a pad rests on: it carries every load and warns of nothing.
        """
        region = self.face_region("top", region) if len(region) == 2 else region
        thin = int(np.argmin([line.length for line in self.lines[::-1]]))
        picks = []
        for axis, (line, span) in enumerate(zip(self.lines, region, strict=True)):
            cells = line.cells(*span)
            pick = np.arange(cells.start, cells.stop + 1)
            if axis == 2 - thin and span[0] == span[1] and line.station(span[0]) in (0, line.elements):
                pick = np.array([round(line.station(span[0]))])
            picks.append(pick)
        return (3 * self.grid[np.ix_(*picks)].ravel()[:, None] + np.arange(3)).ravel()

    def _centred(self) -> Array:
        places = np.array(np.meshgrid(*(line.local_nodes - line.length / 2 for line in self.lines), indexing="ij"))
        return places.reshape(3, -1).T[np.argsort(self.grid.ravel())] / max(line.length for line in self.lines)


def known_face(name: object) -> str:
    """The name of a face.

    Raises
    ------
    InputError
        If there is no such face.
    """
    hint = "bottom and top along Z, left and right along X, front and back along Y"
    return one_of("a block has no such face", name, FACES, where="face", hint=hint)


def _line_mass(line: Line) -> sparse.csr_array:
    """Mass of the linear hats of a line (nodes, nodes)."""
    n = line.elements
    diagonal = np.full(n + 1, 4.0)
    diagonal[[0, -1]] = 2.0
    return sparse.csr_array(sparse.diags_array([np.ones(n), diagonal, np.ones(n)], offsets=[-1, 0, 1]) * (line.h / 6))


def _hat_integral(line: Line, start: float, stop: float) -> Array:
    """Integrals of the linear hats of a line from `start` to `stop`, partial cells included, (nodes,)."""
    a, b = line.station(start), line.station(stop)
    cells = np.arange(line.elements)
    low, high = np.clip(a - cells, 0, 1), np.clip(b - cells, 0, 1)
    right = (high**2 - low**2) / 2 * line.h
    out = np.zeros(line.elements + 1)
    out[:-1] = (high - low) * line.h - right
    out[1:] += right
    return out


WARN, REFUSE = 0.45, 0.49
TRIAL = 20_000  # DOFs up to which the mesh itself is tried
# A bonded pad of 16 x 16 x 4 plain bricks (16 x 16 x 4 mm, loaded in the middle): % too stiff against B-bar.
PAD = {0.3: 1.0, 0.45: 4.0, 0.49: 20.0, 0.499: 67.0, 0.4999: 94.0}
ADVICE = 'element="bbar", and check that nu was measured: gels of 0.32 to 0.49 are published'


def locking(field: HexField, fixed: Sequence[str], allow: Iterable[str] = ()) -> tuple[Flag, ...]:
    """Flag W108 (plain bricks and nu > 0.45), or the refusal E109 (nu > 0.49), or nothing.

    Parameters
    ----------
    field : HexField
        The block.
    fixed : sequence of str
        Its fixed faces.
    allow : iterable of str
        ``("E109",)`` turns the refusal into a flag.

    Raises
    ------
    InputError
        Code LID-E109, with the number, unless it is allowed.
    """
    nu, allowed = field.cell.nu, codes_of(allow)
    if field.cell.element != "standard" or nu <= WARN:
        return ()
    return too_stiff(nu, *_excess(field, fixed), allowed, "solids.block")


def codes_of(allow: Iterable[str]) -> set[str]:
    """The guard codes that a user allows, each checked."""
    return {canonical(code) for code in ([allow] if isinstance(allow, str) else allow)}


def too_stiff(nu: float, excess: float, how: str, allowed: set[str], where: str) -> tuple[Flag, ...]:
    """W108 or E109 of plain bricks that are `excess` per cent too stiff, as was found on `how`.

    Raises
    ------
    InputError
        Code LID-E109, unless it is allowed.
    """
    message = f"plain Hex-8 is {excess:.0f} % too stiff at nu = {nu:g} ({how})"
    if nu <= REFUSE:
        return (Flag("W108", Evidence("Poisson's ratio", nu, WARN), message),)
    if "LID-E109" not in allowed:
        raise InputError(
            message,
            where=f"{where}, element",
            found=f"element='standard' and nu = {nu:g}",
            expected=f"nu <= {REFUSE}, or another element",
            hint=ADVICE + '; allow=("E109",) builds it all the same',
            code="LID-E109",
        )
    return (Flag("E109", Evidence("Poisson's ratio", nu, REFUSE), message + ", allowed by the user"),)


def of_a_pad(nu: float) -> tuple[float, str]:
    """By how many per cent plain bricks of a bonded pad are too stiff against B-bar, and what pad that is."""
    x = [np.log10(1 - 2 * v) for v in PAD]
    found = np.interp(np.log10(1 - 2 * nu), x[::-1], list(PAD.values())[::-1])
    return float(found), "a bonded pad of 16 x 16 x 4 cells"


def _excess(field: HexField, fixed: Sequence[str]) -> tuple[float, str]:
    """By how many per cent plain bricks are too stiff against B-bar, and on what mesh that was found."""
    face = _loaded(fixed)
    if face is None or field.size > TRIAL:
        return of_a_pad(field.cell.nu)
    held = np.unique(np.concatenate([field.face_nodes(name).ravel() for name in fixed or ("bottom",)]))
    free = np.setdiff1d(np.arange(field.size), (3 * held[:, None] + np.arange(3)).ravel())
    f = _press(field, face)[free]
    compliance = []
    for element in ("standard", "bbar"):
        K = field.assemble(replace(field.cell, element=element).stiffness)[free][:, free]
        compliance.append(f @ Factor(K, check=False).solve(f))
    return 100 * (
        1 - compliance[0] / compliance[1]
    ), f"this mesh against B-bar, pressed in the middle of its {face} face"


def _loaded(fixed: Sequence[str]) -> str | None:
    """The free face to press: opposite to the first fixed one if possible."""
    axis, end = FACES[fixed[0] if fixed else "bottom"]
    opposite = next(name for name, place in FACES.items() if place == (axis, 1 - end))
    return next((name for name in (opposite, *FACES) if name not in (fixed or ("bottom",))), None)


def _press(field: HexField, face: str) -> np.ndarray:
    """A pressure on the middle of a face, about 1.4 times as wide as the block is deep."""
    axis, _ = FACES[face]
    side, spans = 1.4 * field.lines[axis].length, []
    for line in field.face_lines(face):
        half, middle = min(max(side, 2 * line.h), line.length) / 2, line.origin + line.length / 2
        spans.append((middle - half, middle + half))
    return field.traction(face, tuple(spans), axis + 1)
