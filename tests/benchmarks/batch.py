"""What `loadid batch` costs beside the work itself, and whether it survives. `python -m tests.benchmarks.batch`.

    --only speed     40 chunks of 1 s that only wait, on one and on two workers; and that compute
    --only overhead  chunks of 10 s that only wait, beside the waiting
    --only kills     runs with a worker killed by SIGKILL at random moments, beside a serial one (--runs 50)
    --only plan      100 000 records planned: seconds and memory, files new and files known
    --only fleet     500 assets x 1 day at 100 Hz planned, costed from the first chunks (two processes of two cores)
    --folder PATH    where files are written (default a temporary folder; fleet takes 70 MB)

The alternative that is at hand is a loop of `loadid identify` in a shell: every record starts a process (last row).
"""

from __future__ import annotations

import argparse
import contextlib
import datetime as dt
import io
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from pathlib import Path

import numpy as np

from loadid import cli
from loadid._batch import plan as plans
from loadid._batch import records
from loadid._batch import run as running
from loadid._batch.records import Chunk, Order, part_of
from loadid._batch.work import Done
from loadid._batch.work import work as real
from tests.batch.fleet import fleet, record, written
from tests.halfsine import system

PARTS = {"kind": "refused", "why": "bad input", "said": "a chunk that waits"}
HEAD = "[job]\nchoice = 0.003\n[run]\npiece = 6000\nworkers = {workers}\n"


def nap(chunk: Chunk, order: Order) -> Done:
    """A chunk that waits so long as its record's name says, in hundredths of a second, and writes a part."""
    begun, target = time.monotonic(), part_of(order.folder, chunk.key)
    time.sleep(float(os.environ["GRAIN"]))
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(json.dumps(PARTS))
    return Done(time.monotonic() - begun, str(os.getpid()))


def waited(folder: Path, count: int, workers: int, grain: float) -> tuple[float, float]:
    """Seconds of a run of chunks that wait, with its start; and from the first part to the last."""
    shutil.rmtree(folder, ignore_errors=True)
    plan = fleet(folder, assets=1, records=count, samples=300, more=HEAD.format(workers=workers))
    os.environ["GRAIN"], running.work = str(grain), nap
    begun = time.monotonic()
    try:
        quiet(["batch", str(plan)])
    finally:
        running.work = real
    whole = time.monotonic() - begun
    stamps = [line["at"] for line in ledger(folder)]
    first, last = (dt.datetime.fromisoformat(stamp).timestamp() for stamp in (stamps[0], stamps[-1]))
    return whole, last - first + grain


def quiet(arguments: list[str]) -> int:
    """The command, its text thrown away."""
    with contextlib.redirect_stdout(io.StringIO()):
        return cli.main(arguments)


def ledger(folder: Path) -> list[dict]:
    return [json.loads(line) for line in (folder / "out" / "ledger.jsonl").read_text().splitlines()]


def speed(folder: Path) -> None:
    """Chunks of 1 s on one and two workers."""
    count = 40
    one, two = (waited(folder / "nap", count, workers, 1.0)[0] for workers in (1, 2))
    print(f"{count} chunks that wait 1 s: 1 worker {one:.1f} s, 2 workers {two:.1f} s: {one / two:.3f} times")
    times = []
    for workers in (1, 2):
        shutil.rmtree(folder / "real", ignore_errors=True)
        plan = fleet(folder / "real", assets=1, records=24, samples=30_000,
                     more=f'[job]\nchoice = "gcv"\nvariance = "constant"\n[run]\nworkers = {workers}\n')  # fmt: skip
        begun = time.monotonic()
        quiet(["batch", str(plan)])
        times.append(time.monotonic() - begun)
    grain = np.median([line["seconds"] for line in ledger(folder / "real")])
    print(f"24 records that compute, {grain:.2g} s each: 1 worker {times[0]:.1f} s, 2 workers {times[1]:.1f} s: "
          f"{times[0] / times[1]:.2f} times (load of the machine {os.getloadavg()[0]:.1f})")  # fmt: skip
    begun, at = time.monotonic(), folder / "real" / "b0"
    base = [sys.executable, "-m", "loadid.cli", "identify", "--model", str(folder / "real" / "beam.h5"), "--choice",
            "gcv", "--variance", "constant", "--unit", "y0=arbitrary", "-o", str(folder / "r.h5")]  # fmt: skip
    for path in sorted(at.iterdir())[:4]:
        subprocess.run([*base, str(path)], check=True, stdout=subprocess.DEVNULL)
    each = (time.monotonic() - begun) / 4
    print(f"a loop of `loadid identify`, one process: {each:.2f} s a record, 24 records {24 * each:.0f} s")


def overhead(folder: Path) -> None:
    """Chunks of 10 s on two workers, beside the waiting itself."""
    count, grain = 16, 10.0
    whole, inside = waited(folder / "nap", count, 2, grain)
    ideal = count * grain / 2
    print(f"{count} chunks that wait {grain:g} s on 2 workers, ideal {ideal:.0f} s: {inside:.2f} s from the first "
          f"chunk to the last part ({100 * (inside / ideal - 1):.2f} %), {whole:.2f} s with start, plan, tables and "
          f"page ({100 * (whole / ideal - 1):.1f} %)")  # fmt: skip


def kills(folder: Path, runs: int) -> None:
    """Runs with a worker killed at a random moment, once or more in each."""
    shutil.rmtree(folder / "kills", ignore_errors=True)
    plan = fleet(folder / "kills", assets=2, records=3, samples=1500, more=HEAD.format(workers=1))
    record(folder / "kills" / "b0" / "20260301_0100.npz", 36_000, 7)
    out = folder / "kills" / "out"
    quiet(["batch", str(plan)])
    expected, chunks = written(out), len(ledger(folder / "kills"))
    rng, tally = random.Random(1), Counter()
    begun = time.monotonic()
    for _ in range(runs):
        shutil.rmtree(out)
        crews: list[running.Processes] = []
        over = threading.Event()

        def watched(size: int, memory: float | None, crews: list = crews) -> running.Processes:
            crews.append(Killable(2, memory))
            return crews[0]

        def kill(crews: list = crews, over: threading.Event = over) -> None:
            left = rng.randint(1, 3)
            while left and not over.wait(rng.uniform(0.0, 3.0)):
                busy = [who.result() for who in list(crews[0].who.values()) if who.done()] if crews else []
                if busy:
                    tally["killed"] += 1
                    left -= 1
                    try:
                        os.kill(rng.choice(busy), signal.SIGKILL)
                    except ProcessLookupError:
                        tally["killed"] -= 1

        made, running.Processes = running.Processes, watched  # type: ignore[misc,assignment]
        thread = threading.Thread(target=kill, daemon=True)
        thread.start()
        try:
            tally["exit 0"] += quiet(["batch", str(plan)]) == 0
        finally:
            over.set()
            thread.join()
            running.Processes = made  # type: ignore[misc]
        lines = ledger(folder / "kills")
        done = [line["key"] for line in lines if line["event"] == "done"]
        tally["identical"] += written(out) == expected
        tally["duplicates"] += len(done) - len(set(done))
        tally["chunks repeated"] += sum(line["event"] == "lost" for line in lines)
        tally["failed"] += sum(line["event"] == "failed" for line in lines)
    names = ("exit 0", "identical", "killed", "chunks repeated", "duplicates", "failed")
    said = ", ".join(f"{name} {tally[name]}" for name in names)
    print(f"{runs} runs of {chunks} chunks on 2 workers: {said} ({time.monotonic() - begun:.0f} s)")


class Killable(running.Processes):
    """Processes whose numbers are known."""

    @property
    def who(self) -> dict:
        """Futures of their numbers."""
        return self._who


def planned(folder: Path) -> None:
    """100 000 records of 100 assets: manifest and run, twice."""
    count, place = 100_000, folder / "many"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    system().save(place / "beam.h5")
    for a in range(100):
        (place / f"b{a:03}").mkdir()
        for k in range(count // 100):
            (place / f"b{a:03}" / f"202603{1 + k // 48:02}_{k // 2 % 24:02}{k % 2 * 30:02}.csv").write_text(f"{a} {k}")
    names = "".join(f'[[asset]]\nname = "b{a:03}"\n' for a in range(100))
    (place / "plan.toml").write_text('output = "out"\n[every]\nmodel = "beam.h5"\nrecords = ["{name}/*.csv"]\n'
                                     'start = "%Y%m%d_%H%M.csv"\n' + names)  # fmt: skip
    code = (
        "import sys, time, resource\nfrom pathlib import Path\nb = time.monotonic()\n"
        "from loadid._batch import plan, records, run\np = plan.read(sys.argv[1])\nm = records.manifest(p)\n"
        "r = run.Run(p, m, run.Processes(2), run.Ledger(p.output / 'ledger.jsonl'))\n"
        "print(f'{r.waiting} chunks, {time.monotonic() - b:.1f} s, '"
        "f'{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB, {len(m.bad)} bad')\n"
    )
    for words in ("files never seen", "files known"):
        run = subprocess.run([sys.executable, "-c", code, str(place / "plan.toml")], check=True, capture_output=True,
                             text=True)  # fmt: skip
        print(f"plan of {count} records of 100 assets, {words}: {run.stdout.strip()}")


def simulated(folder: Path, days: int) -> None:
    """A day of 500 assets at 100 Hz, some of them run: one file under 500 names, as days are alike in their bytes."""
    place, samples = folder / "fleet", 8_640_000
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    system().save(place / "beam.h5")
    record(place / "day.npz", samples, 1)
    for a in range(500):
        (place / f"b{a:03}").mkdir()
        os.link(place / "day.npz", place / f"b{a:03}" / "20260301.npz")
    names = "".join(f'[[asset]]\nname = "b{a:03}"\n' for a in range(500))
    (place / "plan.toml").write_text(
        'output = "out"\nreading = { unit = { y0 = "arbitrary" } }\n[fatigue]\nexponents = [3, 5]\n[every]\n'
        'model = "beam.h5"\nrecords = ["{name}/*.npz"]\nstart = "%Y%m%d.npz"\n' + names
    )  # fmt: skip
    path = str(place / "plan.toml")
    begun = time.monotonic()
    asked = plans.read(path, workers=2)
    listed = records.manifest(asked)
    print(f"plan of {len(listed.entries)} days, {500 * samples / 1e9:.2f}e9 samples: {time.monotonic() - begun:.1f} s "
          "(one file under 500 names is read once)")  # fmt: skip
    command = [sys.executable, "-m", "loadid.cli", "batch", path, "--workers", "2"]
    said = subprocess.run([*command, "--estimate"], check=True, capture_output=True, text=True)
    print(said.stdout.strip())
    times = [(line["seconds"], "piece" if "span" in line else "first") for line in ledger(place)]
    print("; ".join(f"{kind} {seconds:.2f} s" for seconds, kind in times))
    few = path.replace("plan.toml", "few.toml")
    Path(few).write_text(Path(path).read_text().split(f'[[asset]]\nname = "b{days:03}"')[0].replace('"out"', '"few"'))
    begun, command[4] = time.monotonic(), few
    said = subprocess.run(command, check=True, capture_output=True, text=True)
    print(f"{days} of these days run: {time.monotonic() - begun:.0f} s; {said.stdout.splitlines()[0]}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=("speed", "overhead", "kills", "plan", "fleet"))
    parser.add_argument("--runs", type=int, default=50, help="of kills")
    parser.add_argument("--days", type=int, default=25, help="of fleet that are run (25 are 5 %%)")
    parser.add_argument("--folder", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = args.folder or Path(temporary)
        for name, part in (("speed", speed), ("overhead", overhead), ("kills", lambda f: kills(f, args.runs)),
                           ("plan", planned), ("fleet", lambda f: simulated(f, args.days))):  # fmt: skip
            if args.only in (None, name):
                part(folder)


if __name__ == "__main__":
    main()
