"""Invariant zeros of a sampled system: loads that leave no trace in any sensor, and how late sensors hear of a load."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

ZERO = 1e-9  # singular value of the scaled system matrix below which a candidate is a zero
BLIND = 1e-12  # the same at a point drawn at random: below it, every point is a zero
FAR = 1e4  # modulus beyond which a candidate is one at infinity, smeared by rounding
SAME = 1e-5  # distance of two candidates that are one: rounding splits a double zero by the root of 1e-16 and more
OUTER, ALIKE = 1.2, 5e-3  # outside this modulus sensors share zeros of sampling nearly, not quite: relative distance
SHARED = 1e-3  # distance within which two mixtures may have the same zero
ITERATIONS, SETTLED = 100, 1e-4  # of the inverse iteration: at most, and until a step changes as little
RANK = 1e-9  # singular value over the largest that is rounding


def invariant_zeros(A: Array, B: Array, C: Array, D: Array) -> Complex | None:
    """Finite points z where ``[A - z I, B; C, D]`` loses column rank, ascending in modulus.

    A load that moves as ``z^k`` in the right direction, from the right state, is then unseen by all sensors. On or
    outside the unit circle it never dies out, and no filter without a prior of the load follows it.

    Parameters
    ----------
    A, B, C, D : arrays, shapes (n, n), (n, p), (m, n), (m, p)
        Rows of C and D in units of the noise, columns of B and D in units of the load.

    Returns
    -------
    array, complex, or None
        None where every z is a zero: fewer sensors than loads, or loads that no sensor tells apart.

    Notes
    -----
    With more sensors than loads the rows are squared down by two random mixtures; a zero of the system is a zero of
    each of them, found as a generalised eigenvalue, and each candidate is confirmed on the whole system matrix. Zeros
    and the system matrix: A. Emami-Naeini, P. Van Dooren, "Computation of zeros of linear multivariable systems",
    Automatica 18 (1982) 415-430.
    """
    from scipy.linalg import eigvals

    n, m, p = len(A), len(C), B.shape[1]
    B, C, D = _scaled(A, B, C, D)
    rng = np.random.default_rng(0)
    if m < p or _smallest(A, B, C, D, np.exp(2j * np.pi * rng.uniform(0.1, 0.4))) < BLIND:
        return None
    ends = np.zeros((n + p, n + p))
    ends[:n, :n] = np.eye(n)

    def squared(mix: Array) -> Complex:
        alpha, beta = eigvals(np.block([[A, B], [mix @ C, mix @ D]]), ends, homogeneous_eigvals=True)
        finite = np.abs(beta) * FAR > np.abs(alpha)
        return np.asarray(np.sort_complex(alpha[finite] / beta[finite]))

    if m == p:
        candidates = squared(np.eye(m))
    else:
        one, two = (squared(np.linalg.qr(rng.standard_normal((m, p)))[0].T) for _ in range(2))
        near = np.abs(one[:, None] - two) < SHARED * np.maximum(1, np.abs(one))[:, None]
        candidates = one[near.any(axis=1)]
    found: list[complex] = []
    for z in candidates:
        if all(abs(z - w) > _apart(w) for w in found) and _smallest(A, B, C, D, z) < ZERO:
            found.append(complex(z))
    zeros = np.array(found, complex)
    return zeros[np.argsort(np.abs(zeros), kind="stable")]


def delay(A: Array, B: Array, C: Array, D: Array, longest: int = 20) -> int | None:
    """Samples after which the sensors have heard of every load, by rank alone; None if not within the longest.

    The smallest L by which the block Toeplitz matrix of the Markov parameters gains a full set of columns. Necessary
    for a prior-free inversion with that lag, by no means enough: the sd of the load at a lag is what counts.

    Notes
    -----
    M. Sain, J. Massey, "Invertibility of linear time-invariant dynamical systems", IEEE Trans. Automatic Control 14
    (1969) 141-149.
    """
    B, C, D = _scaled(A, B, C, D)
    m, p = D.shape
    if m < p:
        return None
    markov, x = [D], B
    before = 0
    for late in range(longest + 1):
        if late:
            markov.append(C @ x)
            x = A @ x
        T = np.zeros(((late + 1) * m, (late + 1) * p))
        for i in range(late + 1):
            for j in range(i + 1):
                T[i * m : (i + 1) * m, j * p : (j + 1) * p] = markov[i - j]
        s = np.linalg.svd(T, compute_uv=False)
        rank = int(np.sum(s > RANK * max(s[0], np.finfo(float).tiny)))
        if rank - before == p:
            return late
        before = rank
    return None


def _scaled(A: Array, B: Array, C: Array, D: Array) -> tuple[Array, Array, Array]:
    """B with columns of norm one, states in its size, rows of [C, D] of norm one: zeros stay where they are."""
    tiny = np.finfo(float).tiny
    size = np.linalg.norm(B) / np.sqrt(B.shape[1]) or 1.0
    B, C = B / size, C * size
    columns = np.maximum(np.linalg.norm(np.vstack([B, D / max(np.abs(D).max(initial=0), 1.0)]), axis=0), tiny)
    B, D = B / columns, D / columns
    rows = np.linalg.norm(np.hstack([C, D]), axis=1)
    rows = np.where(rows > tiny, rows, 1.0)[:, None]
    return B, C / rows, D / rows


def _apart(z: complex) -> float:
    """How far from a zero another one begins."""
    return SAME if abs(z) < OUTER else ALIKE * abs(z)


def _smallest(A: Array, B: Array, C: Array, D: Array, z: complex) -> float:
    """Smallest singular value of the system matrix at z, states divided by the modulus of z outside the circle."""
    size = max(1.0, abs(z))
    P = np.block([[(A - z * np.eye(len(A))) / size, B], [C / size, D]])
    return smallest(P)[0]


def smallest(M: NDArray) -> tuple[float, NDArray]:
    """Smallest singular value of a tall matrix and its right vector: one QR, then inverse iteration."""
    from scipy.linalg import qr, solve_triangular

    n = M.shape[1]
    R = qr(M, mode="r", check_finite=False)[0][:n]
    d = np.abs(np.diag(R))
    if d.min() <= 1e-14 * d.max():  # what is singular to rounding is no factor to iterate with
        s, V = np.linalg.svd(R)[1:]
        return float(s[-1]), V[-1].conj()
    v = np.random.default_rng(1).standard_normal(n) / np.sqrt(n)
    sigma = 0.0
    for _ in range(ITERATIONS):
        u = solve_triangular(R, solve_triangular(R, v, trans="C", check_finite=False), check_finite=False)
        size = float(np.linalg.norm(u))
        v, before, sigma = u / size, sigma, 1 / np.sqrt(size)
        if abs(sigma - before) < SETTLED * sigma:
            break
    return sigma, v
