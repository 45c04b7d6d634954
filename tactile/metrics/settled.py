"""Maps as users give them, settled to arrays that can be compared."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

Array = NDArray[np.float64]


def finite(values: Any, name: str, *, where: str = "metrics") -> Array:
    """A finite real array.

    Raises
    ------
    InputError
        Texts, complex numbers, NaN or infinity.
    """
    array = reals(values, where=f"{where}, {name}")
    if not np.isfinite(array).all():
        raise InputError(
            f"{name}: {int(np.sum(~np.isfinite(array)))} values are NaN or infinite",
            where=where,
            found=f"shape {array.shape}",
            expected="finite numbers",
            hint="leave out the points that the map does not reach, from the truth too",
        )
    return array


def field(values: Any, name: str) -> Array:
    """A map (points, components): three components, or fewer of a map that has no others.

    Raises
    ------
    InputError
        Another shape, or values that are not finite.
    """
    array = finite(values, name)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or not array.size or array.shape[1] > 3:
        raise InputError(
            f"{name} is no map",
            where="metrics",
            found=f"shape {array.shape}",
            expected="(points, 3), or (points,) of one component",
            hint="reshape a flat vector of three components per point with .reshape(-1, 3)",
        )
    return array


def pair(found: Any, truth: Any) -> tuple[Array, Array]:
    """An estimate and its truth on the same points.

    Raises
    ------
    InputError
        Shapes that differ, or a truth without any load: nothing relative is defined there.
    """
    a, b = field(found, "found"), field(truth, "truth")
    if a.shape != b.shape:
        raise InputError(
            "estimate and truth are on different points",
            where="metrics",
            found=a.shape,
            expected=b.shape,
            hint="evaluate the truth at the nodes of the estimate",
        )
    if not np.any(b):
        raise InputError(
            "the truth is zero everywhere", where="metrics, truth", found="no load", expected="a load",
            hint="judge an unloaded frame by its noise, not by relative errors",
        )  # fmt: skip
    return a, b


def weights(areas: ArrayLike | None, points: int) -> Array:
    """Tributary areas (points,), equal ones where none are given; their sum is one.

    Raises
    ------
    InputError
        Another number of areas, or one that is not positive.
    """
    if areas is None:
        return np.full(points, 1 / points)
    found = finite(areas, "areas")
    if found.shape != (points,) or not (found > 0).all():
        raise InputError(
            "areas do not fit the map",
            where="metrics, areas",
            found=f"shape {found.shape}, smallest {found.min(initial=np.inf):.3g}",
            expected=f"{points} positive areas",
            hint="pass surface.areas, or nothing on a regular grid",
        )
    return found / found.sum()


def places(points: ArrayLike, count: int) -> Array:
    """Places of the map's points (points, dim).

    Raises
    ------
    InputError
        Another number of places.
    """
    found = finite(points, "points")
    if found.ndim != 2 or len(found) != count or found.shape[1] not in (2, 3):
        raise InputError(
            "places do not fit the map",
            where="metrics, points",
            found=f"shape {found.shape}",
            expected=f"({count}, 2) or ({count}, 3)",
            hint="one place for each point of the map",
        )
    return found


def size(t: Array) -> Array:
    """Magnitude of the vector at each point."""
    return np.linalg.norm(t, axis=1)
