"""The set-ups on which inversions of FRFs are compared: a plate seen in lines and in time, and a beam's antiresonances.

- `lines`: simply supported aluminium plate, 20 sensors, 5 forces of which two stand 30 mm apart and one is silent, 2000
  lines from 20 to 1000 Hz, 30 dB; the solver's FRF errs by 0.2 % in frequency and 10 % in damping.
- `record`: the same plate in time, 8192 samples at 2 kHz, half sines of 5 ms at four places and a random force at a
  fifth, 30 dB, exact impulse response.
- `beam`: accelerance of a simply supported steel beam under one force, 797 lines with its antiresonances, 1 %.

Beside them what is compared with: the pseudo-inverse, Tikhonov's lambda per line by L-curve and by generalised
cross-validation (Hansen, SIAM 1998, ch. 7; Golub, Heath & Wahba, Technometrics 21 (1979) 215), written for these cases
alone and apart from the package, and the best lambda of each line that the truth allows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from structures import ForwardModel

Array = NDArray[np.float64]
Complex = NDArray[np.complex128]

LX, LY, THICKNESS, E, RHO, NU = 1.0, 0.7, 0.004, 70e9, 2700.0, 0.33
MASS = RHO * THICKNESS * LX * LY / 4  # of every mode
KINDS = ("accelerance", "mobility", "receptance")
SENSORS, LOADS = 20, 5
NOISE_DB = 30.0
OMITTED = 1e-300  # keeps the logarithm of a vanished norm finite


# -- the plate --------------------------------------------------------------------------------------------------------
def modes(count: int) -> tuple[Array, NDArray[np.intp]]:
    """Circular frequencies (count,) of the lowest modes, and their half waves (count, 2)."""
    waves = np.array([(p, q) for p in range(1, 25) for q in range(1, 25)])
    rigidity = E * THICKNESS**3 / 12 / (1 - NU**2)
    omega = np.sqrt(rigidity / (RHO * THICKNESS)) * np.sum((np.pi * waves / [LX, LY]) ** 2, axis=1)
    order = np.argsort(omega, kind="stable")[:count]
    return omega[order], waves[order]


def shapes(waves: NDArray, at: NDArray) -> Array:
    """Mode shapes (points, modes) at places (points, 2)."""
    return np.prod(np.sin(np.pi * at[:, None, :] * waves / [LX, LY]), axis=2)


def places(rng: np.random.Generator) -> tuple[Array, Array]:
    """Places of sensors and of loads, (n, 2) each, in m."""
    sensors = rng.uniform([0.05, 0.05], [0.95, 0.65], (SENSORS, 2))
    return sensors, rng.uniform([0.10, 0.10], [0.90, 0.60], (LOADS, 2))


def complex_normals(rng: np.random.Generator, *shape: int) -> Complex:
    """Real parts first, then imaginary ones, each of unit variance."""
    real = rng.standard_normal(shape)
    return real + 1j * rng.standard_normal(shape)


@dataclass(frozen=True)
class Lines:
    """A problem of lines: what the solver knows, and the truth.

    Parameters
    ----------
    frequencies : array (lines,), Hz
    H : array (lines, sensors, loads)
        The solver's FRF.
    Y : array (lines, sensors)
        Noisy response.
    truth : array (lines, loads)
    exact : array like H
        The FRF that made the response.
    sigma : float
        Noise std: sqrt(E |noise|^2).
    """

    frequencies: Array
    H: Complex
    Y: Complex
    truth: Complex
    exact: Complex
    sigma: float

    def scaled(self, factor: float) -> Lines:
        """FRF and response times a factor; the load stays."""
        H, Y, exact = factor * self.H, factor * self.Y, factor * self.exact
        return replace(self, H=H, Y=Y, exact=exact, sigma=factor * self.sigma)

    @property
    def drawn(self) -> float:
        """Noise std of this draw, on which the published counts of flagged lines rest."""
        return float(np.std(self.Y - np.einsum("ksl,kl->ks", self.exact, self.truth)))

    def errors(self, load: NDArray) -> Array:
        """Relative error of each line."""
        return np.linalg.norm(load - self.truth, axis=1) / np.linalg.norm(self.truth, axis=1)

    def scores(self, load: NDArray) -> dict[str, float]:
        """Median and 95th percentile over the lines, global error, and what leaks into the silent load (rms ratio)."""
        errors = self.errors(load)
        silent = ~np.any(self.truth, axis=0)
        leak = rms(load[:, silent]) / rms(self.truth[:, ~silent]) if silent.any() else 0.0
        whole = float(np.linalg.norm(load - self.truth) / np.linalg.norm(self.truth))
        return {"med": float(np.median(errors)), "p95": float(np.percentile(errors, 95)), "glob": whole, "leak": leak}


def rms(values: NDArray) -> float:
    """Root mean square of magnitudes."""
    return float(np.sqrt(np.mean(np.abs(values) ** 2)))


def kind_factor(kind: str, omega: Array) -> Complex:
    """What turns receptance into another kind at circular frequencies."""
    order = {"receptance": 0, "mobility": 1, "accelerance": 2}[kind]
    return np.asarray((1j * omega) ** order, complex)


def lines(kind: str = "accelerance", seed: int = 0, count: int = 2000) -> Lines:
    """The plate in lines; `seed` 0 and 2000 lines make the benchmark."""
    rng = np.random.default_rng(seed)
    seen, pushed = places(rng)
    pushed[1] = pushed[0] + (0.03, 0.0)
    natural, waves = modes(40)
    a, b = rng.standard_normal(40), rng.standard_normal(40)
    F = complex_normals(rng, count, LOADS)
    F[:, -1] = 0
    frequencies = np.linspace(20, 1000, count)
    omega = 2 * np.pi * frequencies
    left, right = shapes(waves, seen), shapes(waves, pushed)

    def frf(natural: Array, zeta: Array) -> Complex:
        q = 1 / (MASS * (natural**2 - omega[:, None] ** 2 + 2j * zeta * natural * omega[:, None]))
        return ((q * kind_factor(kind, omega)[:, None])[:, None, :] * left) @ right.T

    exact = frf(natural, np.full(40, 0.01))
    clean = np.einsum("ksl,kl->ks", exact, F)
    sigma = 10 ** (-NOISE_DB / 20) * rms(clean)
    noise = complex_normals(rng, count, SENSORS) * sigma / np.sqrt(2)
    known = frf(natural * (1 + 0.002 * a), 0.01 * (1 + 0.1 * b))
    return Lines(frequencies, known, clean + noise, F, exact, sigma)


# -- the plate in time ------------------------------------------------------------------------------------------------
RATE, SAMPLES, TAPS, TIMED_MODES, TIMED_DAMPING = 2000.0, 8192, 2048, 25, 0.02


@dataclass(frozen=True)
class Transient:
    """Impulse response (taps, sensors, loads), noisy record (samples, sensors), truth (samples, loads), noise std."""

    h: Array
    y: Array
    truth: Array
    sigma: float

    def scores(self, load: NDArray) -> dict[str, float]:
        """Relative error over the impacts and over the random load; the worst relative error of the four peaks."""
        known = self.truth
        peaks = np.abs(np.abs(load[:, :4]).max(axis=0) / np.abs(known[:, :4]).max(axis=0) - 1)
        return {"impacts": _relative(load[:, :4], known[:, :4]), "random": _relative(load[:, 4], known[:, 4]),
                "peak": float(peaks.max())}  # fmt: skip


def _relative(found: NDArray, known: NDArray) -> float:
    return float(np.linalg.norm(found - known) / np.linalg.norm(known))


def oscillators() -> tuple[Array, Array, Array, Array]:
    """Step (modes, 2, 2), input and output (modes, 2) and feedthrough (modes,) of the acceleration of every mode."""
    from scipy.linalg import expm

    natural, _ = modes(TIMED_MODES)
    A, B, C = np.zeros((TIMED_MODES, 2, 2)), np.zeros((TIMED_MODES, 2)), np.zeros((TIMED_MODES, 2))
    for k, w in enumerate(natural):
        whole = np.zeros((3, 3))
        whole[:2, :2] = [[0, 1], [-(w**2), -2 * TIMED_DAMPING * w]]
        whole[1, 2] = 1 / MASS
        step = expm(whole / RATE)
        A[k], B[k], C[k] = step[:2, :2], step[:2, 2], (-(w**2), -2 * TIMED_DAMPING * w)
    return A, B, C, np.full(TIMED_MODES, 1 / MASS)


def timed_places(seed: int = 1) -> tuple[Array, Array]:
    """Mode shapes at sensors (sensors, modes) and at loads (loads, modes) of the record."""
    seen, pushed = places(np.random.default_rng(seed))
    waves = modes(TIMED_MODES)[1]
    return shapes(waves, seen), shapes(waves, pushed)


def impulse_response(left: Array, right: Array, taps: int = TAPS) -> Array:
    """Held impulse response (taps, sensors, loads) of the accelerations."""
    A, B, C, D = oscillators()
    q, state = np.zeros((taps, TIMED_MODES)), B
    q[0] = D
    for n in range(1, taps):
        q[n] = np.sum(C * state, axis=1)
        state = np.einsum("kij,kj->ki", A, state)
    return np.einsum("sk,nk,lk->nsl", left, q, right, optimize=True)


def record(seed: int = 1) -> Transient:
    """The plate in time; `seed` 1 makes the benchmark."""
    from scipy.signal import fftconvolve

    rng = np.random.default_rng(seed)
    seen, pushed = places(rng)
    waves = modes(TIMED_MODES)[1]
    h = impulse_response(shapes(waves, seen), shapes(waves, pushed))
    F = np.zeros((SAMPLES, LOADS))
    pulse = np.sin(np.pi * np.arange(11) / 10)
    for j in range(LOADS - 1):
        for start in rng.integers(819, 6553, 3):
            F[start : start + 11, j] += rng.uniform(50, 200) * pulse
    F[:, -1] = 10 * np.sin(np.pi * np.arange(SAMPLES) / SAMPLES) ** 2 * rng.standard_normal(SAMPLES)
    clean = sum(fftconvolve(h[:, :, j], F[:, j, None], axes=0)[:SAMPLES] for j in range(LOADS))
    sigma = 10**-1.5 * float(np.std(clean))
    return Transient(h, clean + sigma * rng.standard_normal(clean.shape), F, sigma)


def fourier(case: Transient, share: float = 1e-4) -> Array:
    """Division of zero-padded spectra with one lambda, a share of the squared median of the largest singular values."""
    from scipy import fft

    padded = fft.next_fast_len(SAMPLES + TAPS, real=True)
    H, Y = fft.rfft(case.h, padded, axis=0), fft.rfft(case.y, padded, axis=0)
    U, s, Vh = np.linalg.svd(H, full_matrices=False)
    gains = s / (s**2 + share * np.median(s[:, 0]) ** 2) * np.einsum("ksr,ks->kr", U.conj(), Y)
    return fft.irfft(np.einsum("krl,kr->kl", Vh.conj(), gains), padded, axis=0)[:SAMPLES]


# -- the beam ---------------------------------------------------------------------------------------------------------
ANTIRESONANCES = (16.50, 52.25, 75.50, 127.50)  # Hz, of the collocated accelerance, to the nearest line
LAYOUTS = ((13,), (8,), (8, 20), (8, 13, 20, 31))
AMPLITUDE = 10.0


def beam_model(*nodes: int) -> ForwardModel:
    """Accelerometers at some nodes of a simply supported steel beam of 2 m, 12 modes, a force at node 13."""
    from structures import beams, damping, loads, sensors

    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=40,
        damping=damping.Modal(0.01),
    )  # fmt: skip
    seen = [sensors.Accelerometer(f"{n}+Z") for n in nodes]
    return ForwardModel(structure, seen, [loads.Point("13+Z", label="force")], modes=12, residual=False)


@lru_cache(maxsize=8)
def beam_frf(*nodes: int) -> Complex:
    """Accelerance (797, sensors, 1) from 1 to 200 Hz."""
    return beam_model(*nodes).frf(np.arange(1, 200.01, 0.25))


def beam(*nodes: int, seed: int = 0) -> Lines:
    """A force of 10 N on every line, 1 % of noise; `seed` 0 makes the table."""
    H = beam_frf(*nodes)
    truth = np.full((len(H), 1), AMPLITUDE, complex)
    clean = np.einsum("ksl,kl->ks", H, truth)
    sigma = 0.01 * rms(clean)
    noise = complex_normals(np.random.default_rng(seed), *clean.shape) * sigma / np.sqrt(2)
    return Lines(np.arange(1, 200.01, 0.25), H, clean + noise, truth, H, sigma)


# -- what is compared with --------------------------------------------------------------------------------------------
def pinv(H: NDArray, Y: NDArray) -> Complex:
    """Pseudo-inverse of every line, as it is written with numpy."""
    return (np.linalg.pinv(H) @ Y[..., None])[..., 0]


@dataclass(frozen=True)
class Decomposed:
    """Batched SVD with the coefficients of the data and what no load explains."""

    s: Array
    V: Complex
    b: Complex
    extra: Array
    sensors: int

    @classmethod
    def of(cls, H: NDArray, Y: NDArray) -> Decomposed:
        """Of FRFs (lines, sensors, loads) and responses (lines, sensors)."""
        U, s, Vh = np.linalg.svd(H, full_matrices=False)
        b = np.einsum("ksr,ks->kr", U.conj(), Y)
        extra = np.sum(np.abs(Y) ** 2, axis=1) - np.sum(np.abs(b) ** 2, axis=1)
        return cls(s, Vh.conj().swapaxes(1, 2), b, np.maximum(extra, 0), H.shape[1])

    def load(self, lam: NDArray) -> Complex:
        """Tikhonov solution at one lambda per line; the penalty is written as ``s^2 + lambda``."""
        return np.einsum("klr,kr->kl", self.V, self.s / (self.s**2 + lam[:, None]) * self.b)

    def grid(self, low: float, count: int = 100) -> Array:
        """Lambdas (lines, count) from a share of the smallest squared singular value to the largest."""
        return np.geomspace(low * self.s[:, -1] ** 2, self.s[:, 0] ** 2, count, axis=1)

    def norms(self, lam: NDArray) -> tuple[Array, Array, Array]:
        """Squared norms of residual and load, and the degrees of freedom, (lines, lambdas)."""
        d = self.s[:, None, :] ** 2 + lam[..., None]
        b2 = np.abs(self.b[:, None, :]) ** 2
        residual = np.sum((lam[..., None] / d) ** 2 * b2, axis=2) + self.extra[:, None]
        return residual, np.sum((self.s[:, None, :] / d) ** 2 * b2, axis=2), np.sum(self.s[:, None, :] ** 2 / d, axis=2)


def at_index(lam: NDArray, index: NDArray) -> Array:
    """One column of every line."""
    return np.take_along_axis(lam, index[:, None], 1)[:, 0]


def l_curve(H: NDArray, Y: NDArray) -> Complex:
    """Tikhonov, lambda of each line at the corner of its L-curve: the largest signed curvature."""
    problem = Decomposed.of(H, Y)
    lam = problem.grid(1e-2)
    residual, load, _ = problem.norms(lam)
    x = np.log(lam)
    step = (x[:, -1] - x[:, 0])[:, None] / (lam.shape[1] - 1)
    rho, eta = np.log(residual + OMITTED), np.log(load + OMITTED)
    r1, e1 = (np.gradient(v, axis=1) / step for v in (rho, eta))
    r2, e2 = (np.gradient(v, axis=1) / step for v in (r1, e1))
    return problem.load(at_index(lam, np.argmax((r1 * e2 - e1 * r2) / (r1**2 + e1**2) ** 1.5, axis=1)))


def gcv(H: NDArray, Y: NDArray) -> Complex:
    """Tikhonov, lambda of each line by generalised cross-validation."""
    problem = Decomposed.of(H, Y)
    lam = problem.grid(1e-4)
    residual, _, freedom = problem.norms(lam)
    return problem.load(at_index(lam, np.argmin(residual / (problem.sensors - freedom) ** 2, axis=1)))


def oracle(case: Lines) -> Complex:
    """Tikhonov with the lambda of each line that comes closest to the truth: a limit, not a method."""
    problem = Decomposed.of(case.H, case.Y)
    best, least = pinv(case.H, case.Y), case.errors(pinv(case.H, case.Y))
    for share in np.geomspace(1e-12, 1e2, 200):
        load = problem.load(share * problem.s[:, 0] ** 2)
        error = case.errors(load)
        better = error < least
        best[better], least[better] = load[better], error[better]
    return best
