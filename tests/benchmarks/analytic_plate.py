"""Places of loads on a plate whose response is a closed form: nothing of the truth is made by this package.

``python -m tests.benchmarks.analytic_plate [records] [seed] [lasting]``. A simply supported plate of steel (0.6 x
0.5 m, 5 mm, 1 % damping) with the seventy lowest modes of Navier's solution (A. W. Leissa, Vibration of Plates, 1969),
each answered exactly for a force that is linear between samples eight times finer than the record's, which is filtered
and decimated; four to six accelerometers, hits of 1.5 to 4 ms anywhere, noise of 0.3 to 3 %; with the word `lasting`
loads that begin and go on (random up to 800 Hz, a step of 2 ms, 60 to 300 Hz). The user has 12 x 10 elements, the modes
below half the sampling rate, 30 candidates, and a modulus that is 3 % too small, right or 3 % too large.

A line for each record: distance of the place found from the true one, over the radius of the 95 % ellipse there (nan
where nothing bounds it); the distance; the std; what told the place; residual over noise; the codes of its warnings.
"""

from __future__ import annotations

import sys
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, lfilter, sosfiltfilt, ss2tf
from scipy.stats import chi2

from loadid import LocationSearch
from loadid._results.location import LocationResult
from structures import ForwardModel, beams, loads, plates, sensors

Array = NDArray[np.float64]
SIDES, THICKNESS, DAMPING, RATE, FINER, SAMPLES = (0.6, 0.5), 0.005, 0.01, 4000.0, 8, 500
LASTING = ("random", "step", "sine")
STEEL = beams.materials.steel
MASS = STEEL.rho * THICKNESS
BENDING = STEEL.E * THICKNESS**3 / 12 / (1 - STEEL.nu**2)
WAVES = np.array([(m, n) for m in range(1, 12) for n in range(1, 12)])
OMEGAS = np.pi**2 * np.sum((WAVES / SIDES) ** 2, axis=1) * np.sqrt(BENDING / MASS)
LOWEST = np.argsort(OMEGAS)[:70]
WAVES, OMEGAS = WAVES[LOWEST], OMEGAS[LOWEST]


def shapes(place: Array) -> Array:
    """Modes of unit modal mass at a place (x, y)."""
    return np.asarray(2 / np.sqrt(MASS * np.prod(SIDES)) * np.prod(np.sin(np.pi * WAVES * place / SIDES), axis=1))


def response(force: Array, at: Array, watched: Array, step: float) -> Array:
    """Accelerations (samples, sensors) to a force that is linear between samples."""
    pushed, seen = shapes(at), np.array([shapes(one) for one in watched])
    out = np.zeros((len(force), len(watched)))
    for k, w in enumerate(OMEGAS):
        A, B = np.array([[0, 1], [-(w**2), -2 * DAMPING * w]]), np.array([[0.0], [1.0]])
        F, G, C, D, _ = cont2discrete((A, B, A[1:], np.ones((1, 1))), step, method="foh")
        top, bottom = ss2tf(F, G, C, D)
        out += np.outer(lfilter(top[0], bottom, force) * pushed[k], seen[:, k])
    return out


def force(kind: str, t: Array, rng: np.random.Generator) -> Array:
    """One history, which begins after 20 to 50 ms."""
    width, start = rng.uniform(1.5e-3, 4e-3), rng.uniform(0.02, 0.05)
    since = np.maximum(t - start, 0.0)
    if kind == "hit":
        return np.where((since > 0) & (since < width), 100 * np.sin(np.pi * since / width), 0.0)
    calm = np.minimum(since / 2e-3, 1.0)
    if kind == "step":
        return 20 * calm
    if kind == "sine":
        return np.asarray(20 * calm * np.sin(2 * np.pi * rng.uniform(60, 300) * since))
    raw = sosfiltfilt(butter(2, 800, fs=RATE * FINER, output="sos"), rng.standard_normal(len(t)))
    return np.asarray(20 * calm * raw / raw.std())


def record(rng: np.random.Generator, kind: str = "hit") -> tuple[Array, Array, Array]:
    """Accelerations of a load, where it was, and where the sensors are."""
    at = rng.uniform(0.12, 0.88, 2) * SIDES
    watched = rng.uniform(0.1, 0.9, (int(rng.integers(4, 7)), 2)) * SIDES
    t = np.arange(SAMPLES * FINER) / (RATE * FINER)
    y = response(force(kind, t, rng), at, watched, t[1])
    y = sosfiltfilt(butter(8, 0.425 * RATE, fs=RATE * FINER, output="sos"), y, axis=0)[::FINER]
    return y + rng.choice([0.003, 0.01, 0.03]) * y.std(axis=0) * rng.standard_normal(y.shape), at, watched


def user(watched: Array, stiffer: float) -> ForwardModel:
    """The model of a user: 30 candidates."""
    material = beams.Material(E=STEEL.E * stiffer, rho=STEEL.rho, nu=STEEL.nu)
    plate = plates.plate(lengths=SIDES, thickness=THICKNESS, material=material, elements=(12, 10), damping=DAMPING)
    x, y = np.arange(1, 12, 2) * SIDES[0] / 12, np.arange(1, 10, 2) * SIDES[1] / 10
    candidates = [loads.Point(at=(float(i), float(j))) for j in y for i in x]
    seen = [sensors.Accelerometer(at=(float(i), float(j))) for i, j in watched]
    return ForwardModel(plate, seen, candidates, modes=int(np.sum(np.pi * RATE > OMEGAS)))


def off(found: LocationResult, at: Array) -> tuple[float, float, float]:
    """Distance over the radius of the 95 % ellipse, distance, std of the place."""
    assert found.found is not None
    assert found.covariance is not None
    away, C = found.found[0][:2] - at, found.covariance[0][:2, :2]
    over = np.sqrt(away @ np.linalg.solve(C, away) / chi2.ppf(0.95, 2)) if np.all(np.isfinite(C)) else np.nan
    return float(over), float(np.linalg.norm(away)), float(np.sqrt(np.trace(C)))


def main(count: int = 12, seed: int = 1, lasting: bool = False) -> None:
    """Print a line for each record, and how many are in their band."""
    warnings.simplefilter("ignore")
    every = []
    print(f"{'load':7s} {'modulus':>7s} {'off':>6s} {'mm':>7s} {'std':>7s}  place by  (residual over noise)")
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        kind = LASTING[k % len(LASTING)] if lasting else "hit"
        y, at, watched = record(rng, kind)
        stiffer = float(rng.choice([0.97, 1.0, 1.03]))
        found = LocationSearch(user(watched, stiffer)).locate(y, 1 / RATE)
        over, away, std = off(found, at)
        codes = " ".join(sorted({f.code[4:] for f in found.flags if f.code[4] == "W"}))
        every.append((over, "W511" in codes))
        print(f"{kind:7s} {stiffer:7.2f} {over:6.2f} {1e3 * away:7.2f} {1e3 * std:7.2f}  {found.facts['place_by']} "
              f"({found.facts['residual_to_noise']:.1f})  {codes}", flush=True)  # fmt: skip
    told = [over for over, unsure in every if not unsure]
    print(f"{count} places, {count - len(told)} said to be unsure (W511); of the others "
          f"{np.mean(np.array(told) <= 1):.0%} in band, {np.max(told):.2g} bands at most")  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]), lasting="lasting" in sys.argv[3:])
