"""Offsets of sensors: what no constant load makes is an unknown of the instrument, found with the load and taken off.

The constant of a channel that is blind at 0 Hz has no prior: ``y = H g + C b + e``. With K the covariance of load and
noise in the data, generalised least squares give ``b = (C' K^-1 C)^-1 C' K^-1 y`` and its covariance, by one more solve
for each channel at the lambda in use. Where these constants are beyond chance the problem is posed again with them as
unknowns, so that the rules do not see them as misfit and the band holds what is not known of them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures._advice import Advice, Option
from structures._flags import Evidence, Flag
from structures._model import Model
from structures.errors import InputError, NotIdentifiable

from .._inverse.choice import Choice
from .._inverse.nuisances import Free, free
from .._quality import OFFSET, quiet_part
from .data import Data
from .noise import noise_level
from .posing import Posed

Array = NDArray[np.float64]

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
            flags.append(_taken(data, i, offset))
        elif at_rest and _matters(data, i, offset) and "LID-E213" not in allow:
            raise NotIdentifiable(
                f"channel {channel.label} stands {offset.value:.4g} {channel.unit} off zero before the response "
                f"({offset.shown_by}): an offset of the sensor, or a load from before the record",
                advice=Advice(
                    "subtract it from the channel where the structure was unloaded; where it carried a load, "
                    "take the start as unknown (",
                    Option("initial", "unknown"),
                    ", state-space models)",
                ),
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


def _taken(data: Data, i: int, offset: Offset) -> Flag:
    return Flag("W206", offset.evidence, f"channel {data.channels[i].label}: an offset of {offset.value:.4g}"
                f"{_unit(data, i)} ({offset.shown_by}) was subtracted: no constant load makes it", ADVICE)  # fmt: skip


CHANCE = 6.3e-5  # of constants as large as these where there are none: four standard deviations of one
SURE = 3.0  # standard deviations
SMALLER = (0.1, 0.01)  # of the smaller lambda: there the load may make more of a constant, and alarms are fewer
RESTLESS = 10.0  # mean square of slow lines over what is expected, beyond which a fit tells nothing of constants
BESIDE = 8  # slow lines that a constant has to stand out of
LEAST = 1e-9  # of the largest reading, below which a constant is rounding
ROUNDS = 3  # in which constants are taken off and the rest is fitted
NEAR, SAME = 3.0, 0.1  # standard deviations of a constant that may stay: as an unknown, and where it is none
ADVICE = "look at the amplifier; nothing to do where the channel is known to have an offset"


@dataclass(frozen=True, eq=False)
class Constants:
    """Constants that were found with the load, in the units of their channels.

    Parameters
    ----------
    channels : array of int, shape (k,)
        Of those that are used.
    value : array, shape (k,)
    std : array, shape (k,)
    unknown : bool
        They are unknowns of the problem: the band of the load holds what is not known of them.
    """

    channels: NDArray[np.int_]
    value: Array
    std: Array
    unknown: bool

    def words(self, data: Data) -> tuple[str, ...]:
        """Each with its std and unit."""
        return tuple(f"{data.channels[i].label}: {v:.4g} +- {s:.2g}{_unit(data, i)}"
                     for i, v, s in zip(self.channels, self.value, self.std, strict=True))  # fmt: skip

    def flags(self, data: Data) -> tuple[Flag, ...]:
        """W206 of each channel whose constant stands out; one of all where none does."""
        beside = "" if self.unknown else "; the std of the load does not hold what is not known of it"
        ratio, each = np.abs(self.value) / self.std, self.words(data)
        if not np.any(ratio > SURE):
            found = Evidence("largest offset over its std", float(ratio.max()), SURE)
            return (Flag("W206", found, f"channels have offsets that are not told from each other and from the load: "
                         f"{'; '.join(each)}{beside}", ADVICE),)  # fmt: skip
        return tuple(
            Flag("W206", Evidence("offset over its std", float(r), SURE), f"channel {data.channels[i].label}: an "
                 f"offset of {said[len(data.channels[i].label) + 2 :]} was estimated with "
                 f"the load and subtracted: no constant load makes it{beside}", ADVICE)
            for i, r, said in zip(self.channels, ratio, each, strict=True) if r > SURE
        )  # fmt: skip


@dataclass(frozen=True)
class Settled:
    """A record less its offsets, the problem that has what is left of them as unknowns, and its lambda.

    Parameters
    ----------
    data : Data
    posed : Posed
    choice : Choice
    offsets : Constants or None
        None where there are none beyond chance.
    """

    data: Data
    posed: Posed
    choice: Choice
    offsets: Constants | None = None


def settled(
    model: Model, data: Data, posed: Callable[[Data], Posed], chosen: Callable[[Posed], Choice],
    moving: Callable[[Settled], bool],
) -> Settled:  # fmt: skip
    """Fit a record; where constants of blind channels are beyond chance, fit them with the load.

    Parameters
    ----------
    data : Data
        Constants that are known of taken off.
    posed, chosen : callable
        The problem of data, and the lambda of a problem.
    moving : callable
        Whether a fit says that the record starts in motion, which is no offset.
    """
    problem = posed(data)
    first = Settled(data, problem, chosen(problem))
    blind = blind_to_constants(model, data)
    if blind is None or not blind.any():
        return first
    new = np.setdiff1d(np.flatnonzero(blind), data.floating)
    found = _beyond_chance(first, new)
    if found is None:
        return _centred(first, posed, chosen) if len(data.floating) else first
    data = less(data, new, found.mean)
    problem = posed(data)
    after = _centred(Settled(data, problem, chosen(problem)), posed, chosen)
    stays = after.offsets is None or bool(np.any(np.abs(after.offsets.value) > SURE * after.offsets.std))
    return first if not stays or moving(after) else after


def _beyond_chance(fit: Settled, channels: NDArray[np.int_]) -> Free | None:
    """Constants of channels that are beyond chance at a lambda in use, or at smaller ones: an offset makes it large."""
    evidence = [r.lam for r in fit.choice.rules if r.rule == "evidence" and r.lam is not None]
    values = fit.data.values[:, channels]
    largest = np.abs(values).max(axis=0)
    if np.any(np.ptp(values, axis=0) == 0):  # what is nothing else has no constant
        return None
    lams = [fit.choice.lam, *evidence]
    lams += [
        max(min(lams) * share, fit.posed.path.range[0]) for share in SMALLER if min(lams) > fit.posed.path.range[0]
    ]
    for lam in dict.fromkeys(lams):
        found = told(fit.posed, lam, fit.data, channels)
        if found is None or found.chance() > CHANCE or np.all(np.abs(found.mean) <= LEAST * largest):
            continue
        unrest = _unrest(fit, lam, channels, found)
        alone = float(np.max(np.abs(found.mean) / found.std)) / np.sqrt(found.noise2 * max(unrest, 1.0))
        if unrest <= RESTLESS and found.chance(unrest) <= CHANCE and alone > SURE:
            return found
    return None


def _unrest(fit: Settled, lam: float, channels: NDArray[np.int_], found: Free) -> float:
    """Mean square of the slowest lines of channels without their constants, over what the fit expects of them.

    Loads that are slower than the prior has them, and noise that grows towards 0 Hz, make constants too, but never
    alone.
    """
    posed, samples = fit.posed, len(fit.posed.values)
    lines = np.cos(np.pi * np.arange(1, BESIDE + 1)[:, None] * (np.arange(samples) + 0.5) / samples)
    constants = _responses(posed, lam, fit.data, channels, np.ones((1, samples)))
    slow = _responses(posed, lam, fit.data, channels, lines)
    if constants is None or slow is None:
        return 1.0
    rest = posed.path.residual(lam).ravel() - found.mean @ constants[1]
    shared = slow[0] @ constants[1].T
    expected = np.sum(slow[0] * slow[1], axis=1) - np.sum((shared @ found.covariance) * shared, axis=1)
    size2 = np.sum(slow[0] ** 2, axis=1)
    ratio = (slow[0] @ rest) ** 2 / np.maximum(expected, LEAST * size2) / found.noise2
    return float(np.mean(ratio))


def _centred(fit: Settled, posed: Callable[[Data], Posed], chosen: Callable[[Posed], Choice]) -> Settled:
    """The fit of data whose constants are those that it finds, with what is known of these.

    They are found by the same problem without the unknowns. Where they are unknowns, what is not taken off does not
    matter to the load, but to what is read off the data as they are: scales, windows, where the load acts.
    """
    channels, data = fit.data.floating, fit.data
    for last in range(ROUNDS):
        bare = posed(replace(data, offsets=())) if fit.posed.floats else fit.posed
        lam = fit.choice.lam * fit.choice.scale / float(bare.path.scale)
        found = told(bare, max(lam, bare.path.range[0]) if lam else lam, data, channels)
        if found is None:
            return fit
        left, std = found.mean, noise_level(fit.posed.path, fit.choice, fit.posed.noise) * found.std
        if last == ROUNDS - 1 or np.all(np.abs(left) <= (NEAR if fit.posed.floats else SAME) * std):
            break
        data = less(data, channels, left)
        problem = posed(data)
        fit = Settled(data, problem, chosen(problem))
    if fit.posed.floats:
        data = less(data, channels, left)
    offsets = Constants(channels, np.array(data.offsets)[channels], std, fit.posed.floats)
    data = replace(data, flags=offsets.flags(data))
    return Settled(data, replace(fit.posed, values=data.values[-len(fit.posed.values) :]), fit.choice, offsets)


def told(posed: Posed, lam: float, data: Data, channels: NDArray[np.int_]) -> Free | None:
    """What a fit at a relative lambda tells of the constants of channels; None where it tells nothing.

    Parameters
    ----------
    channels : array of int
        Whose constants are no unknowns of this fit.
    """
    made = _responses(posed, lam, data, channels, np.ones((1, len(posed.values))))
    if made is None:
        return None
    point = posed.path.at(lam)
    objective = point.residual2 if point.objective is None else point.objective
    least = 1.0 if posed.noise.known else 0.0
    return free(*made, posed.path.residual(lam).ravel(), float(objective), posed.path.m, least)


def _responses(
    posed: Posed, lam: float, data: Data, channels: NDArray[np.int_], lines: Array
) -> tuple[Array, Array] | None:
    """Histories (k, samples) in each channel as data of the path, and what is left of these: (lines * channels, m)."""
    if posed.white is None or not len(channels):
        return None
    missing, columns, left = data.missing[-len(posed.values) :], [], []
    for line in lines:
        for i in channels:
            raw = np.zeros_like(posed.values)
            raw[:, i] = np.where(missing[:, i], 0.0, line)
            columns.append(posed.white(raw))
            rest = posed.path.left_of(columns[-1], lam)
            if rest is None:
                return None
            left.append(rest)
    return np.array(columns).reshape(len(columns), -1), np.array(left).reshape(len(left), -1)


def less(data: Data, channels: NDArray[np.int_], value: Array) -> Data:
    """The data less further constants of channels."""
    taken = np.zeros(data.values.shape[1])
    taken[channels] = value
    before = np.array(data.offsets) if data.offsets else np.zeros(len(taken))
    values = np.where(data.missing, 0.0, data.values - taken)
    return replace(data, values=values, offsets=tuple((before + taken).tolist()))


def _unit(data: Data, i: int) -> str:
    unit = data.channels[i].unit
    return "" if unit == "arbitrary" else f" {unit}"
