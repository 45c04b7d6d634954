"""The case studies of routes and designs, pinned: the figures that they print."""

import numpy as np
import pytest

from case_studies import gelforce, skin_design, three_routes


@pytest.fixture(scope="module")
def lines():
    """One press on a smaller pad."""
    return three_routes.table(three_routes.Rig(side=18e-3, seen=12e-3), ratios=(0.5,), draws=2)


class TestGelForce:
    def test_depth_over_pitch_decides(self):
        """Reference case at depths of 2 and 4 mm: kappa 5.9e3, pseudo-inverse 1.24, best lambda 0.304, GCV 0.307."""
        row = gelforce.depth(gelforce.DEPTHS[2], seeds=3)
        assert row.kappa == pytest.approx(5.87e3, rel=0.01)
        assert row.clean < 1e-12
        assert row.plain == pytest.approx(1.24, rel=0.15)
        assert row.plain == pytest.approx(row.expected, rel=0.2)
        assert row.oracle == pytest.approx(0.304, rel=0.08)
        assert row.gcv == pytest.approx(0.307, rel=0.08)
        assert row.oracle <= row.gcv
        assert row.gcv < row.discrepancy < 0.4
        assert row.force < 0.006
        assert row.warned
        assert row.in_plane[1] > 10 * row.expected

    def test_a_bonded_pad_takes_the_resultant_of_a_half_space_first(self):
        thick, layer = gelforce.bonded(0.1, side=11)
        assert thick.force == pytest.approx(0.70, abs=0.03)
        assert thick.inside == pytest.approx(1.0, abs=0.03)
        assert thick.error < 2 * layer.error
        thin, layer = gelforce.bonded(1.0, side=11)
        assert abs(thin.force) < 0.06
        assert thin.inside < 0.3
        assert layer.force == pytest.approx(0.97, abs=0.03)
        assert layer.shear == pytest.approx(0.985, abs=0.02)
        assert "E602" in thin.flags
        assert not layer.flags

    def test_guards(self):
        assert gelforce.refused(0.05) == "nothing"
        assert "W601" in gelforce.refused(0.2)
        assert "12 % too soft" in gelforce.refused(0.2)
        assert gelforce.refused(0.5).startswith("refused, [LID-E602]")
        assert "knows no edge" in gelforce.refused(0.05, 24e-3)
        assert gelforce.refused(0.05, 0.2) == "nothing"

    def test_softness_is_that_of_the_reference(self):
        known = [0.926, 0.854, 0.783, 0.650, 0.505, 0.388, 0.230, 0.143]
        assert gelforce.softness(0.49) == pytest.approx(known, abs=1e-3)


class TestThreeRoutes:
    def test_one_layer_has_the_resultant_and_not_the_map(self, lines):
        by = {x.route: x for x in lines}
        slim, ridge = by["GelSlim, one layer"], by["multilayer, ridge"]
        for x in (slim, ridge):
            assert np.linalg.norm(x.force - [0.0625, 0, -0.25]) < 0.04 * 0.25
        assert slim.error > 0.8
        assert slim.bias > 0.8
        assert "W115" in slim.flags
        assert ridge.error < 0.13
        assert ridge.bias < 0.09
        assert ridge.cosine > 0.99
        assert ridge.radius == pytest.approx(1.5e-3, rel=0.08)
        assert "W115" not in ridge.flags

    def test_a_half_space_has_place_and_shape_and_no_force(self, lines):
        by = {x.route: x for x in lines}
        half, layer, full = (by[f"GelForce, {name}"] for name in ("half-space", "layer", "layer, z to 10 um"))
        assert abs(half.force[2]) < 0.5 * 0.25
        assert half.cosine > 0.85
        assert {"E602", "N606"} <= set(half.flags)
        assert layer.force[0] == pytest.approx(0.0625, rel=0.05)
        assert abs(layer.force[2]) < 0.75 * 0.25  # in-plane motion leaves it to the prior
        assert full.force[2] == pytest.approx(-0.25, rel=0.25)
        assert full.error < layer.error < half.error

    def test_text_and_picture(self, lines, tmp_path):
        assert "a/t = 0.5: radius 1.5 mm" in three_routes.show(lines)
        three_routes.figure(lines, tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 20_000


class TestSkinDesign:
    def test_one_number_for_each_choice(self):
        found = {c.knob: c.numbers for c in skin_design.conclusions()}
        assert list(found) == list(skin_design.KNOBS)
        thick, gain, tight = found["thickness"], found["modulus"], found["compressibility"]
        assert thick["crossover over h"] == pytest.approx(thick["the same, thick"], rel=1e-6)
        assert thick["crossover over h"] == pytest.approx(0.638, abs=1e-3)
        assert thick["signal"] == pytest.approx(2.75, rel=0.01)
        assert thick["kappa"] == pytest.approx(4, rel=0.02)
        assert 0.85 < thick["pressure std"] < 1
        assert all(v == pytest.approx(1, rel=1e-9) for v in gain.values())
        assert tight["long wave"] > 0.99
        assert tight["long wave, tight"] == pytest.approx(0.83, abs=0.01)
        assert tight["locking, tight"] == pytest.approx(0.80, abs=0.02)
        assert found["markers"]["effective"] == pytest.approx(4)
        assert found["markers"]["effective, shared"] < 1.02
        deep, camera = found["depth"], found["camera"]
        assert deep["kappa"] > 500
        assert deep["shear std"] > 10
        assert deep["waves, deep"] < deep["waves"] < 0.9
        assert deep["resolution over its half"] == pytest.approx(1, abs=0.1)
        assert camera["shear slope"] == pytest.approx(1, abs=0.01)
        assert camera["pressure slope"] == pytest.approx(1, abs=0.01)
        assert camera["pressure"] == pytest.approx(0, abs=0.01)
        assert camera["unseen"] == pytest.approx(1 / 3)
        assert camera["prior left"] > 0.98
