"""The manifest: every record of a plan with the digest of its bytes, and how one of them is read."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from structures.errors import InputError

from .. import __version__
from .._folders import listed, spans
from .plan import Asset, Plan

if TYPE_CHECKING:
    from .._record import Record

PIECE = 1 << 20
PARTS = 1  # goes up when parts of an earlier release can no longer be read


@dataclass(frozen=True, slots=True)
class Chunk:
    """Work that is done as a whole or not at all.

    Parameters
    ----------
    key : str
        Digest of what it depends on, and the name of its part.
    record : str
        Path of its record: a file, or a folder of files that make one.
    size : int
        Bytes of the record that it stands for.
    asset : int
        Place in the plan.
    parent : str
        Key of the record, of a piece of a long one; "" of a record.
    span : (int, int)
        Samples of the piece.
    """

    key: str
    record: str
    size: int
    asset: int
    parent: str = ""
    span: tuple[int, int] = (0, 0)


@dataclass(frozen=True)
class Order:
    """What all chunks of an asset share, as plain values.

    Parameters
    ----------
    folder : str
        Of the parts.
    model, model_digest : str
    response : tuple of str, optional
    reading, job : mapping
    exponents : tuple of float, optional
    piece : int
    history : bool
    """

    folder: str
    model: str
    model_digest: str
    response: tuple[str, ...] | None
    reading: Mapping[str, Any]
    job: Mapping[str, Any]
    exponents: tuple[float, ...] | None
    piece: int
    history: bool


@dataclass(frozen=True, slots=True)
class Entry:
    """One record of an asset.

    Parameters
    ----------
    chunk : Chunk
    start : float, optional
        When it begins, in s since 1970 (UTC); None where its name does not tell.
    """

    chunk: Chunk
    start: float | None


@dataclass(frozen=True, slots=True)
class Bad:
    """A record that no worker sees, and why."""

    asset: int
    record: str
    said: str


@dataclass(frozen=True)
class Manifest:
    """All records of a plan, by asset and time.

    Parameters
    ----------
    entries : tuple of Entry
    bad : tuple of Bad
    orders : tuple of Order
        One for each asset.
    """

    entries: tuple[Entry, ...]
    bad: tuple[Bad, ...]
    orders: tuple[Order, ...]


def manifest(plan: Plan) -> Manifest:
    """Records of a plan with their keys.

    Files that did not change since an earlier run (same size, time of change and inode) are not read again.
    """
    known = Digests(plan.output / "digests.txt")
    orders = tuple(_order(plan, asset, known) for asset in plan.assets)
    entries: list[Entry] = []
    bad: list[Bad] = []
    for at, (asset, order) in enumerate(zip(plan.assets, orders, strict=True)):
        base = _common(asset, order)
        seen: dict[str, str] = {}
        found = []
        for path, start in _in_range(asset, at, bad):
            try:
                digest, size = known.of(path)
            except OSError as error:
                bad.append(Bad(at, path, f"{path}: the file cannot be read; found: {error.strerror or error}"))
                continue
            except InputError as error:
                bad.append(Bad(at, path, error.command))
                continue
            if digest in seen:
                bad.append(Bad(at, path, f"{path}: the same bytes as {seen[digest]}, which is counted once; "
                               "what to do: take one of them away"))  # fmt: skip
                continue
            seen[digest] = path
            key = base.copy()
            key.update(digest.encode())
            found.append(Entry(Chunk(key.hexdigest(), path, size, at), start))
        entries += sorted(found, key=lambda e: (e.start is None, e.start or 0.0, e.chunk.record))
    known.close()
    return Manifest(tuple(entries), tuple(bad), orders)


def _in_range(asset: Asset, at: int, bad: list[Bad]) -> Iterator[tuple[str, float | None]]:
    first = None if asset.first is None else asset.first.timestamp()
    last = None if asset.last is None else asset.last.timestamp()
    for path in asset.records:
        try:
            start = asset.begins(path)
        except InputError as error:
            bad.append(Bad(at, path, error.command))
            continue
        if start is None or ((first is None or start >= first) and (last is None or start < last)):
            yield path, start


def _order(plan: Plan, asset: Asset, known: Digests) -> Order:
    exponents = None if plan.fatigue is None else plan.fatigue.exponents
    return Order(
        str(plan.output), str(asset.model), known.of(str(asset.model))[0], asset.response, dict(asset.reading),
        dict(plan.job), exponents, plan.run.piece, plan.run.history,
    )  # fmt: skip


def _common(asset: Asset, order: Order) -> Any:
    """Digest of all that a part of an asset depends on but for its record."""
    told = {
        "version": __version__, "parts": PARTS, "asset": asset.name, "model": order.model_digest, "job": order.job,
        "response": order.response, "reading": order.reading, "exponents": order.exponents, "piece": order.piece,
        "history": order.history,
    }  # fmt: skip
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode())


class Digests:
    """sha256 of files, kept beside the parts: a file is read once as long as it does not change.

    Parameters
    ----------
    path : Path
        Lines of device, inode, size, time of change (ns) and digest.
    """

    def __init__(self, path: Path) -> None:
        self.known: dict[str, str] = {}
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists():
            for line in path.read_text("ascii", "replace").splitlines():
                mark, _, digest = line.rpartition(" ")
                if len(digest) == 64 and mark:
                    self.known[mark] = digest
        self._file = path.open("a")

    def of(self, path: str) -> tuple[str, int]:
        """Digest and size in bytes; of a folder, of the names and the bytes of its files.

        Raises
        ------
        OSError
            A file that cannot be read.
        InputError
            A folder that is no record.
        """
        if os.path.isdir(path):
            files = [(file.name, *self.of(str(file))) for file in listed(Path(path))[0]]
            told = json.dumps([file[:2] for file in files]).encode()
            return hashlib.sha256(told).hexdigest(), sum(size for _, _, size in files)
        about = os.stat(path)
        mark = f"{about.st_dev} {about.st_ino} {about.st_size} {about.st_mtime_ns}"
        digest = self.known.get(mark)
        if digest is None:
            with open(path, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()
            self.known[mark] = digest
            self._file.write(f"{mark} {digest}\n")
        return digest, about.st_size

    def close(self) -> None:
        """Write what is new."""
        self._file.close()


# -- parts ------------------------------------------------------------------------------------------------------------
def part_of(folder: str, key: str) -> Path:
    """Where the part of a chunk lies."""
    return Path(folder) / "parts" / key[:2] / f"{key}.json"


def pieces_of(chunk: Chunk, tree: Mapping[str, Any]) -> tuple[tuple[str, int, int], ...]:
    """Keys and spans of the pieces of a record whose part is `tree`; none where it was done as a whole."""
    if tree["kind"] != "settled":
        return ()
    seed = hashlib.sha256(json.dumps(tree["settled"], sort_keys=True).encode()).hexdigest()
    return tuple(
        (hashlib.sha256(f"{chunk.key} {seed} {a}:{b}".encode()).hexdigest(), a, b)
        for a, b in spans(tree["samples"], tree["piece"])
    )  # fmt: skip


# -- one record -------------------------------------------------------------------------------------------------------
def read_record(path: str, reading: Mapping[str, Any]) -> Record:
    """A record of any format that the package reads.

    Raises
    ------
    InputError
        Whatever is wrong with the file.
    """
    from .._readers import read

    return read(path, **reading)
