"""Sums of tracked loads with their std: a total, a resultant, a difference between two places."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import reals

from .steady import Steady


def combined_std(settled: Steady, weights: ArrayLike) -> NDArray[np.float64]:
    """Std of weighted sums of the loads at the settled gain.

    The loads of one sample are correlated: neighbouring places share what a sensor says of both, and the errors of such
    a pair mostly cancel in their sum. The std of each load alone bounds that of a sum, and can be many times as large.

    Parameters
    ----------
    settled : Steady
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
