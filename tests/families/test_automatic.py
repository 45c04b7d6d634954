"""What `AutomaticInversion` takes: by the kind of data; of priors the plain one unless another is clearly better."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from loadid import (
    AutomaticInversion,
    Deconvolution,
    FrequencyInversion,
    InputError,
    Penalty,
    Record,
    Spectra,
    StaticInversion,
)
from loadid._families import automatic
from loadid._families.automatic import kind_of, stated
from structures import ForwardModel, FrfModel, MatrixModel, bases, beams, damping, loads, sensors

RATE = 800.0


def beam(elements: int) -> object:
    return beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=elements,
        damping=damping.Modal(0.02),
    )  # fmt: skip


def forward(kind: type, elements: int = 16, modes: int = 5, at: tuple[float, ...] = (0.7,)) -> ForwardModel:
    seen = [kind(at=x, direction="+Z", label=f"s{i}") for i, x in enumerate((0.5, 1.3))]
    return ForwardModel(beam(elements), seen, [loads.Point(at=x, direction="+Z") for x in at], modes=modes)


def record(kind: type, force: np.ndarray, noise: float = 0.05) -> np.ndarray:
    """Of a finer mesh with twice the modes; a step four times finer."""
    truth = forward(kind, 40, 10)
    fine = np.interp(np.arange(4 * len(force)) / 4, np.arange(len(force)), force)
    y = truth.predict(fine[:, None], 1 / RATE / 4)[::4]
    return y + noise * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)


SLOW = 20 * np.convolve(np.random.default_rng(3).standard_normal(349), np.hanning(52)[1:-1], "valid")
HIT = np.zeros(300)
HIT[100:112] = 100 * np.sin(np.pi * np.arange(12) / 12)


def test_a_slow_load_is_smooth_and_comes_out_better() -> None:
    y = record(sensors.Displacement, SLOW)
    model = forward(sensors.Displacement)
    said: list[tuple[float, str]] = []
    plain = Deconvolution(model).estimate(y, 1 / RATE)
    auto = AutomaticInversion(model, progress=lambda *told: said.append(told)).estimate(y, 1 / RATE)
    assert [fraction for fraction, text in said if text == "done"] == [1.0]
    assert (0.5, "plain prior: done") in said
    error = [np.linalg.norm(e.load[:, 0] - SLOW) / np.linalg.norm(SLOW) for e in (plain, auto)]
    assert auto.facts["variance"] == "smooth"
    assert error[1] < 0.8 * error[0]
    assert "smooth over" in auto.facts.chosen
    assert "\n" not in auto.facts.chosen
    own = Deconvolution(model, penalty=Penalty(variance="smooth")).estimate(y, 1 / RATE)
    np.testing.assert_array_equal(auto.load, own.load)
    assert stated(auto) < automatic.SMALLER * stated(plain)
    inside = np.abs(auto.load[:, 0] - SLOW) < 1.96 * auto.std[:, 0]
    assert inside.mean() > 0.9


@pytest.mark.parametrize(
    ("kind", "force", "more"),
    [
        (sensors.Displacement, HIT, {}),  # impacts, for which the record itself asks
        (sensors.Accelerometer, SLOW, {}),  # no sensor sees its slow part
        (sensors.Displacement, SLOW, {"support": (0.0, 0.3)}),
    ],
)
def test_else_it_is_the_plain_one(kind: type, force: np.ndarray, more: dict) -> None:
    y, model = record(kind, force), forward(kind)
    auto = AutomaticInversion(model, **more).estimate(y, 1 / RATE)
    plain = Deconvolution(model, **more).estimate(y, 1 / RATE)
    np.testing.assert_array_equal(auto.load, plain.load)
    np.testing.assert_array_equal(auto.std, plain.std)
    assert auto.facts.chosen.startswith("Deconvolution: ")


def test_loads_that_slow_sensors_do_not_tell_apart_stay_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    model = forward(sensors.Displacement, at=(0.70, 0.74))
    y = record(sensors.Displacement, SLOW)
    assert "do not tell" in AutomaticInversion(model)._lacking(y, 1 / RATE, len(y))
    monkeypatch.setattr(automatic, "MIXED", 1e12)
    assert not AutomaticInversion(model)._lacking(y, 1 / RATE, len(y))


def patched() -> ForwardModel:
    own = beam(32)
    seen = [
        sensors.Displacement(at=x, direction="+Z", label=f"d{i}") for i, x in enumerate(np.linspace(0.15, 1.85, 12))
    ]
    return ForwardModel(own, seen, bases.patches(own, 24), modes=8)


def test_a_load_whose_variance_was_learned_away_is_none_without_error() -> None:
    """A slow one beside a sweep that is three times as large, by three sensors, of a finer mesh behind a filter."""

    def cantilever(elements: int, modes: int) -> ForwardModel:
        structure = beams.cantilever(length=0.5, section=beams.Section.rectangle(0.04, 0.008), elements=elements,
                                     material=beams.materials.steel, damping=damping.Modal(0.01))  # fmt: skip
        seen = [sensors.StrainGauge(at=0.06, fibre=0.004, label="gauge"), sensors.Displacement(at=0.3),
                sensors.Accelerometer(at=0.38)]  # fmt: skip
        return ForwardModel(structure, seen, [loads.Point(at=0.3), loads.Point(at=0.42)], modes=modes)

    t = np.arange(8 * 500) / 32_000
    slow, sweep = 3.3 * np.sin(2 * np.pi * 8 * t), 10 * np.sin(2 * np.pi * (20 * t + 1200 * t**2))
    g = np.column_stack([slow * np.minimum(1, t / 0.03), sweep])
    y = sosfiltfilt(butter(8, 1700, fs=32_000, output="sos"), cantilever(50, 12).predict(g, 1 / 32_000), axis=0)[::8]
    y, model = y + 0.03 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape), cantilever(25, 8)
    smooth = Deconvolution(model, penalty=Penalty(variance="smooth")).estimate(y, 1 / 4000)
    assert np.mean(np.abs(smooth.load - g[::8]) < 1.96 * smooth.std) < 0.5  # which is why
    auto = AutomaticInversion(model).estimate(y, 1 / 4000)
    assert np.mean(np.abs(auto.load - g[::8]) < 1.96 * auto.std) > 0.9
    assert "learned away" in auto.facts.chosen


def test_a_smooth_static_field_is_told_by_sensors_that_the_others_predict() -> None:
    model = patched()
    x = (np.arange(24) + 0.5) / 24
    load = 100 + 40 * x
    y = model.static() @ load
    y = y * (1 + 1e-4 * np.random.default_rng(1).standard_normal(len(y)))
    found = {p: StaticInversion(model, penalty=p).estimate(y) for p in ("identity", "gradient", "laplacian")}
    auto = AutomaticInversion(model).estimate(y)
    taken = next(p for p, e in found.items() if np.array_equal(e.load, auto.load))
    error = {p: np.linalg.norm(e.load - load) for p, e in found.items()}
    assert taken != "identity"
    assert error[taken] < error["identity"]
    assert f"penalty={taken!r}" in auto.facts.chosen


def test_predicted_sensors_are_those_of_fits_without_them() -> None:
    """The short way through the hat matrix against leaving every sensor out, lambda held."""
    from loadid._families.data import readings

    model, rng = patched(), np.random.default_rng(2)
    y = model.static() @ (50 + 10 * rng.standard_normal(24))
    family = StaticInversion(model, penalty="gradient", noise=1e-6)
    given = readings(y, model, None)
    posed = family.pose(given)
    lam = family.choose(posed).lam * float(posed.path.scale)
    H, L, data = posed.base.problem.H, posed.base.problem.L, posed.base.problem.y
    left = []
    for i in range(len(data)):
        keep = np.arange(len(data)) != i
        A = np.vstack([H[keep], lam * L])
        g = np.linalg.lstsq(A, np.r_[data[keep], np.zeros(len(L))], rcond=None)[0]
        left.append(data[i] - H[i] @ g)
    expected = np.linalg.norm(left) / np.linalg.norm(data)
    assert automatic._tried(family, given).error == pytest.approx(expected, rel=1e-5)


def test_a_field_that_is_refused_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sensors and penalty whose null spaces nearly meet (LID-E306): the plain prior answers."""
    model = patched()
    y = model.static() @ (100 + 40 * (np.arange(24) + 0.5) / 24)
    monkeypatch.setattr("loadid._families.static.MEETING", np.inf)
    assert "penalty='identity'" in AutomaticInversion(model).estimate(y).facts.chosen


def test_the_kind_of_data() -> None:
    model = forward(sensors.Displacement)
    f = np.linspace(5, 100, 20)
    tabled = FrfModel.of(model, f)
    two = Record(np.ones((9, 2)), 1 / RATE, [s.label for s in model.sensors])
    spectra = Spectra(f, model.frf(f)[..., 0])
    assert kind_of(model, two) == "history"
    assert kind_of(model, np.ones(2)) == "static"
    assert kind_of(model, np.ones((9, 2)), 0.1) == "history"
    assert kind_of(model, {"s0": 1.0, "s1": 2.0}) == "static"
    assert kind_of(tabled, two) == "lines"
    assert kind_of(model, spectra) == "lines"
    assert kind_of(MatrixModel.of(np.eye(2)), two) == "static"
    with pytest.raises(InputError, match="no family takes"):
        kind_of(tabled, {"s0": 1.0})
    own = FrequencyInversion(tabled).estimate(spectra)
    auto = AutomaticInversion(tabled).estimate(spectra)
    np.testing.assert_array_equal(auto.load, own.load)


@pytest.mark.parametrize(
    ("given", "data", "where"),
    [
        ({"support": (0.0, 0.1)}, {"s0": 1.0, "s1": 2.0}, "support"),
        ({"band": (5.0, 50.0)}, np.ones((300, 2)), "band"),
        ({"signal": "transient"}, {"s0": 1.0, "s1": 2.0}, "signal"),
    ],
)
def test_a_setting_of_other_data_is_refused(given: dict, data: object, where: str) -> None:
    with pytest.raises(InputError) as caught:
        AutomaticInversion(forward(sensors.Displacement), **given).estimate(
            data, 1 / RATE if isinstance(data, np.ndarray) else None
        )
    assert caught.value.where == where


def test_it_travels() -> None:
    y, model = record(sensors.Displacement, HIT), forward(sensors.Displacement)
    one = AutomaticInversion(model, noise=1e-6)
    again = pickle.loads(pickle.dumps(one))
    np.testing.assert_array_equal(one.estimate(y, 1 / RATE).load, again.estimate(y, 1 / RATE).load)
