"""The path by lines of the zero-padded spectrum: for measured models, whose noise and errors differ by line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice
from structures.errors import InputError
from structures.model import Model
from structures.spectra import padded_length

from ...inverse import diagnose, penalties
from ...inverse.noise_source import NoiseSource
from ...inverse.toeplitz import SpectralPath
from ...inverse.weights import roughness
from .. import noise as noises
from ..data import AS_RECORDED, Data
from .posed import PADDED, Posed, Settings, by_prediction, shift

SILENT = 0.01  # share of the lines on which an FRF may be zero
ROUGH = 0.5  # relative error of the best sensor above which the load fills the record and roughness tells nothing


def lines(h: NDArray, values: NDArray, noise: noises.Noise, data: Data, settings: Settings) -> Posed:
    """Problem of impulse responses (samples, sensors, loads) with the same noise on every line.

    Right where the response has decayed within the record.

    Raises
    ------
    InputError
        Missing samples, a covariance, or a penalty without a name.
    """
    settings.refuse_special("line by line")
    H = np.fft.rfft(h, padded_length(len(values)), axis=0)
    return _lines(H, h, values, noises.white(noise, len(values), len(H)), data, settings)


def measured_lines(model: Model, data: Data, settings: Settings) -> Posed:
    """Problem of a measured model, with the variance of its FRFs and the noise that its training left on each line.

    Raises
    ------
    InputError
        A record of another step, an FRF that is not causal, missing samples, or a penalty without a name.
    """
    H, f = _measured_lines(model, data)
    h = np.fft.irfft(H, axis=0)
    samples = len(data.values)
    shift(h[:samples, data.rows], model, settings.allow)  # lines hold what comes before zero: only a refusal counts
    variance = model.frf_variance(f)
    variance = None if variance is None else variance[:, data.rows]
    noise = _measured_noise(model, data, settings, H[:, data.rows], model.noise_spectrum(f))
    return _lines(H, h[: min(samples, model.samples or samples)], data.values, noise, data, settings, variance)


def measured_response(model: Model, data: Data, settings: Settings) -> tuple[NDArray[np.float64], noises.LineNoise]:
    """Impulse responses (taps, sensors, loads) of a measured model, and its noise line by line."""
    H, f = _measured_lines(model, data)
    h = np.fft.irfft(H, axis=0)[: min(len(data.values), model.samples or len(data.values))]
    shift(h[:, data.rows], model, settings.allow)
    return h, _measured_noise(model, data, settings, H[:, data.rows], model.noise_spectrum(f))


def _measured_lines(model: Model, data: Data) -> tuple[NDArray[np.complex128], NDArray[np.float64]]:
    """FRFs at the lines of the padded transform of a record, and their frequencies."""
    own = float(model.dt or data.dt)
    if abs(data.dt / own - 1) > 1e-6:
        raise InputError(
            "the record and the model have different steps",
            where="estimate",
            found=f"dt = {data.dt:.9g} s",
            expected=f"dt = {own:.9g} s",
            hint=Advice(AS_RECORDED, ", or resample"),
        )
    f = np.linspace(0, 0.5 / own, padded_length(len(data.values)) // 2 + 1)
    return model.frf(f), f


def _lines(
    H: NDArray,
    h: NDArray,
    values: NDArray,
    noise: noises.LineNoise,
    data: Data,
    settings: Settings,
    variance: NDArray | None = None,
) -> Posed:
    if data.missing.any():
        raise InputError("the path by lines takes no missing samples", where="record", found=data.gaps,
                         expected="complete channels", hint="path='auto' and method='tikhonov'")  # fmt: skip
    penalty = "identity" if settings.penalty is None else settings.penalty
    if not isinstance(penalty, str):
        raise InputError(
            "the path by lines takes a named penalty",
            where="penalty",
            found="a matrix",
            expected=f"one of {penalties.names()}",
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

    kappa, _, _ = diagnose.layout(path.c, path.unknowns)
    layout = kappa, path.rank, max(path.unknowns - path.rank, 0)
    compare = by_prediction(values, predict)
    return Posed(path, noise.noise, compare, values, PADDED, h[:, data.rows], layout, full, path.unknowns, path)


def _measured_noise(
    model: Model, data: Data, settings: Settings, H: NDArray, spectrum: NDArray | None
) -> noises.LineNoise:
    """Noise of each line: of the user, of the training hits, of the roughness of one short load, or of the record."""
    samples = len(data.values)
    if settings.noise is None and spectrum is not None:
        hits = sum(h.used for h in model.hits)
        said = f"residual power of {hits} training hits, averaged over neighbouring lines"
        return noises.LineNoise(samples * spectrum[:, data.rows], None, NoiseSource("residual", said))
    if settings.noise is None and model.training and H.shape[2] == 1 and np.mean(H == 0) < SILENT:
        own = np.where(H[..., 0] == 0, np.max(np.abs(H)), H[..., 0])  # a silent line tells nothing: no roughness there
        size = np.abs(own) ** 2
        told = roughness(np.fft.rfft(data.values, 2 * (len(H) - 1), axis=0) / own)
        if np.median(np.min(told.relative, axis=1)) <= ROUGH:
            excess = np.maximum(told.local - told.typical, 0.0) * size
            source = NoiseSource("residual", "roughness of the load spectrum that each sensor gives alone")
            return noises.LineNoise(told.typical * size, excess, source)
    noise = noises.resolve(settings.noise, settings.noise_source, model, data)
    return noises.white(noise, samples, len(H))
