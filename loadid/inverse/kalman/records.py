"""Whole records through a filter that settles: roots where gains change, one product a sample where they do not.

The numbers are those of `squareroot.filter` and `smoothing.bryson_frazier` to the distance from the steady covariance
at which the gains are taken for steady (`NEAR`), and steady stretches need no memory for states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..statespace import blocks
from .loops import Loop
from .roots import backward, forward, lower
from .smoothing import back, left_over
from .squareroot import Filtered, Innovation, SquareRoot, State, checked
from .steady import Steady

NEAR = 1e-10  # of the variances: where gains count as steady
UNMOVED = 1e-13  # of what later samples tell: where going on changes nothing
SHORT = 64  # samples of a stretch that is worth its overhead
PART = 65536  # samples between two reports

Progress = Callable[[float, str], None] | None


@dataclass(frozen=True, eq=False)
class Section:
    """Samples from `first` on: walked (state and innovation of each), or settled (innovations, shape (samples, m))."""

    first: int
    states: list[State]
    said: list[Innovation]
    e: NDArray[np.float64] | None = None

    @property
    def count(self) -> int:
        """Samples."""
        return len(self.states) if self.e is None else len(self.e)


@dataclass(frozen=True, eq=False)
class Sectioned:
    """A filtered record, and its sections for the smoother."""

    filtered: Filtered
    sections: tuple[Section, ...]
    steady: Steady


@dataclass(frozen=True, eq=False)
class SmoothedRecord:
    """Loads with all data: load, std (samples, p); what they leave of the data (samples, m), NaN where missing."""

    load: NDArray[np.float64]
    std: NDArray[np.float64]
    residual: NDArray[np.float64]


def filter_settling(steady: Steady, Y: ArrayLike, *, progress: Progress = None) -> Sectioned:
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
            k, state, predicted = stop, State(x, ahead), True
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


def _complete_until(Y: NDArray) -> NDArray[np.int_]:
    """For each sample, the first sample from it on that lacks a channel (samples,)."""
    lacking = np.append(np.flatnonzero(~np.isfinite(Y).all(axis=1)), len(Y))
    return lacking[np.searchsorted(lacking, np.arange(len(Y)))]


def _settled(
    steady: Steady, out: Filtered, first: int, stop: int, x: NDArray, progress: Progress
) -> tuple[Section, NDArray]:
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


def back_mean(steady: Steady, e: NDArray, told: NDArray, change: NDArray, rest: NDArray) -> NDArray[np.float64]:
    """Fill the change of the loads of a stretch and its residuals; what it and later samples tell the one before.

    With lambda from the later samples, ``y - H x_s = R (Se^-1 e + K^T lambda)``, as ``H P = R K^T``.
    """
    part = steady.part
    R, over = part.LR @ part.LR.T, steady.model.Cp @ steady.L @ steady.L.T
    news, direct = (backward(steady.Se_root, forward(steady.Se_root, X)).T for X in (part.H @ part.F, R))
    system = blocks.Filter(
        steady.A.T, -news, np.vstack([over, R @ steady.K.T]), np.vstack([np.zeros((len(over), len(R))), direct])
    )
    return blocks.run(system, told, [e], [change, rest], backwards=True)


def _back_std(steady: Steady, count: int, root: NDArray) -> tuple[NDArray, NDArray]:
    """Stds of the smoothed loads of a stretch, and the root of what it and all later samples tell."""
    own = steady.model.Cp @ steady.L
    over, variance = own @ steady.L.T, np.sum(own**2, axis=1)
    news = (forward(steady.Se_root, steady.part.H) @ steady.part.F).T
    std, size = np.empty((count, len(own))), np.sum(root**2, axis=1)
    for k in range(count - 1, -1, -1):
        std[k] = np.sqrt(np.maximum(variance - np.sum((over @ root) ** 2, axis=1), 0.0))
        root = lower(news, steady.A.T @ root)
        before, size = size, np.sum(root**2, axis=1)
        if np.all(np.abs(size - before) <= UNMOVED * size):
            std[:k] = np.sqrt(np.maximum(variance - np.sum((over @ root) ** 2, axis=1), 0.0))
            break
    return std, root
