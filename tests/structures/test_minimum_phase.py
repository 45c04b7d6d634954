"""The causal filter of a given magnitude."""

import numpy as np
import pytest

from structures._testing.spectra import minimum_phase


def test_a_filter_with_its_zeros_inside_the_circle_is_found_again():
    b = np.convolve([1.0, -0.6], [1.0, 0.5, 0.3])
    lines = np.fft.rfft(b, 1024)
    assert minimum_phase(np.abs(lines)) == pytest.approx(lines, abs=1e-12)


def test_zeros_outside_are_reflected():
    out, inside = np.fft.rfft([1.0, -2.0], 1024), np.fft.rfft([2.0, -1.0], 1024)
    assert minimum_phase(np.abs(out)) == pytest.approx(inside, abs=1e-12)


def test_columns_are_filters_of_their_own():
    magnitude = np.abs(np.fft.rfft([[1.0, 3.0], [0.4, 0.2]], 64, axis=0))
    both = minimum_phase(magnitude)
    assert np.abs(both) == pytest.approx(magnitude, rel=1e-12)
    for j in range(2):
        assert both[:, j] == pytest.approx(minimum_phase(magnitude[:, j]), rel=1e-12)
