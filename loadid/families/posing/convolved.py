"""The Toeplitz path: impulse responses of any model, any length, right at both ends of the record."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.measured import MeasuredModel

from ...inverse.convolution import Convolution
from ...inverse.convolved.path import ConvolvedPath
from ...inverse.nonnegative.solver import NonNegativeRecord
from ...inverse.whitening import whiten
from ..data import Data
from ..noise import Noise
from .coloured import coloured
from .lines import measured_response
from .posed import Posed, Settings

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
                         expected="identity, first_difference or second_difference")  # fmt: skip
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
    path = ConvolvedPath(h_white, y_white, penalty, weight)
    forward = Convolution(used, samples)

    def compare(load: NDArray, lam: float, start: NDArray | None) -> tuple[NDArray, NDArray]:
        predicted = forward.apply(load)
        shown = np.where(missing, predicted, values)
        return shown, shown - predicted

    full = None
    if len(data.rows) < h.shape[1]:
        size = np.sqrt(np.mean(h**2, axis=(0, 2)))
        full = _layout(Convolution(h / np.where(size > 0, size, 1.0)[:, None], samples))
    layout = _layout(Convolution(h_white, samples))

    def pushing(signed: ArrayLike | None) -> NonNegativeRecord:
        return NonNegativeRecord.convolved(h_white, y_white, penalty, weight=weight, signed=signed)

    n = path.unknowns
    return Posed(path, noise, compare, values, "Toeplitz, preconditioned CG", used, layout, full, n, path, pushing)


def convolved_measured(model: MeasuredModel, data: Data, settings: Settings) -> Posed:
    """The same for a measured model, its noise made white in time; with gaps, at its mean level.

    Raises
    ------
    InputError
        As `convolved`, and a record of another step.
    """
    if not isinstance(settings.penalty, str):
        raise InputError("the Toeplitz path takes a named penalty", where="penalty", found="a matrix or None",
                         expected="identity, first_difference or second_difference")  # fmt: skip
    if data.missing.any():
        h, line_noise = measured_response(model, data, settings)
        level = np.sqrt(np.mean(line_noise.power, axis=0) / len(data.values))
        noise = Noise(level, line_noise.known, line_noise.source)
        return convolved(h, data.values, data.missing, noise, data, settings)
    white = coloured(model, data, settings)
    return _posed(white.raw, white.h, white.y, data.values, data.missing, white.noise, data, settings)


def _layout(operator: Convolution) -> tuple[float, int, int]:
    """Condition number, rank and nullity by the lines of the padded transform."""
    values = np.linalg.svd(operator.lines, compute_uv=False)
    seen = values > LAYOUT * values.max()
    unknowns = operator.samples * operator.loads
    rank = round(unknowns * float(np.sum(seen)) / (len(values) * operator.loads))
    return float(values.max() / values[seen].min()), rank, max(unknowns - rank, 0)
