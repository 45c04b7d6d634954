"""Gradient and Laplacian of a field over a surface of triangles and quadrilaterals, by finite elements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

from .lines import degree

if TYPE_CHECKING:
    from scipy.sparse import csr_array

GAUSS = np.array([(a, b) for a in (-1, 1) for b in (-1, 1)]) / np.sqrt(3)  # weight 1 each
CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])


@dataclass(frozen=True)
class Cells:
    """Cells of one kind: which points they join, and what they do to the values there.

    Parameters
    ----------
    points : array of int, shape (cells, corners)
    root : array, shape (cells, rows, corners)
        ``|root g|^2`` is the integral of ``|grad g|^2`` over the cell.
    area : array, shape (cells, corners)
        Integral of each shape function.
    """

    points: NDArray[np.int_]
    root: NDArray[np.float64]
    area: NDArray[np.float64]


def surface(
    coordinates: ArrayLike, cells: ArrayLike | Sequence[Sequence[int]], kind: int | str = "gradient"
) -> csr_array:
    """Gradient or Laplacian of a field that is given at the points of a surface mesh.

    Linear triangles (the cotangent formula; Pinkall & Polthier, Exp. Math. 2 (1993) 15) and bilinear quadrilaterals,
    flat or in space; both kinds may be mixed. The edge is free: nothing is prescribed there (natural boundary), so
    that only constants cost nothing.

    Parameters
    ----------
    coordinates : array, shape (points, 2) or (points, 3)
        Places, m.
    cells : array (cells, 3) or (cells, 4), or sequence of index triples and quadruples
        Corners of each cell, in order around it.
    kind : str or int
        ``"gradient"`` (1) or ``"laplacian"`` (2).

    Returns
    -------
    sparse array
        Gradient: two rows for a triangle and three for a quadrilateral; ``|L g|^2`` is the integral of ``|grad g|^2``
        of the interpolated field. Laplacian: (points, points), ``M^(-1/2) K`` with the stiffness K and the lumped mass
        M; ``|L g|^2`` tends to the integral of the squared Laplacian for a field without slope across the edge.

    Raises
    ------
    InputError
        Cells that name no points or have no area, points without a cell, another kind, NaN.
    """
    from scipy.sparse import coo_array, csr_array, diags_array

    order, (places, groups) = degree(kind), _checked(coordinates, cells)
    parts = [_triangles(places, c) if c.shape[1] == 3 else _quadrilaterals(places, c) for c in groups]
    n = len(places)
    if order == 1:
        values, rows, columns, count = [], [], [], 0
        for part in parts:
            size = part.root.shape[:2]
            row = count + np.arange(size[0] * size[1]).reshape(*size, 1)
            values.append(part.root.ravel())
            rows.append(np.broadcast_to(row, part.root.shape).ravel())
            columns.append(np.broadcast_to(part.points[:, None], part.root.shape).ravel())
            count += row.size
        joined = tuple(np.concatenate(x) for x in (values, rows, columns))
        return csr_array(coo_array((joined[0], joined[1:]), shape=(count, n)))
    K, mass = csr_array((n, n)), np.zeros(n)
    for part in parts:
        block = np.einsum("fri,frj->fij", part.root, part.root)
        i, j = (np.broadcast_to(x, block.shape).ravel() for x in (part.points[:, :, None], part.points[:, None]))
        K = K + coo_array((block.ravel(), (i, j)), shape=(n, n))
        mass += np.bincount(part.points.ravel(), part.area.ravel(), n)
    return csr_array(diags_array(1 / np.sqrt(mass)) @ K)


def _triangles(places: NDArray, points: NDArray) -> Cells:
    """Linear elements: the gradient is constant, R^-T of the two differences from the first corner."""
    edges = places[points[:, 1:]] - places[points[:, :1]]  # (cells, 2, dim)
    R = _triangle_of(edges, points)
    area = np.abs(R[:, 0, 0] * R[:, 1, 1]) / 2
    slopes = np.sqrt(area)[:, None, None] * np.linalg.solve(R.swapaxes(1, 2), np.broadcast_to(np.eye(2), R.shape))
    return Cells(points, _from_differences(slopes), np.repeat(area[:, None] / 3, 3, axis=1))


def _quadrilaterals(places: NDArray, points: NDArray) -> Cells:
    """Bilinear elements with two by two Gauss points: four gradients, compressed to three rows by QR."""
    corners = places[points]  # (cells, 4, dim)
    rows, normals, area = [], [], np.zeros(points.shape)
    for xi, eta in GAUSS:
        a, b = 1 + CORNERS[:, 0] * xi, 1 + CORNERS[:, 1] * eta
        derivative = np.stack([CORNERS[:, 0] * b, CORNERS[:, 1] * a]) / 4  # (2, 4)
        tangents = derivative @ corners
        R = _triangle_of(tangents, points)
        size = np.abs(R[:, 0, 0] * R[:, 1, 1])
        slopes = np.linalg.solve(R.swapaxes(1, 2), np.broadcast_to(derivative[:, 1:], (len(points), 2, 3)))
        rows.append(np.sqrt(size)[:, None, None] * slopes)
        area += size[:, None] * (a * b) / 4
        normals.append(_normal(tangents))
    turned = np.einsum("gfi,fi->gf", np.array(normals), np.sum(normals, axis=0)).min(axis=0) <= 0
    _refuse_flat(turned, points)
    compressed = np.linalg.qr(np.concatenate(rows, axis=1), mode="r")
    return Cells(points, _from_differences(np.asarray(compressed)), area)


def _triangle_of(tangents: NDArray, points: NDArray) -> NDArray[np.float64]:
    """R of two tangents = Q R in the plane that they span, for each cell; refuses those without area."""
    R = np.asarray(np.linalg.qr(tangents.swapaxes(1, 2), mode="r"))
    size, length = np.abs(R[:, 0, 0] * R[:, 1, 1]), np.max(np.linalg.norm(tangents, axis=2), axis=1)
    _refuse_flat(~(size > 1e-12 * length**2), points)
    return R


def _normal(tangents: NDArray) -> NDArray[np.float64]:
    """Normal vectors (cells, 3) of pairs of tangents, not of unit length."""
    room = np.zeros((len(tangents), 2, 3))
    room[:, :, : tangents.shape[2]] = tangents
    return np.cross(room[:, 0], room[:, 1])


def _refuse_flat(bad: NDArray[np.bool_], points: NDArray) -> None:
    if np.any(bad):
        raise InputError(
            "a cell of the surface has no area or crosses itself", where="penalty",
            found=f"cell with points {points[np.flatnonzero(bad)[0]].tolist()}", expected="corners in order around it",
        )  # fmt: skip


def _from_differences(slopes: NDArray) -> NDArray[np.float64]:
    """Slopes from differences to the first corner -> from the values at all corners: constants give zero exactly."""
    return np.concatenate([-slopes.sum(axis=2, keepdims=True), slopes], axis=2)


def _checked(coordinates: ArrayLike, cells: ArrayLike | Sequence[Sequence[int]]) -> tuple[NDArray, list[NDArray]]:
    """Places, and the cells in groups of equal kind."""
    places = np.asarray(plain(coordinates), float)
    if places.ndim != 2 or places.shape[1] not in (2, 3) or not np.all(np.isfinite(places)):
        raise InputError("no places of a surface", where="penalty", found=f"shape {places.shape}, or NaN",
                         expected="finite, shape (points, 2) or (points, 3)")  # fmt: skip
    polygons = [np.asarray(c, int) for c in cells]  # type: ignore[union-attr]
    odd = [k for k, c in enumerate(polygons) if c.shape not in {(3,), (4,)} or len(set(c.tolist())) < len(c)]
    if not polygons or odd:
        raise InputError("no cells of a surface", where="penalty",
                         found=f"cell {odd[0]}: {polygons[odd[0]].tolist()}" if odd else "none",
                         expected="three or four different points for each cell")  # fmt: skip
    used = np.concatenate(polygons)
    if used.min() < 0 or used.max() >= len(places):
        raise InputError("a cell names a point that is not there", where="penalty", found=f"{used.min()}..{used.max()}",
                         expected=f"0..{len(places) - 1}")  # fmt: skip
    alone = np.setdiff1d(np.arange(len(places)), used)
    if len(alone):
        raise InputError("points of the surface belong to no cell", where="penalty", found=alone[:5].tolist(),
                         expected="every point in a cell", hint="leave these points out")  # fmt: skip
    sizes = (3, 4)
    return places, [np.array(g) for g in ([c for c in polygons if len(c) == k] for k in sizes) if g]
