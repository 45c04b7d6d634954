"""`loadid serve` behind a real MQTT broker: a fleet on one core, a day, kills. `python -m tests.benchmarks.serve`.

    --fleet 500          structures of 22 states and 4 sensors at 100 Hz, a message a second from each, for a minute:
                         CPU seconds of the server for a second of the fleet, its memory, lateness of the rows
    --day                86.4 million rows at 1 kHz (or --rows N) of one structure, as fast as they go, with pauses,
                         doubled, late and lost messages: memory after the first hour and at the end, what was counted
    --kills 1000         by SIGKILL while messages come: tables beside those of an undisturbed run
    --only fleet|day|kills

Needs mosquitto (`apt install mosquitto`). The alternative for a fleet is a process for each structure: what
`loadid track` takes for the same rows from a pipe is printed beside it.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from urllib.request import urlopen

import numpy as np

from loadid import LoadTracker
from loadid._families.tracking.tracker import Tracker
from tests.killed import text
from tests.serve.broker import Mosquitto, free_port, health, tortured, waited
from tests.tracked import bm2

TROUBLE = {"doubled": 997, "late": 1499, "lost": 1999}  # each so many messages
TICKS = os.sysconf("SC_CLK_TCK")


def spent(pid: int) -> float:
    """CPU seconds of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def resident(pid: int) -> float:
    """MB of a process in memory."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def fitted(samples: int, dt: float = 0.01) -> tuple[Tracker, np.ndarray]:
    """Tracker of a ten-storey building, fitted to a record of it, and a longer record."""
    case = bm2("matern", 0, samples=samples, dt=dt)
    return LoadTracker(case.setup.space("zoh"), noise=case.noise).fit(case.y[:3000], case.dt), case.y


def served(folder: Path, broker: Mosquitto, names: list[str], latency: float) -> tuple[subprocess.Popen[bytes], int]:
    """A server of structures that are alike, once it has subscribed."""
    port = free_port()
    assets = "".join(f'[[asset]]\nname = "{name}"\n' for name in names)
    (folder / "plan.toml").write_text(
        f'states = "states"\n[run]\nlatency = {latency}\nhttp = {port}\n[every]\nmodel = "model.h5"\n'
        f'source = "mqtt://127.0.0.1:{broker.port}/{{name}}"\nsinks = ["loads/{{name}}.csv"]\n{assets}'
    )
    env = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen([sys.executable, "-m", "loadid.cli", "serve", str(folder / "plan.toml")], env=env)
    waited(lambda: health(port).get("status") == "ok", "the server", 600)
    return process, port


def fleet(structures: int, seconds: int) -> None:
    """What a second of a fleet costs."""
    tracker, Y = fitted(100 * (seconds + 5))
    lines = text(tracker, Y)
    parts = [b"".join(lines[1 + 100 * k : 101 + 100 * k]) for k in range(seconds + 5)]
    names = [f"mast-{k}" for k in range(structures)]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tracker.save(folder / "model.h5")
        with Mosquitto(folder) as broker:
            begun = time.monotonic()
            server, _ = served(folder, broker, names, 0.2)
            ready = time.monotonic() - begun
            client, late = broker.client(), []
            start, marks = time.monotonic(), []
            for k, part in enumerate(parts):
                if k == 5:
                    marks.append(spent(server.pid))
                for j, own in enumerate(names):
                    client.publish(own, lines[0] * (k == 0) + part, qos=1)
                    due = start + k + (j + 1) / structures
                    if j % 20 == 19 and (ahead := due - time.monotonic()) > 0:
                        time.sleep(ahead)
                if k in (10, seconds):
                    size = (folder / "loads" / f"{names[-1]}.csv").stat().st_size
                    sent = time.monotonic()
                    waited(lambda: (folder / "loads" / f"{names[-1]}.csv").stat().st_size > size, "a row")  # noqa: B023
                    late.append(time.monotonic() - sent)
            cpu, wall = spent(server.pid) - marks[0], seconds
            memory, expected = resident(server.pid), 100 * len(parts) * structures
            tables = sorted((folder / "loads").glob("*.csv"))
            waited(lambda: sum(path.read_bytes().count(b"\n") - 1 for path in tables) >= expected, "the rows", 300)
            server.terminate()
            server.wait(120)
            client.loop_stop()
            rows = sum(path.read_bytes().count(b"\n") - 1 for path in (folder / "loads").glob("*.csv"))
    own = 1e6 * cpu / (100 * wall * structures)
    print(f"fleet of {structures} at 100 Hz: {cpu / wall:.0%} of a core, {own:.1f} us a row, {memory:.0f} MB, ready in "
          f"{ready:.0f} s; a row {1e3 * max(late):.0f} ms after its message; {rows} rows of {expected}")  # fmt: skip


def day(rows: int) -> None:
    """Growth of the memory over a day of one structure at 1 kHz, a message a second, some of them in trouble."""
    tracker, Y = fitted(600_000, 1e-3)  # played over and over: a jump every ten minutes
    cells = [line.partition(b",")[2] for line in text(tracker, Y)]
    head, body = b"time," + cells[0], cells[1:]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        tracker.save(folder / "model.h5")
        with Mosquitto(folder) as broker:
            server, port = served(folder, broker, ["mast"], 0.1)
            client, base, cpu, sent = broker.client(), 0.0, spent(server.pid), Counter[str]()
            waiting: list[bytes] = []
            for k in range(rows // 1000):
                part = body[1000 * (k % 600) : 1000 * (k % 600 + 1)]
                stamped = b"".join(b"%d.%03d,%s" % (k, i, row) for i, row in enumerate(part))
                kind = next((what for what, each in TROUBLE.items() if k % each == each - 1), "sound")
                sent[kind] += 1
                if kind == "late":
                    waiting.append(stamped)  # comes after the next
                elif kind != "lost":
                    for message in [stamped, *([stamped] if kind == "doubled" else []), *waiting]:
                        client.publish("mast", head * (k == 0) + message, qos=1)
                    waiting = []
                if k % (rows // 8000) == rows // 8000 - 1:
                    print(f"  {k + 1:,} s: {resident(server.pid):.1f} MB", flush=True)
                if k % 100 == 99:
                    waited(lambda k=k: metrics(port)["loadid_messages_total"] >= k - 200, "the server", 300)  # type: ignore[misc]
                if not base and k >= rows // 24_000:
                    base = resident(server.pid)
                time.sleep(1.0 if k % 20_000 == 19_999 else 0.0)
            come = rows // 1000 - sent["lost"] + sent["doubled"] - len(waiting)
            waited(lambda: metrics(port)["loadid_messages_total"] >= come, "the last message", 300)
            grown, cpu, found = resident(server.pid) - base, spent(server.pid) - cpu, metrics(port)
            server.terminate()
            server.wait(120)
            client.loop_stop()
    counts = {kind: found.get(f'loadid_events_total{{structure="mast",kind="{kind}"}}', 0.0)
              for kind in ("samples", "filled", "late", "jumps")}  # fmt: skip
    print(f"{rows:,} rows at 1 kHz: {1e6 * cpu / rows:.1f} us a row; growth after the first 24th {grown:.1f} MB; "
          f"messages sent {dict(sent)}; known again {found['loadid_messages_again_total']:.0f}; {counts}")  # fmt: skip


def metrics(port: int) -> dict[str, float]:
    """What a server tells Prometheus, by name and labels."""
    with urlopen(f"http://127.0.0.1:{port}/metrics", timeout=30) as answer:
        lines = [line for line in answer.read().decode().splitlines() if not line.startswith("#")]
    return {line.rpartition(" ")[0]: float(line.rpartition(" ")[2]) for line in lines}


def kills(count: int) -> None:
    """Killed while messages come."""
    with tempfile.TemporaryDirectory() as name:
        found = tortured(Path(name), count)
    lost = {name: found["sent"] - rows for name, rows in found["rows"].items()}
    print(f"{count} kills, {found['sent']} rows to each of two structures: lost or doubled {lost}; tables as "
          f"those of an undisturbed run: {found['same']}")  # fmt: skip


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fleet", type=int, default=500)
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--rows", type=int, default=3_600_000)
    parser.add_argument("--day", action="store_true")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--only", choices=("fleet", "day", "kills"))
    args = parser.parse_args()
    jobs: dict[str, Callable[[], None]] = {
        "fleet": lambda: fleet(args.fleet, args.seconds),
        "day": lambda: day(86_400_000 if args.day else args.rows),
        "kills": lambda: kills(args.kills),
    }
    for name, job in jobs.items():
        if args.only in (None, name):
            job()


if __name__ == "__main__":
    main()
