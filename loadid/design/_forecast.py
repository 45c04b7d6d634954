"""What a model and the noise of its sensors promise before anything is measured: the error of one typical pulse.

A load f is found from H f and noise as the minimum of ``|H g - y|^2 + lam^2 |g / w|^2``, rows in units of their noise:
over a short record from rest, with the prior std w of a load that acts when the pulse does, as the local variance of
`loadid.Penalty` finds it on a record; or line by line, w constant, where a model has FRFs alone. What that leaves out
is the bias, what it lets in is the noise, of the sensors and of the FRFs themselves where their variance is known:
closed forms of one singular value decomposition. Lambda is that of the least expected error; rules seek it on a record.

Source: P. C. Hansen, Discrete Inverse Problems (2010), sections 4.2, 5.1 and 8.1 (perturbation error, general form).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures.errors import InputError

Array = NDArray[Any]

STEPS = 20  # samples of a pulse, where neither a model nor a record says how fast is sampled
PULSES = 10  # length of the record in pulses, where that is not
UNKNOWNS = 600  # samples of all loads: more make the record shorter
LEAST = 2.5  # pulses that it must hold
WIDTH = 0.1  # of a pulse: how sharply the data show when the load acts
FLOOR = 0.01  # std of a load where it does not act, over its peak
ASSUMED = 0.01  # noise over the largest response of each sensor, where nothing says more
LAMBDAS = 65


@dataclass(frozen=True)
class Pulse:
    """A half sine.

    Parameters
    ----------
    duration : float
        In s.
    peak : float
        In the unit of the load.
    """

    duration: float = 1e-3
    peak: float = 100.0

    def at(self, t: ArrayLike) -> Array:
        """Its values at times (s); it begins at 0."""
        phase = np.asarray(t, float) / self.duration
        return np.where((phase > 0) & (phase < 1), self.peak * np.sin(np.pi * phase), 0.0)

    def spectrum(self, frequencies: ArrayLike) -> Array:
        """Its Fourier transform at `frequencies` (Hz), in unit of the load times s."""
        t = (np.arange(400) + 0.5) * self.duration / 400
        lines = np.exp(-2j * np.pi * np.asarray(frequencies, float)[:, None] * t)
        return np.asarray(lines @ self.at(t) * self.duration / 400)


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
    if not model.gives("impulse_response"):
        model.require("frf", family="forecast")
        return _of_lines(model, pulse, noise, noise_source, dt)
    dt = model.dt if model.dt is not None else dt if dt is not None else pulse.duration / STEPS
    samples, n = _samples(model, dt, pulse), len(model.loads)
    h = np.asarray(model.impulse_response(dt, samples, model.default_hold))
    start = samples // 4
    f = pulse.at((np.arange(samples) - start) * dt)
    H = np.stack([np.concatenate([np.zeros((k, *h.shape[1:])), h[: samples - k]]) for k in range(samples)], axis=-1)
    reached = np.abs(H @ f).max(axis=(0, 2))
    std, source = _noise(model, noise, noise_source, reached)
    A = (np.moveaxis(H, 0, 1) / std[:, None, None, None]).reshape(-1, n * samples)  # (sensors samples, loads samples)
    variance = None if model.frequencies is None else model.frf_variance(model.frequencies)
    from scipy.ndimage import gaussian_filter1d

    hits = []
    for j, load in enumerate(model.loads):
        whole = np.zeros((n, samples))
        whole[j] = f
        prior = np.full((n, samples), FLOOR)
        prior[j] += np.sqrt(gaussian_filter1d((f / pulse.peak) ** 2, WIDTH * pulse.duration / dt))
        errors = _of_tests(variance[:, :, j], pulse, dt, samples, std) if variance is not None else None
        missed, spread, wrong = _parts(A, whole.ravel(), prior.ravel(), errors)
        size = float(f @ f)
        parts = [float(np.sqrt(np.sum(x) / size)) for x in (missed**2, spread, wrong)]
        hits.append(HitForecast(load.label, load.unit, float(np.linalg.norm(parts)), *parts))
    return Forecast(pulse, tuple(hits), tuple(std.tolist()), source, dt, samples * dt, (0.0, 0.5 / dt), 1.0)


def _samples(model: Model, dt: float, pulse: Pulse) -> int:
    """Samples of the short record.

    Raises
    ------
    InputError
        Too many loads, or a step that does not resolve the pulse.
    """
    each = pulse.duration / dt
    samples = min(int(PULSES * each), UNKNOWNS // len(model.loads))
    if each < 4 or samples < LEAST * each:
        raise InputError(
            "the pulse is too short for the step" if each < 4 else "too many loads for a pulse of so many samples",
            where="forecast", found=f"{each:.3g} samples a pulse, {len(model.loads)} loads",
            expected=f"4 samples or more, {int(UNKNOWNS / LEAST)} samples of all loads at most",
            hint="state a longer pulse" if each < 4 else "state a shorter pulse, or judge the layout by loadid design",
        )  # fmt: skip
    return samples


def _of_tests(variance: Array, pulse: Pulse, dt: float, samples: int, std: Array) -> Array:
    """Covariance (sensors, samples, samples) of the response that errors of the FRFs add, whitened.

    The errors are independent from line to line of the test, whose length is that of the table.
    """
    from scipy.linalg import toeplitz

    long = 2 * (len(variance) - 1)
    F = np.fft.rfft(pulse.at(np.arange(long) * dt))
    lag = np.fft.irfft(variance * np.abs(F[:, None]) ** 2, axis=0)[:samples] / long
    lag = np.concatenate([lag, np.zeros((samples - len(lag), lag.shape[1]))])
    return np.stack([toeplitz(column) for column in (lag / std**2).T])


def _parts(A: Array, f: Array, prior: Array, errors: Array | None) -> tuple[Array, Array, Array]:
    """Bias, variance by the noise and variance by the errors of the FRFs of every sample of the loads `f`."""
    U, s, Vt = np.linalg.svd(A * prior, full_matrices=False)
    V, s2 = prior[:, None] * Vt.T, s**2
    c = Vt @ (f / prior)
    added = 0.0 if errors is None else float(np.mean(np.diagonal(errors, axis1=1, axis2=2)))
    lambdas = s[0] * np.logspace(-9, 0, LAMBDAS)
    kept = s2 / (s2 + lambdas[:, None] ** 2)
    missed = f - (kept * c) @ V.T
    gains = (kept**2 / np.maximum(s2, np.finfo(float).tiny)) @ np.sum(V**2, axis=0)
    gain = s / (s2 + lambdas[int(np.argmin(np.sum(missed**2, axis=1) + (1 + added) * gains))] ** 2)
    K = (V * gain) @ U.T  # (samples of the loads, samples of the sensors)
    wrong = np.zeros(len(f))
    if errors is not None:
        for part, C in zip(np.split(K, len(errors), axis=1), errors, strict=True):
            wrong += np.einsum("ij,ij->i", part @ C, part)
    return V @ (gain * s * c) - f, np.sum(K**2, axis=1), wrong


def _noise(model: Model, given: ArrayLike | None, said: str, reached: Array) -> tuple[Array, str]:
    m = len(model.sensors)
    if not np.any(reached > 0):
        raise InputError("no load moves any sensor", where="forecast", found="a response of zeros",
                         expected="some response")  # fmt: skip
    if given is not None:
        std = np.asarray(given, float)
        if std.ndim > 1 or (std.ndim == 1 and len(std) != m) or not np.all(std > 0) or not np.all(np.isfinite(std)):
            raise InputError("the noise does not fit the sensors", where="noise", found=np.shape(std),
                             expected=f"one std, or {m}, all > 0")  # fmt: skip
        return np.broadcast_to(std, m), said or "stated"
    own = model.noise
    if own is not None:
        std = np.asarray(own, float)
        std = std if std.ndim == 1 else np.sqrt(np.diag(std))
        if np.all(std > 0):
            return std, "stated with the sensors of the model"
    spectrum = model.noise_spectrum(model.frequencies) if model.frequencies is not None else None
    if spectrum is not None and np.all(np.mean(spectrum, axis=0) > 0):
        return np.sqrt(np.mean(spectrum, axis=0)), "as the tests of the model left it"
    least = np.where(reached > 0, reached, reached.max())
    return ASSUMED * least, f"assumed: {ASSUMED:.0%} of the largest response of each sensor"


def _of_lines(model: Model, pulse: Pulse, noise: ArrayLike | None, said: str, dt: float | None) -> Forecast:
    """On the lines of a table; a record as long as one over their spacing."""
    assert model.frequencies is not None
    f = np.asarray(model.frequencies, float)
    F, H = pulse.spectrum(f), model.frf(f)
    width = np.gradient(f) if len(f) > 1 else np.ones(1)
    dt = dt if dt is not None else 0.5 / float(f[-1])
    reached = 2 * np.abs(np.sum(np.abs(H * F[:, None, None]) * width[:, None, None], axis=0)).max(axis=1)
    std, source = _noise(model, noise, said, reached)
    level = std * np.sqrt(dt / float(np.median(width)))  # of the transform of a record as long as a line is narrow
    variance = model.frf_variance(f)
    variance = None if variance is None else variance / level[:, None] ** 2
    told = [_line_errors(H / level[:, None], F, variance, width, j) for j in range(len(model.loads))]
    hits = tuple(
        HitForecast(load.label, load.unit, float(np.linalg.norm(parts)), *parts)
        for load, parts in zip(model.loads, told, strict=True)
    )
    whole = pulse.peak**2 * pulse.duration / 2
    inside = float(np.sqrt(min(2 * np.sum(width * np.abs(F) ** 2) / whole, 1.0)))
    return Forecast(pulse, hits, tuple(std.tolist()), source, None, None, (float(f[0]), float(f[-1])), inside)


def _line_errors(H: Array, F: Array, variance: Array | None, weights: Array, j: int) -> list[float]:
    """Bias, noise and errors of the FRFs of a pulse on load `j` over its rms; rows `H` in units of their noise."""
    U, s, Vh = np.linalg.svd(H, full_matrices=False)
    V, Uh = np.conj(np.swapaxes(Vh, 1, 2)), np.conj(np.swapaxes(U, 1, 2))
    found = []
    for lam in float(s.max()) * np.logspace(-8, 0, LAMBDAS):
        gain = s / (s**2 + lam**2)
        K = (V * gain[:, None, :]) @ Uh
        missed = np.einsum("lnk,lk,lk->ln", V, gain * s, Vh[:, :, j]) * F[:, None]
        missed[:, j] -= F
        size = np.abs(K) ** 2
        wrong = np.zeros(len(F))
        if variance is not None:
            wrong = np.einsum("lnm,lm->l", size, variance[:, :, j]) * np.abs(F) ** 2
        found.append([float(weights @ x) for x in (np.sum(np.abs(missed) ** 2, axis=1), size.sum(axis=(1, 2)), wrong)])
    rms = float(weights @ np.abs(F) ** 2)
    return [float(np.sqrt(x / rms)) for x in min(found, key=sum)]
