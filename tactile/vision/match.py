"""Which dot of a frame is which marker: mutual nearest neighbours around a prediction, and what the neighbours do."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals

NONE = -1  # index of a marker without a dot
NEIGHBOURS = 8
RING = 24  # neighbours asked where fewer than three of the nearest are seen
ENOUGH = 3


def match(predicted: ArrayLike, found: ArrayLike, *, gate: float) -> NDArray[np.intp]:
    """Dot of every marker: each the nearest of the other, and not farther apart than the gate.

    Parameters
    ----------
    predicted : array, shape (N, 2)
        Where the markers are expected; NaN takes no part.
    found : array, shape (k, 2)
        Where dots were found.
    gate : float
        Largest distance, in the same unit.

    Returns
    -------
    array of int, shape (N,)
        Index of the dot of each marker, -1 for none.
    """
    expected, dots = places(predicted, "predicted"), places(found, "found")
    return Dots(dots).mutual(expected, positive("gate", gate, where="match"))


class Dots:
    """Dots of one frame, ready to be asked for the nearest of them.

    Parameters
    ----------
    points : array, shape (k, 2)
        Finite places.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        from scipy.spatial import cKDTree

        self.points = points
        self._tree = cKDTree(points, balanced_tree=False) if len(points) else None

    def mutual(self, expected: NDArray[np.float64], gate: float) -> NDArray[np.intp]:
        """Dot of every marker, each the nearest of the other within the gate; -1 for none, shape (N,)."""
        from scipy.spatial import cKDTree

        index = np.full(len(expected), NONE, np.intp)
        asked = np.flatnonzero(np.isfinite(expected).all(axis=1))
        if len(asked) == 0 or self._tree is None:
            return index
        distance, dot = self._tree.query(expected[asked])
        back = cKDTree(expected[asked], balanced_tree=False).query(self.points)[1]
        both = (back[dot] == np.arange(len(asked))) & (distance <= gate)
        index[asked[both]] = dot[both]
        return index

    def offers(self, expected: NDArray[np.float64], gate: float) -> NDArray[np.float64]:
        """Vector from every marker to its nearest dot within the gate that is no nearer to another one, NaN for none.

        A quicker and looser question than `mutual`, for a first look; all places must be finite.
        """
        offered = np.full_like(expected, np.nan)
        if self._tree is None:
            return offered
        distance, dot = self._tree.query(expected)
        near = np.argsort(-distance, kind="stable")
        owner = np.empty(len(self.points), np.intp)
        owner[dot[near]] = near  # the nearest of those that ask for a dot is written last
        own = (owner[dot] == np.arange(len(expected))) & (distance <= gate)
        offered[own] = self.points[dot[own]] - expected[own]
        return offered


def places(points: ArrayLike, name: str) -> NDArray[np.float64]:
    """Points of a plane, shape (n, 2); an empty list is none.

    Raises
    ------
    InputError
        Another shape.
    """
    array = reals(points, where=name)
    array = array.reshape(0, 2) if array.size == 0 else array
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError("no points of a plane", where=name, found=f"shape {array.shape}", expected="(points, 2)")
    return array


class Neighbourhood:
    """The neighbours of every marker of a pattern at rest.

    Parameters
    ----------
    points : array, shape (N, 2)
        Markers at rest.

    Attributes
    ----------
    pitch : float
        Median distance to the nearest neighbour.
    """

    def __init__(self, points: ArrayLike) -> None:
        from scipy.spatial import cKDTree

        rest = places(points, "markers")
        tree, count = cKDTree(rest), min(len(rest), RING + 1)
        distance, index = tree.query(rest, k=count)
        self.pitch = float(np.median(distance[:, 1]))
        self._ring = index[:, 1:]
        self._near = index[:, 1 : NEIGHBOURS + 1]

    def median(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Median over the neighbours of each marker, per component; NaN where fewer than three are known.

        Parameters
        ----------
        values : array, shape (N, components)
            NaN = not known.
        """
        middle = _median(values[self._near])
        alone = np.flatnonzero(np.isnan(middle).any(axis=1))
        if len(alone):
            middle[alone] = _median(values[self._ring[alone]])
        return middle


def _median(values: NDArray[Any]) -> NDArray[np.float64]:
    """Median over the second axis that leaves NaN out, shape (n, components); NaN where fewer than three are known."""
    ordered = np.sort(values, axis=1)  # NaN last
    count = np.isfinite(values).sum(axis=1, keepdims=True)
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=1)
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[1] - 1), axis=1)
    few = (count < min(ENOUGH, values.shape[1]))[:, 0]
    return np.where(few, np.nan, 0.5 * (low + high)[:, 0])
