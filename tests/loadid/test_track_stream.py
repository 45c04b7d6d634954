"""Lines, clocks, sources and outputs of a stream: what comes in pieces, late, twice, wrong or not at all."""

import os
import socket
import threading
import time

import numpy as np
import pytest

from loadid._commands.track import BINS, History, live
from loadid._stream import framing
from loadid._stream.clock import LONGEST, REGULAR, Clock
from loadid._stream.framing import LONGEST as LINE
from loadid._stream.framing import Lines
from loadid._stream.output import Output
from loadid._stream.sources import GrowingFile, Pumped, open_source
from structures import Channel
from structures.errors import InputError

SENSORS = (
    Channel(label="a", quantity="acceleration", unit="m/s^2"),
    Channel(label="d", quantity="displacement", unit="m"),
)


def rows(data, sizes=(10**9,), sensors=SENSORS):
    """Stamps, values and counts of bytes that come in pieces of these sizes, again and again."""
    lines, stamps, values, k, i = Lines(sensors), [], [], 0, 0
    while k < len(data):
        t, y = lines.push(data[k : k + sizes[i % len(sizes)]])
        stamps += [] if t is None else t.tolist()
        values.append(y)
        k, i = k + sizes[i % len(sizes)], i + 1
    return stamps, np.concatenate(values), {n: c for n, c in lines.counts.items() if c}


# -- lines ------------------------------------------------------------------------------------------------------------
MESSY = (
    b"# log\ntime,a [m/s^2],d [m]\n"
    b"0.0,1.5,2\n0.1,,3\n\n0.2,nan,4\n0.3,inf,5\n0.4,1\n0.5,1,2,3\n0.6,x,2\n0.7,1e200,-1e-3\r\n"
    b"0.8," + b"9" * (LINE + 5) + b",1\n# end\n0.9,7,8\n1.0,1,2"
)  # fmt: skip


@pytest.mark.parametrize("sizes", [(10**9,), (1,), (7, 3, 1000), (LINE, 1), (30,)])
def test_rows_do_not_depend_on_the_pieces(sizes):
    stamps, values, counts = rows(MESSY, sizes)
    assert stamps == [0.0, 0.1, 0.2, 0.3, 0.7, 0.9]
    n = np.nan
    assert np.array_equal(values, [[1.5, 2], [n, 3], [n, 4], [n, 5], [n, -1e-3], [7, 8]], equal_nan=True)
    assert counts == {"lines": 9, "wide": 2, "unreadable": 1, "infinite": 2, "endless": 1}


@pytest.mark.parametrize("sizes", [(10**9,), (7, 3, 1000), (30,)])
def test_lines_that_are_read_at_once_are_read_alike(monkeypatch, sizes):
    tidy = b"time,a [m/s^2],d [m]\r\n" + b"".join(b"%d,%.17g, -%d.5e-7 \r\n" % (k, np.sqrt(k), k) for k in range(40))
    whole = tidy + MESSY.replace(b"time,a", b"t,a") + b"\n" + tidy.replace(b",", b";").replace(b".", b",")
    monkeypatch.setattr(Lines, "_plain", lambda self, data: None)
    known = rows(whole, sizes)
    monkeypatch.undo()
    monkeypatch.setattr(framing, "COLD", 0)
    assert str(rows(whole, sizes)) == str(known)


def numbers(lines, mark=b","):
    """Cells of lines as the loop reads them; which of them it has left to `float`."""
    text = b"\n".join(lines) + b"\n"
    table = np.empty((len(lines), lines[0].count(mark) + 1))
    others = np.empty((table.size, 3), np.int64)
    found = framing._numbers(np.frombuffer(text, np.int8), mark[0], framing.TENS, 100, table, others)
    return table, found, {text[begin:end] for _, begin, end in others[: max(found, 0)].tolist()}


def test_numbers_are_read_to_the_last_bit():
    rng = np.random.default_rng(0)
    values = rng.standard_normal((4000, 2)) * 10.0 ** rng.integers(-9, 12, (4000, 2))
    lines = [b"%.*g,%.*g" % (k % 20, a, k % 7 + 14, b) for k, (a, b) in enumerate(values.tolist())]
    lines += [b"%d.%d,%d" % tuple(row) for row in rng.integers(1, 10**9, (4000, 3)) ** 2 // 7]
    lines += [b"%d.5,%d" % tuple(row) for row in rng.integers(2**52, 2**54, (4000, 2))]  # half way between two
    lines += [
        b"-0,0.000",
        b"+.5,5.",
        b" 1E+2 ,1e-05",
        b"nan, NaN ",
        b"1e22,1e-22",
        b"1e23,1e400",
        b"9007199254740993,-0e9",
    ]
    lines += [b"%r,%r" % tuple(row) for row in values.tolist()]
    table, found, left = numbers(lines)
    right = np.array([[float(cell) for cell in line.split(b",")] for line in lines])
    told = np.array([[cell.strip() not in left for cell in line.split(b",")] for line in lines])
    assert found > 0
    assert np.mean(told) > 0.5
    assert np.array_equal(np.isnan(table), np.isnan(right) & told)
    told &= ~np.isnan(right)
    assert np.array_equal(table[told].view(np.int64), right[told].view(np.int64))


@pytest.mark.parametrize(
    "line", [b"", b"1", b"1,2,3", b"x,1", b"1,-", b"1,.", b"1,e5", b"1,2e", b"1,2 3", b"1,1_0", b"1,--2", b"1.2.3,1",
             b"1;2", b"#1,2", b"1,\xb2", b"1,0x1", b"nan1,1", b"1,na", b"-nan,1", b"1,2\r\r", b"1," + b"1" * 99],
)  # fmt: skip
def test_other_text_than_numbers_is_left_alone(line):
    assert numbers([b"1,2", line, b"3,4"])[1] == -1


def test_without_stamps_a_bad_line_is_a_sample_without_data():
    stamps, values, counts = rows(b"1,2\n3\nx,1\n5,6\n")
    assert stamps == []
    assert np.array_equal(values, [[1, 2], [np.nan] * 2, [np.nan] * 2, [5, 6]], equal_nan=True)
    assert counts == {"lines": 4, "wide": 1, "unreadable": 1}


def test_a_header_puts_the_columns_in_order_and_converts_units():
    stamps, values, _ = rows(b"d [mm];other;t [s];a [g]\n5;0;0.5;2\n")
    assert stamps == [0.5]
    assert np.allclose(values, [[2 * 9.80665, 5e-3]], rtol=1e-15)
    with pytest.raises(InputError, match="channel d"):
        rows(b"time,a,b\n0,1,2\n")
    with pytest.raises(InputError, match="another quantity"):
        rows(b"time,a [mm],d [m]\n0,1,2\n")
    with pytest.raises(InputError, match="first line"):
        rows(b"0,1,2,3,4\n")


def test_another_file_may_begin_with_a_header_or_without():
    lines = Lines(SENSORS)
    lines.push(b"d [m],a [m/s^2]\n1,2\n3")
    lines.another()
    assert np.array_equal(lines.push(b"5,6\n")[1], [[6, 5]])  # as before, and without the begin that was left
    lines.another()
    assert np.array_equal(lines.push(b"a [m/s^2],d [m]\n5,6\n")[1], [[5, 6]])


# -- time stamps ------------------------------------------------------------------------------------------------------
class Single(Clock):
    """Every row on its own."""

    def _regular(self, stamps, first):
        return first


@pytest.mark.parametrize("window", [0, 3])
@pytest.mark.parametrize("seed", range(4))
def test_regular_rows_are_placed_as_one_by_one(seed, window):
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(600) * (1 + 1e-4 * seed) + 0.001 * (1 + seed) * rng.standard_normal(600)
    t = np.delete(t, rng.integers(0, 600, 20 * seed))
    t[rng.integers(100, len(t), 5)] -= 0.015 * seed
    t[-100:] -= 3.0 * (seed == 3)  # a clock that was put back
    values = rng.standard_normal((len(t), 2))
    values[rng.random(values.shape) < 0.05] = np.nan
    clocks = Clock(0.01, window), Single(0.01, window)
    for part in np.array_split(np.arange(len(t)), 7):
        (times, found), (ones, alike) = (clock.place(t[part], values[part]) for clock in clocks)
        assert times.tobytes() == ones.tobytes()
        assert found.tobytes() == alike.tobytes()
        assert str(clocks[0].behind) == str(clocks[1].behind)
        assert str(clocks[0].to_tree()) == str(clocks[1].to_tree())


def placed(stamps, dt=0.01, again=False, pieces=1):
    """Times and numbers of the rows, -1 without data; counts."""
    clock = Clock(dt)
    clock.again = again
    times, found = [], []
    for part in np.array_split(np.arange(len(stamps)), pieces):
        t, y = clock.place(np.asarray(stamps, float)[part], part[:, None].astype(float))
        times += t.tolist()
        found += np.where(np.isnan(y[:, 0]), -1, y[:, 0]).astype(int).tolist()
    return times, found, {n: int(c) for n, c in clock.counts.items() if c}


def test_a_steady_clock_passes_and_a_gap_is_filled():
    t = np.arange(50) * 0.01
    assert placed(t)[1:] == (list(range(50)), {})
    times, found, counts = placed(np.delete(t, [20, 21, 22, 40]))
    assert found == [*range(20), -1, -1, -1, *range(20, 37), -1, *range(37, 46)]
    assert counts == {"gaps": 2, "filled": 4}
    assert np.allclose(times, t, atol=1e-9)


def test_duplicated_and_late_samples_are_left_out():
    t = (np.arange(30) * 0.01).tolist()
    stamps = [*t[:10], t[9], t[9], *t[10:20], t[4], *t[20:]]
    _, found, counts = placed(stamps)
    assert [stamps[k] for k in found] == t
    assert counts == {"duplicated": 2, "late": 1}


def test_jitter_and_a_fast_clock_lose_nothing():
    rng = np.random.default_rng(0)
    t = 5 + np.arange(10_000) * 0.01
    _, found, counts = placed(t + 0.001 * rng.uniform(-1, 1, len(t)))
    assert found == list(range(len(t)))
    assert "filled" not in counts
    assert placed(t * (1 + 1e-4))[1:] == (list(range(len(t))), {})
    _, found, counts = placed(t + 0.003 * rng.uniform(-1, 1, len(t)))
    assert found == list(range(len(t)))
    assert 3000 < counts["jitter"] < 9000


@pytest.mark.parametrize("pieces", [1, 7, 60])
def test_a_clock_that_was_put_back_is_followed_and_one_put_forward_is_no_endless_gap(pieces):
    t = np.arange(60) * 0.01
    _, found, counts = placed(np.r_[t + 100, t + 99], pieces=pieces)
    assert found == list(range(120))
    assert counts == {"jumps": 1}
    _, found, counts = placed(np.r_[t, t + 1e9], pieces=pieces)
    assert found == [*range(60), *[-1] * LONGEST, *range(60, 120)]
    assert counts == {"jumps": 1, "filled": LONGEST}


def test_what_a_sender_repeats_after_a_new_start_is_left_out():
    clock = Clock(0.01)
    t, y = np.arange(100) * 0.01, np.arange(100.0)[:, None]
    clock.place(t[:60], y[:60])
    other = Clock(0.01)
    other.restore(clock.to_tree())
    other.again = True
    assert np.array_equal(other.place(t, y)[1], y[60:])
    assert other.counts["again"] == 60
    assert REGULAR < 60  # not taken for a clock that was put back


def test_a_clock_goes_on_from_its_tree():
    rng = np.random.default_rng(1)
    t = np.cumsum(rng.choice([0.01, 0.01, 0.03, 0.0, -0.02], 500)) + 0.002 * rng.standard_normal(500)
    whole, clock = placed(t), Clock(0.01)
    found = clock.place(t[:250], np.arange(250.0)[:, None])[0].tolist()
    other = Clock(0.01)
    other.restore(clock.to_tree())
    assert found + other.place(t[250:], np.arange(250.0)[:, None])[0].tolist() == whole[0]


# -- sources ----------------------------------------------------------------------------------------------------------
def drained(source):
    data = b""
    while piece := source.read(0.0):
        data += piece
    return data


def test_a_growing_file_is_read_once_while_it_is_rotated_and_emptied(tmp_path):
    path, fresh = tmp_path / "log", []
    path.write_bytes(b"one\n")
    source = GrowingFile(path, fresh=lambda: fresh.append(1))
    assert drained(source) == b"one\n"
    with path.open("ab") as file:
        file.write(b"tw")
    assert drained(source) == b"tw"
    with path.open("ab") as file:
        file.write(b"o\n")
    path.rename(tmp_path / "log.1")
    assert drained(source) == b"o\n"  # between two files
    path.write_bytes(b"three\n")
    assert drained(source) == b"three\n"
    path.write_bytes(b"4\n")
    assert drained(source) == b"4\n"
    assert len(fresh) == 2
    source.close()


def test_a_file_is_known_again_by_its_begin(tmp_path):
    path = tmp_path / "log"
    path.write_bytes(b"abcdef\nxy")
    source = GrowingFile(path)
    source.read(0.0)
    place = source.place(2)
    source.close()
    assert place["at"] == 7
    path.write_bytes(b"abcdef\nxyz\n")
    again = GrowingFile(path, place)
    assert drained(again) == b"xyz\n"
    again.close()
    path.write_bytes(b"Abcdef\nxyz\n")
    other = GrowingFile(path, place)
    assert drained(other) == b"Abcdef\nxyz\n"
    assert other.counts["rotated"] == 1
    other.close()


def test_a_full_queue_makes_the_sender_wait_and_says_so(caplog):
    sent = []

    def receive():
        if len(sent) == 50:
            return b""
        sent.append(1)
        return b"x"

    source = Pumped(receive, lambda: None, size=4)
    until = time.monotonic() + 5
    while not source.counts["waited"] and time.monotonic() < until:
        time.sleep(0.005)
    assert len(sent) <= 6  # nothing piles up
    assert source.counts["waited"] == 1
    data = b""
    while (piece := source.read(1.0)) is not None:
        data += piece
    assert data == b"x" * 50
    assert caplog.text.count("made to wait") == 1
    assert source.read(0.0) is None
    source.close()


def test_a_socket_is_read_to_its_end():
    server = socket.create_server(("127.0.0.1", 0))

    def serve():
        connection, _ = server.accept()
        with connection:
            for k in range(50):
                connection.sendall(b"%d," % k)

    thread = threading.Thread(target=serve)
    thread.start()
    source = open_source(f"tcp://127.0.0.1:{server.getsockname()[1]}")
    data = b""
    while (piece := source.read(1.0)) is not None:
        data += piece
    source.close()
    thread.join()
    server.close()
    assert data == b"".join(b"%d," % k for k in range(50))


def test_sources_that_are_not_there_are_named(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(InputError, match="nobody answers"):
        open_source(f"tcp://127.0.0.1:{port}")
    for wrong in ("tcp://", "tcp://host", "tcp://host:port", "tcp://host:99999"):
        with pytest.raises(InputError, match="address"):
            open_source(wrong)
    with pytest.raises(InputError, match="cannot be read"):
        open_source(str(tmp_path / "nothing"))


# -- output and pictures ----------------------------------------------------------------------------------------------
def test_an_output_goes_on_from_its_checkpoint_and_a_changed_one_is_refused(tmp_path):
    path = str(tmp_path / "out.csv")
    output, one = Output(path, ["t", "p", "s"]), np.ones((1, 1))
    output.write(np.array([0.1]), 2 * one, one / 3)
    place = output.place()
    output.write(np.array([0.2]), one, one)
    output.close()
    with open(path, "ab") as file:
        file.write(b"0.3,5.")  # killed in the middle of a row
    again = Output(path, ["t", "p", "s"], place)
    again.write(np.array([0.2]), one, one)
    again.write(np.array([0.3]), one, one)
    assert again.place()["at"] == os.path.getsize(path)
    again.close()
    text = (tmp_path / "out.csv").read_text()
    assert text == "t,p,s\n0.1,2.0,0.3333333333333333\n0.2,1.0,1.0\n0.3,1.0,1.0\n"
    for wrong in (text[:20], text.replace("2.0", "3.0")):
        (tmp_path / "out.csv").write_text(wrong)
        with pytest.raises(InputError, match="not the one"):
            Output(path, ["t", "p", "s"], place)
        assert (tmp_path / "out.csv").read_text() == wrong
    os.remove(path)
    with pytest.raises(InputError, match="gone"):
        Output(path, ["t", "p", "s"], place)


def test_the_past_is_kept_in_bounded_memory_with_its_extremes():
    rng, past = np.random.default_rng(0), History(["p"], ["N"])
    load, k = rng.standard_normal((40_000, 1)), 0
    while k < len(load):
        size = int(rng.integers(1, 400))
        part = load[k : k + size]
        past.add(np.arange(k, k + len(part)) * 1.0, part, np.full(part.shape, 0.5))
        k += size
    bins, times = past.bins, past.times
    assert BINS // 2 <= len(past) <= BINS
    assert np.all(np.diff(times) > 0)
    covered = int(times[-1] + past.size / 2)
    assert bins[:, 2].max() == pytest.approx(load[:covered].max() + 0.98)
    assert np.mean(bins[:, 0]) == pytest.approx(load[:covered].mean(), abs=5e-3)


def test_the_picture_in_a_terminal_shows_load_and_band():
    t = np.arange(400) * 0.01
    text = live(["p1", "p2"], ["N", "N"], t, np.column_stack([np.sin(t), 0 * t]), np.full((400, 2), 0.1))
    lines = text.split("\n")
    assert len(lines) == 22
    assert "p1 [N]  now" in lines[0]
    columns = np.array([list(line[11:].ljust(72)) for line in lines[1:10]])
    rows = np.argmax(columns == "█", axis=0)
    assert rows[0] > rows[28] < rows[-1]  # a sine rises and falls
    assert np.all((columns != " ").any(axis=0))


@pytest.mark.parametrize("alarms", [None, np.repeat([[0, 0], [528, 2], [0, 0]], [5, 3, 4], axis=0)])
def test_rows_are_written_with_all_their_digits(tmp_path, alarms):
    rng = np.random.default_rng(0)
    t, load, std = np.arange(12) * 0.01, rng.standard_normal((12, 2)) * 1e17, rng.random((12, 2))
    std[1:6], load[3], std[9] = std[0], np.nan, -0.0
    output = Output(str(tmp_path / "o"), ["t", "p", "q", "std p", "std q"] + ["code", "channel"] * (alarms is not None))
    output.write(t, load, std, alarms)
    output.write(t, load, np.add.outer(t, load[0]), alarms)  # another std in every row
    output.close()
    ends = [[]] * 12 if alarms is None else alarms.tolist()
    both = [np.column_stack([t, load, band]) for band in (std, np.add.outer(t, load[0]))]
    rows = [[*a, *b] for a, b in zip(np.concatenate(both).tolist(), [*ends, *ends], strict=True)]
    assert (tmp_path / "o").read_text().split("\n")[1:-1] == [",".join(map(repr, row)) for row in rows]
