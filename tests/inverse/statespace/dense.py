"""Dense references of records over a state space: operator column by column, augmented least squares by QR."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from structures import StateSpace


def operator(system: StateSpace, samples: int) -> NDArray[np.float64]:
    """Response (samples, sensors) to one unit of each load at each sample, shape (samples, sensors, samples, loads)."""
    sensors, loads = len(system.sensors), len(system.loads)
    B = np.broadcast_to(system.B, (samples, len(system.A), loads))
    D = np.broadcast_to(system.D, (samples, sensors, loads))
    H, x = np.zeros((samples, sensors, samples, loads)), np.zeros((len(system.A), samples, loads))
    for k in range(samples):
        H[k] = np.einsum("si,ikp->skp", system.C, x)
        H[k, :, k] += D[k]
        x = np.einsum("ij,jkp->ikp", system.A, x)
        x[:, k] += B[k]
    return H


def starts(system: StateSpace, samples: int) -> NDArray[np.float64]:
    """Response to each state at the first sample, shape (samples, sensors, states)."""
    rows = [system.C]
    for _ in range(samples - 1):
        rows.append(rows[-1] @ system.A)
    return np.array(rows)


def penalty(name: str, samples: int, loads: int, *, leak: float | None = None, from_zero: bool = False) -> NDArray:
    """Penalty over load histories flattened as (samples, loads), written out by its definition."""
    one = np.eye(samples)
    back = np.eye(samples, k=-1)
    if leak is not None:
        step, free = one - leak * back, 0
    else:
        degree = {"identity": 0, "first_difference": 1, "second_difference": 2}[name]
        step, free = np.linalg.matrix_power(one - back, degree), 0 if from_zero else degree
    return np.kron(step[free:], np.eye(loads))


def whitened(values: NDArray, noise: NDArray, missing: NDArray) -> NDArray[np.float64]:
    """Rows (samples, sensors, ...) of the data that are there, divided by the root of their own covariance."""
    covariance = np.diag(noise**2) if noise.ndim == 1 else noise
    rows = []
    for one, gone in zip(values, missing, strict=True):
        there = np.flatnonzero(~gone)
        if len(there):
            factor = np.linalg.cholesky(covariance[np.ix_(there, there)])
            rows.append(np.linalg.solve(factor, one[there].reshape(len(there), -1)))
    return np.concatenate(rows).reshape(-1, *values.shape[2:])


@dataclass(frozen=True)
class Dense:
    """A problem with the unknown start behind the load.

    Parameters
    ----------
    H : array, shape (m, loads * samples + start)
    y : array, shape (m,)
    L : array, shape (rows, loads * samples + start)
    shape : tuple
        (samples, loads).
    """

    H: NDArray
    y: NDArray
    L: NDArray
    shape: tuple[int, int]

    def at(self, lam: float) -> At:
        """Everything at one absolute lambda."""
        return At(self, lam)

    @property
    def unknowns(self) -> int:
        """Unknowns of the load."""
        return self.shape[0] * self.shape[1]

    @cached_property
    def gamma(self) -> NDArray[np.float64]:
        """Generalised singular values that the penalty sees: those of H on its rows, the null space fitted first."""
        _, s, vt = np.linalg.svd(self.L)
        rank = int(np.sum(s > 1e-10 * s[0]))
        null = self.H @ vt[rank:].T
        Q = np.linalg.qr(null)[0]
        onto = self.H @ (vt[:rank].T / s[:rank])  # L-weighted inverse, minimal part
        return np.linalg.svd(onto - Q @ (Q.T @ onto), compute_uv=False)

    def log_ratio(self, lam: float) -> float:
        """Sum of ln(1 + gamma^2 / lambda^2)."""
        return float(np.sum(np.log1p((self.gamma / lam) ** 2)))


@dataclass(frozen=True)
class At:
    """A dense problem at one absolute lambda, from the QR of [H; lambda L]."""

    problem: Dense
    lam: float

    @cached_property
    def _qr(self) -> tuple[NDArray, NDArray]:
        Q, R = np.linalg.qr(np.vstack([self.problem.H, self.lam * self.problem.L]))
        return Q, R

    @cached_property
    def whole(self) -> NDArray[np.float64]:
        """Load and start, flat."""
        Q, R = self._qr
        return np.linalg.solve(R, Q[: len(self.problem.y)].T @ self.problem.y)

    @property
    def load(self) -> NDArray[np.float64]:
        """(samples, loads)."""
        return self.whole[: self.problem.unknowns].reshape(self.problem.shape)

    @property
    def residual(self) -> NDArray[np.float64]:
        """(m,)."""
        return self.problem.y - self.problem.H @ self.whole

    @cached_property
    def influence(self) -> NDArray[np.float64]:
        """A (m, m)."""
        Q = self._qr[0][: len(self.problem.y)]
        return Q @ Q.T

    @cached_property
    def covariance(self) -> NDArray[np.float64]:
        """(H^T H + lambda^2 L^T L)^-1 of load and start."""
        half = np.linalg.solve(self._qr[1], np.eye(len(self.whole)))
        return half @ half.T

    @cached_property
    def resolution(self) -> NDArray[np.float64]:
        """Estimate = resolution times truth, of load and start together."""
        return self.covariance @ (self.problem.H.T @ self.problem.H)

    @cached_property
    def noise_covariance(self) -> NDArray[np.float64]:
        """Of the estimate, by the noise alone."""
        P = self.covariance @ self.problem.H.T
        return P @ P.T


def problem(
    system: StateSpace, y: NDArray, noise: NDArray, name: str, *, leak: float | None = None, from_zero: bool = False,
    unknown_start: bool = False,
) -> Dense:  # fmt: skip
    """Dense problem of raw data (samples, sensors), NaN where missing, with noise std or covariance."""
    samples, loads, missing = len(y), len(system.loads), np.isnan(y)
    H = operator(system, samples).reshape(samples, -1, samples * loads)
    L = penalty(name, samples, loads, leak=leak, from_zero=from_zero)
    if unknown_start:
        H = np.concatenate([H, starts(system, samples)], axis=2)
        L = np.hstack([L, np.zeros((len(L), len(system.A)))])
    return Dense(whitened(H, noise, missing), whitened(y[:, :, None], noise, missing)[:, 0], L, (samples, loads))
