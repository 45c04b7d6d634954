"""Headers of a stream: units that are not stated, and a header that comes again with other columns or units."""

import io
import os
import socket
import sys
import threading
from datetime import UTC, datetime, timedelta
from importlib.metadata import EntryPoint, EntryPoints

import numpy as np
import pytest

from loadid import cli
from loadid._families.tracking import tracker as checkpoint
from loadid._families.tracking.tracker import Tracker
from loadid._stream import follow, framing
from loadid._stream.clock import Clock
from loadid._stream.framing import Lines
from loadid._stream.header import ColumnLayout
from structures import Channel
from structures.errors import InputError
from tests.killed import fitted, text

SENSORS = (
    Channel(label="a", quantity="acceleration", unit="m/s^2"),
    Channel(label="d", quantity="displacement", unit="m"),
)
FIRST = b"time [s],a [m/s^2],d [m]\n0.0,1,2\n0.1,3,4\n"
ROWS = [[1, 2], [3, 4], [5, 6], [7, 8]]

AGAIN = {
    "repeated": b"time [s],a [m/s^2],d [m]\n0.2,5,6\n0.3,7,8\n",
    "other order": b"d [m],a [m/s^2],time [s]\n6,5,0.2\n8,7,0.3\n",
    "other units": b"time [ms],a [mm/s^2],d [mm]\n200,5000,6000\n300,7000,8000\n",
    "round brackets": b"time (s),d (mm),a (m/s^2)\n0.2,6000,5\n0.3,8000,7\n",
    "units row": b"time,d,a\ns,mm,m/s^2\n0.2,6000,5\n0.3,8000,7\n",
    "units row in brackets": b"time,d,a\n[s],[mm],[m/s^2]\n# a word\n\n0.2,6000,5\n0.3,8000,7\n",
    "a column more": b"time [s],extra [V],d [m],a [m/s^2],note\n0.2,9,6,5,1\n0.3,9,8,7,1\n",
    "semicolons": b"time [s];d [m];a [m/s^2]\n0,2;6;5\n0,3;8;7\n",
    "tabs": b"time [s]\td [m]\ta [m/s^2]\r\n0.2\t6\t5\r\n0.3\t8\t7\r\n",
    "spaces": b"time [s] d [m] a [m/s^2]\n0.2 6 5\n0.3 8 7\n",
    "quotes": b'"time [s]","d [m]","a [m/s^2]"\n0.2,6,5\n0.3,8,7\n',
    "mark of order": b"\xef\xbb\xbftime [s],d [m],a [m/s^2]\n0.2,6,5\n0.3,8,7\n",
    "comment": b"# time [s],d [m],a [m/s^2]\n0.2,6,5\n0.3,8,7\n",
    "behind a broken row": b"0.2,5.time [s],d [m],a [m/s^2]\n0.2,6,5\n0.3,8,7\n",
    "behind the begin of a broken row": b"0.time [s],d [m],a [m/s^2]\n0.2,6,5\n0.3,8,7\n",
}


def read(data, sizes=(10**9,), lines=None):
    """Stamps and values of bytes that come in pieces, until they end or are refused; what was refused."""
    lines, stamps, values, k, i = lines or Lines(SENSORS), [], [], 0, 0
    try:
        while k < len(data):
            t, y = lines.push(data[k : k + sizes[i % len(sizes)]])
            stamps += [] if t is None else t.tolist()
            values += y.tolist()
            k, i = k + sizes[i % len(sizes)], i + 1
        lines.push(b"")
    except InputError as error:
        return stamps, values, str(error)
    return stamps, values, ""


@pytest.mark.parametrize("sizes", [(10**9,), (1,), (13, 5)])
@pytest.mark.parametrize("form", AGAIN)
def test_a_header_that_comes_again_is_read(form, sizes):
    stamps, values, refused = read(FIRST + AGAIN[form], sizes)
    assert refused == ""
    assert np.allclose(stamps, [0, 0.1, 0.2, 0.3], rtol=0, atol=1e-12)
    assert np.allclose(values, ROWS, rtol=1e-12)


NEVER = {
    "a column fewer": (b"time [s],a [m/s^2]\n", "channel d"),
    "another name": (b"time [s],a [m/s^2],d2 [m]\n", "channel d"),
    "no known name but units": (b"x [m],y [g],z\n", "channel a"),
    "the same name twice": (b"time [s],a [m/s^2],d [m],d [m]\n", "channel d"),
    "volts": (b"time [s],a [mV],d [m]\n", "another quantity"),
    "no such unit": (b"time [s],a [ergs],d [m]\n", "unknown unit"),
    "arbitrary": (b"time [s],a [arbitrary],d [m]\n", "another quantity"),
    "no units": (b"d,a,time\n", "--unit a=m/s^2"),
    "no time": (b"a [m/s^2],d [m]\n", "column of time"),
    "numbers in it": (b"a [m/s^2],d [m],7\n", "names and numbers"),
}


@pytest.mark.parametrize("sizes", [(10**9,), (1,), (13, 5)])
@pytest.mark.parametrize("form", NEVER)
def test_a_header_that_cannot_be_read_ends_the_stream_after_the_rows_before_it(form, sizes):
    header, said = NEVER[form]
    lines = Lines(SENSORS)
    stamps, values, refused = read(FIRST + header + b"7,8,9\n7,8,9\n", sizes, lines)
    assert said in refused
    assert stamps == [0, 0.1]
    assert values == ROWS[:2]


def test_words_that_are_no_header_are_left_out_as_before():
    words = b"x,y,z\nERROR: disk full\nOVERLOAD,OVERLOAD,OVERLOAD\n0.15,OVERLOAD,5\n,,\nnan,nan,nan\n# d and a\n"
    stamps, values, refused = read(FIRST + words + b"0.2,5,6\n")
    assert refused == ""
    assert stamps == [0, 0.1, 0.2]
    assert values == ROWS[:3]


def test_units_that_nobody_states_are_refused_and_can_be_stated():
    for data in (b"time,a,d\n0,1,2\n", b"time,a [g],d\n0,1,2\n", b"time,a [],d []\n0,1,2\n", b"# time,a,d\n0,1,2\n"):
        assert "--unit d=m" in read(data)[2]
    stated = {"a": "mm/s^2", "d": "m", "time": "ms"}
    for data in (b"time,a,d\n500,1000,2\n", b"time [s],a [g],d [mm]\n500,1000,2\n", b"500,1000,2\n"):
        stamps, values, _ = read(data, lines=Lines(SENSORS, units=stated))
        assert np.allclose([stamps[0], *values[0]], [0.5, 1, 2], rtol=1e-15)
    assert read(b"a,d\n1,2\n", lines=Lines((Channel(label="a"), Channel(label="d"))))[1] == [[1, 2]]  # arbitrary
    for wrong, said in (("b", "no sensor"), ("a", "another quantity"), ("time", "no unit of time")):
        with pytest.raises(InputError, match=said):
            Lines(SENSORS, units={wrong: "m"})


def test_a_state_goes_on_with_the_units_that_it_began_with():
    layout = ColumnLayout(3, 0, (1, 2), (1.0, 1.0))
    Lines(SENSORS, layout, {"a": "m/s^2"})
    with pytest.raises(InputError, match="other units"):
        Lines(SENSORS, layout, {"a": "g"})


# -- the clock of a logger that was started again ---------------------------------------------------------------------
@pytest.mark.parametrize("step", [1, 2])
def test_a_clock_that_begins_again_behind_a_header_is_followed_at_once(step):
    clock, n = Clock(0.01), 15  # fewer than it takes to believe it without a header
    clock.place(100 + 0.01 * np.arange(50), np.zeros((50, 1)))
    clock.anew()
    other = Clock(0.01)
    other.restore(clock.to_tree())
    times, values = other.place(0.01 * step * np.arange(n), np.ones((n, 1)))
    assert len(times) == step * (n - 1) + 1
    assert np.allclose(times, 0.01 * np.arange(len(times)), atol=1e-9)
    assert np.nansum(values) == n
    assert {k: v for k, v in other.counts.items() if v and k != "filled" and k != "gaps"} == {"jumps": 1}


def test_another_step_behind_a_header_is_refused():
    clock = Clock(0.01)
    clock.place(0.01 * np.arange(100), np.zeros((100, 1)))
    clock.anew()
    with pytest.raises(InputError, match="another step"):
        clock.place(10 + 0.001 * np.arange(100), np.zeros((100, 1)))


def test_a_sender_whose_clock_was_put_back_while_nobody_listened_is_told_of(caplog):
    clock = Clock(0.01)
    clock.place(100 + 0.01 * np.arange(50), np.zeros((50, 1)))
    clock.again = True
    clock.place(0.01 * np.arange(50), np.zeros((50, 1)))
    assert caplog.text.count("begins again at 0 s") == 1


# -- from end to end --------------------------------------------------------------------------------------------------
@pytest.fixture(autouse=True)
def installed(monkeypatch):
    group = EntryPoints([EntryPoint("track", "loadid._commands.track:command", cli.GROUP)])
    monkeypatch.setattr(cli, "entry_points", lambda group=None, found=group: found)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Tracker, record, file of the tracker, and its answers."""
    tracker, Y = fitted(600)
    path = tmp_path_factory.mktemp("headers") / "model.h5"
    tracker.save(path)
    load, std, _ = Tracker.load(path).run(Y)
    return tracker, Y, path, np.column_stack([load, std])


def again(tracker, Y, at):
    """Lines of a logger that is started again at a row: reversed columns, accelerations in g, displacements in mm."""
    names = [f"{c.label} [{'g' if c.unit == 'm/s^2' else 'mm'}]" for c in tracker.fitted.sensors]
    scale = [9.80665 if c.unit == "m/s^2" else 1e-3 for c in tracker.fitted.sensors]
    lines = [*text(tracker, Y)[: at + 1], ",".join(["time", *names][::-1]).encode() + b"\n"]
    for k, row in enumerate((Y / scale).tolist()[at:], at):
        lines.append(",".join([*map(repr, row[::-1]), f"{k * tracker.fitted.dt:.6f}"]).encode() + b"\n")
    return b"".join(lines)


def sent(data, way, tmp_path, monkeypatch, *words):
    """Exit code of a run on a growing file, standard input or a socket."""
    argv = ["track", "--state", str(tmp_path / "s.h5"), "--out", str(tmp_path / "out.csv"), *map(str, words)]
    if way == "file":
        (tmp_path / "log.csv").write_bytes(data)
        return cli.main([*argv, "--in", str(tmp_path / "log.csv"), "--idle", "0"])
    if way == "pipe":
        reading, writing = os.pipe()
        threading.Thread(target=lambda: (os.write(writing, data), os.close(writing)), daemon=True).start()
        with os.fdopen(reading, "rb") as pipe:
            monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(pipe))
            return cli.main([*argv, "--in", "-"])
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            connection, _ = server.accept()
            with connection:
                connection.sendall(data)

        threading.Thread(target=serve, daemon=True).start()
        return cli.main([*argv, "--in", f"tcp://127.0.0.1:{server.getsockname()[1]}"])


@pytest.mark.parametrize("way", ["file", "pipe", "socket"])
def test_loads_do_not_change_where_the_header_does(made, way, tmp_path, monkeypatch):
    tracker, Y, model, expected = made
    assert sent(again(tracker, Y, 350), way, tmp_path, monkeypatch, "--model", model) == 0
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, :-2]
    assert np.allclose(found[:, 1:], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("way", ["file", "pipe", "socket"])
def test_a_stream_ends_at_a_header_without_units_and_goes_on_where_they_are_stated(
    made, way, tmp_path, monkeypatch, capfd
):
    tracker, Y, model, expected = made
    lines = text(tracker, Y)
    names = b",".join([b"time", *(c.label.encode() for c in tracker.fitted.sensors)]) + b"\n"
    data = b"".join([*lines[:351], names, *lines[351:]])
    assert sent(data, way, tmp_path, monkeypatch, "--model", model) == cli.BAD_INPUT
    assert "--unit a0=m/s^2" in capfd.readouterr().err
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, :-2]
    assert np.array_equal(found[:, 1:], expected[:350])
    units = [word for c in tracker.fitted.sensors for word in ("--unit", f"{c.label}={c.unit}")]
    assert sent(data, way, tmp_path, monkeypatch, *units) == 0
    found = np.loadtxt(tmp_path / "out.csv", delimiter=",", skiprows=1)[:, :-2]
    assert np.array_equal(found[:, 1:], expected)


def test_a_run_that_stops_between_a_header_and_its_units_goes_on(made, tmp_path):
    tracker, Y, model, expected = made
    lines = text(tracker, Y)
    names = ["time", *(c.label for c in tracker.fitted.sensors)]
    units = ["s", *(c.unit for c in tracker.fitted.sensors)]
    lines[301:301] = [f"{','.join(names)}\n".encode(), f"{','.join(units)}\n".encode()]
    log, state = tmp_path / "log", tmp_path / "s.h5"
    for upto in (302, len(lines)):
        log.write_bytes(b"".join(lines[:upto]))
        tracker, stream = checkpoint.read(state if state.exists() else model)
        follow(tracker, str(log), str(tmp_path / "o"), state=state, stream=stream, idle=0)
    found = np.loadtxt(tmp_path / "o", delimiter=",", skiprows=1)[:, :-2]
    assert np.array_equal(found[:, 1:], expected)


@pytest.mark.parametrize(
    ("stamp", "when"),
    [
        ("2026-03-01T10:00:00.25Z", datetime(2026, 3, 1, 10, 0, 0, 250_000, UTC)),
        ("2026-03-01 10:00:00.25", datetime(2026, 3, 1, 10, 0, 0, 250_000, UTC)),
        ("2026/03/01 10:00", datetime(2026, 3, 1, 10, 0, tzinfo=UTC)),
        ("2026-03-01T10:00:00+01:00", datetime(2026, 3, 1, 9, 0, tzinfo=UTC)),
        ("2026-03-01T10:00:00.123456789-0530", float("1772379000.123456789")),  # beyond what a datetime holds
    ],
)
@pytest.mark.parametrize("pieces", [10**9, 7])
def test_iso_stamps_are_seconds_since_1970(stamp, when, pieces):
    for names in ("time,a [m/s^2],d [m]\n", ""):
        data = f'{names}{stamp},1,2\n"{stamp}",,4\n'.encode()
        lines, stamps, values = Lines(SENSORS), [], []
        for k in range(0, len(data), pieces):
            t, y = lines.push(data[k : k + pieces])
            stamps += [] if t is None else t.tolist()
            values += y.tolist()
        assert stamps == [when if isinstance(when, float) else when.timestamp()] * 2
        np.testing.assert_array_equal(values, [[1, 2], [np.nan, 4]])
    with_comma = f"zeit;a [m/s^2];d [m]\n{stamp.replace('.', ',')};1,5;2\n".encode()
    stamps, values = Lines(SENSORS).push(with_comma)
    assert stamps.tolist() == [when if isinstance(when, float) else when.timestamp()]
    assert values.tolist() == [[1.5, 2]]


def test_a_decimal_comma_of_a_stamp_is_no_comma_between_cells_and_no_day_is_made_up():
    stamps, values = Lines(SENSORS).push(b"t,a [m/s^2],d [m]\n2026-03-01T10:00:00,125,2\n2026-02-30T10:00:00,1,2\n")
    assert stamps.tolist() == [datetime(2026, 3, 1, 10, tzinfo=UTC).timestamp()]
    assert values.tolist() == [[125, 2]]


def test_iso_stamps_in_a_long_piece_are_read_as_line_by_line(monkeypatch):
    head, first = b"time,a [m/s^2],d [m]\n", datetime(2026, 3, 1, tzinfo=UTC)
    body = b"".join(f"{(first + timedelta(milliseconds=k)).isoformat()},{k},-{k}e-3\n".encode() for k in range(3000))
    lines = Lines(SENSORS)
    lines.push(head)
    slow = lines.push(body)
    monkeypatch.setattr(framing, "COLD", 0)
    lines = Lines(SENSORS)
    lines.push(head)
    fast = lines.push(body)
    assert len(fast[0]) == 3000
    np.testing.assert_array_equal(fast[0], slow[0])
    np.testing.assert_array_equal(fast[1], slow[1])
    np.testing.assert_allclose(np.diff(fast[0]), 1e-3, atol=5e-7)
