"""A stream that is killed again and again: a nursery that forks `loadid track`, and the log that it is fed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from loadid import LoadTracker
from loadid._families.tracking.tracker import Tracker
from loadid._spellings import folded
from loadid.priors import Matern32

from .tracked import bm2

ROOT = Path(__file__).resolve().parent.parent


def fitted(samples: int = 1500, **settings: object) -> tuple[Tracker, np.ndarray]:
    """Tracker of the ten-storey building with a given prior, and its record."""
    case = bm2("matern", 0, samples=samples)
    tracker = LoadTracker(
        case.setup.space("foh"), prior=Matern32(100.0, 0.1), noise=case.noise, **folded(LoadTracker, settings)
    )  # type: ignore[arg-type]
    return tracker.fit(case.y, case.dt), case.y


def text(tracker: Tracker, Y: np.ndarray, *, stamps: bool = True, header: bool = True) -> list[bytes]:
    """Lines of a record."""
    names = [f"{c.label} [{c.unit}]" for c in tracker.fitted.sensors]
    lines = [",".join(["time", *names] if stamps else names)] if header else []
    for k, row in enumerate(Y.tolist()):
        cells = [f"{k * tracker.fitted.dt:.6f}"] * stamps + ["" if v != v else repr(v) for v in row]
        lines.append(",".join(cells))
    return [f"{line}\n".encode() for line in lines]


def troubled(tracker: Tracker, Y: np.ndarray, seed: int = 0) -> bytes:
    """A log with everything that happens to logs."""
    rng = np.random.default_rng(seed)
    Y = Y.copy()
    n = len(Y)
    Y[rng.integers(1, n, n // 50), rng.integers(0, Y.shape[1], n // 50)] = np.nan
    Y[n // 3 : n // 3 + 40, -1] = np.nan
    Y[n // 2, 0] += 1e3
    lines = text(tracker, Y)
    for k in sorted(rng.choice(np.arange(60, n - 60), n // 60, replace=False), reverse=True):
        kind = int(rng.integers(7))
        if kind == 0:
            del lines[k : k + int(rng.integers(1, 20))]
        elif kind == 1:
            lines.insert(k, lines[k - 1])
        elif kind == 2:
            lines.insert(k, lines[k - 5])
        elif kind == 6:
            lines.insert(k + 4, lines.pop(k))  # comes late
        else:
            lines.insert(k, [b"1,2\n", b"# a word\n", b"x,y,z,u,v\n"][kind - 3])
    a, b, c = n // 2, 2 * n // 3, 5 * n // 6
    return b"".join([*lines[:a], lines[0], *lines[a:b], *turned(lines[0], *lines[b:c]), lines[0], *lines[c:]])


def turned(*lines: bytes) -> list[bytes]:
    """Lines of a logger that was started again, with its columns in the other order."""
    return [b",".join(reversed(line.strip().split(b","))) + b"\n" for line in lines]


def leaves(tree: Any) -> Iterator[Any]:
    """Names and values of a tree, arrays by their bytes."""
    if isinstance(tree, dict | list | tuple):
        for name, inner in tree.items() if isinstance(tree, dict) else enumerate(tree):
            yield name
            yield from leaves(inner)
    else:
        yield tree.tobytes() if isinstance(tree, np.ndarray) else tree


class Nursery:
    """A process that has imported everything and forks one run at a time, so that a start costs little.

    It compiles nothing: what its runs write is compared with what compiled loops write.
    """

    def __init__(self, *modules: str) -> None:
        self.process_id = 0  # of the last run
        self.process = subprocess.Popen([sys.executable, "-m", "tests.killed", *modules], stdin=subprocess.PIPE,
                                        stdout=subprocess.PIPE, cwd=ROOT, text=True)  # fmt: skip
        assert self._line() == "ready"

    def run(self, *argv: str) -> int:
        """Start `loadid` with these words; its process id."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(argv) + "\n")
        self.process.stdin.flush()
        self.process_id = int(self._line())
        return self.process_id

    def ended(self) -> int:
        """Wait for the run; its exit code, or minus the signal that killed it."""
        return int(self._line())

    def close(self) -> None:
        """End the nursery."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self.process.stdin.close()
        self.process.wait(30)
        self.process.stdout.close()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()


def tortured(nursery: Nursery, folder: Path, data: bytes, kills: int, seed: int = 0) -> tuple[int, int]:
    """Feed a log to a run that is killed; the kills that met a checkpoint, and those that lost lines of the output."""
    rng = np.random.default_rng(seed)
    log, out, state = (folder / name for name in ("log.csv", "out.csv", "state.h5"))
    log.write_bytes(b"")
    argv = ["track", "--model", str(folder / "model.h5"), "--state", str(state), "--in", str(log), "--out", str(out)]
    argv += ["--every", "20"]
    pieces = np.array_split(np.frombuffer(data, np.uint8), 6 * kills)  # anywhere: most end within a line
    resumed = cut = 0
    with log.open("ab", buffering=0) as file:
        for k in range(kills):
            before = _written(state)
            pid = nursery.run(*argv)
            for i, piece in enumerate(pieces[6 * k : 6 * k + 6]):
                file.write(piece.tobytes())
                until = time.monotonic() + (5.0 if i == 2 and k % 4 else 0.0)  # every fourth before it has settled
                while _written(state) == before and time.monotonic() < until:
                    time.sleep(0.001)
                time.sleep(float(rng.uniform(0, 0.012)))
            os.kill(pid, signal.SIGKILL)
            assert nursery.ended() == -signal.SIGKILL
            resumed += state.exists()
            cut += out.stat().st_size > seen(state) if state.exists() else 0
    nursery.run(*argv, "--idle", "0")
    assert nursery.ended() == 0
    return resumed, cut


def _written(path: Path) -> int:
    return path.stat().st_mtime_ns if path.exists() else 0


def seen(state: Path) -> int:
    """Length of the output that a checkpoint saw."""
    from loadid._families.tracking import tracker as checkpoint

    stream = checkpoint.read(state)[1]
    assert stream is not None
    return int(stream["output"]["at"])


def _nurse() -> None:
    import h5py  # noqa: F401  (what a run would import)

    import loadid._stream  # noqa: F401
    from loadid import cli
    from loadid._commands import track  # noqa: F401

    for module in sys.argv[1:]:
        import_module(module)
    print("ready", flush=True)
    for line in sys.stdin:
        pid = os.fork()
        if pid == 0:
            sys.stdout = open(os.devnull, "w")  # noqa: SIM115  (the pipe is the nursery's)
            os._exit(cli.main(json.loads(line)))
        print(pid, flush=True)
        print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), flush=True)


if __name__ == "__main__":
    _nurse()
