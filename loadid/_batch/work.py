"""What a worker does with a chunk: a record, or a piece of a long one, becomes a part, a file that is there or not.

Nothing but plain values comes in and goes out. A part is JSON, put in its place by a rename; equal chunks make equal
parts, byte for byte, whoever makes them and however often.
"""

from __future__ import annotations

import json
import os
import secrets
import threading
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError, NotIdentifiable
from structures.files import _storage as storage

from .loads import kept
from .records import Chunk, Order, part_of, pieces_of, read_record

if TYPE_CHECKING:
    from structures._model import Model

    from .._record import Record

Array = NDArray[np.float64]
MODELS = 16  # that a worker keeps


@dataclass(frozen=True, slots=True)
class Done:
    """What is known of a chunk when its part is there.

    Parameters
    ----------
    seconds : float
        That it took; 0 where the part was there.
    worker : str
    pieces : tuple of (str, int, int)
        Key and span of the pieces into which a long record falls.
    """

    seconds: float
    worker: str
    pieces: tuple[tuple[str, int, int], ...] = ()


def work(chunk: Chunk, order: Order) -> Done:
    """Make the part of a chunk.

    What is wrong with its record, or cannot be told from it, is an answer too: a part that says so.

    Raises
    ------
    MemoryError
        More memory is needed than a worker may take.
    """
    begun, target = time.monotonic(), part_of(order.folder, chunk.key)
    try:
        tree = _piece(chunk, order) if chunk.parent else _record(chunk, order)
    except (InputError, NotIdentifiable) as error:
        if isinstance(error.__cause__, MemoryError):  # the record is not to blame
            raise MemoryError from error
        kind = "bad input" if isinstance(error, InputError) else "not identifiable"
        tree = {"kind": "refused", "why": kind, "said": error.command}
    _put(target, json.dumps(tree, allow_nan=False, sort_keys=True).encode())
    return Done(time.monotonic() - begun, f"{os.uname().nodename}:{os.getpid()}", pieces_of(chunk, tree))


# -- records ----------------------------------------------------------------------------------------------------------
def _record(chunk: Chunk, order: Order) -> dict[str, Any]:
    from .._commands.identify import identify
    from . import joined

    record, model = _read(chunk.record, order), _model(order)
    known = {"samples": len(record), "dt": record.dt, "sensors": _health(record)}
    if len(record) >= 1.5 * order.piece and joined.divisible(model, order.job, record.dt):
        settled, estimate = joined.settle(record, model, order.job, order.piece)
        if 2 * settled.overlap < order.piece:
            _put_array(scratch_of(order.folder, chunk.key), record.values)
            return {"kind": "settled", "settled": asdict(settled), "piece": order.piece, **known, **_judged(estimate)}
    estimate = identify(record, model, **order.job)
    if estimate.axis is None or estimate.axis.name != "time" or len(estimate.axis.values) != len(estimate.load):
        raise InputError("this job gives no histories", where="[job]", expected="loads over time")
    if order.history:
        _history(order, chunk.key, estimate.load, estimate.std)
    return {
        "kind": "whole", **known, **_judged(estimate), "loads": _kept(estimate.load, estimate.std, record.dt, 0, order),
        "misfit": _misfit(estimate.residual, estimate.response),
    }  # fmt: skip


def _judged(estimate: Any) -> dict[str, Any]:
    choice, grade = estimate.choice, estimate.grade
    return {
        "labels": list(estimate.labels), "units": list(estimate.units), "names": list(estimate.sensors),
        "grade": grade.letter, "expected_error": float(grade.expected), "codes": sorted(estimate.codes),
        "rule": None if choice is None else str(choice.rule),
        "verdict": None if choice is None else str(choice.verdict),
        "lam": None if choice is None else float(choice.lam),
    }  # fmt: skip


def _kept(load: Array, std: Array, dt: float, start: int, order: Order) -> list[dict[str, Any]]:
    return [
        kept(load[:, j], std[:, j], dt, start, order.exponents).to_dict() for j in range(load.shape[1])
    ]  # fmt: skip


def _misfit(residual: Array | None, response: Array | None) -> list[list[float]] | None:
    """Sums of squares of residual and response of every sensor."""
    if residual is None or response is None or residual.ndim != 2:
        return None
    return [[float(np.sum(r**2)), float(np.sum(y**2))] for r, y in zip(residual.T, response.T, strict=True)]


def _health(record: Record) -> list[dict[str, Any]]:
    """Mean, root mean square, share of missing samples and findings of every channel that is used."""
    found = []
    for k, channel in enumerate(record.channels):
        y = record.values[:, k]
        there = y[~np.isnan(y)]
        kinds = sorted({str(flag.evidence.name) for flag in record.select(k).health() if flag.evidence is not None})
        found.append({
            "label": channel.label, "unit": channel.unit, "missing": 1 - len(there) / len(y),
            "mean": float(there.mean()) if len(there) else None,
            "rms": float(np.sqrt(np.mean(there**2))) if len(there) else None, "found": kinds,
        })  # fmt: skip
    return found


# -- pieces -----------------------------------------------------------------------------------------------------------
def _piece(chunk: Chunk, order: Order) -> dict[str, Any]:
    from . import joined

    tree = json.loads(part_of(order.folder, chunk.parent).read_bytes())
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in tree["settled"].items()}
    settled = joined.SettledLoads(**given)
    held, model, (first, last) = _held(chunk, order), _model(order), chunk.span
    load, std, rest = joined.solved(held, tree["dt"], model, order.job, settled, first, last)
    if order.history:
        _history(order, chunk.key, load, std)
    heard = np.nan_to_num(held[first : first + len(rest)] - np.array(settled.offsets))
    return {
        "kind": "piece", "start": first, "loads": _kept(load, std, tree["dt"], first, order),
        "misfit": _misfit(rest, heard),
    }  # fmt: skip


def scratch_of(folder: str, key: str) -> Path:
    """Where the samples of a long record lie while its pieces are worked on."""
    return Path(folder) / "scratch" / f"{key}.npy"


def _held(chunk: Chunk, order: Order) -> Array:
    """Samples of the record of a piece, in the file that its first chunk made, or that is made again."""
    path = scratch_of(order.folder, chunk.parent)
    if not path.exists():
        _put_array(path, _read(chunk.record, order).values)
    held: Array = np.load(path, mmap_mode="r", allow_pickle=False)
    return held


# -- files ------------------------------------------------------------------------------------------------------------
def _read(path: str, order: Order) -> Record:
    """The channels of a record that the model takes, in the order of its sensors."""
    from .._commands.identify import responses_of

    return responses_of(read_record(path, order.reading), _model(order), order.response)


_MODELS: dict[tuple[str, str], Model] = {}
_LOADING = threading.Lock()


def _model(order: Order) -> Model:
    """The model of an asset; a worker keeps those of its last chunks."""
    from .._commands import load_model

    key = (order.model, order.model_digest)
    with _LOADING:
        if key not in _MODELS:
            while len(_MODELS) >= MODELS:
                del _MODELS[next(iter(_MODELS))]
            _MODELS[key] = load_model(order.model)
        return _MODELS[key]


def _put(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    storage.replace(path, data)


def _put_array(path: Path, values: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(6)}.tmp")
    try:
        with temporary.open("xb") as file:
            np.save(file, values, allow_pickle=False)
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)


def history_of(folder: str, key: str) -> Path:
    """Where the histories of a chunk lie."""
    return Path(folder) / "histories" / key[:2] / f"{key}.npy"


def _history(order: Order, key: str, load: Array, std: Array) -> None:
    _put_array(history_of(order.folder, key), np.stack([load, std]))
