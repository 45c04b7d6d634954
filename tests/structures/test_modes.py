"""Modes from a test against structures whose modes are known, and the model made of them against those structures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from structures import (
    Channel,
    ForwardModel,
    FrfModel,
    MeasuredModel,
    MeasuredModes,
    ModalModel,
    beams,
    damping,
    identify_modes,
    loads,
    sensors,
)
from structures._testing.modalfit import FrfBand, Poles, fitted
from structures._testing.modalorder import reweighted, selected
from structures._testing.polyreference import stabilisation
from structures.errors import InputError
from structures.files._modelfile import load_model

from ..data import measured

LINES = np.arange(10.0, 201.0, 0.25)
F = np.array([31.0, 52.0, 52.52, 88.0, 121.0, 160.0, 190.0, 230.0, 420.0])  # the last two lie above the band
Z = np.array([0.01, 0.005, 0.004, 0.002, 0.02, 0.05, 0.01, 0.01, 0.01])
INSIDE = 7
RNG = np.random.default_rng(11)
SHAPES = RNG.standard_normal((5, len(F)))
DT = 1 / 2000


def frf(lines: np.ndarray = LINES, *, loads: int = 2, order: int = 2) -> np.ndarray:
    """FRFs of the modes above, written out."""
    s = 2j * np.pi * lines[:, None]
    w = 2 * np.pi * F
    return np.einsum("lk,mk,pk->lmp", s**order / (s**2 + 2 * Z * w * s + w**2), SHAPES, SHAPES[:loads])


def table(noise: float = 0.01, seed: int = 0, *, count: int = 2, told: bool = True) -> FrfModel:
    """The FRFs with white noise of a share of their rms; places are DOFs, so that the first ones are driven points."""
    H = frf(loads=count)
    std = noise * np.sqrt(np.mean(np.abs(H) ** 2))
    rng = np.random.default_rng(seed)
    H = H + std * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
    return FrfModel.from_frf(
        LINES, H, kind="accelerance", sensors=[f"{i + 1}+Z" for i in range(5)],
        loads=[f"{j + 1}+Z" for j in range(count)], variance=np.full(H.shape, std**2) if told else None,
    )  # fmt: skip


@pytest.fixture(scope="module")
def found() -> MeasuredModes:
    return identify_modes(table())


# -- poles ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("count", [1, 2])
def test_poles_without_noise_are_those_of_the_structure(count):
    """Some eight modes above the band, too: only the maximum likelihood knows of them."""
    H = frf(loads=count)
    poles, v = stabilisation(H, np.ones(H.shape[:2]), LINES, 40).chosen
    near = [np.argmin(np.abs(np.abs(poles) / (2 * np.pi) - f)) for f in F[:INSIDE]]
    np.testing.assert_allclose(np.abs(poles[near]) / (2 * np.pi), F[:INSIDE], rtol=1e-6)
    np.testing.assert_allclose(-poles[near].real / np.abs(poles[near]), Z[:INSIDE], rtol=1e-4)
    given = SHAPES[:count, :INSIDE].T
    given = given / np.linalg.norm(given, axis=1)[:, None]
    np.testing.assert_allclose(np.abs(np.sum(given * v[near].conj(), axis=1)), 1, rtol=1e-6)


def test_poles_of_noise_grow_and_are_left_out():
    s = stabilisation(table(0.05).H, np.ones((len(LINES), 5)), LINES, 30)
    assert s.unstable > 400
    assert np.all(s.poles.real < 0)
    assert len(s.chosen[0]) < 15


def test_all_modes_with_noise(found):
    assert len(found) == INSIDE
    np.testing.assert_allclose(found.frequencies, F[:INSIDE], rtol=1e-3)
    np.testing.assert_allclose(found.damping, Z[:INSIDE], rtol=0.05)
    assert 0.9 < found.misfit < 1.1
    assert np.all(found.mpc > 0.98)
    assert np.all(np.diag(found.mac) > 1 - 1e-12)
    assert "LID-W217" not in {f.code for f in found.flags}


def test_std_of_poles_cover_the_truth():
    """40 noises: the share of 95 % bands that hold the truth, and the size of the errors in their std."""
    H = frf()
    std = 0.02 * np.sqrt(np.mean(np.abs(H) ** 2))
    w = 2 * np.pi * F
    start = -Z * w + 1j * w * np.sqrt(1 - Z**2)
    inside, errors = [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noisy = H + std * (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
        band = FrfBand(LINES[::2], noisy[::2], np.full((len(LINES[::2]), 5, 2), std), 2)
        fit = fitted(band, Poles(start[:7], SHAPES[:2, :7].T.astype(complex), start[7:]), np.ones(7, bool))
        off = fit.poles[:INSIDE] - start[:INSIDE]
        size = np.sqrt(np.diag(fit.covariance))[: 2 * INSIDE].reshape(2, -1)
        errors.append(np.array([off.real, off.imag]) / size)
        inside.append(np.abs(errors[-1]) < 1.96)
    assert 0.92 < np.mean(inside) < 0.98  # 560 bands: 95 % +- 0.9 % (std)
    assert 0.9 < np.std(errors) < 1.1


def test_correlated_lines_widen_the_std():
    """Errors of a Hann window: neighbours are correlated by 2/3, and half as many lines are worth something."""
    H = frf(loads=1)[:, :3]
    std = 0.02 * np.sqrt(np.mean(np.abs(H) ** 2))
    w = 2 * np.pi * F
    start = -Z * w + 1j * w * np.sqrt(1 - Z**2)
    smooth = []
    for seed in range(16):
        rng = np.random.default_rng(seed)
        e = rng.standard_normal((len(LINES) + 2, 3, 1)) + 1j * rng.standard_normal((len(LINES) + 2, 3, 1))
        e = (0.5 * e[1:-1] + 0.25 * (e[:-2] + e[2:])) / np.sqrt(2 * 0.375)
        band = FrfBand(LINES, H + std * e, np.full(H.shape, std), 2)
        fit = fitted(band, Poles(start[:7], np.ones((7, 1), complex), start[7:]), np.ones(7, bool))
        assert abs(fit.correlation[0] - 2 / 3) < 0.06
        size = np.sqrt(np.diag(fit.covariance))[: 2 * INSIDE].reshape(2, -1)
        off = fit.poles - start[:7]
        smooth.append(np.array([off.real / size[0], off.imag / size[1]])[:, :4])
    assert 0.8 < np.std(smooth) < 1.2  # without the correlation 1.4


def test_weights_from_residuals_are_unbiased_and_know_what_they_cost():
    """White noise without a mode: the mean of 1/std^2, and the scatter of std^2 of so many degrees of freedom."""
    H = frf(loads=1)[:, :3]
    w = 2 * np.pi * F
    start = Poles((-Z * w + 1j * w * np.sqrt(1 - Z**2))[:7], np.ones((7, 1), complex), np.zeros(0, complex))
    band = FrfBand(LINES, H, np.ones(H.shape), 2)
    fit = fitted(band, start, np.ones(7, bool), 1)
    unknowns = 3 * 2 * 7 + 2 * 7
    assert 2 * fit.leverage.sum() == pytest.approx(unknowns, rel=1e-6)  # trace of the hat matrix
    ratio = []
    for seed in range(30):
        rng = np.random.default_rng([11, seed])
        noise = (rng.standard_normal(H.shape) + 1j * rng.standard_normal(H.shape)) / np.sqrt(2)
        quiet = replace(fit, residual=noise, leverage=np.zeros(H.shape), correlation=np.zeros(0))
        found = reweighted(band, quiet)
        ratio.append(found.std**2)
    power = np.array(ratio)
    n = found.freedom
    assert np.mean(1 / power) == pytest.approx(1, abs=0.01)
    assert np.var(power * (n - 2) / n) == pytest.approx(2 / n, rel=0.05)
    assert found.loss == pytest.approx((n - 2) / (n - 4))
    half = reweighted(band, replace(quiet, leverage=np.full(H.shape, 0.5)))
    np.testing.assert_allclose(half.std**2, 2 * found.std**2)  # what the fit followed is made up for


def test_a_mode_that_explains_nothing_is_dropped():
    H = table(0.02, count=1)
    band = FrfBand(LINES, H.H, np.sqrt(np.asarray(H.variance)), 2)
    w = 2 * np.pi * np.append(F, 140.0)
    z = np.append(Z, 0.01)
    fit, dropped = selected(band, -z * w + 1j * w, np.ones((len(w), 1), complex))
    assert dropped >= 1
    assert np.abs(np.abs(fit.poles[fit.stayed]) / (2 * np.pi) - 140).min() > 3


# -- shapes, masses, models -------------------------------------------------------------------------------------------
def test_shapes_and_modal_masses_of_a_driven_point(found):
    """Shapes of unit modal mass are those of the structure, but for their sign; the mass is one over the largest."""
    assert found.scaled
    given = SHAPES[:, :INSIDE] * np.sign(np.sum(SHAPES[:, :INSIDE] * found.normal_shapes, axis=0))
    np.testing.assert_allclose(found.normal_shapes, given, atol=0.05 * np.abs(given).max())
    mass = 1 / np.max(np.abs(given), axis=0) ** 2
    off = (found.modal_mass - mass) / found.modal_mass_std
    assert np.all(np.abs(off) < 4)
    assert np.all(found.modal_mass_std < 0.1 * mass)


def test_the_model_answers_as_the_structure_does(found):
    model = found.model()
    H, G = frf(), model.frf(LINES)
    assert np.linalg.norm(G - H) < 0.005 * np.linalg.norm(H)
    ratio = np.abs(G - H) ** 2 / model.frf_variance(LINES)
    for load in range(2):
        assert 0.3 < np.median(ratio[:, :, load]) < 1.2  # 0.69 for complex errors of this variance
        assert np.mean(ratio[LINES < 160, :, load]) < 2  # the modes above the band are felt beyond
    np.testing.assert_allclose(model.natural_frequencies, found.frequencies)


def test_frf_impulse_response_and_state_space_are_one_system(found):
    model = found.model()
    dt, n = 1 / 4000, 49152  # the narrowest mode has decayed
    h = model.impulse_response(dt, n, "foh")
    np.testing.assert_allclose(h[:600], model.state_space(dt).impulse_response(dt, 600), atol=1e-9 * np.abs(h).max())
    f = np.arange(20.0, 190.0, 7.0)
    spectrum = np.einsum("fn,nsl->fsl", np.exp(-2j * np.pi * np.outer(f, np.arange(n)) * dt), h)
    hold = np.sinc(f * dt) ** 2  # of a load that is linear between samples
    np.testing.assert_allclose(spectrum, model.frf(f) * hold[:, None, None], atol=2e-3 * np.abs(spectrum).max())


def test_a_force_that_was_not_driven_needs_a_driven_point(found):
    H = frf(loads=5)
    G = found.model(["5+Z", "1+Z"]).frf(LINES)
    peaks = [np.argmin(np.abs(LINES - f)) for f in F[[0, 3, 4]]]
    for j, place in enumerate((4, 0)):
        off = np.linalg.norm(G[peaks, :, j] - H[peaks, :, place]) / np.linalg.norm(H[peaks, :, place])
        assert off < 0.1
    data = table(count=1)
    other = FrfModel(LINES[:561], data.H[:561], sensors=[Channel(label=f"a{i}", quantity="acceleration", unit="m/s^2")
                                             for i in range(5)], loads=data.loads,
                     variance=np.asarray(data.variance)[:561])  # fmt: skip
    shapes = identify_modes(other, order=40)
    assert not shapes.scaled
    assert np.all(np.isnan(shapes.modal_mass))
    assert len(shapes.model().loads) == 1
    with pytest.raises(InputError, match="no driven point"):
        shapes.model(["a3"])
    with pytest.raises(InputError, match="no such place"):
        shapes.model(["nowhere"])
    assert identify_modes(other, order=40, driven=("a0", "1+Z")).scaled


def test_a_roving_hammer_is_a_roving_sensor(found):
    """Two sensors and five loads: FRFs turned round, the same modes."""
    data = table()
    turned = FrfModel(LINES, data.H.transpose(0, 2, 1), variance=np.asarray(data.variance).transpose(0, 2, 1),
                      sensors=[Channel(label=c.label, quantity="acceleration", unit="m/s^2") for c in data.loads],
                      loads=[Channel(label=c.label, quantity="force", unit="N") for c in data.sensors])  # fmt: skip
    one, two = found, identify_modes(turned)
    np.testing.assert_allclose(two.frequencies, one.frequencies, rtol=1e-9)
    np.testing.assert_allclose(two.modal_mass, one.modal_mass, rtol=1e-4)
    np.testing.assert_allclose(two.model().frf(LINES), one.model().frf(LINES).transpose(0, 2, 1), rtol=1e-4, atol=1e-4)
    variance = one.model().frf_variance(LINES).transpose(0, 2, 1)
    np.testing.assert_allclose(two.model().frf_variance(LINES), variance, rtol=1e-3)


def test_kinds_of_frf_give_the_same_modes():
    found = identify_modes(table(0.002, count=1).as_kind("mobility"))
    np.testing.assert_allclose(found.frequencies, F[:INSIDE], rtol=1e-3)
    np.testing.assert_allclose(found.damping, Z[:INSIDE], rtol=0.05)


def test_without_a_variance_the_residuals_tell_it():
    found = identify_modes(table(told=False), order=30)
    assert len(found) == INSIDE
    np.testing.assert_allclose(found.frequencies, F[:INSIDE], rtol=1e-3)
    assert np.all(np.abs(found.frequencies - F[:INSIDE]) < 5 * found.frequency_std)


def test_a_model_in_a_file_and_changed(found, tmp_path):
    model = found.model()
    model.save(tmp_path / "m.h5")
    back = load_model(tmp_path / "m.h5")
    assert isinstance(back, ModalModel)
    assert back.fingerprint == model.fingerprint
    np.testing.assert_array_equal(back.frf(LINES), model.frf(LINES))
    np.testing.assert_array_equal(back.frf_variance(LINES), model.frf_variance(LINES))
    some = back.with_sensors([3, 1])
    np.testing.assert_array_equal(some.frf(LINES), model.frf(LINES)[:, [3, 1]])
    np.testing.assert_allclose(some.frf_variance(LINES), model.frf_variance(LINES)[:, [3, 1]])
    softer = model.perturbed("stiffness", 0.81)
    np.testing.assert_allclose(softer.natural_frequencies, 0.9 * model.natural_frequencies)
    np.testing.assert_allclose(model.perturbed("mass", 2.0).frf([100.0]).shape, (1, 5, 2))
    with pytest.raises(InputError, match="no such change"):
        model.perturbed("colour", 1.1)


def test_static_is_not_told_by_accelerometers(found):
    np.testing.assert_array_equal(found.model().static(), 0.0)


# -- records ----------------------------------------------------------------------------------------------------------
def mast() -> ForwardModel:
    """A steel mast with three accelerometers, driven at its top, and many more modes than the test sees."""
    body = beams.cantilever(length=1.5, EI=1500.0, mass_per_length=4.0, elements=20, damping=damping.Modal(0.008))
    seen = [sensors.Accelerometer(p) for p in ("20+Z", "14+Z", "9+Z")]
    return ForwardModel(body, seen, [loads.Point("20+Z", label="20+Z")], modes=12)


def answered(truth: ForwardModel, load: np.ndarray) -> np.ndarray:
    """Response to a periodic load, exactly, line by line."""
    f = np.fft.rfftfreq(len(load), DT)
    H = truth.frf(f)[:, :, 0]
    H[-1] = 0
    return np.fft.irfft(H * np.fft.rfft(load)[:, None], len(load), axis=0)


@pytest.fixture(scope="module")
def shaken() -> tuple[ForwardModel, MeasuredModes]:
    """The mast, and its modes from 33 s under a shaker."""
    truth, rng = mast(), np.random.default_rng(3)
    force = rng.standard_normal(65_536)
    y = answered(truth, force)
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    names = ["F", *(s.label for s in truth.sensors)]
    channels = [Channel(label=names[0], quantity="force", unit="N")]
    channels += [Channel(label=n, quantity="acceleration", unit="m/s^2") for n in names[1:]]
    made = FrfModel.from_records(
        np.column_stack([force, y]), dt=DT, channels=channels, forces="F", responses=names[1:], segment=8192
    )
    return truth, identify_modes(made, band=(15, 700), driven=("20+Z", "F"), order=50)


def swept(truth: ForwardModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A force of 90 Hz that comes and goes, what the mast answers with 1 % noise, and its std."""
    t = np.arange(2048) * DT
    load = np.where((t > 0.2) & (t < 0.8), np.sin(2 * np.pi * 90 * t) * np.sin(np.pi * (t - 0.2) / 0.6) ** 2, 0.0)
    seen = answered(truth, np.concatenate([load, np.zeros(6144)]))[:2048]
    sigma = 0.01 * seen.std(axis=0)
    return load, seen + sigma * np.random.default_rng(4).standard_normal(seen.shape), sigma


def test_records_of_a_shaker_give_the_modes(shaken):
    truth, found = shaken
    given = truth.natural_frequencies[1:7]
    np.testing.assert_allclose(found.frequencies, given, rtol=1e-3)
    np.testing.assert_allclose(found.damping[1:], 0.008, rtol=0.05)  # the first is narrower than the lines
    np.testing.assert_allclose(found.modal_mass[1:], 1.5, rtol=0.03)  # rho A L / 4, whatever the mode of a cantilever


def test_the_modes_rebuild_a_force(shaken):
    """No finite elements anywhere in the inversion: their modes are those of the test."""
    from loadid import Deconvolution, Noise

    truth, found = shaken
    load, seen, sigma = swept(truth)
    e = Deconvolution(found.model(), noise=Noise(sigma)).estimate(seen, DT)
    assert np.linalg.norm(e.load[:, 0] - load) < 0.05 * np.linalg.norm(load)


def test_a_tracker_on_the_modes_is_near_one_on_the_structure(shaken):
    """The twelve modes of the mast itself are the tracker that no test can beat."""
    from loadid import LoadTracker, Noise

    truth, found = shaken
    load, seen, sigma = swept(truth)
    off = []
    for model in (truth, found.model()):
        e = LoadTracker(model, noise=Noise(sigma)).fit(seen, DT).track(seen)
        off.append(np.linalg.norm(e.load[:, 0] - load) / np.linalg.norm(load))
    assert off[1] < 0.1
    assert off[1] < 1.2 * off[0]  # .059 against .061


# -- refusals ---------------------------------------------------------------------------------------------------------
def test_refusals():
    data = table()
    with pytest.raises(InputError, match="no lines of its own"):
        identify_modes(mast())
    with pytest.raises(InputError, match="too few lines"):
        identify_modes(data, band=(10, 11))
    with pytest.raises(InputError, match="which channels are forces"):
        identify_modes(np.zeros((100, 2)))
    with pytest.raises(InputError, match="no such driven point"):
        identify_modes(data, driven=("a", "b"))
    with pytest.raises(InputError, match="no order"):
        identify_modes(data, order=1000)
    bare = FrfModel(LINES, data.H, sensors=[Channel(label=f"s{i}") for i in range(5)], loads=data.loads)
    with pytest.raises(InputError, match="LID-W208"):
        identify_modes(bare)
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((len(LINES), 2, 1)) + 1j * rng.standard_normal((len(LINES), 2, 1))
    with pytest.raises(InputError, match="no mode stays"):
        identify_modes(FrfModel.from_frf(LINES, noise, kind="accelerance"), order=20)


# -- a measured structure ---------------------------------------------------------------------------------------------
def test_hammer_hits_of_a_measured_structure():
    """Two hits, two accelerometers: what one hit tells is what the other one does."""
    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as data:
        hits = [data["hit1"], data["hit2"]]
    channels = [Channel(label="F", quantity="force", unit="arbitrary")]
    channels += [Channel(label=n, quantity="acceleration", unit="m/s^2") for n in ("m_1", "m_2")]
    found = []
    for hit in hits:
        model = MeasuredModel.from_hits(
            [_Hit(hit - hit[-2000:].mean(axis=0), 1 / 1024, channels)], force="F", responses=["m_2"]
        )
        found.append(identify_modes(model, band=(200, 400), order=40))
    for f in (233.56, 235.71, 339.5):
        ones = [x.frequencies[np.argmin(np.abs(x.frequencies - f))] for x in found]
        np.testing.assert_allclose(ones, f, rtol=2e-3)
        assert abs(ones[0] / ones[1] - 1) < 1e-3


class _Hit:
    def __init__(self, values, dt, channels):
        self.values, self.dt, self.channels = values, dt, channels
