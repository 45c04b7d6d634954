"""How a record and a model become a linear problem with a path: dense, by lines, or by measured lines."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.measured import MeasuredModel
from structures.model import Model
from structures.spectra import padded_length

from .. import flags as guards
from ..inverse import diagnose, penalties
from ..inverse.problem import LinearProblem
from ..inverse.svd import SVDPath
from ..inverse.toeplitz import SpectralPath, toeplitz
from ..inverse.weights import roughness
from . import noise as noises
from .data import Data

DENSE = 2000  # unknowns up to which the exact dense path is taken
UNUSABLE = 1e-12  # |h(0)| over max |h| below which the diagonal is zero
SILENT = 0.01  # share of the lines on which an FRF may be zero
ROUGH = 0.5  # relative error of the best sensor above which the load fills the record and roughness tells nothing


@dataclass(frozen=True)
class Settings:
    """What decides how a problem is posed; see `Deconvolution`."""

    method: str
    penalty: str | ArrayLike | None
    hold: str | None
    noise: ArrayLike | None
    noise_source: str | None
    allow: tuple[str, ...]

    @property
    def truncated(self) -> bool:
        """Truncated SVD in place of Tikhonov."""
        return self.method == "tsvd"


@dataclass(frozen=True)
class Posed:
    """A problem as posed.

    Parameters
    ----------
    path : SVDPath or SpectralPath
    noise : Noise
    predict : callable
        Load (samples, loads) -> responses of the used sensors (samples, sensors).
    values : array, shape (samples, sensors)
        The data, advanced where the impulse response begins late.
    name : str
        Which path it is.
    h : array, shape (samples, sensors, loads)
        Impulse response of the used sensors.
    full : (kappa, rank, nullity) or None
        Conditioning with all sensors of the model, where only some are used.
    """

    path: SVDPath | SpectralPath
    noise: noises.Noise
    predict: Callable[[NDArray], NDArray]
    values: NDArray[np.float64]
    name: str
    h: NDArray[np.float64]
    full: tuple[float, int, int] | None

    @property
    def unknowns(self) -> int:
        """Number of unknowns."""
        return self.path.problem.H.shape[1] if isinstance(self.path, SVDPath) else self.path.unknowns

    @property
    def layout(self) -> tuple[float, int, int]:
        """Conditioning of the visible part, rank and nullity."""
        singular = self.path.singular_values if isinstance(self.path, SVDPath) else self.path.c
        kappa, _, _ = diagnose.layout(singular, self.unknowns)
        return kappa, self.path.rank, max(self.unknowns - self.path.rank, 0)


def pose(model: Model, data: Data, settings: Settings) -> Posed:
    """Problem of a record: dense up to `DENSE` unknowns, by lines beyond and for measured models.

    Raises
    ------
    InputError
        No usable diagonal (LID-E506), different steps, or a penalty or noise that the path does not take.
    """
    if isinstance(model, MeasuredModel):
        return _measured(model, data, settings)
    h = model.impulse_response(data.dt, len(data.values), settings.hold or model.default_hold)
    shift = _shift(h[:, data.rows], model, settings.allow)
    h, values = h[shift:], data.values[shift:]
    noise = noises.resolve(settings.noise, settings.noise_source, model, data)
    if len(values) * h.shape[2] <= DENSE or not isinstance(settings.penalty, str | None):
        return _dense(h, values, noise, data, settings)
    H = np.fft.rfft(h, padded_length(len(values)), axis=0)
    return _lines(H, h, values, noises.white(noise, len(values), len(H)), data, settings)


def _dense(h: NDArray, values: NDArray, noise: noises.Noise, data: Data, settings: Settings) -> Posed:
    samples, loads = len(values), h.shape[2]
    n = samples * loads
    if n > 2 * DENSE:
        raise InputError(
            "a penalty matrix needs the dense path, and the record is too long for it",
            where="penalty",
            found=f"{n} unknowns",
            expected=f"at most {2 * DENSE}",
            hint="use a named penalty, or a window",
        )
    used = h[:, data.rows]
    T = toeplitz(used)
    L = None if settings.penalty is None else penalties.matrix(settings.penalty, samples, loads)
    path = SVDPath(LinearProblem.whitened(T, values, noise.level, L, (samples, loads)), truncated=settings.truncated)
    full = None
    if len(data.rows) < h.shape[1]:
        scale = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = diagnose.layout(np.linalg.svd(toeplitz(h / scale[:, None]).reshape(-1, n), compute_uv=False), n)

    def predict(g: NDArray) -> NDArray:
        return (T.reshape(-1, n) @ g.reshape(-1)).reshape(values.shape)

    return Posed(path, noise, predict, values, "dense SVD", used, full)


def _lines(
    H: NDArray,
    h: NDArray,
    values: NDArray,
    noise: noises.LineNoise,
    data: Data,
    settings: Settings,
    variance: NDArray | None = None,
) -> Posed:
    penalty = "identity" if settings.penalty is None else settings.penalty
    if not isinstance(penalty, str):
        raise InputError(
            "a measured model takes a named penalty",
            where="penalty",
            found="a matrix",
            expected=", ".join(penalties.ORDER),
        )
    used = H[:, data.rows]
    path = SpectralPath(
        used,
        values,
        noise.power,
        penalty=penalty,
        variance=variance,
        excess=noise.excess,
        truncated=settings.truncated,
    )
    full = None
    if len(data.rows) < H.shape[1]:
        scale = np.sqrt(np.mean(np.abs(H) ** 2, axis=(0, 2)))
        full = diagnose.layout(np.linalg.svd(H / scale[:, None], compute_uv=False).ravel(), len(H) * H.shape[2])

    def predict(g: NDArray) -> NDArray:
        G = np.fft.rfft(g, path.padded, axis=0)
        return np.fft.irfft(np.einsum("ksl,kl->ks", used, G), path.padded, axis=0)[: len(values)]

    return Posed(path, noise.noise, predict, values, "zero-padded FFT", h[:, data.rows], full)


def _measured(model: MeasuredModel, data: Data, settings: Settings) -> Posed:
    if abs(data.dt / model.dt - 1) > 1e-6:
        raise InputError(
            "the record and the model have different steps",
            where="estimate",
            found=f"dt = {data.dt:.9g} s",
            expected=f"dt = {model.dt:.9g} s",
            hint="give the sampling rate as recorded (--fs, dt=), or resample",
        )
    samples = len(data.values)
    f = np.linspace(0, 0.5 / model.dt, padded_length(samples) // 2 + 1)
    H = model.frf(f)
    h = np.fft.irfft(H, axis=0)
    _shift(h[:samples, data.rows], model, settings.allow)  # lines hold what comes before zero: only a refusal counts
    variance = model.frf_variance(f)
    variance = None if variance is None else variance[:, data.rows]
    noise = _measured_noise(model, data, settings, H[:, data.rows], model.noise_spectrum(f))
    return _lines(H, h[: min(samples, model.samples)], data.values, noise, data, settings, variance)


def _measured_noise(
    model: MeasuredModel, data: Data, settings: Settings, H: NDArray, spectrum: NDArray | None
) -> noises.LineNoise:
    """Noise of each line: of the user, of the training hits, of the roughness of one short load, or of the record."""
    samples = len(data.values)
    if settings.noise is None and spectrum is not None:
        hits = sum(h.used for h in model.hits)
        source = f"residual power of {hits} training hits, averaged over neighbouring lines"
        return noises.LineNoise(samples * spectrum[:, data.rows], None, source)
    if settings.noise is None and model.training and H.shape[2] == 1 and np.mean(H == 0) < SILENT:
        own = np.where(H[..., 0] == 0, np.max(np.abs(H)), H[..., 0])  # a silent line tells nothing: no roughness there
        size = np.abs(own) ** 2
        told = roughness(np.fft.rfft(data.values, 2 * (len(H) - 1), axis=0) / own)
        if np.median(np.min(told.relative, axis=1)) <= ROUGH:
            excess = np.maximum(told.local - told.typical, 0.0) * size
            source = "roughness of the load spectrum that each sensor gives alone"
            return noises.LineNoise(told.typical * size, excess, source)
    noise = noises.resolve(settings.noise, settings.noise_source, model, data)
    return noises.white(noise, samples, len(H))


def diagonal(h: NDArray) -> float:
    """First sample of the impulse responses (samples, sensors, loads) over their maximum, for the worst load."""
    level = np.max(np.abs(h), axis=1)
    return float(np.min(level[0] / level.max(axis=0)))


def _shift(h: NDArray, model: Model, allow: tuple[str, ...]) -> int:
    """Samples by which data are advanced so that the first load to arrive has a diagonal (0 with a first-order hold).

    No more than that: what a load that arrives earlier does in between must stay in the operator. The last samples of
    a load that arrives later are not seen, and are left to the prior.
    """
    level = np.max(np.abs(h), axis=1)  # (samples, loads)
    largest = level.max(axis=0)
    for j in np.flatnonzero(largest == 0):
        raise guards.index_offset(0.0, model.loads[j].label, None)
    usable = level > UNUSABLE * largest
    if "LID-E506" in allow or usable[0].all():
        return 0
    first = np.argmax(usable, axis=0)
    worst = int(np.argmax(first))
    if first[worst] > len(h) // 2:
        raise guards.index_offset(float(level[0, worst] / largest[worst]), model.loads[worst].label, int(first[worst]))
    return int(first.min())
