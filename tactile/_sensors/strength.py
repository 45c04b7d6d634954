"""How strong a press is beside those that lambda was chosen on: lambda goes with it, from frame to frame.

Under a contact prior lambda is the std of the noise over the size that loads are expected to have. One for presses
that differ in size smooths the strong ones away, or lets noise into the weak ones. The size of a frame is that of the
largest evidence: readings over their noise, turned to the axes of what loads and errors of the model make of them, have
variances ``w / x^2 + 1``, of which x is the only unknown (D. J. C. MacKay, Neural Comput. 4 (1992) 415).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .._arrays import Array

STEP = 1.5  # between two lambdas: the error of a map hardly changes over it
MOST = 7  # steps from the lambda of the calibration
FINE = 0.1  # log x, between two at which the evidence is asked
ROOM = 12.0  # log x, below the largest singular value and its like above


@dataclass(frozen=True, eq=False)
class PressStrength:
    """Sizes of presses by their readings over their noise (m,), beside that of the frames of a calibration.

    `axes` (m, m) and `variances` (m,) are those of what loads of a unit of prior variance make of the readings;
    `usual` is the x of these frames.
    """

    axes: Array
    variances: Array
    usual: float

    @classmethod
    def of(cls, made: Array, frames: Sequence[Array]) -> PressStrength:
        """From the covariance (m, m) of whitened readings under loads of unit prior variance, and such readings."""
        w, V = np.linalg.eigh(made)
        w = np.maximum(w, 0.0)
        return cls(V, w, _likeliest(w, np.array([V.T @ z for z in frames])))

    def steps(self, z: Array) -> int:
        """Steps by which lambda of a frame is larger (m,) than that of the calibration: weaker presses have more."""
        ratio = _likeliest(self.variances, (self.axes.T @ z)[None]) / self.usual
        return int(np.clip(round(np.log(ratio) / np.log(STEP)), -MOST, MOST))


def _likeliest(w: Array, on: Array) -> float:
    """The x of largest evidence of readings (frames, m) along their axes, of variances w / x^2 + 1."""
    top = np.log(w[-1]) / 2
    x = np.exp(np.arange(top - ROOM, top + ROOM / 4, FINE))
    variance = w / x[:, None] ** 2 + 1
    log = -0.5 * (np.sum(on**2, axis=0) @ (1 / variance).T + len(on) * np.sum(np.log(variance), axis=1))
    return float(x[int(np.argmax(log))])
