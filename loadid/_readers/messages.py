"""Recordings of robots (MCAP, ROS 1 and ROS 2 bags): topics as records, numeric fields of their messages as channels.

The time of a message is the stamp in its header, else when it was logged. Units are SI for the message types that say
so themselves (ROS REP 103 and the definitions of geometry_msgs and sensor_msgs); of any other field the unit is stated.
"""

from __future__ import annotations

import importlib.util
import json
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np

from structures._flags import Flag

from .source import COLUMNS, Options, Source, Table, register, since, truncated

ITEMS = 64  # of an array whose entries are channels
DEPTH = 16
CLOCKS = ("header", "timestamp")
VALUES = 2**26  # numbers of a file
# fields of message types whose definitions name the unit; orientations are quaternions
UNITS = {
    ("Wrench", "force"): "N", ("Wrench", "torque"): "N*m", ("Twist", "linear"): "m/s", ("Twist", "angular"): "rad/s",
    ("Accel", "linear"): "m/s^2", ("Accel", "angular"): "rad/s^2", ("Pose", "position"): "m",
    ("Pose", "orientation"): "arbitrary", ("Transform", "translation"): "m", ("Transform", "rotation"): "arbitrary",
    ("Imu", "linear_acceleration"): "m/s^2", ("Imu", "angular_velocity"): "rad/s", ("Imu", "orientation"): "arbitrary",
    ("PointStamped", "point"): "m", ("FluidPressure", "fluid_pressure"): "Pa", ("Range", "range"): "m",
}  # fmt: skip
ROS = ("cdr", "ros1")  # encodings that rosbags reads
PACKAGES = ("geometry_msgs", "sensor_msgs")
Decoder = Callable[[bytes], Any]


@dataclass
class _Topic:
    """Messages of one topic: when they were logged and stamped (ns), their numbers, what was passed over."""

    name: str
    logged: list[int] = field(default_factory=list)
    stamped: list[int | None] = field(default_factory=list)
    rows: list[dict[str, float]] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)

    def add(self, logged: int, message: Any) -> None:
        """The numbers of one message."""
        self.logged.append(logged)
        self.stamped.append(_stamp(message))
        row: dict[str, float] = {}
        for path, value, unit in _numbers(message, "", "", 0):
            row[path] = value
            if unit and not self.rows:
                self.units[path] = unit
        self.rows.append(row)


@register(
    "MCAP",
    suffixes=(".mcap",),
    sniff=lambda head: head.startswith(b"\x89MCAP0\r\n"),
    native=True,
    library="mcap",
    speed=2e5,
)
def load_mcap(source: Source, options: Options) -> list[Table]:
    """Topics with JSON, ROS 2 (CDR) or ROS 1 messages as records; other encodings are passed over and named."""
    from mcap.exceptions import EndOfFile, InvalidMagic
    from mcap.records import Channel, Message, Schema, Statistics

    topics: dict[int, _Topic] = {}
    decoders: dict[int, Decoder | None] = {}
    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    passed: dict[str, str] = {}
    count, declared, left = 0, None, VALUES
    try:
        for record in _records(source):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Statistics):
                declared = record.message_count
            elif isinstance(record, Message):
                count += 1
                channel = channels[record.channel_id]
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(channel, schemas.get(channel.schema_id))
                decode = decoders[channel.id]
                if decode is None:
                    passed[channel.topic] = channel.message_encoding
                    continue
                topic = topics.setdefault(channel.id, _Topic(channel.topic))
                topic.add(record.log_time, decode(record.data))
                left = _less(left, topic, source)
    except (EndOfFile, InvalidMagic, struct.error):  # a recorder that was cut off
        if not count:
            raise
        declared = count + 1
    flags: tuple[Flag, ...] = ()
    if declared is not None and declared > count:
        flags = (truncated(count, declared, "messages at least"),)
    listed = ", ".join(f"{t} ({e} messages)" for t, e in list(passed.items())[:20])
    if passed and not topics:
        lacks = importlib.util.find_spec("rosbags") is None and any(e in ROS for e in passed.values())
        source.refuse("no topic of the file is read", listed, "JSON, ROS 2 (cdr) or ROS 1 messages",
                      "pip install 'loadid[io]'" if lacks else "record it as JSON or ROS messages")  # fmt: skip
    notes = [f"passed over: {listed}"] if passed else []
    return _tables(list(topics.values()), flags, notes, source)


def _records(source: Source) -> Iterator[Any]:
    """Records of a file with every checksum compared, chunks unpacked within the budget."""
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader, breakup_chunk

    unpacked = 0
    with (source.place or source.path).open("rb") as stream:
        reader = StreamReader(stream, emit_chunks=True, validate_crcs=True, record_size_limit=source.size)
        for record in reader.records:
            if not isinstance(record, Chunk):
                yield record
                continue
            unpacked += record.uncompressed_size
            source.allow(unpacked, "the chunks of the file")
            yield from breakup_chunk(record, validate_crc=True)


def _decoder(channel: Any, schema: Any) -> Decoder | None:
    """What turns the bytes of a message into an object; None for an encoding that is not read."""
    if channel.message_encoding == "json":
        return json.loads
    if schema is None or channel.message_encoding not in ROS or importlib.util.find_spec("rosbags") is None:
        return None
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    text = schema.data.decode("utf-8", "replace")
    name = schema.name if "/msg/" in schema.name else schema.name.replace("/", "/msg/", 1)
    if schema.encoding in ("ros2msg", "ros1msg"):
        types = get_types_from_msg(text, name)
    elif schema.encoding == "ros2idl":
        types = {}
        for part in text.split("=" * 80 + "\n"):
            types |= get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part) if part else {}
    else:
        return None
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    take = store.deserialize_cdr if channel.message_encoding == "cdr" else store.deserialize_ros1
    return lambda data: take(data, name)


@register(
    "ROS 1 bag",
    suffixes=(".bag",),
    sniff=lambda head: head.startswith(b"#ROSBAG V2.0"),
    native=True,
    library="rosbags",
    speed=2e5,
)
def load_bag(source: Source, options: Options) -> list[Table]:
    """Topics of a ROS 1 bag as records."""
    return _bag(source)


@register(
    "ROS 2 bag",
    suffixes=(".db3",),
    sniff=lambda head: head.startswith(b"SQLite format 3\0"),
    native=True,
    library="rosbags",
    speed=2e5,
)
def load_db3(source: Source, options: Options) -> list[Table]:
    """Topics of the database of a ROS 2 bag as records."""
    page = int.from_bytes(source.head[16:18], "big")
    declared = int.from_bytes(source.head[28:32], "big") * (65536 if page == 1 else page)
    if source.size < declared:
        source.refuse(f"truncated: {source.size} of {declared} bytes", None, "all pages of the database")
    return _bag(source)


def _bag(source: Source) -> list[Table]:
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    topics: dict[int, _Topic] = {}
    left = VALUES
    notes = []
    with AnyReader([source.place or source.path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        if all(not c.msgdef.data for c in reader.connections):
            notes = ["the bag holds no definitions of its messages: those of the latest ROS 2 are taken"]
        declared = reader.message_count
        for count, (connection, logged, data) in enumerate(reader.messages(), 1):
            if count > declared:  # the index may be damaged, and point to messages again and again
                source.refuse("more messages than the index of the bag counts", f"more than {declared}", "as many",
                              "transfer the file again, or repair it: rosbag reindex")  # fmt: skip
            topic = topics.setdefault(connection.id, _Topic(connection.topic))
            topic.add(logged, reader.deserialize(data, connection.msgtype))
            left = _less(left, topic, source)
    read = sum(len(t.rows) for t in topics.values())
    flags = (truncated(read, declared, "messages"),) if read < declared else ()
    return _tables(list(topics.values()), flags, notes, source)


def _less(left: int, topic: _Topic, source: Source) -> int:
    """Numbers that may still be read after the last message of a topic."""
    left -= len(topic.rows[-1])
    if left < 0:
        source.refuse("the file holds more than may be read", f"more than {VALUES} numbers", "a shorter recording")
    return left


def _numbers(value: Any, path: str, unit: str, depth: int) -> Iterator[tuple[str, float, str]]:
    """Path, number and unit of every numeric field of a message; headers, texts and covariances are none."""
    if isinstance(value, bool | int | float | np.number | np.bool_):
        yield path or "data", float(value), unit
    elif depth > DEPTH or isinstance(value, str | bytes):
        return
    elif isinstance(value, list | np.ndarray):
        if len(value) <= ITEMS and not path.endswith("covariance"):
            for i, item in enumerate(value):
                yield from _numbers(item, f"{path}[{i}]", unit, depth + 1)
    else:
        kind = str(getattr(value, "__msgtype__", ""))
        known = kind.rpartition("/")[2] if kind.startswith(PACKAGES) else ""
        for name, item in _fields(value):
            if not (depth == 0 and name in CLOCKS):
                own = UNITS.get((known, name), "") or unit
                yield from _numbers(item, f"{path}.{name}" if path else name, own, depth + 1)


def _fields(value: Any) -> list[tuple[str, Any]]:
    if isinstance(value, dict):
        return list(value.items())
    if is_dataclass(value):
        return [(f.name, getattr(value, f.name)) for f in fields(value) if not f.name.startswith("__")]
    return []


def _stamp(message: Any) -> int | None:
    """Stamp of a message in ns since 1970; None where it has none, or one that was never set."""
    top = dict(_fields(message))
    stamp = dict(_fields(top["header"])).get("stamp") if "header" in top else top.get("timestamp")
    parts = dict(_fields(stamp))
    whole = next((parts[k] for k in ("sec", "secs") if k in parts), None)
    part = next((parts[k] for k in ("nanosec", "nsec", "nsecs") if k in parts), None)
    if not isinstance(whole, int | np.integer) or not isinstance(part, int | np.integer):
        return None
    total = int(whole) * 10**9 + int(part)
    return total if 0 < total < 2**63 else None


def _tables(topics: list[_Topic], flags: tuple[Flag, ...], notes: list[str], source: Source) -> list[Table]:
    """Topics with numbers as records, over the stamps of their headers or, where one lacks, over the log."""
    tables, without = [], []
    for topic in topics:
        paths = list(topic.rows[0])
        if not paths:
            without.append(topic.name)
            continue
        if len(paths) > COLUMNS:
            source.refuse("too many channels", f"{topic.name}: {len(paths)}", f"at most {COLUMNS}")
        stamps = [s for s in topic.stamped if s is not None]
        whole = len(stamps) == len(topic.rows)
        said = "time is the stamp of the header" if whole else "time is that of the log: messages carry no stamp"
        seconds, start = since(np.array(stamps if whole else topic.logged, "datetime64[ns]"))
        more = {p for row in topic.rows for p in row} - set(paths)
        varying = (
            [f"{topic.name}: passed over, not in its first message: {', '.join(sorted(more)[:12])}"] if more else []
        )
        values = np.array([[row.get(p, np.nan) for p in paths] for row in topic.rows])
        tables.append(
            Table(
                np.column_stack([seconds, values]),
                name=topic.name,
                columns=("time", *(f"{topic.name}.{p}" for p in paths)),
                units=("s", *(topic.units.get(p) for p in paths)),
                time=0,
                flags=flags,
                notes=(said, *varying, *notes, *([f"no numbers in {', '.join(without[:20])}"] if without else [])),
                start=start,
            )
        )
    return tables
