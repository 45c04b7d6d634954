"""Presses of the case study `learned_skin`, kept: `python -m tests.learning.skin` draws and writes them.

520 that are learned from, the least that tell the loads of its pad apart, and 10 of each row: a minute of one core.
Readings are kept in steps of 0.2 um, a third of their noise, and tractions in 2000 steps.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from case_studies.learned_skin import Sets, drawn, sensor
from loadid.generate import Examples, TrainingSet
from tactile import MultilayerPad

FILE = Path(__file__).with_name("skin.npz")
DRAWS, TESTED, STEP, STEPS = 520, 10, 2e-7, 2000  # m, steps of the largest traction
TOLD = ("E", "nu")


def kept(flat: MultilayerPad) -> Sets:
    """The presses, as a sensor without a depth map reads them."""
    with np.load(FILE) as file:
        names = list(dict.fromkeys(key.partition(": ")[0] for key in file.files))
        sets = {name: _opened({key: file[f"{name}: {key}"] for key in KEYS}, flat) for name in names}
    return Sets(sets.pop("training"), sets)


KEYS = ("data", "loads", "largest", "noise", *TOLD)


def _opened(one: dict[str, Any], flat: MultilayerPad) -> TrainingSet:
    loads = one["loads"] * (one["largest"] / STEPS)[:, None]
    found = Examples.measured(STEP * one["data"], loads, noise=one["noise"], kinds="pressed",
                              parameters={name: one[name] for name in TOLD})  # fmt: skip
    return TrainingSet.of(found, sensors=flat.model.sensors, loads=flat.model.loads)


def _closed(training: TrainingSet) -> dict[str, Any]:
    seen = training.read()
    largest = np.abs(seen.loads).max(axis=1)
    return {
        "data": np.round(seen.data / STEP).astype(np.int16), "largest": largest.astype(np.float32),
        "loads": np.round(seen.loads / largest[:, None] * STEPS).astype(np.int16),
        "noise": np.sqrt(np.mean(np.atleast_2d(seen.noise) ** 2, axis=0)).astype(np.float32),
        **{name: seen.parameters[name].astype(np.float32) for name in TOLD},
    }  # fmt: skip


def write() -> None:
    """Draw them."""
    flat = sensor(deep=False)
    with tempfile.TemporaryDirectory() as folder:
        sets = drawn(sensor(deep=True, camera=flat.eye), Path(folder), DRAWS, tested=TESTED).without_depth(flat)
        named = {"training": sets.training, **sets.tests}
        arrays = {f"{name}: {key}": value for name, one in named.items() for key, value in _closed(one).items()}
    np.savez_compressed(FILE, **arrays)


if __name__ == "__main__":
    write()
