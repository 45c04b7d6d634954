"""What lies between the nodes of a frame: rows at a place (member, s), and the motions that cost no energy."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from .._channels import Dof, direction_label
from .._system import fields
from .._system.fields import Line, Span, gauss
from ..errors import InputError
from .members import PLANE, Element

LOOSE = 1e-12  # energy of a linkage, over that of single DOFs, which is rounding: its stiffness has few DOFs
Array = NDArray[np.float64]


class At(NamedTuple):
    """A place on a frame.

    Parameters
    ----------
    member : int
        Which member, in the order in which they were given.
    s : float
        Distance (m) from its start.
    """

    member: int
    s: float


@dataclass(frozen=True, eq=False)
class Piece:
    """One member as it is meshed.

    Parameters
    ----------
    line : Line
        Its division; s runs from 0 to its length.
    element : Element
        Its equal elements.
    axes : array (3, 3)
        Rows are the local axes x, y, z in global coordinates.
    nodes : array (elements + 1,)
        Node numbers along it.
    dofs : array (elements, 6 or 12)
        DOFs of each element: X, Z, RY at both ends in a plane frame, else all six.
    """

    line: Line
    element: Element
    axes: Array
    nodes: NDArray[np.intp]
    dofs: NDArray[np.intp]

    @property
    def plane(self) -> bool:
        """Whether it belongs to a plane frame."""
        return bool(self.dofs.shape[1] == 6)

    def on_global(self, rows: Array) -> Array:
        """Columns of local unknowns (r, 12) as columns of the DOFs of one element (r, 6 or 12)."""
        turned = (rows.reshape(-1, 4, 3) @ self.axes).reshape(-1, 12)
        return turned[:, PLANE] if self.plane else turned

    def matrix(self, local: Array) -> Array:
        """Element matrix in global directions from one in local axes."""
        return self.on_global(self.on_global(local).T).T

    def motion(self, xi: float) -> Array:
        """Global X, Y, Z, RX, RY, RZ inside an element, (6, 6 or 12)."""
        local = self.on_global(self.element.motion(xi)).reshape(2, 3, -1)
        return np.concatenate([self.axes.T @ part for part in local])

    def cells(self, s: float) -> tuple[float, list[int]]:
        """Station of s in elements, and the elements that meet there."""
        station = self.line.station(s)
        return station, list(self.line.cells(s, s))


@dataclass(frozen=True, eq=False)
class FrameField:
    """What lies between the nodes of a frame. A place is (member, s): s in m from the start of the member.

    Parameters
    ----------
    pieces : sequence of Piece
        The members, in the order in which they were given.
    dofs : sequence of Dof
        The DOF table.
    places : array (n, 3)
        Place of the node of every DOF, from the middle of the frame (m).
    middle : array (3,)
        Middle of the frame (m).
    hinged : bool
        Whether a member has a hinge.
    """

    pieces: Sequence[Piece]
    dofs: Sequence[Dof]
    places: Array
    middle: Array
    hinged: bool = False

    @property
    def plane(self) -> bool:
        """Whether it is a plane frame."""
        return self.pieces[0].plane

    def piece(self, member: float) -> Piece:
        """A member by its number.

        Raises
        ------
        InputError
            If the frame has none.
        """
        if member != int(member) or not 0 <= member < len(self.pieces):
            _refuse("the frame has no such member", f"{member:g}", f"a member from 0 to {len(self.pieces) - 1}")
        return self.pieces[int(member)]

    def _at(self, at: ArrayLike) -> tuple[Piece, float]:
        member, s = fields.point(at, ("member", "s"))
        return self.piece(member), s

    def _row(self, piece: Piece, rows: dict[int, Array]) -> Array:
        out = np.zeros(len(self.dofs))
        for cell, row in rows.items():
            out[piece.dofs[cell]] += row
        return out

    def _axis(self, axis: int) -> int:
        allowed = (1, 3, 5) if self.plane else tuple(range(1, 7))
        if axis not in allowed:
            expected = ", ".join(direction_label(a) for a in allowed)
            _refuse(f"a {'plane' if self.plane else 'space'} frame has no such motion", direction_label(axis), expected)
        return axis - 1

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the motion along a global axis (X, Z, RY in a plane frame, else all six) at (member, s)."""
        piece, s = self._at(at)
        k, (station, cells) = self._axis(axis), piece.cells(s)
        return self._row(piece, {cells[-1]: piece.motion(station - cells[-1])[k]})

    def strain(self, at: ArrayLike, fibre: float | tuple[float, float], angle: float, length: float | None) -> Array:
        """Row of the strain along the member, u' + z ry' - y rz', of the fibre at z, or at (y, z), in local axes.

        With a `length` the mean over the gauge, which is the difference of the fibre's motion at its two ends.
        """
        piece, s = self._at(at)
        if angle:
            _refuse("a member has strain along its axis only", f"angle = {angle:g} rad", "angle = 0")
        y, z = self._fibre(piece, fibre)
        if length is None:
            station, cells = piece.cells(s)
            weights = np.array([1.0, z, -y])[None] / len(cells)
            rows = {c: piece.on_global(weights @ piece.element.gradient(station - c))[0] for c in cells}
            return self._row(piece, rows)
        return (self._stretch(piece, s + length / 2, y, z) - self._stretch(piece, s - length / 2, y, z)) / length

    def _stretch(self, piece: Piece, s: float, y: float, z: float) -> Array:
        """Row of the motion of a fibre along the member."""
        station, cells = piece.cells(s)
        weights = np.array([[1.0, 0.0, 0.0, 0.0, z, -y]])
        local = weights @ piece.element.motion(station - cells[-1])
        return self._row(piece, {cells[-1]: piece.on_global(local)[0]})

    def _fibre(self, piece: Piece, fibre: float | tuple[float, float]) -> tuple[float, float]:
        """(y, z) of a fibre, inside the section."""
        y, z = (0.0, float(fibre)) if np.ndim(fibre) == 0 else fibre  # type: ignore[arg-type, misc]
        if y and self.plane:
            _refuse("a plane frame bends in its plane only", f"fibre y = {y:g} m", "the height z alone")
        fields.within(z, piece.element.section.c)
        fields.within(y, piece.element.section.c_y)
        return y, z

    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses: a frame has no one direction of deflection."""
        _refuse("a frame takes loads on its members", "a span", "frames.LineLoad(member=, direction=)")

    def line(self, member: int, span: Span | None, direction: Array) -> Array:
        """Row of the integral over a span (s0, s1) of a member of the motion along `direction` (3,)."""
        piece = self.piece(member)
        start, stop = (0.0, piece.line.length) if span is None else span
        a, b = piece.line.station(start), piece.line.station(stop)
        points, weights = gauss(2)  # two points integrate the cubics exactly
        rows = {}
        for cell in range(int(a), min(math.ceil(b), piece.line.elements)):
            lo, hi = max(a - cell, 0.0), min(b - cell, 1.0)
            parts = [w * piece.motion(float(lo + (hi - lo) * xi))[:3] for xi, w in zip(points, weights, strict=True)]
            rows[cell] = (hi - lo) * piece.line.h * (direction @ sum(parts[1:], parts[0]))
        return self._row(piece, rows)

    # -- places ---------------------------------------------------------------------------------------------------
    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node on the first member that has it."""
        joint = self._joint.get(node, node)
        member = next(k for k, piece in enumerate(self.pieces) if joint in piece.nodes)
        piece = self.pieces[member]
        s = float(np.flatnonzero(piece.nodes == joint)[0]) * piece.line.h
        return (member, member), (s, s)

    @cached_property
    def _joint(self) -> dict[int, int]:
        """The joint at which the extra node of a hinge lies."""
        out = {}
        for piece in self.pieces:
            half = piece.dofs.shape[1] // 2
            for node, last in ((piece.nodes[0], piece.dofs[0, half - 1]), (piece.nodes[-1], piece.dofs[-1, -1])):
                out[self.dofs[last].node] = int(node)
        return out

    def locate(self, place: Sequence[float]) -> At:
        """The place (member, s) of a point given in space: on the first member that passes through it.

        Parameters
        ----------
        place : (x, z) or (x, y, z)
            Coordinates as those of the nodes (m).

        Raises
        ------
        InputError
            If it lies on no member (1e-6 of the member's length is forgiven); the message names the nearest.
        """
        point = np.zeros(3)
        point[[0, 2] if self.plane else [0, 1, 2]] = fields.point(place, ("x", "z") if self.plane else ("x", "y", "z"))
        found = [(*self._gap(piece, point), k) for k, piece in enumerate(self.pieces)]
        hits = [At(k, s) for gap, s, k in found if gap < 1e-6 * self.pieces[k].line.length]
        if not hits:
            gap, s, k = min(found)
            far = f"{tuple(map(float, place))}, {gap:.3g} m from member {k} at s = {s:.6g} m"
            _refuse("the point lies on no member", far, "a point on a member")
        return hits[0]

    def _gap(self, piece: Piece, point: Array) -> tuple[float, float]:
        """Distance of a point from a member, and where on the member it is nearest."""
        arm = point - self.middle - self.places[piece.dofs[0, 0]]
        s = min(max(float(piece.axes[0] @ arm), 0.0), piece.line.length)
        return float(np.linalg.norm(arm - s * piece.axes[0])), s

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the elements that a span of a member shares; at a joint, of all that meet there."""
        (member, _), (start, stop) = region
        piece = self.piece(member)
        cells = piece.line.cells(start, stop)
        found = [piece.dofs[cells.start : cells.stop].ravel()]
        if start == stop and piece.line.station(start) in (0.0, float(piece.line.elements)):
            joint = piece.nodes[round(piece.line.station(start))]
            for other in self.pieces:
                found += [other.dofs[end] for end in (0, -1) if other.nodes[end] == joint]
        return np.unique(np.concatenate(found))

    def inside(self, at: ArrayLike) -> bool:
        """Whether the place (member, s) exists."""
        member, s = fields.point(at, ("member", "s"))
        return member == int(member) and 0 <= member < len(self.pieces) and self.pieces[int(member)].line.inside(s)

    # -- motions without energy -----------------------------------------------------------------------------------
    def rigid(self) -> dict[str, Array]:
        """Translations, rotations about the middle, and the linkages that hinges let go."""
        axes = np.array([dof.axis for dof in self.dofs])
        size = float(np.ptp(self.places, axis=0).max())
        out = {}
        for axis in (1, 3) if self.plane else (1, 2, 3):
            out[f"translation {direction_label(axis)[1:]}"] = np.where(axes == axis, 1.0, 0.0)
        for axis in (5,) if self.plane else (4, 5, 6):
            moved = np.cross(np.eye(3)[axis - 4], self.places)
            row = np.where(axes == axis, 1.0, 0.0)
            for k in range(3):
                row = np.where(axes == k + 1, moved[:, k], row)
            out[f"rotation {direction_label(axis)[1:]}"] = row / size
        return out | self._linkages(np.column_stack(list(out.values()))) if self.hinged else out

    def _linkages(self, rigid: Array) -> dict[str, Array]:
        """Motions about the hinges: what the stiffness of whole, unmeshed members annihilates beyond `rigid`."""
        half = self.pieces[0].dofs.shape[1] // 2
        ends = [np.concatenate([p.dofs[0, :half], p.dofs[-1, half:]]) for p in self.pieces]
        joints = np.unique(np.concatenate(ends))
        K = np.zeros((len(joints), len(joints)))
        for piece, rows in zip(self.pieces, ends, strict=True):
            e = piece.element
            whole = Element(piece.line.length, e.section, e.material, e.shear)
            at = np.searchsorted(joints, rows)
            K[np.ix_(at, at)] += piece.matrix(whole.stiffness())
        scale = np.sqrt(K.diagonal())
        w, V = linalg.eigh(K / scale / scale[:, None])
        loose = V[:, w < LOOSE]
        Q, _ = np.linalg.qr(scale[:, None] * rigid[joints])
        U, s, _ = np.linalg.svd(loose - Q @ (Q.T @ loose), full_matrices=False)
        ways = (U[:, s > 1e-6] / scale[:, None]).T
        out = {}
        for way, vector in enumerate(ways, 1):
            full = np.zeros(len(self.dofs))
            full[joints] = vector / np.abs(vector).max()
            self._follow(full)
            out[self._hinges() + (f", way {way}" if len(ways) > 1 else "")] = full
        return out

    def _hinges(self) -> str:
        nodes = sorted({joint for own, joint in self._joint.items() if own != joint})
        return f"rotation about the hinges at nodes {', '.join(map(str, nodes[:8]))}" + (", ..." if nodes[8:] else "")

    def _follow(self, motion: Array) -> None:
        """Move the nodes inside every member as those of a rigid body, from the motion of its start."""
        for piece in self.pieces:
            half = piece.dofs.shape[1] // 2
            start = motion[piece.dofs[0, :half]]
            move, turn = start[:3], start[3:]
            if half == 3:
                move, turn = np.array([start[0], 0.0, start[1]]), np.array([0.0, start[2], 0.0])
            for cell in range(piece.line.elements - 1):
                arm = (cell + 1) * piece.line.h * piece.axes[0]
                whole = np.concatenate([move + np.cross(turn, arm), turn])
                motion[piece.dofs[cell, half:]] = whole[[0, 2, 4]] if half == 3 else whole


def _refuse(what: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where="sensor or load on a frame",
        found=found,
        expected=expected,
        hint="a place on a frame is at=frames.At(member, s)",
    )
