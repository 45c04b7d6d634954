"""Penalties L of the regularisation term: as matrices over the samples, and as symbols over frequency lines."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

ORDER = {"identity": 0, "gradient": 1, "first_difference": 1, "laplacian": 2, "second_difference": 2}


def order(penalty: str) -> int:
    """Order of the difference that a named penalty takes: 0, 1 or 2."""
    if penalty not in ORDER:
        raise InputError(
            "unknown penalty", where="penalty", found=repr(penalty), expected=f"one of {', '.join(ORDER)}, or a matrix"
        )
    return ORDER[penalty]


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
    penalty = penalty.toarray() if hasattr(penalty, "toarray") else penalty  # sparse
    L = np.atleast_2d(np.asarray(penalty, float))
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
