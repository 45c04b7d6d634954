"""The forward model asked again: certificates of records with a known load, and what has drifted since the first."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from structures._certificate import Certificate
from structures._flags import Flag
from structures.errors import InputError, digests

from .. import _guards as guards
from ..validate._checks import GAIN, SDS
from .context import SAMPLES, GuidedJob

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._model import Model

    from .._record import Record


def certified(job: GuidedJob, record: Record) -> Certificate:
    """Certificate of the model of a job against a record that holds a known load.

    Static readings through `Model.static`, histories through `Model.verify`, and behind a table of FRFs the lines of
    segments of the record.

    Raises
    ------
    InputError
        No known load; a record that the model was made from; what does not fit the model.
    """
    if (own := job.certified(record)) is not None:
        return own
    model, load = job.model, job.loads(record)
    responses = job.responses(record)
    if load is None:
        raise InputError(
            "the record holds no known load", where=record.name or record.source,
            found=f"channels {', '.join(record.labels)}",
            expected=f"a channel for the load{'s' * (len(model.loads) > 1)} "
            f"{', '.join(c.label for c in model.loads[:8])}",
            hint="name the channel of the load with --truth CH",
        )  # fmt: skip
    if len(responses) >= SAMPLES and model.training & set(digests(responses.values)):
        raise InputError(
            "the model was made from this very record: that it fits proves nothing", where=record.name or record.source,
            found="the same samples", expected="a record that was not used to make the model",
            hint="keep one test out of the calibration, and verify with that one",
        )  # fmt: skip
    source = record.name or record.source
    if job.static:
        predicted = load @ np.asarray(model.static(), float).T
        return _compared(model, predicted, responses, source)
    if model.gives("impulse_response"):
        return model.verify(load, responses.values, responses.dt, source=source)
    return _on_lines(model, load, responses, source)


def _compared(model: Model, predicted: NDArray[np.float64], responses: Record, source: str) -> Certificate:
    noise = model.noise
    std = noise if noise is None or noise.ndim == 1 else np.sqrt(np.diagonal(noise))
    if np.isnan(responses.values).any():
        raise InputError("readings are missing", where=source, found=f"{int(np.isnan(responses.values).sum())} of them",
                         expected="complete readings", hint="leave these rows out")  # fmt: skip
    labels = [s.label for s in model.sensors]
    return Certificate.compare(predicted, responses.values, labels, noise=std, source=source)


def _on_lines(model: Model, load: NDArray[np.float64], responses: Record, source: str) -> Certificate:
    """Through the FRFs on their lines: Hann segments as long as the lines lie apart, real and imaginary parts."""
    f = np.asarray(model.frequencies, float)
    apart = float(np.min(np.diff(f))) if len(f) > 1 else float(f[0])
    samples = min(max(round(1 / (apart * responses.dt)), 2) * 2, len(responses))
    starts = np.arange(0, len(responses) - samples + 1, max(samples // 2, 1))
    turn = np.exp(-2j * np.pi * np.outer(np.arange(samples) * responses.dt, f))
    kernel = np.hanning(samples + 2)[1:-1, None] * turn

    def lines(values: NDArray[np.float64]) -> NDArray[np.complex128]:
        cut = np.stack([values[k : k + samples] for k in starts])
        return np.einsum("ksc,sl->klc", cut - cut.mean(axis=1, keepdims=True), kernel)

    if np.isnan(responses.values).any():
        raise InputError("samples are missing", where=source, found=f"{int(np.isnan(responses.values).sum())} of them",
                         expected="a complete record", hint="take a part of it without gaps")  # fmt: skip
    predicted = np.einsum("lsp,klp->kls", model.frf(f), lines(load)).reshape(-1, len(model.sensors))
    measured = lines(responses.values).reshape(-1, len(model.sensors))
    labels = [s.label for s in model.sensors]
    return Certificate.compare(
        np.vstack([predicted.real, predicted.imag]), np.vstack([measured.real, measured.imag]), labels,
        source=f"{source}, on {len(f)} lines",
    )  # fmt: skip


# -- as figures --------------------------------------------------------------------------------------------------------
def rows(certificate: Certificate) -> dict[str, dict[str, float]]:
    """Gain, shape, residual and its ratio to the noise of every sensor."""
    ratios = certificate.noise_ratio or (None,) * len(certificate.sensors)
    return {
        sensor: {"gain": gain, "shape": shape, "residual": error, **({} if ratio is None else {"times_noise": ratio})}
        for sensor, gain, shape, error, ratio in zip(
            certificate.sensors, certificate.gain, certificate.shape, certificate.error, ratios, strict=True
        )
    }


def of_rows(sensors: Mapping[str, Mapping[str, float]], source: str, date: str) -> Certificate:
    """The certificate that `rows` was made of."""
    told = [one.get("times_noise") for one in sensors.values()]
    ratios = tuple(float(one) for one in told if one is not None)
    gain, shape, error = (tuple(float(one[key]) for one in sensors.values()) for key in ("gain", "shape", "residual"))
    return Certificate(gain, shape, error, ratios if len(ratios) == len(told) else None, tuple(sensors), source, date)


def worst(certificate: Certificate) -> str:
    """The sensor that is predicted least well, in words."""
    k = int(np.argmax(certificate.error))
    return f"worst sensor {certificate.sensors[k]}: gain {certificate.gain[k]:.4g}, residual {certificate.error[k]:.2%}"


@dataclass(frozen=True)
class GainDrift:
    """Gains of a certificate over those of an earlier one.

    Parameters
    ----------
    table : mapping of str to mapping
        Of every sensor the figures of `rows`, ``gain_over_step_2`` and, where the noise is known, its ``std``.
    moved : tuple of str
        Sensors whose gain has left `GAIN` by more than the noise.
    most : str
        The sensor that moved most, beyond its noise.
    """

    table: dict[str, dict[str, float]]
    moved: tuple[str, ...]
    most: str

    @property
    def said(self) -> str:
        """The sensor that moved most, in words."""
        row = self.table[self.most]
        noise = f" ± {row['std']:.2%}" if "std" in row else ""
        return f"{row['gain_over_step_2'] - 1:+.2%}{noise} ({self.most})"


def drift(before: Certificate, samples: int, now: Certificate, samples_now: int) -> GainDrift:
    """How far the gains of the sensors have moved, and whether the noise of the two records explains it.

    Raises
    ------
    InputError
        The two certificates know different sensors.
    """
    if set(before.sensors) != set(now.sensors):
        raise InputError("the sensors are not those of the certificate of step 2", where="drift",
                         found=", ".join(now.sensors), expected=", ".join(before.sensors),
                         hint="sign step 2 again for the model of these sensors")  # fmt: skip
    first, then, later = (dict(zip(one.sensors, values, strict=True)) for one, values in (
        (before, before.gain), (before, _noise(before, samples)), (now, _noise(now, samples_now))
    ))  # fmt: skip
    table, moved, beyond = rows(now), [], dict[str, float]()
    for sensor, row in table.items():
        row["gain_over_step_2"] = ratio = row["gain"] / first[sensor] if first[sensor] else float("inf")
        std = float(np.hypot(then[sensor], later[sensor]))
        if std > 0:
            row["std"] = std
        beyond[sensor] = abs(ratio - 1) - SDS * std
        if not GAIN[0] <= ratio <= GAIN[1] and beyond[sensor] > 0:
            moved.append(sensor)
    return GainDrift(table, tuple(moved), max(beyond, key=lambda sensor: beyond[sensor]))


def _noise(one: Certificate, samples: int) -> tuple[float, ...]:
    """Relative std of the gain of every sensor by the noise of its record; 0 where it is not known."""
    if one.noise_ratio is None:
        return (0.0,) * len(one.sensors)
    pairs = zip(one.error, one.noise_ratio, strict=True)
    return tuple(error / ratio / np.sqrt(samples) if ratio > 0 else 0.0 for error, ratio in pairs)


def watched(job: GuidedJob, record: Record) -> list[Flag]:
    """What a record without a known load tells: channels that are not sound, sensors that contradict the others."""
    from .._commands.check import contradictions

    if not job.over_time:
        return []
    responses = job.responses(record)
    found = list(responses.health())
    if not job.static and job.model.gives("impulse_response"):
        found += contradictions(job.model, responses, job.model.impulse_response(responses.dt, len(responses)))
    return list(guards.collect(found))
