"""Dates, times of day, epochs and zones of a log, against the calendar and the zone database of Python and pandas."""

import datetime as dt
import zoneinfo

import numpy as np
import pytest

from loadid import Record, _stamps, read, read_all
from loadid._readers import outline
from structures.errors import InputError

BEGIN = dt.datetime(2026, 11, 24, 15, 38, 1, 500_000)
BERLIN = zoneinfo.ZoneInfo("Europe/Berlin")
N = 12
VALUES = np.arange(N) / 8


def log(tmp_path, names, rows, separator=","):
    path = tmp_path / "log.csv"
    path.write_text("\n".join([separator.join(names), *(separator.join(r) for r in rows)]) + "\n", "utf-8")
    return path


def moments(step=dt.timedelta(milliseconds=250), begin=BEGIN, count=N):
    return [begin + k * step for k in range(count)]


def us(when):
    half = "AM" if when.hour < 12 else "PM"
    return f"{when.month}/{when.day}/{when.year} {(when.hour - 1) % 12 + 1}:{when:%M:%S.%f} {half}"


FORMS = {
    "ISO 8601": lambda t: t.isoformat(timespec="microseconds"),
    "ISO 8601 with Z": lambda t: t.isoformat(timespec="microseconds") + "Z",
    "compact": lambda t: f"{t:%Y%m%dT%H%M%S.%f}",
    "blank": lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f}",
    "strokes": lambda t: f"{t:%Y/%m/%d %H:%M:%S.%f}",
    "German": lambda t: f"{t:%d.%m.%Y %H:%M:%S.%f}",
    "US": us,
    "MATLAB": lambda t: f"{t:%d-%b-%Y %H:%M:%S.%f}",
    "offset": lambda t: t.replace(tzinfo=dt.UTC).astimezone(BERLIN).isoformat(timespec="microseconds"),
    "UTC in words": lambda t: f"{t:%Y-%m-%d %H:%M:%S.%f} UTC",
    "two digits": lambda t: f"{t:%d.%m.%y %H:%M:%S.%f}",
}


@pytest.mark.parametrize("form", FORMS)
def test_every_usual_form_gives_the_step_and_the_start(tmp_path, form):
    rows = [(FORMS[form](t), f"{v}") for t, v in zip(moments(), VALUES, strict=True)]
    r = read(log(tmp_path, ("time", "a [g]"), rows))
    assert (r.dt, r.start) == (0.25, BEGIN.replace(tzinfo=dt.UTC).timestamp())
    np.testing.assert_allclose(r["a"], VALUES * 9.80665)
    named = form in ("ISO 8601 with Z", "offset", "UTC in words")
    assert any("no time zone: taken as UTC" in n for n in r.notes) is not named


def test_german_commas_and_separate_columns(tmp_path):
    rows = [(f"{t:%d.%m.%Y %H:%M:%S},{t.microsecond // 1000:03d}", f"{v:.3f}".replace(".", ","))
            for t, v in zip(moments(), VALUES, strict=True)]  # fmt: skip
    r = read(log(tmp_path, ("Zeit", "a [g]"), rows, ";"))
    assert (r.dt, r.start) == (0.25, BEGIN.replace(tzinfo=dt.UTC).timestamp())
    np.testing.assert_allclose(r["a"], VALUES * 9.80665)
    parted = [(f"{t:%Y-%m-%d}", f"{t:%H:%M:%S.%f}", f"{v}") for t, v in zip(moments(), VALUES, strict=True)]
    for separator, names in ((",", ("Date", "Time", "a[g]")), (" ", ("Date", "Time", "a[g]")), (" ", ("t", "a[g]"))):
        r = read(log(tmp_path, names, parted, separator))
        assert (r.dt, r.start, r.labels) == (0.25, BEGIN.replace(tzinfo=dt.UTC).timestamp(), ("a",))


def test_times_of_day_run_on_past_midnight(tmp_path):
    begin = dt.datetime(2026, 1, 1, 23, 59, 59)
    for form in ("%H:%M:%S.%f", "%I:%M:%S.%f %p"):
        rows = [(t.strftime(form), f"{v}") for t, v in zip(moments(begin=begin), VALUES, strict=True)]
        r = read(log(tmp_path, ("time", "a [g]"), rows))
        assert (r.dt, r.start, len(r)) == (0.25, None, N)
        assert any("the date is not known" in n for n in r.notes)


@pytest.mark.parametrize(("unit", "size"), [("s", 1), ("ms", 10**3), ("us", 10**6), ("ns", 10**9)])
@pytest.mark.parametrize("stated", [False, True])
def test_epochs_are_told_by_their_size(tmp_path, unit, size, stated):
    first = 1_795_534_681
    rows = [(f"{first * size + k * size // 4}" if size > 1 else f"{first + k / 4}", f"{v}")
            for k, v in enumerate(VALUES)]  # fmt: skip
    r = read(log(tmp_path, (f"time [{unit}]" if stated else "time", "a [g]"), rows))
    assert (r.dt, r.start) == (0.25, first)
    assert stated or any(f"{unit} since 1970 by their size" in n for n in r.notes)


def test_numbers_that_are_no_epoch_stay_what_they_were(tmp_path):
    rows = [(f"{k / 4}", f"{v}") for k, v in enumerate(VALUES)]
    assert read(log(tmp_path, ("time", "a [g]"), rows)).start is None
    rows = [(f"{1_795_534_681_000 + k}", f"{v}") for k, v in enumerate(VALUES)]
    r = read(log(tmp_path, ("time [s]", "a [g]"), rows))  # what the file says is not replaced by a guess
    assert (r.dt, r.start) == (1.0, None)


def test_day_and_month_that_could_be_swapped_are_refused_with_both_readings(tmp_path):
    rows = [(f"11/12/2026 10:00:0{k}", f"{k}") for k in range(9)]
    path = log(tmp_path, ("time", "a [g]"), rows)
    with pytest.raises(InputError, match=r"2026-12-11 \(day first\) or 2026-11-12 \(month first\).*--unit time=DD/MM"):
        read(path)
    found = {order: read(path, units={"time": order}).start for order in ("DD/MM/YYYY", "MM/DD/YYYY")}
    assert found["DD/MM/YYYY"] == dt.datetime(2026, 12, 11, 10, tzinfo=dt.UTC).timestamp()
    assert found["MM/DD/YYYY"] == dt.datetime(2026, 11, 12, 10, tzinfo=dt.UTC).timestamp()
    same = log(tmp_path, ("time", "a [g]"), [(f"11/11/2026 10:00:0{k}", f"{k}") for k in range(9)])
    assert read(same).start == dt.datetime(2026, 11, 11, 10, tzinfo=dt.UTC).timestamp()
    days = [(f"{d}/11/2026", f"{d}") for d in range(9, 16)]  # the column decides
    assert read(log(tmp_path, ("time", "a [g]"), days)).dt == 86_400
    mixed = log(tmp_path, ("time", "a [g]"), [("13/11/2026", "1"), ("11/14/2026", "2"), ("15/11/2026", "3")])
    with pytest.raises(InputError, match="two orders"):
        read(mixed)


def walked(begin, minutes):
    """Local stamps of Berlin, one a minute, from a moment in UTC."""
    times = [begin + dt.timedelta(minutes=k) for k in range(minutes)]
    return [(t.astimezone(BERLIN).strftime("%Y-%m-%d %H:%M:%S"), f"{k}") for k, t in enumerate(times)]


@pytest.mark.parametrize("before", [90, 45, 20, 0])
def test_the_end_of_summer_time_is_resolved_where_the_zone_is_stated(tmp_path, before):
    begin = dt.datetime(2026, 10, 25, 1, tzinfo=dt.UTC) - dt.timedelta(minutes=before)
    path = log(tmp_path, ("time", "a [g]"), walked(begin, before + 200))
    r = read(path, units={"time": "Europe/Berlin"})
    assert (r.dt, len(r)) == (60, before + 200)
    assert np.isfinite(r.values).all()
    assert r.start == begin.timestamp()
    if before:
        with pytest.raises(InputError, match="summer time ends"):
            read(path)


def test_the_begin_of_summer_time_is_said_and_resolved(tmp_path):
    begin = dt.datetime(2026, 3, 29, 0, tzinfo=dt.UTC)
    path = log(tmp_path, ("time", "a [g]"), walked(begin, 600))
    r = read(path)
    assert len(r) == 660  # an hour of nothing
    assert any("where summer time begins there, state the zone of" in n for n in r.notes)
    r = read(path, units={"time": "Europe/Berlin"})
    assert (len(r), r.start) == (600, begin.timestamp())
    never = log(tmp_path, ("time", "a [g]"), [(f"2026-03-29 02:{m:02d}:00", "1") for m in range(9)])
    with pytest.raises(InputError, match="no such time: summer time begins"):
        read(never, units={"time": "Europe/Berlin"})


def test_zones_against_pandas():
    pd = pytest.importorskip("pandas")
    rng = np.random.default_rng(0)
    for zone in ("Europe/Berlin", "America/New_York", "Australia/Lord_Howe", "Asia/Kolkata", "Pacific/Apia"):
        begin = pd.Timestamp("2026-01-01", tz="UTC")
        times = begin + pd.to_timedelta(np.cumsum(rng.integers(1, 3600, 20_000)), unit="s")
        local = times.tz_convert(zone).tz_localize(None)
        apart = np.diff(local.to_numpy()).min() > np.timedelta64(0)
        found = _stamps.of_texts([str(t) for t in local], "here", zone)
        expected = (times - times[0]).total_seconds().to_numpy()
        if apart:  # no clock that goes back: whatever is twice cannot be told, all else is exact
            away = found.seconds - expected
            assert np.mean(away == 0) > 0.999
        else:
            np.testing.assert_array_equal(found.seconds, expected)
        assert found.start == times[0].timestamp()


@pytest.mark.parametrize(
    ("cell", "match"),
    [
        ("2026-02-30 10:00:00", "no such day"),
        ("2026-02-28 25:00:00", "no such time of day"),
        ("2026-02-28 10:00:00 XYZT", "line 7.*XYZT"),
        ("2026-02-28 10:00:00Z", "only some stamps have a time zone"),
        ("", "no time stamp"),
        ("soon", "line 7: 'soon,1'"),
    ],
)
def test_a_bad_stamp_is_named(tmp_path, cell, match):
    rows = [(f"{t:%Y-%m-%d %H:%M:%S.%f}", "1") for t in moments()]
    rows[5] = (cell, "1")
    with pytest.raises(InputError, match=match):
        read(log(tmp_path, ("time", "a [g]"), rows))


def test_dropped_samples_are_gaps_and_other_stamps_only_begin_the_record(tmp_path):
    rows = [(f"{t:%Y-%m-%d %H:%M:%S.%f}", "1") for k, t in enumerate(moments(count=40)) if k not in (7, 8)]
    r = read(log(tmp_path, ("time", "a [g]"), rows))
    assert np.flatnonzero(np.isnan(r["a"])).tolist() == [7, 8]
    rows = [(f"{BEGIN:%Y-%m-%d %H:%M:%S}", f"{k / 100}", "1") for k in range(9)]
    r = read(log(tmp_path, ("stamp", "time [s]", "a [g]"), rows))
    assert (r.dt, r.start) == (0.01, BEGIN.replace(microsecond=0, tzinfo=dt.UTC).timestamp())
    with pytest.raises(InputError, match="no rows of numbers"):
        read(log(tmp_path, ("stamp", "b"), [(f"{t:%Y-%m-%d}", f"{t:%H:%M:%S}") for t in moments()]))


def test_a_zone_that_is_none_and_a_name_that_is_none(tmp_path):
    rows = [(f"{t:%Y-%m-%d %H:%M:%S.%f}", "1") for t in moments()]
    path = log(tmp_path, ("logged at", "a [g]"), rows)
    assert read(path, units={"time": "UTC+1"}).start == read(path, units={"logged at": "+01:00"}).start
    assert read(path, units={"time": "UTC+1"}).start == read(path).start - 3600
    with pytest.raises(InputError, match=r"no such unit.*Berlin"):
        read(path, units={"time": "Bielefeld"})
    with pytest.raises(InputError, match="no channel 'b'"):
        read(path, units={"b": "UTC"})
    assert outline(path)[0].dt == 0.25
    assert read_all(path)[0].start == read(path).start


def test_records_know_when_they_began():
    r = Record(np.arange(10.0), 0.5, "a", start="2026-11-24T15:38:01.5Z")
    assert r.start == BEGIN.replace(tzinfo=dt.UTC).timestamp()
    assert r.window(1.0, 3.0).start == r.start + 1.0
    assert r.select("a").start == r.apply_units({"a": "g"}).start == r.start
    assert Record([1.0], 1, start=BEGIN).start == Record([1.0], 1, start=np.datetime64(BEGIN)).start == r.start
    assert "2026-11-24T15:38:01.5" in repr(r)
    assert Record([1.0], 1).start is None
    for bad in ("yesterday", np.nan, "11/12/2026 10:00", np.datetime64("NaT"), [1, 2]):
        with pytest.raises(InputError, match="no moment"):
            Record([1.0], 1, start=bad)
