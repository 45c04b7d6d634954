"""Load histories: layout, offsets, gaps, drift, memory and start of their record; histories that only push."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._flags import Evidence, Flag
from structures._model import Model
from structures.errors import InputError, NotIdentifiable

from .. import _guards as guards
from .._inverse import penalties
from .._inverse.choice import Choice
from .._inverse.constrained.nonnegative import CONVERGED, NonNegativeSolution, discrepancy
from .._inverse.diagnosis.identifiability import apart, start
from .._inverse.problem import Noise, whitener
from .._inverse.sweep import RuleResult
from .._quality import OFFSET, quiet_part
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


OFFSET_HEAD = 512  # samples of the impulse response beside which a static gain is nothing
NOTHING = 1e-6  # such a gain, over the sum of the response
BLOCKS, CERTAIN = 8, 8.0  # blocks of the quiet part; their mean over its standard error beyond chance (t, 7 dof: 1e-4)
LARGE = 0.05  # offset over the rms of a channel from which a load that is read into it matters
PERIODS = 5.0  # of the lowest mode in a record whose velocity comes and goes
DRIFT = 5.0  # change of velocity by an offset over the range of the velocity without it, beyond what vibration makes


@dataclass(frozen=True)
class Offset:
    """Offset of one channel with its significance and the place that shows it."""

    value: float
    evidence: Evidence
    shown_by: str


def without_offsets(data: Data, model: Model, *, at_rest: bool, allow: tuple[str, ...]) -> Data:
    """The data less the offsets of channels that no constant load moves, with W206 for each.

    A channel that a constant load moves (strain, displacement) may carry an offset or a load from before the record:
    where its quiet part stands off zero, and the structure is said to start at rest, no load can be told.

    Parameters
    ----------
    at_rest : bool
        The structure is said to be at rest at the first sample.
    allow : tuple of str
        ``LID-E213`` takes such an offset for a load.

    Raises
    ------
    NotIdentifiable
        LID-E213: an offset that cannot be told from a constant load.
    """
    found = [_offset(data, model, i) for i in range(len(data.channels))]
    if not any(found):
        return data
    blind = blind_to_constants(model, data)
    if blind is None:
        return data
    taken, flags = np.zeros(len(found)), []
    for i, (offset, channel) in enumerate(zip(found, data.channels, strict=True)):
        if offset is None:
            continue
        if blind[i]:
            taken[i] = offset.value
            flags.append(_taken(channel.label, channel.unit, offset))
        elif at_rest and _matters(data, i, offset) and "LID-E213" not in allow:
            raise NotIdentifiable(
                f"channel {channel.label} stands {offset.value:.4g} {channel.unit} off zero before the response "
                f"({offset.shown_by}): an offset of the sensor, or a load from before the record",
                advice="subtract it from the channel where the structure was unloaded; where it carried a load, take "
                'the start as unknown (initial="unknown", state-space models)',
                code="LID-E213",
            )
    values = np.where(data.missing, 0.0, data.values - taken)
    return replace(data, values=values, offsets=tuple(taken.tolist()), flags=(*data.flags, *flags))


def blind_to_constants(model: Model, data: Data) -> NDArray[np.bool_] | None:
    """Which used channels no constant load moves in the end; None where the model does not tell."""
    try:
        static = np.abs(model.static()[data.rows])
    except NotIdentifiable:  # a structure that moves away for ever
        return np.zeros(len(data.rows), bool)
    except InputError:
        return None
    h = np.abs(model.impulse_response(data.dt, min(OFFSET_HEAD, len(data.values)))[:, data.rows])
    return np.asarray(np.all(static <= NOTHING * np.sum(h, axis=0), axis=1))


def _offset(data: Data, model: Model, i: int) -> Offset | None:
    """The offset of a used channel, where it is beyond chance."""
    column = data.record.labels.index(data.channels[i].label)
    part = quiet_part(data.record, column)
    return _of_velocity(data, model, i) if part is None else _of_quiet(part)


def _of_quiet(part: Array) -> Offset | None:
    """Mean of the quiet part over its standard error, from the means of blocks: noise may be correlated."""
    means = np.array([block.mean() for block in np.array_split(part, BLOCKS)])
    value, error = float(part.mean()), float(means.std(ddof=1)) / np.sqrt(BLOCKS)
    if not abs(value) > max(CERTAIN * error, 1e-9 * float(np.abs(part).max())):
        return None
    ratio = min(abs(value) / error, 1e300) if error > 0 else 1e300
    return Offset(value, Evidence("offset over its standard error", ratio, CERTAIN), f"{len(part)} quiet samples")


def _of_velocity(data: Data, model: Model, i: int) -> Offset | None:
    """Mean of an acceleration that would carry the velocity away, further than vibration moves it.

    Under a Hann window, which leaves of a vibration of f the share 1 / (f T)^2 of what the plain mean leaves.
    """
    frequencies = model.natural_frequencies
    if data.channels[i].quantity != "acceleration" or data.missing[:, i].any() or frequencies is None:
        return None
    y, lowest = data.values[:, i], float(np.min(frequencies, initial=np.inf))
    if not lowest * data.duration >= PERIODS:
        return None
    value = float(np.average(y, weights=np.hanning(len(y))))
    ratio = abs(value) * data.duration / max(float(np.ptp(np.cumsum(y - value))) * data.dt, np.finfo(float).tiny)
    if ratio <= DRIFT:
        return None
    return Offset(value, Evidence("drift of the velocity over its range", ratio, DRIFT), "mean of the record")


def _matters(data: Data, i: int, offset: Offset) -> bool:
    rest = data.values[:, i] - offset.value
    part = quiet_part(data.record, data.record.labels.index(data.channels[i].label))
    noise = 0.0 if part is None else float(part.std(ddof=1))
    return abs(offset.value) > max(LARGE * float(np.sqrt(np.mean(rest**2))), OFFSET * noise)


def _taken(label: str, unit: str, offset: Offset) -> Flag:
    unit = "" if unit == "arbitrary" else f" {unit}"
    return Flag(
        "W206",
        offset.evidence,
        f"channel {label}: an offset of {offset.value:.4g}{unit} ({offset.shown_by}) was subtracted: no constant load "
        "makes it",
        "look at the amplifier; nothing to do where the channel is known to have an offset",
    )


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
