"""Late answers of a tracker against the smoother of what was known by then."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import InputError, LoadTracker, ModelErrors, Online
from loadid._inverse.gaussian.records import filter_record as filtered
from loadid._inverse.gaussian.records import smooth_record as smooth
from loadid._spellings import folded
from loadid.settings import Noise
from tests import tracked


@pytest.fixture(scope="module")
def case() -> tracked.Tracked:
    return tracked.bm2("matern", 0, acc=(3, 6), disp=(8,), samples=2000)


def tracker(case: tracked.Tracked, **settings: object):
    from loadid.priors import Matern32

    known = {"prior": Matern32(100.0, 0.08), "noise": Noise(case.noise, source="data sheet")}
    return LoadTracker(case.setup.space(), **folded(LoadTracker, {**known, **settings})).fit(case.y, case.dt)


def test_a_late_answer_is_the_smoothed_one(case: tracked.Tracked) -> None:
    lag = 10
    late = tracker(case, lag=lag).track(case.y)
    known = tracker(case, lag=lag).fitted.model
    for k in (400, 1200):
        whole = smooth(filtered(known, case.y[: k + lag + 1]))
        assert late.load[k] == pytest.approx(whole.load[k], abs=1e-3 * whole.std[k].item())
        assert late.std[k] == pytest.approx(whole.std[k], rel=1e-3)
    assert len(late.load) == len(case.y) - lag
    assert late.axis is not None
    assert late.axis.values[0] == 0


def test_around_a_gap_the_band_stays_honest(case: tracked.Tracked) -> None:
    y = case.y.copy()
    y[900:940, 2] = np.nan
    y[1400] = np.nan
    late = tracker(case, lag=10).track(y)
    truth = case.load[: len(late.load)]
    z = (late.load - truth) / late.std
    assert np.isfinite(z).all()
    assert np.mean(np.abs(z[200:]) < 1.96) > 0.9
    plain = tracker(case).track(y)
    assert np.linalg.norm((late.load - truth)[200:]) < 0.5 * np.linalg.norm((plain.load[: len(truth)] - truth)[200:])


@pytest.mark.parametrize("every", [1, 4])
def test_late_answers_are_the_smoothed_ones_around_everything(case: tracked.Tracked, every: int) -> None:
    """Starts, gaps of all and of some channels, a wrong sample, channels of two rates: at any time, to rounding."""
    lag, y = 6, case.y[:700].copy()
    y[np.arange(700) % every > 0, 0] = np.nan
    y[100:103], y[300:340, 2] = np.nan, np.nan
    gone = y.copy()
    y[420, 1] += 1e4
    gone[420, 1] = np.nan
    found = tracker(case, lag=lag)
    late = found.track(y)
    assert found.counts["gated"] == 1
    model = found.fitted.model
    for k in (0, 3, 95, 99, 101, 104, 296, 310, 337, 341, 345, 415, 420, 424, 500, 650):
        whole = smooth(filtered(model, gone[: k + lag + 1]))
        assert late.load[k] == pytest.approx(whole.load[k], abs=2e-3 * whole.std[k].item())
        assert late.std[k] == pytest.approx(whole.std[k], rel=2e-3)


def test_a_wrong_sample_beside_the_load_is_decided_before_a_late_answer() -> None:
    """It looks like an event at first: the late answer is that of the filter that did not believe it."""
    seen = tracked.bm2("matern", 0, samples=900)
    y, lag = seen.y.copy(), 5
    y[600, 2] += 1e3
    gone = y.copy()
    gone[600, 2] = np.nan
    found = tracker(seen, lag=lag)
    late = found.track(y)
    assert found.counts["gated"] == 1
    assert found.counts["steps"] == 0
    for k in (594, 596, 599, 600, 601, 605):
        whole = smooth(filtered(found.fitted.model, gone[: k + lag + 1]))
        if k + lag > 600:
            assert late.load[k] == pytest.approx(whole.load[k], abs=2e-3 * whole.std[k].item())
            assert late.std[k] == pytest.approx(whole.std[k], rel=2e-3)


def test_a_drift_that_is_accepted_has_late_answers_too() -> None:
    from loadid.priors import RandomWalk

    seen, lag = tracked.bm2("mix", 0, disp=(), samples=300), 8
    found = tracker(seen, prior=RandomWalk(100.0), allow_drift=True, lag=lag, gate=None)
    late = found.track(seen.y)
    whole = smooth(filtered(found.fitted.model, seen.y[: 200 + lag + 1]))
    assert late.load[200] == pytest.approx(whole.load[200], abs=1e-6 * whole.std[200].item())
    assert late.std[200] == pytest.approx(whole.std[200], rel=1e-6)


def test_samples_and_blocks_answer_alike_also_from_a_file(case: tracked.Tracked, tmp_path) -> None:
    y = case.y[:900].copy()
    y[500:520, 1] = np.nan
    one, two = tracker(case, lag=7), tracker(case, lag=7)
    load, std, _ = one.run(y)
    answers = [two.step(sample) for sample in y[:510]]
    two.save(tmp_path / "t.h5")
    two = type(two).load(tmp_path / "t.h5")
    answers += [two.step(sample) for sample in y[510:]]
    assert np.allclose([a[0] for a in answers], load, atol=1e-9 * np.abs(load).max())
    assert np.allclose([a[1] for a in answers], std, rtol=1e-9)


def test_auto_takes_as_few_as_needed(case: tracked.Tracked) -> None:
    found = tracker(case, lag="auto").lag
    assert 10 <= found <= 40


def test_lags_that_cannot_be(case: tracked.Tracked) -> None:
    for lag in (-1, 2.5, "late", 10_000, True):
        with pytest.raises(InputError, match="lag"):
            LoadTracker(case.setup.space(), online=Online(lag))
    with pytest.raises(InputError, match="errors of the model"):
        LoadTracker(case.setup.space(), online=Online(5), model_error={"stiffness": 0.01})
    with pytest.raises(InputError, match="first late answer"):
        tracker(case, lag=10).track(case.y[:8])


def test_filterpy_runs_the_same_filter(case: tracked.Tracked) -> None:
    y = case.y[:600].copy()
    y[200:230, 1] = np.nan
    found = tracker(case, gate=None)
    ours, theirs = found.track(y), found.on_filterpy(y)
    size = np.abs(ours.load).max()
    # the settled gain takes over where the variances are within a thousandth
    assert np.allclose(ours.load, theirs.load, atol=1e-3 * size)
    assert np.allclose(ours.std, theirs.std, rtol=2e-3)
    assert found.to_filterpy().dim_x == found.fitted.model.n


def test_ambient_loads_that_disturb_both_noises_leave_an_honest_band() -> None:
    """A beam of 8 modes whose error exceeds its load: the predicted std is the empirical one."""
    from loadid import Ambient
    from loadid.priors import OU
    from structures import StateSpace

    case = tracked.bm3(0, 30_000)
    setup, j = case.setup, np.arange(1, 9)
    x = (np.array([25, 45, 80])[:, None] - 1) * 30.0 / 100
    around = (np.sqrt(2 / (50.0 * 30.0)) * np.sin(j * np.pi * x / 30.0)).T
    _, first, second = setup.held(around, case.dt)
    A, _, G, _ = setup.matrices()
    ambient = Ambient(StateSpace(A, first + second, G, setup.through(around), case.dt, "zoh"), 1.0)
    known = {"prior": OU(10.0, 1 / (2 * np.pi * 0.05)), "noise": Noise(1e-4, source="set")}
    found = LoadTracker(
        setup.space(), model_error=ModelErrors(ambient=ambient, state_noise=1e-8), gate=None, **known
    ).fit(case.y, case.dt)
    answer = found.track(case.y)
    rest = (answer.load - case.load)[2000:]
    assert np.std(rest) / answer.std[-1] == pytest.approx(1.0, abs=0.03)
    assert found.certificate is not None
    assert found.certificate.nis == pytest.approx(1.0, abs=0.02)


def test_a_drift_that_is_accepted_is_tuned_and_grows() -> None:
    seen = tracked.bm2("mix", 0, disp=(), samples=3000)
    known = {"prior": "random_walk", "noise": Noise(seen.noise, source="data sheet")}
    found = LoadTracker(seen.setup.space(), allow=["LID-E501"], **known).fit(seen.y, seen.dt)
    answer = found.track(seen.y)
    assert "LID-E501" in {f.code for f in found.flags}
    assert answer.std[-1] > 1.2 * answer.std[300]
    z = (answer.load - seen.load) / answer.std
    assert np.mean(np.abs(z[200:]) < 1.96) > 0.9


def test_a_sensor_that_the_gate_keeps_out_is_said(case: tracked.Tracked) -> None:
    y = case.y[:1200].copy()
    assert "W521" not in tracker(case).track(y).codes
    y[400:700, 0] += 100 * np.asarray(case.noise)[0]
    assert "W521" in tracker(case).track(y).codes


def test_a_smoothed_record_keeps_no_states_and_is_the_smoother_that_does(case: tracked.Tracked) -> None:
    y = case.y.copy()
    y[700:720, 1] = np.nan
    found = tracker(case)
    answer, whole = found.smooth(y), smooth(filtered(found.fitted.model, y))
    assert np.allclose(answer.load, whole.load, atol=1e-6 * np.abs(whole.load).max())
    assert np.allclose(answer.std, whole.std, rtol=1e-6)
    assert found.counts["samples"] == 0
