"""From a record to the numbers of a filter: what is tuned, on which stretch, and what is to be said of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.flags import Flag

from ...flags.tracking import spoilt, undetermined
from ..data import Data
from .named import Named
from .posed import Posing
from .tuning import tune

LONGEST = 60_000  # samples that a fit is tuned on
PATCHY = 2000  # of a record with gaps everywhere
SHORTEST, ENOUGH = 50, 500  # samples without a gap: that a fit takes, and that it prefers to all with gaps
FACTORS = (0.3, 1.0, 3.0, 10.0)  # on a noise that is to be found beside priors that are given


@dataclass(frozen=True, eq=False)
class Numbers:
    """What a search has found.

    Parameters
    ----------
    x : array
        Logarithms, as `Posing` takes them.
    scale : float
        Variance on all noises.
    words : mapping of str to float
        The numbers by name.
    flags : tuple of Flag
        Numbers that the record does not tell (W523), wrong samples (W524).
    """

    x: NDArray[np.float64]
    scale: float
    words: Mapping[str, float]
    flags: tuple[Flag, ...]


def numbers_of(
    posing: Posing, data: Data, size: float, known: bool, progress: Callable[[float], None] = lambda share: None
) -> Numbers:
    """The most likely numbers of all priors that are named, of scales of the model, of a noise that is not known.

    Parameters
    ----------
    posing : Posing
    data : Data
    size : float
        Std of a white load that moves the sensors as they move.
    known : bool
        The noise is stated.
    progress : callable

    Raises
    ------
    InputError
        The record is too short; no filter exists for any numbers.
    """
    if posing.shared is None and not posing.scales and known:
        return Numbers(np.zeros(0), 1.0, {}, ())
    Y = stretch(data)
    own = [g.starts(size, data.dt, len(data.values)) for g in posing.given if isinstance(g, Named)]
    starts = [np.concatenate(parts) for parts in zip(*own, strict=False)] or [np.zeros(0)]
    factors = np.log(FACTORS)[:, None] if posing.free_noise else np.zeros((1, 0))
    grid = [np.r_[s, np.zeros(len(posing.scales)), factor] for s in starts for factor in factors]
    free = not (known or posing.free_noise)
    found = tune(posing.build, grid, Y, free_scale=free, progress=progress)
    words = dict(zip(posing.names, np.exp(found.parameters).tolist(), strict=True))
    if free:
        words["noise scale"] = float(np.sqrt(found.scale))
    words["log-likelihood"] = found.loglik
    labels = [c.label for c in data.channels]
    said = (
        undetermined([posing.names[i] for i in found.bounded]),
        spoilt(found.wrong, labels) if found.wrong else None,
    )
    return Numbers(found.parameters, found.scale, words, tuple(flag for flag in said if flag is not None))


def stretch(data: Data) -> NDArray[np.float64]:
    """What a fit is tuned on: a complete stretch where there is a long one, else the record with its gaps (NaN).

    Raises
    ------
    InputError
        Too few samples.
    """
    if np.any(data.missing.all(axis=0)) or not (tail := ~data.missing.all(axis=1)).any():
        return complete(data)  # refuses, and says why
    runs = np.diff(np.flatnonzero(np.r_[True, data.missing.any(axis=1), True])) - 1
    if runs.max(initial=0) >= min(ENOUGH, len(data.values) // 2):
        return complete(data)
    start, stop = np.flatnonzero(tail)[[0, -1]]
    Y = np.where(data.missing, np.nan, data.values)[start : min(stop + 1, start + PATCHY)]
    return np.ascontiguousarray(Y) if len(Y) >= SHORTEST else complete(data)


def complete(data: Data) -> NDArray[np.float64]:
    """The longest stretch of a record without gaps, at most `LONGEST` samples.

    Raises
    ------
    InputError
        There is none, or it is too short to tune on.
    """
    good = np.concatenate([[False], ~data.missing.any(axis=1), [False]])
    edges = np.flatnonzero(np.diff(good)).reshape(-1, 2)
    if not len(edges):
        raise InputError("no sample of the record is complete", where="fit", found="every sample lacks a channel",
                         expected="a stretch with all channels", hint="fit with fewer sensors (sensors=)")  # fmt: skip
    start, stop = edges[np.argmax(np.ptp(edges, axis=1))]
    stop = min(stop, start + LONGEST)
    if stop - start < SHORTEST:
        raise InputError("the record is too short to tune on", where="fit", found=f"{stop - start} complete samples",
                         expected=f"at least {SHORTEST}", hint="record longer, or state prior and noise")  # fmt: skip
    return np.ascontiguousarray(data.values[start:stop])
