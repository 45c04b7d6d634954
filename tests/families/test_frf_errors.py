"""Errors of the FRF that nobody states: learned, in the band, and in what is trusted."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import FrequencyInversion, Noise, Spectra
from loadid._inverse.discrepancy import FLOOR, learned
from structures import InputError

from ..campaigns import frequency
from ..campaigns.scores import Z95
from ..linecases import case, model, normals


@pytest.mark.parametrize(("sensors", "loads"), [(8, 3), (5, 3), (2, 1)])
@pytest.mark.parametrize("error", [0.03, 0.10])
def test_the_size_is_learned_from_spare_sensors(sensors, loads, error):
    c = case(400, sensors, loads, error=error, noise=0.01)
    power = np.full(c.Y.shape, c.sigma**2)
    found = learned(c.H, c.Y[..., None], power, c.f, known=True, neighbours=40)
    assert found.entry == pytest.approx(error, rel=0.35)


def test_an_exact_frf_of_many_sensors_is_found_exact():
    c = case(400, 8, 3, noise=0.01)
    found = learned(c.H, c.Y[..., None], np.full(c.Y.shape, c.sigma**2), c.f, known=True, neighbours=40)
    assert found.entry < 0.015


def test_learning_hardly_widens_the_band_of_an_exact_frf():
    c = case(600, 8, 3)
    data = Spectra(c.f, c.Y, noise=c.sigma)
    e, exact = (FrequencyInversion(model(c.f, c.H), noise=n).estimate(data) for n in (None, Noise(frf=0.0)))
    assert np.median(e.std / exact.std) < 1.2
    assert 0.925 < np.mean(c.inside(e)) < 0.99


def test_one_sensor_of_one_load_tells_nothing_and_has_the_floor():
    c = case(200, 1, 1, noise=0.01)
    e = FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, c.Y, noise=c.sigma))
    assert np.all(e.std >= 0.9 * FLOOR * np.abs(e.load))
    assert e.trust().any()
    assert "no spare sensor" in e.facts["frf_errors"]
    exact = FrequencyInversion(model(c.f, c.H), noise=Noise(frf=0.0)).estimate(Spectra(c.f, c.Y, noise=c.sigma))
    assert np.min(exact.std / np.abs(exact.load)) < 0.3 * FLOOR


def test_a_shift_of_the_frequencies_is_told_from_errors_of_entries():
    c = case(400, 8, 2, noise=0.01)
    slope = np.gradient(c.H, np.log(c.f), axis=0)
    g = normals(np.random.default_rng(3), 400, 2)
    Y = np.einsum("ksl,kl->ks", c.H + 0.003 * slope, g)
    sigma = 0.01 * float(np.sqrt(np.mean(np.abs(Y) ** 2)))
    Y = Y + sigma * normals(np.random.default_rng(4), *Y.shape)
    found = learned(c.H, Y[..., None], np.full(Y.shape, sigma**2), c.f, known=True, neighbours=40)
    assert np.sqrt(found.sizes[2]) == pytest.approx(0.003, rel=0.4)


def test_stated_errors_are_not_learned():
    c = case(100, 4, 2, error=0.05)
    data = Spectra(c.f, c.Y, noise=c.sigma)
    e = FrequencyInversion(model(c.f, c.H), noise=Noise(frf=0.05)).estimate(data)
    stated = FrequencyInversion(model(c.f, c.H, 0.05**2 * np.abs(c.H) ** 2)).estimate(data)
    assert np.array_equal(e.load, stated.load)
    for wrong in (-0.1, 1.0, np.nan, "5 %", True):
        with pytest.raises(InputError, match="frf"):
            Noise(frf=wrong)


def test_a_silent_load_does_not_hide_the_lines_that_tell_the_others():
    truth = normals(np.random.default_rng(2), 400, 3)
    truth[:, 2] = 0
    c = case(400, 8, 3, truth=truth)
    e = FrequencyInversion(model(c.f, c.H)).estimate(Spectra(c.f, c.Y, noise=c.sigma))
    assert e.facts["trusted_lines"] > 0.3


def test_a_slice_of_the_campaign():
    """`python -m tests.campaigns frequency`; docs/bands.md has its table."""
    found = [s for error in ("entry", "modal", "gain") for s in frequency.run(4, 9, error, 0.05)]
    z = np.concatenate([np.abs(s.z)[:, s.trusted].ravel() for s in found]) <= Z95
    off = np.concatenate([s.off[s.trusted] for s in found])
    kept = np.concatenate([s.trusted[s.before & (s.off_before < frequency.BAD)] for s in found])
    assert np.mean(z) > 0.87
    assert np.mean(off > frequency.BAD) < 0.03
    assert np.mean(kept) > 0.5
