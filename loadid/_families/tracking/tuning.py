"""Numbers of a filter by the likelihood of its innovations: what is tuned, on which stretch, wrong samples out.

An innovation cannot tell a wrong number from an impact, as both surprise. What the smoother leaves of the data can: it
has seen what came later, and a load that is there moves all sensors, so that little is left; of a wrong number nearly
all is left, in one channel alone.

Source: A. C. Harvey, S. J. Koopman, J. Business & Economic Statistics 10 (1992) 377-389 (auxiliary residuals).

The steady filter predicts every sample; the density of what the samples said beyond that is the likelihood. A common
factor on process and measurement noise leaves the gain alone: its optimum is the mean NIS, in closed form, where the
noise level is not known. The search stays within `REACH` of where it starts, and the starts follow from step and length
of the record: a correlation length of ten records is not told from an endless one, nor one of a hundredth of a step
from none. Single wrong samples, which no load explains, are left out in a second pass. A record with gaps everywhere
has its likelihood in `likelihood.Patchy`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures._flags import Flag
from structures.errors import InputError, NotIdentifiable

from ..._guards.tracking import spoilt, undetermined
from ..._inverse.gaussian.model import FilterModel
from ..._inverse.gaussian.records import run_settled, smooth_settled
from ..._inverse.gaussian.roots import Array, solve_lower
from ..._inverse.gaussian.steady import SteadyFilter, steady
from ..data import Data
from .filters import Named, Posing, rescaled
from .likelihood import LikelihoodPoint, Patchy, climb

BEYOND = 8.0  # stds of what is left of a channel, and of its noise
AHEAD = 3.0  # times what is left of the other channels around: no load moves one sensor only
AROUND = 2  # samples before and after, in which they are asked
APART = 10  # samples, within which only the largest is taken at once: a wrong number spoils what is left around it
MOST = 0.02  # of the samples of a record that may be wrong: more is no matter of single samples
TURNS = 12  # in which new ones are looked for
ROUNDS = 3  # of the numbers that stand in for wrong ones
SMALLEST = 1e-3  # share of a number that is left of it: less is no matter of one sample
QUARTILE = 0.6745  # of a normal number's size, which has the median one


@dataclass(frozen=True, eq=False)
class Outliers:
    """Wrong samples, and the record as the others have it.

    Parameters
    ----------
    mask : array of bool, shape (samples, m)
    values : array, shape (samples, m)
        The record; where the mask holds, what all other samples say of it.
    """

    mask: NDArray[np.bool_]
    values: Array

    @property
    def count(self) -> int:
        """Of all channels."""
        return int(self.mask.sum())


def wrong_samples(settled: SteadyFilter, Y: Array) -> Outliers:
    """Numbers of a complete record Y (samples, m) that no load explains, by a smoother at the numbers of a filter.

    Where the load itself moves as it seldom does (an impact, a step) a prior may fit it badly, and that is left alone.
    """
    none = np.zeros(Y.shape, bool)
    mask, kept, values, share = none, none, Y, None
    for _ in range(TURNS):
        new = _apart(settled, smooth_settled(settled, values)[1]) & ~mask & ~kept
        if not new.any():
            return Outliers(mask, values)
        mask = mask | new
        if mask.any(axis=1).mean() > MOST:
            break
        if share is None:
            share = own_share(settled, len(Y))
        values = _replaced(settled, Y, mask, values, share)
        moved = mask & _event(smooth_settled(settled, values)[0])[:, None]
        if moved.any():
            mask, kept = mask & ~moved, kept | moved
            values = _replaced(settled, Y, mask, values, share)
    return Outliers(none, Y)


def _replaced(settled: SteadyFilter, Y: Array, mask: NDArray[np.bool_], values: Array, share: Array) -> Array:
    """The record with what all others say where the mask holds: numbers that the smoother leaves nothing of."""
    values = np.where(mask, values, Y)
    for _ in range(ROUNDS):
        values = np.where(mask, values - smooth_settled(settled, values)[1] / share, Y)
    return values


def _event(load: Array) -> NDArray[np.bool_]:
    """Where a load (samples, p) moves within a few samples as it seldom does (samples,)."""
    moved = np.zeros(load.shape)
    moved[AROUND:-AROUND] = np.abs(load[2 * AROUND :] - load[: -2 * AROUND])
    usual = np.median(moved, axis=0) / QUARTILE
    return np.asarray(np.any(moved > BEYOND * usual, axis=1))


def own_share(settled: SteadyFilter, samples: int) -> Array:
    """What is left of a one amid a record of zeros, for each channel (m,)."""
    m, at = len(settled.Se_root), samples // 2
    found = np.empty(m)
    for i in range(m):
        one = np.zeros((samples, m))
        one[at, i] = 1.0
        found[i] = smooth_settled(settled, one)[1][at, i]
    return np.maximum(found, SMALLEST)


def _apart(settled: SteadyFilter, rest: Array) -> NDArray[np.bool_]:
    """Where one channel is far out, alone and more so than the samples around (samples, m)."""
    from scipy.ndimage import maximum_filter1d

    noise = np.linalg.norm(settled.model.LR, axis=1)
    usual = np.median(np.abs(rest), axis=0) / QUARTILE
    size = np.abs(rest) / np.maximum(np.where(usual > 0, usual, np.inf), noise)
    around = maximum_filter1d(size, 2 * AROUND + 1, axis=0)
    ranked = np.sort(around, axis=1)
    others = np.where(around == ranked[:, -1:], ranked[:, -2:-1] if size.shape[1] > 1 else 0.0, ranked[:, -1:])
    highest = maximum_filter1d(size.max(axis=1), 2 * APART + 1)[:, None]
    return np.asarray((size > BEYOND) & (size >= highest) & (size > AHEAD * others))


SKIPPED = 0.05  # of a record, in which the filter settles
STARTS = 2  # of the grid from which the search goes on
REACH = 100.0  # of the search beyond its starts, as a factor
PASSES = 3  # in which wrong samples are looked for
EDGE = 1e-6  # of a logarithm, within which a number counts as at its bound

Build = Callable[[Array], FilterModel]


@dataclass(frozen=True, eq=False)
class Tuned:
    """The most likely numbers.

    Parameters
    ----------
    parameters : array
        Logarithms, as the search moves them.
    loglik : float
        At the optimum, of the samples that count.
    scale : float
        Variance by which process and measurement noise are to be multiplied; 1 where the level is known.
    evaluations : int
    bounded : tuple of int
        Numbers that ended at a bound of the search: the record does not tell them.
    outliers : tuple of int
        Samples of each channel that no load explains, and that were left out.
    """

    parameters: Array
    loglik: float
    scale: float
    evaluations: int
    bounded: tuple[int, ...] = ()
    outliers: tuple[int, ...] = ()


def tune(
    build: Build,
    starts: list[Array],
    Y: Array,
    *,
    free_scale: bool,
    progress: Callable[[float], None] = lambda share: None,
) -> Tuned:
    """Scoring from the best of a grid of starts, once more without wrong samples where there are some.

    Parameters
    ----------
    build : callable
        Model of logarithms of the parameters.
    starts : list of array
    Y : array, shape (samples, sensors)
        NaN where a channel is missing; wrong samples are looked for where nothing is.
    free_scale : bool
        The noise level is not known: the common scale is at its optimum everywhere.

    Raises
    ------
    InputError
        No filter exists for any start.
    """
    grid = np.array(starts, float)
    low, high = grid.min(axis=0) - np.log(REACH), grid.max(axis=0) + np.log(REACH)
    whole = bool(np.isfinite(Y).all())
    likely: Likelihood | Patchy = Likelihood(build, Y, free_scale, progress)
    if not whole:
        likely = Patchy(build, Y, settled_samples(len(Y)), free_scale, progress)
    points = sorted((p for p in map(likely, grid) if p is not None), key=lambda p: p.cost)
    if not points:
        raise InputError("no steady filter exists for any numbers of this prior", where="fit",
                         found=f"{len(starts)} starts", expected="a prior that the sensors can follow",
                         hint="add a displacement or strain sensor, take a prior that returns to zero, or state the "
                         "numbers of the prior, such as RandomWalk(100)")  # fmt: skip
    best = climb(likely, points[0], low, high)
    for point in points[1:STARTS]:
        best = min(best, climb(likely, point, low, high, best), key=lambda p: p.cost)
    count, wrong = likely.count, None
    for _ in range(PASSES if whole else 0):
        found = wrong_samples(steady(rescaled(build(best.x), best.scale)), Y)
        if found.count == 0 or (wrong is not None and np.array_equal(found.mask, wrong.mask)):
            break
        wrong = found
        likely = Likelihood(build, wrong.values, free_scale, progress, np.asarray(wrong.mask.any(axis=1)))
        again = likely(best.x)
        assert again is not None  # a filter exists here
        best = climb(likely, again, low, high)
        count += likely.count
    edge = np.flatnonzero((best.x <= low + EDGE) | (best.x >= high - EDGE))
    left = () if wrong is None else tuple(wrong.mask.sum(axis=0).tolist())
    return Tuned(best.x, -best.cost, best.scale, count, tuple(edge.tolist()), left)


class Likelihood:
    """Points of a search: the likelihood of a complete record (samples, sensors) at numbers, and how often asked.

    Parameters
    ----------
    build, Y, free_scale, progress
        As in `tune`.
    apart : array of bool (samples,), optional
        Samples that do not count.
    """

    def __init__(
        self,
        build: Build,
        Y: Array,
        free_scale: bool,
        progress: Callable[[float], None],
        apart: NDArray[np.bool_] | None = None,
    ) -> None:
        self.build, self.Y, self.free_scale, self.progress, self.count = build, Y, free_scale, progress, 0
        self.use = settled_samples(len(Y)) if apart is None else settled_samples(len(Y)) & ~apart

    def __call__(self, x: Array) -> LikelihoodPoint | None:
        """Where a filter exists."""
        self.count += 1
        self.progress(min(self.count / 100, 1.0))
        try:
            found = steady(self.build(x))
        except (NotIdentifiable, InputError, np.linalg.LinAlgError):
            return None
        e = run_settled(found, self.Y)[1][self.use]
        value, scale = density(found.Se_root, e, self.free_scale)
        if not np.isfinite(value):
            return None
        root = found.Se_root * np.where(np.diag(found.Se_root) < 0, -1.0, 1.0)
        return LikelihoodPoint(np.array(x, float), -value, scale, e, root, self.free_scale)


def settled_samples(count: int) -> NDArray[np.bool_]:
    """Samples of a record in which the filter has settled (count,)."""
    return np.arange(count) >= min(max(int(SKIPPED * count), 10), count - 1)


def density(root: Array, e: Array, free_scale: bool) -> tuple[float, float]:
    """Log-likelihood of innovations (samples, m) of a covariance given by its root, and the scale of the noises."""
    white = solve_lower(root, e.T)
    squares, number = float(np.sum(white**2)), white.size
    scale = squares / number if free_scale else 1.0
    spread = float(np.sum(np.log(np.abs(np.diag(root))))) + 0.5 * len(root) * float(np.log(scale))
    return -0.5 * (squares / scale + number * float(np.log(2 * np.pi))) - len(e) * spread, scale


def likelihood(filtered: SteadyFilter, Y: Array, free_scale: bool) -> tuple[float, float]:
    """Log-likelihood of the samples of a complete record beyond the settling, and the common scale of the noises."""
    return density(filtered.Se_root, run_settled(filtered, Y)[1][settled_samples(len(Y))], free_scale)


LONGEST = 60_000  # samples that a fit is tuned on
PATCHY = 2000  # of a record with gaps everywhere
SHORTEST, ENOUGH = 50, 500  # samples without a gap: that a fit takes, and that it prefers to all with gaps
FACTORS = (0.3, 1.0, 3.0, 10.0)  # on a noise that is to be found beside priors that are given


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a search has found.

    Parameters
    ----------
    x : array
        Logarithms, as `Posing` takes them.
    scale : float
        Variance on all noises.
    words : mapping of str to float
        The numbers by name.
    flags : tuple of Flag
        Numbers that the record does not tell (W523), wrong samples (W524).
    """

    x: Array
    scale: float
    words: Mapping[str, float]
    flags: tuple[Flag, ...]


def numbers_of(
    posing: Posing, data: Data, size: float, known: bool, progress: Callable[[float], None] = lambda share: None
) -> Numbers:
    """The most likely numbers of all priors that are named, of scales of the model, of a noise that is not known.

    Parameters
    ----------
    posing : Posing
    data : Data
    size : float
        Std of a white load that moves the sensors as they move.
    known : bool
        The noise is stated.
    progress : callable

    Raises
    ------
    InputError
        The record is too short; no filter exists for any numbers.
    """
    if posing.shared is None and not posing.scales and known:
        return Numbers(np.zeros(0), 1.0, {}, ())
    Y = stretch(data)
    own = [g.starts(size, data.dt, len(data.values)) for g in posing.given if isinstance(g, Named)]
    starts = [np.concatenate(parts) for parts in zip(*own, strict=False)] or [np.zeros(0)]
    factors = np.log(FACTORS)[:, None] if posing.free_noise else np.zeros((1, 0))
    grid = [np.r_[s, np.zeros(len(posing.scales)), factor] for s in starts for factor in factors]
    free = not (known or posing.free_noise)
    found = tune(posing.build, grid, Y, free_scale=free, progress=progress)
    words = dict(zip(posing.names, np.exp(found.parameters).tolist(), strict=True))
    if free:
        words["noise scale"] = float(np.sqrt(found.scale))
    words["log-likelihood"] = found.loglik
    labels = [c.label for c in data.channels]
    said = (
        undetermined([posing.names[i] for i in found.bounded]),
        spoilt(found.outliers, labels) if found.outliers else None,
    )
    return Numbers(found.parameters, found.scale, words, tuple(flag for flag in said if flag is not None))


def stretch(data: Data) -> Array:
    """What a fit is tuned on: a complete stretch where there is a long one, else the record with its gaps (NaN).

    Raises
    ------
    InputError
        Too few samples.
    """
    if np.any(data.missing.all(axis=0)) or not (tail := ~data.missing.all(axis=1)).any():
        return complete(data)  # refuses, and says why
    runs = np.diff(np.flatnonzero(np.r_[True, data.missing.any(axis=1), True])) - 1
    if runs.max(initial=0) >= min(ENOUGH, len(data.values) // 2):
        return complete(data)
    start, stop = np.flatnonzero(tail)[[0, -1]]
    Y = np.where(data.missing, np.nan, data.values)[start : min(stop + 1, start + PATCHY)]
    return np.ascontiguousarray(Y) if len(Y) >= SHORTEST else complete(data)


def complete(data: Data) -> Array:
    """The longest stretch of a record without gaps, at most `LONGEST` samples.

    Raises
    ------
    InputError
        There is none, or it is too short to tune on.
    """
    good = np.concatenate([[False], ~data.missing.any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(good)).reshape(-1, 2)
    if not len(edges):
        raise InputError("no sample of the record is complete", where="fit", found="every sample lacks a channel",
                         expected="a stretch with all channels", hint="fit with fewer sensors (sensors=)")  # fmt: skip
    start, stop = edges[np.argmax(np.ptp(edges, axis=1))]
    stop = min(stop, start + LONGEST)
    if stop - start < SHORTEST:
        raise InputError("the record is too short to tune on", where="fit", found=f"{stop - start} complete samples",
                         expected=f"at least {SHORTEST}", hint="record longer, or state prior and noise")  # fmt: skip
    return np.ascontiguousarray(data.values[start:stop])
