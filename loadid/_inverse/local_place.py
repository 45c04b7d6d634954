"""Places of hits by evidence: at the right place the load is a hit, which rests before it and after it.

The residual of a load that may be anything at any time hardly tells places near a support from others: its history
explains the noise too, and a penalty prefers the place that needs the smallest load. Under the local prior of
`local_prior` the history is no more than a hit, and the likelihood of the data tells the place. Its variances and the
place are improved by turns (evidence: D. MacKay, Neural Comput. 4 (1992) 415). The band is that of the place as one
more parameter beside the errors of the model, linearised about the fit (`nuisances`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from .ascent import highest
from .gaussian.local_variance import smoothed
from .gaussian.record import WhitenedRecord
from .local_prior import Fit, LocalPrior, errors_told, local_prior, with_memory, with_misfit
from .nuisances import STEP, Nuisances

Array = NDArray[np.float64]
RecordAt = Callable[[Array], WhitenedRecord]
TURNS, UPDATES = 4, 4  # of variances and place at most; of the variances at a place that is tried
LIKELIEST = 4  # starts, by the variances of the first, whose own are learned
SETTLED = 3e-3  # of a spacing, below which a turn is the last
UNTOLD = 1e-3  # share of the variance of a place, below which the data tell nothing
ANYWHERE = 10.0  # spacings: std of a place before the data


@dataclass(frozen=True, eq=False)
class EvidentPlace:
    """Places with the largest evidence.

    Parameters
    ----------
    place : array, shape (loads, dim)
    edge : bool
        A place came to rest on the bounds.
    prior : LocalPrior
        With the misfit of the model.
    """

    place: Array
    edge: bool
    prior: LocalPrior

    def covariance(self, record: RecordAt, errors: Nuisances | None, box: Array, spacing: float) -> Array:
        """Second moments of the places about those found (loads, dim, dim), errors of the model counted.

        Parameters
        ----------
        record : callable
        errors : Nuisances or None
            Errors of the model at the places found.
        box : array, shape (dim, 2)
        spacing : float
        """
        size, std = self.place.size, ANYWHERE * spacing
        sense = np.where(self.place + STEP * std <= box[:, 1], 1.0, -1.0)  # of a step that stays in the box

        def moved(at: Array) -> WhitenedRecord:
            if errors is not None and not at[:size].any():
                return errors.record(at[size:])
            return record(self.place + sense * at[:size].reshape(self.place.shape))

        none: tuple[tuple[str, ...], list[Array]] = ((), [])
        names, known = none if errors is None else (errors.names, [errors.covariance])
        every = Nuisances((*("place",) * size, *names), block_diag(std**2 * np.eye(size), *known), moved)
        told = errors_told(self.prior, every)
        turned = sense.ravel()
        inside, step = turned[:, None] * told.covariance[:size, :size] * turned, turned * told.step[:size]
        seen = np.diag(inside) < (1 - UNTOLD) * std**2
        full = np.where(seen[:, None] & seen, inside + np.outer(step, step), 0.0)
        full[~seen, ~seen] = np.inf
        loads, dim = self.place.shape
        blocks = full.reshape(loads, dim, loads, dim)
        return np.array([blocks[k, :, k] for k in range(loads)])


def evident_place(
    starts: Sequence[Array], record: RecordAt, box: Array, spacing: float, *, stated: bool, early: bool = False
) -> EvidentPlace | None:
    """Find the places whose evidence is the largest; None where the record does not ask for a load that rests.

    Parameters
    ----------
    starts : sequence of array, shape (loads, dim)
        The best so far first.
    record : callable
        Places (loads, dim) -> the record over the states of a model with its loads there.
    box : array, shape (dim, 2)
        Bounds.
    spacing : float
        Of the candidates.
    stated : bool
        The noise is stated.
    early : bool
        The record ends soon after the onset: the load may go on, and what the model leaves need not be white.
    """
    prior = local_prior(record(starts[0]), stated=stated)
    if not (prior.rests if early else prior.asked_for):
        return None

    memory = prior.memory

    def heard(at: Array) -> WhitenedRecord:
        return with_memory(record(at), memory)

    def learned(old: Fit, at: Array) -> Fit:
        fit = old.on(heard(at))
        fit.climb(UPDATES, missing=fit.misfit2 > 0)
        return fit

    given = prior.fit.variances()
    told = [smoothed(heard(at), given).evidence for at in starts]
    likeliest = sorted(range(len(starts)), key=lambda i: -told[i])[:LIKELIEST]
    tried = [(learned(prior.fit, starts[i]), starts[i]) for i in likeliest]
    fit, place = max(tried, key=lambda one: one[0].evidence)
    for _ in range(TURNS):
        before, place = place, _moved(fit, heard, place, box, spacing)
        fit = learned(fit, place)
        if np.abs(place - before).max() < SETTLED * spacing:
            break
    prior = with_misfit(replace(prior, fit=fit, record=fit.record))
    place = _moved(prior.fit, heard, place, box, spacing)
    fit = learned(prior.fit, place)
    prior = replace(prior, fit=fit, record=fit.record, given=fit.variances(), noise=fit.r)
    return EvidentPlace(place, bool(np.any((place <= box[:, 0]) | (place >= box[:, 1]))), prior)


def _moved(fit: Fit, record: RecordAt, place: Array, box: Array, spacing: float) -> Array:
    """The place of the largest evidence under variances that stay."""
    given = fit.variances()

    def evidence(at: Array) -> float:
        return smoothed(record(at.reshape(place.shape)), given).evidence

    return highest(evidence, place.ravel(), np.tile(box, (len(place), 1)), spacing)[1].reshape(place.shape)
