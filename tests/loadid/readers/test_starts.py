"""`Record.start` over the formats that write dates without a zone: UTC, or the zone that is stated."""

import datetime as dt

import numpy as np
import pytest

from loadid import Record, read

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


def frame(zone):
    pd = pytest.importorskip("pandas")
    made = pd.DataFrame({"F [N]": Y}, index=pd.DatetimeIndex(LOCAL, name="when"))
    return Record.from_dataframe(made, units=None if zone is None else {"when": zone})


WRITERS = {"csv": csv, "xlsx": excel, "parquet": arrow, "feather": arrow}


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


def test_a_stated_zone_does_not_move_stamps_in_utc(tmp_path):
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    stamps = pa.array(LOCAL, pa.timestamp("ms", tz="UTC"))
    parquet.write_table(pa.table({"when": stamps, "F [N]": Y}), tmp_path / "x.parquet")
    assert read(tmp_path / "x.parquet", units={"when": "Europe/Berlin"}).start == UTC
