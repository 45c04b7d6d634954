"""Learned force maps on a gel that is not the one they were learned on: what each way of telling its band is worth.

Presses of the case study `learned_skin`, on gels that are other than the sensor believes. Ways: the map as it is; with
`Tolerances` of the gel; learned from any gel (modulus within 35 %, nu .36 to .49); a depth map beside the markers;
adapted by a few presses of known force on that gel. `gels` are presses on any gel.

Run ``python -m tests.benchmarks.learned_gels [DRAWS] [depth] [network]``: 5000 draws by default, markers in the plane
or a depth map too, by the linear map or by networks (extra ``learn``). What is drawn and learned stays in the folder
``learned_skin``, which the case study shares: 12 400 presses and two networks, about an hour of one core from nothing.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from case_studies.learned_skin import (
    KNOWN,
    UNSEEN,
    Sets,
    by_map,
    declared,
    drawn,
    learned,
    of_any_gel,
    pad,
    sensor,
    show,
)
from loadid.generate import TrainingSet
from tactile import LearnedSensor, MultilayerPad, Tolerances, Wrench
from tactile.generate import presses

KNOWN_TO = {
    "E 12 %, nu .03": Tolerances(E=0.12, nu=0.03), "E 14 %, nu .04": Tolerances(E=0.144, nu=0.04),
    "E 20 %, nu .05": Tolerances(E=0.2, nu=0.05),
}  # fmt: skip
TESTED, HELD, FEW = 100, 50, (3, 5, 10)


def tests_of(sets: Sets, gels: Sets, of: MultilayerPad, folder: Path) -> dict[str, TrainingSet]:
    """Presses of each column."""
    own = {"soft, .48": (KNOWN, (0.8, 0.8), 12, pad(0.48, 2)),
           "square .40": ([UNSEEN["square"]], (1.2, 1.2), 15, pad(0.40, 2))}  # fmt: skip
    return {
        "in the set": sets.tests["in the set"], "gels": gels.tests["any gel"], "stiff, .40": sets.tests["other gel"],
        **{name: presses(of, declared(bodies, E), folder / name, draws=TESTED, seed=seed, truth=gel)
           for name, (bodies, E, seed, gel) in own.items()},
    }  # fmt: skip


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
    folder, whole, of = Path("learned_skin"), sensor(deep=True), sensor(deep=deep)
    sets, gels = drawn(whole, folder, draws), of_any_gel(whole, folder, draws)
    kept = tests_of(sets, gels, whole, folder)
    if not deep:
        sets, gels = sets.without_depth(of), gels.without_depth(of)
    tests = {name: part(one, of, slice(TESTED)) for name, one in kept.items()}
    plain = learned(of, sets, engine, folder=folder)
    ways = {"as it is": plain, "any gel": learned(of, gels, engine, folder=folder, name=", gels")}
    depth = None if of.depth is None else of.depth.template
    for name, known in KNOWN_TO.items():
        ways[name] = LearnedSensor(MultilayerPad(of.pad, eye=of.eye, depth=depth, tolerances=known), plain.fitted)
    for name, one in ways.items():
        print(show(by_map(name, one, Sets(sets.training, tests))))
        print(f"half width of the normal force, in the set: {width(one, tests['in the set']):.0%}", flush=True)
    seen, R = tests["stiff, .40"].read(), of.resultant[:3]
    held = {"stiff, .40": part(kept["stiff, .40"], of, slice(HELD, None)), "square .40": tests["square .40"]}
    for few in FEW:
        count = len(of.model.sensors)
        told = plain.adapted_to([y[:count] for y in seen.data[:few]], [Wrench(tuple(R @ g)) for g in seen.loads[:few]])
        print(show(by_map(f"{few} known forces", told, Sets(sets.training, held))))
        print(f"half width, on the stiff gel: {width(told, held['stiff, .40']):.0%}", flush=True)


if __name__ == "__main__":
    words = sys.argv[1:]
    main(*(int(word) for word in words if word.isdigit()), deep="depth" in words,
         engine="torch" if "network" in words else "linear")  # fmt: skip
