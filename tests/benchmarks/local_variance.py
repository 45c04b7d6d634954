"""Impacts under a local and under a constant variance. `python -m tests.benchmarks.local_variance [seeds] [first]`.

Cantilevers of .6 to 2 m, 4 to 8 modes, 1 to 4 sensors of one kind or mixed, 1 to 3 loads, 200 to 600 samples, noise of
.5 to 10 %. Impacts are 1 to 20 half sines of 6 to 20 samples; slow, harmonic, random, stepped and swept loads show what
harm is done. "Foreign": the data come from a mesh twice as fine, with twice the modes and a step four times finer.
"Gains": every channel is wrong by 3 %.

Each line: problems; for the default and for the local prior medians of the relative error (90 % of them below), share
of the pulse in the 95 % band, share of all samples, share of the peaks, band over error on the pulse, CPU seconds; and
how often the data ask for the local prior.
"""

from __future__ import annotations

import sys
import time
import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, Penalty
from structures import ForwardModel, beams, loads, sensors
from structures._system.damping import Modal

Array = NDArray[np.float64]
THROUGHOUT = ("slow", "harmonic", "random", "step", "swept")


def impacts(rng: np.random.Generator, samples: int, count: int) -> Array:
    """Half sines of 6 to 20 samples."""
    g = np.zeros(samples)
    for _ in range(count):
        width = int(rng.integers(6, 21))
        start = int(rng.integers(5, samples - width - 5))
        g[start : start + width] += rng.uniform(0.3, 1) * np.sin(np.pi * np.arange(width) / (width - 1))
    return g


def throughout(rng: np.random.Generator, samples: int, kind: str) -> Array:
    """A load that acts all the time."""
    t = np.arange(samples)
    if kind in ("slow", "random"):
        width = int(rng.integers(40, 200) if kind == "slow" else rng.integers(1, 12))
        window = np.hanning(width + 2)[1:-1]
        return np.convolve(rng.standard_normal(samples + width - 1), window, "valid")
    if kind == "harmonic":
        tones = [(rng.uniform(0.3, 1), rng.uniform(0.003, 0.15), rng.uniform(0, 6)) for _ in range(rng.integers(1, 4))]
        return np.sum([a * np.sin(2 * np.pi * f * t + phase) for a, f, phase in tones], axis=0)
    if kind == "step":
        steps = [(rng.uniform(0.3, 1) * rng.choice([-1, 1]), rng.uniform(0.05, 0.7)) for _ in range(rng.integers(1, 4))]
        return np.sum([a * (t >= int(at * samples)) for a, at in steps], axis=0)
    return np.sin(2 * np.pi * np.cumsum(np.linspace(rng.uniform(0.001, 0.01), rng.uniform(0.05, 0.2), samples)))


@dataclass(frozen=True)
class Problem:
    """A model, its step, a record and the loads behind it."""

    model: ForwardModel
    dt: float
    y: Array
    load: Array


def problem(seed: int, kind: str = "impact", *, foreign: bool = False, gains: float = 0.0) -> Problem:
    """One of a family, by its seed."""
    rng = np.random.default_rng(seed)
    length, zeta, modes = rng.uniform(0.6, 2), rng.uniform(0.005, 0.03), int(rng.integers(4, 9))
    count = int(rng.integers(1, 4))
    m = int(rng.integers(count, 5))
    kinds = rng.choice(list("asd"), m) if rng.random() < 0.5 else np.full(m, rng.choice(list("asd")))
    seen = rng.uniform(0.15, 1, m) * length
    struck = length * (1 - np.cumsum(np.r_[rng.uniform(0, 0.2), rng.uniform(0.15, 0.25, count - 1)]))

    def built(elements: int, modes: int) -> ForwardModel:
        structure = beams.cantilever(
            elements=elements, damping=Modal(zeta), length=length, EI=800.0, mass_per_length=3.0
        )
        own = {
            "a": lambda x, i: sensors.Accelerometer(at=x, label=f"y{i}"),
            "s": lambda x, i: sensors.StrainGauge(at=0.7 * x, fibre=0.01, label=f"y{i}"),
            "d": lambda x, i: sensors.Displacement(at=x, label=f"y{i}"),
        }
        where = [loads.Point(at=x, label=f"p{i}") for i, x in enumerate(struck)]
        return ForwardModel(structure, [own[k](x, i) for i, (k, x) in enumerate(zip(kinds, seen, strict=True))], where,
                            modes=modes)  # fmt: skip

    model = built(8, modes)
    poles = np.log(np.linalg.eigvals(model.state_space(1e-6).A).astype(complex)) / 1e-6
    dt = 2 * np.pi / np.abs(poles).max() / rng.uniform(2.5, 6)
    samples = int(rng.integers(200, 600))
    if kind == "impact":
        g = np.array([impacts(rng, samples, int(rng.integers(1, 21 if j == 0 else 8))) for j in range(count)]).T
    else:
        g = np.array([throughout(rng, samples, kind) for _ in range(count)]).T
    g *= 100.0
    if foreign:
        fine = np.array([np.interp(np.arange(4 * samples) / 4, np.arange(samples), one) for one in g.T]).T
        y = built(16, 2 * modes).state_space(dt / 4).simulate(fine)[::4]
    else:
        y = model.state_space(dt).simulate(g)
    y = y * (1 + gains * rng.standard_normal(m))
    noise = 10 ** rng.uniform(np.log10(0.005), -1) * np.sqrt(np.mean(y**2, axis=0))
    return Problem(model, dt, y + noise * rng.standard_normal(y.shape), g)


def judged(p: Problem, variance: str) -> tuple[Array, bool]:
    """Error, pulse, all, peaks, band over error, CPU seconds; and whether the data ask for the local prior."""
    begun = time.process_time()
    found = Deconvolution(p.model, penalty=Penalty("identity", variance=variance)).estimate(p.y, p.dt)
    spent = time.process_time() - begun
    error, on = found.load - p.load, np.abs(p.load) > 1e-9
    inside = np.abs(error) < 1.96 * found.std
    peaks = [inside[np.argmax(np.abs(g)), j] for j, g in enumerate(p.load.T)]
    width = np.sqrt(np.mean(found.std[on] ** 2) / np.mean(error[on] ** 2))
    numbers = [np.linalg.norm(error) / np.linalg.norm(p.load), inside[on].mean(), inside.mean(), np.mean(peaks), width,
               spent]  # fmt: skip
    return np.array(numbers), bool(found.facts.get("local_asked_for", False))


def main(seeds: int, first: int) -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    groups = {
        "exact model": [problem(first + i) for i in range(seeds)],
        "foreign truth": [problem(first + i, foreign=True) for i in range(seeds)],
        "gains wrong by 3 %": [problem(first + i, gains=0.03) for i in range(seeds)],
        **{k: [problem(first + i, k) for i in range(max(seeds // 3, 1))] for k in THROUGHOUT},
    }
    judged(problem(first), "local")  # compiled
    print(f"{'':20s}{'':9s}error (90 %)     pulse  all    peaks  width  CPU s  asked for")
    for name, problems in groups.items():
        for variance in ("constant", "local", "auto"):
            rows = [judged(p, variance) for p in problems]
            table = np.array([row for row, _ in rows])
            middle, worst = np.median(table, axis=0), float(np.quantile(table[:, 0], 0.9))
            asked = "" if variance == "constant" else f"{sum(a for _, a in rows)} of {len(rows)}"
            numbers = "  ".join(f"{x:5.2f}" for x in middle[1:])
            print(f"{name:20s}{variance:9s}{middle[0]:6.3f} ({worst:5.2f})  {numbers}  {asked}", flush=True)


if __name__ == "__main__":
    given = [int(x) for x in sys.argv[1:]]
    main(*(given + [12, 0][len(given) :]))
