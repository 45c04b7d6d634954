"""Products and triangular solves of matrices of a dozen rows."""

from __future__ import annotations

from numpy.typing import NDArray

from ..compiled import Compiled


@Compiled
def multiply(A: NDArray, B: NDArray, out: NDArray) -> None:
    """Put A B into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            out[i, j] = 0.0
        for k in range(A.shape[1]):
            a = A[i, k]
            if a != 0.0:
                for j in range(B.shape[1]):
                    out[i, j] += a * B[k, j]


@Compiled
def multiply_by_transposed(A: NDArray, B: NDArray, out: NDArray) -> None:
    """Put A B^T into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            out[i, j] = total


@Compiled
def solve_upper(R: NDArray, B: NDArray, out: NDArray) -> None:
    """Put R^-1 B into `out`, R upper triangular."""
    p = R.shape[0]
    for i in range(p - 1, -1, -1):
        for j in range(B.shape[1]):
            total = B[i, j]
            for k in range(i + 1, p):
                total -= R[i, k] * out[k, j]
            out[i, j] = total / R[i, i]
