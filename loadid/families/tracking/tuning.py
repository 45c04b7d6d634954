"""Numbers of a filter by the likelihood of its innovations.

The steady filter predicts every sample; the density of what the samples said beyond that is the likelihood. A common
factor on process and measurement noise leaves the gain alone: its optimum is the mean NIS, in closed form, where the
noise level is not known. The search stays within `REACH` of where it starts, and the starts follow from step and length
of the record: a correlation length of ten records is not told from an endless one, nor one of a hundredth of a step
from none. Single wrong samples, which no load explains, are left out in a second pass. A record with gaps everywhere
has its likelihood in `patchy`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.steady import Steady, steady
from .patchy import Patchy
from .posed import rescaled
from .search import Point, climb
from .wrong import wrong_samples

SKIPPED = 0.05  # of a record, in which the filter settles
STARTS = 2  # of the grid from which the search goes on
REACH = 100.0  # of the search beyond its starts, as a factor
PASSES = 3  # in which wrong samples are looked for
EDGE = 1e-6  # of a logarithm, within which a number counts as at its bound

Build = Callable[[NDArray], FilterModel]


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
    wrong : tuple of int
        Samples of each channel that no load explains, and that were left out.
    """

    parameters: NDArray[np.float64]
    loglik: float
    scale: float
    evaluations: int
    bounded: tuple[int, ...] = ()
    wrong: tuple[int, ...] = ()


def tune(
    build: Build,
    starts: list[NDArray],
    Y: NDArray,
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
        Y: NDArray,
        free_scale: bool,
        progress: Callable[[float], None],
        apart: NDArray[np.bool_] | None = None,
    ) -> None:
        self.build, self.Y, self.free_scale, self.progress, self.count = build, Y, free_scale, progress, 0
        self.use = settled_samples(len(Y)) if apart is None else settled_samples(len(Y)) & ~apart

    def __call__(self, x: NDArray) -> Point | None:
        """Where a filter exists."""
        self.count += 1
        self.progress(min(self.count / 100, 1.0))
        try:
            found = steady(self.build(x))
        except (NotIdentifiable, InputError, np.linalg.LinAlgError):
            return None
        e = innovations(found, self.Y)[self.use]
        value, scale = density(found.Se_root, e, self.free_scale)
        if not np.isfinite(value):
            return None
        root = found.Se_root * np.where(np.diag(found.Se_root) < 0, -1.0, 1.0)
        return Point(np.array(x, float), -value, scale, e, root, self.free_scale)


def settled_samples(count: int) -> NDArray[np.bool_]:
    """Samples of a record in which the filter has settled (count,)."""
    return np.arange(count) >= min(max(int(SKIPPED * count), 10), count - 1)


def density(root: NDArray, e: NDArray, free_scale: bool) -> tuple[float, float]:
    """Log-likelihood of innovations (samples, m) of a covariance given by its root, and the scale of the noises."""
    from ...inverse.kalman.roots import forward

    white = forward(root, e.T)
    squares, number = float(np.sum(white**2)), white.size
    scale = squares / number if free_scale else 1.0
    spread = float(np.sum(np.log(np.abs(np.diag(root))))) + 0.5 * len(root) * float(np.log(scale))
    return -0.5 * (squares / scale + number * float(np.log(2 * np.pi))) - len(e) * spread, scale


def likelihood(filtered: Steady, Y: NDArray, free_scale: bool) -> tuple[float, float]:
    """Log-likelihood of the samples of a complete record beyond the settling, and the common scale of the noises."""
    return density(filtered.Se_root, innovations(filtered, Y)[settled_samples(len(Y))], free_scale)


def innovations(filtered: Steady, Y: NDArray) -> NDArray[np.float64]:
    """What each sample of a complete record (samples, sensors) says beyond the steady prediction."""
    from ...inverse.kalman.loops import Loop

    model = filtered.model
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    loop = Loop(filtered.rows(), model.p, model.m, model.x0)
    loop.compile()  # a search asks many times
    loop.block(Y, load, e)
    return e
