"""Refinement: the stiffness grows worse as h^-2, the transfer matrix converges, added candidates add only noise."""

import pytest

from tests.benchmarks import refinement


def test_the_condition_of_the_stiffness_grows_as_h_to_minus_two():
    assert refinement.growth((1, 2)) == pytest.approx(-2, abs=0.1)
    assert refinement.growth((2, 3), encased=True) == pytest.approx(-2, abs=0.1)


def test_leading_singular_values_converge():
    first, second = refinement.meshes((0, 1, 2))
    assert second < 0.05
    assert second < 0.7 * first


def test_added_candidates_add_only_values_below_the_noise():
    """Markers deep in the pad: from 75 to 243 candidates the data tell more apart, from 243 to 867 they do not."""
    coarse, middle, fine = refinement.candidates(level=2, markers=9, cells=(4, 8, 16), depth=3.75e-3, noise=0.03)
    assert 50 < coarse < middle
    assert middle <= fine <= middle + 2
