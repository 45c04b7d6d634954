"""The FE pad against the exact layer: plane waves, a Hertz patch, locking."""

from functools import cache

import numpy as np
import pytest

from tactile import Pad, Press

from .padtruth import consistent, map_error, recovered

NUS = (0.3, 0.3223, 0.4, 0.45, 0.475, 0.49, 0.499)
# literature page: pressure at kh = 1, 2, 4 and shear over the pressure at kh = 2
WAVES = {
    (1, 0.25, "standard"): ((1.12, 1.29, 1.41, 0.41), (1.45, 2.01, 2.05, 1.00), (3.3, 6.1, 6.0, 4.3)),
    (2, 0.25, "standard"): ((1.02, 1.03, 1.03, 0.09), (1.10, 1.21, 1.23, 0.22), (1.57, 2.31, 2.49, 1.0)),
    (4, 0.25, "standard"): ((1.00, 0.99, 0.94, 0.02), (1.02, 1.04, 1.06, 0.05), (1.15, 1.43, 1.72, 0.25)),
    (4, 0.25, "bbar"): ((0.99, 0.97, 0.89, 0.01), (1.00, 0.96, 0.88, 0.01), (1.01, 0.96, 0.88, 0.01)),
    (8, 0.125, "bbar"): ((1.00, 0.99, 0.97, 0.003), (1.00, 0.99, 0.97, 0.002), (1.00, 0.99, 0.97, 0.002)),
}
# map error and peak of a Hertz patch as wide as the pad is thick, 1 N, at nu = .3223, .475, .49
HERTZ = {
    (1, "standard"): ((0.54, 1.25), (2.6, 2.8), (6.2, 5.6)),
    (2, "standard"): ((0.13, 1.03), (0.64, 1.43), (1.6, 2.2)),
    (4, "standard"): ((0.050, 0.99), (0.22, 1.12), (0.55, 1.37)),
    (4, "bbar"): ((0.051, 0.98), (0.056, 0.97), (0.058, 0.97)),
}
PRESS = Press(radius=3e-3, force=1.0)


def pad(nu, layers=4, element="bbar", pitch=1e-3):
    return Pad(
        size=(24e-3, 24e-3), thickness=3e-3, E=147e3, nu=nu, pitch=pitch, layers=layers, element=element, allow="W115"
    )


kept = cache(pad)  # coarse ones: several tests ask the same pad


class TestPlaneWaves:
    @pytest.mark.parametrize("mesh", WAVES)
    def test_the_table_of_the_literature_page(self, mesh):
        layers, side, element = mesh
        for nu, row in zip((0.3223, 0.45, 0.49), WAVES[mesh], strict=True):
            found = [recovered(kh, nu, layers=layers, side=side, element=element) for kh in (1, 2, 4)]
            pressure, shear = [abs(t[2]) for t in found], abs(found[1][0])
            assert pressure == pytest.approx(row[:3], rel=0.02)
            assert shear == pytest.approx(row[3], rel=0.05, abs=0.0051 if row[3] > 0.005 else 0.0006)

    @pytest.mark.parametrize("nu", NUS)
    @pytest.mark.parametrize("angle", [0.0, np.pi / 4])
    def test_a_fine_mesh_is_the_layer(self, nu, angle):
        """Pressure and both shears, with what they leak into the other components."""
        along = np.array([np.cos(angle), np.sin(angle), 0])
        for kh, limit in ((0.25, 0.02), (1, 0.02), (2, 0.02), (4, 0.04)):
            for t in (np.array([0, 0, 1.0]), along, np.array([-along[1], along[0], 0])):
                found = recovered(kh, nu, layers=8, side=1 / 8, traction=t, angle=angle)
                assert np.linalg.norm(found - t) < limit

    def test_one_layer_is_not(self):
        for nu, limit in ((0.3223, 0.4), (0.45, 1.0)):
            assert np.linalg.norm(recovered(2, nu, layers=1, side=1 / 4, element="standard") - [0, 0, 1]) > limit


class TestHertzPatch:
    @pytest.mark.parametrize("scheme", HERTZ)
    @pytest.mark.parametrize("column", [0, 1, 2])
    def test_the_table_of_the_literature_page(self, scheme, column):
        layers, element = scheme
        force, error, peak = map_error(kept((0.3223, 0.475, 0.49)[column], layers, element), PRESS)
        assert error == pytest.approx(HERTZ[scheme][column][0], rel=0.025)
        assert peak == pytest.approx(HERTZ[scheme][column][1], rel=0.02)
        assert np.abs(force[:2]).max() < 1e-12
        if element == "bbar":
            assert error <= (0.055, 0.060, 0.060)[column]

    def test_eight_layers_near_incompressibility(self):
        assert map_error(pad(0.49, 8, pitch=0.5e-3), PRESS)[1] <= 0.032

    def test_partial_validation_trap(self):
        """One layer: the resultant is right to three digits, the map wrong by half."""
        force, error, _ = map_error(kept(0.3223, 1, "standard"), PRESS)
        assert -force[2] == pytest.approx(1.0, abs=1e-3)
        assert error > 0.5


@pytest.mark.parametrize(
    ("nu", "layers", "pitch", "excess"),
    [(0.3223, 4, 1e-3, 0.031), (0.49, 4, 1e-3, 0.051), (0.49, 6, 0.5e-3, 0.008)],
)
def test_forward_against_the_layer(nu, layers, pitch, excess):
    """Centre under a Hertz patch: by how much the finite elements are too deep (literature page)."""
    mesh = kept(nu, layers, "bbar") if pitch == 1e-3 else pad(nu, layers, pitch=pitch)
    depth = mesh.displacements(consistent(mesh, PRESS))[np.argmin(np.linalg.norm(mesh.nodes2d, axis=1)), 2]
    exact = PRESS.displacement(mesh.layer, np.zeros((1, 2)))[0, 2]
    assert depth / exact - 1 == pytest.approx(excess, abs=1e-3)


# 1 N over the nodes with r < 3.1 mm, pad 16 x 16 x 4 mm, mm: plain 8 x 8 x 2, plain and B-bar 16 x 16 x 4
LOCKING = {0.3: (0.600, 0.701, 0.708), 0.45: (0.410, 0.515, 0.534), 0.499: (0.056, 0.148, 0.454)}


@pytest.mark.parametrize("nu", LOCKING)
def test_locking(nu):
    found = []
    for n, layers, element in ((8, 2, "standard"), (16, 4, "standard"), (16, 4, "bbar")):
        gel = Pad(
            size=(16e-3, 16e-3), thickness=4e-3, E=147e3, nu=nu, elements=(n, n), layers=layers, element=element,
            allow=("E109", "W115"),
        )  # fmt: skip
        r = np.linalg.norm(gel.nodes2d, axis=1)
        f = np.zeros((gel.points, 3))
        f[r < 3.1e-3, 2] = -1 / np.count_nonzero(r < 3.1e-3)
        u = gel.displacements(f)
        found.append(1e3 * (np.abs(u).max() if n == 8 else -u[np.argmin(r), 2]))
    assert found == pytest.approx(LOCKING[nu], rel=0.006)
