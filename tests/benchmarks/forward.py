"""Forward models: how the cost grows, modal against direct, and what reciprocity saves.

Run ``python -m tests.benchmarks.forward``; it prints tables, CPU seconds, best of three.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

import numpy as np

from structures import ForwardModel, Structure, loads, plates, sensors
from structures._elements.members import steel
from structures._system.damping import Rayleigh
from structures._system.factor import Factor


def cpu(work: Callable[[], object], repeat: int = 3) -> float:
    """Best CPU time of some runs, in seconds."""
    times = []
    for _ in range(repeat):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def exponent(sizes: Sequence[float], times: Sequence[float]) -> float:
    """Slope of log(time) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(np.maximum(times, 1e-6)), 1)[0])


def plate(cells: int) -> Structure:
    """Cantilever plate with cells x cells elements."""
    damping = Rayleigh(2.0, 2e-6)
    return plates.plate(
        lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(cells, cells), edges="CFFF", damping=damping
    )


def places(count: int, kind: Callable, seed: int) -> list:
    """Sensors or loads at random points of the plate."""
    points = np.random.default_rng(seed).uniform(0.02, 0.38, (count, 2))
    return [kind(at=tuple(x), label=str(i)) for i, x in enumerate(points)]


def model(structure: Structure, rows: int = 20, columns: int = 5, **settings: object) -> ForwardModel:
    """Displacements and forces at random points."""
    return ForwardModel(structure, places(rows, sensors.Displacement, 0), places(columns, loads.Point, 1), **settings)


def growth(cells: Sequence[int] = (16, 24, 36, 54, 80)) -> dict[str, float]:
    """Factorisation, one block of solves and 60 modes over the number of DOFs; returns the exponents."""
    print("\nGrowth with the number of DOFs (plate, 4 DOFs per node)")
    heads = ("factor s", "100 solves s", "60 modes s", "sweep 1000 lines s", "direct line s")
    print(f"{'DOFs':>8} {heads[0]:>9} {heads[1]:>13} {heads[2]:>11} {heads[3]:>19} {heads[4]:>14}")
    rows = []
    for c in cells:
        structure = plate(c)
        n = structure.free.size
        factor = Factor.of(structure)
        B = np.random.default_rng(0).standard_normal((n, 100))
        reduced = model(structure).reduced
        f = np.linspace(1, 1000, 1000)
        rows.append(
            (
                n,
                cpu(lambda s=structure: Factor.of(s)),
                cpu(lambda k=factor, b=B: k.solve(b)),
                cpu(lambda s=structure: model(s).modes, repeat=1),
                cpu(lambda r=reduced, f=f: r.frf(f)),
                cpu(lambda s=structure: model(s).frf([300.0], method="direct"), repeat=1),
            )
        )
        print("{:8d} {:9.3f} {:13.3f} {:11.3f} {:19.4f} {:14.3f}".format(*rows[-1]))
    table = np.array(rows).T
    names = ("factor", "solves", "modes", "sweep", "direct line")
    found = {name: exponent(table[0], times) for name, times in zip(names, table[1:], strict=True)}
    print("exponent " + ", ".join(f"{name} {value:.2f}" for name, value in found.items()))
    return found


def sweep(lines: Sequence[int] = (250, 1000, 4000, 16000)) -> float:
    """Modal sweep and impulse response over their length; returns the exponent of the sweep."""
    reduced = model(plate(30))
    reduced.reduced  # noqa: B018  (the modes are no part of the sweep)
    print("\nGrowth with the length (60 modes, 20 sensors, 5 loads)")
    print(f"{'length':>8} {'sweep s':>9} {'impulse response s':>19}")
    rows = []
    for n in lines:
        f = np.linspace(1, 1000, n)
        times = cpu(lambda f=f: reduced.frf(f)), cpu(lambda n=n: reduced.impulse_response(1e-4, n))
        rows.append((n, *times))
        print("{:8d} {:9.4f} {:19.4f}".format(*rows[-1]))
    table = np.array(rows).T
    print(f"exponent sweep {exponent(table[0], table[1]):.2f}, impulse response {exponent(table[0], table[2]):.2f}")
    return exponent(table[0], table[1])


def modal_against_direct(counts: Sequence[int] = (20, 30, 60, 120), cells: int = 50) -> dict[int, tuple[float, float]]:
    """Error of the modal response on 14 lines of 1-1000 Hz, plain and with the static residual."""
    structure, f = plate(cells), np.linspace(1, 1000, 14)
    start = time.process_time()
    direct = model(structure).frf(f, method="direct")
    print(f"\nModal against direct ({structure.free.size} DOFs, 14 lines of 1-1000 Hz, 20 sensors, 5 loads)")
    print(f"direct: {(time.process_time() - start) / len(f):.3f} s per line")
    print(
        f"{'modes':>6} {'to Hz':>7} {'set-up s':>9} {'plain max':>10} {'median':>8} {'+ static max':>13} {'median':>8}"
    )
    out = {}
    for k in counts:
        m, bare = model(structure, modes=k), model(structure, modes=k, residual=False)
        start = time.process_time()
        m.reduced  # noqa: B018
        setup = time.process_time() - start
        errors = [
            np.linalg.norm(x.frf(f) - direct, axis=(1, 2)) / np.linalg.norm(direct, axis=(1, 2)) for x in (bare, m)
        ]
        out[k] = errors[0].max(), errors[1].max()
        top, (a, b) = m.modes.frequencies[-1], errors
        print(f"{k:6d} {top:7.0f} {setup:9.2f} {a.max():10.1e} {np.median(a):8.1e} {b.max():13.1e} {np.median(b):8.1e}")
    return out


def reciprocity(cells: int = 40) -> list[tuple[int, int, int]]:
    """Right-hand sides that a static transfer matrix costs."""
    structure = plate(cells)
    print(f"\nReciprocity: solves of a static transfer matrix ({structure.free.size} DOFs)")
    print(f"{'sensors':>8} {'loads':>6} {'solves':>7} {'CPU s':>7}")
    out = []
    for rows, columns in ((4, 400), (400, 4), (60, 1500), (200, 200)):
        m = model(structure, rows, columns)
        m.factor.solves = 0
        start = time.process_time()
        m.static()
        out.append((rows, columns, m.factor.solves))
        print(f"{rows:8d} {columns:6d} {m.factor.solves:7d} {time.process_time() - start:7.3f}")
    return out


if __name__ == "__main__":
    growth()
    sweep()
    modal_against_direct()
    reciprocity()
