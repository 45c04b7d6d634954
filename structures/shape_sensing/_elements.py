"""What an inverse element model asks of a structure: rows of gauges, and strains at points all over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._channels import Dof
from .._elements.beams import BeamField
from .._elements.framefield import FrameField
from .._elements.plates import PlateField
from .._system.sensors import Sensor, StrainGauge
from .._system.structure import Structure
from ..errors import InputError, frozen, one_of, positive, shown
from . import _quads as quads

Array = NDArray[np.float64]
AXES = (3, -5, 4, 1, 2)  # w, w_x, w_y, u, v
THEORIES = ("kirchhoff", "mindlin")


@dataclass(frozen=True, eq=False)
class Sampled:
    """Strains of the surface at points all over a structure, however the gauges lie.

    Parameters
    ----------
    strains : sparse array, shape (rows, n)
        Strains of the outer fibre, three rows a point on a plate, and where the theory has it, shear.
    bends : sparse array, shape (others, rows)
        Each strain at each point, less the linear field through the elements around it.
    """

    strains: sparse.csr_array
    bends: sparse.csr_array


class QuadPlate:
    """A flat plate of four-node elements of any shape, for shape sensing; no stiffness and no mass are asked.

    Parameters
    ----------
    nodes : array, shape (nodes, 2)
        x, y in m.
    cells : array of int, shape (elements, 4)
        Corners of each element, counter-clockwise.
    thickness : float
        m.
    theory : {"kirchhoff", "mindlin"}
        Thin, or with shear.
    supports : sequence of Dof or str
        Held DOFs: ``"12+Z"``, ``"12-RY"`` (w_x), ``"12+RX"`` (w_y), ``"12+X"``, ``"12+Y"``.
    membrane : bool
        The mid-plane stretches too: gauges on both faces (or in threes) are needed to tell it from bending.

    Raises
    ------
    InputError
        Elements that are turned over, concave or of no area, nodes that do not exist, unknown supports.
    """

    def __init__(
        self,
        nodes: ArrayLike,
        cells: ArrayLike,
        thickness: float,
        *,
        theory: str = "kirchhoff",
        supports: Sequence[Any] = (),
        membrane: bool = False,
    ) -> None:
        self.nodes, self.thickness = (
            frozen(nodes, "nodes"),
            positive("thickness", thickness, where="QuadPlate", unit="m"),
        )
        table = np.asarray(cells)
        if (
            self.nodes.ndim != 2
            or self.nodes.shape[1] != 2
            or table.ndim != 2
            or table.shape[1:] != (4,)
            or (table.dtype.kind not in "iu" or table.min() < 0 or table.max() >= len(self.nodes))
        ):
            raise InputError(
                "no mesh of quadrilaterals",
                where="QuadPlate",
                found=f"nodes {self.nodes.shape}, cells {table.shape}",
                expected="nodes (n, 2) in m and cells (elements, 4) of their numbers",
                hint="QuadPlate.rectangle makes a regular one",
            )
        self.cells = np.array(table, np.intp)
        self.theory = one_of("unknown theory of plates", theory, THEORIES, where="QuadPlate")
        self.membrane = bool(membrane)
        self._upright()
        axes = AXES if membrane else AXES[:3]
        self.dofs = tuple(Dof(k, axis) for k in range(len(self.nodes)) for axis in axes)
        index = {(dof.node, dof.axis): i for i, dof in enumerate(self.dofs)}
        held = [Dof.parse(one) for one in supports]
        lost = [str(one) for one in held if (one.node, one.axis) not in index]
        if lost:
            raise InputError(
                "unknown supports",
                where="QuadPlate",
                found=lost[:8],
                expected=f"DOFs of {len(self.nodes)} nodes: +Z, -RY, +RX" + (", +X, +Y" if membrane else ""),
            )
        self.free = np.ones(len(self.dofs), bool)
        self.free[[index[one.node, one.axis] for one in held]] = False

    @classmethod
    def rectangle(
        cls,
        lengths: tuple[float, float],
        elements: tuple[int, int],
        thickness: float,
        *,
        edges: str = "SSSS",
        theory: str = "kirchhoff",
        membrane: bool = False,
    ) -> QuadPlate:
        """A regular mesh; `edges` as in `plates.plate`: S, C or F for x = 0, y = 0, x = a, y = b.

        Raises
        ------
        InputError
            As the constructor, or unknown letters.
        """
        if not isinstance(edges, str) or len(edges) != 4 or set(edges) - set("SCF"):
            raise InputError("unknown edges", where="QuadPlate", found=shown(edges), expected="four letters S, C or F")
        nx, ny = elements
        x, y = np.linspace(0, lengths[0], nx + 1), np.linspace(0, lengths[1], ny + 1)
        nodes = np.column_stack([np.tile(x, ny + 1), np.repeat(y, nx + 1)])
        number = np.arange(len(nodes)).reshape(ny + 1, nx + 1)
        cells = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
        held: list[tuple[int, int]] = []
        sides = (number[:, 0], number[0], number[:, -1], number[-1])
        for kind, line, slope in zip(edges, sides, (4, -5, 4, -5), strict=True):
            axes = {"S": (3, slope), "C": (3, -5, 4), "F": ()}[kind]
            held += [(int(k), axis) for k in line for axis in axes]
        if membrane:  # the mid-plane as a whole does not move
            held += [(0, 1), (0, 2), (int(number[0, -1]), 2)]
        return cls(nodes, cells, thickness, theory=theory, supports=held, membrane=membrane)

    def row(self, sensor: Sensor) -> Array:
        """Row (n,) of a strain gauge, or of the deflection (direction +Z) at a point.

        Raises
        ------
        InputError
            If the point lies outside the plate, or the sensor reads something else.
        """
        at = getattr(sensor, "at", None)
        if at is None or np.size(at) != 2 or sensor.derivative:
            raise InputError(
                "the sensor reads no strain and no deflection of a plate",
                where=f"sensor {sensor.label}",
                found=sensor.quantity,
                expected="StrainGauge(at=(x, y), fibre=) or Displacement(at=(x, y))",
            )
        cell, place = self._found(np.asarray(at, float), sensor.label)
        if not isinstance(sensor, StrainGauge):
            return self._spread(
                cell,
                np.insert(
                    quads.deflection(self.nodes[self.cells[cell]], *place).reshape(4, 3), [3, 3], 0.0, axis=1
                ).ravel(),
            )
        rows = quads.strains(self.nodes[self.cells[cell]], *place, self.theory)
        c, s = np.cos(sensor.angle), np.sin(sensor.angle)
        way = np.array([c * c, s * s, c * s])
        fibre = float(np.asarray(sensor.fibre).ravel()[-1])
        return self._spread(cell, way @ rows[quads.MEMBRANE] - fibre * (way @ rows[quads.BENDING]))

    def sampled(self) -> Sampled:
        """Strains at 2 x 2 points of each element."""
        shear = self.theory == "mindlin"
        kinds = [*range(3), *(range(3, 5) if shear else ()), *(range(5, 8) if self.membrane else ())]
        scale = np.where(np.arange(8) < 3, self.thickness / 2, 1.0)[kinds][:, None]
        width, count = (5 if self.membrane else 3), len(kinds)
        columns = (5 * np.arange(4)[:, None] + np.arange(width)).ravel()
        local = np.array(
            [
                scale
                * quads.strains(self.nodes[corners], float(place[0]), float(place[1]), self.theory)[kinds][:, columns]
                for corners in self.cells
                for place in quads.POINTS
            ]
        )
        dofs = (width * self.cells[:, :, None] + np.arange(width)).reshape(len(self.cells), -1)
        owner = np.repeat(np.arange(len(self.cells)), 4)
        i = np.broadcast_to(np.arange(len(local) * count).reshape(len(local), count, 1), local.shape)
        j = np.broadcast_to(dofs[owner][:, None, :], local.shape)
        strains = sparse.coo_array((local.ravel(), (i.ravel(), j.ravel())), shape=(len(local) * count, len(self.dofs)))
        places = np.array([quads.bilinear(*place)[0] for place in quads.POINTS]) @ self.nodes[self.cells]
        return Sampled(strains.tocsr(), bends(places.reshape(-1, 2), owner, self._around(), count))

    # -- inside ---------------------------------------------------------------------------------------------------
    def _upright(self) -> None:
        d = np.roll(self.nodes[self.cells], -1, axis=1) - self.nodes[self.cells]
        turn = d[:, :, 0] * np.roll(d, -1, axis=1)[:, :, 1] - d[:, :, 1] * np.roll(d, -1, axis=1)[:, :, 0]
        bad = np.flatnonzero(np.min(turn, axis=1) <= 1e-9 * np.max(np.abs(turn)))
        if len(bad):
            raise InputError(
                "elements of no or negative area, or concave ones",
                where="QuadPlate",
                found=f"cells {bad[:8].tolist()}",
                expected="convex, counter-clockwise",
                hint="turn the order of their corners, or repair the mesh",
            )

    def _found(self, point: Array, label: str) -> tuple[int, tuple[float, float]]:
        boxes = self.nodes[self.cells]
        slack = 1e-9 * np.ptp(self.nodes)
        near = np.all((point >= boxes.min(axis=1) - slack) & (point <= boxes.max(axis=1) + slack), axis=1)
        for cell in np.flatnonzero(near):
            if (at := quads.natural(boxes[cell], point)) is not None:
                return int(cell), (float(at[0]), float(at[1]))
        low, high = self.nodes.min(axis=0), self.nodes.max(axis=0)
        raise InputError(
            "the gauge lies outside the plate",
            where=f"sensor {label}",
            found=f"x = {point[0]:.6g}, y = {point[1]:.6g}",
            expected=f"a point of the plate: x {low[0]:.6g} to {high[0]:.6g}, y {low[1]:.6g} to {high[1]:.6g} m",
            hint="places are in metres, in the frame of the nodes",
        )

    def _spread(self, cell: int, row: Array) -> Array:
        width = 5 if self.membrane else 3
        out = np.zeros(len(self.dofs))
        for k, node in enumerate(self.cells[cell]):
            out[width * node : width * (node + 1)] = row[5 * k : 5 * k + width]
        return out

    def _around(self) -> list[NDArray[np.intp]]:
        """Elements that share a node with each element, itself among them."""
        at: list[set[int]] = [set() for _ in self.nodes]
        for cell, corners in enumerate(self.cells):
            for node in corners:
                at[node].add(cell)
        return [np.array(sorted(set().union(*(at[node] for node in corners)))) for corners in self.cells]


def bends(places: Array, owner: NDArray[np.intp], around: Sequence[NDArray[np.intp]], count: int) -> sparse.csr_array:
    """Strains at points less the linear field through the means of the elements around theirs.

    Parameters
    ----------
    places : array, shape (points, dim)
    owner : array of int, shape (points,)
        Element of each point.
    around : sequence of array of int
        Elements around each element, itself among them.
    count : int
        Strains at each point.
    """
    points, cells = len(places), len(around)
    mean = sparse.csr_array((1 / np.bincount(owner)[owner], (owner, np.arange(points))), shape=(cells, points))
    middle = mean @ places
    i, j, w = [], [], []
    for cell, patch in enumerate(around):
        mine = np.flatnonzero(owner == cell)
        basis = np.column_stack([np.ones(len(patch)), middle[patch] - middle[cell]])
        fit = np.linalg.lstsq(basis, np.eye(len(patch)), rcond=1e-9)[0]
        weights = np.column_stack([np.ones(len(mine)), places[mine] - middle[cell]]) @ fit
        i.append(np.repeat(mine, len(patch)))
        j.append(np.tile(patch, len(mine)))
        w.append(weights.ravel())
    linear = sparse.csr_array((np.concatenate(w), (np.concatenate(i), np.concatenate(j))), shape=(points, cells))
    one = sparse.eye_array(points) - linear @ mean
    return sparse.csr_array(sparse.kron(one, sparse.eye_array(count), format="csr"))


@dataclass(frozen=True, eq=False)
class Placed:
    """A beam, rectangular plate or frame of the package, asked for what `QuadPlate` answers."""

    structure: Structure

    @property
    def dofs(self) -> tuple[Dof, ...]:
        """The DOF table."""
        return self.structure.dofs

    @property
    def free(self) -> NDArray[np.bool_]:
        """DOFs that are not held."""
        free = np.zeros(self.structure.n, bool)
        free[self.structure.free] = True
        return free

    def row(self, sensor: Sensor) -> Array:
        """Row (n,) of a gauge or of a displacement."""
        if sensor.derivative:
            raise InputError(
                "shape sensing takes strains and displacements",
                where=f"sensor {sensor.label}",
                found=sensor.quantity,
                expected="StrainGauge or Displacement",
            )
        return sensor.row(self.structure)

    def sampled(self) -> Sampled:
        """Strains of outer fibres between the nodes."""
        field = self.structure.field
        if isinstance(field, PlateField):
            return _of_plate(field)
        if isinstance(field, BeamField):
            return _of_line(field)
        assert isinstance(field, FrameField)
        return _of_frame(field)


def elements_of(model: Any) -> QuadPlate | Placed:
    """A mesh of quadrilaterals, or a structure whose strains between the nodes are known.

    Raises
    ------
    InputError
        For anything else.
    """
    if isinstance(model, QuadPlate):
        return model
    if isinstance(model, Structure) and isinstance(model.field, PlateField | BeamField | FrameField):
        return Placed(model)
    raise InputError(
        "shape sensing needs strains between the nodes",
        where="InverseFEM",
        found=type(model).__name__,
        expected="a beam, a rectangular plate or a frame of structures, or a QuadPlate",
        hint="QuadPlate(nodes, cells, thickness) takes any flat mesh of quadrilaterals",
    )


def _between(line: Any) -> Array:
    """Two points in each element (Gauss's)."""
    inside = np.array([0.5 - 0.5 / np.sqrt(3), 0.5 + 0.5 / np.sqrt(3)])
    return np.asarray(line.origin + line.h * (np.arange(line.elements)[:, None] + inside).ravel(), float)


def _in_row(elements: int, first: int = 0) -> list[NDArray[np.intp]]:
    """Elements of a line that touch each of them."""
    return [first + np.arange(max(k - 1, 0), min(k + 2, elements)) for k in range(elements)]


def _of_line(field: BeamField) -> Sampled:
    outer, places = field.outer or 1.0, _between(field.line)
    rows = np.array([field.strain(x, outer, 0.0, None) for x in places])
    owner = np.repeat(np.arange(field.line.elements), 2)
    return Sampled(sparse.csr_array(rows), bends(places[:, None], owner, _in_row(field.line.elements), 1))


def _of_plate(field: PlateField) -> Sampled:
    x, y = _between(field.x), _between(field.y)
    X, Y = (
        [sparse.csr_array(np.array([line.row(v, k) for v in at])) for k in range(3)]
        for line, at in ((field.x, x), (field.y, y))
    )
    parts = [sparse.kron(Y[0], X[2]), sparse.kron(Y[2], X[0]), 2 * sparse.kron(Y[1], X[1])]
    count, nx, ny = len(x) * len(y), field.x.elements, field.y.elements
    strains = -(field.outer or 1.0) * sparse.csr_array(sparse.vstack(parts))[:, field.order]
    by_point = np.arange(3 * count).reshape(3, count).T.ravel()
    places = np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])
    owner = (np.repeat(np.arange(ny), 2)[:, None] * nx + np.repeat(np.arange(nx), 2)).ravel()
    around = [(row[:, None] * nx + column).ravel() for row in _in_row(ny) for column in _in_row(nx)]
    return Sampled(sparse.csr_array(strains[by_point]), bends(places, owner, around, 3))


def _of_frame(field: FrameField) -> Sampled:
    rows: list[Array] = []
    places: list[Array] = []
    owner: list[NDArray[np.intp]] = []
    around: list[NDArray[np.intp]] = []
    for k, piece in enumerate(field.pieces):
        section, at = piece.element.section, _between(piece.line)
        high, wide = section.c, section.c_y or section.c
        fibres: list[Any] = [high, -high] if field.plane else [(wide, high), (-wide, high), (wide, -high)]
        strains = [[field.strain((k, s), fibre, 0.0, None) for fibre in fibres] for s in at]
        if not field.plane:  # gauges along a member do not see it turn: its rate is held even
            turn = [piece.axes[0] @ np.array([field.motion((k, s), axis) for axis in (4, 5, 6)]) for s in at]
            for i, one in enumerate(strains):
                j = min(i, len(at) - 2)
                one.append(high * (turn[j + 1] - turn[j]) / (at[j + 1] - at[j]))
        rows += [row for one in strains for row in one]
        owner.append(len(around) + np.repeat(np.arange(piece.line.elements), 2))
        around += _in_row(piece.line.elements, len(around))
        places.append(at)
    where, count = np.concatenate(places)[:, None], len(rows) // sum(map(len, places))
    return Sampled(sparse.csr_array(np.array(rows)), bends(where, np.concatenate(owner), around, count))
