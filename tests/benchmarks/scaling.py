"""How the cost grows with the problem: CPU seconds and exponents. `python -m tests.benchmarks.scaling [--quick]`.

Deconvolution of one record (1 sensor, 1 load; response and record decay) by the dense and by the FFT path, beside what
a user would write: numpy's least squares of the stacked system at the lambda that was found, and scipy's LSQR on an FFT
operator at the same lambda. Those two give a load only; the package also sweeps lambda, asks every rule, and gives the
std and the flags. Then the forward side: factorisation, modes and FRF sweep.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, LoadEstimate
from structures import ImpulseModel

from .forward import cpu, exponent, growth, sweep

DENSE = (200, 400, 800, 1600)
LONG = tuple(2**k for k in range(14, 20))
LIMIT = 1.15
DT = 1e-3


@dataclass(frozen=True)
class Case:
    """A record of some hits on an oscillator, with its model and its load (samples,)."""

    model: ImpulseModel
    record: NDArray[np.float64]
    force: NDArray[np.float64]


def case(samples: int, noise: float = 0.01) -> Case:
    """A hit in every 500 samples but the last 20 %, the same response and hits whatever the length of the record."""
    t = np.arange(samples) * DT
    h = np.exp(-(min(samples, 500) ** -1) * 20 * t / DT) * np.sin(2 * np.pi * 60 * t + 0.3)  # h[0] is not zero
    force = np.zeros(samples)
    for start in range(samples // 20, samples * 4 // 5, min(500, samples // 3)):
        force[start : start + 20] = np.sin(np.pi * np.arange(20) / 20)
    padded = 2 * samples
    clean = np.fft.irfft(np.fft.rfft(h, padded) * np.fft.rfft(force, padded), padded)[:samples]
    std = noise * np.sqrt(np.mean(clean**2))
    record = clean + std * np.random.default_rng(0).standard_normal(samples)
    return Case(ImpulseModel(h, DT, kind="held"), record[:, None], force)


def estimate(c: Case) -> LoadEstimate:
    """What the package does, start to finish."""
    return Deconvolution(c.model).estimate(c.record, DT)


def lstsq(c: Case, lam: float) -> NDArray[np.float64]:
    """Least squares of the stacked system [T; lam I]: what a user writes first."""
    from scipy.linalg import toeplitz

    h = c.model.h[:, 0, 0]
    n = len(h)
    stacked = np.vstack([toeplitz(h, np.zeros(n)), lam * np.eye(n)])
    return np.linalg.lstsq(stacked, np.concatenate([c.record[:, 0], np.zeros(n)]), rcond=None)[0]


def lsqr(c: Case, lam: float) -> tuple[NDArray[np.float64], int]:
    """Damped LSQR on an FFT operator, and its iterations: what a user writes for a long record."""
    from scipy import fft
    from scipy.sparse.linalg import LinearOperator
    from scipy.sparse.linalg import lsqr as solve

    h = c.model.h[:, 0, 0]
    n = len(h)
    padded = fft.next_fast_len(2 * n, real=True)
    H = fft.rfft(h, padded)

    def times(symbol: NDArray) -> Callable[[NDArray], NDArray]:
        return lambda x: fft.irfft(symbol * fft.rfft(x.ravel(), padded), padded)[:n]

    operator = LinearOperator((n, n), matvec=times(H), rmatvec=times(H.conj()), dtype=float)
    found = solve(operator, c.record[:, 0], damp=lam, atol=1e-8, btol=1e-8, iter_lim=1000)
    return found[0], int(found[2])


def absolute(c: Case, e: LoadEstimate) -> float:
    """Lambda of the problem as recorded: largest singular value of the convolution times the relative lambda."""
    h = c.model.h[:, 0, 0]
    return float(e.choice.lam * np.abs(np.fft.rfft(h, 2 * len(h))).max())


def error(load: NDArray, c: Case) -> float:
    """Relative L2 error of a load."""
    return float(np.linalg.norm(load.ravel() - c.force) / np.linalg.norm(c.force))


def deconvolution(title: str, sizes: Sequence[int], other: str, alternative: Callable[[Case, float], NDArray]) -> float:
    """Table of one path beside the alternative; returns the growth exponent of the path."""
    print(f"\n{title}")
    print(
        f"{'samples':>9}{'loadid s':>11}{'us/sample':>11}{'error':>8}{other + ' s':>14}{'error':>8}{'ratio':>8}  path"
    )
    ours, theirs = [], []
    for n in sizes:
        c = case(n)
        e = estimate(c)
        lam = absolute(c, e)
        repeat = 3 if n < 2**17 else 2
        ours.append(cpu(lambda c=c: estimate(c), repeat))
        found: list[NDArray] = []
        theirs.append(cpu(lambda c=c, lam=lam, found=found: found.append(alternative(c, lam)), 1 if n > 2**14 else 3))
        print(
            f"{n:9d}{ours[-1]:11.3f}{1e6 * ours[-1] / n:11.2f}{error(e.load, c):8.3f}"
            f"{theirs[-1]:14.3f}{error(found[-1], c):8.3f}{ours[-1] / theirs[-1]:8.2f}  {e.facts['path']}"
        )
    print(f"exponent: loadid {exponent(sizes, ours):.2f}, {other} {exponent(sizes, theirs):.2f}")
    return exponent(sizes, ours)


def main(quick: bool = False) -> int:
    """Print all tables; 1 where the FFT path grows faster than the limit."""
    import loadid._plots  # noqa: F401  (nothing below pays for an import)

    estimate(case(200))
    estimate(case(4096))
    deconvolution("Dense path (SVD)", DENSE[:3] if quick else DENSE, "lstsq", lstsq)
    found = deconvolution(
        "Long records (zero-padded FFT)", LONG[:4] if quick else LONG, "LSQR", lambda c, lam: lsqr(c, lam)[0]
    )
    growth((12, 18, 27) if quick else (16, 24, 36, 54))
    sweep((250, 1000) if quick else (250, 1000, 4000, 16000))
    print(f"\nFFT path: exponent {found:.2f} (at most {LIMIT})")
    return int(found > LIMIT)


if __name__ == "__main__":
    sys.exit(main("--quick" in sys.argv[1:]))
