"""A homography between a plane and an image, given or fitted to corresponding points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals

FEWEST = 4
DEGENERATE = 1e-8  # smallest singular value that is not the solution, over the largest


@dataclass(frozen=True)
class Homography:
    """Projective map of a plane to pixels.

    Parameters
    ----------
    matrix : array, shape (3, 3)
        (x, y, 1) on the plane to (column, row, 1), up to a factor.
    unit : float
        Metres of the matrix's unit of length.

    Raises
    ------
    InputError
        Another shape, NaN, or a matrix without an inverse.
    """

    matrix: NDArray[np.float64]
    unit: float = 1.0

    def __post_init__(self) -> None:
        matrix = reals(self.matrix, where="homography")
        positive("unit", self.unit, where="homography", unit="m")
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
            raise InputError("no homography", where="homography", found=f"shape {matrix.shape}", expected="(3, 3)")
        rows = np.linalg.norm(matrix, axis=1, keepdims=True)
        if not rows.all() or np.linalg.cond(matrix / rows) > 1 / np.finfo(float).eps:
            raise InputError("a homography without an inverse", where="homography", found=matrix.tolist())
        object.__setattr__(self, "matrix", matrix)

    def to_pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Pixels of points of the plane (m), shape (N, 2)."""
        return _flat(np.column_stack([points / self.unit, np.ones(len(points))]) @ self.matrix.T)

    def to_plane(self, pixels: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points of the plane (m) that pixels show, shape (N, 2)."""
        seen = np.column_stack([pixels, np.ones(len(pixels))])
        return self.unit * _flat(np.linalg.solve(self.matrix, seen.T).T)


def fitted(points: ArrayLike, pixels: ArrayLike) -> Homography:
    """Homography of corresponding points, by the normalised direct linear transform (Hartley 1997).

    Parameters
    ----------
    points, pixels : array, shape (n, 2)
        At least four, no three of them on a line.

    Raises
    ------
    InputError
        Fewer, different numbers, NaN, or points that leave the map open.
    """
    p, q = reals(points, where="points"), reals(pixels, where="pixels")
    if p.ndim != 2 or p.shape != q.shape or p.shape[1] != 2 or len(p) < FEWEST or not np.isfinite([p, q]).all():
        raise InputError(
            "no corresponding points",
            where="homography",
            found=f"{p.shape} and {q.shape}",
            expected=f"(n, 2) twice, finite, n at least {FEWEST}",
        )
    (P, T), (Q, S) = _normalised(p), _normalised(q)
    one, zero = np.ones((len(p), 1)), np.zeros((len(p), 3))
    A = np.hstack([P, one])
    system = np.vstack([np.hstack([A, zero, -Q[:, :1] * A]), np.hstack([zero, A, -Q[:, 1:] * A])])
    _, values, vectors = np.linalg.svd(system)
    if values[7] < DEGENERATE * values[0]:
        raise InputError(
            "the points leave the homography open",
            where="homography",
            expected="four points of which no three are on a line",
        )
    matrix = np.linalg.solve(S, vectors[8].reshape(3, 3)) @ T
    return Homography(matrix / np.abs(matrix).max())


def _normalised(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points about their mean at a mean distance of sqrt 2, and the matrix that makes them so."""
    mean = points.mean(axis=0)
    size = np.hypot(*(points - mean).T).mean() / np.sqrt(2)
    if size == 0:
        raise InputError("all points are one", where="homography")
    matrix = np.array([[1 / size, 0, -mean[0] / size], [0, 1 / size, -mean[1] / size], [0, 0, 1]])
    return (points - mean) / size, matrix


def _flat(homogeneous: NDArray[Any]) -> NDArray[np.float64]:
    return homogeneous[:, :2] / homogeneous[:, 2:]
