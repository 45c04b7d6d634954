"""Many points at once: rows of the motion anywhere in a solid, and the strain of every cell.

`Field.motion` answers for one point and one axis; a camera sees hundreds of markers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .errors import InputError
from .fields import field_of
from .hexfield import HexField
from .structure import Structure
from .values import plain, reals

Array = NDArray[np.float64]
Index = NDArray[np.intp]
SNAP = 1e-9  # of a cell: points so far outside are on the surface


def motions(structure: Structure, points: ArrayLike, *, reach: float | None = None) -> sparse.csr_array:
    """Rows of the motion along X, Y, Z at many points of a solid.

    Parameters
    ----------
    structure : Structure
        A block or a mesh of `structures.solids`.
    points : array (N, 3)
        Places in the solid or on its surface (m).
    reach : float, optional
        How far outside a cell of a general mesh a point may lie, in cells: near a curved surface.

    Returns
    -------
    sparse (3 N, n)
        Row 3 i + c is the motion of point i along axis c; columns are all DOFs, supported ones included.

    Raises
    ------
    InputError
        If a point is none or lies outside: the first such point is named.
    """
    nodes, values = interpolants(structure, points, reach=reach)
    count, corners = nodes.shape
    rows = 3 * np.arange(count)[:, None, None] + np.arange(3)
    columns = 3 * nodes[:, :, None] + np.arange(3)
    data = np.repeat(values.ravel(), 3)
    where = np.broadcast_to(rows, (count, corners, 3)).ravel(), columns.ravel()
    out = sparse.coo_array((data, where), shape=(3 * count, structure.n)).tocsr()
    out.eliminate_zeros()
    return out


def interpolants(structure: Structure, points: ArrayLike, *, reach: float | None = None) -> tuple[Index, Array]:
    """Nodes (N, m) whose motion makes that of each point, and their weights (N, m), which sum to one.

    Raises
    ------
    InputError
        As `motions`.
    """
    places = reals(points, where="points of a solid", hint="an array (N, 3) in m")
    if places.ndim != 2 or places.shape[1] != 3 or not np.all(np.isfinite(places)):
        bad = np.flatnonzero(~np.isfinite(places).all(axis=1)) if places.ndim == 2 else np.empty(0, int)
        raise InputError(
            "no points of a solid",
            where=f"point {bad[0]}" if len(bad) else "points",
            found="NaN or infinity" if len(bad) else f"shape {places.shape}",
            expected="finite (x, y, z) in m, shape (N, 3)",
            hint="leave lost markers out",
        )
    field: Any = field_of(structure, "points of a solid")
    if isinstance(field, HexField):
        return _in_block(field, places)
    return field.interpolants(places) if reach is None else field.interpolants(places, reach)


def _in_block(field: HexField, places: Array) -> tuple[Index, Array]:
    origin = np.array([line.origin for line in field.lines])
    steps = np.array([line.h for line in field.lines])
    counts = np.array([line.elements for line in field.lines])
    stations = (places - origin) / steps
    outside(np.any((stations < -SNAP) | (stations > counts + SNAP), axis=1), places, origin, origin + counts * steps)
    cell = np.clip(np.floor(stations).astype(np.intp), 0, counts - 1)
    xi = np.clip(stations - cell, 0.0, 1.0)
    corners = np.arange(8)
    high = np.stack([corners & 1, corners >> 1 & 1, corners >> 2], axis=1).astype(bool)
    values = np.prod(np.where(high, xi[:, None], 1 - xi[:, None]), axis=2)
    return field.corners(*cell.T), values


def outside(beyond: NDArray[np.bool_], places: Array, lower: Array, upper: Array) -> None:
    """Refuse points outside a solid, naming the first.

    Raises
    ------
    InputError
        If any is.
    """
    if not np.any(beyond):
        return
    first = int(np.flatnonzero(beyond)[0])
    spans = ", ".join(f"{name} {a:.6g}..{b:.6g}" for name, a, b in zip("xyz", lower, upper, strict=True))
    raise InputError(
        f"{int(beyond.sum())} of {len(places)} points lie outside the solid",
        where=f"point {first}",
        found="({:.6g}, {:.6g}, {:.6g}) m".format(*places[first]),
        expected=f"within {spans} m",
        hint="check the frame of the points, and their unit (m)",
    )


def strains(structure: Structure, u: ArrayLike) -> Array:
    """Strains at the centres of all cells.

    Parameters
    ----------
    structure : Structure
        A block or a mesh of `structures.solids`.
    u : array (n,)
        Motion of all DOFs (m).

    Returns
    -------
    array (cells, 6)
        xx, yy, zz, yz, xz, xy; shear as angles, that is twice the tensor's component.
    """
    field: Any = field_of(structure, "strains of a solid")
    u = np.asarray(plain(u), float)
    if u.shape != (structure.n,) or not np.all(np.isfinite(u)):
        raise InputError(
            "the motion does not fit",
            where="strains of a solid",
            found=f"shape {u.shape}" if u.shape != (structure.n,) else "NaN or infinity",
            expected=f"({structure.n},), finite",
            hint="structure.expand completes the motion of the free DOFs",
        )
    if not isinstance(field, HexField):
        return field.strains(u)
    cells = np.meshgrid(*(np.arange(line.elements) for line in field.lines[::-1]), indexing="ij")[::-1]
    nodes = field.corners(*(c.ravel() for c in cells))
    return np.asarray(u.reshape(-1, 3)[nodes].reshape(-1, 24) @ field.cell.strain(np.full(3, 0.5)).T, float)


def largest_strain(strain: ArrayLike) -> Array:
    """Largest principal strain by size, with its sign, of strains (cells, 6) as `strains` gives them."""
    e = np.asarray(plain(strain), float)
    xx, yy, zz, yz, xz, xy = e.T
    tensor = np.stack([xx, xy / 2, xz / 2, xy / 2, yy, yz / 2, xz / 2, yz / 2, zz], axis=1).reshape(-1, 3, 3)
    values = np.linalg.eigvalsh(tensor)
    return np.where(-values[:, 0] > values[:, 2], values[:, 0], values[:, 2])
