import numpy as np
import pytest
from scipy import signal

from structures import InputError
from structures._models.discretise import blocks, discretise, filter_step, markov, sequence
from structures._models.reduction import ReducedModel


def taylor(F):
    """Matrix exponential by scaled Taylor series in extended precision."""
    F = F.astype(np.longdouble)
    squarings = max(0, int(np.ceil(np.log2(float(np.abs(F).sum(axis=1).max()) + 1e-300)))) + 4
    term = E = np.eye(len(F), dtype=np.longdouble)
    for j in range(1, 30):
        term = term @ F / 2**squarings / j
        E = E + term
    for _ in range(squarings):
        E = E @ E
    return E


def reference(lam, c, dt, derivative=0, corner=0.0):
    """Transition and input matrices of one mode in the states (omega q, dq/dt[, filter])."""
    w = np.sqrt(lam) if lam > 0 else 1.0
    s = 3 if corner else 2
    F = np.zeros((s + 2, s + 2), dtype=np.longdouble)
    F[0, 1], F[1, 0], F[1, 1], F[1, s] = w, -lam / w, -c, 1.0
    if corner:
        a = 2 * np.pi * corner
        row, feed = (((1 / w, 0.0), 0.0), ((0.0, 1.0), 0.0), ((-lam / w, -c), 1.0))[derivative]
        F[2, :2], F[2, s], F[2, 2] = a * np.array(row), a * feed, -a
    F *= dt
    F[s, s + 1] = 1.0
    E = taylor(F)
    return E[:s, :s], E[:s, s], E[:s, s + 1]


@pytest.mark.parametrize("omega_h", [0.0, 1e-9, 1e-6, 1e-4, 0.3, 3.0])
@pytest.mark.parametrize("zeta", [0.0, 0.01, 1.0, 3.0])
@pytest.mark.parametrize("corner", [0.0, 0.5])
def test_no_digit_is_lost_from_rigid_to_fast_modes(omega_h, zeta, corner):
    dt = 1.7e-3
    lam, c = np.array([(omega_h / dt) ** 2]), np.array([2 * zeta * (omega_h / dt or 5.0)])
    for derivative in (0, 1, 2):
        got = blocks(lam, c, dt, "foh", derivative=derivative, corner=corner)
        for mine, exact in zip((got.A, got.G1, got.G2), reference(lam[0], c[0], dt, derivative, corner), strict=True):
            assert np.allclose(mine[0], exact.astype(float), rtol=1e-11, atol=0)


def test_a_mode_far_above_the_sampling_frequency():
    """At omega h = 1e4 the error is that of the phase, eps omega h, not its square."""
    dt, w = 1e-3, 1e7
    got = blocks(np.array([w**2]), np.zeros(1), dt, "foh")
    A, G1, G2 = (x.astype(float) for x in reference(w**2, 0.0, dt))
    assert np.allclose(got.A[0], A, rtol=1e-10)
    assert np.allclose(got.G1[0], G1, rtol=1e-10)
    assert np.allclose(got.G2[0], G2, rtol=1e-10)


def test_a_rigid_mode_is_a_double_integrator():
    h = 0.02
    for hold, G2 in (("foh", [h**2 / 6, h / 2]), ("zoh", [0, 0])):
        got = blocks(np.zeros(1), np.zeros(1), h, hold)
        assert np.allclose(got.A[0], [[1, h], [0, 1]], rtol=1e-14)
        assert np.allclose(got.G1[0], [h**2 / 2, h], rtol=1e-14)
        assert np.allclose(got.G2[0], G2, rtol=1e-14)


def reduced(lam, damping, derivative, corner, residual=None, seed=0):
    rng, m, k = np.random.default_rng(seed), len(derivative), len(lam)
    S, B = rng.standard_normal((m, k)), rng.standard_normal((k, 2))
    return ReducedModel(np.array(lam), np.array(damping), S, B, residual, np.array(derivative), np.array(corner))


def continuous(model):
    """The same model as one continuous state space, filters as states of their own."""
    k, m = len(model.lam), len(model.S)
    C2 = np.diag(model.damping) if model.proportional else model.damping
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-np.diag(model.lam), -C2]])
    B = np.vstack([np.zeros((k, 2)), model.B])
    rows = [[np.eye(k), 0 * C2], [0 * C2, np.eye(k)], [-np.diag(model.lam), -C2]]
    C = np.array([model.S[i] @ np.hstack(rows[d]) for i, d in enumerate(model.derivative)])
    R = np.zeros((m, 2)) if model.residual is None else model.residual
    D = np.array([model.S[i] @ model.B if d == 2 else R[i] * (d == 0) for i, d in enumerate(model.derivative)])
    a = 2 * np.pi * model.corner
    A = np.block([[A, np.zeros((2 * k, m))], [a[:, None] * C, -np.diag(a)]])
    return A, np.vstack([B, a[:, None] * D]), np.hstack([C, -np.diag((a > 0) * 1.0)]), D


LAM = [0.0, 30.0**2, 31.0**2, 200.0**2, 900.0**2]
COUPLED = np.diag([0.5, 1.0, 2.0, 3.0, 20.0]) + 0.4


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("damping", [[0.0, 0.6, 2.0, 30.0, 2500.0], COUPLED])
@pytest.mark.parametrize("corner", [[0.0] * 4, [3.0, 0.0, 2.0, 0.7]])
def test_equal_to_the_discretisation_of_the_whole_system(hold, damping, corner):
    model = reduced(LAM, damping, [0, 1, 2, 0], corner, residual=np.arange(8.0).reshape(4, 2) * 1e-3)
    dt = 2e-3
    A, B, C, D = discretise(model, dt, hold)
    other = signal.cont2discrete(continuous(model), dt, hold)
    h = signal.dimpulse((A, B, C, D, dt), n=60)[1]
    g = signal.dimpulse((*other[:4], dt), n=60)[1]
    for mine, theirs in zip(h, g, strict=True):
        assert np.all(np.abs(mine - theirs).max(axis=0) < 1e-10 * np.abs(theirs).max(axis=0) + 1e-15)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("samples", [1, 2, 3, 64, 1000])
def test_markov_parameters_by_powers_of_blocks(hold, samples):
    residual = np.arange(8.0).reshape(4, 2) * 1e-3
    model = reduced(LAM, [0.0, 0.6, 2.0, 30.0, 2500.0], [0, 1, 2, 2], [3.0, 0.0, 2.0, 0.0], residual)
    A, B, C, D = discretise(model, 1e-3, hold)
    h, x, expected = markov(model, 1e-3, hold, samples), B, [D]
    for _ in range(samples - 1):
        expected.append(C @ x)
        x = A @ x
    expected = np.array(expected)
    assert np.all(np.abs(h - expected).max(axis=0) <= 1e-12 * np.abs(expected).max(axis=0))


def test_the_sequence_holds_for_a_hundred_thousand_samples():
    """An undamped mode: after 1e5 samples the phase is still right, and nothing has grown."""
    w, dt, n = 300.0, 2.0**-10, 100_000  # a step by which the phase below is exact
    system = blocks(np.array([w**2]), np.zeros(1), dt, "zoh", derivative=1)
    t = np.arange(1, n) * dt
    # velocity after a unit force that lasted one step: (sin wt - sin w(t - dt)) / w
    exact = 2 * np.cos(w * (t - dt / 2)) * np.sin(w * dt / 2) / w
    assert np.abs(sequence(system, n)[0, 1:] - exact).max() < 1e-10 * np.abs(exact).max()


def test_a_moving_load_has_inputs_for_every_sample():
    still = reduced([30.0**2, 50.0**2], [0.6, 2.0], [0, 2], [0.0, 1.0])
    b = np.stack([still.B, 2 * still.B, -still.B])
    moving = ReducedModel(still.lam, still.damping, still.S, b, None, still.derivative, still.corner)
    A, B, C, D = discretise(moving, 1e-3, "foh")
    A0, B0, C0, D0 = discretise(still, 1e-3, "foh")
    assert np.array_equal(A, A0)
    assert np.array_equal(C, C0)
    for k, factor in enumerate((1, 2, -1)):
        assert np.allclose(B[k], factor * B0, rtol=1e-13)
        assert np.allclose(D[k], factor * D0, rtol=1e-13)


def test_filter_of_a_feedthrough():
    a, dt = 2 * np.pi * 3.0, 0.01
    decay, g1, g2 = filter_step(3.0, dt, "foh")
    e = np.exp(-a * dt)
    assert (decay, g1, g2) == pytest.approx((e, 1 - e, 1 - (1 - e) / (a * dt)))
    assert filter_step(3.0, dt, "zoh")[2] == 0


@pytest.mark.parametrize("dt", [0.0, -1.0, np.nan, np.inf, [1e-3]])
def test_a_bad_step_is_refused(dt):
    with pytest.raises(InputError, match="step"):
        discretise(reduced([1.0], [0.1], [0], [0.0]), dt, "foh")


@pytest.mark.parametrize("hold", ["tustin", "", None, "FOH"])
def test_an_unknown_hold_is_refused(hold):
    with pytest.raises(InputError, match=r"'foh'.*'zoh'"):
        discretise(reduced([1.0], [0.1], [0], [0.0]), 1e-3, hold)
