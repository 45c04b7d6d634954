"""Penalties L of the regularisation term: over samples, lines, grids, graphs and surfaces, and as spectral symbols.

Those of a field are scaled so that ``|L g|^2`` is the integral of ``|grad g|^2`` or of the squared second derivative:
the penalty then does not change with the mesh. They are sparse; `LinearProblem` takes them as they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain, reals

from .lines import degree, grid, line
from .surface import surface

if TYPE_CHECKING:
    from scipy.sparse import csr_array

__all__ = [
    "components", "difference", "graph", "grid", "line", "matrix", "names", "order", "stencil", "surface", "symbol",
]  # fmt: skip

# every named penalty is a difference of the order that stands here; all solvers take any order from this table
ORDER = {"identity": 0, "gradient": 1, "first_difference": 1, "laplacian": 2, "second_difference": 2}


def names() -> str:
    """The named penalties, for messages."""
    return ", ".join(ORDER)


def order(penalty: str) -> int:
    """Order of the difference that a named penalty takes; 0 is the load itself.

    Raises
    ------
    InputError
        A name that is none.
    """
    if penalty not in ORDER:
        raise InputError(
            "unknown penalty", where="penalty", found=repr(penalty), expected=f"one of {names()}, or a matrix"
        )
    return ORDER[penalty]


def stencil(degree: int) -> NDArray[np.float64]:
    """Coefficients (degree + 1,) of a difference of order `degree`, oldest sample first."""
    return difference(degree + 1, degree)[0]


def difference(samples: int, degree: int) -> NDArray[np.float64]:
    """Difference matrix of order `degree`, shape (samples - degree, samples): ends are free."""
    return np.asarray(np.diff(np.eye(samples), n=degree, axis=0), float)


def matrix(penalty: str | ArrayLike, samples: int, loads: int = 1) -> NDArray[np.float64] | None:
    """Penalty over load histories flattened as (samples, loads), time first.

    Parameters
    ----------
    penalty : str or array, shape (rows, samples * loads)
        A name, or a matrix of the user.

    Returns
    -------
    array, shape (rows, samples * loads), or None
        None stands for the identity, which needs no matrix.
    """
    if isinstance(penalty, str):
        degree = order(penalty)
        if degree == 0:
            return None
        if samples <= degree:
            raise InputError(
                "too few samples for this penalty",
                where="penalty",
                found=samples,
                expected=f"more than {degree} for {penalty}",
            )
        return np.asarray(np.kron(difference(samples, degree), np.eye(loads)), float)
    L = np.atleast_2d(reals(penalty, what="the penalty is no matrix of real numbers", where="penalty"))
    if L.ndim != 2 or L.shape[1] != samples * loads or not np.all(np.isfinite(L)):
        raise InputError(
            "the penalty matrix does not fit the unknowns",
            where="penalty",
            found=f"shape {L.shape}" + ("" if np.all(np.isfinite(L)) else " with NaN or inf"),
            expected=f"finite, shape (rows, {samples * loads})",
        )
    return L


def symbol(penalty: str, theta: NDArray) -> NDArray[np.float64]:
    """Modulus of a named penalty at the digital frequencies `theta` (rad/sample)."""
    return np.abs(2 * np.sin(theta / 2)) ** order(penalty)


def graph(n: int, edges: ArrayLike, weights: ArrayLike | None = None, kind: int | str = "gradient") -> csr_array:
    """Differences along the edges of a graph, or the graph Laplacian.

    Parameters
    ----------
    n : int
        Number of points.
    edges : array of int, shape (edges, 2)
    weights : array, shape (edges,), optional
        Positive, default 1. With the squared inverse length of each edge the differences become slopes.
    kind : str or int
        ``"gradient"`` (1): rows ``sqrt(w) (g_j - g_i)``. ``"laplacian"`` (2): rows ``sum_j w_ij (g_i - g_j)``.

    Returns
    -------
    sparse array, (edges, n) or (n, n)

    Raises
    ------
    InputError
        Edges that name no points or join a point to itself, or weights that are not positive.
    """
    from scipy.sparse import coo_array, csr_array

    ends, order = np.asarray(edges, int).reshape(-1, 2), degree(kind)
    w = np.ones(len(ends)) if weights is None else np.asarray(plain(weights), float)
    if len(ends) == 0 or ends.min() < 0 or ends.max() >= n or np.any(ends[:, 0] == ends[:, 1]):
        raise InputError("these are no edges of the graph", where="penalty", found=f"{len(ends)} edges",
                         expected=f"pairs of different points from 0 to {n - 1}")  # fmt: skip
    if w.shape != (len(ends),) or not np.all(np.isfinite(w)) or np.any(w <= 0):
        raise InputError("the weights of the edges do not fit", where="penalty", found=f"shape {w.shape}, or not > 0",
                         expected=f"{len(ends)} positive numbers")  # fmt: skip
    i, j = ends.T
    if order == 1:
        row, root = np.arange(len(ends)), np.sqrt(w)
        return csr_array(coo_array((np.r_[-root, root], (np.r_[row, row], np.r_[i, j])), shape=(len(ends), n)))
    values = np.r_[w, w, -w, -w]
    return csr_array(coo_array((values, (np.r_[i, j, i, j], np.r_[i, j, j, i])), shape=(n, n)))


def components(L: ArrayLike | csr_array, count: int) -> csr_array:
    """One penalty for each of `count` components of a vector load, (rows * count, points * count).

    The loads are numbered point by point: index = point * count + component.
    """
    from scipy.sparse import csr_array, eye_array, kron

    return csr_array(kron(csr_array(L), eye_array(count)))
