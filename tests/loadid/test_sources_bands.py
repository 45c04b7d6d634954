"""Fractional octave bands against IEC 61260-1, and band powers against the mean square of the signal itself."""

import numpy as np
import pytest

from loadid.sources import band_power, octave_bands
from loadid.sources._levels import bands_of
from structures import InputError

THIRDS = [
    *("20", "25", "31.5", "40", "50", "63", "80", "100", "125", "160", "200", "250", "315", "400", "500", "630"),
    *("800", "1000", "1250", "1600", "2000", "2500", "3150", "4000", "5000", "6300", "8000", "10000", "12500"),
    *("16000", "20000"),
]
OCTAVES = ["16", "31.5", "63", "125", "250", "500", "1000", "2000", "4000", "8000", "16000"]


def periodogram(x, dt):
    """One-sided density whose sum times the line spacing is the mean square."""
    n = len(x)
    power = np.abs(np.fft.rfft(x, axis=0)) ** 2 * dt / n
    power[1 : (n + 1) // 2] *= 2
    return np.fft.rfftfreq(n, dt), power


def test_nominal_frequencies_are_the_preferred_numbers():
    assert list(octave_bands(3, 20, 20e3).names) == THIRDS
    assert list(octave_bands(1, 16, 16e3).names) == OCTAVES
    assert octave_bands(1, 0.9, 4).names == ("1", "2", "4")
    assert octave_bands(6, 1001, 1100).names == ("1060",)  # 1000 G^(1/12) = 1059.25 Hz, three digits


def test_midband_frequencies_are_powers_of_ten():
    k = np.arange(13, 44)
    np.testing.assert_allclose(octave_bands(3, 20, 20e3).centres, 10 ** (k / 10), rtol=1e-12)
    # IEC 61260-1, table of exact octave midbands: 63.10, 125.89, 251.19, 501.19, 1000, 1995.26 Hz
    expected = [63.0957, 125.8925, 251.1886, 501.1872, 1000, 1995.2623]
    np.testing.assert_allclose(octave_bands(1, 63, 2000).centres, expected, rtol=1e-6)


@pytest.mark.parametrize("fraction", [1, 2, 3, 6, 12, 24])
def test_edges_lie_half_a_band_away_and_are_shared(fraction):
    b = octave_bands(fraction, 31, 4000)
    np.testing.assert_allclose(b.upper / b.lower, 10 ** (0.3 / fraction), rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(b.upper * b.lower), b.centres, rtol=1e-12)
    np.testing.assert_array_equal(b.upper[:-1], b.lower[1:])
    assert b.lower[0] <= 31 < b.upper[0]
    assert b.lower[-1] <= 4000 < b.upper[-1]
    # an odd fraction has a band around 1 kHz, an even one an edge there
    at = b.centres if fraction % 2 else b.lower
    assert np.abs(at / 1000 - 1).min() < 1e-12


@pytest.mark.parametrize("samples", [4000, 4001])
@pytest.mark.parametrize("fraction", [1, 3, 12])
def test_bands_add_to_the_mean_square(samples, fraction):
    rng, dt = np.random.default_rng(samples), 1 / 5000
    x = rng.standard_normal((samples, 2)) * [1.0, 1e-4] + [0.3, 0.0]
    f, power = periodogram(x, dt)
    bands = octave_bands(fraction, 0.4 * f[1], 2 * f[-1])
    found = band_power(f, power, bands, density=True)
    np.testing.assert_allclose(found.power.sum(axis=0), np.var(x, axis=0), rtol=1e-12)
    assert found.coverage.max() <= 1


def test_a_sine_lies_in_its_band_and_a_tone_in_one():
    dt, n = 1 / 4096, 4096
    t = np.arange(n) * dt
    x = 3 * np.sin(2 * np.pi * 100 * t) + 0.1 * np.sin(2 * np.pi * 1000 * t)
    f, power = periodogram(x, dt)
    bands = octave_bands(3, 50, 2000)
    found = band_power(f, power, bands, density=True).power
    level = dict(zip(bands.names, found, strict=True))
    assert level["100"] == pytest.approx(4.5, rel=1e-9)
    assert level["1000"] == pytest.approx(0.005, rel=1e-9)
    assert level["400"] < 1e-20
    tones = band_power([100.0, 1000.0], [4.5, 0.005], bands, density=False).power
    np.testing.assert_allclose(tones, found, atol=1e-9)


def test_a_line_across_an_edge_is_parted_there():
    bands = octave_bands(1, 400, 1100)  # 500 and 1000 Hz, edge at 707.9 Hz
    edge = bands.upper[0]
    f = edge + np.array([-20.0, -10.0, 2.5, 12.5])
    f[1:3] = edge + np.array([-10.0, 2.5])
    found = band_power([edge - 7.5, edge + 2.5, edge + 12.5], [0.0, 1.0, 0.0], bands, density=True)
    np.testing.assert_allclose(found.power, [2.5, 7.5], rtol=1e-9)


def test_a_hole_between_lines_is_not_filled():
    f = np.concatenate([np.arange(100, 201.0), np.arange(400, 501.0)])
    found = band_power(f, np.full(len(f), 2.0), octave_bands(1, 63, 1000), density=True)
    assert found.power.sum() == pytest.approx(2 * 202, rel=1e-12)  # two stretches of 101 lines of 1 Hz
    assert dict(zip(found.bands.names, found.coverage, strict=True))["1000"] == 0
    assert dict(zip(found.bands.names, found.coverage, strict=True))["125"] == pytest.approx(
        (found.bands.upper[1] - 99.5) / (found.bands.upper[1] - found.bands.lower[1])
    )


def test_zero_hertz_is_in_no_band():
    bands = bands_of([0.0, 1.0, 2.0])
    assert bands.lower[0] > 0
    assert band_power([0.0, 1.0, 2.0], [1e9, 1.0, 1.0], bands, density=True).power.sum() <= 2


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: octave_bands(0), "fraction"),
        (lambda: octave_bands(2.5), "fraction"),
        (lambda: octave_bands(3, 0, 100), "0 < low"),
        (lambda: octave_bands(3, 200, 100), "0 < low"),
        (lambda: bands_of([0.0]), "above 0 Hz"),
        (lambda: band_power([2.0, 1.0], [1.0, 1.0], octave_bands(), density=True), "ascending"),
        (lambda: band_power([1.0, 2.0], [1.0, np.nan], octave_bands(), density=True), "finite"),
        (lambda: band_power([1.0], [1.0], octave_bands(), density=True), "no width"),
    ],
)
def test_bad_bands_are_refused(call, match):
    with pytest.raises(InputError, match=match):
        call()
