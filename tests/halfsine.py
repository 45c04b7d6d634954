"""The half-sine impact benchmark: a free beam struck at one end and read at the other, pulses of known shape and width.

Six bending modes of a uniform beam with free ends, 62 to 1158 Hz (frequencies go with the squares of the roots of
``cosh b cos b = 1``), damping ratios 1.5 % falling to 1 %, displacement, 10240 Hz, first-order hold. Between the two
ends the residues are equal in size and alternate in sign. A record holds three pulses, in 2000 samples.

The design is the one that reproduces best the figures which are known of the benchmark (tests/benchmarks/nonnegative.py
prints them): relative load error of Tikhonov with L = I at the best lambda .127 / .246 for 41 samples and 1 / 5 %
noise, .623 / .763 for 3 samples.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from structures import StateSpace
from structures._models.discretise import blocks

RATE, SAMPLES = 10240.0, 2000
ROOTS = np.array([4.730040745, 7.853204624, 10.995607838, 14.137165491, 17.278759657, 20.420352246])
FREQUENCIES = 62.13 * (ROOTS / ROOTS[0]) ** 2
DAMPING = np.linspace(0.015, 0.010, 6)
SIGNS = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
STARTS, PEAKS = (200, 900, 1500), (1.0, 0.6, 0.8)
WIDTHS, NOISES = (3, 11, 41), (0.01, 0.05)


def system(hold: str = "foh") -> StateSpace:
    """One load, one displacement sensor, 12 states."""
    omega = 2 * np.pi * FREQUENCIES
    modes = blocks(omega**2, 2 * DAMPING * omega, 1 / RATE, hold)
    A = np.zeros((12, 12))
    for k in range(6):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = modes.A[k]
    C = (SIGNS[:, None] * modes.c).reshape(1, 12)
    return StateSpace(A, modes.B.reshape(12, 1), C, [[SIGNS @ modes.D]], 1 / RATE, hold)


def impulse_response(samples: int = SAMPLES) -> NDArray[np.float64]:
    """Response (samples,) to a unit load at the first sample."""
    return system().impulse_response(1 / RATE, samples)[:, 0, 0]


def pulses(width: int, samples: int = SAMPLES) -> NDArray[np.float64]:
    """The load (samples,): half-sines of `width` samples, three of them in every 2000 samples."""
    shape = np.sin(np.pi * (np.arange(width) + 0.5) / width)
    g = np.zeros(samples)
    for begin in range(0, samples, SAMPLES):
        for start, peak in zip(STARTS, PEAKS, strict=True):
            place = slice(begin + start, min(begin + start + width, samples))
            g[place] += peak * shape[: max(0, place.stop - place.start)]
    return g


def respond(g: NDArray) -> NDArray[np.float64]:
    """Displacement (samples,) under the load g (samples,)."""
    from scipy.signal import oaconvolve

    return oaconvolve(impulse_response(min(len(g), 40_000)), g)[: len(g)]


def level(clean: NDArray, noise: float) -> float:
    """Standard deviation of the noise: a share of the rms of the response."""
    return noise * float(np.sqrt(np.mean(clean**2)))


def record(
    width: int, noise: float, seed: int, samples: int = SAMPLES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Noisy displacement (samples,) and the load (samples,) that made it.

    Parameters
    ----------
    width : int
        Samples per pulse: 3, 11 or 41 in the benchmark.
    noise : float
        Standard deviation of the white noise over the rms of the response: 0.01 or 0.05 in the benchmark.
    seed : int
    samples : int
        Longer records repeat the three pulses every 2000 samples.
    """
    g = pulses(width, samples)
    clean = respond(g)
    return clean + level(clean, noise) * np.random.default_rng(seed).standard_normal(samples), g
