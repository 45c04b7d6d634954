"""Lambda of long records with few hits: load error of the default over that of the best lambda.

Two set-ups, both with the exact model. ``six``: six modes from 62 to 1158 Hz, one sensor (displacement or acceleration)
under a zero-order hold, half sines of 41 samples, 5 % noise. ``cantilever``: a steel beam of 0.6 m with 14 modes of 1 %
damping, three accelerometers, half sines of 1000 N over 20 samples, 1.5 % noise. The hits are one, a few, twenty,
early, late or in pairs; the noise level is stated or not. Responses are made by one `scipy.signal.lfilter` for each
pole, not by the solver's passes.

Two references, both on a grid of a tenth of a decade with the truth known: the best lambda of this draw of the noise
(``best``), which noise and bias that cancel by chance may make far better than any rule can know, and the lambda of the
smallest mean square error over `DRAWS` draws. ``expected`` is the root mean square error over these draws at the chosen
lambda over that at the latter: what the choice is worth.

Run ``python -m tests.benchmarks.long_lambda [--samples 4000 10000 ...] [--seeds 5] [--first 0] [--turns]``;
with ``--turns`` each seed takes one layout of the hits, in turn.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, Noise, Penalty
from loadid._families.data import gather
from loadid._families.posing import pose
from loadid._inverse.gaussian.path import StateSpacePath
from structures import ForwardModel, Model, StateSpace, beams, damping, loads, sensors
from tests.halfsine import DAMPING, FREQUENCIES, RATE, SIGNS

DRAWS = 8  # of the noise, for the expectation
LAYOUTS = ("one early", "one late", "pair", "few", "twenty")


@dataclass(frozen=True)
class Problem:
    """A model with a record of (samples, sensors), the load (samples,) behind it, and the noise std (sensors,)."""

    model: Model
    dt: float
    record: NDArray[np.float64]
    load: NDArray[np.float64]
    sigma: NDArray[np.float64]


def six(kind: str) -> StateSpace:
    """Six modes with one sensor of ``displacement`` or ``acceleration``, zero-order hold."""
    from scipy.signal import cont2discrete

    omega = 2 * np.pi * FREQUENCIES
    A, B, C = np.zeros((12, 12)), np.zeros((12, 1)), np.zeros((1, 12))
    D = np.zeros((1, 1))
    for k, (w, z, s) in enumerate(zip(omega, DAMPING, SIGNS, strict=True)):
        A[2 * k, 2 * k + 1], A[2 * k + 1, 2 * k : 2 * k + 2] = 1.0, (-(w**2), -2 * z * w)
        B[2 * k + 1] = 1.0
        C[0, 2 * k : 2 * k + 2] = (s, 0.0) if kind == "displacement" else (-s * w**2, -2 * s * z * w)
        D += 0.0 if kind == "displacement" else s
    A, B, C, D, _ = cont2discrete((A, B, C, D), 1 / RATE, "zoh")
    return StateSpace(A, B, C, D, 1 / RATE, "zoh")


def cantilever() -> ForwardModel:
    """The steel beam with three accelerometers."""
    beam = beams.cantilever(
        length=0.6,
        section=beams.Section.rectangle(width=0.04, height=0.01),
        material=beams.materials.steel,
        elements=40,
        damping=damping.Modal(0.01),
    )
    gauges = [sensors.Accelerometer(at=x, direction="Z") for x in (0.2, 0.35, 0.5)]
    return ForwardModel(beam, gauges, [loads.Point(at=0.45, direction="Z")], modes=14)


def starts(layout: str, samples: int, width: int, rng: np.random.Generator) -> NDArray[np.int_]:
    """First samples of the hits."""
    end = samples - 3 * width
    if layout == "one early":
        return np.array([int(rng.integers(samples // 20, samples // 8))])
    if layout == "one late":
        return np.array([int(rng.integers(samples * 9 // 10, end))])
    if layout == "pair":
        first = int(rng.integers(samples // 10, end - 4 * width))
        return np.array([first, first + int(rng.integers(width, 3 * width))])
    count = 20 if layout == "twenty" else max(samples // 4000, 2)
    return np.sort(rng.integers(width, end, count))


def problem(setup: str, layout: str, samples: int, seed: int) -> Problem:
    """One random record."""
    rng = np.random.default_rng([seed, samples, LAYOUTS.index(layout), len(setup)])
    model = cantilever() if setup == "cantilever" else six(setup.split()[1])
    dt, width, height, noise = (1e-4, 20, 1000.0, 0.015) if setup == "cantilever" else (1 / RATE, 41, 1.0, 0.05)
    load = np.zeros(samples)
    for k in starts(layout, samples, width, rng):
        size = height * (1.0 if layout.startswith("one") else rng.uniform(0.3, 1.0))
        load[k : k + width] += size * np.sin(np.pi * (np.arange(width) + 0.5) / width)
    clean = respond(model, dt, load)
    sigma = noise * clean.std(axis=0)
    return Problem(model, dt, clean + sigma * rng.standard_normal(clean.shape), load, sigma)


def respond(model: Model, dt: float, load: NDArray) -> NDArray[np.float64]:
    """Response (samples, sensors) by the poles and residues of the discrete system, one filter for each mode."""
    from scipy.signal import lfilter

    system = model if isinstance(model, StateSpace) else model.state_space(dt, model.default_hold)
    poles, V = np.linalg.eig(system.A)
    residues = (system.C @ V) * np.linalg.solve(V, system.B.astype(complex))[:, 0]
    out = system.D[:, 0] * load[:, None]
    delayed = np.concatenate([[0.0], load[:-1]]).astype(complex)
    for pole, r in zip(poles, residues.T, strict=True):
        out = out + np.real(lfilter([1.0], [1.0, -pole], delayed)[:, None] * r)
    return out


def error(load: NDArray, truth: NDArray) -> float:
    """Relative error of a load history; without a direct term the last sample is not seen."""
    truth = truth[: len(load)]
    return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))


@dataclass(frozen=True)
class Judged:
    """Error of the default, the best of this draw, ratio in expectation, what was chosen, CPU s of the public call."""

    error: float
    best: float
    expected: float
    words: str
    seconds: float


def errors(path: StateSpacePath, lam: float, p: Problem, others: list[NDArray]) -> NDArray[np.float64]:
    """Load errors at one lambda: of the record, then of other draws (whitened records) of its noise."""
    held, solved = path._solved(lam)
    return np.array([error(g[:, 0], p.load) for g in (solved.load, *(path._again(lam, held, y).load for y in others))])


@dataclass(frozen=True, eq=False)
class Yardstick:
    """A problem, its path with the noise level known, and the errors at any lambda: they are the same for all choices.

    Parameters
    ----------
    problem : Problem
    path : StateSpacePath
    others : list of array
        Whitened records of other draws of the noise.
    """

    problem: Problem
    path: StateSpacePath
    others: list[NDArray]

    @cache  # noqa: B019 - one is kept at a time
    def at(self, lam: float) -> tuple[float, float]:
        """Error of the record, root mean square of those of the other draws."""
        made = errors(self.path, lam, self.problem, self.others)
        return float(made[0]), float(np.sqrt(np.mean(made[1:] ** 2)))


@lru_cache(maxsize=1)
def yardstick(setup: str, layout: str, samples: int, seed: int) -> Yardstick:
    """What choices on one record are measured by."""
    p = problem(setup, layout, samples, seed)
    known = Deconvolution(p.model, noise=p.sigma)
    path = pose(p.model, gather(p.record, p.dt, p.model, None, allow_missing=True), known.settings).path
    assert isinstance(path, StateSpacePath)
    clean, rng = respond(p.model, p.dt, p.load)[-len(path.record.y) :] / p.sigma, np.random.default_rng(seed)
    return Yardstick(p, path, [clean + rng.standard_normal(clean.shape) for _ in range(DRAWS)])


def judged(setup: str, layout: str, samples: int, seed: int, stated: bool) -> Judged:
    """The public call, and what other lambdas would have given."""
    known = yardstick(setup, layout, samples, seed)
    p = known.problem
    begun = time.process_time()
    noise = Noise(p.sigma if stated else None, source="data sheet" if stated else None)
    family = Deconvolution(p.model, noise=noise, penalty=Penalty(variance="constant"))  # of which lambda is
    found = family.estimate(p.record, p.dt)
    spent = time.process_time() - begun
    chosen = found.choice.lam  # relative: whitening by the noise of like sensors changes it little
    tenths = round(10 * np.log10(chosen)) + np.arange(-20, 11)
    tenths = tenths[(tenths > -70) & (tenths < 0)]
    best, mean = (smallest(lambda i, of=of: known.at(float(10 ** (tenths[i] / 10)))[of], len(tenths)) for of in (0, 1))
    own = known.at(float(chosen))[1]
    words = f"{found.choice.rule} {found.choice.lam:.2g}, {found.choice.verdict}"
    mine = error(found.load[:, 0], p.load)
    return Judged(mine, min(mine, best), float(own / min(own, mean)), words, spent)


def smallest(value: Callable[[int], float], count: int) -> float:
    """Smallest of `count` values that fall to a minimum and rise: every fourth, then those around the best."""
    first = min(range(0, count, 4), key=value)
    return min(value(i) for i in range(max(first - 3, 0), min(first + 4, count)))


def main() -> None:
    """Print a line for every record, and the worst ratios."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--samples", type=int, nargs="+", default=[4000, 10_000, 30_000, 100_000])
    parser.add_argument("--setups", nargs="+", default=["six displacement", "six acceleration", "cantilever"])
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--turns", action="store_true", help="one layout of the hits a seed, in turn")
    asked = parser.parse_args()
    ratios = []
    print(f"{'set-up':18s}{'samples':>8s} {'hits':10s}{'seed':>5s} {'sigma':8s}{'error':>7s}{'best':>8s}{'ratio':>7s}"
          f"{'expected':>9s}{'CPU s':>7s}")  # fmt: skip
    for setup in asked.setups:
        for samples in asked.samples:
            for i, seed in product(range(len(LAYOUTS)), range(asked.first, asked.first + asked.seeds)):
                if asked.turns and seed % len(LAYOUTS) != i:
                    continue
                # with turns, every other round of layouts has its noise stated
                stated = bool((seed // len(LAYOUTS) + i if asked.turns else seed + i) % 2)
                j = judged(setup, LAYOUTS[i], samples, seed, stated)
                ratios.append((j.error / j.best, j.expected))
                numbers = f"{j.error:7.4f}{j.best:8.4f}{ratios[-1][0]:7.3f}{j.expected:9.3f}{j.seconds:7.1f}"
                print(f"{setup:18s}{samples:8d} {LAYOUTS[i]:10s}{seed:5d} {'stated' if stated else 'unknown':8s}"
                      f"{numbers}  {j.words}", flush=True)  # fmt: skip
    for name, x in zip(("of this draw", "in expectation"), np.array(ratios).T, strict=True):
        print(f"{name}: worst {x.max():.3f}, median {np.median(x):.3f}, {np.mean(x <= 1.2):.1%} within 1.2")


if __name__ == "__main__":
    main()
