"""What a record and its model say about a load history beside the answer: layout, gaps, drift, memory, the start."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, NotIdentifiable
from structures.flags import Flag
from structures.model import Model

from .. import flags as guards
from ..inverse import penalties
from ..inverse.apart import apart
from ..inverse.start import start
from ..inverse.whitening import Noise, whitener
from .data import Data

HEAD = 400  # samples of the impulse response that hold the free motions


def layout(
    model: Model, data: Data, h: NDArray, penalty: str | ArrayLike | None, bound: bool = False
) -> tuple[Flag, ...]:
    """Guards that need no answer: AC coupling, gaps, drift, memory, aliasing.

    Parameters
    ----------
    h : array, shape (taps, used sensors, loads)
        Impulse responses.
    penalty : str, array or None
        As the family takes it.
    bound : bool
        The penalty holds constants too: a leaky difference, or a weight of the size.
    """
    rows = [model.sensors[i] for i in data.rows]
    lost = np.mean(data.missing, axis=0)
    return guards.collect(
        [
            guards.high_pass(rows, data.duration, data.channels),
            guards.gaps(lost.tolist(), [c.label for c in data.channels]),
            None if bound else _drift(model, data, h, penalty),
            guards.memory(model.decay_rate, data.duration, h, model.natural_frequencies),
            guards.aliased(model.natural_frequencies, data.dt),
        ]
    )


def determined(model: Model, m: int, n: int, rank: int | None, h: NDArray) -> Flag | None:
    """W201: the loads that the sensors cannot tell apart at any frequency, and rank loss where the rank is known."""
    ratio, combination = apart(h)
    lacking = None if rank is None else guards.null_space(m, n, rank)
    named = guards.not_apart(ratio, combination.tolist(), [c.label for c in model.loads], h.shape[1])
    if lacking is None or named is None:
        return lacking or named
    return replace(lacking, message=f"{lacking.message}; {named.message}", advice=named.advice)


def beginning(
    h: NDArray,
    values: NDArray,
    noise: Noise,
    lam: float,
    penalty: str | ArrayLike | None,
    sigma: float,
    missing: NDArray | None = None,
) -> Flag | None:
    """W518: the record starts in motion, and the model at rest.

    Parameters
    ----------
    h : array, shape (taps, used sensors, loads)
    values : array, shape (samples, used sensors)
    noise : array or Cholesky
        Level, covariance or scale that the problem was whitened with.
    lam : float
        Absolute lambda.
    sigma : float
        Noise level of the whitened data.
    missing : array of bool, shape (samples, used sensors), optional
        Samples that are not there; given with a covariance, a sample that is missing in part is left out whole.
    """
    if not isinstance(penalty, str) or not lam > 0:
        return None
    white = whitener(noise, h.shape[1])
    h, values = white.apply(h[:HEAD], 1), white.apply(values, 1)
    if missing is not None and (white.lower is not None or missing.shape != values.shape):
        missing = np.repeat(np.any(missing, axis=1)[:, None], values.shape[1], axis=1)
    return guards.in_motion(start(h, values, lam, penalty, sigma, missing))


def _drift(model: Model, data: Data, h: NDArray, penalty: str | ArrayLike | None) -> Flag | None:
    """W517: what the static gain of the used sensors says about the constants that a difference leaves free."""
    if not isinstance(penalty, str) or penalties.order(penalty) == 0:
        return None
    try:
        static = np.abs(model.static()[data.rows])
    except (InputError, NotIdentifiable):  # no static response, or one without end: nothing to say
        return None
    share = np.max(static / np.maximum(np.sum(np.abs(h), axis=0), np.finfo(float).tiny), axis=0)
    return guards.drifting(share, [c.label for c in model.loads], [c.label for c in data.channels], penalty)
