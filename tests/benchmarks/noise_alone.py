"""What every family makes of records that hold nothing but noise: grades, and who says that no load is told (W318).

`python -m tests.benchmarks.noise_alone [draws] [words ...]`, where only cases count that begin with a word. Noise is
white, its level stated or not; beam and readings are those of `tests.guards.test_not_told`. Each line: grades of the
draws (* with W318), what was refused, and CPU seconds a draw.
"""

from __future__ import annotations

import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from loadid import (
    AutomaticInversion,
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    HarmonicInversion,
    LearnedMap,
    LoadTracker,
    LocationSearch,
    Noise,
    NotIdentifiable,
    Penalty,
    Record,
    ShapeSensing,
    SparseDeconvolution,
    StaticInversion,
)
from loadid.constraints import NonNegative
from loadid.generate import Examples, TrainingSet
from structures import ForwardModel, bases, beams, damping, loads, plates, sensors

DT, SAMPLES = 1 / 4096, 300
BEAM = beams.simply_supported(length=1.0, section=beams.Section.rectangle(0.04, 0.01), elements=40,
                              material=beams.materials.steel, damping=damping.Modal(0.02))  # fmt: skip
GAUGES = [sensors.StrainGauge(at=x, fibre=0.005, label=f"s{k}") for k, x in enumerate(np.linspace(0.1, 0.9, 8))]
FEW = [sensors.StrainGauge(at=x, fibre=0.005, label=f"s{k}") for k, x in enumerate((0.2, 0.4, 0.6, 0.8))]
ACC = [sensors.Accelerometer(at=x) for x in (0.41, 0.76)]
DISP = [sensors.Displacement(at=x, direction="Z") for x in (0.41, 0.76)]
Case = Callable[[np.random.Generator], Any]


def on(seen: list[Any], *acting: Any) -> ForwardModel:
    return ForwardModel(BEAM, seen, list(acting) or [loads.Point(at=0.59, label="F")], modes=6)


def under(seen: list[Any], points: int) -> ForwardModel:
    """A line load."""
    return ForwardModel(BEAM, seen, bases.hats(BEAM, [np.linspace(0, 1, points)]), modes=6)


def histories(known: bool) -> Iterator[tuple[str, Case]]:
    acc, disp, mixed = on(ACC), on(DISP), on([ACC[0], DISP[1]])

    def of(family: Any, model: Any, std: Any, samples: int = SAMPLES, **settings: Any) -> Case:
        made = family(model, noise=np.broadcast_to(std, len(model.sensors)) if known else None, **settings)
        return lambda rng: made.estimate(std * rng.standard_normal((samples, len(model.sensors))), DT)

    yield "Deconvolution, accelerations", of(Deconvolution, acc, 1.0)
    yield "Deconvolution, displacements", of(Deconvolution, disp, 1e-6)
    yield "Deconvolution, both", of(Deconvolution, mixed, np.array([1.0, 1e-6]))
    yield "Deconvolution, learned variance", of(Deconvolution, acc, 1.0, penalty=Penalty("identity", variance="local"))
    yield "Deconvolution, second difference", of(Deconvolution, disp, 1e-6, penalty="second_difference")
    yield "Deconvolution, window", of(Deconvolution, acc, 1.0, support=(0.03, 0.04))
    yield "Deconvolution, pushing", of(Deconvolution, acc, 1.0, constraints=[NonNegative()])
    moving = loads.MovingPoint(np.linspace(0.02, 0.98, SAMPLES), label="F")
    yield "Deconvolution, moving load", of(Deconvolution, on(FEW, moving), 1e-6)
    yield "AutomaticInversion, accelerations", of(AutomaticInversion, acc, 1.0)
    yield "AutomaticInversion, displacements", of(AutomaticInversion, disp, 1e-6)
    for dictionary in ("dirac", "bspline", "wavelet"):
        yield f"SparseDeconvolution, {dictionary}", of(SparseDeconvolution, acc, 1.0, dictionary=dictionary)
    yield "FrequencyInversion, transient", of(FrequencyInversion, acc, 1.0, signal="transient")
    yield "FrequencyInversion, stationary", of(FrequencyInversion, acc, 1.0, 4096, signal="stationary")
    yield "HarmonicInversion", lambda rng: HarmonicInversion(acc, 60.0, noise=1.0 if known else None).estimate(
        Record(rng.standard_normal((4096, 2)), DT, acc.sensors))  # fmt: skip
    candidates = on([*ACC, sensors.Accelerometer(at=0.2)], *(loads.Point(at=x) for x in (0.2, 0.35, 0.59, 0.7)))
    yield "LocationSearch", of(LocationSearch, candidates, 1.0)
    yield "FieldDeconvolution", of(FieldDeconvolution, under(FEW, 7), 1e-6, 120,
                                   space="gradient")  # fmt: skip


def tracked(known: bool) -> Iterator[tuple[str, Case]]:
    for name, model, std in (("displacements", on(DISP), np.array([1e-6, 1e-6])),
                             ("both", on([ACC[0], DISP[1]]), np.array([1.0, 1e-6]))):  # fmt: skip
        for how in ("track", "smooth"):

            def run(rng: np.random.Generator, model: Any = model, std: Any = std, how: str = how) -> Any:
                y = std * rng.standard_normal((1000, 2))
                return getattr(LoadTracker(model, noise=Noise(std) if known else None).fit(y, DT), how)(y)

            yield f"LoadTracker.{how}, {name}", run


def readings(known: bool) -> Iterator[tuple[str, Case]]:
    model = under(GAUGES, 12)
    level = 1e-6 if known else None
    for penalty in ("identity", "gradient", "laplacian"):
        family = StaticInversion(model, penalty=penalty, noise=level)
        yield f"StaticInversion, {penalty}", lambda rng, f=family: f.estimate(1e-6 * rng.standard_normal(8))
    pushing = StaticInversion(model, constraints=[NonNegative()], noise=level)
    yield "StaticInversion, pushing", lambda rng: pushing.estimate(1e-6 * rng.standard_normal(8))
    yield "StaticInversion, 20 frames", lambda rng: StaticInversion(model, noise=level).estimate(
        1e-6 * rng.standard_normal((20, 8)))  # fmt: skip
    plate = plates.plate(lengths=(1, 1), thickness=5e-3, elements=8, damping=damping.Modal(0.02),
                         material=plates.Material(E=70e9, rho=2700, nu=0.33))  # fmt: skip
    p = np.linspace(0.05, 0.95, 6)
    gauges = [sensors.StrainGauge(at=(x, y), fibre=2.5e-3, angle=a, label=f"{x:.2f} {y:.2f} {a:.1f}")
              for y in p for x in p for a in (0.0, np.pi / 2)]  # fmt: skip
    shape = ShapeSensing(plate, gauges, noise=3e-7 if known else None)
    yield "ShapeSensing, one frame", lambda rng: shape.estimate(3e-7 * rng.standard_normal(72))
    yield "ShapeSensing, 60 samples", lambda rng: shape.estimate(3e-7 * rng.standard_normal((60, 72)), 1e-3)


def learned(known: bool) -> Iterator[tuple[str, Case]]:
    if not known:  # a map has learned the level
        return
    model, rng = on(ACC), np.random.default_rng(11)
    hits = np.zeros((200, SAMPLES, 1))
    for g in hits:
        start = rng.integers(20, 250)
        g[start : start + 20, 0] = rng.uniform(20, 200) * np.sin(np.pi * (np.arange(20) + 0.5) / 20)
    read = np.stack([model.predict(g, DT) for g in hits])
    read += rng.standard_normal(read.shape)
    some = Examples.measured(read, hits, noise=np.ones(2))
    fitted = LearnedMap(model).fit(TrainingSet.of(some, sensors=model.sensors, loads=model.loads, dt=DT))
    yield "LearnedMap, hits", lambda rng: fitted.estimate(Record(rng.standard_normal((SAMPLES, 2)), DT, model.sensors))


def main() -> None:
    given = sys.argv[1:]
    draws = int(given.pop(0)) if given and given[0].isdigit() else 10
    warnings.simplefilter("ignore")
    for known in (True, False):
        for group in (histories, tracked, readings, learned):
            for name, case in group(known):
                if given and not any(name.startswith(word) for word in given):
                    continue
                line(f"{name}, {'stated' if known else 'not stated'}", case, draws)


def line(name: str, case: Case, draws: int) -> None:
    said: Counter[str] = Counter()
    begun = time.process_time()
    for seed in range(draws):
        try:
            found = case(np.random.default_rng([5, seed]))
            found = getattr(found, "estimate", found)
            said[found.grade.letter + "*" * any(f.code == "LID-W318" for f in found.flags)] += 1
        except NotIdentifiable:
            said["refused"] += 1
    counts = ", ".join(f"{n} {grade}" for grade, n in sorted(said.items()))
    print(f"{name:50s} {counts:30s} {(time.process_time() - begun) / draws:6.2f} s", flush=True)


if __name__ == "__main__":
    main()
