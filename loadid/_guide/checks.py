"""The forward model asked again: certificates of records with a known load, and what has drifted since the first."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from structures._certificate import Certificate
from structures._flags import Flag
from structures.errors import InputError, digests

from .. import _guards as guards
from ..validate._checks import GAIN
from .context import GuidedJob

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from structures._model import Model

    from .._record import Record

SAMPLES = 8  # from which equal columns are the same record, and no coincidence


def certified(job: GuidedJob, record: Record) -> Certificate:
    """Certificate of the model of a job against a record that holds a known load.

    Static readings through `Model.static`, histories through `Model.verify`, and behind a table of FRFs the lines of
    segments of the record.

    Raises
    ------
    InputError
        No known load; a record that the model was made from; what does not fit the model.
    """
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
    return (
        f"worst sensor {certificate.sensors[k]}: gain {certificate.gain[k]:.4g}, residual {certificate.error[k]:.2%}"
    )


def drift(before: Certificate, now: Certificate) -> tuple[dict[str, dict[str, float]], list[str]]:
    """Gain of every sensor now over its gain when the model was verified, and the sensors beyond `GAIN`.

    Raises
    ------
    InputError
        The two certificates know different sensors.
    """
    if set(before.sensors) != set(now.sensors):
        raise InputError("the sensors are not those of the certificate of step 2", where="drift",
                         found=", ".join(now.sensors), expected=", ".join(before.sensors),
                         hint="sign step 2 again for the model of these sensors")  # fmt: skip
    first = dict(zip(before.sensors, before.gain, strict=True))
    table = {
        sensor: {**row, "gain_over_step_2": row["gain"] / first[sensor] if first[sensor] else float("inf")}
        for sensor, row in rows(now).items()
    }
    return table, [s for s, row in table.items() if not GAIN[0] <= row["gain_over_step_2"] <= GAIN[1]]


def watched(job: GuidedJob, record: Record) -> list[Flag]:
    """What a record without a known load tells: channels that are not sound, sensors that contradict the others."""
    from .._commands.check import contradictions

    responses = job.responses(record)
    found = list(responses.health())
    if not job.static and job.model.gives("impulse_response"):
        found += contradictions(job.model, responses, job.model.impulse_response(responses.dt, len(responses)))
    return list(guards.collect(found))
