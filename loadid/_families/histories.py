"""Load histories: layout, gaps, drift, memory and start of their record; histories that only push."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._flags import Flag
from structures._model import Model
from structures.errors import InputError, NotIdentifiable

from .. import _guards as guards
from .._inverse import penalties
from .._inverse.choice import Choice
from .._inverse.constrained.nonnegative import CONVERGED, NonNegativeSolution, discrepancy
from .._inverse.diagnosis.identifiability import apart, start
from .._inverse.problem import Noise, whitener
from .._inverse.sweep import RuleResult
from ..constraints import NonNegative
from .data import Data
from .posing import Posed
from .posing.posed import AUTO

Array = NDArray[Any]


def half_width(g: Array) -> float:
    """Width in samples of the largest pulse of a history at half its height."""
    size = np.abs(g)
    k = int(np.argmax(size))
    low = size < 0.5 * size[k]
    before, after = np.flatnonzero(low[:k]), np.flatnonzero(low[k:])
    left = k - (before[-1] if len(before) else -1)
    right = after[0] if len(after) else len(g) - k
    return float(left + right - 1)


def kurtosis(g: Array) -> float:
    """Fourth moment over the square of the second about zero; 3 for a Gaussian history, large for impacts."""
    power = float(np.mean(g**2))
    return float(np.mean(g**4)) / power**2 if power > 0 else 0.0


def lost_response(h: Array, missing: NDArray[np.bool_], std: Array, load: Array) -> float:
    """Share of the power of the response to a load that fell on samples which are missing.

    Parameters
    ----------
    h : array (samples, sensors, loads)
        Impulse response.
    missing : array of bool (samples, sensors)
    std : array (sensors,)
        Noise of the sensors, by which they count.
    load : array (samples, loads)
    """
    from scipy import fft

    n, size = len(load), fft.next_fast_len(2 * len(load), real=True)
    power = fft.rfft((h[:n] / std[:, None]) ** 2, size, axis=0).conj()
    of = [np.maximum(fft.irfft(np.einsum("fsl,fs->fl", power, fft.rfft(mask, size, axis=0)), size, axis=0)[:n], 0)
          for mask in (missing.astype(float), np.ones(missing.shape))]  # fmt: skip
    energy = load**2
    whole = float(np.sum(energy * of[1]))
    return min(float(np.sum(energy * of[0])) / whole, 1.0) if whole > 0 else 0.0


HEAD = 400  # samples of the impulse response that hold the free motions


def layout(
    model: Model, data: Data, h: Array, penalty: str | ArrayLike | None, bound: bool = False,
    periodic: bool = False,
) -> tuple[Flag, ...]:  # fmt: skip
    """Guards that need no answer: AC coupling, gaps, drift, memory, aliasing.

    Parameters
    ----------
    h : array, shape (taps, used sensors, loads)
        Impulse responses.
    penalty : str, array or None
        As the family takes it.
    bound : bool
        The penalty holds constants too: a leaky difference, or a weight of the size.
    periodic : bool
        The record is inverted by transforms that need its response to end.
    """
    rows = [model.sensors[i] for i in data.rows]
    lost = np.mean(data.missing, axis=0)
    return guards.collect(
        [
            guards.high_pass(rows, data.duration, data.channels),
            guards.gaps(lost.tolist(), [c.label for c in data.channels]),
            None if bound else _drift(model, data, h, penalty),
            guards.memory(model.decay_rate, data.duration, h, model.natural_frequencies, periodic=periodic),
            guards.aliased(model.natural_frequencies, data.dt),
        ]
    )


def determined(model: Model, m: int, n: int, rank: int | None, h: Array) -> Flag | None:
    """W201: the loads that the sensors cannot tell apart at any frequency, and rank loss where the rank is known."""
    ratio, combination = apart(h)
    lacking = None if rank is None else guards.null_space(m, n, rank)
    named = guards.not_apart(ratio, combination.tolist(), [c.label for c in model.loads], h.shape[1])
    if lacking is None or named is None:
        return lacking or named
    return replace(lacking, message=f"{lacking.message}; {named.message}", advice=named.advice, state=False)


def beginning(
    h: Array,
    values: Array,
    noise: Noise,
    lam: float,
    penalty: str | ArrayLike | None,
    sigma: float,
    missing: Array | None = None,
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


def _drift(model: Model, data: Data, h: Array, penalty: str | ArrayLike | None) -> Flag | None:
    """W517: what the static gain of the used sensors says about the constants that a difference leaves free."""
    if not isinstance(penalty, str) or penalties.order(penalty) == 0:
        return None
    try:
        static = np.abs(model.static()[data.rows])
    except (InputError, NotIdentifiable):  # no static response, or one without end: nothing to say
        return None
    share = np.max(static / np.maximum(np.sum(np.abs(h), axis=0), np.finfo(float).tiny), axis=0)
    return guards.drifting(share, [c.label for c in model.loads], [c.label for c in data.channels], penalty)


RULE = "discrepancy of loads that push"


def signs(constraints: Sequence[Any]) -> ArrayLike | bool | None:
    """Loads that only push: their numbers, None for all; False where nothing is asked.

    Raises
    ------
    InputError
        A constraint that is not `NonNegative`.
    """
    given: list[Any] = list(constraints) if isinstance(constraints, list | tuple) else [constraints]
    found = [c for c in given if isinstance(c, NonNegative)]
    if len(found) < len(given):
        raise InputError("load histories take signs only", where="constraints", found=repr(constraints)[:80],
                         expected="[NonNegative()] or [NonNegative(loads=[...])]")  # fmt: skip
    if not found:
        return False
    if any(c.loads is None for c in found):
        return None
    return np.unique(np.concatenate([np.atleast_1d(np.asarray(c.loads)) for c in found]))


def push(
    posed: Posed, choice: Choice, sigma: float, signed: ArrayLike | None, keep: bool,
    progress: Callable[[float, str], None],
) -> tuple[NonNegativeSolution, Choice]:  # fmt: skip
    """Load under signs, and the lambda that it took.

    Parameters
    ----------
    choice : Choice
        Of the path without signs.
    sigma : float
        Noise level of the whitened data.
    signed : array of int, optional
        Loads that only push; default all.
    keep : bool
        Take the lambda of `choice`, which the user asked for. Else the largest at which the load explains the data.

    Raises
    ------
    InputError
        A path that cannot take signs.
    """
    if posed.pushing is None:
        raise InputError("this path takes no signs", where="constraints", found=posed.name,
                         expected=Advice(AUTO, " and a named penalty"))  # fmt: skip
    record = posed.pushing(signed)
    if keep:
        return record.solve(choice.lam * choice.scale, progress=progress), choice
    found = discrepancy(record, choice.lam * choice.scale, sigma, progress=progress)
    lam = found.solution.lam / choice.scale
    note = "from the residual under signs" if found.met else "no lambda explains the data under signs: left as chosen"
    own = RuleResult(RULE, lam, note=note)
    if not found.met:
        return found.solution, replace(choice, rules=(*choice.rules, replace(own, lam=None)))
    return found.solution, replace(choice, lam=lam, rule=RULE, rules=(*choice.rules, own))


def facts(solution: NonNegativeSolution, m: int, known: bool) -> dict[str, Any]:
    """What is said of it; `m` data, whose noise is known or not."""
    return {
        "residual_to_noise": float(np.sqrt(solution.residual2 / m)) if known else None,
        "gap": solution.gap,
        "converged": solution.converged,
        "held": int(np.sum(solution.held)),
        "solver": solution.solver,
        "steps": solution.steps,
    }


def flags(solution: NonNegativeSolution, posed: Posed, choice: Choice, sigma: float) -> tuple[Flag, ...]:
    """W308 and W410 of a load under signs."""
    free = float(np.sum(posed.path.residual(choice.lam) ** 2))
    known = sigma if posed.noise.known else None
    return guards.collect(
        [
            guards.pulling(solution, free, sigma, posed.path.m),
            guards.stopped(solution, known, posed.path.m, CONVERGED),
        ]
    )


# -- windows of a load that miss it ------------------------------------------------------------------------------------
BETTER = 1.5  # residual with windows over that without, from which they miss the load
LARGE = 0.25  # of the largest load, that belongs to a pulse
CLOSE, MARGIN = 20, 5  # samples between two parts of a pulse, and to its sides
PULSES = 3  # that are named


def missed(load: Array, acting: Array, dt: float, windows: Sequence[tuple[float, float]], ratio: float) -> Flag | None:
    """W319: windows leave `ratio` times the residual of the load (samples, loads) that is sought at all times.

    Parameters
    ----------
    load : array, shape (samples, loads)
        Without windows.
    acting : array of bool, shape (samples,)
        Inside the windows.
    dt : float
        Step in s.
    windows : sequence of (float, float)
        In s.
    ratio : float
    """
    size = np.max(np.abs(load) / np.maximum(np.max(np.abs(load), axis=0), np.finfo(float).tiny), axis=1)
    large = np.flatnonzero(size > LARGE)
    if ratio < BETTER or not len(large):
        return None
    parts = np.split(large, np.flatnonzero(np.diff(large) > CLOSE) + 1)
    parts = sorted(parts, key=lambda part: -float(np.sum(size[part] ** 2)))[:PULSES]
    ends = sorted((max(int(p[0]) - MARGIN, 0) * dt, min(int(p[-1]) + MARGIN, len(load) - 1) * dt) for p in parts)
    outside = float(np.sum(size[~acting] ** 2) / np.sum(size**2))
    return guards.window_missed(ratio, BETTER, outside, windows, ends)
