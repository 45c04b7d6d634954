"""Long records by the state-space path beside what users would take. `python -m tests.benchmarks.longrecord [--quick]`.

Six modes from 62 to 1158 Hz (12 states), damping 1 to 1.5 %, 10240 Hz, displacement in advance form, a half sine of 41
samples in every 1500, 1 % noise. CPU seconds of one thread, medians of some runs. "Job": lambda by robust GCV and by
discrepancy on windows, both confirmed on the whole record, the solution, and the std of every sample.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import LinearOperator

from loadid import Deconvolution
from loadid._inverse.gaussian.coarse import confirm, windows_of
from loadid._inverse.gaussian.gains import gains
from loadid._inverse.gaussian.passes import Solved, solve
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.posterior import variances
from loadid._inverse.gaussian.record import Augmented, augment, record
from loadid.paths import LinearProblem, SVDPath, choose, toeplitz
from structures import StateSpace

from .forward import exponent

FS, FREQUENCIES, DAMPING = 10240.0, np.linspace(62, 1158, 6), np.linspace(0.01, 0.015, 6)
NOISE, RELATIVE, TAPS = 0.01, 1.5e-2, 1 << 16
LIMITS = {
    "job at 1e6, s": 2.5,
    "solve at 1e6, s": 0.25,
    "exponent": 1.05,
    "memory, arrays": 12.0,
    "gradient": 1e-12,
    "MIMO, s": 1.0,
    "MIMO with choice, s": 1.0,
}
LEAST = {"lsmr at 1e5": 80.0, "PCG at 1e6": 20.0, "lsqr at 2000": 1.0, "SVD at 2000": 5.0}


# -- the case ---------------------------------------------------------------------------------------------------------
def system(loads: int = 1, sensors: int = 1) -> StateSpace:
    """Six modes; several loads and sensors at points of a simply supported span. States (omega q, dq)."""
    from scipy.linalg import block_diag, expm

    dt, blocks, rows = 1 / FS, [], []
    for f, z in zip(FREQUENCIES, DAMPING, strict=True):
        w = 2 * np.pi * f
        step = expm(dt * np.array([[0, w, 0], [-w, -2 * z * w, 1.0], [0, 0, 0]]))
        blocks.append(step[:2, :2])
        rows.append(step[:2, 2:])
    A, B = block_diag(*blocks), np.vstack(rows)
    C = np.concatenate([[1 / (2 * np.pi * f), 0] for f in FREQUENCIES])[None]
    if (loads, sensors) != (1, 1):
        modes = np.repeat(np.arange(1, 7), 2)
        B = B * np.sin(np.pi * np.outer(modes, (1 + np.arange(loads)) / (loads + 1.37)))
        C = C * np.sin(np.pi * np.outer((1 + np.arange(sensors)) / (sensors + 1.21), modes))
    return StateSpace(A, B, C @ A, C @ B, dt, "zoh")  # advance form: y[k + 1] stands beside g[k]


@dataclass(frozen=True)
class Case:
    """A record (samples, sensors) with its noise level, model and load (samples, loads)."""

    model: StateSpace
    y: NDArray[np.float64]
    sigma: float
    load: NDArray[np.float64]

    @property
    def augmented(self) -> Augmented:
        """Whitened, penalty on the load itself."""
        m = self.model
        return augment(m.A, m.B, m.C / self.sigma, m.D / self.sigma, "identity")

    @cached_property
    def lam(self) -> float:
        """Absolute lambda of the whitened problem: a given share of the largest |H|."""
        h = self.model.impulse_response(self.model.dt, TAPS)[:, 0, 0]
        return float(RELATIVE * np.abs(np.fft.rfft(h, 4 * TAPS)).max() / self.sigma)


def case(samples: int, loads: int = 1, sensors: int = 1) -> Case:
    """Impacts that take turns at the loads, and their noisy response."""
    model, rng = system(loads, sensors), np.random.default_rng(0)
    g, pulse = np.zeros((samples, loads)), np.sin(np.pi * np.arange(41) / 41)
    for i, k in enumerate(range(200, samples - 100, 1500)):
        g[k : k + 41, i % loads] = pulse
    path = StateSpacePath(record(augment(model.A, model.B, model.C, model.D, "identity"), np.zeros((samples, sensors))),
                          scale=1.0)  # fmt: skip
    clean = path.response(g)
    sigma = NOISE * float(np.std(clean))
    return Case(model, clean + sigma * rng.standard_normal(clean.shape), sigma, g)


# -- what the package does --------------------------------------------------------------------------------------------
def one(c: Case) -> Solved:
    """Gains and solution at one lambda."""
    own = record(c.augmented, c.y / c.sigma)
    return solve(own, gains(own, c.lam))


def with_spread(c: Case) -> tuple[Solved, NDArray]:
    """Solution and std of every sample at one lambda."""
    own = record(c.augmented, c.y / c.sigma)
    held = gains(own, c.lam)
    return solve(own, held), np.sqrt(variances(own, held).variance)  # type: ignore[arg-type]


def job(c: Case, rules: Iterable[str] = ("discrepancy", "robust_gcv")) -> dict[str, object]:
    """Lambda by each rule, with shared nodes, then load and std at the last one's."""
    path = StateSpacePath(record(c.augmented, c.y / c.sigma), quick=True)
    found: dict[str, object] = {"path": path}
    windows = windows_of(path) or path
    asked = choose(windows, "robust_gcv", sigma=1.0)
    lam = asked.lam
    for rule in rules:
        lam = confirm(path, asked, rule, sigma=1.0, source="stated").lam
        found[rule] = lam
    solution = path.solution(lam, 1.0)
    assert solution.posterior is not None
    return found | {"load": solution.load, "std": solution.posterior.std, "lam": lam}


def public(c: Case) -> NDArray[np.float64]:
    """The same through the public interface, which also asks all rules and raises its flags."""
    estimate = Deconvolution(c.model, noise=c.sigma, choice="robust_gcv").estimate(c.y, dt=c.model.dt)
    assert estimate.std is not None
    return estimate.load


# -- what a user would take -------------------------------------------------------------------------------------------
class Fourier:
    """Convolution with the impulse response and its adjoint, by zero-padded FFT."""

    def __init__(self, c: Case) -> None:
        from scipy import fft

        self.samples, self.y = len(c.y), c.y[:, 0] / c.sigma
        self.padded = fft.next_fast_len(2 * self.samples, real=True)
        h = c.model.impulse_response(c.model.dt, min(self.samples, TAPS))[:, 0, 0] / c.sigma
        self.symbol = fft.rfft(h, self.padded)

    def times(self, symbol: NDArray, x: NDArray) -> NDArray[np.float64]:
        """Filter by a symbol."""
        from scipy import fft

        return fft.irfft(symbol * fft.rfft(np.ravel(x), self.padded), self.padded)[: self.samples]

    def operator(self) -> LinearOperator:
        """For scipy's solvers."""
        shape = (self.samples, self.samples)
        return LinearOperator(shape, matvec=lambda x: self.times(self.symbol, x),
                              rmatvec=lambda x: self.times(self.symbol.conj(), x), dtype=float)  # fmt: skip


def krylov(c: Case, name: str, tolerance: float = 1e-8) -> tuple[NDArray, int]:
    """scipy's LSQR or LSMR on the FFT operator; the load and the iterations."""
    from scipy.sparse import linalg

    f = Fourier(c)
    found = getattr(linalg, name)(f.operator(), f.y, damp=c.lam, atol=tolerance, btol=tolerance)
    return found[0], int(found[2])


def pcg(c: Case, tolerance: float = 1e-8) -> tuple[NDArray, int]:
    """Conjugate gradients with the compressed padded circulant as preconditioner."""
    f, lam = Fourier(c), c.lam
    power = np.abs(f.symbol) ** 2 + lam**2
    r = f.times(f.symbol.conj(), f.y)
    stop = tolerance * float(np.linalg.norm(r))
    x, z = np.zeros_like(r), f.times(1 / power, r)
    d, energy, count = z, float(r @ z), 0
    while np.linalg.norm(r) > stop and count < 500:
        u = f.times(f.symbol.conj(), f.times(f.symbol, d)) + lam**2 * d
        step = energy / float(d @ u)
        x += step * d
        r -= step * u
        z = f.times(1 / power, r)
        energy, before = float(r @ z), energy
        d = z + energy / before * d
        count += 1
    return x, count


def wiener(c: Case) -> tuple[NDArray, int]:
    """Division of zero-padded spectra."""
    f = Fourier(c)
    return f.times(f.symbol.conj() / (np.abs(f.symbol) ** 2 + c.lam**2), f.y), 0


def dense(c: Case) -> NDArray[np.float64]:
    """SVD of the Toeplitz matrix, its sweep, all rules, and the std."""
    h = c.model.impulse_response(c.model.dt, len(c.y))
    path = SVDPath(LinearProblem.whitened(toeplitz(h), c.y, noise=[c.sigma]))
    solution = path.solution(choose(path, "robust_gcv", sigma=1.0).lam, 1.0)
    assert solution.posterior is not None
    return np.asarray(solution.posterior.std)


# -- tables -----------------------------------------------------------------------------------------------------------
def cpu(work: Callable[[], object], repeat: int = 3) -> float:
    """Median CPU time of some runs, in seconds."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times))


def one_lambda(sizes: Iterable[int], repeat: int) -> dict[str, float]:
    """Solution at one lambda, with the distance of each alternative to it; ratios of times."""
    print("\nOne lambda (CPU s; iterations; relative distance to the exact solution)")
    print(f"{'samples':>9} {'state space':>12} {'gradient':>9}   alternatives")
    ratios = {}
    for n in sizes:
        c = case(n)
        own = cpu(lambda c=c: one(c), 2 * repeat + 1)
        exact = one(c).load[:, 0]
        path = StateSpacePath(record(c.augmented, c.y / c.sigma), quick=True)
        line = f"{n:9d} {own:12.4f} {path.gradient(c.lam / float(path.scale)):9.1e}  "
        rivals: dict[str, Callable[[], tuple[NDArray, int]]] = {}
        if n <= 100_000:
            rivals |= {name: (lambda name=name, c=c: krylov(c, name)) for name in ("lsqr", "lsmr")}
        rivals |= {"PCG": lambda c=c: pcg(c), "Wiener": lambda c=c: wiener(c)}
        for name, run in rivals.items():
            load, steps = run()
            seconds = cpu(run, repeat if n < 100_000 or name not in ("lsqr", "lsmr") else 1)
            distance = float(np.linalg.norm(load - exact) / np.linalg.norm(exact))
            ratios[f"{name} at {n}"] = seconds / own
            line += f"  {name} {seconds:.4f} ({steps}; {distance:.0e}; {seconds / own:.1f}x)"
        print(line)
    return {name.replace("1000000", "1e6").replace("100000", "1e5"): value for name, value in ratios.items()}


def growth(sizes: Iterable[int], repeat: int) -> dict[str, float]:
    """Job and single solve over the length of the record."""
    print("\nGrowth (CPU s): job = lambda by two rules, solution, std; one solve; the public interface with its flags")
    heads = ("samples", "job", "us/sample", "solve", "public", "memory")
    print(("{:>9} {:>8} {:>10} {:>8} {:>8} {:>8}   lambda (two rules)   error").format(*heads))
    sizes, jobs, solves, found = list(sizes), [], [], {}
    for n in sizes:
        c = case(n)
        c.lam  # noqa: B018 (not part of what is timed)
        jobs.append(cpu(lambda c=c: job(c), repeat))
        solves.append(cpu(lambda c=c: one(c), repeat))
        done, single = job(c), solves[-1]
        shown = cpu(lambda c=c: public(c), 1) if n <= 1_000_000 else float("nan")
        arrays = memory(n) if n >= 1_000_000 else float("nan")
        error = float(np.linalg.norm(done["load"] - c.load) / np.linalg.norm(c.load))  # type: ignore[operator]
        print(f"{n:9d} {jobs[-1]:8.3f} {1e6 * jobs[-1] / n:10.2f} {single:8.4f} {shown:8.2f} {arrays:8.1f}   "
              f"{done['robust_gcv']:.3g} / {done['discrepancy']:.3g}   {error:.3f}")  # fmt: skip
        if n == 1_000_000:
            found = {"job at 1e6, s": jobs[-1], "solve at 1e6, s": single}
        if n >= 1_000_000:
            found["memory, arrays"] = max(arrays, found.get("memory, arrays", 0.0))
        if n == 1_000_000:
            path = done["path"]
            assert isinstance(path, StateSpacePath)
            found["gradient"] = path.gradient(float(done["lam"]))  # type: ignore[arg-type]
    steps = [exponent(sizes[i : i + 2], jobs[i : i + 2]) for i in range(len(sizes) - 1)]
    print("exponent of the job from size to size: " + ", ".join(f"{e:.2f}" for e in steps)
          + f"; of one solve over all: {exponent(sizes, solves):.2f}")  # fmt: skip
    return found | {"exponent": max(exponent(sizes, jobs), exponent(sizes, solves))}


def memory(samples: int) -> float:
    """Peak memory of a job with its record in a process of its own, less the interpreter and the case, in records."""
    run = [sys.executable, "-m", "tests.benchmarks.longrecord", "--memory", str(samples)]
    return float(subprocess.run(run, check=True, capture_output=True, text=True).stdout)


def _memory(samples: int) -> None:
    job(case(2_000))
    job(case(30_000))
    c = case(samples)
    before = _resident() - c.y.nbytes
    job(c)
    print((_resident("VmHWM") - before) / (8.0 * samples))


def _resident(field: str = "VmRSS") -> float:
    """Memory of this process, or its highest (VmHWM; that of `resource` begins with the parent's)."""
    with open("/proc/self/status") as file:
        return next(1024.0 * float(line.split()[1]) for line in file if line.startswith(field))


def short(repeat: int) -> dict[str, float]:
    """The whole job at 2000 samples beside a dense SVD."""
    c = case(2000)
    own, other = cpu(lambda: job(c), repeat), cpu(lambda: dense(c), repeat)
    print(f"\nWhole job at 2000 samples: state space {own:.3f} s, dense SVD {other:.3f} s, ratio {other / own:.1f}")
    return {"SVD at 2000": other / own}


def several(repeat: int) -> dict[str, float]:
    """Four loads and six sensors, 1e5 samples."""
    c = case(100_000, 4, 6)
    single, whole = cpu(lambda: with_spread(c), repeat), cpu(lambda: job(c, ("robust_gcv",)), repeat)
    print(f"\n4 loads, 6 sensors, 1e5 samples: one lambda with std {single:.3f} s, with choice {whole:.3f} s")
    return {"MIMO, s": single, "MIMO with choice, s": whole}


def main(quick: bool = False) -> int:
    """Print all tables; 1 where a figure is missed."""
    threads = os.environ.get("OPENBLAS_NUM_THREADS", "not limited")
    print(f"{os.cpu_count()} cores; threads of the linear algebra: {threads}")
    repeat = 1 if quick else 3
    job(case(2_000))
    job(case(30_000))
    found = one_lambda((2000, 10_000) if quick else (2000, 10_000, 100_000, 1_000_000), repeat)
    found |= growth((10_000, 100_000) if quick else (10_000, 100_000, 1_000_000, 10_000_000), repeat)
    found |= several(repeat) | short(repeat)
    print("\nFigures (limit)")
    missed = 0
    for name, value in found.items():
        if name in LIMITS or name in LEAST:
            good = value <= LIMITS[name] if name in LIMITS else value >= LEAST[name]
            missed += not good
            bound = f"at most {LIMITS[name]:g}" if name in LIMITS else f"at least {LEAST[name]:g} times faster"
            print(f"  {name:22s} {value:10.3g}   ({bound}){'' if good else '   MISSED'}")
    return int(missed > 0)


if __name__ == "__main__":
    if "--memory" in sys.argv:
        _memory(int(sys.argv[-1]))
    else:
        sys.exit(main("--quick" in sys.argv[1:]))
