"""Static inversion: against closed forms, a dense reference, and what a user does wrong."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Absolute, InputError, Noise, NotIdentifiable, Record, StaticInversion, load
from loadid._families.frozen import Frozen
from loadid._spellings import folded
from loadid.constraints import NonNegative, Resultant, Support
from structures import Channel, ForwardModel, MatrixModel, bases, beams, loads, sensors
from structures._flags import codes

BEAM = {"length": 2.0, "EI": 1e4, "mass_per_length": 1.0, "elements": 20}


def gauges(count=6, noise=1e-6) -> list:
    return [
        sensors.StrainGauge(at=float(x), fibre=0.01, label=f"g{i}", noise=noise)
        for i, x in enumerate(np.linspace(0.1, 1.7, count))
    ]


def wing(count=6, noise=1e-6) -> ForwardModel:
    return ForwardModel(beams.cantilever(**BEAM), gauges(count, noise), [loads.Point("20+Z"), loads.Point("10+Z")])


def smooth(n=24, m=16, seed=0) -> MatrixModel:
    x, s = (np.arange(n) + 0.5) / n, (np.arange(m) + 0.5) / m
    H = 0.1 / np.pi / (0.01 + (s[:, None] - x) ** 2) / n
    return MatrixModel(H, sensors=[Channel(label=f"s{i}", quantity="displacement", unit="m") for i in range(m)])


def bump(n=24) -> np.ndarray:
    x = (np.arange(n) + 0.5) / n
    return np.exp(-(((x - 0.4) / 0.12) ** 2) / 2)


# -- right answers ----------------------------------------------------------------------------------------------------
def test_two_hanging_masses_on_a_cantilever():
    """Gauges read P (a - x) c / EI for a load at a: the loads come back to rounding without noise."""
    g = np.array([120.0, -40.0])
    x = np.linspace(0.1, 1.7, 6)
    moment = g[0] * (2.0 - x) + g[1] * np.maximum(1.0 - x, 0)
    y = -moment * 0.01 / 1e4
    estimate = StaticInversion(wing(), penalty=None).estimate(y)
    np.testing.assert_allclose(estimate.load, g, rtol=1e-9)
    assert estimate.load.shape == (2,)
    assert estimate.axis is None
    assert "N303" in estimate.codes


def test_the_band_is_that_of_least_squares():
    model = wing(noise=2e-6)
    H = model.static()
    estimate = StaticInversion(model, penalty=None).estimate(H @ [100.0, 50.0])
    expected = 2e-6 * np.sqrt(np.sum(np.linalg.pinv(H) ** 2, axis=1))
    np.testing.assert_allclose(estimate.posterior.std, expected, rtol=1e-8)


@pytest.mark.parametrize("penalty", ["identity", "first_difference", "second_difference"])
def test_a_given_lambda_against_augmented_least_squares(penalty):
    model, g = smooth(), bump()
    y = model.H @ g + 1e-3 * np.random.default_rng(0).standard_normal(16)
    estimate = StaticInversion(model, penalty=penalty, choice=1e-2, noise=1e-3).estimate(y)
    n = 24
    L = {"identity": np.eye(n), "first_difference": np.diff(np.eye(n), axis=0)}.get(
        penalty, np.diff(np.eye(n), 2, axis=0)
    )
    lam = 1e-2 * estimate.choice.scale
    A, b = np.vstack([model.H / 1e-3, lam * L]), np.concatenate([y / 1e-3, np.zeros(len(L))])
    np.testing.assert_allclose(estimate.load, np.linalg.lstsq(A, b, rcond=None)[0], rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_no_answer_depends_on_units(factor):
    model, g = smooth(), bump()
    y = model.H @ g + 1e-3 * np.random.default_rng(1).standard_normal(16)
    first = StaticInversion(model, noise=1e-3).estimate(y)
    scaled = StaticInversion(MatrixModel(model.H * factor), noise=1e-3 * factor).estimate(y * factor)
    np.testing.assert_allclose(scaled.load, first.load, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(scaled.std, first.std, rtol=1e-7)
    assert scaled.choice.lam == pytest.approx(first.choice.lam, rel=1e-9)
    stiffer = StaticInversion(MatrixModel(model.H / factor), noise=1e-3).estimate(y)
    np.testing.assert_allclose(stiffer.load / factor, first.load, rtol=1e-7, atol=1e-9)  # gain only, never shape


def test_frames_share_one_lambda_and_equal_single_readings_at_it():
    model, rng = smooth(), np.random.default_rng(2)
    truth = np.stack([bump(), 0.5 * bump(), np.roll(bump(), 5)])
    y = truth @ model.H.T + 1e-3 * rng.standard_normal((3, 16))
    together = StaticInversion(model, noise=1e-3).estimate(y)
    assert together.load.shape == (3, 24)
    assert together.axis.name == "frame"
    alone = StaticInversion(model, noise=1e-3, choice=together.choice.lam)
    for frame, row in zip(together.load, y, strict=True):
        np.testing.assert_allclose(alone.estimate(row).load, frame, rtol=1e-9, atol=1e-12)


def test_a_record_over_time():
    model = wing()
    g = np.outer(np.linspace(0, 1, 50), [100.0, 20.0])
    record = Record(
        g @ model.static().T, 0.01, [Channel(label=s.label, quantity="strain", unit="m/m") for s in gauges()]
    )
    estimate = StaticInversion(model, penalty=None).estimate(record)
    assert estimate.axis.unit == "s"
    np.testing.assert_allclose(estimate.load, g, atol=1e-6)


def test_labels_decide_not_the_order():
    model = wing()
    y = model.static() @ [100.0, 50.0]
    by_name = {f"g{i}": y[i] for i in reversed(range(6))}
    found = StaticInversion(model, penalty=None).estimate(by_name)
    np.testing.assert_allclose(found.load, [100.0, 50.0], rtol=1e-8)


def test_a_lost_gauge_is_left_out():
    model = wing()
    y = model.static() @ [100.0, 50.0]
    kept = ["g0", "g1", "g3", "g5"]
    found = StaticInversion(model, penalty=None, sensors=kept).estimate(y)
    np.testing.assert_allclose(found.load, [100.0, 50.0], rtol=1e-8)
    assert found.sensors == tuple(kept)


# -- calibrate and freeze ---------------------------------------------------------------------------------------------
def presses(model, count=6, noise=1e-3) -> list:
    rng = np.random.default_rng(3)
    return [model.H @ (a * bump()) + noise * rng.standard_normal(16) for a in np.linspace(0.5, 2, count)]


def test_calibration_reports_the_spread():
    family = StaticInversion(smooth(), noise=Noise(1e-3, source="unloaded record"))
    calibration = family.calibrate(presses(family.model))
    assert len(calibration.alone) == 6
    assert min(calibration.alone) <= calibration.lam * 10
    assert calibration.spread == pytest.approx(np.ptp(np.log10(calibration.alone)))
    assert "unloaded record" in str(calibration)
    assert "record 3" in calibration.table()
    assert family.estimate(presses(family.model)[0]).choice.lam == calibration.lam


def test_the_frozen_inverse_is_one_product(tmp_path):
    family = StaticInversion(smooth(), noise=Noise(1e-3, source="unloaded record"), penalty="first_difference")
    records = presses(family.model)
    family.calibrate(records)
    frozen = family.freeze()
    for y in records:
        np.testing.assert_allclose(frozen(y), family.estimate(y).load, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(frozen(records[0] + records[1]), frozen(records[0]) + frozen(records[1]), rtol=1e-10)
    assert "one matrix-vector product" in str(frozen)
    assert "unloaded record" in str(frozen)
    frozen.save(tmp_path / "inverse.h5")
    np.testing.assert_array_equal(Frozen.read(tmp_path / "inverse.h5")(records[0]), frozen(records[0]))


def test_frozen_with_constraints_says_that_it_solves():
    family = StaticInversion(smooth(), noise=1e-3, choice=1e-2, constraints=[NonNegative()])
    frozen = family.freeze()
    y = presses(family.model)[2]
    np.testing.assert_allclose(frozen(y), family.estimate(y).load, rtol=1e-6, atol=1e-8)
    assert "no longer one product" in str(frozen)
    with pytest.raises(InputError, match="solver"):
        frozen.save("never.h5")


def test_a_lambda_that_is_not_fixed_is_not_frozen():
    with pytest.raises(InputError, match="not fixed"):
        StaticInversion(smooth(), noise=1e-3).freeze()


def test_a_stiffer_body_keeps_the_relative_lambda():
    """An error in E rescales the load and leaves its shape."""
    first = StaticInversion(smooth(), noise=1e-3, choice=2e-2)
    second = StaticInversion(MatrixModel(smooth().H / 1.3), noise=1e-3, choice=2e-2)
    y = presses(smooth())[0]
    np.testing.assert_allclose(second.estimate(y).load / 1.3, first.estimate(y).load, rtol=1e-9, atol=1e-12)


# -- constraints and functionals --------------------------------------------------------------------------------------
def test_constraints_hold_and_improve_the_map():
    model, g = smooth(), bump()
    y = model.H @ g + 2e-2 * np.random.default_rng(4).standard_normal(16)
    free = StaticInversion(model, noise=2e-2).estimate(y)
    total = Resultant(np.ones((1, 24)), [g.sum()])
    for constraints in ([NonNegative()], [NonNegative(), total], [Support(np.arange(2, 20)), NonNegative()]):
        held = StaticInversion(model, noise=2e-2, choice=free.choice.lam, constraints=constraints).estimate(y)
        assert np.linalg.norm(held.load - g) < np.linalg.norm(free.load - g)
        assert held.load.min() >= -1e-9
    assert StaticInversion(model, noise=2e-2, constraints=total).estimate(y).load.sum() == pytest.approx(
        g.sum(), rel=1e-9
    )


def test_functionals_of_a_static_load():
    model, g = smooth(), bump()
    y = model.H @ g + 1e-3 * np.random.default_rng(5).standard_normal(16)
    estimate = StaticInversion(model, noise=1e-3).estimate(y)
    total = estimate.functional("sum", limit=2.0)
    assert total.value == pytest.approx(estimate.load.sum())
    assert total.std >= total.noise_std > 0
    assert abs(total.value - g.sum()) <= total.bias_limit + 4 * total.noise_std
    few = estimate.functional("mean", loads=[8, 9, 10])
    assert few.value == pytest.approx(estimate.load[8:11].mean())
    assert estimate.functional("peak").value == pytest.approx(estimate.load.max())


def test_a_basis_gives_resultants_and_tractions():
    beam = beams.cantilever(**BEAM)
    basis = bases.patches(beam, 8)
    model = ForwardModel(beam, gauges(10, noise=1e-9), basis)
    q = 50 * np.sqrt(1 - (np.linspace(0, 2, 9)[:-1] / 2) ** 2)
    estimate = StaticInversion(model, penalty="gradient").estimate(model.static() @ q)
    force = next(r for r in estimate.resultants if r.name.startswith("F"))
    assert force.value == pytest.approx(q.sum() * 0.25, rel=0.02)
    assert force.unit == "N"
    np.testing.assert_allclose(estimate.traction(), estimate.load)
    assert {"measures", "coordinates", "kind"} <= set(estimate.geometry)


def test_everything_survives_a_file(tmp_path):
    beam = beams.cantilever(**BEAM)
    model = ForwardModel(beam, gauges(10), bases.patches(beam, 8))
    estimate = StaticInversion(model, penalty="laplacian").estimate(model.static() @ np.linspace(1, 2, 8))
    estimate.save(tmp_path / "lift.h5")
    back = load(tmp_path / "lift.h5")
    np.testing.assert_array_equal(back.load, estimate.load)
    np.testing.assert_allclose([r.std for r in back.resultants], [r.std for r in estimate.resultants])
    assert back.summary(details=True) == estimate.summary(details=True)
    estimate.report(tmp_path / "lift.html")
    assert (tmp_path / "lift.html").stat().st_size > 10_000


# -- guards -----------------------------------------------------------------------------------------------------------
def test_fewer_sensors_than_loads_is_one_of_many():
    estimate = StaticInversion(smooth(m=10), noise=1e-3).estimate(smooth(m=10).H @ bump())
    flag = next(f for f in estimate.flags if f.code == "LID-W201")
    assert "nullity 14" in flag.message
    assert "one of many" in flag.message


def test_a_load_that_no_sensor_sees_is_named():
    H = np.random.default_rng(6).standard_normal((5, 3))
    H[:, 1] = 0
    estimate = StaticInversion(MatrixModel(H, loads=["a", "blind", "c"]), noise=0.1).estimate(H @ [1.0, 2.0, 3.0])
    assert "blind" in next(f for f in estimate.flags if f.code == "LID-W201").message
    with pytest.raises(NotIdentifiable, match="rank 2 of 3"):
        StaticInversion(MatrixModel(H), penalty=None).estimate(H @ [1.0, 2.0, 3.0])


def test_an_absolute_lambda_is_flagged_and_obeyed():
    model = smooth()
    y = presses(model)[0]
    relative = StaticInversion(model, noise=1e-3, choice=1e-2).estimate(y)
    absolute = StaticInversion(model, noise=1e-3, choice=Absolute(1e-2 * relative.choice.scale)).estimate(y)
    np.testing.assert_allclose(absolute.load, relative.load, rtol=1e-9)
    assert "W307" in absolute.codes
    assert "W307" not in relative.codes


def test_a_lambda_per_frame_is_flagged():
    model = smooth()
    y = np.stack(presses(model))
    each = StaticInversion(model, noise=1e-3).estimate(y, joint=False)
    assert each.load.shape == (6, 24)
    assert "W409" in each.codes
    assert "W409" not in StaticInversion(model, noise=1e-3).estimate(y).codes
    np.testing.assert_allclose(each.load[2], StaticInversion(model, noise=1e-3).estimate(y[2]).load)


def test_diagonal_stiffness_is_refused():
    with pytest.raises(InputError, match=r"E102|painted"):
        StaticInversion(MatrixModel(np.diag([1.0, 2.0, 3.0])))
    allowed = StaticInversion(MatrixModel(np.diag([1.0, 2.0, 3.0])), allow=["E102"], noise=0.1)
    assert "E102" in allowed.estimate([1.0, 2.0, 3.0]).codes


def test_interpolated_markers_are_said_and_whitened():
    model, rng = smooth(n=8, m=40), np.random.default_rng(7)
    markers = np.linspace(0, 1, 10)
    W = np.array([np.interp((np.arange(40) + 0.5) / 40, markers, e) for e in np.eye(10)]).T
    g, x = bump(8), (np.arange(8) + 0.5) / 8
    at_markers = 0.1 / np.pi / (0.01 + (markers[:, None] - x) ** 2) / 8
    y = W @ (at_markers @ g + 1e-3 * rng.standard_normal(10))
    estimate = StaticInversion(model, noise=Noise(1e-3, interpolation=W)).estimate(y)
    flag = next(f for f in estimate.flags if f.code == "LID-W203")
    assert "rank of the noise covariance 10" in flag.message
    assert flag.evidence.value < 11
    assert "W203" not in StaticInversion(model, noise=1e-3).estimate(y).codes


# -- bad input --------------------------------------------------------------------------------------------------------
BAD = [
    ([1.0, 2.0], "do not fit"),
    ([1.0, 2.0, np.nan, 4.0, 5.0, 6.0], "NaN"),
    ({"g0": 1.0, "g1": 2.0}, "no reading"),
    ({f"g{i}": 1.0 for i in range(7)}, "belongs to no sensor"),
    (np.ones(6) * 1j, "real"),
    (["a"] * 6, "no numbers"),
    (np.zeros((0, 6)), "do not fit"),
]


@pytest.mark.parametrize(("found", "said"), BAD, ids=[s for _, s in BAD])
def test_bad_readings(found, said):
    with pytest.raises(InputError, match=said):
        StaticInversion(wing()).estimate(found)


def test_a_sensor_that_sees_no_static_load_is_named():
    beam = beams.cantilever(**BEAM)
    model = ForwardModel(beam, [*gauges(3), sensors.Accelerometer("20+Z")], [loads.Point("20+Z")])
    with pytest.raises(InputError, match=r"20\+Z"):
        StaticInversion(model).estimate(np.ones(4))
    assert StaticInversion(model, sensors=["g0", "g1", "g2"]).estimate(np.ones(4) * 1e-5).load.shape == (1,)


@pytest.mark.parametrize("noise", [0.0, -1.0, np.nan, [1.0, 2.0], -np.eye(6)])
def test_bad_noise(noise):
    with pytest.raises(InputError, match="noise"):
        StaticInversion(wing(), noise=noise).estimate(np.ones(6))


def test_bad_settings():
    for settings in ({"penalty": "rough"}, {"penalty": np.ones((2, 5))}, {"method": "magic"}, {"choice": "wish"},
                     {"choice": -1.0}, {"penalty": None, "choice": 0.1}, {"sensors": ["g0", "g0"]}):  # fmt: skip
        with pytest.raises(InputError):
            StaticInversion(wing(), **folded(StaticInversion, settings)).estimate(np.ones(6) * 1e-5)


def test_flags_have_words():
    estimate = StaticInversion(smooth(m=10)).estimate(smooth(m=10).H @ bump())
    assert codes(estimate.flags) >= {"W201", "N303", "W114"}
    assert all(f.message and f.advice for f in estimate.flags)
