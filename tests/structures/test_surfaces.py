"""Faces of solids: geometry, boundary mass, resultants."""

import numpy as np
import pytest

from structures import InputError, solids
from structures._elements.hexfield import FACES
from structures._elements.members import Material

SIDES, ORIGIN = (0.03, 0.02, 0.01), (1.0, -2.0, 0.5)
BLOCK = solids.block(
    lengths=SIDES, elements=(3, 4, 2), material=Material(E=1e5, rho=1.0, nu=0.4), origin=ORIGIN, fixed=None
)


def area(face):
    return np.prod([side for k, side in enumerate(SIDES) if k != FACES[face][0]])


@pytest.mark.parametrize("face", FACES)
class TestEveryFace:
    def test_nodes_lie_on_it(self, face):
        surface, (axis, end) = BLOCK.field.surface(face), FACES[face]
        assert np.array_equal(surface.coordinates, BLOCK.coordinates[surface.nodes])
        assert surface.coordinates[:, axis] == pytest.approx(ORIGIN[axis] + end * SIDES[axis], abs=1e-15)
        on_it = np.isclose(BLOCK.coordinates[:, axis], ORIGIN[axis] + end * SIDES[axis], atol=1e-12)
        assert sorted(surface.nodes) == np.flatnonzero(on_it).tolist()

    def test_normals_and_cells_face_outwards(self, face):
        surface, (axis, end) = BLOCK.field.surface(face), FACES[face]
        assert np.array_equal(surface.normals, np.tile((2 * end - 1) * np.eye(3)[axis], (len(surface.nodes), 1)))
        a, b, c, d = (surface.coordinates[surface.cells[:, k]] for k in range(4))
        turn = np.cross(c - a, d - b) / 2
        assert turn.sum(axis=0) == pytest.approx(area(face) * surface.normals[0], rel=1e-9, abs=1e-15)
        assert np.all(turn @ surface.normals[0] > 0)
        assert len(np.unique(surface.cells)) == len(surface.nodes)

    def test_the_mass_integrates_bilinear_functions_exactly(self, face):
        surface, axis = BLOCK.field.surface(face), FACES[face][0]
        x = surface.coordinates - np.array(ORIGIN)
        u, v = (x[:, k] / SIDES[k] for k in range(3) if k != axis)
        one = np.ones(len(u))
        for f, g, exact in ((one, one, 1), (u, one, 1 / 2), (u, u, 1 / 3), (u * v, one, 1 / 4), (u * v, u * v, 1 / 9)):
            assert f @ surface.mass @ g == pytest.approx(exact * area(face), rel=1e-12)
        assert surface.areas.sum() == pytest.approx(surface.area, rel=1e-14)
        assert np.all(surface.areas > 0)

    def test_the_resultant_of_a_linear_pressure(self, face):
        """Hydrostatic pressure on a face, about a point that is not the origin."""
        surface, (axis, _) = BLOCK.field.surface(face), FACES[face]
        x = surface.coordinates - np.array(ORIGIN)
        first = next(k for k in range(3) if k != axis)
        pressure = x[:, first] / SIDES[first]
        found = surface.traction_resultant(-pressure[:, None] * surface.normals, about=ORIGIN)
        force = -area(face) / 2 * surface.normals[0]
        centre = np.array([SIDES[k] / 2 for k in range(3)])
        centre[first] = 2 / 3 * SIDES[first]
        centre[axis] = x[0, axis]
        assert found[:3] == pytest.approx(force, rel=1e-12, abs=1e-16)
        assert found[3:] == pytest.approx(np.cross(centre, force), rel=1e-12, abs=1e-16)

    def test_forces_and_tractions_are_inverse(self, face):
        surface = BLOCK.field.surface(face)
        t = np.random.default_rng(0).standard_normal((len(surface.nodes), 3))
        assert surface.tractions(surface.forces(t)) == pytest.approx(t, rel=1e-11)


def test_moments_about_the_origin_of_coordinates():
    surface = BLOCK.field.surface("top")
    up = np.tile([0, 0, 1.0], (len(surface.nodes), 1))
    x, y = ORIGIN[0] + SIDES[0] / 2, ORIGIN[1] + SIDES[1] / 2
    exact = surface.area * np.array([0, 0, 1, y, -x, 0])
    assert surface.traction_resultant(up) == pytest.approx(exact, rel=1e-12)


def test_refining_leaves_a_traction_unchanged_and_divides_the_forces():
    """Twice: the nodal force inside falls with the area, the traction does not."""
    sizes = []
    for n in (4, 8, 16):
        s = solids.block(lengths=(0.1, 0.1, 0.02), elements=(n, n, 1), material=Material(E=1e5, rho=1.0))
        surface = s.field.surface("top")
        f = surface.forces(np.tile([0, 0, -5.0], (len(surface.nodes), 1)))
        sizes.append(np.abs(f).max())
        assert surface.tractions(f)[:, 2] == pytest.approx(-5.0, rel=1e-10)
    assert sizes[0] / sizes[1] == pytest.approx(4)
    assert sizes[1] / sizes[2] == pytest.approx(4)


def test_bad_input_is_refused():
    surface = BLOCK.field.surface("top")
    with pytest.raises(InputError, match="no such face"):
        BLOCK.field.surface("lid")
    for bad in (np.ones((3, 3)), "abc", np.full((len(surface.nodes), 3), np.nan)):
        with pytest.raises(InputError, match="do not fit the surface"):
            surface.forces(bad)
    with pytest.raises(InputError, match="no point"):
        surface.traction_resultant(np.ones((len(surface.nodes), 3)), about=(0, 1))
