"""The std of a map, made to hold what it says by split conformal prediction on examples that were kept apart.

J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, Distribution-free predictive inference for regression,
J. Am. Stat. Assoc. 113 (2018) 1094: errors over their stated std are exchangeable between draws, so that their quantile
on the examples kept apart covers as often on those to come. Where large loads err by more than small ones, the std is
first made to say so (their section 5.2): by a share of the load itself, which other examples tell.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from structures.errors import InputError

Array = NDArray[np.float64]

FEWEST = 20  # draws that calibrate
EACH = 1000  # draws from which every output has a factor of its own
TELLS = 200  # numbers from which it is told how errors go with the load
ROUNDS = 12  # of weighted least squares
LEAST = 1e-3  # of the variance that an engine states: so much is kept


@dataclass(frozen=True, eq=False)
class Factors:
    """What to multiply the std of an engine with.

    Parameters
    ----------
    inside : array (outputs,)
        Of static loads, and of samples far from the ends of a record.
    start, end : array (samples, outputs)
        Of the first and the last samples of a record, which are told less; empty for static loads.
    share : array (outputs,)
        Of a load, which is added to the std that the engine states, by squares and before it is multiplied.
    """

    inside: Array
    start: Array
    end: Array
    share: Array

    @classmethod
    def none(cls, outputs: int, share: Array | None = None) -> Self:
        """Ones."""
        empty = np.zeros((0, outputs))
        return cls(np.ones(outputs), empty, empty, np.zeros(outputs) if share is None else share)

    def applied(self, mean: Array, std: Array) -> Array:
        """Std of what an engine answers, (n, [samples,] outputs): of means of that shape and of its own std."""
        return self.multiplied(self.grown(mean, std))

    def multiplied(self, std: Array) -> Array:
        """Std (n, [samples,] outputs) that has grown, by its factors."""
        return np.asarray(std * (self.inside if std.ndim == 2 else self._of(std.shape[1])))

    def grown(self, mean: Array, std: Array) -> Array:
        """As `applied`, before it is multiplied; what the engine is certain of stays so."""
        return np.where(std > 0, np.hypot(std, self.share * mean), 0.0)

    def _of(self, samples: int) -> Array:
        """For a record of so many samples (samples, outputs)."""
        whole = np.tile(self.inside, (samples, 1))
        first, last = (min(len(part), samples) for part in (self.start, self.end))
        whole[:first] = self.start[:first]
        if last:
            whole[-last:] = np.maximum(whole[-last:], self.end[-last:])
        return whole


def grown(errors: Array, std: Array, mean: Array, groups: NDArray[np.int_]) -> Array:
    """Share (outputs,) of a load that its error grows by: squared errors have the mean ``a std^2 + b mean^2``.

    Fitted by least squares whose weights follow the fit, as for numbers that scatter as much as they are large (P.
    McCullagh & J. Nelder, Generalized Linear Models, 1989, chapter 8); the share is the root of b / a.

    Parameters
    ----------
    errors, std, mean : array (draws, [samples,] outputs)
        Of draws that calibrate nothing else.
    groups : array of int (outputs,)
        Outputs that share it.
    """
    out = np.zeros(len(groups))
    for group in np.unique(groups):
        members = groups == group
        off, own, load = (x[..., members].ravel() ** 2 for x in (errors, std, mean))
        seen = own > 0
        if np.count_nonzero(seen) >= TELLS and np.any(load[seen]):
            out[members] = _share(off[seen], own[seen], load[seen])
    return out


def _share(off: Array, own: Array, load: Array) -> float:
    """Of squares of errors, of their std and of the load (n,)."""
    size = np.array([np.mean(own), np.mean(load)])
    columns = np.stack([own, load], axis=1) / size
    expected, x = np.full(len(off), np.mean(off)), np.array([1.0, 0.0])
    if not expected.any():
        return 0.0
    for _ in range(ROUNDS):
        x, _ = nnls(columns / expected[:, None], off / expected)
        x[0] = max(x[0], LEAST * size[0])
        expected = columns @ x
    return float(np.sqrt(x[1] / size[1] / (x[0] / size[0])))


def calibrated(
    errors: Array, std: Array, groups: NDArray[np.int_], coverage: float, reach: int | None, share: Array
) -> Factors:  # fmt: skip
    """Factors by the errors of draws kept apart.

    Parameters
    ----------
    errors, std : array (draws, [samples,] outputs)
        Errors, and the std that is stated for them.
    groups : array of int (outputs,)
        Outputs of one quantity and direction, which share a factor where there are too few draws for each.
    coverage : float
        Of the band of `coverage` of a normal distribution of that std.
    reach : int or None
        Samples around one that its load depends on; None of static readings.
    share : array (outputs,)
        As `Factors`; the std has it already.
    """
    # no factor widens the std of an output that no example loads, 0: W616 names it
    ratio = np.divide(np.abs(errors), std, out=np.zeros(np.shape(errors)), where=std > 0)
    outputs = ratio.shape[-1]
    empty = np.zeros((0, outputs))
    if reach is None:
        return Factors(_factor(ratio, groups, coverage, len(ratio) >= EACH), empty, empty, share)
    samples = ratio.shape[1]
    first, last = min(2 * reach, samples // 3), min(reach, samples // 3)
    inside = _factor(ratio[:, first : samples - last].reshape(-1, outputs), groups, coverage, len(ratio) >= EACH)
    at = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples) if i < first]
    late = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples - last, samples)]
    return Factors(inside, np.stack(at) if at else empty, np.stack(late) if late else empty, share)


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
