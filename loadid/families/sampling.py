"""Draws from the posterior of a static problem."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

from ..inverse.choice import Choice
from .steady import Steady


def drawn(posed: Steady, choice: Choice, sigma: float, draws: int, seed: int) -> NDArray[np.float64]:
    """See `StaticInversion.sample`.

    Raises
    ------
    InputError
        If the number of draws is no positive integer.
    """
    if isinstance(draws, bool) or not isinstance(draws, int | np.integer) or draws < 1:
        raise InputError("no number of draws", where="sample", found=repr(draws)[:40], expected="a positive integer")
    if posed.constrained:
        return posed.path.sample(choice.lam, sigma, int(draws), seed=seed)
    solution, rng = posed.base.solution(choice.lam, sigma), np.random.default_rng(seed)
    factor = solution.posterior.factor  # type: ignore[union-attr]
    lead = solution.load.shape[:-1]
    return solution.load + rng.standard_normal((int(draws), *lead, factor.shape[1])) @ factor.T
