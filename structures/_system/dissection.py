"""An order of elimination for large structures: nested dissection by the places of their nodes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

LEAF = 60  # nodes that are no longer divided
BYTES = 20.0  # for each entry of one factor: two of them, their indices, and what lies idle while they are made
LARGE = 20_000  # rows from which on it is quicker than a minimum degree order, by a factor of three at 300 000
Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Elimination:
    """An order of elimination, and what its factor takes.

    Parameters
    ----------
    order : int array (n,)
    entries : int
        Of a triangular factor, about: each part with those that border on it is taken as full, as it nearly is when its
        turn comes.
    """

    order: Index
    entries: int

    @property
    def memory(self) -> float:
        """Bytes of both triangular factors, about."""
        return BYTES * self.entries


def elimination_of(structure: Any) -> Elimination | None:
    """Elimination of the free DOFs of a structure; None where it is small or its nodes have no places."""
    if structure.free.size < LARGE or structure.coordinates is None:
        return None
    node = np.array([structure.dofs[i].node for i in structure.free])
    every = np.unique(np.array([dof.node for dof in structure.dofs]))
    return dissected(structure.K_free, structure.coordinates[np.searchsorted(every, node)])


def dissected(A: Any, places: Array) -> Elimination:
    """Order under which a factor of `A` fills in little.

    Each part is cut at the median of its longest side; the nodes on one side that touch the other are eliminated last.

    Parameters
    ----------
    A : sparse (n, n)
        Of symmetric pattern.
    places : array (n, dim)
        Of the node of every row; rows at one place stay together.

    Notes
    -----
    A. George, "Nested dissection of a regular finite element mesh", SIAM J. Numer. Anal. 10 (1973) 345-363.
    """
    spots, node = np.unique(places, axis=0, return_inverse=True)
    node = node.ravel()
    rows = (node, np.arange(len(node)))
    joins = sparse.csr_array((np.ones(len(node), np.int32), rows), shape=(len(spots), len(node)))
    pattern = sparse.csr_array((np.ones(A.nnz, np.int32), A.indices, A.indptr), shape=A.shape)
    rank = np.empty(len(spots), np.intp)
    order, entries = _divided((joins @ pattern @ joins.T).tocsr(), spots, np.bincount(node))
    rank[order] = np.arange(len(spots))
    return Elimination(np.argsort(rank[node], kind="stable"), entries)


def _divided(graph: Any, spots: Array, size: Index) -> tuple[Index, int]:
    """Order (nodes,) of elimination, and entries of the factor; size: rows of each node."""
    order = np.empty(len(spots), np.intp)
    mark = np.zeros(len(spots), np.int8)
    waiting: list[tuple[Index, int]] = [(np.arange(len(spots)), 0)]
    entries = 0

    def front(pivots: Index, part: Index) -> int:
        mark[part] = 1
        near = np.unique(graph[part].indices)
        border = int(size[near[mark[near] == 0]].sum())
        mark[part] = 0
        rows = int(size[pivots].sum())
        return rows * (rows + 1) // 2 + rows * border

    while waiting:
        part, start = waiting.pop()
        if len(part) <= LEAF:
            order[start : start + len(part)] = part
            entries += front(part, part)
            continue
        left, right = _halves(part, spots[part])
        mark[left] = 1
        touching = graph[right] @ mark > 0
        mark[left] = 0
        cut, right = right[touching], right[~touching]
        order[start + len(left) + len(right) : start + len(part)] = cut
        entries += front(cut, part)
        waiting += [(left, start), (right, start + len(left))]
    return order, entries


def _halves(part: Index, spots: Array) -> tuple[Index, Index]:
    """A part cut at the median of its longest side; spots differ, so that neither half is empty."""
    along = spots[:, np.argmax(np.ptp(spots, axis=0))]
    right = along >= np.median(along)
    if right.all():  # the median is the smallest
        right = along > along.min()
    return part[~right], part[right]
