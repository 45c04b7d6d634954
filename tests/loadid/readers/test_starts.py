"""`Record.start` over the formats that write dates without a zone: UTC, or the zone that is stated."""

import datetime as dt

import numpy as np
import pytest

from loadid import Record, read
from tests.structures.uff_made import text58

from .files import lvm

LOCAL = [dt.datetime(2026, 7, 1, 12, 30, 0) + dt.timedelta(milliseconds=250 * k) for k in range(8)]
UTC = LOCAL[0].replace(tzinfo=dt.UTC).timestamp()
Y = np.arange(8.0) ** 2


def csv(path):
    path.write_text("when,F [N]\n" + "".join(f"{t.isoformat(' ')},{y}\n" for t, y in zip(LOCAL, Y, strict=True)))


def excel(path):
    book = pytest.importorskip("openpyxl").Workbook()
    for row in [["when", "F [N]"], *zip(LOCAL, Y.tolist(), strict=True)]:
        book.active.append(list(row))
    book.save(path)


def arrow(path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import feather, parquet

    table = pa.table({"when": pa.array(LOCAL, pa.timestamp("ms")), "F [N]": Y})
    (parquet.write_table if path.suffix == ".parquet" else feather.write_feather)(table, path)


def uff(path):
    text = text58(Y, response=("F", 0, 0), ordinate=(13, "N"), function=1, step=0.25, abscissa=("time", "s"),
                  denominator=(0, "NONE"), ids=("NONE", "NONE", "01-Jul-26 12:30:00", "NONE", "NONE"))  # fmt: skip
    path.write_bytes(text)


def matlab(path):
    scipy_io = pytest.importorskip("scipy.io")
    scipy_io.savemat(path, {"F": Y, "dt": 0.25, "units": "N", "start": "2026-07-01 12:30:00"})


def labview(path):
    text = lvm(records=1, samples=8).replace("Date\t2020/01/01\t2020/01/01", "Date\t2026/07/01\t2026/07/01\n"
                                             "Time\t12:30:00,000000\t12:30:00,000000")  # fmt: skip
    rows = text.splitlines()
    first = next(k for k, row in enumerate(rows) if row.startswith("X_Value")) + 1
    rows[first:] = [f"\t{y}\t0" for y in Y]
    path.write_text("\n".join(rows).replace("0.001000", "0.250000") + "\n")


def frame(zone):
    pd = pytest.importorskip("pandas")
    made = pd.DataFrame({"F [N]": Y}, index=pd.DatetimeIndex(LOCAL, name="when"))
    return Record.from_dataframe(made, units=None if zone is None else {"when": zone})


WRITERS = {"csv": csv, "xlsx": excel, "parquet": arrow, "feather": arrow}
BEGUN = {"uff": uff, "mat": matlab, "lvm": labview}  # that state when they began, by a text


@pytest.mark.parametrize("zone", [None, "Europe/Berlin", "UTC+3"])
@pytest.mark.parametrize("suffix", [*WRITERS, "pandas"])
def test_one_moment_in_all_formats(tmp_path, suffix, zone):
    if suffix == "pandas":
        record = frame(zone)
    else:
        WRITERS[suffix](tmp_path / f"x.{suffix}")
        record = read(tmp_path / f"x.{suffix}", units=None if zone is None else {"when": zone})
    hours = {None: 0, "Europe/Berlin": 2, "UTC+3": 3}[zone]  # summer time in Berlin
    assert record.start == UTC - 3600 * hours
    assert (record.dt, record.labels, record.units) == (0.25, ("F",), ("N",))
    np.testing.assert_array_equal(record["F"], Y)
    assert any(("taken as UTC" if zone is None else "time zone") in note for note in record.notes)


@pytest.mark.parametrize("zone", [None, "Europe/Berlin", "UTC+3"])
@pytest.mark.parametrize("suffix", BEGUN)
def test_a_start_that_is_a_text_is_in_the_zone_that_is_stated(tmp_path, suffix, zone):
    BEGUN[suffix](tmp_path / f"x.{suffix}")
    record = read(tmp_path / f"x.{suffix}", units=None if zone is None else {"time": zone})
    assert record.start == UTC - 3600 * {None: 0, "Europe/Berlin": 2, "UTC+3": 3}[zone]
    assert record.dt == 0.25
    np.testing.assert_array_equal(record["F"], Y)
    assert any(("taken as UTC" if zone is None else "time zone") in note for note in record.notes)


def test_a_start_with_two_readings_is_said_and_can_be_stated(tmp_path):
    import scipy.io

    scipy.io.savemat(tmp_path / "x.mat", {"F": Y, "dt": 0.25, "units": "N", "start": "01/07/2026 12:30:00"})
    record = read(tmp_path / "x.mat")
    assert record.start is None
    assert any("when it began is not read: '01/07/2026 12:30:00'" in note for note in record.notes)
    assert read(tmp_path / "x.mat", units={"time": "DD/MM/YYYY Europe/Berlin"}).start == UTC - 7200


def test_a_stated_zone_does_not_move_stamps_in_utc(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    stamps = pa.array(LOCAL, pa.timestamp("ms", tz="UTC"))
    parquet.write_table(pa.table({"when": stamps, "F [N]": Y}), tmp_path / "x.parquet")
    assert read(tmp_path / "x.parquet", units={"when": "Europe/Berlin"}).start == UTC
