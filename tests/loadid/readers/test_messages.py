"""MCAP and ROS bags: messages that the libraries of these formats wrote."""

import json

import numpy as np
import pytest

from loadid import read, read_all
from loadid._readers import scan
from loadid._readers.source import NotStated
from structures._flags import codes
from structures.errors import InputError

from .exports import NS, header, mcap_json, rosbag1, rosbag2
from .files import A, F


def imus(store):
    """Messages of an inertial unit, with covariances and orientations."""
    types = store.types
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    zero = np.zeros(9)
    for k, t in enumerate(NS.tolist()):
        yield (
            t,
            types["sensor_msgs/msg/Imu"](
                header=header(store, t),
                orientation=turn(x=0.0, y=0.0, z=0.0, w=1.0),
                orientation_covariance=zero,
                angular_velocity=vector(x=F[k], y=0.0, z=0.0),
                angular_velocity_covariance=zero,
                linear_acceleration=vector(x=0.0, y=0.0, z=A[k]),
                linear_acceleration_covariance=zero,
            ),
        )


def wrenches(store):
    """Messages without a stamp."""
    types = store.types
    vector = types["geometry_msgs/msg/Vector3"]
    for k, t in enumerate(NS.tolist()):
        yield (
            t,
            types["geometry_msgs/msg/Wrench"](force=vector(x=F[k], y=0.0, z=0.0), torque=vector(x=0.0, y=A[k], z=0)),
        )


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
def test_units_of_known_messages_are_si(tmp_path, suffix):
    pytest.importorskip("mcap")
    path = rosbag2(tmp_path / f"x{suffix}", tmp_path / "bag", suffix, "sensor_msgs/msg/Imu", imus)
    record = read(path)
    assert record.dt == 0.001
    assert len(record.labels) == 10  # no covariance among them
    np.testing.assert_array_equal(record["/load.linear_acceleration.z"], A)
    unit = {c.label: c.unit for c in record.channels}
    assert unit["/load.linear_acceleration.x"] == "m/s^2"
    assert unit["/load.angular_velocity.z"] == "rad/s"
    assert unit["/load.orientation.w"] == "arbitrary"


def test_messages_without_a_stamp_have_the_time_of_the_log(tmp_path):
    path = rosbag2(tmp_path / "x.db3", tmp_path / "bag", ".db3", "geometry_msgs/msg/Wrench", wrenches)
    record = read(path)
    assert any("time is that of the log" in note for note in record.notes)
    assert [c.unit for c in record.channels] == ["N"] * 3 + ["N*m"] * 3
    np.testing.assert_array_equal(record["/load.torque.y"], A)


def test_own_messages_are_read_by_the_definition_in_the_bag(tmp_path):
    """The log is half a microsecond late: the stamps rule. A text is no channel, a unit is asked."""
    path = rosbag1(tmp_path / "x.bag")
    with pytest.raises(NotStated, match=r"/load\.F, /load\.a"):
        read(path)
    record = read(path, columns=["/load.a"], units={"/load.a": "g"})
    assert record.dt == 0.001
    np.testing.assert_allclose(record.values[:, 0], A * 9.80665, rtol=1e-15)


@pytest.mark.parametrize(("at", "byte", "expected"), [(-8, 1, "as many"), (-4, 3, "as many"), (-4, 255, None)])
def test_an_index_that_counts_other_messages_is_told(tmp_path, at, byte, expected):
    """The last eight bytes of a bag of one topic: its number, and how many messages of it the chunk holds."""
    path = rosbag1(tmp_path / "x.bag")
    data = bytearray(path.read_bytes())
    data[at] = byte
    path.write_bytes(data)
    stated = {"units": {0: "N", 1: "g"}}
    if expected is None:
        assert "W209" in codes(read(path, **stated).flags)
    else:
        with pytest.raises(InputError, match=f"expected: {expected}"):
            read(path, **stated)


def mixed(path, *, compression="NONE", messages=16):
    """Two JSON topics, one of another shape now and then, and one in an encoding that is not read."""
    writer = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        file = writer.Writer(stream, compression=writer.CompressionType[compression], chunk_size=400)
        file.start()
        schema = file.register_schema("any", "jsonschema", b"{}")
        proto = file.register_schema("Any", "protobuf", b"")
        one, two = (file.register_channel(t, "json", schema) for t in ("/one", "/two"))
        other = file.register_channel("/other", "protobuf", proto)
        for k, t in enumerate(NS[:messages].tolist()):
            data = {"v": [F[k], A[k]], "on": True, "name": "x", "deep": {"w": {"u": k}}} | (
                {"late": 1} if k > 3 else {}
            )
            file.add_message(one, t, json.dumps(data).encode(), t)
            file.add_message(two, t, json.dumps({"x": k} if k != 5 else {"y": k}).encode(), t)
            file.add_message(other, t, b"\x08\x01", t)
        file.finish()
    return path


@pytest.mark.parametrize("compression", ["NONE", "LZ4", "ZSTD"])
def test_topics_are_records_and_nested_fields_channels(tmp_path, compression):
    one, two = scan(mixed(tmp_path / "x.mcap", compression=compression))
    assert one.columns == ("time", "/one.v[0]", "/one.v[1]", "/one.on", "/one.deep.w.u")
    np.testing.assert_array_equal(one.values[:, 1:3], np.column_stack((F, A)))
    said = "; ".join(one.notes)
    assert "not in its first message: late" in said
    assert "passed over: /other (protobuf messages)" in said
    assert np.flatnonzero(np.isnan(two.values[:, 1])).tolist() == [5]
    assert len(read_all(tmp_path / "x.mcap", units=dict.fromkeys((*one.columns[1:], "/two.x"), "N"))) == 2


def test_topics_that_are_all_unknown(tmp_path):
    writer = pytest.importorskip("mcap.writer")
    with (tmp_path / "x.mcap").open("wb") as stream:
        file = writer.Writer(stream)
        file.start()
        topic = file.register_channel("/p", "protobuf", file.register_schema("P", "protobuf", b""))
        file.add_message(topic, 1, b"", 1)
        file.finish()
    with pytest.raises(InputError, match=r"no topic of the file is read.*/p \(protobuf messages\).*JSON"):
        read(tmp_path / "x.mcap")


def test_a_recording_that_was_not_finished_is_read_and_said(tmp_path):
    path = mixed(tmp_path / "x.mcap")
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 3])
    one = scan(path)[0]
    assert "W209" in codes(one.flags)
    np.testing.assert_array_equal(one.values[:, 1], F[: len(one.values)])


def test_a_chunk_that_was_changed_is_refused(tmp_path):
    path = mixed(tmp_path / "x.mcap")
    data = bytearray(path.read_bytes())
    at = data.index(b'"name": "x"') + 9
    data[at] = ord("y")
    path.write_bytes(data)
    with pytest.raises(InputError, match="CRC"):
        scan(path)


def test_a_record_cannot_be_larger_than_its_file(tmp_path):
    path = mcap_json(tmp_path / "x.mcap")
    data = bytearray(path.read_bytes())
    data[9:17] = (2**40).to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(InputError, match="RecordLengthLimitExceeded"):
        scan(path)


def test_a_database_that_is_no_bag(tmp_path):
    import sqlite3

    pytest.importorskip("rosbags")
    with sqlite3.connect(tmp_path / "x.db3") as base:
        base.execute("create table t (x int)")
    with pytest.raises(InputError):
        scan(tmp_path / "x.db3")
