"""A tracker that runs for a day, and one that is killed again and again. `python -m tests.benchmarks.stream`.

    --samples 3600000    through the block path, memory after the first sixtieth (a minute of an hour) and at the end
    --day                86.4 million: a day at 1 kHz
    --kills 200          `loadid track` killed at random moments; its output beside that of an undisturbed run
    --only soak|text|latency|kills|restart

A chain of 18 masses (36 states) under one load, a Matern-3/2 process with an Ornstein-Uhlenbeck process beside it (3
states), 8 sensors. CPU seconds of one thread. filterpy runs the same model, predict and update for each sample.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from loadid import LoadTracker
from loadid._families.tracking import tracker as checkpoint
from loadid._families.tracking.fit import TrackerFit
from loadid._families.tracking.tracker import Tracker
from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.steady import steady
from loadid._stream import follow
from loadid.priors import OU, Matern32, Sum
from tests.killed import Nursery, fitted, leaves, tortured, troubled
from tests.tracked import Setup, bm2, selector, tridiagonal

LIMITS = {
    "memory, MB": 5.0,
    "a day, s": 300.0,
    "restart in a warm process, s": 1.0,
    "restart in a new process, s CPU": 1.0,
    "different bytes": 0.0,
    "text, us/sample": 6.0,
    "text with watch, us/sample": 6.0,
}
LEAST = {"filterpy over ours": 12.0}
BLOCK = 65_536


def tracker(modes: int = 18, sensors: int = 8) -> tuple[Tracker, NDArray[np.float64]]:
    """A chain under one load, and a stretch of its record that is played over and over."""
    K, M = 4e4 * tridiagonal(modes), np.eye(modes)
    rows = np.linspace(1, modes, sensors - 1).round().astype(int).tolist()
    setup = Setup(M, 0.002 * K, K, selector([modes], modes).T, selector(rows, modes), selector([modes], modes), 1e-3)
    rng = np.random.default_rng(0)
    load = np.cumsum(rng.standard_normal((20_000, 1)), axis=0)
    load -= np.linspace(0, 1, len(load))[:, None] * load[-1]
    clean = setup.respond(load)
    noise = 0.01 * clean.std(axis=0)
    space = setup.space("foh")
    prior = Sum((Matern32(50.0, 0.5), OU(20.0, 0.05)))
    model = augment(space, setup.dt, [prior], noise=noise)
    fit = TrackerFit(
        model=model, settled=steady(model, setup.dt), bank=(), dt=setup.dt, sensors=tuple(space.sensors),
        loads=tuple(space.loads), words=prior.words, numbers={}, noise_source="given", certificate=None, flags=(),
        fingerprint="chain", settings={}, inputs={},
    )  # fmt: skip
    return Tracker(fit), clean + noise * rng.standard_normal(clean.shape)


def soak(samples: int) -> dict[str, float]:
    """Samples through the block path; lost channels and whole lost samples among them."""
    t, Y = tracker()
    rng, first, done = np.random.default_rng(1), samples // 60, 0
    block = np.resize(Y, (BLOCK, Y.shape[1]))
    start, base, peak = time.process_time(), 0.0, 0.0
    while done < samples:
        size = min(BLOCK, samples - done)
        part = block[:size].copy()
        hit = int(rng.integers(0, max(size - 50, 1)))
        part[hit : hit + 10, int(rng.integers(Y.shape[1]))] = np.nan
        part[hit + 20 : hit + 22] = np.nan
        t.run(part)
        done += size
        if done >= first:
            gc.collect()
            base = base or resident()
            peak = max(peak, resident())
    seconds = time.process_time() - start
    growth = (peak - base) / 1e6
    print(f"block path, {t.fitted.model.n} states, {t.fitted.model.m} sensors, {done:,} samples: {seconds:.1f} s CPU, "
          f"{1e6 * seconds / done:.2f} us/sample; memory {base / 1e6:.0f} MB after {first:,} samples, "
          f"growth {growth:.2f} MB; {t.counts}")  # fmt: skip
    return {"memory, MB": growth, "a day, s": seconds * 86.4e6 / done, "us/sample": 1e6 * seconds / done}


def rival(own: float) -> dict[str, float]:
    """filterpy on the same model."""
    try:
        from filterpy.kalman import KalmanFilter
    except ImportError:
        print("filterpy is not installed: no comparison")
        return {}
    t, Y = tracker()
    m = t.fitted.model
    k = KalmanFilter(dim_x=m.n, dim_z=m.m)
    k.x, k.P, k.F, k.H = np.array(m.x0)[:, None], m.L0 @ m.L0.T, np.array(m.F), np.array(m.H)
    k.Q, k.R = m.LQ @ m.LQ.T, m.LR @ m.LR.T
    times = []
    for part in np.split(Y[:3000], 3):
        start = time.process_time()
        for y in part:
            k.predict()
            k.update(y[:, None])
        times.append((time.process_time() - start) / len(part))
    other = 1e6 * float(np.median(times))
    print(f"filterpy, predict + update: {other:.1f} us/sample, {other / own:.0f} times as long")
    return {"filterpy over ours": other / own}


def words(samples: int = 100_000) -> dict[str, float]:
    """The whole way from a file of text to a file of text, with checkpoints: a bare filter, and one with its watch."""
    found = {}
    for name, (t, Y) in {"text": tracker(), "text with watch": watched(samples)}.items():
        found[f"{name}, us/sample"] = text(name, t, Y, samples)
    return found


def watched(samples: int) -> tuple[Tracker, NDArray[np.float64]]:
    """A fitted tracker, gate and watch over its sensors, and a record that goes on."""
    case = bm2("matern", 0, samples=samples, fine=4)
    return LoadTracker(case.setup.space("foh"), noise=case.noise).fit(case.y[:4000], case.dt), case.y


def text(label: str, t: Tracker, Y: NDArray[np.float64], samples: int) -> float:
    """Microseconds of CPU a sample, the compiler loaded."""
    t.reset()
    t.compile()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        block = np.resize(Y, (samples, Y.shape[1]))
        table = np.column_stack([np.arange(samples) * t.fitted.dt, block])
        np.savetxt(folder / "in.csv", table, delimiter=",", fmt="%.9g")
        start, begun = time.process_time(), time.monotonic()
        done = follow(t, str(folder / "in.csv"), str(folder / "out.csv"), state=folder / "state.h5", idle=0)
        seconds, wall = time.process_time() - start, time.monotonic() - begun
    print(f"{label} to text with time stamps and checkpoints: {done.samples} samples, "
          f"{1e6 * seconds / samples:.1f} us/sample CPU, {1e6 * wall / samples:.1f} wall")  # fmt: skip
    return 1e6 * seconds / samples


def killed(kills: int) -> dict[str, float]:
    """Killed runs beside an undisturbed one."""
    t, Y = fitted(max(20 * kills, 600), lag=6, replay=12)
    nursery = Nursery()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        t.save(folder / "model.h5")
        data = troubled(t, Y)
        resumed, cut = tortured(nursery, folder, data, kills)
        nursery.close()
        (folder / "whole.csv").write_bytes(data)
        straight = checkpoint.load(folder / "model.h5")
        assert straight._engine.loop is not None
        straight._engine.loop.compile()
        done = follow(straight, str(folder / "whole.csv"), str(folder / "straight.csv"), idle=0)
        a, b = ((folder / name).read_bytes() for name in ("out.csv", "straight.csv"))
        own, other = (x.to_tree() for x in (checkpoint.load(folder / "state.h5"), straight))
        same = list(leaves(own)) == list(leaves(other))
    different = abs(len(a) - len(b)) + sum(x != y for x, y in zip(a, b, strict=False)) + (not same)
    print(f"killed {kills} times, {resumed} of them with a checkpoint, {cut} with output behind it; "
          f"{done.samples} samples, {len(b)} bytes, different: {different}")  # fmt: skip
    return {"different bytes": float(different)}


def restart(times: int = 7) -> dict[str, float]:
    """From the start of a run to the answer to one new sample: in a process that has imported everything, in a new one.

    The new process reads the state, cuts the output back, answers, saves the state again and ends. Bytecode is kept, as
    that of an installed package is. What numpy, scipy.linalg and h5py take of it is measured beside it.
    """
    t, Y = fitted(600)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        t.save(folder / "model.h5")
        (folder / "log").write_bytes(troubled(t, Y))
        argv = [sys.executable, "-m", "loadid.cli", "track", "--model", str(folder / "model.h5"), "--in",
                str(folder / "log"), "--out", str(folder / "o"), "--state", str(folder / "s.h5"),
                "--idle", "0", "--json"]  # fmt: skip
        env = {**os.environ, "PYTHONPYCACHEPREFIX": str(folder / "bytecode")}
        env.pop("PYTHONDONTWRITEBYTECODE", None)
        bare = [sys.executable, "-c", "import numpy, scipy.linalg, h5py"]
        for command in (argv, bare):
            subprocess.run(command, check=True, capture_output=True, env=env)
        inner, whole, least = [], [], []
        for k in range(times):
            _one_more(folder / "log", 6.0 + 2 * k * t.fitted.dt)
            begun, cpu = time.monotonic(), children()
            done = subprocess.run(argv, check=True, capture_output=True, env=env)
            whole.append((children() - cpu, time.monotonic() - begun))
            assert json.loads(done.stdout)["resumed"]
            assert json.loads(done.stdout)["samples"] >= 1
            _one_more(folder / "log", 6.0 + (2 * k + 1) * t.fitted.dt)
            begun = time.monotonic()
            again, stream = checkpoint.read(folder / "s.h5")
            follow(again, str(folder / "log"), str(folder / "o"), state=folder / "s.h5", stream=stream, idle=0)
            inner.append(time.monotonic() - begun)
            cpu = children()
            subprocess.run(bare, check=True, env=env)
            least.append(children() - cpu)
        cpu, wall = (float(np.median(column)) for column in zip(*whole, strict=True))
    warm, imports = float(np.median(inner)), float(np.median(least))
    print(f"restart: {warm:.3f} s in a warm process; a new process from its start to its end {cpu:.2f} s CPU "
          f"({min(c for c, _ in whole):.2f} to {max(c for c, _ in whole):.2f}), {wall:.2f} s wall; "
          f"numpy, scipy.linalg and h5py alone {imports:.2f} (machine load {os.getloadavg()[0]:.1f})")  # fmt: skip
    return {"restart in a warm process, s": warm, "restart in a new process, s CPU": cpu}


def _one_more(log: Path, t: float) -> None:
    with log.open("ab") as file:
        file.write(b"%.6f,0,0,0,0\n" % t)


class Clocked:
    """A pipe that notes when each line reached it."""

    def __init__(self) -> None:
        self.times: list[float] = []

    def write(self, data: bytes) -> int:
        """Take some lines."""
        self.times += [time.monotonic()] * bytes(data).count(b"\n")
        return len(data)

    def flush(self) -> None:
        """Nothing is held back."""


def latency(samples: int = 3000) -> dict[str, float]:
    """From a sample in a socket at 1 kHz, with pauses, to its answer in a pipe."""
    t, Y = tracker()
    sent: list[float] = []
    out = Clocked()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            connection, _ = server.accept()
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            with connection:
                for k in range(samples):
                    sent.append(time.monotonic())
                    connection.sendall(",".join(map(repr, [k * t.fitted.dt, *Y[k].tolist()])).encode() + b"\n")
                    time.sleep(0.05 if k % 500 == 499 else 1e-3)

        thread = threading.Thread(target=serve)
        thread.start()
        done = follow(t, f"tcp://127.0.0.1:{server.getsockname()[1]}", out)  # type: ignore[arg-type]
        thread.join()
    late = 1e3 * (np.array(out.times[1:]) - np.array(sent))
    middle, most = (float(np.percentile(late, q)) for q in (50, 99.9))
    print(f"socket to pipe at 1 kHz: {done.samples} samples, median {middle:.2f} ms, 99.9 % {most:.2f} ms; the source "
          f"waited {done.counts.get('waited', 0)} times (load of the machine {os.getloadavg()[0]:.1f})")  # fmt: skip
    return {"latency, ms": middle, "latency 99.9 %, ms": most}


def children() -> float:
    """CPU seconds of processes that have ended."""
    now = os.times()
    return now.children_user + now.children_system


def resident() -> float:
    """Bytes of this process in memory."""
    with open("/proc/self/status") as file:
        return next(1024.0 * float(line.split()[1]) for line in file if line.startswith("VmRSS"))


def main() -> int:
    """Print all figures; 1 where one is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=3_600_000)
    parser.add_argument("--day", action="store_true")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--only", choices=("soak", "text", "latency", "kills", "restart"))
    args = parser.parse_args()
    found: dict[str, float] = {}
    if args.only in (None, "soak"):
        found |= soak(86_400_000 if args.day else args.samples)
        found |= rival(found["us/sample"])
    if args.only in (None, "text"):
        found |= words()
    if args.only in (None, "latency"):
        found |= latency()
    if args.only in (None, "restart"):
        found |= restart()
    if args.only in (None, "kills"):
        found |= killed(args.kills)
    print("\nFigures (limit)")
    missed = 0
    for name, value in found.items():
        good = value <= LIMITS.get(name, np.inf) and value >= LEAST.get(name, -np.inf)
        missed += not good
        bound = f"at most {LIMITS[name]:g}" if name in LIMITS else f"at least {LEAST[name]:g}" if name in LEAST else "-"
        print(f"  {name:30s} {value:10.3g}   ({bound}){'' if good else '   MISSED'}")
    return int(missed > 0)


if __name__ == "__main__":
    sys.exit(main())
