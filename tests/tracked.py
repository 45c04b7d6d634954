"""Structures under loads that are tracked: the benchmarks' matrices, records and truths, and filters to judge by.

Everything here is built from M, K, C and textbook formulas with dense covariances, apart from `loadid`: slow and clear.
Sources of the set-ups: BM1 the eight-storey chain of Sedehi et al. (2019); BM2 the ten-storey shear building of Nayek
et al. (2019); BM3 the beam of the public MATLAB toolbox ssm_tools; D2 the beam under a slow or a short load; D2b the
public four-storey example of an augmented Kalman filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, cholesky, eigh, expm, qr, solve

from loadid._inverse.gaussian.model import FilterModel
from structures import Channel, StateSpace

Array = NDArray[np.float64]


# -- structures -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Setup:
    """``M u'' + C u' + K u = Sp p`` with accelerometers ``Sa u''`` and displacements ``Sd u``; states ``(u, u')``."""

    M: Array
    C: Array
    K: Array
    Sp: Array  # (dofs, loads)
    Sa: Array  # (accelerometers, dofs)
    Sd: Array  # (displacements, dofs)
    dt: float

    @cached_property
    def nx(self) -> int:
        return 2 * len(self.M)

    def driven(self, S: Array) -> Array:
        """Continuous input matrix (nx, columns) of forces on the DOFs."""
        return np.vstack([np.zeros_like(S), solve(self.M, S)])

    @cached_property
    def continuous(self) -> Array:
        n = len(self.M)
        zero, one = np.zeros((n, n)), np.eye(n)
        return np.block([[zero, one], [-solve(self.M, self.K), -solve(self.M, self.C)]])

    @cached_property
    def G(self) -> Array:
        """Outputs of the state (sensors, nx): accelerometers first."""
        moving = self.Sa @ self.continuous[len(self.M) :]
        return np.vstack([moving, np.hstack([self.Sd, np.zeros_like(self.Sd)])])

    def through(self, S: Array) -> Array:
        """Feedthrough (sensors, columns) of forces on the DOFs."""
        return np.vstack([self.Sa @ solve(self.M, S), np.zeros((len(self.Sd), S.shape[1]))])

    @cached_property
    def J(self) -> Array:
        return self.through(self.Sp)

    def held(self, S: Array, dt: float) -> tuple[Array, Array, Array]:
        """``A, B0, B1`` of forces that run straight between samples; ``B0 + B1`` is the zero-order hold."""
        b = self.driven(S)
        n, p = b.shape
        block = np.zeros((n + 2 * p, n + 2 * p))
        block[:n, :n], block[:n, n : n + p] = self.continuous * dt, b * dt
        block[n : n + p, n + p :] = np.eye(p)
        E = expm(block)
        return E[:n, :n], E[:n, n : n + p] - E[:n, n + p :], E[:n, n + p :]

    def matrices(self, hold: str = "zoh") -> tuple[Array, Array, Array, Array]:
        """``A, B, G, J`` at the step of the set-up; first-order hold in its causal form ``x - B1 u``."""
        A, B0, B1 = self.held(self.Sp, self.dt)
        if hold == "zoh":
            return A, B0 + B1, self.G, self.J
        return A, B0 + A @ B1, self.G, self.J + self.G @ B1

    def space(self, hold: str = "zoh") -> StateSpace:
        """The same as a `structures.StateSpace` with named channels."""
        rows = [Channel(label=f"a{i}", quantity="acceleration", unit="m/s^2") for i in range(len(self.Sa))]
        rows += [Channel(label=f"d{i}", quantity="displacement", unit="m") for i in range(len(self.Sd))]
        columns = [Channel(label=f"p{j}", quantity="force", unit="N") for j in range(self.Sp.shape[1])]
        return StateSpace(*self.matrices(hold), self.dt, hold, sensors=rows, loads=columns)

    def stiffened(self, factor: float) -> Setup:
        """The same with another stiffness (and its damping as it was)."""
        return replace(self, K=self.K * factor)

    def respond(self, load: Array, fine: int = 1, hold: str = "zoh") -> Array:
        """Response (samples, sensors) to a load history (samples * fine, loads) at dt / fine, from rest."""
        A, B0, B1 = self.held(self.Sp, self.dt / fine)
        ahead = np.vstack([load[1:], load[-1:]]) if hold == "foh" else load
        inputs = load @ B0.T + ahead @ B1.T
        return (recursion(A, inputs, np.zeros(self.nx)) @ self.G.T + load @ self.J.T)[::fine]


@dataclass(frozen=True, eq=False)
class Tracked:
    """A record with its truth: sensors (samples, m) with noise of the given sd, loads (samples, p)."""

    setup: Setup
    y: Array
    load: Array
    noise: Array  # sd per sensor, or its covariance
    x0: Array  # variances of the structure's first state
    Qx: Array  # white noise of its transition, (nx, nx)
    S: Array | None = None

    @property
    def dt(self) -> float:
        return self.setup.dt

    @property
    def t(self) -> Array:
        return np.arange(len(self.y)) * self.dt


def selector(rows: Sequence[int], n: int) -> Array:
    """Rows of the unit matrix, DOFs counted from one."""
    return np.eye(n)[[r - 1 for r in rows]]


def tridiagonal(n: int) -> Array:
    """2 and -1, the last entry 1: a chain that is fixed at its first end."""
    T = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    T[-1, -1] = 1
    return T


def disturbed(clean: Array, rng: np.random.Generator, share: float) -> tuple[Array, Array]:
    """Record with white noise of a share of each channel's std, and that sd."""
    sd = share * clean.std(axis=0)
    return clean + sd * rng.standard_normal(clean.shape), sd


# -- priors of one load: F, root of Q, read-out, start variance --------------------------------------------------------
Prior = tuple[Array, Array, Array, Array]


def walk(q: float, start: float = 1e4) -> Prior:
    """Random walk, variance q per step."""
    return np.eye(1), np.sqrt([[q]]), np.eye(1), np.array([[np.sqrt(start)]])


def white(sd: float) -> Prior:
    return np.zeros((1, 1)), np.array([[sd]]), np.eye(1), np.array([[sd]])


def ar1(sd: float, pole: float) -> Prior:
    return np.array([[pole]]), np.array([[sd * np.sqrt(1 - pole**2)]]), np.eye(1), np.array([[sd]])


def matern32(sd: float, length: float, dt: float) -> Prior:
    """Matern 3/2 in ``(p, p' / lam)``: its transition noise in closed form."""
    a = np.sqrt(3) * dt / length
    F = np.exp(-a) * np.array([[1 + a, a], [-a, 1 - a]])
    e = np.exp(-2 * a)
    q11, q12, q22 = 1 - e * (1 + 2 * a + 2 * a**2), 2 * a**2 * e, 1 - e * (1 - 2 * a + 2 * a**2)
    root = sd * cholesky(np.array([[q11, q12], [q12, q22]]), lower=True)
    return F, root, np.array([[1.0, 0.0]]), sd * np.eye(2)


def together(*priors: Prior) -> Prior:
    """Loads side by side, each with its own prior."""
    F, LQ, H, L0 = (block_diag(*parts) for parts in zip(*priors, strict=True))
    return F, LQ, H, L0


def filter_model(case: Tracked, prior: Prior, hold: str = "zoh") -> FilterModel:
    """Structure and prior as one system; the first-order hold in its causal form."""
    A, B, G, J = case.setup.matrices(hold)
    Fz, Lz, Hz, Z0 = prior
    nx, nz = len(A), len(Fz)
    noise = case.noise
    return FilterModel(
        F=np.block([[A, B @ Hz], [np.zeros((nz, nx)), Fz]]),
        LQ=block_diag(root(case.Qx), Lz),
        H=np.hstack([G, J @ Hz]),
        LR=np.diag(noise) if noise.ndim == 1 else cholesky(noise, lower=True),
        Cp=np.hstack([np.zeros((len(Hz), nx)), Hz]),
        x0=np.zeros(nx + nz),
        L0=block_diag(np.diag(np.sqrt(case.x0)), Z0),
        nx=nx,
        S=None if case.S is None else np.vstack([case.S, np.zeros((nz, len(G)))]),
    )


def root(Q: Array) -> Array:
    """Symmetric root of a covariance that may be singular."""
    w, V = eigh(Q)
    return V * np.sqrt(np.maximum(w, 0))


# -- the benchmarks ----------------------------------------------------------------------------------------------------
def bm1(seed: int = 0, samples: int = 20_001) -> Tracked:
    """Chain of eight under white noise of 5 N at its first mass; accelerometers at 1 and 4."""
    n, dt = 8, 1e-3
    K = 1000 * tridiagonal(n)
    setup = Setup(np.eye(n), K / 1000, K, selector([1], n).T, selector([1, 4], n), np.zeros((0, n)), dt)
    rng = np.random.default_rng(seed)
    load = 5 * rng.standard_normal((samples, 1))
    clean = setup.respond(load)
    sd = np.full(2, np.sqrt(1e-4 * clean[:, 1].var()))
    y = clean + sd * rng.standard_normal(clean.shape)
    Qx = np.diag(np.repeat([0.0, 1e-8], n))
    return Tracked(setup, y, load, sd, np.full(2 * n, 1e-12), Qx)


def building(acc: Sequence[int] = (3, 6, 10), disp: Sequence[int] = (10,), dt: float = 0.01, at: int = 10) -> Setup:
    """Shear building of ten storeys: k / m = 2500, C = .1 M + 5e-4 K."""
    n = 10
    M, K = np.eye(n), 2500 * tridiagonal(n)
    return Setup(M, 0.1 * M + 5e-4 * K, K, selector([at], n).T, selector(acc, n), selector(disp, n), dt)


LOADS = ("mix", "matern", "step")


def history(kind: str, t: Array, rng: np.random.Generator) -> Array:
    """Load history of the building (samples, 1)."""
    if kind == "mix":
        tones = ((100, 0.3, 0.0), (60, 2.7, 0.4), (20, 6.1, 0.0))
        p = sum(a * np.sin(2 * np.pi * f * t + phase) for a, f, phase in tones)
    elif kind == "step":
        p = np.where(t >= 5, 100.0, 0.0) * np.where(t >= 40, 0.5, 1.0) + 5 * np.sin(2 * np.pi * 1.1 * t)
    else:
        F, L, H, _ = matern32(100.0, 0.08, t[1] - t[0])
        z, p = np.zeros(2), np.empty(len(t))
        for k, w in enumerate(rng.standard_normal((len(t), 2))):
            p[k] = (H @ z)[0]
            z = F @ z + L @ w
    return np.asarray(p)[:, None]


def bm2(
    kind: str = "matern",
    seed: int = 0,
    *,
    acc: Sequence[int] = (3, 6, 10),
    disp: Sequence[int] = (10,),
    samples: int = 6001,
    dt: float = 0.01,
    fine: int = 1,
) -> Tracked:
    """The building under ``"mix"``, ``"matern"`` or ``"step"``; 1 % noise per channel.

    With ``fine`` > 1 the truth runs continuously: it is drawn and simulated at ``dt / fine``, straight between its
    samples. With 1 it is held between samples, as a filter with a zero-order hold assumes.
    """
    setup = building(acc, disp, dt)
    rng = np.random.default_rng(seed)
    load = history(kind, np.arange(samples * fine) * dt / fine, rng)
    clean = setup.respond(load, fine, "zoh" if fine == 1 else "foh")
    y, sd = disturbed(clean, rng, 0.01)
    return Tracked(setup, y, load[::fine], sd, np.full(setup.nx, 1e-12), 1e-14 * np.eye(setup.nx))


def bm3(seed: int = 0, samples: int = 100_000) -> Tracked:
    """Simply supported beam under a slow load and three white ambient loads, which correlate both noises."""
    length, stiffness, mass, zeta, dt = 30.0, 210e9 * 1e-6, 50.0, 0.02, 0.01
    j = np.arange(1, 9)
    omega = (j * np.pi / length) ** 2 * np.sqrt(stiffness / mass)

    def shapes(nodes: Sequence[int]) -> Array:
        x = (np.array(nodes)[:, None] - 1) * length / 100
        return np.sqrt(2 / (mass * length)) * np.sin(j * np.pi * x / length)

    setup = Setup(
        np.eye(8), np.diag(2 * zeta * omega), np.diag(omega**2), shapes([30]).T, shapes([10, 50]), shapes([15, 55]), dt
    )
    around = shapes([25, 45, 80]).T
    _, E0, E1 = setup.held(around, dt)
    Be, Je = E0 + E1, setup.through(around)
    rng = np.random.default_rng(seed)
    pole, sd = np.exp(-2 * np.pi * 0.05 * dt), 10.0
    load = driven_ar1(rng.standard_normal(samples), pole, sd)
    ambient = rng.standard_normal((samples, 3))
    A, B, G, J = setup.matrices()
    push = load @ B.T + ambient @ Be.T + 1e-8 * rng.standard_normal((samples, 16))
    y = recursion(A, push, np.zeros(16)) @ G.T
    y += load @ J.T + ambient @ Je.T + 1e-4 * rng.standard_normal((samples, 4))
    return Tracked(
        setup, y, load, Je @ Je.T + 1e-8 * np.eye(4), np.full(16, 1e-2), Be @ Be.T + 1e-16 * np.eye(16), Be @ Je.T
    )


def driven_ar1(white: Array, pole: float, sd: float) -> Array:
    """Stationary AR(1) history (samples, 1)."""
    from scipy.signal import lfilter

    w = white * sd * np.sqrt(1 - pole**2)
    w[0] = white[0] * sd
    return lfilter([1.0], [1.0, -pole], w)[:, None]


def steel_beam(elements: int = 40, length: float = 2.0, b: float = 0.05, h: float = 0.01) -> tuple[Array, Array]:
    """Frequencies (rad/s) and deflections (nodes, modes) of a simply supported steel beam, mass-normalised."""
    EI, mu, e = 210e9 * b * h**3 / 12, 7850 * b * h, length / elements
    k = np.array([[12, 6 * e, -12, 6 * e], [6 * e, 4 * e**2, -6 * e, 2 * e**2],
                  [-12, -6 * e, 12, -6 * e], [6 * e, 2 * e**2, -6 * e, 4 * e**2]])  # fmt: skip
    m = np.array([[156, 22 * e, 54, -13 * e], [22 * e, 4 * e**2, 13 * e, -3 * e**2],
                  [54, 13 * e, 156, -22 * e], [-13 * e, -3 * e**2, -22 * e, 4 * e**2]])  # fmt: skip
    n = 2 * (elements + 1)
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for i in range(elements):
        a = slice(2 * i, 2 * i + 4)
        K[a, a] += EI / e**3 * k
        M[a, a] += mu * e / 420 * m
    free = [i for i in range(n) if i not in (0, n - 2)]
    w2, V = eigh(K[np.ix_(free, free)], M[np.ix_(free, free)])
    shapes = np.zeros((n, len(free)))
    shapes[free] = V
    return np.sqrt(w2), shapes[::2]


def d2(
    kind: str = "slow", seed: int = 0, *, disp: bool = True, Qx: float = 1e-18, bias: float = 0.0, samples: int = 4000
) -> Tracked:
    """Steel beam of eight modes, force at 0.65 m; ``"slow"`` tones or a ``"short"`` half sine; bias in m/s^2."""
    dt = 1e-3
    w, phi = steel_beam()
    w, phi = w[:8], phi[:, :8]
    setup = Setup(
        np.eye(8), np.diag(0.02 * w), np.diag(w**2), phi[[13]].T, phi[[8, 13, 20, 31]],
        phi[[20]] if disp else np.zeros((0, 8)), dt,
    )  # fmt: skip
    t = np.arange(samples) * dt
    if kind == "slow":
        load = 20 * np.sin(2 * np.pi * 4 * t) * (t >= 0.3) + 10 * np.sin(2 * np.pi * 1.1 * t)
    else:
        load = 200 * np.sin(np.pi * np.clip((t - 1.0) / 0.02, 0, 1))
    load = load[:, None]
    clean = setup.respond(load)
    sd = np.array([0.01 * clean[:, :4].std()] * 4 + [1e-5] * disp)
    y = clean + sd * np.random.default_rng(seed).standard_normal(clean.shape)
    y[:, :4] += bias
    return Tracked(setup, y, load, sd, np.full(16, 1e-12), Qx * np.eye(16))


def d2b(Qv: float = 0.0, seed: int = 42, samples: int = 5001) -> Tracked:
    """Four storeys under white noise at the top, accelerometers on 1 and 4."""
    n, dt = 4, 1e-3
    T = tridiagonal(n)
    setup = Setup(np.eye(n), T, 1e3 * T, selector([4], n).T, selector([1, 4], n), np.zeros((0, n)), dt)
    rng = np.random.default_rng(seed)
    load = 0.05 * rng.standard_normal((samples, 1))
    clean = setup.respond(load)
    sd = np.full(2, 0.1 * clean[:, 0].std())
    y = clean + sd * rng.standard_normal(clean.shape)
    return Tracked(setup, y, load, sd, np.full(2 * n, 1e-12), np.diag(np.repeat([0.0, Qv], n)))


def recursion(A: Array, push: Array, x: Array) -> Array:
    """States before each sample (samples, n) of ``x <- A x + push``."""
    states = np.empty((len(push), len(x)))
    for k, u in enumerate(push):
        states[k] = x
        x = A @ x + u
    return states


# -- filters to judge by -----------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False, repr=False)
class Track:
    """Filtered loads (samples, p) with their sd, and what each innovation said."""

    load: Array
    std: Array
    nis: Array  # squared norm of the whitened innovation
    loglik: Array
    count: Array  # channels present
    e: Array  # innovations over their sd, NaN where a channel is missing
    x: Array  # last filtered state
    P: Array


def reference(model: FilterModel, y: Array, settle: float = 0.0) -> Track:
    """Textbook filter with dense covariances: update by Joseph's form, then predict, symmetrised.

    Missing channels (NaN) are left out of H, R and S. Correlated noises are taken apart first:
    ``F - S R^-1 H``, ``Q - S R^-1 S^T`` and the known input ``S R^-1 y``. With ``settle`` > 0 the covariance is kept
    once it repeats to that relative change; not for records with gaps.
    """
    R, Q, P = (L @ L.T for L in (model.LR, model.LQ, model.L0))
    x, one = model.x0.copy(), np.eye(model.n)
    load, std = np.empty((len(y), model.p)), np.empty((len(y), model.p))
    nis, loglik, count = np.zeros(len(y)), np.zeros(len(y)), np.zeros(len(y), int)
    normal = np.full(y.shape, np.nan)
    for k, sample in enumerate(y):
        ok = np.isfinite(sample)
        H, Rk, yk = model.H[ok], R[np.ix_(ok, ok)], sample[ok]
        Se = H @ P @ H.T + Rk
        c = np.linalg.cholesky(Se)
        gain = np.linalg.solve(Se, H @ P).T
        I_KH = one - gain @ H
        Pf = I_KH @ P @ I_KH.T + gain @ Rk @ gain.T
        Sk = np.zeros((model.n, len(yk))) if model.S is None else model.S[:, ok]
        T = np.linalg.solve(Rk, Sk.T).T if len(yk) else Sk
        F, Qk = model.F - T @ H, Q - T @ Sk.T
        P_next = F @ Pf @ F.T + Qk
        P_next = (P_next + P_next.T) / 2
        sd = np.sqrt(np.maximum(np.diag(model.Cp @ Pf @ model.Cp.T), 0))
        e = yk - H @ x
        x = x + gain @ e
        whitened = np.linalg.solve(c, e)
        nis[k], count[k] = whitened @ whitened, len(yk)
        normal[k, ok] = e / np.linalg.norm(c, axis=1)
        loglik[k] = -0.5 * (nis[k] + 2 * np.log(np.diag(c)).sum() + len(yk) * np.log(2 * np.pi))
        load[k], std[k] = model.Cp @ x, sd
        last, x = x, F @ x + T @ yk
        size = np.sqrt(np.maximum(np.diag(P_next), 1e-300))
        settled = bool(settle) and np.max(np.abs(P_next - P) / np.outer(size, size)) < settle
        P = P_next
        if settled and k + 1 < len(y):  # from here on every sample is the same two products
            rest = slice(k + 1, None)
            predicted = recursion(F @ I_KH, y[rest] @ (F @ gain + T).T, x)
            error = y[rest] - predicted @ H.T
            states = predicted + error @ gain.T
            last = states[-1]
            nis[rest], count[rest] = np.sum(np.linalg.solve(c, error.T) ** 2, axis=0), len(R)
            normal[rest] = error / np.linalg.norm(c, axis=1)
            loglik[rest] = -0.5 * (nis[rest] + 2 * np.log(np.diag(c)).sum() + len(R) * np.log(2 * np.pi))
            load[rest], std[rest] = states @ model.Cp.T, sd
            break
    return Track(load, std, nis, loglik, count, normal, last, Pf)


def unbiased(case: Tracked, use_S: bool = True) -> Track:
    """Filter without a prior of the load, for sensors with feedthrough: Gillijns and De Moor (2007), with S."""
    A, B, G, J = case.setup.matrices()
    R = np.diag(case.noise**2) if case.noise.ndim == 1 else case.noise
    S = np.zeros((len(A), len(R))) if case.S is None or not use_S else case.S
    x, P = np.zeros(len(A)), np.diag(case.x0)
    load, std = np.empty_like(case.load), np.empty_like(case.load)
    for k, y in enumerate(case.y):
        Rt = G @ P @ G.T + R
        W = np.linalg.solve(Rt, J)
        D = np.linalg.solve(J.T @ W, np.eye(J.shape[1]))
        Mgain = D @ W.T
        Sbar = A @ P @ G.T + S
        SR = np.linalg.solve(Rt, Sbar.T).T
        K = SR + (B - SR @ J) @ Mgain
        P_next = A @ P @ A.T + case.Qx - Sbar @ K.T - K @ Sbar.T + K @ Rt @ K.T
        P_next = (P_next + P_next.T) / 2
        fixed = bool(np.max(np.abs(P_next - P)) < 1e-13 * np.max(np.abs(P)))
        P = P_next
        if fixed:  # from here on the gains stay
            predicted = recursion(A - K @ G, case.y[k:] @ K.T, x)
            load[k:], std[k:] = (case.y[k:] - predicted @ G.T) @ Mgain.T, np.sqrt(np.diag(D))
            e = case.y[-1] - G @ predicted[-1]
            x = A @ predicted[-1] + K @ e
            break
        e = y - G @ x
        load[k], std[k] = Mgain @ e, np.sqrt(np.diag(D))
        x = A @ x + K @ e
    none = np.zeros(len(load))
    return Track(load, std, none, none, none.astype(int), case.y * np.nan, x, P)


def dual(case: Tracked, q: float, start: float = 1.0) -> Track:
    """Two filters in series, without their cross-covariance: Azam et al. (2015), one load."""
    A, B, G, J = case.setup.matrices()
    R = np.diag(case.noise**2)
    x, P, p, V = np.zeros(len(A)), np.diag(case.x0), np.zeros(1), start * np.eye(1)
    load, std = np.empty_like(case.load), np.empty_like(case.load)
    for k, y in enumerate(case.y):
        V = V + q
        gain = np.linalg.solve(J @ V @ J.T + R, J @ V).T
        p = p + gain @ (y - G @ x - J @ p)
        V = V - gain @ J @ V
        gain = np.linalg.solve(G @ P @ G.T + R, G @ P).T
        x = x + gain @ (y - G @ x - J @ p)
        P = P - gain @ G @ P
        load[k], std[k] = p, np.sqrt(np.diag(V))
        x, P = A @ x + B @ p, A @ P @ A.T + case.Qx
        P = (P + P.T) / 2
    none = np.zeros(len(load))
    return Track(load, std, none, none, none.astype(int), case.y * np.nan, x, P)


def triangular(L: Array) -> Array:
    """Lower root with positive diagonal of the same covariance: to compare roots by."""
    R = np.asarray(qr(L.T, mode="r")[0])[: len(L)].T
    return R * np.where(np.diag(R) < 0, -1, 1)


# -- how good a track is -----------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Score:
    """Error over the load's norm, share of the truth in the band, mean squared normalised error, NIS per channel."""

    error: float
    cover: float
    nees: float
    nis: float

    def __str__(self) -> str:
        return f"error {self.error:.4f}  cover {self.cover:.3f}  NEES {self.nees:.3g}  NIS/m {self.nis:.3f}"


def score(load: Array, std: Array, truth: Array, *, skip: int = 200, width: float = 1.96) -> Score:
    """Figures of a track (samples, p) after its first samples."""
    off = (load - truth)[skip:]
    z = off / std[skip:]
    relative = float(np.sqrt(np.sum(off**2) / np.sum(truth[skip:] ** 2)))
    return Score(relative, float(np.mean(np.abs(z) < width)), float(np.mean(z**2)), float("nan"))


def judged(track: Track, case: Tracked, *, skip: int = 200, width: float = 1.96) -> Score:
    """Score of a reference track, with the NIS per channel."""
    found = score(track.load, track.std, case.load, skip=skip, width=width)
    nis = track.nis[skip:].sum() / max(track.count[skip:].sum(), 1)
    return replace(found, nis=float(nis))
