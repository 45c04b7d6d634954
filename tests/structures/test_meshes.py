"""General meshes: against the regular block, patch tests, points, boundary, refusals."""

import numpy as np
import pytest

from structures import InputError, bases, solids
from structures._elements.cells import HEX8, TET10
from structures._elements.members import Material
from structures._elements.meshfield import interpolants, largest_strain, motions, strains
from structures._flags import codes
from structures._system.factor import Factor
from tests.benchmarks.assembly import hexahedra, skewed, tetrahedra

GEL = Material(E=2e5, rho=1e3, nu=0.45)
SIDES = (6e-3, 4e-3, 3e-3)
BLOCK = solids.block(lengths=SIDES, elements=(3, 2, 2), material=GEL, element="bbar")


def hexes(block=BLOCK):
    return hexahedra(block)


def tets(n=(2, 2, 2)):
    return tetrahedra(n, SIDES)


MESHES = {
    "hexahedra": solids.mesh(skewed(BLOCK.coordinates, 1e-3), hexes(), material=GEL, fixed=None),
    "plain hexahedra": solids.mesh(
        skewed(BLOCK.coordinates, 1e-3), hexes(), material=GEL, element="standard", fixed=None
    ),
    "tetrahedra": solids.mesh(*tets(), material=GEL, kind="C3D10", fixed=None),
}


@pytest.mark.parametrize("element", ["bbar", "standard"])
def test_boxes_are_those_of_the_block(element):
    block = solids.block(lengths=SIDES, elements=(3, 2, 2), material=GEL, element=element)
    mesh = solids.mesh(block.coordinates, hexes(), material=GEL, element=element)
    assert abs(mesh.K - block.K).max() < 1e-12 * abs(block.K).max()
    assert abs(mesh.M - block.M).max() < 1e-12 * abs(block.M).max()
    assert mesh.supports == block.supports
    ours, theirs = mesh.field.surface("top"), block.field.surface("top")
    assert np.array_equal(ours.nodes, np.sort(theirs.nodes))
    assert abs(ours.mass - theirs.mass).max() < 1e-14 * theirs.area
    assert ours.normals == pytest.approx(theirs.normals)


@pytest.mark.parametrize("name", MESHES)
class TestPatch:
    GRADIENT = np.array([[0.01, 0.02, -0.03], [0.005, -0.01, 0.015], [0.02, -0.005, 0.03]])

    def test_constant_strain_is_exact(self, name):
        """A linear motion prescribed on the boundary: the inside follows, the strain is the same everywhere."""
        mesh = MESHES[name]
        u = (mesh.coordinates @ self.GRADIENT.T).ravel()
        rest = (mesh.K @ u).reshape(-1, 3)
        inner = np.setdiff1d(np.arange(len(rest)), mesh.field.boundary)
        assert np.abs(rest[inner]).max(initial=0.0) < 1e-12 * np.abs(rest).max()
        e = (self.GRADIENT + self.GRADIENT.T) / 2
        wanted = [e[0, 0], e[1, 1], e[2, 2], 2 * e[1, 2], 2 * e[0, 2], 2 * e[0, 1]]
        assert strains(mesh, u) == pytest.approx(np.tile(wanted, (len(mesh.field.cells), 1)), rel=1e-9)
        values = np.linalg.eigvalsh(e)
        assert largest_strain(strains(mesh, u)) == pytest.approx(values[np.argmax(np.abs(values))], rel=1e-9)

    def test_energy_of_a_linear_motion(self, name):
        mesh = MESHES[name]
        u = (mesh.coordinates @ self.GRADIENT.T).ravel()
        volume = mesh.M.sum() / 3 / GEL.rho
        e = (self.GRADIENT + self.GRADIENT.T) / 2
        mu, lam = GEL.E / 2 / (1 + GEL.nu), GEL.E * GEL.nu / (1 + GEL.nu) / (1 - 2 * GEL.nu)
        assert u @ mesh.K @ u == pytest.approx(volume * (2 * mu * np.sum(e * e) + lam * np.trace(e) ** 2), rel=1e-10)

    def test_rigid_motions_cost_nothing(self, name):
        mesh = MESHES[name]
        for u in mesh.field.rigid().values():
            assert np.abs(mesh.K @ u).max() < 1e-11 * abs(mesh.K).max()
        assert len(mesh.rigid_body_motions()) == 6

    def test_linear_fields_are_met_at_any_point(self, name):
        mesh = MESHES[name]
        nodes, rng = mesh.field.cells, np.random.default_rng(1)
        xi = rng.dirichlet(np.ones(4), 12)[:, 1:] if name == "tetrahedra" else rng.uniform(-1, 1, (12, 3))
        corners = mesh.coordinates[nodes[rng.integers(len(nodes), size=12)]]
        places = np.einsum("qn,qnx->qx", mesh.field.cell.shape(xi), corners)
        u = (mesh.coordinates @ self.GRADIENT.T).ravel()
        assert motions(mesh, places) @ u == pytest.approx((places @ self.GRADIENT.T).ravel(), abs=1e-12)
        assert mesh.field.motion(places[0], 2) @ u == pytest.approx(places[0] @ self.GRADIENT[1], abs=1e-13)
        row = mesh.field.direct_strain(places[0], np.array([0.6, 0, 0.8]), None)
        assert row @ u == pytest.approx(np.array([0.6, 0, 0.8]) @ self.GRADIENT @ [0.6, 0, 0.8], rel=1e-9)

    def test_nodes_are_found_where_they_are(self, name):
        mesh = MESHES[name]
        nodes, values = interpolants(mesh, mesh.coordinates)
        assert values.sum(axis=1) == pytest.approx(1.0)
        for i in range(len(mesh.coordinates)):
            assert nodes[i, np.argmax(values[i])] == i

    def test_points_outside_are_refused(self, name):
        with pytest.raises(InputError, match="point 1"):
            motions(MESHES[name], [MESHES[name].coordinates.mean(axis=0), [1.0, 0.0, 0.0]])
        assert not MESHES[name].field.inside((1.0, 0, 0))

    def test_boundary_is_closed(self, name):
        """Gauss: the area vectors of a closed surface cancel, and it encloses the volume (straight sides)."""
        field = MESHES[name].field
        whole = field.surface("all", np.arange(len(field.boundary)))
        pairs = np.sort(np.stack([whole.cells.ravel(), np.roll(whole.cells, -1, axis=1).ravel()], 1), axis=1)
        _, times = np.unique(pairs, axis=0, return_counts=True)
        assert np.all(times == 2)
        assert len(whole.nodes) - len(times) + len(whole.cells) == 2


def test_a_pressed_mesh_moves_like_a_pressed_block():
    """Different cells, one body: tetrahedra and hexahedra against fine bricks."""
    fine = solids.block(lengths=SIDES, elements=(12, 8, 6), material=GEL)
    energies = []
    for structure in (fine, solids.mesh(*tets(), material=GEL, kind="C3D10")):
        top = structure.field.surface("top")
        p = 1e3 * (1 + top.coordinates[:, 0] / SIDES[0])
        f = np.zeros((len(structure.coordinates), 3))
        f[:, 2] = -structure.field.hats(top) @ p if structure is not fine else 0.0
        if structure is fine:
            f[top.nodes, 2] = -(top.mass @ p)
        f = f.ravel()
        u = structure.expand(Factor.of(structure).solve(f[structure.free]))
        energies.append(f @ u)
    assert energies[1] == pytest.approx(energies[0], rel=0.03)


@pytest.mark.parametrize("name", MESHES)
def test_consistent_loads_do_the_work_of_the_traction(name):
    """A linear traction and a linear motion: the work is the integral of their product, the columns sum to areas."""
    mesh = MESHES[name]
    field, top = mesh.field, mesh.field.surface("top")
    H = field.hats(top)
    p, w = 1 + 300 * top.coordinates[:, 0], mesh.coordinates[:, 1]
    assert w @ H @ p == pytest.approx(w[top.nodes] @ top.mass @ p, rel=1e-12)
    assert np.asarray(H.sum(axis=0)).ravel() == pytest.approx(top.areas, rel=1e-12)
    other = MESHES["tetrahedra" if name != "tetrahedra" else "hexahedra"].field.surface("bottom")
    with pytest.raises(InputError, match="none of this mesh"):
        field.hats(other)


def test_loads_on_its_surface():
    """Nodal forces and hats on a curved face: hats carry the boundary mass."""
    lift = np.where(BLOCK.coordinates[:, 2] > 2e-3, 40 * BLOCK.coordinates[:, 0] * BLOCK.coordinates[:, 1], 0)
    mesh = solids.mesh(BLOCK.coordinates + lift[:, None] * [0, 0, 1], hexes(), material=GEL)
    surface = mesh.field.surface("top")
    nodal = bases.nodal(mesh, surface, components=("+X", "+Z"))
    hats = bases.hats(mesh, region=surface, components="+Z")
    assert nodal.points == hats.points == len(surface.nodes)
    assert nodal.columns(mesh).sum() == pytest.approx(len(nodal))
    found = hats.columns(mesh).toarray()[3 * surface.nodes + 2]
    assert np.abs(found - surface.mass.toarray()).max() < 1e-6 * surface.mass.max()
    assert surface.area > SIDES[0] * SIDES[1] * 1.001


class TestRefusals:
    X, C = BLOCK.coordinates, hexes()

    def refused(self, match, nodes=None, cells=None, **settings):
        with pytest.raises(InputError, match=match):
            solids.mesh(
                self.X if nodes is None else nodes, self.C if cells is None else cells, material=GEL, **settings
            )

    def test_inverted_cell(self):
        cells = self.C.copy()
        cells[4] = cells[4][[4, 5, 6, 7, 0, 1, 2, 3]]
        self.refused("cell 4.*inverted", cells=cells)

    def test_flat_cell(self):
        cells = self.C.copy()
        cells[2, 4:] = cells[2, :4]
        self.refused("cell 2", cells=cells)

    def test_orphan_node(self):
        self.refused("node 36: 1 of 37 nodes", nodes=np.vstack([self.X, [1.0, 2.0, 3.0]]))

    def test_node_that_does_not_exist(self):
        cells = self.C.copy()
        cells[5, 3] = 99
        self.refused("cell 5", cells=cells)

    def test_two_parts(self):
        self.refused(
            "2 parts", nodes=np.vstack([self.X, self.X + 0.1]), cells=np.vstack([self.C, self.C + len(self.X)])
        )

    def test_cell_listed_twice(self):
        self.refused("more than two|inverted", cells=np.vstack([self.C, self.C[:1]]))

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            ({"nodes": np.full((36, 3), np.nan)}, "node 0"),
            ({"nodes": np.zeros((36, 2))}, "shape"),
            ({"cells": np.zeros((2, 10), int)}, "C3D8"),
            ({"cells": np.zeros((2, 8))}, "C3D8"),
            ({"kind": "C3D20"}, "C3D10"),
            ({"element": "incompatible"}, "bbar"),
            ({"fixed": "left"}, "base"),
            ({"fixed": [99]}, "base"),
        ],
    )
    def test_other(self, change, match):
        self.refused(match, **change)

    def test_locking_is_refused_and_flagged(self):
        stiff = Material(E=1e5, rho=1.0, nu=0.495)
        with pytest.raises(InputError, match="LID-E109"):
            solids.mesh(self.X, self.C, material=stiff, element="standard")
        allowed = solids.mesh(self.X, self.C, material=stiff, element="standard", allow=("E109",))
        assert codes(allowed.field.flags) == {"E109"}
        soft = Material(E=1e5, rho=1.0, nu=0.46)
        assert codes(solids.mesh(self.X, self.C, material=soft, element="standard").field.flags) == {"W108"}
        assert solids.mesh(self.X, self.C, material=stiff).field.flags == ()


def test_shape_functions_are_a_partition():
    for cell in (HEX8, TET10):
        xi = np.random.default_rng(0).uniform(0, 0.3, (5, 3))
        assert cell.shape(xi).sum(axis=1) == pytest.approx(1.0)
        steps = np.stack([(cell.shape(xi + d) - cell.shape(xi - d)) / 2e-6 for d in 1e-6 * np.eye(3)], axis=2)
        assert cell.slopes(xi) == pytest.approx(steps, abs=1e-8)
