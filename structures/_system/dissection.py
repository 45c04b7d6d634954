"""An order of elimination for large structures: nested dissection by the places of their nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

LEAF = 60  # nodes that are no longer divided
LARGE = 20_000  # rows from which on it is quicker than a minimum degree order, by a factor of three at 300 000
Array = NDArray[np.float64]
Index = NDArray[np.intp]


def order_of(structure: Any) -> Index | None:
    """Permutation of the free DOFs of a structure; None where it is small or its nodes have no places."""
    if structure.free.size < LARGE or structure.coordinates is None:
        return None
    node = np.array([structure.dofs[i].node for i in structure.free])
    every = np.unique(np.array([dof.node for dof in structure.dofs]))
    return dissected(structure.K_free, structure.coordinates[np.searchsorted(every, node)])


def dissected(A: Any, places: Array) -> Index:
    """Permutation (n,) under which a factor of `A` fills in little.

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
    rank[_divided((joins @ pattern @ joins.T).tocsr(), spots)] = np.arange(len(spots))
    return np.argsort(rank[node], kind="stable")


def _divided(graph: Any, spots: Array) -> Index:
    """Order (nodes,) of elimination."""
    order = np.empty(len(spots), np.intp)
    mark = np.zeros(len(spots), np.int8)
    waiting: list[tuple[Index, int]] = [(np.arange(len(spots)), 0)]
    while waiting:
        part, start = waiting.pop()
        if len(part) <= LEAF:
            order[start : start + len(part)] = part
            continue
        left, right = _halves(part, spots[part])
        mark[left] = 1
        touching = graph[right] @ mark > 0
        mark[left] = 0
        cut, right = right[touching], right[~touching]
        order[start + len(left) + len(right) : start + len(part)] = cut
        waiting += [(left, start), (right, start + len(left))]
    return order


def _halves(part: Index, spots: Array) -> tuple[Index, Index]:
    """A part cut at the median of its longest side; spots differ, so that neither half is empty."""
    along = spots[:, np.argmax(np.ptp(spots, axis=0))]
    right = along >= np.median(along)
    if right.all():  # the median is the smallest
        right = along > along.min()
    return part[~right], part[right]
