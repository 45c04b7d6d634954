"""A tone in what should be noise: hum of the mains or of a machine, in the part of a record before its response.

One sine and a constant are fitted by least squares at the frequency that explains most; under white noise the share of
the power that this takes follows Fisher's test of the largest ordinate (P. J. Brockwell, R. A. Davis, *Time Series:
Theory and Methods*, section 10.2). Correlated noise has its power in many lines, hence the share that is asked for.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

CYCLES = 3.0  # in the part, below which a tone cannot be told from drift
SHARE = 0.6  # of the power of the part
CERTAIN = 25.0  # power of the tone over twice that of a degree of freedom of the rest: exp(-25) for each frequency
FINER = 8  # frequencies tried for each line of the part


class Tone(NamedTuple):
    """Frequency (Hz), amplitude in the unit of the samples, and share of the power of the part."""

    frequency: float
    amplitude: float
    share: float


def tone(part: NDArray[np.float64], dt: float) -> Tone | None:
    """The tone that makes up most of a part, or None.

    Parameters
    ----------
    part : array (samples,)
        Without gaps.
    dt : float
        Step in s.
    """
    n, y = len(part), part - part.mean()
    power = float(y @ y)
    if n < 8 * CYCLES or not power > 0:
        return None
    spectrum = np.abs(np.fft.rfft(y, FINER * n)) ** 2
    lines = np.arange(len(spectrum)) / FINER  # cycles in the part
    inside = (lines >= CYCLES) & (lines <= 0.45 * n)
    if not inside.any():
        return None
    cycles = float(lines[inside][np.argmax(spectrum[inside])])
    angle = 2 * np.pi * cycles / n * np.arange(n)
    basis = np.stack([np.cos(angle), np.sin(angle), np.ones(n)], axis=1)
    weight = np.linalg.lstsq(basis, y, rcond=None)[0]
    rest = float(np.sum((y - basis @ weight) ** 2))
    share = 1 - rest / power
    if share < SHARE or (n - 4) * (power - rest) < 2 * CERTAIN * rest:
        return None
    return Tone(cycles / (n * dt), float(np.hypot(*weight[:2])), share)
