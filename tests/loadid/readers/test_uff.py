"""Time responses of universal files as records."""

import numpy as np
import pytest

from loadid import read, read_all
from loadid._readers import outline
from loadid.cli import main
from structures.errors import InputError
from tests.structures.uff_made import binary58, block, text58, units

from .files import A, F, T, uff

TIME = {"function": 1, "step": 0.001, "abscissa": ("time", "s"), "denominator": (0, "NONE")}


@pytest.fixture
def place(tmp_path):
    def put(data, name="x.uff"):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return put


def channel(values, node, way, kind=12, unit="g", write=text58, **about):
    return write(values, response=("NONE", node, way), ordinate=(kind, unit), **{**TIME, **about})


@pytest.mark.parametrize("write", [text58, binary58])
@pytest.mark.parametrize("suffix", ["uff", "unv", "ufb", "bunv"])
def test_channels_are_degrees_of_freedom(place, write, suffix):
    record = read(place(uff(write), f"x.{suffix}"))
    assert (record.labels, record.units, record.dt) == (("1+Z", "2-X"), ("N", "g"), 0.001)
    np.testing.assert_allclose(record["2-X"], A * 9.80665, rtol=1e-10)


def test_runs_with_the_same_channels_are_records(place):
    sets = [channel(k * x, node, 3) for k in (1, 2) for node, x in ((1, F), (2, A))]
    first, second = read_all(place(b"".join(sets)))
    assert (first.name, second.name) == ("run 1", "run 2")
    np.testing.assert_allclose(second.values, 2 * first.values, rtol=1e-10)
    with pytest.raises(InputError, match="0: run 1 16x2"):
        read(place(b"".join(sets)))
    records = read_all(place(channel(F, 1, 3) + channel(A[:8], 2, 3) + channel(F, 3, 3, step=0.002)))
    assert [(r.labels, len(r), r.dt) for r in records] == [
        (("1+Z",), 16, 0.001), (("2+Z",), 8, 0.001), (("3+Z",), 16, 0.002)
    ]  # fmt: skip


@pytest.mark.parametrize("write", [text58, binary58])
def test_a_stored_time_axis(place, write):
    sets = write(F, T, ordinate=(13, "N"), **TIME) + write(A, T, response=("acc", 0, 0), ordinate=(1, "m/s²"), **TIME)
    record = read(place(sets))
    assert (record.labels, record.dt) == (("1+Z", "acc"), 0.001)
    np.testing.assert_allclose(record.values, np.column_stack((F, A)), rtol=1e-6)
    with pytest.raises(InputError, match="time is not uniform"):
        read(place(write(F, T**2 + T, ordinate=(13, "N"), **TIME)))


def test_names_notes_and_the_start_of_time(place):
    sets = text58(F, response=("Hammer", 0, 0), ordinate=(13, "N"), start=-0.25, **TIME)
    sets += text58(A, response=("NONE", 0, 0), ordinate=(12, "g"), start=-0.25, label="left", **TIME)
    record = read(place(sets + block(82, "1") + block(777, "1")))
    assert record.labels == ("Hammer", "left")
    text = "; ".join(record.notes)
    assert "time begins at -0.25 s" in text
    assert "skipped: 1 x data set 82 (trace lines)" in text
    assert "skipped: 1 x data set 777 (unknown)" in text


def test_units_of_the_file_and_units_that_are_open(place):
    sets = units(1e3, 1.0, 10, "mm (newton)") + channel(A, 1, 3, unit="NONE") + channel(F, 2, 3, 13, "NONE")
    record = read(place(sets))
    assert record.units == ("mm/s^2", "N")
    np.testing.assert_allclose(record["1+Z"], A / 1e3, rtol=1e-10)
    pressure = units(1e2, 1e2, 6, "cm (centi newton)") + channel(A, 1, 3, 15, "NONE")
    np.testing.assert_allclose(read(place(pressure)).values[:, 0], A * 100, rtol=1e-10)
    path = place(channel(A, 1, 3, unit="NONE"))
    with pytest.raises(InputError, match=r"does not state the unit.*1\+Z=UNIT"):
        read(path)
    assert "no data set 164" in outline(path)[0].notes[0]
    assert read(path, units={"1+Z": "g"}).units == ("g",)
    path = place(units() + channel(A, 1, 3, unit="g"))  # SI by its data set 164, g by the text of its axis
    with pytest.raises(InputError, match="does not state the unit"):
        read(path)
    assert read(path, units={"1+Z": "m/s^2"})["1+Z"][3] == pytest.approx(A[3])


def test_milliseconds_and_a_rounded_step(place):
    assert read(place(text58(F, ordinate=(13, "N"), **{**TIME, "abscissa": ("time", "ms"), "step": 0.5}))).dt == 5e-4
    record = read(place(text58(F, ordinate=(13, "N"), **{**TIME, "step": 1 / 51200})))
    assert record.dt == 1 / 51200
    assert any("1.9531" in note for note in record.notes)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (text58(F + 1j * A), "no time response; found: 1 x FRF.*read_frfs"),
        (text58(F + 1j * A, **TIME), "has complex values.*time response"),
        (text58(F, **{**TIME, "abscissa": ("frequency", "Hz")}), "abscissa of a time response is no time"),
        (text58(F, **{**TIME, "abscissa": ("time", "rev")}), "abscissa of a time response is no time"),
    ],
)
def test_what_is_no_record(place, data, what):
    with pytest.raises(InputError, match=what):
        read(place(data))


def test_info_names_what_is_no_record(place, capsys):
    frf = text58(F + 1j * A, response=("", 1, 3), reference=("", 7, -2), ordinate=(12, "g"), start=20, step=2.5)
    assert main(["info", str(place(block(151, "Beam", "test") + frf, "x.unv"))]) == 0
    text = capsys.readouterr().out
    for word in ("Beam, test", "1 x FRF", "1+Z [g]", "7-Y [N]", "16 values, 20 to 57.5 Hz", "loadid model import"):
        assert word in text
    assert main(["info", str(place(uff()))]) == 0
    assert "16 samples" in capsys.readouterr().out
    assert main(["info", str(place(frf[:-10], "y.unv"))]) == 3


def test_a_file_cut_in_its_second_channel_is_refused(place):
    data = uff()
    for k in (len(data) - 2, len(data) - 100, len(data) // 2 + 100):
        with pytest.raises(InputError, match="truncated"):
            read(place(data[:k]))
