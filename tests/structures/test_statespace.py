import numpy as np
import pytest
from scipy import signal

from structures import Channel, ForwardModel, InputError, NotIdentifiable, StateSpace, beams, chains, loads, sensors
from structures._system.damping import Modal

RNG = np.random.default_rng(0)
A = 0.25 * RNG.standard_normal((6, 6))
B, C, D = RNG.standard_normal((6, 2)), RNG.standard_normal((3, 6)), RNG.standard_normal((3, 2))
DT = 1e-3


def system(**settings):
    return StateSpace(A, B, C, D, DT, **settings)


@pytest.mark.parametrize("samples", [1, 2, 65, 200])
def test_impulse_response_is_the_markov_parameters(samples):
    h = [y[:samples] for y in signal.dimpulse((A, B, C, D, DT), n=samples + 1)[1]]
    assert np.allclose(system().impulse_response(DT, samples), np.stack(h, axis=-1), atol=1e-13)


def test_frequency_response_at_any_line():
    f = np.linspace(0, 500, 37)
    H = system().frf(f)
    z = np.exp(2j * np.pi * f * DT)
    exact = np.array([C @ np.linalg.solve(w * np.eye(6) - A, B) + D for w in z])
    assert np.allclose(H, exact, rtol=1e-11)
    assert np.allclose(system().static(), exact[0].real)


def test_simulation_agrees_with_convolution_and_takes_an_initial_state():
    u = RNG.standard_normal((50, 2))
    y = system().simulate(u)
    assert np.allclose(y, signal.dlsim((A, B, C, D, DT), u)[1], atol=1e-12)
    assert np.allclose(y, system().predict(u, DT), atol=1e-12)
    x0 = RNG.standard_normal(6)
    free = np.array([C @ np.linalg.matrix_power(A, k) @ x0 for k in range(50)])
    assert np.allclose(system().simulate(u, x0) - y, free, atol=1e-12)


def test_a_load_that_moves():
    u = RNG.standard_normal((9, 2))
    Bt, Dt = B * (1 + np.arange(9.0))[:, None, None], D * np.ones((9, 1, 1))
    moving = StateSpace(A, Bt, C, Dt, DT)
    still = system().simulate(u * (1 + np.arange(9.0))[:, None]) - (u * np.arange(9.0)[:, None]) @ D.T
    assert np.allclose(moving.simulate(u), still, atol=1e-12)
    for ask in (lambda: moving.frf([1.0]), lambda: moving.impulse_response(DT, 5), moving.static):
        with pytest.raises(InputError, match="loads that move"):
            ask()
    with pytest.raises(InputError, match="9, 2"):
        moving.simulate(u[:5])


@pytest.mark.parametrize(("dt", "hold"), [(2e-3, None), (DT, "foh"), (np.nan, None)])
def test_another_step_or_hold_is_refused_by_name(dt, hold):
    for ask in (lambda: system().impulse_response(dt, 5, hold), lambda: system().state_space(dt, hold)):
        with pytest.raises(InputError, match=r"dt=0\.001, hold='zoh'"):
            ask()


def test_its_own_step_and_hold_are_accepted():
    model = system()
    assert model.state_space(DT) is model
    assert model.state_space(DT, "zoh") is model
    assert model.impulse_response(DT, 4, "zoh").shape == (4, 3, 2)


@pytest.mark.parametrize(
    "matrices",
    [
        (A[:5], B, C, D),
        (A, B[:4], C, D),
        (A, B, C[:, :5], D),
        (A, B, C, D[:2]),
        (A, B, C, D[:, :1]),
        (A, np.stack([B, B]), C, np.stack([D, D, D])),
    ],
)
def test_matrices_that_do_not_fit_are_refused(matrices):
    with pytest.raises(InputError, match="do not fit each other"):
        StateSpace(*matrices, DT)


def test_bad_numbers_are_refused():
    bad = A.copy()
    bad[2, 3] = np.nan
    with pytest.raises(InputError, match="A: NaN"):
        StateSpace(bad, B, C, D, DT)
    with pytest.raises(InputError, match="complex"):
        StateSpace(A + 0j, B, C, D, DT)
    with pytest.raises(InputError, match="step"):
        StateSpace(A, B, C, D, 0.0)
    with pytest.raises(InputError, match="hold"):
        StateSpace(A, B, C, D, DT, "linear")
    with pytest.raises(InputError, match="labels"):
        system(sensors=["a", "b"])
    with pytest.raises(InputError, match="labels"):
        system(loads=["a", "a"])
    with pytest.raises(InputError, match="NaN"):
        system().simulate(np.array([[np.nan, 0.0]]))
    with pytest.raises(InputError, match="frequencies"):
        system().frf([501.0])
    with pytest.raises(InputError, match="samples"):
        system().impulse_response(DT, 0)
    with pytest.raises(InputError, match="state does not fit"):
        system().simulate(np.zeros((3, 2)), np.zeros(5))
    with pytest.raises(InputError, match=r"no perturbed\(\)"):
        system().perturbed("stiffness", 1.1)


def test_labels_noise_and_fingerprint():
    model = system(
        sensors=[Channel(label=x, noise=s) for x, s in (("a", 1.0), ("b", 2.0), ("c", 3.0))], loads=["p", "q"]
    )
    assert [c.label for c in model.loads] == ["p", "q"]
    assert np.array_equal(model.noise, [1, 2, 3])
    assert system().noise is None
    assert model.fingerprint != system().fingerprint == system().fingerprint
    assert StateSpace(A, B, C, D, DT, "foh").fingerprint != system().fingerprint
    assert not model.A.flags.writeable


def test_decay_rate_is_that_of_the_slowest_mode():
    beam = beams.cantilever(length=1.2, EI=800.0, mass_per_length=3.0, elements=5, damping=Modal(0.02))
    model = ForwardModel(beam, [sensors.Displacement("5+Z")], [loads.Point("5+Z")])
    slowest = 0.02 * 2 * np.pi * model.natural_frequencies[0]
    assert model.decay_rate == pytest.approx(slowest)
    assert model.state_space(1e-4).decay_rate == pytest.approx(slowest, rel=1e-8)


def test_an_integrator_has_no_static_gain():
    with pytest.raises(NotIdentifiable, match="never settles"):
        StateSpace([[1.0, 0.1], [0, 1]], [[0.005], [0.1]], [[1.0, 0]], [[0.0]], 0.1).static()


def test_certificate_of_a_model_with_the_wrong_gain():
    u = RNG.standard_normal((40, 2))
    y = system().simulate(u)
    scaled = StateSpace(A, B, 2 * C, 2 * D, DT)
    certificate = scaled.verify(u, y, DT, source="hit 3")
    assert certificate.gain == pytest.approx([0.5] * 3)
    assert certificate.shape == pytest.approx([1.0] * 3)
    assert scaled.certificate is certificate
    assert "hit 3" in str(certificate)


class TestUnstable:
    """A model that grows has no static response and no FRF; it is simulated, without a warning, while numbers last."""

    grows = StateSpace([[2.0]], [[1.0]], [[1.0]], [[0.0]], 0.01)

    @pytest.mark.parametrize("ask", [lambda m: m.static(), lambda m: m.frf([1.0])])
    def test_refused_by_name(self, ask):
        with pytest.raises(InputError, match=r"unstable.*modulus 2") as error:
            ask(self.grows)
        assert error.value.hint

    def test_simulated_while_numbers_last(self):
        assert self.grows.simulate(np.eye(1, 50)[0])[-1, 0] == 2.0**48
        for ask in (lambda: self.grows.simulate(np.ones(3000)), lambda: self.grows.impulse_response(0.01, 3000)):
            with pytest.raises(InputError, match=r"outgrows the numbers.*overflow at sample 10"):
                ask()

    @pytest.mark.parametrize("size", [1, 4])
    def test_a_free_body_is_not_unstable(self, size):
        """Its double pole at 1 is moved by the root of rounding: decay rate 0, and an FRF away from 0 Hz."""
        s = chains.chain(masses=np.ones(size), springs=5.0, left="free")
        model = ForwardModel(s, [sensors.Displacement("1+X")], [loads.Point("1+X")]).state_space(1e-3)
        assert model.decay_rate == pytest.approx(0.0, abs=1e-3)
        assert np.all(np.isfinite(model.frf([1.0, 10.0])))

    def test_an_undamped_pole_is_named(self):
        m = ForwardModel(
            chains.oscillator(mass=1.0, stiffness=100.0), [sensors.Displacement("1+X")], [loads.Point("1+X")]
        )
        with pytest.raises(NotIdentifiable, match=r"at 1.59155 Hz is unbounded: an undamped pole"):
            m.state_space(0.01).frf([1.0, 10 / (2 * np.pi)])
