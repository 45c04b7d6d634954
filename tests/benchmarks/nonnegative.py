"""Loads that only push: accuracy on the half-sine benchmark, and cost over the length of the record.

Run as ``python -m tests.benchmarks.nonnegative [accuracy|cost|long]``. CPU seconds of the process, one thread, medians
of three runs (one run beyond 1e5 samples). Nothing here is compiled.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import svd, toeplitz
from scipy.optimize import minimize, nnls

from loadid._inverse import rules
from loadid._inverse.constrained.condensed import BlockNormal
from loadid._inverse.constrained.nonnegative import NonNegativeRecord, discrepancy
from loadid._inverse.constrained.normal import gap
from loadid._inverse.convolution import Convolution
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import WhitenedRecord, augment, record
from tests import halfsine

SEEDS = 3
RELATIVE = 1e-2  # lambda of the timings, over the largest singular value of 2000 samples


def made(y: NDArray, sigma: float = 1.0, penalty: str = "identity") -> WhitenedRecord:
    """Record of the benchmark, whitened."""
    s = halfsine.system()
    return record(augment(s.A, s.B, s.C / sigma, s.D / sigma, penalty), y[:, None] / sigma)


def accuracy() -> None:
    """Relative load error: Tikhonov, and loads that only push at the same lambda and at one chosen with the sign."""
    H = toeplitz(halfsine.impulse_response(), np.zeros(halfsine.SAMPLES))
    U, s, V = svd(H)
    print("relative load error, mean of", SEEDS, "seeds; L = I, 2000 samples")
    print("pulse  noise   Tikhonov           pushes only, lambda of")
    print("               best   discrep.    best    discrep.   own discrepancy   solutions")
    for width in halfsine.WIDTHS:
        for noise in halfsine.NOISES:
            rows = [_errors(width, noise, seed, U, s, V) for seed in range(SEEDS)]
            a, b, c, d, e, tried = np.mean(rows, axis=0)
            print(f"{width:5d} {noise:6.0%}   {a:6.3f} {b:8.3f} {c:10.3f} {d:9.3f} {e:12.3f} {tried:14.1f}")


def _errors(width: int, noise: float, seed: int, U: NDArray, s: NDArray, V: NDArray) -> tuple[float, ...]:
    y, g = halfsine.record(width, noise, seed)
    sigma = halfsine.level(halfsine.respond(g), noise)

    def error(load: NDArray) -> float:
        return float(np.linalg.norm(load.reshape(-1) - g) / np.linalg.norm(g))

    c, lams = U.T @ y, s[0] * np.geomspace(1e-5, 0.3, 80)
    loads = [V.T @ (s * c / (s**2 + lam**2)) for lam in lams]
    best = int(np.argmin([error(x) for x in loads]))
    path = StateSpacePath(made(y, sigma))
    relative = rules.discrepancy(rules.Sweep.over(path, 1.0)).lam
    problem = NonNegativeRecord(made(y, sigma))
    same = problem.solve(lams[best] / sigma)
    first = problem.solve(relative * float(path.scale))
    own = discrepancy(problem, first.lam, 1.0, warm=first)
    return (
        error(loads[best]), error(path.solution(relative, None).load), error(same.load), error(first.load),
        error(own.solution.load), len(own.tried),
    )  # fmt: skip


def timed(run: Callable[[], Any], repeat: int = 3) -> tuple[float, Any]:
    """Median CPU time, and what the last run gave."""
    times, out = [], None
    for _ in range(repeat):
        start = time.process_time()
        out = run()
        times.append(time.process_time() - start)
    return float(np.median(times)), out


def cost(lengths: tuple[int, ...] = (400, 2000, 20_000, 100_000)) -> None:
    """CPU time and gap, beside what a user would take instead."""
    s1 = float(np.linalg.norm(toeplitz(halfsine.impulse_response(), np.zeros(halfsine.SAMPLES)), 2))
    print("samples  lambda/s1  method                               CPU s   relative gap   steps   exact zeros")
    for n in lengths:
        y, _ = halfsine.record(41, 0.01, 0, n)
        for relative in (RELATIVE, 1e-3, 1e-4) if n >= 2000 else (RELATIVE,):
            _at(y, relative, s1)


def _at(y: NDArray, relative: float, s1: float) -> None:
    """The lines of one record at one lambda."""
    n, lam = len(y), relative * s1
    normal = BlockNormal(NonNegativeRecord(made(y)).blocks, lam)

    def line(name: str, seconds: float, v: NDArray, steps: int) -> None:
        stated = gap(normal, normal.factor(), v, normal.gradient(v), np.ones(n, bool))
        zeros = float(np.mean(v == 0))
        print(f"{n:7d} {relative:9.0e}   {name:35s} {seconds:7.2f} {stated:12.1e} {steps:9d} {zeros:10.3f}", flush=True)

    seconds, mine = timed(lambda: NonNegativeRecord(made(y)).solve(lam), 3 if n <= 20_000 else 1)
    line("this: " + mine.solver, seconds, mine.load[:, 0], mine.steps)
    if relative == RELATIVE and n <= 2000:
        H = toeplitz(halfsine.impulse_response(n), np.zeros(n))
        stack, right = np.vstack([H, lam * np.eye(n)]), np.r_[y, np.zeros(n)]
        seconds, x = timed(lambda: nnls(stack, right, maxiter=30 * n)[0], 1)
        line("scipy nnls, dense", seconds, x, 0)
    if relative == RELATIVE:
        _rivals(n, y, lam, s1, line)


def _rivals(n: int, y: NDArray, lam: float, s1: float, line: Callable[..., None]) -> None:
    """Products by FFT with L-BFGS-B, and with an accelerated projected gradient."""
    H, steps = Convolution(halfsine.impulse_response(n)[:, None, None], n), 1000

    def objective(g: NDArray) -> tuple[float, NDArray]:
        r = H.apply(g[:, None]) - y[:, None]
        value = 0.5 * float(np.sum(r**2)) + 0.5 * lam**2 * float(g @ g)
        return value / s1**2, (H.apply_transposed(r)[:, 0] + lam**2 * g) / s1**2

    options = {"maxiter": steps, "maxfun": 2000, "ftol": 1e-15, "gtol": 1e-12}
    seconds, found = timed(
        lambda: minimize(objective, np.zeros(n), jac=True, method="L-BFGS-B", bounds=[(0, None)] * n, options=options),
        1,
    )
    line("scipy L-BFGS-B, FFT", seconds, found.x, int(found.nit))

    def fista() -> NDArray:
        reach = float(np.abs(H.lines).max()) ** 2 / s1**2 + lam**2 / s1**2
        x = z = np.zeros(n)
        t = 1.0
        for _ in range(steps):
            new = np.maximum(z - objective(z)[1] / reach, 0.0)
            if (z - new) @ (new - x) > 0:  # restart (O'Donoghue & Candes 2015)
                t = 1.0
            later = (1 + np.sqrt(1 + 4 * t * t)) / 2
            x, z, t = new, new + (t - 1) / later * (new - x), later
        return x

    seconds, x = timed(fista, 1)
    line("projected FISTA with restart, FFT", seconds, x, steps)


def long(n: int = 1_000_000) -> None:
    """A million samples: time, gap, memory."""
    y, g = halfsine.record(41, 0.01, 0, n)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds, found = timed(lambda: NonNegativeRecord(made(y)).solve(1e-6), 1)
    after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    error = np.linalg.norm(found.load[:, 0] - g) / np.linalg.norm(g)
    arrays = (after - before) * 1024 / (8 * n)
    print(f"{n} samples: {seconds:.1f} s, gap {found.gap:.1e}, {found.steps} steps ({found.solver})")
    print(f"load error {error:.3f}; {arrays:.0f} arrays of the record's size at the peak")


if __name__ == "__main__":
    for name in sys.argv[1:] or ("accuracy", "cost"):
        {"accuracy": accuracy, "cost": cost, "long": long}[name]()
