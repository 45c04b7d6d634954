"""Records as tables of other libraries and as files of other tools, and back: every bit, name and unit."""

import numpy as np
import pytest

from loadid import Record, Spectra, StaticInversion, read
from loadid._readers.source import known_suffixes
from structures import Channel, MatrixModel
from structures.errors import InputError, reals

RNG = np.random.default_rng(3)
CHANNELS = (
    Channel(label="12+Z", quantity="acceleration", unit="m/s^2"),
    Channel(label="hammer", quantity="force", unit="N"),
    Channel(label="ε foot, left", quantity="strain", unit="m/m"),
)
STEPS = (1e-3, 1 / 51_200, 1 / 44_100, 0.01234567890123, 3.7)
START = "2026-11-24T15:38:01.25Z"


def record(dt=1e-3, start=None, n=64):
    values = RNG.normal(size=(n, 3)) * 10.0 ** RNG.uniform(-12, 6, (n, 3))
    values[5, 1] = np.nan
    return Record(values, dt, CHANNELS, name="run 7", start=start)


def same(found, r, exactly=True):
    assert np.array_equal(found.values, r.values, equal_nan=True)
    assert found.labels == r.labels
    assert [(c.quantity, c.unit) for c in found.channels] == [(c.quantity, c.unit) for c in r.channels]
    assert found.start == r.start
    assert found.dt == r.dt if exactly else found.dt == pytest.approx(r.dt, rel=1e-9)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".uff", ".parquet"])
@pytest.mark.parametrize("start", [None, START])
@pytest.mark.parametrize("dt", STEPS)
def test_files_come_back_bit_for_bit(tmp_path, suffix, dt, start):
    r = record(dt, start)
    path = tmp_path / f"r{suffix}"
    if suffix == ".parquet":
        pytest.importorskip("pyarrow")
    getattr(r, {".csv": "to_csv", ".mat": "to_mat", ".uff": "to_uff", ".parquet": "to_parquet"}[suffix])(path)
    if suffix not in known_suffixes():
        pytest.skip("nothing reads it")
    # stamps in text hold nanoseconds: the step of no round number is known to their rounding alone
    same(read(path), r, exactly=not (suffix == ".csv" and start and dt == STEPS[3]))


def test_universal_files_against_pyuff(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    r = record(start=START)
    r.to_uff(tmp_path / "r.uff")
    sets = [s for s in pyuff.UFF(str(tmp_path / "r.uff")).read_sets() if s["type"] == 58]
    for k, (one, channel) in enumerate(zip(sets, r.channels, strict=True)):
        assert np.array_equal(one["data"], r.values[:, k], equal_nan=True)
        assert one["abscissa_inc"] == r.dt
        assert one["ordinate_axis_units_lab"].strip() == channel.unit
    assert (sets[0]["rsp_node"], sets[0]["rsp_dir"]) == (12, 3)
    assert sets[1]["ordinate_axis_lab"].strip() == "hammer"
    long = Record(np.ones((3, 1)), 1, Channel(label="x" * 21, quantity="force", unit="N"))
    with pytest.raises(InputError, match="does not fit into a universal file"):
        long.to_uff(tmp_path / "long.uff")
    assert not (tmp_path / "long.uff").exists()


def test_mat_against_scipy_and_parquet_against_pyarrow(tmp_path):
    from scipy.io import loadmat

    r = record()
    r.to_mat(tmp_path / "r.mat")
    found = loadmat(tmp_path / "r.mat")
    assert np.array_equal(found["data"], r.values, equal_nan=True)
    assert found["dt"].item() == r.dt
    assert found["channels"].item().split("\n") == list(r.labels)
    parquet = pytest.importorskip("pyarrow.parquet")
    r.to_parquet(tmp_path / "r.parquet")
    table = parquet.read_table(tmp_path / "r.parquet")
    assert table.column_names == ["time", *r.labels]
    assert [f.metadata[b"unit"].decode() for f in table.schema] == ["s", "m/s^2", "N", "m/m"]
    assert np.array_equal(table["hammer"].to_numpy(), r["hammer"], equal_nan=True)


def test_a_suffix_of_another_format_is_refused_and_nothing_is_left(tmp_path):
    for name in ("to_csv", "to_mat", "to_uff", "to_parquet"):
        with pytest.raises(InputError, match="another format"):
            getattr(record(), name)(tmp_path / "r.h5")
        suffix = {"to_csv": ".csv", "to_mat": ".mat", "to_uff": ".uff", "to_parquet": ".pq"}[name]
        with pytest.raises(InputError, match="cannot be written"):
            getattr(record(), name)(tmp_path / "none" / f"r{suffix}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("start", [None, START])
@pytest.mark.parametrize("dt", STEPS)
def test_dataframes_and_arrays_come_back_bit_for_bit(dt, start):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    r = record(dt, start)
    frame = r.to_dataframe()
    assert list(frame.columns) == list(r.labels)
    same(Record.from_dataframe(frame), r)
    array = r.to_xarray()
    assert array.dims == ("time", "channel")
    same(Record.from_xarray(array), r)
    frame.iloc[0, 0] = 99.0  # what is handed out is nobody's
    assert r.values[0, 0] != 99.0
    half = Record.from_dataframe(frame.iloc[::2])  # what the frame says beside its index is no longer so
    assert half.dt == pytest.approx(2 * dt, rel=1e-9)


def test_frames_of_pandas_as_people_have_them():
    pd = pytest.importorskip("pandas")
    t = pd.date_range("2026-11-24 15:38", periods=20, freq="10ms")
    values = RNG.normal(size=20)
    local = pd.DataFrame({"a [g]": values, "note": "x"}, index=t.tz_localize("Europe/Berlin"))
    r = Record.from_dataframe(local)
    assert (r.dt, r.labels, r.start) == (0.01, ("a",), pd.Timestamp("2026-11-24 14:38", tz="UTC").timestamp())
    np.testing.assert_allclose(r["a"], values * 9.80665)
    assert any("passed over: note" in n for n in r.notes)
    column = pd.DataFrame({"when": t, "a": values})
    assert Record.from_dataframe(column, units={"a": "N"}).dt == 0.01
    zoned = pd.DataFrame({"when": t.tz_localize("Europe/Berlin"), "a": values})
    assert Record.from_dataframe(zoned, units={"a": "N"}).start == r.start
    assert Record.from_dataframe(pd.DataFrame({"time": np.arange(20) / 8, "a [N]": values})).dt == 0.125
    assert Record.from_dataframe(pd.DataFrame({"a [N]": values}), fs=50).dt == 0.02
    spans = pd.DataFrame({"a [N]": values}, index=pd.to_timedelta(np.arange(20) / 4, unit="s"))
    assert Record.from_dataframe(spans).dt == 0.25
    with pytest.raises(InputError, match="unit of a channel"):
        Record.from_dataframe(column)
    with pytest.raises(InputError, match="sampling frequency is not known"):
        Record.from_dataframe(pd.DataFrame({"a [N]": values}))
    with pytest.raises(InputError, match="doubled"):
        Record.from_dataframe(pd.DataFrame(np.ones((5, 2)), columns=["a", "a"]))
    with pytest.raises(InputError, match="no DataFrame"):
        Record.from_dataframe(values)
    late = column.assign(when=column["when"].where(column.index != 3))
    with pytest.raises(InputError, match="stamp is missing"):
        Record.from_dataframe(late, units={"a": "N"})


def test_frames_of_polars():
    pl = pytest.importorskip("polars")
    import datetime as dt

    when = [dt.datetime(2026, 11, 24, 15, 38) + k * dt.timedelta(milliseconds=10) for k in range(20)]
    r = Record.from_dataframe(pl.DataFrame({"t": when, "a [N]": np.arange(20.0)}))
    assert (r.dt, r.start) == (0.01, dt.datetime(2026, 11, 24, 15, 38, tzinfo=dt.UTC).timestamp())
    assert r["a"].tolist() == list(range(20))
    assert Record(pl.DataFrame({"a": [1.0, 2.0], "b": [3.0, 4.0]}), 1).labels == ("a", "b")


def test_records_of_frames_quantities_and_masked_arrays():
    pd = pytest.importorskip("pandas")
    pint = pytest.importorskip("pint")
    u = pint.UnitRegistry()
    assert Record(pd.DataFrame({"a": [1.0, 2.0], "b": [3.0, 4.0]}), 1).labels == ("a", "b")
    with pytest.raises(InputError, match="from_dataframe"):
        Record(pd.DataFrame({"time": [0.0, 1.0], "b": [3.0, 4.0]}), 1)
    r = Record(np.array([[1.0], [2.0]]) * u.kilonewton, 5 * u.millisecond)
    assert (r.dt, r.channels[0].unit, r.channels[0].quantity) == (0.005, "N", "force")
    assert r.values.ravel().tolist() == [1000.0, 2000.0]
    inch = Record(np.ones(3) * u.inch, 1.0, CHANNELS[2].label)
    assert (inch.channels[0].unit, inch.values[0, 0]) == ("m", pytest.approx(0.0254))
    for values, dt, match in (
        (np.ones(3) * u.kelvin * u.candela, 1, "not read"),
        (np.ones(3) * u.N, 1 * u.m, "no time"),
    ):
        with pytest.raises(InputError, match=match):
            Record(values, dt)
    with pytest.raises(InputError, match="another unit than the channel"):
        Record(np.ones(3) * u.kilonewton, 1, CHANNELS[0])
    hidden = np.ma.masked_equal([[1.0], [999.0], [3.0]], 999.0)
    assert np.isnan(Record(hidden, 1).values[1, 0])
    for door in (lambda x: Spectra([1.0, 2.0, 3.0], x), lambda x: MatrixModel(x), lambda x: reals(x, where="here")):
        with pytest.raises(InputError, match=r"pint|no numbers"):  # a door that cannot know the unit takes none
            door(np.ones(3) * u.N)


def test_estimates_as_tables():
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    e = StaticInversion(MatrixModel(np.array([[1.0, 0.2], [0.1, 1.0], [0.4, 0.7]]))).estimate([1.0, 2.0, 1.5])
    frame, data = e.to_dataframe(), e.to_xarray()
    assert frame["load"].tolist() == e.load.tolist()
    assert frame["std"].tolist() == e.std.tolist()
    assert list(frame.index) == list(e.labels)
    assert np.array_equal(data["load"], e.load)
    assert np.array_equal(data["std"].sel(label=e.labels[1]), e.std[1])


def test_a_history_as_tables():
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    from loadid._results.estimate import Axis, LoadEstimate

    load = RNG.normal(size=(8, 2))
    e = LoadEstimate(
        load=load, std=np.abs(load), labels=("F", "G"), units=("N", "N"), axis=Axis("time", "s", np.arange(8) / 4)
    )
    frame = e.to_dataframe()
    assert list(frame.columns) == ["F", "F std", "G", "G std"]
    assert frame.index.name == "time [s]"
    assert frame["G"].to_numpy().tolist() == load[:, 1].tolist()
    data = e.to_xarray()
    assert data["std"].dims == ("time", "label")
    assert data["load"].sel(time=0.5, label="G").item() == load[2, 1]
