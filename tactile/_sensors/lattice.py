"""Loads that are linear between the points of a square lattice: few enough that all they make is known beforehand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from .._arrays import Array, Index, Mask

PITCH = 0.5  # of the lattice, in thicknesses
NEAR = 0.5  # thicknesses about a contact within which loads may act


@dataclass(frozen=True, eq=False)
class Lattice:
    """Hat functions on a square lattice over a surface.

    `hats` (P, k) sparse are their values at the nodes, `block` (P,) says in which square of the lattice a node lies,
    `near` (blocks, k) which hats lie within a thickness of each square that has nodes.
    """

    hats: sparse.csc_array
    block: Index
    near: Mask

    @classmethod
    def over(cls, places: Array, thickness: float) -> Lattice:
        """Of nodes at places (P, 2), on a gel of such thickness (m)."""
        at = places / (PITCH * thickness)
        at = at - at.min(axis=0)
        corner = np.floor(at).astype(int)
        part = at - corner
        steps = np.array([(0, 0), (1, 0), (0, 1), (1, 1)])
        points = corner[:, None] + steps
        values = np.prod(np.where(steps, part[:, None], 1 - part[:, None]), axis=2)
        used, column = np.unique(points[values > 0], axis=0, return_inverse=True)
        node = np.repeat(np.arange(len(at)), len(steps)).reshape(values.shape)[values > 0]
        hats = sparse.csc_array((values[values > 0], (node, column.ravel())), shape=(len(at), len(used)))
        squares, block = np.unique(corner, axis=0, return_inverse=True)
        # from the rim of a square: as far as from any node in it
        beyond = np.maximum(np.abs(used - squares[:, None] - 0.5) - 0.5, 0.0)
        near = np.hypot(*np.moveaxis(beyond, -1, 0)) <= NEAR / PITCH
        return cls(hats, block.ravel().astype(np.intp), near)
