"""Products and triangular factors of matrices of a dozen rows: loops where they are compiled, else numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compiled import AVAILABLE, compiled


def _multiply(A: NDArray, B: NDArray, out: NDArray) -> None:
    """Put A B into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[1]):
            out[i, j] = 0.0
        for k in range(A.shape[1]):
            a = A[i, k]
            if a != 0.0:
                for j in range(B.shape[1]):
                    out[i, j] += a * B[k, j]


def _multiply_by_transposed(A: NDArray, B: NDArray, out: NDArray) -> None:
    """Put A B^T into `out`."""
    for i in range(A.shape[0]):
        for j in range(B.shape[0]):
            total = 0.0
            for k in range(A.shape[1]):
                total += A[i, k] * B[j, k]
            out[i, j] = total


def _triangularise(A: NDArray) -> None:
    """Overwrite A (rows, columns), rows >= columns, by the R of its QR factorisation; rows below it hold no meaning."""
    rows, columns = A.shape
    w = np.empty(columns)
    for j in range(columns):
        norm2 = 0.0
        for i in range(j + 1, rows):
            norm2 += A[i, j] * A[i, j]
        if norm2 == 0.0:
            continue
        alpha = np.sqrt(norm2 + A[j, j] * A[j, j])
        if A[j, j] > 0.0:
            alpha = -alpha
        first = A[j, j] - alpha
        scale = 2.0 / (norm2 + first * first)
        for c in range(j + 1, columns):
            w[c] = first * A[j, c]
        for i in range(j + 1, rows):
            v = A[i, j]
            if v != 0.0:
                for c in range(j + 1, columns):
                    w[c] += v * A[i, c]
        for c in range(j + 1, columns):
            A[j, c] -= scale * first * w[c]
        for i in range(j + 1, rows):
            v = scale * A[i, j]
            if v != 0.0:
                for c in range(j + 1, columns):
                    A[i, c] -= v * w[c]
        A[j, j] = alpha
        for i in range(j + 1, rows):
            A[i, j] = 0.0


def _solve_upper(R: NDArray, B: NDArray, out: NDArray) -> None:
    """Put R^-1 B into `out`, R upper triangular."""
    p = R.shape[0]
    for i in range(p - 1, -1, -1):
        for j in range(B.shape[1]):
            total = B[i, j]
            for k in range(i + 1, p):
                total -= R[i, k] * out[k, j]
            out[i, j] = total / R[i, i]


def _numpy_multiply(A: NDArray, B: NDArray, out: NDArray) -> None:
    np.matmul(A, B, out=out)


def _numpy_multiply_by_transposed(A: NDArray, B: NDArray, out: NDArray) -> None:
    np.matmul(A, B.T, out=out)


def _numpy_triangularise(A: NDArray) -> None:
    columns = A.shape[1]
    A[:columns] = np.linalg.qr(A, mode="r")
    A[columns:] = 0.0


def _numpy_solve_upper(R: NDArray, B: NDArray, out: NDArray) -> None:
    out[:] = np.linalg.solve(R, B)


if AVAILABLE:
    multiply = compiled(_multiply)
    multiply_by_transposed = compiled(_multiply_by_transposed)
    triangularise = compiled(_triangularise)
    solve_upper = compiled(_solve_upper)
else:
    multiply, multiply_by_transposed = _numpy_multiply, _numpy_multiply_by_transposed
    triangularise, solve_upper = _numpy_triangularise, _numpy_solve_upper
