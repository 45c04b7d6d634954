"""The error of a typical pulse that some of many sensors leave, in closed forms of one singular value decomposition.

A load f is found from H f and noise as the minimum of ``|H g - y|^2 + lam^2 |g / w|^2``, rows in units of their noise:
over a short record from rest, with the prior std w of a load that acts when the pulse does, as the local variance of
`loadid.Penalty` finds it on a record; or line by line, w constant, where a model has FRFs alone. What that leaves out
is the bias, what it lets in is the noise, of the sensors and of the FRFs themselves where their variance is known.
Lambda is that of the least expected error; rules seek it on a record.

Source: P. C. Hansen, Discrete Inverse Problems (2010), sections 4.2, 5.1 and 8.1 (perturbation error, general form).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._model import Model
from structures.errors import InputError

Array = NDArray[Any]

LEAST = 2.5  # pulses that the record must hold
WIDTH = 0.1  # of a pulse: how sharply the data show when the load acts
FLOOR = 0.01  # std of a load where it does not act, over its peak
ASSUMED = 0.01  # noise over the largest response of each sensor, where nothing says more


@dataclass(frozen=True)
class Fineness:
    """How finely a pulse is looked at.

    Parameters
    ----------
    steps : int
        Samples of a pulse, where neither a model nor a record says how fast is sampled.
    pulses : int
        Length of the record in pulses, where that is not said.
    unknowns : int
        Samples of all loads: more make the record shorter.
    lines : int
        Most lines of a table of FRFs.
    lambdas : int
        That are tried.
    """

    steps: int = 20
    pulses: int = 10
    unknowns: int = 600
    lines: int = 1_000_000
    lambdas: int = 65


FINE = Fineness()
COARSE = Fineness(8, 6, 240, 200, 17)  # of a search among many layouts


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


class HitProblem(Protocol):
    """A pulse on each load of a model, before some of its sensors."""

    @property
    def noise(self) -> Array:
        """Std of every sensor (sensors,), SI."""

    @property
    def noise_source(self) -> str:
        """Where it comes from, in words."""

    def errors(self, rows: Sequence[int]) -> Array:
        """Bias, noise and errors of the FRFs over the rms of the pulse (loads, 3), of the sensors `rows`."""


@dataclass(frozen=True, eq=False)
class RecordProblem:
    """Over a short record from rest.

    Parameters
    ----------
    A : array, shape (sensors, samples, loads samples)
        In units of the noise.
    f : array, shape (samples,)
        The pulse.
    priors : array, shape (loads, loads samples)
        Std of all loads where one of them is hit.
    variance : array (lines, sensors, loads) or None
        Of the FRFs.
    pulse, dt, noise, noise_source, lambdas
    """

    A: Array
    f: Array
    priors: Array
    variance: Array | None
    pulse: Pulse
    dt: float
    noise: Array
    noise_source: str
    lambdas: int

    def errors(self, rows: Sequence[int]) -> Array:
        """As `HitProblem.errors`."""
        rows, samples = list(rows), len(self.f)
        A, found = self.A[rows].reshape(-1, self.A.shape[2]), []
        for j, prior in enumerate(self.priors):
            whole = np.zeros(self.A.shape[2])
            whole[j * samples : (j + 1) * samples] = self.f
            wrong = None
            if self.variance is not None:
                wrong = _of_tests(self.variance[:, rows, j], self.pulse, self.dt, samples, self.noise[rows])
            missed, spread, more = _parts(A, whole, prior, wrong, self.lambdas)
            found.append([float(np.sum(x)) for x in (missed**2, spread, more)])
        return np.sqrt(np.array(found) / float(self.f @ self.f))


@dataclass(frozen=True, eq=False)
class LineProblem:
    """On the lines of a table; a record as long as one over their spacing.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
        In units of the noise.
    F : array, shape (lines,)
        Spectrum of the pulse.
    variance : array (lines, sensors, loads) or None
        Of `H`.
    width : array, shape (lines,)
        In Hz.
    noise, noise_source, lambdas
    """

    H: Array
    F: Array
    variance: Array | None
    width: Array
    noise: Array
    noise_source: str
    lambdas: int

    def errors(self, rows: Sequence[int]) -> Array:
        """As `HitProblem.errors`."""
        H, rows = self.H[:, list(rows)], list(rows)
        U, s, Vh = np.linalg.svd(H, full_matrices=False)
        V, Uh = np.conj(np.swapaxes(Vh, 1, 2)), np.conj(np.swapaxes(U, 1, 2))
        loads, rms = range(H.shape[2]), float(self.width @ np.abs(self.F) ** 2)
        found = np.zeros((self.lambdas, len(loads), 3))
        for k, lam in enumerate(max(float(s.max()), np.finfo(float).tiny) * np.logspace(-8, 0, self.lambdas)):
            gain = s / (s**2 + lam**2)
            size = np.abs((V * gain[:, None, :]) @ Uh) ** 2
            for j in loads:
                missed = np.einsum("lnk,lk,lk->ln", V, gain * s, Vh[:, :, j]) * self.F[:, None]
                missed[:, j] -= self.F
                found[k, j, 0] = self.width @ np.sum(np.abs(missed) ** 2, axis=1)
                found[k, j, 1] = self.width @ size.sum(axis=(1, 2))
                if self.variance is not None:
                    wrong = np.einsum("lnm,lm->l", size, self.variance[:, rows, j]) * np.abs(self.F) ** 2
                    found[k, j, 2] = self.width @ wrong
        best = np.argmin(found.sum(axis=2), axis=0)
        return np.sqrt(found[best, loads] / rms)


def posed(
    model: Model, pulse: Pulse, noise: ArrayLike | None, said: str, dt: float | None, fine: Fineness = FINE,
    alike: bool = False,
) -> HitProblem:  # fmt: skip
    """The problem of all sensors of a model.

    Parameters
    ----------
    model : Model
        One that gives an impulse response; else lines of its table of FRFs.
    pulse : Pulse
    noise : float or array (sensors,), optional
        Std, SI; default that of the model, of its tests, else 1 % of the largest response of each sensor.
    said : str
        Where a given noise comes from.
    dt : float, optional
        Step in s, where the model has none of its own.
    fine : Fineness
    alike : bool
        Where nothing says how much noise there is, sensors of one unit have the same, that of the one that moves most.

    Raises
    ------
    InputError
        A model that gives neither, another number of sensors, a pulse that moves no sensor.
    """
    if not model.gives("impulse_response"):
        model.require("frf", family="forecast")
        return _of_lines(model, pulse, noise, said, dt, fine, alike)
    dt = model.dt if model.dt is not None else dt if dt is not None else pulse.duration / fine.steps
    samples, n = _samples(model, dt, pulse, fine), len(model.loads)
    h = np.asarray(model.impulse_response(dt, samples, model.default_hold))
    f = pulse.at((np.arange(samples) - samples // 4) * dt)
    H = np.stack([np.concatenate([np.zeros((k, *h.shape[1:])), h[: samples - k]]) for k in range(samples)], axis=-1)
    std, source = _noise(model, noise, said, np.abs(H @ f).max(axis=(0, 2)), alike)
    A = (np.moveaxis(H, 0, 1) / std[:, None, None, None]).reshape(len(std), samples, n * samples)
    from scipy.ndimage import gaussian_filter1d

    priors = np.full((n, n, samples), FLOOR)
    acts = np.sqrt(gaussian_filter1d((f / pulse.peak) ** 2, WIDTH * pulse.duration / dt))
    priors[range(n), range(n)] += acts
    variance = None if model.frequencies is None else model.frf_variance(model.frequencies)
    return RecordProblem(A, f, priors.reshape(n, -1), variance, pulse, dt, std, source, fine.lambdas)


# -- inside ------------------------------------------------------------------------------------------------------------
def _samples(model: Model, dt: float, pulse: Pulse, fine: Fineness) -> int:
    """Samples of the short record.

    Raises
    ------
    InputError
        Too many loads, or a step that does not resolve the pulse.
    """
    each = pulse.duration / dt
    most = FINE.unknowns // len(model.loads)
    samples = min(int(fine.pulses * each), max(fine.unknowns // len(model.loads), min(most, int(LEAST * each) + 1)))
    if each < 4 or samples < LEAST * each:
        raise InputError(
            "the pulse is too short for the step" if each < 4 else "too many loads for a pulse of so many samples",
            where="forecast", found=f"{each:.3g} samples a pulse, {len(model.loads)} loads",
            expected=f"4 samples or more, {int(FINE.unknowns / LEAST)} samples of all loads at most",
            hint="state a longer pulse" if each < 4 else "state a shorter pulse, or name fewer loads",
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


def _parts(A: Array, f: Array, prior: Array, errors: Array | None, count: int) -> tuple[Array, Array, Array]:
    """Bias, variance by the noise and variance by the errors of the FRFs of every sample of the loads `f`."""
    U, s, Vt = np.linalg.svd(A * prior, full_matrices=False)
    V, s2 = prior[:, None] * Vt.T, s**2
    c = Vt @ (f / prior)
    added = 0.0 if errors is None else float(np.mean(np.diagonal(errors, axis1=1, axis2=2)))
    lambdas = max(float(s[0]), np.finfo(float).tiny) * np.logspace(-9, 0, count)
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


def _noise(model: Model, given: ArrayLike | None, said: str, reached: Array, alike: bool) -> tuple[Array, str]:
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
    if alike:
        kinds = np.array([c.unit for c in model.sensors])
        most = np.array([reached[kinds == kind].max() for kind in kinds])
        return ASSUMED * np.where(most > 0, most, 1.0), (
            f"assumed: {ASSUMED:.0%} of the largest response of the sensors of a unit")  # fmt: skip
    least = np.where(reached > 0, reached, reached.max())
    return ASSUMED * least, f"assumed: {ASSUMED:.0%} of the largest response of each sensor"


def _of_lines(
    model: Model, pulse: Pulse, noise: ArrayLike | None, said: str, dt: float | None, fine: Fineness, alike: bool
) -> LineProblem:
    assert model.frequencies is not None
    f = np.asarray(model.frequencies, float)
    F, H = pulse.spectrum(f), model.frf(f)
    width = np.gradient(f) if len(f) > 1 else np.ones(1)
    dt = dt if dt is not None else 0.5 / float(f[-1])
    reached = 2 * np.abs(np.sum(np.abs(H * F[:, None, None]) * width[:, None, None], axis=0)).max(axis=1)
    std, source = _noise(model, noise, said, reached, alike)
    level = std * np.sqrt(dt / float(np.median(width)))  # of the transform of a record as long as a line is narrow
    variance = model.frf_variance(f)
    variance = None if variance is None else variance / level[:, None] ** 2
    some = slice(None, None, -(-len(f) // fine.lines))
    return LineProblem((H / level[:, None])[some], F[some], None if variance is None else variance[some], width[some],
                       std, source, fine.lambdas)  # fmt: skip
