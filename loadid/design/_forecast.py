"""What a model and the noise of its sensors promise before anything is measured: the error of one typical pulse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from structures._model import Model

from ._hits import HitProblem, Pulse, RecordProblem, posed


@dataclass(frozen=True)
class HitForecast:
    """Expected error of a pulse on one load, the others zero but unknown.

    Parameters
    ----------
    load, unit : str
    error : float
        Rms error of the history over the rms of the pulse, within the band.
    bias, noise, model : float
        Its parts: what is not seen, the noise of the sensors, the errors of the FRFs.
    """

    load: str
    unit: str
    error: float
    bias: float
    noise: float
    model: float


@dataclass(frozen=True)
class Forecast:
    """Hits on every load, and what was taken for granted.

    Parameters
    ----------
    pulse : Pulse
    hits : tuple of HitForecast
    noise : tuple of float
        Std of every sensor, SI.
    noise_source : str
        Where it comes from, in words.
    dt, duration : float or None
        Step and length of the record (s); None of lines.
    band : tuple of float
        Hz.
    inside : float
        Share of the rms of the pulse that lies in the band.
    """

    pulse: Pulse
    hits: tuple[HitForecast, ...]
    noise: tuple[float, ...]
    noise_source: str
    dt: float | None
    duration: float | None
    band: tuple[float, float]
    inside: float

    @property
    def worst(self) -> HitForecast:
        """The hit that is found least well."""
        return max(self.hits, key=lambda hit: hit.error)

    def to_dict(self) -> dict[str, Any]:
        """Plain values."""
        return {**asdict(self), "hits": [asdict(hit) for hit in self.hits], "worst": self.worst.load}

    def __str__(self) -> str:
        hit, p = self.worst, self.pulse
        size = f"{p.peak:g} {hit.unit}".removesuffix(" arbitrary")
        which = f"on {hit.load}" + (f", the worst of {len(self.hits)} loads," if len(self.hits) > 1 else "")
        beyond = "" if self.dt is not None else (
            f" within {self.band[0]:.4g} to {self.band[1]:.4g} Hz, where {self.inside:.0%} of its rms lies,"
        )  # fmt: skip
        sampled = "" if self.dt is None else f"; sampled at {1 / self.dt:.4g} Hz"
        granted = f"noise {self.noise_source}{sampled}; the model is right" + " within its own errors" * (hit.model > 0)
        return (f"a hit of {1e3 * p.duration:.4g} ms and {size} {which}{beyond} would be found to "
                f"+-{100 * hit.error:.3g} % of its rms with these sensors ({granted})")  # fmt: skip


def forecast(
    model: Model,
    *,
    pulse: Pulse | None = None,
    noise: ArrayLike | None = None,
    noise_source: str = "",
    dt: float | None = None,
) -> Forecast:
    """Expected error of a pulse on each load of a dynamic model.

    Parameters
    ----------
    model : Model
        One that gives an impulse response; else lines of its table of FRFs.
    pulse : Pulse, optional
        Default 1 ms, 100 units of the load.
    noise : float or array (sensors,), optional
        Std of the noise of a sample, SI; default that of the model, of its tests, else 1 % of the largest response of
        each sensor to the pulse on the load that moves it most.
    noise_source : str
        Of a given noise, in words.
    dt : float, optional
        Step of the record in s, where the model has none of its own; default a twentieth of the pulse.

    Raises
    ------
    InputError
        A model that gives neither, another number of sensors, a pulse that moves no sensor.
    """
    pulse = pulse or Pulse()
    return of(posed(model, pulse, noise, noise_source, dt), model, pulse)


def of(problem: HitProblem, model: Model, pulse: Pulse, rows: Sequence[int] | None = None) -> Forecast:
    """The forecast of some sensors (default all) of a problem of a model."""
    rows = range(len(model.sensors)) if rows is None else rows
    hits = tuple(
        HitForecast(load.label, load.unit, float(np.linalg.norm(parts)), *map(float, parts))
        for load, parts in zip(model.loads, problem.errors(rows), strict=True)
    )
    std = tuple(problem.noise[list(rows)].tolist())
    if isinstance(problem, RecordProblem):
        duration = len(problem.f) * problem.dt
        return Forecast(pulse, hits, std, problem.noise_source, problem.dt, duration, (0.0, 0.5 / problem.dt), 1.0)
    assert model.frequencies is not None
    f = np.asarray(model.frequencies, float)
    width, F = np.gradient(f) if len(f) > 1 else np.ones(1), pulse.spectrum(f)
    whole = pulse.peak**2 * pulse.duration / 2
    inside = float(np.sqrt(min(2 * np.sum(width * np.abs(F) ** 2) / whole, 1.0)))
    return Forecast(pulse, hits, std, problem.noise_source, None, None, (float(f[0]), float(f[-1])), inside)
