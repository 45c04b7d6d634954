"""The case studies of force maps on one pad, pinned: the figures that they print."""

import numpy as np
import pytest

from case_studies import foreign_gel, gelslim, ifem2, live_day, one_press


@pytest.fixture(scope="module")
def run():
    return gelslim.push_and_slide(push=2, slide=1)


@pytest.fixture(scope="module")
def press():
    return one_press.one_press()


@pytest.fixture(scope="module")
def foreign():
    return foreign_gel.maps(foreign_gel.pad(), ("in the plane", "and depth", "and depth, no pull"))


class TestSingleLayer:
    """Figures of the literature page (T1), within 5 %."""

    def test_without_noise(self):
        found = gelslim.single_layer()
        assert found.deepest == pytest.approx(1.347, abs=1e-3)
        assert found.kappa == pytest.approx(70.6, rel=1e-3)
        assert (found.largest, found.smallest) == pytest.approx((83.6, 1.18), rel=5e-3)
        assert found.error < 1e-12
        assert found.reactions == pytest.approx([-0.5, 0, 2], abs=1e-9)
        assert found.moved_outside == pytest.approx(0.18, rel=0.03)

    def test_under_noise(self):
        few, many = gelslim.noisy_layer(draws=5)
        expected = {"naive": (0.127, 0.51), "oracle": (0.087, 0.22), "gcv": (0.127, 0.35), "discrepancy": (0.088, 0.22)}
        for rule, (low, high) in expected.items():
            assert few[rule].map == pytest.approx(low, rel=0.06)
            assert many[rule].map == pytest.approx(high, rel=0.06)
        assert few["gcv"].edge == 1
        assert many["discrepancy"].normal == pytest.approx(0.073, abs=0.025)
        assert many["discrepancy"].peak == pytest.approx(0.91, abs=0.03)

    def test_the_model_trap_reaches_the_resultant_only(self):
        rows = gelslim.trap()
        assert [r.map for r in rows] == pytest.approx([0.35, 0.53, 0.60], rel=0.015)
        for r in rows:
            assert r.force == pytest.approx([0.5, 0, -2], rel=0.01, abs=1e-9)
            assert r.validation.agrees
            assert r.validation.partial
            assert r.validation.level == "resultant"
        assert "level: resultant, partial" in gelslim.show_trap(rows)


class TestPushAndSlide:
    def test_the_surface_is_that_of_a_sphere(self, run):
        assert run.misfit < 6e-6

    def test_resultants_agree_and_the_map_of_one_layer_is_wrong(self, run):
        thin, thick = run.rows[1], run.rows[3]
        for row in (thin, thick):
            assert all(v.agrees and v.partial for v in row.validations)
        assert thin.map > 0.5
        assert thick.map < 0.1
        assert thick.cosine > 0.99

    def test_a_completed_sphere_serves_four_layers_better_than_one(self, run):
        assert abs(run.rows[0].errors.bias[2]) > 0.08
        assert abs(run.rows[2].errors.bias[2]) < 0.06
        assert run.rows[0].last.provided["z"] == "completed"
        assert run.rows[1].last.provided["z"] == "measured"

    def test_words_and_picture(self, run, tmp_path):
        assert "level: resultant, partial; agrees in 3 frames" in gelslim.show_run(run)
        gelslim.picture(run, tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 20_000


class TestOnePress:
    def test_motion_and_force_outside_the_patch(self, press):
        assert press.moved_outside > 0.35
        assert press["truth", 0.0].outside == 0
        for model in ("GelSlim, 4 layers", "MultilayerPad"):
            assert press[model, 0.0].outside < 0.09
            assert press[model, one_press.NOISE].error < 0.08
        assert press["f = c u", 0.0].outside == pytest.approx(press.moved_outside, rel=1e-9)
        assert press["f = c u", 0.0].error > 1

    def test_force_at_the_edge_may_oppose_the_motion(self, press):
        for noise in (0.0, one_press.NOISE):
            for model in ("GelSlim, 4 layers", "MultilayerPad"):
                assert press[model, noise].shared >= 4  # the same nodes as in truth
            assert press["f = c u", noise].opposed == 0
        assert press["truth", 0.0].opposed == 9

    def test_words_and_picture(self, press, tmp_path):
        assert "0 of 48" in one_press.show(press)
        one_press.picture(press, tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 20_000


class TestLiveDay:
    def test_what_is_said_and_how_wrong_the_force_is(self):
        found = live_day.live_day(short=True)
        said = {part.name: part.said for part in found.parts if part.said}
        assert said == {
            "light falls by a third": ["+light"],
            "light is back": ["-light"],
            "black frames": ["+no image"],
            "frames are back": ["-no image"],
            "eight dots are worn off": ["+markers lost"],
            "hand over a third": ["+covered", "-markers lost"],
            "hand is gone": ["+markers lost", "-covered"],
            "let go": ["-markers lost"],
            "camera is knocked": ["+camera moved", "zeroed", "-camera moved"],
            "object slides": ["+sliding"],
        }
        for part in found.parts:
            if part.name not in ("hand over a third", "black frames"):
                assert part.error < 0.012, part.name
                assert part.maps == part.frames
        assert found["hand over a third"].error < 0.15 * found["hand over a third"].force
        assert found["black frames"].maps == 0
        value, std = found.friction
        assert value == pytest.approx(live_day.MU, abs=2 * std)
        assert std < 0.03
        assert found.counts["dead"] == 10
        assert "friction learned" in live_day.show(found)


class TestSeveralLayers:
    def test_own_data(self):
        """Figures of the literature page (T2), within 6 %."""
        (row,) = ifem2.own_data((20e-6,), 5, meshes=((3, "standard", 3e-3),))
        assert row.kappa == pytest.approx(27.2, rel=2e-3)
        for rule, figure in {"naive": 0.186, "oracle": 0.160, "discrepancy": 0.177}.items():
            assert row.rules[0][rule].map == pytest.approx(figure, rel=0.06)

    def test_a_hertz_patch_without_noise(self):
        one, four = ifem2.hertz((0.3223,), ((1, "standard", 1e-3), (4, "bbar", 1e-3)))
        assert one.error > 0.53
        assert four.error < 0.055
        assert one.force == pytest.approx(1, abs=2e-3)

    def test_edges_take_from_the_resultant(self):
        rows = ifem2.edges((16e-3, 32e-3), (0.45,))
        assert rows[0][2] < 0.9 < 0.98 < rows[1][2]

    def test_under_noise(self):
        """On a smaller pad; against the naive single layer, and ridge against ridge."""
        found = {name: tables[0] for name, tables in ifem2.noisy_patch((20e-6,), 3, side=14e-3).items()}
        one, four = found["1 layer"], found["4 layers"]
        assert four["naive"].map < 0.6 * one["naive"].map
        assert four["upre"].map < 0.6 * one["naive"].map
        assert four["upre"].map < 0.8 * four["naive"].map
        assert four["upre"].map < 1.05 * four["oracle"].map

    def test_modulus_and_poissons_ratio_in_the_sensor(self):
        modulus, shape = ifem2.calibrated(pitch=0.8e-3, layers=5)
        assert pytest.approx(ifem2.TRUE_E, rel=0.015) == modulus.E
        assert shape.inside
        assert shape.nu == pytest.approx(ifem2.TRUE_NU, abs=0.006)
        assert pytest.approx(ifem2.TRUE_E, rel=0.015) == shape.gain.E

    def test_the_sensors_on_the_same_presses(self):
        table = ifem2.benchmark(1, (2e-6, 20e-6), ("upre",))
        one, four = ("GelSlim, 1 layer", "GelSlim, 4 layers")
        ridge = "MultilayerPad, upre"
        for noise in (2e-6, 20e-6):
            assert table[four, noise].metrics.error < 0.3 * table[one, noise].metrics.error
            assert table[ridge, noise].metrics.cosine > 0.96
        assert table[ridge, 20e-6].metrics.error < 0.8 * table[four, 20e-6].metrics.error
        assert abs(table[ridge, 2e-6].force_z) < 0.06
        assert np.all([row.metrics.kind == "distribution" for row in table.rows])


class TestForeignGel:
    """A gel of other finite elements than those of the sensor."""

    def test_forces(self, foreign):
        for row in foreign:
            assert np.all(np.abs(row.away[:2]) < 0.02)
            if row.sensor == "in the plane":
                assert abs(row.away[2]) < row.band[2]
            else:
                assert abs(row.away[2]) < 0.1

    def test_maps(self, foreign):
        off = {name: [r.map for r in foreign if r.sensor == name] for name in ("and depth", "and depth, no pull")}
        assert max(off["and depth"]) < 0.4
        assert max(off["and depth, no pull"]) < 0.3
        assert max(r.map for r in foreign if r.sensor == "in the plane") < 0.5

    def test_a_pad_that_is_declared_wrong_is_found(self):
        found = foreign_gel.in_situ()
        at = np.array([np.log(found.pad.E / foreign_gel.E), found.pad.nu - foreign_gel.NU,
                       np.log(found.pad.thickness / foreign_gel.THICKNESS)])  # fmt: skip
        assert np.all(np.abs(at) < [0.05, 0.01, 0.03])
        assert np.all(np.abs(at) < 2.5 * np.sqrt(np.diag(found.covariance)))
        assert not found.flags
        assert "told: E, nu, thickness" in foreign_gel.show_material(found)

    def test_words_and_picture(self, foreign, tmp_path):
        assert "ring" in foreign_gel.show(foreign)
        foreign_gel.picture(foreign, tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 20_000
