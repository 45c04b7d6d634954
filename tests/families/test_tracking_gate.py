"""The gate is never much worse than none: random campaigns on exact models, offsets that come in service, alarms."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid._families.tracking.innovations import Means
from loadid._families.tracking.tracker import Tracker
from tests.benchmarks.gate import GUARDS, WORSE, Campaign, campaign, followed

FIVE, HALF = 0.049, 0.0049  # mg as m/s^2


@cache
def fitted(seed: int) -> tuple[Campaign, Tracker]:
    """A campaign of the benchmark, and its tracker."""
    drawn = campaign(seed)
    return drawn, drawn.tracker()


@pytest.mark.parametrize("seed", [5, 15, 22, 29])
def test_the_gate_is_no_worse_than_none_on_an_exact_model(seed):
    """Steps and impacts that are far from the sensors: an event of some samples ago is none of now, a million times."""
    c, tracker = fitted(seed)
    assert followed(tracker, c.record, c.load).ratio < WORSE


def test_the_gate_still_takes_steps_up():
    c, tracker = fitted(10)
    found = followed(tracker, c.record, c.load)
    assert found.ratio < 0.7
    assert found.events
    assert not found.alarms


@pytest.mark.parametrize("seed", [28, 38])
@pytest.mark.parametrize("size", [FIVE, HALF])
def test_an_offset_in_service_costs_no_more_than_without_a_gate_and_is_said(seed, size):
    """The clean record is the twin: no alarm."""
    c, tracker = fitted(seed)
    assert followed(tracker, c.record, c.load).alarms == ()
    found = followed(tracker, c.offset(size), c.load)
    assert found.ratio < 1.2
    assert {"LID-W521", "LID-W527"} & set(found.alarms)


def test_an_offset_below_the_gate_is_said_with_the_channels_that_show_it():
    """Nothing is beyond the gate; a load that stays, which a prior that returns to zero misses a bit, is no offset."""
    c, tracker = fitted(130)
    running = Tracker(tracker.fitted, tracker.gate)
    found = running.track(c.offset(FIVE))
    (flag,) = [f for f in found.flags if f.code == "LID-W527"]
    assert running.counts["gated"] + running.counts["believed"] == 0
    assert any(f"of channel {s.label} (" in flag.message for s in c.model.sensors)
    assert abs(flag.evidence.value) > 8
    assert flag in running.flags
    running.reset()
    assert not {f.code for f in running.flags} & set(GUARDS)
    steps, fit = fitted(36)
    assert not followed(fit, steps.record, steps.load).alarms


def test_a_tracker_goes_on_from_its_file_while_the_gate_is_judged(tmp_path):
    """Set aside or in judgement: bit for bit, alarms too."""
    c, tracker = fitted(28)
    y = c.offset(FIVE)
    whole = Tracker(tracker.fitted, tracker.gate)
    load, std, _ = whole.run(y)
    judged = 0
    for cut in (3, 6, 9, 30, 200):
        first = Tracker(tracker.fitted, tracker.gate)
        first.run(y[:cut])
        judged += first._engine.plain is not None
        first.save(tmp_path / "t.h5")
        second = Tracker.load(tmp_path / "t.h5")
        a, b, _ = second.run(y[cut:])
        assert np.array_equal(a, load[cut:])
        assert np.array_equal(b, std[cut:])
        assert [f.code for f in second.flags] == [f.code for f in whole.flags]
    assert judged


def test_means_of_innovations_tell_an_offset_from_noise_in_streams_of_any_length():
    """White and correlated noise stay below the alarm, however long; a small offset does not; parts as the whole."""
    rng = np.random.default_rng(3)
    white = rng.standard_normal((30_000, 2))
    slow = np.array(white)
    for k in range(1, len(slow)):
        slow[k] += 0.9 * slow[k - 1]
    for e in (white, slow):
        means, parts = Means(2), Means(2)
        means.add(e)
        for part in np.array_split(e, 997):
            parts.add(part)
        assert np.abs(means.errors()).max() < 5
        assert parts.errors() == pytest.approx(means.errors(), rel=1e-9)
    off = white + np.array([0.0, 0.2])
    off[::3, 1] = np.nan
    means = Means(2)
    means.add(off)
    assert abs(means.errors()[0]) < 5
    assert means.errors()[1] > 8
    few = Means(1)
    few.add(np.ones((100, 1)))
    assert few.errors() == [0.0]
