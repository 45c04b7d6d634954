"""Recordings that a kill leaves readable, in HDF5 or MCAP, and played again at any speed.

HDF5 is written as a single writer with many readers (SWMR): what was flushed can be read while it is written, and after
a kill. MCAP is written in chunks; a file without its end is read up to there. No file is gone on with: the next run,
and one that is long, begins another part, ``run-2.h5`` beside ``run.h5``, and all are played as one.

A frame is its number, time, motion of the markers, load and std (single precision), covariance of force and torque, and
a text of JSON with its flags, facts and events; what all frames share stands at the beginning.
"""

from __future__ import annotations

import base64
import json
import os
import re
import time as clock
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from loadid._results.archive import plain
from structures._flags import Flag
from structures.errors import InputError, positive

from .._results.forcemap import ForceFacts, ForceMap
from .._sensors.posing import channels
from ._events import LiveEvent
from ._frame import LiveFrame
from ._messages import message
from ._slip import SlipWatch

SUFFIXES = (".h5", ".mcap")
FLUSH = 0.5  # s between two flushes: what a kill may cost
PART = 36000  # frames of a part, at most
CHUNK, BLOCK, ROWS = 1 << 16, 1 << 19, 1024  # bytes of text and of MCAP, of a block of HDF5, and its rows, at most
FORMAT = 1
SINGLE = ("load", "std")
SHARED = ("coordinates", "cells", "measures", "resultant", "about", "mass_data", "mass_indices", "mass_indptr")
Tree = dict[str, Any]


class Part(Protocol):
    """A file that frames are appended to."""

    path: Path

    def append(self, frame: LiveFrame) -> None:
        """Add a frame."""

    def close(self) -> None:
        """End it."""


class Recording:
    """A recording that frames are appended to, in parts: a new one for each run, and after 36000 frames.

    So an index that grows with its file stays small, in the memory too.

    Parameters
    ----------
    path : path
        Of its first part: HDF5 (.h5) or MCAP (.mcap).

    Raises
    ------
    InputError
        Another suffix, a folder that is not there, a package that is not installed.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        place = Path(os.fspath(path))
        if place.suffix.lower() not in SUFFIXES:
            raise _other_kind(place)
        if not place.resolve().parent.is_dir():
            raise InputError("the folder does not exist", where=str(place), hint="make it first")
        self._place = place
        self._part, self._frames = self._next(), 0

    @property
    def path(self) -> Path:
        """File of the part that is written."""
        return self._part.path

    def append(self, frame: LiveFrame) -> None:
        """Add a frame; on the disk within half a second."""
        if self._frames == PART:
            self._part.close()
            self._part, self._frames = self._next(), 0
        self._part.append(frame)
        self._frames += 1

    def close(self) -> None:
        """End it; without a frame it leaves no file."""
        self._part.close()

    def _next(self) -> Part:
        place = self._place
        number = max((_number(p, place) for p in parts(place)), default=0) + 1
        new = place if number == 1 else place.with_name(f"{place.stem}-{number}{place.suffix}")
        return Hdf5Part(new) if place.suffix.lower() == ".h5" else McapPart(new)


def parts(path: Path) -> list[Path]:
    """Parts of a recording, in their order."""
    found = [p for p in path.parent.glob(f"{path.stem}*{path.suffix}") if p == path or _number(p, path)]
    return sorted(found, key=lambda p: _number(p, path))


def _number(part: Path, path: Path) -> int:
    if part.name == path.name:
        return 1
    found = re.fullmatch(re.escape(path.stem) + r"-(\d+)", part.stem)
    return int(found[1]) if found else 0


# -- HDF5 -------------------------------------------------------------------------------------------------------------
class Hdf5Part:
    """One HDF5 file: ``head`` is JSON in an attribute, ``frames/*`` have a row for each frame."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: Any = None
        self._data: dict[str, Any] = {}
        self._rows = 0
        self._flushed = clock.monotonic()

    def append(self, frame: LiveFrame) -> None:
        """Add a frame; on the disk within half a second."""
        row = _row(frame)
        if self._file is None:
            self._begin(frame, row)
        data, text = self._data, np.frombuffer(row.pop("text"), np.uint8)
        end = len(data["text"]) + len(text)
        data["text"].resize(end, axis=0)
        data["text"][end - len(text) :] = text
        for name, value in {**row, "end": end}.items():
            data[name].resize(self._rows + 1, axis=0)
            data[name][self._rows] = value
        self._rows += 1
        if clock.monotonic() - self._flushed > FLUSH:
            self._file.flush()
            self._flushed = clock.monotonic()

    def close(self) -> None:
        """End it."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _begin(self, frame: LiveFrame, row: Mapping[str, Any]) -> None:
        import h5py

        self._file = h5py.File(self.path, "w", libver="latest")
        head, arrays = _head(frame)
        self._file.attrs["head"] = json.dumps(head)
        for name, value in arrays.items():
            self._file[f"shared/{name}"] = value
        group = self._file.create_group("frames")
        for name, value in {**row, "end": 0}.items():
            shape, kind = ((), np.uint8) if name == "text" else (np.shape(value), np.asarray(value).dtype)
            row_bytes = max(1, int(np.prod(shape)) * np.dtype(kind).itemsize)
            several = CHUNK if name == "text" else min(max(1, BLOCK // row_bytes), ROWS)
            self._data[name] = group.create_dataset(
                name, (0, *shape), kind, maxshape=(None, *shape), chunks=(several, *shape)
            )
        self._file.swmr_mode = True


def _read_hdf5(path: Path) -> tuple[Tree, dict[str, Any], Iterator[Tree]]:
    import h5py

    try:
        file = h5py.File(path, "r", libver="latest", swmr=True)
        head = json.loads(file.attrs["head"])
    except (OSError, KeyError, ValueError) as error:
        raise _unreadable(path, error) from None

    def rows() -> Iterator[Tree]:
        with file:
            data = file["frames"]
            count = min(len(data[name]) for name in data if name != "text")
            ends = data["end"][:count]
            count = int(np.searchsorted(ends, len(data["text"]), side="right"))  # as far as its text is there
            for k in range(count):
                start = int(ends[k - 1]) if k else 0
                row = {name: data[name][k] for name in data if name not in ("text", "end")}
                yield {**row, "text": data["text"][start : int(ends[k])].tobytes()}

    return head, {name: file["shared"][name][...] for name in file["shared"]}, rows()


# -- MCAP -------------------------------------------------------------------------------------------------------------
TOPICS = {"head": "/tactile/sensor", "force": "/tactile/force", "map": "/tactile/map"}
NUMBERS: Tree = {"type": "array", "items": {"type": ["number", "null"]}}
PACKED: Tree = {"type": "object", "description": "array: type and shape as numpy writes them, bytes in base64",
                "properties": {"type": {"type": "string"}, "shape": NUMBERS, "data": {"type": "string"}}}  # fmt: skip
SCHEMAS: dict[str, Tree] = {
    "head": {"type": "object", "properties": {"head": {"type": "object"}, "arrays": {"type": "object"}}},
    "force": {"type": "object", "properties": {
        **dict.fromkeys(("force", "force_std", "torque", "torque_std"), NUMBERS),
        "number": {"type": "integer"}, "time": {"type": "number"}, "touched": {"type": "boolean"},
        **{name: {"type": ["object", "null"]} for name in ("contact", "slip", "latency")},
        **{name: {"type": "array"} for name in ("flags", "on", "events")},
    }},
    "map": {"type": "object", "properties": {"number": {"type": "integer"}, "time": {"type": "number"},
            **dict.fromkeys(("motion", "load", "std", "covariance", "image"), PACKED),
            "text": {"type": "string"}}},
}  # fmt: skip


class McapPart:
    """One MCAP file: JSON messages of the topics ``/tactile/sensor``, ``/tactile/force`` and ``/tactile/map``."""

    def __init__(self, path: Path) -> None:
        _mcap()
        self.path = path
        self._file: Any = None
        self._writer: Any = None
        self._channels: dict[str, int] = {}
        self._flushed = clock.monotonic()

    def append(self, frame: LiveFrame) -> None:
        """Add a frame; on the disk within half a second, or a chunk."""
        if self._file is None:
            self._begin(frame)
        row = _row(frame)
        text = row.pop("text").decode()
        small = {"number": int(row.pop("number")), "time": float(row.pop("time"))}
        stamp = round(1e9 * max(frame.time, 0.0))
        self._say("force", message(frame), stamp)
        self._say("map", {**small, **{name: _packed(value) for name, value in row.items()}, "text": text}, stamp)
        if clock.monotonic() - self._flushed > FLUSH:
            self._file.flush()
            self._flushed = clock.monotonic()

    def close(self) -> None:
        """End it: its index is written."""
        if self._file is not None:
            self._writer.finish()
            self._file.close()
            self._file = None

    def _begin(self, frame: LiveFrame) -> None:
        writer = _mcap().writer
        self._file = self.path.open("wb")
        self._writer = writer.Writer(self._file, chunk_size=CHUNK, compression=writer.CompressionType.NONE)
        self._writer.start(profile="", library="loadid")
        for name, topic in TOPICS.items():
            schema = self._writer.register_schema(
                name=f"tactile.{name}", encoding="jsonschema", data=json.dumps(SCHEMAS[name]).encode()
            )
            self._channels[name] = self._writer.register_channel(topic=topic, message_encoding="json", schema_id=schema)
        head, arrays = _head(frame)
        self._say("head", {"head": head, "arrays": {name: _packed(value) for name, value in arrays.items()}},
                  round(1e9 * max(frame.time, 0.0)))  # fmt: skip

    def _say(self, name: str, value: Tree, stamp: int) -> None:
        data = json.dumps(value, allow_nan=False, separators=(",", ":")).encode()
        self._writer.add_message(channel_id=self._channels[name], log_time=stamp, publish_time=stamp, data=data)


def _read_mcap(path: Path) -> tuple[Tree, dict[str, Any], Iterator[Tree]]:
    mcap = _mcap()

    def values() -> Iterator[tuple[str, Tree]]:
        with path.open("rb") as file:
            reader = mcap.reader.NonSeekingReader(file)
            try:
                for _, channel, said in reader.iter_messages(log_time_order=False):
                    yield channel.topic, json.loads(said.data)
            except (mcap.exceptions.McapError, mcap.struct_error, ValueError):
                return  # a kill cut it here

    coming = values()
    topic, first = next(coming, ("", {}))
    if topic != TOPICS["head"]:
        raise _unreadable(path, "its first message is not that of this package")

    def rows() -> Iterator[Tree]:
        for topic, value in coming:
            if topic == TOPICS["map"]:
                yield {name: _unpacked(v) for name, v in value.items()} | {"text": value["text"].encode()}

    return first["head"], {name: _unpacked(v) for name, v in first["arrays"].items()}, rows()


class _Mcap:
    """What is used of the package mcap."""

    def __init__(self) -> None:
        import struct

        import mcap.exceptions
        import mcap.reader
        import mcap.writer

        self.reader, self.writer, self.exceptions = mcap.reader, mcap.writer, mcap.exceptions
        self.struct_error = struct.error


def _mcap() -> _Mcap:
    try:
        return _Mcap()
    except ImportError:
        raise InputError("MCAP files need the package mcap", where="record", hint='pip install "loadid[mcap]", or '
                         "record to .h5") from None  # fmt: skip


def _packed(array: NDArray[Any]) -> Tree:
    array = np.ascontiguousarray(array)
    return {"type": array.dtype.str, "shape": list(array.shape), "data": base64.b64encode(array.tobytes()).decode()}


def _unpacked(value: Any) -> Any:
    if not (isinstance(value, dict) and "data" in value):
        return value
    kind = np.dtype(value["type"])
    if kind.kind not in "biuf":
        raise InputError("an array of a kind that no recording holds", where="recording", found=value["type"])
    return np.frombuffer(base64.b64decode(value["data"]), kind).reshape(value["shape"])


# -- frames to rows and back ------------------------------------------------------------------------------------------
def _row(frame: LiveFrame) -> Tree:
    """What is kept of a frame."""
    found = frame.map
    assert found.geometry is not None
    text = {
        "flags": [flag.to_dict() for flag in found.flags], "facts": dict(found.facts), "touched": frame.touched,
        "on": frame.on, "events": [vars(event) for event in frame.events],
    }  # fmt: skip
    row: Tree = {
        "number": np.int64(frame.number), "time": np.float64(frame.time), "motion": frame.motion,
        "covariance": np.asarray(found.geometry["resultant_covariance"], float),
        **{name: getattr(found, name).astype(np.float32) for name in SINGLE},
        "text": json.dumps(plain(text), allow_nan=False).encode(),
    }  # fmt: skip
    return row if frame.image is None else {**row, "image": frame.image}


def _head(frame: LiveFrame) -> tuple[Tree, dict[str, Any]]:
    """What all frames share: words, and arrays of the geometry."""
    geometry = frame.map.geometry
    assert geometry is not None
    known = {k: v for k, v in geometry.items() if k not in SHARED and k != "resultant_covariance"}
    arrays = {name: np.asarray(geometry[name]) for name in SHARED if geometry.get(name) is not None}
    return {"format": FORMAT, "is": "tactile recording", "geometry": plain(known)}, arrays


def _frame(row: Tree, geometry: Tree, loads: list[Any]) -> LiveFrame:
    text = json.loads(row["text"])
    found = ForceMap(
        load=np.asarray(row["load"], float),
        std=np.asarray(row["std"], float),
        labels=[c.label for c in loads],
        units=[c.unit for c in loads],
        flags=tuple(Flag.from_dict(flag) for flag in text["flags"]),
        geometry={**geometry, "resultant_covariance": np.asarray(row["covariance"], float)},
        facts=ForceFacts.of(text["facts"]),
    )
    events = tuple(LiveEvent(**event) for event in text["events"])
    return LiveFrame(int(row["number"]), float(row["time"]), found, np.asarray(row["motion"]), text["touched"],
                     events=events, on=tuple(text["on"]), image=row.get("image"))  # fmt: skip


def _other_kind(place: Path) -> InputError:
    return InputError("no kind of recording", where=str(place), found=place.suffix or "no suffix",
                      expected=" or ".join(SUFFIXES))  # fmt: skip


def _unreadable(path: Path, error: Any) -> InputError:
    return InputError("the recording cannot be read", where=str(path), found=str(error)[:200],
                      expected="a file that tactile.live has recorded")  # fmt: skip


def replay(path: str | os.PathLike[str], *, speed: float | None = 1.0) -> Iterator[LiveFrame]:
    """Frames of a recording, all its parts after each other, as they were when it was made.

    Maps are those that were recorded, in single precision; friction is learned from them anew, latency is not kept.

    Parameters
    ----------
    path : path
        Of the first part.
    speed : float, optional
        Over that of the recording; None for as fast as it goes.

    Raises
    ------
    InputError
        No such file, damaged at its beginning, no recording; a speed that is not positive.
    """
    place = Path(os.fspath(path))
    pace = None if speed is None else positive("the speed", speed, where="replay")
    if place.suffix.lower() not in SUFFIXES:
        raise _other_kind(place)
    if not place.is_file():
        raise InputError("there is no such file", where=str(place), expected="a recording")
    return _played(parts(place), pace)


def _played(files: list[Path], pace: float | None) -> Iterator[LiveFrame]:
    last: float | None = None
    due, watch = clock.monotonic(), SlipWatch()
    for file in files:
        head, arrays, rows = _read_hdf5(file) if file.suffix.lower() == ".h5" else _read_mcap(file)
        if head.get("is") != "tactile recording" or head.get("format") != FORMAT:
            raise _unreadable(file, f"{head.get('is')}, format {head.get('format')}")
        geometry = {**head["geometry"], **arrays}
        loads = channels(len(geometry["measures"]), geometry["kind"])
        for row in rows:
            frame = _frame(row, geometry, loads)
            if pace is not None and last is not None:
                due = max(due + max(frame.time - last, 0.0) / pace, clock.monotonic() - 1.0)
                clock.sleep(max(due - clock.monotonic(), 0.0))
            last = frame.time
            slips = frame.touched and "W611" not in frame.map.codes
            yield replace(frame, slip=watch.update(last, frame.map, frame.map.contact())) if slips else frame
