"""An impact on a plate whose stiffness is off: deconvolution beside learned maps. `python -m tests.benchmarks.learned`.

An aluminium plate 0.5 x 0.4 m, 4 mm, simply supported, hit at one place; three accelerometers, 4 kHz, 400 samples, the
same noise in all records, 1 % of what the training set reads. Every route has the model of the nominal plate, 8 x 8
elements and 24 modes. The truth is a plate of 12 x 12 elements and 32 modes whose stiffness is off by a factor. The
maps learn from hits of other sizes, lengths and times on 10 x 10 elements, with 32 modes and the stiffness drawn within
8 %: what they are told of the error is its size, not its value. Errors are relative, medians over hits that no map has
seen; "alone" is what a map says where the physics answers; peak is that of the height, coverage that
of the 95 % band, impulse the share of impulses in theirs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, LearnedMap, Record
from loadid.generate import Examples, TrainingSet
from structures import ForwardModel, beams, loads, plates, sensors

DT, SAMPLES = 1 / 4000, 400
NOISE = 0.01
PLACES = ((0.11, 0.13), (0.33, 0.09), (0.21, 0.31))
HIT = (0.17, 0.22)
FACTORS = (1.0, 1.05, 0.95)
Array = NDArray[np.float64]


@cache
def plate(factor: float = 1.0, elements: int = 8, modes: int = 24) -> ForwardModel:
    """A plate whose stiffness is multiplied."""
    material = beams.Material(E=70e9 * factor, rho=2700.0, nu=0.33)
    structure = plates.plate(lengths=(0.5, 0.4), thickness=4e-3, material=material, elements=(elements, elements),
                             damping=0.01)  # fmt: skip
    seen = [sensors.Accelerometer(at=at, direction="Z", label=f"a{i}") for i, at in enumerate(PLACES)]
    return ForwardModel(structure, seen, [loads.Point(at=HIT, direction="Z", label="hit")], modes=modes)


def hit(rng: np.random.Generator) -> Array:
    """A half sine of 1 to 3 ms and 50 to 500 N."""
    width, start = rng.uniform(1e-3, 3e-3), rng.uniform(40, 200) * DT
    t = np.arange(SAMPLES) * DT - start
    return rng.uniform(50, 500) * np.sin(np.pi * t / width) * ((t >= 0) & (t <= width))


def training(draws: int, seed: int = 0) -> TrainingSet:
    """Hits on plates whose stiffness is drawn, in 17 steps."""
    rng = np.random.default_rng(seed)
    factors = np.round(rng.uniform(0.92, 1.08, draws), 2)
    histories = np.stack([hit(rng) for _ in range(draws)])
    clean = np.stack([plate(float(f), 10, 32).predict(g, DT) for f, g in zip(factors, histories, strict=True)])
    noise = NOISE * np.sqrt(np.mean(clean**2, axis=(0, 1)))
    data = clean + noise * rng.standard_normal(clean.shape)
    return TrainingSet.of(
        Examples.measured(data, histories[:, :, None], noise=noise, kinds="impact", parameters={"stiffness": factors}),
        sensors=plate().sensors, loads=plate().loads, dt=DT,
    )  # fmt: skip


@dataclass(frozen=True)
class Route:
    """Who answers.

    Parameters
    ----------
    answer : callable
        Record -> estimate.
    learned : FittedMap or None
    """

    answer: Callable[[Record], Any]
    learned: Any = None


def judged(route: Route, factor: float, noise: Array, seeds: int) -> dict[str, float]:
    """Numbers of one route at one factor; times in CPU s."""
    rows = []
    truth = plate(factor, 12, 32)
    for seed in range(seeds):
        rng = np.random.default_rng([9, seed])
        load = hit(rng)
        y = truth.predict(load, DT) + noise * rng.standard_normal((SAMPLES, len(PLACES)))
        start = time.process_time()
        found = route.answer(Record(y, DT, plate().sensors))
        cost = time.process_time() - start
        g, band = found.load[:, 0], found.band()
        inside = (load >= band[0][:, 0]) & (load <= band[1][:, 0])
        alone = g if route.learned is None else route.learned.predict(y[None]).mean[0, :, 0]
        size, impulse = np.linalg.norm(load), found.functional("impulse")
        held = abs(impulse.value - load.sum() * DT) <= 1.96 * impulse.std
        rows.append([np.linalg.norm(g - load) / size, np.linalg.norm(alone - load) / size,
                     abs(g.max() / load.max() - 1), np.mean(inside), held, "W609" in found.codes,
                     cost])  # fmt: skip
    table = np.array(rows, float)
    medians, means = np.median(table, axis=0), np.mean(table, axis=0)
    return {"error": medians[0], "alone": medians[1], "peak": medians[2], "coverage": means[3], "impulse": means[4],
            "alarms": means[5], "CPU": medians[6]}  # fmt: skip


def routes(learned: TrainingSet) -> dict[str, Route]:
    """All by name."""
    noise = learned.read([0]).noise
    physics = Deconvolution(plate(), noise=noise)
    linear = LearnedMap(plate(), physics=physics).fit(learned)
    found = {"deconvolution": Route(physics.estimate), "learned, linear": Route(linear.estimate, linear)}
    if find_spec("torch") is not None:
        network = LearnedMap(plate(), engine="torch", physics=physics).fit(learned)
        found["learned, network"] = Route(network.estimate, network)
    return found


def main(draws: int = 600, seeds: int = 20) -> None:
    """Print the table."""
    learned = training(draws)
    noise = learned.read([0]).noise
    print("stiffness  route                 error    alone    peak  coverage  impulse  alarms    CPU s")
    for name, route in routes(learned).items():
        for factor in FACTORS:
            n = judged(route, factor, noise, seeds)
            print(f"{factor:9.2f}  {name:18s} {n['error']:8.3f} {n['alone']:8.3f} {n['peak']:7.1%} "
                  f"{n['coverage']:9.3f} {n['impulse']:8.2f} {n['alarms']:7.2f} {n['CPU']:8.3f}",
                  flush=True)  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
