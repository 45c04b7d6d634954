"""Gains that a filter settles on, of all channels or of a period of them, and whether they are to be believed.

Channels of several rates come and go with a period: a mask that repeats has gains that repeat, one for each phase. The
Riccati maps of the phases are joined to that of a period and doubled until it settles (`roots.fixed_point`), and the
roots are walked through some periods by QR: the gains are theirs. One phase with all its channels is the usual case.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable, reals

from .model import LOG2PI, FilterModel, Present, SquareRoot
from .roots import Array, Riccati, fixed_point, joined_maps, solve_lower, solve_lower_transposed

POLISH = 6  # samples of QR after the doubling, and two periods, at least: the gains are theirs
RESIDUAL = 1e-6  # of the Riccati equation, relative to the variances
RADIUS = 1e-6  # by which the closed loop must stay inside the unit circle
ADVICE = (
    "add a displacement or strain channel that sees the load statically, give the load a prior that returns to zero "
    "(OU, Matern), or accept a drift and its growing std"
)


@dataclass(frozen=True, eq=False)
class SteadyFilter:
    """Gain of a filter that has settled: ``x_k = A x_{k-1} + K y_k (+ A_T y_{k-1})`` with ``A = (I - K H) F``.

    Parameters
    ----------
    model : FilterModel
    part : Present
        F and Q without the correlation of the noises, and the channels that are there: all, but for `periodic`.
    K : array, shape (n, m)
    A : array, shape (n, n)
    L : array, shape (n, n)
        Root of the filtered covariance.
    Se_root : array, shape (m, m)
        Lower triangular root of the covariance of the innovation.
    std : array, shape (p,)
        Of the loads.
    radius, time_constant : float
        Largest eigenvalue of A, and the time in which its error falls by e, in units of `dt`.
    iterations : int
        Doublings.
    residual : float
        Of the Riccati equation, relative to the variances.
    """

    model: FilterModel
    part: Present
    K: Array
    A: Array
    L: Array
    Se_root: Array
    std: Array
    radius: float
    time_constant: float
    iterations: int
    residual: float

    @property
    def innovation_std(self) -> Array:
        """Std of the innovation of each channel (m,)."""
        return np.asarray(np.linalg.norm(self.Se_root, axis=1))

    def judged(self, e: Array) -> tuple[Array, Array]:
        """Normalised square and log density of each innovation (samples, m)."""
        nis = np.sum(solve_lower(self.Se_root, e.T) ** 2, axis=0)
        spread = 2 * float(np.sum(np.log(np.abs(np.diag(self.Se_root)))))
        return nis, -0.5 * (nis + e.shape[1] * LOG2PI + spread)

    def distance(self, L: Array) -> float:
        """Largest relative deviation of the variances of a filtered covariance L L^T from the steady ones."""
        settled = np.sum(self.L**2, axis=1)
        at = settled > 0
        return float(np.max(np.abs(np.sum(L[at] ** 2, axis=1) / settled[at] - 1), initial=0.0))

    def rows(self) -> Array:
        """Loads, innovations and next prediction from ``[x-; y]``, shape (p + m + n, n + m): see `loop.Loop`."""
        n, m, F, H, Cp = self.model.n, len(self.part.H), self.part.F, self.part.H, self.model.Cp
        update = np.hstack([np.eye(n) - self.K @ H, self.K])
        ahead = F @ update
        if self.part.T is not None:
            ahead[:, n:] += self.part.T
        return np.vstack([Cp @ update, np.hstack([-H, np.eye(m)]), ahead])


def steady(model: FilterModel, dt: float = 1.0) -> SteadyFilter:
    """Steady gain of a model with all its channels; parameters and refusals as those of `periodic`."""
    return periodic(model, np.ones((1, model.m), bool), dt).phases[0]


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
        The covariance grows on, misses its equation, or the error of the loop does not die (E501).
    InputError
        Masks that do not fit, a channel without noise.
    """
    masks = np.asarray(masks)
    if masks.dtype != bool or masks.ndim != 2 or masks.shape[1] != model.m or not len(masks):
        raise InputError("masks that do not fit the channels", where="masks", found=f"{masks.dtype} {masks.shape}",
                         expected=f"bool, (phases, {model.m})")  # fmt: skip
    core, T = SquareRoot(model), len(masks)
    parts = [core.seen(mask) for mask in masks]
    L, count, settled = fixed_point(reduce(joined_maps, map(sample_map, parts)))
    if not settled:
        raise refused(f"the variance of the filter grows on: it has not settled after 2^{count} periods")
    steps, residual = _walked(core, masks, core.update_root(parts[0], L))
    if residual > RESIDUAL:
        raise refused(f"the Riccati equation of the steady filter is not solved: relative residual {residual:.1g}")
    gains = [solve_lower_transposed(Se, gain.T).T for Se, gain, _ in steps]  # Se^-T/2 on the right of P H^T Se^-T/2
    ahead = [parts[t - 1].F for t in range(T)]
    loops = [F - K @ (part.H @ F) for F, K, part in zip(ahead, gains, parts, strict=True)]
    whole = reduce(lambda before, A: A @ before, loops)
    radius = float(np.max(np.abs(np.linalg.eigvals(whole)), initial=0.0)) ** (1 / T)  # a sample's share
    if not radius < 1 - RADIUS:
        raise refused(f"the error of the steady filter does not die: its largest eigenvalue is {radius:.9f}")
    constant = float(-dt / np.log(radius)) if radius > 0 else 0.0
    phases = tuple(
        SteadyFilter(
            model, part, K, A, root, Se, np.linalg.norm(model.Cp @ root, axis=1), radius, constant, count, residual
        )
        for part, K, A, (Se, _, root) in zip(parts, gains, loops, steps, strict=True)
    )
    return PeriodicFilter(phases, radius, constant, residual)


Step = tuple[Array, Array, Array]


def _walked(core: SquareRoot, masks: NDArray[np.bool_], L: Array) -> tuple[list[Step], float]:
    """Roots and gains of every phase, some periods after the root of the first; the change over the last period."""
    T, steps = len(masks), list[Step]()
    for t in range(1, max(2, -(-POLISH // T)) * T + 1):
        stack = core.stack(None if core.model.S is None else masks[(t - 1) % T], masks[t % T])
        steps.append(core.covariance(stack, L))
        L = steps[-1][2]
    residual = max(distance(now[2], before[2]) for now, before in zip(steps[-T:], steps[-2 * T : -T], strict=True))
    return [steps[-1], *steps[-T:-1]], residual


def sample_map(part: Present) -> Riccati:
    """Predicted covariance of a sample to that of the next.

    Raises
    ------
    InputError
        A channel without noise.
    """
    if not np.all(np.diag(part.LR)):
        raise InputError("a steady gain needs noise on every channel", where="FilterModel.LR",
                         found="a singular root", expected="a positive definite covariance of the noise")  # fmt: skip
    return Riccati(part.F, part.LQ, solve_lower(part.LR, part.H).T)


def refused(what: str) -> NotIdentifiable:
    """No gain to be believed: what the filter does instead."""
    return NotIdentifiable(what, advice=ADVICE, code="LID-E501")


def distance(now: Array, before: Array) -> float:
    """Largest change of a covariance in units of its variances."""
    std = np.linalg.norm(now, axis=1)
    std[std == 0] = 1.0
    a, b = now / std[:, None], before / std[:, None]
    return float(np.max(np.abs(a @ a.T - b @ b.T), initial=0.0))


def combined_std(settled: SteadyFilter, weights: ArrayLike) -> Array:
    """Std of weighted sums of the loads at the settled gain.

    The loads of one sample are correlated: neighbouring places share what a sensor says of both, and the errors of such
    a pair mostly cancel in their sum. The std of each load alone bounds that of a sum, and can be many times as large.

    Parameters
    ----------
    settled : SteadyFilter
        Of a fitted tracker (``tracker.fitted.settled``).
    weights : array (sums, loads), or (loads,)
        ``[1, 1, ...]`` for the total; the lever arms for a moment.

    Returns
    -------
    array (sums,)
        In the unit of weight times load. It holds for the samples at which the tracker is settled.

    Raises
    ------
    InputError
        Weights that do not fit the loads.

    Notes
    -----
    ``|w C_p L|``, with L a root of the covariance of the filtered state: no covariance is formed.
    """
    w = np.atleast_2d(reals(weights, where="weights", what="weights that are no real numbers"))
    if w.ndim != 2 or w.shape[1] != settled.model.p or not np.isfinite(w).all():
        raise InputError("the weights do not fit the loads", where="weights", found=f"shape {w.shape}",
                         expected=f"(sums, {settled.model.p}), finite")  # fmt: skip
    return np.asarray(np.linalg.norm(w @ settled.model.Cp @ settled.L, axis=1))
