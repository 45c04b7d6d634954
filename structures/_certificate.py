"""The certificate of a forward model: what it predicts held against what a known load made its sensors read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InputError, frozen

if TYPE_CHECKING:
    from ._model import Model

WRONG = 0.5  # residual over response of a check from which on a model does not predict a sensor
LOUD = 3.0  # times the noise below which a residual may be noise


@dataclass(frozen=True)
class Certificate:
    """Outcome of the check of a forward model against a known load.

    Parameters
    ----------
    gain : tuple of float
        Per sensor, the factor that scales the predicted onto the measured response (1 is right).
    shape : tuple of float
        Per sensor, correlation of predicted and measured response (1 is right).
    error : tuple of float
        Per sensor, norm of measured minus predicted over norm of measured.
    noise_ratio : tuple of float or None
        Per sensor, rms residual over the noise std; None where the noise is not known.
    sensors : tuple of str
        Labels.
    source : str
        What it was checked against.
    date : str
        ISO date and time, UTC.
    """

    gain: tuple[float, ...]
    shape: tuple[float, ...]
    error: tuple[float, ...]
    noise_ratio: tuple[float, ...] | None
    sensors: tuple[str, ...]
    source: str
    date: str

    def __str__(self) -> str:
        rows = [
            f"{name}: gain {g:.4g}, shape {s:.4f}, residual {e:.2%}"
            for name, g, s, e in zip(self.sensors, self.gain, self.shape, self.error, strict=True)
        ]
        verdict = "disagrees with" if self.wrong else "verified against"
        return f"forward model {verdict} {self.source} on {self.date[:10]} ({'; '.join(rows)})"

    @property
    def wrong(self) -> tuple[str, ...]:
        """Sensors that the model does not predict: a residual above half of the response, and above its noise."""
        noise = [np.inf] * len(self.sensors) if self.noise_ratio is None else self.noise_ratio
        found = zip(self.sensors, self.error, noise, strict=True)
        return tuple(name for name, error, ratio in found if error > WRONG and ratio > LOUD)

    @classmethod
    def compare(
        cls,
        predicted: NDArray[np.float64],
        measured: NDArray[np.float64],
        sensors: Sequence[str],
        *,
        noise: NDArray[np.float64] | None = None,
        source: str = "a known load",
    ) -> Self:
        """Certificate of predicted against measured responses, both (samples, sensors).

        Raises
        ------
        InputError
            If a response is zero: nothing can be compared.
        """
        pp, mm, pm = (
            np.sum(a * b, axis=0) for a, b in ((predicted, predicted), (measured, measured), (predicted, measured))
        )
        residual = measured - predicted
        if np.any(pp == 0) or np.any(mm == 0):
            raise InputError(
                "a response is zero: nothing can be compared",
                where="verify",
                found=[s for s, a, b in zip(sensors, pp, mm, strict=True) if a == 0 or b == 0],
                expected="a load that moves every sensor",
                hint="leave this sensor out, or choose another load",
            )
        ratio = None if noise is None else tuple((np.sqrt(np.mean(residual**2, axis=0)) / noise).tolist())
        return cls(
            gain=tuple((pm / pp).tolist()),
            shape=tuple((pm / np.sqrt(pp * mm)).tolist()),
            error=tuple(np.sqrt(np.sum(residual**2, axis=0) / mm).tolist()),
            noise_ratio=ratio,
            sensors=tuple(sensors),
            source=source,
            date=datetime.now(UTC).isoformat(timespec="seconds"),
        )

    @classmethod
    def stored(cls, tree: Mapping[str, Any] | None) -> Self | None:
        """What a file gives back of one: lists are the tuples that they were, and None is none."""
        if tree is None:
            return None
        fields: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in tree.items()}
        return cls(**fields)


def verified(model: Model, load: ArrayLike, response: ArrayLike, dt: float | None, source: str) -> Certificate:
    """Certificate of a model against a known load, by `Model.verify`; parameters and errors are those of it."""
    load, response = frozen(load, "load"), frozen(response, "response")
    names = [s.label for s in model.sensors]
    if dt is None:
        load, response = np.atleast_1d(load), np.atleast_2d(response)
        if load.shape != (len(model.loads),):
            raise bad_load(model, "verify", f"shape {load.shape}", "one number per load; give dt for a history")
        predicted = (model.static() @ load)[None]
    else:
        predicted = model.predict(load, dt)
        response = response[:, None] if response.ndim == 1 else response
    if response.shape != predicted.shape:
        raise InputError(
            "the response does not fit the model",
            where="verify",
            found=f"shape {response.shape}",
            expected=f"shape {predicted.shape} for the sensors {names}",
            hint="one column per sensor, in the order of model.sensors",
        )
    noise = model.noise
    std = noise if noise is None or noise.ndim == 1 else np.sqrt(np.diagonal(noise))
    return Certificate.compare(predicted, response, names, noise=std, source=source)


def bad_load(model: Model, where: str, found: str, shape: str) -> InputError:
    """The refusal of a load that does not fit a model."""
    return InputError(
        "the load does not fit the model",
        where=where,
        found=found,
        expected=f"{shape}; loads: {[c.label for c in model.loads]}",
        hint="one column per load, in the order of model.loads",
    )
