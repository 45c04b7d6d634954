"""A layer on a regular grid: influence matrices without a mesh, motion and tractions by fast Fourier transforms.

The half-space answers in closed form for patches (`tactile._closed.halfspace`); a hat, bilinear over four cells, is the
mean of the patch over one cell. What the base of a layer takes from that is smooth, and short rules average it.

The mesh-free fast path. The motion is that of an infinite layer under the patches or hats that the grid stands for,
free of wrap-around; the way back is regularised.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable, integer, number, one_of, positive, reals

from .._arrays import PLANE, SPACE, Array, Mask, shaped
from .halfspace import point_forces, rectangle
from .layer import HalfSpace, Layer
from .presses import matrices, unit_point
from .profiles import drawn, gauss

SHAPES = ("patch", "hat")
BATCH = 200_000  # pairs of point and node at a time


def influence(
    ground: Layer | HalfSpace, points: ArrayLike, nodes: ArrayLike, pitch: float, shape: str = "patch"
) -> Array:
    """Motion of points per traction at the nodes of a grid (m/Pa), (3 m, 3 n), rows and columns point-major.

    Points (m, 2) lie on the surface, (m, 3) anywhere in the body; nodes are (n, 2) at a `pitch`, all in m. A unit
    traction covers the square cell about its node (``"patch"``), or falls linearly to zero at the next nodes
    (``"hat"``). Patches are exact to rounding on a half-space and to 3e-7 of the largest entry on the surface of a
    layer, hats to 1e-5.
    """
    points, nodes = (
        shaped(np.atleast_2d(reals(x, where=n)), *shapes, where=n, what=f"{n} must be finite rows of coordinates")
        for n, x, shapes in (("points", points, (PLANE, SPACE)), ("nodes", nodes, (PLANE,)))
    )
    pitch = positive("pitch", pitch, where="influence", unit="m")
    one_of("no shape of a traction", shape, SHAPES, where="shape")
    heights = points[:, 2] if points.shape[1] == 3 else np.full(len(points), ground.top)
    found = np.empty((len(points), 3, len(nodes), 3))
    step = max(1, BATCH // max(1, len(nodes)))
    for i in range(0, len(points), step):
        part = slice(i, i + step)
        offsets = points[part, None, :2] - nodes
        z = np.broadcast_to(heights[part, None], offsets.shape[:2])
        flat = _pairs(ground, offsets.reshape(-1, 2), z.ravel(), pitch, shape)
        found[part] = flat.reshape(*offsets.shape[:2], 3, 3).transpose(0, 2, 1, 3)
    return found.reshape(3 * len(points), 3 * len(nodes))


def _pairs(ground: Layer | HalfSpace, offsets: Array, z: Array, pitch: float, shape: str) -> Array:
    """Motion per traction of each pair of a point and a node, (pairs, 3, 3)."""
    half_space = ground.half_space if isinstance(ground, Layer) else ground
    sunk = np.column_stack([offsets, np.minimum(z - ground.top, 0.0)])
    found = rectangle(half_space, sunk, (pitch, pitch)) if shape == "patch" else _hats(half_space, sunk, pitch)
    if isinstance(ground, Layer):
        # the image of the load in the base lies h + z below the point
        share = pitch / (ground.h + float(np.min(z, initial=ground.h)))
        s, w = _rule(shape, 3 if share <= 0.26 else 5 if share <= 0.7 else 16)
        for i, wi in zip(s, w, strict=True):
            for j, wj in zip(s, w, strict=True):
                at = offsets - pitch * np.array([i, j])
                found += wi * wj * pitch**2 * matrices(unit_point(ground, np.hypot(*at.T), z), at)
    return found


def _rule(shape: str, n: int) -> tuple[Array, Array]:
    """Places and weights, in pitches, of the mean over a patch or over a hat."""
    x, w = gauss(n)
    if shape == "patch":
        return x - 0.5, w
    if n == 3:  # meets the moments of a hat up to the fifth
        return np.sqrt(0.4) * np.array([-1.0, 0.0, 1.0]), np.array([5.0, 14.0, 5.0]) / 24
    return np.concatenate([-x, x]), np.tile(w * (1 - x), 2)


def _hats(ground: HalfSpace, offsets: Array, pitch: float) -> Array:
    """Motion per hat on a half-space: by the distance with a fine, a coarse, or a rule over point forces."""
    far = np.sqrt((offsets**2).sum(axis=1)) / pitch
    found = np.empty((len(offsets), 3, 3))
    near, middle, rest = far < 3, (far >= 3) & (far < 6), far >= 6
    if near.any():
        # on a grid most pairs see the same few offsets
        unique, back = np.unique(np.round(offsets[near] / pitch, 9), axis=0, return_inverse=True)
        found[near] = _near_hats(ground, unique * pitch, pitch)[back.ravel()]
    rules: tuple[tuple[Mask, tuple[Array, Array], Callable[[Array], Array], float], ...] = (
        (middle, _rule("patch", 3), lambda at: rectangle(ground, at, (pitch, pitch)), 1.0),
        (rest, _rule("hat", 3), lambda at: point_forces(ground, at), pitch**2),
    )
    for here, (s, w), motion, area in rules:
        if here.any():
            found[here] = area * sum(
                wi * wj * motion(offsets[here] - pitch * np.array([i, j, 0.0]))
                for i, wi in zip(s, w, strict=True)
                for j, wj in zip(s, w, strict=True)
            )
    return found


def _near_hats(ground: HalfSpace, offsets: Array, pitch: float, nodes: int = 8) -> Array:
    """Mean of the patch over a cell, by rules drawn to the lines on which the point meets the edge of the patch."""
    t, dt = drawn(nodes)
    places, weights = [], []
    for c in offsets[:, :2].T / pitch:
        edge = np.clip(c - np.copysign(0.5, c), -0.5, 0.5)[:, None]
        places.append(np.hstack([-0.5 + t * (edge + 0.5), edge + t * (0.5 - edge)]))
        weights.append(np.hstack([dt * (edge + 0.5), dt * (0.5 - edge)]))
    total = np.zeros((len(offsets), 3, 3))
    for i in range(2 * nodes):
        at = np.repeat(offsets[:, None, :], 2 * nodes, axis=1)
        at[..., 0] -= pitch * places[0][:, i, None]
        at[..., 1] -= pitch * places[1]
        both = weights[0][:, i, None] * weights[1]
        total += np.einsum("pj,pjab->pab", both, rectangle(ground, at, (pitch, pitch)))
    return total


LIMIT = 4096
HEIGHTS = 8  # of points under the surface, whose transforms a grid keeps


@dataclass(frozen=True)
class LayerGrid:
    """A layer loaded on a square grid of ny x nx nodes, its middle at the origin.

    Parameters
    ----------
    layer : Layer
        The layer.
    shape : tuple of two ints
        Nodes along Y and along X.
    pitch : float
        Distance of neighbours (m); at most a quarter of what is to be resolved.
    load : {"patch", "hat"}
        What a traction at a node stands for: constant over its cell, or bilinear between nodes.

    Raises
    ------
    InputError
        If an argument is not possible.
    """

    layer: Layer
    shape: tuple[int, int]
    pitch: float
    load: str = field(default="patch", kw_only=True)

    def __post_init__(self) -> None:
        if not isinstance(self.layer, Layer):
            raise InputError("no layer", where="LayerGrid", found=type(self.layer).__name__, expected="a tactile Layer")
        ny, nx = (integer("nodes", n, where="LayerGrid", limit=LIMIT) for n in self.shape)
        object.__setattr__(self, "shape", (ny, nx))
        object.__setattr__(self, "pitch", positive("pitch", self.pitch, where="LayerGrid", unit="m"))
        one_of("no load of a grid", self.load, SHAPES, where="load")

    @cached_property
    def nodes(self) -> Array:
        """Places of the nodes (m), (ny, nx, 2)."""
        y, x = ((np.arange(n) - (n - 1) / 2) * self.pitch for n in self.shape)
        return np.stack(np.meshgrid(x, y), axis=-1)

    def displacements(self, tractions: ArrayLike, z: float | None = None) -> Array:
        """Motion (m) above or below each node, (ny, nx, 3), under tractions (ny, nx, 3) (Pa).

        Parameters
        ----------
        tractions : array_like, (ny, nx, 3)
            Traction on the layer at each node (Pa).
        z : float, optional
            Height of the points (m); None: on the surface.

        Raises
        ------
        InputError
            If the shapes do not fit or values are not finite.
        """
        height = None if z is None else number("z", z, where="displacements", unit="m")
        waves = np.einsum("yxij,yxj->yxi", self._at(height), self._padded(self._checked(tractions, "tractions")))
        return self._back(waves)

    def between(self, field: ArrayLike, points: ArrayLike) -> Array:
        """A field (ny, nx, 3) at the nodes at points (n, 2) between them, (n, 3), by cubic splines.

        Raises
        ------
        InputError
            If points lie outside the grid.
        """
        from scipy.ndimage import map_coordinates

        values = self._checked(field, "field")
        places = shaped(reals(points, where="points"), PLANE, where="points", what="points must be rows (x, y)")
        at = (places[:, ::-1] - self.nodes[0, 0, ::-1]) / self.pitch
        if np.any((at < -1e-9) | (at > np.subtract(self.shape, 1) + 1e-9)):
            raise InputError("points outside the grid", where="motion", found=f"{np.abs(places).max():.3g} m away",
                             expected="points between the nodes", hint="take a larger LayerGrid")  # fmt: skip
        return np.stack([map_coordinates(values[..., i], at.T, order=3, mode="nearest") for i in range(3)], axis=1)

    def window(self, shape: tuple[int, int]) -> LayerGrid:
        """A grid of fewer nodes on the same layer, which shares the influence of a node on the surface."""
        found = LayerGrid(self.layer, shape, self.pitch, load=self.load)
        if np.any(np.greater(found.shape, self.shape)):
            raise InputError("a window is no larger than its grid", where="window", found=str(found.shape),
                             expected=f"at most {self.shape}")  # fmt: skip
        found.__dict__["_quarter"] = self._quarter[: found.shape[0], : found.shape[1]]
        return found

    def along(self, axes: slice) -> Callable[[Array], Array]:
        """What gives the motion (ny, nx, axes) of the surface along some axes under tractions along them alone."""
        symbol = self._symbol[..., axes, axes]
        return lambda tractions: self._back(np.einsum("yxij,yxj->yxi", symbol, self._padded(tractions)))

    @cached_property
    def compliance(self) -> Array:
        """Largest motion of a wave of traction along X, Y and Z (m/Pa), (3,)."""
        return np.asarray(np.abs(np.einsum("yxii->yxi", self._symbol)).max(axis=(0, 1)))

    def tractions(self, displacements: ArrayLike, lam: float = 1e-3) -> Array:
        """Tractions (Pa), (ny, nx, 3), from the motion of the surface (ny, nx, 3) (m), regularised.

        Minimises norm(G t - u)^2 + (lam w1)^2 norm(t)^2 over tractions on the grid, w1 the largest compliance:
        Tikhonov with the identity. Conjugate gradients with the transform alone as preconditioner, which is exact
        away from the edge.

        Parameters
        ----------
        displacements : array_like, (ny, nx, 3)
            Motion of the nodes (m), all of it caused by tractions on the grid.
        lam : float
            Relative to the largest compliance; 0 leaves the inverse unregularised.

        Raises
        ------
        InputError
            If the shapes do not fit or lam is negative.
        NotIdentifiable
            If lam = 0 and a wave of traction does not move the surface, or if the iteration does not settle.
        """
        from scipy.sparse.linalg import LinearOperator, cg

        lam = number("lam", lam, where="tractions")
        if lam < 0:
            raise InputError("lam must not be negative", where="tractions", found=lam, expected="lam >= 0")
        w, V = self._principal
        top = float(w.max())
        share = float(w.min()) / top
        if lam == 0 and share <= 1e-10:
            raise _unseen(f"a wave of traction moves the surface by {share:.1e} of the largest motion")
        u = self._checked(displacements, "displacements") / top
        size = u.size

        def forward(t: Array) -> Array:
            return self.displacements(t.reshape(u.shape)) / top

        def posed(t: Array) -> Array:
            return forward(forward(t)).ravel() + lam**2 * t.ravel()

        def undone(t: Array) -> Array:
            waves = np.einsum("yxji,yxj->yxi", V.conj(), self._padded(t.reshape(u.shape)))
            waves /= (w / top) ** 2 + lam**2
            return self._back(np.einsum("yxij,yxj->yxi", V, waves)).ravel()

        found, left = cg(
            LinearOperator((size, size), matvec=posed, dtype=float),
            forward(u).ravel(),
            rtol=1e-11,
            maxiter=500,
            M=LinearOperator((size, size), matvec=undone, dtype=float),
        )
        if left:
            raise _unseen("the inversion on the grid did not settle in 500 steps")
        return np.asarray(found.reshape(u.shape))

    def influence(self, points: ArrayLike) -> Array:
        """Motion of points (m, 2) or (m, 3) per traction at the nodes (m/Pa), shape (3 m, 3 ny nx)."""
        return influence(self.layer, points, self.nodes.reshape(-1, 2), self.pitch, self.load)

    @cached_property
    def _size(self) -> tuple[int, int]:
        from scipy.fft import next_fast_len

        ny, nx = self.shape
        return next_fast_len(2 * ny, real=True), next_fast_len(2 * nx, real=True)

    @cached_property
    def _symbol(self) -> NDArray[np.complex128]:
        return self._transformed(self._quarter)

    @cached_property
    def _quarter(self) -> Array:
        return self._of_one(None)

    @cached_property
    def _under(self) -> dict[float, NDArray[np.complex128]]:
        return {}

    def _at(self, z: float | None) -> NDArray[np.complex128]:
        """Transform of the motion at a height; the last few are kept."""
        if z is None:
            return self._symbol
        found = self._under.get(z)
        if found is None:
            found = self._transformed(self._of_one(z))
            if len(self._under) >= HEIGHTS:
                self._under.clear()
            self._under[z] = found
        return found

    @cached_property
    def _principal(self) -> tuple[Array, NDArray[np.complex128]]:
        w, V = np.linalg.eigh((self._symbol + np.swapaxes(self._symbol.conj(), -1, -2)) / 2)
        return w, V

    def _of_one(self, z: float | None) -> Array:
        """Motion under one node over the offsets of a quarter, (ny, nx, 3, 3)."""
        ny, nx = self.shape
        y, x = np.arange(ny) * self.pitch, np.arange(nx) * self.pitch
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if z is not None:
            points = np.column_stack([points, np.full(len(points), z)])
        return influence(self.layer, points, np.zeros((1, 2)), self.pitch, self.load).reshape(ny, nx, 3, 3)

    def _transformed(self, quarter: Array) -> NDArray[np.complex128]:
        """Transform of the motion under one node, over all offsets on the grid, (lines, lines/2 + 1, 3, 3)."""
        ny, nx = self.shape
        full = np.zeros((*self._size, 3, 3))
        for sy in (1, -1):
            for sx in (1, -1):
                sign = np.array([sx, sy, 1.0])  # the mirror image: each index along X or Y turns the sign
                full[np.ix_(sy * np.arange(ny), sx * np.arange(nx))] = quarter * np.multiply.outer(sign, sign)
        return np.fft.rfft2(full, axes=(0, 1))

    def _checked(self, values: ArrayLike, name: str) -> Array:
        what, hint = (
            f"{name} must be finite, three components at every node",
            "fill lost nodes by a fit first (tactile.Interpolation)",
        )
        return shaped(values, (*self.shape, 3), where=name, what=what, hint=hint)

    def _padded(self, values: Array) -> NDArray[np.complex128]:
        from scipy.fft import rfft2

        return np.asarray(rfft2(values, s=self._size, axes=(0, 1)))

    def _back(self, waves: NDArray[np.complex128]) -> Array:
        from scipy.fft import irfft2

        ny, nx = self.shape
        return np.asarray(irfft2(waves, s=self._size, axes=(0, 1))[:ny, :nx])


def _unseen(what: str) -> NotIdentifiable:
    return NotIdentifiable(what, advice="give a larger lam", code="LID-E306")
