"""A long record in pieces that overlap: each is solved alone, and what lies inside is that of the whole record.

Tikhonov over a state space is a filter that runs backward and one that runs forward, and both forget at the rate of the
closed loop ``F - G K``, K being the gain that settles (`loadid._inverse.gaussian.gains`). A piece that begins and ends
so many samples early and late that this rate has brought whatever stood there below `FORGOTTEN` has inside the load of
the whole record at the same lambda, noise and offsets, which are therefore settled once for a record.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._model import Model
from structures.errors import InputError

from .._families.data import Data, gather
from .._families.noise import resolve
from .._families.offsets import without_offsets
from .._families.posing import Posed, PosingSettings, pose
from .._families.posing.paths import MOST
from .._inverse.gaussian.gains import gains
from .._record import Record
from .._results.estimate import LoadEstimate
from ..settings import Lambda, Noise, Penalty

Array = NDArray[np.float64]

FORGOTTEN = 1e-11  # of what stood at the end of a piece
NEVER = 1 << 40  # samples of overlap: more than any record has, which therefore stays whole


@dataclass(frozen=True)
class SettledLoads:
    """What all pieces of a record share.

    Parameters
    ----------
    lam : float
        Absolute lambda of the problem whitened by `noise`.
    noise : tuple of float
        Level of each sensor, by which its data are whitened.
    sigma : float
        Noise of the whitened data, which makes the std.
    offsets : tuple of float
        What is subtracted from each sensor.
    overlap : int
        Samples with data by which a piece begins earlier and ends later than what is taken from it.
    """

    lam: float
    noise: tuple[float, ...]
    sigma: float
    offsets: tuple[float, ...]
    overlap: int


def divisible(model: Model, job: Mapping[str, Any], dt: float) -> bool:
    """Whether records of this job may be cut: Tikhonov with a named penalty over some dozens of states, any sign."""
    plain = job.get("family") == "deconvolution" and job.get("method") in (None, "tikhonov")
    plain = plain and job.get("variance") in (None, "constant") and job.get("path") in (None, "auto", "statespace")
    plain = plain and job.get("penalty") != "none" and not job.get("nonnegative") and job.get("choice") != 0
    if not plain or model.sampled or model.moving or not model.gives("state_space"):
        return False
    return len(model.state_space(dt, model.default_hold).A) <= MOST


def settle(record: Record, model: Model, job: Mapping[str, Any], piece: int) -> tuple[SettledLoads, LoadEstimate]:
    """Lambda, noise and offsets of a long record, and the estimate of the piece that tells them: its loudest.

    Raises
    ------
    InputError, NotIdentifiable
        From the family.
    """
    from .._commands.identify import identify

    data = gather(record, None, model, None, allow_missing=True)
    rest = job.get("initial") in (None, "rest")
    taken = without_offsets(data, model, at_rest=rest, allow=tuple(job.get("allow") or ())).offsets
    offsets = tuple(taken) or (0.0,) * len(data.rows)
    first, last = loudest(data.values - np.array(offsets), piece)
    window = replace(record, values=record.values[first:last] - np.array(offsets))
    asked = {**job, "path": "statespace"}
    if job.get("penalty") in (None, "identity") and not job.get("leak"):
        asked["variance"] = "constant"  # other penalties know no other
    if first:
        asked["initial"] = "unknown"
    estimate = identify(window, model, **asked)
    choice = estimate.choice
    assert choice is not None
    level = _level(model, window)
    sigma = estimate.facts.noise_level
    found = SettledLoads(choice.lam * choice.scale, level, 1.0 if sigma is None else float(sigma), offsets, 0)
    return replace(found, overlap=overlap(posed(window, model, job, found, "rest"), found.lam)), estimate


def loudest(values: Array, piece: int) -> tuple[int, int]:
    """Ends of the piece (of a record cut from its beginning) in which the sensors moved most, each by its own rms."""
    values = np.nan_to_num(values)
    size = np.maximum(np.sqrt(np.mean(values**2, axis=0)), 1e-300)
    starts = range(0, max(len(values) - piece, 0) + 1, piece)
    energy = [float(np.sum((values[a : a + piece] / size) ** 2)) for a in starts]
    first = int(np.argmax(energy)) * piece
    return first, min(first + piece, len(values))


def overlap(problem: Posed, lam: float) -> int:
    """Samples after which a piece has forgotten how it began; `NEVER` where its closed loop forgets nothing."""
    record = problem.record
    assert record is not None
    kind = int(np.argmax(np.abs(record.C).sum(axis=(1, 2))))
    settled = gains(replace(record, kind=np.full(len(record.kind), kind, np.int32), y=np.zeros_like(record.y)), lam)
    closed = record.F[kind] - record.G[kind] @ settled.K[settled.which[0]]
    radius = float(np.max(np.abs(np.linalg.eigvals(closed)), initial=0.0))
    if not radius < 1:
        return NEVER
    return 1 if radius == 0 else min(math.ceil(math.log(FORGOTTEN) / math.log(radius)), NEVER)


def posed(record: Record, model: Model, job: Mapping[str, Any], found: SettledLoads, initial: Any) -> Posed:
    """The problem of a piece, offsets taken off."""
    missing = np.isnan(record.values)  # a channel may be missing throughout a piece
    values = np.where(missing, 0.0, record.values)
    data = Data(values, record.dt, np.arange(values.shape[1]), record.channels, record, missing)
    settings = PosingSettings(
        Noise(np.array(found.noise)), Lambda(None, path="statespace"),
        Penalty(job.get("penalty") or "identity", leak=job.get("leak"), variance="constant"),
        tuple(job.get("allow") or ()), None, initial, False,
    )  # fmt: skip
    return pose(model, data, settings)


def around(values: Array, first: int, last: int, overlap: int) -> tuple[int, int]:
    """Ends of a piece with its overlaps, which are counted in samples that have all their data."""
    begin, end, left = first, last, overlap
    while begin > 0 and left > 0:
        low = max(begin - left, 0)
        left -= int(np.sum(~np.isnan(values[low:begin]).any(axis=1)))
        begin = low
    left = overlap
    while end < len(values) and left > 0:
        high = min(end + left, len(values))
        left -= int(np.sum(~np.isnan(values[end:high]).any(axis=1)))
        end = high
    return begin, end


def solved(
    values: Array, dt: float, model: Model, job: Mapping[str, Any], found: SettledLoads, first: int, last: int
) -> tuple[Array, Array, Array]:
    """Load, std (samples, loads) and residual (samples, sensors) of the samples from `first` to `last` of a record.

    Parameters
    ----------
    values : array, shape (samples, sensors)
        The whole record, of which the piece and its overlaps are read.
    """
    begin, end = around(values, first, last, found.overlap)
    record = Record(values[begin:end] - np.array(found.offsets), dt, tuple(model.sensors))
    problem = posed(record, model, job, found, (job.get("initial") or "rest") if begin == 0 else "rest")
    lam = found.lam / float(problem.path.scale)
    solution = problem.path.solution(lam, found.sigma)
    assert solution.posterior is not None
    std = np.asarray(solution.posterior.std, float).reshape(solution.load.shape)
    part = slice(first - begin, min(last - begin, len(std)))  # loads whose response comes late end before the record
    return solution.load[part], std[part], problem.compare(solution.load, lam, None)[1][part]


def _level(model: Model, record: Record) -> tuple[float, ...]:
    """Noise level of each sensor, as the family takes it."""
    data = gather(record, None, model, None, allow_missing=True)
    level = np.asarray(resolve(Noise(None), model, data).level, float)
    if level.ndim != 1:
        raise InputError("noise that is correlated between sensors", where="piece", found=f"covariance {level.shape}",
                         expected="a std for each sensor", hint="a larger piece takes records whole")  # fmt: skip
    return tuple(level.tolist())
