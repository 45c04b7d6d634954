"""References of the filters: conditioning of all samples at once, and classic recursions; small and plain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, expm

from loadid._inverse.gaussian.model import FilterModel, SquareRoot
from loadid._inverse.gaussian.records import Filtered
from loadid._inverse.gaussian.roots import lower, solve_lower_transposed


def conditioned(model: FilterModel, Y: NDArray, given: int, at: int) -> tuple[NDArray, NDArray]:
    """Mean and covariance of the state at one sample given the first so many samples, from the joint Gaussian."""
    N, n, m = len(Y), model.n, model.m
    S = np.zeros((n, m)) if model.S is None else model.S
    R, Q = model.LR @ model.LR.T, model.LQ @ model.LQ.T
    noise = block_diag(model.L0 @ model.L0.T, *([np.block([[Q, S], [S.T, R]])] * N))
    state = np.hstack([np.eye(n), np.zeros((n, N * (n + m)))])
    mean, states, rows, means = model.x0, [], [], []
    for k in range(N):
        states.append(state)
        v = np.zeros((m, state.shape[1]))
        v[:, n + k * (n + m) + n : n + (k + 1) * (n + m)] = np.eye(m)
        rows.append(model.H @ state + v)
        means.append(mean)
        w = np.zeros_like(state)
        w[:, n + k * (n + m) : n + k * (n + m) + n] = np.eye(n)
        state, mean = model.F @ state + w, model.F @ mean
    y = Y[:given].reshape(-1)
    seen = np.isfinite(y)
    A = np.concatenate(rows[:given])[seen]
    expected = np.concatenate([model.H @ mean for mean in means[:given]])[seen]
    X = states[at]
    gain = np.linalg.solve(A @ noise @ A.T, A @ noise @ X.T).T
    return means[at] + gain @ (y[seen] - expected), X @ noise @ X.T - gain @ A @ noise @ X.T


def drawn(model: FilterModel, samples: int, seed: int = 0) -> tuple[NDArray, NDArray]:
    """Data (samples, m) and loads (samples, p) that the model draws."""
    rng = np.random.default_rng(seed)
    n, m = model.n, model.m
    S = np.zeros((n, m)) if model.S is None else model.S
    values, vectors = np.linalg.eigh(np.block([[model.LQ @ model.LQ.T, S], [S.T, model.LR @ model.LR.T]]))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    if model.S is None:
        root = block_diag(model.LQ, model.LR)
    x = model.x0 + model.L0 @ rng.standard_normal(model.L0.shape[1])
    Y, P = np.empty((samples, m)), np.empty((samples, model.p))
    for k in range(samples):
        wv = root @ rng.standard_normal(root.shape[1])
        Y[k], P[k] = model.H @ x + wv[n:], model.Cp @ x
        x = model.F @ x + wv[:n]
    return Y, P


def small(seed: int = 0, *, correlated: bool = False) -> FilterModel:
    """Five states, three sensors, two loads; noises correlated or not."""
    rng = np.random.default_rng(seed)
    n, m = 5, 3
    F = rng.standard_normal((n, n))
    F *= 0.9 / np.max(np.abs(np.linalg.eigvals(F)))
    joint = rng.standard_normal((n + m, n + m))
    LQ, LR, S = joint[:n], np.linalg.cholesky(joint[n:] @ joint[n:].T), joint[:n] @ joint[n:].T
    return FilterModel(F, LQ, rng.standard_normal((m, n)), LR, rng.standard_normal((2, n)), rng.standard_normal(n),
                       rng.standard_normal((n, n)), nx=3, S=S if correlated else None)  # fmt: skip


@dataclass(frozen=True)
class Building:
    """Discrete model of a shear building: A, B, G, J, with a load that is held over a sample."""

    A: NDArray[np.float64]
    B: NDArray[np.float64]
    G: NDArray[np.float64]
    J: NDArray[np.float64]

    def walk(
        self, q: float, r: NDArray, *, states: float = 1e-14, start: float = 1e-12, load: float = 1e4
    ) -> FilterModel:
        """With a random walk of variance q a sample; r stds of the sensors; variances of noise and start."""
        nx, p = self.B.shape
        F = np.block([[self.A, self.B], [np.zeros((p, nx)), np.eye(p)]])
        LQ = np.diag(np.r_[np.full(nx, states), np.full(p, q)]) ** 0.5
        L0 = np.diag(np.r_[np.full(nx, start), np.full(p, load)]) ** 0.5
        H, Cp = np.hstack([self.G, self.J]), np.hstack([np.zeros((p, nx)), np.eye(p)])
        return FilterModel(F, LQ, H, np.diag(r), Cp, np.zeros(nx + p), L0, nx=nx)

    def white(self, sd: float, R: NDArray, Qx: NDArray, S: NDArray | None = None) -> FilterModel:
        """With a load that is independent from sample to sample."""
        nx, p = self.B.shape
        F = np.block([[self.A, self.B], [np.zeros((p, nx)), np.zeros((p, p))]])
        values, vectors = np.linalg.eigh(Qx)
        root = block_diag(vectors * np.sqrt(np.maximum(values, 0.0)), sd * np.eye(p))
        H, Cp = np.hstack([self.G, self.J]), np.hstack([np.zeros((p, nx)), np.eye(p)])
        L0 = block_diag(1e-6 * np.eye(nx), sd * np.eye(p))
        wide = None if S is None else np.vstack([S, np.zeros((p, S.shape[1]))])
        return FilterModel(F, root, H, np.linalg.cholesky(R), Cp, np.zeros(nx + p), L0, nx=nx, S=wide)

    def matern(self, sd: float, length: float, dt: float, r: NDArray, *, states: float = 1e-14) -> FilterModel:
        """With a Matern 3/2 load."""
        nx = len(self.A)
        a = np.sqrt(3) / length * dt
        Fz = np.exp(-a) * np.array([[1 + a, a], [-a, 1 - a]])
        Hz = np.array([[sd, 0.0]])
        F = np.block([[self.A, self.B @ Hz], [np.zeros((2, nx)), Fz]])
        LQ = block_diag(states**0.5 * np.eye(nx), np.linalg.cholesky(np.eye(2) - Fz @ Fz.T))
        L0 = block_diag(1e-6 * np.eye(nx), np.eye(2))
        return FilterModel(F, LQ, np.hstack([self.G, self.J @ Hz]), np.diag(r), np.hstack([np.zeros((1, nx)), Hz]),
                           np.zeros(nx + 2), L0, nx=nx)  # fmt: skip


def building(
    acc: tuple[int, ...] = (2, 5, 9), disp: tuple[int, ...] = (9,), *, k: float = 2500.0, mass: float = 1.0,
    dt: float = 0.01, storeys: int = 10, at: int = -1,
) -> Building:  # fmt: skip
    """Ten storeys, the load on one of them: accelerations and displacements of some storeys."""
    n = storeys
    K = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[-1, -1] = k
    C = 0.1 * mass * np.eye(n) + 5e-4 * K
    Ac = np.block([[np.zeros((n, n)), np.eye(n)], [-K / mass, -C / mass]])
    Bc = np.zeros((2 * n, 1))
    Bc[n + at % n] = 1 / mass
    E = expm(np.block([[Ac, Bc], [np.zeros((1, 2 * n + 1))]]) * dt)
    G = np.vstack([Ac[n:][list(acc)], np.eye(2 * n)[list(disp)]])
    J = np.concatenate([Bc[n:][list(acc)], np.zeros((len(disp), 1))])
    return Building(E[:-1, :-1], E[:-1, -1:], G, J)


def gillijns_de_moor(
    model: Building, Y: NDArray, R: NDArray, Q: NDArray, P: NDArray, S: NDArray | None = None
) -> tuple[NDArray, NDArray]:
    """Loads and variances of the filter of Gillijns & De Moor, Automatica 43 (2007) 934, direct feedthrough."""
    A, B, G, J = model.A, model.B, model.G, model.J
    S = np.zeros((len(A), len(G))) if S is None else S
    x, loads, variances = np.zeros(len(A)), [], []
    for y in Y:
        Rt = G @ P @ G.T + R
        D = np.linalg.solve(J.T @ np.linalg.solve(Rt, J), np.eye(J.shape[1]))
        M = D @ np.linalg.solve(Rt, J).T
        e = y - G @ x
        loads.append(M @ e)
        variances.append(np.diag(D))
        Sb = A @ P @ G.T + S
        over = np.linalg.solve(Rt, Sb.T).T
        K = over + (B - over @ J) @ M
        x = A @ x + K @ e
        P = A @ P @ A.T + Q - Sb @ K.T - K @ Sb.T + K @ Rt @ K.T
        P = (P + P.T) / 2
    return np.array(loads), np.array(variances)


def joseph(model: FilterModel, steps: int) -> NDArray[np.float64]:
    """Load variances of the covariance recursion in Joseph's form, as textbooks have it."""
    F, H, R, Q = model.F, model.H, model.LR @ model.LR.T, model.LQ @ model.LQ.T
    P, out = model.L0 @ model.L0.T, []
    for _ in range(steps):
        K = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        C = np.eye(len(F)) - K @ H
        P = C @ P @ C.T + K @ R @ K.T
        out.append(model.Cp[0] @ P @ model.Cp[0])
        P = F @ P @ F.T + Q
    return np.array(out)


def long_double(model: FilterModel, steps: int) -> NDArray[np.float64]:
    """Load variances by the same recursion in extended precision, one channel after the other: R is diagonal."""
    long = np.longdouble
    F, H, LQ, L0 = (x.astype(long) for x in (model.F, model.H, model.LQ, model.L0))
    P, Q, out, eye = L0 @ L0.T, LQ @ LQ.T, [], np.eye(model.n, dtype=long)
    for _ in range(steps):
        for h, r in zip(H, np.diag(model.LR).astype(long) ** 2, strict=True):
            gain = P @ h / (h @ P @ h + r)
            C = eye - np.outer(gain, h)
            P = C @ P @ C.T + np.outer(gain, gain) * r
        out.append(float(model.Cp[0] @ P @ model.Cp[0]))
        P = F @ P @ F.T + Q
        P = (P + P.T) / 2
    return np.array(out)


SINGULAR = 1e-11  # of a state's predicted std: the part that is new to those before it


def rts(filtered: Filtered) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """States (samples, n), loads and their std (samples, p) with all data, by another way than that of the library.

    Rauch, Tung & Striebel, AIAA J. 3 (1965) 1445, in root form, which asks for a regular predicted covariance:

        [ F L   LQ ]        [ A   0 ]
        [ L     0  ]   =    [ B   D ]  Q,    G = B A^-1,    L_s L_s^T = D D^T + G L_s+ L_s+^T G^T.
    """
    model, (kept,) = filtered.model, (stretch.states for stretch in filtered.stretches)
    core, there, n = SquareRoot(model), np.isfinite(filtered.Y), model.n
    states, load, std = np.empty((len(kept), n)), np.empty(filtered.load.shape), np.empty(filtered.load.shape)
    x, L = kept[-1].x, kept[-1].L
    for k in range(len(kept) - 1, -1, -1):
        if k < len(kept) - 1:
            part, own = core.seen(there[k]), kept[k].L
            q, r = part.LQ.shape[1], own.shape[1]
            wide = np.zeros((2 * n, max(r + q, 2 * n)))
            wide[:n, :r], wide[:n, r : r + q], wide[n:, :r] = part.F @ own, part.LQ, own
            made = lower(wide)
            A, B, D = made[:n, :n], made[n:, :n], made[n:, n:]
            if np.any(np.abs(np.diag(A)) <= SINGULAR * np.linalg.norm(A, axis=1)):
                raise np.linalg.LinAlgError("the predicted covariance is singular")
            G = solve_lower_transposed(A, B.T).T
            x = kept[k].x + G @ (x - part.moved(kept[k].x, filtered.Y[k]))
            L = lower(D, G @ L)
        states[k], load[k], std[k] = x, model.Cp @ x, np.linalg.norm(model.Cp @ L, axis=1)
    return states, load, std
