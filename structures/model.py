"""The forward-model contract: what every family may ask, and how a model refuses what it cannot give."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .channels import Channel
from .errors import InputError
from .flags import Flag
from .values import plain

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
        predicted: NDArray,
        measured: NDArray,
        sensors: Sequence[str],
        *,
        noise: NDArray | None = None,
        source: str = "a known load",
    ) -> Certificate:
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


class Model:
    """A map from loads to responses. Subclasses override what they can give; the rest refuses by name.

    Shapes: time or frequency first, then sensors, then loads. Units are those of the channels.

    Attributes
    ----------
    sensors, loads : tuple of Channel
        Rows and columns.
    certificate : Certificate or None
        Outcome of the last `verify`.
    flags : tuple of Flag
        What the guards of the forward model found when it was built.
    """

    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    certificate: Certificate | None = None
    flags: tuple[Flag, ...] = ()
    serves: ClassVar[dict[str, str]] = {
        "static": "StaticInversion",
        "frf": "FrequencyInversion",
        "impulse_response": "Deconvolution",
        "state_space": "LoadTracker",
    }

    # -- the contract ---------------------------------------------------------------------------------------------
    def static(self) -> NDArray[np.float64]:
        """Static transfer matrix, shape (sensors, loads).

        Units of the sensor over units of the load.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self._refuse("static")

    def frf(self, frequencies: ArrayLike) -> NDArray[np.complex128]:
        """Frequency response at `frequencies` (Hz), shape (lines, sensors, loads).

        Units of the sensor over units of the load; the sign of time is exp(+i omega t).

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self._refuse("frf")

    def impulse_response(self, dt: float, samples: int, hold: str = "foh") -> NDArray[np.float64]:
        """Response to one unit held over one sample, shape (samples, sensors, loads).

        Parameters
        ----------
        dt : float
            Step in s.
        samples : int
        hold : ``"foh"`` or ``"zoh"``
            The load is linear between its samples, or constant over each.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self._refuse("impulse_response")

    def state_space(self, dt: float, hold: str = "foh") -> Any:
        """Discrete state space at step `dt` (s).

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self._refuse("state_space")

    def perturbed(self, parameter: str, factor: float) -> Self:
        """A model of the same kind with one parameter multiplied by `factor`.

        Raises
        ------
        InputError
            If a model of this kind has none; it names the families that can run on it.
        """
        self._refuse("perturbed")

    @property
    def noise(self) -> NDArray[np.float64] | None:
        """Noise std per sensor (sensors,) or covariance (sensors, sensors); None when not all are known."""
        stds = [s.noise for s in self.sensors]
        return None if any(s is None for s in stds) else np.array(stds, dtype=float)

    @property
    def natural_frequencies(self) -> NDArray[np.float64] | None:
        """Natural frequencies (Hz) that the model retains, ascending; None where a model has no modes."""
        return None

    @property
    def decay_rate(self) -> float | None:
        """Slowest decay rate zeta*omega (1/s) of the model; None when not known."""
        return None

    @property
    def fingerprint(self) -> str:
        """Sha256 (hex) of what the model is made of: two models with the same digest are the same model."""
        raise NotImplementedError

    def verify(
        self, load: ArrayLike, response: ArrayLike, dt: float | None = None, *, source: str = "a known load"
    ) -> Certificate:
        """Check the model against a known load, and keep the certificate.

        Parameters
        ----------
        load : array, shape (loads,) for a static check, (samples, loads) or (samples,) with `dt`
        response : array, shape (sensors,), or (samples, sensors)
        dt : float, optional
            Step in s; without it the check is static.
        source : str
            What the load was: "hanging mass 2.0 kg", "hit 5".

        Returns
        -------
        Certificate
            Also kept as ``model.certificate``, so that it travels in every estimate.

        Raises
        ------
        InputError
            If load or response do not fit the model, hold NaN or are zero; or if the model has no `static`, or no
            `impulse_response`, at this step.
        NotIdentifiable
            From `static` of a structure that is not supported.
        """
        load, response = _finite(load, "load"), _finite(response, "response")
        names = [s.label for s in self.sensors]
        if dt is None:
            load, response = np.atleast_1d(load), np.atleast_2d(response)
            if load.shape != (len(self.loads),):
                raise self._bad_load("verify", f"shape {load.shape}", "one number per load; give dt for a history")
            predicted = (self.static() @ load)[None]
        else:
            predicted = self.predict(load, dt)
            response = response[:, None] if response.ndim == 1 else response
        if response.shape != predicted.shape:
            raise InputError(
                "the response does not fit the model",
                where="verify",
                found=f"shape {response.shape}",
                expected=f"shape {predicted.shape} for the sensors {names}",
                hint="one column per sensor, in the order of model.sensors",
            )
        self.certificate = Certificate.compare(predicted, response, names, noise=self._noise_std(), source=source)
        return self.certificate

    # -- shared ---------------------------------------------------------------------------------------------------
    @property
    def default_hold(self) -> str:
        """Hold that `predict` uses when none is named."""
        return "foh"

    def predict(self, load: ArrayLike, dt: float, hold: str | None = None) -> NDArray[np.float64]:
        """Response (samples, sensors) to a load history (samples, loads), at rest before its first sample.

        Parameters
        ----------
        load : array (samples, loads), or (samples,) for one load
        dt : float
            Step in s.
        hold : ``"foh"`` or ``"zoh"``, optional
            How the load runs between its samples; `default_hold` where not given.

        Raises
        ------
        InputError
            If the load does not fit the model or holds NaN, or the model has no `impulse_response` at this step.
        """
        from scipy.signal import fftconvolve

        load = _finite(load, "load")
        load = load[:, None] if load.ndim == 1 else load
        if load.ndim != 2 or load.shape[1] != len(self.loads) or len(load) == 0:
            raise self._bad_load("predict", f"shape {load.shape}", "(samples, loads)")
        h = self.impulse_response(dt, len(load), hold or self.default_hold)
        response = np.zeros((len(load), len(self.sensors)))
        for j in range(len(self.loads)):
            response += fftconvolve(h[:, :, j], load[:, j, None], axes=0)[: len(load)]
        return response

    def _bad_load(self, where: str, found: str, shape: str) -> InputError:
        return InputError(
            "the load does not fit the model",
            where=where,
            found=found,
            expected=f"{shape}; loads: {[c.label for c in self.loads]}",
            hint="one column per load, in the order of model.loads",
        )

    def _noise_std(self) -> NDArray | None:
        noise = self.noise
        return noise if noise is None or noise.ndim == 1 else np.sqrt(np.diagonal(noise))

    def _refuse(self, method: str) -> NoReturn:
        can = [family for name, family in self.serves.items() if getattr(type(self), name) is not getattr(Model, name)]
        family = self.serves.get(method)
        raise InputError(
            f"{type(self).__name__} has no {method}()" + (f": {family} cannot run on it" if family else ""),
            where="forward model",
            found=type(self).__name__,
            expected=f"a model that gives {method}()",
            hint=f"families that can run on this model: {', '.join(can) or 'none'}",
        )


def _finite(values: ArrayLike, name: str) -> NDArray[np.float64]:
    try:
        array = np.asarray(plain(values), float)
    except (TypeError, ValueError):
        raise InputError(
            "not a real array", where=name, found=repr(values)[:60], expected="numbers", hint="pass an array of numbers"
        ) from None
    if not np.all(np.isfinite(array)):
        raise InputError(
            "NaN or infinity",
            where=name,
            found=f"{np.sum(~np.isfinite(array))} entries",
            expected="finite",
            hint="repair or leave out what is missing",
        )
    return array
