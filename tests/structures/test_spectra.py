"""Spectra of finite records: lengths, counts, averages and resampling against closed forms and loops."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from structures._testing.spectra import multiplicity, padded_length, resample_lines, smooth_lines, without_error

from .impacts import DT, response, transfer


@given(st.integers(1, 100_000))
def test_padded_length_holds_a_linear_convolution(samples):
    padded = padded_length(samples)
    assert padded % 2 == 0
    assert 2 * samples <= padded <= 2.3 * samples + 8


@pytest.mark.parametrize("n", [8, 9, 30, 31])
def test_multiplicity_is_parseval(n):
    x = np.random.default_rng(n).standard_normal(n)
    assert np.sum(multiplicity(n) * np.abs(np.fft.rfft(x)) ** 2) == pytest.approx(n * np.sum(x**2))
    assert multiplicity(n).sum() == n


class TestSmoothLines:
    def test_against_a_loop(self):
        power = np.random.default_rng(0).random((40, 2))
        weight = 0.5 * (1 + np.cos(np.pi * np.arange(-3, 4) / 4))
        smooth = smooth_lines(power, 3)
        for k in range(40):
            total = 0
            for w, j in zip(weight, range(k - 3, k + 4), strict=True):
                total = total + w * power[abs(j) if j < 40 else 78 - j]
            assert smooth[k] == pytest.approx(total / weight.sum())

    @pytest.mark.parametrize("half", [0, 1, 5, 100])
    @pytest.mark.parametrize("lines", [1, 2, 3, 50])
    def test_keeps_a_constant_and_positive_numbers(self, half, lines):
        assert smooth_lines(np.full((lines, 2), 3.0), half) == pytest.approx(3.0)
        assert np.all(smooth_lines(np.random.default_rng(0).random(lines), half) > 0)


class TestResample:
    @pytest.mark.parametrize("padded", [802, 1024, 2048, 5000])
    def test_exact_for_a_decayed_response(self, padded):
        """Lines of another spacing are those of the Fourier integral itself, up to what has not decayed (1e-9)."""
        lines = transfer(np.fft.rfftfreq(4096, DT), sensors=2)
        exact = transfer(np.fft.rfftfreq(padded, DT), sensors=2)
        assert np.abs(resample_lines(lines, padded) - exact).max() < 1e-6 * np.abs(exact).max()

    def test_against_the_transform_of_the_samples(self):
        h = response(300)
        for old, new in ((700, 2000), (2000, 700), (700, 702)):
            found = resample_lines(np.fft.rfft(h, old, axis=0), new)
            assert np.abs(found - np.fft.rfft(h, new, axis=0)).max() < 1e-12 * np.abs(found).max()

    def test_same_length_and_back(self):
        H = np.fft.rfft(np.random.default_rng(0).standard_normal((64, 2, 3)), axis=0)
        np.testing.assert_array_equal(resample_lines(H, 64), H)
        assert resample_lines(resample_lines(H, 640), 64) == pytest.approx(H)

    def test_a_little_before_zero_stays_before_zero(self):
        """The ringing of an anti-alias filter ahead of a blow is not moved to the end of the record."""
        h = np.zeros(256)
        h[[0, 1, -1, -2]] = 1.0, 0.5, 0.2, -0.1
        wide = np.fft.irfft(resample_lines(np.fft.rfft(h), 1024))
        expected = np.zeros(1024)
        expected[[0, 1, -1, -2]] = 1.0, 0.5, 0.2, -0.1
        assert wide == pytest.approx(expected, abs=1e-12)


def test_frfs_without_their_errors_are_as_likely_too_large_as_too_small() -> None:
    rng = np.random.default_rng(4)
    f = np.linspace(0, 1, 801)[:, None, None]
    true = f**2 * np.exp(2j * np.pi * 3 * f)  # of an accelerometer
    error = 0.01 * np.ones((801, 40, 1))
    noise = np.sqrt(error / 2) * (rng.standard_normal(error.shape) + 1j * rng.standard_normal(error.shape))
    found, variance = without_error(true + noise, error)
    slope = {}
    for name, H in (("measured", true + noise), ("told", found)):
        part = slice(180, 320)  # where its square is a quarter of the error to twice and a half
        slope[name] = np.sum((H.conj() * true)[part].real) / np.sum(np.abs(H[part]) ** 2)
    assert slope["measured"] < 0.65  # a load is told so much too small
    assert abs(slope["told"] - 1) < 0.15
    assert not found[:80].any()  # where nothing is told
    assert np.all(variance[:80] >= 0.5 * np.abs(true[:80]) ** 2)
    np.testing.assert_allclose(found[-100:], (true + noise)[-100:], rtol=0.02)
    same, none = without_error(true + noise, 0 * error)
    np.testing.assert_array_equal(same, true + noise)
    assert not none.any()
