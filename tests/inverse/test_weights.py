"""Roughness of the load spectrum: the noise of each sensor, told by one short pulse."""

import numpy as np
import pytest

from loadid._families.posing.posed import roughness

N = 1024


def spectra(noise: list[float], start: int = 200, pulse: int = 12, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Load spectrum (lines, sensors) that each sensor gives alone, padded to twice the record, and the load's."""
    g = np.zeros(N)
    g[start : start + pulse] = np.sin(np.pi * np.arange(pulse) / pulse)
    error = np.random.default_rng(seed).standard_normal((N, len(noise))) * noise
    return np.fft.rfft(g[:, None] + error, 2 * N, axis=0), np.fft.rfft(g, 2 * N)


@pytest.mark.parametrize("start", [0, 200, 500, 900])
@pytest.mark.parametrize("noise", [[0.01, 0.01], [0.005, 0.05], [0.1, 0.001]])
def test_noise_of_each_sensor_is_recovered(noise: list[float], start: int) -> None:
    told = roughness(spectra(noise, start)[0])
    expected = N * np.array(noise) ** 2  # energy of the noise on each line
    for level in (told.typical, told.local):
        assert np.all(np.abs(np.log10(np.median(level, axis=0) / expected)) < np.log10(1.7))
    assert (told.typical[:, 0] < told.typical[:, 1]).mean() == pytest.approx(float(noise[0] < noise[1]), abs=0.02) or (
        noise[0] == noise[1]
    )


def test_noise_is_recovered_over_many_draws() -> None:
    for start in (10, 250, 600):  # wherever the pulse lies in the record
        ratio = [np.mean(roughness(spectra([0.02], start, seed=s)[0]).local) / (N * 0.02**2) for s in range(20)]
        assert np.mean(ratio) == pytest.approx(1.0, abs=0.05)


def test_noise_that_changes_with_frequency_is_followed() -> None:
    G, g = spectra([0.02, 0.02])
    lines = np.arange(len(G))
    rise = np.where(lines > len(G) // 2, 10.0, 1.0)[:, None]  # an antiresonance region, ten times as noisy
    told = roughness(g[:, None] + (G - g[:, None]) * rise)
    low, high = np.median(told.typical[:400], axis=0), np.median(told.typical[-400:], axis=0)
    np.testing.assert_allclose(high / low, 100, rtol=0.4)


def test_one_bad_line_stays_local() -> None:
    G, _ = spectra([0.02])
    told, k = roughness(G), 500
    spoiled = G.copy()
    spoiled[k] += 200 * np.sqrt(N) * 0.02
    after = roughness(spoiled)
    assert after.local[k, 0] > 1000 * told.local[k, 0]
    assert after.typical[k, 0] < 2 * told.typical[k, 0]


def test_relative_error_says_whether_the_load_is_short() -> None:
    short = roughness(spectra([0.001])[0])
    low = slice(0, len(short.relative) // 12)  # where the pulse has its energy
    assert np.median(short.relative[low]) < 0.01
    rng = np.random.default_rng(1)
    long = roughness(np.fft.rfft(rng.standard_normal((N, 1)), 2 * N, axis=0))
    assert np.median(long.relative) > 0.5


def test_scale_of_the_load_scales_the_error() -> None:
    G, _ = spectra([0.01, 0.03])
    one, two = roughness(G), roughness(1e6 * G)
    np.testing.assert_allclose(two.typical, 1e12 * one.typical, rtol=1e-6)
    np.testing.assert_allclose(two.relative, one.relative, rtol=1e-6)
