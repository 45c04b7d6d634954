"""Filters that settle: one product a sample, and whole records with roots where gains change.

    [load; e; x-]  <-  M [x-; y]

A sample that is not finite, or whose innovation leaves its limits, is not taken: the state stays as it was, and the
caller decides. Sample by sample and block are the same recursion.

Short blocks run in numpy first, with the same sums in the same order, bit for bit: a process that
starts anew answers before the compiler is loaded, and a stream goes on as if it had never been interrupted.

The numbers are those of `squareroot.filter` and `smoothing.bryson_frazier` to the distance from the steady covariance
at which the gains are taken for steady (`NEAR`), and steady stretches need no memory for states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from operator import le
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError

from . import passes as blocks
from .compiled import Compiled
from .roots import Array, lower, solve_lower, solve_lower_transposed
from .smoothing import back, left_over
from .squareroot import Filtered, FilterState, Innovation, SquareRoot, checked
from .steady import SteadyFilter

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
        "_M",
        "_all",
        "_cold",
        "_done",
        "_fast",
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
        Y = np.require(Y, float, ["C", "W"])  # one type: another would be compiled anew
        if Y.ndim != 2 or Y.shape[1] != self.m:
            raise _width(Y, self.m)
        if self._single:
            self._done += len(Y) * (self.n + self.m) * len(self._out) * (len(Y) >= LONG)
            if self._done > COLD:
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


NEAR = 1e-10  # of the variances: where gains count as steady
UNMOVED = 1e-13  # of what later samples tell: where going on changes nothing
SHORT = 64  # samples of a stretch that is worth its overhead
PART = 65536  # samples between two reports

Progress = Callable[[float, str], None] | None


@dataclass(frozen=True, eq=False)
class Section:
    """Samples from `first` on: walked (state and innovation of each), or settled (innovations, shape (samples, m))."""

    first: int
    states: list[FilterState]
    said: list[Innovation]
    e: Array | None = None

    @property
    def count(self) -> int:
        """Samples."""
        return len(self.states) if self.e is None else len(self.e)


@dataclass(frozen=True, eq=False)
class Sectioned:
    """A filtered record, and its sections for the smoother."""

    filtered: Filtered
    sections: tuple[Section, ...]
    steady: SteadyFilter


@dataclass(frozen=True, eq=False)
class SmoothedRecord:
    """Loads with all data: load, std (samples, p); what they leave of the data (samples, m), NaN where missing."""

    load: Array
    std: Array
    residual: Array


def filter_settling(steady: SteadyFilter, Y: ArrayLike, *, progress: Progress = None) -> Sectioned:
    """Filter a record Y (samples, m), NaN where a channel is missing; as `squareroot.filter`, mostly faster.

    Raises
    ------
    InputError
        A record of the wrong shape, or infinite numbers.
    """
    model = steady.model
    Y = checked(model, Y)
    core, N = SquareRoot(model), len(Y)
    out = Filtered(model, Y, np.empty((N, model.p)), np.empty((N, model.p)), np.empty(N), np.empty(N),
                   np.empty(Y.shape), core.start())  # fmt: skip
    ahead = lower(steady.part.F @ steady.L, steady.part.LQ)
    stops = _complete_until(Y)
    sections, walked, state, k, predicted = [], Section(0, [], []), core.start(), 0, True
    while k < N:
        if not predicted and k and min(stops[k - 1], N - 1) - k >= SHORT and steady.distance(state.L) <= NEAR:
            stop = min(int(stops[k]), N - 1)  # the last sample is walked: its state is asked for
            if walked.count:
                sections.append(walked)
            x = steady.part.moved(state.x, state.y)
            section, x = _settled(steady, out, k, stop, x, progress)
            sections.append(section)
            k, state, predicted = stop, FilterState(x, ahead), True
            walked = Section(k, [], [])
            continue
        state, said = core.update(state, Y[k]) if predicted else core.advance(state, Y[k])
        predicted = False
        walked.states.append(state)
        walked.said.append(said)
        out.load[k], out.std[k] = model.Cp @ state.x, np.linalg.norm(model.Cp @ state.L, axis=1)
        out.nis[k], out.loglik[k], out.normalised[k] = said.nis, said.loglik, said.normalised
        k += 1
        if progress is not None and k % 256 == 0:
            progress(k / N, "filtering")
    whole = Filtered(model, Y, out.load, out.std, out.nis, out.loglik, out.normalised, state)
    return Sectioned(whole, (*sections, walked), steady)


def smooth_settling(record: Sectioned, *, progress: Progress = None) -> SmoothedRecord:
    """Every load with all data, from a record of `filter_settling`; the states are not computed."""
    filtered, steady, model = record.filtered, record.steady, record.filtered.model
    core, there = SquareRoot(model), np.isfinite(filtered.Y)
    load, std, rest = (np.empty(like.shape) for like in (filtered.load, filtered.load, filtered.Y))
    told, root = np.zeros(model.n), np.zeros((model.n, 0))
    for section in reversed(record.sections):
        part = slice(section.first, section.first + section.count)
        if section.e is not None:
            told = back_mean(steady, section.e, told, load[part], rest[part])
            np.subtract(filtered.load[part], load[part], out=load[part])
            std[part], root = _back_std(steady, section.count, root)
        else:
            for i in range(section.count - 1, -1, -1):
                k, state = section.first + i, section.states[i]
                x = state.x - state.L @ (state.L.T @ told)
                load[k], rest[k] = model.Cp @ x, filtered.Y[k] - model.H @ x
                std[k] = np.linalg.norm(model.Cp @ left_over(state.L, root), axis=1)
                if k:
                    told, root = back(told, root, section.said[i], core.seen(there[k]).H, core.seen(there[k - 1]).F)
        if progress is not None:
            progress(1 - section.first / len(load), "smoothing")
    return SmoothedRecord(load, std, rest)


def _complete_until(Y: Array) -> NDArray[np.int_]:
    """For each sample, the first sample from it on that lacks a channel (samples,)."""
    lacking = np.append(np.flatnonzero(~np.isfinite(Y).all(axis=1)), len(Y))
    return lacking[np.searchsorted(lacking, np.arange(len(Y)))]


def _settled(
    steady: SteadyFilter, out: Filtered, first: int, stop: int, x: Array, progress: Progress
) -> tuple[Section, Array]:
    """Fill the samples of a stretch; its section, and the prediction of the sample after it."""
    model, part = steady.model, slice(first, stop)
    loop = Loop(steady.rows(), model.p, model.m, x)
    e = np.empty((stop - first, model.m))
    for low in range(first, stop, PART):
        high = min(low + PART, stop)
        loop.block(out.Y[low:high], out.load[low:high], e[low - first : high - first])
        if progress is not None:
            progress(high / len(out.Y), "filtering")
    out.nis[part], out.loglik[part] = steady.judged(e)
    out.normalised[part], out.std[part] = e / steady.innovation_std, steady.std
    return Section(first, [], [], e), loop.x


def back_mean(steady: SteadyFilter, e: Array, told: Array, change: Array, rest: Array) -> Array:
    """Fill the change of the loads of a stretch and its residuals; what it and later samples tell the one before.

    With lambda from the later samples, ``y - H x_s = R (Se^-1 e + K^T lambda)``, as ``H P = R K^T``.
    """
    part = steady.part
    R, over = part.LR @ part.LR.T, steady.model.Cp @ steady.L @ steady.L.T
    news, direct = (
        solve_lower_transposed(steady.Se_root, solve_lower(steady.Se_root, X)).T for X in (part.H @ part.F, R)
    )
    system = blocks.Filter(
        steady.A.T, -news, np.vstack([over, R @ steady.K.T]), np.vstack([np.zeros((len(over), len(R))), direct])
    )
    return blocks.run_blocks(system, told, [e], [change, rest], backwards=True)


def _back_std(steady: SteadyFilter, count: int, root: Array) -> tuple[Array, Array]:
    """Stds of the smoothed loads of a stretch, and the root of what it and all later samples tell."""
    own = steady.model.Cp @ steady.L
    over, variance = own @ steady.L.T, np.sum(own**2, axis=1)
    news = (solve_lower(steady.Se_root, steady.part.H) @ steady.part.F).T
    std, size = np.empty((count, len(own))), np.sum(root**2, axis=1)
    for k in range(count - 1, -1, -1):
        std[k] = np.sqrt(np.maximum(variance - np.sum((over @ root) ** 2, axis=1), 0.0))
        root = lower(news, steady.A.T @ root)
        before, size = size, np.sum(root**2, axis=1)
        if np.all(np.abs(size - before) <= UNMOVED * size):
            std[:k] = np.sqrt(np.maximum(variance - np.sum((over @ root) ** 2, axis=1), 0.0))
            break
    return std, root
