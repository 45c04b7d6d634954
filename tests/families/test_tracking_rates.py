"""Channels of several rates: a period in what is missing is recognised, and runs by the gains of its phases."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, priors
from loadid._families.tracking.filters import rescaled
from loadid._families.tracking.fit import TrackerFit
from loadid._families.tracking.likelihood import Listener, Patchy
from loadid._families.tracking.tracker import Tracker
from loadid._inverse.gaussian.model import SquareRoot
from loadid._inverse.gaussian.records import filter_record as recursive
from tests.tracked import Tracked, bm2

DISP = 3


@cache
def case() -> Tracked:
    return bm2("matern", samples=1500)


@cache
def fit() -> TrackerFit:
    c = case()
    return LoadTracker(c.setup.space(), prior=priors.Matern32(100.0, 0.08), noise=c.noise).fit(c.y, c.dt).fitted


def sampled(every: int, first: int = 0) -> np.ndarray:
    """The displacement in every so-many-th sample only."""
    y = case().y.copy()
    y[np.arange(len(y)) % every != first, DISP] = np.nan
    return y


@pytest.mark.parametrize("every", [2, 10])
def test_several_rates_are_the_recursion_by_a_gain_for_each_phase(every):
    y = sampled(every, every - 1)
    tracker = Tracker(fit(), 6.0)
    load, std, e = tracker.run(y)
    expected = recursive(fit().model, y)
    assert tracker.phase == "periodic"
    assert np.abs(load - expected.load).max() < 1e-9 * np.abs(expected.load).max()
    assert std == pytest.approx(expected.std, rel=1e-9)
    assert np.array_equal(np.isnan(e), np.isnan(expected.normalised))
    assert np.nanmax(np.abs(e - expected.normalised)) < 1e-6
    assert tracker.counts["missing"] == np.isnan(y).sum()
    assert tracker.counts["gated"] == 0


def test_a_gap_and_a_wrong_sample_leave_the_rhythm_and_it_is_found_again(tmp_path):
    """Also in samples one by one, and through a file within the rhythm."""
    y = sampled(5)
    y[700:707] = np.nan
    y[1150, 0] += 1e3
    whole = Tracker(fit(), 6.0)
    load, std, _ = whole.run(y)
    gone = y.copy()
    gone[1150, 0] = np.nan
    expected = recursive(fit().model, gone)
    assert np.abs(load - expected.load).max() < 1e-8 * np.abs(expected.load).max()
    assert whole.counts["gated"] == 1
    single = Tracker(fit(), 6.0)
    phases, found = [], []
    for k, row in enumerate(y):
        if k in (600, 705, 1151):
            single.save(tmp_path / "t.h5")
            single = Tracker.load(tmp_path / "t.h5")
        found.append(single.step(row))
        phases.append(single.phase)
    assert [phases[k] for k in (690, 700, 701, 1149, 1150, 1499)] == [
        "periodic", "transient", "transient", "periodic", "transient", "periodic",
    ]  # fmt: skip
    assert np.array_equal(np.array([a[0] for a in found]), load)
    assert np.array_equal(np.array([a[1] for a in found]), std)


def test_a_channel_that_is_lost_for_good_has_a_settled_gain_too():
    y = case().y.copy()
    y[300:, 0] = np.nan
    tracker = Tracker(fit(), 6.0)
    load = tracker.run(y)[0]
    assert tracker.phase == "periodic"
    assert np.abs(load - recursive(fit().model, y).load)[600:].max() < 1e-9 * np.abs(load).max()


def test_what_does_not_repeat_or_does_not_settle_has_no_rhythm():
    listener = Listener(SquareRoot(fit().model))
    rng = np.random.default_rng(0)
    for mask in rng.random((400, 4)) < 0.7:
        listener.hear(mask)
        assert listener.found() is None
    listener.clear()
    for _ in range(300):
        listener.hear(np.zeros(4, bool))
    assert listener.found() is None
    listener.clear()
    for k in range(60):
        listener.hear(np.array([True, k % 3 > 0, True, k % 6 == 2]))
    rhythm, phase = listener.found()
    assert rhythm.period == 6
    assert rhythm.masks[phase].tolist() == [True, True, True, False]
    assert rhythm.masks[(phase + 3) % 6].tolist() == [True, True, True, True]


def test_sets_of_channels_are_forgotten(monkeypatch):
    """A stream whose sets never come again takes no memory, and what came last is known all the same."""
    from types import SimpleNamespace

    from loadid._families.tracking import likelihood as rhythm

    monkeypatch.setattr(rhythm, "NAMES", 150)
    listener, rng = Listener(SimpleNamespace(model=SimpleNamespace(m=20))), np.random.default_rng(0)
    masks = rng.random((400, 20)) < 0.5
    for k, mask in enumerate(masks):
        listener.hear(mask)
        assert np.array_equal(listener.past(min(k + 1, 128)), masks[max(k - 127, 0) : k + 1])
        assert len(listener._names) <= 150
    for k in range(60):
        listener.hear(masks[k % 3])
    assert listener.runs[2] == 57
    other = Listener(listener.core)
    other.restore(listener.to_tree())
    assert np.array_equal(other.past(128), listener.past(128))
    assert np.array_equal(other.runs, listener.runs)


# -- the fit ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("every", [1, 4])
def test_the_likelihood_of_a_record_with_gaps_is_that_of_the_square_root_filter(every):
    """By the gains of a period, and sample by sample; of a complete record it is the one that is known."""
    y = (sampled(every) if every > 1 else case().y)[:900]
    model, use = fit().model, np.arange(900) >= 800
    points = [Patchy(lambda x: model, y, use, False, lambda share: None)]
    points.append(Patchy(lambda x: model, y, use, False, lambda share: None))
    points[1].masks = None
    by_period, by_sample = (point(np.zeros(0)).cost for point in points)
    assert points[0].masks.shape == (every, 4)
    assert by_sample == pytest.approx(-np.sum(recursive(model, y).loglik[use]), rel=1e-12)
    assert by_period == pytest.approx(by_sample, abs=1e-6 * abs(by_sample))
    scaled = Patchy(lambda x: rescaled(model, 4.0), y, use, True, lambda share: None)(np.zeros(0))
    assert scaled.scale == pytest.approx(np.sum(recursive(model, y).nis[use]) / np.isfinite(y[use]).sum() / 4, rel=1e-5)


def test_a_slow_channel_is_tuned_on():
    """No stretch is complete: the numbers come near those that made the load, and the band holds."""
    c, y = case(), sampled(10)
    tracker = LoadTracker(c.setup.space(), prior="matern32", noise=c.noise).fit(y, c.dt)
    sd, length = (tracker.fitted.numbers[f"{name} of load 1"] for name in ("sd", "length"))
    assert 60 < sd < 160
    assert 0.05 < length < 0.12
    found = tracker.track(y)
    off = np.abs(found.load - c.load)
    assert np.linalg.norm(off) < 0.05 * np.linalg.norm(c.load)
    assert np.mean(off < 1.96 * found.std) > 0.92
