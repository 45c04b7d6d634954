"""What becomes of a single load (columns of the resolution matrix), and whether a finer basis would show more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from ..arrays import Array


def width(spread: Array, peak: int) -> float:
    """Full width at half maximum of a point spread around its peak, in samples, interpolated."""
    x = np.abs(spread) / abs(spread[peak])

    def reach(y: Array) -> float:
        below = np.flatnonzero(y < 0.5)
        if len(below) == 0:
            return float(len(y))
        k = int(below[0])
        return float(k - 1 + (y[k - 1] - 0.5) / (y[k - 1] - y[k]))

    return max(1.0, reach(x[peak:]) + reach(x[peak::-1]))


@dataclass(frozen=True)
class LoadLayout:
    """Where loads are: in a row, on a line, or on a surface. Load index = point * components + component.

    Parameters
    ----------
    points, components : int
    places : array, shape (points, d), or None
        In m, in the 1, 2 or 3 directions in which they differ; None: in the order of their index.
    measures : array, shape (points,)
        Length or area of each; in samples without places.
    """

    points: int
    components: int = 1
    places: Array | None = None
    measures: Array | None = None

    @classmethod
    def of(cls, n: int, components: int = 1, geometry: Mapping[str, Any] | None = None) -> LoadLayout:
        """LoadLayout of `n` loads, with the geometry of a load basis where there is one.

        Raises
        ------
        InputError
            If the geometry is one of another number of loads.
        """
        found = None if geometry is None or geometry.get("kind") == "polynomials" else geometry.get("coordinates")
        if found is None:
            return cls(n // components, components)
        x = np.asarray(found, float)
        x = x[:, None] if x.ndim == 1 else x
        components = len(geometry.get("components") or ()) or components  # type: ignore[union-attr]
        if len(x) * components != n:
            raise InputError("the places are not those of the loads", where="geometry",
                             found=f"{len(x)} places, {components} components", expected=f"{n} loads")  # fmt: skip
        measures = geometry.get("measures")  # type: ignore[union-attr]
        flat = _flattened(x)
        if flat.shape[1] == 0:
            return cls(len(x), components)
        return cls(len(x), components, flat, _cells(flat) if measures is None else np.asarray(measures, float))

    @property
    def dimension(self) -> int:
        """1 along a line, 2 over a surface, 3 in a body."""
        return 1 if self.places is None else self.places.shape[1]

    @property
    def unit(self) -> str:
        """Unit of a width."""
        return "loads" if self.places is None else "m"

    def width(self, spread: Array, load: int) -> float:
        """Full width at half maximum of a point spread (n,), among the loads of its own direction.

        On a line interpolated; on a surface the diameter of a disc (of a ball) as large as all that is above the half.
        """
        x = np.abs(spread.reshape(self.points, self.components)[:, load % self.components])
        own = load // self.components
        if x[own] <= 0:
            return float(self.points) if self.places is None else float(np.linalg.norm(np.ptp(self.places, axis=0)))
        if self.places is None:
            return width(x, own)
        assert self.measures is not None
        if self.dimension == 1:
            return max(_crossings(self.places[:, 0], x / x[own], own), float(self.measures[own]))
        size = float(np.sum(self.measures[x >= 0.5 * x[own]]))
        # nodes of a surface carry its area; those of a body are taken for points of a surface in it
        return 2 * float(np.sqrt(size / np.pi))

    def cross_talk(self, spread: Array, load: int, reach: float) -> float:
        """Largest response beyond `reach` of a load, or in another direction, over that at the load itself.

        Infinite where the load itself is shown nowhere in place.
        """
        x, own = np.abs(spread.reshape(self.points, self.components)), load // self.components
        at = np.arange(self.points)[:, None] if self.places is None else self.places
        away = np.linalg.norm(at - at[own], axis=1) > reach
        mine = x[own, load % self.components]
        others = np.delete(x, load % self.components, axis=1)
        largest = max(float(x[away, load % self.components].max(initial=0.0)), float(others.max(initial=0.0)))
        return largest / float(mine) if mine > 0 else (np.inf if largest > 0 else 0.0)


def _flattened(x: Array) -> Array:
    """Coordinates along the directions in which the places differ."""
    centred = x - x.mean(axis=0)
    if not np.any(centred):
        return np.asarray(centred[:, :0])
    span, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    return np.asarray(centred @ axes[span > 1e-6 * span[0]].T)


def _cells(x: Array) -> Array:
    """Tributary length on a line; an equal share of the box elsewhere."""
    if x.shape[1] > 1:
        return np.full(len(x), float(np.prod(np.sort(np.ptp(x, axis=0))[-2:])) / len(x))
    order = np.argsort(x[:, 0])
    cells = np.empty(len(x))
    cells[order] = np.abs(np.gradient(x[order, 0]))
    return cells


def _crossings(x: Array, y: Array, own: int) -> float:
    """Distance between the places left and right of a peak of height 1 where it has fallen to a half."""
    order = np.argsort(x)
    x, y, k = x[order], y[order], int(np.flatnonzero(order == own)[0])

    def reach(a: Array, b: Array) -> float:
        below = np.flatnonzero(b < 0.5)
        if len(below) == 0:
            return abs(float(a[-1] - a[0]))
        j = int(below[0])
        part = (b[j - 1] - 0.5) / (b[j - 1] - b[j])
        return abs(float(a[j - 1] + part * (a[j] - a[j - 1]) - a[0]))

    return reach(x[k:], y[k:]) + reach(x[k::-1], y[k::-1])


@dataclass(frozen=True)
class Spreads:
    """Height, width and cross-talk of some columns of a resolution matrix; arrays (columns,)."""

    loads: NDArray[np.int64]
    widths: Array
    cross_talk: Array


def spreads(columns: ArrayLike, loads: NDArray[np.int64], layout: LoadLayout) -> Spreads:
    """Measure columns (n, k) of a resolution matrix that belong to `loads` (k,)."""
    columns = np.asarray(columns, float)
    widths = np.array([layout.width(column, int(j)) for column, j in zip(columns.T, loads, strict=True)])
    talk = [layout.cross_talk(c, int(j), w) for c, j, w in zip(columns.T, loads, widths, strict=True)]
    return Spreads(np.asarray(loads, int), widths, np.array(talk, float))


@dataclass(frozen=True)
class Refinement:
    """Two load bases for the same region and sensors.

    Parameters
    ----------
    coarse, fine : int
        Number of loads of each.
    before, after : int
        Modes above the noise in each.
    eta : float
        Noise, relative to the largest singular value.
    """

    coarse: int
    fine: int
    before: int
    after: int
    eta: float

    @property
    def gained(self) -> int:
        """Modes that refining added above the noise."""
        return self.after - self.before


def refinement(coarse: ArrayLike, fine: ArrayLike, eta: float, *, loads: tuple[int, int] | None = None) -> Refinement:
    """Compare two bases by their operators or their singular values.

    Parameters
    ----------
    coarse, fine : array, shape (m, n) or (r,)
        Whitened operators, or their singular values.
    eta : float
        Noise relative to the largest singular value, between 0 and 1.
    loads : (int, int), optional
        Number of loads, where singular values are given and are fewer.

    Raises
    ------
    InputError
        If `eta` is not between 0 and 1, or the second basis is not the larger one.
    """
    if not 0 < eta < 1:
        raise InputError("no relative noise level", where="eta", found=eta, expected="between 0 and 1")
    (a, s), (b, t) = _values(coarse), _values(fine)
    a, b = loads or (a, b)
    if b <= a:
        raise InputError("the second basis is not finer", where="refinement", found=f"{a} and {b} loads",
                         expected="more loads in the second")  # fmt: skip
    return Refinement(a, b, int(np.sum(s > eta * s.max())), int(np.sum(t > eta * t.max())), float(eta))


def against_half(H: ArrayLike, eta: float, *, components: int = 1, edges: ArrayLike | None = None) -> Refinement:
    """Compare a basis with the one of half its size in which neighbouring loads are merged.

    The merged loads are orthonormal combinations, so that their singular values lie below those of the full basis.

    Parameters
    ----------
    H : array, shape (m, n)
        Whitened operator.
    eta : float
        Noise relative to the largest singular value.
    components : int
        Directions of each point: load index = point * components + component.
    edges : array, shape (E, 2), optional
        Pairs of neighbouring points; default the next one in order.

    Raises
    ------
    InputError
        If there are fewer than two points, or no whole number of them.
    """
    H = np.asarray(H, float)
    points, odd = divmod(H.shape[1], components)
    if odd or points < 2:
        raise InputError("these loads cannot be merged in pairs", where="refinement",
                         found=f"{H.shape[1]} loads of {components} components",
                         expected="two points or more")  # fmt: skip
    pairs = np.column_stack([np.arange(points - 1), np.arange(1, points)]) if edges is None else np.asarray(edges, int)
    group = _matched(points, pairs)
    size = np.bincount(group)
    merged = np.zeros((len(H), len(size), components))
    for point, g in enumerate(group):
        merged[:, g] += H.reshape(len(H), points, components)[:, point]
    merged /= np.sqrt(size)[:, None]
    return refinement(merged.reshape(len(H), -1), H, eta)


def _matched(points: int, edges: Array) -> NDArray[np.int64]:
    """Group of each point: neighbours in pairs, as many as can be found in order."""
    partner = np.full(points, -1)
    for a, b in edges:
        if a != b and partner[a] < 0 and partner[b] < 0:
            partner[a], partner[b] = b, a
    first = np.where(partner < 0, np.arange(points), np.minimum(np.arange(points), partner))
    return np.unique(first, return_inverse=True)[1]


def _values(A: ArrayLike) -> tuple[int, Array]:
    A = np.asarray(A, float)
    if A.ndim not in (1, 2) or A.size == 0 or not np.all(np.isfinite(A)):
        raise InputError("no operator and no singular values", where="refinement", found=f"shape {A.shape}, or NaN",
                         expected="finite, (m, n) or (r,)")  # fmt: skip
    return A.shape[-1], np.linalg.svdvals(A) if A.ndim == 2 else np.abs(A)
