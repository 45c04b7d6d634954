"""What lies between the rings of a circular plate: rows at a place (x, y) from the amplitudes of the harmonics."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import direction_label
from .._system import fields
from .._system.fields import Line, Span, gauss, shape
from ..errors import InputError

CENTRE = 1e-9  # of an element length: the limit at the centre is taken here
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CircularField:
    """What lies between the rings of a circular plate.

    Parameters
    ----------
    line : Line
        The division of the radius, from the inner edge (or the centre) to the rim.
    harmonics : int
        Highest circumferential order.
    centre : (x0, y0)
        Centre of the plate (m).
    outer : float
        Half the thickness (m).
    """

    line: Line
    harmonics: int
    centre: tuple[float, float]
    outer: float

    @property
    def full(self) -> bool:
        """Whether the plate has a centre."""
        return self.line.origin == 0.0

    @property
    def families(self) -> int:
        """Number of harmonics, cosines and sines apart."""
        return 2 * self.harmonics + 1

    @cached_property
    def _orders(self) -> NDArray[np.intp]:
        """Circumferential order of every family."""
        return (np.arange(self.families) + 1) // 2

    @cached_property
    def kept(self) -> NDArray[np.intp]:
        """Positions, family by family, of the unknowns that are DOFs: all but those that the centre cannot have."""
        keep = np.ones((self.families, self.line.size), bool)
        if self.full:
            keep[0, 1] = False
            keep[1:3, 0] = False
            keep[3:, :2] = False
        return np.flatnonzero(keep)

    def _polar(self, at: ArrayLike) -> tuple[float, float]:
        x, y = fields.point(at, ("x", "y"))
        dx, dy = x - self.centre[0], y - self.centre[1]
        r = math.hypot(dx, dy)
        # a point on a ring is rounded in x and y, more than the line forgives of r
        slack = 1e-12 * self.line.h + 4 * np.finfo(float).eps * (abs(x) + abs(y))
        ring = float(self.line.nodes[self._ring(r)])
        return ring if abs(r - ring) <= slack else r, math.atan2(dy, dx)

    def _angular(self, theta: float, order: int = 0) -> Array:
        """1, cos theta, sin theta, ... or their derivative of `order` 0, 1, 2; (families,)."""
        n = self._orders[1::2]
        turn = n * theta + order * np.pi / 2  # every derivative turns by a quarter
        out = np.zeros(self.families)
        out[0] = order == 0
        out[1::2], out[2::2] = n**order * np.cos(turn), n**order * np.sin(turn)
        return out

    def _row(self, radial: Array, angular: Array) -> Array:
        """Row of all DOFs from a row along the radius, the same for all harmonics, and the factors of these."""
        return np.outer(angular, radial).ravel()[self.kept]

    def _gradient(self, r: float, theta: float, c: float, s: float) -> Array:
        """Row of the slope along (c, s); r = 0 is a limit that all directions share."""
        r = max(r, CENTRE * self.line.h) if self.full else r
        along, across = c * math.cos(theta) + s * math.sin(theta), s * math.cos(theta) - c * math.sin(theta)
        return along * self._row(self.line.row(r, 1), self._angular(theta)) + across / r * self._row(
            self.line.row(r), self._angular(theta, 1)
        )

    def motion(self, at: ArrayLike, axis: int) -> Array:
        """Row of the deflection (Z) or a rotation (RX = w_y, RY = -w_x) at (x, y)."""
        r, theta = self._polar(at)
        if axis not in (3, 4, 5):
            _refuse("a plate moves along Z and turns about X and Y", direction_label(axis), "+Z, +RX or +RY")
        if axis == 3:
            return self._row(self.line.row(r), self._angular(theta))
        return self._gradient(r, theta, 0.0, 1.0) if axis == 4 else self._gradient(r, theta, -1.0, 0.0)

    def strain(self, at: ArrayLike, fibre: Any, angle: float, length: float | None) -> Array:
        """Row of the strain -z w_ss along s at `angle` from X, at z = `fibre`; or its mean over a gauge of `length`."""
        fields.within(fibre, self.outer)
        if length is not None:
            c, s = math.cos(angle), math.sin(angle)
            # the gradient is continuous: the mean of w_ss is the difference of w_s at the ends
            x, y = fields.point(at, ("x", "y"))
            ends = [self._polar((x + k * c * length / 2, y + k * s * length / 2)) for k in (1, -1)]
            rows = [self._gradient(r, theta, c, s) for r, theta in ends]
            return np.asarray(-fibre * (rows[0] - rows[1]) / length)
        r, theta = self._polar(at)
        if self.full and r < CENTRE * self.line.h:
            # of all harmonics only r^2 and r^2 cos 2 theta curve at the centre
            order = self._orders
            bend = np.where(order == 0, 1.0, np.where(order == 2, self._angular(angle), 0.0))
            return np.asarray(-fibre * self._row(self.line.row(0.0, 2), bend))
        c, s = math.cos(angle - theta), math.sin(angle - theta)
        w, slope = self.line.row(r), self.line.row(r, 1)
        none, once, twice = (self._angular(theta, order) for order in range(3))
        radial = self._row(self.line.row(r, 2), none)
        hoop = self._row(slope / r, none) + self._row(w / r**2, twice)
        twist = self._row(slope / r - w / r**2, once)
        return np.asarray(-fibre * (c * c * radial + s * s * hoop + 2 * c * s * twist))

    # -- regions --------------------------------------------------------------------------------------------------
    def resultant(self, region: tuple[Span, ...]) -> Array:
        """Refuses: a rectangle does not fit a round plate."""
        _refuse(
            "a circular plate takes pressure on rings and sectors", "a rectangle", "circular.Pressure(radius=, angle=)"
        )

    def pressure(self, radius: Span, angle: Span) -> Array:
        """Row of the integral of w over the sector between two radii and two angles, partial elements included."""
        a, b = self.line.station(radius[0]), self.line.station(radius[1])
        radial, (points, weights) = np.zeros(self.line.size), gauss(3)  # r times a cubic
        for cell in range(int(a), min(math.ceil(b), self.line.elements)):
            lo, hi = max(a - cell, 0.0), min(b - cell, 1.0)
            for xi, weight in zip(lo + (hi - lo) * points, weights, strict=True):
                r = self.line.origin + (cell + xi) * self.line.h
                part = weight * (hi - lo) * self.line.h * r
                radial[2 * cell : 2 * cell + 4] += part * shape(float(xi), self.line.h)
        # the integral of cos n theta is 2 / n sin(n width / 2) cos(n middle): it does not cancel on a thin sector
        width, middle = angle[1] - angle[0], (angle[0] + angle[1]) / 2
        factor = width * np.sinc(self._orders * width / (2 * np.pi))
        return self._row(radial, factor * self._angular(middle))

    def box(self, node: int) -> tuple[Span, ...]:
        """Place of a node: where its harmonic is largest."""
        x, y = (float(v) for v in self.places(np.array([node]))[0])
        return (x, x), (y, y)

    def places(self, nodes: NDArray[np.intp]) -> Array:
        """Coordinates of nodes: on their ring, where their harmonic is largest, (nodes, 2)."""
        family, ring = np.divmod(nodes, self.line.elements + 1)
        order = (family + 1) // 2
        theta = np.where((family % 2 == 0) & (family > 0), np.pi / 2 / np.maximum(order, 1), 0.0)
        r = self.line.nodes[ring]
        return np.asarray(self.centre) + np.column_stack([r * np.cos(theta), r * np.sin(theta)])

    def near(self, region: tuple[Span, ...]) -> NDArray[np.intp]:
        """DOFs of the rings of elements that a rectangle ((x0, x1), (y0, y1)) shares."""
        spans = [(lo - o, hi - o) for (lo, hi), o in zip(region, self.centre, strict=True)]
        inner = math.hypot(*(max(lo, -hi, 0.0) for lo, hi in spans))
        outer = math.hypot(*(max(-lo, hi) for lo, hi in spans))
        first, last = self.line.origin, self.line.origin + self.line.length
        slack = 1e-9 * self.line.h  # rounding of a place on a ring
        r = [min(max(v, first), last) for v in (inner, outer)]
        rings = [float(self.line.nodes[self._ring(v)]) for v in r]
        cells = self.line.cells(*(k if abs(v - k) < slack else v for v, k in zip(r, rings, strict=True)))
        unknowns = np.arange(2 * cells.start, 2 * cells.stop + 2)
        return np.flatnonzero(np.isin(self.kept % self.line.size, unknowns))

    def _ring(self, r: float) -> int:
        """Nearest ring."""
        return min(max(round((r - self.line.origin) / self.line.h), 0), self.line.elements)

    def inside(self, at: ArrayLike) -> bool:
        """Whether (x, y) lies on the plate."""
        return self.line.inside(self._polar(at)[0])

    def rigid(self) -> dict[str, Array]:
        """Translation and two rotations about the centre."""
        rows = self.line.elements + 1
        flat, far = np.tile([1.0, 0.0], rows), 2 * (self.line.origin + self.line.length)
        tilt = np.column_stack([self.line.nodes / far, np.full(rows, 1 / far)]).ravel()
        unit = np.eye(3, self.families)
        return {
            "translation Z": self._row(flat, unit[0]),
            "rotation RX": self._row(tilt, unit[2]),
            "rotation RY": self._row(-tilt, unit[1]),
        }


def _refuse(what: str, found: str, expected: str) -> NoReturn:
    raise InputError(
        what,
        where="sensor or load on a circular plate",
        found=found,
        expected=expected,
        hint="the plate lies in X-Y; places are (x, y) in m",
    )
