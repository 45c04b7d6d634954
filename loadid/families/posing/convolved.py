"""The Toeplitz path: impulse responses of any model, any length, right at both ends of the record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.model import Model

from ...inverse.convolution import Convolution
from ...inverse.convolved.path import ConvolvedPath
from ...inverse.nonnegative.solver import NonNegativeRecord
from ...inverse.penalties import names
from ...inverse.streamed import Stream, heard
from ...inverse.whitening import whiten
from ...inverse.windowed import WindowedPath, beginning_of
from ..data import Data
from ..noise import Noise
from .coloured import coloured
from .lines import measured_response
from .posed import WHOLE, Posed, Settings

FEW = 4096  # samples of a record whose lines tell as much as those of a longer one, once the response has ended
LAYOUT = 1e-12  # share of the largest line below which a line says nothing


def convolved(h: NDArray, values: NDArray, missing: NDArray, noise: Noise, data: Data, settings: Settings) -> Posed:
    """Problem of impulse responses (taps, sensors, loads) of all sensors of the model.

    Raises
    ------
    InputError
        A penalty without a name, a start that is not at rest, or a covariance beside missing samples.
    """
    if not isinstance(settings.penalty, str):
        raise InputError("the Toeplitz path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=f"one of {names()}; a matrix goes by path='dense'")  # fmt: skip
    if missing.any() and noise.level.ndim == 2:
        raise InputError("missing samples take a noise std per sensor, not a covariance", where="noise",
                         found=f"covariance {noise.level.shape}", expected=f"({len(data.rows)},)")  # fmt: skip
    white = whiten(h[:, data.rows], noise.level, 1), whiten(values, noise.level, 1)
    return _posed(h, *white, values, missing, noise, data, settings)


def _posed(
    h: NDArray, h_white: NDArray, y_white: NDArray, values: NDArray, missing: NDArray, noise: Noise, data: Data,
    settings: Settings,
) -> Posed:  # fmt: skip
    """Problem of whitened impulse responses of the used sensors and whitened data."""
    settings.refuse_special("Toeplitz")
    used, samples, penalty = h[:, data.rows], len(values), settings.penalty
    assert isinstance(penalty, str)
    weight = (~missing).astype(float) if missing.any() else None
    pieces = settings.path == "windows" or (settings.path == "auto" and samples > WHOLE and weight is None)
    h_white = heard(h_white)
    path = (WindowedPath if pieces else ConvolvedPath)(h_white, y_white, penalty, weight)
    judged = (beginning_of(path) or path) if pieces else path
    forward = Stream(heard(used))

    def compare(load: NDArray, lam: float, start: NDArray | None) -> tuple[NDArray, NDArray]:
        predicted = forward.whole(load.T).T
        shown = np.where(missing, predicted, values)
        return shown, shown - predicted

    full = None
    if len(data.rows) < h.shape[1]:
        size = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = _layout(h / np.where(size > 0, size, 1.0)[:, None], samples)

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        return NonNegativeRecord.convolved(h_white, y_white, penalty, weight=weight, signed=signed)

    n = path.unknowns
    name = "Toeplitz, in windows" if pieces else "Toeplitz, preconditioned CG"
    visible = _layout(h_white, samples)
    return Posed(path, noise, compare, values, name, used, visible, full, n, judged, pushing)


def convolved_measured(model: Model, data: Data, settings: Settings) -> Posed:
    """The same for a measured model, its noise made white in time; with gaps, at its mean level.

    Raises
    ------
    InputError
        As `convolved`, and a record of another step.
    """
    if not isinstance(settings.penalty, str):
        raise InputError("the Toeplitz path takes a named penalty", where="penalty", found="a matrix or None",
                         expected=f"one of {names()}; a matrix goes by path='dense'")  # fmt: skip
    if data.missing.any():
        h, line_noise = measured_response(model, data, settings)
        level = np.sqrt(np.mean(line_noise.power, axis=0) / len(data.values))
        noise = Noise(level, line_noise.known, line_noise.source)
        return convolved(h, data.values, data.missing, noise, data, settings)
    white = coloured(model, data, settings)
    return _posed(white.raw, white.h, white.y, data.values, data.missing, white.noise, data, settings)


def _layout(h: NDArray, samples: int) -> tuple[float, int, int]:
    """Condition number, rank and nullity by the lines of a padded transform of impulse responses."""
    h = heard(h)
    values = np.linalg.svd(Convolution(h, min(samples, max(len(h), FEW))).lines, compute_uv=False)
    seen = values > LAYOUT * values.max()
    unknowns = samples * h.shape[2]
    rank = round(unknowns * float(np.sum(seen)) / values.size)
    return float(values.max() / values[seen].min()), rank, max(unknowns - rank, 0)
