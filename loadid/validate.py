"""What was validated, and at which level: coverage of the stated bands, and channels that were kept out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import NormalDist
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.model import Model

from . import flags as guards
from .estimate import LoadEstimate
from .record import Record


@dataclass(frozen=True)
class Coverage:
    """Share of the true load samples inside the stated band.

    Parameters
    ----------
    share : float
        Over all draws, samples and loads.
    level : float
        Stated level of the band.
    draws : int
    date : str
    """

    share: float
    level: float
    draws: int
    date: str

    def __str__(self) -> str:
        return f"the {self.level:.0%} band held {self.share:.1%} of the true samples in {self.draws} simulated records"


def coverage(
    family: Any,
    loads: ArrayLike | Sequence[ArrayLike],
    dt: float,
    *,
    noise: ArrayLike,
    truth: Model | None = None,
    draws: int = 50,
    level: float = 0.95,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Coverage:
    """Simulate records of known loads with fresh noise, rebuild them, and count the samples inside the band.

    Parameters
    ----------
    family : Deconvolution or another family
        Set up as it will be used.
    loads : array, shape (samples, loads), or a sequence of them
        Loads like the ones to be expected; draws go through them in turn.
    dt : float
        Step in s.
    noise : float or array, shape (sensors,)
        Noise std to add.
    truth : Model, optional
        Model that makes the data; default the family's own, which is optimistic (an inverse crime).
    draws, level, seed
        Number of records, level of the band, seed of the noise.

    Returns
    -------
    Coverage
        Pass it as ``coverage=`` to the family.
    """
    histories = [np.asarray(g, float) for g in (loads if isinstance(loads, list | tuple) else [loads])]
    if draws < 1 or not histories or not 0 < level < 1:
        raise InputError(
            "nothing to draw",
            where="coverage",
            found=f"{draws} draws, {len(histories)} loads, level {level}",
            expected="at least one draw of one load, and a level in (0, 1)",
        )
    rng, z = np.random.default_rng(seed), NormalDist().inv_cdf(0.5 + level / 2)
    inside = total = 0
    for i in range(draws):
        g = histories[i % len(histories)].reshape(len(histories[i % len(histories)]), -1)
        y = (truth or family.model).predict(g, dt)
        estimate = family.estimate(y + np.asarray(noise) * rng.standard_normal(y.shape), dt)
        hit = np.abs(estimate.load - g[: len(estimate.load)]) <= z * estimate.std
        inside, total = inside + int(hit.sum()), total + hit.size
        if progress is not None:
            progress((i + 1) / draws, "coverage")
    return Coverage(inside / total, level, draws, datetime.now(UTC).isoformat(timespec="seconds"))


@dataclass(frozen=True)
class HeldOut:
    """Prediction of channels from an estimated load.

    Parameters
    ----------
    predicted, measured : array, shape (samples, sensors)
    error : tuple of float
        Per channel, norm of the difference over norm of the measured.
    labels : tuple of str
    flags : tuple of Flag
        W704 where a channel was used in the inversion.
    """

    predicted: NDArray[np.float64]
    measured: NDArray[np.float64]
    error: tuple[float, ...]
    labels: tuple[str, ...]
    flags: tuple[Flag, ...]


def held_out(estimate: LoadEstimate, model: Model, record: Record) -> HeldOut:
    """Predict the channels of `model` from an estimated load and compare them with what was measured there.

    Parameters
    ----------
    estimate : LoadEstimate
        Load histories with a time axis.
    model : Model
        Forward model from the same loads to the validation channels.
    record : Record
        Holds those channels.

    Raises
    ------
    InputError
        Channels that are missing, or an estimate without a time axis.
    """
    if estimate.axis is None or estimate.axis.name != "time":
        raise InputError(
            "only load histories can be validated on held-out channels",
            where="held_out",
            found="no time axis",
            expected="an estimate over time",
        )
    labels = [s.label for s in model.sensors]
    measured = np.asarray(record.select(labels).values)[: len(estimate.load)]
    predicted = model.predict(estimate.load, record.dt)[: len(measured)]
    size = np.linalg.norm(measured, axis=0)
    if np.any(size == 0):
        raise InputError("a validation channel is zero", where="held_out", found=labels, expected="measured responses")
    shared = set(labels) & set(estimate.sensors)
    flag = guards.used_for_training("a validation channel", shared)
    error = np.linalg.norm(measured - predicted, axis=0) / size
    return HeldOut(predicted, measured, tuple(float(e) for e in error), tuple(labels), guards.collect([flag]))
