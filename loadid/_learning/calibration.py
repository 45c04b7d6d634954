"""The std of a map, made to hold what it says by split conformal prediction on examples that were kept apart.

J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, Distribution-free predictive inference for regression,
J. Am. Stat. Assoc. 113 (2018) 1094: errors over their stated std are exchangeable between draws, so that their quantile
on the examples kept apart covers as often on those to come.
"""

from __future__ import annotations

from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]

FEWEST = 20  # draws that calibrate
EACH = 100  # draws from which every output has a factor of its own


def factors(errors: Array, std: Array, groups: NDArray[np.int_], coverage: float, draws: int) -> Array:
    """What to multiply the std of each output with, (outputs,).

    Parameters
    ----------
    errors, std : array (numbers, outputs)
        Errors on examples kept apart, and the std that the engine states for them.
    groups : array of int (outputs,)
        Outputs of one quantity and direction, which share a factor where there are too few draws for each.
    coverage : float
        Of the band of `coverage` of a normal distribution of that std.
    draws : int
        That these numbers come from.
    """
    ratio = np.abs(errors) / np.maximum(std, np.finfo(float).tiny)
    ratio = np.where((errors == 0) & (std == 0), 0.0, ratio)
    wide = NormalDist().inv_cdf(0.5 + coverage / 2)
    if draws >= EACH:
        return np.array([quantile(column, coverage) for column in ratio.T]) / wide
    shared = {int(g): quantile(ratio[:, groups == g].ravel(), coverage) for g in np.unique(groups)}
    return np.array([shared[int(g)] for g in groups]) / wide


def quantile(scores: Array, level: float) -> float:
    """The conformal quantile: the ceil((n + 1) level)-th smallest of n scores, the largest where there is none."""
    n = len(scores)
    at = min(int(np.ceil((n + 1) * level)), n) - 1
    return float(np.partition(scores, at)[at])


def require_draws(draws: int) -> None:
    """Nothing, if so many draws are enough to calibrate with.

    Raises
    ------
    InputError
        They are not.
    """
    if draws < FEWEST:
        raise InputError(
            "too few draws to calibrate the std and the alarm with", where="training",
            found=f"{draws} draws are kept for that", expected=f"at least {FEWEST}",
            hint="draw more examples, or cut long records into several",
        )  # fmt: skip
