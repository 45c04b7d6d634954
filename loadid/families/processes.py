"""Gaussian processes in time as priors of a load, compared by the evidence of a record.

Every prior of the tracker gives the record a density, all its numbers at their most likely: the product of what the
filter expected of each sample. Priors compare by it, with a price for each number that was tuned; a white load is the
prior of Tikhonov, and stands among them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable
from structures.model import Model

from .data import Data
from .kalman import LoadTracker
from .sparsity import Problem
from .tracking.tracker import Tracker

NAMES = ("white", "random_walk", "ou", "matern32", "matern52")
FEW = ("white", "matern32", "matern52")  # where loads are many, as each has numbers of its own
MANY = 4  # loads

Say = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class Process:
    """A prior that was tuned to a record.

    Parameters
    ----------
    name : str
        As `LoadTracker` takes it.
    tracker : Tracker
    criterion : float
        ``-2 log p(record) + numbers log data``: smaller is better; natural units of the record, so that it compares
        with `of_sparse`.
    """

    name: str
    tracker: Tracker
    criterion: float


def compared(model: Model, data: Data, samples: int, settings: Mapping[str, Any], say: Say) -> dict[str, Process]:
    """Every prior that a tracker of this model carries, on the first samples of a record; empty where it carries none.

    Parameters
    ----------
    model : Model
    data : Data
    samples : int
        From the start of the record.
    settings : mapping
        Of `LoadTracker`.
    say : callable
    """
    names = NAMES if len(model.loads) <= MANY else FEW
    Y = np.where(data.missing, np.nan, data.values)[:samples]
    found: dict[str, Process] = {}
    for i, name in enumerate(names):
        say(i / len(names), f"a load that is {name.replace('_', ' ')}")
        try:
            tracker = LoadTracker(model, prior=name, gate=None, **settings).fit(Y, data.dt)
            found[name] = Process(name, tracker, _criterion(tracker, Y))
        except (
            InputError,
            NotIdentifiable,
        ):  # no state space, a walk that nobody sees, a record with holes: another prior, or none
            continue
    return found


def of_sparse(score: float, problem: Problem, samples: int) -> float:
    """An information criterion of `loadid.inverse.sparse.path` in the units of a `Process`.

    Samples before the response begins hold noise alone, which costs what noise of the stated level costs.
    """
    level = np.broadcast_to(np.asarray(problem.noise.level, float), (problem.values.shape[1],))
    present = (~problem.missing[: problem.samples]).sum(axis=0)
    early = max(samples - problem.samples, 0)
    logs = float(np.sum((present + early) * np.log(2 * np.pi * level**2)))
    free = problem.data if problem.noise.sigma is None else 0  # |r|^2 at its own level
    return score + logs + free + early * len(level)


def _criterion(tracker: Tracker, Y: NDArray) -> float:
    from ..inverse.kalman.records import filter_settling

    settled = tracker.fitted.settled
    if settled is None:
        raise InputError("a filter that never settles has no evidence", where="recommend", found="a drift",
                         expected="a settled gain")  # fmt: skip
    tuned = len([name for name in tracker.fitted.numbers if name != "log-likelihood"])
    density = float(np.sum(filter_settling(settled, Y).filtered.loglik))
    return -2 * density + tuned * float(np.log(np.isfinite(Y).sum()))
