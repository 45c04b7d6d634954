"""What an offset of accelerometers costs: `python -m tests.benchmarks.offsets [PROBLEMS [SEED]]`.

Problems of `tests.campaigns.impacts` that have an accelerometer. The first one gets an offset, the others with a chance
of one half: of 0.2 to 20 times their noise, or of 1 to 100 % of their rms. The error is that over the same record
without; the CPU time of clean records is that over the time without asking for offsets.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution
from loadid._families import offsets
from structures import ForwardModel, beams, damping, loads, sensors

from ..campaigns.impacts import Problem, problem


def problems(count: int, seed: int) -> Iterator[tuple[int, Problem, NDArray[np.float64]]]:
    """Number, problem, and offsets (sensors,) of each."""
    number = seed * 100_000
    while count:
        given, number = problem(number), number + 1
        seen = [i for i, c in enumerate(given.model.sensors) if c.quantity == "acceleration"]
        if not seen:
            continue
        count -= 1
        rng, off, rms = np.random.default_rng([number, 77]), np.zeros(len(given.sigma)), given.record.std(axis=0)
        for i in seen:
            if i == seen[0] or rng.random() < 0.5:
                side, small = rng.choice([-1, 1]), rng.random() < 0.5
                size = given.sigma[i] * 10 ** rng.uniform(np.log10(0.2), np.log10(20)) if small else 0.0
                off[i] = side * (size if small else rms[i] * 10 ** rng.uniform(-2, 0))
        yield number - 1, given, off


def estimated(family: Deconvolution, record: Any, dt: float, *, asked: bool = True) -> tuple[Any, float]:
    """Answer and CPU seconds, with or without asking for offsets."""
    told = offsets.told
    try:
        if not asked:
            offsets.told = lambda *given: None
        began = time.process_time()
        return family.estimate(record, dt), time.process_time() - began
    finally:
        offsets.told = told


def errors(count: int, seed: int) -> None:
    """Table of the problems that lose more than a fifth, and the sums."""
    rows = []
    for number, given, off in problems(count, seed):
        family = given.inversion()
        before, plain = estimated(family, given.record, given.dt, asked=False)
        clean, asked = estimated(family, given.record, given.dt)
        found, cost = estimated(family, given.record + off, given.dt)
        size = np.linalg.norm(given.truth)
        error = [np.linalg.norm(e.load - given.truth) / size for e in (clean, found)]
        inside = [np.mean(np.abs(e.load - given.truth) <= 2 * e.std) for e in (clean, found)]
        said = ["offsets" in e.facts for e in (clean, found)]
        rows.append([error[1] / error[0], *inside, plain, asked, cost, *said, np.array_equal(before.load, clean.load)])
        if not 0.8 < rows[-1][0] < 1.2:
            print(
                f"{number}: {len(given.record)} samples, offset {np.abs(off / given.sigma).max():.2g} noise, error "
                f"{error[0]:.3f} -> {error[1]:.3f}, grade {clean.grade.letter} -> {found.grade.letter}",
                flush=True,
            )
    ratio, one, two, plain, asked, cost, alarms, said, same = np.array(rows, float).T
    print(f"{count} problems: error over that of the clean record, median {np.median(ratio):.3f}, "
          f"> 1.2 in {np.sum(ratio > 1.2)}, > 1.5 in {np.sum(ratio > 1.5)}, > 3 in {np.sum(ratio > 3)}")  # fmt: skip
    print(f"within 2 std: {np.mean(one):.3f} clean, {np.mean(two):.3f} with offsets; said in {np.sum(said):.0f}")
    print(
        f"clean records: {np.sum(alarms):.0f} false alarms, the same answer in {np.sum(same):.0f}; CPU "
        f"{asked.sum() / plain.sum():.2f} of that without asking, {cost.sum() / plain.sum():.2f} with offsets"
    )


def long_records() -> None:
    """CPU time of clean and of offset records of many samples."""
    beam = beams.simply_supported(length=2.0, section=beams.Section.rectangle(0.05, 0.01), elements=20,
                                  material=beams.materials.steel, damping=damping.Modal(0.02))  # fmt: skip
    gauges = [sensors.Accelerometer(at=x, direction="Z", label=f"s{i}") for i, x in enumerate((0.3, 0.7, 1.1, 1.6))]
    model, dt = ForwardModel(beam, gauges, [loads.Point(at=0.65, direction="Z")], modes=6), 5e-4
    for samples in (2000, 8000, 30000):
        rng = np.random.default_rng(samples)
        load = np.convolve(rng.standard_normal(samples), np.hanning(20), "same")[:, None] * 10
        y = model.predict(load, dt)
        noise = 0.02 * y.std(axis=0)
        y = y + noise * rng.standard_normal(y.shape)
        family = Deconvolution(model, noise=noise)
        plain, asked, cost = (estimated(family, y + off, dt, asked=a)[1]
                              for off, a in ((0.0, False), (0.0, True), (y.std(axis=0) * 0.2, True)))  # fmt: skip
        print(f"{samples} samples: {plain:.1f} s without asking, {asked / plain:.2f} of it asked, "
              f"{cost / plain:.2f} with offsets", flush=True)  # fmt: skip


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    given = [int(a) for a in sys.argv[1:]]
    errors(*(given + [60, 3][len(given) :]))
    long_records()
