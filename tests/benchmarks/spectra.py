"""Cross spectra beside scipy, and the variance of FRFs beside their scatter.

Run with ``python -m tests.benchmarks.spectra``. CPU seconds, medians of three runs; the variance over 400 simulated
tests of 40 independent segments, 3 sensors, no leakage.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy import signal

from structures import cross_spectra
from structures._testing.frfs import estimate
from tests.structures.test_frfs import MIX, spectra

CASES = (
    ("H1", (0,), (0, 1, 2), 0.0, 0.5),
    ("H1", (0, 1), (0, 1, 2), 0.0, 0.5),
    ("H2", (0,), (0, 1, 2), 0.5, 0.0),
    ("H2", (0, 1), (0, 2), 0.1, 0.0),
    ("Hv", (0,), (0, 1, 2), 0.3, 0.3),
    ("Hv", (0, 1), (0, 1, 2), 0.1, 0.1),
    ("Hs", (0, 1), (0, 1, 2), 0.1, 0.1),
)


def seconds(job: Callable[[], object]) -> float:
    """Median CPU time of three runs."""
    taken = []
    for _ in range(3):
        start = time.process_time()
        job()
        taken.append(time.process_time() - start)
    return float(np.median(taken))


def times() -> None:
    """Full matrix of cross spectra: ours, with its leakage check, and `scipy.signal.csd` broadcast over pairs."""
    print("  samples  channels  segment    ours s   scipy s   ratio   largest difference")
    rng = np.random.default_rng(0)
    for samples, channels, segment in ((100_000, 5, 1024), (200_000, 25, 2048), (50_000, 60, 512)):
        x = rng.standard_normal((samples, channels))
        ours = cross_spectra(x, 1.0, segment=segment).matrix
        theirs = signal.csd(x.T[None], x.T[:, None], nperseg=segment)[1].transpose(2, 0, 1)
        a = seconds(lambda x=x, n=segment: cross_spectra(x, 1.0, segment=n))
        b = seconds(lambda x=x, n=segment: signal.csd(x.T[None], x.T[:, None], nperseg=n))
        off = np.abs(ours - theirs).max() / np.abs(theirs).max()
        print(f"{samples:9d} {channels:9d} {segment:8d} {a:9.3f} {b:9.3f} {b / a:7.1f}   {off:.1e}")


def variances(tests: int = 400) -> None:
    """Predicted over empirical variance of every estimator: median, and the outermost entries."""
    print("\nestimator  forces  predicted / empirical variance, median over lines (least and largest entry)")
    for estimator, forces, sensors, force_noise, response_noise in CASES:
        loads, rows = [f"f{j}" for j in forces], [f"y{i}" for i in sensors]
        found = [
            estimate(spectra(40, forces, MIX, force_noise, response_noise, seed), loads, rows, estimator)
            for seed in range(tests)
        ]
        ratio = np.mean([e.variance for e in found], axis=0) / np.var([e.H for e in found], axis=0, ddof=1)
        each = np.median(ratio, axis=0)
        print(f"{estimator:>9s} {len(forces):7d} {np.median(ratio):8.3f}   ({each.min():.3f} to {each.max():.3f})")


if __name__ == "__main__":
    times()
    variances()
