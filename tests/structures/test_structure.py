import dataclasses

import numpy as np
import pytest
from scipy import sparse

from structures import Dof, Structure, beams, chains, loads, plates
from structures.errors import InputError

from .exact import assembled, norm, solve
from .kinds import EVERY, MASS, SQUARE, UNIT


@pytest.fixture(params=sorted(EVERY), scope="module")
def named(request):
    return request.param, EVERY[request.param]()


# -- what every structure must be ----------------------------------------------------------------------------------
def test_matrices_are_symmetric_and_not_negative(named):
    _, s = named
    for A in (s.K, s.M):
        assert abs(A - A.T).max() == 0
        scale = 1 / np.sqrt(np.where(A.diagonal() > 0, A.diagonal(), 1))
        assert np.linalg.eigvalsh(scale[:, None] * A.toarray() * scale).min() > -1e-13


def test_translations_have_the_mass(named):
    name, s = named
    ones = np.array([float(dof.axis in (1, 3)) for dof in s.dofs])
    assert ones @ s.M @ ones == pytest.approx(MASS[name], rel=1e-12)


def test_rigid_motions_cost_nothing(named):
    _, s = named
    if s.field is not None and not s.terms:
        for name, u in s.field.rigid().items():
            assert np.linalg.norm(s.K @ u) / (norm(s.K) * np.linalg.norm(u)) < 1e-12, name
    for motion in s.rigid_body_motions():
        u = motion.vector
        assert np.linalg.norm(s.K_free @ u[s.free]) / (norm(s.K) * np.linalg.norm(u)) < 1e-12
        assert not np.any(u[s.supported])
        assert u[np.argmax(np.abs(u))] == 1.0


def test_the_null_space_of_the_matrix_is_what_geometry_says(named):
    """The geometric and the algebraic search are two ways to the same answer; rank by NumPy is a third."""
    _, s = named
    K = s.K_free.toarray()
    scale = 1 / np.sqrt(K.diagonal())
    nullity = len(K) - np.linalg.matrix_rank(scale[:, None] * K * scale, hermitian=True, tol=1e-12)
    assert len(s.rigid_body_motions()) == len(assembled(s).rigid_body_motions()) == nullity


def test_reactions_balance_the_load(named):
    _, s = named
    if s.rigid_body_motions():
        return
    rng = np.random.default_rng(1)
    f = rng.standard_normal(s.n)
    u = solve(s, f)
    r = s.reactions(u, f)
    full = np.zeros(s.n)
    full[s.supported] = r
    assert np.allclose(s.K @ u, f + full, rtol=0, atol=1e-9 * np.abs(f).max() * s.n)
    assert np.allclose(s.reactions(u[s.free], f), r)
    ones = np.array([float(dof.axis in (1, 3)) for dof in s.dofs])
    if s.field is not None and s.supports:
        assert ones @ (f + full) == pytest.approx(0, abs=1e-9 * np.abs(full).max())


def test_dofs_are_found_whatever_their_polarity(named):
    _, s = named
    for i, dof in enumerate(s.dofs):
        assert s.index(dof) == s.index(Dof(dof.node, -dof.direction)) == i
        assert s.unit_row(dof)[i] == 1.0
        if dof.direction:
            assert s.unit_row(Dof(dof.node, -dof.direction))[i] == -1.0
    assert sorted([*s.free, *s.supported]) == list(range(s.n))


def test_copies_are_scaled_and_the_digest_follows(named):
    _, s = named
    assert s.digest == dataclasses.replace(s).digest
    assert len(s.digest) == 64
    assert np.allclose(s.scaled("stiffness", 1.1).K.data, 1.1 * s.K.data, rtol=1e-15)
    twice = s.scaled("mass", 2.0).scaled("mass", 0.75)
    assert np.allclose(twice.M.data, 1.5 * s.M.data)
    assert twice.parameters["mass"] == 1.5
    digests = {s.digest, s.scaled("stiffness", 1.1).digest, twice.digest, s.with_supports(s.dofs[s.free[0]]).digest}
    assert len(digests) == 4
    for term in s.terms:
        changed = s.scaled(term, 3.0)
        assert abs(changed.K - (s.K + 2 * s.terms[term])).max() < 1e-12 * abs(s.K).max()
        assert changed.parameters[term] == 3.0


def test_nothing_can_be_changed(named):
    _, s = named
    with pytest.raises(dataclasses.FrozenInstanceError):
        s.K = None
    with pytest.raises(ValueError, match="read-only"):
        s.K.data[0] = 0


# -- the house of 100 metres ---------------------------------------------------------------------------------------
def test_a_structure_moved_by_100_m_is_the_same():
    for make, shift, at in (
        (lambda o: beams.cantilever(elements=40, tension=3.0, origin=o[0], **UNIT), (100.0,), (0.371,)),
        (lambda o: plates.plate(elements=(8, 8), edges="CFFF", origin=o, **SQUARE), (100.0, -100.0), (0.371, 0.713)),
    ):
        here, there = make((0.0,) * len(shift)), make(shift)
        for A, B in ((here.K, there.K), (here.M, there.M)):
            assert np.array_equal(A.data, B.data)
            assert np.array_equal(A.indices, B.indices)
        moved = tuple(a + d for a, d in zip(at, shift, strict=True))
        assert np.allclose(there.coordinates, here.coordinates + np.array(shift), atol=1e-12)
        for axis in (3, 5):
            want, got = here.field.motion(at, axis), there.field.motion(moved, axis)
            assert np.abs(got - want).max() < 1e-11 * np.abs(want).max()
        want = here.field.strain(at, 0.05, 0.0, None)
        assert np.abs(there.field.strain(moved, 0.05, 0.0, None) - want).max() < 1e-10 * np.abs(want).max()


# -- mechanisms ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "motions"),
    [("beam free-free", ["translation Z", "rotation RY"]), ("beam free-pinned", ["rotation RY"]),
     ("beam guided-guided", ["translation Z"]), ("beam free-guided", ["translation Z"]), ("beam clamped-free", []),
     ("plate FFFF", ["translation Z", "rotation RX", "rotation RY"]), ("plate CFFF", []),
     ("chain free-free", ["translation X"]), ("chain fixed-free", []), ("beam tension", [])],
)  # fmt: skip
def test_free_motions_are_named(name, motions):
    assert [str(m) for m in EVERY[name]().rigid_body_motions()] == motions


def test_a_plate_on_one_simple_edge_turns_about_it():
    s = plates.plate(elements=(3, 3), edges="SFFF", **SQUARE)
    (motion,) = s.rigid_body_motions()
    assert motion.name == "rotation RY"
    z = np.array([dof.axis == 3 for dof in s.dofs])
    w = motion.vector[z]
    assert np.allclose(w / w[-1], s.coordinates[:, 0], atol=1e-12)


def test_a_tension_resists_the_rotation_of_a_free_beam():
    s = beams.beam(left="free", right="free", elements=12, tension=2.0, **UNIT)
    assert [str(m) for m in s.rigid_body_motions()] == ["translation Z"]
    held = beams.beam(left="pinned", right="free", elements=12, tension=2.0, **UNIT)
    assert held.rigid_body_motions() == ()


def test_free_motions_of_user_matrices_are_named():
    named = [str(m) for m in assembled(EVERY["plate FFFF"]()).rigid_body_motions()]
    assert named == ["translation Z", "rotation RX", "rotation RY"]
    K = np.zeros((3, 3))
    K[:2, :2] = [[1, -1], [-1, 1]]
    s = Structure.from_matrices(K, dofs=["1+X", "2+X", "7+Y"])
    assert {str(m) for m in s.rigid_body_motions()} == {"translation X", "translation Y"}
    loose = Structure.from_matrices([[2, -1, 0], [-1, 1, 0], [0, 0, 0]], dofs=["1+X", "2+X", "3+X"])
    assert [str(m) for m in loose.rigid_body_motions()] == ["motion of 3+X"]


def test_a_long_slender_beam_is_no_mechanism():
    """Its smallest scaled eigenvalue is 3e-13: a tolerance of n eps would call it one."""
    long = beams.cantilever(elements=1000, **UNIT)
    assert long.rigid_body_motions() == () == assembled(long).rigid_body_motions()
    loose = assembled(beams.free(elements=1000, **UNIT))
    assert [str(m) for m in loose.rigid_body_motions()] == ["translation Z", "rotation RY"]


# -- point masses --------------------------------------------------------------------------------------------------
def test_a_mass_is_added_where_it_sits():
    s = EVERY["beam clamped-free"]()
    ones = np.array([float(dof.axis == 3) for dof in s.dofs])
    for heavier in (s.with_mass("7+Z", 0.25), s.with_mass("7-Z", 0.25), s.with_mass(kg=0.25, at=0.43)):
        assert ones @ heavier.M @ ones == pytest.approx(1.25)
        assert abs(heavier.K - s.K).max() == 0
    node = s.with_mass("7+Z", 0.25).M - s.with_mass(at=1.0, kg=0.25).M
    assert abs(node).max() < 1e-15


@pytest.mark.parametrize(
    "settings",
    [{"dof": "3+Z"}, {"dof": "3+Z", "kg": -1.0}, {"kg": 1.0}, {"dof": "3+Z", "at": 0.1, "kg": 1.0},
     {"dof": "99+Z", "kg": 1.0}, {"at": 2.0, "kg": 1.0}],
)  # fmt: skip
def test_bad_masses_raise(settings):
    with pytest.raises(InputError):
        EVERY["beam clamped-free"]().with_mass(**settings)


# -- bad input -----------------------------------------------------------------------------------------------------
GOOD = np.array([[2.0, -1.0], [-1.0, 2.0]])
LOPSIDED = np.array([[2.0, -1.0], [-1.0 - 1e-6, 2.0]])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"K": np.ones((2, 3))}, "square"),
        ({"K": np.ones(3)}, "square"),
        ({"K": [[1.0], [1.0, 2.0]]}, "matrix of numbers"),
        ({"K": "stiff"}, "matrix of numbers"),
        ({"K": np.zeros((0, 0)), "dofs": []}, "square"),
        ({"K": LOPSIDED}, r"not symmetric.*differ by 5e-07"),
        ({"K": GOOD * 1j}, "complex"),
        ({"K": np.array([[np.nan, 0], [0, 1.0]])}, "NaN"),
        ({"K": sparse.csr_array(np.array([[np.inf, 0], [0, 1.0]]))}, "infinity"),
        ({"K": GOOD, "M": np.eye(3)}, "wrong size"),
        ({"K": GOOD, "M": np.diag([1.0, -1.0])}, r"negative mass.*2\+X|2\+X.*negative mass"),
        ({"K": GOOD, "M": np.diag([1.0, 0.0])}, r"no mass.*2\+X"),
        ({"K": GOOD, "M": np.array([[1.0, 0.2], [0.1, 1.0]])}, "matrix M: not symmetric"),
        ({"K": GOOD, "C": np.diag([1.0, -1.0])}, "negative damping"),
        ({"K": np.diag([1.0, -1.0])}, "negative stiffness"),
        ({"K": GOOD, "dofs": ["1+X", "1-X"]}, r"duplicated DOF; found: 1-X"),
        ({"K": GOOD, "dofs": ["1+X"]}, "1 DOFs"),
        ({"K": GOOD, "dofs": ["1+X", "two"]}, "no DOF"),
        ({"K": GOOD, "supports": ["3+X"]}, r"no such DOF; found: 3\+X; expected: nodes 1 to 2"),
        ({"K": GOOD, "supports": ["2+Y"]}, r"node 2 has 2\+X"),
        ({"K": GOOD, "coordinates": [0.0, np.nan]}, "NaN"),
        ({"K": GOOD, "coordinates": [0.0, 1.0, 2.0]}, "coordinates"),
    ],
)
def test_bad_matrices_raise(settings, words):
    with pytest.raises(InputError, match=words):
        Structure.from_matrices(**{"dofs": ["1+X", "2+X"], **settings})


def test_a_supported_dof_needs_no_mass():
    s = Structure.from_matrices(GOOD, np.diag([1.0, 0.0]), dofs=["1+X", "2+X"], supports=["2-X"])
    assert s.M_free.shape == (1, 1)
    assert [str(d) for d in s.supports] == ["2+X"]


def test_rounding_asymmetry_is_forgiven_and_removed():
    K = GOOD.copy()
    K[0, 1] += 1e-12
    s = Structure.from_matrices(K)
    assert abs(s.K - s.K.T).max() == 0
    assert [str(d) for d in s.dofs] == ["0+S", "1+S"]


def test_bad_questions_raise():
    s = EVERY["beam steel"]()
    for question in (
        lambda: s.scaled("length", 1.1),
        lambda: s.scaled("mass", 0.0),
        lambda: s.scaled("mass", np.nan),
        lambda: s.reactions(np.ones(3)),
        lambda: s.reactions(np.full(s.n, np.nan)),
        lambda: s.reactions(np.ones(s.n), np.ones(3)),
        lambda: s.expand(np.ones(3)),
    ):
        with pytest.raises(InputError):
            question()


def test_a_support_reaction_is_no_load():
    s = beams.simply_supported(elements=10, **UNIT)
    f = loads.Patch(x=(0.0, 1.0)).column(s)
    r = s.reactions(solve(s, f), f)
    assert [str(d) for d in s.supports] == ["0+Z", "10+Z"]
    assert r == pytest.approx([-0.5, -0.5], rel=1e-9)
    # without the load, what the elements beside the supports pass straight into them would be missing
    assert s.reactions(solve(s, f)) == pytest.approx([-0.45, -0.45], rel=1e-9)


def test_chain_reaction():
    s = chains.chain(masses=[1.0, 1.0], springs=[1.0, 2.0, 3.0], right="fixed")
    u = solve(s, loads.Point("1+X").column(s))
    assert s.reactions(u).sum() == pytest.approx(-1.0)


# -- definiteness ----------------------------------------------------------------------------------------------------
def ring(n, a):
    """Unit diagonal, `a` beside it and in the corners: eigenvalues 1 + 2 a cos."""
    i = np.arange(n)
    off = sparse.coo_array((np.full(n, a), (i, (i + 1) % n)), shape=(n, n))
    return sparse.eye_array(n) + off + off.T


@pytest.mark.parametrize("name", ["M", "C"])
@pytest.mark.parametrize(("n", "good", "bad"), [(20, 0.499, 0.51), (800, 0.499, 1.01)])
def test_a_matrix_that_gives_some_motion_negative_energy(name, n, good, bad):
    """Small matrices by their eigenvalues, large ones by pairs of DOFs; units (1e6 apart) do not matter."""
    units = sparse.diags_array(np.logspace(-3, 3, n))
    for value in (good, bad):
        A = units @ ring(n, value) @ units
        parts = {"M": sparse.eye_array(n), name: A}
        if value == good:
            Structure.from_matrices(sparse.eye_array(n), **parts)
            continue
        with pytest.raises(InputError, match=f"matrix {name}: the (mass|damping) matrix is indefinite"):
            Structure.from_matrices(sparse.eye_array(n), **parts)


def test_semidefinite_matrices_pass():
    """A dashpot between two DOFs, and a supported DOF without mass."""
    Structure.from_matrices(np.eye(3), np.diag([1.0, 1.0, 0.0]), [[1, -1, 0], [-1, 1, 0], [0, 0, 0]], supports=["2+S"])
    with pytest.raises(InputError, match="indefinite"):
        Structure.from_matrices(np.eye(2), [[1.0, 0.5], [0.5, 0.0]], supports=["1+S"])
