"""A running tracker: splits, missing channels, lost sensors, gates and steps, starts anew, wrong samples."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from loadid import LoadTracker, priors
from loadid._families.tracking.fit import TrackerFit
from loadid._families.tracking.tracker import Tracker
from structures import ForwardModel, InputError, chains, damping, loads, sensors
from tests.families.test_tracking import building
from tests.tracked import Tracked, bm2, reference

ACC3, ACC6, ROOF, DISP = range(4)
MATERN = priors.Matern32(100.0, 0.08)


@cache
def case(kind: str = "matern") -> Tracked:
    return bm2(kind, samples=3000)


@cache
def fit(kind: str = "matern") -> TrackerFit:
    """The right prior with its numbers, on a quiet stretch."""
    prior = {"matern": MATERN, "mix": priors.RandomWalk(90.0), "step": priors.RandomWalk(15.0)}[kind]
    c = case(kind)
    return LoadTracker(c.setup.space(), prior=prior, noise=c.noise).fit(c.y[:1500], c.dt).fitted


def tracked(y: np.ndarray, kind: str = "matern", gate: float | None = 6.0):
    """Load, std and tracker of a stream from its start."""
    tracker = Tracker(fit(kind), gate)
    load, std, _ = tracker.run(y)
    return load[:, 0], std[:, 0], tracker


def judged(y: np.ndarray, start: int, stop: int, kind: str = "matern", gate: float | None = 6.0):
    """Relative error and coverage of a stretch, and the tracker."""
    load, std, tracker = tracked(y, kind, gate)
    assert np.isfinite(load).all()
    assert np.isfinite(std).all()
    truth = case(kind).load[start:stop, 0]
    off = load[start:stop] - truth
    cover = np.mean(np.abs(off) < 1.96 * std[start:stop])
    return np.linalg.norm(off) / np.linalg.norm(truth), cover, tracker


def disturbed() -> np.ndarray:
    """Gaps, wrong samples, a step, a channel that stays wrong."""
    y, rng = case().y[:900].copy(), np.random.default_rng(2)
    y[100:140, DISP] = np.nan
    y[150:153] = np.nan
    y[rng.random(900) < 0.02, ACC6] = np.nan
    y[300, ACC3] += 1e3
    y[330, ROOF] += 1e3
    y[420:450, ROOF] += 500.0
    y[600:660, DISP] += 1.0
    return y


# -- sample by sample, in blocks, from anywhere -----------------------------------------------------------------------
def test_samples_and_blocks_of_any_split_are_one_track():
    y = disturbed()
    load, std, whole = tracked(y)
    assert whole.counts["gated"] > 0
    assert whole.counts["missing"] == np.isnan(y).sum()
    single = Tracker(fit(), 6.0)
    pairs = [single.step(row) for row in y]
    assert np.abs(np.array([p[0][0] for p in pairs]) - load).max() <= 1e-12 * np.abs(load).max()
    assert np.array([p[1][0] for p in pairs]) == pytest.approx(std, rel=1e-12)
    assert single.counts == whole.counts
    rng = np.random.default_rng(0)
    for _ in range(3):
        cuts = [0, *sorted(rng.choice(np.arange(1, 900), 8, replace=False)), 331, 421, 900]
        cuts = sorted(set(cuts))
        tracker = Tracker(fit(), 6.0)
        parts = [tracker.track(y[a:b]) for a, b in pairwise(cuts)]
        joined = np.concatenate([p.load[:, 0] for p in parts])
        assert np.abs(joined - load).max() <= 1e-12 * np.abs(load).max()
        assert tracker.counts == whole.counts
        assert parts[-1].axis.values[0] == pytest.approx(cuts[-2] * 0.01)


def test_a_tracker_goes_on_from_its_state_within_doubt_and_gaps():
    """Everything that changes is in the tree: also a rival, and channels that are kept out."""
    y = disturbed()
    load, std, _ = tracked(y)
    for cut in (120, 331, 335, 425, 460, 620, 670):
        first, second = Tracker(fit(), 6.0), Tracker(fit(), 6.0)
        first.run(y[:cut])
        second.restore(first.to_tree())
        a, b, _ = second.run(y[cut:])
        assert np.array_equal(a[:, 0], load[cut:])
        assert np.array_equal(b[:, 0], std[cut:])


def test_the_tree_of_an_engine_holds_an_undecided_doubt():
    first, second = Tracker(fit(), 6.0)._engine, Tracker(fit(), 6.0)._engine
    for row in disturbed()[:331]:
        first.step(row)
    assert first.rival is not None
    first.doubt, first.age, first.good[1], first.wrong[1] = 1.25, 3, 2, 7
    second.restore(first.to_tree())
    assert second.suspects.tolist() == [False, False, True, False]
    assert (second.believing, second.doubt, second.age) == (first.believing, 1.25, 3)
    assert (second.lean, second.events, second.out, second.young) == (first.lean, 1, 1, False)
    assert second.good.tolist() == [0, 2, 0, 0]
    assert second.wrong.tolist() == [0, 7, 0, 0]
    assert np.array_equal(second.rival.x, first.rival.x)


def test_reset_forgets():
    tracker = Tracker(fit(), 6.0)
    first = tracker.run(case().y[:300])[0]
    assert tracker.phase == "steady"
    tracker.reset()
    assert tracker.phase == "warm-up"
    assert tracker.counts["samples"] == 0
    assert np.array_equal(tracker.run(case().y[:300])[0], first)


# -- missing channels -------------------------------------------------------------------------------------------------
def test_missing_channels_are_left_out_exactly():
    """Against the dense reference with reduced arrays, full covariances at every sample."""
    y, rng = case().y[:500].copy(), np.random.default_rng(1)
    y[rng.random(y.shape) < 0.1] = np.nan
    y[200:220] = np.nan
    load, std, _ = tracked(y, gate=None)
    expected = reference(fit().model, y)
    assert np.abs(load - expected.load[:, 0]).max() < 1e-3 * std.min()
    assert std == pytest.approx(expected.std[:, 0], rel=1e-3)


@pytest.mark.parametrize(("channel", "error"), [(DISP, 0.34), (ROOF, 0.6), (ACC3, 0.04)])
def test_a_lost_sensor_costs_no_more_than_its_row(channel, error):
    """Five seconds without it, over several records (what drifts is one draw in each): the band says what is lost."""
    errors, squares, inside = [], [], []
    for seed in range(6):
        c = bm2("matern", seed, samples=1200)
        fitted = LoadTracker(c.setup.space(), prior=MATERN, noise=c.noise).fit(c.y[:400], c.dt).fitted
        y = c.y.copy()
        y[500:1000, channel] = np.nan
        tracker = Tracker(fitted, 6.0)
        load, std, _ = tracker.run(y)
        assert np.isfinite(load).all()
        assert std[999] > fitted.settled.std
        off = (load - c.load)[:, 0]
        z = off / std[:, 0]
        errors.append(np.linalg.norm(off[500:1000]) / np.linalg.norm(c.load[500:1000]))
        squares.append(np.mean(z[500:1000] ** 2))
        inside.append(np.mean(np.abs(z[500:1000]) < 1.96))
        assert np.mean(np.abs(z[1050:]) < 1.96) > 0.85
        assert tracker.phase == "steady"
    assert np.mean(errors) < error
    assert 0.4 < np.mean(squares) < 1.7
    assert np.mean(inside) > 0.88


def test_all_channels_lost_for_a_moment():
    y = case().y.copy()
    y[2000:2020] = np.nan
    load, std, _ = tracked(y)
    assert 90 < std[2019] < 105  # the prior
    assert np.abs(load[2030:2100] - case().load[2030:2100, 0]).max() < 4 * std[2030:2100].max()


# -- the gate ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("channel", range(4))
@pytest.mark.parametrize("size", [5.0, -50.0, 1e6])
def test_one_wrong_sample_leaves_the_load_in_its_band(channel, size):
    """Also of the accelerometer beside the load, which looks like a step for one sample: its band says so."""
    clean, _, _ = tracked(case().y)
    y = case().y.copy()
    y[2000, channel] += size * y[:, channel].std()
    load, std, tracker = tracked(y)
    off = np.abs(load - case().load[:, 0])
    assert (off[1995:2100] / std[1995:2100]).max() < 4
    assert np.abs(load - clean)[2001:2100].max() < 3 * tracker.fitted.settled.std[0] + 2 * std[2001]
    assert std[2001] < 10 * tracker.fitted.settled.std[0]
    assert tracker.counts["gated"] == 1
    assert tracker.counts["steps"] == 0


def test_without_a_gate_every_number_is_believed():
    y = case().y.copy()
    y[2000, ACC3] += 50 * y[:, ACC3].std()
    load, std, tracker = tracked(y, gate=None)
    off = np.abs(load - case().load[:, 0])[2000:2100] / std[2000:2100]
    assert off.max() > 20
    assert tracker.counts["gated"] == 0


@pytest.mark.parametrize("channel", [ACC3, ACC6, DISP])
@pytest.mark.parametrize("stop", [2010, 2500, 3000])
def test_a_channel_that_stays_wrong_stays_out(channel, stop):
    """Exactly as if it were lost, for as long as it is wrong and then as long again, at most 20 samples."""
    y, lost = case().y.copy(), case().y.copy()
    y[2000:stop, channel] += 20 * y[:, channel].std()
    lost[2000 : stop + min(stop - 2000, 20) - 1, channel] = np.nan
    load, std, tracker = tracked(y)
    expected, band, _ = tracked(lost, gate=None)
    assert load == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert std == pytest.approx(band, rel=1e-9)
    assert tracker.counts["gated"] == np.isnan(lost).sum()
    assert (tracker.phase == "steady") == (stop < 3000)


def test_an_accelerometer_beside_the_load_that_stays_wrong_is_no_step():
    y = case().y.copy()
    y[2000:2500, ROOF] += 20 * y[:, ROOF].std()
    error, cover, tracker = judged(y, 2003, 2600)
    assert error < 0.6
    assert cover > 0.9
    assert tracker.counts["steps"] == 0
    assert tracker.phase == "steady"


def test_a_stuck_sensor_is_not_believed_when_it_happens_to_be_right():
    for channel in (ACC3, ACC6):
        y = case().y.copy()
        y[2000:2300, channel] = y[1999, channel]
        error, cover, _ = judged(y, 2010, 2500)
        assert error < 0.05
        assert cover > 0.85


@pytest.mark.parametrize("height", [300.0, -2000.0])
def test_a_step_of_the_load_is_taken_up_at_once(height):
    """Far beyond what the prior expects: no channel is thrown away."""
    c = case("step")
    load = c.load.copy()
    load[2000:] += height
    y = c.setup.respond(load) + c.noise * np.random.default_rng(5).standard_normal(c.y.shape)
    found, std, tracker = tracked(y, "step")
    off = np.abs(found - load[:, 0])
    assert off[2000:2002].max() < 0.05 * abs(height)
    assert (off[2000:2100] / std[2000:2100]).max() < 4
    assert tracker.counts["steps"] >= 1
    assert tracker.counts["gated"] <= 2


def test_a_hit_is_no_wrong_sample():
    """A force of one sample: up and down, and the structure swings after it."""
    c = case("step")
    load = c.load.copy()
    load[2000] += 3000.0
    y = c.setup.respond(load) + c.noise * np.random.default_rng(5).standard_normal(c.y.shape)
    found, std, _ = tracked(y, "step")
    assert found[2000] == pytest.approx(load[2000, 0], rel=0.01)
    assert (np.abs(found - load[:, 0])[2002:2200] / std[2002:2200]).max() < 5


def test_a_whole_sample_that_is_wrong_is_left_out():
    rng = np.random.default_rng(4)
    y = case().y.copy()
    y[2000] += 30 * y.std(axis=0) * rng.choice([-1, 1], 4) * rng.uniform(0.5, 2, 4)
    load, std, tracker = tracked(y)
    assert (np.abs(load - case().load[:, 0])[2000:2100] / std[2000:2100]).max() < 4
    assert tracker.counts["gated"] == 4


@pytest.mark.parametrize("off", [1.0, 1.03])
def test_an_impact_of_a_few_samples_is_no_fault_of_its_sensors(off):
    """Twelve prior stds within three samples, every channel beyond the gate: followed as well as without a gate."""
    from case_studies import method_map

    c = method_map.case("impact", 3)
    model = method_map.model() if off == 1.0 else method_map.model().perturbed("stiffness", off)
    found = LoadTracker(model, prior=priors.Matern32(17.0, 0.004), noise=c.noise).fit(c.record, method_map.DT).fitted
    errors, cover = {}, 0.0
    for gate in (None, 6.0):
        tracker = Tracker(found, gate)
        load, std, _ = tracker.run(c.record)
        errors[gate] = np.linalg.norm(load[:, 0] - c.force)
        cover = np.mean(np.abs(load[:, 0] - c.force) < 1.96 * std[:, 0])
    assert errors[6.0] < 1.1 * errors[None]
    assert tracker.counts["gated"] == 0
    assert tracker.counts["steps"] >= 1
    assert cover > 0.9 or off > 1


def test_a_wholly_wrong_sample_is_told_from_an_impact_by_what_follows():
    """Three channels that a load could explain for one sample: its band says so, and the next sample decides."""
    from case_studies import method_map

    c, rng = method_map.case("random", 0), np.random.default_rng(0)
    found = (
        LoadTracker(method_map.model(), prior=priors.Matern32(22.0, 0.019), noise=c.noise).fit(c.record, 2e-3).fitted
    )
    for size in (3.0, 30.0):
        for at in (220, 260, 300):
            y = c.record.copy()
            y[at] += size * y.std(axis=0) * rng.choice([-1, 1], 3) * rng.uniform(0.5, 2, 3)
            tracker = Tracker(found, 6.0)
            load, std, _ = tracker.run(y)
            assert (np.abs(load[:, 0] - c.force) / std[:, 0])[at : at + 60].max() < 4
            assert tracker.counts["gated"] == 3
            assert tracker.counts["steps"] == 0


def test_a_wrong_model_is_no_reason_to_throw_its_sensors_away():
    """Innovations are what they were at the fit: the gate is as many times wider, and still keeps what is wrong out."""
    c = case()
    tracker = LoadTracker(c.setup.stiffened(1.05).space(), prior=MATERN, noise=c.noise).fit(c.y[:1500], c.dt)
    assert min(tracker.certificate.rms[:2]) > 5
    tracker.run(c.y)
    assert tracker.counts["gated"] + tracker.counts["steps"] < 30
    tracker.reset()
    y = c.y.copy()
    y[2000, ACC3] += 100 * y[:, ACC3].std()
    load, std, _ = tracker.run(y)
    tracker.reset()
    assert np.abs(load - tracker.run(c.y)[0])[2000:].max() < 20 * std.max()
    assert tracker.counts["samples"] == 3000


@pytest.mark.parametrize("start", [500, 1500])
def test_a_stream_from_the_middle_is_found_again(start):
    """The structure moves already: the first samples tell it, and the gate has nothing to find."""
    load, std, tracker = tracked(case().y[start:])
    truth = case().load[start:, 0]
    inside = np.abs(load - truth) < 1.96 * std
    assert np.mean(inside[200:]) > 0.92
    assert np.mean(inside[:100]) > 0.85
    assert np.linalg.norm((load - truth)[5:100]) < 0.5 * np.linalg.norm(truth[5:100])
    assert tracker.counts["gated"] == 0
    assert tracker.counts["lost"] == 0
    assert "LID-N532" in [flag.code for flag in tracker.alarms]
    assert tracker.phase == "steady"


def test_what_is_kept_out_is_kept_out_of_the_models_that_may_be_wrong():
    """The variance between models stays as it was."""
    structure = chains.shear_building(masses=[1.0] * 10, stiffnesses=[2500.0] * 10, damping=damping.Rayleigh(0.1, 5e-4))
    seen = [sensors.Accelerometer(f"{k}+X", label=f"a{k}") for k in (3, 6, 10)]
    model = ForwardModel(structure, [*seen, sensors.Displacement("10+X", label="d10")], [loads.Point("10+X")])
    c = case()
    tracker = LoadTracker(model, prior=MATERN, noise=c.noise, hold="zoh", model_error={"stiffness": 0.02}).fit(
        c.y[:800], c.dt
    )
    clean = tracker.track(c.y[:800]).std[:, 0]
    y = c.y[:800].copy()
    y[500, ACC3] += 1e6
    tracker.reset()
    blocks = tracker.track(y).std[:, 0]
    assert tracker.counts["gated"] == 1
    assert blocks.max() < 1.2 * clean.max()
    tracker.reset()
    assert np.array([tracker.step(row)[1][0] for row in y]) == pytest.approx(blocks, rel=1e-9)


# -- after the stream -------------------------------------------------------------------------------------------------
def test_smooth_is_the_batch_answer():
    """Against the conditional mean and covariance of all loads at once, in dense arrays."""
    model, y = fit().model, case().y[:60].copy()
    y[10:20, DISP], y[30] = np.nan, np.nan
    N, n = len(y), model.n
    root = np.zeros((N * n, n + (N - 1) * model.LQ.shape[1]))
    q = model.LQ.shape[1]
    root[:n, :n] = model.L0 @ np.eye(model.L0.shape[1], n)
    for k in range(1, N):
        root[k * n : (k + 1) * n] = model.F @ root[(k - 1) * n : k * n]
        root[k * n : (k + 1) * n, n + (k - 1) * q : n + k * q] += model.LQ
    there = np.isfinite(y.ravel())
    seen = np.concatenate([model.H @ root[k * n : (k + 1) * n] for k in range(N)])[there]
    load = np.concatenate([model.Cp @ root[k * n : (k + 1) * n] for k in range(N)])
    sd = np.tile(np.linalg.norm(model.LR, axis=1), N)[there]
    U, s, Vt = np.linalg.svd(seen / sd[:, None], full_matrices=False)
    mean = load @ Vt.T @ ((s / (1 + s**2)) * (U.T @ (y.ravel()[there] / sd)))
    left = load - load @ Vt.T @ Vt
    std = np.sqrt(np.sum(left**2, axis=1) + np.sum((load @ Vt.T) ** 2 / (1 + s**2), axis=1))
    tracker = Tracker(fit(), 6.0)
    before = tracker.counts
    found = tracker.smooth(y)
    assert tracker.counts == before
    assert found.load[:, 0] == pytest.approx(mean, abs=1e-6 * np.abs(mean).max())
    assert found.std[:, 0] == pytest.approx(std, rel=1e-6)


# -- wrong samples ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "sample",
    [[1.0, 2.0], [np.inf, 0, 0, 0], ["a"] * 4, None, 3.0, [1j] * 4, np.zeros((2, 4)), [[1.0], 2.0, 3.0, 4.0]],
    ids=str,
)
@pytest.mark.parametrize("count", [0, 300])
def test_a_wrong_sample_is_refused_and_the_stream_goes_on(sample, count):
    """In the warm-up and settled: nothing is counted, nothing changes."""
    y = case().y[:320]
    expected = tracked(y)[0]
    tracker = Tracker(fit(), 6.0)
    tracker.run(y[:count])
    with pytest.raises(InputError):
        tracker.step(sample)
    assert tracker.counts["samples"] == count
    assert np.array_equal(tracker.run(y[count:])[0][:, 0], expected[count:])


def test_wrong_blocks_are_refused():
    tracker, y = Tracker(fit(), 6.0), case().y
    for block, text in (
        (y[0], "shape"), (np.empty((0, 4)), "shape"), (np.zeros((3, 5)), "shape"), (None, "shape"),
        (np.full((3, 4), np.inf), "infinite"), ([["a"] * 4], "texts"), (np.zeros((3, 4), complex), "complex"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=text):
            tracker.track(block)
    for dt in (0.02, 0.0, -0.01, np.nan, "fast"):
        with pytest.raises(InputError, match="dt"):
            tracker.track(y, dt)
    assert tracker.counts["samples"] == 0
    single = y[:50].astype(np.float32)
    assert tracker.track(single).load.dtype == np.float64


def test_a_step_between_two_samples_is_an_event():
    """Truth twenty times finer: the structure has felt nothing of a load that has stepped just before a sample."""
    c = bm2("step", 1, samples=600, fine=20)
    prior = priors.Matern32(67.0, 0.16)
    tracker = LoadTracker(building(), prior=prior, hold="foh", noise=c.noise).fit(c.y[:400], c.dt)
    found = tracker.track(c.y)
    assert found.facts["count_gated"] == 0
    assert found.facts["count_steps"] == 1
    believed = Tracker(tracker.fitted, None).run(c.y)[0]
    assert np.linalg.norm(found.load - c.load) < np.linalg.norm(believed - c.load)
