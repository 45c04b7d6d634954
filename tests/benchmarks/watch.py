"""What the watch over the sensors costs. `python -m tests.benchmarks.watch [ROUNDS]`.

A chain of sixteen masses, eight modes of it, one load and 4, 8, 12 and 16 displacement sensors, fitted to one clean
record; another clean one is followed by `LoadTracker.step` and `LoadTracker.run`, with the watch and without it.
Microseconds of CPU a sample once the gain has settled, the least of ROUNDS (5) rounds in turn, and their ratio in the
same run; the share of rows with an alarm, which should be none.

Then a building of ten storeys whose load is seen by one accelerometer beside it (`tests.tracked.bm2`), on ten clean
records of 4000 samples without gaps and with 1 and 5 % of all cells missing: channels that are named, and the mean
error of the load over that without gaps.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np

from loadid import LoadTracker, Noise
from loadid._families.tracking.tracker import Tracker
from loadid.priors import Matern32
from structures import ForwardModel, chains, loads, sensors
from tests.tracked import bm2

CHANNELS, SAMPLES, SETTLED, FINER, DT = (4, 8, 12, 16), 3000, 1000, 10, 0.005


def fitted(channels: int) -> tuple[Tracker, np.ndarray]:
    """A tracker, and a clean record for it."""
    rng, masses = np.random.default_rng(channels), 16
    building = chains.shear_building(masses=[1.0] * masses, stiffnesses=[4e3] * masses, damping=0.02)
    rows = [sensors.Displacement(f"{i + 1}+X", label=f"s{i}") for i in range(masses - channels, masses)]
    model = ForwardModel(building, rows, [loads.Point("9+X", label="F")], modes=8)
    records = []
    for _ in "ab":
        t, waves = np.arange(FINER * SAMPLES) / FINER, zip(rng.uniform(100, 600, 4), rng.uniform(0, 6, 4), strict=True)
        load = sum(np.sin(2 * np.pi * t / long + at) for long, at in waves) * np.minimum(t / 50, 1)
        clean = np.asarray(model.predict(np.asarray(load)[:, None], DT / FINER))[::FINER]
        records.append(clean)
    noise = 0.02 * records[0].std(axis=0)
    records = [clean + noise * rng.standard_normal(clean.shape) for clean in records]
    return LoadTracker(model, noise=noise).fit(records[0], DT), records[1]


def least(work: Callable[[Tracker], object], trackers: list[Callable[[], Tracker]], rounds: int) -> list[float]:
    """Microseconds of CPU a sample of each tracker, in turn."""
    times = np.empty((rounds, len(trackers)))
    for i in range(rounds):
        for j, made in enumerate(trackers):
            tracker = made()
            start = time.process_time()
            work(tracker)
            times[i, j] = (time.process_time() - start) / (SAMPLES - SETTLED) * 1e6
    return [float(t) for t in times.min(axis=0)]


def missing(share: float) -> tuple[int, float]:
    """Channels that are named on ten records with missing cells, and the mean rms error of the load."""
    case = bm2("matern", 0, samples=3000)
    known = {"prior": Matern32(100.0, 0.08), "noise": Noise(case.noise, source="data sheet")}
    tracker = LoadTracker(case.setup.space(), **known).fit(case.y[:2000], case.dt)
    named, errors = 0, []
    for seed in range(10):
        other, rng = bm2("matern", seed, samples=4000), np.random.default_rng(seed + 70)
        clean = other.setup.respond(other.load, 1, "zoh")
        y = clean + case.noise * rng.standard_normal(clean.shape)
        y[rng.random(y.shape) < share] = np.nan
        tracker.reset()
        errors.append(float(np.sqrt(np.mean((tracker.run(y)[0] - other.load) ** 2))))
        named += len(tracker.faults)
    return named, float(np.mean(errors))


def main() -> None:
    """Print the tables."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 5
    print("channels states    step   bare ratio     run   bare ratio  alarm")
    for channels in CHANNELS:
        tracker, record = fitted(channels)
        begun, record = record[:SETTLED], record[SETTLED:]
        samples = list(record)

        def watched(tracker: Tracker = tracker, begun: np.ndarray = begun) -> Tracker:
            made = Tracker(tracker.fitted, tracker.gate)
            made.compile()
            made.run(begun)
            return made

        def bare(watched: Callable[[], Tracker] = watched) -> Tracker:
            made = watched()
            made._watch = None
            return made

        def stepped(run: Tracker, samples: list[np.ndarray] = samples) -> None:
            for y in samples:
                run.step(y)

        def blocked(run: Tracker, record: np.ndarray = record) -> None:
            run.run(record)

        both: list[Callable[[], Tracker]] = [watched, bare]
        one, two = least(stepped, both, rounds)
        three, four = least(blocked, both, rounds)
        states, run = tracker.fitted.model.n, watched()
        run.run(record)
        alarm = float(np.mean(run.row_alarms[:, 0] > 0))
        print(f"{channels:8d} {states:6d}  {one:6.2f} {two:6.2f} {one / two:5.2f}  {three:6.2f} {four:6.2f} "
              f"{three / four:5.2f}  {alarm:5.1%}", flush=True)  # fmt: skip
    usual = missing(0.0)[1]
    print("cells missing   named   error over that without")
    for share in (0.0, 0.01, 0.05):
        named, error = missing(share)
        print(f"{share:12.0%} {named:7d} {error / usual:10.2f}")


if __name__ == "__main__":
    main()
