"""Penalties L of the regularisation term: over samples, lines, grids, graphs and surfaces, and as spectral symbols.

Those of a field are scaled so that ``|L g|^2`` is the integral of ``|grad g|^2`` or of the squared second derivative:
the penalty then does not change with the mesh. They are sparse; `LinearProblem` takes them as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError, plain, reals, shown

from . import Array, Flags, Indices

if TYPE_CHECKING:
    from scipy.sparse import csr_array


__all__ = [
    "components",
    "difference",
    "graph",
    "grid",
    "line",
    "matrix",
    "names",
    "order",
    "register_penalty",
    "stencil",
    "surface",
    "symbol",
]

KINDS = {"gradient": 1, "first_difference": 1, "laplacian": 2, "second_difference": 2}


def degree(kind: int | str) -> int:
    """Order of the derivative that a penalty over places takes: 1 or 2.

    Raises
    ------
    InputError
        If it is neither.
    """
    found = KINDS.get(kind) if isinstance(kind, str) else kind
    if isinstance(found, bool) or found not in (1, 2):
        raise InputError("no such penalty over places", where="penalty", found=repr(kind),
                         expected="'gradient' (1) or 'laplacian' (2)")  # fmt: skip
    return int(found)


def line(n: int, order: int | str, spacing: float | ArrayLike = 1.0) -> csr_array:
    """First or second derivative along a line of points, at any spacing; the ends are free.

    Parameters
    ----------
    n : int
        Number of points.
    order : int or str
        1 or 2, or a named penalty of that order.
    spacing : float or array, shape (n - 1,)
        Distances between neighbours, m.

    Returns
    -------
    sparse array, shape (n - order, n)
        ``|L g|^2`` is the sum of the squared derivative times the length that it stands for. With spacing 1 these are
        the plain differences; polynomials below the order cost nothing.

    Raises
    ------
    InputError
        Too few points, another order, or distances that are not positive.
    """
    from scipy.sparse import csr_array, diags_array

    d = degree(order)
    if n <= d:
        raise InputError("too few points for this penalty", where="penalty", found=n, expected=f"more than {d}")
    h = _steps(spacing, n)
    slope = diags_array([-1 / h, 1 / h], offsets=[0, 1], shape=(n - 1, n))
    if d == 1:
        return csr_array(diags_array(np.sqrt(h)) @ slope)
    middle = (h[1:] + h[:-1]) / 2
    change = diags_array([-np.ones(n - 2), np.ones(n - 2)], offsets=[0, 1], shape=(n - 2, n - 1))
    return csr_array(diags_array(1 / np.sqrt(middle)) @ change @ slope)


def grid(shape: Sequence[int], kind: int | str = "gradient", spacing: Any = 1.0) -> csr_array:
    """Gradient or Laplacian of a field over a rectangular grid of points, by multilinear elements.

    Parameters
    ----------
    shape : sequence of int
        Points along each axis; the load is the flattened array, last axis fastest.
    kind : str or int
        ``"gradient"`` (1) or ``"laplacian"`` (2).
    spacing : float, or sequence with a float or an array (points - 1,) for each axis
        Distances between neighbours, m.

    Returns
    -------
    sparse array, (rows, points)
        The operator that `surface` makes of the same mesh of quadrilaterals, from products of lines. One axis: `line`.

    Raises
    ------
    InputError
        Fewer than two points along an axis, another kind, or distances that are not positive.
    """
    from scipy.sparse import csr_array, diags_array, vstack

    shape, d = tuple(int(n) for n in shape), degree(kind)
    steps = [spacing] * len(shape) if np.isscalar(spacing) else list(spacing)
    if not shape or min(shape) < 2 or len(steps) != len(shape):
        raise InputError("no grid", where="penalty", found=f"shape {shape}, {len(steps)} spacings",
                         expected="at least two points and one spacing along each axis")  # fmt: skip
    if len(shape) == 1:
        return line(shape[0], d, steps[0])
    widths = [_steps(h, n) for h, n in zip(steps, shape, strict=True)]
    slopes = [line(n, 1, h) for n, h in zip(shape, widths, strict=True)]
    if d == 1:
        roots = [_mass_root(h) for h in widths]
        return csr_array(vstack([_product(roots, slopes[k], k) for k in range(len(shape))]))
    masses = [_mass(h) for h in widths]
    lumped = [m.sum(axis=1) for m in masses]
    stiffness = sum(_product(masses, _stiffness(h), k) for k, h in enumerate(widths))
    area = lumped[0]
    for m in lumped[1:]:
        area = np.kron(area, m)
    return csr_array(diags_array(1 / np.sqrt(area)) @ stiffness)


def _steps(spacing: float | ArrayLike, n: int) -> Array:
    h = np.asarray(plain(spacing), float)
    if h.shape not in {(), (n - 1,)} or not np.all(np.isfinite(h)) or np.any(h <= 0):
        raise InputError("no spacing of points", where="penalty", found=f"shape {h.shape}, or not > 0",
                         expected=f"a positive distance, or {n - 1} of them")  # fmt: skip
    return np.broadcast_to(h, (n - 1,)).astype(float)


def _mass(h: Array) -> csr_array:
    """Gram matrix of the hat functions of a line."""
    from scipy.sparse import csr_array, diags_array

    diagonal = (np.r_[h, 0.0] + np.r_[0.0, h]) / 3
    return csr_array(diags_array([h / 6, diagonal, h / 6], offsets=[-1, 0, 1]))


def _mass_root(h: Array) -> csr_array:
    """Upper bidiagonal C with C^T C = the Gram matrix of the hat functions: its Cholesky factor."""
    from scipy.linalg import cholesky_banded
    from scipy.sparse import csr_array, diags_array

    M = _mass(h)
    band = cholesky_banded(np.stack([np.r_[0.0, M.diagonal(1)], M.diagonal()]))
    return csr_array(diags_array([band[1], band[0, 1:]], offsets=[0, 1]))


def _stiffness(h: Array) -> csr_array:
    """Integrals of products of the slopes of the hat functions of a line."""
    from scipy.sparse import csr_array, diags_array

    return csr_array(diags_array([-1 / h, np.r_[1 / h, 0.0] + np.r_[0.0, 1 / h], -1 / h], offsets=[-1, 0, 1]))


def _product(factors: Sequence[csr_array], at: csr_array, axis: int) -> csr_array:
    """Kronecker product of `factors`, with `at` in place of one of them."""
    from scipy.sparse import csr_array, kron

    parts = [at if k == axis else f for k, f in enumerate(factors)]
    whole = parts[0]
    for part in parts[1:]:
        whole = kron(whole, part)
    return csr_array(whole)


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

    points: Indices
    root: Array
    area: Array


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


def _triangles(places: Array, points: Indices) -> Cells:
    """Linear elements: the gradient is constant, R^-T of the two differences from the first corner."""
    edges = places[points[:, 1:]] - places[points[:, :1]]  # (cells, 2, dim)
    R = _triangle_of(edges, points)
    area = np.abs(R[:, 0, 0] * R[:, 1, 1]) / 2
    slopes = np.sqrt(area)[:, None, None] * np.linalg.solve(R.swapaxes(1, 2), np.broadcast_to(np.eye(2), R.shape))
    return Cells(points, _from_differences(slopes), np.repeat(area[:, None] / 3, 3, axis=1))


def _quadrilaterals(places: Array, points: Indices) -> Cells:
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


def _triangle_of(tangents: Array, points: Indices) -> Array:
    """R of two tangents = Q R in the plane that they span, for each cell; refuses those without area."""
    R = np.asarray(np.linalg.qr(tangents.swapaxes(1, 2), mode="r"))
    size, length = np.abs(R[:, 0, 0] * R[:, 1, 1]), np.max(np.linalg.norm(tangents, axis=2), axis=1)
    _refuse_flat(~(size > 1e-12 * length**2), points)
    return R


def _normal(tangents: Array) -> Array:
    """Normal vectors (cells, 3) of pairs of tangents, not of unit length."""
    room = np.zeros((len(tangents), 2, 3))
    room[:, :, : tangents.shape[2]] = tangents
    return np.cross(room[:, 0], room[:, 1])


def _refuse_flat(bad: Flags, points: Indices) -> None:
    if np.any(bad):
        raise InputError(
            "a cell of the surface has no area or crosses itself", where="penalty",
            found=f"cell with points {points[np.flatnonzero(bad)[0]].tolist()}", expected="corners in order around it",
        )  # fmt: skip


def _from_differences(slopes: Array) -> Array:
    """Slopes from differences to the first corner -> from the values at all corners: constants give zero exactly."""
    return np.concatenate([-slopes.sum(axis=2, keepdims=True), slopes], axis=2)


def _checked(coordinates: ArrayLike, cells: ArrayLike | Sequence[Sequence[int]]) -> tuple[Array, list[Indices]]:
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


# every named penalty is a difference of the order that stands here; all solvers take any order from this table
ORDER = {"identity": 0, "gradient": 1, "first_difference": 1, "laplacian": 2, "second_difference": 2}


def register_penalty(name: str, order: int) -> None:
    """Name a difference of your own, which every family with a named penalty then takes.

    Parameters
    ----------
    name : str
    order : int
        Of the difference, from 0 (the load itself).

    Raises
    ------
    InputError
        No order, or a name that stands for another one.
    """
    if isinstance(order, bool) or not isinstance(order, int) or order < 0:
        raise InputError("no order of a difference", where="register_penalty", found=shown(order),
                         expected="an integer >= 0")  # fmt: skip
    if not (isinstance(name, str) and name) or ORDER.get(name, order) != order:
        raise InputError("a penalty needs a name of its own", where="register_penalty", found=shown(name),
                         expected=f"none of {names()}")  # fmt: skip
    ORDER[name] = order


def names() -> str:
    """The named penalties, for messages."""
    return ", ".join(ORDER)


def order(penalty: str) -> int:
    """Order of the difference that a named penalty takes; 0 is the load itself.

    Raises
    ------
    InputError
        A name that is none.
    """
    if penalty not in ORDER:
        raise InputError(
            "unknown penalty", where="penalty", found=repr(penalty), expected=f"one of {names()}, or a matrix"
        )
    return ORDER[penalty]


def stencil(degree: int) -> Array:
    """Coefficients (degree + 1,) of a difference of order `degree`, oldest sample first."""
    return np.asarray(difference(degree + 1, degree)[0])


def difference(samples: int, degree: int) -> Array:
    """Difference matrix of order `degree`, shape (samples - degree, samples): ends are free."""
    return np.asarray(np.diff(np.eye(samples), n=degree, axis=0), float)


def matrix(penalty: str | ArrayLike, samples: int, loads: int = 1) -> Array | None:
    """Penalty over load histories flattened as (samples, loads), time first.

    Parameters
    ----------
    penalty : str or array, shape (rows, samples * loads)
        A name, or a matrix of the user.

    Returns
    -------
    array, shape (rows, samples * loads), or None
        None stands for the identity, which needs no matrix.
    """
    if isinstance(penalty, str):
        degree = order(penalty)
        if degree == 0:
            return None
        if samples <= degree:
            raise InputError("too few samples for this penalty", where="penalty", found=samples,
                             expected=f"more than {degree} for {penalty}")  # fmt: skip
        return np.asarray(np.kron(difference(samples, degree), np.eye(loads)), float)
    L = reals(penalty, what="the penalty is no matrix of real numbers", where="penalty")
    if L.ndim == 1 and L.shape == (samples * loads,):
        raise InputError(
            "a vector is no penalty matrix", where="penalty", found=f"shape {L.shape}",
            expected=f"shape (rows, {samples * loads})", hint="np.diag(w) weighs each unknown; w[None] is one row",
        )  # fmt: skip
    L = np.atleast_2d(L)
    if L.ndim != 2 or L.shape[1] != samples * loads or not np.all(np.isfinite(L)):
        raise InputError("the penalty matrix does not fit the unknowns", where="penalty",
                         found=f"shape {L.shape}" + ("" if np.all(np.isfinite(L)) else " with NaN or inf"),
                         expected=f"finite, shape (rows, {samples * loads})")  # fmt: skip
    return L


def symbol(penalty: str, theta: Array) -> Array:
    """Modulus of a named penalty at the digital frequencies `theta` (rad/sample)."""
    return np.asarray(np.abs(2 * np.sin(theta / 2)) ** order(penalty))


def graph(n: int, edges: ArrayLike, weights: ArrayLike | None = None, kind: int | str = "gradient") -> csr_array:
    """Differences along the edges of a graph, or the graph Laplacian.

    Parameters
    ----------
    n : int
        Number of points.
    edges : array of int, shape (edges, 2)
    weights : array, shape (edges,), optional
        Positive, default 1. With the squared inverse length of each edge the differences become slopes.
    kind : str or int
        ``"gradient"`` (1): rows ``sqrt(w) (g_j - g_i)``. ``"laplacian"`` (2): rows ``sum_j w_ij (g_i - g_j)``.

    Returns
    -------
    sparse array, (edges, n) or (n, n)

    Raises
    ------
    InputError
        Edges that name no points or join a point to itself, or weights that are not positive.
    """
    from scipy.sparse import coo_array, csr_array

    ends, order = np.asarray(edges, int).reshape(-1, 2), degree(kind)
    w = np.ones(len(ends)) if weights is None else np.asarray(plain(weights), float)
    if len(ends) == 0 or ends.min() < 0 or ends.max() >= n or np.any(ends[:, 0] == ends[:, 1]):
        raise InputError("these are no edges of the graph", where="penalty", found=f"{len(ends)} edges",
                         expected=f"pairs of different points from 0 to {n - 1}")  # fmt: skip
    if w.shape != (len(ends),) or not np.all(np.isfinite(w)) or np.any(w <= 0):
        raise InputError("the weights of the edges do not fit", where="penalty", found=f"shape {w.shape}, or not > 0",
                         expected=f"{len(ends)} positive numbers")  # fmt: skip
    i, j = ends.T
    if order == 1:
        row, root = np.arange(len(ends)), np.sqrt(w)
        return csr_array(coo_array((np.r_[-root, root], (np.r_[row, row], np.r_[i, j])), shape=(len(ends), n)))
    values = np.r_[w, w, -w, -w]
    return csr_array(coo_array((values, (np.r_[i, j, i, j], np.r_[i, j, j, i])), shape=(n, n)))


def components(L: ArrayLike | csr_array, count: int) -> csr_array:
    """One penalty for each of `count` components of a vector load, (rows * count, points * count).

    The loads are numbered point by point: index = point * count + component.
    """
    from scipy.sparse import csr_array, eye_array, kron

    return csr_array(kron(csr_array(L), eye_array(count)))
