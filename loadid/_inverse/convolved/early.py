"""The place of a load by the first part of its response, where errors of the model have not grown yet.

An error of a frequency turns the phase of its mode in proportion to the time since the load began: after some cycles
the response is as far from the model as from that of another place, and a history that may be anything explains it at
the wrong one. Before the load everything rests, and in the first periods the model is near. In a window from just
before the onset the history is free: white, of zero mean, its variance that of the largest evidence; errors of the
model are noise in proportion to the energy of each channel, and their share has the largest evidence too.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..ascent import highest
from ..problem import toeplitz

Array = NDArray[np.float64]
BEFORE, AFTER = 10, 32  # samples about the onset that are used
REST = 128  # samples before the onset that show that everything rested
SMOOTH = 4  # samples over which the energy is averaged to find the onset
LOUD, QUIET = 0.02, 6.0  # of the largest energy, and times that of the noise: an onset is above both
CALM = 64  # samples whose least mean energy is that of a noise that is not known
ENERGY = 16  # samples over which the energy of a channel is averaged
SHARES = (0.003, 0.01, 0.03, 0.1, 0.2)  # of the energy, that are errors of the model: relative std
VARIANCES = np.logspace(-4, 8, 25)  # of the history, in units of the noise over the largest singular value
LEAST = 1e-8  # of the mean square of a channel, that is noise
STARTS, ROUGH = 3, 10.0  # candidates from which the place is refined, times the tolerance of a place that is the last


@dataclass(frozen=True, eq=False)
class EarlyResponse:
    """The data about the onset.

    Parameters
    ----------
    onset : int
        Sample of the record.
    y : array, shape (n, sensors)
        Whitened data.
    noise : array, shape (sensors,)
        Variances.
    power : array, shape (n, sensors)
        Energy of the response.
    """

    onset: int
    y: Array
    noise: Array
    power: Array

    @property
    def part(self) -> slice:
        """Samples of the record from rest to the end of the data."""
        return slice(max(self.onset - REST, 0), self.onset + AFTER)

    def evidence(self, h: Array) -> float:
        """Log likelihood of the data by a load with these impulse responses (n, sensors), up to a constant."""
        H = toeplitz(h[:, :, None]).reshape(self.y.size, -1)
        return max(self._at(H, share) for share in SHARES)

    def _at(self, H: Array, share: float) -> float:
        std = np.sqrt(self.noise + share**2 * self.power).ravel()
        U, s, _ = np.linalg.svd(H / std[:, None], full_matrices=False)
        data = self.y.ravel() / std
        told = U.T @ data
        spread = 1 + VARIANCES[:, None] * (s / max(s[0], np.finfo(float).tiny)) ** 2
        explained = np.sum(told**2 * (1 - 1 / spread) - np.log(spread), axis=1)
        return float(0.5 * np.max(explained) - 0.5 * data @ data - np.sum(np.log(std)))


def early_response(y: Array, noise2: float | None) -> EarlyResponse | None:
    """The data about the onset of a whitened record (samples, sensors); None where nothing begins in it.

    Parameters
    ----------
    y : array
    noise2 : float or None
        Variance of its noise where it is known; else that before the onset.
    """
    energy = np.mean(y**2, axis=1)
    calm = float(_averaged(energy, CALM).min()) if noise2 is None else noise2
    energy = _averaged(energy, SMOOTH)
    loud = energy > max(LOUD * energy.max(), QUIET * calm)
    onset = int(np.argmax(loud))
    first = max(onset - BEFORE, 0)
    if not loud[onset] or (noise2 is None and first < SMOOTH):
        return None
    window = y[first : onset + AFTER]
    noise = np.mean(y[:first] ** 2, axis=0) if noise2 is None else np.full(y.shape[1], noise2)
    noise = np.maximum(noise, LEAST * np.mean(window**2, axis=0))
    power = np.maximum(np.apply_along_axis(_averaged, 0, window**2, ENERGY) - noise, 0.0)
    return EarlyResponse(onset, window, noise, power)


def early_places(
    early: EarlyResponse, places: Array, h: Array, responses: Callable[[Array, int], Array], box: Array, spacing: float
) -> list[tuple[float, Array]]:
    """Evidence and place (dim,) from the likeliest candidates, refined; the best first.

    Parameters
    ----------
    early : EarlyResponse
    places : array, shape (candidates, dim)
    h : array, shape (samples, sensors, candidates)
        Their whitened impulse responses.
    responses : callable
        Places (n, dim) and samples -> whitened impulse responses (samples, sensors, n).
    box : array, shape (dim, 2)
        Bounds.
    spacing : float
        Of the candidates.
    """
    samples = len(early.y)

    def evidence(at: Array) -> float:
        return early.evidence(responses(at[None], samples)[..., 0])

    told = np.array([early.evidence(h[:samples, :, j]) for j in range(len(places))])
    starts = np.argsort(-told, kind="stable")[:STARTS]
    found = [highest(evidence, np.clip(places[j], *box.T), box, spacing, rough=ROUGH) for j in starts]
    return sorted(found, key=lambda one: -one[0])


def _averaged(x: Array, width: int) -> Array:
    """Mean over so many samples, or as many as there are at the ends."""
    ones = np.ones(min(width, len(x)))
    return np.asarray(np.convolve(x, ones, "same") / np.convolve(np.ones(len(x)), ones, "same"))
