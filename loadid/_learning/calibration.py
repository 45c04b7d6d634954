"""The std of a map, made to hold what it says by split conformal prediction on examples that were kept apart.

J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, Distribution-free predictive inference for regression,
J. Am. Stat. Assoc. 113 (2018) 1094: errors over their stated std are exchangeable between draws, so that their quantile
on the examples kept apart covers as often on those to come.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Array = NDArray[np.float64]

FEWEST = 20  # draws that calibrate
EACH = 1000  # draws from which every output has a factor of its own


@dataclass(frozen=True, eq=False)
class Factors:
    """What to multiply the std of an engine with.

    Parameters
    ----------
    inside : array (outputs,)
        Of static loads, and of samples far from the ends of a record.
    start, end : array (samples, outputs)
        Of the first and the last samples of a record, which are told less; empty for static loads.
    """

    inside: Array
    start: Array
    end: Array

    @classmethod
    def none(cls, outputs: int) -> Self:
        """Ones."""
        return cls(np.ones(outputs), np.zeros((0, outputs)), np.zeros((0, outputs)))

    def of(self, samples: int) -> Array:
        """For a record of so many samples (samples, outputs)."""
        whole = np.tile(self.inside, (samples, 1))
        first, last = (min(len(part), samples) for part in (self.start, self.end))
        whole[:first] = self.start[:first]
        if last:
            whole[-last:] = np.maximum(whole[-last:], self.end[-last:])
        return whole


def calibrated(
    errors: Array, std: Array, groups: NDArray[np.int_], coverage: float, reach: int | None
) -> Factors:  # fmt: skip
    """Factors by the errors of draws kept apart.

    Parameters
    ----------
    errors, std : array (draws, [samples,] outputs)
        Errors, and the std that the engine states for them.
    groups : array of int (outputs,)
        Outputs of one quantity and direction, which share a factor where there are too few draws for each.
    coverage : float
        Of the band of `coverage` of a normal distribution of that std.
    reach : int or None
        Samples around one that its load depends on; None of static readings.
    """
    # no factor widens the std of an output that no example loads, 0: W616 names it
    ratio = np.divide(np.abs(errors), std, out=np.zeros(np.shape(errors)), where=std > 0)
    outputs = ratio.shape[-1]
    if reach is None:
        return Factors(_factor(ratio, groups, coverage, len(ratio) >= EACH), np.zeros((0, outputs)),
                       np.zeros((0, outputs)))  # fmt: skip
    samples = ratio.shape[1]
    first, last = min(2 * reach, samples // 3), min(reach, samples // 3)
    inside = _factor(ratio[:, first : samples - last].reshape(-1, outputs), groups, coverage, len(ratio) >= EACH)
    at = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples) if i < first]
    late = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples - last, samples)]
    empty = np.zeros((0, outputs))
    return Factors(inside, np.stack(at) if at else empty, np.stack(late) if late else empty)


def _near(ratio: Array, at: int, outputs: int) -> Array:
    """Ratios of a sample and its two neighbours."""
    return ratio[:, max(at - 1, 0) : at + 2].reshape(-1, outputs)


def _factor(ratio: Array, groups: NDArray[np.int_], coverage: float, each: bool) -> Array:
    """Factors (outputs,) of ratios (numbers, outputs): one for each output, or for each group."""
    wide = NormalDist().inv_cdf(0.5 + coverage / 2)
    if each:
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
