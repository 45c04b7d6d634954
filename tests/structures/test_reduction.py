import numpy as np
import pytest

from structures import ForwardModel, InputError, NotIdentifiable, Structure, beams, chains, loads, plates, sensors
from structures._elements.members import steel
from structures._models.reduction import DENSE, modal_damping, modal_weights, modes
from structures._system.damping import Modal, Rayleigh

SETTINGS = {"length": 1.2, "EI": 800.0, "mass_per_length": 3.0}
PLATE = {"lengths": (0.5, 0.5), "thickness": 3e-3, "material": steel}


def check_modes(structure, found):
    K, M, phi = structure.K_free, structure.M_free, found.phi
    assert np.allclose(phi.T @ (M @ phi), np.eye(phi.shape[1]), atol=1e-9)
    top = np.max(K.diagonal() / M.diagonal())  # the rounding of K itself
    assert np.allclose(phi.T @ (K @ phi), np.diag(found.lam), atol=1e-8 * found.lam[-1] + 1e-13 * top)


@pytest.mark.parametrize("count", [8, None])
def test_dense_modes_of_a_beam(count):
    beam = beams.simply_supported(elements=40, **SETTINGS)
    found = modes(beam, count)
    n = np.arange(1, 9)
    assert np.allclose(np.sqrt(found.lam[:8]), (n * np.pi / 1.2) ** 2 * np.sqrt(800 / 3), rtol=2e-4)
    assert len(found.lam) == (count or beam.free.size)
    check_modes(beam, found)


def test_sparse_and_dense_solvers_agree():
    beam = beams.cantilever(elements=DENSE // 2 + 10, **SETTINGS)
    assert beam.free.size > DENSE
    sparse_, dense = modes(beam, 12), modes(beam)
    unit = 1 / np.sqrt(beam.K_free.diagonal())
    rounded = np.finfo(float).eps * np.linalg.cond(unit[:, None] * beam.K_free.toarray() * unit)  # what K itself tells
    assert np.allclose(sparse_.lam, dense.lam[:12], rtol=rounded, atol=0)
    assert rounded < 1e-5
    overlap = np.abs(sparse_.phi.T @ (beam.M_free @ dense.phi[:, :12]))
    assert np.allclose(overlap, np.eye(12), atol=1e-5)


@pytest.mark.parametrize("make", [beams.cantilever, beams.free])
def test_every_dense_mode_is_accurate_from_the_first_to_the_last(make):
    """One eigenproblem alone loses the low or the high end: their frequencies differ by a factor 1e4 and more."""
    beam = make(elements=40, **SETTINGS)
    found = modes(beam)
    scale = 1 / np.sqrt(beam.M_free.diagonal())[:, None]
    error = scale * (beam.K_free @ found.phi - beam.M_free @ found.phi * found.lam)
    top = np.linalg.norm(scale * (abs(beam.K_free) @ np.abs(found.phi)), axis=0)
    assert np.all(np.linalg.norm(error, axis=0) < 1e-12 * top)
    fine = modes(make(elements=41, **SETTINGS)).lam
    assert np.allclose(found.lam[found.rigid : 8], fine[found.rigid : 8], rtol=1e-4)


def test_double_frequencies_of_a_square_plate_are_all_found():
    plate = plates.plate(elements=(16, 16), edges="SSSS", **PLATE)
    found = modes(plate, 30)
    D = steel.E * 3e-3**3 / 12 / (1 - steel.nu**2)
    exact = np.sort([np.pi**2 * (i**2 + j**2) for i in range(1, 15) for j in range(1, 15)])[:30]
    assert np.allclose(np.sqrt(found.lam * steel.rho * 3e-3 / D) * 0.25, exact, rtol=5e-3)
    assert np.allclose(np.sqrt(found.lam[:10] * steel.rho * 3e-3 / D) * 0.25, exact[:10], rtol=1e-3)
    check_modes(plate, found)


@pytest.mark.parametrize(
    ("structure", "rigid"),
    [
        (beams.free(elements=20, **SETTINGS), 2),
        (beams.free(elements=250, **SETTINGS), 2),
        (beams.beam(left="pinned", right="free", elements=20, **SETTINGS), 1),
        (plates.plate(elements=(4, 4), edges="FFFF", **PLATE), 3),
        (plates.plate(elements=(12, 12), edges="FFFF", **PLATE), 3),
        (chains.chain(masses=[1.0, 2.0], springs=[5.0], left="free", right="free"), 1),
        (Structure.from_matrices(np.zeros((1, 1)), np.array([[2.0]])), 1),
    ],
)
def test_rigid_body_modes_are_exactly_zero(structure, rigid):
    count = None if structure.free.size <= DENSE else 12
    found = modes(structure, count)
    assert found.rigid == rigid
    assert np.all(found.lam[:rigid] == 0)
    assert np.all(found.lam[rigid:] > 0)
    assert np.abs(structure.K_free @ found.phi[:, :rigid]).max() < 1e-7 * abs(structure.K_free).max() + 1e-12
    check_modes(structure, found)


@pytest.mark.parametrize("elements", [25, 250])
def test_free_beam_frequencies(elements):
    found = modes(beams.free(elements=elements, **SETTINGS), 5)
    beta = np.array([4.73004074, 7.85320462, 10.99560784])
    assert np.allclose(np.sqrt(found.lam[2:]), (beta / 1.2) ** 2 * np.sqrt(800 / 3), rtol=1e-4)


def test_modal_damping_of_every_kind():
    beam = beams.cantilever(elements=6, **SETTINGS)
    found = modes(beam)
    omega = np.sqrt(found.lam)
    assert np.array_equal(modal_damping(beam, found), np.zeros(12))
    c = modal_damping(beam.with_damping(Modal((0.01, 0.03))), found)
    assert np.allclose(c, 2 * omega * np.r_[0.01, np.full(11, 0.03)])
    rayleigh = beam.with_damping(Rayleigh(3.0, 1e-5))
    projected = Structure.from_matrices(beam.K_free, beam.M_free, 3.0 * beam.M_free + 1e-5 * beam.K_free)
    assert np.allclose(modal_damping(rayleigh, found), modal_damping(projected, found), rtol=1e-8)
    assert modal_damping(projected, found).ndim == 1


def test_ratios_are_counted_from_the_first_elastic_mode():
    beam = beams.free(elements=6, damping=Modal((0.01, 0.5)), **SETTINGS)
    found = modes(beam)
    c = modal_damping(beam, found)
    assert np.all(c[:2] == 0)
    assert c[2] == pytest.approx(0.02 * np.sqrt(found.lam[2]))


def test_a_dashpot_that_couples_the_modes_keeps_its_matrix():
    chain = chains.chain(masses=[1.0, 2.0, 1.0], springs=[900.0, 400.0, 500.0], dashpots=[5.0, 0.0, 0.0])
    found = modes(chain)
    C = modal_damping(chain, found)
    assert C.shape == (3, 3)
    assert np.allclose(C, found.phi.T @ chain.C_free.toarray() @ found.phi)


def test_static_residual_is_what_the_left_out_modes_give():
    beam = beams.cantilever(elements=20, **SETTINGS)
    args = (
        [sensors.Displacement("9+Z"), sensors.StrainGauge(at=0.3, fibre=0.01)],
        [loads.Point("17+Z"), loads.Point("4+Z")],
    )
    few, full = ForwardModel(beam, *args, modes=6), ForwardModel(beam, *args)
    s, b, lam = full.reduced.S[:, 6:], full.reduced.B[6:], full.reduced.lam[6:]
    assert full.reduced.residual is None
    assert np.allclose(few.reduced.residual, (s / lam) @ b, rtol=1e-6)
    assert ForwardModel(beam, *args, modes=6, residual=False).reduced.residual is None


def test_static_residual_of_a_free_structure():
    beam = beams.free(elements=20, **SETTINGS)
    args = [sensors.Displacement("9+Z")], [loads.Point("17+Z")]
    few, full = ForwardModel(beam, *args, modes=10), ForwardModel(beam, *args)
    rest = (full.reduced.S[:, 10:] / full.reduced.lam[10:]) @ full.reduced.B[10:]
    assert np.allclose(few.reduced.residual, rest, rtol=1e-3)


def test_weights_of_a_rigid_mode_keep_their_limit():
    zero = np.array([0.0])
    for c, derivative, limit in ((0.0, 2, 1.0), (3.0, 2, 0.0), (3.0, 1, 1 / 3.0)):
        w = modal_weights(zero, zero, np.array([c]), zero > 1, derivative)
        assert w[0, 0] == pytest.approx(limit)
    assert np.isnan(modal_weights(zero, zero, zero, zero > 1, 0)[0, 0])
    w = modal_weights(np.array([5.0]), zero, np.array([3.0]), zero > 1, 1)
    assert w[0, 0] == pytest.approx(5j / (-25 + 15j))


def test_what_has_no_modes_is_refused():
    beam = beams.cantilever(elements=4, **SETTINGS)
    with pytest.raises(InputError, match="no mass matrix"):
        modes(Structure.from_matrices(beam.K_free))
    with pytest.raises(InputError, match="number of modes"):
        modes(beam, 9)
    with pytest.raises(InputError, match="indefinite"):
        modes(Structure.from_matrices(np.diag([2.0, 2.0]), np.array([[1.0, 2.0], [2.0, 1.0]])))
    buckled = beams.simply_supported(elements=10, tension=-1.2 * np.pi**2 * 800 / 1.2**2, **SETTINGS)
    with pytest.raises(InputError, match="unstable"):
        modes(buckled)


class TestUndamped:
    """A structure without damping is a model like any other: no warning, decay rate 0, refusals by name."""

    def model(self, damping=None, right="free", sensor=sensors.Accelerometer):
        s = beams.beam(
            length=1.2, elements=12, left="clamped", right=right, section=beams.Section.rectangle(0.04, 0.008),
            material=steel, damping=damping,
        )  # fmt: skip
        return ForwardModel(s, [sensor("6+Z")], [loads.Point("9+Z")])

    def test_decays_at_no_rate_without_a_warning(self):
        assert self.model().decay_rate == 0.0
        assert self.model(Modal(0.01)).decay_rate == pytest.approx(
            0.01 * 2 * np.pi * self.model().natural_frequencies[0]
        )

    def test_overdamped_slow_root(self):
        oscillator = chains.oscillator(mass=1.0, stiffness=1.0, dashpot=1e4)
        m = ForwardModel(oscillator, [sensors.Displacement("1+X")], [loads.Point("1+X")])
        assert m.decay_rate == pytest.approx(1e-4, rel=1e-7)

    def test_time_domain_is_exact(self):
        m = ForwardModel(
            chains.oscillator(mass=2.0, stiffness=50.0), [sensors.Displacement("1+X")], [loads.Point("1+X")]
        )
        y = m.predict(np.ones(400), 0.01, hold="zoh")[:, 0]
        np.testing.assert_allclose(y, (1 - np.cos(5.0 * 0.01 * np.arange(400))) / 50, atol=1e-13)

    @pytest.mark.parametrize("method", ["modal", "direct"])
    @pytest.mark.parametrize("mode", [0, 2])
    def test_a_line_on_a_resonance_is_refused_by_name(self, method, mode):
        m = self.model(sensor=sensors.Displacement)
        at = m.natural_frequencies[mode]
        with pytest.raises(NotIdentifiable, match=rf"natural frequency of mode {mode + 1} .*no damping") as error:
            m.frf([1.0, at, 2 * at], method=method)
        assert error.value.code == "LID-E116"
        assert np.all(np.isfinite(m.frf([at * (1 - 1e-9), at * (1 + 1e-9)], method=method)))
        assert np.all(np.isfinite(self.model(Modal(1e-6)).frf([at])))

    def test_a_mode_that_the_damper_misses(self):
        """Three masses, a damper on the middle one: the antisymmetric mode never feels it, the other two couple."""
        K = 100.0 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]])
        s = Structure.from_matrices(K, np.diag([1.0, 3.0, 1.0]), np.diag([0.0, 2.0, 0.0]), dofs=["1+X", "2+X", "3+X"])
        m = ForwardModel(s, [sensors.Displacement("1+X")], [loads.Point("1+X")])
        assert not m.reduced.proportional
        assert m.decay_rate == pytest.approx(0.0, abs=1e-9)
        at = np.sqrt(200.0) / (2 * np.pi)
        with pytest.raises(NotIdentifiable, match="natural frequency of mode 2"):
            m.frf([1.0, at, 2.0])
        assert np.all(np.isfinite(m.frf([0.0, at * (1 - 1e-8)])))
