"""Which hold a filter should assume of a load that runs continuously: zero order, first order, or as its prior says.

Run with ``python -m tests.benchmarks.holds [seeds]``. The building of ten storeys, three accelerometers and a
displacement, 1 % noise, 30 s; the truth is drawn and simulated at a twentieth of the filter's step, in stairs or
straight between these samples. Stairs of a twentieth already cost a smooth load a part of its error, for they are late
by half their width. The prior is Matern 3/2 with a std of 100 N and a length of 0.08 s, which is right for the Matern
load. Every cell is load error / coverage of the 95 % band / squared innovation per channel, means over the seeds; the
steady filter runs, and the first two seconds do not count.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.loop import Loop
from loadid._inverse.gaussian.steady import steady
from loadid.priors import Matern32
from structures import ForwardModel, chains, loads, sensors
from structures._system.damping import Rayleigh

from .. import tracked

SECONDS, FINE, SKIP = 30.0, 20, 2.0
STEPS = (0.01, 0.005, 0.002)
HOLDS = ("zoh", "foh", "joint")
PRIOR = Matern32(100.0, 0.08)


@dataclass(frozen=True, eq=False)
class Record:
    """Response (samples, 4) to a load (samples, 1) that ran continuously, with the std of its noise."""

    y: NDArray[np.float64]
    load: NDArray[np.float64]
    noise: NDArray[np.float64]
    dt: float


def tower() -> ForwardModel:
    """The building with the sensors of the benchmark, all modes kept."""
    structure = chains.shear_building(masses=np.ones(10), stiffnesses=2500.0, damping=Rayleigh(0.1, 5e-4))
    rows = [sensors.Accelerometer(f"{i}+X") for i in (3, 6, 10)]
    return ForwardModel(structure, [*rows, sensors.Displacement("10+X", label="roof")], [loads.Point("10+X")])


def record(kind: str, dt: float, seed: int, truth: str) -> Record:
    """Record of the building; `truth` is how the load runs between its samples at ``dt / FINE``."""
    setup, rng = tracked.building(dt=dt), np.random.default_rng(seed)
    load = tracked.history(kind, np.arange((round(SECONDS / dt) + 1) * FINE) * dt / FINE, rng)
    y, noise = tracked.disturbed(setup.respond(load, FINE, truth), rng, 0.01)
    return Record(y, load[::FINE], noise, dt)


def judged(case: Record, hold: str) -> tuple[float, float, float]:
    """Relative load error, coverage of the 95 % band, squared innovation per channel."""
    model = augment(tower(), case.dt, PRIOR, noise=case.noise, hold=hold, state_noise=1e-7)
    known = steady(model, case.dt)
    load, e = np.empty(case.load.shape), np.empty(case.y.shape)
    Loop(known.rows(), model.p, model.m, model.x0).block(case.y, load, e)
    rest = slice(round(SKIP / case.dt), None)
    error = (load - case.load)[rest]
    white = np.linalg.solve(known.Se_root, e[rest].T)
    size = np.sqrt(np.sum(error**2) / np.sum(case.load[rest] ** 2))
    return float(size), float(np.mean(np.abs(error) < 1.96 * known.std)), float(np.mean(white**2))


def main(seeds: int = 1) -> None:
    """Print the table."""
    print("load    truth     step s " + "".join(f"{hold:>22}" for hold in HOLDS))
    for kind in ("mix", "matern"):
        for truth, words in (("zoh", "stairs"), ("foh", "straight")):
            for dt in STEPS:
                cases = [record(kind, dt, seed, truth) for seed in range(seeds)]
                cells = [np.mean([judged(case, hold) for case in cases], axis=0) for hold in HOLDS]
                print(f"{kind:7} {words:8} {dt:7g} " + "".join(f"{e:10.4f} /{c:4.2f} /{n:5.2f}" for e, c, n in cells))


if __name__ == "__main__":
    main(*(int(x) for x in sys.argv[1:]))
