"""Filters that have settled, on one gain or on those of a period: one product a sample.

    [load; e; x-]  <-  M [x-; y]

A sample that is not finite, or whose innovation leaves its limits, is not taken: the state stays as it was, and the
caller decides. Sample by sample and block are the same recursion.

Short blocks run in numpy first, with the same sums in the same order, bit for bit: a process that
starts anew answers before the compiler is loaded, and a stream goes on as if it had never been interrupted.
"""

from __future__ import annotations

from collections.abc import Callable
from operator import le
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError

from .compiled import Compiled
from .model import FilterModel
from .roots import Array
from .steady import PeriodicFilter, SteadyFilter

LARGE = 40_000  # entries of M from which BLAS is faster than the loop, call and all
COLD = 10**8  # products from which the compiler is worth its load
LONG = 64  # samples of a block that count for it: who sends fewer is waited for, and a live stream is not held up


class Loop:
    """The recursion of a steady filter, with its state; the std of its loads is constant.

    Parameters
    ----------
    rows : array, shape (p + m + n, n + m)
        Loads, innovations and next prediction from ``[x-; y]`` (`SteadyFilter.rows`).
    p, m : int
        Loads and channels.
    x : array, shape (n,)
        Prediction of the first sample.
    limit : array, shape (m,), optional
        Largest innovation that is taken; infinite by default.
    """

    __slots__ = (
        "_M", "_all", "_cold", "_done", "_fast", "_gemv", "_limits", "_load", "_next", "_out", "_single", "_v", "_x",
        "_y", "e", "m", "n", "p",
    )  # fmt: skip

    def __init__(self, rows: Array, p: int, m: int, x: ArrayLike, limit: Array | None = None) -> None:
        from scipy.linalg.blas import dgemv

        n = rows.shape[1] - m
        self.p, self.m, self.n = p, m, n
        self._single = rows.size <= LARGE
        limits = np.minimum(np.full(m, np.inf) if limit is None else np.asarray(limit, float), np.finfo(float).max)
        # one array, as each one that is handed to a compiled function costs a tenth of a microsecond
        matrix = rows.T if self._single else rows
        self._all = np.concatenate([limits, np.zeros(n + m), np.zeros(len(rows)), matrix.ravel()])
        _, self._v, self._out, flat = np.split(self._all, np.cumsum([m, n + m, len(rows)]))
        self._M, self._limits, self._gemv = flat.reshape(matrix.shape).T, limits.tolist(), dgemv
        self._x, self._y = self._v[:n], self._v[n:]
        self._load, self.e, self._next = self._out[:p], self._out[p : p + m], self._out[p + m :]
        self._x[:] = x
        self._fast: tuple[Callable[..., Any], Callable[..., Any]] | None = None
        self._cold: _Plain | None = None
        self._done = 0  # products without the compiler
        if self._single and _block.built:
            self.compile()  # it is there

    @property
    def x(self) -> Array:
        """Prediction of the next sample (n,)."""
        return self._x.copy()

    @x.setter
    def x(self, value: ArrayLike) -> None:
        self._x[:] = value

    def compile(self) -> None:
        """Load the compiler of the loop now, and not within a sample; `step` asks for it at its first call."""
        if not self._single or self._fast is not None:
            return
        self._fast = _step.build(), _block.build()
        n, m, p, state = self.n, self.m, self.p, self._all.copy()
        self._fast[1](state, n, m, p, np.full((1, m), np.nan), np.empty((1, p)), np.empty((1, m)))
        self._fast[0](state, n, m, p)

    @property
    def ahead(self) -> Array:
        """The same, not copied: the next step overwrites it."""
        return self._x

    def step(self, y: ArrayLike) -> Array | None:
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
            if self._fast is None:
                self.compile()
            return self._load.copy() if self._fast[0](self._all, self.n, self.m, self.p) else None  # type: ignore[index]
        return self._load.copy() if self._numpy_step() else None

    def block(self, Y: ArrayLike, load: Array, e: Array) -> int:
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
        if type(Y) is not np.ndarray or Y.dtype != float or not Y.flags.carray:
            Y = np.require(Y, float, ["C", "W"])  # one type: another would be compiled anew
        if Y.ndim != 2 or Y.shape[1] != self.m:
            raise _width(Y, self.m)
        if self._single:
            self._done += len(Y) * (self.n + self.m) * len(self._out) * (len(Y) >= LONG)
            if self._fast is None and (self._done > COLD or _block.built):
                self.compile()
            if self._fast is not None:
                return int(self._fast[1](self._all, self.n, self.m, self.p, Y, load, e))
        y, found, innovation, one = self._y, self._load, self.e, self._same() if self._single else self._numpy_step
        for k in range(len(Y)):
            y[:] = Y[k]
            taken = one()
            e[k] = innovation
            if not taken:
                return k
            load[k] = found
        return len(Y)

    def _same(self) -> Callable[[], bool]:
        """The compiled step without the compiler."""
        if self._cold is None:
            self._cold = _Plain(self._all, self.n, self.m, self.p)
        return self._cold.step

    def _numpy_step(self) -> bool:
        # as numpy's dot, which would warn of inf: alpha, a, x, beta, y, offsets and steps of x and y, trans, overwrite
        self._gemv(1.0, self._M, self._v, 0.0, self._out, 0, 1, 0, 1, 1, 1)
        if not all(map(le, map(abs, self.e.tolist()), self._limits)):  # quickest of so few; NaN is never smaller
            return False
        self._x[:] = self._next
        return True


class _Plain:
    """`_step` in numpy on the same array: the same products, added in the same order.

    Four columns of M at a time, as there: products of a column are made at once, and `add.reduce` along the first axis
    adds one row after the other.
    """

    def __init__(self, a: Array, n: int, m: int, p: int) -> None:
        columns, rows = n + m, p + m + n
        ends = np.cumsum([m, columns, rows])
        self._limits, v, self._out, flat = np.split(a, ends)
        self._M, self._v, self._x, self._next = flat.reshape(columns, rows), v[:, None], v[:n], self._out[p + m :]
        self._e, self._limit = self._out[p : p + m], self._limits.tolist()
        fours = columns // 4
        self._products = np.empty((columns, rows))
        self._sums = np.zeros((1 + fours + columns % 4, rows))  # the first is the zero that the loop starts from
        whole, self._rest = self._products[: 4 * fours], self._products[4 * fours :]
        self._quarters = tuple(whole[k::4] for k in range(4))
        self._fours, self._left = self._sums[1 : 1 + fours], self._sums[1 + fours :]
        self._half = np.empty((fours, rows))

    def step(self) -> bool:
        """As `_step`."""
        np.multiply(self._M, self._v, out=self._products)
        q, r, s, t = self._quarters
        np.add(q, r, out=self._fours)
        np.add(s, t, out=self._half)
        np.add(self._fours, self._half, out=self._fours)
        self._left[:] = self._rest
        np.add.reduce(self._sums, axis=0, out=self._out)
        if not all(map(le, map(abs, self._e.tolist()), self._limit)):
            return False
        self._x[:] = self._next
        return True


def _width(y: ArrayLike, m: int) -> InputError:
    return InputError("a sample of the wrong width", where="sample", found=f"shape {np.shape(y)}", expected=f"({m},)")


@Compiled
def _step(a: Array, n: int, m: int, p: int) -> bool:
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


@Compiled
def _block(a: Array, n: int, m: int, p: int, Y: Array, load: Array, e: Array) -> int:
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
    return int(Y.shape[0])


class PeriodicLoop:
    """The recursion of a periodic filter, one loop for each phase; a channel that a phase has not weighs nothing.

    Parameters
    ----------
    filters : PeriodicFilter
    x : array, shape (n,)
        Prediction of the first sample.
    phase : int
        Of the first sample.
    sigmas : float or array (m,)
        Innovations, in units of their std, beyond which a sample is not taken.
    """

    def __init__(self, filters: PeriodicFilter, x: ArrayLike, phase: int = 0, sigmas: ArrayLike = np.inf) -> None:
        self.phase, self.std = phase, filters.std
        self.masks = np.array([f.part.mask for f in filters.phases])
        self._x = np.array(x, float)
        self._loops = [_padded(f, sigmas) for f in filters.phases]
        self._spread = np.full(self.masks.shape, np.nan)
        for t, f in enumerate(filters.phases):
            self._spread[t, self.masks[t]] = f.innovation_std

    @property
    def x(self) -> Array:
        """Prediction of the next sample (n,)."""
        return self._x.copy()

    def step(self, y: Array) -> Array | None:
        """Loads (p,) of the sample y (m,), or None where it was not taken: another mask than its phase has too.

        The std is that of the phase before the step, ``std[phase]``.
        """
        load, e = np.empty((1, self.std.shape[1])), np.empty((1, len(y)))
        return load[0] if self.block(np.asarray(y, float)[None], load, e) else None

    def block(self, Y: Array, load: Array, e: Array) -> int:
        """Fill loads (samples, p) and normalised innovations (samples, m) up to the first sample that is not taken.

        Returns
        -------
        taken : int
            Samples before it.
        """
        there = ~np.isnan(Y)
        phases = (self.phase + np.arange(len(Y))) % len(self._loops)
        fits = np.all(there == self.masks[phases], axis=1)
        stop = len(Y) if fits.all() else int(np.argmin(fits))
        taken, x, loops = 0, self._x, self._loops
        for t, y in zip(phases[:stop].tolist(), np.where(there, Y, 0.0), strict=False):
            loop = loops[t]
            loop.x = x
            found = loop.step(y)
            if found is None:
                break
            x = loop.ahead
            load[taken], e[taken] = found, loop.e
            taken += 1
        e[:taken] /= self._spread[phases[:taken]]
        self._x = np.array(x)
        self.phase = (self.phase + taken) % len(loops)
        return taken


def _padded(f: SteadyFilter, sigmas: ArrayLike) -> Loop:
    """Loop of a phase with all channels, those that it has not with zeros."""
    mask, n, p = f.part.mask, f.model.n, f.model.p
    m = len(mask)
    rows, limit = np.zeros((p + m + n, n + m)), np.full(m, np.inf)
    into = np.r_[np.arange(n), n + np.flatnonzero(mask)]
    out = np.r_[np.arange(p), p + np.flatnonzero(mask), p + m + np.arange(n)]
    rows[np.ix_(out, into)] = f.rows()
    limit[mask] = np.broadcast_to(np.asarray(sigmas, float), (m,))[mask] * f.innovation_std
    return Loop(rows, p, m, np.zeros(n), limit)


WIDER = 8  # samples after which a root is made narrow again
TURN = 2 * np.pi
WHOLE, ODD, ARRIVED, SHOWN = range(4)  # why it stopped: at the end, before an odd sample, settled, in a rhythm


class RootLoop:
    """The square-root recursion in one loop, channels that are missing left out: mean, root of the covariance.

    A sample takes its channels one after the other, ``L <- L (I - b v v^T)`` with ``v = L^T h`` (J. E. Potter, in G. J.
    Bierman, Factorization Methods for Discrete Sequential Estimation, Academic Press 1977, ch. II). The process noise
    adds its columns to the root, which is made triangular by reflections every few samples only. What sensors and loads
    read of the states is carried along in the same sums.

    Parameters
    ----------
    model : FilterModel
        Without correlated noises.
    width : array, shape (m,)
        Innovations over their std that are taken.
    variance : array, shape (n,), optional
        Of the states, where it ends: they have settled within `near` times these, with all channels there.
    near : float
    """

    def __init__(self, model: FilterModel, width: Array, variance: Array | None, near: float) -> None:
        self.n, self.m, self.p = model.n, model.m, model.p
        read = np.vstack([np.eye(self.n), model.H, model.Cp])
        self._read, self._ahead = np.ascontiguousarray(read.T), np.ascontiguousarray((read @ model.F).T)
        self._noise = np.ascontiguousarray((read @ model.LQ).T)
        self._power, self._width = np.sum(model.LR**2, axis=1), np.array(width, float)
        self._variance, self._near = np.full(self.n, -1.0) if variance is None else variance, near
        q = len(self._noise)
        self._most = self.n + max(q, min(WIDER * q, self.n))

    @staticmethod
    def takes(model: FilterModel) -> bool:
        """Whether every channel has a noise of its own, correlated with no other."""
        LR = model.LR
        return model.S is None and bool(np.all(np.diag(LR) != 0)) and np.count_nonzero(LR) == len(LR)

    def compile(self) -> None:
        """Load the compiler of the loop now, and not within a sample."""
        none, one = np.zeros((3, 0, max(self.m, self.p))), np.zeros(1, int)
        _roots.build()
        self.block(np.zeros(self.n), np.zeros((self.n, 0)), False, none[0, :, : self.m].copy(), (0, one, one, one, one),
                   none[1, :, : self.p].copy(), none[1, :, : self.p].copy(), none[2, :, : self.m].copy())  # fmt: skip

    def block(
        self, x: Array, L: Array, ahead: bool, Y: Array, ear: tuple[Any, ...], load: Array, std: Array, e: Array,
        density: Array | None = None,
    ) -> tuple[int, int, Array, Array]:  # fmt: skip
        """Fill loads and std (samples, p) and normalised innovations (samples, m) of samples, as far as it goes.

        Parameters
        ----------
        x, L : array, shapes (n,), (n, any)
            Of the states before the first sample: predicted (`ahead`), or of the sample before.
        Y : array, shape (samples, m)
        ear : tuple
            Samples heard before; number of each sample's set of channels (samples,); numbers of those before in a ring,
            the newest first, twice; how many samples in a row were as those 1, 2, ... before, and how many show it.
        density : array, shape (samples,), optional
            Filled with the log density of each sample, given those before.

        Returns
        -------
        taken, why : int
            Samples, and one of `WHOLE`, `ODD`, `ARRIVED`, `SHOWN`.
        x, L : array
            After them.
        """
        if not Y.flags.carray:
            Y = np.require(Y, float, ["C", "W"])  # one type: another would be compiled anew
        n, wide = self.n, self._read.shape[1]
        rows = max(self._most, L.shape[1]) + len(self._noise)
        root, mean = np.zeros((2, rows, wide)), np.zeros((3, wide))
        root[0, : L.shape[1], :n], mean[0, :n] = L.T, x
        if ahead:
            L = np.ascontiguousarray(L)  # the same bits wherever it comes from
            root[0, : L.shape[1], n:], mean[0, n:] = L.T @ self._read[:, n:], x @ self._read[:, n:]
        at = np.array([L.shape[1], ahead, 0, self._most, ear[0]])
        why = _roots.after(len(Y) * n * wide * self._most)(
            self._ahead, self._noise, self._power, self._width, self._variance, self._near, root, mean, at, Y, *ear[1:],
            load, std, e, np.empty(len(Y)) if density is None else density,
        )  # fmt: skip
        return int(at[2]), int(why), mean[0, :n].copy(), np.ascontiguousarray(root[0, : at[0], :n].T)


@Compiled
def _roots(
    F: Array, Q: Array, power: Array, width: Array, variance: Array, near: float, root: Array, mean: Array, at: Array,
    Y: Array, names: Array, ring: Array, runs: Array, shown: Array, load: Array, std: Array, e: Array, density: Array,
) -> int:  # fmt: skip
    """`RootLoop.block`: why it stopped.

    `root` and `mean` hold what is and what is ahead, a row for each column of the root, sensors and loads behind the
    states; `at` the number of rows, whether the first are ahead, samples taken, most rows, samples heard.
    """
    n, wide, q = F.shape[0], F.shape[1], Q.shape[0]
    m, p = len(power), load.shape[1]
    gain, spread, half = mean[2], np.zeros(wide), len(runs)
    for k in range(Y.shape[0]):
        for i in range(m):
            if np.isinf(Y[k, i]):
                return ODD
        r, now = at[0], root[0]
        if at[1] == 0:
            for j in range(r + 1):  # the mean last
                before = mean[0] if j == r else now[j]
                after = mean[1] if j == r else root[1, j]
                for i in range(wide):
                    after[i] = 0.0
                c = 0
                while c + 4 <= n:
                    a0, a1, a2, a3 = before[c], before[c + 1], before[c + 2], before[c + 3]
                    for i in range(wide):
                        after[i] += (a0 * F[c, i] + a1 * F[c + 1, i]) + (a2 * F[c + 2, i] + a3 * F[c + 3, i])
                    c += 4
                while c < n:
                    a0 = before[c]
                    for i in range(wide):
                        after[i] += a0 * F[c, i]
                    c += 1
            now = root[1]
            for j in range(q):
                for i in range(wide):
                    now[r + j, i] = Q[j, i]
            r += q
            x = mean[1]
        else:
            x = mean[0]
        for i in range(wide):
            spread[i] = 0.0
        for j in range(r):
            for i in range(n, n + m):
                spread[i] += now[j, i] * now[j, i]
        whole = True
        for i in range(m):
            e[k, i] = (Y[k, i] - x[n + i]) / np.sqrt(spread[n + i] + power[i])
            whole = whole and not np.isnan(Y[k, i])
            if abs(e[k, i]) > width[i]:
                return ODD
        if at[1] == 0:
            for i in range(wide):
                mean[0, i] = x[i]
            for j in range(r):
                for i in range(wide):
                    root[0, j, i] = now[j, i]
            now, x = root[0], mean[0]
        at[0], at[1] = r, 0
        density[k] = 0.0
        for i in range(m):
            if np.isnan(Y[k, i]):
                continue
            size = power[i]
            for c in range(wide):
                gain[c] = 0.0
            for j in range(r):
                a = now[j, n + i]
                size += a * a
                for c in range(wide):
                    gain[c] += a * now[j, c]
            share, rest = 1.0 / (size + np.sqrt(power[i] * size)), (Y[k, i] - x[n + i]) / size
            density[k] -= 0.5 * (np.log(TURN * size) + rest * rest * size)
            for j in range(r):
                a = share * now[j, n + i]
                for c in range(wide):
                    now[j, c] -= a * gain[c]
            for c in range(wide):
                x[c] += rest * gain[c]
        for i in range(wide):
            spread[i] = 0.0
        for j in range(r):
            for i in range(wide):
                spread[i] += now[j, i] * now[j, i]
        for i in range(p):
            load[k, i], std[k, i] = x[n + m + i], np.sqrt(spread[n + m + i])
        if r + q > at[3] and r > n:  # triangular again
            for c in range(n):
                size = 0.0
                for j in range(c, r):
                    size += now[j, c] * now[j, c]
                if size == 0.0:
                    continue
                first = now[c, c]
                corner = -np.sqrt(size) if first >= 0.0 else np.sqrt(size)
                beta = 1.0 / (size - first * corner)
                now[c, c] = first - corner
                for i in range(c + 1, n):
                    gain[i] = 0.0
                for j in range(c, r):
                    a = now[j, c]
                    for i in range(c + 1, n):
                        gain[i] += a * now[j, i]
                for j in range(c, r):
                    a = beta * now[j, c]
                    for i in range(c + 1, n):
                        now[j, i] -= a * gain[i]
                now[c, c] = corner
                for j in range(c + 1, r):
                    now[j, c] = 0.0
            at[0] = n
        at[2] = k + 1
        start = half - at[4] % half
        told = -1
        for i in range(half):
            runs[i] = runs[i] + 1 if ring[start + i] == names[k] else 0
            if told < 0 and runs[i] >= shown[i]:
                told = i
        if told >= 0 and whole and variance[0] >= 0.0 and runs[0] >= told:
            told = -1  # all channels over all of the period
        ring[start - 1] = names[k]
        ring[start - 1 + half] = names[k]
        at[4] += 1
        if whole:
            for i in range(n):
                whole = whole and abs(spread[i] - variance[i]) <= near * variance[i]
            if whole:
                return ARRIVED
        if told >= 0:
            return SHOWN
    return WHOLE
