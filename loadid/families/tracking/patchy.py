"""Likelihood of a record whose channels come and go: several rates, or samples lost.

Sets of channels that repeat have gains that repeat (`loadid.inverse.kalman.periodic`), and an evaluation costs one
product a sample; any others take the square-root filter, a factorisation a sample.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.periodic import PeriodicLoop, periodic
from ...inverse.kalman.roots import forward
from ...inverse.kalman.squareroot import SquareRoot
from .rhythm import LONGEST
from .search import Point

White = tuple[NDArray[np.float64], NDArray[np.float64]]


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
        self, build: Callable[[NDArray], FilterModel], Y: NDArray, use: NDArray[np.bool_], free_scale: bool,
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

    def __call__(self, x: NDArray) -> Point | None:
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
        return Point(np.array(x, float), -value, scale, white, np.eye(self.Y.shape[1]), self.free_scale)


def repeating(there: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """The shortest period (phases, m) of the channels of a record (samples, m); None where they do not repeat."""
    for period in range(1, min(LONGEST, len(there) // 2) + 1):
        if np.array_equal(there[period:], there[:-period]):
            return there[:period]
    return None


def whitened(model: FilterModel, Y: NDArray, masks: NDArray[np.bool_] | None) -> White:
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
            white[k, said.present] = forward(said.root, said.e[said.present])
            spread[k] = np.sum(np.log(np.abs(np.diag(said.root))))
        return white, spread
    found = periodic(model, masks)
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    PeriodicLoop(found, model.x0).block(Y, load, e)
    for t, phase in enumerate(found.phases):
        part, mask = slice(t, None, len(masks)), masks[t]
        white[part, mask] = forward(phase.Se_root, (e[part, mask] * phase.innovation_std).T).T
        spread[part] = np.sum(np.log(np.abs(np.diag(phase.Se_root))))
    return white, spread
