"""Likelihood of records whose channels come and go, at several rates, and its maximum by scoring.

A channel that is sampled every tenth time is missing in nine of ten samples. Where the sets of channels of the last
samples repeat with a period, the gains do too (`loadid._inverse.gaussian.steady`): they are solved for once, and from
there on a sample is one product again.

The innovations e of a steady filter are white with covariance S. Their information of the numbers is
``sum_k de_k^T S^-1 de_k + samples / 2 tr(S^-1 dS S^-1 dS)``; a difference for each number gives it together with the
slope, so that a step costs one filter more than there are numbers. A common factor on all noises is at its optimum
everywhere; what it shares with the numbers is taken out of their information.

Source: N. K. Gupta, R. K. Mehra, IEEE Trans. Automat. Control 19 (1974) 774-783 (scoring for innovations).

Sets of channels that repeat have gains that repeat (`loadid._inverse.gaussian.steady`), and an evaluation costs one
product a sample; any others take the square-root filter, a factorisation a sample.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ..._inverse.gaussian.loop import PeriodicLoop
from ..._inverse.gaussian.model import FilterModel, FilterState, SquareRoot
from ..._inverse.gaussian.roots import Array, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter, periodic

LONGEST = 128  # samples of a period
REPEATED = 2  # periods that show one
LEAST = 32  # samples that show one
FOR_GOOD = 256  # samples without a channel that show that it will not come back
NAMES = 1024  # sets of channels that are told apart
KEPT = 8  # rhythms whose gains are kept
SHOWN = np.maximum(REPEATED * np.arange(1, LONGEST + 1), LEAST)  # samples that show each period
SHOWN[0] = FOR_GOOD


class ChannelPeriod:
    """The filters of a period.

    Parameters
    ----------
    core : SquareRoot
    masks : array of bool, shape (phases, m)

    Raises
    ------
    NotIdentifiable
        No filter settles on these channels.
    """

    def __init__(self, core: SquareRoot, masks: NDArray[np.bool_]) -> None:
        self.masks, self.filters = masks, periodic(core.model, masks)
        self.variances = [np.sum(f.L**2, axis=1) for f in self.filters.phases]
        self.std, self.absent = self.filters.std, np.sum(~masks, axis=1)
        self.std.setflags(write=False)
        zero, last = np.zeros(core.model.n), np.roll(masks, 1, axis=0)
        self.ahead = [  # root of the prediction of each phase
            core.predict(FilterState(zero, self.filters.phases[t - 1].L, np.where(last[t], 0.0, np.nan))).L
            for t in range(len(masks))
        ]

    @property
    def period(self) -> int:
        """Samples."""
        return len(self.masks)

    def pair(self, phase: int) -> tuple[SteadyFilter, SteadyFilter]:
        """Filters of the phase before, and of this one; phases count on."""
        phases, T = self.filters.phases, self.period
        return phases[(phase - 1) % T], phases[phase % T]


class Listener:
    """Recognises a period in the sets of channels that come.

    Parameters
    ----------
    core : SquareRoot
    settled : bool
        All channels have a settled gain already: that they are there is no period to solve for.
    """

    def __init__(self, core: SquareRoot, settled: bool = False) -> None:
        self.core, self.settled = core, settled
        self._known: dict[bytes, ChannelPeriod | None] = {}
        self.clear()

    def clear(self) -> None:
        """Forget what has come."""
        self.heard = 0
        self._last: tuple[tuple[int, int], ChannelPeriod | None, int] | None = None
        self._names: dict[bytes, int] = {}  # of masks, in the ring
        self._ring = np.full(2 * LONGEST, -1)  # the last ones, the newest first, twice: they lie side by side
        self.runs = np.zeros(LONGEST, int)  # samples in a row that were as those 1, 2, ... samples before

    def hear(self, mask: NDArray[np.bool_]) -> None:
        """Channels present in the next sample."""
        if len(self._names) >= NAMES:  # sets that never come again
            self._rename()
        name = self._names.setdefault(mask.tobytes(), len(self._names))
        at = LONGEST - self.heard % LONGEST  # the ring runs backwards
        self.runs += 1
        self.runs *= self._ring[at : at + LONGEST] == name
        self._ring[at - 1] = self._ring[at - 1 + LONGEST] = name
        self.heard += 1

    def ear(self, there: NDArray[np.bool_]) -> tuple[Any, ...]:
        """What `RootLoop.block` hears the next samples (samples, m) with; `heard` is left to who calls it."""
        if len(self._names) >= NAMES:
            self._rename()
        names, data, m = self._names, there.tobytes(), there.shape[1]
        listed = np.array([names.setdefault(data[i : i + m], len(names)) for i in range(0, len(data), m)])
        return self.heard, listed, self._ring, self.runs, SHOWN

    def _rename(self) -> None:
        """Names of the sets in the ring alone."""
        used, ring = np.unique(self._ring, return_inverse=True)
        known = list(self._names)
        gone = int(used[0] == -1)  # nothing has come there
        self._names = {known[old]: new for new, old in enumerate(used[gone:])}
        self._ring = ring.reshape(-1) - gone

    def past(self, count: int) -> NDArray[np.bool_]:
        """Masks of the last samples (count, m), the oldest first."""
        at = LONGEST - (self.heard - 1) % LONGEST - 1
        masks = [np.frombuffer(name, bool) for name in self._names]
        return np.array([masks[i] for i in self._ring[at : at + count][::-1]]).reshape(count, self.core.model.m)

    def found(self) -> tuple[ChannelPeriod, int] | None:
        """The rhythm of what came last, and the phase of the last sample; None where there is none that settles."""
        shown = self.runs >= SHOWN
        if not shown.any():
            return None
        period = int(np.argmax(shown)) + 1
        if self._last is not None and self._last[0] == (self.heard - 1, period):  # it goes on
            rhythm, phase = self._last[1], (self._last[2] + 1) % period
            self._last = (self.heard, period), rhythm, phase
            return None if rhythm is None else (rhythm, phase)
        masks = self.past(period)  # the last one is that of now
        turn = min(range(period), key=lambda t: np.roll(masks, -t, axis=0).tobytes())
        rhythm = None if self.settled and masks.all() else self.solved(np.roll(masks, -turn, axis=0))
        phase = (period - 1 - turn) % period
        self._last = (self.heard, period), rhythm, phase
        return None if rhythm is None else (rhythm, phase)

    def solved(self, masks: NDArray[np.bool_]) -> ChannelPeriod | None:
        """Filters of a period, solved for once; None where none settles."""
        key = masks.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.clear()
            try:
                self._known[key] = ChannelPeriod(self.core, masks) if masks.any() else None
            except (NotIdentifiable, InputError):
                self._known[key] = None
        return self._known[key]

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {"heard": self.heard, "past": self.past(min(self.heard, LONGEST)), "runs": self.runs.copy()}

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.clear()
        past = np.array(tree["past"], bool).reshape(-1, self.core.model.m)
        self.heard = int(tree["heard"]) - len(past)
        for mask in past:
            self.hear(mask)
        self.runs = np.array(tree["runs"], int)


NUDGE = 1e-4  # of a logarithm, for the differences
FARTHEST = 1.5  # by which a step moves a logarithm at most
ENOUGH = 1e-4  # of a log-likelihood: what a further step may promise
STEPS = 40
NEAR = 0.2  # of the logarithms, within which two ways end at one top
DAMPING, EASE, STIFFEN = 1e-3, 0.2, 5.0
GIVE_UP = 1e8  # of the damping


@dataclass(frozen=True, eq=False)
class LikelihoodPoint:
    """What numbers are worth.

    Parameters
    ----------
    x : array
        Logarithms of the numbers.
    cost : float
        Negative log-likelihood.
    scale : float
        Common variance of the noises, at its optimum or 1.
    e : array, shape (samples, m)
        Innovations of the samples that count.
    root : array, shape (m, m)
        Lower triangular root of their covariance, positive diagonal.
    free : bool
        The scale is at its optimum.
    """

    x: Array
    cost: float
    scale: float
    e: Array
    root: Array
    free: bool


def climb(
    at: Callable[[Array], LikelihoodPoint | None],
    start: LikelihoodPoint,
    low: Array,
    high: Array,
    top: LikelihoodPoint | None = None,
) -> LikelihoodPoint:
    """The best point that steps from a start reach between two bounds.

    Parameters
    ----------
    at : callable
        Point of logarithms; None where no filter exists.
    start : LikelihoodPoint
    low, high : array
    top : LikelihoodPoint, optional
        Where another start has ended: a way that comes near it is not gone to its end.
    """
    best, damping = start, DAMPING
    for _ in range(STEPS):
        if top is not None and np.abs(best.x - top.x).max() < NEAR and best.cost >= top.cost:
            return top
        slope, known = _expanded(at, best, high)
        free = ~(((best.x <= low) & (slope > 0)) | ((best.x >= high) & (slope < 0)))
        if not free.any():
            return best
        while damping < GIVE_UP:
            move = _step(slope, known, free, damping)
            x = np.clip(best.x + move, low, high)
            promised = -float(slope @ (x - best.x)) / 2
            if promised <= ENOUGH:
                return best
            found = at(x)
            if found is not None and found.cost < best.cost:
                best, damping = found, damping * EASE
                break
            damping *= STIFFEN
        else:
            return best
    return best


def _step(slope: Array, known: Array, free: NDArray[np.bool_], damping: float) -> Array:
    """Damped step of the numbers that are free to move."""
    some = np.ix_(free, free)
    size = np.diag(known)[free]
    part = known[some] + damping * np.diag(np.where(size > 0, size, 1.0))
    move = np.zeros(len(slope))
    move[free] = -np.linalg.lstsq(part, slope[free], rcond=1e-12)[0]
    return move / max(1.0, float(np.abs(move).max()) / FARTHEST)


def _expanded(at: Callable[[Array], LikelihoodPoint | None], best: LikelihoodPoint, high: Array) -> tuple[Array, Array]:
    """Slope of the cost and information of the numbers at a point; zero where a number cannot be moved."""
    count, samples = len(best.x), len(best.e)
    slope, nudges, news, roots = np.zeros(count), np.zeros(count), [], []
    for i in range(count):
        moved, h = None, NUDGE
        for h in (NUDGE, -NUDGE) if best.x[i] + NUDGE <= high[i] else (-NUDGE,):
            x = best.x.copy()
            x[i] += h
            moved = at(x)
            if moved is not None:
                break
        if moved is None:
            news.append(np.zeros(best.e.size))
            roots.append(np.zeros(best.root.shape))
            continue
        slope[i], nudges[i] = (moved.cost - best.cost) / h, h
        news.append(solve_lower(best.root, ((moved.e - best.e) / h).T).ravel() / np.sqrt(best.scale))
        change = (moved.root @ moved.root.T - best.root @ best.root.T) / h
        roots.append(solve_lower(best.root, solve_lower(best.root, change).T))
    J, V = np.array(news), np.array(roots).reshape(count, -1)
    known = J @ J.T + samples / 2 * (V @ V.T)
    if best.free:  # the scale changes the covariance by itself, the innovations not at all
        shared = samples / 2 * np.array([np.trace(v) for v in roots])
        known -= np.outer(shared, shared) / (samples / 2 * len(best.root))
    return slope - nudges / 2 * np.diag(known), known  # a one-sided difference sees half a curvature too much


White = tuple[Array, Array]


class Patchy:
    """Points of a search on a record with NaN, as `tuning.Likelihood` on a complete one.

    The innovations of its points are whitened, each sample by its own covariance: what scoring then sees of the
    numbers is a little less than their whole information, which costs steps and moves no optimum.

    Parameters
    ----------
    build : callable
        Model of logarithms of the numbers.
    Y : array, shape (samples, m)
    use : array of bool (samples,)
        Samples that count.
    free_scale : bool
    progress : callable
    """

    def __init__(
        self, build: Callable[[Array], FilterModel], Y: Array, use: NDArray[np.bool_], free_scale: bool,
        progress: Callable[[float], None],
    ) -> None:  # fmt: skip
        self.build, self.Y, self.use, self.free_scale, self.progress, self.count = (
            build,
            Y,
            use,
            free_scale,
            progress,
            0,
        )
        self.masks = repeating(np.isfinite(Y))

    def __call__(self, x: Array) -> LikelihoodPoint | None:
        """Where a filter exists."""
        self.count += 1
        self.progress(min(self.count / 100, 1.0))
        try:
            white, spread = whitened(self.build(x), self.Y, self.masks)
        except (NotIdentifiable, InputError, np.linalg.LinAlgError):
            return None
        white, there = white[self.use], np.isfinite(self.Y[self.use])
        squares, number = float(np.sum(white**2)), int(there.sum())
        scale = squares / number if self.free_scale else 1.0
        value = -0.5 * (squares / scale + number * float(np.log(2 * np.pi * scale))) - float(np.sum(spread[self.use]))
        if not np.isfinite(value):
            return None
        return LikelihoodPoint(np.array(x, float), -value, scale, white, np.eye(self.Y.shape[1]), self.free_scale)


def repeating(there: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """The shortest period (phases, m) of the channels of a record (samples, m); None where they do not repeat."""
    for period in range(1, min(LONGEST, len(there) // 2) + 1):
        if np.array_equal(there[period:], there[:-period]):
            return there[:period]
    return None


def whitened(model: FilterModel, Y: Array, masks: NDArray[np.bool_] | None) -> White:
    """Innovations (samples, m) over the root of their covariance, 0 where missing; log of its determinant, halved.

    Raises
    ------
    NotIdentifiable
        No filter settles on channels that repeat.
    """
    white, spread = np.zeros(Y.shape), np.zeros(len(Y))
    if masks is None:
        core, state = SquareRoot(model), None
        for k, y in enumerate(Y):
            state, said = core.update(core.start(), y) if state is None else core.advance(state, y)
            white[k, said.present] = solve_lower(said.root, said.e[said.present])
            spread[k] = np.sum(np.log(np.abs(np.diag(said.root))))
        return white, spread
    found = periodic(model, masks)
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    PeriodicLoop(found, model.x0).block(Y, load, e)
    for t, phase in enumerate(found.phases):
        part, mask = slice(t, None, len(masks)), masks[t]
        white[part, mask] = solve_lower(phase.Se_root, (e[part, mask] * phase.innovation_std).T).T
        spread[part] = np.sum(np.log(np.abs(np.diag(phase.Se_root))))
    return white, spread
