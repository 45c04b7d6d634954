"""Dense references that share nothing with the package: augmented least squares by QR."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Augmented:
    """Everything that one lambda says, from the QR of [H; lambda L]."""

    load: NDArray
    residual: NDArray
    penalty2: float
    A: NDArray  # influence matrix


def augmented(H: NDArray, y: NDArray, L: NDArray, lam: float) -> Augmented:
    """Tikhonov solution at an absolute lambda."""
    m = len(H)
    Q, R = np.linalg.qr(np.vstack([H, lam * L]))
    load = np.linalg.solve(R, Q[:m].conj().T @ y)
    return Augmented(load, y - H @ load, float(np.linalg.norm(L @ load) ** 2), Q[:m] @ Q[:m].conj().T)


def ill_conditioned(m: int, n: int, kappa: float, seed: int = 0) -> NDArray:
    """Random matrix with singular values in geometric progression."""
    rng = np.random.default_rng(seed)
    r = min(m, n)
    U = np.linalg.qr(rng.standard_normal((m, m)))[0][:, :r]
    V = np.linalg.qr(rng.standard_normal((n, n)))[0][:, :r]
    return (U * np.geomspace(1, 1 / kappa, r)) @ V.T


def penalty(name: str, n: int) -> NDArray:
    """Penalty matrix by its definition, written out."""
    if name == "identity":
        return np.eye(n)
    if name == "first_difference":
        return np.eye(n - 1, n, 1) - np.eye(n - 1, n)
    if name == "second_difference":
        return np.eye(n - 2, n) - 2 * np.eye(n - 2, n, 1) + np.eye(n - 2, n, 2)
    return np.random.default_rng(5).standard_normal((n + 2, n))


def echo(samples: int, sensors: int = 1, loads: int = 1, seed: int = 0, decay: float = 8.0) -> NDArray:
    """Impulse responses (samples, sensors, loads) of damped oscillators that die out within the record."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples)[:, None, None]
    f, phase = rng.uniform(0.05, 0.3, (2, 1, sensors, loads))
    return np.exp(-t / decay) * np.cos(2 * np.pi * f * t + phase) * rng.uniform(0.5, 1.5, (1, sensors, loads))
