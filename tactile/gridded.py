"""A layer on a regular grid: motion from tractions and tractions from motion by fast Fourier transforms.

The mesh-free fast path. The motion is that of an infinite layer under the patches or hats that the grid stands for,
free of wrap-around; the way back is regularised.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable
from structures.values import integer, number, positive, reals, shown

from .influence import influence
from .layer import Layer

Array = NDArray[np.float64]
LIMIT = 4096


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
        if self.load not in ("patch", "hat"):
            raise InputError("no load of a grid", where="load", found=shown(self.load), expected="'patch' or 'hat'")

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
        symbol = self._symbol if z is None else self._transformed(number("z", z, where="displacements", unit="m"))
        waves = np.einsum("yxij,yxj->yxi", symbol, self._padded(self._checked(tractions, "tractions")))
        return self._back(waves)

    def tractions(self, displacements: ArrayLike, lam: float = 1e-3) -> Array:
        """Tractions (Pa), (ny, nx, 3), from the motion of the surface (ny, nx, 3) (m), regularised.

        Minimises |G t - u|^2 + (lam w1)^2 |t|^2 over tractions on the grid, w1 the largest compliance: Tikhonov with
        the identity. Conjugate gradients with the transform alone as preconditioner, which is exact away from the edge.

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
        return found.reshape(u.shape)

    def influence(self, points: ArrayLike) -> Array:
        """Motion of points (m, 2) or (m, 3) per traction at the nodes (m/Pa), (3 m, 3 ny nx): `tactile.influence`."""
        return influence(self.layer, points, self.nodes.reshape(-1, 2), self.pitch, self.load)

    @cached_property
    def _size(self) -> tuple[int, int]:
        from scipy.fft import next_fast_len

        ny, nx = self.shape
        return next_fast_len(2 * ny, real=True), next_fast_len(2 * nx, real=True)

    @cached_property
    def _symbol(self) -> NDArray[np.complex128]:
        return self._transformed(None)

    @cached_property
    def _principal(self) -> tuple[Array, NDArray[np.complex128]]:
        w, V = np.linalg.eigh((self._symbol + np.swapaxes(self._symbol.conj(), -1, -2)) / 2)
        return w, V

    def _transformed(self, z: float | None) -> NDArray[np.complex128]:
        """Transform of the motion under one node, over all offsets on the grid, (lines, lines/2 + 1, 3, 3)."""
        ny, nx = self.shape
        y, x = np.arange(ny) * self.pitch, np.arange(nx) * self.pitch
        points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        if z is not None:
            points = np.column_stack([points, np.full(len(points), z)])
        quarter = influence(self.layer, points, np.zeros((1, 2)), self.pitch, self.load).reshape(ny, nx, 3, 3)
        full = np.zeros((*self._size, 3, 3))
        for sy in (1, -1):
            for sx in (1, -1):
                sign = np.array([sx, sy, 1.0])  # the mirror image: each index along X or Y turns the sign
                full[np.ix_(sy * np.arange(ny), sx * np.arange(nx))] = quarter * np.multiply.outer(sign, sign)
        return np.fft.rfft2(full, axes=(0, 1))

    def _checked(self, values: ArrayLike, name: str) -> Array:
        found = reals(values, where=name)
        if found.shape != (*self.shape, 3) or not np.isfinite(found).all():
            raise InputError(
                f"{name} must be finite, three components at every node",
                where=name,
                found=f"shape {found.shape}" if found.shape != (*self.shape, 3) else "NaN or infinity",
                expected=f"{(*self.shape, 3)}",
                hint="fill lost nodes by a fit first (tactile.interpolation)",
            )
        return found

    def _padded(self, values: Array) -> NDArray[np.complex128]:
        return np.fft.rfft2(values, s=self._size, axes=(0, 1))

    def _back(self, waves: NDArray[np.complex128]) -> Array:
        ny, nx = self.shape
        return np.fft.irfft2(waves, s=self._size, axes=(0, 1))[:ny, :nx]


def _unseen(what: str) -> NotIdentifiable:
    return NotIdentifiable(what, advice="give a larger lam", code="LID-E306")
