"""Numbers of a filter by the likelihood of its innovations.

The steady filter predicts every sample; the density of what the samples said beyond that is the likelihood. A common
factor on process and measurement noise leaves the gain alone: its optimum is the mean NIS, in closed form, where the
noise level is not known.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable

from ...inverse.kalman.model import FilterModel
from ...inverse.kalman.steady import Steady, steady

SKIPPED = 0.05  # of a record, in which the filter settles
STARTS = 2  # of the grid from which the search goes on
LOST = 1e12  # of a filter that does not exist


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
    """

    parameters: NDArray[np.float64]
    loglik: float
    scale: float
    evaluations: int


def tune(
    build: Callable[[NDArray], FilterModel],
    starts: list[NDArray],
    Y: NDArray,
    *,
    free_scale: bool,
    step: float = 0.3,
    progress: Callable[[float], None] = lambda share: None,
) -> Tuned:
    """Nelder-Mead from the best of a grid of starts.

    Parameters
    ----------
    build : callable
        Model of logarithms of the parameters.
    starts : list of array
    Y : array, shape (samples, sensors)
        Without gaps.
    free_scale : bool
        The noise level is not known: the common scale is at its optimum everywhere.
    step : float
        First step of the simplex, in logarithms.

    Raises
    ------
    InputError
        No filter exists for any start.
    """
    from scipy.optimize import minimize

    count = 0

    def cost(x: NDArray) -> float:
        nonlocal count
        count += 1
        progress(min(count / 150, 1.0))
        try:
            found = steady(build(x))
        except (NotIdentifiable, InputError, np.linalg.LinAlgError):
            return LOST
        value = likelihood(found, Y, free_scale)[0]
        return -value if np.isfinite(value) else LOST

    values = [cost(x) for x in starts]
    if min(values) >= LOST:
        raise InputError("no steady filter exists for any numbers of this prior", where="fit",
                         found=f"{len(starts)} starts", expected="a prior that the sensors can follow",
                         hint="add a displacement or strain sensor, take a prior that returns to zero, or state the "
                         "numbers of the prior, such as RandomWalk(100)")  # fmt: skip
    best = None
    for k in np.argsort(values)[:STARTS]:
        x0 = np.asarray(starts[k], float)
        simplex = np.vstack([x0, x0 + step * np.eye(len(x0))])
        options = {"initial_simplex": simplex, "xatol": 5e-3, "fatol": 1e-2, "maxfev": 80 * len(x0)}
        found = minimize(cost, x0, method="Nelder-Mead", options=options)
        if best is None or found.fun < best.fun:
            best = found
    assert best is not None
    value, scale = likelihood(steady(build(best.x)), Y, free_scale)
    return Tuned(np.asarray(best.x, float), value, scale, count)


def likelihood(filtered: Steady, Y: NDArray, free_scale: bool) -> tuple[float, float]:
    """Log-likelihood of the samples beyond the settling, and the common scale of the noises."""
    from ...inverse.kalman.roots import forward

    e = innovations(filtered, Y)
    first = min(max(int(SKIPPED * len(Y)), 10), len(Y) - 1)
    white = forward(filtered.Se_root, e[first:].T)
    squares, number = float(np.sum(white**2)), white.size
    scale = squares / number if free_scale else 1.0
    spread = float(np.sum(np.log(np.abs(np.diag(filtered.Se_root))))) + 0.5 * len(filtered.Se_root) * np.log(scale)
    value = -0.5 * (squares / scale + number * np.log(2 * np.pi)) - (len(Y) - first) * spread
    return value, scale


def innovations(filtered: Steady, Y: NDArray) -> NDArray[np.float64]:
    """What each sample of a complete record (samples, sensors) says beyond the steady prediction."""
    from ...inverse.kalman.loops import Loop

    model = filtered.model
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    Loop(filtered.rows(), model.p, model.m, model.x0).block(Y, load, e)
    return e
