"""A settled filter as one product a sample: compiled, or numpy's where nothing compiles.

    [load; e; x-]  <-  M [x-; y]

A sample that is not finite, or whose innovation leaves its limits, is not taken: the state stays as it was, and the
caller decides. Sample by sample and block are the same recursion.
"""

from __future__ import annotations

from operator import le

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from ..compiled import AVAILABLE, compiled

LARGE = 40_000  # entries of M from which BLAS is faster than the loop, call and all


class Loop:
    """The recursion of a steady filter, with its state; the std of its loads is constant.

    Parameters
    ----------
    rows : array, shape (p + m + n, n + m)
        Loads, innovations and next prediction from ``[x-; y]`` (`Steady.rows`).
    p, m : int
        Loads and channels.
    x : array, shape (n,)
        Prediction of the first sample.
    limit : array, shape (m,), optional
        Largest innovation that is taken; infinite by default.
    """

    __slots__ = (
        "_M",
        "_all",
        "_gemv",
        "_limits",
        "_load",
        "_next",
        "_out",
        "_single",
        "_v",
        "_x",
        "_y",
        "e",
        "m",
        "n",
        "p",
    )

    def __init__(self, rows: NDArray, p: int, m: int, x: ArrayLike, limit: NDArray | None = None) -> None:
        from scipy.linalg.blas import dgemv

        n = rows.shape[1] - m
        self.p, self.m, self.n = p, m, n
        self._single = AVAILABLE and rows.size <= LARGE
        limits = np.minimum(np.full(m, np.inf) if limit is None else np.asarray(limit, float), np.finfo(float).max)
        # one array, as each one that is handed to a compiled function costs a tenth of a microsecond
        matrix = rows.T if self._single else rows
        self._all = np.concatenate([limits, np.zeros(n + m), np.zeros(len(rows)), matrix.ravel()])
        _, self._v, self._out, flat = np.split(self._all, np.cumsum([m, n + m, len(rows)]))
        self._M, self._limits, self._gemv = flat.reshape(matrix.shape).T, limits.tolist(), dgemv
        self._x, self._y = self._v[:n], self._v[n:]
        self._load, self.e, self._next = self._out[:p], self._out[p : p + m], self._out[p + m :]
        self._x[:] = x
        if self._single:  # compiled now, not within the first sample
            _block(self._all, n, m, p, np.full((1, m), np.nan), np.empty((1, p)), np.empty((1, m)))
            _step(self._all, n, m, p)

    @property
    def x(self) -> NDArray[np.float64]:
        """Prediction of the next sample (n,)."""
        return self._x.copy()

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._x[:] = value

    def step(self, y: ArrayLike) -> NDArray[np.float64] | None:
        """Loads (p,) of the sample y (m,), or None where it was not taken; its innovation is then in `e`.

        Raises
        ------
        InputError
            A sample of another width.
        """
        if len(y) != self.m:  # type: ignore[arg-type]
            raise _width(y, self.m)
        self._y[:] = y
        if self._single:
            return self._load.copy() if _step(self._all, self.n, self.m, self.p) else None
        return self._load.copy() if self._numpy_step() else None

    def block(self, Y: ArrayLike, load: NDArray, e: NDArray) -> int:
        """Fill loads (samples, p) and innovations (samples, m) of Y (samples, m) up to the first that is not taken.

        Parameters
        ----------
        Y : array, shape (samples, m)
        load, e : array of float64, C-contiguous, shapes (samples, p), (samples, m)

        Returns
        -------
        taken : int
            Samples before the first that was not taken; all of them if none. The innovation of that one is in `e` too.

        Raises
        ------
        InputError
            Samples of another width.
        """
        Y = np.require(Y, float, ["C", "W"])  # one type: another would be compiled anew
        if Y.ndim != 2 or Y.shape[1] != self.m:
            raise _width(Y, self.m)
        if self._single:
            return int(_block(self._all, self.n, self.m, self.p, Y, load, e))
        y, found, innovation = self._y, self._load, self.e
        for k in range(len(Y)):
            y[:] = Y[k]
            taken = self._numpy_step()
            e[k] = innovation
            if not taken:
                return k
            load[k] = found
        return len(Y)

    def _numpy_step(self) -> bool:
        # as numpy's dot, which would warn of inf: alpha, a, x, beta, y, offsets and steps of x and y, trans, overwrite
        self._gemv(1.0, self._M, self._v, 0.0, self._out, 0, 1, 0, 1, 1, 1)
        if not all(map(le, map(abs, self.e.tolist()), self._limits)):  # quickest of so few; NaN is never smaller
            return False
        self._x[:] = self._next
        return True


def _width(y: ArrayLike, m: int) -> InputError:
    return InputError("a sample of the wrong width", where="sample", found=f"shape {np.shape(y)}", expected=f"({m},)")


@compiled
def _step(a: NDArray, n: int, m: int, p: int) -> bool:
    """Overwrite out = M^T v; the prediction in v too where every innovation is within its limit.

    `a` holds the limits (m), v (n + m), out (p + m + n) and M (n + m, p + m + n) one after the other.
    """
    columns, rows = n + m, p + m + n
    v, out = a[m : m + columns], a[m + columns : m + columns + rows]
    M = a[m + columns + rows :].reshape(columns, rows)
    for i in range(rows):
        out[i] = 0.0
    j = 0
    while j + 4 <= columns:  # four columns at a time: the sums are loaded and stored a quarter as often
        q, r, s, t = v[j], v[j + 1], v[j + 2], v[j + 3]
        for i in range(rows):
            out[i] += (q * M[j, i] + r * M[j + 1, i]) + (s * M[j + 2, i] + t * M[j + 3, i])
        j += 4
    while j < columns:
        q = v[j]
        for i in range(rows):
            out[i] += q * M[j, i]
        j += 1
    for i in range(m):
        if not abs(out[p + i]) <= a[i]:  # NaN is never smaller
            return False
    for i in range(n):
        v[i] = out[p + m + i]
    return True


@compiled
def _block(a: NDArray, n: int, m: int, p: int, Y: NDArray, load: NDArray, e: NDArray) -> int:
    """Samples taken before the first that is not."""
    y, out = a[m + n : m + n + m], a[m + n + m : m + n + m + p + m]
    for k in range(Y.shape[0]):
        for i in range(m):
            y[i] = Y[k, i]
        taken = _step(a, n, m, p)
        for i in range(m):
            e[k, i] = out[p + i]
        if not taken:
            return k
        for i in range(p):
            load[k, i] = out[i]
    return Y.shape[0]
