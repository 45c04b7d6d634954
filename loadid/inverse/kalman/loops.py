"""A settled filter as one product a sample: compiled, or numpy's where nothing compiles.

    [load; e; x-]  <-  M [x-; y]

A sample that is not finite, or whose innovation leaves its limits, is not taken: the state stays as it was, and the
caller decides. Sample by sample and block are the same recursion.
"""

from __future__ import annotations

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

    __slots__ = ("_M", "_load", "_next", "_out", "_s", "_single", "_v", "_w", "_x", "_y", "e", "m", "n", "p")

    def __init__(self, rows: NDArray, p: int, m: int, x: ArrayLike, limit: NDArray | None = None) -> None:
        n = rows.shape[1] - m
        self.p, self.m, self.n = p, m, n
        self._single = AVAILABLE and rows.size <= LARGE
        self._M = np.ascontiguousarray(rows.T if self._single else rows, float)
        self._v, self._out, self._s = np.zeros(n + m), np.zeros(p + m + n), np.zeros(m)
        self._w = np.zeros(m) if limit is None else 1.0 / np.asarray(limit, float)
        self._x, self._y = self._v[:n], self._v[n:]
        self._load, self.e, self._next = self._out[:p], self._out[p : p + m], self._out[p + m :]
        self._x[:] = x
        if AVAILABLE:  # compiled now, not within the first sample
            y = np.full((1, m), np.nan)
            self.block(y, np.empty((1, p)), np.empty((1, m)))
            self.step(y[0])

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
            return self._load.copy() if _step(self._M, self._v, self._out, self._w) else None
        return self._load.copy() if self._numpy_step() else None

    def block(self, Y: NDArray, load: NDArray, e: NDArray) -> int:
        """Fill loads (samples, p) and innovations (samples, m) of Y (samples, m) up to the first that is not taken.

        Parameters
        ----------
        Y : array of float64, shape (samples, m)
        load, e : array of float64, shapes (samples, p), (samples, m)

        Returns
        -------
        taken : int
            Samples before the first that was not taken; all of them if none. The innovation of that one is in `e` too.

        Raises
        ------
        InputError
            Samples of another width.
        """
        if Y.ndim != 2 or Y.shape[1] != self.m:
            raise _width(Y, self.m)
        if self._single:
            return int(_block(self._M, self._v, self._out, self._w, Y, load, e))
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
        np.dot(self._M, self._v, out=self._out)
        np.multiply(self.e, self._w, out=self._s)
        if not self._s.dot(self._s) <= 1.0 and not (np.abs(self._s) <= 1.0).all():  # NaN is never smaller
            return False
        self._x[:] = self._next
        return True


def _width(y: ArrayLike, m: int) -> InputError:
    return InputError("a sample of the wrong width", where="sample", found=f"shape {np.shape(y)}", expected=f"({m},)")


@compiled
def _step(M: NDArray, v: NDArray, out: NDArray, w: NDArray) -> bool:
    """Overwrite out = M^T v; the prediction of v too where every innovation, times w, is within one."""
    columns, rows, m = M.shape[0], M.shape[1], w.shape[0]
    n = columns - m
    first = rows - n - m
    for i in range(rows):
        out[i] = 0.0
    j = 0
    while j + 4 <= columns:  # four columns at a time: the sums stay in registers
        a, b, c, d = v[j], v[j + 1], v[j + 2], v[j + 3]
        for i in range(rows):
            out[i] += (a * M[j, i] + b * M[j + 1, i]) + (c * M[j + 2, i] + d * M[j + 3, i])
        j += 4
    while j < columns:
        a = v[j]
        for i in range(rows):
            out[i] += a * M[j, i]
        j += 1
    for i in range(m):
        if not abs(out[first + i] * w[i]) <= 1.0:  # NaN is never smaller
            return False
    for i in range(n):
        v[i] = out[rows - n + i]
    return True


@compiled
def _block(M: NDArray, v: NDArray, out: NDArray, w: NDArray, Y: NDArray, load: NDArray, e: NDArray) -> int:
    """Samples taken before the first that is not."""
    m, n, p = Y.shape[1], M.shape[0] - Y.shape[1], load.shape[1]
    for k in range(Y.shape[0]):
        for i in range(m):
            v[n + i] = Y[k, i]
        taken = _step(M, v, out, w)
        for i in range(m):
            e[k, i] = out[p + i]
        if not taken:
            return k
        for i in range(p):
            load[k, i] = out[i]
    return Y.shape[0]
