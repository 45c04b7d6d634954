"""The kinds of load basis: patches, hats and polynomials."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse

from ..errors import InputError, integer, shown
from . import _grids as grids
from ._basis import ROUNDING, Basis
from ._domains import Domain, FaceDomain, Quadrature
from ._regions import Region, region_of

if TYPE_CHECKING:
    from .._system.structure import Structure


Array = NDArray[np.float64]
Index = NDArray[np.intp]
Components = str | Sequence[str]
DEGREE = 40
_COMPONENT = re.compile(r"([+-]?)(X|Y|Z|N|T1|T2)")


def patches(
    structure: Structure,
    grid: Any = None,
    *,
    rectangles: Any = None,
    region: Any = None,
    components: Components = "+Z",
) -> Basis:
    """Uniform loads on the spans of a beam, or on rectangles of a plate or of a face of a solid.

    Parameters
    ----------
    structure : Structure
    grid : int, (int, int) or breaks, optional
        Divisions along each axis, or their breaks (m): ``8``, ``(8, 6)``, ``([0, 0.2, 1.0], [0, 0.5])``. One patch per
        element where neither grid nor rectangles are given.
    rectangles : list, optional
        Instead: spans ``(x0, x1)`` or rectangles ``((x0, x1), (y0, y1))`` (m) inside the region.
    region, components
        As in `hats`.

    Returns
    -------
    Basis
        Coefficients in N/m or Pa; partial elements are integrated exactly.

    Raises
    ------
    InputError
        If region, grid or components do not fit the structure; a curved face takes one patch per cell only.
    """
    where = "bases.patches"
    part = region_of(structure, region, where)
    domain = part.domain
    if grid is None and rectangles is None and not (part.whole or domain.boxed):
        raise part.curved(where)
    if grid is None and rectangles is None and isinstance(domain, FaceDomain) and part.whole:
        return _cell_patches(structure, part, components)
    if grid is not None and rectangles is not None:
        raise InputError(
            "patches are stated twice",
            where=where,
            found="grid and rectangles",
            expected="one of the two",
            hint="leave one out",
        )
    part.flat(where)
    if rectangles is not None:
        extents = part.rectangles(rectangles, where)
        rules = [domain.rule(box, None, 0) for box in extents]
        rule = _joined(rules)
        owner = np.repeat(np.arange(len(rules)), [len(r.weights) for r in rules])
        psi = sparse.coo_array((np.ones(len(owner)), (np.arange(len(owner)), owner))).tocsr()
        shape, edges, cells, mass = None, grids.touching(extents), None, grids.overlaps(extents)
    else:
        lines = part.mesh_lines() if grid is None else grids.breaks(grid, part.window, domain.names, where)
        extents, shape = grids.boxes(lines), tuple(len(x) - 1 for x in lines[::-1])
        rule = domain.rule(np.array([[x[0], x[-1]] for x in lines]), lines, 0)
        psi = grids.rowwise([grids.step(x, rule.along[:, k]) for k, x in enumerate(lines)])
        edges, cells = grids.neighbours(shape), grids.quads(shape)
        mass = sparse.diags_array(psi.T @ rule.weights).tocsr()
    centres = extents.mean(axis=-1)
    names = [_place(domain.names, box) for box in extents]
    return _distributed(
        "patches", structure, part, components, rule, psi, domain.lift(centres), names, mass=mass, shape=shape,
        edges=edges, cells=cells, extents=extents, values=partial(_boxes_at, domain=domain, extents=extents),
    )  # fmt: skip


def _cell_patches(structure: Structure, part: Region, components: Components) -> Basis:
    """One patch per cell of a face, whatever its shape."""
    domain = part.domain
    every = np.arange(len(domain.cells))
    rule = domain.cell_rule(every, 0)
    psi = sparse.coo_array((np.ones(len(rule.cell)), (np.arange(len(rule.cell)), rule.cell))).tocsr()
    areas = psi.T @ rule.weights
    centres = (psi.T @ (rule.weights[:, None] * rule.places)) / areas[:, None]
    extents = np.stack([domain.lower, domain.upper], axis=-1)
    names = [f"face {k}" for k in every]
    return _distributed(
        "patches", structure, part, components, rule, psi, centres, names, mass=sparse.diags_array(areas).tocsr(),
        shape=None, edges=_sharing(domain.cells), cells=None, extents=extents if domain.boxed else None,
        values=partial(_boxes_at, domain=domain, extents=extents) if domain.boxed else None,
    )  # fmt: skip


def hats(structure: Structure, grid: Any = None, *, region: Any = None, components: Components = "+Z") -> Basis:
    """Continuous, piecewise linear (bilinear) loads: a value at each point of a grid, or at each node of the mesh.

    Parameters
    ----------
    structure : Structure
    grid : int, (int, int) or breaks, optional
        Divisions along each axis, one less than points, or the points themselves (m); the nodes of the mesh where not
        given.
    region : optional
        Part that is loaded: ``(x0, x1)`` on a beam, ``((x0, x1), (y0, y1))`` on a plate; on a solid a face by name
        (``"top"``), a `Surface`, or either with a rectangle in its two axes: ``("top", ((x0, x1), (y0, y1)))``.
    components : str or sequence of str
        Directions: ``"+Z"`` or ``"-Z"``; on a face also X, Y, its outward normal N and its tangents T1, T2
        (``"-N"`` pushes).

    Returns
    -------
    Basis
        Coefficients in N/m (beam) or Pa: the load at the points.

    Raises
    ------
    InputError
        If region, grid or components do not fit the structure.
    """
    where = "bases.hats"
    part = region_of(structure, region, where)
    domain = part.domain
    if grid is None and part.whole and isinstance(domain, FaceDomain):
        every = np.arange(len(domain.cells))
        rule = domain.cell_rule(every, 1)
        psi, places = domain.node_hats(rule), domain.coordinates
        shape: tuple[int, ...] | None = None
        cells: Index | None
        edges, cells = _sides(domain.cells), domain.cells
        names = [f"hat {node}" for node in domain.nodes]
        values = partial(domain.node_hats_at, cells=every) if domain.boxed else None
    else:
        part.flat(where)
        lines = part.mesh_lines() if grid is None else grids.breaks(grid, part.window, domain.names, where)
        rule = domain.rule(np.array([[x[0], x[-1]] for x in lines]), lines, 1)
        psi = grids.rowwise([grids.hat(x, rule.along[:, k]) for k, x in enumerate(lines)])
        along, shape = grids.product(lines), tuple(len(x) for x in lines[::-1])
        places, edges, cells = domain.lift(along), grids.neighbours(shape), grids.quads(shape)
        names = ["hat " + _place(domain.names, point) for point in along]
        values = partial(_grid_hats, domain=domain, lines=lines)
    mass = (psi.T @ sparse.diags_array(rule.weights) @ psi).tocsr()
    return _distributed(
        "hats", structure, part, components, rule, psi, places, names, mass=mass, shape=shape, edges=edges,
        cells=cells, extents=None, values=values,
    )  # fmt: skip


def polynomials(structure: Structure, degree: int, *, region: Any = None, components: Components = "+Z") -> Basis:
    """Smooth loads: polynomials up to a total degree, orthogonal over the region and of mean square one.

    Parameters
    ----------
    structure : Structure
    degree : int
        Highest total degree, 0 to 40; (degree + 1) functions on a beam, (degree + 1)(degree + 2)/2 on a sheet.
    region, components
        As in `hats`.

    Returns
    -------
    Basis
        Coefficients in N/m or Pa; the first is the mean load, and the sum of squares of all is the mean square.

    Raises
    ------
    InputError
        If degree, region or components do not fit.

    Notes
    -----
    Products of Legendre polynomials, made orthonormal under the mean over the region by a QR factorisation.
    """
    where = "bases.polynomials"
    if isinstance(degree, bool) or degree != 0:
        try:
            integer("degree", degree, where=where, limit=DEGREE)
        except InputError:
            raise InputError(
                "no degree", where=where, found=shown(degree), expected=f"an integer from 0 to {DEGREE}",
                hint="finer detail than that takes patches or hats",
            ) from None  # fmt: skip
    part = region_of(structure, region, where)
    domain, window = part.domain, part.window
    if not part.whole:
        part.flat(where)
    rule = domain.rule(window, None, degree) if domain.boxed else domain.cell_rule(np.arange(len(domain.cells)), degree)
    filled = domain.boxed and abs(rule.weights.sum() / np.prod(np.ptp(window, axis=1)) - 1) < 1e-9
    if domain.boxed and not filled:  # a face with gaps: squares are integrated too, to make them orthonormal
        rule = domain.rule(window, None, 2 * degree)
    orders = _orders(len(window), degree)
    products = partial(_products, window=window, degree=degree)
    area = rule.weights.sum()
    mix = np.eye(len(orders))  # on a rectangle the products are orthonormal as they are
    if not filled:
        upper = np.linalg.qr(np.sqrt(rule.weights / area)[:, None] * products(rule.along), mode="r")
        mix = linalg.solve_triangular(upper * np.sign(np.diag(upper))[:, None], mix)

    psi = sparse.csr_array(products(rule.along) @ mix)
    centre = (rule.weights @ rule.places) / area
    names = [" ".join(f"P{k}({name})" for k, name in zip(order, domain.names, strict=True)) for order in orders]
    mass = sparse.diags_array(np.full(len(orders), area)).tocsr()
    return _distributed(
        "polynomials", structure, part, components, rule, psi, np.tile(centre, (len(orders), 1)), names, mass=mass,
        shape=None, edges=np.empty((0, 2), np.intp), cells=None, extents=None,
        values=partial(_polynomials_at, domain=domain, window=window, degree=degree, mix=mix),
        measures=np.full(len(orders), area),
    )  # fmt: skip


def _products(along: Array, window: Array, degree: int) -> Array:
    """Products of Legendre polynomials up to a total degree at coordinates along the axes, (m, functions)."""
    orders = _orders(len(window), degree)
    each = [grids.legendre(span, degree, along[:, k]) for k, span in enumerate(window)]
    return np.asarray(np.prod([table[:, orders[:, k]] for k, table in enumerate(each)], axis=0))


def _polynomials_at(at: Array, domain: Domain, window: Array, degree: int, mix: Array) -> sparse.csr_array:
    """Values of mixed products at places, zero outside the window."""
    along = domain.project(at)
    slack = grids.SNAP * np.ptp(window, axis=1)
    on = np.all((along >= window[:, 0] - slack) & (along <= window[:, 1] + slack), axis=1)
    return sparse.csr_array(np.where(on[:, None], _products(along, window, degree) @ mix, 0.0))


def _grid_hats(at: Array, domain: Domain, lines: Sequence[Array]) -> sparse.csr_array:
    """Values of the hats of a grid at places."""
    return grids.rowwise([grids.hat(x, domain.project(at)[:, k]) for k, x in enumerate(lines)])


def _orders(axes: int, degree: int) -> Index:
    """Exponents of the products, by total degree, (functions, axes)."""
    if axes == 1:
        return np.arange(degree + 1)[:, None]
    return np.array([(total - j, j) for total in range(degree + 1) for j in range(total + 1)], np.intp)


# -- shared -----------------------------------------------------------------------------------------------------------
def parsed(
    components: Components, allowed: Sequence[str], domain: Domain | None, where: str
) -> list[tuple[float, str]]:
    """Sign and direction of each component label.

    Raises
    ------
    InputError
        If a label is none, does not fit the structure, or comes twice.
    """
    items = [components] if isinstance(components, str) else list(components) if np.iterable(components) else []
    found = [_COMPONENT.fullmatch(item) if isinstance(item, str) else None for item in items]
    out = [(-1.0 if m[1] == "-" else 1.0, m[2]) for m in found if m]
    names = [name for _, name in out]
    if not items or len(out) != len(items) or len(set(names)) != len(names) or not set(names) <= set(allowed):
        raise InputError(
            f"no components of a load on {'this structure' if domain is None else domain.words}",
            where=f"{where}, components",
            found=shown(components),
            expected=f"one or more of {', '.join('+' + d for d in allowed)}, each once, with either sign",
            hint='components=("+Z",), for example; moments and rotations are loads.Moment',
        )
    return out


def labelled(sign: float, name: str) -> str:
    """``+Z`` of a sign and a direction."""
    return ("-" if sign < 0 else "+") + name


def interleaved(parts: Sequence[sparse.csc_array]) -> sparse.csc_array:
    """Columns of the components, (n, P) each, with those of a point together, (n, P x components)."""
    count, P = len(parts), parts[0].shape[1]
    if count == 1:
        return parts[0]
    order = (np.arange(P)[:, None] + P * np.arange(count)).ravel()
    return sparse.hstack(parts, format="csc")[:, order].tocsc()


def cleaned(B: sparse.csc_array) -> sparse.csc_array:
    """Columns without what rounding left where contributions cancel."""
    B = sparse.csc_array(B)
    B.sum_duplicates()
    if B.nnz:
        largest = abs(B).max(axis=0).toarray().ravel()
        column = np.repeat(np.arange(B.shape[1]), np.diff(B.indptr))
        B.data[np.abs(B.data) <= ROUNDING * largest[column]] = 0.0
        B.eliminate_zeros()
    return B


def _distributed(
    kind: str,
    structure: Structure,
    part: Region,
    components: Components,
    rule: Quadrature,
    psi: sparse.csr_array,
    places: Array,
    names: Sequence[str],
    *,
    mass: sparse.csr_array,
    measures: Array | None = None,
    **geometry: Any,
) -> Basis:
    """Basis of functions `psi` (Q, P) at quadrature points: consistent loads, resultants, geometry."""
    domain, P = part.domain, psi.shape[1]
    chosen = parsed(components, domain.directions, domain, f"bases.{kind}")
    weighted = (sparse.diags_array(rule.weights) @ psi).tocsc()
    columns, forces, moments, reach = [], [], [], sparse.csr_array((structure.n, P))
    arms = np.zeros((len(rule.weights), 3))
    arms[:, : rule.places.shape[1]] = rule.places
    for sign, name in chosen:
        motion = domain.motion(rule, name)
        columns.append(cleaned(sign * (motion.T @ weighted)))
        reach = reach + abs(motion).T @ abs(weighted)  # a DOF where contributions cancel is touched all the same
        vectors = sign * domain.vectors(name, rule)
        forces.append((weighted.T @ vectors).T)
        moments.append((weighted.T @ np.cross(arms, vectors)).T)
    count = len(chosen)
    B = interleaved(columns)
    several = count > 1 or isinstance(domain, FaceDomain)
    labels = [f"{name} {labelled(*c)}" if several else name for name in names for c in chosen]
    normals = part.normals_at(places)
    return Basis(
        kind=kind,
        components=tuple(labelled(*c) for c in chosen),
        coordinates=np.array(places, float),
        unit=domain.unit,
        traction_unit=domain.unit,
        quantity=domain.quantity,
        labels=tuple(labels),
        directions=part.directions_at(chosen, P, normals),
        normals=normals,
        measures=np.asarray(psi.T @ rule.weights, float) if measures is None else measures,
        mass=mass,
        own_structure=structure,
        matrix=B,
        reach=sparse.csr_array(reach),
        force=np.stack(forces, axis=-1).reshape(3, P * count),
        moment=np.stack(moments, axis=-1).reshape(3, P * count),
        **geometry,
    )


def _joined(rules: Sequence[Quadrature]) -> Quadrature:
    parts = [[getattr(r, name) for r in rules] for name in ("cell", "along", "places", "weights")]
    return Quadrature(*(np.concatenate(part) for part in parts))


def _place(names: Sequence[str], values: ArrayLike) -> str:
    """``x=0.2 y=0.4`` of a point, ``x=0..0.2`` of a box."""
    words = [f"{v:.9g}" if np.ndim(v) == 0 else f"{v[0]:.9g}..{v[1]:.9g}" for v in np.asarray(values)]
    return " ".join(f"{name}={word}" for name, word in zip(names, words, strict=True))


def _boxes_at(at: Array, domain: Domain, extents: Array) -> sparse.csr_array:
    """Indicators of boxes at places; where patches overlap both count, a shared side belongs to the first."""
    slack = grids.SNAP * np.ptp(domain.bounds, axis=1)
    along = domain.project(at)
    rows, columns = [], []
    step = max(1, 4_000_000 // len(extents))
    for start in range(0, len(along), step):
        part = along[start : start + step, None]
        on = np.all((part >= extents[..., 0] - slack) & (part <= extents[..., 1] + slack), axis=-1)
        inner = np.all((part > extents[..., 0] + slack) & (part < extents[..., 1] - slack), axis=-1)
        alone = np.flatnonzero(on.any(axis=1) & ~inner.any(axis=1))
        inner[alone, on[alone].argmax(axis=1)] = True
        i, j = np.nonzero(inner)
        rows.append(start + i)
        columns.append(j)
    i, j = np.concatenate(rows), np.concatenate(columns)
    return sparse.coo_array((np.ones(len(i)), (i, j)), shape=(len(along), len(extents))).tocsr()


def _sides(cells: Index) -> Index:
    """Sides of cells in cyclic order, each once, (edges, 2)."""
    turned = np.roll(cells, -1, axis=1)
    pairs = np.column_stack([cells.ravel(), turned.ravel()])
    return np.unique(np.sort(pairs, axis=1), axis=0).astype(np.intp)


def _sharing(cells: Index) -> Index:
    """Pairs of cells that share a side, (edges, 2)."""
    pairs = np.sort(np.column_stack([cells.ravel(), np.roll(cells, -1, axis=1).ravel()]), axis=1)
    _, side = np.unique(pairs, axis=0, return_inverse=True)
    order = np.argsort(side.ravel(), kind="stable")
    same = np.flatnonzero(np.diff(side.ravel()[order]) == 0)
    owner = np.repeat(np.arange(len(cells)), cells.shape[1])[order]
    return np.sort(np.column_stack([owner[same], owner[same + 1]]), axis=1).astype(np.intp)
