"""A small pad in its plane, and presses on the endless layer that it is nearly: examples for maps of a sensor."""

from __future__ import annotations

from functools import cache

import numpy as np

from loadid.generate import Examples, TrainingSet
from tactile import Layer, Markers, MultilayerPad, Pad, Press, Tolerances

NOISE = 2e-6
LAYER = Layer(2e-3, 147e3, 0.45)


def places(seed: int = 0) -> np.ndarray:
    """Markers (56, 2) on a grid with some disorder."""
    x, y = np.meshgrid(np.linspace(-3.5e-3, 3.5e-3, 8), np.linspace(-3e-3, 3e-3, 7))
    return np.column_stack([x.ravel(), y.ravel()]) + np.random.default_rng(seed).uniform(-5e-5, 5e-5, (56, 2))


@cache
def pad() -> Pad:
    """10 x 9 x 2 mm on a 1 mm grid."""
    return Pad(size=(10e-3, 9e-3), thickness=2e-3, E=147e3, nu=0.45, elements=(10, 9), layers=2, allow=("W115",))


def sensor(points: np.ndarray | None = None, **known: float) -> MultilayerPad:
    """A sensor with a ridge at a frozen lambda, its gel known so well."""
    markers = Markers(places() if points is None else points, NOISE)
    return MultilayerPad(pad(), markers, penalty="identity", choice=0.01, tolerances=Tolerances(**known))


@cache
def presses(count: int, seed: int, gel: Layer = LAYER) -> tuple[np.ndarray, np.ndarray]:
    """Motion (n, markers, 2) with noise, and tractions (n, 3 P) in Pa: means over the cells about the nodes."""
    rng, motion, loads = np.random.default_rng(seed), [], []
    steps = ((np.arange(6) + 0.5) / 6 - 0.5) * 1e-3
    cells = pad().nodes2d[:, None, None] + np.stack(np.meshgrid(steps, steps), axis=-1)
    for _ in range(count):
        force = rng.uniform(0.1, 0.4)
        one = Press(at=tuple(rng.uniform(-1.5e-3, 1.5e-3, 2)), radius=rng.uniform(1e-3, 2e-3), force=force,
                    shear=tuple(force * rng.uniform(-0.3, 0.3, 2)))  # fmt: skip
        seen = one.displacement(gel, places())[:, :2]
        motion.append(seen + NOISE * rng.standard_normal(seen.shape))
        loads.append(one.traction(cells.reshape(-1, 2)).reshape(pad().points, -1, 3).mean(axis=1).ravel())
    return np.array(motion), np.array(loads)


@cache
def training(count: int = 300, seed: int = 0) -> TrainingSet:
    """Presses as a training set of the sensor."""
    motion, loads = presses(count, seed)
    model = sensor().model
    one = Examples.measured(motion.reshape(count, -1), loads, noise=NOISE, kinds="sphere")
    return TrainingSet.of(one, sensors=model.sensors, loads=model.loads)
