"""The surface that a map lives on: places, areas, resultants and neighbours, as plain arrays that a result carries."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from structures.channels import Channel
from structures.values import plain

if TYPE_CHECKING:
    from .pad import Pad

Array = NDArray[np.float64]
AXES = "XYZ"
RESULTANTS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


def of_pad(pad: Pad, kind: str = "hats") -> dict[str, Any]:
    """Geometry of the surface of a pad, for tractions (``"hats"``) or nodal forces (``"nodal"``)."""
    surface = pad.surface
    mass = surface.mass.tocsr()
    whole = wrenches(surface.coordinates, pad.top)
    if kind == "hats":
        whole = np.asarray((sparse.kron(mass, sparse.eye_array(3)).T @ whole.T).T)
    return {
        "coordinates": surface.coordinates,
        "cells": surface.cells,
        "components": ["+X", "+Y", "+Z"],
        "kind": kind,
        "extents": None,
        "measures": surface.areas,
        "resultant": whole,
        "resultant_labels": list(RESULTANTS),
        "traction": None,
        "about": np.asarray(pad.top, float),
        "mass_data": mass.data,
        "mass_indices": mass.indices,
        "mass_indptr": mass.indptr,
    }


def of_points(places: Array, area: float, about: Any) -> dict[str, Any]:
    """Geometry of point forces on a grid, each with its share of the area."""
    return {
        "coordinates": places,
        "cells": None,
        "components": ["+X", "+Y", "+Z"],
        "kind": "nodal",
        "extents": None,
        "measures": np.full(len(places), float(area)),
        "resultant": wrenches(places, about),
        "resultant_labels": list(RESULTANTS),
        "traction": None,
        "about": np.asarray(plain(about), float),
    }


def wrenches(places: Array, about: Any) -> Array:
    """Force and moment (6, 3 n) of unit forces at places (n, 3)."""
    arms = places - np.asarray(plain(about), float)
    out = np.zeros((6, len(places), 3))
    for k, unit in enumerate(np.eye(3)):
        out[k, :, k] = 1.0
        out[3:, :, k] = np.cross(arms, unit).T
    return out.reshape(6, -1)


def channels(points: int, kind: str) -> list[Channel]:
    """A load for each node and component."""
    quantity, unit = ("pressure", "Pa") if kind == "hats" else ("force", "N")
    return [Channel(label=f"n{i}+{a}", quantity=quantity, unit=unit) for i in range(points) for a in AXES]


def neighbours(cells: NDArray | None, places: Array) -> sparse.csr_array:
    """Which points share a cell; on a grid without cells, which lie within one and a half pitches."""
    count = len(places)
    if cells is not None:
        corners = np.asarray(cells)
        n = corners.shape[1]
        i, j = np.repeat(corners, n, axis=1).ravel(), np.tile(corners, (1, n)).ravel()
        return sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(count, count))
    from scipy.spatial import cKDTree

    tree = cKDTree(places[:, :2])
    pitch = float(np.median(tree.query(places[:, :2], k=2)[0][:, 1]))
    pairs = tree.query_pairs(1.5 * pitch, output_type="ndarray")
    i, j = np.vstack([pairs, pairs[:, ::-1]]).T
    return sparse.csr_array((np.ones(len(i), bool), (i, j)), shape=(count, count))
