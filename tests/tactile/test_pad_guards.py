"""Guards of the pad: E110, W111, W112, W115 and those of locking, each raised and silent; pads from TOML files."""

import numpy as np
import pytest

from structures import InputError
from structures._flags import codes
from tactile import Pad
from tactile import _guards as guards
from tactile._pad import body as outline

GEL = {"size": (8e-3, 8e-3), "thickness": 3e-3, "E": 147e3, "nu": 0.3223, "pitch": 2e-3}


class TestModulus:
    @pytest.mark.parametrize(("E", "threshold"), [(147e6, 1e7), (600.0, 1e3), (999.0, 1e3)])
    def test_raised(self, E, threshold):
        (flag,) = Pad(**{**GEL, "E": E}).flags
        assert flag.code == "LID-W111"
        assert (flag.evidence.value, flag.evidence.threshold) == (E, threshold)
        assert f"{E:.4g}" in flag.message
        assert "pure gain" in flag.message

    @pytest.mark.parametrize("E", [1e3, 147e3, 1e7])
    def test_silent(self, E):
        assert Pad(**{**GEL, "E": E}).flags == ()

    def test_other_materials_are_not_asked(self):
        assert Pad(**{**GEL, "E": 210e9}, material="steel").flags == ()


class TestLayers:
    @pytest.mark.parametrize(("layers", "wrong"), [(1, "54 %"), (2, "13 %")])
    def test_raised(self, layers, wrong):
        (flag,) = Pad(**GEL, layers=layers).flags
        assert flag.code == "LID-W115"
        assert flag.evidence.value == layers
        assert wrong in flag.message

    def test_silent(self):
        assert Pad(**GEL, layers=3).flags == ()
        assert Pad(**GEL, layers=1, allow="W115").flags == ()


class TestLargeStrain:
    def test_raised_and_silent(self):
        pad = Pad(**GEL)
        f = pad.surface.forces(np.tile([0.0, 0.0, -1e3], (pad.points, 1)))
        size = np.abs(pad.strain(f)).max()
        assert pad.strained(0.099 / size * f) is None
        flag = pad.strained(0.3 / size * f)
        assert flag.code == "LID-W112"
        assert flag.evidence.value == pytest.approx(0.3)
        assert "30.0 %" in flag.message

    def test_strain_of_a_column(self):
        """A pad on frictionless ground has uniform strain; here: far thinner than wide, the middle is confined."""
        pad = Pad(size=(8e-3, 8e-3), thickness=0.4e-3, E=147e3, nu=0.3223, pitch=0.8e-3, layers=3)
        p, nu = 1e3, 0.3223
        f = pad.surface.forces(np.tile([0.0, 0.0, -p], (pad.points, 1)))
        confined = p / pad.E * (1 + nu) * (1 - 2 * nu) / (1 - nu)
        strain = pad.strain(f).reshape(3, 10, 10)
        assert strain[:, 4:6, 4:6] == pytest.approx(-confined, rel=0.02)

    def test_sign_is_told(self):
        pad = Pad(**GEL)
        f = pad.surface.forces(np.tile([0.0, 0.0, 1e3], (pad.points, 1)))
        assert pad.strain(f).max() > -pad.strain(f).min()


class TestLocking:
    def test_refused_warned_silent(self):
        with pytest.raises(InputError, match="LID-E109"):
            Pad(**{**GEL, "nu": 0.495}, element="standard")
        for shape in (None, outline.rounded(2e-3)):
            assert codes(Pad(**{**GEL, "nu": 0.495}, element="standard", allow="E109", outline=shape).flags) == {"E109"}
            assert codes(Pad(**{**GEL, "nu": 0.47}, element="standard", outline=shape).flags) == {"W108"}
            assert Pad(**{**GEL, "nu": 0.499}, outline=shape).flags == ()


class TestCounts:
    def test_the_published_mesh_is_impossible(self):
        """1964 hexahedra with 3698 nodes in one layer: more than 3928 are needed."""
        with pytest.raises(InputError, match="LID-E110") as caught:
            guards.counts(1964, 3698)
        assert "1964" in str(caught.value)
        assert "3934 to 7860 nodes" in str(caught.value)

    @pytest.mark.parametrize(("nx", "ny", "layers"), [(1, 1, 1), (7, 1, 2), (20, 16, 1), (5, 9, 4)])
    def test_rectangles_are_possible(self, nx, ny, layers):
        nodes = (nx + 1) * (ny + 1) * (layers + 1)
        guards.counts(nx * ny * layers, nodes, layers=layers)
        guards.counts(nx * ny * layers, nodes, layers=layers, boundary_edges=2 * (nx + ny))
        with pytest.raises(InputError, match=f"{nodes} nodes"):
            guards.counts(nx * ny * layers, nodes + layers + 1, layers=layers, boundary_edges=2 * (nx + ny))

    def test_any_outline_is_possible(self):
        rng = np.random.default_rng(0)
        for _ in range(5):
            cells = np.zeros((6, 6), bool)
            j = i = 3
            for _ in range(14):
                cells[j, i] = True
                j, i = np.clip((j, i) + np.array([[0, 1], [1, 0], [0, -1], [-1, 0]])[rng.integers(4)], 0, 5)
            places, quads = outline.mask(cells).on((6.0, 6.0), (6, 6))
            holes = len(places) - len(edges(quads)) + len(quads) != 1
            if not holes:
                guards.counts(3 * len(quads), 4 * len(places), layers=3)

    @pytest.mark.parametrize(
        ("cells", "nodes", "settings"),
        [
            (10, 22, {"layers": 3}),
            (4, 19, {}),
            (4, 30, {}),
            (4, 18, {"boundary_edges": 7}),
            (4, 18, {"boundary_edges": 40}),
        ],
    )
    def test_refused(self, cells, nodes, settings):
        with pytest.raises(InputError, match="Euler"):
            guards.counts(cells, nodes, **settings)


def edges(quads):
    return np.unique(np.sort(np.stack([quads.ravel(), np.roll(quads, -1, axis=1).ravel()], 1), axis=1), axis=0)


class TestToml:
    TEXT = """
        [pad]
        size = ["20 mm", "16 mm"]
        thickness = "3 mm"
        E = "0.147 MPa"
        nu = 0.3223
        pitch = "2 mm"
        layers = 3
        rounded = "4 mm"
    """

    def test_the_pad_of_a_file(self, tmp_path):
        (tmp_path / "pad.toml").write_text(self.TEXT)
        pad = Pad.from_toml(tmp_path / "pad.toml")
        wanted = Pad(
            size=(20e-3, 16e-3), thickness=3e-3, E=147e3, nu=0.3223, pitch=2e-3, layers=3, outline=outline.rounded(4e-3)
        )
        assert abs(pad.structure.K - wanted.structure.K).max() < 1e-10 * abs(wanted.structure.K).max()

    @pytest.mark.parametrize(("old", "new"), [("[pad]", "[skin]"), ('"3 mm"', '"thick"'), ("nu =", "mu =")])
    def test_refused(self, tmp_path, old, new):
        (tmp_path / "pad.toml").write_text(self.TEXT.replace(old, new, 1))
        with pytest.raises(InputError, match=r"pad\.toml"):
            Pad.from_toml(tmp_path / "pad.toml")


class TestPublishedCounts:
    def test_refused(self):
        with pytest.raises(InputError, match="LID-E110"):
            Pad(**GEL, layers=1, counts=(1964, 3698))
        for counts in ((1964,), 1964, (1964, 3698.5), (0, 8)):
            with pytest.raises(InputError, match="counts"):
                Pad(**GEL, layers=1, counts=counts)

    def test_silent(self):
        assert Pad(**GEL, layers=1, counts=(320, 714), allow="W115").flags == ()
