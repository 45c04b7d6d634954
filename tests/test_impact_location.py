"""The impact location case study, pinned; `python -m tests.benchmarks.location` has all trials."""

import numpy as np
import pytest

from case_studies import impact_location as study


@pytest.fixture(scope="module")
def trials():
    return {seen: list(study.beam_trials(seen, (0.05, 0.30))) for seen in study.LAYOUTS}


@pytest.mark.parametrize(
    ("seen", "level", "hits", "median", "smallest"),
    [
        ((5, 17, 29), 0.05, 57, 4.97, 1.24),
        ((5, 17, 29), 0.30, 54, 1.27, 1.00),
        ((5, 17), 0.05, 57, 1.97, 1.00),
        ((5, 17), 0.30, 42, 1.03, 1.00),
    ],
)
def test_the_table_of_the_beam(trials, seen, level, hits, median, smallest):
    (row,) = [r for r in study.rows(trials[seen], seen) if r.level == level]
    assert (row.hits, row.trials) == (hits, 57)
    assert row.median == pytest.approx(median, abs=0.006)
    assert row.smallest == pytest.approx(smallest, abs=0.006)


def test_every_miss_is_flagged(trials):
    missed = [t for found in trials.values() for t in found if not t.hit]
    assert len(missed) == 18
    assert all("W511" in t.result.codes for t in missed)
    assert max(t.result.ratio for t in missed) < 1.046
    clear = [t for t in trials[5, 17, 29] if t.level == 0.05]
    assert sum(t.result.ambiguous for t in clear) == 0


def test_one_sensor_at_mid_span_is_ambiguous():
    found = study.mid_span()
    assert found.ratio == pytest.approx(1.0, abs=1e-6)
    assert {"E512", "W511"} <= found.codes
    assert ("12+Z", "28+Z") in found.alike


@pytest.fixture(scope="module")
def impacts():
    return study.plate_impacts(12)


def test_impacts_on_the_plate(impacts):
    errors = np.array([i.error for i in impacts])
    assert np.median(errors) <= 0.02
    assert errors.max() <= 0.1
    assert np.median([i.nearest for i in impacts]) > 0.2  # refinement is what does it
    assert not any(i.result.ambiguous for i in impacts)


def test_words_and_picture(impacts, trials, tmp_path):
    text = study.show_plate(impacts)
    assert f"median {np.median([i.error for i in impacts]):.4f}" in text
    assert "42/57" in study.show_beam(study.rows(trials[5, 17], (5, 17)))
    study.picture(tmp_path / "plate.png", impacts)
    assert (tmp_path / "plate.png").stat().st_size > 20_000
