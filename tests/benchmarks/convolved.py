"""Long records behind impulse responses: one lambda, and all that rules ask. `python -m tests.benchmarks.convolved`.

Six lightly damped modes (62 to 1158 Hz, 10240 Hz sampling, displacement), half-sine pulses, 1 % noise, lambda 1.5e-2
of the largest singular value, L = I; four loads and six sensors with random mode shapes. Beside it what a user would
write: scipy's LSMR on an FFT LinearOperator, with its tolerance lowered until its load is as near to a reference as
ours (about 1e-8). CPU seconds, medians. Then the path over half decades with traces and std, and windows.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from loadid._inverse.convolution import PenalizedConvolution
from loadid._inverse.convolved.path import ConvolvedPath
from loadid._inverse.convolved.pcg import Circulant, Sides, largest, solve
from loadid._inverse.convolved.windows import solve_in_windows

from .forward import cpu

RATE = 10240.0
MODES = np.array([62.0, 190.0, 370.0, 600.0, 870.0, 1158.0])
LAMBDA = 1.5e-2


def responses(samples: int, sensors: int = 1, loads: int = 1) -> NDArray[np.float64]:
    """Displacement impulse responses (samples, sensors, loads)."""
    rng = np.random.default_rng(3)
    t, zeta = np.arange(1, samples + 1) / RATE, np.linspace(0.01, 0.015, 6)
    shapes, forms = rng.standard_normal((sensors, 6)), rng.standard_normal((loads, 6))
    if sensors * loads == 1:
        shapes, forms = np.ones((1, 6)), np.ones((1, 6))
    w = 2 * np.pi * MODES
    waves = np.exp(-np.outer(zeta * w, t)) * np.sin(np.outer(w * np.sqrt(1 - zeta**2), t)) / w[:, None]
    return np.einsum("sk,lk,kt->tsl", shapes, forms, waves)


def record(samples: int, sensors: int, loads: int) -> tuple[NDArray, NDArray]:
    """Whitened impulse responses and data (samples, sensors)."""
    h = responses(samples, sensors, loads)
    g = np.zeros((loads, samples))
    for start in range(100, samples - 50, 1500):
        g[:, start : start + 41] = np.sin(np.pi * np.arange(41) / 40)
    clean = PenalizedConvolution(h, samples).convolve(g[None])[0].T
    sigma = 0.01 * clean.std()
    return h / sigma, (clean + sigma * np.random.default_rng(1).standard_normal(clean.shape)) / sigma


def by_lsmr(h: NDArray, y: NDArray, lam: float, tolerance: float) -> tuple[NDArray[np.float64], int]:
    """Load (samples, loads) by LSMR on an FFT operator, and its iterations."""
    from scipy import fft
    from scipy.sparse.linalg import LinearOperator, lsmr

    samples, sensors, loads = h.shape
    padded = fft.next_fast_len(2 * samples, real=True)
    H = np.moveaxis(fft.rfft(h, padded, axis=0), 0, -1)

    def apply(x: NDArray) -> NDArray:
        G = fft.rfft(x.reshape(loads, samples), padded)
        return fft.irfft(np.einsum("slk,lk->sk", H, G), padded)[:, :samples].ravel()

    def adjoint(x: NDArray) -> NDArray:
        R = fft.rfft(x.reshape(sensors, samples), padded)
        return fft.irfft(np.einsum("slk,sk->lk", H.conj(), R), padded)[:, :samples].ravel()

    operator = LinearOperator((samples * sensors, samples * loads), matvec=apply, rmatvec=adjoint, dtype=float)
    found = lsmr(operator, y.T.ravel(), damp=lam, atol=tolerance, btol=tolerance, conlim=0, maxiter=5000)
    return found[0].reshape(loads, samples).T, int(found[2])


def one_lambda(samples: int, sensors: int, loads: int) -> None:
    """A row of the table of one lambda."""
    h, y = record(samples, sensors, loads)
    operator = PenalizedConvolution(h, samples)
    lam = LAMBDA * largest(operator)
    data = np.ascontiguousarray(y.T)[None]

    def ours(tolerance: float) -> tuple[NDArray, int]:
        made = PenalizedConvolution(h, samples)
        found = solve(made, Circulant(made, lam), Sides(y=data), tolerance)
        return found.x[0].T, found.iterations

    reference = ours(1e-14)[0]

    def off(load: NDArray) -> float:
        return float(np.linalg.norm(load - reference) / np.linalg.norm(reference))

    load, steps = ours(1e-9)
    repeat = 5 if samples <= 20_000 else 3
    seconds = cpu(lambda: ours(1e-9), repeat)
    tolerance = 1e-7
    while True:
        other, other_steps = by_lsmr(h, y, lam, tolerance)
        if off(other) <= max(off(load), 1e-9) or tolerance < 1e-14:
            break
        tolerance /= 10
    others = cpu(partial(by_lsmr, h, y, lam, tolerance), repeat if samples <= 20_000 else 1)
    print(
        f"{samples:8d}{loads:4d} x {sensors}{steps:7d}{seconds:10.4f}{off(load):9.0e}"
        f"{other_steps:8d}{others:10.3f}{off(other):9.0e}{others / seconds:8.1f}"
    )


def whole(samples: int, sensors: int, loads: int, penalty: str) -> None:
    """A row of the table of all that rules ask."""
    h, y = record(samples, sensors, loads)
    made: list[ConvolvedPath] = []
    start = cpu(lambda: made.append(ConvolvedPath(h, y, penalty)), 1)
    path = made[0]
    lam = np.geomspace(*path.range, 121)
    sweep = cpu(lambda: path.at(lam), 1)
    load = cpu(lambda: path.solution(float(lam[60]), None), 1)
    posterior = path.solution(float(lam[60]), 1.0).posterior
    assert posterior is not None
    std = cpu(lambda: posterior.std, 1)
    print(f"{samples:8d}{loads:4d} x {sensors}  {penalty:18}{start:8.2f}{sweep:10.2f}{load:10.3f}{std:10.2f}")


def windowed(samples: int) -> None:
    """A row of the table of windows."""
    h, y = record(samples, 1, 1)
    h = h * np.exp(-np.arange(samples) / 1200)[:, None, None]
    lam = LAMBDA * largest(PenalizedConvolution(h, samples))
    path, short = ConvolvedPath(h, y), h[:12_000]
    reference = path.solution(lam / float(path.scale), None).load
    run: Callable[[], object] = lambda: solve_in_windows(short, y, lam)  # noqa: E731
    seconds, found = cpu(run, 1), solve_in_windows(short, y, lam)
    size = float(np.linalg.norm(reference))
    off = float(np.linalg.norm(found.load - reference)) / size
    print(
        f"{samples:8d}{found.window:8d}{found.overlap:9d}{found.count:9d}{len(found.changes):8d}"
        f"{off:10.1e}{found.bound / size:10.1e}{seconds:8.2f}"
    )


def main(quick: bool = False) -> int:
    """Print the tables."""
    import scipy.sparse.linalg  # noqa: F401  (nothing below pays for an import)

    print("One lambda, CPU s (operator and preconditioner included)")
    print(" samples  loads x sensors   steps    ours   off from    LSMR steps     s   off   ratio")
    for samples in (2000, 20_000) if quick else (2000, 20_000, 100_000):
        for sensors, loads in ((1, 1), (6, 4)):
            one_lambda(samples, sensors, loads)
    print("\nThe path at 121 lambdas (every scalar), one load with std, CPU s")
    print(" samples  loads x sensors  penalty            scale     sweep      load       std")
    whole(2000, 1, 1, "identity")
    if not quick:
        whole(20_000, 1, 1, "identity")
        whole(20_000, 1, 1, "second_difference")
        whole(100_000, 1, 1, "identity")
    print("\nWindows, beside the record in one piece")
    print(" samples  window  overlap  windows  sweeps       off     bound       s")
    for samples in (50_000,) if quick else (50_000, 200_000):
        windowed(samples)
    return 0


if __name__ == "__main__":
    sys.exit(main("--quick" in sys.argv[1:]))
