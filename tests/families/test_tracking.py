"""Load tracking: numbers and certificate of a fit, what it takes, what it says, and what it refuses."""

from __future__ import annotations

from dataclasses import FrozenInstanceError
from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, Record, priors
from loadid._spellings import folded
from structures import Channel, ForwardModel, InputError, NotIdentifiable, StateSpace, chains, damping, loads, sensors
from structures._models.mapped import mapped
from tests.tracked import Score, Tracked, bm2, matern32, score

MATERN = priors.Matern32(100.0, 0.08)
ACC = ("a3", "a6", "a10")


@cache
def case(kind: str = "matern", seed: int = 0, samples: int = 2500, fine: int = 1) -> Tracked:
    return bm2(kind, seed, samples=samples, fine=fine)


@cache
def building(stiffness: float = 1.0, at: tuple[int, ...] = (10,), disp: tuple[int, ...] = (10,)) -> ForwardModel:
    """The benchmark's building as a model with named channels."""
    structure = chains.shear_building(
        masses=[1.0] * 10, stiffnesses=[2500.0 * stiffness] * 10, damping=damping.Rayleigh(0.1, 5e-4)
    )
    seen = [sensors.Accelerometer(f"{k}+X", label=f"a{k}") for k in (3, 6, 10)]
    seen += [sensors.Displacement(f"{k}+X", label=f"d{k}") for k in disp]
    return ForwardModel(structure, seen, [loads.Point(f"{k}+X", label=f"p{k}") for k in at])


def judged(tracker, c: Tracked) -> Score:
    tracker.reset()
    found = tracker.track(c.y, c.dt)
    return score(found.load, found.std, c.load)


def fitted(c: Tracked, model=None, **settings):
    settings = {"noise": c.noise, **settings}
    return LoadTracker(c.setup.space() if model is None else model, **folded(LoadTracker, settings)).fit(c.y, c.dt)


# -- numbers of the fit -----------------------------------------------------------------------------------------------
def test_numbers_of_the_prior_are_found():
    c = case(samples=4000)
    tracker = fitted(c)
    assert tracker.fitted.numbers["sd of load 1"] == pytest.approx(100, rel=0.08)
    assert tracker.fitted.numbers["length of load 1"] == pytest.approx(0.08, rel=0.08)
    found = judged(tracker, c)
    assert found.error < 0.025
    assert 0.92 < found.cover < 0.97
    assert tracker.certificate.verdict == "calibrated"
    assert not {"LID-W502", "LID-W504", "LID-W519", "LID-W520"} & {f.code for f in tracker.flags}


@pytest.mark.parametrize(("factor", "prior"), [(1.0, "matern32"), (4.0, MATERN)])
def test_noise_that_nobody_states_is_found_within_10_percent(factor, prior):
    """And a prior that is given stays as it is, however wrong the first guess of the noise."""
    c = case()
    extra = np.random.default_rng(9).standard_normal(c.y.shape) * c.noise * np.sqrt(factor**2 - 1)
    tracker = LoadTracker(c.setup.space(), prior=prior).fit(c.y + extra, c.dt)
    level = np.sqrt(np.diag(tracker.fitted.model.LR @ tracker.fitted.model.LR.T))
    assert level == pytest.approx(factor * c.noise, rel=0.1)
    assert tracker.fitted.noise_source.text == "likelihood of the innovations"
    root = tracker.fitted.model.L0[tracker.fitted.model.nx :]
    sd = np.linalg.norm((tracker.fitted.model.Cp @ tracker.fitted.model.L0)[0])
    assert root.any()
    assert sd == pytest.approx(100, rel=1e-9 if prior is MATERN else 0.1)


def test_a_wrong_stiffness_is_flagged_declared_or_found():
    """Innovations tell half a percent; the band is honest where it is declared; the scale is found where it is free."""
    c = case()
    small = fitted(c, building(1.005), hold="zoh")
    assert small.certificate.whiteness > 2 * small.certificate.whiteness_bound
    assert small.certificate.verdict == "not calibrated"
    assert small.certificate.nis > 1.5
    assert any("NIS" in word for word in small.certificate.failing)
    assert any("from the others" in word for word in small.certificate.failing)
    wrong = building(1.02)
    plain = judged(fitted(c, wrong, hold="zoh", prior=MATERN), c)
    declared = judged(fitted(c, wrong, hold="zoh", prior=MATERN, model_error={"stiffness": 0.02}), c)
    assert plain.cover < 0.6
    assert declared.cover >= 0.93
    assert declared.error == pytest.approx(plain.error, rel=0.2)
    scaled = fitted(c, wrong, hold="zoh", prior=MATERN, scales=["stiffness"])
    assert scaled.fitted.numbers["stiffness"] == pytest.approx(1 / 1.02, abs=1e-3)
    found = judged(scaled, c)
    assert found.cover >= 0.93
    assert found.error < 0.03


def test_a_bad_sensor_is_named():
    c = case()
    y = c.y.copy()
    y[:, 1] += 5 * c.noise[1] * np.random.default_rng(3).standard_normal(len(y))
    certificate = LoadTracker(c.setup.space(), prior=MATERN, noise=c.noise).fit(y, c.dt).certificate
    assert int(np.argmax(certificate.rms)) == 1
    assert certificate.rms[1] > 3
    assert max(certificate.rms[0], certificate.rms[2], certificate.rms[3]) < certificate.rms[1] / 2
    assert certificate.left_out[1] < 0.7
    assert int(np.argmin(certificate.left_out)) == 1
    assert any(word.startswith("a1") for word in certificate.failing)
    assert "a1" in str(certificate)


@pytest.mark.parametrize("known", [True, False])
def test_units_change_nothing(known):
    """Sensors and loads in other units: load, std and numbers are the same."""
    c = case(samples=1200)
    plain = c.setup.space()
    rows, column = np.array([1e6, 1e-6, 1.0, 1e3]), 1e-6
    other = StateSpace(
        plain.A, plain.B * column, plain.C * rows[:, None], plain.D * rows[:, None] * column, plain.dt, plain.hold,
        sensors=[Channel(label=s.label, quantity=s.quantity, unit="arbitrary") for s in plain.sensors],
        loads=plain.loads,
    )  # fmt: skip
    a = LoadTracker(plain, noise=c.noise if known else None).fit(c.y, c.dt)
    b = LoadTracker(other, noise=c.noise * rows if known else None).fit(c.y * rows, c.dt)
    one, two = a.track(c.y), b.track(c.y * rows)
    assert two.load * column == pytest.approx(one.load, rel=1e-6, abs=1e-6)
    assert two.std * column == pytest.approx(one.std, rel=1e-6)
    assert b.fitted.numbers["sd of load 1"] * column == pytest.approx(a.fitted.numbers["sd of load 1"], rel=1e-6)
    assert b.fitted.numbers["length of load 1"] == pytest.approx(a.fitted.numbers["length of load 1"], rel=1e-6)


# -- models, priors, loads --------------------------------------------------------------------------------------------
def test_a_forward_model_and_its_state_space_are_one():
    c = case(samples=600)
    one = fitted(c, prior=MATERN).track(c.y)
    other = fitted(c, building(), prior=MATERN, hold="zoh").track(c.y)
    assert np.abs(one.load - other.load).max() < 1e-3
    assert other.std == pytest.approx(one.std, rel=1e-4)


def test_a_continuous_truth_is_covered_by_default():
    """Loads run on between samples: the joint hold, which a structural model gets with a Matern prior, knows."""
    c = case(seed=1, fine=20)
    assert judged(fitted(c, building(), prior=MATERN), c).cover >= 0.92
    assert judged(fitted(c, building(), prior=MATERN, hold="zoh"), c).cover < 0.6


@cache
def two_loads() -> tuple[ForwardModel, np.ndarray, np.ndarray, np.ndarray]:
    """Matern loads of 100 and 40 N, one displacement under each; model, loads, record and noise."""
    model, rng = building(at=(10, 5), disp=(10, 5)), np.random.default_rng(0)
    F, L, H, _ = matern32(1.0, 0.08, 0.01)
    z, g = np.zeros((2, 2)), np.empty((1500, 2))
    for k in range(len(g)):
        g[k] = (H @ z)[0] * [100, 40]
        z = F @ z + L @ rng.standard_normal((2, 2))
    clean = model.predict(g, 0.01, "foh")
    sd = 0.01 * clean.std(axis=0)
    return model, g, clean + sd * rng.standard_normal(clean.shape), sd


@pytest.mark.parametrize("prior", [[MATERN, priors.Matern32(40.0, 0.08)], ["random_walk", priors.Matern32(40.0, 0.08)]])
def test_two_loads_with_a_prior_each(prior):
    model, truth, y, sd = two_loads()
    tracker = LoadTracker(model, prior=prior, noise=sd).fit(y, 0.01)
    found = tracker.track(y, 0.01)
    assert found.labels == ("p10", "p5")
    for j, limit in enumerate((0.05, 0.3)):
        own = score(found.load[:, [j]], found.std[:, [j]], truth[:, [j]])
        assert own.error < limit
        assert 0.92 < own.cover < 0.985
    named = [n for n in tracker.fitted.numbers if "load 1" in n]
    assert named == (["rate of load 1"] if prior[0] == "random_walk" else [])
    assert "load 2" not in "".join(tracker.fitted.numbers)


def test_loads_of_a_mapped_model():
    model = mapped(two_loads()[0], np.array([[1.0], [0.4]]))
    c = case(samples=1000)
    clean = model.predict(c.load, 0.01, "foh")
    sd = 0.01 * clean.std(axis=0)
    y = clean + sd * np.random.default_rng(1).standard_normal(clean.shape)
    found = LoadTracker(model, prior=MATERN, noise=sd).estimate(y, 0.01)
    own = score(found.load, found.std, c.load)
    assert own.error < 0.03
    assert own.cover > 0.92


# -- records ----------------------------------------------------------------------------------------------------------
def test_channels_are_found_by_their_labels():
    """A record with its channels in another order, and one more, is the same record."""
    c = case(samples=400)
    labels = [*ACC, "d10"]
    channels = [Channel(label=s.label, quantity=s.quantity, unit=s.unit) for s in building().sensors]
    order = [3, 0, 2, 1]
    mixed = Record(
        np.c_[c.y[:, order], np.ones(len(c.y))], 0.01,
        [*(channels[i] for i in order), Channel(label="temperature", quantity="arbitrary", unit="arbitrary")],
    )  # fmt: skip
    tracker = fitted(c, building(), prior=MATERN, hold="zoh")
    plain = tracker.track(c.y, 0.01)
    tracker.reset()
    assert np.array_equal(tracker.track(mixed).load, plain.load)
    assert [s.label for s in tracker.fitted.sensors] == labels
    lacking = mixed.select(["d10", "a3", "a10"])
    with pytest.raises(InputError, match="a6"):
        tracker.track(lacking)
    wrong = Record(c.y, 0.01, [*channels[:3], Channel(label="d10", quantity="velocity", unit="m/s")])
    with pytest.raises(InputError, match=r"d10 in m/s, not m"):
        tracker.track(wrong)


def test_some_sensors_of_a_table_of_all():
    c = case(samples=400)
    some = LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise[[3, 0]], sensors=["d10", "a3"])
    whole = some.estimate(c.y, 0.01)
    picked = some.estimate(c.y[:, [3, 0]], 0.01)
    assert np.array_equal(whole.load, picked.load)
    assert whole.sensors == ("d10", "a3")
    single = LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise[3], sensors=["d10"])
    assert single.estimate(c.y[:, 3], 0.01).load.shape == (400, 1)


def test_a_record_with_gaps_is_fitted():
    """The likelihood takes the longest complete stretch; the certificate all that is there."""
    c = case()
    y = c.y.copy()
    y[100:160, 3] = np.nan
    y[50] = np.nan
    y[2200:2230, :2] = np.nan
    tracker = LoadTracker(c.setup.space(), noise=c.noise).fit(y, c.dt)
    assert tracker.fitted.numbers["sd of load 1"] == pytest.approx(100, rel=0.12)
    low, high = tracker.certificate.nis_bounds
    assert 2 * low - 1 < tracker.certificate.nis < 2 * high - 1
    found = tracker.track(y)
    assert np.isfinite(found.load).all()
    assert np.isfinite(found.std).all()


# -- what it says -----------------------------------------------------------------------------------------------------
def test_accelerometers_alone_cannot_hold_a_walk():
    c = case(samples=600)
    settings = {"noise": c.noise[:3], "sensors": ACC, "hold": "zoh"}
    walk = priors.RandomWalk(2000.0)
    with pytest.raises(NotIdentifiable, match=r"LID-E501.*displacement"):
        LoadTracker(building(), prior=walk, **settings).fit(c.y, c.dt)
    with pytest.raises(NotIdentifiable, match="LID-E501"):
        LoadTracker(building(), **settings | {"prior": "random_walk"}).fit(c.y, c.dt)
    drifting = LoadTracker(building(), prior=walk, allow=["LID-E501"], **settings).fit(c.y, c.dt)
    assert "LID-E501" in {f.code for f in drifting.flags}
    std = drifting.track(c.y[:, :3]).std[:, 0]
    assert std[599] > 1.02 * std[299] > 1.04 * std[99]
    stationary = LoadTracker(building(), prior=MATERN, **settings).fit(c.y, c.dt)
    codes = {f.code for f in stationary.flags}
    assert "LID-W519" in codes
    assert "LID-E501" not in codes
    seen = {f.code for f in fitted(c, building(), prior=walk, hold="zoh").flags}
    assert not {"LID-E501", "LID-W519", "LID-W520"} & seen


def test_what_was_not_tuned_or_does_not_fit_is_said():
    c = case(samples=600)
    assert "LID-W502" in {f.code for f in fitted(c, prior=MATERN).flags}
    timid = fitted(c, prior=priors.Matern32(1.0, 0.08))
    assert {"LID-W502", "LID-W504"} <= {f.code for f in timid.flags}
    assert timid.certificate.nis > 2
    shared = {noise: {f.code for f in fitted(c, prior=MATERN, state_noise=noise).flags} for noise in (1e-9, 0.1)}
    assert "LID-W503" in shared[0.1]
    assert "LID-W503" not in shared[1e-9]
    slow = LoadTracker(building(), prior=MATERN, noise=c.noise[:3], sensors=ACC, hold="zoh").fit(c.y[:60], c.dt)
    assert "LID-W520" in {f.code for f in slow.flags}


def test_results_cannot_be_changed():
    c = case(samples=400)
    tracker = fitted(c, prior=MATERN)
    with pytest.raises(FrozenInstanceError):
        tracker.fitted.dt = 1.0
    with pytest.raises(FrozenInstanceError):
        tracker.certificate.nis = 1.0
    found = tracker.track(c.y[:-4])
    with pytest.raises(ValueError, match="read-only"):
        found.load[0] = 1.0
    for y in c.y[-4:-1]:  # at the settled gain
        load, std = tracker.step(y)
        with pytest.raises(ValueError, match="read-only"):
            std[0] = 0.0
        load[0] = 1e9  # its own copy
    assert tracker.phase == "steady"
    assert tracker.step(c.y[-1])[1] == tracker.fitted.settled.std


# -- what it refuses --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ({"noise": -1.0}, "none negative"), ({"noise": 0.0}, "without noise"), ({"noise": [1, 2]}, "sensors"),
        ({"noise": "low"}, "no real number"), ({"noise": np.nan}, "NaN"), ({"noise": np.eye(4)}, "noise std per"),
        ({"hold": "spline"}, "joint"), ({"hold": "foh"}, "one step and one hold"), ({"state_noise": "no"}, "number"),
        ({"state_noise": -1.0}, "negative"), ({"gate": 0}, "gate"), ({"gate": np.nan}, "gate"),
        ({"gate": "no"}, "gate"),
        ({"prior": 3}, "no prior"), ({"prior": "gauss"}, "matern32"), ({"prior": [MATERN, MATERN]}, "each load"),
        ({"scales": "stiffness"}, "list"), ({"scales": ["length"]}, "stiffness"), ({"scales": 3}, "list"),
        ({"scales": ["mass", "mass"]}, "once"), ({"scales": ["stiffness"]}, "perturbed"),
        ({"model_error": {"stiffness": 0.02}}, "perturbed"), ({"model_error": {"stiffness": "x"}}, "relative std"),
        ({"model_error": {"length": 0.1}}, "relative std"), ({"model_error": 0.02}, "mapping"),
        ({"sensors": "d0"}, "list"), ({"sensors": ["d9"]}, "no such sensor"), ({"sensors": []}, "once"),
        ({"lag": -1}, "lag"), ({"allow": "LID-E501"}, "list of codes"),
    ],
)  # fmt: skip
def test_bad_settings_are_refused(setting, text):
    c = case(samples=400)
    with pytest.raises(InputError, match=text):
        fitted(c, **{"prior": MATERN, **setting})


def test_bad_models_and_records_are_refused():
    c = case(samples=400)
    with pytest.raises(InputError, match="no forward model"):
        LoadTracker(3)
    with pytest.raises(InputError, match="too short"):
        LoadTracker(c.setup.space(), noise=c.noise).fit(c.y[:30], c.dt)
    holes = c.y.copy()
    holes[::3, 0] = np.nan
    with pytest.raises(InputError, match="too short"):
        LoadTracker(c.setup.space(), noise=c.noise).fit(holes[:45], c.dt)
    with pytest.raises(InputError, match="step"):
        LoadTracker(c.setup.space(), noise=c.noise).fit(c.y, 0.02)
    with pytest.raises(InputError, match="not known"):
        LoadTracker(c.setup.space(), noise=c.noise).fit(c.y)
