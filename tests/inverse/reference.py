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


def attainable(A: NDArray, b: NDArray, x: NDArray) -> float:
    """Relative error that a backward stable method may make in the least-squares solution x of A x = b.

    Wedin's bound (Bjorck, SIAM 1996, eq. 1.4.16) for a relative perturbation ``sqrt(n) u``: rounding errors of n
    operations add up like that (Higham & Mary, SIAM J. Sci. Comput. 41 (2019) A2815).
    """
    s = np.linalg.svd(A, compute_uv=False)
    kappa, size = s[0] / s[-1], s[0] * np.linalg.norm(x)
    relative = np.linalg.norm(b) / size, np.linalg.norm(b - A @ x) / size
    return float(rounding(len(x)) * kappa * (1 + relative[0] + kappa * relative[1]))


def rounding(n: int) -> float:
    """Rounding errors of n operations, relative to the size of what goes in."""
    return float(0.5 * np.finfo(float).eps * np.sqrt(n))


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
