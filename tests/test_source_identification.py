"""The case study `source_identification`: forces on a plate from averaged spectra, judged by the truth."""

import numpy as np
import pytest

from case_studies import source_identification as study


@pytest.fixture(scope="module")
def case() -> study.Campaign:
    return study.campaign()


@pytest.fixture(scope="module")
def rows(case: study.Campaign) -> dict[str, study.Row]:
    return {name: study.identified(name, case) for name in study.METHODS}


def test_the_measured_frfs_are_those_of_the_plate(case: study.Campaign):
    """Within the variance that the test itself states, up to what the window leaks at the sharp peaks."""
    exact = study.plate().frf(case.frequencies)
    assert case.model.variance is not None
    error = np.abs(case.model.H - exact) ** 2 / case.model.variance
    assert 0.8 < np.median(error) / np.log(2) < 1.5  # of a complex normal the median square is log 2


def test_trusted_lines_are_right_and_the_others_flagged(rows: dict[str, study.Row]):
    best = rows[study.DEFAULT]
    assert best.over(best.trusted) < 0.2  # dB; 10 % in amplitude are 0.9 dB
    assert np.abs(best.off[best.trusted]).max() < 1.5
    wrong = np.abs(best.off) > 20 * np.log10(1.3)
    assert not np.any(wrong & best.trusted)
    assert "W507" in best.estimate.codes


def test_better_than_what_users_take(rows: dict[str, study.Row]):
    best, plain = rows[study.DEFAULT], rows["pseudo-inverse"]
    told = best.trusted
    for name, row in rows.items():
        assert best.matrix <= row.matrix * 1.1, name
        assert best.leak <= row.leak, name
    assert best.over(~told) < 0.6 * plain.over(~told)
    assert best.leak < 0.4 * plain.leak


def test_the_idle_mount_is_never_trusted(rows: dict[str, study.Row]):
    assert not rows[study.DEFAULT].estimate.trust()[:, 3].any()


def test_kept_out_sensors_are_predicted(rows: dict[str, study.Row]):
    best = rows[study.DEFAULT]
    assert best.held < 0.5
    assert best.transfer.comparison.sensors == study.HELD
    inside = best.transfer.inside
    assert inside is not None
    assert min(inside) > 0.85


def test_contributions_name_the_feet_and_not_the_mount(rows: dict[str, study.Row], case: study.Campaign):
    order = study.ranked(rows[study.DEFAULT], case).ranking("desk")
    assert order[0][0] == "foot 1"
    shares = dict(order)
    assert shares.get("mount", 0.0) < 0.01
    exact = study.plate().frf(case.frequencies)[:, 7]
    power = np.einsum("kj,kjj->j", np.abs(exact) ** 2, case.truth.real)
    true = power / power.sum()
    found = [shares[name] for name in list(study.LOADS)[:3]]
    np.testing.assert_allclose(found, true[:3], atol=0.03)


def test_rocking_feet_are_wrong_only_where_it_is_said():
    row = study.identified(study.DEFAULT, study.campaign(rocking=True))
    assert row.over(row.trusted) < 0.2
    assert row.over(~row.trusted) > 5 * row.over(row.trusted)
