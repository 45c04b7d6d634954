"""What an estimate is held against: known loads, a pressure mat, a force and moment; settled to plain arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import units
from structures.errors import InputError, plain

Array = NDArray[np.float64]

Values = ArrayLike | Callable[[Array], ArrayLike]


@dataclass(frozen=True, eq=False)
class Known:
    """A known load: an FE truth, a known shape, a measured force history.

    Parameters
    ----------
    values : array or callable
        ``(loads,)``, ``(samples,)`` of one load, or ``(samples, loads)``, in the order of the estimate. With
        `coordinates`, ``(Q,)`` or ``(Q, components)`` at those places. A callable gets the places ``(P,)`` or
        ``(P, dim)`` of the load basis (or the time of a history) and returns ``(P,)`` or ``(P, components)``. Against
        nodal forces both are tractions.
    coordinates : array, shape (Q,) or (Q, dim), optional
        Places (m). Patches take the average of the points nearest to each where there are four of them or more;
        everything else interpolates linearly.
    std : float or array, optional
        Std of the values.
    unit : str, optional
        Unit of the values, converted to SI; default that of the estimate.
    loads : str or sequence, optional
        A component of the basis (``"+Z"``), or labels or indices of the loads that are known; default all.
    outside : float, optional
        Value where `coordinates` do not reach; default refuses.
    source : str
        What it is, in words.
    """

    values: Values
    coordinates: ArrayLike | None = None
    std: ArrayLike | None = None
    unit: str | None = None
    loads: str | Sequence[str | int] | None = None
    outside: float | None = None
    source: str = "a known load"


@dataclass(frozen=True, eq=False)
class PressureMat:
    """A coarser measurement of the distribution: every cell reads a weighted mean of the loads.

    Parameters
    ----------
    P : array (cells, loads)
        Weights of the loads in each cell; rows of averages sum to one. With `loads`, columns for those only.
    values : array (cells,) or (frames, cells)
    std : float or array (cells,), optional
    unit : str, optional
        Unit of the values, converted to SI; default that of the estimate.
    loads : str or sequence, optional
        As in `Known`: ``"+Z"`` where the mat feels the normal component only.
    source : str
    """

    P: ArrayLike
    values: ArrayLike
    std: ArrayLike | None = None
    unit: str | None = None
    loads: str | Sequence[str | int] | None = None
    source: str = "a pressure mat"


@dataclass(frozen=True, eq=False)
class ReferenceWrench:
    """Resultant force and moment, of a force/torque sensor for example.

    Parameters
    ----------
    value : array (R,) or (frames, R)
        N and N m, unless `units` say otherwise.
    std : float or array (R,), optional
    labels : sequence of str, optional
        ``("Fx", "Fz")``: which resultants of the load basis; default all of them.
    C : array (R, loads), optional
        Weights of the loads in each resultant, about the point to which `value` refers; default those of the basis.
    units : sequence of str, optional
        Units of `value`, converted to SI.
    source : str
    """

    value: ArrayLike
    std: ArrayLike | None = None
    labels: Sequence[str] = ()
    C: ArrayLike | None = None
    units: Sequence[str] = ()
    source: str = "a force sensor"


def numbers(values: Any, what: str, hint: str = "", where: str = "validate") -> Array:
    """A finite real array.

    Raises
    ------
    InputError
        If it is none.
    """
    try:
        if np.iscomplexobj(values):
            raise TypeError("complex numbers")
        array = np.asarray(plain(values), float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what}: no real numbers", where=where, found=str(error)[:80],
                         expected="an array of real numbers",
                         hint=hint or "give plain numbers in SI units") from None  # fmt: skip
    bad = int(np.sum(~np.isfinite(array)))
    if bad or not array.size:
        raise InputError(f"{what}: NaN, infinity or nothing", where=where,
                         found=f"{bad} entries that are not finite, of {array.size}", expected="finite numbers",
                         hint=hint or "leave out what was not measured")  # fmt: skip
    return array


def spread(std: Any, shape: tuple[int, ...], what: str) -> Array | None:
    """A std in a given shape, or None.

    Raises
    ------
    InputError
        If it is not positive or does not fit.
    """
    if std is None:
        return None
    array = numbers(std, f"std of {what}")
    if array.ndim == 1 and shape[-1] == 1 and len(array) == shape[0]:
        array = array[:, None]
    try:
        wide = np.broadcast_to(array, shape)
    except ValueError:
        wide = np.zeros(shape)
    if np.any(wide <= 0):
        raise InputError(f"std of {what}: not positive, or of another shape", where="validate",
                         found=f"shape {array.shape}, smallest {array.min():.3g}",
                         expected=f"positive numbers that fit {shape}",
                         hint="leave std out where it is not known")  # fmt: skip
    return wide


def factor(unit: str | None, expected: str, what: str) -> float:
    """Factor that brings numbers in `unit` to the SI unit `expected`.

    Raises
    ------
    InputError
        If the two measure different things.
    """
    if unit is None or unit == expected:
        return 1.0
    own = units.parse(unit, where="validate")
    if expected != "arbitrary" and own.dimension != units.parse(expected.replace(" ", "*"), where="validate").dimension:
        raise InputError(
            f"{what} is measured in another unit than the estimate",
            where="validate",
            found=unit,
            expected=expected,
            hint="compare forces with forces and tractions with tractions: estimate.traction()",
        )
    return float(own.factor)


# -- places ------------------------------------------------------------------------------------------------------------
def places(geometry: Any) -> Array:
    """Places (P, dim) of a load basis.

    Raises
    ------
    InputError
        If it has none.
    """
    found = None if geometry is None else geometry.get("coordinates")
    if found is None or (geometry is not None and geometry.get("kind") == "polynomials"):
        raise InputError(
            "these loads have no places at which a known field could be taken",
            where="validate",
            found="loads without a basis" if found is None else "polynomials",
            expected="a basis of nodes, patches or hats",
            hint="give the known load as an array (loads,), or PressureMat(P, values) with rows of your own",
        )
    x = np.asarray(found, float)
    return x[:, None] if x.ndim == 1 else x


def at_places(known: Known, geometry: Any) -> Array:
    """Values (P,) or (P, components) of a field on the places of a load basis.

    Raises
    ------
    InputError
        If a place lies outside the reference, or shapes do not fit.
    """
    x = places(geometry)
    patches, measures = geometry.get("kind") == "patches", geometry.get("measures")
    if not callable(known.values):
        values = numbers(known.values, "the reference")
        reach = None
        if patches:
            size = np.inf if measures is None else np.asarray(measures, float)
            reach = np.broadcast_to(0.5 * size if x.shape[1] == 1 else np.sqrt(0.5 * size), len(x))
        return _from_points(x, numbers(known.coordinates, "coordinates"), values, reach, known.outside)
    boxes = _boxes(geometry, x) if patches else None
    if boxes is not None:
        return _averaged(known.values, boxes)
    return _asked(known.values, x[:, 0] if x.shape[1] == 1 else x)


def _boxes(geometry: Any, x: Array) -> Array | None:
    """Corners (P, dim, 2) of patches that are spans or rectangles."""
    extents, measures = geometry.get("extents"), geometry.get("measures")
    if extents is not None and np.shape(extents) == (*x.shape, 2):
        return np.asarray(extents, float)
    if x.shape[1] == 1 and measures is not None:
        half = np.asarray(measures, float)[:, None] / 2
        return np.stack([x - half, x + half], axis=-1)
    return None


def _averaged(function: Callable[[Array], ArrayLike], boxes: Array) -> Array:
    """Means (P,) or (P, components) of a function over boxes, by a Gauss rule of six points a side."""
    nodes, weights = np.polynomial.legendre.leggauss(6)
    dim = boxes.shape[1]
    local = np.stack(np.meshgrid(*[nodes] * dim, indexing="ij"), axis=-1).reshape(-1, dim)
    shares = np.prod(np.stack(np.meshgrid(*[weights / 2] * dim, indexing="ij"), axis=-1).reshape(-1, dim), axis=1)
    middle, half = boxes.mean(axis=2), np.ptp(boxes, axis=2) / 2
    at = (middle[:, None] + half[:, None] * local).reshape(-1, dim)
    found = _asked(function, at[:, 0] if dim == 1 else at)
    means = np.einsum("pqc,q->pc", found.reshape(len(boxes), len(shares), -1), shares)
    return np.asarray(means[:, 0] if found.ndim == 1 else means)


def _asked(function: Callable[[Array], ArrayLike], x: Array) -> Array:
    try:
        answer = function(x)
    except Exception as error:  # whatever a user's function may raise
        raise InputError(
            "the reference function fails", where="Known", found=f"{type(error).__name__}: {error}",
            expected="values at the places it is given", hint=f"it was called with an array of shape {x.shape}",
        ) from error  # fmt: skip
    found = numbers(answer, "values of the reference function")
    if found.ndim == 0:
        found = np.full(len(x), float(found))
    if found.ndim > 2 or len(found) != len(x):
        raise InputError("the reference function gives another number of values than places", where="validate",
                         found=f"shape {found.shape}", expected=f"({len(x)},) or ({len(x)}, components)",
                         hint="it gets all places at once")  # fmt: skip
    return found


def _from_points(x: Array, points: Array, values: Array, reach: Array | None, outside: float | None) -> Array:
    """Averages over the points nearest to each patch and within its `reach`, else interpolation."""
    points = points[:, None] if points.ndim == 1 else points
    if points.ndim != 2 or points.shape[1] != x.shape[1] or len(values) != len(points) or values.ndim > 2:
        raise InputError("places and values of the reference do not fit", where="validate",
                         found=f"{points.shape} places, {values.shape} values",
                         expected=f"places (Q, {x.shape[1]}), values (Q,) or (Q, components)",
                         hint="in the coordinates of the structure, m")  # fmt: skip
    table = values.reshape(len(values), -1)
    if reach is not None:
        from scipy.spatial import cKDTree

        distance, owner = cKDTree(x).query(points)
        near = distance <= reach[owner] * (1 + 1e-9)
        count = np.bincount(owner[near], minlength=len(x))
        if count.min() >= 4:
            sums = np.stack([np.bincount(owner[near], column[near], minlength=len(x)) for column in table.T], axis=-1)
            return (sums / count[:, None]).reshape(len(x), *values.shape[1:])
    found = _interpolated(x, points, table)
    missing = np.isnan(found).any(axis=1)
    if missing.any() and outside is None:
        raise InputError("the reference does not reach every load", where="validate",
                         found=f"{missing.sum()} of {len(x)} places outside its points",
                         expected="a reference over the whole basis",
                         hint="Known(..., outside=0.0) where there is no load beyond it")  # fmt: skip
    found[missing] = 0.0 if outside is None else outside
    return found.reshape(len(x), *values.shape[1:])


def _interpolated(x: Array, points: Array, table: Array) -> Array:
    """Linear interpolation; NaN outside. Points in space must lie in one plane."""
    origin = points.mean(axis=0)
    span, axes = np.linalg.svd(points - origin, full_matrices=False)[1:]
    flat = int(np.sum(span > 1e-6 * span[0])) if span[0] > 0 else 0
    if flat == 0 or flat > 2 or np.abs((x - origin) @ axes[flat:].T).max(initial=0.0) > 1e-3 * span[0]:
        raise InputError("points on no common line or plane cannot be interpolated here", where="validate",
                         found=f"{len(points)} points that span {flat} dimensions",
                         expected="points on the line or plane of the loads",
                         hint="give a function of the places, or values at the places themselves")  # fmt: skip
    u, v = (points - origin) @ axes[:flat].T, (x - origin) @ axes[:flat].T
    # hull of a reference on the same grid: what lies on its rim is inside
    if flat == 1:
        order = np.argsort(u[:, 0])
        s, tol = u[order, 0], 1e-9 * np.ptp(u)
        out = (v[:, 0] < s[0] - tol) | (v[:, 0] > s[-1] + tol)
        found = np.stack([np.interp(v[:, 0], s, column[order]) for column in table.T], axis=-1)
        found[out] = np.nan
        return found
    from scipy.interpolate import LinearNDInterpolator

    shrunk = v + 1e-9 * (u.mean(axis=0) - v)
    return np.asarray(LinearNDInterpolator(u, table, rescale=True)(shrunk), float)
