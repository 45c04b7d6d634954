import numpy as np
import pytest
from scipy import signal

from structures import ForwardModel, NotIdentifiable, Structure, beams, chains, loads, plates, sensors
from structures._elements.members import steel
from structures._system.damping import Modal, Rayleigh

L, EI, MASS = 1.2, 800.0, 3.0
SETTINGS = {"length": L, "EI": EI, "mass_per_length": MASS}
PLATE = {"lengths": (0.5, 0.4), "thickness": 3e-3, "material": steel}
LINES = np.linspace(2.0, 800.0, 12)


def every_sensor():
    """Each kind, at a DOF and inside an element, DC and AC coupled."""
    return [
        sensors.Displacement("3+Z"),
        sensors.Velocity("5-Z"),
        sensors.Accelerometer(at=0.41, label="a"),
        sensors.StrainGauge(at=0.37, fibre=0.01, length=0.02),
        sensors.Displacement("7+RY", highpass=2.0),
        sensors.Accelerometer("8+Z", highpass=0.7),
        sensors.StrainGauge(at=0.8, fibre=-0.01, highpass=11.0),
    ]


def some_loads():
    return [loads.Point("6+Z"), loads.Point(at=0.77), loads.Moment("4+RY"), loads.Patch(x=(0.2, 0.5))]


def beam_model(make=beams.cantilever, damping=None, elements=12, **settings):
    beam = make(elements=elements, damping=damping or Modal(0.01), **SETTINGS)
    return ForwardModel(beam, every_sensor(), some_loads(), **settings)


def rounding(structure):
    """What a stable solve leaves: rounding times the condition number of the dynamic stiffness with a unit diagonal."""
    K, M, C = (A.toarray() for A in (structure.K_free, structure.M_free, structure.C_free))
    unit = 1 / np.sqrt(np.diag(K))
    stiffness = (K - w**2 * M + 1j * w * C for w in 2 * np.pi * LINES)
    return np.finfo(float).eps * max(np.linalg.cond(unit[:, None] * Z * unit) for Z in stiffness)


def worst(got, exact):
    """Largest error of any sensor, over the largest value that this sensor has."""
    axes = (*range(got.ndim - 2), -1)
    return float(np.max(np.abs(got - exact).max(axis=axes) / np.abs(exact).max(axis=axes)))


# -- the figures of the forward model
@pytest.mark.parametrize("method", ["modal", "direct"])
@pytest.mark.parametrize(
    ("structure", "places"),
    [
        (beams.cantilever(elements=20, damping=Rayleigh(2.0, 1e-5), **SETTINGS), ["4+Z", "13-Z", "20+Z"]),
        (beams.free(elements=20, damping=Modal(0.01), **SETTINGS), ["1+Z", "13-Z", "9+Z"]),
        (plates.plate(elements=(6, 5), edges="CFSF", damping=Modal(0.01), **PLATE), ["9+Z", "17+Z", "25-Z"]),
        (chains.chain(masses=[1.0, 2.0, 3.0], springs=1e5, dashpots=[9.0, 0, 2]), ["1+X", "2-X", "3+X"]),
    ],
)
def test_reciprocity(structure, places, method):
    """Swapping load and response changes nothing: H = H^T."""
    model = ForwardModel(structure, [sensors.Displacement(p) for p in places], [loads.Point(p) for p in places])
    # Near 0 Hz the dynamic stiffness of a free structure is singular to rounding, so there the modes only.
    H = model.frf(LINES if structure.supports or method == "modal" else LINES + 50.0, method=method)
    assert np.all(np.abs(H - H.transpose(0, 2, 1)).max(axis=(1, 2)) < 1e-12 * np.abs(H).max(axis=(1, 2)))


@pytest.mark.parametrize("damping", [Modal(0.01), Modal((0.03, 0.002)), Rayleigh(2.0, 2e-6)])
@pytest.mark.parametrize("make", [beams.cantilever, beams.simply_supported, beams.clamped, beams.free])
def test_all_modes_give_the_direct_response(make, damping):
    model = beam_model(make, damping)
    assert worst(model.frf(LINES), model.frf(LINES, method="direct")) < 1e-9


@pytest.mark.parametrize("make", [beams.cantilever, beams.free])
def test_all_modes_of_a_finer_mesh_and_of_a_plate(make):
    fine = beam_model(make, Rayleigh(2.0, 2e-6), elements=40)
    assert worst(fine.frf(LINES), fine.frf(LINES, method="direct")) < 4 * rounding(fine.structure) < 2e-7
    plate = plates.plate(elements=(6, 6), edges="CFFF", damping=Rayleigh(2.0, 2e-6), **PLATE)
    model = ForwardModel(plate, [sensors.Accelerometer(at=(0.31, 0.22))], [loads.Point(at=(0.4, 0.1))])
    assert worst(model.frf(LINES), model.frf(LINES, method="direct")) < 1e-9


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("make", [beams.cantilever, beams.free])
@pytest.mark.parametrize("settings", [{}, {"modes": 9}])
def test_impulse_response_is_the_markov_parameters(make, hold, settings):
    model = beam_model(make, **settings)
    h, system = model.impulse_response(1e-4, 1500, hold), model.state_space(1e-4, hold)
    assert worst(h, system.impulse_response(1e-4, 1500)) < 1e-12
    x, slow = system.B, [system.D]
    for _ in range(200):
        slow.append(system.C @ x)
        x = system.A @ x
    assert worst(h[:201], np.array(slow)) < 1e-12


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("settings", [{}, {"modes": 9}])
@pytest.mark.parametrize("dt", [1e-2, 1e-4, 1e-6])
def test_discrete_static_gain_is_the_static_matrix(hold, settings, dt):
    model = beam_model(elements=40, **settings)
    gain, static = model.state_space(dt, hold).static(), model.static()
    rows = [0, 3]
    assert worst(gain[rows], static[rows]) < 1e-9
    assert np.abs(gain[4:]).max() < 1e-6 * np.abs(model.frf(LINES)[:, 4:]).max()
    assert not np.any(static[[1, 2, 4, 5, 6]])


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_transform_of_the_decayed_impulse_response(hold):
    model = beam_model(damping=Modal(0.2), elements=8)
    dt, n = 5e-4, 2**14
    h = model.impulse_response(dt, n, hold)
    lines = np.fft.rfftfreq(n, dt)[::37]
    assert np.all(np.abs(h[-1]).max(axis=1) < 1e-12 * np.abs(h).max(axis=(0, 2)))
    assert worst(np.fft.rfft(h, axis=0)[::37], model.state_space(dt, hold).frf(lines)) < 1e-9


def test_sampled_response_tends_to_the_frequency_response():
    """What a first-order hold adds is sinc^2 and aliases, both small far below Nyquist."""
    model = beam_model(damping=Modal(0.02), modes=6)
    lines, dt = np.array([1.0, 7.0, 30.0, 60.0]), 1e-5
    sampled = model.state_space(dt).frf(lines)
    rows = [0, 3, 4, 6]  # where the static residual is a feedthrough
    assert worst(sampled[:, rows], model.frf(lines)[:, rows]) < 1e-4


def test_order_of_convergence_of_the_holds():
    """First-order hold: second order. Zero-order hold: half a sample late, second order once that is allowed for."""
    beam = beams.simply_supported(elements=10, damping=Modal(0.01), **SETTINGS)
    model = ForwardModel(beam, [sensors.Displacement("3+Z")], [loads.Point("6+Z")], modes=3)
    pulse = lambda t: np.where((t > 0) & (t < 0.05), np.sin(np.pi * t / 0.05) ** 4, 0.0)  # noqa: E731

    def error(dt, hold, shift=0.0):
        t = np.arange(0, 0.1, dt)
        y = model.predict(pulse(t + shift * dt), dt, hold)[:: round(1e-3 / dt), 0]
        return np.abs(y - exact).max() / np.abs(exact).max()

    exact = model.predict(pulse(np.arange(0, 0.1, 1e-5)), 1e-5)[::100, 0]
    foh = [error(dt, "foh") for dt in (1e-3, 5e-4, 2.5e-4)]
    zoh = [error(dt, "zoh") for dt in (1e-3, 5e-4, 2.5e-4)]
    late = [error(dt, "zoh", 0.5) for dt in (1e-3, 5e-4, 2.5e-4)]
    for errors, order in ((foh, 2), (zoh, 1), (late, 2)):
        assert np.allclose(np.log2(np.array(errors[:-1]) / errors[1:]), order, atol=0.15)
    assert max(foh[0], late[0]) < 0.1 * zoh[0]


# -- closed forms
def test_tip_receptance_and_antiresonances_of_a_cantilever():
    beam = beams.cantilever(elements=40, **SETTINGS)
    model = ForwardModel(beam, [sensors.Displacement("40+Z")], [loads.Point("40+Z")])
    omega = lambda b: (b / L) ** 2 * np.sqrt(EI / MASS)  # noqa: E731
    b = np.array([0.4, 1.5, 2.7, 4.2, 5.5])
    exact = L**3 / EI * (np.cosh(b) * np.sin(b) - np.sinh(b) * np.cos(b)) / (b**3 * (1 + np.cos(b) * np.cosh(b)))
    assert np.allclose(model.frf(omega(b) / 2 / np.pi)[:, 0, 0].real, exact, rtol=1e-5)
    for root in (3.92660231, 7.06858275, 10.21017612):  # clamped-pinned: the driven point is a node there
        H = model.frf(omega(root * np.array([1 - 2e-5, 1 + 2e-5])) / 2 / np.pi)[:, 0, 0].real
        assert H[0] * H[1] < 0


def test_static_response_in_closed_form():
    beam = beams.cantilever(elements=7, **SETTINGS)
    tip, root = sensors.Displacement("7+Z"), sensors.StrainGauge(at=1e-9, fibre=0.01)
    static = ForwardModel(beam, [tip, root], [loads.Point("7+Z"), loads.Patch(x=(0.0, L))]).static()
    assert static[0] == pytest.approx([L**3 / 3 / EI, L**4 / 8 / EI])
    assert static[1, 0] == pytest.approx(-0.01 * L / EI)


def test_one_oscillator_in_closed_form():
    m, k, c, dt = 2.0, 800.0, 3.0, 0.01
    structure = chains.oscillator(mass=m, stiffness=k, dashpot=c)
    model = ForwardModel(
        structure, [sensors.Displacement("1+X"), sensors.Accelerometer("1+X", label="a")], [loads.Point("1+X")]
    )
    w = 2 * np.pi * LINES
    receptance = 1 / (k - m * w**2 + 1j * w * c)
    assert np.allclose(model.frf(LINES)[:, :, 0], np.array([receptance, -(w**2) * receptance]).T)
    decay, wd = c / 2 / m, np.sqrt(k / m - (c / 2 / m) ** 2)
    assert model.decay_rate == pytest.approx(decay)
    step = lambda t: (1 - np.exp(-decay * t) * (np.cos(wd * t) + decay / wd * np.sin(wd * t))) / k  # noqa: E731
    t = dt * np.arange(1, 50)
    h = model.impulse_response(dt, 50, "zoh")
    assert h[0, 0, 0] == 0
    assert h[0, 1, 0] == pytest.approx(1 / m)
    assert np.allclose(h[1:, 0, 0], step(t) - step(t - dt), rtol=1e-9, atol=1e-15)


def test_ac_coupling_is_an_exact_first_order_high_pass():
    beam, fc = beams.cantilever(elements=8, damping=Modal(0.02), **SETTINGS), 3.0
    args = [loads.Point("8+Z")]
    dc, ac = (ForwardModel(beam, [sensors.Displacement("5+Z", highpass=x)], args) for x in (None, fc))
    f = np.array([0.0, 0.3, 3.0, 50.0])
    for method in ("modal", "direct"):
        assert np.allclose(ac.frf(f, method)[:, 0, 0], dc.frf(f, method)[:, 0, 0] * 1j * f / (fc + 1j * f), rtol=1e-9)
    # In time: a bilinear filter at a fine step does nearly the same to the DC response.
    u, dt = np.random.default_rng(0).standard_normal(2000), 1e-4
    a = np.pi * fc * dt
    filtered = signal.lfilter([1 / (1 + a), -1 / (1 + a)], [1, -(1 - a) / (1 + a)], dc.predict(u, dt)[:, 0])
    assert np.allclose(ac.predict(u, dt)[:, 0], filtered, atol=1e-4 * np.abs(filtered).max())
    assert ac.static() == 0
    assert ac.decay_rate == pytest.approx(min(dc.decay_rate, 2 * np.pi * fc))


# -- modes, residual, cost
def test_few_modes_with_the_residual_against_direct():
    plate = plates.plate(elements=(16, 12), edges="CFFF", damping=Rayleigh(2.0, 2e-6), **PLATE)
    rng, lines = np.random.default_rng(1), np.array([30.0, 200.0, 450.0])
    rows = [sensors.Accelerometer(at=tuple(x), label=str(i)) for i, x in enumerate(rng.uniform(0.05, 0.35, (6, 2)))]
    columns = [loads.Point(at=tuple(x), label=str(i)) for i, x in enumerate(rng.uniform(0.05, 0.35, (2, 2)))]
    model = ForwardModel(plate, rows, columns, band=500.0)
    bare = ForwardModel(plate, rows, columns, band=500.0, residual=False)
    direct = model.frf(lines, method="direct")
    error, worse = (
        np.linalg.norm(m.frf(lines) - direct, axis=(1, 2)) / np.linalg.norm(direct, axis=(1, 2)) for m in (model, bare)
    )
    assert np.all(error < [1e-5, 1e-3, 2e-2])
    assert np.all(error < 0.5 * worse)
    assert model.natural_frequencies[-1] >= 1250 > model.natural_frequencies[-2]
    assert f"{len(model.natural_frequencies)} of {plate.free.size} modes + static residual" in repr(model)


@pytest.mark.parametrize(("rows", "columns"), [(5, 2), (2, 5), (3, 3)])
def test_static_costs_the_fewer_solves(rows, columns):
    beam = beams.cantilever(elements=30, **SETTINGS)
    model = ForwardModel(
        beam,
        [sensors.Displacement(f"{i + 4}+Z") for i in range(rows)],
        [loads.Point(f"{i + 9}+Z") for i in range(columns)],
    )
    model.static()
    model.static()
    assert model.factor.solves == min(rows, columns)


def test_default_number_of_modes():
    args = [sensors.Displacement("9+Z")], [loads.Point("20+Z")]
    assert "all 40 modes" in repr(ForwardModel(beams.cantilever(elements=20, **SETTINGS), *args))
    large = ForwardModel(beams.cantilever(elements=250, **SETTINGS), *args)
    assert repr(large) == "ForwardModel(500 free DOFs, 1 sensors, 1 loads, 60 of 500 modes + static residual)"
    assert len(large.natural_frequencies) == 60


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_damping_that_couples_the_modes(hold):
    chain = chains.chain(masses=[1.0, 2.0, 1.0], springs=[900.0, 400.0, 500.0], dashpots=[5.0, 2.0, 0.1])
    rows = [sensors.Displacement("1+X"), sensors.Velocity("2+X"), sensors.Accelerometer("3+X", highpass=0.2)]
    model = ForwardModel(chain, rows, [loads.Point("2+X"), loads.Point("3+X")])
    f, dt = np.linspace(0.1, 10, 30), 0.01
    assert not model.reduced.proportional
    assert worst(model.frf(f), model.frf(f, method="direct")) < 1e-11
    n = 2**14
    h, system = model.impulse_response(dt, n, hold), model.state_space(dt, hold)
    assert worst(np.fft.rfft(h, axis=0)[::200], system.frf(np.fft.rfftfreq(n, dt)[::200])) < 1e-9
    assert worst(system.static()[:1], model.static()[:1]) < 1e-9
    assert model.decay_rate == pytest.approx(system.decay_rate, rel=1e-6)


def test_the_residual_of_few_coupled_modes():
    base = beams.cantilever(elements=12, **SETTINGS)
    C = 1e-4 * base.K_free.toarray()
    C[11, 11] += 3.0
    structure = Structure.from_matrices(base.K_free, base.M_free, C)
    args = [sensors.Displacement("2+S"), sensors.Accelerometer("20+S")], [loads.Point("10+S")]
    model, bare = ForwardModel(structure, *args, modes=3), ForwardModel(structure, *args, modes=3, residual=False)
    f = np.array([0.1, 0.5])
    direct = model.frf(f, method="direct")
    assert not model.reduced.proportional
    assert worst(model.frf(f), direct) < 0.1 * worst(bare.frf(f), direct)


# -- free structures
def test_a_free_structure_has_dynamics_but_no_statics():
    beam = beams.free(elements=10, damping=Modal(0.01), **SETTINGS)
    tip = sensors.Accelerometer("10+Z")
    model = ForwardModel(beam, [tip, sensors.StrainGauge(at=0.5, fibre=0.01)], [loads.Point("10+Z")])
    with pytest.raises(NotIdentifiable, match=r"translation Z.*rotation RY"):
        model.static()
    assert np.all(model.natural_frequencies[:2] == 0)
    # A slow force moves it as a rigid body: F/m at the centre plus the rotation, together 4 F / m at the tip.
    assert model.frf([1e-3, 0.0])[:, 0, 0].real == pytest.approx([4 / (MASS * L)] * 2, rel=1e-4)
    with pytest.raises(NotIdentifiable, match="at 0 Hz is unbounded"):
        ForwardModel(beam, [sensors.Displacement("10+Z")], [loads.Point("10+Z")]).frf([5.0, 0.0])
    with pytest.raises(NotIdentifiable, match="never settles"):
        model.state_space(1e-3).static()


def test_decay_rate_of_a_free_structure_is_what_its_sensors_see():
    beam = beams.free(elements=10, damping=Modal(0.01), **SETTINGS)
    load = [loads.Point("10+Z")]
    elastic = 0.01 * 4.73004074**2 / L**2 * np.sqrt(EI / MASS)
    rate = lambda row: ForwardModel(beam, [row], load).decay_rate  # noqa: E731
    assert rate(sensors.Accelerometer("10+Z")) == pytest.approx(elastic, rel=1e-4)
    assert rate(sensors.StrainGauge(at=0.5, fibre=0.01)) == pytest.approx(elastic, rel=1e-4)
    assert rate(sensors.Velocity("10+Z")) == rate(sensors.Displacement("10+Z")) == 0


def test_rigid_motion_in_discrete_time():
    body = Structure.from_matrices(np.zeros((1, 1)), np.array([[2.0]]))
    model = ForwardModel(body, [sensors.Displacement("0+S"), sensors.Velocity("0+S", label="v")], [loads.Point("0+S")])
    y = model.predict(np.ones(100), 0.1)
    t = 0.1 * np.arange(100)
    # Linear between samples, and zero one sample before the first: the ramp up adds half a step.
    assert np.allclose(y[:, 1], (t + 0.05) / 2.0)
    assert np.allclose(y[:, 0], (t**2 / 2 + 0.05 * t + 0.01 / 6) / 2.0)
