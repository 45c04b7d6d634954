"""Whole records through a filter and its smoother: roots where gains change, one product a sample where they do not.

Forward, a sample off the settled gain is one factorisation (`squareroot.SquareRoot`), a stretch at it a loop
(`loop.Loop`) that needs no memory for states. The numbers are those of the factorisations to the distance from the
steady covariance at which the gains are taken for steady (`NEAR`).

Backward, what later innovations say is carried as a root (Bierman, Automatica 9 (1973) 503): no covariance of a state
is inverted, so that states may be known exactly, such as those of a structure at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain

from . import passes as blocks
from .compiled import NEVER
from .loop import ARRIVED, Loop, RootLoop
from .model import FilterModel, FilterState, Innovation, SquareRoot
from .roots import Array, lower, solve_lower, solve_lower_transposed
from .steady import SteadyFilter

NEAR = 1e-10  # of the variances: where gains count as steady
UNMOVED = 1e-13  # of what later samples tell: where going on changes nothing
SHORT = 64  # samples of a stretch that is worth its overhead
PART = 65536  # samples between two reports

Progress = Callable[[float, str], None] | None


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples from `first` on: walked (state and innovation of each), or settled (innovations, shape (samples, m))."""

    first: int
    states: list[FilterState]
    innovations: list[Innovation]
    e: Array | None = None

    @property
    def count(self) -> int:
        """Samples."""
        return len(self.states) if self.e is None else len(self.e)


@dataclass(frozen=True, eq=False)
class Filtered:
    """A record after the filter.

    Parameters
    ----------
    model : FilterModel
    Y : array, shape (samples, m)
    load, std : array, shape (samples, p)
    nis, loglik : array, shape (samples,)
    normalised : array, shape (samples, m)
        Innovation of each channel over its own std; NaN where missing.
    steady : SteadyFilter or None
        Whose gain the settled stretches have.
    stretches : tuple of Stretch
        What the smoother needs; the last sample is walked.
    """

    model: FilterModel
    Y: Array
    load: Array
    std: Array
    nis: Array
    loglik: Array
    normalised: Array
    steady: SteadyFilter | None
    stretches: tuple[Stretch, ...]

    @cached_property
    def count(self) -> NDArray[np.int_]:
        """Channels present in each sample (samples,)."""
        return np.asarray(np.sum(np.isfinite(self.Y), axis=1))

    @property
    def last(self) -> FilterState:
        """After the last sample."""
        return self.stretches[-1].states[-1]


@dataclass(frozen=True, eq=False)
class Smoothed:
    """Loads with all data: load, std (samples, p); what they leave of the data (samples, m), NaN where missing."""

    load: Array
    std: Array
    residual: Array


def filter_record(
    model: FilterModel, Y: ArrayLike, steady: SteadyFilter | None = None, *, progress: Progress = None
) -> Filtered:
    """Filter a record Y (samples, m), NaN where a channel is missing; the first sample updates `model.x0`, `L0`.

    Parameters
    ----------
    model : FilterModel
    Y : array, shape (samples, m)
    steady : SteadyFilter, optional
        Of the same model: complete stretches run at its gain once they have come to it. Without it every sample is
        walked, and its state kept for the smoother: 8 n^2 bytes a sample.
    progress : callable, optional
        Called with the share of the samples that are done.

    Raises
    ------
    InputError
        A record of the wrong shape, or infinite numbers.
    """
    Y = checked(model, Y)
    core, N = SquareRoot(model), len(Y)
    load, std, normalised = np.empty((N, model.p)), np.empty((N, model.p)), np.empty(Y.shape)
    nis, loglik = np.empty(N), np.empty(N)
    out = Filtered(model, Y, load, std, nis, loglik, normalised, steady, ())
    stops = _complete_until(Y)
    stretches, walked, state, k, predicted = [], Stretch(0, [], []), core.start(), 0, True
    while k < N:
        ahead = 0 if steady is None or predicted else min(int(stops[k - 1]), N - 1) - k
        if steady is not None and ahead >= SHORT and steady.distance(state.L) <= NEAR:
            stop = min(int(stops[k]), N - 1)  # the last sample is walked: its state is asked for
            if walked.count:
                stretches.append(walked)
            stretch, x = _settled(steady, out, k, stop, steady.part.moved(state.x, state.y), progress)
            stretches.append(stretch)
            k, state, predicted = stop, FilterState(x, lower(steady.part.F @ steady.L, steady.part.LQ)), True
            walked = Stretch(k, [], [])
            continue
        state, news = core.update(state, Y[k]) if predicted else core.advance(state, Y[k])
        predicted = False
        walked.states.append(state)
        walked.innovations.append(news)
        load[k], std[k] = model.Cp @ state.x, np.linalg.norm(model.Cp @ state.L, axis=1)
        nis[k], loglik[k], normalised[k] = news.nis, news.loglik, news.normalised
        if progress is not None and k % 256 == 0:
            progress(k / N, "filtering")
        k += 1
    return Filtered(model, Y, load, std, nis, loglik, normalised, steady, (*stretches, walked))


def log_density(model: FilterModel, Y: ArrayLike, steady: SteadyFilter) -> Array:
    """`filter_record(...).loglik` (samples,) alone: no state is kept, and what is not settled runs in one loop.

    Parameters
    ----------
    model : FilterModel
    Y : array, shape (samples, m)
    steady : SteadyFilter
        Of the same model.

    Raises
    ------
    InputError
        As in `filter_record`.
    """
    if not RootLoop.takes(model):
        return filter_record(model, Y, steady).loglik
    Y, x, L, ahead, k = checked(model, Y), model.x0, model.L0, True, 0
    loop = RootLoop(model, np.full(model.m, np.inf), np.sum(steady.L**2, axis=1), NEAR)
    found, load, std, e = np.empty(len(Y)), *np.empty((2, len(Y), model.p)), np.empty(Y.shape)
    stops, unheard = _complete_until(Y), (0, np.zeros(len(Y), int), np.full(2, -1), np.zeros(1, int), np.full(1, NEVER))
    while k < len(Y):
        taken, why, x, L = loop.block(x, L, ahead, Y[k:], unheard, load[k:], std[k:], e[k:], found[k:])
        k, ahead = k + taken, False
        if why == ARRIVED and k < len(Y) and (stop := int(stops[k])) - k >= SHORT:
            settled = Loop(steady.rows(), model.p, model.m, model.F @ x)
            settled.block(Y[k:stop], load[k:stop], e[k:stop])
            found[k:stop] = steady.judged(e[k:stop])[1]
            k, x, L, ahead = stop, settled.x, lower(model.F @ steady.L, model.LQ), True
    return found


def smooth_record(filtered: Filtered, *, progress: Progress = None) -> Smoothed:
    """Every load with all data."""
    model, steady = filtered.model, filtered.steady
    core, there = SquareRoot(model), np.isfinite(filtered.Y)
    load, std, rest = (np.empty(like.shape) for like in (filtered.load, filtered.load, filtered.Y))
    told, root = np.zeros(model.n), np.zeros((model.n, 0))  # lambda; Lambda = root root^T
    for stretch in reversed(filtered.stretches):
        part = slice(stretch.first, stretch.first + stretch.count)
        if stretch.e is not None:
            assert steady is not None
            told = back_mean(steady, stretch.e, told, load[part], rest[part])
            np.subtract(filtered.load[part], load[part], out=load[part])
            std[part], root = _back_std(steady, stretch.count, root)
        for i in range(len(stretch.states) - 1, -1, -1):
            k, state = stretch.first + i, stretch.states[i]
            x = state.x - state.L @ (state.L.T @ told)
            load[k], rest[k] = model.Cp @ x, filtered.Y[k] - model.H @ x
            std[k] = np.linalg.norm(model.Cp @ left_over(state.L, root), axis=1)
            if k:
                told, root = back(told, root, stretch.innovations[i], core.seen(there[k]).H, core.seen(there[k - 1]).F)
        if progress is not None:
            progress(1 - stretch.first / len(load), "smoothing")
    return Smoothed(load, std, rest)


def checked(model: FilterModel, Y: ArrayLike) -> Array:
    """A record as float64 (samples, m).

    Raises
    ------
    InputError
        Another shape, or infinite numbers.
    """
    Y = np.asarray(plain(Y), float)
    if Y.ndim != 2 or Y.shape[1] != model.m or not len(Y):
        raise InputError("the record does not fit the model", where="record", found=f"shape {Y.shape}",
                         expected=f"(samples, {model.m}), at least one sample")  # fmt: skip
    infinite = np.argwhere(np.isinf(Y))
    if len(infinite):
        sample, channel = infinite[0]
        raise InputError("an infinite number in a record", where=f"channel {channel}, sample {sample}",
                         expected="finite numbers, NaN where a channel is missing")  # fmt: skip
    return Y


def left_over(L: Array, root: Array) -> Array:
    """Root of ``P - P Lambda P`` with ``P = L L^T``, ``Lambda = root root^T``."""
    U, s, _ = np.linalg.svd(L.T @ root, full_matrices=True)
    left = np.ones(len(U))
    left[: len(s)] = np.sqrt(np.maximum((1 - s) * (1 + s), 0.0))
    return L @ (U * left)


def back(told: Array, root: Array, news: Innovation, H: Array, F: Array) -> tuple[Array, Array]:
    """What a sample and all later ones tell the one before it: H of its channels, F that led to it."""
    white_H, white = solve_lower(news.root, H), solve_lower(news.root, news.e[news.present])
    told = F.T @ (told - white_H.T @ (news.gain.T @ told) - white_H.T @ white)
    return told, lower(F.T @ white_H.T, F.T @ (root - white_H.T @ (news.gain.T @ root)))


def _complete_until(Y: Array) -> NDArray[np.int_]:
    """For each sample, the first sample from it on that lacks a channel (samples,)."""
    lacking = np.append(np.flatnonzero(~np.isfinite(Y).all(axis=1)), len(Y))
    return lacking[np.searchsorted(lacking, np.arange(len(Y)))]


def _settled(
    steady: SteadyFilter, out: Filtered, first: int, stop: int, x: Array, progress: Progress
) -> tuple[Stretch, Array]:
    """Fill the samples of a stretch; the stretch, and the prediction of the sample after it."""
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
    return Stretch(first, [], [], e), loop.x


def run_settled(steady: SteadyFilter, Y: Array) -> tuple[Array, Array]:
    """Loads (samples, p) and innovations (samples, m) of a complete record at the settled gain throughout."""
    model = steady.model
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    loop = Loop(steady.rows(), model.p, model.m, model.x0)
    loop.compile()  # a search asks many times
    loop.block(Y, load, e)
    return load, e


def smooth_settled(steady: SteadyFilter, Y: Array) -> tuple[Array, Array]:
    """Loads (samples, p) with all data at the settled gain throughout, and what they leave of a complete record."""
    load, e = run_settled(steady, Y)
    change, rest = np.empty(load.shape), np.empty(Y.shape)
    back_mean(steady, e, np.zeros(steady.model.n), change, rest)
    return load - change, rest


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
