"""Sparse weighted least squares by orthogonal rotations: a front of dense QR factorisations passes over the columns.

The normal equations square the condition number, and are not formed. Rows wait until the front has reached their first
column; each block of columns is then eliminated by one dense QR factorisation, and what is left of its rows waits on
(A. George, M. T. Heath, Linear Algebra Appl. 34 (1980) 69-83; L. Reid's frontal form of it).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.csgraph import reverse_cuthill_mckee

Array = NDArray[np.float64]
BLOCK = 96  # columns that are eliminated at once
RANK = 1e-13  # diagonal over the length of the column, below which nothing determines an unknown


@dataclass(frozen=True, eq=False)
class Triangle:
    """``Q^T A P = R``, with the columns of A scaled to length one: solves, and answers how well unknowns are known.

    Parameters
    ----------
    R : sparse array, shape (n, n)
        Upper triangular.
    order : array of int, shape (n,)
        Column of A of each column of R.
    scale : array, shape (n,)
        Length of each column of A.
    solution : array, shape (n, k)
        Of the right-hand sides that the rotations were applied to.
    """

    R: sparse.csr_array
    order: NDArray[np.intp]
    scale: Array
    solution: Array

    def root(self, rows: Array) -> Array:
        """``R^-T rows^T``, (n, rows): its columns have the std of the rows of the solution as their length."""
        turned = (rows / self.scale)[:, self.order]
        return np.asarray(sparse.linalg.spsolve_triangular(self.R.T.tocsr(), turned.T, lower=True))


def undetermined(R: sparse.csr_array) -> NDArray[np.intp]:
    """Columns of R whose diagonal is rounding."""
    return np.flatnonzero(np.abs(R.diagonal()) <= RANK)


def factorise(A: sparse.csr_array, rhs: Array) -> tuple[Triangle, NDArray[np.intp]]:
    """Least squares of ``A x = rhs`` (m, n) and (m, k), and the unknowns that nothing determines.

    Where there are such unknowns the solution is not computed, and zero.
    """
    m, n = A.shape
    length = np.sqrt(np.asarray(A.multiply(A).sum(axis=0)).ravel())
    scale = np.where(length > 0, length, 1.0)
    touching = (A != 0).astype(np.float64)  # the graph of rows and columns, ordered together
    graph = sparse.csr_array(sparse.block_array([[None, touching], [touching.T, None]]))
    both = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True), np.intp)
    order = both[both >= m] - m
    B = sparse.csr_array(A @ sparse.diags_array(1 / scale))[:, order].tocsr()
    B.sort_indices()
    filled = np.flatnonzero(np.diff(B.indptr) > 0)
    first = B.indices[B.indptr[filled]]
    last = np.zeros(m, int)
    last[filled] = B.indices[B.indptr[filled + 1] - 1]
    k = rhs.shape[1]
    rest, stop = np.zeros((0, k)), 0  # rows that wait: columns from `start` to `stop`, then the right-hand sides
    blocks, turned = [], np.zeros((n, k))
    for start in range(0, n, BLOCK):
        end = min(start + BLOCK, n)
        new = filled[(first >= start) & (first < end)]
        reach = max(end, stop, int(last[new].max(initial=-1)) + 1)
        waiting = np.zeros((len(rest), reach - start + k))
        waiting[:, : max(stop - start, 0)] = rest[:, : max(stop - start, 0)]
        waiting[:, reach - start :] = rest[:, rest.shape[1] - k :]
        front = np.vstack([waiting, np.hstack([B[new][:, start:reach].toarray(), rhs[new]])])
        upper = linalg.qr(front, mode="r", check_finite=False)[0] if len(front) else front
        upper = upper[: min(len(upper), reach - start)]  # rows below have nothing left but what is not explained
        done = np.zeros((end - start, upper.shape[1]))
        done[: min(len(upper), end - start)] = upper[: end - start]
        blocks.append(sparse.csr_array(np.pad(done[:, : reach - start], ((0, 0), (start, n - reach)))))
        turned[start:end] = done[:, reach - start :]
        rest, stop = upper[end - start :, end - start :], reach
    R = sparse.csr_array(sparse.vstack(blocks, format="csr"))
    lost = order[undetermined(R)]
    solution = np.zeros((n, k))
    if not len(lost):
        solution[order] = sparse.linalg.spsolve_triangular(R, turned, lower=False).reshape(n, k)
        solution /= scale[:, None]
    return Triangle(R, order, scale, solution), lost
