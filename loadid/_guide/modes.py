"""What a record can tell of load histories, line by line: rank and Picard of a convolution.

The singular vectors of a convolution over a record are those of its frequency lines, so that each line has the singular
values of its FRF; what of the response lies beyond the record, the estimate adds, folded back to its start. Data
coefficients of all lines, in order of falling singular values, are a Picard plot of the record (P. C. Hansen, Discrete
Inverse Problems, SIAM 2010, ch. 3). A load need not fall with the singular values of its lines: a blow has most where
an accelerometer sees least. So modes are counted that stand above a noise that is known; where it is not, the plateau
of the coefficients is looked for, as in all families.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .._inverse.diagnosis.picard import plateau

if TYPE_CHECKING:
    from structures._model import Model

Array = NDArray[np.float64]
CHANCE = 0.01  # that noise alone makes a coefficient so large


@dataclass(frozen=True)
class LineModes:
    """Modes of the lines of a record, two real ones for each complex one.

    Parameters
    ----------
    unknowns, rank, recoverable : int
        Numbers of the load on these lines; those that reach a sensor; those above the noise, i*.
    floor : float
        Level of the noise in the coefficients, relative to the largest; 0 where they fall to the end.
    condition : float
        Largest over smallest singular value that is seen.
    singular_values, coefficients : array
        Relative to the largest, in order of falling singular values.
    """

    unknowns: int
    rank: int
    recoverable: int
    floor: float
    condition: float
    singular_values: Array
    coefficients: Array

    @property
    def nullity(self) -> int:
        """Numbers of the load that leave no trace."""
        return self.unknowns - self.rank


def line_modes(model: Model, values: Array, dt: float, noise: Array | None, load: Array) -> LineModes:
    """Modes of a record (samples, sensors) of a model with histories.

    Parameters
    ----------
    values : array (samples, sensors)
        A missing sample is taken as zero.
    dt : float
        Step in s.
    noise : array (sensors,), optional
        Std by which the sensors weigh; without it the rms of each.
    load : array (samples or fewer, loads)
        The estimate: what it makes beyond the end of the record is added.
    """
    samples = len(values)
    table = np.where(np.isnan(values), 0.0, values)
    twice = np.zeros((2 * samples, len(model.loads)))
    twice[: len(load)] = load
    table = table + model.predict(twice, dt)[samples:]
    h = model.impulse_response(dt, 2 * samples, model.default_hold)
    h = h[:samples] + h[samples:]
    size = np.sqrt(np.mean(table**2, axis=0)) if noise is None else np.asarray(noise, float)
    weight = 1 / np.where(size > 0, size, 1.0)
    H = np.fft.rfft(h * weight[:, None], axis=0)
    Y = np.fft.rfft(table * weight, axis=0)
    u, s, _ = np.linalg.svd(H, full_matrices=False)
    beta = np.abs(np.einsum("lmi,lm->li", u.conj(), Y))
    single = np.zeros(len(H), bool)  # lines that hold one real number and not two
    single[0] = True
    single[-1] = samples % 2 == 0
    times = np.broadcast_to(np.where(single, 1, 2)[:, None], s.shape)
    seen = s > max(samples, H.shape[1]) * np.finfo(float).eps * s.max(initial=0.0)
    order = np.argsort(-s[seen], kind="stable")
    sigma, coefficients, weight_of = s[seen][order], beta[seen][order], times[seen][order]
    if noise is None:
        found = plateau(coefficients, frames=2)
        recoverable, floor = int(weight_of[: found.start].sum()), found.floor
    else:  # |u^H Y|^2 of white noise of std 1 is exponential, of mean `samples`
        recoverable = int(weight_of[coefficients**2 > -np.log(CHANCE) * samples].sum())
        floor = float(np.sqrt(samples))
    top, loudest = float(sigma[0]), float(coefficients.max(initial=0.0))
    return LineModes(
        unknowns=samples * H.shape[2],
        rank=int(weight_of.sum()),
        recoverable=recoverable,
        floor=floor / loudest if loudest > 0 else 0.0,
        condition=top / float(sigma[-1]),
        singular_values=sigma / top,
        coefficients=coefficients / loudest if loudest > 0 else coefficients,
    )
