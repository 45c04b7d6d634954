"""The files of a training set: a head that says what was declared, and shards of draws, each whole or not there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures._channels import Channel
from structures.errors import InputError
from structures.files import _storage

from ._examples import Examples

VERSION = 1  # goes up when a seed no longer gives the numbers that it gave
HEAD, SHARDS = "set.h5", "shards"
KIND, SHARD_KIND = "training set", "training shard"
CHANNEL = ("noise", "highpass", "measure")


@dataclass(frozen=True, eq=False)
class SetHead:
    """What all shards of a set share.

    Parameters
    ----------
    fingerprint : str
        Of declaration, seed, version of the generator and models.
    draws, shard : int
        In the set, and in each shard but the last.
    seed : int
    sensors, loads : tuple of Channel
    kinds : tuple of str
        That may be drawn.
    dt : float, optional
        Step (s) of histories; None of static readings.
    samples : int, optional
    declaration : mapping
        As plain data.
    model : str
        Fingerprint of the model of the inverse; empty where it is not known.
    places : array (n, 2), optional
        Where what is read lies (m), for sensors that are found anew.
    """

    fingerprint: str
    draws: int
    shard: int
    seed: int
    sensors: tuple[Channel, ...]
    loads: tuple[Channel, ...]
    kinds: tuple[str, ...]
    dt: float | None = None
    samples: int | None = None
    declaration: Mapping[str, Any] = field(default_factory=dict)
    model: str = ""
    places: NDArray[np.float64] | None = None

    @property
    def shards(self) -> int:
        """How many there are."""
        return -(-self.draws // self.shard)

    def span(self, number: int) -> tuple[int, int]:
        """First draw of a shard, and the one behind its last."""
        return number * self.shard, min((number + 1) * self.shard, self.draws)


# -- the head ---------------------------------------------------------------------------------------------------------
def write_head(folder: Path, head: SetHead) -> None:
    """Put the head of a set into its folder."""
    tree = {
        "version": VERSION, "fingerprint": head.fingerprint, "draws": head.draws, "shard": head.shard,
        "seed": head.seed, "sensors": _columns(head.sensors), "loads": _columns(head.loads),
        "kinds": list(head.kinds), "dt": head.dt, "samples": head.samples, "declaration": dict(head.declaration),
        "model": head.model, "places": head.places,
    }  # fmt: skip
    _storage.write(folder / HEAD, tree, KIND)


def read_head(folder: Path) -> SetHead:
    """The head of a set.

    Raises
    ------
    InputError
        No set is there, its head is damaged, or another version of the generator wrote it.
    """
    path = folder / HEAD
    if not path.is_file():
        raise InputError("no training set is there", where=str(folder), found=f"no {HEAD}",
                         expected="a folder that loadid learn generate wrote")  # fmt: skip
    tree = _storage.read(path, KIND)
    if tree["version"] != VERSION:
        raise InputError("another version of the generator wrote this set", where=str(path),
                         found=f"version {tree['version']}", expected=f"version {VERSION}",
                         hint="generate it again")  # fmt: skip
    given: dict[str, Any] = {name: value for name, value in tree.items() if name != "version"}
    given |= {name: _channels(tree[name]) for name in ("sensors", "loads")}
    return SetHead(**{**given, "kinds": tuple(tree["kinds"])})


def _columns(channels: Sequence[Channel]) -> dict[str, Any]:
    texts = {name: [getattr(c, name) for c in channels] for name in ("label", "quantity", "unit")}
    values = {name: np.array([getattr(c, name) or np.nan for c in channels], float) for name in CHANNEL}
    return {**texts, **values}


def _channels(columns: Mapping[str, Any]) -> tuple[Channel, ...]:
    numbers = {name: [None if np.isnan(v) else float(v) for v in columns[name]] for name in CHANNEL}
    rows = zip(columns["label"], columns["quantity"], columns["unit"], *numbers.values(), strict=True)
    return tuple(
        Channel(label=label, quantity=quantity, unit=unit, noise=noise, highpass=highpass, measure=measure)
        for label, quantity, unit, noise, highpass, measure in rows
    )


# -- shards -----------------------------------------------------------------------------------------------------------
def shard_of(folder: Path, number: int) -> Path:
    """Where a shard lies."""
    return folder / SHARDS / f"{number:05d}.h5"


def write_shard(folder: Path, number: int, examples: Examples, fingerprint: str, seed: int) -> None:
    """Put a shard in its place: readings and loads to seven figures, in a file that is whole or not there."""
    path = shard_of(folder, number)
    path.parent.mkdir(parents=True, exist_ok=True)
    _storage.write(path, {
        "version": VERSION, "fingerprint": fingerprint, "seed": seed, "draws": examples.draws,
        "data": examples.data.astype(np.float32), "loads": examples.loads.astype(np.float32),
        "noise": examples.noise, "kinds": [str(k) for k in examples.kinds], "missing": examples.missing,
        "parameters": dict(examples.parameters),
    }, SHARD_KIND)  # fmt: skip


def read_shard(folder: Path, number: int, head: SetHead) -> Examples:
    """The draws of a shard.

    Raises
    ------
    InputError
        It is missing, damaged, or of another declaration, seed or version.
    """
    path = shard_of(folder, number)
    if not path.is_file():
        raise InputError("a shard of the training set is missing", where=str(path), found="no file",
                         expected=f"draws {head.span(number)[0]} to {head.span(number)[1] - 1}",
                         hint="generate into the same folder again: what is there stays")  # fmt: skip
    tree = _storage.read(path, SHARD_KIND)
    if tree["version"] != VERSION or tree["fingerprint"] != head.fingerprint:
        raise InputError("a shard of another training set", where=str(path),
                         found=f"version {tree['version']}, {tree['fingerprint'][:12]}",
                         expected=f"version {VERSION}, {head.fingerprint[:12]}",
                         hint="delete the shard, and generate into the same folder again")  # fmt: skip
    if not np.array_equal(tree["draws"], np.arange(*head.span(number))):
        raise InputError("a shard holds draws that are not its own", where=str(path),
                         found=f"{len(tree['draws'])} draws", expected=f"{head.span(number)}",
                         hint="delete the shard, and generate into the same folder again")  # fmt: skip
    given = {name: tree[name] for name in ("draws", "data", "loads", "noise", "missing", "parameters")}
    return Examples(**given, kinds=np.array(tree["kinds"], np.str_))
