"""Faults of sensors in service: named, kept out, said in every row; none on clean data; restart bit for bit."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, Noise
from loadid._families.tracking.bank import lifted_of
from loadid._families.tracking.tracker import Tracker
from loadid._families.tracking.watch import FARTHEST, FAULT, MISFIT
from loadid.priors import Matern32
from tests import tracked
from tests.campaigns.tracking import BEGIN, FAULTS, SOON, followed, service

DRAWN = 500_007  # a chain with four displacement sensors and one load
TWO = 3_100_020  # a chain with two displacement sensors and one load


@cache
def fitted() -> Tracker:
    return service(DRAWN).tracker()


def followed_by(fault: str) -> Tracker:
    tracker = Tracker(fitted().fitted, fitted().gate)
    tracker.run(service(DRAWN, fault).record)
    return tracker


@pytest.mark.parametrize("fault", [f for f in FAULTS if f != "spikes"])
def test_the_channel_is_named_in_time_and_every_row_says_so(fault):
    given, tracker = service(DRAWN, fault), followed_by(fault)
    assert tracker.faults
    assert {f.channel for f in tracker.faults} <= set(given.wrong)
    assert BEGIN < tracker.faults[0].sample <= BEGIN + SOON
    assert not tracker.row_alarms[:BEGIN].any()
    code, channel = tracker.row_alarms[BEGIN + SOON :].T
    assert np.all(code == FAULT)
    assert set(channel - 1) <= set(given.wrong)
    assert tracker.faults[0].kind == fault
    assert "LID-W528" in {f.code for f in tracker.flags}


def test_spikes_are_left_to_the_gate():
    """A sample now and then is no broken sensor: it is kept out, the channel is not."""
    tracker = followed_by("spikes")
    assert tracker.faults == ()
    assert not tracker.row_alarms.any()
    assert 10 <= tracker.counts["gated"] < 60


def test_a_clean_record_names_nobody():
    tracker = followed_by("none")
    assert tracker.faults == ()
    assert not tracker.row_alarms.any()
    assert not {"LID-W528", "LID-W529"} & {f.code for f in tracker.flags}


def test_the_loads_go_on_without_the_channel(monkeypatch):
    given = service(DRAWN, "offset")
    monkeypatch.setattr(type(given), "tracker", lambda self, **settings: fitted())
    found = followed(given)
    assert found.right
    assert found.late < 2
    assert found.gate < 0.2
    assert found.covered.min() > 0.85


def test_without_a_gate_it_is_said_and_believed():
    given = service(DRAWN, "stuck")
    deaf, bare = Tracker(fitted().fitted, None), Tracker(fitted().fitted, None)
    bare._watch = None
    assert np.array_equal(deaf.run(given.record)[0], bare.run(given.record)[0])
    assert [f.kind for f in deaf.faults] == ["stuck"]


@pytest.mark.parametrize("fault", ["offset", "swapped", "drift"])
def test_rows_blocks_and_a_restart_give_the_same_bits(fault, tmp_path):
    y = service(DRAWN, fault).record
    whole = Tracker(fitted().fitted, fitted().gate)
    load, std, _ = whole.run(y)
    alarms = whole.row_alarms
    for cut in (407, 490):
        first = Tracker(fitted().fitted, fitted().gate)
        for k in range(0, cut, 37):
            first.run(y[k : min(k + 37, cut)])
        first.save(tmp_path / "t.h5")
        second = Tracker.load(tmp_path / "t.h5")
        for k in range(cut, cut + 50):
            a, b = second.step(y[k])
            assert np.array_equal(a, load[k])
            assert np.array_equal(b, std[k])
            assert np.array_equal(second.row_alarms[0], alarms[k])
        a, b, _ = second.run(y[cut + 50 :])
        assert np.array_equal(a, load[cut + 50 :])
        assert np.array_equal(b, std[cut + 50 :])
        assert np.array_equal(second.row_alarms, alarms[cut + 50 :])
        assert second.faults == whole.faults
        assert second.counts == whole.counts


def test_a_channel_is_believed_again_when_it_is_right_again():
    y = service(DRAWN).record.copy()
    y[BEGIN : BEGIN + 200, 0] += 2 * y[:, 0].std()
    tracker = Tracker(fitted().fitted, fitted().gate)
    tracker.run(y)
    assert [f.channel for f in tracker.faults] == [0]
    assert np.all(tracker.row_alarms[BEGIN + 60 : BEGIN + 200, 0] == FAULT)
    assert not tracker.row_alarms[BEGIN + 400 :].any()
    assert tracker.phase == "steady"


def test_what_no_single_channel_explains_has_its_alarm_too():
    y = service(DRAWN).record.copy()
    y[BEGIN:] += 3 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y[BEGIN:].shape)
    tracker = Tracker(fitted().fitted, fitted().gate)
    tracker.run(y)
    assert np.mean(tracker.row_alarms[BEGIN + SOON :, 0] == MISFIT) > 0.8
    assert "LID-W529" in {f.code for f in tracker.flags}


def test_where_no_channel_can_be_told_from_another_the_band_holds_what_each_leaves():
    """Two sensors, one load, one of them drifts: which one nobody can tell."""
    given = service(TWO, "drift")
    tracker = given.tracker()
    load, std, _ = tracker.run(given.record)
    late = slice(BEGIN + SOON, None)
    assert tracker.faults == ()
    assert np.all(tracker.row_alarms[late, 0] == MISFIT)
    assert np.mean(np.abs(load - given.truth)[late] < 1.96 * std[late]) > 0.9
    assert np.sqrt(np.mean(std[late] ** 2)) < 2 * np.sqrt(np.mean((load - given.truth)[late] ** 2))
    (flag,) = [f for f in tracker.flags if f.code == "LID-W529"]
    assert "s0, s1" in flag.message


def test_a_channel_is_named_while_another_one_is_missing():
    y = service(DRAWN, "offset").record.copy()
    (wrong,) = service(DRAWN, "offset").wrong
    gone = (wrong + 1) % y.shape[1]
    y[200:, gone] = np.nan
    tracker = Tracker(fitted().fitted, fitted().gate)
    tracker.run(y)
    assert {f.channel for f in tracker.faults} == {wrong}
    assert tracker.faults[0].sample <= BEGIN + SOON
    assert not tracker.row_alarms[:BEGIN].any()


def test_a_load_with_an_alarm_stays_within_reach_of_those_of_the_fit():
    y = service(DRAWN).record.copy()
    y[BEGIN:] += 1e6 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y[BEGIN:].shape)
    tracker = Tracker(fitted().fitted, fitted().gate)
    load, std, _ = tracker.run(y)
    late = slice(BEGIN + SOON, None)
    assert tracker.fitted.most is not None
    assert np.all(np.abs(load[late]) <= FARTHEST * tracker.fitted.most)
    assert np.all(std[late] >= tracker.fitted.most)


def asleep_at(tracker: Tracker) -> bool:
    assert tracker._watch is not None
    return tracker._watch.asleep


def test_a_clean_stream_is_only_looked_at():
    tracker, y = Tracker(fitted().fitted, fitted().gate), service(DRAWN).record
    tracker.run(y[:400])
    for k in range(400, 1000, 20):
        assert asleep_at(tracker)
        tracker.run(y[k : k + 20])


@pytest.mark.parametrize("fault", [f for f in FAULTS if f != "spikes"])
def test_who_sleeps_finds_what_is_found_awake(fault):
    """The same channel within a hop of when the hypotheses find it that are followed all the time."""
    y = service(DRAWN, fault).record
    sleeper, awake = (Tracker(fitted().fitted, fitted().gate) for _ in "ab")
    assert awake._watch is not None
    awake._watch.light = None
    sleeper.run(y[:BEGIN])
    assert asleep_at(sleeper)
    sleeper.run(y[BEGIN:])
    awake.run(y)
    assert not asleep_at(sleeper)
    found, expected = sleeper.faults[0], awake.faults[0]
    assert (found.channel, found.other, found.kind) == (expected.channel, expected.other, expected.kind)
    assert abs(found.sample - expected.sample) <= 20


@pytest.mark.parametrize("size", [1, 7, 20, 333, 1000])
def test_a_sleeper_is_woken_alike_by_samples_and_by_blocks(size):
    y = service(DRAWN, "drift").record
    whole, parts = (Tracker(fitted().fitted, fitted().gate) for _ in "ab")
    load, std, _ = whole.run(y)
    found = [parts.step(row) for row in y] if size == 1 else []
    if size > 1:
        blocks = [parts.run(y[k : k + size]) for k in range(0, len(y), size)]
        found = [pair for a, b, _ in blocks for pair in zip(a, b, strict=True)]
    assert np.array_equal(load, [a for a, _ in found])
    assert np.array_equal(std, [b for _, b in found])
    assert parts.faults == whole.faults


def test_a_sleeper_is_woken_by_what_is_no_number():
    y = service(DRAWN).record.copy()
    y[500:504, 1] = np.nan
    tracker = Tracker(fitted().fitted, fitted().gate)
    tracker.run(y[:500])
    assert asleep_at(tracker)
    tracker.run(y[500:520])
    assert not asleep_at(tracker)
    tracker.run(y[520:])
    assert asleep_at(tracker)
    assert not tracker.row_alarms.any()


def test_channels_missing_now_and_all_the_time_leave_the_mixture_its_numbers() -> None:
    """A hop without the last channel; of two loads for one sample, the missing cell is as the others tell it."""
    model = fitted().fitted.model
    there = np.ones(model.m, bool)
    there[-1] = False
    bank = lifted_of(model, there)
    y = np.random.default_rng(2).standard_normal((4, model.m))
    y[:, -1], y[2, 0] = np.nan, np.nan
    rows = bank.hypotheses[:2]
    load, std, ahead = bank.mixed(rows, np.array([0.4, 0.6]), np.tile(bank.x0, (2, 1)), y)
    assert np.isfinite(load).all()
    assert np.isfinite(std).all()
    assert np.isfinite(ahead).all()


def test_missing_cells_name_nobody() -> None:
    """A missing cell of the accelerometer beside the load leaves the state less known than settled gains take it."""
    case = tracked.bm2("matern", 0, samples=2500)
    known = {"prior": Matern32(100.0, 0.08), "noise": Noise(case.noise, source="data sheet")}
    tracker = LoadTracker(case.setup.space(), **known).fit(case.y[:1500], case.dt)
    y, gone = case.y.copy(), np.random.default_rng(5).random(case.y.shape) < 0.05
    y[gone] = np.nan
    found = tracker.run(y)
    assert not tracker.faults
    assert "LID-N531" in {flag.code for flag in tracker.alarms}
    tracker.reset()
    usual = np.sqrt(np.mean((tracker.run(case.y)[0] - case.load) ** 2))
    assert np.sqrt(np.mean((found[0] - case.load) ** 2)) < 4 * usual  # it was 19 times, with six alarms
