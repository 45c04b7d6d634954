"""What presses do to a gel: contact solved on the exact layer, motion of the layer or of a finer pad with its edges."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from structures.errors import NotIdentifiable

from .._arrays import Array, Mask
from .._closed.gridded import LayerGrid
from .._closed.layer import Layer
from .._closed.rigid_contact import RigidBody, RigidContact

if TYPE_CHECKING:
    from .._pad.pad import Pad

CELLS = 12  # of the grid through a thickness
STEPS = 2  # of a drag
SETTLED = 1e-3  # of gap and friction: what the forces then lack is less than that
WIDER = (1.3, 2.5)  # over the depth, up to which a body may touch a gel that bulges beside it
DEEPEST = (0.1, 0.3, 1.0)  # thicknesses, within which a force may press a body
MARGIN, ROUND = 3, 8  # nodes beside a contact; sides of windows are multiples of so many
Heights = Callable[[Array], Array]


@dataclass(frozen=True)
class Move:
    """How a body is pressed, dragged and turned: depth (m) or force (N), shift (m), turn (rad), about a place (m)."""

    at: tuple[float, float]
    depth: float | None
    force: float | None
    shift: tuple[float, float]
    turn: float
    friction: float


@dataclass(frozen=True, eq=False)
class Acting:
    """Tractions (ny, nx, 3) on the grid of a gel (Pa), and how deep the body went (m)."""

    tractions: Array
    depth: float


class Ground:
    """A layer as wide as a pad, on a grid.

    Parameters
    ----------
    layer : Layer
    size : (a, b)
        Sides of the pad (m).
    reach : float
        Half of the side that the grid must have at least (m): that of the farthest marker.
    pitch : float
        Of the grid (m).
    """

    def __init__(self, layer: Layer, size: tuple[float, float], reach: float, pitch: float) -> None:
        self.layer, self.size = layer, size
        half = [int(np.ceil(max(side / 2, reach) / pitch - 1e-9)) for side in size]
        self.grid = LayerGrid(layer, (2 * half[1] + 1, 2 * half[0] + 1), pitch)
        self._windows: dict[tuple[int, int], LayerGrid] = {}

    @cached_property
    def inside(self) -> Mask:
        """Nodes on the pad (ny, nx)."""
        return np.asarray(np.all(np.abs(self.grid.nodes) <= np.array(self.size) / 2 + 1e-12, axis=-1))

    def press(self, heights: Heights, move: Move) -> Acting:
        """What a body does that is pressed, dragged and turned.

        Raises
        ------
        NotIdentifiable
            It touches more than the pad, or the contact does not settle.
        """
        height = heights(self.grid.nodes)
        height = height - height.min()
        depth = move.depth
        reaches = [k * self.layer.h for k in DEEPEST] if depth is None else [k * depth for k in WIDER]
        for last, reach in enumerate(reaches, 1):
            try:
                return self._within(height, reach, move)
            except NotIdentifiable:
                if last == len(reaches):
                    raise
        raise AssertionError

    def _within(self, height: Array, reach: float, move: Move) -> Acting:
        rows, columns = self._box(height <= reach)
        part = (slice(*rows), slice(*columns))
        body = RigidBody(self._window(rows, columns), height[part], friction=move.friction, settled=SETTLED)
        found: RigidContact = (
            body.press(force=move.force) if move.depth is None else body.press(depth=move.depth)
        )  # fmt: skip
        if any(move.shift) or move.turn:
            middle = (self.grid.nodes[rows[0], columns[0]] + self.grid.nodes[rows[1] - 1, columns[1] - 1]) / 2
            arm = np.array(move.at) - middle
            shift = np.array(move.shift) + move.turn * np.array([arm[1], -arm[0]])
            found = found.drag((float(shift[0]), float(shift[1])), move.turn, STEPS)
        out = np.zeros((*self.grid.shape, 3))
        out[part] = found.tractions
        if np.any(found.touches & ~self.inside[part]):
            raise NotIdentifiable("the body touches more than the pad", advice="press nearer to its middle",
                                  code="LID-E306")  # fmt: skip
        return Acting(out, found.depth)

    def _box(self, near: Mask) -> tuple[tuple[int, int], tuple[int, int]]:
        """First row and column, and those behind the last, of a window about some nodes."""
        spans = []
        for axis, count in ((1, near.shape[0]), (0, near.shape[1])):
            there = np.flatnonzero(near.any(axis=axis))
            first, last = int(there[0]) - MARGIN, int(there[-1]) + 1 + MARGIN
            width = min(-(-(last - first) // ROUND) * ROUND, count)
            start = min(max((first + last - width) // 2, 0), count - width)
            spans.append((start, start + width))
        return spans[0], spans[1]

    def _window(self, rows: tuple[int, int], columns: tuple[int, int]) -> LayerGrid:
        shape = rows[1] - rows[0], columns[1] - columns[0]
        if shape not in self._windows:
            self._windows[shape] = self.grid.window(shape)
        return self._windows[shape]

    def motion(self, tractions: Array, points: Array, z: Array | None) -> Array:
        """Motion (n, 3) in m of points (n, 2), on the surface or at heights z (n,)."""
        if z is None:
            return self.grid.between(self.grid.displacements(tractions), points)
        out = np.empty((len(points), 3))
        for height in np.unique(z):
            here = z == height
            out[here] = self.grid.between(self.grid.displacements(tractions, float(height)), points[here])
        return out


class Edged:
    """A finer pad that moves instead of the layer, with its free edges.

    Parameters
    ----------
    pad : Pad
    ground : Ground
        On which its contacts are solved.
    points : sequence of array (n, 2 or 3)
        Whose motion is asked for.
    """

    def __init__(self, pad: Pad, ground: Ground, points: Sequence[Array]) -> None:
        self.pad = pad
        self._loads = spread_over(pad, ground)
        self._rows = [pad.from_surface(one) for one in points]

    def motion(self, forces: Array) -> list[Array]:
        """Motion of each group of points under forces on the nodes of the ground (ny, nx, 3) in N."""
        nodal = self._loads @ forces.reshape(-1, 3)
        moved = self.pad.displacements(nodal).ravel()
        return [np.asarray(rows @ moved).reshape(-1, 3) for rows in self._rows]


def spread_over(pad: Pad, ground: Ground) -> Any:
    """Consistent nodal forces (P, nodes of the ground) of unit forces there, sparse: sums and moments are kept."""
    from scipy import sparse

    inside = ground.inside.ravel()
    rows = sparse.csr_array(pad.from_surface(ground.grid.nodes.reshape(-1, 2)[inside]))
    found = rows[::3][:, ::3].T.tocoo()
    columns = np.flatnonzero(inside)[found.col]
    return sparse.csr_array((found.data, (found.row, columns)), shape=(pad.points, inside.size))
