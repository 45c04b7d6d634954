"""How far each sensor of a single-hit model can be believed, told by the test record itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from structures.spectra import smooth_lines

LOCAL = 5  # lines on each side
EXPECTED_LOG = np.exp(np.euler_gamma)  # mean over geometric mean of an exponential variable: the periodogram's scatter


@dataclass(frozen=True)
class Roughness:
    """Error energy (lines, sensors) of the load spectrum that each sensor gives alone.

    Parameters
    ----------
    typical : array
        Geometric mean over a wide band: for weights, where a single antiresonance must not speak for its neighbours.
    local : array
        Arithmetic mean over a few lines: for the band of uncertainty, where every line counts.
    relative : array
        `typical` over the power of the load.
    """

    typical: NDArray[np.float64]
    local: NDArray[np.float64]
    relative: NDArray[np.float64]


def roughness(G: NDArray, band: float = 1 / 16) -> Roughness:
    """Error of the load spectrum that each sensor gives alone, from its roughness over the lines.

    A load that lasts a small part of the record has a spectrum that is smooth from line to line once it is shifted to
    its own time; what is rough is error. The second difference over lines keeps the noise that fills the record, by
    a known factor, and removes the load.

    Parameters
    ----------
    G : array, shape (lines, sensors)
        Load spectrum of each sensor alone, padded to twice the record.
    band : float
        Share of all lines on each side over which the typical error is averaged.
    """
    padded = 2 * (len(G) - 1)
    g = np.fft.irfft(G, axis=0)[: padded // 2]
    best = int(np.argmax(np.max(np.abs(g), axis=0) / np.maximum(np.median(np.abs(g), axis=0), np.finfo(float).tiny)))
    start = int(np.argmax(np.abs(g[:, best])))
    shift = np.exp(2j * np.pi * np.arange(len(G)) * start / padded)
    # the second difference multiplies sample t by 4 sin^2(pi t / padded): what is left of noise that fills the record
    kept = np.mean((2 * np.sin(np.pi * (np.arange(padded // 2) - start) / padded)) ** 4)
    rough = np.abs(np.diff(G * shift[:, None], n=2, axis=0)) ** 2 / kept
    rough = np.concatenate([rough[:1], rough, rough[-1:]])
    half = max(1, round(band * len(G)))
    tiny = np.finfo(float).tiny
    typical = np.exp(smooth_lines(np.log(np.maximum(rough, tiny)), half)) * EXPECTED_LOG
    power = np.exp(smooth_lines(np.log(np.maximum(np.abs(G[:, best]) ** 2, tiny)), half))
    return Roughness(typical, smooth_lines(rough, LOCAL), typical / power[:, None])
