"""Misses of the search for a place, and what it costs. `python -m tests.benchmarks.location [SEEDS] [IMPACTS]`.

1520 searches among 19 candidates on a beam (two layouts, four noise levels, SEEDS = 10 draws), without refinement:
hits, ratio of the runner-up, misses without a flag. The same with truncated SVD in place of Tikhonov; and refined, at
the noise where searches miss. Then IMPACTS = 100 impacts on a plate, refined. Then CPU seconds of one search: the
factors made once; each further record; beside dense SVDs made anew for every record, which is what the recipe costs as
it is usually written. About four minutes.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from case_studies import impact_location as study
from loadid import LocationSearch, Search
from loadid.paths import toeplitz

RANK = 40
LENGTHS = (200, 2000, 20_000)


def truncated(level: float = 0.01, seeds: int = 5) -> tuple[int, int]:
    """Hits and trials with truncated SVD of one rank for all candidates."""
    seen = study.LAYOUTS[0]
    h = study.beam(seen).impulse_response(study.DT, study.SAMPLES, "zoh")
    force = study.half_sine(study.SAMPLES, study.DT, 0.010, 0.005)
    matrices = [toeplitz(h[:, :, c, None]).reshape(-1, study.SAMPLES) for c in range(len(study.NODES))]
    ranges = [np.linalg.svd(H, full_matrices=False)[0][:, :RANK] for H in matrices]
    hits = 0
    for c, node in enumerate(study.NODES):
        clean = (matrices[c] @ force).reshape(study.SAMPLES, -1)
        for seed in range(seeds):
            y = study.noisy(clean, level, 100 * 2 * node + seed)[0].ravel()
            hits += int(np.argmin([np.linalg.norm(y - U @ (U.T @ y)) for U in ranges])) == c
    return hits, seeds * len(study.NODES)


def refined(seen: tuple[int, ...], level: float, seeds: int = 3) -> str:
    """Refined places on the beam: how many are off by more than a spacing, and what is flagged."""
    trials = list(study.beam_trials(seen, (level,), seeds, refine=True))
    off = np.array([abs(t.result.found[0, 0] - 0.05 * t.node) / 0.1 for t in trials])
    flagged = np.array([t.result.ambiguous for t in trials])
    inside = np.mean([o * 0.1 < 1.96 * t.result.std[0, 0] for o, t in zip(off, trials, strict=True)])
    return (
        f"{len(seen)} sensors {level:4.0%}: median error {np.median(off):.3f} spacings, {np.sum(off > 1)} of "
        f"{len(off)} off by more than one, {np.sum((off > 1) & ~flagged)} of them without a flag, "
        f"{np.sum((off <= 1) & flagged)} flags on others; inside the 95 % band {inside:.0%}"
    )


def spent(work: Callable[[], object], runs: int) -> float:
    """Median CPU seconds."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return float(np.median(times))


def costs(samples: int) -> tuple[float, float, float]:
    """CPU seconds of the first search, of a further one, and of the recipe with dense SVDs (nan where too large)."""
    model = study.beam(study.LAYOUTS[0])
    force = study.half_sine(samples, study.DT, 0.010, 0.005)
    load = np.zeros((samples, len(study.NODES)))
    load[:, 5] = force
    values, std = study.noisy(model.predict(load, study.DT, "zoh"), 0.05, 0)
    record = study.recorded(model, values, study.DT, std)
    runs = 5 if samples < 1000 else 1

    def fresh() -> LocationSearch:
        one = LocationSearch(model, hold="zoh", search=Search(refine=False, workers=1))
        one.locate(record)
        return one

    kept = fresh()
    first, further = spent(fresh, runs), spent(lambda: kept.locate(record), runs)
    if samples > 600:
        return first, further, float("nan")
    h = model.impulse_response(study.DT, samples, "zoh")
    y = values.ravel()

    def recipe() -> int:
        left = []
        for c in range(h.shape[2]):
            U, s, _ = np.linalg.svd(toeplitz(h[:, :, c, None]).reshape(-1, samples), full_matrices=False)
            f = s**2 / (s**2 + (1e-3 * s[0]) ** 2)
            left.append(np.linalg.norm(y - U @ (f * (U.T @ y))))
        return int(np.argmin(left))

    return first, further, spent(recipe, runs)


def main(seeds: int = 10, impacts: int = 100) -> None:
    """Print all tables."""
    write = sys.stdout.write
    write(study.show_beam(table := study.beam_table(seeds)) + "\n")
    missed = sum(r.trials - r.hits for r in table)
    write(f"{sum(r.trials for r in table)} searches, {missed} misses, largest ratio of a miss ")
    write(f"{max(r.largest_of_misses for r in table):.4f}, {sum(r.unflagged for r in table)} without a flag\n")
    hits, trials = truncated()
    write(f"truncated SVD of rank {RANK}, 1 % noise: {hits}/{trials} hits\n")
    write("refined places on the beam\n")
    for seen, level in ((study.LAYOUTS[0], 0.05), (study.LAYOUTS[0], 0.30), (study.LAYOUTS[1], 0.30)):
        write("  " + refined(seen, level) + "\n")
    write("\n" + study.show_plate(study.plate_impacts(impacts)) + "\n\n")
    write("samples  first search  further record  dense SVDs anew   (CPU s, 19 candidates, 3 sensors)\n")
    for samples in LENGTHS:
        first, further, recipe = costs(samples)
        write(f"{samples:7d} {first:13.3f} {further:15.4f} {recipe:16.3f}\n")


if __name__ == "__main__":
    main(*(int(a) for a in sys.argv[1:]))
