"""The FE pad: published case of one layer, condensation, transfer to points, materials."""

from dataclasses import replace

import numpy as np
import pytest

from structures import InputError
from structures._system.factor import Factor
from tactile import Pad

GEL = {"size": (20e-3, 16e-3), "thickness": 3e-3, "E": 147e3, "nu": 0.3223, "pitch": 1e-3}
PLAIN = {**GEL, "element": "standard", "allow": ("W115",)}


def patch(pad, force=(0.5, 0.0, -2.0), radius=3e-3):
    """Nodal forces of the case: a half-ellipsoid over the nodes nearer than `radius`."""
    r = np.linalg.norm(pad.nodes2d, axis=1)
    q = np.where(r < radius * (1 - 1e-9), np.sqrt(np.clip(1 - (r / radius) ** 2, 0, 1)), 0)
    return np.outer(q / q.sum(), force)


@pytest.fixture(scope="module")
def single():
    return Pad(**PLAIN, layers=1)


@pytest.fixture(scope="module")
def pad():
    return Pad(**{**GEL, "pitch": 2e-3}, layers=3)


class TestSingleLayer:
    """Figures of the published case, 20 x 16 x 3 mm, one layer of plain bricks."""

    def test_deepest_motion_and_conditioning(self, single):
        U = single.displacements(patch(single))
        assert np.count_nonzero(patch(single)[:, 2]) == 25
        assert np.abs(U[:, 2]).max() == pytest.approx(1.347e-3, rel=5e-4)
        values = np.linalg.svd(single.compliance, compute_uv=False)
        assert values[[0, -1]] == pytest.approx([83.6e-3, 1.18e-3], rel=5e-3)
        assert values[0] / values[-1] == pytest.approx(70.6, rel=1e-3)

    def test_forces_come_back_from_the_displacements(self, single):
        f = patch(single)
        U = single.displacements(f)
        assert np.abs(single.forces(U) - f).max() < 1e-12 * np.abs(f).max()
        assert np.abs(single.stiffness @ U.ravel() - f.ravel()).max() < 1e-12 * np.abs(f).max()

    def test_reactions_oppose_the_load_and_are_not_part_of_it(self, single):
        reactions = single.reactions(patch(single))
        assert reactions.sum(axis=0) == pytest.approx([-0.5, 0.0, 2.0], abs=1e-12)
        assert single.forces(single.displacements(patch(single))).sum(axis=0) == pytest.approx([0.5, 0, -2], abs=1e-12)

    def test_markers_move_where_there_is_no_force(self, single):
        U = np.linalg.norm(single.displacements(patch(single)), axis=1)
        beside = np.linalg.norm(single.nodes2d, axis=1) > 4e-3
        assert U[beside].max() / U.max() == pytest.approx(0.18, abs=0.005)

    @pytest.mark.parametrize(("layers", "wrong"), [(2, 0.35), (4, 0.53), (6, 0.60)])
    def test_model_trap(self, single, layers, wrong):
        """A truth of several layers read with one: the resultant passes, the map is wrong."""
        f = patch(single)
        found = single.forces(Pad(**PLAIN, layers=layers).displacements(f))
        assert found.sum(axis=0) == pytest.approx([0.5, 0.0, -2.0], rel=0.01, abs=1e-9)
        assert np.linalg.norm(found - f) / np.linalg.norm(f) == pytest.approx(wrong, abs=0.006)


class TestCondensation:
    def test_against_the_whole_matrix(self, pad):
        s = np.searchsorted(pad.structure.free, pad.dofs)
        K = pad.structure.K_free.toarray()
        units = np.eye(len(K))[:, s]
        flexibility = np.linalg.solve(K, units)[s]
        assert np.abs(pad.compliance - flexibility).max() < 1e-10 * np.abs(flexibility).max()
        assert np.abs(pad.stiffness @ flexibility - np.eye(len(s))).max() < 1e-9

    def test_it_is_symmetric_and_coupled(self, pad):
        assert np.array_equal(pad.stiffness, pad.stiffness.T)
        assert np.count_nonzero(pad.stiffness - np.diag(np.diag(pad.stiffness))) > 0.9 * pad.stiffness.size

    def test_modulus_is_a_pure_gain(self, pad):
        stiffer = replace(pad, E=1e3 * pad.E, material="glass")
        assert np.abs(stiffer.stiffness / 1e3 - pad.stiffness).max() < 1e-12 * np.abs(pad.stiffness).max()

    def test_units_change_nothing(self, pad):
        """The same pad in other units: mm and MPa."""
        other = Pad(size=(20.0, 16.0), thickness=3.0, E=0.147, nu=0.3223, pitch=2.0, layers=3, material="mm, MPa")
        assert np.abs(other.stiffness - 1e-3 * pad.stiffness).max() < 1e-12 * np.abs(other.stiffness).max()


class TestPoints:
    POINTS = np.random.default_rng(3).uniform([-10e-3, -8e-3, 0], [10e-3, 8e-3, 3e-3], (9, 3))

    def test_rows_agree_with_the_field_point_by_point(self, pad):
        rows = pad.rows(self.POINTS).toarray()
        for i, place in enumerate(self.POINTS):
            for axis in range(3):
                assert np.abs(rows[3 * i + axis] - pad.structure.field.motion(place, axis + 1)).max() < 1e-12

    def test_transfer_is_motion_under_unit_forces(self, pad):
        f = patch(pad, radius=5e-3)
        u = (pad.rows(self.POINTS) @ pad.solve(f)).reshape(-1, 3)
        assert pad.transfer(self.POINTS, "ZX") @ f.ravel() == pytest.approx(u[:, [2, 0]].ravel(), rel=1e-10, abs=1e-16)
        fresh = replace(pad)
        assert "_condensed" not in fresh.__dict__
        assert np.abs(fresh.transfer(self.POINTS, "ZX") - pad.transfer(self.POINTS, "ZX")).max() < 1e-12

    def test_interior_follows_the_surface(self, pad):
        f = patch(pad, radius=5e-3)
        u = pad.solve(f)
        assert pad.from_surface(self.POINTS) @ u[pad.dofs] == pytest.approx(pad.rows(self.POINTS) @ u, rel=1e-10)

    def test_two_columns_lie_on_the_surface(self, pad):
        top = np.column_stack([self.POINTS[:, :2], np.full(9, 3e-3)])
        assert (pad.rows(self.POINTS[:, :2]) != pad.rows(top)).nnz == 0
        assert np.abs(pad.transfer(pad.nodes2d) - pad.compliance).max() < 1e-14 * np.abs(pad.compliance).max()

    def test_base_does_not_move(self, pad):
        base = np.column_stack([self.POINTS[:, :2], np.zeros(9)])
        assert np.all(pad.transfer(base) == 0)

    @pytest.mark.parametrize(
        ("points", "word"),
        [
            ([[0.0, 0.0, 0.0031]], "point 0"),
            ([[0.0, 0.0], [0.011, 0.0]], "point 1"),
            ([[0.0, np.nan]], "point 0"),
            ([0.0, 0.0], "shape"),
        ],
    )
    def test_points_outside_are_named(self, pad, points, word):
        with pytest.raises(InputError, match=word):
            pad.rows(points)


class TestGeometry:
    def test_frame(self, pad):
        assert pad.nodes2d.min(axis=0) == pytest.approx([-10e-3, -8e-3])
        assert pad.nodes2d.max(axis=0) == pytest.approx([10e-3, 8e-3])
        assert pad.surface.coordinates[:, 2] == pytest.approx(3e-3)
        assert pad.surface.normals == pytest.approx(np.tile([0, 0, 1.0], (pad.points, 1)))

    def test_edge_is_the_rim(self, pad):
        x, y = np.abs(pad.nodes2d).T
        assert np.array_equal(pad.edge, (x > 9.99e-3) | (y > 7.99e-3))

    def test_resultant_is_about_the_middle_of_the_surface(self, pad):
        f = np.zeros((pad.points, 3))
        corner = int(np.argmax(pad.nodes2d.sum(axis=1)))
        f[corner] = 0.1, 0.2, -1.0
        assert pad.resultant(f) == pytest.approx([0.1, 0.2, -1.0, -8e-3, 10e-3, 10e-3 * 0.2 - 8e-3 * 0.1])

    def test_pitch_and_elements(self):
        given = Pad(size=(4e-3, 3e-3), thickness=1e-3, E=1e5, nu=0.4, elements=(8, 6), layers=3)
        assert Pad(size=(4e-3, 3e-3), thickness=1e-3, E=1e5, nu=0.4, pitch=0.5e-3, layers=3).points == given.points
        assert Pad(size=(4e-3, 3e-3), thickness=2e-3, E=1e5, nu=0.4, layers=3).elements == (8, 6)

    def test_basis_is_every_node_along_every_axis(self, pad):
        columns = pad.basis.columns(pad.structure)
        assert len(pad.basis) == 3 * pad.points
        assert np.array_equal(columns.tocsc().indices, pad.dofs)

    @pytest.mark.parametrize("force", [(0.0, 0.0, -1.0), (0.3, 0.0, -1.0), (0.3, -0.2, 1.0)])
    def test_motion_is_that_of_the_whole_stiffness(self, pad, force):
        """Symmetric, half symmetric and crooked loads."""
        f = patch(pad, force, radius=5e-3)
        f[3] += np.array(force) * (force[1] != 0)
        load = np.zeros(pad.structure.n)
        load[pad.dofs] = f.ravel()
        wanted = Factor.of(pad.structure).solve(load[pad.structure.free])
        assert np.abs(pad.solve(f)[pad.structure.free] - wanted).max() < 1e-12 * np.abs(wanted).max()


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"size": (0.02, -0.01)}, "side"),
        ({"size": 0.02}, "size"),
        ({"thickness": 0.0}, "thickness"),
        ({"nu": 0.5}, "Poisson"),
        ({"E": -1.0}, "E"),
        ({"layers": 0}, "layers"),
        ({"element": "quad"}, "element"),
        ({"elements": (4, 4)}, "two divisions"),
        ({"pitch": None, "elements": 4}, "elements"),
        ({"pitch": 1e-6}, "cells"),
        ({"pitch": -1e-3}, "pitch"),
    ],
)
def test_impossible_pads_are_refused(change, word):
    with pytest.raises(InputError, match=word):
        Pad(**{**GEL, **change})


@pytest.mark.parametrize("forces", [np.zeros((3, 3)), np.full((99, 3), np.nan), "none"])
def test_forces_that_do_not_fit_are_refused(pad, forces):
    with pytest.raises(InputError):
        pad.solve(forces)
