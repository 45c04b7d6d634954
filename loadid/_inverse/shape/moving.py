"""Coefficients of a field over time, with their first and second derivatives, by the house's filters and smoothers.

Each direction of a singular value decomposition is one series of data in white noise, whose amplitude is believed to be
a Matern process with three derivatives (nu = 7/2): its states are the amplitude, rate, acceleration and jerk, so that
the smoother answers derivatives with their covariance, and nothing is differenced.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, toeplitz
from scipy.optimize import minimize_scalar

from ..gaussian.model import FilterModel
from ..gaussian.records import filter_record, log_density, smooth_record
from ..gaussian.roots import step
from ..gaussian.steady import steady

Array = NDArray[np.float64]
STATES, POLE = 4, np.sqrt(7)
UNIT = np.array([[0.0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [-1, -4, -6, -4]])  # (d/dt + 1)^4
DENSITY = (
    16 * 2 / 5 * np.sqrt(1.0)
)  # of the white noise at which the amplitude has variance 1: 2^(2n-1) ((n-1)!)^2/(2n-2)!
COVARIANCE = np.array([[1, 0, -1 / 5, 0], [0, 1 / 5, 0, -1 / 5], [-1 / 5, 0, 1 / 5, 0], [0, -1 / 5, 0, 1.0]])
FAINT = 0.05  # amplitude over noise, over all samples of a length, below which a direction keeps its prior
PAIRS = np.array([[0, 1], [0, 2], [1, 2]])
SHORT = 3  # samples of the shortest length


@dataclass(frozen=True, eq=False)
class Motion:
    """Amplitude, rate and acceleration of every direction.

    Parameters
    ----------
    mean : array, shape (samples, directions, 3)
    covariance : array, shape (samples, directions, 3, 3)
    prior : array, shape (3, 3)
        Covariance of a direction that nothing is heard of.
    length : float
        Correlation length in s.
    """

    mean: Array
    covariance: Array
    prior: Array
    length: float


def _model(gain: float, size: float, length: float, dt: float) -> tuple[FilterModel, Array]:
    """Filter of one direction, states in multiples of the size and the pole; and the size of each derivative."""
    rate = POLE / length
    F, LQ = step(UNIT, np.array([[0.0], [0], [0], [np.sqrt(DENSITY)]]), rate * dt)
    reads = np.eye(3, STATES)
    Cp = np.vstack([reads, [reads[i] + reads[j] for i, j in PAIRS]])
    root = np.linalg.cholesky(COVARIANCE)
    model = FilterModel(
        F=F, LQ=LQ, H=gain * size * np.eye(1, STATES), LR=np.eye(1), Cp=Cp, x0=np.zeros(STATES), L0=root, nx=0
    )
    return model, size * rate ** np.arange(3)


def correlation_length(data: Array, gains: Array, size: float, dt: float) -> float:
    """Length (s) of the largest likelihood of the loudest directions; data (samples, directions) in unit noise."""
    loud = np.argsort(-np.mean(data**2, axis=0))[:6]

    def unlikely(log_length: float) -> float:
        total = 0.0
        for k in loud:
            model, _ = _model(float(gains[k]), size, float(np.exp(log_length)), dt)
            total -= float(np.sum(log_density(model, data[:, k : k + 1], steady(model, dt))))
        return total

    low, high = np.log(SHORT * dt), np.log(2 * len(data) * dt)
    grid = np.linspace(low, high, 9)
    best = int(np.argmin([unlikely(x) for x in grid]))
    around = (grid[max(best - 1, 0)], grid[min(best + 1, 8)])
    found = minimize_scalar(unlikely, bounds=around, method="bounded", options={"xatol": 0.05})
    return float(np.exp(found.x))


def accelerating(size: float, length: float, dt: float, samples: int) -> tuple[Array, Array]:
    """Smoother (samples, samples) from one series in unit noise to its second derivative, and the variance of this.

    The same process, by its covariances: for many series of one size and length at once.
    """
    rate = POLE / length
    F, _ = step(UNIT, np.array([[0.0], [0], [0], [np.sqrt(DENSITY)]]), rate * dt)
    lagged = [COVARIANCE]
    for _ in range(samples - 1):
        lagged.append(F @ lagged[-1])
    lags = size**2 * np.array(lagged)
    read, bent = (toeplitz(lags[:, k, 0]) for k in (0, 2))
    S = cho_solve(cho_factor(read + np.eye(samples)), bent).T
    return rate**2 * S, rate**4 * (lags[0, 2, 2] - np.sum(S * bent, axis=1))


def smoothed(data: Array, gains: Array, size: float, dt: float, length: float | None = None) -> Motion:
    """Every direction smoothed: data (samples, directions) in unit noise, ``data = gain * amplitude``.

    Parameters
    ----------
    data : array, shape (samples, directions)
    gains : array, shape (directions,)
    size : float
        Std that is believed of every amplitude.
    dt : float
        s.
    length : float, optional
        Correlation length (s); by likelihood where not given.
    """
    samples, count = data.shape
    length = correlation_length(data, gains, size, dt) if length is None else length
    units = size * (POLE / length) ** np.arange(3)
    prior = COVARIANCE[:3, :3] * np.outer(units, units)
    mean = np.zeros((samples, count, 3))
    covariance = np.broadcast_to(prior, (samples, count, 3, 3)).copy()
    heard = gains * size * np.sqrt(max(length / dt, 1.0)) > FAINT
    for k in np.flatnonzero(heard):
        model, units = _model(float(gains[k]), size, length, dt)
        found = smooth_record(filter_record(model, data[:, k : k + 1], steady(model, dt)))
        mean[:, k] = found.load[:, :3] * units
        var = found.std**2
        C = np.zeros((samples, 3, 3))
        C[:, range(3), range(3)] = var[:, :3]
        for n, (i, j) in enumerate(PAIRS):
            C[:, i, j] = C[:, j, i] = 0.5 * (var[:, 3 + n] - var[:, i] - var[:, j])
        covariance[:, k] = C * np.outer(units, units)
    return Motion(mean, covariance, prior, length)
