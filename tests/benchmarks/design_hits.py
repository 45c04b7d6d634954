"""Layouts for hits against what else could be done: ``python -m tests.benchmarks.design_hits``.

Ten accelerometers could be placed on a cantilever with two loads, three are. Each of the 120 layouts is judged by
records: a hit on each load through a mesh that is twice as fine with twice the modes, noise, `Deconvolution`. Beside
it in the same table: the layout that `design.place_for_hits` chooses, by all sets and by its search; the best in the
records, the median of all (chance), three sensors spread evenly, all candidates. Then 40 candidates, where no one looks
at every set: the search against 100 random layouts, of finite elements and of their FRFs.
"""

from __future__ import annotations

import time
from itertools import combinations
from typing import Any

import numpy as np

from loadid import Deconvolution, Record, design
from loadid.design._hits import FINE, Pulse, posed
from structures import Channel, ForwardModel, FrfModel, beams, damping, loads, sensors

PULSE, RECORDS, TAKEN = (2e-3, 100.0), 3, 3
PLACES = np.linspace(0.1, 1.0, 10)


def cantilever(places: Any, elements: int = 30, modes: int = 8) -> ForwardModel:
    beam = beams.cantilever(length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                            elements=elements, damping=damping.Modal(0.02))  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"a{x:.3g}") for x in places]
    acting = [loads.Point(at=x, label=label) for x, label in ((0.45, "F1"), (0.95, "F2"))]
    return ForwardModel(beam, seen, acting, modes=modes)


def measured_error(truth: np.ndarray, force: np.ndarray, rows: Any, std: np.ndarray,
                   dt: float) -> float:  # fmt: skip
    """Error of the load that is found least well, over simulated records."""
    rows, worst = list(rows), 0.0
    part = cantilever(PLACES[rows])
    family = Deconvolution(part, noise=std[rows])
    for j in range(2):
        errors = []
        for seed in range(RECORDS):
            y = truth[j][:, rows] + std[rows] * np.random.default_rng([7, seed]).standard_normal(
                (len(force), len(rows))
            )
            channels = [Channel(label=c.label, quantity=c.quantity, unit=c.unit) for c in part.sensors]
            found = family.estimate(Record(y, dt, channels)).load.copy()
            found[:, j] -= force
            errors.append(np.sum(found**2))
        worst = max(worst, float(np.sqrt(np.mean(errors) / np.sum(force**2))))
    return worst


def small() -> None:
    model, finer = cantilever(PLACES), cantilever(PLACES, 60, 16)
    problem = posed(model, Pulse(*PULSE), None, "", None, FINE, True)
    dt, force = problem.dt, problem.f
    truth = []
    for j in range(2):
        both = np.zeros((4 * len(force), 2))
        both[:, j] = Pulse(*PULSE).at((np.arange(4 * len(force)) / 4 - len(force) // 4) * dt)
        truth.append(finer.predict(both, dt / 4)[::4])
    std = problem.noise
    sets = list(combinations(range(10), TAKEN))
    each = {rows: measured_error(truth, force, rows, std, dt) for rows in sets}
    told = {rows: float(np.linalg.norm(problem.errors(rows), axis=1).max()) for rows in sets}
    rank = [np.argsort(np.argsort(list(d.values()))) for d in (each, told)]
    rows_of = {
        "place_for_hits, all sets": design.place_for_hits(model, TAKEN, pulse=PULSE, exhaustive=True).chosen,
        "place_for_hits, search": design.place_for_hits(model, TAKEN, pulse=PULSE, exhaustive=False).chosen,
        "the best in the records": min(each, key=lambda rows: each[rows]),
        "evenly spread": (2, 5, 9),
        "all ten": tuple(range(10)),
    }
    print(f"{'3 of 10 accelerometers':28} {'promised':>9} {'in records':>11}  better layouts")
    for name, rows in rows_of.items():
        found = measured_error(truth, force, rows, std, dt)
        promised = float(np.linalg.norm(problem.errors(rows), axis=1).max())
        print(f"{name:28} {promised:9.1%} {found:11.1%}  {sum(e < found - 1e-12 for e in each.values()):3d} of 120"
              f"  {', '.join(model.sensors[i].label for i in sorted(rows))}")  # fmt: skip
    print(f"{'median of the 120':28} {np.median(list(told.values())):9.1%} {np.median(list(each.values())):11.1%}")
    print(f"{'worst of the 120':28} {max(told.values()):9.1%} {max(each.values()):11.1%}")
    print(f"rank correlation of promised and found: {np.corrcoef(*rank)[0, 1]:.2f}")


def large() -> None:
    whole = cantilever(np.linspace(0.025, 1.0, 40))
    lines = np.arange(4.0, 1500.0, 4.0)
    for name, model in (("finite elements", whole), ("FRFs", FrfModel.of(whole, lines))):
        begun = time.process_time()
        found = design.place_for_hits(model, 4, pulse=PULSE)
        cost = time.process_time() - begun
        problem = posed(model, Pulse(*PULSE), None, "", None, FINE, True)
        rng = np.random.default_rng(3)
        luck = sorted(
            float(np.linalg.norm(problem.errors(rng.choice(40, 4, replace=False)), axis=1).max()) for _ in range(100)
        )
        print(f"4 of 40, {name:16} chosen {found.layout.share.max():6.1%}  best, median of 100 random {luck[0]:6.1%} "
              f"{luck[50]:6.1%}  all {found.everything.share.max():6.1%}  {cost:5.1f} CPU s")  # fmt: skip


if __name__ == "__main__":
    small()
    large()
