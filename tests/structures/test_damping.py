import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures import ForwardModel, Structure, beams, chains, files, loads, motion, sensors
from structures._system.damping import Modal, Rayleigh, Structural
from structures.errors import InputError

from .kinds import EVERY


@given(st.floats(0.1, 1e4), st.floats(1.01, 100), st.floats(1e-4, 0.5), st.floats(0, 1))
def test_rayleigh_reproduces_the_two_ratios(f1, spread, z1, share):
    f2 = f1 * spread
    z2 = min(z1 * (1 / spread + share * (spread - 1 / spread)), 0.99)
    damping = Rayleigh.from_ratios(f1, z1, f2, z2)
    omega = 2 * np.pi * np.array([f1, f2])
    assert damping.ratio(omega) == pytest.approx([z1, z2], rel=1e-7, abs=1e-12)
    assert damping.coefficient(omega) == pytest.approx(2 * damping.ratio(omega) * omega)
    assert Rayleigh.from_ratios(f2, z2, f1, z1) == damping


def test_equal_ratios_have_the_closed_form_and_its_minimum():
    z, w1, w2 = 0.02, 2 * np.pi * 10, 2 * np.pi * 90
    damping = Rayleigh.from_ratios(10, z, 90, z)
    assert damping.alpha == pytest.approx(2 * z * w1 * w2 / (w1 + w2))
    assert damping.beta == pytest.approx(2 * z / (w1 + w2))
    omega = np.linspace(w1, w2, 20001)
    assert damping.ratio(omega).min() == pytest.approx(2 * z * np.sqrt(w1 * w2) / (w1 + w2), rel=1e-7)


@pytest.mark.parametrize(("z1", "z2", "name"), [(0.001, 0.05, "alpha"), (0.2, 0.01, "beta")])
def test_impossible_ratios_are_refused_and_named(z1, z2, name):
    with pytest.raises(InputError, match=f"ratios {z1} at 10 Hz and {z2} at 30 Hz make {name} negative"):
        Rayleigh.from_ratios(10, z1, 30, z2)


@pytest.mark.parametrize(
    "bad",
    [lambda: Rayleigh(-1.0, 0.0), lambda: Rayleigh(0.0, np.nan), lambda: Rayleigh.from_ratios(5, 0.01, 5, 0.02),
     lambda: Rayleigh.from_ratios(0, 0.01, 5, 0.02), lambda: Rayleigh.from_ratios(1, 2.0, 5, 2.0), lambda: Modal(2.0),
     lambda: Modal(np.nan), lambda: Modal([]), lambda: Modal([0.01, -0.01]), lambda: Rayleigh(1, 1).ratio(0.0),
     lambda: Structural(-0.01), lambda: Structural(2.0), lambda: Structural(np.nan), lambda: Structural("2 %"),
     lambda: Structural(0.6).scaled(2.0)],
)  # fmt: skip
def test_bad_damping_raises(bad):
    with pytest.raises(InputError):
        bad()


def test_rayleigh_matrix_has_the_modal_ratios():
    structure = EVERY["shear building"]().with_damping(Rayleigh(0.3, 2e-3))
    import scipy.linalg

    w2, X = scipy.linalg.eigh(structure.K_free.toarray(), structure.M_free.toarray())
    C = X.T @ structure.C_free @ X
    assert np.diag(C) == pytest.approx(structure.damping.coefficient(np.sqrt(w2)))
    assert np.abs(C - np.diag(np.diag(C))).max() < 1e-9 * np.abs(C).max()


def test_modal_ratios_are_kept_above_the_last_one():
    omega = np.array([1.0, 2.0, 5.0])
    assert Modal(0.01).coefficient(omega) == pytest.approx(0.02 * omega)
    assert Modal([0.01, 0.03]).ratio(omega) == pytest.approx([0.01, 0.03, 0.03])
    assert hash(Modal(np.array([0.01, 0.02]))) == hash(Modal([0.01, 0.02]))


def test_scaling_multiplies_the_damping():
    assert Rayleigh(1.0, 2.0).scaled(3.0) == Rayleigh(3.0, 6.0)
    assert Modal([0.01, 0.02]).scaled(2.0) == Modal([0.02, 0.04])


def test_dashpots_and_rayleigh_add_but_modal_ratios_replace():
    chain = EVERY["chain fixed-free"]()
    both = chain.with_damping(Rayleigh(0.5, 0.0))
    assert np.allclose((both.C_free - chain.C_free).toarray(), 0.5 * chain.M_free.toarray())
    with pytest.raises(InputError, match="modal ratios at once"):
        chain.with_damping(Modal(0.01))
    beam = EVERY["beam clamped-free"]().with_damping(Modal(0.01))
    assert beam.C_free is None
    with pytest.raises(InputError, match="mass matrix"):
        Structure.from_matrices([[1.0]], damping=Rayleigh(1.0, 0.0))


# -- structural damping: K (1 + i eta)
ETA = 0.04
REDUCTIONS = {"modes": {}, "krylov": {"reduction": "krylov", "band": 900.0}}
BEAM = {"length": 1.2, "EI": 800.0, "mass_per_length": 3.0, "elements": 40}


@pytest.mark.parametrize("reduction", REDUCTIONS)
@pytest.mark.parametrize("method", ["modal", "direct"])
def test_an_oscillator_with_a_loss_factor_in_closed_form(method, reduction):
    m, k = 2.0, 5e3
    model = ForwardModel(
        chains.oscillator(mass=m, stiffness=k).with_damping(Structural(ETA)),
        [sensors.Displacement("1+X"), sensors.Accelerometer("1+X", label="a")],
        [loads.Point("1+X")],
        **REDUCTIONS[reduction],
    )
    f = np.array([0.0, 1.0, np.sqrt(k / m) / (2 * np.pi), 20.0])
    w = 2 * np.pi * f
    exact = 1 / (k * (1 + 1j * ETA * (f > 0)) - m * w**2)
    H = model.frf(f, method=method)[:, :, 0]
    assert np.allclose(H[:, 0], exact, rtol=1e-12)
    assert np.allclose(H[:, 1], -(w**2) * exact, rtol=1e-12)
    assert H[0, 0] == pytest.approx(model.static()[0, 0])
    same = ForwardModel(model.structure.with_damping(Modal(ETA / 2)), model.sensors, model.loads)
    assert np.allclose(same.frf(f[2:3]), H[2:3, :, None], rtol=1e-12)  # the modal ratio of equal loss at resonance
    assert model.decay_rate == pytest.approx(same.decay_rate)


@pytest.mark.parametrize(
    ("settings", "method", "tolerance"),
    [({}, "modal", 1e-4), ({}, "direct", 1e-4), (REDUCTIONS["krylov"], "modal", 1e-4), ({"modes": 2}, "modal", 1e-4)],
)
def test_a_cantilever_with_a_complex_modulus_in_closed_form(settings, method, tolerance):
    """The receptance of the tip with EI (1 + i eta) for EI; two modes need a damped residual."""
    L, EI, mass = BEAM["length"], BEAM["EI"] * (1 + 1j * ETA), BEAM["mass_per_length"]
    model = ForwardModel(
        beams.cantilever(damping=Structural(ETA), **BEAM),
        [sensors.Displacement("40+Z")],
        [loads.Point("40+Z")],
        **settings,
    )
    f = np.array([1.0, 4.0, 30.0, 78.0, 120.0, 250.0]) if settings.get("modes") != 2 else np.array([1.0, 4.0, 9.0])
    b = L * (mass * (2 * np.pi * f) ** 2 / EI) ** 0.25
    exact = L**3 / EI * (np.cosh(b) * np.sin(b) - np.sinh(b) * np.cos(b)) / (b**3 * (1 + np.cos(b) * np.cosh(b)))
    H = model.frf(f, method=method)[:, 0, 0]
    assert np.all(np.abs(H - exact) < tolerance * np.abs(exact))
    assert np.all(np.abs(np.angle(H / exact)) < tolerance)
    assert np.all(H.imag < 0)  # power flows in, never out


def test_a_loss_factor_beside_a_dashpot():
    chain = EVERY["chain fixed-free"]().with_damping(Structural(ETA))
    model = ForwardModel(chain, [sensors.Velocity("3+X")], [loads.Point("1+X")])
    f = np.array([0.3, 0.7, 1.4])
    w = 2 * np.pi * f[:, None, None]
    K, M, C = (A.toarray() for A in (chain.K_free, chain.M_free, chain.C_free))
    exact = np.linalg.solve(K * (1 + 1j * ETA) - w**2 * M + 1j * w * C, np.eye(3))
    assert not model.reduced.proportional
    for method in ("modal", "direct"):
        assert np.allclose(model.frf(f, method=method)[:, 0, 0], 1j * w[:, 0, 0] * exact[:, 2, 0], rtol=1e-10)


@pytest.mark.parametrize("settings", REDUCTIONS.values(), ids=REDUCTIONS)
@pytest.mark.parametrize("eta", [ETA, 0.1])
def test_a_loss_factor_has_no_time_domain(eta, settings):
    model = ForwardModel(
        beams.cantilever(damping=Structural(eta), **BEAM),
        [sensors.Displacement("40+Z")],
        [loads.Point("9+Z")],
        **settings,
    )
    for name, ask in (
        ("impulse_response", lambda: model.impulse_response(1e-3, 10)),
        ("impulse_response", lambda: model.predict(np.ones(10), 1e-3)),
        ("state_space", lambda: model.state_space(1e-3)),
        ("motion", lambda: motion.motion(model, np.ones((10, 1)), 1e-3)),
    ):
        with pytest.raises(InputError, match=rf"no {name}.*not causal.*damping={eta / 2:g}, the modal ratio eta / 2"):
            ask()


def test_the_whole_motion_under_a_loss_factor_balances():
    model = ForwardModel(
        beams.cantilever(damping=Structural(ETA), **BEAM), [sensors.Displacement("40+Z")], [loads.Point("40+Z")]
    )
    found = motion.harmonic_motion(model, [2.0], 78.0)
    s, u = model.structure, found.displacement[model.structure.free]
    turns, forces = np.array([3 < abs(s.dofs[i].direction) <= 6 for i in s.free]), abs(s.K_free) @ np.abs(u)
    # rows of 6 entries, each rounded in both factors and in the product: a backward stable solve leaves that
    rounded = 18 * np.finfo(float).eps * np.linalg.norm(forces[turns]) / np.linalg.norm((s.K_free @ u)[turns])
    assert found.imbalance() < rounded < 1e-8
    tip = found.displacement[model.structure.index("40+Z")]
    assert tip == pytest.approx(2.0 * model.frf([78.0])[0, 0, 0], rel=1e-8)


def test_structural_damping_is_kept_scaled_and_saved(tmp_path):
    structure = EVERY["beam clamped-free"]().with_damping(Structural(ETA))
    assert structure.C_free is None
    assert structure.scaled("damping", 2.0).damping == Structural(2 * ETA)
    assert structure.digest != structure.with_damping(None).digest
    assert Structural(ETA).ratio([1.0, 5.0]) == pytest.approx([ETA / 2, ETA / 2])
    files.save(structure, tmp_path / "model.npz")
    assert files.load(tmp_path / "model.npz").damping == Structural(ETA)
