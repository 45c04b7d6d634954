"""Small training sets: static readings of a few correlated loads, and histories of a chain."""

from __future__ import annotations

from functools import cache

import numpy as np

from loadid import LearnedMap
from loadid.generate import Examples, TrainingSet
from structures import Channel, ForwardModel, MatrixModel, chains, damping, loads, sensors

NOISE = 0.05
DT = 1 / 200
SAMPLES = 400


@cache
def plate():
    """Eight sensors of four loads, and a factor of the covariance of these."""
    rng = np.random.default_rng(5)
    H = rng.standard_normal((8, 4))
    model = MatrixModel(
        H,
        sensors=[Channel(label=f"s{i}", quantity="strain", unit="1") for i in range(8)],
        loads=[Channel(label=f"p{i}", quantity="force", unit="N") for i in range(4)],
    )
    return model, rng.standard_normal((4, 4)) + 2 * np.eye(4)


def presses(n, seed, noise=NOISE):
    """Readings (n, 8) and loads (n, 4)."""
    model, spread = plate()
    rng = np.random.default_rng(seed)
    truth = rng.standard_normal((n, 4)) @ spread + 1.0
    return truth @ model.static().T + noise * rng.standard_normal((n, 8)), truth


def static_set(n=600, seed=0, **other):
    model, _ = plate()
    y, g = presses(n, seed)
    return TrainingSet.of(
        Examples.measured(y, g, noise=NOISE), **{"sensors": model.sensors, "loads": model.loads} | other
    )


@cache
def static_map(output="load"):
    return LearnedMap(plate()[0], output=output).fit(static_set())


@cache
def chain(factor=1.0):
    """Three masses, one force, two accelerometers and a displacement sensor."""
    structure = chains.chain(masses=np.ones(3), springs=2e3 * factor, damping=damping.Rayleigh(0.0, 0.004))
    places = [sensors.Accelerometer("1+X", label="a1"), sensors.Accelerometer("3+X", label="a3"),
              sensors.Displacement("2+X", label="u2")]  # fmt: skip
    return ForwardModel(structure, sensors=places, loads=[loads.Point("2+X")])


LEVEL = np.array([0.01, 0.01, 1e-5])  # noise of the sensors of the chain


def slow(rng):
    """A load between 0.5 and 10 Hz, unit std."""
    lines = np.fft.rfftfreq(SAMPLES, DT)
    inside = (lines >= 0.5) & (lines <= 10)
    load = np.fft.irfft(inside * (rng.standard_normal(len(lines)) + 1j * rng.standard_normal(len(lines))), SAMPLES)
    return load / np.std(load)


def seen(load, rng, factor=1.0):
    """What the chain reads of a load."""
    return chain(factor).predict(load, DT) + LEVEL * rng.standard_normal((len(load), 3))


def records(n, seed):
    rng = np.random.default_rng(seed)
    g = np.stack([slow(rng) for _ in range(n)])
    return np.stack([seen(one, rng) for one in g]), g[:, :, None]


@cache
def history_map():
    y, g = records(300, 0)
    training = TrainingSet.of(Examples.measured(y, g, noise=LEVEL), sensors=chain().sensors, loads=chain().loads, dt=DT)
    return LearnedMap(chain()).fit(training)
