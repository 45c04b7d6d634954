"""Loads of a beam whose response is a closed form: nothing of the truth is made by this package.

``python -m tests.benchmarks.analytic [records] [seed]``. An Euler-Bernoulli cantilever of steel (0.5 m, 40 x 8 mm, 1 %
modal damping) with the first twenty modes of its characteristic equation (R. D. Blevins, Formulas for Natural Frequency
and Mode Shape, 1979), each answered exactly for a force that is linear between samples sixteen times finer than the
record's, which is filtered and decimated. Two to four accelerometers, gauges or displacements; noise of 0.3 to 3 %. The
user has fifty beam elements and six modes; five for places, as the sixth is above half the sampling rate.

Columns: answers, median error over the load, share of the load in its 95 % band where it acts, the worst record's
share, how many of those with grade A or B have less than 80 % in band. `places` are those of `LocationSearch`, in
units of their 95 % band.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.signal import butter, cont2discrete, lfilter, sosfiltfilt, ss2tf

from loadid import AutomaticInversion, LoadEstimate, LoadTracker, LocationSearch, Record
from structures import ForwardModel, beams, damping, loads, sensors
from structures.errors import InputError, NotIdentifiable

Array = NDArray[np.float64]
LENGTH, WIDTH, HEIGHT, DAMPING, ELEMENTS = 0.5, 0.04, 0.008, 0.01, 50
FINER = 16
LOADS = ("hit", "two hits", "steps", "slow", "random", "sweep", "harmonic", "hit on slow")
STEEL = beams.materials.steel
MASS, STIFFNESS = STEEL.rho * WIDTH * HEIGHT, STEEL.E * WIDTH * HEIGHT**3 / 12


def _roots() -> Array:
    """Of cos x cosh x = -1, the first twenty."""
    first = [brentq(lambda x: np.cos(x) * np.cosh(x) + 1, *ends) for ends in ((1.5, 2.5), (4, 5.2), (7, 8.4))]
    return np.array([*first, *(np.pi * (np.arange(4, 21) - 0.5))])


ROOTS = _roots()
OMEGA = (ROOTS / LENGTH) ** 2 * np.sqrt(STIFFNESS / MASS)


def shapes(x: float) -> Array:
    """Modes of unit modal mass at a place, without differences of large numbers."""
    z = ROOTS * x / LENGTH
    rest = np.sin(ROOTS) - np.cos(ROOTS) - np.exp(-ROOTS)  # over the next: one less the ratio of the hyperbolic parts
    whole = np.exp(ROOTS) - np.exp(-ROOTS) + 2 * np.sin(ROOTS)  # twice
    grown = rest * (np.exp(z - ROOTS) - np.exp(-z - ROOTS)) / (whole * np.exp(-ROOTS))
    out = np.exp(-z) - np.cos(z) + (1 - 2 * rest / whole) * np.sin(z) + grown
    return np.asarray(out / np.sqrt(MASS * LENGTH))


def seen_at(kind: str, x: float) -> Array:
    """What a sensor sees of each mode: its shape, or the strain of its outer fibre."""
    if kind != "strain":
        return shapes(x)
    step = 1e-4
    return -(shapes(x + step) - 2 * shapes(x) + shapes(x - step)) / step**2 * HEIGHT / 2


def response(force: Array, at: float, watched: list[tuple[str, float]], step: float) -> Array:
    """Of sensors (samples, sensors) to a force that is linear between samples."""
    out = np.zeros((len(force), len(watched)))
    for k, (w, pushed) in enumerate(zip(OMEGA, shapes(at), strict=True)):
        A, B = np.array([[0, 1], [-(w**2), -2 * DAMPING * w]]), np.array([[0.0], [1.0]])
        for i, (kind, x) in enumerate(watched):
            rows = (A[1:], np.ones((1, 1))) if kind == "acceleration" else (np.eye(1, 2), np.zeros((1, 1)))
            F, G, C, D, _ = cont2discrete((A, B, *rows), step, method="foh")
            top, bottom = ss2tf(F, G, C, D)
            out[:, i] += lfilter(top[0], bottom, force) * pushed * seen_at(kind, x)[k]
    return out


def force(kind: str, t: Array, rng: np.random.Generator) -> Array:
    """One history."""
    end, calm = t[-1], np.minimum(1, t / 0.03)

    def pulse(at: float) -> Array:
        width = rng.uniform(1e-3, 4e-3)
        return np.where((t > at) & (t < at + width), rng.uniform(40, 150) * np.sin(np.pi * (t - at) / width), 0.0)

    def noise(high: float) -> Array:
        raw = sosfiltfilt(butter(2, high, fs=1 / (t[1] - t[0]), output="sos"), rng.standard_normal(len(t)))
        return np.asarray(10 * calm * raw / raw.std())

    if kind in ("hit", "two hits"):
        return np.asarray(sum(pulse(rng.uniform(0.1, 0.7) * end) for _ in range(1 + (kind == "two hits"))))
    if kind == "steps":
        return np.where(t > 0.3 * end, 20.0, 0.0) - np.where(t > 0.7 * end, 35.0, 0.0)
    if kind == "hit on slow":
        return noise(8.0) + pulse(0.5 * end)
    if kind == "harmonic":
        return np.asarray(10 * calm * np.sin(2 * np.pi * rng.uniform(20, 300) * t))
    if kind == "sweep":
        return np.asarray(10 * np.sin(2 * np.pi * (20 * t + 300 * t**2)))
    return noise({"slow": rng.uniform(4, 20), "random": rng.uniform(50, 600)}[kind])


@dataclass(frozen=True, eq=False)
class Case:
    """A record (samples, sensors) of loads (samples, loads) at some nodes, and the model that a user has."""

    model: ForwardModel
    record: Array
    truth: Array
    dt: float


def case(rng: np.random.Generator, kinds: list[str], *, rate: float = 4000.0, samples: int = 1000,
         kind: str = "", candidates: tuple[int, ...] = ()) -> tuple[Case, list[float]]:  # fmt: skip
    """A case and the places of its loads; `candidates`: nodes of the model's loads, where these are not told."""
    t = np.arange(samples * FINER) / (rate * FINER)
    nodes = sorted(rng.choice(candidates or np.arange(15, ELEMENTS + 1), len(kinds), replace=False).tolist())
    number = len(kinds) + int(rng.integers(1, 3)) + bool(candidates)
    at = sorted(rng.choice(np.arange(6, ELEMENTS + 1), number, replace=False).tolist())
    watched = [
        (kind or str(rng.choice(["acceleration", "acceleration", "strain", "displacement"])), 0.01 * n) for n in at
    ]
    histories = [force(one, t, rng) for one in kinds]
    y = sum(response(f, 0.01 * n, watched, t[1]) for f, n in zip(histories, nodes, strict=True))
    y = sosfiltfilt(butter(8, 0.425 * rate, fs=rate * FINER, output="sos"), y, axis=0)[::FINER]
    y = y + rng.choice([0.003, 0.01, 0.03]) * y.std(axis=0) * rng.standard_normal(y.shape)
    made = {"acceleration": sensors.Accelerometer, "displacement": sensors.Displacement}
    channels = [made[k](at=x) if k in made else sensors.StrainGauge(at=x, fibre=HEIGHT / 2) for k, x in watched]
    pushed = [loads.Point(at=0.01 * n) for n in candidates or nodes]
    return Case(user(channels, pushed), y, np.stack([f[::FINER] for f in histories], axis=1), 1 / rate), [
        0.01 * n for n in nodes
    ]


def user(channels: list, pushed: list, modes: int = 6) -> ForwardModel:
    """The model of a user."""
    beam = beams.cantilever(length=LENGTH, section=beams.Section.rectangle(WIDTH, HEIGHT), material=STEEL,
                            damping=damping.Modal(DAMPING), elements=ELEMENTS)  # fmt: skip
    return ForwardModel(beam, channels, pushed, modes=modes)


@dataclass(frozen=True)
class Score:
    """Of one answer: relative error, share of the load in its band where it acts, grade."""

    error: float
    inside: float
    grade: str


def score(found: LoadEstimate, truth: Array) -> Score:
    """Against the truth."""
    acts = np.abs(truth) > 0.02 * np.abs(truth).max(axis=0)
    inside = np.abs(found.load - truth) <= 1.96 * found.std
    error = float(np.linalg.norm(found.load - truth) / np.linalg.norm(truth))
    return Score(error, float(inside[acts].mean()), found.grade.letter)


def histories(count: int, seed: int, number: int) -> Iterator[Score]:
    """`AutomaticInversion` on records of so many loads, of kinds that are drawn."""
    for k in range(count):
        rng = np.random.default_rng([seed, number, k])
        one, _ = case(rng, [str(rng.choice(LOADS)) for _ in range(number)], samples=int(rng.integers(500, 1600)))
        yield score(AutomaticInversion(one.model).estimate(one.record, one.dt), one.truth)


def steps(count: int, seed: int) -> Iterator[Score]:
    """Steps in front of accelerometers, which see next to nothing of what stays."""
    for k in range(count):
        one, _ = case(np.random.default_rng([seed, 7, k]), ["steps"], samples=2000, kind="acceleration")
        yield score(AutomaticInversion(one.model).estimate(one.record, one.dt), one.truth)


def tracked(count: int, seed: int) -> Iterator[Score]:
    """A tracker that is tuned on the first half of a record, on the second."""
    for k in range(count):
        rng = np.random.default_rng([seed, 8, k])
        one, _ = case(rng, ["slow"], rate=1000.0, samples=8000)
        half, channels = len(one.record) // 2, one.model.sensors
        try:
            tracker = LoadTracker(one.model).fit(Record(one.record[:half], one.dt, channels))
        except (InputError, NotIdentifiable):  # accelerometers alone see no constant load
            continue
        yield score(tracker.track(Record(one.record[half:], one.dt, channels)), one.truth[half:])


def places(count: int, seed: int) -> Iterator[float]:
    """How far off hits are found, over half their 95 % band, by a model of the modes below half the sampling rate."""
    for k in range(count):
        one, (at,) = case(np.random.default_rng([seed, 9, k]), ["hit"], samples=600, kind="acceleration",
                          candidates=tuple(range(10, ELEMENTS + 1, 4)))  # fmt: skip
        model = user(one.model.sensors, one.model.loads, modes=5)
        found = LocationSearch(model).locate(one.record, one.dt)
        if found.found is not None and found.std is not None:
            yield float(np.abs(np.ravel(found.found)[0] - at) / (1.96 * np.ravel(found.std)[0]))


def row(name: str, found: list[Score]) -> str:
    """One line."""
    inside = np.array([s.inside for s in found])
    bold = sum(s.grade in "AB" and s.inside < 0.8 for s in found)
    error = np.median([s.error for s in found])
    return f"{name:28s} {len(found):4d} {error:7.3f} {inside.mean():7.0%} {inside.min():7.0%} {bold:5d}"


def main(count: int = 24, seed: int = 1) -> None:
    """Print the table."""
    warnings.simplefilter("ignore")
    print(f"{'':28s} {'n':>4s} {'error':>7s} {'in band':>7s} {'worst':>7s} {'bold':>5s}")
    print(row("one load", list(histories(count, seed, 1))), flush=True)
    print(row("two loads", list(histories(count, seed, 2))), flush=True)
    print(row("steps, accelerometers", list(steps(count, seed))), flush=True)
    print(row("tracked", list(tracked(count, seed))), flush=True)
    off = np.array(list(places(count, seed)))
    print(f"places: {np.mean(off <= 1):.0%} of {len(off)} in band, 90 % within {np.quantile(off, 0.9):.2g} bands, "
          f"{off.max():.2g} at most")  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
