"""Models made of measured modes: the std of their FRFs, structures with any damping, and measured hits."""

from __future__ import annotations

import numpy as np
import pytest

from structures import Channel, FrfModel, MeasuredModel, MeasuredModes, identify_modes
from structures._testing.modalfit import kernel, kernel_slope
from structures.files._modelfile import load_model

from ..benchmarks.modes import Case, beam, dashpots, noisy
from ..data import measured
from .test_modes import LINES, frf, table


def test_bands_of_the_frfs_hold_the_truth():
    """Real and imaginary parts of the FRFs of both references, over noises that nothing was set on."""
    H, s, inside = frf(), 2j * np.pi * LINES, []
    for seed in range(900, 904):
        model = identify_modes(table(seed=seed)).model()
        off = model.frf(LINES) - H
        for o in range(5):
            root = model._errors.root(s, 2, o)
            for part, size in ((off[:, o].real, root.real), (off[:, o].imag, root.imag)):
                inside.append(np.abs(part) < 1.96 * np.sqrt(np.sum(size**2, axis=2)))
    assert 0.91 < np.mean(inside) < 0.98  # 0.955 and 0.951 over 30 noises
    assert np.mean(np.array(inside)[:, LINES > 160]) > 0.9  # where the modes above the band are felt


def test_a_fit_that_is_wrong_says_so_in_its_std():
    """A band whose strongest mode turns into two lines of a nonlinearity: the residual widens the std there."""
    data = table(0.002, count=1)
    H = np.array(data.H)
    near = np.abs(LINES - 121) < 1.5
    H[near] *= 1.25
    wrong = FrfModel(LINES, H, sensors=data.sensors, loads=data.loads, variance=data.variance)
    model = identify_modes(wrong).model()
    off, std = np.abs(model.frf(LINES) - H)[near], np.sqrt(model.frf_variance(LINES))[near]
    assert np.mean(off < 3 * std) > 0.9


def test_a_cut_impulse_response_scales_residues_and_moves_no_pole():
    """The kernel against the sum of an exponential that was cut, and its slope against a difference."""
    p, T = np.array([-2.0 + 300j, -0.3 + 77j]), 1.25
    s = 2j * np.pi * np.arange(3, 40) / T
    t = (np.arange(200_000) + 0.5) * T / 200_000
    sums = np.stack([np.exp(np.outer(q - s, t)) @ np.full(len(t), T / len(t)) for q in p], axis=1)
    np.testing.assert_allclose(kernel(s, p, 0, T), sums, rtol=1e-4)
    for d in (0, 1, 2):
        step = (kernel(s, p + 1e-5, d, T) - kernel(s, p - 1e-5, d, T)) / 2e-5
        np.testing.assert_allclose(kernel_slope(s, p, d, T), step, rtol=1e-4, atol=1e-6 * np.abs(step).max())


# -- any damping ------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def damped() -> tuple[Case, MeasuredModes]:
    """A beam with two dashpots, 40 elements, and its modes from FRFs with half a per cent of noise."""
    case = dashpots(0.005)
    H, std = noisy(case, 3)
    channels = [Channel(label=f"{i + 1}+Z", quantity="acceleration", unit="m/s^2") for i in range(5)]
    made = FrfModel(case.f, H[..., None], sensors=channels, loads=[Channel(label="1+Z", quantity="force", unit="N")],
                    variance=np.full((*H.shape, 1), std**2))  # fmt: skip
    return case, identify_modes(made)


def test_complex_modes_of_dashpots(damped, tmp_path):
    case, found = damped
    model = found.model()
    assert model.viscous is not None
    assert model.reduced is None
    assert np.linalg.norm(model.frf(case.f)[..., 0] - case.H) < 0.005 * np.linalg.norm(case.H)
    order = [int(np.argmin(np.abs(found.frequencies - f))) for f in case.frequencies]
    np.testing.assert_allclose(found.frequencies[order], case.frequencies, rtol=2e-3)
    np.testing.assert_allclose(found.damping[order], case.damping, rtol=0.05)
    model.save(tmp_path / "m.h5")
    back = load_model(tmp_path / "m.h5")
    assert back.fingerprint == model.fingerprint
    np.testing.assert_array_equal(back.frf(case.f), model.frf(case.f))
    np.testing.assert_array_equal(back.frf_variance(case.f), model.frf_variance(case.f))
    h = model.impulse_response(1e-4, 40_000, "foh")
    f = np.arange(20.0, 390.0, 13.0)
    spectrum = np.einsum("fn,nsl->fsl", np.exp(-2j * np.pi * np.outer(f, np.arange(40_000)) * 1e-4), h)
    hold = np.sinc(f * 1e-4) ** 2
    np.testing.assert_allclose(spectrum, model.frf(f) * hold[:, None, None], atol=0.02 * np.abs(spectrum).max())


def test_a_force_that_was_not_driven_on_a_structure_with_dashpots(damped):
    """Reciprocity of the full K, M, C: the force at the second sensor, scaled by the driven point, at the peaks."""
    _, found = damped
    model = found.model(["2+Z"])
    K, M, C = beam(40)
    places = [2 * round(40 * x) - 2 for x in (1.0, 0.8, 0.6, 0.45, 0.3)]
    push = np.eye(len(K))[places[1]]
    for f in found.frequencies[1:3]:
        w = 2 * np.pi * f
        truth = -(w**2) * np.linalg.solve(K - w**2 * M + 1j * w * C, push)[places]
        off = np.linalg.norm(model.frf([f])[0, :, 0] - truth)
        assert off < 0.1 * np.linalg.norm(truth)


def test_the_force_on_a_structure_with_dashpots(damped):
    """Deconvolution and tracker on complex modes; the truth is the full K, M, C, line by line."""
    from loadid import Deconvolution, LoadTracker, Noise

    _, found = damped
    dt, n = 1 / 2000, 1024
    t = np.arange(n) * dt
    load = np.where((t > 0.1) & (t < 0.4), np.sin(2 * np.pi * 90 * t) * np.sin(np.pi * (t - 0.1) / 0.3) ** 2, 0.0)
    K, M, C = beam(40)
    places = [2 * round(40 * x) - 2 for x in (1.0, 0.8, 0.6, 0.45, 0.3)]
    push, f = np.eye(len(K))[places[0]], np.fft.rfftfreq(4 * n, dt)
    spectrum, seen = np.fft.rfft(load, 4 * n), np.zeros((len(f), 5), complex)
    for i in np.flatnonzero(f < 300):
        w = 2 * np.pi * f[i]
        seen[i] = -(w**2) * np.linalg.solve(K - w**2 * M + 1j * w * C, push)[places] * spectrum[i]
    y = np.fft.irfft(seen, 4 * n, axis=0)[:n]
    sigma = 0.01 * y.std(axis=0)
    y = y + sigma * np.random.default_rng(5).standard_normal(y.shape)
    e = Deconvolution(found.model(), noise=Noise(sigma)).estimate(y, dt)
    assert np.linalg.norm(e.load[:, 0] - load) < 0.1 * np.linalg.norm(load)
    e = LoadTracker(found.model(), noise=Noise(sigma)).fit(y, dt).track(y)
    assert np.linalg.norm(e.load[:, 0] - load) < 0.2 * np.linalg.norm(load)


# -- measured hits ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("band", "most"), [((500, 1000), 0.05), ((1000, 2000), 0.02)])
def test_five_measured_hits(band, most):
    """What the modes miss of the FRFs of one sensor: 3.3 and 0.6 %, 7.7 and 34 % before."""
    hits = [np.load(measured("hammer_five_hits", f"measurements_{k}.npy"))[1:].T for k in range(1, 6)]
    channels = [Channel(label="F", quantity="force", unit="N"), Channel(label="a", quantity="acceleration",
                                                                        unit="m/s^2")]  # fmt: skip
    model = MeasuredModel.from_hits([_Hit(hit, channels) for hit in hits], force="F", responses=["a"])
    found = identify_modes(model, band=band)
    assert found.model()._errors.missed.max() < most
    assert "LID-W219" not in {f.code for f in found.flags}


class _Hit:
    def __init__(self, values, channels):
        self.values, self.dt, self.channels = values, 1 / 25600, channels


def test_without_a_variance_what_changes_from_line_to_line_is_noise_and_the_rest_is_not():
    from structures._testing.modalshapes import rough

    rng, f = np.random.default_rng(2), np.linspace(0.0, 1.0, 2000)[:, None, None]
    noise = rng.standard_normal((2000, 2, 1)) + 1j * rng.standard_normal((2000, 2, 1))
    np.testing.assert_allclose(rough(noise), 2.0, rtol=0.1)
    np.testing.assert_allclose(rough(noise + 5.0 / (0.02 + 1j * (f - 0.5))), 2.0, rtol=0.1)
    assert not rough(noise[:2]).any()
