"""Training sets made: every draw by its own seed, shard by shard, by the workers of this machine or of a cluster.

A draw is the same numbers whatever the size of a shard, the number of workers, or what was interrupted before.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures._threads import one_thread
from structures.errors import InputError, NotIdentifiable, digest, integer, whole
from structures.files._storage import as_path

from ._examples import Examples
from ._shards import VERSION, SetHead, read_head, read_shard, shard_of, write_head, write_shard
from ._trainingset import TrainingSet

Array = NDArray[np.float64]
SHARD = 100  # draws
REJECTED = 50  # draws in a row that have no answer
RETRIES = 3
KEPT = 4  # makers that a worker keeps


@dataclass(frozen=True, eq=False)
class Drawn:
    """One draw.

    Parameters
    ----------
    data : array ([samples,] sensors)
        NaN where a reading is lost.
    loads : array ([samples,] loads)
    kind : str
    noise : array (sensors,)
    parameters : mapping of text to float
    """

    data: Array
    loads: Array
    kind: str
    noise: Array
    parameters: Mapping[str, float] = field(default_factory=dict)


class DrawMaker(Protocol):
    """What draws: an object that can be pickled, whose draws depend on the numbers it is given alone.

    One that has `inverse`, the fingerprint of the model of the inverse, makes sets that no map of another model learns
    from; one that has `markers_at` (n, 2), the places of markers in m, sets for sensors that find these anew.
    """

    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What is read."""

    @property
    def loads(self) -> tuple[Channel, ...]:
        """What acts."""

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds that may be drawn."""

    @property
    def dt(self) -> float | None:
        """Step of histories (s)."""

    @property
    def samples(self) -> int | None:
        """Length of histories."""

    @property
    def declaration(self) -> Mapping[str, Any]:
        """What was declared, as plain data."""

    @property
    def models(self) -> tuple[str, ...]:
        """Fingerprints of the models."""

    def draw(self, rng: np.random.Generator) -> Drawn:
        """One draw; `NotIdentifiable` where what was drawn has no answer."""


def generate(
    maker: DrawMaker,
    folder: str | os.PathLike[str],
    *,
    draws: int,
    seed: int,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[float, str], None] | None = None,
) -> TrainingSet:
    """Make a set, or what is missing of it.

    Parameters
    ----------
    maker : DrawMaker
    folder : path
    draws, seed : int
    workers : int, optional
        Processes of this machine, each with one thread; all cores where nothing is said, 1 is this process.
    scheduler : str, optional
        Address of a dask scheduler instead, whose workers see the folder.
    progress : callable, optional
        Called as ``progress(fraction, text)``.

    Raises
    ------
    InputError
        The folder holds another set or a damaged shard; next to no draw has an answer.
    """
    head = head_of(maker, draws, seed)
    path = as_path(folder)
    todo = _claimed(path, head)
    tell = progress or (lambda fraction, text: None)
    given = {k: (maker, str(path), head, k) for k in todo}
    size = 1 if scheduler else integer("workers", workers or os.cpu_count() or 1, where="generate", limit=4096)
    if scheduler is None and (size == 1 or len(todo) < 2):
        for done, k in enumerate(todo):
            tell(done / len(todo), f"shard {k + 1} of {head.shards}")
            make_shard(*given[k])
    elif todo:
        _shared(given, min(size, len(todo)), scheduler, tell)
    tell(1.0, f"{head.draws} draws")
    return TrainingSet.open(path)


def head_of(maker: DrawMaker, draws: int, seed: int) -> SetHead:
    """The head of the set that a maker would make."""
    number = whole(seed)
    if number is None or not 0 <= number < 2**63:
        raise InputError("no seed", where="seed", found=repr(seed), expected="an integer, at least 0")
    told = dict(maker.declaration)
    mark = digest("training set", VERSION, number, repr(_plain(told)), *maker.models)
    return SetHead(
        mark, integer("draws", draws, where="draws", limit=10**9), SHARD, number, maker.sensors, maker.loads,
        maker.kinds, maker.dt, maker.samples, told, str(getattr(maker, "inverse", "")),
        getattr(maker, "markers_at", None),
    )  # fmt: skip


def make_shard(maker: DrawMaker, folder: str, head: SetHead, number: int) -> int:
    """Draw a shard and write it; what a worker does."""
    kept = _kept(maker, head.fingerprint)
    with one_thread():
        drawn = [drawn_as(kept, head.seed, k) for k in range(*head.span(number))]
    write_shard(Path(folder), number, _together(drawn, head.span(number)[0]), head.fingerprint, head.seed)
    return number


def drawn_as(maker: DrawMaker, seed: int, number: int) -> Drawn:
    """The draw of a number: by its own seed, drawn anew where it has no answer.

    Raises
    ------
    InputError
        Next to none has one.
    """
    for attempt in range(REJECTED):
        try:
            found = maker.draw(numbers_of(seed, number, attempt))
        except NotIdentifiable as error:
            said = str(error)
            continue
        again = {"redrawn": float(attempt)}
        return Drawn(found.data, found.loads, found.kind, found.noise, {**found.parameters, **again})
    raise InputError("what is declared has hardly ever an answer", where=f"draw {number}",
                     found=f"{REJECTED} times in a row: {said}", expected="ranges of loads that a model answers",
                     hint="narrow the ranges of the declaration")  # fmt: skip


def numbers_of(seed: int, number: int, attempt: int) -> np.random.Generator:
    """The random numbers of an attempt at a draw."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number, attempt)))


# -- files ------------------------------------------------------------------------------------------------------------
def _claimed(folder: Path, head: SetHead) -> list[int]:
    """Shards that are missing in the folder of a set, which is made where it is not there."""
    try:
        (folder / "shards").mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError("the folder cannot be made", where=str(folder), found=error.strerror or error,
                         expected="a folder that may be written") from None  # fmt: skip
    if not (folder / "set.h5").exists():
        write_head(folder, head)
    there = read_head(folder)
    if (there.fingerprint, there.draws, there.shard) != (head.fingerprint, head.draws, head.shard):
        raise InputError("the folder holds another training set", where=str(folder),
                         found=f"{there.draws} draws of {there.fingerprint[:12]}, seed {there.seed}",
                         expected=f"{head.draws} draws of {head.fingerprint[:12]}, seed {head.seed}",
                         hint="name another folder, or go on with the declaration and seed of this one")  # fmt: skip
    todo = []
    for number in range(head.shards):
        if shard_of(folder, number).exists():
            read_shard(folder, number, there)
        else:
            todo.append(number)
    return todo


def _together(drawn: list[Drawn], first: int) -> Examples:
    data = np.array([one.data for one in drawn])
    missing = np.isnan(data)
    names = drawn[0].parameters
    return Examples(
        np.arange(first, first + len(drawn)), np.where(missing, 0.0, data), np.array([one.loads for one in drawn]),
        np.array([one.noise for one in drawn]), np.array([one.kind for one in drawn]),
        missing if missing.any() else None,
        {name: np.array([one.parameters[name] for one in drawn]) for name in names},
    )  # fmt: skip


def _plain(value: Any) -> Any:
    """Plain data in one order, for a digest."""
    if isinstance(value, Mapping):
        return tuple((k, _plain(value[k])) for k in sorted(value))
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


# -- workers ----------------------------------------------------------------------------------------------------------
_MAKERS: dict[str, DrawMaker] = {}
_KEEPING = threading.Lock()


def _kept(maker: DrawMaker, key: str) -> DrawMaker:
    """The maker that this process has of a set: what it has computed serves all its shards."""
    with _KEEPING:
        if key not in _MAKERS:
            while len(_MAKERS) >= KEPT:
                del _MAKERS[next(iter(_MAKERS))]
            _MAKERS[key] = maker
        return _MAKERS[key]


def _shared(
    given: Mapping[int, tuple[Any, ...]], size: int, scheduler: str | None, tell: Callable[[float, str], None]
) -> None:
    """All shards by a crew; one whose worker was lost is given to another."""
    from .._batch.run import Cluster, Crew, Processes

    crew: Crew = Cluster(scheduler, make_shard) if scheduler else Processes(size, task=make_shard)
    todo, tries = deque(given), dict.fromkeys(given, 0)
    busy: dict[Future[Any], int] = {}
    try:
        while busy or todo:
            while todo and len(busy) < crew.room:
                number = todo.popleft()
                busy[crew.submit(*given[number])] = number
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                number = busy.pop(future)
                if not crew.lost(future):
                    future.result()
                    continue
                tries[number] += 1
                if tries[number] > RETRIES:
                    raise InputError("the workers that draw a shard are lost", where=f"shard {number}",
                                     found=f"{tries[number]} times", expected="workers that live",
                                     hint="fewer workers, or more memory; what was made is kept")  # fmt: skip
                todo.appendleft(number)
            tell(1 - (len(todo) + len(busy)) / len(given), f"{len(given) - len(todo) - len(busy)} shards")
    finally:
        crew.close()
