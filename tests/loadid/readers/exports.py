"""The record of `files` in the formats of other tools, each written by the library that others write it with."""

import datetime as dt
import importlib.util
from pathlib import Path

import numpy as np
import pytest

from .files import A, F, T

BEGIN = dt.datetime(2026, 11, 24, 8, 0, 0, tzinfo=dt.UTC)
START = BEGIN.timestamp()
NS = int(START) * 10**9 + np.round(T * 1e9).astype(np.int64)


def tdms(path: Path, segments=2) -> Path:
    """A TDMS file as LabVIEW logs it: the waveform properties in the first segment, data in all."""
    nptdms = pytest.importorskip("nptdms")
    begin = np.datetime64(BEGIN.replace(tzinfo=None))
    about = {"wf_increment": 0.001, "wf_start_offset": 0.0, "wf_samples": 8, "wf_start_time": begin}
    with nptdms.TdmsWriter(path) as file:
        for part in np.array_split(np.arange(len(F)), segments):
            channels = [
                nptdms.ChannelObject("run", n, x[part], {**about, "unit_string": u, "NI_ChannelName": n})
                for n, x, u in (("F", F, "N"), ("a", A, "g"))
            ]
            file.write_segment([nptdms.RootObject({"name": "log"}), nptdms.GroupObject("run"), *channels])
    return path


def mdf(path: Path, version="4.10") -> Path:
    """An MDF file; the acceleration as raw integers with a linear conversion."""
    asammdf = pytest.importorskip("asammdf")
    raw = np.round(A * 1e4).astype("i4")
    file = asammdf.MDF(version=version)
    file.start_time = BEGIN
    signals = [
        asammdf.Signal(F, T, name="F", unit="N"),
        asammdf.Signal(raw, T, name="a", unit="g", conversion={"a": 1e-4, "b": 0.0}),
    ]
    file.append(signals, comment="run")
    file.save(path, overwrite=True)
    file.close()
    return path


def wav(path: Path, values=None, kind="<f8", rate=1000) -> Path:
    """A WAV file of 64-bit floats in physical units, or of other numbers."""
    from scipy.io import wavfile

    wavfile.write(path, rate, np.column_stack((F, A)).astype(kind) if values is None else values)
    return path


def arrow_table(**about):
    """A table with its units in the metadata of its columns."""
    pa = pytest.importorskip("pyarrow")
    fields = [pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in (("F", "N"), ("a", "g"))]
    return pa.table([F, A], schema=pa.schema(fields, metadata={"fs": "1000.0", **about}))


def parquet(path: Path, table=None) -> Path:
    """A Parquet file with checksums."""
    from pyarrow import parquet

    parquet.write_table(arrow_table() if table is None else table, path, write_page_checksum=True)
    return path


def arrow(path: Path) -> Path:
    """An Arrow IPC file, which is Feather too."""
    table = arrow_table()
    from pyarrow import feather

    feather.write_feather(table, path, compression="uncompressed")
    return path


def excel(path: Path, rows=None) -> Path:
    """A workbook with a title, a heading and a row of units, as a logger fills it."""
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Log"
    head = [["Hammer test"], [], ["Time", "F", "a"], ["s", "N", "g"]]
    for row in [*head, *zip(T.tolist(), F.tolist(), A.tolist(), strict=True)] if rows is None else rows:
        sheet.append(list(row))
    book.save(path)
    return path


def mcap_json(path: Path) -> Path:
    """An MCAP file with JSON messages, as Foxglove writes them."""
    writer = pytest.importorskip("mcap.writer")
    import json

    with path.open("wb") as stream:
        file = writer.Writer(stream, compression=writer.CompressionType.NONE)
        file.start(profile="", library="test")
        schema = file.register_schema(name="Load", encoding="jsonschema", data=b'{"type": "object"}')
        channel = file.register_channel(topic="/load", message_encoding="json", schema_id=schema)
        for k, t in enumerate(NS.tolist()):
            stamp = {"sec": t // 10**9, "nsec": t % 10**9}
            data = json.dumps({"timestamp": stamp, "F": F[k], "a": A[k], "frame_id": "base"}).encode()
            file.add_message(channel, log_time=t + 500, data=data, publish_time=t)
        file.finish()
    return path


PAIR = "std_msgs/Header header\nfloat64 F\nfloat64 a\nstring note\n"


def ros_store(name):
    """The types of a ROS version, with a type of one's own."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores[name])
    store.register(get_types_from_msg(PAIR, "lab_msgs/msg/Pair"))
    return store


def header(store, t, k=0):
    """Header of a message with the stamp `t` in ns."""
    stamp, kind = store.types["builtin_interfaces/msg/Time"], store.types["std_msgs/msg/Header"]
    seq = {"seq": k} if "seq" in kind.__dataclass_fields__ else {}
    return kind(stamp=stamp(sec=t // 10**9, nanosec=t % 10**9), frame_id="base", **seq)


def pairs(store):
    """Log times and messages of the two channels."""
    kind = store.types["lab_msgs/msg/Pair"]
    for k, t in enumerate(NS.tolist()):
        yield t + 500, kind(header=header(store, t, k), F=F[k], a=A[k], note="x")


def rosbag1(path: Path) -> Path:
    """A ROS 1 bag."""
    store = ros_store("ROS1_NOETIC")
    from rosbags.rosbag1 import Writer

    with Writer(path) as file:
        topic = file.add_connection("/load", "lab_msgs/msg/Pair", typestore=store)
        for t, message in pairs(store):
            file.write(topic, t, store.serialize_ros1(message, topic.msgtype))
    return path


def rosbag2(path: Path, folder: Path, suffix=".db3", kind="lab_msgs/msg/Pair", messages=pairs) -> Path:
    """The database of a ROS 2 bag, or its MCAP file."""
    store = ros_store("ROS2_HUMBLE")
    from rosbags.rosbag2 import StoragePlugin, Writer

    plugin = StoragePlugin.SQLITE3 if suffix == ".db3" else StoragePlugin.MCAP
    with Writer(folder, version=9, storage_plugin=plugin) as file:
        topic = file.add_connection("/load", kind, typestore=store)
        for t, message in messages(store):
            file.write(topic, t, store.serialize_cdr(message, topic.msgtype))
    (data,) = folder.glob(f"*{suffix}")
    path.write_bytes(data.read_bytes())
    return path


def miniseed(path: Path, version=2) -> Path:
    """A miniSEED file of doubles, with a record for each channel."""
    pymseed = pytest.importorskip("pymseed")
    traces = pymseed.MS3TraceList()
    for name, x in (("N", F), ("Z", A)):
        traces.add_data(f"FDSN:XX_STA_00_H_N_{name}", x, "d", 1000.0, starttime_seconds=START)
    traces.to_file(path, overwrite=True, max_record_length=512, format_version=version,
                   encoding=pymseed.DataEncoding.FLOAT64)  # fmt: skip
    return path


def _db3(path: Path) -> Path:
    return rosbag2(path, path.parent / "bag")


WRITERS = {
    "tdms": ("nptdms", tdms), "mf4": ("asammdf", mdf), "wav": ("scipy", wav), "parquet": ("pyarrow", parquet),
    "arrow": ("pyarrow", arrow), "xlsx": ("openpyxl", excel), "mcap": ("mcap", mcap_json), "bag": ("rosbags", rosbag1),
    "db3": ("rosbags", _db3), "mseed": ("pymseed", miniseed),
}  # fmt: skip


def exports(folder: Path) -> None:
    """One valid small file ``a.<suffix>`` of every format whose library is installed."""
    for suffix, (library, write) in WRITERS.items():
        if importlib.util.find_spec(library):
            write(folder / f"a.{suffix}")
