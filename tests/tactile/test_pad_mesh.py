"""Pads with an outline, and pads from mesh files."""

import gzip
from dataclasses import replace

import numpy as np
import pytest

from structures import InputError
from structures._system.layered import reflections
from tactile import Pad
from tactile._pad import body as outline
from tactile._pad.meshfiles import elastic, read
from tactile._pad.pad import placed
from tests.data import measured
from tests.structures.test_meshes import tets

GEL = {"E": 147e3, "nu": 0.45}
RECT = {**GEL, "size": (20e-3, 16e-3), "thickness": 3e-3, "pitch": 2e-3, "layers": 3}
TURN = np.linspace(0, 2 * np.pi, 48, endpoint=False)
CIRCLE = 9e-3 * np.column_stack([np.cos(TURN), np.sin(TURN)])


def push(pad):
    """A smooth traction in the middle as nodal forces."""
    w = np.exp(-np.sum(pad.nodes2d**2, axis=1) / (3e-3) ** 2)
    t = w[:, None] * np.array([400.0, 100.0, -1000.0])
    return t * pad.surface.areas[:, None] if pad._quadratic else pad.surface.forces(t)


def test_a_mesh_has_its_own_shape_and_supports():
    for given in ({"rim": "bonded"}, {"curvature": 0.02}):
        with pytest.raises(InputError, match="its own shape"):
            Pad(**GEL, mesh=object(), **given)


class TestOutline:
    def test_a_mask_that_leaves_everything_is_the_rectangle(self):
        whole, cut = Pad(**RECT), Pad(**RECT, outline=outline.mask(np.ones((8, 10), bool)))
        assert abs(whole.structure.K - cut.structure.K).max() < 1e-12 * abs(whole.structure.K).max()
        assert np.array_equal(whole.edge, cut.edge)
        assert np.abs(cut.displacements(push(cut)) - whole.displacements(push(whole))).max() < 1e-15

    @pytest.mark.parametrize("shape", [outline.rounded(4e-3), outline.polygon(CIRCLE)])
    def test_area_and_rim_follow_the_outline(self, shape):
        pad = Pad(**{**RECT, "size": (20e-3, 20e-3), "pitch": 1e-3}, outline=shape)
        wanted = 20e-3**2 - (4 - np.pi) * 16e-6 if shape.radius else 24 * np.sin(np.pi / 24) * 81e-6
        assert pad.surface.area == pytest.approx(wanted, rel=0.012)
        x, y = np.abs(pad.nodes2d[pad.edge]).T
        if shape.radius:
            corner = (x > 6e-3) & (y > 6e-3)
            off = np.where(corner, np.hypot(x - 6e-3, y - 6e-3) - 4e-3, np.maximum(x, y) - 10e-3)
        else:
            off = np.hypot(x, y) - 9e-3
        assert np.abs(off).max() < 0.35e-3
        assert np.median(np.abs(off)) < 0.03e-3
        assert not shape.radius or len(reflections(pad.structure)) == 2

    def test_stairs_stay_where_asked(self):
        pad = Pad(**RECT, outline=outline.rounded(4e-3, fitted=False))
        assert pad.surface.area == pytest.approx(len(pad.surface.cells) * 4e-6)

    def test_forces_far_from_a_corner_hardly_notice_it(self):
        whole, cut = Pad(**RECT), Pad(**RECT, outline=outline.rounded(4e-3))
        deep = [pad.displacements(push(pad))[:, 2].min() for pad in (whole, cut)]
        assert deep[1] == pytest.approx(deep[0], rel=0.01)
        f = push(cut)
        assert np.abs(cut.forces(cut.displacements(f)) - f).max() < 1e-12 * np.abs(f).max()
        assert np.abs(cut.stiffness @ cut.compliance - np.eye(3 * cut.points)).max() < 1e-8

    def test_points_in_a_cropped_corner_are_outside(self):
        with pytest.raises(InputError, match="point 0"):
            Pad(**RECT, outline=outline.rounded(4e-3)).rows([[9.9e-3, 7.9e-3]])

    @pytest.mark.parametrize(
        ("make", "word"),
        [
            (lambda: outline.rounded(9e-3), "rounder"),
            (lambda: outline.rounded(-1.0), "radius"),
            (lambda: outline.polygon(CIRCLE + 1.0), "no cell"),
            (lambda: outline.polygon(CIRCLE[:2]), "polygon"),
            (lambda: outline.mask(np.ones((3, 3), bool)), "mask"),
            (lambda: outline.mask([[1, 0]]), "truth"),
            (lambda: outline.mask(np.kron(np.eye(2), np.ones((4, 5))).astype(bool)), "2 pieces"),
            (lambda: "round", "outline"),
        ],
    )
    def test_impossible_outlines_are_refused(self, make, word):
        with pytest.raises(InputError, match=word):
            Pad(**RECT, outline=make())


def inp(pad, *, axis=2, scale=1e3, kind="C3D8", more=""):
    """An Abaqus file of a pad, its thickness along another axis, in mm, node numbers with gaps, long cells wrapped."""
    X = np.roll(pad.structure.coordinates, axis - 2, axis=1) * scale
    field = pad.structure.field
    lines = ["** made for a test", "*Heading", " a gel", "*NODE, NSET=ALL"]
    lines += [f"{7 * i + 3}, " + ", ".join(f"{v:.12g}" for v in x) for i, x in enumerate(X)]
    lines += ["", f"*Element, type={kind}, elset=GEL"]
    for number, cell in enumerate(field.cells):
        words = [str(number + 1), *(str(7 * n + 3) for n in cell)]
        lines += [", ".join(words[:6]) + ",", ", ".join(words[6:])]
    lines += ["*NSET, NSET=BASE", ", ".join(str(7 * n + 3) for n in range(pad.points))]
    lines += ["*MATERIAL, NAME=gel", "*HYPERELASTIC, NEO HOOKE", "0.0725, 0.", more]
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def cut():
    return Pad(**RECT, outline=outline.rounded(4e-3))


@pytest.fixture
def file(tmp_path):
    def write(text, name="pad.inp"):
        path = tmp_path / name
        path.write_bytes(gzip.compress(text.encode()) if name.endswith(".gz") else text.encode())
        return path

    return write


class TestFiles:
    @pytest.mark.parametrize("axis", [0, 1, 2])
    @pytest.mark.parametrize("name", ["pad.inp", "pad.inp.gz"])
    def test_the_pad_comes_back(self, cut, file, axis, name):
        pad = Pad.from_mesh(file(inp(cut, axis=axis), name), **GEL)
        assert pad.thickness == pytest.approx(3e-3)
        assert pad.layers == 3
        assert pad.points == cut.points
        assert sorted(pad.size) == pytest.approx(sorted(cut.size), rel=1e-9)
        assert pad.surface.coordinates[:, 2] == pytest.approx(3e-3)
        assert len(pad.structure.supports) == 3 * cut.points
        ours, theirs = (np.sort(np.linalg.eigvalsh(p.compliance)) for p in (pad, cut))
        assert ours == pytest.approx(theirs, rel=1e-8)
        assert "mm, assumed" in pad.mesh.says

    def test_which_end_is_stated(self, cut, file):
        path = file(inp(cut))
        assert "lower end" in Pad.from_mesh(path, **GEL).mesh.says
        other = Pad.from_mesh(path, **GEL, axis="-Z")
        assert "-Z, as stated" in other.mesh.says
        assert other.surface.coordinates[:, 2] == pytest.approx(3e-3)
        with pytest.raises(InputError, match="loaded surface"):
            Pad.from_mesh(path, **GEL, axis="-Z", base="BASE", top="BASE")

    def test_sets_and_units(self, cut, file):
        path = file(inp(cut, scale=1.0))
        pad = Pad.from_mesh(path, **GEL, base="base")
        assert "in m, assumed" in pad.mesh.says
        assert pad.size[0] == pytest.approx(20e-3)
        assert Pad.from_mesh(path, **GEL, unit="cm").size[0] == pytest.approx(20e-5)
        with pytest.raises(InputError, match="ALL, BASE"):
            Pad.from_mesh(path, **GEL, base="bottom")

    def test_arrays(self, cut, tmp_path):
        path = tmp_path / "pad.npz"
        np.savez(path, nodes=cut.structure.coordinates, cells=cut.structure.field.cells)
        pad = Pad.from_mesh(path, **GEL, unit="m")
        assert np.abs(pad.stiffness - cut.stiffness).max() < 1e-9 * np.abs(cut.stiffness).max()

    def test_rebuilt_from_bricks(self, cut, file):
        """The same body on other cells: nearly the same motion."""
        path = file(inp(cut))
        pad = Pad.from_mesh(path, **GEL, pitch=2e-3, layers=3)
        assert pad.surface.area == pytest.approx(cut.surface.area, rel=0.02)
        deep = [p.displacements(push(p))[:, 2].min() for p in (pad, cut)]
        assert deep[0] == pytest.approx(deep[1], rel=0.02)

    @pytest.mark.parametrize(
        ("change", "match"),
        [
            (lambda t: t.replace("\n10, ", "\nten, ", 1), r"line 6.*numbers"),
            (lambda t: t.replace("\n10, ", "\n3, ", 1), "line 6.*twice"),
            (lambda t: t.replace("type=C3D8", "type=C3D20"), "C3D20"),
            (lambda t: t.replace("*Element", "*Ignored"), "no mesh"),
            (lambda t: t.replace("*NODE", "*Ignored"), "0 nodes"),
            (lambda t: t[: t.index("*NSET, NSET=BASE")].rsplit(",", 1)[0], "line"),
            (lambda t: t.replace("*Heading", "*NODE\n99999, 1, 2, 3\n*Heading", 1), "node 99999"),
            (lambda t: t.replace("*Heading", "*NODE\n3, nan, 2, 3\n*Heading", 1), "NaN"),
        ],
    )
    def test_broken_files_are_refused_with_the_place(self, cut, file, change, match):
        with pytest.raises(InputError, match=match) as caught:
            Pad.from_mesh(file(change(inp(cut))), **GEL)
        assert "pad.inp" in str(caught.value)

    def test_every_cut_of_a_file_is_refused_or_read(self, cut, file):
        text = inp(cut)
        for length in np.linspace(0, len(text), 25).astype(int)[:-1]:
            try:
                read(file(text[:length]))
            except InputError:
                continue

    @pytest.mark.parametrize("name", ["pad.stl", "none.inp", "pad.npz", "pad.inp.gz"])
    def test_no_mesh_file(self, tmp_path, name):
        if name != "none.inp":
            (tmp_path / name).write_bytes(b"solid of nothing")
        with pytest.raises(InputError, match=name):
            read(tmp_path / name)


class TestImpossibleMeshes:
    """Seams, tunnels, bodies without a base: the place is named."""

    def file(self, tmp_path, nodes, cells):
        np.savez(tmp_path / "mesh.npz", nodes=nodes, cells=cells)
        return tmp_path / "mesh.npz"

    def grid(self, mask):
        pad = Pad(**{**RECT, "layers": 1, "pitch": None, "elements": (3, 3), "allow": "W115"})
        X, cells = pad.structure.coordinates, np.array(Pad(**{**RECT, "layers": 1, "pitch": None, "elements": (3, 3),
            "allow": "W115"}, outline=outline.mask(np.ones((3, 3), bool))).structure.field.cells)  # fmt: skip
        cells = cells[np.array(mask, bool).ravel()]
        used, local = np.unique(cells, return_inverse=True)
        return X[used], local.reshape(-1, 8)

    def test_a_tunnel(self, tmp_path):
        path = self.file(tmp_path, *self.grid([[1, 1, 1], [1, 0, 1], [1, 1, 1]]))
        with pytest.raises(InputError, match=r"LID-E110.*faces = 0"):
            Pad.from_mesh(path, **GEL, unit="m")
        pad = Pad.from_mesh(path, **GEL, unit="m", allow=("E110", "W115"))
        assert pad.surface.area == pytest.approx(8 / 9 * 320e-6)

    def test_cells_that_touch_at_an_edge(self, tmp_path):
        path = self.file(tmp_path, *self.grid([[1, 0, 0], [0, 1, 0], [0, 0, 1]]))
        with pytest.raises(InputError, match="LID-E110"):
            Pad.from_mesh(path, **GEL, unit="m")

    def test_double_nodes(self, tmp_path):
        X, cells = self.grid(np.ones((3, 3)))
        apart = cells.copy()
        apart[4] = len(X) + np.arange(8)
        with pytest.raises(InputError, match=r"E110|parts"):
            Pad.from_mesh(self.file(tmp_path, np.vstack([X, X[cells[4]]]), apart), **GEL, unit="m")

    def test_inverted_and_orphan(self, tmp_path):
        X, cells = self.grid(np.ones((3, 3)))
        turned = cells.copy()
        turned[5] = turned[5][[3, 2, 1, 0, 7, 6, 5, 4]]
        with pytest.raises(InputError, match="cell 5"):
            Pad.from_mesh(self.file(tmp_path, X, turned), **GEL, unit="m")
        with pytest.raises(InputError, match="node 32"):
            Pad.from_mesh(self.file(tmp_path, np.vstack([X, [1, 1, 1]]), cells), **GEL, unit="m")

    def test_no_flat_end(self, tmp_path):
        X, cells = self.grid(np.ones((3, 3)))
        bent = X + np.column_stack([np.zeros((len(X), 2)), 20 * X[:, 0] ** 2 + 30 * (X[:, 1] + 1e-3) ** 2])
        with pytest.raises(InputError, match="flat"):
            Pad.from_mesh(self.file(tmp_path, bent, cells), **GEL, unit="m")
        with pytest.raises(InputError, match="flat base"):
            Pad.from_mesh(self.file(tmp_path, bent, cells), **GEL, unit="m", axis="+Z")

    def test_settings(self, cut, tmp_path):
        path = self.file(tmp_path, cut.structure.coordinates, cut.structure.field.cells)
        for change, word in (({"unit": "inch"}, "unit"), ({"axis": "up"}, "axis"), ({"pitch": -1.0}, "pitch")):
            with pytest.raises(InputError, match=word):
                Pad.from_mesh(path, **GEL, **change)


class TestMaterials:
    @pytest.mark.parametrize(
        ("text", "E", "nu"),
        [
            ("*ELASTIC\n210000.0, 0.3", 210000.0, 0.3),
            ("*HYPERELASTIC, NEO HOOKE\n0.0725, 0.", 0.435, None),
            # mu = 2 C10 = 0.2, K = 2 / D1 = 1
            ("*HYPERELASTIC, NEO HOOKE\n0.1, 2.0", 9 * 0.2 / 3.2, 2.6 / 6.4),
        ],
    )
    def test_constants(self, file, text, E, nu):
        found = elastic(file(f"*MATERIAL, NAME=gel\n{text}\n"))
        assert found["E"] == pytest.approx(E)
        assert found["nu"] == (None if nu is None else pytest.approx(nu))

    def test_none(self, file):
        with pytest.raises(InputError, match="gel"):
            elastic(file("*MATERIAL, NAME=gel\n*ELASTIC\n1.0, 0.3\n"), "steel")


@pytest.fixture(scope="module")
def gel():
    E = 1e6 * elastic(measured("gelsight_dots", "materials.inp"), "silicone")["E"]
    return Pad.from_mesh(measured("gelsight_dots", "gelsight_miniMesh.inp.gz"), E=E, nu=0.475)


class TestPublishedGel:
    """GelSight Mini gel: ten-node tetrahedra, domed, rounded."""

    def test_base_and_surface_are_found(self, gel):
        assert pytest.approx(435e3) == gel.E
        assert gel.size == pytest.approx((25.25e-3, 20.75e-3), rel=1e-4)
        assert gel.thickness == pytest.approx(4e-3)
        assert "in mm, assumed" in gel.mesh.says
        assert "towards +Y, the flat end" in gel.mesh.says
        base = gel.structure.coordinates[gel.mesh.base]
        assert np.all(base[:, 2] < 1e-9)
        assert gel.surface.area == pytest.approx(538e-6, rel=2e-3)

    def test_rebuilt_from_bricks(self, gel):
        """The dome and the rounded outline stay; what is pressed on it is carried by the base."""
        bricks = replace(gel, pitch=1.5e-3, layers=4)
        assert bricks.flags == ()
        assert bricks.surface.area == pytest.approx(gel.surface.area, rel=0.01)
        ours, theirs = (p.surface.coordinates[:, 2].max() for p in (bricks, gel))
        assert ours == pytest.approx(theirs, rel=0.005)
        f = push(bricks)
        assert bricks.reactions(f).sum(axis=0) == pytest.approx(-f.sum(axis=0), rel=1e-9)
        assert np.all(np.isfinite(bricks.rows([[0.0, 0.0], [11e-3, 9e-3], [-12e-3, 0.0]]).toarray()))

    def test_no_basis_of_corner_forces(self, gel):
        with pytest.raises(InputError, match="pitch="):
            _ = gel.basis


class TestTetrahedra:
    """Ten-node tetrahedra: a force on a corner is a traction around it."""

    @pytest.fixture
    def pads(self, tmp_path):
        nodes, cells = tets((5, 4, 4))
        np.savez(tmp_path / "tets.npz", nodes=nodes, cells=cells)
        sides = {"size": (6e-3, 4e-3), "thickness": 3e-3}
        return Pad.from_mesh(tmp_path / "tets.npz", **GEL, unit="m"), Pad(**GEL, **sides, pitch=0.5e-3, layers=6)

    def test_uniform_pressure(self, pads):
        """Forces in proportion to the areas: the same motion as of fine bricks."""
        points = np.array([[0.0, 0.0], [1.5e-3, 1e-3], [-2e-3, 0.5e-3]])
        deep = []
        for pad in pads:
            f = np.outer(pad.surface.areas, [200.0, 0.0, -1000.0])
            assert pad.reactions(f).sum(axis=0) == pytest.approx(-f.sum(axis=0), rel=1e-9)
            deep.append(pad.transfer(points) @ f.ravel())
            assert pad.rows(points) @ pad.solve(f) == pytest.approx(deep[-1], rel=1e-9)
        assert deep[0] == pytest.approx(deep[1], abs=0.025 * np.abs(deep[1]).max())

    def test_resultant_balances_the_base(self, pads):
        """Force and moment of crooked forces on the corners against those of the reactions."""
        for pad in pads:
            f = np.random.default_rng(1).standard_normal((pad.points, 3))
            held = pad.structure.coordinates[np.unique(pad.structure.supported // 3)] - np.array(pad.top)
            reactions = pad.reactions(f)
            balance = np.concatenate([reactions.sum(axis=0), np.cross(held, reactions).sum(axis=0)])
            assert pad.resultant(f) == pytest.approx(-balance, abs=1e-8)

    def test_forces_come_back(self, pads):
        pad, rng = pads[0], np.random.default_rng(0)
        f = rng.standard_normal((pad.points, 3))
        assert pad.forces(pad.displacements(f)) == pytest.approx(f, abs=1e-9)
        assert pad.compliance @ f.ravel() == pytest.approx(pad.displacements(f).ravel(), abs=1e-12)
        seen = (pad.rows(pad.nodes2d[:3]) @ pad.solve(f)).ravel()
        assert pad.from_surface(pad.nodes2d[:3]) @ pad.displacements(f).ravel() == pytest.approx(seen, abs=1e-12)


def test_a_file_without_a_unit_says_what_was_taken(cut, file, caplog):
    with caplog.at_level("INFO"):
        placed(read(file(inp(cut))))
    assert "assumed" in caplog.text
