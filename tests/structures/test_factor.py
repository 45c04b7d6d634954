import numpy as np
import pytest
from scipy import sparse

from structures import InputError, NotIdentifiable, Structure, beams, chains, plates
from structures._elements.members import steel
from structures._system.factor import BLOCK, Factor

SETTINGS = {"length": 1.2, "EI": 800.0, "mass_per_length": 3.0}


def laplacian(n, shift=0.01):
    return sparse.diags_array([-np.ones(n - 1), (2 + shift) * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]).tocsc()


@pytest.mark.parametrize("shape", [(60,), (60, 1), (60, 2 * BLOCK + 3)])
def test_solution_is_that_of_a_dense_solver(shape):
    K, B = laplacian(60), np.random.default_rng(0).standard_normal(shape)
    assert np.allclose(Factor(K).solve(B), np.linalg.solve(K.toarray(), B), rtol=1e-11)


def test_sparse_and_complex_right_hand_sides():
    K, rng = laplacian(30), np.random.default_rng(1)
    B = sparse.random_array((30, 4), density=0.2, rng=rng).tocsr()
    factor = Factor(K)
    assert np.allclose(factor.solve(B), np.linalg.solve(K.toarray(), B.toarray()))
    z = rng.standard_normal((30, 2)) + 1j * rng.standard_normal((30, 2))
    assert np.allclose(factor.solve(z), np.linalg.solve(K.toarray(), z))


@pytest.mark.parametrize(("sensors", "loads"), [(3, 7), (7, 3), (4, 4), (1, 500)])
def test_reciprocity_costs_the_fewer_solves(sensors, loads):
    K, rng = laplacian(50), np.random.default_rng(2)
    S, B = rng.standard_normal((sensors, 50)), rng.standard_normal((50, loads))
    factor = Factor(K)
    H = factor.transfer(S, B)
    assert factor.solves == min(sensors, loads)
    assert np.allclose(H, S @ np.linalg.solve(K.toarray(), B), rtol=1e-11)


@pytest.mark.parametrize(("sensors", "loads"), [(2, 5), (5, 2)])
def test_complex_symmetric_uses_the_plain_transpose(sensors, loads):
    """With a conjugate, the answer through the rows would differ from the answer through the columns."""
    rng = np.random.default_rng(3)
    D = (laplacian(40) - 0.5 * sparse.eye_array(40) + 0.3j * laplacian(40)).tocsc()
    S, B = rng.standard_normal((sensors, 40)), rng.standard_normal((40, loads))
    assert np.allclose(Factor(D).transfer(S, B), S @ np.linalg.solve(D.toarray(), B), rtol=1e-11)


def test_condensed_stiffness_is_the_inverse_of_the_flexibility_block():
    K = plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(4, 4), edges="CFFF").K_free
    dofs = [79, 3, 17, 41]
    flexibility = np.linalg.solve(K.toarray(), np.eye(K.shape[0]))[np.ix_(dofs, dofs)]
    condensed = Factor(K).condense(dofs)
    assert np.array_equal(condensed, condensed.T)
    assert np.allclose(condensed @ flexibility, np.eye(4), atol=1e-8)
    everything = np.arange(K.shape[0])
    assert np.array_equal(Factor(K).condense(everything), K.toarray())


def test_a_fine_cantilever_is_no_mechanism():
    beam = beams.cantilever(elements=2000, **SETTINGS)
    tip = np.zeros(beam.free.size)
    tip[-2] = 1.0
    assert Factor.of(beam).solve(tip)[-2] == pytest.approx(1.2**3 / 3 / 800, rel=1e-3)


@pytest.mark.parametrize(
    ("structure", "words"),
    [
        (beams.free(elements=30, **SETTINGS), "translation Z.*rotation RY"),
        (beams.beam(left="pinned", right="free", elements=300, **SETTINGS), "rotation RY"),
        (beams.beam(left="free", right="guided", elements=7, **SETTINGS), "translation Z"),
        (plates.plate(lengths=(0.5, 0.4), thickness=3e-3, material=steel, elements=(5, 5), edges="SFFF"), "rotation"),
        (chains.chain(masses=[1.0, 2.0, 3.0], springs=[5.0, 7.0], left="free", right="free"), "translation|motion"),
    ],
)
def test_a_mechanism_is_refused_by_name(structure, words):
    with pytest.raises(NotIdentifiable, match=words) as caught:
        Factor.of(structure)
    assert caught.value.code == "LID-E116"
    assert "supports" in caught.value.advice


def test_an_inner_mechanism_names_its_dofs():
    K = np.zeros((5, 5))
    K[:3, :3] = [[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]]
    K[3:, 3:] = [[4.0, -4], [-4, 4]]
    structure = Structure.from_matrices(K, np.eye(5), dofs=["1+X", "2+X", "3+X", "8+X", "9+X"])
    with pytest.raises(NotIdentifiable, match=r"8\+X, 9\+X"):
        Factor.of(structure)
    with pytest.raises(NotIdentifiable, match=r"index \[.*3, 4"):
        Factor(sparse.csc_array(K))


@pytest.mark.parametrize(
    ("K", "words"),
    [
        (np.ones((2, 3)), "not square"),
        (np.array([[1.0, np.nan], [np.nan, 1.0]]), "NaN"),
        (np.array([[2.0, 1.0], [0.0, 2.0]]), "not symmetric"),
    ],
)
def test_a_bad_matrix_is_refused(K, words):
    with pytest.raises(InputError, match=words):
        Factor(K)


def test_bad_right_hand_sides_and_dofs_are_refused():
    factor = Factor(laplacian(5))
    with pytest.raises(InputError, match="5 rows"):
        factor.solve(np.ones(4))
    with pytest.raises(InputError, match="NaN"):
        factor.solve(np.array([1.0, np.nan, 0, 0, 0]))
    for dofs in ([0, 0], [5], [-1], [], [0.5]):
        with pytest.raises(InputError, match="condense"):
            factor.condense(dofs)


def test_a_poor_factor_is_refined_and_a_useless_one_refused():
    K, B = laplacian(40), np.random.default_rng(5).standard_normal((40, 3))

    class Poor:
        """What an unpivoted factor of a nearly singular matrix does: an error of 1e-5, or of 100 %."""

        def __init__(self, lu, error):
            self.lu, self.error = lu, error

        def solve(self, b):
            return self.lu.solve(b) * (1 + self.error)

    factor, useless = Factor(K), Factor(K)
    factor._lu, useless._lu = Poor(factor._lu, 1e-5), Poor(useless._lu, 1.0)
    exact = np.linalg.solve(K.toarray(), B)
    assert np.linalg.norm(factor.solve(B) - exact) < 1e-9 * np.linalg.norm(exact)
    with pytest.raises(InputError, match="useless"):
        useless.solve(B)


def test_an_indefinite_shifted_matrix_keeps_its_accuracy():
    beam = beams.simply_supported(elements=60, **SETTINGS)
    D = beam.K_free - (2 * np.pi * 400.0) ** 2 * beam.M_free
    x = np.random.default_rng(4).standard_normal(D.shape[0])
    assert np.linalg.norm(Factor(D).solve(D @ x) - x) < 1e-7 * np.linalg.norm(x)


class TestMechanismsNamed:
    """Every pair of ends and every plate's edges: either it carries a static load, or its free motion is named."""

    FREE = {  # noqa: RUF012  (pair of ends in any order -> what is left free)
        frozenset({"pinned", "free"}): "rotation RY",
        frozenset({"free"}): "translation Z, rotation RY",
        frozenset({"guided", "free"}): "translation Z",
        frozenset({"guided"}): "translation Z",
    }

    @pytest.mark.parametrize("elements", [1, 7, 40, 160])
    @pytest.mark.parametrize("left", beams.ENDS)
    @pytest.mark.parametrize("right", beams.ENDS)
    def test_beam(self, left, right, elements):
        flat = beams.Section.rectangle(0.04, 0.008)
        s = beams.beam(length=1.2, elements=elements, left=left, right=right, section=flat, material=steel)
        words = self.FREE.get(frozenset({left, right}))
        if s.free.size == 0:
            return
        if words is None:
            assert np.all(np.isfinite(Factor.of(s).solve(np.ones(s.free.size))))
            return
        with pytest.raises(NotIdentifiable, match=rf"rigid-body motion left free \({words}\)"):
            Factor.of(s)

    @pytest.mark.parametrize("elements", [(1, 1), (5, 4), (16, 16)])
    @pytest.mark.parametrize(
        ("edges", "words"),
        [
            ("FFFF", "translation Z, rotation RX, rotation RY"),
            ("SFFF", "rotation RY"),
            ("FSFF", "rotation RX"),
            ("FFSF", "rotation RY"),
            ("FFFS", "rotation RX"),
            ("SSFF", None),
            ("SFSF", None),
            ("CFFF", None),
            ("FFFC", None),
        ],
    )
    def test_plate(self, edges, words, elements):
        s = plates.plate(lengths=(1.0, 0.7), thickness=4e-3, elements=elements, edges=edges, material=steel)
        if words is None:
            assert np.all(np.isfinite(Factor.of(s).solve(np.ones(s.free.size))))
            return
        with pytest.raises(NotIdentifiable, match=rf"rigid-body motion left free \({words}\)"):
            Factor.of(s)

    @pytest.mark.parametrize("corners", [1, 2, 3])
    def test_plate_on_corner_points(self, corners):
        """One point leaves two rotations, two points the rotation about their line, three none."""
        s = plates.plate(lengths=(1.0, 1.0), thickness=4e-3, elements=(4, 4), edges="FFFF", material=steel)
        s = s.with_supports(*["0+Z", "24+Z", "4+Z"][:corners])
        if corners == 3:
            assert np.all(np.isfinite(Factor.of(s).solve(np.ones(s.free.size))))
            return
        with pytest.raises(NotIdentifiable, match=r"rigid-body motion left free .*rotation RX.*rotation RY"):
            Factor.of(s)

    def test_from_matrices_and_bare(self):
        """Without geometry the null space of the matrix names the motion, whatever the mesh."""
        for elements in (10, 40, 41):
            s = beams.beam(length=1.2, elements=elements, left="pinned", right="free", EI=1.0, mass_per_length=1.0)
            bare = Structure.from_matrices(s.K, s.M, dofs=s.dofs, supports=s.supports, coordinates=s.coordinates)
            with pytest.raises(NotIdentifiable, match="rotation RY"):
                Factor.of(bare)
            with pytest.raises(NotIdentifiable, match="meets no stiffness"):
                Factor(s.K_free)
