"""The chain whose load a learned map gives, and the loads that it leaves to Tikhonov."""

import numpy as np
import pytest

from case_studies import learned_chain
from case_studies.learned_chain import KINDS, OUTSIDE, Study, auc, show


@pytest.fixture(scope="module")
def study():
    return Study(draws=300)


@pytest.fixture(scope="module")
def trials(study):
    known = study.trials(study.linear, KINDS[0], range(60), 0)
    return {KINDS[0]: known} | {kind: study.trials(study.linear, kind, range(6), 0) for kind in KINDS[1:]}


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in OUTSIDE])
def test_loads_of_the_band_are_within_one_per_cent(trials, kind):
    own = trials[kind]
    assert np.median([t.map_error for t in own]) <= 0.007
    assert 0.93 <= np.mean([t.coverage for t in own]) <= 0.97


def test_no_more_than_one_in_a_hundred_raises_a_false_alarm(trials):
    known = [t.novelty for kind in KINDS if kind not in OUTSIDE for t in trials[kind]]
    assert np.mean(np.array(known) > 1) <= 0.014  # one of 72


@pytest.mark.parametrize("kind", OUTSIDE)
def test_what_it_does_not_know_is_told_from_what_it_knows(trials, kind):
    known = [t.novelty for one in KINDS if one not in OUTSIDE for t in trials[one]]
    assert auc(known, [t.novelty for t in trials[kind]]) >= 0.99
    assert all(t.novelty > 2 for t in trials[kind])
    assert np.median([t.map_error for t in trials[kind]]) > 0.2  # the map alone would be of no use


@pytest.mark.parametrize("sensor", [0, 4])
def test_a_sensor_that_is_off_by_a_constant_is_told(study, sensor):
    """By as much as its noise: a tenth of what is asked for."""
    for seed in range(100, 104):
        _, y = study.record(KINDS[0], seed)
        y[:, sensor] += study.noise[sensor]
        told = study.linear.predict(y[None]).verdicts[0]
        assert told.worst == "offset"
        assert told.value > 2


def test_what_is_answered_then_is_no_worse_than_tikhonov(study):
    found = [study.trials(study.linear, kind, [0], 1)[0] for kind in ("sine 40 Hz", "stiffness + 10 %")]
    assert all(t.answered_error <= 1.02 * t.tikhonov_error for t in found)
    assert "sine 40 Hz" in show("linear map", found)


def test_auc_counts_pairs():
    assert auc([0.0, 1.0], [1.0, 2.0]) == pytest.approx(0.875)
    assert auc([1.0], [1.0]) == 0.5


def test_picture(study, tmp_path):
    learned_chain.picture(study, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 10_000
