"""Where was the structure hit? The place of a half-sine impact on a beam and on a plate, from a few accelerometers.

The recipe of the field, a grid of candidates and the smallest residual, on a beam of 19 candidates: hits, and the ratio
of the runner-up's residual to the best, over noise and sensors; one sensor at mid-span cannot tell left from right.
Then 100 impacts anywhere on a plate, between the candidates: data come from a finer mesh with more modes than the model
of the search has, 5 % noise, five accelerometers. All of it is simulated: figures are optimistic for the field.

Run ``python -m case_studies.impact_location``: prints the tables and saves ``impact_location.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import LocationResult, LocationSearch, Record, Search
from structures import Channel, ForwardModel, beams, damping, loads, plates, sensors

Array = NDArray[np.float64]

# -- the beam ---------------------------------------------------------------------------------------------------------
NODES = tuple(range(2, 39, 2))
LAYOUTS = ((5, 17, 29), (5, 17))
LEVELS = (0.01, 0.05, 0.10, 0.30)
SAMPLES, DT = 200, 1 / 2000


def beam(seen: Sequence[int], nodes: Sequence[int] = NODES) -> ForwardModel:
    """Steel beam on two supports, 2 m, 40 elements, 10 modes, accelerometers at nodes; its loads are the candidates."""
    steel = beams.Material(E=210e9, rho=7850, nu=0.3)
    structure = beams.simply_supported(
        length=2.0,
        section=beams.Section.rectangle(0.05, 0.01),
        material=steel,
        elements=40,
        damping=damping.Modal(0.01),
    )
    return ForwardModel(
        structure,
        [sensors.Accelerometer(f"{k}+Z") for k in seen],
        [loads.Point(f"{k}+Z") for k in nodes],
        modes=10,
        residual=False,
    )


def half_sine(samples: int, dt: float, start: float, duration: float, peak: float = 100.0) -> Array:
    """Half sine of `peak` N."""
    t = np.arange(samples) * dt - start
    return np.where((t > -1e-9) & (t < duration + 1e-9), peak * np.sin(np.pi * t / duration), 0.0)


def noisy(clean: Array, level: float, seed: int) -> tuple[Array, float]:
    """Data with noise of exactly `level` times their norm, drawn sensor by sensor, and its std."""
    e = np.random.default_rng(seed).standard_normal(clean.T.shape).T
    size = level * np.linalg.norm(clean)
    return clean + e * size / np.linalg.norm(e), float(size / np.sqrt(clean.size))


def recorded(model: ForwardModel, values: Array, dt: float, std: float) -> Record:
    """The data as a record that states its noise."""
    stated = [Channel(label=s.label, quantity=s.quantity, unit=s.unit, noise=std) for s in model.sensors]
    return Record(values, dt, stated)


@dataclass(frozen=True)
class Trial:
    """One search on the beam: the true node, and what was found."""

    node: int
    level: float
    result: LocationResult

    @property
    def hit(self) -> bool:
        """The best candidate is the true one."""
        return NODES[self.result.best[0]] == self.node


def beam_trials(
    seen: Sequence[int], levels: Sequence[float] = LEVELS, seeds: int = 3, *, refine: bool = False
) -> Iterator[Trial]:
    """Every candidate as the truth, every noise level, `seeds` draws."""
    model = beam(seen)
    search = LocationSearch(model, hold="zoh", search=Search(refine=refine))
    h = model.impulse_response(DT, SAMPLES, "zoh")
    force = half_sine(SAMPLES, DT, 0.010, 0.005)
    for c, node in enumerate(NODES):
        clean = np.column_stack([np.convolve(h[:, s, c], force)[:SAMPLES] for s in range(len(seen))])
        for level in levels:
            for seed in range(seeds):
                values, std = noisy(clean, level, 100 * 2 * node + seed)
                yield Trial(node, level, search.locate(recorded(model, values, DT, std)))


@dataclass(frozen=True)
class Row:
    """One row of the beam's table: hits, the ratio of the runner-up, and misses without a flag."""

    sensors: int
    level: float
    trials: int
    hits: int
    median: float
    smallest: float
    largest_of_misses: float
    unflagged: int


def rows(trials: Sequence[Trial], seen: Sequence[int]) -> list[Row]:
    """Rows of one layout, by noise level."""
    found = []
    for level in sorted({t.level for t in trials}):
        mine = [t for t in trials if t.level == level]
        ratios, missed = [t.result.ratio for t in mine], [t for t in mine if not t.hit]
        found.append(
            Row(
                len(seen),
                level,
                len(mine),
                len(mine) - len(missed),
                float(np.median(ratios)),
                min(ratios),
                max([t.result.ratio for t in missed], default=0.0),
                sum(not t.result.ambiguous for t in missed),
            )
        )
    return found


def beam_table(seeds: int = 3, *, refine: bool = False) -> list[Row]:
    """The table of hits for both layouts."""
    return [row for seen in LAYOUTS for row in rows(list(beam_trials(seen, seeds=seeds, refine=refine)), seen)]


def mid_span(node: int = 12) -> LocationResult:
    """One sensor at mid-span, clean data: the mirror place explains them as well, and the search says so."""
    model = beam((20,))
    h = model.impulse_response(DT, SAMPLES, "zoh")[:, :, NODES.index(node)]
    values = np.column_stack([np.convolve(h[:, 0], half_sine(SAMPLES, DT, 0.010, 0.005))[:SAMPLES]])
    return LocationSearch(model, hold="zoh", search=Search(refine=False), allow=["LID-E512"]).locate(values, DT)


# -- the plate --------------------------------------------------------------------------------------------------------
SIDES, GRID = (1.0, 0.8), 0.1
ACCELEROMETERS = ((0.23, 0.17), (0.71, 0.23), (0.37, 0.61), (0.83, 0.57), (0.53, 0.37))
PLATE_SAMPLES, PLATE_DT = 200, 1 / 4000


def plate(places: Sequence[tuple[float, float]], elements: tuple[int, int], modes: int) -> ForwardModel:
    """Simply supported aluminium plate, 1 x 0.8 m, 5 mm, five accelerometers, loads at places."""
    structure = plates.plate(
        lengths=SIDES,
        thickness=0.005,
        material=beams.Material(E=70e9, rho=2700, nu=0.33),
        elements=elements,
        damping=damping.Modal(0.01),
    )
    seen = [sensors.Accelerometer(at=a, direction="+Z", label=f"a{i}") for i, a in enumerate(ACCELEROMETERS)]
    return ForwardModel(
        structure, seen, [loads.Point(at=p, direction="+Z", label=f"({p[0]:.3g}, {p[1]:.3g})") for p in places],
        modes=modes,
    )  # fmt: skip


def plate_grid() -> list[tuple[float, float]]:
    """Candidates every 0.1 m, one spacing from the edges."""
    x, y = (np.arange(1, round(side / GRID)) * GRID for side in SIDES)
    return [(float(a), float(b)) for b in y for a in x]


@dataclass(frozen=True)
class Impact:
    """One impact on the plate: where it was, and what was found."""

    place: Array
    record: Record
    result: LocationResult

    @property
    def error(self) -> float:
        """Distance of the place found, in grid spacings."""
        assert self.result.found is not None
        return float(np.linalg.norm(self.result.found[0] - self.place)) / GRID

    @property
    def nearest(self) -> float:
        """Distance of the candidate with the smallest residual, in grid spacings: the place without refinement."""
        assert self.result.places is not None
        smallest = int(np.argmin(self.result.scores[0]))
        return float(np.linalg.norm(self.result.places[smallest] - self.place)) / GRID

    @property
    def missed(self) -> bool:
        """Off by more than one spacing."""
        return self.error > 1


def plate_impacts(count: int = 100, level: float = 0.05, seed: int = 0) -> list[Impact]:
    """Impacts anywhere within the grid, 2 to 5 ms long, each in a record of its own."""
    rng = np.random.default_rng(seed)
    truth = plate([(0.5, 0.4)], (16, 12), 60)
    model = plate(plate_grid(), (10, 8), 40)
    search = LocationSearch(model)
    found = []
    for k in range(count):
        place = np.array([rng.uniform(GRID, side - GRID) for side in SIDES])
        force = half_sine(PLATE_SAMPLES, PLATE_DT, 0.005, rng.uniform(0.002, 0.005))
        one = truth.with_loads([replace(truth.loads[0], at=tuple(place))])  # type: ignore[call-arg]
        values, std = noisy(one.predict(force, PLATE_DT), level, 1000 * seed + k)
        record = recorded(model, values, PLATE_DT, std)
        found.append(Impact(place, record, search.locate(record)))
    return found


# -- words and pictures -----------------------------------------------------------------------------------------------
def show_beam(table: Sequence[Row]) -> str:
    """The table of the beam in text."""
    lines = ["sensors noise  hits     ratio median (min)  largest of a miss  misses without a flag"]
    for r in table:
        miss = f"{r.largest_of_misses:.3f}" if r.hits < r.trials else "-"
        lines.append(
            f"{r.sensors:7d} {r.level:5.0%}  {r.hits:4d}/{r.trials:<4d} {r.median:6.3g} ({r.smallest:.3g})"
            f"{'':9s} {miss:>10s} {r.unflagged:12d}"
        )
    return "\n".join(lines)


def show_plate(impacts: Sequence[Impact]) -> str:
    """What the searches on the plate came to, in text."""
    error, nearest = np.array([i.error for i in impacts]), np.array([i.nearest for i in impacts])
    missed = [i for i in impacts if i.missed]
    inside = np.mean([_distance2(i) < 5.99 for i in impacts])
    silent = sum(not i.result.ambiguous for i in missed)
    alarms = sum(i.result.ambiguous for i in impacts if not i.missed)
    return "\n".join(
        [
            f"{len(impacts)} impacts on the plate, {len(ACCELEROMETERS)} accelerometers; errors in grid spacings",
            f"  refined: median {np.median(error):.4f}, 90 % {np.quantile(error, 0.9):.4f}, largest {error.max():.3f}",
            f"  best candidate alone: median {np.median(nearest):.2f}, largest {nearest.max():.2f}",
            f"  off by more than a spacing: {len(missed)}, {silent} of them without a flag; flags on others: {alarms}",
            f"  true place inside the stated 95 % ellipse: {inside:.0%}",
        ]
    )


def _distance2(impact: Impact) -> float:
    assert impact.result.found is not None
    assert impact.result.covariance is not None
    off = impact.result.found[0] - impact.place
    return float(off @ np.linalg.solve(impact.result.covariance[0], off))


def picture(path: Path, impacts: Sequence[Impact]) -> None:
    """All places on the plate, and the residual map of the impact that was hardest to place."""
    from matplotlib.figure import Figure

    from loadid._plots.choosing import draw_map

    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    candidates = np.array(plate_grid())
    left.plot(*candidates.T, "+", color="0.7", label="candidates")
    left.plot(*np.array(ACCELEROMETERS).T, "^", color="#009E73", label="accelerometers")
    left.plot(*np.array([i.place for i in impacts]).T, "o", mfc="none", mec="k", ms=7, label="true")
    left.plot(*np.array([i.result.found[0] for i in impacts]).T, ".", color="#D55E00", ms=4, label="found")
    left.set(
        xlim=(0, SIDES[0]), ylim=(0, SIDES[1]), aspect="equal", xlabel="x [m]", ylabel="y [m]",
        title=f"{len(impacts)} impacts, 5 % noise: median error {np.median([i.error for i in impacts]):.3f} spacings",
    )  # fmt: skip
    left.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4, fontsize=8, frameon=False)
    hardest = max(impacts, key=lambda i: i.error)
    draw_map(right, hardest.result, truth=hardest.place[None])
    right.set_title(f"residual map of the largest error, {hardest.error:.3f} spacings")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the tables and save the picture."""
    write = sys.stdout.write
    write("19 candidates on a beam\n" + show_beam(beam_table()) + "\n\n")
    mirror = mid_span()
    write(f"one sensor at mid-span\n{mirror.summary()}\n\n")
    impacts = plate_impacts()
    write(show_plate(impacts) + "\n")
    target = Path("impact_location.png")
    picture(target, impacts)
    write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
