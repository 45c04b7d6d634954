"""Tables of pandas, polars and xarray handed to a family: the answer is that of the record that they hold."""

import warnings

import numpy as np
import pytest

from loadid import Deconvolution, Record, StaticInversion
from structures import Channel, ImpulseModel, MatrixModel
from structures.errors import InputError

DT, N = 1e-3, 80
ACC = [
    Channel(label="a1", unit="m/s^2", quantity="acceleration"),
    Channel(label="a2", unit="m/s^2", quantity="acceleration"),
]
H = 0.6 ** np.arange(30)[:, None, None] * np.array([[1.0], [0.5]])
MODEL = ImpulseModel(H, DT, kind="held", sensors=ACC, loads=[Channel(label="F", unit="N", quantity="force")])
P = np.sin(np.arange(N) / 6.0) ** 2
Y = MODEL.predict(P[:, None], DT, MODEL.default_hold) + 1e-3 * np.random.default_rng(0).standard_normal((N, 2))
WANT = np.asarray(Deconvolution(MODEL, noise=1e-3).estimate(Record(Y, DT, ACC)).load)
STATIC = MatrixModel([[2.0], [1.0]], sensors=ACC, loads=[Channel(label="F", unit="N", quantity="force")])


def frames():
    pd, pl, xr = (pytest.importorskip(name) for name in ("pandas", "polars", "xarray"))
    stamps = pd.date_range("2026-11-24", periods=N, freq="1ms")
    time = np.arange(N) * DT
    return {
        "swapped stamps": pd.DataFrame({"a2": Y[:, 1], "other": 7.0, "a1": Y[:, 0]}, index=stamps),
        "column of time": pd.DataFrame({"time": time, "a1": Y[:, 0], "a2 [m/s^2]": Y[:, 1]}),
        "g": pd.DataFrame({"a1 [g]": Y[:, 0] / 9.80665, "a2 [g]": Y[:, 1] / 9.80665}, index=stamps),
        "polars": pl.DataFrame({"time": time, "a2": Y[:, 1], "a1": Y[:, 0]}),
        "xarray": xr.DataArray(Y[:, ::-1], dims=("time", "ch"), coords={"time": time, "ch": ["a2", "a1"]}),
    }


@pytest.mark.parametrize("kind", ["swapped stamps", "column of time", "g", "polars", "xarray"])
def test_a_table_is_the_record_that_it_holds(kind):
    found = Deconvolution(MODEL, noise=1e-3).estimate(frames()[kind])
    np.testing.assert_allclose(np.asarray(found.load), WANT, rtol=1e-9, atol=1e-9)


def test_a_table_without_time_takes_dt_and_its_names():
    pd = pytest.importorskip("pandas")
    frame = pd.DataFrame({"a2": Y[:, 1], "a1": Y[:, 0]})
    found = Deconvolution(MODEL, noise=1e-3).estimate(frame, dt=DT)
    np.testing.assert_allclose(np.asarray(found.load), WANT, rtol=1e-9, atol=1e-9)
    with pytest.raises(InputError, match=r"step of a table is not known.*dt="):
        Deconvolution(MODEL).estimate(frame)


def test_a_table_in_another_unit_or_step_is_refused():
    pd = pytest.importorskip("pandas")
    stamps = pd.date_range("2026-11-24", periods=N, freq="1ms")
    with pytest.raises(InputError, match="a1: the unit of a channel does not fit"):
        Deconvolution(MODEL).estimate(pd.DataFrame({"a1 [mm]": Y[:, 0], "a2": Y[:, 1]}, index=stamps))
    with pytest.raises(InputError, match="has its own step"):
        Deconvolution(MODEL).estimate(pd.DataFrame(Y, columns=["a1", "a2"], index=stamps), dt=2e-3)
    with pytest.raises(InputError, match="no channel for a sensor"):
        Deconvolution(MODEL).estimate(pd.DataFrame(Y, columns=["a1", "b"], index=stamps))


def test_static_readings_of_a_frame_go_by_name():
    pd = pytest.importorskip("pandas")
    loads = np.array([1.0, -2.0, 3.0])
    frame = pd.DataFrame({"a2": loads, "a1": 2 * loads})
    want = StaticInversion(STATIC).estimate(np.column_stack([2 * loads, loads])).load  # in the order of the sensors
    np.testing.assert_allclose(StaticInversion(STATIC).estimate(frame).load, want, rtol=1e-12)
    np.testing.assert_allclose(np.ravel(want), loads, rtol=1e-5)
    frame.index = pd.date_range("2026-11-24", periods=3, freq="1s")
    over = StaticInversion(STATIC).estimate(frame)  # a record, as it has a time, however few its rows are
    np.testing.assert_allclose(over.load, want, rtol=1e-12)
    np.testing.assert_allclose(over.axis.values, [0, 1, 2])


def test_a_record_of_one_row_is_one_reading():
    reading = np.array([[2.0, 1.0]])
    one = StaticInversion(STATIC).estimate(Record(reading, 1.0, list(STATIC.sensors)))
    want = StaticInversion(STATIC).estimate({"a1": 2.0, "a2": 1.0})
    assert one.axis is None
    assert one.load.shape == want.load.shape == (1,)
    np.testing.assert_array_equal(one.load, want.load)
    np.testing.assert_array_equal(one.std, want.std)
    with pytest.raises(InputError, match="too few samples"):
        Deconvolution(MODEL).estimate(Record(reading, DT, list(MODEL.sensors)))


def test_quantities_of_pint_are_refused_without_a_warning():
    pint = pytest.importorskip("pint")
    q = pint.UnitRegistry().Quantity(Y, "m/s^2")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for call in (lambda: Deconvolution(MODEL).estimate(q, dt=DT), lambda: StaticInversion(STATIC).estimate(q)):
            with pytest.raises(InputError, match="quantity of pint"):
                call()
