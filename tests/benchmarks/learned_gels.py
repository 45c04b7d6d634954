"""Learned force maps on a gel that is not the one they were learned on: what each way of telling its band is worth.

Presses of the case study `learned_skin`, on gels that are other than the sensor believes. Ways: the map as it is; with
`Tolerances` of the gel; learned from gels drawn over a wide range (modulus within 25 %, nu .38 to .49); a depth map
beside the markers; adapted by a few presses of known force on that gel. `gels` are presses on gels of that range.
All maps have one band for all gels of their set (``unseen=()``), so that what is told beside it is seen.

Run ``python -m tests.benchmarks.learned_gels [DRAWS] [depth] [network]``: 5000 draws by default, markers in the plane
or a depth map too, by the linear map or by networks (extra ``learn``; two, a quarter of an hour of one core each). What
is drawn stays in the folder ``learned_gels``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from case_studies.learned_skin import KNOWN, UNSEEN, Sets, by_map, declared, pad, sensor, show
from loadid.generate import TrainingSet
from tactile import LearnedSensor, MultilayerPad, Tolerances, Wrench
from tactile.generate import presses

RANGE, RATIOS = (0.75, 1.25), (0.38, 0.41, 0.44, 0.47, 0.49)
KNOWN_TO = {
    "E 12 %, nu .03": Tolerances(E=0.12, nu=0.03), "E 14 %, nu .04": Tolerances(E=0.144, nu=0.04),
    "E 20 %, nu .05": Tolerances(E=0.2, nu=0.05),
}  # fmt: skip
TESTED, HELD, FEW = 100, 50, (3, 5, 10)


def drawn(folder: Path, draws: int) -> dict[str, TrainingSet]:
    """Training sets, and presses of each column."""
    of, square = sensor(deep=True), [UNSEEN["square"]]
    one, wide = [pad(nu, 2) for nu in (0.44, 0.45, 0.46)], [pad(nu, 2) for nu in RATIOS]
    told = {
        "training": (draws, KNOWN, (0.95, 1.05), 0, one), "wide": (draws, KNOWN, RANGE, 0, wide),
        "in the set": (TESTED, KNOWN, (0.95, 1.05), 1, one), "gels": (TESTED, KNOWN, RANGE, 11, wide),
        "stiff, .40": (TESTED, KNOWN, (1.2, 1.2), 9, pad(0.40, 2)),
        "soft, .48": (TESTED, KNOWN, (0.8, 0.8), 12, pad(0.48, 2)),
        "square .40": (TESTED, square, (1.2, 1.2), 15, pad(0.40, 2)),
    }  # fmt: skip
    return {
        name: presses(of, declared(bodies, E), folder / name, draws=count, seed=seed, truth=gel)
        for name, (count, bodies, E, seed, gel) in told.items()
    }


def part(kept: TrainingSet, of: MultilayerPad, places: slice) -> TrainingSet:
    """Some presses, as a sensor reads them that may lack the depth map."""
    seen, count = kept.read(places), len(of.model.sensors)
    less = replace(seen, data=seen.data[:, :count], noise=seen.noise[..., :count],
                   missing=None if seen.missing is None else seen.missing[:, :count])  # fmt: skip
    return TrainingSet.of(less, sensors=of.model.sensors, loads=of.model.loads)


def width(one: LearnedSensor, kept: TrainingSet) -> float:
    """Median half width of the band of the normal force over the force."""
    seen, R = kept.read(), one.sensor.resultant[2]
    found = [1.96 * one.explained(y).resultant().std[2] / abs(R @ load)
             for y, load in zip(seen.data, seen.loads, strict=True)]  # fmt: skip
    return float(np.median(found))


def main(draws: int = 5000, deep: bool = False, engine: str = "linear") -> None:
    """Print the tables."""
    sets, of = drawn(Path("learned_gels"), draws), sensor(deep=deep)
    training, wide = (part(sets.pop(name), of, slice(None)) for name in ("training", "wide"))
    tests = {name: part(kept, of, slice(None)) for name, kept in sets.items()}
    plain = LearnedSensor.fit(of, training, engine=engine, unseen=())
    ways = {"as it is": plain, "wide set": LearnedSensor.fit(of, wide, engine=engine, unseen=())}
    depth = None if of.depth is None else of.depth.template
    for name, known in KNOWN_TO.items():
        ways[name] = LearnedSensor(MultilayerPad(of.pad, eye=of.eye, depth=depth, tolerances=known), plain.fitted)
    for name, one in ways.items():
        print(show(by_map(name, one, Sets(training, tests))))
        print(f"half width of the normal force, in the set: {width(one, tests['in the set']):.0%}", flush=True)
    seen, R = tests["stiff, .40"].read(), of.resultant[:3]
    held = {"stiff, .40": part(sets["stiff, .40"], of, slice(HELD, None)), "square .40": tests["square .40"]}
    for few in FEW:
        count = len(of.model.sensors)
        told = plain.adapted_to([y[:count] for y in seen.data[:few]], [Wrench(tuple(R @ g)) for g in seen.loads[:few]])
        print(show(by_map(f"{few} known forces", told, Sets(training, held))))
        print(f"half width, on the stiff gel: {width(told, held['stiff, .40']):.0%}", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(*(int(word) for word in words if word.isdigit()), deep="depth" in words,
         engine="torch" if "network" in words else "linear")  # fmt: skip
