"""A measured model and a record whose noise has been made white in time: impulse responses that any path takes.

The noise of a measured model differs from line to line, and its FRFs err by a share of the load's own spectrum. Both
are put into one spectrum per sensor, and record and impulse responses pass the causal filter that makes it flat: what
was causal stays so, and what lies beyond the end of the record does not matter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from structures.model import Model
from structures.spectra import minimum_phase, smooth_lines

from ...inverse.convolved.path import ConvolvedPath
from ...inverse.streamed import heard
from ...inverse.windowed import WindowedPath
from ..data import Data
from ..noise import Noise
from .lines import measured_response
from .posed import WHOLE, Settings

PILOT = 1e-2  # relative lambda of the first estimate
NEIGHBOURS = 20  # lines to either side over which the power of the load is averaged
RANGE = 1e-12  # of the largest noise power: weaker lines are not believed


@dataclass(frozen=True)
class Coloured:
    """Impulse responses of all sensors (taps, sensors, loads), whitened ones of the used sensors, whitened data.

    The level of `noise` is that of the mean over all lines.
    """

    raw: NDArray[np.float64]
    h: NDArray[np.float64]
    y: NDArray[np.float64]
    noise: Noise


def coloured(model: Model, data: Data, settings: Settings) -> Coloured:
    """Whiten a record and its measured model in time.

    Raises
    ------
    InputError
        A record of another step, or an FRF that is not causal.
    """
    raw, noise = measured_response(model, data, settings)
    power = noise.power / len(data.values)
    h, y = _whitened(raw[:, data.rows], data.values, power)
    variance = model.frf_variance(np.linspace(0, 0.5 / float(model.dt or data.dt), len(power)))
    if variance is not None:
        # the errors of the FRFs are in proportion to the load, of which a first estimate knows the power
        load = (WindowedPath if len(y) > WHOLE else ConvolvedPath)(heard(h), y).solution(PILOT, None).load
        size = smooth_lines(np.abs(np.fft.rfft(load, 2 * (len(power) - 1), axis=0)) ** 2, NEIGHBOURS)
        power = power + np.einsum("ksl,kl->ks", variance[:, data.rows], size) / len(data.values)
        h, y = _whitened(raw[:, data.rows], data.values, power)
    level = np.sqrt(np.mean(power, axis=0))
    source = replace(noise.source, text=f"{noise.source}, with the errors of the FRFs, white in time", white=True)
    return Coloured(raw, h, y, Noise(level, noise.known, source))


def _whitened(h: NDArray, y: NDArray, power: NDArray) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Impulse responses (taps, sensors, loads) and data (samples, sensors) after the filter of each sensor."""
    from scipy import fft

    samples, padded = len(y), 2 * (len(power) - 1)
    W = minimum_phase(1 / np.sqrt(np.maximum(power, RANGE * power.max(axis=0))))
    white = fft.irfft(fft.rfft(h, padded, axis=0) * W[..., None], padded, axis=0)[:samples]
    return white, fft.irfft(fft.rfft(y, padded, axis=0) * W, padded, axis=0)[:samples]
