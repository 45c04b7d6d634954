"""What happens to a running tracker: late samples, ends of ranges, another model; and filterpy in its place."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, Online, priors
from loadid._families.tracking.fit import TrackerFit
from loadid._families.tracking.tracker import Tracker
from loadid._families.tracking.watch import MISFIT
from loadid._spellings import folded
from structures import ForwardModel, InputError, chains, damping, loads, sensors
from tests.tracked import Tracked, bm2

MATERN = priors.Matern32(100.0, 0.08)


@cache
def case() -> Tracked:
    return bm2("matern", samples=1000)


@cache
def building(stiffness: float = 1.0, storeys: int = 10, label: str = "roof") -> ForwardModel:
    structure = chains.shear_building(
        masses=[1.0] * storeys, stiffnesses=[2500.0 * stiffness] * storeys, damping=damping.Rayleigh(0.1, 5e-4)
    )
    seen = [sensors.Accelerometer(f"{k}+X", label=f"a{k}") for k in (3, 6, 10)]
    return ForwardModel(
        structure, [*seen, sensors.Displacement("10+X", label="d10")], [loads.Point("10+X", label=label)]
    )


def made(**settings: object) -> Tracker:
    c = case()
    return LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise, **folded(LoadTracker, settings)).fit(
        c.y[:500], c.dt
    )


@cache
def fit() -> TrackerFit:
    return made().fitted


# -- late samples -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("lag", [0, 6])
@pytest.mark.parametrize("blocks", [False, True])
def test_a_late_sample_is_put_in_its_place(lag, blocks, tmp_path):
    """Whole rows and single channels, several at once, through a file: the track is that of the samples in order."""
    y, window = case().y[:430].copy(), 12
    y[200:230, 3] = np.nan
    expected, band, _ = Tracker(fit(), 6.0, lag).run(y)
    gappy = y.copy()
    gappy[400], gappy[405, 1], gappy[409, :2] = np.nan, np.nan, np.nan
    tracker = Tracker(fit(), 6.0, lag, replay=window)
    if blocks:
        tracker.run(gappy[:410])
    else:
        for row in gappy[:410]:
            tracker.step(row)
    tracker.save(tmp_path / "t.h5")
    tracker = Tracker.load(tmp_path / "t.h5")
    assert tracker.insert(y[400], 9)[0].shape == (10, 1)
    tracker.insert([np.nan, y[405, 1], np.nan, np.nan], 4)
    load, std = tracker.insert(y[409], 0)
    size = np.abs(expected).max()
    assert load[-1] == pytest.approx(expected[409], abs=1e-12 * size)
    assert std[-1] == pytest.approx(band[409], rel=1e-12)
    rest, after, _ = tracker.run(y[410:])
    assert np.abs(rest - expected[410:]).max() <= 1e-12 * size
    assert after == pytest.approx(band[410:], rel=1e-12)
    assert tracker.counts["replayed"] == 3
    assert tracker.counts["missing"] == 30


def test_beyond_the_window_late_samples_are_counted():
    tracker, y = Tracker(fit(), 6.0, replay=5), case().y
    before = tracker.run(y[:100])[0]
    assert tracker.insert(y[90], 9) is None
    assert Tracker(fit(), 6.0).insert(y[0], 0) is None
    assert tracker.counts["expired"] == 1
    assert tracker.insert(y[99], 0)[0][0] == pytest.approx(before[99], abs=1e-12)  # what is there stays
    assert np.array_equal(tracker.insert(2 * y[99], 0)[0][0], tracker.insert(y[99], 0)[0][0])
    for ago in (-1, 1.5, True, "now"):
        with pytest.raises(InputError, match="count of samples"):
            tracker.insert(y[0], ago)
    with pytest.raises(InputError, match="width"):
        tracker.insert(y[0, :2], 0)


# -- ends of ranges ---------------------------------------------------------------------------------------------------
def test_a_sample_at_the_end_of_its_range_is_no_sample():
    """A clipped roof accelerometer: as if it were missing there, in the fit as well, and counted."""
    c = case()
    end = 0.5 * np.abs(c.y[:, 2]).max()
    y, gaps = c.y.copy(), c.y.copy()
    y[:, 2] = np.clip(y[:, 2], -end, end)
    clipped = np.abs(c.y[:, 2]) >= end
    gaps[clipped, 2] = np.nan
    tracker = LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise, online=Online(limits={"a10": end})).fit(
        y, c.dt
    )
    plain = LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise).fit(gaps, c.dt)
    assert tracker.certificate.nis == plain.certificate.nis
    found, expected = tracker.track(y), plain.track(gaps)
    assert np.array_equal(found.load, expected.load)
    assert tracker.counts["saturated"] == clipped.sum() > 3
    assert found.facts["missing"] == expected.facts["missing"]
    tracker.reset()
    assert np.array([tracker.step(row)[0] for row in y[:120]]) == pytest.approx(expected.load[:120], abs=1e-9)
    off = np.abs(found.load - c.load)[clipped] / found.std[clipped]
    deaf = LoadTracker(building(), prior=MATERN, hold="zoh", noise=c.noise, gate=None).fit(c.y, c.dt).track(y)
    assert off.max() < 4 < (np.abs(deaf.load - c.load)[clipped] / deaf.std[clipped]).max()


@pytest.mark.parametrize(
    "limits", [0.0, -1.0, "wide", {"a11": 1.0}, [1.0, 2.0], {"a3": (2.0, 1.0)}, {"a3": (1.0, 2.0, 3.0)}, np.nan, 1e-9]
)
def test_ranges_that_cannot_be(limits):
    with pytest.raises(InputError, match=r"limits|range"):
        made(limits=limits)


def test_ranges_of_either_side():
    limits = made(limits=[(None, 1e6), None, 1e6, (-1e6, 2e6)]).fitted.limits
    assert limits.tolist() == [[-np.inf, 1e6], [-np.inf, np.inf], [-1e6, 1e6], [-1e6, 2e6]]


# -- another model ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("from_file", [False, True])
def test_a_tracker_goes_on_with_a_stiffness_that_has_changed(from_file, tmp_path):
    """The structure loses a tenth of its stiffness at once: with the model updated the band is honest, without not."""
    c, change = case(), 400
    setup = c.setup
    after = replace(setup.stiffened(0.9), C=0.1 * setup.M + 5e-4 * 0.9 * setup.K)
    A, B0, B1 = setup.held(setup.Sp, setup.dt)
    A2, C0, C1 = after.held(setup.Sp, setup.dt)
    x, clean = np.zeros(setup.nx), np.empty(c.y.shape)
    for k, p in enumerate(c.load):
        now = setup if k < change else after
        clean[k] = now.G @ x + now.J @ p
        x = (A @ x + (B0 + B1) @ p) if k < change else (A2 @ x + (C0 + C1) @ p)
    y = clean + c.noise * np.random.default_rng(3).standard_normal(clean.shape)
    kept, updated = made(), made()
    first = updated.run(y[:change])[0]
    kept.run(y[:change])
    if from_file:
        updated.save(tmp_path / "t.h5")
        updated = Tracker.load(tmp_path / "t.h5")
    updated.update_model(building(0.9))
    assert updated.fitted.stale
    assert "LID-W522" in {f.code for f in updated.flags}
    assert updated.counts["samples"] == change
    assert np.abs(first - c.load[:change]).max() < 20
    load, std, _ = updated.run(y[change:])
    z = np.abs(load - c.load[change:]) / std
    assert np.mean(z < 1.96) > 0.92
    assert z.max() < 5
    assert updated.counts["gated"] == 0
    old, band, _ = kept.run(y[change:])
    assert np.mean(np.abs(old - c.load[change:]) / band < 1.96) < 0.5
    assert np.mean(kept.row_alarms[100:, 0] == MISFIT) > 0.9
    assert np.linalg.norm(old - c.load[change:]) > 5 * np.linalg.norm(load - c.load[change:])
    updated.save(tmp_path / "u.h5")
    again = Tracker.load(tmp_path / "u.h5", building(0.9))
    assert np.array_equal(again.run(y[:9])[0], updated.run(y[:9])[0])


def test_an_update_with_the_same_model_changes_nothing_but_the_gain_s_start():
    y, one, two = case().y, made(lag=4), made(lag=4)
    expected = one.run(y[:600])[0]
    two.run(y[:400])
    two.update_model(building())
    assert "LID-W522" not in {f.code for f in two.flags}
    rest = two.run(y[400:600])[0]
    assert np.abs(rest - expected[400:])[10:].max() < 1e-2 * two.fitted.settled.std.max()


def test_models_that_do_not_fit_are_refused_and_nothing_changes():
    tracker, y = made(), case().y
    before = tracker.fitted
    two = building().with_loads([loads.Point("10+X", label="roof"), loads.Point("5+X", label="mid")])
    few = ForwardModel(building().structure, building().sensors, building().loads, modes=4)
    other = ForwardModel(building().structure, building().sensors[:3], building().loads)
    for model, text in (
        (building(1.0, 10, "tower"), "other loads"), (two, "other loads"), (few, "other states"),
        (other, "other sensors"), (3, "no forward model"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            tracker.update_model(model)
    assert tracker.fitted is before
    blind = Tracker(replace(before, recipe=None))
    with pytest.raises(InputError, match="how its filter was made"):
        blind.update_model(building())
    assert np.isfinite(tracker.run(y)[0]).all()


# -- filterpy in its place --------------------------------------------------------------------------------------------
def test_filterpy_runs_the_tracker(tmp_path):
    """Masks, blocks, steps, files: equal to our engine without a settled gain to 1e-8 of the load."""
    y, rng = case().y[:300].copy(), np.random.default_rng(1)
    y[rng.random(y.shape) < 0.05], y[100:110] = np.nan, np.nan
    theirs = made(engine="filterpy")
    ours = Tracker(replace(fit(), settled=None), None)
    load, std, e = ours.run(y)
    found = theirs.track(y[:200])
    assert "filterpy" in found.facts["path"]
    theirs.save(tmp_path / "t.h5")
    theirs = Tracker.load(tmp_path / "t.h5")
    rest = np.array([theirs.step(row) for row in y[200:]])
    size = np.abs(load).max()
    assert np.abs(np.concatenate([found.load, rest[:, 0]]) - load).max() < 1e-8 * size
    assert np.concatenate([found.std, rest[:, 1]]) == pytest.approx(std, rel=1e-8)
    assert theirs.counts["missing"] == np.isnan(y).sum()
    both = np.isfinite(e[:200]) & np.isfinite(found.residual)
    assert both.sum() > 500
    with pytest.raises(InputError, match="how its filter was made"):
        theirs.update_model(building())


def test_settings_of_engines_that_cannot_be():
    for settings, text in (
        ({"engine": "matlab"}, "engine"), ({"engine": "filterpy", "lag": 3}, "answers at once"),
        ({"engine": "filterpy", "model_error": {"stiffness": 0.01}}, "answers at once"), ({"replay": -1}, "replay"),
        ({"replay": 2.5}, "replay"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            LoadTracker(building(), **folded(LoadTracker, settings))
