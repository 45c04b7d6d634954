"""Channels of several rates: a mask that repeats has gains that repeat, one for each phase.

The maps of the phases are joined to that of a period (`doubling.composed`), doubled until it settles, and the roots
are walked through one period by QR.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike

from structures.errors import InputError

from .model import FilterModel
from .roots import Array, fixed_point, joined_maps, solve_lower_transposed
from .settled import Loop
from .squareroot import SquareRoot
from .steady import RADIUS, RESIDUAL, SteadyFilter, distance, refused, sample_map


@dataclass(frozen=True, eq=False)
class PeriodicFilter:
    """Steady filters of the phases of a period.

    Parameters
    ----------
    phases : tuple of SteadyFilter
        Gains (n, channels of the phase), roots and stds; `SteadyFilter.A` leads from the phase before.
    radius, time_constant : float
        Of the closed loop, per sample, and in units of `dt`.
    residual : float
        Largest relative change of a covariance from one period to the next.
    """

    phases: tuple[SteadyFilter, ...]
    radius: float
    time_constant: float
    residual: float

    @property
    def std(self) -> Array:
        """Of the loads in each phase (phases, p)."""
        return np.array([phase.std for phase in self.phases])


def periodic(model: FilterModel, masks: ArrayLike, dt: float = 1.0) -> PeriodicFilter:
    """Steady filters of channels that come and go with a period.

    Parameters
    ----------
    model : FilterModel
    masks : array of bool, shape (phases, m)
        Channels present in each phase.
    dt : float
        Step in s, for the time constant.

    Raises
    ------
    NotIdentifiable
        As `steady` (E501).
    InputError
        Masks that do not fit.
    """
    masks = np.asarray(masks)
    if masks.dtype != bool or masks.ndim != 2 or masks.shape[1] != model.m or not len(masks):
        raise InputError("masks that do not fit the channels", where="masks", found=f"{masks.dtype} {masks.shape}",
                         expected=f"bool, (phases, {model.m})")  # fmt: skip
    core, T = SquareRoot(model), len(masks)
    parts = [core.seen(mask) for mask in masks]
    L, count, settled = fixed_point(reduce(joined_maps, map(sample_map, parts)))
    if not settled:
        raise refused("the variance of the periodic filter grows on")
    steps, residual = _walked(core, masks, core.update_root(parts[0], L))
    if residual > RESIDUAL:
        raise refused(f"the gains do not repeat: relative change {residual:.1g} from one period to the next")
    gains = [solve_lower_transposed(Se, gain.T).T for Se, gain, _ in steps]
    ahead = [parts[t - 1].F for t in range(T)]
    loops = [F - K @ (part.H @ F) for F, K, part in zip(ahead, gains, parts, strict=True)]
    radius = _radius(loops)
    if not radius < 1 - RADIUS:
        raise refused(f"the error of the periodic filter does not die: {radius:.9f} a sample")
    constant = float(-dt / np.log(radius)) if radius > 0 else 0.0
    phases = tuple(
        SteadyFilter(
            model, part, K, A, root, Se, np.linalg.norm(model.Cp @ root, axis=1), radius, constant, count, residual
        )
        for part, K, A, (Se, _, root) in zip(parts, gains, loops, steps, strict=True)
    )
    return PeriodicFilter(phases, radius, constant, residual)


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


Step = tuple[Array, Array, Array]


def _walked(core: SquareRoot, masks: Array, L: Array) -> tuple[list[Step], float]:
    """Roots and gains of every phase from the root of the first; the largest change in the period after."""
    T, steps = len(masks), []
    for t in range(1, 2 * T + 1):
        stack = core.stack(None if core.model.S is None else masks[(t - 1) % T], masks[t % T])
        steps.append(core.covariance(stack, L))
        L = steps[-1][2]
    residual = max(distance(steps[t + T][2], steps[t][2]) for t in range(T))
    return [steps[2 * T - 1], *steps[T : 2 * T - 1]], residual


def _radius(loops: list[Array]) -> float:
    """Radius of the closed loop over a period, a sample's share."""
    whole = reduce(lambda before, A: A @ before, loops)
    largest = float(np.max(np.abs(np.linalg.eigvals(whole)), initial=0.0))
    return float(largest ** (1 / len(loops)))
