"""Factorisation of a pair (H, L) by scaled QR and SVD, and the loads that neither of them sees, by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Option
from structures.errors import InputError, NotIdentifiable

EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Factors:
    """Modes of a pair: ``H X = U diag(c)``, ``|L X e_i| = s_i``, ``X^-1 = Y^T``.

    Parameters
    ----------
    U : array, shape (m, min(m, n))
    c, s : array, shape (n,)
    X, Y : array, shape (n, n)
        Modes of the load, and their dual: ``Y.T @ X`` is the identity.
    meeting : float
        Smallest singular value of ``[H / |H|; L / |L|]``: zero where the null spaces of H and L meet.
    balance : float
        ``|H| / |L|``: the absolute lambda at which the two terms weigh the same.
    """

    U: NDArray[np.float64]
    c: NDArray[np.float64]
    s: NDArray[np.float64]
    X: NDArray[np.float64]
    Y: NDArray[np.float64]
    meeting: float
    balance: float


def plain(H: NDArray) -> Factors:
    """Ordinary SVD, L = I."""
    U, c, Wt = svd(H)
    n = H.shape[1]
    return Factors(U, pad(c, n), np.ones(n), Wt.T, Wt.T, 1.0, float(c[0]))


def paired(H: NDArray, L: NDArray, labels: Sequence[str] | None = None) -> Factors:
    """Modes of (H, L) from the QR of ``[H; alpha L]`` and the SVD of its upper block.

    The sines come from the lower block, not from sqrt(1 - c^2), which loses every digit where c is near 1; the scaling
    alpha = |H| / |L| keeps the digits of the smaller block. Hansen (1998), sec. 2.1.

    Raises
    ------
    InputError
        If the penalty is zero.
    NotIdentifiable
        If the null spaces meet (LID-E306); the message names the loads.
    """
    import scipy.linalg

    m, n = H.shape
    if not np.any(L):
        raise InputError("the penalty matrix is zero", where="penalty", expected="a matrix that penalises something")
    weights = L.diagonal()
    if L.shape == (n, n) and np.all(weights != 0) and np.count_nonzero(L) == n:
        return weighted(H, weights)
    size = norm2(H) or 1.0
    alpha = size / norm2(L)
    stack = np.empty((m + len(L), n), order="F")
    stack[:m], stack[m:] = H, L
    stack[m:] *= alpha
    Q, R = scipy.linalg.qr(stack, mode="economic", overwrite_a=True, check_finite=False)
    upper, lower = np.asfortranarray(Q[:m]), Q[m:].copy()
    del stack, Q
    meeting = _smallest(R, n, labels) / size
    U, c, Wt = svd(upper, overwrite=True)
    W = Wt.T
    s = np.linalg.norm(lower @ W, axis=0) / alpha
    return Factors(U, pad(c, n), s, scipy.linalg.solve_triangular(R, W), R.T @ W, meeting, alpha)


def weighted(H: NDArray, weights: NDArray) -> Factors:
    """Modes of (H, diag(weights)): the SVD of H diag(1 / weights), no more than without a penalty."""
    U, c, Wt = svd(H / weights)
    n, W = H.shape[1], Wt.T
    balance = norm2(H) / float(np.abs(weights).max())
    least = float(np.abs(weights).min() / np.abs(weights).max())
    return Factors(U, pad(c, n), np.ones(n), W / weights[:, None], W * weights[:, None], least, balance)


def augmented(H: NDArray, L: NDArray, y: NDArray, x: float) -> NDArray[np.float64]:
    """Tikhonov solution (n,) or (n, frames) at the absolute lambda `x`, by Householder QR of ``[x L; H]``.

    The most accurate way at one small lambda: an SVD rotates the rounding of the data into the weak modes.
    """
    import scipy.linalg

    n, rows = H.shape[1], len(L)
    data = y.reshape(len(y), -1)
    stack = np.zeros((rows + len(H), n + data.shape[1]), order="F")
    stack[:rows, :n], stack[rows:, :n], stack[rows:, n:] = L, H, data
    stack[:rows, :n] *= x
    R = scipy.linalg.qr(stack, mode="r", overwrite_a=True, check_finite=False)[0]
    return scipy.linalg.solve_triangular(R[:n, :n], R[:n, n:]).reshape(n, *y.shape[1:])


def svd(A: NDArray, overwrite: bool = False) -> tuple[NDArray, NDArray, NDArray]:
    """SVD by divide and conquer, with all right vectors: U (m, r), c (r,), Wt (n, n)."""
    import scipy.linalg

    m, n = A.shape
    U, c, Wt = scipy.linalg.svd(A, full_matrices=m < n, overwrite_a=overwrite, check_finite=False)
    return U[:, : len(c)], c, Wt


def pad(x: NDArray, n: int) -> NDArray:
    """`x` with zeros up to length `n` on its first axis."""
    return x if len(x) >= n else np.concatenate([x, np.zeros((n - len(x), *x.shape[1:]), x.dtype)])


def norm2(A: NDArray, steps: int = 30) -> float:
    """Spectral norm, to a few per cent, from power iterations."""
    top = float(np.abs(A).max(initial=0.0))
    x: NDArray = np.random.default_rng(0).standard_normal((A.shape[1],))
    size = 0.0
    for _ in range(steps if top > 0 else 0):
        x = x / np.linalg.norm(x)
        y = A @ x / top  # squares stay within the range of numbers
        size = float(np.linalg.norm(y))
        x = A.T @ y / top
        if not np.any(x):
            break
    return size * top


def _smallest(R: NDArray, n: int, labels: Sequence[str] | None) -> float:
    """Smallest singular value of the triangle; refuses where it is rounding."""
    if len(R) == n:
        diagonal = np.abs(np.diag(R))
        value = _inverse_iteration(R) if diagonal.min() > n * EPS * diagonal.max() else 0.0
        if value > 100 * n * EPS * diagonal.max():
            return value
    vectors_t, values = np.linalg.svd(R)[2], np.zeros(n)
    values[: len(R)] = np.linalg.svdvals(R)
    unseen = values <= n * EPS * values[0]
    if np.any(unseen):
        count = int(np.sum(unseen))
        loads = "one load pattern is" if count == 1 else f"{count} load patterns are"
        raise NotIdentifiable(
            f"{loads} seen neither by the sensors nor by the penalty (relative singular value "
            f"{values[-1] / values[0]:.2g}): {names(vectors_t[unseen].T, labels)}",
            advice=Advice(
                "add a sensor that sees it, or use ",
                Option("penalty", "identity"),
                " (with a resultant as a constraint, if known)",
            ),
            code="LID-E306",
        )
    return float(values[-1])


def _inverse_iteration(R: NDArray, steps: int = 8) -> float:
    """Smallest singular value of a regular triangle, from above: the cost is a few triangular solves."""
    from scipy.linalg import solve_triangular

    x = np.linalg.qr(np.random.default_rng(0).standard_normal((len(R), min(4, len(R)))))[0]
    growth = 0.0
    for _ in range(steps):
        z = solve_triangular(R, x, trans="T", check_finite=False)
        growth = float(np.linalg.norm(z, 2))
        x = solve_triangular(R, z / growth, check_finite=False)
        x = np.linalg.qr(x)[0]
    return 1 / growth


def names(directions: NDArray, labels: Sequence[str] | None = None, most: int = 5) -> str:
    """Load patterns in words: constant, linear in the order of the loads, or the loads with the largest entries.

    Parameters
    ----------
    directions : array, shape (n, k)
        Orthonormal patterns.
    labels : sequence of str, optional
        Names of the loads; default their numbers.
    """
    n = len(directions)
    plain = np.linalg.qr(np.vander(np.linspace(-1, 1, n), 2, increasing=True))[0] if n > 1 else np.ones((1, 1))
    turn, shared, mix = np.linalg.svd(directions.T @ plain)
    inside = int(np.sum(shared > 1 - 1e-6))  # patterns that are a constant plus a slope
    rest, found = directions @ turn[:, inside:], []
    if inside == 2 or (inside == 1 and abs(mix[0, 0]) > 1 - 1e-6):
        found.append("constant over all loads")
    if inside == 2 or (inside == 1 and not found):
        found.append("linear in the order of the loads")
    if rest.shape[1]:
        size = np.linalg.norm(rest, axis=1)
        largest = [k for k in np.argsort(-size, kind="stable")[:most] if size[k] > 0.01 * size.max()]
        who = [str(k) if labels is None else labels[k] for k in largest]
        found.append(f"largest at {'unknowns' if labels is None else 'loads'} [{', '.join(who)}]")
    return "; ".join(found)
