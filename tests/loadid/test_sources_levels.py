"""Levels in decibels and over time against closed forms."""

import numpy as np
import pytest

from loadid.sources import compare, decibels, running_level, running_rms, time_weighted
from structures import InputError

DT = 1e-3


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
def test_running_rms_of_a_sine_over_whole_periods(scale):
    t = np.arange(2001) * DT
    window = 101 * DT  # five and two periods
    x = scale * np.stack([np.sin(2 * np.pi * 5 / window * t), 2 * np.cos(2 * np.pi * 2 / window * t)], axis=1)
    level = running_rms(x, DT, 0.1005)
    expected = np.broadcast_to(scale * np.array([1, 2]) / np.sqrt(2), (1901, 2))
    np.testing.assert_allclose(level[50:-50], expected, rtol=1e-9)
    brute = [np.sqrt(np.mean(x[max(i - 50, 0) : i + 51] ** 2, axis=0)) for i in range(len(x))]
    np.testing.assert_allclose(level, brute, rtol=1e-9)


@pytest.mark.parametrize(("weighting", "tau"), [("fast", 0.125), ("slow", 1.0), (0.035, 0.035)])
def test_exponential_weighting_charges_and_decays_with_its_time_constant(weighting, tau):
    x = np.concatenate([np.full(3000, 2.0), np.zeros(3000)])
    square = time_weighted(x, DT, weighting) ** 2
    n = np.arange(1, 3001)
    np.testing.assert_allclose(square[:3000], 4 * (1 - np.exp(-n * DT / tau)), rtol=1e-9)
    np.testing.assert_allclose(square[3000:], square[2999] * np.exp(-n * DT / tau), rtol=1e-6, atol=1e-15)


def test_a_gain_is_the_same_number_of_decibels_everywhere():
    x = np.random.default_rng(0).standard_normal((5000, 2))
    run = running_level(x, 1.1220184543 * x, DT)  # 1 dB
    np.testing.assert_allclose(run.error, 1.0, atol=1e-8)
    np.testing.assert_allclose(run.rms_error, 1.0, atol=1e-8)
    np.testing.assert_allclose(run.global_error, 1.0, atol=1e-8)
    c = compare(x, 1.1220184543 * x, dt=DT)
    np.testing.assert_allclose(c.overall, 1.0, atol=1e-8)
    np.testing.assert_allclose(c.bands(3).error, 1.0, atol=1e-8)
    np.testing.assert_allclose(c.lines, 1.0, atol=1e-8)
    np.testing.assert_allclose(c.correlation, 1.0, rtol=1e-12)
    np.testing.assert_allclose(c.error, 0.1220184543, rtol=1e-9)


def test_quiet_stretches_do_not_count():
    rng = np.random.default_rng(1)
    x = np.concatenate([rng.standard_normal(2000), 1e-4 * rng.standard_normal(4000)])[:, None]
    wrong = x.copy()
    wrong[4000:] *= 10  # 20 dB too loud, where all is noise
    run = running_level(x, wrong, DT, 0.05)
    assert run.rms_error[0] < 1e-6
    assert run.error[-100:].min() == pytest.approx(20, abs=1e-9)


def test_decibels_have_a_floor_and_no_infinity():
    found = decibels([[0.0, 1.0], [1.0, 0.0]], [[0.0, 1.0], [10.0, 1.0]])
    np.testing.assert_allclose(found, [[0, 0], [-10, -200]])


def test_levels_over_bands_are_those_of_the_signals():
    t = np.arange(8192) / 4096
    m = np.sin(2 * np.pi * 100 * t) + np.sin(2 * np.pi * 400 * t)
    s = 2 * np.sin(2 * np.pi * 100 * t) + 0.5 * np.sin(2 * np.pi * 400 * t)
    banded = compare(m, s, dt=1 / 4096).bands(3)
    level = {n: (a[0], b[0], e[0]) for n, a, b, e in zip(banded.bands.names, banded.measured, banded.synthesised,
                                                         banded.error, strict=True)}  # fmt: skip
    assert level["100"] == pytest.approx((np.sqrt(0.5), np.sqrt(2), 6.0206), rel=1e-4)
    assert level["400"] == pytest.approx((np.sqrt(0.5), np.sqrt(0.125), -6.0206), rel=1e-4)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_errors_of_spectra_and_densities_do_not_depend_on_units(scale):
    rng = np.random.default_rng(2)
    f = np.arange(0, 1000, 2.5)
    m = rng.standard_normal((len(f), 3)) + 1j * rng.standard_normal((len(f), 3))
    s = m * rng.uniform(0.5, 2, m.shape)
    for a, b in ((m, s), (np.abs(m) ** 2, np.abs(s) ** 2)):
        one = compare(a, b, frequencies=f)
        two = compare(scale * a, scale * b, frequencies=f)
        for name in ("overall", "lines", "rms_lines", "global_lines", "error"):
            np.testing.assert_allclose(getattr(two, name), getattr(one, name), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(two.bands().error, one.bands().error, atol=1e-9)
    # densities of the same amplitudes err by the same number of dB at each line
    np.testing.assert_allclose(compare(m, s, frequencies=f).lines, one.lines, atol=1e-9)
    assert compare(np.abs(m), np.abs(s), frequencies=f).correlation is None


def test_the_global_error_weighs_by_the_square_of_the_density():
    m, s = np.array([[1.0, 3.0], [1.0, 1.0]]), np.array([[10.0, 3.0], [10.0, 0.1]])
    c = compare(m, s, frequencies=[10.0, 20.0])
    np.testing.assert_allclose(c.lines, [[10, 0], [10, -10]], atol=1e-12)
    np.testing.assert_allclose(c.global_lines, [(1 * 10 + 9 * 0) / 10, 0], atol=1e-12)
    np.testing.assert_allclose(c.rms_lines, [10, np.sqrt(50)])
    with pytest.raises(InputError, match="one unit"):
        _ = compare(m, s, frequencies=[10.0, 20.0], units=["m", "m/s"]).global_lines


def test_the_table_and_the_words_hold_the_numbers():
    f = np.arange(20, 200.0)
    m = np.ones((len(f), 2), complex)
    c = compare(m, m * [1.0, 10.0], frequencies=f, sensors=["left", "right"])
    assert "overall level off by at most 20.00 dB (right), FRAC at least 1.0000" in str(c)
    row = next(x for x in c.table(1).splitlines() if x.startswith("right"))
    assert row.split()[1:4] == ["+20.00", "20.00", "1.0000"]
    silent = compare(m, m * [1.0, 0.0], frequencies=f)
    assert silent.correlation.tolist() == pytest.approx([1, 0])
    assert silent.overall[1] == pytest.approx(-200)


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: running_rms([1.0, np.nan], DT, 1.0), "finite"),
        (lambda: running_rms([1.0], 0, 1.0), "positive"),
        (lambda: time_weighted([1.0], DT, "impulse"), "weighting"),
        (lambda: decibels([-1.0], [1.0]), "negative"),
        (lambda: decibels([1.0], [0.0]), "zero"),
        (lambda: decibels([1.0], [1.0, 2.0]), "fit"),
        (lambda: compare([1.0], [1.0]), "frequency or over time"),
        (lambda: compare([1.0], [1.0], frequencies=[1.0], dt=1.0), "frequency or over time"),
        (lambda: compare([1.0, 2.0], [1.0], dt=1.0), "fit"),
        (lambda: compare([0.0, 0.0], [1.0, 1.0], dt=1.0), "dead|zeros"),
        (lambda: compare([1.0, -1.0], [1.0, 1.0], frequencies=[1.0, 2.0]), "negative"),
        (lambda: compare([1.0, 1.0], [1.0, 1.0], frequencies=[2.0, 1.0]), "ascending"),
        (lambda: compare([1j, 1.0], [1.0, 1.0], frequencies=[1.0, 2.0]).running(), "histories"),
    ],
)
def test_bad_input_is_refused(call, match):
    with pytest.raises(InputError, match=match):
        call()
