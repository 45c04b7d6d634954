"""Blocks of bricks: the element, the field between the nodes, the guards of locking."""

import numpy as np
import pytest
from scipy.linalg import eigh

from structures import ForwardModel, InputError, NotIdentifiable, loads, sensors, solids
from structures._elements.cells import ELEMENTS, Brick
from structures._elements.hexfield import FACES
from structures._elements.members import Material
from structures._system.factor import Factor
from tests.benchmarks import locking

SOFT = Material(E=2e5, rho=1100.0, nu=0.4)
SIDES, CELLS = (0.03, 0.02, 0.01), (3, 2, 2)


def block(element="bbar", material=SOFT, **settings):
    settings = {"lengths": SIDES, "elements": CELLS, "fixed": None, **settings}
    return solids.block(element=element, material=material, **settings)


def nodal(structure, field):
    """Displacements of all DOFs of a vector field of the places (nodes, 3)."""
    return np.asarray(field(structure.coordinates)).ravel()


def test_incompatible_cell_minimises_the_energy_over_its_bubbles():
    """Against plain quadrature with three points a side of the energy of corners and bubbles together."""
    h, nu = np.array([0.01, 0.02, 0.005]), 0.3
    cell = Brick(h, nu, "incompatible")
    x, w = np.polynomial.legendre.leggauss(3)
    x, w = (x + 1) / 2, w / 2
    lam, mu = nu / (1 + nu) / (1 - 2 * nu), 1 / 2 / (1 + nu)
    K = np.zeros((33, 33))
    for i, a in enumerate(x):
        for j, b in enumerate(x):
            for k, c in enumerate(x):
                xi = np.array([a, b, c])
                bubbles = np.zeros((11, 3))
                bubbles[:8] = cell.gradients(xi)
                bubbles[8:] = np.diag(4 * (1 - 2 * xi) / h)
                strains = []
                for g in bubbles:
                    for axis in range(3):
                        e = np.zeros((3, 3))
                        e[axis] = g
                        strains.append((e + e.T) / 2)
                E = np.array(strains)
                trace = np.trace(E, axis1=1, axis2=2)
                energy = lam * np.outer(trace, trace) + 2 * mu * np.einsum("aij,bij->ab", E, E)
                K += w[i] * w[j] * w[k] * np.prod(h) * energy
    condensed = K[:24, :24] - K[:24, 24:] @ np.linalg.solve(K[24:, 24:], K[24:, :24])
    assert np.abs(cell.stiffness - condensed).max() < 1e-13 * np.abs(condensed).max()


class TestInvariants:
    @pytest.mark.parametrize("element", ELEMENTS)
    @pytest.mark.parametrize("nu", [0.0, 0.3, 0.489, -0.4])
    def test_constant_strain_is_exact(self, element, nu):
        """Patch test: a linear field needs no force inside, and its energy is that of the theory."""
        s = block(element, Material(E=3e5, rho=1.0, nu=nu), elements=(3, 3, 3))
        F = np.random.default_rng(0).standard_normal((3, 3))
        u = nodal(s, lambda x: x @ F.T)
        force = (s.K @ u).reshape(-1, 3)
        inside = np.all((s.coordinates > 1e-6) & (s.coordinates < np.array(SIDES) - 1e-6), axis=1)
        assert inside.sum() == 8
        assert np.abs(force[inside]).max() < 1e-12 * np.abs(force).max()
        e = (F + F.T) / 2
        lam, mu = 3e5 * nu / (1 + nu) / (1 - 2 * nu), 3e5 / 2 / (1 + nu)
        energy = (lam * np.trace(e) ** 2 + 2 * mu * np.sum(e * e)) * np.prod(SIDES)
        assert u @ s.K @ u == pytest.approx(energy, rel=1e-12)

    @pytest.mark.parametrize("element", ELEMENTS)
    def test_rigid_motions_symmetry_rank_mass(self, element):
        s = block(element)
        K = s.K.toarray()
        assert np.array_equal(K, K.T)
        assert np.linalg.matrix_rank(Brick(np.array([1.0, 2.0, 0.5]), 0.3, element).stiffness) == 18
        for vector in s.field.rigid().values():
            assert np.abs(K @ vector).max() < 1e-12 * np.abs(K).max()
        for axis in range(3):
            one = np.eye(3)[axis][None].repeat(len(s.coordinates), 0).ravel()
            assert one @ s.M @ one == pytest.approx(1100.0 * np.prod(SIDES), rel=1e-13)
        # a rotation carries the moment of inertia of the block exactly: trilinear functions hold it
        spin = nodal(s, lambda x: np.cross([0, 0, 1.0], x - np.array(SIDES) / 2))
        exact = 1100.0 * np.prod(SIDES) * (SIDES[0] ** 2 + SIDES[1] ** 2) / 12
        assert spin @ s.M @ spin == pytest.approx(exact, rel=1e-12)

    @pytest.mark.parametrize("element", ELEMENTS)
    @pytest.mark.parametrize("nu", [0.3, 0.48])
    def test_a_column_on_side_rollers_is_exact(self, element, nu):
        material, p = Material(E=3e5, rho=1.0, nu=nu), 70.0
        s = block(element, material, fixed="bottom").with_supports()
        x = s.coordinates
        s = s.with_supports(
            *[(n, "X") for n in np.flatnonzero(np.isclose(x[:, 0] % SIDES[0], 0)).tolist()],
            *[(n, "Y") for n in np.flatnonzero(np.isclose(x[:, 1] % SIDES[1], 0)).tolist()],
        )
        f = p * solids.FacePatch("top").column(s)
        u = s.expand(Factor.of(s).solve(f[s.free])).reshape(-1, 3)
        exact = p * SIDES[2] * (1 + nu) * (1 - 2 * nu) / 3e5 / (1 - nu)
        assert u[x[:, 2] > 0.0099, 2] == pytest.approx(exact, rel=1e-10)

    def test_moving_the_mesh_by_100_m_changes_nothing(self):
        here, there = block(fixed="bottom"), block(fixed="bottom", origin=(100.0, -100.0, 100.0))
        assert np.array_equal(here.K.data, there.K.data)
        assert np.array_equal(here.M.data, there.M.data)
        at, shift = np.array([0.017, 0.011, 0.01]), np.array([100.0, -100.0, 100.0])
        for make in (
            lambda x: sensors.Displacement(at=tuple(x), direction="+Y"),
            lambda x: sensors.SolidGauge(at=tuple(x), direction=(1, 2, 0), length=0.004),
        ):
            a, b = make(at).row(here), make(at + shift).row(there)
            assert b == pytest.approx(a, abs=1e-9 * np.abs(a).max())

    @pytest.mark.parametrize("element", ELEMENTS)
    def test_reciprocity(self, element):
        s = block(element, fixed="left")
        places = [(0.013, 0.004, 0.01), (0.03, 0.02, 0.007), (0.021, 0.013, 0.002)]
        both = [(p, d) for p in places for d in ("+X", "-Y", "+Z")]
        H = ForwardModel(
            s,
            [sensors.Displacement(at=p, direction=d) for p, d in both],
            [loads.Point(at=p, direction=d) for p, d in both],
        ).static()
        assert np.abs(H - H.T).max() < 1e-12 * np.abs(H).max()
        assert eigh(H, eigvals_only=True)[0] > 0

    def test_scaled_density_and_modulus(self):
        s, t = block(fixed="left"), block(fixed="left", material=Material(E=8e5, rho=1100.0, nu=0.4))
        assert abs(4 * s.K - t.K).max() < 1e-12 * abs(t.K).max()
        f = ForwardModel(s, [sensors.Displacement("15+Z")], [loads.Point("15+Z")]).natural_frequencies
        g = ForwardModel(t, [sensors.Displacement("15+Z")], [loads.Point("15+Z")]).natural_frequencies
        assert g == pytest.approx(2 * f, rel=1e-8)


class TestMechanisms:
    def test_a_free_block_has_six(self):
        motions = block().rigid_body_motions()
        assert {m.name for m in motions} == {
            "translation X", "translation Y", "translation Z", "rotation RX", "rotation RY", "rotation RZ",
        }  # fmt: skip
        with pytest.raises(NotIdentifiable, match=r"translation X.*rotation RZ") as caught:
            Factor.of(block())
        assert caught.value.code == "LID-E116"

    def test_rollers_and_hinges_are_named(self):
        s = block()
        bottom = s.field.surface("bottom").nodes.tolist()
        rolling = s.with_supports(*[(n, "Z") for n in bottom])
        with pytest.raises(NotIdentifiable, match=r"left free \(translation X, translation Y, rotation RZ\)"):
            Factor.of(rolling)
        edge = [n for n in bottom if s.coordinates[n, 0] == 0]
        hinged = s.with_supports(*[(n, d) for n in edge for d in "XYZ"])
        with pytest.raises(NotIdentifiable, match=r"left free \(rotation RY\)"):
            Factor.of(hinged)

    def test_every_face_alone_holds_it(self):
        for face in FACES:
            s = block(fixed=face)
            assert np.all(np.isfinite(Factor.of(s).solve(np.ones(s.free.size))))
            assert len(s.supports) == 3 * s.field.face_nodes(face).size


class TestField:
    def test_motion_between_nodes_is_trilinear(self):
        s, rng = block(), np.random.default_rng(0)
        C = rng.standard_normal((8, 3))

        def field(x):
            x, y, z = x.T / 0.01
            return np.column_stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * y * z]) @ C

        u = nodal(s, field)
        for at in rng.uniform(0, 1, (20, 3)) * SIDES:
            for axis in (1, 2, 3):
                assert s.field.motion(at, axis) @ u == pytest.approx(field(at[None])[0, axis - 1], abs=1e-12)

    def test_a_gauge_reads_polynomial_fields(self):
        """Inside a cell and on its surface, for each trilinear field: d^T grad u d."""
        s, rng = block("standard"), np.random.default_rng(1)
        C = rng.standard_normal((8, 3))

        def field(x):
            x, y, z = x.T / 0.01
            return np.column_stack([np.ones_like(x), x, y, z, x * y, y * z, x * z, x * y * z]) @ C

        def gradient(at):
            x, y, z = np.asarray(at) / 0.01
            rows = [[0, 1, 0, 0, y, 0, z, y * z], [0, 0, 1, 0, x, z, 0, x * z], [0, 0, 0, 1, 0, y, x, x * y]]
            return (np.array(rows) @ C / 0.01).T

        u = nodal(s, field)
        for at in [*(rng.uniform(0, 1, (10, 3)) * SIDES), (0.017, 0.004, 0.01), (0.01, 0.01, 0.005)]:
            d = rng.standard_normal(3)
            d /= np.linalg.norm(d)
            exact = d @ gradient(at) @ d
            row = sensors.SolidGauge(at=tuple(at), direction=tuple(7 * d)).row(s)
            assert row @ u == pytest.approx(exact, abs=1e-12 * np.abs(C).max() / 0.01)

    @pytest.mark.parametrize("element", ["standard", "bbar"])
    def test_the_mean_over_a_length_is_the_elongation(self, element):
        """Across cells, along their faces and askew: the mean of the strain is what the two ends say."""
        s, rng = block(element), np.random.default_rng(2)
        u = rng.standard_normal(s.n)
        lines = [
            ((0.015, 0.01, 0.005), (1, 0, 0), 0.028),  # along an edge of cells
            ((0.015, 0.006, 0.01), (1, 1, 0), 0.011),  # askew on the top face
            ((0.014, 0.009, 0.0047), (3, -2, 1), 0.007),
            ((0.021, 0.013, 0.004), (0, 0, 1), 0.001),  # inside one cell
        ]
        for at, d, length in lines:
            d = np.array(d) / np.linalg.norm(d)
            ends = [np.array(at) + sign * length / 2 * d for sign in (1, -1)]
            moved = [np.array([s.field.motion(end, axis) @ u for axis in (1, 2, 3)]) for end in ends]
            row = sensors.SolidGauge(at=at, direction=tuple(d), length=length).row(s)
            assert row @ u == pytest.approx(d @ (moved[0] - moved[1]) / length, rel=1e-11)

    def test_a_gauge_on_a_bent_bar_of_incompatible_bricks(self):
        """Strain P L c / E I under the beam's own theory, away from the ends, on coarse cells."""
        L, b, h, E = 0.1, 0.01, 0.002, 2e5
        s = block("incompatible", Material(E=E, rho=1.0, nu=0.3), lengths=(L, b, h), elements=(20, 2, 1), fixed="left")
        f = solids.FacePatch("right", direction="+Z").column(s)
        u = s.expand(Factor.of(s).solve(f[s.free]))
        P, second = b * h, b * h**3 / 12
        for z, sign in ((h, -1), (0.0, 1)):
            row = sensors.SolidGauge(at=(0.05, b / 2, z), direction="X", length=0.01).row(s)
            assert row @ u == pytest.approx(sign * P * 0.05 * h / 2 / E / second, rel=0.02)
        askew = sensors.SolidGauge(at=(0.052, b / 2, h), direction=(1, 0, 1)).row(
            s
        )  # e_xx (1 - nu) / 2: no false shear
        assert askew @ u == pytest.approx(-0.35 * P * 0.048 * h / 2 / E / second, rel=0.06)

    @pytest.mark.parametrize("face", FACES)
    def test_a_traction_on_part_of_a_face(self, face):
        """Force and first moments of a rectangle that cuts cells."""
        s = block()
        axis, end = FACES[face]
        a, b = (SIDES[k] for k in range(3) if k != axis)
        spans = ((0.13 * a, 0.71 * a), (0.4 * b, 0.95 * b))
        column = solids.FacePatch(face, spans, direction="-X").column(s).reshape(-1, 3)
        area = 0.58 * a * 0.55 * b
        assert column.sum(axis=0) == pytest.approx([-area, 0, 0], rel=1e-12)
        centre = np.insert([0.42 * a, 0.675 * b], axis, end * SIDES[axis])
        assert s.coordinates.T @ column[:, 0] == pytest.approx(-area * centre, rel=1e-12, abs=1e-18)
        whole = solids.FacePatch(face, direction="+Z").column(s).reshape(-1, 3)
        assert whole[s.field.surface(face).nodes, 2] == pytest.approx(s.field.surface(face).areas, rel=1e-12)

    def test_a_patch_presses_the_top(self):
        s = block(fixed="bottom")
        spans = (0.004, 0.02), (0.001, 0.013)
        same = solids.FacePatch("top", spans, direction="-Z").column(s)
        assert np.array_equal(loads.Patch(x=spans[0], y=spans[1], direction="-Z").column(s), same)

    def test_next_to_a_support(self):
        """Through the thickness a pad is held everywhere: no warning; beside a bonded side there is one."""
        thin = block(fixed="bottom", elements=(6, 4, 1))
        patch = solids.FacePatch("top", ((0.012, 0.02), (0.006, 0.013)), direction="-Z")
        assert loads.near_support(thin, [patch, loads.Point(at=(0.0, 0.0, 0.01))]) is None
        walled = block(fixed=("bottom", "left"), elements=(6, 4, 1))
        flag = loads.near_support(walled, [patch, loads.Point(at=(0.002, 0.01, 0.01))])
        assert flag.code == "LID-W105"
        assert flag.evidence.value == 1

    @pytest.mark.parametrize(
        ("sensor", "words"),
        [
            (sensors.StrainGauge(at=(0.01, 0.01, 0.01), fibre=1e-3), "SolidGauge"),
            (sensors.Displacement(at=(0.01, 0.01), direction="+Z"), "finite x, y, z"),
            (sensors.Displacement(at=(0.01, 0.01, 0.02), direction="+Z"), "outside"),
            (sensors.Displacement(at=(0.01, 0.01, 0.01), direction="+RX"), "no rotation"),
            (sensors.SolidGauge(at=(0.029, 0.01, 0.01), direction="X", length=0.004), "outside"),
        ],
    )
    def test_sensors_without_a_place_are_refused(self, sensor, words):
        with pytest.raises(InputError, match=words):
            sensor.row(block())

    def test_gauges_and_tractions_of_solids_need_a_solid(self):
        from structures import beams

        beam = beams.cantilever(length=1.0, EI=1.0, mass_per_length=1.0)
        with pytest.raises(InputError, match="needs a solid"):
            sensors.SolidGauge(at=(0.1, 0, 0), direction="X").row(beam)
        with pytest.raises(InputError, match="no faces"):
            solids.FacePatch("top").column(beam)
        for bad in ((0, 0, 0), (1, 0), "Q", (np.nan, 0, 1)):
            with pytest.raises(InputError, match="direction"):
                sensors.SolidGauge(at=(0.1, 0, 0), direction=bad)
        for bad in (((0.1, 0.0), (0, 1)), ((0, 1),), "abc"):
            with pytest.raises(InputError, match="rectangle"):
                solids.FacePatch("top", bad)
        with pytest.raises(InputError, match="X, Y or Z"):
            solids.FacePatch("top", direction="+RX")
        with pytest.raises(InputError, match="no such face"):
            solids.FacePatch("lid").column(block())
        with pytest.raises(InputError, match="outside"):
            solids.FacePatch("top", ((0, 0.04), (0, 0.01))).column(block())


class TestLocking:
    @pytest.mark.parametrize("nu", locking.PAGE)
    def test_the_table_of_the_literature_page(self, nu):
        for column, known in zip(locking.COLUMNS, locking.PAGE[nu], strict=True):
            ours = locking.compliances(column[0], nu, column[1]) / locking.REFERENCE[nu]
            assert ours == pytest.approx(known, abs=2e-3), column

    def test_the_reference_is_taylor_hood(self):
        """A coarser solution comes near the stored one; the benchmark solves that itself."""
        assert locking.taylor_hood(0.4999, (6, 6, 2)) == pytest.approx(locking.REFERENCE[0.4999], rel=0.03)

    @pytest.mark.parametrize("element", ELEMENTS)
    def test_bending(self, element):
        for nu, known in locking.BENDING[element].items():
            assert locking.tip(element, nu) == pytest.approx(known, abs=2e-3)

    def test_the_thin_limit_of_a_bonded_layer(self):
        """Wide, thin and pressed all over: the middle moves by p h (1 + nu)(1 - 2 nu) / E (1 - nu)."""
        nu = 0.45
        s = block(
            "bbar", Material(E=1e5, rho=1.0, nu=nu), lengths=(0.1, 0.1, 2e-3), elements=(16, 16, 2), fixed="bottom"
        )
        u = s.expand(Factor.of(s).solve(solids.FacePatch("top").column(s)[s.free]))
        middle = s.field.motion((0.05, 0.05, 2e-3), 3) @ u
        assert middle == pytest.approx(2e-3 * (1 + nu) * (1 - 2 * nu) / 1e5 / (1 - nu), rel=3e-3)

    @pytest.mark.parametrize(("nu", "known"), [(0.451, 4), (0.49, 20)])
    def test_the_warning_carries_its_number(self, nu, known):
        """The pad of the case collection: 16 x 16 x 4 cells on 16 x 16 x 4 mm."""
        s = block(
            "standard", Material(E=1e5, rho=1.0, nu=nu), lengths=(16e-3, 16e-3, 4e-3), elements=(16, 16, 4),
            fixed="bottom",
        )  # fmt: skip
        (flag,) = s.field.flags
        assert flag.code == "LID-W108"
        assert flag.evidence.value == nu
        found = float(flag.message.split("is ")[1].split(" %")[0])
        assert found == pytest.approx(known, abs=3)
        model = ForwardModel(s, [sensors.Displacement("1400+Z")], [loads.Point("1400+Z")])
        assert "LID-W108" in {f.code for f in model.flags}
        assert model.perturbed("stiffness", 1.1).flags == model.flags

    def test_the_refusal_carries_its_number_and_can_be_overridden(self):
        gel = Material(E=1e5, rho=1.0, nu=0.499)
        with pytest.raises(InputError, match=r"plain Hex-8 is \d\d % too stiff at nu = 0.499") as caught:
            block("standard", gel, fixed="bottom", elements=(8, 8, 4))
        assert caught.value.code == "LID-E109"
        s = block("standard", gel, fixed="bottom", elements=(8, 8, 4), allow=("E109",))
        assert [flag.code for flag in s.field.flags] == ["LID-E109"]

    def test_silent_where_nothing_locks(self):
        for element, nu in (("standard", 0.45), ("standard", 0.3), ("bbar", 0.4999), ("incompatible", 0.48)):
            assert block(element, Material(E=1e5, rho=1.0, nu=nu)).field.flags == ()

    def test_a_large_or_enclosed_block_takes_the_figures_of_a_pad(self):
        settings = {"element": "standard", "material": Material(E=1e5, rho=1.0, nu=0.49)}
        for more in ({"elements": (45, 45, 3)}, {"fixed": tuple(FACES), "elements": (3, 3, 3)}):
            (flag,) = block(**settings, **more).field.flags
            assert "20 % too stiff at nu = 0.49 (a bonded pad of 16 x 16 x 4 cells)" in flag.message


class TestBadInput:
    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"lengths": (0.1, 0.0, 0.1)}, "a length must be positive"),
            ({"lengths": (0.1, 0.1)}, "three numbers"),
            ({"lengths": "abc"}, "three numbers"),
            ({"lengths": (0.1, np.nan, 0.1)}, "a length must be positive"),
            ({"elements": (0, 1, 1)}, "integer from 1"),
            ({"elements": (2.5, 1, 1)}, "integer from 1"),
            ({"elements": 4}, "three numbers"),
            ({"elements": (100, 100, 100)}, r"1000000 cells, 3090903 DOFs, .* GB"),
            ({"element": "hex20"}, "bbar, standard, incompatible"),
            ({"element": None}, "unknown element"),
            ({"fixed": "base"}, "bottom, top, left, right, front, back"),
            ({"fixed": ("bottom", 3)}, "no such face"),
            ({"material": "rubber"}, "no material"),
            ({"origin": (0, 0, np.inf)}, "one finite number"),
            ({"allow": ("E1",)}, "no guard code"),
        ],
    )
    def test_refused_by_name(self, change, words):
        with pytest.raises(InputError, match=words):
            block(**change)

    @pytest.mark.parametrize("nu", [0.5, 0.6, -1.0, -2.0, np.nan])
    def test_impossible_poisson_ratios(self, nu):
        with pytest.raises(InputError, match="Poisson"):
            block(material=Material(E=1.0, rho=1.0, nu=nu))
