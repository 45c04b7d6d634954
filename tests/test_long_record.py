"""The case study of a long record at small size: what it prints, and that its rivals solve the same problem."""

import numpy as np
import pytest

from case_studies import long_record


@pytest.fixture(scope="module")
def small():
    return long_record.study(30_000)


@pytest.fixture(scope="module")
def rows(small):
    return {row.name: row for row in long_record.alternatives(small, ("circulant PCG", "spectral division"))}


class TestEstimate:
    def test_path(self, small):
        assert small.estimate.facts["path"] == "state space, O(N)"
        assert small.found.shape == small.record.shape

    def test_errors(self, small):
        assert small.error <= 0.13
        assert small.slow_error <= 0.015
        assert small.impulse_error <= 0.07
        assert small.peak_error <= 0.15

    def test_the_last_hit_is_found_although_its_response_is_cut_off(self, small):
        last = slice(small.true.starts[-1], None)
        away = small.found[last] - small.true.load[last]
        assert np.linalg.norm(away) <= 0.3 * np.linalg.norm(small.true.load[last])

    def test_band(self, small):
        assert small.covered >= 0.95

    def test_expected_flags_only(self, small):
        assert set(small.estimate.codes) <= {"W114", "W406", "W703", "N303"}


class TestAlternatives:
    def test_conjugate_gradients_reach_the_same_load(self, rows):
        assert rows["circulant PCG"].distance <= 1e-4

    def test_division_of_spectra_is_wrong_where_the_record_ends_in_motion(self, rows):
        division = rows["spectral division"]
        assert division.at_end >= 0.1
        assert division.distance >= 1e-2

    def test_text(self, small, rows):
        text = long_record.show(small, list(rows.values()))
        assert "30000 samples" in text
        assert all(name in text for name in rows)


def test_picture(small, tmp_path):
    target = tmp_path / "long_record.png"
    long_record.picture(small, target)
    assert target.stat().st_size > 20_000
