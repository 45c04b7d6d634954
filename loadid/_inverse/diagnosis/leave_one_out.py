"""Every sensor predicted from all others, exactly, by one factorisation.

Whitened data of lines (one line of a static problem, many of a spectrum) are ``y = H g + n``. The precision of the
data once the loads are integrated out, ``K = W Z (1 + tau E)^-1 Z^H W``, holds every leave-one-out residual: that of
sensor i is ``(K y)_i / K_ii`` with variance ``1 / K_ii`` (Cook & Weisberg, Residuals and Influence in Regression,
1982).

A model is wrong by some per cent, always, and a wrong gain is wrong by as much on every line. So the variance of a
sensor is that of its noise and ``delta^2`` of its response, and what stands for the error of the model is counted as
one value, not as many as there are lines. `delta` is a floor: the misfit of the others raises it where they show more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
Real = NDArray[np.float64]

FLOOR = 0.03  # relative error that every model is taken to have
BELIEF = 4.0  # values that this floor is worth beside those of the spare sensors
LEVEL = 0.002  # chance that a sound record accuses a sensor, over all sensors
TINY = 1e-12  # gain of a sensor that reads nothing
SEEN = 1e-9  # of the precision of a sensor alone: below, the others say nothing about it


@dataclass(frozen=True, eq=False)
class SensorLines:
    """What sensors read, and what each load makes them read.

    Parameters
    ----------
    H : array, shape (lines, sensors, loads)
    y : array, shape (lines, sensors, snapshots)
    noise : array, shape (lines, sensors)
        Variance of the noise of y; where it is not known, of the same shape over the sensors.
    size : array, shape (lines, sensors)
        Variance of y that errors of the model are measured by.
    known : bool
        The noise is known.
    worth : float
        Independent real values of one snapshot of one line.
    spread : array, shape (loads, loads), optional
        Covariance of the loads up to a factor; None: any load is as likely as any other.
    free : array, shape (loads, k), optional
        Loads that the prior does not hold, beside `spread`.
    """

    H: Array
    y: Array
    noise: Real
    size: Real
    known: bool
    worth: float
    spread: Real | None = None
    free: Real | None = None

    @property
    def sensors(self) -> int:
        """Number of them."""
        return int(self.y.shape[1])

    @property
    def spare(self) -> int:
        """Sensors beyond what fixes the loads without any prior."""
        held = self.H.shape[2] if self.spread is None else 0 if self.free is None else self.free.shape[1]
        return self.sensors - held

    def of(self, keep: Sequence[int]) -> SensorLines:
        """The lines of some sensors."""
        k = list(keep)
        return replace(self, H=self.H[:, k], y=self.y[:, k], noise=self.noise[:, k], size=self.size[:, k])

    def on(self, pick: NDArray[np.bool_]) -> SensorLines:
        """Some of the lines."""
        return replace(self, H=self.H[pick], y=self.y[pick], noise=self.noise[pick], size=self.size[pick])

    def swapped(self, i: int, j: int) -> SensorLines:
        """As if the plugs of two sensors were exchanged: channels stay as they are, and read the other's place."""
        order = list(range(self.sensors))
        order[i], order[j] = j, i
        return replace(self, H=self.H[:, order])


@dataclass(frozen=True, eq=False)
class LeftOut:
    """Every sensor beside its prediction from all others.

    Parameters
    ----------
    rest : array, shape (lines, sensors, snapshots)
        Reading less prediction.
    precision : array, shape (lines, sensors)
        Inverse variance of `rest`; 0 where the others say nothing.
    misfit : float
        Of all sensors together, whitened.
    scale : float
        Factor on the variance that the misfit shows, on all lines or on those where errors of the model count.
    limit : array, shape (sensors,)
        Misfit of each sensor that chance and errors of the model leave, where the variance is as stated.
    excess : array, shape (sensors,)
        Misfit of each over that limit, at the variance that the others show; beyond 1 a sensor stands out.
    tau : float
        Variance of the loads over that of their prior.
    cost : float
        -2 log evidence of the readings under that prior; 0 without one.
    K : array, shape (lines, sensors, sensors)
        Precision of the readings with the loads integrated out.
    dims : int
        Its rank.
    silent : array, shape (sensors,)
        Misfit over its limit that each would have if it read nothing where the others predict what they do: below 1
        they do not determine it, and hardly anything that is wrong with it can be seen.
    """

    rest: Array
    precision: Real
    misfit: float
    scale: float
    limit: Real
    excess: Real
    tau: float
    cost: float
    K: Array
    dims: int
    silent: Real


def left_out(lines: SensorLines, delta: float, tau: float | None = None) -> LeftOut:
    """Predict every sensor from all others, where errors of the model are `delta` of the response.

    Parameters
    ----------
    tau : float, optional
        Variance of the loads over that of their prior; default the likeliest.
    """
    return predicted(lines, delta, *precision_of(lines, lines.noise + delta**2 * lines.size, tau))


def predicted(lines: SensorLines, delta: float, K: Array, dims: int, tau: float, cost: float) -> LeftOut:
    """Every sensor from all others, with the precision of the readings, its rank, and what it was chosen by."""
    variance = lines.noise + delta**2 * lines.size
    diagonal = np.einsum("kii->ki", K).real
    told = diagonal * variance > SEEN
    precision = np.where(told, diagonal, 0.0)
    Ky = K @ lines.y
    rest = np.divide(Ky, diagonal[..., None], out=np.zeros(Ky.shape, Ky.dtype),
                     where=np.broadcast_to(told[..., None], Ky.shape))  # fmt: skip
    errors, weights = delta**2 * lines.size, np.abs(K) ** 2
    # share of the variance of a prediction that is error of the model, not noise
    share = np.einsum("kij,kj->ki", weights, errors) / np.maximum(np.einsum("kij,kj->ki", weights, variance), 1e-300)
    per_line = lines.worth * lines.y.shape[2]
    own = lines.worth * precision * np.sum(np.abs(rest) ** 2, axis=2)
    whole = lines.worth * np.sum((lines.y.conj() * Ky).real, axis=(1, 2))
    count, misfit = per_line * np.sum(told, axis=0), own.sum(axis=0)
    wrong = np.minimum(per_line * np.sum(np.where(told, share, 0.0), axis=0), count)
    left = np.maximum(per_line * len(K) * dims - count, 0.0)
    limit = _limit(count, left, wrong, dims, lines.sensors)
    others = np.maximum(whole[:, None] - own, 0.0)
    scale = _scale(others, per_line * (dims - told), share, lines.known)
    excess = np.divide(misfit, scale * limit, out=np.zeros(len(misfit)), where=limit > 0)
    mean = np.mean(share, axis=1, keepdims=True)
    total = float(_scale(whole[:, None], np.full((len(K), 1), per_line * dims), mean, lines.known)[0])
    due = lines.worth * np.sum(precision * np.sum(np.abs(lines.y - rest) ** 2, axis=2), axis=0)
    silent = np.divide(due, limit, out=np.zeros(len(due)), where=limit > 0)
    return LeftOut(rest, precision, max(float(whole.sum()), 0.0), total, limit, excess, tau, cost,
                   K, dims, silent)  # fmt: skip


def _scale(misfit: Real, freedom: Real, share: Real, known: bool) -> Real:
    """Factor on the variance that misfits (lines, k) show: on all lines, or more where errors of the model count."""
    found = [(BELIEF + np.sum(w * misfit, axis=0)) / (BELIEF + np.sum(w * freedom, axis=0)) for w in (1.0, share)]
    return np.asarray(np.maximum(*found) if not known else np.maximum(np.maximum(*found), 1.0))


def _limit(count: Real, freedom: Real, wrong: Real, dims: int, sensors: int) -> Real:
    """Misfit of one sensor that chance exceeds once in `LEVEL`: of `count` values of noise, or of one model error.

    An error of the model shared by all values weighs as many as it fills, with the chance of one.
    """
    from scipy.special import fdtri

    level = 1 - LEVEL / sensors
    noise = count * fdtri(np.maximum(count, 1.0), freedom + BELIEF, level)
    one = limit_of_one(sensors, dims)
    return np.asarray(np.where(count > 0, np.maximum(noise, count - wrong + one * wrong), 0.0))


def limit_of_one(hypotheses: int, dims: int) -> float:
    """Square of one error of the model, over its expectation, that one of so many hypotheses exceeds by chance."""
    from scipy.special import fdtri

    return float(fdtri(1.0, BELIEF + max(dims - 1, 0), 1 - LEVEL / hypotheses))


def unlikely(lines: SensorLines, gain: float) -> bool:
    """Whether a gain is further from one than that of a sound model is by chance once in `LEVEL`, over all sensors."""
    from scipy.special import ndtri

    reach = -FLOOR * ndtri(0.5 * LEVEL / lines.sensors)
    return bool(abs(gain) < TINY or abs(np.log(abs(gain))) > reach)


def precision_of(lines: SensorLines, variance: Real, tau: float | None) -> tuple[Array, int, float, float]:
    """Precision K of the data with the loads integrated out, (lines, sensors, sensors), its rank, tau, and the cost."""
    W = 1 / np.sqrt(variance)
    H = W[..., None] * lines.H
    flat = H if lines.spread is None else H @ (np.zeros((H.shape[2], 0)) if lines.free is None else lines.free)
    held = flat.shape[2]
    m = lines.sensors
    if held >= m:
        return np.zeros((len(H), m, m), H.dtype), 0, 0.0, 0.0
    Z = np.linalg.qr(flat, mode="complete")[0][..., held:] if held else np.broadcast_to(np.eye(m), (len(H), m, m))
    if lines.spread is None:
        P, tau, cost = Z @ Z.conj().swapaxes(1, 2), 0.0, 0.0
    else:
        one, tau, cost = _under_prior(Z[0], H[0], W[0, :, None] * lines.y[0], lines.spread, lines.known, tau)
        P = one[None]
    return W[..., None] * P * W[:, None], m - held, tau, cost


def _under_prior(
    Z: Real, H: Real, y: Real, spread: Real, known: bool, at: float | None
) -> tuple[NDArray[np.float64], float, float]:
    """Precision of whitened readings (sensors, frames), at the size of the loads that makes them likeliest."""
    M = Z.T @ H
    e, V = np.linalg.eigh(M @ spread @ M.T)
    e, z2 = np.maximum(e, 0.0), np.sum((V.T @ Z.T @ y) ** 2, axis=1)
    frames, top = y.shape[1], max(float(e.max(initial=0.0)), 1e-300)
    tau = np.concatenate([[0.0], np.geomspace(1e-3, 1e9, 73)]) / top if at is None else np.array([at])
    v = 1 + tau[:, None] * e
    chi2, logs = np.sum(z2 / v, axis=1), frames * np.sum(np.log(v), axis=1)
    cost = (chi2 if known else (BELIEF + frames * len(e)) * np.log(BELIEF + chi2)) + logs
    k = int(np.argmin(cost))
    return np.asarray(Z @ (V / v[k]) @ V.T @ Z.T), float(tau[k]), float(cost[k])
