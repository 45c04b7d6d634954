import numpy as np
import pytest

from structures import ForwardModel, InputError, NotIdentifiable, Structure, beams, chains, loads, sensors
from structures._elements.members import steel
from structures._system.damping import Modal

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


def worst(got, exact):
    """Largest error of any sensor, over the largest value that this sensor has."""
    axes = (*range(got.ndim - 2), -1)
    return float(np.max(np.abs(got - exact).max(axis=axes) / np.abs(exact).max(axis=axes)))


# -- moving loads, perturbation, certificate, identity
def test_a_moving_load_against_one_that_stands_still():
    beam = beams.simply_supported(elements=12, damping=Modal(0.02), **SETTINGS)
    rows, n, dt = [sensors.Displacement("5+Z"), sensors.StrainGauge(at=0.5, fibre=0.01)], 40, 1e-3
    u = np.random.default_rng(0).standard_normal((n, 1))
    stands = ForwardModel(beam, rows, [loads.MovingPoint(np.full(n, 0.35))], modes=8)
    still = ForwardModel(beam, rows, [loads.Point(at=0.35)], modes=8)
    system = stands.state_space(dt)
    assert system.B.shape == (n, 16, 1)
    assert system.D.shape == (n, 2, 1)
    assert np.allclose(
        stands.predict(u, dt), still.predict(u, dt), rtol=1e-9, atol=1e-12 * np.abs(still.predict(u, dt)).max()
    )


def test_a_crossing_load_in_closed_form():
    """Constant force at constant speed on a simply supported beam, first mode (Fryba), undamped."""
    beam = beams.simply_supported(elements=30, **SETTINGS)
    n, speed, F = 2001, 6.0, 10.0
    t = np.linspace(0, L / speed, n)
    model = ForwardModel(beam, [sensors.Displacement("15+Z")], [loads.MovingPoint(speed * t)], modes=1, residual=False)
    w1, W = (np.pi / L) ** 2 * np.sqrt(EI / MASS), np.pi * speed / L
    exact = 2 * F / (MASS * L) / (w1**2 - W**2) * (np.sin(W * t) - W / w1 * np.sin(w1 * t))
    assert np.abs(model.predict(np.full(n, F), t[1])[:, 0] - exact).max() < 1e-4 * np.abs(exact).max()


def test_what_a_moving_load_does_not_have_is_refused_by_name():
    beam = beams.simply_supported(elements=6, **SETTINGS)
    model = ForwardModel(beam, [sensors.Displacement("3+Z")], [loads.MovingPoint([0.1, 0.2, 0.3], label="truck")])
    for name, ask in (
        ("static", model.static),
        ("frf", lambda: model.frf([1.0])),
        ("impulse_response", lambda: model.impulse_response(1e-3, 3)),
    ):
        with pytest.raises(InputError, match=rf"no {name}\(\).*truck"):
            ask()
    with pytest.raises(InputError, match="one length"):
        ForwardModel(
            beam,
            [sensors.Displacement("3+Z")],
            [loads.MovingPoint([0.1, 0.2], label=x) for x in "ab"] + [loads.MovingPoint([0.3])],
        )


def test_perturbed_models():
    model = beam_model()
    f = model.natural_frequencies
    assert np.allclose(model.perturbed("stiffness", 4.0).natural_frequencies, 2 * f)
    assert np.allclose(model.perturbed("mass", 4.0).natural_frequencies, f / 2)
    assert model.perturbed("damping", 1.5).decay_rate == pytest.approx(1.5 * model.decay_rate)
    assert model.perturbed("stiffness", 1.25).static()[0] == pytest.approx(model.static()[0] / 1.25)
    assert model.perturbed("mass", 1.1).settings == model.settings
    with pytest.raises(InputError, match="no such parameter"):
        model.perturbed("colour", 1.1)


def test_certificate_tells_a_gain_from_a_shape():
    truth = beam_model(modes=8)
    load = np.random.default_rng(0).standard_normal((400, 4)) @ np.diag([1.0, 0, 0, 0])
    y = truth.predict(load, 1e-3)
    right = truth.verify(load, y, 1e-3)
    assert right.gain == pytest.approx([1.0] * 7)
    assert right.error == pytest.approx([0.0] * 7, abs=1e-12)
    assert right.noise_ratio is None
    rig = ForwardModel(truth.structure, truth.sensors, truth.loads, modes=8)
    gain = rig.verify(load, 1.1 * y, 1e-3, source="hanging mass")
    assert gain.gain == pytest.approx([1.1] * 7)
    assert gain.shape == pytest.approx([1.0] * 7)
    assert str(gain).startswith("forward model verified against hanging mass")
    soft = truth.perturbed("stiffness", 0.8)
    assert soft.certificate is None
    assert max(soft.verify(load, y, 1e-3).shape) < 0.95


def test_static_certificate_counts_the_noise():
    beam = beams.cantilever(elements=5, **SETTINGS)
    model = ForwardModel(
        beam, [sensors.Displacement("5+Z", noise=1e-4), sensors.Displacement("3+Z", noise=2e-4)], [loads.Point("5+Z")]
    )
    y = model.static()[:, 0] * 20.0
    certificate = model.verify(20.0, y + np.array([3e-4, -2e-4]), source="2.04 kg")
    assert certificate.noise_ratio == pytest.approx([3.0, 1.0])
    for load, response, words in (
        ([20.0, 1.0], y, "one number per load"),
        (20.0, y[:1], "does not fit the model"),
        (20.0, [np.nan, 0.0], "NaN"),
        (0.0, y, "nothing can be compared"),
    ):
        with pytest.raises(InputError, match=words):
            model.verify(load, response)


def test_a_bad_history_is_refused():
    model = beam_model()
    for load in (np.ones((10, 3)), np.ones(10), np.ones((0, 4)), np.full((10, 4), np.nan)):
        with pytest.raises(InputError):
            model.predict(load, 1e-3)


def test_fingerprint():
    beam = beams.cantilever(elements=6, **SETTINGS)

    def build(structure=beam, row="3+Z", **settings):
        return ForwardModel(structure, [sensors.Displacement(row)], [loads.Point("6+Z")], **settings)

    same = beams.cantilever(elements=6, **SETTINGS)
    assert build().fingerprint == build(same).fingerprint
    others = [
        build(row="4+Z"),
        build(modes=3),
        build(beam.scaled("stiffness", 1.0001)),
        build(beam.with_damping(Modal(0.01))),
    ]
    assert len({build().fingerprint, *(m.fingerprint for m in others)}) == 5


def test_moving_the_mesh_changes_nothing():
    here, there = (beams.cantilever(elements=9, origin=x, damping=Modal(0.01), **SETTINGS) for x in (0.0, 100.0))
    model = [
        ForwardModel(b, [sensors.StrainGauge(at=x + 0.41, fibre=0.01)], [loads.Point(at=x + 0.9)])
        for b, x in ((here, 0.0), (there, 100.0))
    ]
    assert np.allclose(model[0].frf(LINES), model[1].frf(LINES), rtol=1e-9)
    assert np.allclose(model[0].static(), model[1].static(), rtol=1e-9)


# -- bad input
@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"sensors": []}, "no sensors"),
        ({"loads": []}, "no loads"),
        ({"sensors": ["3+Z"]}, "objects of structures.sensors"),
        ({"sensors": [loads.Point("3+Z")]}, "objects of structures.sensors"),
        ({"loads": [sensors.Displacement("3+Z")]}, "objects of structures.loads"),
        ({"sensors": [sensors.Displacement("3+Z"), sensors.Displacement("3+Z")]}, "different labels"),
        ({"sensors": [sensors.Displacement("33+Z")]}, "no such DOF"),
        ({"loads": [loads.Point("0+Z")]}, "LID-E104"),
        ({"modes": 0}, "number of modes"),
        ({"modes": 13}, "number of modes"),
        ({"modes": 2.5}, "number of modes"),
        ({"band": -1.0}, "band"),
    ],
)
def test_a_bad_model_is_refused(change, words):
    settings = {"sensors": [sensors.Displacement("3+Z")], "loads": [loads.Point("5+Z")], **change}
    beam = beams.cantilever(elements=6, **SETTINGS)
    with pytest.raises(InputError, match=words):
        ForwardModel(beam, settings.pop("sensors"), settings.pop("loads"), **settings)


def test_bad_questions_are_refused():
    model = beam_model()
    for ask, words in (
        (lambda: model.frf([-1.0]), "frequencies"),
        (lambda: model.frf([np.nan]), "NaN"),
        (lambda: model.frf([[1.0]]), "one axis"),
        (lambda: model.frf([1.0], method="fft"), "'modal' or 'direct'"),
        (lambda: model.impulse_response(0.0, 10), "step"),
        (lambda: model.impulse_response(1e-3, 10.5), "samples"),
        (lambda: model.impulse_response(1e-3, 10, "tustin"), "hold"),
        (lambda: model.state_space(-1e-3), "step"),
    ):
        with pytest.raises(InputError, match=words):
            ask()


def test_statics_without_mass():
    beam = beams.cantilever(elements=4, **SETTINGS)
    model = ForwardModel(Structure.from_matrices(beam.K_free), [sensors.Displacement("6+S")], [loads.Point("6+S")])
    assert model.static()[0, 0] == pytest.approx(L**3 / 3 / EI)
    assert model.natural_frequencies is None
    assert model.decay_rate is None
    for ask in (lambda: model.frf([1.0]), lambda: model.frf([1.0], "direct"), lambda: model.state_space(1e-3)):
        with pytest.raises(InputError, match="no mass matrix"):
            ask()


@pytest.mark.parametrize("method", ["modal", "direct"])
def test_an_undamped_resonance_is_unbounded(method):
    f = 4.0
    structure = chains.oscillator(mass=1.0, stiffness=(2 * np.pi * f) ** 2)
    model = ForwardModel(structure, [sensors.Displacement("1+X")], [loads.Point("1+X")])
    H = np.abs(model.frf([0.999 * f, 1.001 * f], method))
    assert np.all(H / model.static()[0, 0] > 100)
    with pytest.raises(NotIdentifiable, match="at 4 Hz is unbounded"):
        model.frf([1.0, f], method)
