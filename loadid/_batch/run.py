"""Chunks given to workers until every part is there: processes of this machine, or the cluster of a scheduler.

A worker that is lost takes nothing with it but the chunk it was working on, which another one repeats. Each local
worker is a pool of one process, as a pool that loses one of several gives up the chunks of all.
"""

from __future__ import annotations

import datetime as dt
import json
import logging
import multiprocessing
import os
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from structures.errors import InputError

from .plan import Plan
from .records import Chunk, Manifest, part_of, pieces_of
from .work import Done, scratch_of, work

log = logging.getLogger(__name__)

UNBORN = 8  # workers in a row that are lost before they begin
WATCH = 1.0  # s between two looks of a worker at whether its parent is there
ONE = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")  # of a worker


# -- who works --------------------------------------------------------------------------------------------------------
class Crew(Protocol):
    """Who takes chunks."""

    @property
    def size(self) -> int:
        """How many work at a time."""

    @property
    def room(self) -> int:
        """How many chunks may be given out at a time."""

    def submit(self, *given: Any) -> Future[Any]:
        """Give a chunk, and what belongs to it, to somebody who is free."""

    def lost(self, future: Future[Any]) -> bool:
        """Whether the worker of a chunk was lost; it is free again."""

    def close(self) -> None:
        """Send all home."""


class Processes:
    """Processes of this machine.

    Parameters
    ----------
    size : int
    memory : float, optional
        Bytes that one may take beside what it takes at its start.
    task : callable
        A function of a module: what is done with a chunk and what belongs to it.
    """

    def __init__(self, size: int, memory: float | None = None, task: Callable[..., Any] = work) -> None:
        self.size, self.room, self.memory, self.task = size, size, memory, task
        self._pools: dict[int, ProcessPoolExecutor] = {}
        self._at: dict[Future[Any], int] = {}
        self._who: dict[int, Future[int]] = {}
        self._unborn = 0

    def submit(self, *given: Any) -> Future[Any]:
        """Give a chunk to a process that is free."""
        place = next(k for k in range(self.size) if k not in self._at.values())
        if place not in self._pools:
            self._start(place)
        try:
            future = self._pools[place].submit(self.task, *given)
        except BrokenProcessPool:  # lost while it had nothing to do
            self._start(place)
            future = self._pools[place].submit(self.task, *given)
        self._at[future] = place
        return future

    def lost(self, future: Future[Any]) -> bool:
        """Whether the process of a chunk is gone.

        Raises
        ------
        InputError
            No process starts at all.
        """
        place = self._at.pop(future)
        if not isinstance(future.exception(), BrokenProcessPool):
            return False
        self._pools.pop(place).shutdown(wait=False)
        who = self._who.pop(place)
        self._unborn = self._unborn + 1 if who.exception() is not None else 0
        if self._unborn > UNBORN:
            raise InputError("the processes of this machine end before they begin", where="[run], workers",
                             found=f"{self._unborn} in a row", expected="processes that start",
                             hint="more memory, or a larger run.memory; what was done is kept: --resume")  # fmt: skip
        return True

    def close(self) -> None:
        """End all processes; what they work on is dropped."""
        working = set(self._at.values())
        for place, pool in self._pools.items():
            pool.shutdown(wait=False, cancel_futures=True)
            who = self._who[place]
            if place in working and who.done() and who.exception() is None:
                with suppress(OSError):
                    os.kill(who.result(), signal.SIGTERM)

    def _start(self, place: int) -> None:
        before = {name: os.environ.get(name) for name in ONE}
        os.environ.update({name: "1" for name, value in before.items() if value is None})  # read when numpy is loaded
        pool = ProcessPoolExecutor(
            1, multiprocessing.get_context("spawn"), initializer=begin, initargs=(self.memory, os.getpid())
        )
        self._pools[place], self._who[place] = pool, pool.submit(os.getpid)  # starts with the first thing it is given
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)


def begin(memory: float | None, parent: int) -> None:
    """Make a new process a worker: it ends with its parent, and takes no more memory than it may."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(WATCH)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
    if memory is None:
        return
    try:
        import resource

        from . import joined  # noqa: F401  # what every chunk loads is not counted

        taken = int(Path("/proc/self/statm").read_text("ascii").split()[5]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_DATA, (taken + int(memory),) * 2)
    except (ImportError, OSError, ValueError, IndexError):
        log.warning("this system knows no limit of memory: run.memory has no effect")


class Cluster:
    """Workers of a dask scheduler, which moves chunks of lost ones by itself.

    Parameters
    ----------
    address : str
        As ``tcp://host:8786``.
    task : callable
        As of `Processes`; the workers have its module.

    Raises
    ------
    InputError
        dask.distributed is not installed, or nobody answers.
    """

    def __init__(self, address: str, task: Callable[..., Any] = work) -> None:
        try:
            from distributed import Client, KilledWorker
        except ImportError:
            raise InputError("a scheduler is reached by a package that is not installed", where="--scheduler",
                             found="no dask.distributed", expected="dask.distributed",
                             hint="pip install 'loadid[cluster]', or leave --scheduler out") from None  # fmt: skip
        try:
            self._client = Client(address, timeout="20s")
        except (OSError, ValueError, TimeoutError) as error:
            raise InputError("the scheduler does not answer", where="--scheduler", found=f"{address}: {error}"[:200],
                             expected="the address of a dask scheduler, as tcp://host:8786") from None  # fmt: skip
        self._killed, self.task = KilledWorker, task
        self._executor: Executor = self._client.get_executor(pure=False, retries=0)
        self._out = 0

    @property
    def size(self) -> int:
        """Threads of all workers now."""
        return max(sum(self._client.nthreads().values()), 1)

    @property
    def room(self) -> int:
        """Chunks that are given out at a time: one for each thread, and one that waits for it."""
        return 2 * self.size

    def submit(self, *given: Any) -> Future[Any]:
        """Give a chunk to the scheduler."""
        return self._executor.submit(self.task, *given)

    def lost(self, future: Future[Any]) -> bool:
        """Whether so many workers died of a chunk that the scheduler gave it up."""
        return isinstance(future.exception(), self._killed)

    def close(self) -> None:
        """Leave the scheduler; its workers stay."""
        self._executor.shutdown(wait=False)
        self._client.close()


# -- the ledger -------------------------------------------------------------------------------------------------------
class Ledger:
    """What happened, a line of JSON for each chunk, only ever added to; one run at a time holds it.

    Parameters
    ----------
    path : Path

    Raises
    ------
    InputError
        Another run holds it.
    """

    def __init__(self, path: Path) -> None:
        from .._stream.output import taken

        path.parent.mkdir(parents=True, exist_ok=True)
        self._file: BinaryIO = path.open("ab")
        if not taken(self._file):
            self._file.close()
            raise InputError("another run writes into this folder", where=str(path), expected="one run at a time",
                             hint="end it first, or name another output")  # fmt: skip
        if path.stat().st_size and path.read_bytes()[-1:] != b"\n":  # a line that a kill cut off
            self._file.write(b"\n")

    def add(self, chunk: Chunk, event: str, **more: Any) -> None:
        """One line."""
        line = {"at": dt.datetime.now(dt.UTC).isoformat(timespec="milliseconds"), "event": event, "key": chunk.key,
                "record": chunk.record, **({"span": chunk.span} if chunk.parent else {}), **more}  # fmt: skip
        self._file.write(json.dumps(line).encode() + b"\n")
        self._file.flush()

    def close(self) -> None:
        """Let go of it."""
        self._file.close()


# -- the run ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Failed:
    """A chunk that has no part, and why."""

    chunk: Chunk
    said: str


@dataclass
class Run:
    """A plan on its way.

    Parameters
    ----------
    plan : Plan
    manifest : Manifest
    crew : Crew
    ledger : Ledger
    progress : callable
        Called as ``progress(fraction, text)``.
    """

    plan: Plan
    manifest: Manifest
    crew: Crew
    ledger: Ledger
    progress: Callable[[float, str], None] = lambda fraction, text: None
    failed: list[Failed] = field(default_factory=list)
    times: list[tuple[Chunk, float]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._there = parts_there(self.plan.output)
        self._todo: deque[Chunk] = deque()
        self._busy: dict[Future[Done], Chunk] = {}
        self._tries: dict[str, int] = {}
        self._seen: set[str] = set()
        self._rated = False  # whether a worker has done its second chunk
        self._open: dict[str, int] = {}  # key of a long record -> pieces that are not there yet
        self.total = sum(entry.chunk.size for entry in self.manifest.entries)
        self.ready = 0
        for entry in self.manifest.entries:
            self._take(entry.chunk)

    @property
    def left(self) -> int:
        """Bytes whose chunks are not done."""
        return self.total - self.ready

    @property
    def waiting(self) -> int:
        """Chunks that are known and not given out."""
        return len(self._todo)

    def go(self, most: int | None = None, known: Callable[[], None] | None = None) -> None:
        """Work until every part is there, or until so many chunks more are done.

        Parameters
        ----------
        known : callable, optional
            Called once, as soon as a worker that has loaded and compiled tells what the rest will cost; nobody waits.
        """
        given = 0
        while self._busy or (self._todo and (most is None or given < most)):
            while self._todo and len(self._busy) < self.crew.room and (most is None or given < most):
                chunk = self._todo.popleft()
                self._busy[self.crew.submit(chunk, self.manifest.orders[chunk.asset])] = chunk
                given += 1
            for future in wait(self._busy, return_when=FIRST_COMPLETED).done:
                self._ended(self._busy.pop(future), future)
            if known is not None and self._rated:
                known()
                known = None
            self.progress(self.ready / max(self.total, 1), f"{self.ready / 1e6:.0f} of {self.total / 1e6:.0f} MB")

    def _take(self, chunk: Chunk, first: bool = False) -> None:
        """A chunk is known: its part is there, or it waits."""
        if chunk.key not in self._there:
            (self._todo.appendleft if first else self._todo.append)(chunk)
            return
        if chunk.parent:
            self._one_less(chunk)
            self.ready += chunk.size
            return
        with part_of(str(self.plan.output), chunk.key).open("rb") as file:
            settled = file.read(1 << 16).find(b'"kind": "settled"') >= 0
        self._done(chunk, self._pieces(chunk) if settled else ())

    def _pieces(self, chunk: Chunk) -> tuple[tuple[str, int, int], ...]:
        return pieces_of(chunk, json.loads(part_of(str(self.plan.output), chunk.key).read_bytes()))

    def _done(self, chunk: Chunk, pieces: tuple[tuple[str, int, int], ...]) -> None:
        if not pieces:
            self.ready += chunk.size
            if chunk.parent:
                self._one_less(chunk)
            return
        self._open[chunk.key] = len(pieces)
        sizes = [chunk.size * (k + 1) // len(pieces) - chunk.size * k // len(pieces) for k in range(len(pieces))]
        for (key, a, b), size in zip(reversed(pieces), reversed(sizes), strict=True):
            self._take(Chunk(key, chunk.record, size, chunk.asset, chunk.key, (a, b)), first=True)

    def _one_less(self, chunk: Chunk) -> None:
        self._open[chunk.parent] -= 1
        if not self._open[chunk.parent]:
            scratch_of(str(self.plan.output), chunk.parent).unlink(missing_ok=True)

    def _ended(self, chunk: Chunk, future: Future[Done]) -> None:
        tries = self._tries[chunk.key] = self._tries.get(chunk.key, 0) + 1
        if self.crew.lost(future):
            self.ledger.add(chunk, "lost", attempt=tries)
            if tries <= self.plan.run.retries:
                self._todo.appendleft(chunk)
            else:
                self._fail(chunk, f"its worker was lost {tries} times: a crash, or more memory than there is")
            return
        error = future.exception()
        if isinstance(error, MemoryError):
            self._fail(chunk, "more memory is needed than a worker may take: a smaller run.piece, or more run.memory")
        elif error is not None:
            self._fail(chunk, f"{type(error).__name__}: {error}"[:500])
        else:
            done = future.result()
            self.ledger.add(chunk, "done", attempt=tries, seconds=round(done.seconds, 4), worker=done.worker)
            self.times.append((chunk, done.seconds))
            self._rated |= done.worker in self._seen
            self._seen.add(done.worker)
            self._done(chunk, done.pieces)

    def _fail(self, chunk: Chunk, said: str) -> None:
        self.ledger.add(chunk, "failed", said=said)
        self.failed.append(Failed(chunk, said))
        self.ready += chunk.size
        if chunk.parent:
            self._one_less(chunk)

    def close(self) -> None:
        """Send the crew home."""
        self.crew.close()
        self.ledger.close()


def parts_there(output: Path) -> set[str]:
    """Keys of all parts of a folder."""
    return {Path(name).stem for name in _names(output / "parts")}


def _names(folder: Path) -> Iterator[str]:
    with suppress(FileNotFoundError), os.scandir(folder) as shelves:
        for shelf in shelves:
            if shelf.is_dir():
                yield from (name for name in os.listdir(shelf.path) if name.endswith(".json") and name[0] != ".")


def seconds_left(run: Run) -> float:
    """How long what is left would take, by the last chunk of each kind that was done: seconds a byte of its record."""
    latest: dict[bool, tuple[float, int]] = {}
    for chunk, seconds in run.times:
        latest[bool(chunk.parent)] = (seconds, chunk.size)
    return sum(seconds / max(size, 1) for seconds, size in latest.values()) * run.left / run.crew.size
