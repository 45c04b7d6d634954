"""Condensation level by level and by mirror symmetry, against the Schur complement of the whole."""

import numpy as np
import pytest

from structures import Structure, solids
from structures._elements.members import Material
from structures._system.factor import Factor, compliance, schur
from structures._system.layered import SymmetricFactor, blocks, condense, reflections

GEL = Material(E=1e5, rho=1e3, nu=0.45)


def block(fixed="bottom", elements=(4, 3, 3)):
    return solids.block(lengths=(8e-3, 6e-3, 3e-3), elements=elements, material=GEL, fixed=fixed)


def top(structure):
    return (3 * structure.field.surface("top").nodes[:, None] + np.arange(3)).ravel()


def stiffer(structure, node):
    """The same with a spring at a node: no mirror left."""
    K = structure.K.tolil()
    for axis in range(3):
        K[3 * node + axis, 3 * node + axis] += 100.0
    return Structure(
        K.tocsr(), structure.M, dofs=structure.dofs, coordinates=structure.coordinates, supports=structure.supports
    )


CASES = {
    "two mirrors": (block(), 2),
    "one mirror": (block(fixed=("bottom", "left")), 1),
    "none": (stiffer(block(), 45), 0),
    "one layer": (block(elements=(3, 2, 1)), 2),
}


@pytest.mark.parametrize("case", CASES)
def test_against_the_schur_complement(case):
    structure, mirrors = CASES[case]
    surface = np.setdiff1d(top(CASES[case][0] if structure.field else block()), structure.supported)
    wanted = schur(structure.K_free, np.searchsorted(structure.free, surface), Factor)
    stiffness, flexibility = condense(structure, surface)
    assert len(reflections(structure)) == mirrors
    assert np.abs(stiffness - wanted).max() < 1e-11 * np.abs(wanted).max()
    wanted = compliance(wanted.copy(order="F"))
    assert np.abs(flexibility - wanted).max() < 1e-11 * np.abs(wanted).max()


@pytest.mark.parametrize("part", [slice(0, 20), slice(30, None, 4)])
def test_some_dofs_anywhere(part):
    """DOFs that are no whole level, and not symmetric among themselves."""
    structure = block()
    surface = np.intersect1d(np.arange(structure.n)[::-1][part], structure.free)
    stiffness, _ = condense(structure, surface)
    wanted = schur(structure.K_free, np.searchsorted(structure.free, surface), Factor)
    assert np.abs(stiffness - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_blocks_are_orthonormal_and_uncoupled():
    structure = block()
    parts = [T for T, _ in blocks(reflections(structure), structure.free.size)]
    whole = np.column_stack([T.toarray() for T in parts])
    assert np.abs(whole.T @ whole - np.eye(structure.free.size)).max() < 1e-14
    K = whole.T @ structure.K_free.toarray() @ whole
    start = 0
    for T in parts:
        stop = start + T.shape[1]
        K[start:stop, start:stop] = 0
        start = stop
    assert np.abs(K).max() < 1e-13 * abs(structure.K_free).max()


@pytest.mark.parametrize("case", CASES)
def test_factors_of_the_blocks(case):
    structure, mirrors = CASES[case]
    rng = np.random.default_rng(0)
    factor = SymmetricFactor(structure.K_free, reflections(structure))
    assert len(factor._factors) == 2**mirrors
    for B in (rng.standard_normal((structure.free.size, 3)), rng.standard_normal(structure.free.size)):
        wanted = Factor(structure.K_free).solve(B)
        assert np.abs(factor.solve(B) - wanted).max() < 1e-11 * np.abs(wanted).max()


def test_a_symmetric_load_asks_for_one_block():
    structure = block()
    load = np.zeros(structure.n)
    load[2::3] = 1.0
    factor = SymmetricFactor(structure.K_free, reflections(structure))
    found = factor.solve(load[structure.free])
    assert [f is not None for f in factor._factors] == [True, False, False, False]
    assert np.abs(structure.K_free @ found - load[structure.free]).max() < 1e-10
    assert np.all(factor.solve(np.zeros(structure.free.size)) == 0)


def test_levels_may_be_told():
    """Curved layers have no common height."""
    structure = block()
    lift = np.where(structure.coordinates[:, 2] > 0, 0.3e-3 * np.cos(500 * structure.coordinates[:, 0]), 0)
    curved = solids.mesh(
        structure.coordinates + lift[:, None] * [0, 0, 1], _hexes(structure), material=GEL, fixed="bottom"
    )
    levels = np.repeat(np.arange(4), 20)
    for told in (levels, None, levels % 2):
        stiffness, _ = condense(curved, top(structure), told)
        wanted = schur(curved.K_free, np.searchsorted(curved.free, top(structure)), Factor)
        assert np.abs(stiffness - wanted).max() < 1e-11 * np.abs(wanted).max()


def _hexes(structure):
    i, j, k = (m.ravel() for m in np.meshgrid(*(np.arange(line.elements) for line in structure.field.lines)))
    return structure.field.corners(i, j, k)[:, [0, 1, 3, 2, 4, 5, 7, 6]]


def test_a_structure_without_a_mesh_is_condensed_all_the_same():
    K = np.diag(np.full(5, 3.0)) - np.diag(np.ones(4), 1) - np.diag(np.ones(4), -1)
    stiffness, flexibility = condense(Structure.from_matrices(K), [4, 0])
    wanted = np.linalg.inv(K)[np.ix_([4, 0], [4, 0])]
    assert flexibility == pytest.approx(wanted, rel=1e-12)
    assert stiffness == pytest.approx(np.linalg.inv(wanted), rel=1e-12)
