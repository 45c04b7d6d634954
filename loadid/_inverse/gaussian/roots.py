"""Triangular roots of covariances: their algebra, the noise of a step, and Riccati maps that are joined and doubled.

``P - F P F^T`` loses every digit of the noise of a short step (all of a Matern-5/2 load at a thousandth of its length),
and so does Van Loan's exponential. A quadrature adds only: its root is a triangular factor of weighted impulse
responses, with the relative accuracy of each of its columns.

A sample maps the predicted covariance P to ``L L^T + F P (I + M M^T P)^-1 F^T``; with ``M M^T = H^T R^-1 H`` and
``L L^T = Q``. Maps of this form are closed under composition, so that samples of any kind can be joined and a map
doubled. Chu, Fan, Lin & Wang, Int. J. Control 77 (2004) 767, for the doubling; here X and G are carried as roots, which
stay positive and feel no scale of the states.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEW = 1000  # entries of a right-hand side below which `dtrsm` keeps to one thread; `dtrtrs` wakes all of them for any
NARROW, WIDE, LARGE = 4, 16, 100  # columns that `dtpqrt` reflects together, and the size from which it is the more


@lru_cache(maxsize=1)
def lapack() -> tuple[Any, Any, Any]:
    """``dgeqrf``, ``dtrtrs``, ``dtpqrt``, found once: numpy's QR copies and costs more than the work at these sizes.

    All are called by position, as names cost a microsecond: (a, lwork, overwrite), (a, b, lower, trans),
    (l, block, a, b, overwrite a, overwrite b).
    """
    from scipy.linalg.lapack import dgeqrf, dtpqrt, dtrtrs

    return dgeqrf, dtrtrs, dtpqrt


@lru_cache(maxsize=1)
def blas() -> Any:
    """``dtrsm`` by position: (alpha, a, b, side, lower, trans)."""
    from scipy.linalg.blas import dtrsm

    return dtrsm


@lru_cache(maxsize=64)
def below(rows: int, columns: int) -> Array:
    """Ones on and below the diagonal."""
    ones = np.tril(np.ones((rows, columns)))
    ones.setflags(write=False)
    return ones


def reflected(wide: Array) -> Array:
    """``L`` with ``L L^T = wide wide^T`` in the lower triangle of what is returned; above it lie left-overs.

    Parameters
    ----------
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    made = lapack()[0](wide.T, 32 * max(len(wide), 1), 1)[0].T
    return np.asarray(made[:, : min(made.shape)])


def lower(*parts: Array) -> Array:
    """Lower triangular (trapezoidal) root of the sum of ``part part^T``; parts have shapes (n, any)."""
    wide = np.concatenate(parts, axis=1)
    if not wide.size:
        return np.zeros((len(wide), 0))
    made = reflected(np.ascontiguousarray(wide, float))
    return made * below(*made.shape)


def square(L: Array) -> Array:
    """The same root with columns of zeros up to a square."""
    out = np.zeros((len(L), len(L)))
    out[:, : L.shape[1]] = L
    return out


def joined(L: Array, wide: Array) -> Array:
    """Lower triangular root of ``L L^T + wide wide^T`` for a lower triangular L (n, n), which is half of the work.

    Parameters
    ----------
    L : array, shape (n, n), C-contiguous
    wide : array, shape (n, k), C-contiguous
        Overwritten.
    """
    if not wide.size:
        return L
    block = min(NARROW if len(L) < LARGE else WIDE, len(L))
    made: Array = lapack()[2](0, block, L.copy().T, wide.T, 1, 1)[0].T
    return made


def solve_lower(L: Array, b: Array) -> Array:
    """``L^-1 b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    if b.ndim == 2 and b.size < FEW and len(L) and np.diagonal(L).all():
        return np.asarray(blas()(1.0, L, b, 0, 1))
    return lapack()[1](L, b, 1)[0] if len(L) else np.array(b, float)


def solve_lower_transposed(L: Array, b: Array) -> Array:
    """``L^-T b`` for a lower triangular L (k, k) and b (k,) or (k, columns)."""
    if b.ndim == 2 and b.size < FEW and len(L) and np.diagonal(L).all():
        return np.asarray(blas()(1.0, L, b, 0, 1, 1))
    return lapack()[1](L, b, 1, 1)[0] if len(L) else np.array(b, float)


NODES = 8  # exact to degree 15: 2e-15 of the noise at the step below
STEP = 0.5  # largest norm of F times the step that one rule covers; longer steps are doubled up to
TERMS = 24  # of the exponential series at that norm: the rest is below 1e-30


def step(F: Array, b: Array, dt: float) -> tuple[Array, Array]:
    """Transition and noise of ``dx = F x dt + b dW`` over a step.

    Parameters
    ----------
    F : array, shape (n, n)
        1/s.
    b : array, shape (n, q)
        Root of the density of the white noise.
    dt : float
        Step in s.

    Returns
    -------
    E : array, shape (n, n)
        ``exp(F dt)``.
    L : array, shape (n, n)
        Lower triangular, ``L L^T`` the integral of ``exp(F s) b b^T exp(F s)^T`` over the step; (n, k) where the
        noise has k < n directions.

    Notes
    -----
    Gauss-Legendre nodes over a part of the step that is short against F, then ``L(2h) = lower [E(h) L(h), L(h)]`` and
    ``E(2h) = E(h)^2`` as often as it takes. The series acts on `b` directly, so that entries of a high power of the
    step are as right as those of a low one.
    """
    F, b, unit = _balanced(F, b)
    size = float(np.abs(F).sum(axis=1).max(initial=0.0)) * dt
    doublings = max(0, int(np.ceil(np.log2(size / STEP)))) if size > 0 else 0
    h = dt / 2**doublings
    places, weights = leggauss(NODES)
    weighed = zip(places, weights, strict=True)
    pushes = [np.sqrt(0.5 * h * w) * _propagated(F, b, 0.5 * h * (1 + s)) for s, w in weighed]
    E, L = _propagated(F, np.eye(len(F)), h), lower(*pushes)
    for _ in range(doublings):
        L = lower(E @ L, L)
        E = E @ E
    return unit[:, None] * E / unit, unit[:, None] * L


def _balanced(F: Array, b: Array) -> tuple[Array, Array, Array]:
    """In units of the states (powers of two) in which no entry stands out: units of loads ask for no doublings."""
    from scipy.linalg import matrix_balance

    if len(F) == 0:
        return F, b, np.ones(0)
    even, (unit, _) = matrix_balance(F, permute=False, separate=True)
    return even, b / unit[:, None], unit


def _propagated(F: Array, b: Array, s: float) -> Array:
    """``exp(F s) b`` by its series, for a small ``F s``."""
    terms = [np.asarray(b, float)]
    for k in range(1, TERMS):
        terms.append(F @ terms[-1] * (s / k))
    return np.asarray(np.sum(terms[::-1], axis=0))  # the small ones first


DOUBLINGS = 40
SETTLED = 1e-14  # share of a variance that a doubling may still add


@dataclass(frozen=True, eq=False)
class Riccati:
    """``P -> L L^T + F P (I + M M^T P)^-1 F^T``; F (n, n), L (n, any), M (n, any)."""

    F: Array
    L: Array
    M: Array


def composed(first: Riccati, second: Riccati) -> tuple[Riccati, Array]:
    """`second` after `first`, and the root (n, any) of what `first` adds to the variance of `second`."""
    S = second.M.T @ first.L
    right = lower(np.eye(S.shape[1]), S.T)  # right right^T = I + S^T S
    left = lower(np.eye(S.shape[0]), S)
    carried = solve_lower(right, first.L.T).T  # root of X (I + G X)^-1
    told = solve_lower(left, second.M.T).T  # root of G (I + X G)^-1
    through = first.F - carried @ solve_lower(right, S.T @ (second.M.T @ first.F))
    added = second.F @ carried
    return Riccati(second.F @ through, lower(added, second.L), lower(first.M, first.F.T @ told)), added


def fixed_point(step: Riccati) -> tuple[Array, int, bool]:
    """Root of the covariance that the map reaches from zero; doublings taken, and whether it settled.

    The root after k doublings is that after 2^k samples: a variance without bound shows itself by growing on.
    """
    for k in range(1, DOUBLINGS + 1):
        with np.errstate(all="ignore"):  # what grows on without bound ends as inf
            step, added = composed(step, step)
        if not np.all(np.isfinite(step.L)):
            return step.L, k, False
        total = np.sum(step.L**2, axis=1)
        if np.all(np.sum(added**2, axis=1) <= SETTLED * total):
            return step.L, k, True
    return step.L, DOUBLINGS, False


def joined_maps(first: Riccati, second: Riccati) -> Riccati:
    """`second` after `first`."""
    return composed(first, second)[0]
