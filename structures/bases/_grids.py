"""Small pieces of grids: breaks along an axis, hats and Legendre polynomials on them, neighbours and cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from ..errors import InputError, numbers, plain, shown, whole

Array = NDArray[np.float64]
SNAP = 1e-9  # of the region's side: breaks closer than this are one
LIMIT = 10_000  # divisions along one axis
PAIRS = 4000  # rectangles of a list: all pairs are compared


def merged(values: ArrayLike, size: float) -> Array:
    """Sorted values (k,), those within rounding of each other (1e-9 of `size`) taken once."""
    x = np.unique(np.asarray(plain(values), float))
    return np.asarray(x[np.concatenate([[True], np.diff(x) > SNAP * size])])


def breaks(grid: Any, window: Array, names: Sequence[str], where: str) -> list[Array]:
    """Breaks along each axis of a window (axes, 2), from numbers of divisions or from the breaks themselves.

    Raises
    ------
    InputError
        If it is neither, or the breaks leave the window.
    """
    axes = len(window)
    several = isinstance(grid, Sequence | np.ndarray) and not isinstance(grid, str)
    each = grid if several else [grid] * axes
    if axes == 1 and several and len(grid) != 1 and not any(isinstance(g, Sequence | np.ndarray) for g in grid):
        each = [grid]  # the breaks of a beam need no second pair of brackets
    if not isinstance(each, Sequence | np.ndarray) or isinstance(each, str) or len(each) != axes:
        raise _no_grid(grid, names, where)
    return [_axis(one, window[k], names[k], where) for k, one in enumerate(each)]


def _axis(one: Any, span: Array, name: str, where: str) -> Array:
    if not isinstance(one, Sequence | np.ndarray) or isinstance(one, str):
        count = whole(one) or 0
        if not 1 <= count <= LIMIT:
            raise _no_grid(one, (name,), where)
        return np.linspace(span[0], span[1], count + 1)
    x = numbers(one)
    slack = SNAP * (span[1] - span[0])
    rising = x.ndim == 1 and len(x) >= 2 and bool(np.all(np.isfinite(x)) and np.all(np.diff(x) > slack))
    if not rising or x[0] < span[0] - slack or x[-1] > span[1] + slack:
        raise InputError(
            f"no breaks along {name}",
            where=where,
            found=shown(one),
            expected=f"two or more rising numbers in m, from {span[0]:.9g} to {span[1]:.9g}",
            hint=f"np.linspace({span[0]:.9g}, {span[1]:.9g}, 11), or a number of divisions",
        )
    return np.asarray(np.clip(x, span[0], span[1]))


def _no_grid(found: Any, names: Sequence[str], where: str) -> InputError:
    many = len(names) > 1
    return InputError(
        "no grid",
        where=where,
        found=shown(found),
        expected=f"the number of divisions along {' and '.join(names)} (1 to {LIMIT}), or their breaks in m",
        hint="grid=(8, 6), for example" if many else "grid=8, for example",
    )


def product(values: Sequence[Array]) -> Array:
    """All combinations of one value per axis, first axis fastest, (points, axes)."""
    mesh = np.meshgrid(*values[::-1], indexing="ij")
    return np.column_stack([m.ravel() for m in mesh[::-1]])


def boxes(lines: Sequence[Array]) -> Array:
    """Boxes of a grid, first axis fastest, (boxes, axes, 2)."""
    lower, upper = product([x[:-1] for x in lines]), product([x[1:] for x in lines])
    return np.stack([lower, upper], axis=-1)


def neighbours(shape: tuple[int, ...]) -> NDArray[np.intp]:
    """Neighbours on a grid (C order), (edges, 2)."""
    number = np.arange(int(np.prod(shape))).reshape(shape)
    pairs = []
    for axis in range(len(shape))[::-1]:
        first, second = (np.moveaxis(number, axis, 0)[part] for part in (slice(None, -1), slice(1, None)))
        pairs.append(np.column_stack([first.ravel(), second.ravel()]))
    return np.concatenate(pairs).astype(np.intp)


def quads(shape: tuple[int, ...]) -> NDArray[np.intp] | None:
    """Cells over the points of a grid: pairs on a line, quadrilaterals in cyclic order on a sheet; None without one."""
    number = np.arange(int(np.prod(shape))).reshape(shape)
    if min(shape) < 2:
        return None
    if len(shape) == 1:
        return np.column_stack([number[:-1], number[1:]]).astype(np.intp)
    corners = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
    return np.column_stack([c.ravel() for c in corners]).astype(np.intp)


def touching(extents: Array) -> NDArray[np.intp]:
    """Pairs of boxes (n, axes, 2) that share a side of some length, (edges, 2)."""
    lower, upper = extents[..., 0], extents[..., 1]
    slack = SNAP * float(np.max(upper - lower))
    gap = np.maximum(lower[:, None], lower) - np.minimum(upper[:, None], upper)  # negative where they overlap
    meet, overlap = np.abs(gap) <= slack, gap < -slack
    beside = np.zeros(meet.shape[:2], bool)
    for axis in range(extents.shape[1]):
        rest = [k for k in range(extents.shape[1]) if k != axis]
        beside |= meet[..., axis] & np.all(overlap[..., rest], axis=-1)
    return np.argwhere(np.triu(beside, 1)).astype(np.intp)


def overlaps(extents: Array) -> sparse.csr_array:
    """Common measure of every pair of boxes (n, axes, 2): the Gram matrix of patches, sparse (n, n)."""
    lower, upper = extents[..., 0], extents[..., 1]
    common = np.clip(np.minimum(upper[:, None], upper) - np.maximum(lower[:, None], lower), 0.0, None)
    common[common <= SNAP * np.max(upper - lower)] = 0.0  # sides that touch
    return sparse.csr_array(np.prod(common, axis=-1))


# -- functions of one coordinate --------------------------------------------------------------------------------------
def hat(nodes: Array, x: Array) -> sparse.csr_array:
    """Piecewise linear functions on `nodes` at the points `x`; zero outside; sparse (points, nodes)."""
    cell = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    share = (x - nodes[cell]) / (nodes[cell + 1] - nodes[cell])
    slack = SNAP * (nodes[-1] - nodes[0]) / (nodes[cell + 1] - nodes[cell])
    on = (share >= -slack) & (share <= 1 + slack)
    share = np.clip(share, 0.0, 1.0)
    row = np.arange(len(x))
    entries = np.concatenate([np.where(on, 1 - share, 0.0), np.where(on, share, 0.0)])
    place = np.concatenate([row, row]), np.concatenate([cell, cell + 1])
    return sparse.coo_array((entries, place), shape=(len(x), len(nodes))).tocsr()


def step(nodes: Array, x: Array) -> sparse.csr_array:
    """Piecewise constant functions between `nodes` at the points `x`; zero outside; sparse (points, nodes - 1)."""
    slack = SNAP * (nodes[-1] - nodes[0])
    cell = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, len(nodes) - 2)
    on = (x >= nodes[0] - slack) & (x <= nodes[-1] + slack)
    return sparse.coo_array((on.astype(float), (np.arange(len(x)), cell)), shape=(len(x), len(nodes) - 1)).tocsr()


def legendre(span: Array, degree: int, x: Array) -> Array:
    """Legendre polynomials on a span, of mean square one over it, at the points `x`; (points, degree + 1)."""
    t = (2 * x - span[0] - span[1]) / (span[1] - span[0])
    return np.asarray(np.polynomial.legendre.legvander(t, degree) * np.sqrt(2 * np.arange(degree + 1) + 1.0))


def rowwise(parts: Sequence[sparse.csr_array]) -> sparse.csr_array:
    """Products of functions of each coordinate, point by point, first axis fastest, (points, n)."""
    out = parts[0]
    for part in parts[1:]:
        a, b = out.tocsr(), part.tocsr()
        counts = np.diff(a.indptr) * np.diff(b.indptr)
        row = np.repeat(np.arange(a.shape[0]), counts)
        local = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        width = np.diff(a.indptr)[row]
        i, j = a.indptr[row] + local % width, b.indptr[row] + local // width
        column = b.indices[j].astype(np.intp) * a.shape[1] + a.indices[i]
        size = a.shape[0], a.shape[1] * b.shape[1]
        out = sparse.coo_array((a.data[i] * b.data[j], (row, column)), shape=size).tocsr()
    return out
