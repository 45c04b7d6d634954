"""A training set: draws of loads and of what sensors read of them, opened lazily, split by draws."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel, named
from structures.errors import InputError, digest, integer, number, positive
from structures.files._storage import as_path

from ._examples import Examples, joined
from ._shards import SetHead, read_head, read_shard

Index = NDArray[np.int64]


class Shards:
    """Shards of a folder, the last one kept in memory.

    Parameters
    ----------
    folder : str
    head : SetHead
    """

    def __init__(self, folder: str, head: SetHead) -> None:
        self.folder, self.head = folder, head
        self._last: tuple[int, Examples] | None = None  # one value, for threads

    def __getstate__(self) -> dict[str, Any]:
        return {"folder": self.folder, "head": self.head, "_last": None}

    def read(self, draws: Index) -> Examples:
        """Draws of some numbers."""
        place = draws // self.head.shard
        parts, order = [], []
        for shard in np.unique(place):
            rows = np.flatnonzero(place == shard)
            parts.append(self._shard(int(shard))[draws[rows] - self.head.span(int(shard))[0]])
            order.append(rows)
        found = joined(parts)
        at = np.concatenate(order)
        return found if np.all(np.diff(at) > 0) else found[np.argsort(at)]

    def _shard(self, shard: int) -> Examples:
        last = self._last
        if last is None or last[0] != shard:
            last = self._last = shard, read_shard(as_path(self.folder), shard, self.head)
        return last[1]


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """Draws of a generator, or measured pairs: loads and what sensors read of them.

    Made by `loadid.generate.histories`, `tactile.generate.presses`, `open` or `of`.

    Parameters
    ----------
    head : SetHead
        What is shared by all draws.
    source : Shards or Examples
        Where they lie.
    draws : array (n,) of int
        Numbers of those that belong to this set, which may be a part of all that lie there.
    """

    head: SetHead = field(repr=False)
    source: Shards | Examples = field(repr=False)
    draws: Index

    @classmethod
    def open(cls, folder: str | os.PathLike[str]) -> TrainingSet:
        """The set in a folder; its shards are read when they are asked for.

        Raises
        ------
        InputError
            No set is there, or its head is damaged or of another version of the generator.
        """
        path = as_path(folder)
        head = read_head(path)
        return cls(head, Shards(str(path), head), np.arange(head.draws))

    @classmethod
    def of(
        cls,
        *examples: Examples,
        sensors: Sequence[Channel | str] | None = None,
        loads: Sequence[Channel | str] | None = None,
        dt: float | None = None,
    ) -> TrainingSet:
        """A set in memory, of examples one after another; draws are numbered anew.

        Parameters
        ----------
        *examples : Examples
        sensors, loads : sequence of Channel or str, optional
            What the columns are.
        dt : float, optional
            Step (s) of histories.

        Raises
        ------
        InputError
            No examples, shapes that differ, histories without a step.
        """
        one = joined(examples)
        history = one.data.ndim == 3
        if history != (dt is not None):
            raise InputError("histories have a step, and static readings none", where="TrainingSet.of, dt",
                             found=f"dt = {dt} of data {one.data.shape}",
                             expected="dt= in s" if history else "no dt")  # fmt: skip
        n = len(one)
        source = Examples(
            np.arange(n), one.data, one.loads, one.noise, one.kinds, one.missing, one.parameters
        )  # fmt: skip
        head = SetHead(
            digest("measured", one.data, one.loads, one.noise), n, max(n, 1), 0,
            named(sensors, one.data.shape[-1], "y", "TrainingSet.of, sensors"),
            named(loads, one.loads.shape[-1], "g", "TrainingSet.of, loads"), tuple(sorted({str(k) for k in one.kinds})),
            None if dt is None else positive("dt", dt, where="TrainingSet.of", unit="s"),
            one.data.shape[1] if history else None,
        )  # fmt: skip
        return cls(head, source, np.arange(n))

    def __len__(self) -> int:
        return len(self.draws)

    def __repr__(self) -> str:
        return f"<TrainingSet: {len(self)} draws, {len(self.sensors)} sensors, {len(self.loads)} loads>"

    # -- what it is ---------------------------------------------------------------------------------------------------
    @property
    def sensors(self) -> tuple[Channel, ...]:
        """What the columns of the data are."""
        return self.head.sensors

    @property
    def loads(self) -> tuple[Channel, ...]:
        """What the columns of the loads are."""
        return self.head.loads

    @property
    def dt(self) -> float | None:
        """Step of histories (s); None of static readings."""
        return self.head.dt

    @property
    def samples(self) -> int | None:
        """Length of histories; None of static readings."""
        return self.head.samples

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of load that may be drawn."""
        return self.head.kinds

    @property
    def fingerprint(self) -> str:
        """Hash of declaration, seed, version of the generator and models; of the numbers, where they were measured."""
        return self.head.fingerprint

    @property
    def model(self) -> str:
        """Fingerprint of the model of the inverse that it was drawn for; empty where it is not known."""
        return self.head.model

    @property
    def places(self) -> NDArray[np.float64] | None:
        """Where what is read lies (n, 2) in m, for sensors that are found anew; None where it is not told."""
        return self.head.places

    @property
    def declaration(self) -> Mapping[str, Any]:
        """What was declared, as plain data."""
        return self.head.declaration

    # -- doing --------------------------------------------------------------------------------------------------------
    def read(self, draws: slice | Sequence[int] | NDArray[Any] | None = None) -> Examples:
        """Some of the draws, by their places in this set; all of them where nothing is said.

        Raises
        ------
        InputError
            Places outside the set, or a shard that is missing, damaged or of another set.
        """
        try:
            numbers = self.draws if draws is None else np.atleast_1d(self.draws[draws])
        except (IndexError, TypeError, ValueError):
            raise InputError("there are no such draws", where="TrainingSet.read", found=repr(draws)[:60],
                             expected=f"places from 0 to {len(self) - 1}, or a slice") from None  # fmt: skip
        if not len(numbers):
            raise InputError("no draws are asked for", where="TrainingSet.read", found="none",
                             expected=f"some of {len(self)}")  # fmt: skip
        return self.source.read(numbers) if isinstance(self.source, Shards) else self.source[numbers]

    def batches(self, size: int) -> Iterator[Examples]:
        """All draws in their order, so many at a time."""
        step = integer("draws", size, where="batches", limit=10**9)
        for start in range(0, len(self), step):
            yield self.read(slice(start, start + step))

    def split(self, fractions: Sequence[float], seed: int = 0) -> tuple[TrainingSet, ...]:
        """Parts that share no draw, drawn at random and in the order of the set.

        Parameters
        ----------
        fractions : sequence of float
            Share of each part; together at most 1.
        seed : int

        Raises
        ------
        InputError
            Shares that are not positive or more than 1 together, or a part without a draw.
        """
        shares = [positive("a share", number("a share", f, where="split"), where="split") for f in fractions]
        ends = np.concatenate([[0.0], np.cumsum(shares)])
        if not shares or ends[-1] > 1 + 1e-9:
            raise InputError("no shares of a set", where="split", found=str(list(fractions)),
                             expected="numbers > 0, at most 1 together")  # fmt: skip
        cuts = np.round(ends * len(self)).astype(int)
        if np.any(np.diff(cuts) < 1):
            raise InputError("a part of the set would be empty", where="split", found=f"{len(self)} draws",
                             expected="a draw for each part at least")  # fmt: skip
        order = np.random.default_rng(seed).permutation(len(self))
        return tuple(TrainingSet(self.head, self.source, self.draws[np.sort(order[a:b])]) for a, b in pairwise(cuts))
