"""Static condensation onto chosen DOFs: the stiffness that they see, and their compliance, dense and in place.

The compliance is asked for as a result here, and every entry of it: that is the one place for LAPACK's potri.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..errors import InputError

BLOCK = 128  # right-hand sides per call of the sparse solver
MIRROR = 512  # rows and columns mirrored at once
TRUST = 1e-9  # relative residual of a random combination of all solutions, above which each is checked and refined
Array = NDArray[np.float64]
Index = NDArray[np.intp]


def schur(K: Any, s: Index, interior: Any) -> NDArray:
    """Schur complement ``K_ss - K_si K_ii^-1 K_is``, exactly symmetric.

    Parameters
    ----------
    K : sparse (n, n)
    s : int array
        The DOFs that stay.
    interior : callable
        Takes the rows that go and returns a `Factor` of their block.

    Returns
    -------
    array (s, s), Fortran order
    """
    rows = sparse.csr_matrix(K)
    i = np.setdiff1d(np.arange(rows.shape[0]), s)
    out = rows[s][:, s].toarray(order="F")
    if i.size == 0:
        return out
    Kis = rows[i][:, s].tocsc()
    Ksi, factor = Kis.T.tocsr(), interior(rows[i][:, i])
    _subtract(out, Ksi, Kis, factor)
    return mirrored(out)


def _subtract(out: NDArray, Ksi: Any, Kis: Any, factor: Any) -> None:
    """Take ``K_si K_ii^-1 K_is`` off `out`, in blocks; one random combination of all columns checks the solutions."""
    weights = np.random.default_rng(0).standard_normal(Kis.shape[1])
    combined = np.zeros(Kis.shape[0], dtype=out.dtype)
    for start in range(0, Kis.shape[1], BLOCK):
        stop = min(start + BLOCK, Kis.shape[1])
        X = factor.raw(Kis[:, start:stop].toarray(order="F"))
        combined += X @ weights[start:stop]
        out[:, start:stop] -= Ksi @ X
    wanted = Kis @ weights
    rest = np.linalg.norm(factor.K @ combined - wanted)
    if not rest <= TRUST * np.linalg.norm(wanted):
        # a poor factor: what the first pass took is put back by its own residual, column by column
        for start in range(0, Kis.shape[1], BLOCK):
            stop = min(start + BLOCK, Kis.shape[1])
            B = Kis[:, start:stop].toarray(order="F")
            out[:, start:stop] -= Ksi @ (factor.solve(B) - factor.raw(B))


def mirrored(A: NDArray) -> NDArray:
    """`A` with its lower triangle copied to the upper one, in place and in blocks."""
    n = len(A)
    for a in range(0, n, MIRROR):
        b = min(a + MIRROR, n)
        corner = A[a:b, a:b]
        corner[...] = np.tril(corner) + np.tril(corner, -1).T
        for c in range(b, n, MIRROR):
            A[a:b, c : c + MIRROR] = A[c : c + MIRROR, a:b].T
    return A


def compliance(K: Array) -> Array:
    """Inverse of a symmetric positive definite dense matrix, in place of it where it is in Fortran order.

    Raises
    ------
    InputError
        If it is not positive definite to working precision.
    """
    from scipy.linalg import lapack

    check = np.random.default_rng(0).standard_normal(len(K))
    moved = K @ check
    factor, info = lapack.dpotrf(K, lower=1, clean=0, overwrite_a=1)
    if info == 0:
        A, info = lapack.dpotri(factor, lower=1, overwrite_c=1)
    if info != 0:
        raise InputError(
            "the condensed stiffness is not positive definite: it has no compliance",
            where="compliance",
            found=f"pivot {abs(info)} of {len(K)} is not positive",
            expected="a supported structure",
            hint="add supports, or check the signs in K and a compressive prestress",
        )
    A = mirrored(A)
    if not np.linalg.norm(A @ moved - check) <= 1e-3 * np.linalg.norm(check):
        raise InputError(
            "the condensed stiffness is singular to working precision",
            where="compliance",
            found="A K x differs from x in the third digit",
            expected="a supported structure",
            hint="add supports; stiffnesses that differ by more than 1e12 have no compliance",
        )
    return np.asarray(A, float)
