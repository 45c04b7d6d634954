"""Derivatives of a field along a line of points and over a rectangular grid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import plain

if TYPE_CHECKING:
    from scipy.sparse import csr_array

KINDS = {"gradient": 1, "first_difference": 1, "laplacian": 2, "second_difference": 2}


def degree(kind: int | str) -> int:
    """Order of the derivative that a penalty over places takes: 1 or 2.

    Raises
    ------
    InputError
        If it is neither.
    """
    found = KINDS.get(kind) if isinstance(kind, str) else kind
    if isinstance(found, bool) or found not in (1, 2):
        raise InputError("no such penalty over places", where="penalty", found=repr(kind),
                         expected="'gradient' (1) or 'laplacian' (2)")  # fmt: skip
    return int(found)


def line(n: int, order: int | str, spacing: float | ArrayLike = 1.0) -> csr_array:
    """First or second derivative along a line of points, at any spacing; the ends are free.

    Parameters
    ----------
    n : int
        Number of points.
    order : int or str
        1 or 2, or a named penalty of that order.
    spacing : float or array, shape (n - 1,)
        Distances between neighbours, m.

    Returns
    -------
    sparse array, shape (n - order, n)
        ``|L g|^2`` is the sum of the squared derivative times the length that it stands for. With spacing 1 these are
        the plain differences; polynomials below the order cost nothing.

    Raises
    ------
    InputError
        Too few points, another order, or distances that are not positive.
    """
    from scipy.sparse import csr_array, diags_array

    d = degree(order)
    if n <= d:
        raise InputError("too few points for this penalty", where="penalty", found=n, expected=f"more than {d}")
    h = _steps(spacing, n)
    slope = diags_array([-1 / h, 1 / h], offsets=[0, 1], shape=(n - 1, n))
    if d == 1:
        return csr_array(diags_array(np.sqrt(h)) @ slope)
    middle = (h[1:] + h[:-1]) / 2
    change = diags_array([-np.ones(n - 2), np.ones(n - 2)], offsets=[0, 1], shape=(n - 2, n - 1))
    return csr_array(diags_array(1 / np.sqrt(middle)) @ change @ slope)


def grid(shape: Sequence[int], kind: int | str = "gradient", spacing: Any = 1.0) -> csr_array:
    """Gradient or Laplacian of a field over a rectangular grid of points, by multilinear elements.

    Parameters
    ----------
    shape : sequence of int
        Points along each axis; the load is the flattened array, last axis fastest.
    kind : str or int
        ``"gradient"`` (1) or ``"laplacian"`` (2).
    spacing : float, or sequence with a float or an array (points - 1,) for each axis
        Distances between neighbours, m.

    Returns
    -------
    sparse array, (rows, points)
        The operator that `surface` makes of the same mesh of quadrilaterals, from products of lines. One axis: `line`.

    Raises
    ------
    InputError
        Fewer than two points along an axis, another kind, or distances that are not positive.
    """
    from scipy.sparse import csr_array, diags_array, vstack

    shape, d = tuple(int(n) for n in shape), degree(kind)
    steps = [spacing] * len(shape) if np.isscalar(spacing) else list(spacing)
    if not shape or min(shape) < 2 or len(steps) != len(shape):
        raise InputError("no grid", where="penalty", found=f"shape {shape}, {len(steps)} spacings",
                         expected="at least two points and one spacing along each axis")  # fmt: skip
    if len(shape) == 1:
        return line(shape[0], d, steps[0])
    widths = [_steps(h, n) for h, n in zip(steps, shape, strict=True)]
    slopes = [line(n, 1, h) for n, h in zip(shape, widths, strict=True)]
    if d == 1:
        roots = [_mass_root(h) for h in widths]
        return csr_array(vstack([_product(roots, slopes[k], k) for k in range(len(shape))]))
    masses = [_mass(h) for h in widths]
    lumped = [m.sum(axis=1) for m in masses]
    stiffness = sum(_product(masses, _stiffness(h), k) for k, h in enumerate(widths))
    area = lumped[0]
    for m in lumped[1:]:
        area = np.kron(area, m)
    return csr_array(diags_array(1 / np.sqrt(area)) @ stiffness)


def _steps(spacing: float | ArrayLike, n: int) -> NDArray[np.float64]:
    h = np.asarray(plain(spacing), float)
    if h.shape not in {(), (n - 1,)} or not np.all(np.isfinite(h)) or np.any(h <= 0):
        raise InputError("no spacing of points", where="penalty", found=f"shape {h.shape}, or not > 0",
                         expected=f"a positive distance, or {n - 1} of them")  # fmt: skip
    return np.broadcast_to(h, (n - 1,)).astype(float)


def _mass(h: NDArray) -> csr_array:
    """Gram matrix of the hat functions of a line."""
    from scipy.sparse import csr_array, diags_array

    diagonal = (np.r_[h, 0.0] + np.r_[0.0, h]) / 3
    return csr_array(diags_array([h / 6, diagonal, h / 6], offsets=[-1, 0, 1]))


def _mass_root(h: NDArray) -> csr_array:
    """Upper bidiagonal C with C^T C = the Gram matrix of the hat functions: its Cholesky factor."""
    from scipy.linalg import cholesky_banded
    from scipy.sparse import csr_array, diags_array

    M = _mass(h)
    band = cholesky_banded(np.stack([np.r_[0.0, M.diagonal(1)], M.diagonal()]))
    return csr_array(diags_array([band[1], band[0, 1:]], offsets=[0, 1]))


def _stiffness(h: NDArray) -> csr_array:
    """Integrals of products of the slopes of the hat functions of a line."""
    from scipy.sparse import csr_array, diags_array

    return csr_array(diags_array([-1 / h, np.r_[1 / h, 0.0] + np.r_[0.0, 1 / h], -1 / h], offsets=[-1, 0, 1]))


def _product(factors: Sequence[csr_array], at: csr_array, axis: int) -> csr_array:
    """Kronecker product of `factors`, with `at` in place of one of them."""
    from scipy.sparse import csr_array, kron

    parts = [at if k == axis else f for k, f in enumerate(factors)]
    whole = parts[0]
    for part in parts[1:]:
        whole = kron(whole, part)
    return csr_array(whole)
