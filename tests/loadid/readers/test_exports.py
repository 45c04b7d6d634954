"""TDMS, MDF, WAV, Parquet, Arrow, Excel and miniSEED: files that the libraries of these formats wrote."""

import datetime as dt
import importlib.util
import json

import numpy as np
import pytest

from loadid import read, read_all
from loadid._readers import outline, scan
from loadid._readers.source import NotStated
from structures._flags import codes
from structures.errors import InputError

from .exports import BEGIN, START, WRITERS, arrow_table, excel, mdf, miniseed, parquet, tdms, wav
from .files import A, F, T

G = 9.80665
BOTH = np.column_stack((F, A))


@pytest.mark.parametrize("suffix", [s for s, (library, _) in WRITERS.items() if library != "scipy"])
def test_a_library_that_lacks_is_named_with_the_line_that_brings_it(tmp_path, monkeypatch, suffix):
    library, write = WRITERS[suffix]
    pytest.importorskip(library)
    path = write(tmp_path / f"x.{suffix}")
    found = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == library else found(name))
    with pytest.raises(InputError, match=rf"not installed.*no {library}.*pip install 'loadid\[io\]'"):
        read(path)


@pytest.mark.parametrize("suffix", ["tdms", "mf4", "db3", "bag", "mseed"])
def test_the_begin_of_a_record_is_kept(tmp_path, suffix):
    library, write = WRITERS[suffix]
    pytest.importorskip(library)
    assert scan(write(tmp_path / f"x.{suffix}"))[0].start == pytest.approx(START, abs=1e-6)


# -- TDMS --------------------------------------------------------------------------------------------------------------
def test_tdms_of_labview_is_read_without_a_word(tmp_path):
    record = read(tdms(tmp_path / "x.tdms"))
    assert (record.labels, record.units, record.dt, record.name) == (("F", "a"), ("N", "g"), 0.001, "run")
    np.testing.assert_array_equal(record.values, BOTH * [1, G])
    assert not record.flags


def test_every_cut_of_a_tdms_file_is_refused_or_said(tmp_path):
    path = tdms(tmp_path / "x.tdms")
    data, silent = path.read_bytes(), []
    for n in range(1, len(data), 5):
        path.write_bytes(data[:n])
        try:
            if not all("W209" in codes(t.flags) for t in scan(path)):
                silent.append(n)
        except InputError:
            continue
    assert silent == []
    path.write_bytes(data[:-12])  # two samples of the second channel
    (table,) = scan(path)
    assert "14 of 16 samples" in table.flags[0].message
    np.testing.assert_array_equal(table.values, BOTH[:14])


def test_a_segment_of_tdms_that_was_never_closed(tmp_path):
    """LabVIEW that crashed leaves 0xFFFFFFFFFFFFFFFF for the offset of the next segment."""
    path = tdms(tmp_path / "x.tdms")
    data = path.read_bytes()
    second = data.index(b"TDSm", 4)
    path.write_bytes(data[: second + 12] + b"\xff" * 8 + data[second + 20 :])
    assert all("W209" in codes(t.flags) for t in scan(path))


@pytest.mark.parametrize("mark", [0x37, 0x6E, 0xFF])
def test_a_segment_of_tdms_with_damaged_marks_is_not_passed_over(tmp_path, mark):
    """No raw data, or numbers of the other endianness: its library drops the samples of such a segment in silence."""
    path = tdms(tmp_path / "x.tdms")
    data = path.read_bytes()
    second = data.index(b"TDSm", 4)
    path.write_bytes(data[: second + 4] + bytes([mark]) + data[second + 5 :])
    with pytest.raises(InputError, match="segment"):
        read(path)


def test_rates_and_groups_of_tdms_are_records(tmp_path):
    nptdms = pytest.importorskip("nptdms")
    stamps = np.datetime64("2026-11-24T08:00:00") + np.arange(8) * np.timedelta64(250, "ms")
    with nptdms.TdmsWriter(tmp_path / "x.tdms") as file:
        fast = [nptdms.ChannelObject("g", n, BOTH[:, i], {"wf_increment": 0.001}) for i, n in enumerate("Fa")]
        slow = nptdms.ChannelObject("g", "T", F[:8], {"wf_increment": 0.5, "unit_string": "mm"})
        text = nptdms.ChannelObject("g", "note", ["a"] * 8, {})
        logged = [nptdms.ChannelObject("scada", "Stamp", stamps), nptdms.ChannelObject("scada", "u", A[:8])]
        file.write_segment([*fast, slow, text, *logged])
    records = read_all(tmp_path / "x.tdms", units={"F": "N", "a": "g", "u": "mm"})
    assert [(r.name, r.labels, r.dt) for r in records] == [
        ("g, 1000 Hz", ("F", "a"), 0.001), ("g, 2 Hz", ("T",), 0.5), ("scada", ("u",), 0.25)
    ]  # fmt: skip
    assert "passed over: note (no numbers)" in records[0].notes


# -- MDF ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("version", ["3.30", "4.10"])
def test_mdf_with_conversions(tmp_path, version):
    record = read(mdf(tmp_path / ("x.mdf" if version < "4" else "x.mf4"), version))
    assert (record.labels, record.units, record.dt) == (("F", "a"), ("N", "g"), 0.001)
    np.testing.assert_allclose(record.values, BOTH * [1, G], rtol=1e-14, atol=1e-14)


def test_groups_invalid_samples_and_text_of_mdf(tmp_path):
    asammdf = pytest.importorskip("asammdf")
    file = asammdf.MDF(version="4.10")
    bad = np.zeros(16, bool)
    bad[3] = True
    note = asammdf.Signal(np.array([b"xy"] * 16), T, name="note", encoding="utf-8")
    file.append([asammdf.Signal(F, T, name="F", unit="N", invalidation_bits=bad), note], comment="fast")
    file.append([asammdf.Signal(A[:4], T[:4] * 10, name="a", unit="g")], comment="slow")
    angle = asammdf.Signal(A, T * 50, name="w", unit="N", master_metadata=("angle", 2))
    file.append([angle], comment="angular")
    file.save(tmp_path / "x.mf4", overwrite=True)
    file.close()
    fast, slow = read_all(tmp_path / "x.mf4")
    assert (fast.name, slow.name, fast.dt, slow.dt) == ("fast", "slow", 0.001, 0.01)
    assert np.flatnonzero(np.isnan(fast["F"])).tolist() == [3]
    said = "; ".join(fast.notes)
    for words in ("1 samples that the file marks as invalid are NaN", "passed over: note (no numbers)", "angular"):
        assert words in said


# -- WAV ---------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("kind", "full", "offset"), [("u1", 128, 128), ("<i2", 2**15, 0), ("<i4", 2**31, 0)])
def test_wav_is_calibrated_by_what_full_scale_is(tmp_path, kind, full, offset):
    counts = np.array([[0, 1], [full - 1, -full], [full // 2, -full // 2]]) + offset
    path = wav(tmp_path / "x.wav", counts.astype(kind))
    with pytest.raises(NotStated, match=r"unit of 2 channels; found: ch1, ch2"):
        read(path)
    assert "full scale is 1" in outline(path)[0].notes[0]
    record = read(path, units={"ch1": "100 g", "ch2": "5 N"})
    expected = (counts - offset) / full * [100 * G, 5]
    np.testing.assert_allclose(record.values, expected, rtol=1e-14)
    assert (record.units, [c.unit for c in record.channels]) == (("100 g", "5 N"), ["m/s^2", "N"])
    np.testing.assert_allclose(record.apply_units({"ch1": "50 g"})["ch1"], expected[:, 0] / 2, rtol=1e-14)


def test_wav_of_24_bits_and_of_floats(tmp_path):
    import wave

    counts = [0, 1, -1, 2**22, -(2**23)]
    with wave.open(str(tmp_path / "x.wav"), "wb") as file:
        file.setparams((1, 3, 51200, 0, "NONE", ""))
        file.writeframes(b"".join(c.to_bytes(3, "little", signed=True) for c in counts))
    record = read(tmp_path / "x.wav", units={0: "1 V"})
    np.testing.assert_array_equal(record.values[:, 0], np.array(counts) / 2**23)
    assert record.dt == 1 / 51200
    record = read(wav(tmp_path / "f.wav"), units={0: "N", 1: "g"})  # floats are not scaled
    np.testing.assert_array_equal(record["ch1"], F)


def test_a_cut_wav_says_how_much_is_there(tmp_path):
    path = wav(tmp_path / "x.wav", BOTH.astype("<f4"))
    data = path.read_bytes()
    start = data.index(b"data") + 8
    for n in range(start + 8, len(data)):
        path.write_bytes(data[:n])
        (table,) = scan(path)
        assert table.flags[0].message == f"truncated: {(n - start) // 8} of 16 samples"
        assert len(table.values) == (n - start) // 8
    path.write_bytes(data[:22] + b"\x09" + data[23:])
    with pytest.raises(InputError, match="header of the file is damaged"):
        scan(path)
    lost = data[: start - 4] + (64).to_bytes(4, "little") + data[start:-15]  # says less of its samples than there are
    path.write_bytes(lost)
    assert scan(path)[0].flags[0].message == f"truncated: {len(lost)} of {len(data)} bytes"
    path.write_bytes(data[:4] + b"\xff" * 4 + data[8:])  # left open by who writes as it records
    assert not scan(path)[0].flags


# -- units with a number -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("unit", ["0 g", "-1 g", "1e400 g", "3 4 g", "5", "10 xyz"])
def test_a_scale_that_is_none(tmp_path, unit):
    with pytest.raises(InputError, match="unit"):
        read(wav(tmp_path / "x.wav"), units={0: unit, 1: "g"})


def test_a_number_in_a_heading_is_no_scale(tmp_path):
    """A range beside a name, as analysers write it, never multiplies the data."""
    path = tmp_path / "x.csv"
    path.write_text("time [s],acc (5 g)\n" + "".join(f"{t},{a}\n" for t, a in zip(T, A, strict=True)))
    with pytest.raises(NotStated, match=r"acc \(5 g\)"):
        read(path)


# -- Parquet and Arrow -------------------------------------------------------------------------------------------------
def test_parquet_of_pandas(tmp_path):
    pd = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    index = pd.date_range(BEGIN, periods=16, freq="1ms", name="when")
    frame = pd.DataFrame({"F": F, "acc [g]": A, "on": [True] * 16}, index=index)
    frame.attrs = {"units": {"F": "kN"}, "operator": "x"}
    frame.iloc[2, 0] = np.nan
    frame.to_parquet(tmp_path / "x.parquet")
    record = read(tmp_path / "x.parquet")
    assert (record.labels, record.units, record.dt) == (("F", "acc"), ("kN", "g"), 0.001)
    assert np.flatnonzero(np.isnan(record["F"])).tolist() == [2]
    assert any("passed over: on (bool)" in note for note in record.notes)
    assert scan(tmp_path / "x.parquet")[0].start == START


def test_parquet_of_polars(tmp_path):
    pl = pytest.importorskip("polars")
    pytest.importorskip("pyarrow")
    pl.DataFrame({"time": T, "F [N]": F, "a": A.astype("f4")}).write_parquet(tmp_path / "x.parquet")
    record = read(tmp_path / "x.parquet", units={"a": "g"})
    np.testing.assert_array_equal(record["F"], F)
    assert record.dt == 0.001


def test_columns_without_numbers_and_nulls_of_parquet(tmp_path):
    pa = pytest.importorskip("pyarrow")
    with pytest.raises(InputError, match=r"holds no numbers.*name \(string\)"):
        read(parquet(tmp_path / "x.parquet", pa.table({"name": ["a", "b"]})))
    counts = pa.table({"n": pa.array([1, None, 3], pa.int64())}, schema=pa.schema([("n", pa.int64())]))
    record = read(parquet(tmp_path / "y.parquet", counts), fs=10, units={"n": "N"})
    np.testing.assert_array_equal(record["n"], [1, np.nan, 3])


def test_compressed_feather_and_streams(tmp_path):
    pytest.importorskip("pyarrow")
    from pyarrow import feather

    feather.write_feather(arrow_table(), tmp_path / "x.feather", compression="zstd")
    np.testing.assert_array_equal(read(tmp_path / "x.feather").values, BOTH * [1, G])


# -- Excel -------------------------------------------------------------------------------------------------------------
def test_excel_with_dates_sheets_and_formulas(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    first = book.active
    first.title = "Notes"
    first.append(["made by hand"])
    log = book.create_sheet("Log 1")
    log.append(["Date", "F [N]", "acc (g)"])
    for k in range(16):
        log.append([BEGIN.replace(tzinfo=None) + dt.timedelta(milliseconds=k), F[k], A[k] if k != 5 else None])
    other = book.create_sheet("Log 2")
    other.append(["t", "F [N]", "double"])
    for k in range(16):
        other.append([T[k], F[k], f"=2*B{k + 2}"])
    book.save(tmp_path / "x.xlsx")
    record = read(tmp_path / "x.xlsx", "Log 1")
    assert (record.labels, record.units, record.dt) == (("F", "acc"), ("N", "g"), 0.001)
    assert np.flatnonzero(np.isnan(record["acc"])).tolist() == [5]
    assert any("sheet Notes" in note for note in record.notes)
    assert scan(tmp_path / "x.xlsx")[0].start == START
    formulas = read(tmp_path / "x.xlsx", "Log 2", units={"double": "N"})
    assert np.all(np.isnan(formulas["double"]))  # nothing is evaluated


def test_excel_names_the_row_of_what_is_no_number(tmp_path):
    rows = [["t [s]", "F [N]"], *([k / 100, k % 7] for k in range(300))]
    rows[9][1] = "OVERLOAD"
    with pytest.raises(InputError, match=r"sheet Log.*line 10, column 2: 'OVERLOAD'"):
        read(excel(tmp_path / "x.xlsx", rows))


def test_excel_by_another_name(tmp_path):
    path = excel(tmp_path / "x.xlsx").rename(tmp_path / "x.csv")
    np.testing.assert_array_equal(read(path)["F"], F)
    text = tmp_path / "y.xlsx"
    text.write_text("time [s],F [N]\n0,1\n1,2\n")
    with pytest.raises(InputError, match=r"content is not Excel.*plain text"):
        read(text)


# -- miniSEED ----------------------------------------------------------------------------------------------------------
def seed(path, *traces, version=2):
    pymseed = pytest.importorskip("pymseed")
    made = pymseed.MS3TraceList()
    for name, values, rate, begin in traces:
        kind = "i" if np.asarray(values).dtype.kind == "i" else "d"
        made.add_data(f"FDSN:XX_STA_00_H_N_{name}", values, kind, rate, starttime_seconds=START + begin)
    encoding = pymseed.DataEncoding.STEIM2 if kind == "i" else pymseed.DataEncoding.FLOAT64
    made.to_file(path, overwrite=True, max_record_length=512, format_version=version, encoding=encoding)
    return path


@pytest.mark.parametrize("version", [2, 3])
def test_miniseed_with_a_gap(tmp_path, version):
    x = (np.arange(600) * 7 % 1000).astype(np.int32)
    path = seed(tmp_path / "x.mseed", ("Z", x[:300], 100.0, 0.0), ("Z", x[400:], 100.0, 4.0), version=version)
    record = read(path, units={0: "2e-6 m/s^2"})
    assert record.labels == ("XX.STA.00.HNZ",)
    assert (len(record), record.dt) == (600, 0.01)
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(record.values[:, 0])), np.arange(300, 400))
    np.testing.assert_allclose(record.values[400:, 0], x[400:] * 2e-6, rtol=1e-14)
    assert any("100 samples of XX.STA.00.HNZ are missing, first at sample 300" in note for note in record.notes)


def test_rates_and_far_pieces_of_miniseed_are_records(tmp_path):
    x = np.arange(200.0)
    path = seed(tmp_path / "x.mseed", ("Z", x, 100.0, 0.0), ("N", x, 100.0, 0.5), ("Z", x, 100.0, 3600.0),
                ("E", x, 50.0, 0.0))  # fmt: skip
    tables = scan(path)
    assert [(t.columns, len(t.values)) for t in tables] == [
        (("XX.STA.00.HNE",), 200), (("XX.STA.00.HNN", "XX.STA.00.HNZ"), 250), (("XX.STA.00.HNZ",), 200)
    ]  # fmt: skip
    assert len({t.name for t in tables}) == 3
    np.testing.assert_array_equal(tables[1].values[50:250, 0], x)


def test_a_cut_miniseed_is_said(tmp_path):
    path = seed(tmp_path / "x.mseed", ("Z", np.arange(200.0), 100.0, 0.0))
    data = path.read_bytes()
    path.write_bytes(data[:-30])
    (table,) = scan(path)
    assert "W209" in codes(table.flags)
    np.testing.assert_array_equal(table.values[:, 0], np.arange(len(table.values)))
    path.write_bytes(data[:100])
    with pytest.raises(InputError):
        scan(path)
    assert miniseed(tmp_path / "y.mseed", 3).exists()
    assert read(tmp_path / "y.mseed", units={0: "N", 1: "g"}).dt == 0.001


def test_metadata_of_arrow_that_are_no_json(tmp_path):
    pa = pytest.importorskip("pyarrow")
    table = arrow_table(operator="Ä", units=json.dumps({"F": "kN"}))
    assert read(parquet(tmp_path / "x.parquet", table)).units == ("N", "g")  # the column's own word goes first
    bare = pa.table({"F": F}, schema=pa.schema([("F", pa.float64())], metadata={"dt": "-1"}))
    with pytest.raises(InputError, match="step is not positive"):
        read(parquet(tmp_path / "y.parquet", bare), units={"F": "N"})


def test_a_begin_is_kept_to_the_last_bit(tmp_path):
    pa = pytest.importorskip("pyarrow")
    stamps = np.datetime64("2026-11-24T15:38:01.25", "ns") + np.arange(16) * np.timedelta64(1, "ms")
    (table,) = scan(parquet(tmp_path / "x.parquet", pa.table({"when": stamps, "F": F})))
    assert table.start == dt.datetime(2026, 11, 24, 15, 38, 1, 250_000, dt.UTC).timestamp()
