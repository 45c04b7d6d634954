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
from structures.hits import digests
from structures.model import Model

from . import flags as guards
from .estimate import LoadEstimate
from .quality import require_finite
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
    histories = _histories(loads)
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
        g = histories[i % len(histories)]
        y = (truth or family.model).predict(g, dt)
        estimate = family.estimate(y + np.asarray(noise) * rng.standard_normal(y.shape), dt)
        hit = np.abs(estimate.load - g[: len(estimate.load)]) <= z * estimate.std
        inside, total = inside + int(hit.sum()), total + hit.size
        if progress is not None:
            progress((i + 1) / draws, "coverage")
    return Coverage(inside / total, level, draws, datetime.now(UTC).isoformat(timespec="seconds"))


def _histories(loads: ArrayLike | Sequence[ArrayLike]) -> list[NDArray[np.float64]]:
    several = isinstance(loads, list | tuple) and any(np.ndim(g) > 0 for g in loads)
    arrays = [np.asarray(g, float) for g in loads] if several else [np.asarray(loads, float)]  # type: ignore[union-attr]
    for g in arrays:
        if g.ndim not in (1, 2) or not g.size:
            raise InputError(
                "no load history", where="coverage", found=f"shape {g.shape}", expected="(samples,) or (samples, loads)"
            )
    return [g.reshape(len(g), -1) for g in arrays]


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
        W704 where a channel was used in the inversion, or the record in making the model.
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
        Channels, samples or units that do not fit, another step, or an estimate without a time axis.
    """
    if estimate.axis is None or estimate.axis.name != "time":
        raise InputError(
            "only load histories can be validated on held-out channels",
            where="held_out",
            found="no time axis",
            expected="an estimate over time",
        )
    if abs(estimate.axis.step / record.dt - 1) > 1e-6:
        raise InputError(
            "the record and the estimate have different steps",
            where="held_out",
            found=f"dt = {record.dt:.9g} s",
            expected=f"dt = {estimate.axis.step:.9g} s",
        )
    labels = [s.label for s in model.sensors]
    kept = record.select(labels)
    require_finite(kept)
    _check_units(model, kept)
    whole = np.asarray(kept.values)
    measured = whole[: len(estimate.load)]
    predicted = model.predict(_ordered(estimate, model), record.dt)[: len(measured)]
    measured = measured[: len(predicted)]
    size = np.linalg.norm(measured, axis=0)
    if np.any(size == 0):
        raise InputError("a validation channel is zero", where="held_out", found=labels, expected="measured responses")
    error = np.linalg.norm(measured - predicted, axis=0) / size
    flag = guards.used_for_training("a validation channel", set(labels) & set(estimate.sensors))
    flag = flag or guards.used_for_training("the validation record", set(digests(whole)) & _seen(estimate, model))
    return HeldOut(predicted, measured, tuple(float(e) for e in error), tuple(labels), guards.collect([flag]))


def _seen(estimate: LoadEstimate, model: Model) -> set[str]:
    """Digests of the responses that were inverted, and of those that the validation model was made from."""
    inverted = () if estimate.response is None else digests(estimate.response)
    return {*inverted, *getattr(model, "training", ())}


def _ordered(estimate: LoadEstimate, model: Model) -> NDArray[np.float64]:
    """Loads of the estimate in the order of the model, where both name the same ones."""
    have, want = list(estimate.labels), [c.label for c in model.loads]
    return estimate.load[:, [have.index(w) for w in want]] if sorted(have) == sorted(want) else estimate.load


def _check_units(model: Model, record: Record) -> None:
    for row, channel in zip(model.sensors, record.channels, strict=True):
        if "arbitrary" not in (row.unit, channel.unit) and row.unit != channel.unit:
            raise InputError(
                "the unit of a channel does not fit the sensor of the model",
                where=f"channel {channel.label}",
                found=channel.unit,
                expected=row.unit,
            )
