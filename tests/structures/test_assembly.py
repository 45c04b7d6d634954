"""Solids against scikit-fem: stiffness and mass of blocks, skewed hexahedra and tetrahedra, entry by entry."""

import pytest

from tests.benchmarks.assembly import apart, assembled, cases

CASES = cases((4, 3, 2))


@pytest.mark.parametrize("name", CASES)
def test_matrices_are_those_of_scikit_fem(name):
    build, places, cells, element = CASES[name]
    stiffness, mass = apart(build(), *assembled(places, cells, element))
    assert stiffness < 1e-12
    assert mass < 1e-12


@pytest.mark.parametrize("name", CASES)
def test_another_material_is_seen(name):
    """The comparison sees an error of one part in a million."""
    build, places, cells, element = CASES[name]
    K, M, basis = assembled(places, cells, element)
    assert min(apart(build(), (1 + 1e-6) * K, (1 + 1e-6) * M, basis)) > 0.9e-6
