"""The std of a map, made to hold what it says by split conformal prediction on examples that were kept apart.

J. Lei, M. G'Sell, A. Rinaldo, R. J. Tibshirani, L. Wasserman, Distribution-free predictive inference for regression,
J. Am. Stat. Assoc. 113 (2018) 1094: errors over their stated std are exchangeable between draws, so that their quantile
on the examples kept apart covers as often on those to come. Where large loads err by more than small ones, the std is
first made to say so (their section 5.2): by a share of the load itself, which other examples tell.

Most nodes of a surface carry nothing, and there a map errs as little as it answers. So static loads have a quantile for
each class of size beside the largest of their kind in the same reading (Mondrian conformal prediction: V. Vovk, A.
Gammerman & G. Shafer, Algorithmic Learning in a Random World, 2005, section 4.5), for those that act at least what
these need: they are covered as often. What no reading tells, as the modulus of a gel, moves the loads of all nodes
together. Nobody knows it of a new reading, so that loads that act have the largest of the factors that the draws need
on either side of its median (equalized coverage: Y. Romano, R. F. Barber, C. Sabatti & E. J. Candes, Harvard Data Sci.
Rev. 2.2, 2020): the band holds on either side, and on both together more often than it says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from structures.errors import InputError

Array = NDArray[np.float64]

FEWEST = 20  # draws that calibrate
EACH = 1000  # draws from which every output of histories has a factor of its own
SIZES = np.array([0.003, 0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9])  # between classes
CLASS = 400  # numbers that a class has at least
ACTS = 0.05  # of the largest load: smaller ones do not tell how errors grow
HALF = 100  # draws on either side of a median at least
TELLS = 200  # numbers from which it is told how errors go with the load
ROUNDS = 12  # of weighted least squares
LEAST = 1e-3  # of the variance that an engine states: so much is kept


@dataclass(frozen=True, eq=False)
class Factors:
    """What to multiply the std of an engine with.

    Parameters
    ----------
    inside : array (classes, outputs)
        Of static loads by their size, in the classes between `SIZES`; of samples far from the ends of a record, in one.
    start, end : array (samples, outputs)
        Of the first and the last samples of a record, which are told less; empty for static loads.
    share : array (outputs,)
        Of a load, which is added to the std that the engine states, by squares and before it is multiplied.
    groups : array of int (outputs,)
        Outputs of one kind, beside whose largest a load is large or small.
    """

    inside: Array
    start: Array
    end: Array
    share: Array
    groups: NDArray[np.int_]

    @classmethod
    def none(cls, groups: NDArray[np.int_], share: Array | None = None) -> Self:
        """Ones."""
        empty = np.zeros((0, len(groups)))
        return cls(np.ones((1, len(groups))), empty, empty, np.zeros(len(groups)) if share is None else share, groups)

    def applied(self, mean: Array, std: Array) -> Array:
        """Std of what an engine answers, (n, [samples,] outputs): of means of that shape and of its own std."""
        return self.multiplied(mean, self.grown(mean, std))

    def multiplied(self, mean: Array, std: Array) -> Array:
        """Std (n, [samples,] outputs) that has grown, by its factors."""
        if std.ndim == 3:
            return np.asarray(std * self._of(std.shape[1]))
        if len(self.inside) == 1:
            return np.asarray(std * self.inside)
        return np.asarray(std * np.take_along_axis(self.inside, classes(mean, self.groups), axis=0))

    def grown(self, mean: Array, std: Array) -> Array:
        """As `applied`, before it is multiplied; what the engine is certain of stays so."""
        return np.where(std > 0, np.hypot(std, self.share * mean), 0.0)

    def _of(self, samples: int) -> Array:
        """For a record of so many samples (samples, outputs)."""
        whole = np.tile(self.inside[0], (samples, 1))
        first, last = (min(len(part), samples) for part in (self.start, self.end))
        whole[:first] = self.start[:first]
        if last:
            whole[-last:] = np.maximum(whole[-last:], self.end[-last:])
        return whole


def classes(mean: Array, groups: NDArray[np.int_]) -> NDArray[np.int_]:
    """Class (n, outputs) of each static load of a map, by its size beside the largest of its group in that reading."""
    return np.asarray(np.digitize(_beside(mean, groups), SIZES))


def _beside(mean: Array, groups: NDArray[np.int_]) -> Array:
    """Sizes (n, outputs) of static loads over the largest of their group."""
    size = np.abs(mean)
    largest = np.stack([size[:, groups == g].max(axis=1) for g in range(int(groups.max()) + 1)], axis=1)[:, groups]
    return np.divide(size, largest, out=np.zeros_like(size), where=largest > 0)


def grown(errors: Array, std: Array, mean: Array, groups: NDArray[np.int_], coverage: float) -> Array:
    """Share (outputs,) of a load that its error grows by: squared errors have the mean ``a std^2 + b mean^2``.

    Fitted by least squares whose weights follow the fit, as for numbers that scatter as much as they are large (P.
    McCullagh & J. Nelder, Generalized Linear Models, 1989, chapter 8); the share is the root of b / a. Static loads
    have it where their band is the sharper for it.

    Parameters
    ----------
    errors, std, mean : array (draws, [samples,] outputs)
        Of draws that calibrate nothing else.
    groups : array of int (outputs,)
        Outputs that share it.
    coverage : float
        Of the band.
    """
    out = np.zeros(len(groups))
    acts = np.ones(mean.shape, bool) if mean.ndim == 3 else _beside(mean, groups) >= ACTS
    for group in np.unique(groups):
        members = groups == group
        seen = (std > 0) & acts & members
        off, own, load = (x[seen] ** 2 for x in (errors, std, mean))
        if len(off) >= TELLS and np.any(load):
            share = _share(off, own, load)
            if mean.ndim == 3 or _better(share, errors[:, members], std[:, members], mean[:, members], coverage):
                out[members] = share
    return out


def _better(share: float, errors: Array, std: Array, mean: Array, coverage: float) -> bool:
    """Whether the band of static loads of one group that grows by a share has the better interval score.

    T. Gneiting & A. Raftery, J. Am. Stat. Assoc. 102 (2007) 359, section 6.2; each reading over its largest load.
    """
    groups, largest = np.zeros(mean.shape[1], int), np.maximum(np.abs(mean).max(axis=1, keepdims=True), 1e-300)
    acts = (std > 0) & (np.abs(mean) >= ACTS * largest)
    scores = []
    for part in (0.0, share):
        one = Factors.none(groups, np.full(len(groups), part))
        whole = one.grown(mean, std)
        wide = calibrated(errors, mean, whole, groups, coverage, None, one.share).multiplied(mean, whole) * _wide(
            coverage
        )
        missed = np.maximum(np.abs(errors) - wide, 0.0)
        scores.append(np.mean(((2 * wide + 2 / (1 - coverage) * missed) / largest)[acts]))
    return bool(scores[1] < scores[0])


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
    errors: Array, mean: Array, std: Array, groups: NDArray[np.int_], coverage: float, reach: int | None, share: Array,
    halves: Sequence[NDArray[np.bool_]] = (),
) -> Factors:  # fmt: skip
    """Factors by the errors of draws kept apart.

    Parameters
    ----------
    errors, mean, std : array (draws, [samples,] outputs)
        Errors of what a map answers, and the std that is stated for them.
    groups : array of int (outputs,)
        Outputs of one quantity and direction, which share factors; of histories where there are too few draws for each.
    coverage : float
        Of the band of `coverage` of a normal distribution of that std.
    reach : int or None
        Samples around one that its load depends on; None of static readings.
    share : array (outputs,)
        As `Factors`; the std has it already.
    halves : sequence of array of bool (draws,)
        As `halved` makes them: in each of them static loads that act are covered.
    """
    # no factor widens the std of an output that no example loads, 0: W616 names it
    ratio = np.divide(np.abs(errors), std, out=np.zeros(np.shape(errors)), where=std > 0)
    outputs = ratio.shape[-1]
    empty = np.zeros((0, outputs))
    if reach is None:
        inside = np.ones((len(SIZES) + 1, outputs))
        kind, acting = classes(mean, groups), _beside(mean - errors, groups) >= ACTS
        large = np.arange(len(inside)) > np.digitize(ACTS, SIZES)
        for group in np.unique(groups):
            seen = (std > 0) & (groups == group)
            whole = _by_class(ratio[seen], kind[seen], coverage)
            needed = [_by_class(ratio[part], kind[part], coverage) for part in (
                seen & acting, *(some & one[:, None] for one in halves for some in (seen, seen & acting)))]  # fmt: skip
            inside[:, groups == group] = np.where(large, np.max([whole, *needed], axis=0), whole)[:, None]
        return Factors(inside, empty, empty, share, groups)
    samples = ratio.shape[1]
    first, last = min(2 * reach, samples // 3), min(reach, samples // 3)
    inside = _factor(ratio[:, first : samples - last].reshape(-1, outputs), groups, coverage, len(ratio) >= EACH)
    at = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples) if i < first]
    late = [_factor(_near(ratio, i, outputs), groups, coverage, each=False) for i in range(samples - last, samples)]
    return Factors(inside[None], np.stack(at) if at else empty, np.stack(late) if late else empty, share, groups)


def halved(unseen: Sequence[Array]) -> list[NDArray[np.bool_]]:
    """Draws (n,) on either side of the median of each of some parameters (n,), of those that leave enough on both."""
    sides = [(values > np.median(values), values <= np.median(values)) for values in unseen]
    return [side for both in sides if min(int(side.sum()) for side in both) >= HALF for side in both]


def _by_class(ratio: Array, kind: NDArray[np.int_], coverage: float) -> Array:
    """Factors (classes,) of ratios (n,), each of its class; small classes are joined with the next larger ones."""
    out, first = np.ones(len(SIZES) + 1), 0
    counts = np.bincount(kind, minlength=len(out))
    while first < len(out):
        last = first + 1
        while last < len(out) and (counts[first:last].sum() < CLASS or counts[last:].sum() < CLASS):
            last += 1
        own = ratio[(kind >= first) & (kind < last)]
        out[first:last] = quantile(own, coverage) / _wide(coverage) if len(own) else 1.0
        first = last
    return out


def _near(ratio: Array, at: int, outputs: int) -> Array:
    """Ratios of a sample and its two neighbours."""
    return ratio[:, max(at - 1, 0) : at + 2].reshape(-1, outputs)


def _factor(ratio: Array, groups: NDArray[np.int_], coverage: float, each: bool) -> Array:
    """Factors (outputs,) of ratios (numbers, outputs): one for each output, or for each group."""
    if each:
        return np.array([quantile(column, coverage) for column in ratio.T]) / _wide(coverage)
    shared = {int(g): quantile(ratio[:, groups == g].ravel(), coverage) for g in np.unique(groups)}
    return np.array([shared[int(g)] for g in groups]) / _wide(coverage)


def _wide(coverage: float) -> float:
    """Half width of the band of a normal distribution of unit std."""
    return NormalDist().inv_cdf(0.5 + coverage / 2)


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
