"""Constant offsets of channels: taken out where no load makes them, refused where one would be read into them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable
from structures.flags import Evidence, Flag
from structures.model import Model

from ..quality import OFFSET, quiet_part
from .data import Data

HEAD = 512  # samples of the impulse response beside which a static gain is nothing
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
    h = np.abs(model.impulse_response(data.dt, min(HEAD, len(data.values)))[:, data.rows])
    return np.asarray(np.all(static <= NOTHING * np.sum(h, axis=0), axis=1))


def _offset(data: Data, model: Model, i: int) -> Offset | None:
    """The offset of a used channel, where it is beyond chance."""
    column = data.record.labels.index(data.channels[i].label)
    part = quiet_part(data.record, column)
    return _of_velocity(data, model, i) if part is None else _of_quiet(part)


def _of_quiet(part: NDArray) -> Offset | None:
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
