"""Time of one sample through the tracker's core. `python -m tests.benchmarks.tracker [BATCHES]`.

A stable model with 20, 60 and 200 states (one load, random walk) and 10 sensors. Microseconds of CPU a sample, median
of BATCHES (15) batches: the settled filter sample by sample (load, std, innovation, NaN test) and in blocks; the same
with a delay of 20 samples, and with a channel that comes ten times more slowly; the square-root step for gaps;
filterpy's `predict` + `update` in the same run, with the ratio. Then milliseconds of the steady gain, and of scipy's
Riccati solver.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

import numpy as np
from filterpy.kalman import KalmanFilter
from scipy.linalg import solve_discrete_are

from loadid._inverse.gaussian.lag import LagLine, fixed_lag
from loadid._inverse.gaussian.loop import Loop, PeriodicLoop
from loadid._inverse.gaussian.model import FilterModel, SquareRoot
from loadid._inverse.gaussian.steady import SteadyFilter, periodic, steady

SIZES, SENSORS, LAG, DT = (20, 60, 200), 10, 20, 0.01
EVERY = 10  # samples between two of the slow channel
OWN = {
    "step": "step", "late": f"step + lag {LAG}", "block": "block of 4096", "rates": f"block, a channel each {EVERY}th",
    "root": "square-root step",
}  # fmt: skip
LIMITS = {"step": 2.5, "root": 150.0, "ratio": 12.0}  # at 60 states


def model(states: int, seed: int = 0) -> FilterModel:
    """Modes between 1 and 40 Hz with 1 % damping, sensors that see them all, one of them the load's static part."""
    rng = np.random.default_rng(seed)
    modes = (states - 1) // 2
    nx = states - 1
    F, H = np.zeros((states, states)), np.zeros((SENSORS, states))
    for i, f in enumerate(np.geomspace(1.0, 40.0, modes)):
        w, z = 2 * np.pi * f, 0.01
        c, s, decay = np.cos(w * DT), np.sin(w * DT), np.exp(-z * w * DT)
        F[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = decay * np.array([[c, s], [-s, c]])
        F[2 * i : 2 * i + 2, -1] = rng.standard_normal() * np.array([1 - c, s]) / w
    if 2 * modes < nx:
        F[nx - 1, nx - 1] = 0.5
    F[-1, -1] = 1.0
    H[:, :nx] = rng.standard_normal((SENSORS, nx))
    H[:, -1] = rng.standard_normal(SENSORS)
    LQ = np.diag(np.r_[np.full(nx, 1e-3), 0.1])
    Cp = np.zeros((1, states))
    Cp[0, -1] = 1.0
    return FilterModel(F, LQ, H, 0.1 * np.eye(SENSORS), Cp, np.zeros(states), np.eye(states), nx=nx)


def median(work: Callable[[], object], samples: int, batches: int) -> float:
    """Microseconds of CPU a sample."""
    work()
    times = []
    for _ in range(batches):
        start = time.process_time()
        work()
        times.append((time.process_time() - start) / samples * 1e6)
    return float(np.median(times))


def own(states: int, batches: int) -> dict[str, float]:
    """Our ways."""
    system = model(states)
    gain, Y = steady(system, DT), np.random.default_rng(1).standard_normal((4096, SENSORS))
    rows = list(Y[:500])
    limit = 1e3 * gain.innovation_std
    found = {"step": median(stepping(gain, limit, rows), len(rows), batches)}
    found["late"] = median(stepping(gain, limit, rows, LagLine(fixed_lag(gain, LAG))), len(rows), batches)
    loop, load, e = Loop(gain.rows(), 1, SENSORS, system.x0, limit), np.empty((4096, 1)), np.empty(Y.shape)
    found["block"] = median(lambda: loop.block(Y, load, e), len(Y), batches)
    found["rates"] = median(several(system, Y), len(Y), min(batches, 5))
    core, few = SquareRoot(system), rows[:50]
    state = core.update(core.start(), Y[0])[0]

    def rooted() -> None:
        now = state
        for y in few:
            now = core.advance(now, y)[0]

    found["root"] = median(rooted, len(few), batches)
    return found


def several(system: FilterModel, Y: np.ndarray) -> Callable[[], object]:
    """The same block where one channel comes more slowly: what would be a square-root step each."""
    masks, slow = np.ones((EVERY, SENSORS), bool), Y.copy()
    masks[1:, 0] = False
    slow[np.arange(len(Y)) % EVERY != 0, 0] = np.nan
    filters, load, e = periodic(system, masks), np.empty((len(Y), 1)), np.empty(Y.shape)

    def run() -> None:
        taken = PeriodicLoop(filters, system.x0).block(slow, load, e)
        assert taken == len(Y)

    return run


def stepping(
    gain: SteadyFilter, limit: np.ndarray, rows: list[np.ndarray], line: LagLine | None = None
) -> Callable[[], object]:
    """A loop over samples as a tracker runs it."""
    loop, std = Loop(gain.rows(), 1, SENSORS, gain.model.x0, limit), gain.std

    def plain() -> object:
        step = loop.step
        for y in rows:
            load = step(y)
        return load, std

    def late() -> object:
        step, push = loop.step, line.push
        for y in rows:
            load = push(step(y), loop.e)
        return load, std

    return plain if line is None else late


def filterpys(states: int, batches: int) -> float:
    """Microseconds of filterpy's predict and update."""
    system, rows = model(states), list(np.random.default_rng(1).standard_normal((20, SENSORS)))
    other = KalmanFilter(states, SENSORS)
    other.F, other.H, other.Q = system.F.copy(), system.H.copy(), system.LQ @ system.LQ.T
    other.R, other.P, other.x = system.LR @ system.LR.T, system.L0 @ system.L0.T, system.x0.copy()

    def run() -> None:
        for y in rows:
            other.predict()
            other.update(y)

    return median(run, len(rows), batches)


def gains(states: int) -> tuple[float, float]:
    """Milliseconds of the steady gain with its checks, and of scipy's Riccati solver alone."""
    system = model(states)
    Q, R = system.LQ @ system.LQ.T, system.LR @ system.LR.T
    return (median(lambda: steady(system, DT), 1, 5) / 1e3,
            median(lambda: solve_discrete_are(system.F.T, system.H.T, Q, R), 1, 5) / 1e3)  # fmt: skip


def main(batches: int = 15) -> None:
    """Print the tables."""
    print(f"us of CPU a sample, {SENSORS} sensors, median of {batches} batches")
    print(f"{'':28}" + "".join(f"{n:>10}" for n in SIZES) + "   states")
    fast = {n: own(n, batches) for n in SIZES}
    for key, name in OWN.items():
        print(f"{name:28}" + "".join(f"{fast[n][key]:10.2f}" for n in SIZES))
    other = {n: filterpys(n, batches) for n in SIZES}
    print(f"{'filterpy predict + update':28}" + "".join(f"{other[n]:10.2f}" for n in SIZES))
    print(f"{'  over step':28}" + "".join(f"{other[n] / fast[n]['step']:9.1f}x" for n in SIZES))
    held = {n: gains(n) for n in SIZES}
    print(f"{'steady gain, ms':28}" + "".join(f"{held[n][0]:10.2f}" for n in SIZES))
    print(f"{'scipy DARE, ms':28}" + "".join(f"{held[n][1]:10.2f}" for n in SIZES))
    reached = {"step": fast[60]["step"], "root": fast[60]["root"], "ratio": other[60] / fast[60]["step"]}
    for key, limit in LIMITS.items():
        good = reached[key] >= limit if key == "ratio" else reached[key] <= limit
        print(f"60 states, {key}: {reached[key]:.2f} ({'at least' if key == 'ratio' else 'at most'} {limit:g})"
              f" {'reached' if good else 'MISSED'}")  # fmt: skip


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
