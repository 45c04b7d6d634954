"""Folders of files by the hour as one record, against the long record that was cut into them."""

import datetime as dt
import json
from dataclasses import replace

import numpy as np
import pytest

from loadid import Record, cli, identify, read, read_all, read_folder
from loadid._batch.records import spans
from structures import MatrixModel
from structures.errors import InputError

DT, HOUR = 0.125, 400
BEGIN = dt.datetime(2026, 11, 24, 22, 0, tzinfo=dt.UTC)
Y = np.random.default_rng(3).standard_normal((3 * HOUR, 2))


def piece(folder, name, first, last, y=Y, units=("m/s^2", "N"), step=DT, stamped=True):
    """Samples of the long record as a file that a logger writes."""
    lines = [f"time,a [{units[0]}],F [{units[1]}]"]
    for k in range(first, last):
        when = (BEGIN + dt.timedelta(seconds=k * step)).isoformat() if stamped else f"{(k - first) * step}"
        lines.append(f"{when},{float(y[k, 0])!r},{float(y[k, 1])!r}")
    (folder / name).write_text("\n".join(lines) + "\n")


@pytest.fixture
def folder(tmp_path):
    """Three files whose names come in another order than their samples."""
    for name, k in (("z.csv", 0), ("m.csv", 1), ("a.csv", 2)):
        piece(tmp_path, name, k * HOUR, (k + 1) * HOUR)
    return tmp_path


def test_files_make_the_record_that_was_cut(folder):
    record = read(folder)
    np.testing.assert_array_equal(record.values, Y)
    assert (record.labels, record.units, record.dt) == (("a", "F"), ("m/s^2", "N"), DT)
    assert record.start == BEGIN.timestamp()
    assert record.source == str(folder)
    assert any("3 files in the order of time, z.csv to a.csv" in note for note in record.notes)
    assert len(read_all(folder)) == 1


def test_what_lies_beside_the_files_is_said(folder):
    for name in ("README.txt", ".hidden.csv", "photo.jpg", "old.npy"):
        (folder / name).write_bytes(b"nothing")
    (folder / "raw").mkdir()
    record = read(folder)
    np.testing.assert_array_equal(record.values, Y)
    (said,) = (note for note in record.notes if note.startswith("passed over"))
    assert said == "passed over: .hidden.csv, README.txt, old.npy, photo.jpg, raw"


def test_a_damaged_file_is_not_passed_over(folder):
    (folder / "b.csv").write_text("no table at all\n")
    with pytest.raises(InputError, match=r"b\.csv"):
        read(folder)


def test_gaps_are_nan_and_said(folder):
    (folder / "m.csv").unlink()
    record = read(folder)
    want = Y.copy()
    want[HOUR : 2 * HOUR] = np.nan
    np.testing.assert_array_equal(record.values, want)
    assert any(f"{HOUR} samples set to NaN" in n and "(50 s) after z.csv" in n for n in record.notes)


def test_overlaps_must_agree(folder):
    piece(folder, "m.csv", HOUR - 50, 2 * HOUR + 20)
    record = read(folder)
    np.testing.assert_array_equal(record.values, Y)
    assert any("70 samples lie in two files" in n and "m.csv, a.csv" in n for n in record.notes)
    other = Y.copy()
    other[HOUR - 7, 1] += 1e-9
    piece(folder, "m.csv", HOUR - 50, 2 * HOUR, other)
    with pytest.raises(InputError, match=r"contradict.*m\.csv|m\.csv.*contradict"):
        read(folder)
    later = read_folder(folder).window(HOUR * DT)  # what does not touch the overlap
    np.testing.assert_array_equal(later.values, Y[HOUR:])


def test_a_file_within_another(folder):
    piece(folder, "m.csv", 100, 200)
    piece(folder, "n.csv", HOUR, 2 * HOUR)
    np.testing.assert_array_equal(read(folder).values, Y)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"units": ("g", "N")}, r"other channels or units.*m\.csv|m\.csv.*other channels or units"),
        ({"step": 0.25}, r"m\.csv.*another step|another step.*m\.csv"),
        ({"stamped": False}, r"only some files state.*m\.csv"),
    ],
)
def test_a_file_of_another_kind_is_named(folder, change, words):
    piece(folder, "m.csv", HOUR, 2 * HOUR, **change)
    with pytest.raises(InputError, match=words):
        read(folder)


def test_doubled_files_are_refused(folder):
    (folder / "m copy.csv").write_bytes((folder / "m.csv").read_bytes())
    with pytest.raises(InputError, match=r"begin at the same time.*m copy\.csv and m\.csv"):
        read(folder)


def test_no_stamps_natural_order(tmp_path):
    for k in range(11):
        piece(tmp_path, f"log_{k + 1}.csv", 100 * k, 100 * (k + 1), stamped=False)
    record = read(tmp_path)
    np.testing.assert_array_equal(record.values, Y[:1100])
    assert record.start is None
    assert any("order of their names" in note for note in record.notes)


def test_windows_and_pieces_are_those_of_the_long_record(folder):
    whole, lazy = Record(Y, DT, start=BEGIN), read_folder(folder)
    assert (len(lazy), lazy.duration, lazy.outline.labels) == (len(Y), whole.duration, ("a", "F"))
    for start, stop in ((0.0, 10.0), (45.0, 55.0), (30.3, 130.1), (140.0, None)):
        own, ref = lazy.window(start, stop), whole.window(start, stop)
        np.testing.assert_array_equal(own.values, ref.values)
        assert own.start == ref.start
    pieces = list(lazy.pieces(250))
    assert [len(p) for p in pieces] == [b - a for a, b in spans(len(Y), 250)] == [250, 250, 250, 250, 200]
    np.testing.assert_array_equal(np.concatenate([p.values for p in pieces]), Y)


def test_pieces_read_every_file_once(folder):
    seen = []
    lazy = replace(read_folder(folder), reader=lambda path, **stated: seen.append(path.name) or read(path, **stated))
    assert len(list(lazy.pieces(90))) == 13
    assert seen == ["z.csv", "m.csv", "a.csv"]


def test_long_gaps_and_long_records_go_in_parts(folder, monkeypatch):
    from loadid import _folders

    (folder / "m.csv").unlink()
    (folder / "z.csv").unlink()
    piece(folder, "z.csv", 0, 100)
    with pytest.raises(InputError, match=r"gaps between the files are longer.*read_folder"):
        read(folder)
    lazy = read_folder(folder)
    assert [len(p) for p in lazy.pieces(100)] == [100] * 5  # 100 samples, 700 of gap, 400 samples
    with pytest.raises(InputError, match="holds no sample"):
        lazy.window(20.0, 30.0)
    monkeypatch.setattr(_folders, "BUDGET", 8 * 2 * 500)
    with pytest.raises(InputError, match=r"longer than memory.*read_folder"):
        lazy.window()
    assert len(lazy.window(0.0, 50.0)) == HOUR


def test_a_file_that_changed_is_refused(folder):
    lazy = read_folder(folder)
    piece(folder, "m.csv", HOUR, 2 * HOUR - 1)
    with pytest.raises(InputError, match="has changed"):
        lazy.window()


@pytest.mark.parametrize("names", [(), ("a.jpg",), ("a.csv", "b.npy")])
def test_folders_of_nothing_and_of_several_formats(tmp_path, names):
    for name in names:
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError, match=r"no file of the folder is read|several formats"):
        read(tmp_path)


def test_other_formats_make_a_folder_too(tmp_path):
    pytest.importorskip("pyarrow")
    whole = Record(Y, DT, ["a", "F"], start=BEGIN).apply_units({"a": "m/s^2", "F": "N"})
    for k in range(3):
        whole.window(k * HOUR * DT, (k + 1) * HOUR * DT).to_parquet(tmp_path / f"{9 - k}.parquet")
    record = read(tmp_path)
    np.testing.assert_array_equal(record.values, Y)
    assert (record.start, record.dt) == (whole.start, DT)


def test_commands_take_folders(folder, capsys):
    assert cli.main(["info", "--json", str(folder)]) == 0
    (told,) = json.loads(capsys.readouterr().out)["records"]
    assert told["samples"] == len(Y)
    from structures import Channel

    model = MatrixModel([[2.0]], sensors=[Channel(label="F", unit="N", quantity="force")],
                        loads=[Channel(label="P", unit="N", quantity="force")])  # fmt: skip
    found = identify(folder, model, family="static")
    whole = Record(Y[:, 1], DT, model.sensors)
    np.testing.assert_allclose(found.load, identify(whole, model, family="static").load, rtol=1e-9)
    assert any("3 files" in note for note in found.provenance["notes"])


def test_info_asks_for_the_units_of_all_files(tmp_path, capsys):
    for k in range(2):
        lines = [f"{(BEGIN + dt.timedelta(seconds=(9 * k + i) * DT)).isoformat()},{i}" for i in range(9)]
        (tmp_path / f"{k}.csv").write_text("\n".join(["time,acc", *lines]) + "\n")
    assert cli.main(["info", "--json", str(tmp_path)]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["tables"][0]["samples"] == 18
    assert "--unit acc=UNIT" in told["to_read_it"]
    assert cli.main(["info", "--json", str(tmp_path), "--unit", "acc=g"]) == 0
