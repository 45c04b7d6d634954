"""One step of the square-root recursion: the stack of `riccati` made triangular.

Columns lie contiguous (arrays are transposed), only the columns of the inputs are eliminated at every step, and the
root of the cost is allowed some rows more than columns until all of it is made triangular. Its product with F takes the
entries that are not zero: few in modal form.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..compiled import Compiled

SPARE = 4  # rows by which a root may grow


def spare(m: int) -> int:
    """Rows of a root beyond its columns, for m data in a sample."""
    return m * max(SPARE // max(m, 1), 1)


@Compiled
def step(
    at: NDArray, entries: NDArray, F: NDArray, G: NDArray, C: NDArray, D: NDArray, lam: float,
    root: NDArray, height: int, stack: NDArray, K: NDArray, R: NDArray,
) -> int:  # fmt: skip
    """Overwrite the root by that of the sample before, fill its gains; rows of the new root.

    Parameters
    ----------
    at, entries : array, shapes (2, entries), (entries,)
        Places and values of what is not zero in F.
    root : array, shape (n, at least height)
        Transpose of Gamma.
    stack : array, shape (p + n, rows)
        To work in; its rows bound those of the root.
    K, R : array, shapes (p, n), (p, p)
        To be filled.
    """
    n, p, m = G.shape[0], G.shape[1], C.shape[0]
    top, rows = m + p, m + p + height
    for c in range(p + n):
        for i in range(m):
            stack[c, i] = D[i, c] if c < p else C[i, c - p]
        for i in range(m, rows):
            stack[c, i] = 0.0
    for c in range(p):
        stack[c, m + c] = lam
        for h in range(n):
            g = G[h, c]
            for i in range(height):
                stack[c, top + i] += g * root[h, i]
    for e in range(at.shape[1]):
        c, h, f = p + at[1, e], at[0, e], entries[e]
        for i in range(height):
            stack[c, top + i] += f * root[h, i]
    if rows - p < root.shape[1]:
        height = rows - p
        _eliminate(stack, rows, p)
    else:
        height = n
        _eliminate(stack, rows, p + n)
    for c in range(n):
        for i in range(height):
            root[c, i] = stack[p + c, p + i]
    for i in range(p - 1, -1, -1):
        for c in range(n):
            total = stack[p + c, i]
            for q in range(i + 1, p):
                total -= stack[q, i] * K[q, c]
            K[i, c] = total / stack[i, i]
        for q in range(p):
            R[i, q] = stack[q, i] if q >= i else 0.0
    return height


@Compiled
def _eliminate(A: NDArray, rows: int, steps: int) -> None:
    """Householder reflections of the first `rows` rows of a matrix whose transpose is A, for its first columns."""
    for j in range(steps):
        norm2 = 0.0
        for i in range(j + 1, rows):
            norm2 += A[j, i] * A[j, i]
        if norm2 == 0.0:
            continue
        d = A[j, j]
        alpha = np.sqrt(norm2 + d * d)
        if d > 0.0:
            alpha = -alpha
        first = d - alpha
        scale = 2.0 / (norm2 + first * first)
        end = rows
        while A[j, end - 1] == 0.0:
            end -= 1
        A[j, j] = first
        for c in range(j + 1, A.shape[0]):
            s0, s1, s2, s3, i = 0.0, 0.0, 0.0, 0.0, j  # four sums: none waits for another
            while i + 4 <= end:
                s0 += A[j, i] * A[c, i]
                s1 += A[j, i + 1] * A[c, i + 1]
                s2 += A[j, i + 2] * A[c, i + 2]
                s3 += A[j, i + 3] * A[c, i + 3]
                i += 4
            while i < end:
                s0 += A[j, i] * A[c, i]
                i += 1
            w = scale * ((s0 + s1) + (s2 + s3))
            for i in range(j, end):
                A[c, i] -= w * A[j, i]
        A[j, j] = alpha
        for i in range(j + 1, rows):
            A[j, i] = 0.0
