"""Streams that a tracker should not swallow: another step, other words, another run on one output, other places."""

import os
import threading

import numpy as np
import pytest

from loadid._stream.clock import SEEN, Clock
from loadid._stream.framing import HOPELESS, Lines
from loadid._stream.header import printable
from loadid._stream.output import Output
from loadid._stream.sources import open_source, require_source
from structures import Channel
from structures.errors import InputError

SENSORS = (Channel(label="a"), Channel(label="d"))


# -- time stamps ------------------------------------------------------------------------------------------------------
STEPS = [(0.005, "another step"), (10.0, "another step"), (0.0, "rise"), (-0.01, "rise")]


def fed(clock, stamps, pieces):
    """Samples that a clock lets pass before it refuses, and what it says."""
    taken = 0
    for part in np.array_split(stamps, pieces):
        try:
            taken += len(clock.place(part, np.zeros((len(part), 1)))[1])
        except InputError as error:
            return taken, str(error)
    return taken, ""


@pytest.mark.parametrize(("step", "said"), STEPS)
@pytest.mark.parametrize("pieces", [10, 300])
def test_a_stream_at_another_step_is_refused_before_much_is_written(step, said, pieces):
    taken, error = fed(Clock(0.01), 5 + step * np.arange(10 * SEEN), pieces)
    assert said in error
    assert "0.01 s" in error
    assert taken <= (6000 if step > 1 else 41)


def test_gaps_jitter_and_a_slower_stream_are_no_other_step(caplog):
    rng = np.random.default_rng(0)
    t = np.delete(0.01 * np.arange(200), rng.choice(200, 60, replace=False)) + 0.002 * rng.standard_normal(140)
    Clock(0.01).place(t, np.zeros((140, 1)))
    assert not caplog.text
    clock = Clock(0.01)
    for part in np.array_split(0.02 * np.arange(200), 40):
        clock.place(part, np.zeros((len(part), 1)))
    assert caplog.text.count("every 0.02 s") == 1
    assert clock.counts["filled"] == 199


# -- lines ------------------------------------------------------------------------------------------------------------
def test_a_stream_none_of_whose_lines_can_be_read_is_refused_with_one_of_them():
    lines = Lines(SENSORS)
    lines.push(b"time,a,d\n")
    lines.push(b"Sunday 6:16:00,1,2\n" * (HOPELESS - 1))
    with pytest.raises(InputError, match="Sunday 6:16:00,1,2"):
        lines.push(b"Sunday 6:16:01,1,2\n")
    lines = Lines(SENSORS)
    lines.push(b"time,a,d\n0,1,2\n" + b"x,1,2\n" * 10 * HOPELESS)
    assert lines.counts["unreadable"] == 10 * HOPELESS  # one was good: the stream goes on


WRITTEN = (
    b"t;a;d\n0,5;1,25;-2e-3\n", b"t\ta\td\n0,5\t1,25\t-2e-3\n", b't,"a",d\n0.5,1.25,-2e-3\n',
    b"\xef\xbb\xbft;a;d\n0.5;1.25;-2e-3\n",
)  # fmt: skip


@pytest.mark.parametrize("data", WRITTEN)
def test_decimal_commas_quotes_and_marks_of_order(data):
    stamps, values = Lines(SENSORS).push(data)
    assert stamps.tolist() == [0.5]
    assert values.tolist() == [[1.25, -2e-3]]


def test_a_name_with_a_comma_is_quoted_on_both_sides(tmp_path):
    sensors = (Channel(label="x=1, y=2"), Channel(label="d"))
    _, values = Lines(sensors).push(b'time,"x=1, y=2",d\n0,1,2\n')
    assert values.tolist() == [[1, 2]]
    output = Output(str(tmp_path / "o"), ["t", 'p, "q" [N]'])
    output.write(np.zeros(1), np.ones((1, 1)), np.ones((1, 0)))
    output.close()
    assert (tmp_path / "o").read_text() == 't,"p, ""q"" [N]"\n0.0,1.0\n'


def test_what_a_stranger_sends_is_shown_without_its_control_characters():
    with pytest.raises(InputError, match="channel a") as refused:
        Lines(SENSORS).push(b"\x1b[2J\x07b,c\n1,2\n")
    assert "?[2J?b" in str(refused.value)
    assert len(printable("x" * 10_000)) < 220


def test_bytes_without_sense_end_in_an_error_or_in_counts():
    rng = np.random.default_rng(0)
    ended = []
    for k in range(30):
        lines = Lines(SENSORS)
        try:
            for _ in range(5):
                _, values = lines.push((b"a,d\n" if k % 2 else b"") + rng.bytes(5000))
                assert np.all(np.isnan(values) | (np.abs(values) < 1e100))
        except InputError as error:
            ended.append(str(error))
    assert ended
    assert all(text.isprintable() for text in ended)


# -- outputs and sources ----------------------------------------------------------------------------------------------
def test_one_run_for_each_output(tmp_path):
    path, one = str(tmp_path / "out"), np.ones((1, 1))
    first = Output(path, ["t", "p"])
    first.write(np.zeros(1), one, one)
    first.sync()
    for place in (None, first.place()):
        with pytest.raises(InputError, match="another run"):
            Output(path, ["t", "p"], place)
    first.close()
    assert (tmp_path / "out").read_text() == "t,p\n0.0,1.0,1.0\n"
    Output(path, ["t", "p"], first.place()).close()


def test_an_old_output_stays_and_a_new_one_comes_with_the_first_answer(tmp_path):
    path = tmp_path / "out"
    path.write_text("old\n")
    with pytest.raises(InputError, match="the output exists"):
        Output(str(path), ["t"])
    assert path.read_text() == "old\n"
    path.write_text("")
    Output(str(tmp_path / "new"), ["t"]).close()
    assert not (tmp_path / "new").exists()
    output = Output(str(path), ["t"])
    output.sync()
    output.close()
    assert path.read_text() == "t\n"


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
def test_devices_are_pipes_and_a_full_disk_is_named():
    one = np.ones((1, 1))
    output = Output("/dev/null", ["t"])
    output.write(np.zeros(1), one, one)
    output.sync()
    assert output.place()["where"] == "-"
    output.close()
    output = Output("/dev/full", ["t"])
    with pytest.raises(InputError, match="cannot be written"):
        output.write(np.zeros(1), one, one)
    output.close()


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_named_pipe_is_opened_once_and_read_to_its_end(tmp_path, monkeypatch):
    path = tmp_path / "pipe"
    os.mkfifo(path)
    require_source(str(path))  # does not touch it
    waiting = open_source(str(path))
    assert waiting.read(0.01) == b""  # nobody sends yet, and a signal can still end the run
    writer = threading.Thread(target=lambda: path.write_bytes(b"1,2\n" * 1000))
    writer.start()
    data = b""
    while (piece := waiting.read(1.0)) is not None:
        data += piece
    writer.join()
    waiting.close()
    assert data == b"1,2\n" * 1000
    monkeypatch.setattr("sys.stdin", None)
    for ask in (require_source, open_source):
        with pytest.raises(InputError, match="closed"):
            ask("-")
    with pytest.raises(InputError, match="no file of the folder is read"):
        require_source(str(tmp_path))
