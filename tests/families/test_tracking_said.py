"""What a fit says beside its numbers: beliefs, bands, wrong samples, numbers that the record does not tell."""

from __future__ import annotations

import pytest

from case_studies import method_map
from loadid import InputError, LoadTracker, NotIdentifiable, Priors
from tests.families.test_tracking import ACC, MATERN, building, case, fitted


def test_a_belief_in_small_displacements_is_offered_as_what_it_is():
    """It takes the place of a sensor that sees a constant load, in words, as a flag, and not as a channel."""
    c = case(samples=800)
    settings = {"noise": c.noise[:3], "sensors": ACC, "hold": "zoh"}
    with pytest.raises(NotIdentifiable, match="LID-E501"):
        LoadTracker(building(), prior="random_walk", **settings).fit(c.y, c.dt)
    tracker = LoadTracker(building(), prior=Priors("random_walk", dummy=1.0), **settings).fit(c.y, c.dt)
    assert "LID-W525" in {f.code for f in tracker.flags}
    assert len(tracker.fitted.sensors) == 3
    found = tracker.track(c.y[:, :3])
    assert "a belief, not measured" in found.provenance["prior"]
    assert found.provenance["settings"]["dummy"] == 1.0
    wider = tracker.fitted.wider[0]  # what the sensors leave between them
    assert found.std[-1, 0] == pytest.approx(wider * tracker.fitted.settled.std[0])
    before = tracker.fitted.settled
    tracker.update_model(building())  # the belief goes on with another model
    assert tracker.fitted.settled.std == pytest.approx(before.std, rel=1e-9)
    assert "LID-W525" not in {f.code for f in fitted(c, building(), prior=MATERN, hold="zoh").flags}
    with pytest.raises(InputError, match="dummy"):
        LoadTracker(building(), prior=Priors("random_walk", dummy=-1.0), **settings).fit(c.y, c.dt)


def test_the_certificate_says_where_the_data_tell():
    c = case(samples=800)
    said = fitted(c, building(), prior=MATERN, hold="zoh").certificate
    assert said.loads == ("p10",)
    assert said.bands[0][0][0] == 0.0
    assert "p10: the data tell more than the prior" in str(said)


def test_wrong_samples_and_untold_numbers_are_said():
    c = case(samples=800)
    y = c.y.copy()
    y[[300, 500], [0, 3]] += 100 * c.noise[[0, 3]]
    tracker = LoadTracker(c.setup.space(), noise=c.noise).fit(y, c.dt)
    (flag,) = [f for f in tracker.flags if f.code == "LID-W524"]
    assert flag.evidence.value == 2
    assert "LID-W524" not in {f.code for f in fitted(c).flags}
    slow = method_map.case("slow")
    tracker = LoadTracker(method_map.model(), prior="ou", noise=slow.noise).fit(slow.record, method_map.DT)
    assert "LID-W523" in {f.code for f in tracker.flags}
