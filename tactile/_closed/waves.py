"""A layer under waves of traction on a periodic grid: its motion by products, at nodes or at scattered points.

The tractions are band-limited: every wave that the grid carries, and none beyond. Grids have odd sides, so that no wave
is its own mirror image. Motion is as band-limited as the tractions; between nodes it is interpolated by gridding: with
the transform of a Kaiser-Bessel window taken off the waves, a short sum over a grid twice as fine is exact to
`GRIDDING` of the largest motion (J. Fessler & B. Sutton, IEEE Trans. Signal Processing 51 (2003) 560).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, reals

from .._arrays import PITCH, Array, Index
from .layer import Layer

Waved = NDArray[np.complex128]
WINDOW = 8  # nodes of the fine grid, along each axis, that a point takes its motion from
BETA = 2.34 * WINDOW  # shape of the window for a grid twice as fine
GRIDDING = 1e-6  # error of an interpolated motion, over the largest
FACTORS = (3, 5, 7, 11)
RING = 4.0  # thicknesses of the layer between a map and its periodic image
ON_NODES = 1e-6  # of the pitch: places so near to a lattice are on it
LARGEST = 4096  # nodes along a side


def odd_length(least: int) -> int:
    """Smallest odd number from `least` on whose transform is fast."""
    n = least | 1
    while True:
        rest = n
        for factor in FACTORS:
            while rest % factor == 0:
                rest //= factor
        if rest == 1:
            return n
        n += 2


@dataclass(frozen=True, eq=False)
class Waves:
    """Waves of traction on a layer, on a periodic grid of ``shape`` (ny, nx) nodes, both odd.

    Fields are arrays (components, ny, nx), their waves (components, ny, nx // 2 + 1): half of those of a real field.

    Parameters
    ----------
    layer : Layer
    shape : (ny, nx)
    pitch : (dy, dx)
        Distance of the nodes (m).
    z : float
        Height at which motion is seen (m).
    """

    layer: Layer
    shape: tuple[int, int]
    pitch: tuple[float, float]
    z: float

    @cached_property
    def numbers(self) -> tuple[Array, Array]:
        """Wave numbers kx (1, nx // 2 + 1) and ky (ny, 1) in rad/m."""
        (ny, nx), (dy, dx) = self.shape, self.pitch
        kx, ky = np.fft.rfftfreq(nx, dx), np.fft.fftfreq(ny, dy)
        return np.asarray(2 * np.pi * kx)[None, :], np.asarray(2 * np.pi * ky)[:, None]

    @cached_property
    def symbol(self) -> Waved:
        """Motion X, Y, Z (m) per wave of traction X, Y, Z (Pa), (3, 3, ny, nx // 2 + 1)."""
        found = self.layer.interior(*self.numbers, None if self.z == self.layer.h else self.z)
        return np.ascontiguousarray(np.moveaxis(found, (-2, -1), (0, 1)))

    @cached_property
    def counts(self) -> Array:
        """How many waves of a real field each of the half stands for, (1, nx // 2 + 1)."""
        found = np.full((1, self.shape[1] // 2 + 1), 2.0)
        found[:, 0] = 1.0
        return found

    def waves(self, field: Array) -> Waved:
        """Waves of a field (components, <= ny, <= nx), zero beyond its nodes; orthonormal."""
        from scipy.fft import rfft2

        return np.asarray(rfft2(field, s=self.shape, norm="ortho"))

    def field(self, waves: Waved) -> Array:
        """Field (components, ny, nx) of its waves."""
        from scipy.fft import irfft2

        return np.asarray(irfft2(waves, s=self.shape, norm="ortho"))

    def held(self, field: Array) -> Array:
        """A field (components, <= ny, <= nx) on all nodes: held at its edges, and let down to zero in half the ring.

        Motion that ends at the edge of a window would ask for loads along it; let down slowly, for little beyond it.
        """
        for axis, whole in ((1, self.shape[0]), (2, self.shape[1])):
            count = field.shape[axis]
            after = (whole - count + 1) // 2
            beyond = np.arange(whole) - count + 1
            beyond = np.where(beyond <= after, np.maximum(beyond, 0), whole - np.arange(whole))
            weight = 0.5 + 0.5 * np.cos(np.pi * np.minimum(beyond / (after + 0.5), 1.0))
            nearest = np.where(np.arange(whole) < count + after, np.minimum(np.arange(whole), count - 1), 0)
            field = np.take(field, nearest, axis) * weight.reshape(-1, *[1] * (2 - axis))
        return field

    def gridding(self, points: Array) -> Gridding:
        """Motion of points (n, 2), in nodes (y, x) from the first one."""
        return Gridding.of(self, points)


@dataclass(frozen=True, eq=False)
class Gridding:
    """Values of a band-limited field at points: `weights` (points, fine nodes) after `undo` was taken off its waves."""

    owner: Waves
    fine: tuple[int, int]
    weights: Any
    undo: Array

    @classmethod
    def of(cls, owner: Waves, points: Array) -> Gridding:
        """For points (n, 2) in nodes (y, x)."""
        from scipy.sparse import csr_array

        fine = (2 * owner.shape[0], 2 * owner.shape[1])
        at = [_taps(2 * points[:, k], fine[k]) for k in range(2)]
        columns = at[0][0][:, :, None] * fine[1] + at[1][0][:, None, :]
        values = at[0][1][:, :, None] * at[1][1][:, None, :]
        rows = np.arange(0, values.size + 1, WINDOW**2)
        weights = csr_array((values.ravel(), columns.ravel(), rows), shape=(len(points), fine[0] * fine[1]))
        half = _window_wave(np.fft.rfftfreq(owner.shape[1]) / 2)
        whole = _window_wave(np.fft.fftfreq(owner.shape[0]) / 2)
        return cls(owner, fine, weights, 1 / np.multiply.outer(whole, half))

    def __call__(self, waves: Waved) -> Array:
        """Values (components, points) of the field of these waves."""
        from scipy.fft import irfft2

        (ny, nx), split = self.owner.shape, self.owner.shape[0] // 2 + 1
        wide = np.zeros((len(waves), self.fine[0], self.fine[1] // 2 + 1), complex)
        taken = waves * self.undo
        wide[:, :split, : nx // 2 + 1] = taken[:, :split]
        wide[:, split - ny :, : nx // 2 + 1] = taken[:, split:]
        field = irfft2(wide, s=self.fine, norm="forward").reshape(len(waves), -1) / np.sqrt(ny * nx)
        return np.asarray((self.weights @ field.T).T)

    def adjoint(self, values: Array) -> Waved:
        """Waves of the field whose product with any other is that of `values` (components, points) at the points."""
        from scipy.fft import rfft2

        (ny, nx), split = self.owner.shape, self.owner.shape[0] // 2 + 1
        field = np.asarray((self.weights.T @ values.T).T).reshape(len(values), *self.fine)
        wide = rfft2(field) / np.sqrt(ny * nx)
        kept = np.concatenate([wide[:, :split], wide[:, split - ny :]], axis=1)[..., : nx // 2 + 1]
        return np.asarray(kept * self.undo)


def _taps(places: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Nodes (points, WINDOW) of a periodic fine line about places, and the window at them."""
    first = np.ceil(places - WINDOW / 2).astype(np.intp)
    nodes = first[:, None] + np.arange(WINDOW)
    share = np.clip(1 - (2 * (nodes - places[:, None]) / WINDOW) ** 2, 0.0, None)
    from scipy.special import i0

    return nodes % count, i0(BETA * np.sqrt(share))


def _window_wave(frequency: Array) -> Array:
    """Transform of the window at frequencies in waves per fine node."""
    root = np.sqrt(BETA**2 - (np.pi * WINDOW * frequency) ** 2)
    return np.asarray(WINDOW * np.sinh(root) / root)


@dataclass(frozen=True, eq=False)
class Lattice:
    """The nodes of the map and what is seen on them: `origin` (x, y) of the first node, `pitch` (dx, dy), m.

    `places` (N, 2) are the markers in nodes (y, x), `box` (ny, nx) the nodes that hold them and the frame, `loaded` the
    slices of `box` that the map covers. `order` (N,) numbers the nodes of markers that fill a rectangle; else None.
    """

    origin: Array
    pitch: Array
    places: Array
    box: tuple[int, int]
    loaded: tuple[slice, slice]
    order: Index | None

    @classmethod
    def of(cls, points: Array, pitch: float | None, frame: Sequence[float] | None) -> Lattice:
        """Of markers (N, 2); a pitch of None is theirs."""
        low, steps = points.min(axis=0), None if pitch else _even(points)
        if steps is None:
            step = pitch or float(np.sqrt(np.prod(np.ptp(points, axis=0)) / len(points)))
            steps = np.full(2, PITCH.positive("the pitch", step, where="LayerSensor"))
        nodes = (points - low) / steps
        first, last = np.zeros(2), np.ceil(nodes.max(axis=0) - ON_NODES)
        inner = (first, last)
        if frame is not None:
            corners = (_frame(frame).reshape(2, 2) - low) / steps
            inner = np.ceil(corners[0] - ON_NODES), np.floor(corners[1] + ON_NODES)
            if np.any(inner[1] < inner[0]):
                raise InputError("no node in the frame", where="LayerSensor, frame", found=list(frame),
                                 expected=f"x0, y0, x1, y1 in m, at a pitch of {steps.max():.3g}")  # fmt: skip
            first, last = np.minimum(first, inner[0]), np.maximum(last, inner[1])
        count = (last - first + 1).astype(int)
        if count.max() > LARGEST:
            raise InputError("too many nodes", where="LayerSensor, pitch", found=f"{count[0]} x {count[1]}",
                             expected=f"at most {LARGEST} along a side", hint="pitch is in m")  # fmt: skip
        at = nodes - first
        x, y = (slice(int(a), int(b) + 1) for a, b in np.transpose(np.array(inner) - first))
        order = None
        if np.all(np.abs(at - np.round(at)) < ON_NODES):
            order = np.asarray(np.round(at[:, 1]) * count[0] + np.round(at[:, 0]), np.intp)
            order = None if len(np.unique(order)) < len(order) else order
        return cls(low + first * steps, steps, at[:, ::-1], (int(count[1]), int(count[0])), (y, x), order)

    @property
    def full(self) -> bool:
        """Whether markers are on all nodes, and all may be loaded."""
        return self.order is not None and len(self.order) == np.prod(self.box) == np.prod(self.shape)

    @property
    def shape(self) -> tuple[int, int]:
        """Nodes of the map (ny, nx)."""
        y, x = self.loaded
        return y.stop - y.start, x.stop - x.start

    def waves(self, layer: Layer, z: float) -> Waves:
        """Waves on the nodes and a ring."""
        dx, dy = self.pitch
        shape = (odd_length(n + int(np.ceil(RING * layer.h / d))) for n, d in zip(self.box, (dy, dx), strict=True))
        ny, nx = shape
        return Waves(layer, (ny, nx), (dy, dx), z)

    def nodes(self, z: float) -> Array:
        """Places of the nodes of the map (P, 3), row by row."""
        y, x = (np.arange(s.start, s.stop) * d + o for s, d, o in
                zip(self.loaded, self.pitch[::-1], self.origin[::-1], strict=True))  # fmt: skip
        X, Y = np.meshgrid(x, y)
        return np.column_stack([X.ravel(), Y.ravel(), np.full(X.size, z)])


def _even(points: Array) -> Array | None:
    """Pitch (dx, dy) of points (n, 2) that fill a rectangle of even pitch, in any order; None of others."""
    found = np.zeros(2)
    count = 1
    for k, values in enumerate(points.T):
        size = np.ptp(values)
        lines = np.unique(np.round((values - values.min()) / (size or 1.0) / ON_NODES) * ON_NODES)
        if len(lines) < 2:
            return None
        steps = np.round((values - values.min()) / size * (len(lines) - 1))
        if np.abs((values - values.min()) / size * (len(lines) - 1) - steps).max() > ON_NODES * len(lines):
            return None
        found[k], count = size / (len(lines) - 1), count * len(lines)
    return found if count == len(points) else None


def _frame(frame: Any) -> Array:
    found = reals(frame, where="LayerSensor, frame")
    if found.shape != (4,) or not np.isfinite(found).all() or np.any(found[:2] >= found[2:]):
        raise InputError("no frame", where="LayerSensor, frame", found=frame, expected="x0 < x1 and y0 < y1 in m: "
                         "(x0, y0, x1, y1)")  # fmt: skip
    return found
