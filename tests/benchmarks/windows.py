"""Long records behind impulse responses in windows, beside one piece. `python -m tests.benchmarks.windows [--quick]`.

Six modes (62 to 1158 Hz at 10240 Hz, forgotten after 8000 samples), half-sine pulses, 1 % noise, one sensor, through
the public interface: lambda by the default rule, load, std of every sample, flags. "One lambda" leaves the rule out.
Each row is a process of its own, and so are the memory figures: highest less that before, in arrays of the record.
"""

from __future__ import annotations

import subprocess
import sys
import time

import numpy as np

from loadid import Deconvolution, Lambda, Noise
from loadid._inverse.convolution import PenalizedConvolution
from structures import ImpulseModel

from .convolved import RATE, responses
from .longrecord import _resident

TAPS, LAMBDA = 8000, 4e-3
COMPLETE = 100_000  # samples up to which the rules are asked in one piece: beyond, that takes minutes


def case(samples: int) -> tuple[ImpulseModel, np.ndarray, float]:
    """Model, record (samples, 1) and its noise level."""
    h = responses(TAPS) * np.exp(-np.arange(TAPS) / 1200)[:, None, None]
    g = np.zeros((1, 1, samples))
    for start in range(100, samples - 50, 1500):
        g[..., start : start + 41] = np.sin(np.pi * np.arange(41) / 40)
    clean = PenalizedConvolution(h, samples).convolve(g)[0].T
    sigma = 0.01 * float(clean.std())
    return (
        ImpulseModel(h, 1 / RATE, kind="held"),
        clean + sigma * np.random.default_rng(1).standard_normal(clean.shape),
        sigma,
    )


def one(samples: int, path: str, choice: float | None) -> None:
    """CPU seconds, memory, error bound over std, lambda and the load's norm, of one run."""
    model, y, sigma = case(3000)
    Deconvolution(model, noise=sigma, choice=Lambda(LAMBDA, path=path)).estimate(
        y, 1 / RATE
    )  # nothing pays for imports
    model, y, sigma = case(samples)
    family = Deconvolution(model, noise=Noise(sigma, source="known"), choice=Lambda(choice, path=path))
    before, start = _resident(), time.process_time()
    found = family.estimate(y, 1 / RATE)
    spent, memory = time.process_time() - start, (_resident("VmHWM") - before) / y.nbytes
    print(spent, memory, found.facts.get("window_bound", 0.0), found.choice.lam, float(np.linalg.norm(found.load)))


def asked(samples: int, path: str, choice: float | None) -> list[float]:
    """As `one`, in a process of its own."""
    run = [sys.executable, "-m", "tests.benchmarks.windows", "--one", str(samples), path, str(choice)]
    return [float(x) for x in subprocess.run(run, check=True, capture_output=True, text=True).stdout.split()]


def main(quick: bool = False) -> None:
    """Print the table."""
    print("  samples            one piece           in windows                    ")
    print("  samples  job       CPU s  arrays       CPU s  arrays    ratio   bound / std    lambda of both")
    for samples in (20_000, 50_000) if quick else (20_000, 50_000, 100_000, 1_000_000):
        for choice in (LAMBDA, None):
            whole = asked(samples, "toeplitz", choice) if choice or samples <= COMPLETE else None
            s, memory, bound, lam, _ = asked(samples, "windows", choice)
            job = "one lambda" if choice else "rules, std"
            left = f"{whole[0]:8.2f}{whole[1]:8.1f}" if whole else "     not run    "
            ratio = f"{whole[0] / s:8.2f}" if whole else "        "
            print(f"{samples:9d}  {job}{left}    {s:8.2f}{memory:8.1f} {ratio}{bound:14.1e}"
                  f"    {whole[3] if whole else float('nan'):.4g} / {lam:.4g}", flush=True)  # fmt: skip


if __name__ == "__main__":
    if "--one" in sys.argv:
        at = sys.argv.index("--one") + 1
        one(int(sys.argv[at]), sys.argv[at + 1], None if sys.argv[at + 2] == "None" else float(sys.argv[at + 2]))
    else:
        main("--quick" in sys.argv)
