"""Routes from gauges to the load of a plate: error, coverage of the 95 % band, CPU time.

``python -m tests.benchmarks.shape_routes [field|gauges|random|record]``. The plate is simply supported, 1 x 1 m,
5 mm of aluminium; the truth is its series solution, scored as the means of 12 x 12 patches.
"""

from __future__ import annotations

import sys
import time

import numpy as np

from loadid import FieldDeconvolution, ShapeSensing, StaticInversion
from structures import ForwardModel, bases, plates, sensors

THICK, E, NU, RHO = 5e-3, 70e9, 0.33, 2700.0
D, MASS = E * THICK**3 / 12 / (1 - NU**2), RHO * THICK
PLATE = plates.plate(lengths=(1, 1), thickness=THICK, material=plates.Material(E=E, rho=RHO, nu=NU), elements=12,
                     damping=0.001)  # fmt: skip
LOADS = bases.patches(PLATE, (12, 12))
CASE = np.zeros((12, 12))
CASE[0, 0], CASE[1, 0] = 100.0, 50.0
ORDERS = np.arange(1, 13)
K2 = np.pi**2 * (ORDERS[:, None] ** 2 + ORDERS**2)


def gauges(count):
    p = np.linspace(0.05, 0.95, count)
    return [sensors.StrainGauge(at=(x, y), fibre=THICK / 2, angle=t, label=f"{x:.3f} {y:.3f} {t:.1f}")
            for y in p for x in p for t in (0.0, np.pi / 2)]  # fmt: skip


def sines(at):
    x, y = np.asarray(at, float)[:, :2].T
    return np.sin(np.pi * np.outer(x, ORDERS)), np.sin(np.pi * np.outer(y, ORDERS))


def pressure(amplitudes, at):
    """Means over patches of 1/12 m about places."""
    mean = np.sinc(ORDERS / 24)
    sx, sy = sines(at)
    return np.einsum("pi,ij,pj->p", sx * mean, amplitudes, sy * mean)


def readings(w, placed):
    """Strains (or deflections) of amplitudes w of the deflection."""
    sx, sy = sines([g.at for g in placed])
    kx, ky = (np.einsum("pi,ij,pj->p", a, w, b) * np.pi**2 * THICK / 2
              for a, b in ((sx * ORDERS**2, sy), (sx, sy * ORDERS**2)))  # fmt: skip
    plain = np.einsum("pi,ij,pj->p", sx, w, sy)
    return np.array([plain[k] if g.quantity != "strain" else kx[k] if g.angle == 0 else ky[k]
                     for k, g in enumerate(placed)])  # fmt: skip


def random_load(rng):
    """Smooth pressure, correlated over 0.3 to 0.7 m."""
    return rng.standard_normal(K2.shape) * np.exp(-K2 * rng.uniform(0.3, 0.7) ** 2 / 8)


def judged(name, family, cases, dt=None):
    """One row of a table: cases are (readings, truth)."""
    start, errors, inside = time.process_time(), [], []
    for y, q in cases:
        found = family.estimate(y) if dt is None else family.estimate(y, dt)
        errors.append(np.linalg.norm(found.load - q) / np.linalg.norm(q))
        inside.append(np.mean(np.abs(found.load - q) <= 1.96 * found.std))
    cost = (time.process_time() - start) / len(cases)
    print(f"  {name:34s} error {np.median(errors):6.3f} (worst {max(errors):.3f})   in the band {np.mean(inside):.3f}"
          f"   {cost:6.2f} CPU s", flush=True)  # fmt: skip


def routes(placed, level):
    model = ForwardModel(PLATE, placed, LOADS)
    return {
        "ShapeSensing": ShapeSensing(PLATE, placed, loads=LOADS, noise=level),
        "ShapeSensing, robust GCV": ShapeSensing(PLATE, placed, loads=LOADS, noise=level, choice="robust_gcv"),
        "ShapeSensing, discrepancy": ShapeSensing(PLATE, placed, loads=LOADS, noise=level, choice="discrepancy"),
        "StaticInversion, Laplacian": StaticInversion(model, penalty="laplacian", noise=level),
    }


def static(placed, level_of, amplitudes, rng):
    cases = []
    for A in amplitudes:
        y = readings(A / (D * K2**2), placed)
        scale = np.abs(y).max()
        cases.append((y / scale + level_of * rng.standard_normal(len(y)), pressure(A, LOADS.coordinates) / scale))
    for name, family in routes(placed, max(level_of, 1e-9)).items():
        judged(name, family, cases)


def field():
    """Deflections at 21 x 21 nodes, the edges among them."""
    p = np.linspace(0, 1, 21)[1:-1]
    placed = [sensors.Displacement(at=(x, y), label=f"{x:.3f} {y:.3f}") for y in p for x in p]
    for level, goal in ((0.0, 0.01), (1e-4, 0.02), (1e-3, 0.06), (1e-2, 0.15)):
        print(f"deflections, noise {level:g}, goal {goal}")
        y = readings(CASE / (D * K2**2), placed)
        y, q = y / np.abs(y).max(), pressure(CASE, LOADS.coordinates) / np.abs(y).max()
        family = ShapeSensing(PLATE, placed, loads=LOADS, noise=max(level, 1e-9))
        judged("ShapeSensing", family,
               [(y + level * np.random.default_rng(s).standard_normal(len(y)), q) for s in range(3)])  # fmt: skip


def table():
    """Strains at 10 x 10 and 6 x 6 stations."""
    for count, level, row in ((10, 0.01, 0.050), (10, 0.05, 0.250), (6, 0.01, 0.084), (6, 0.05, 0.419)):
        print(f"{count} x {count} stations, noise {level:g}; least squares with 4 x 4 true modes {row}")
        static(gauges(count), level, [CASE] * 5, np.random.default_rng(100))


def random():
    """Random smooth loads."""
    for count, level in ((6, 0.001), (6, 0.02), (10, 0.02)):
        print(f"random loads, {count} x {count} stations, noise {level:g}")
        rng = np.random.default_rng(2024)
        static(gauges(count), level, [random_load(rng) for _ in range(40)], rng)


def record():
    """The load of the case at 10 Hz, 0.3 s at 500 Hz."""
    placed, dt, omega = gauges(6), 2e-3, 2 * np.pi * 10
    t = dt * np.arange(150)
    y = np.cos(omega * t)[:, None] * readings(CASE / (D * K2**2 - MASS * omega**2), placed)
    q = np.cos(omega * t)[:, None] * pressure(CASE, LOADS.coordinates)
    level = 0.05 * np.abs(y).max()
    y = y + level * np.random.default_rng(9).standard_normal(y.shape)
    print("record, 6 x 6 stations, noise 0.05")
    model = ForwardModel(PLATE, placed, LOADS, modes=30)
    judged("ShapeSensing", ShapeSensing(PLATE, placed, loads=LOADS, noise=level), [(y, q)], dt)
    other = FieldDeconvolution(model, space="laplacian", time="identity", noise=level)
    judged("FieldDeconvolution, Laplacian", other, [(y, q)], dt)


if __name__ == "__main__":
    for part in sys.argv[1:] or ["field", "gauges", "random", "record"]:
        {"field": field, "gauges": table, "random": random, "record": record}[part]()
