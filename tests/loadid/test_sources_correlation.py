"""Correlation criteria against their definitions in loops, mass-orthogonal modes and closed forms."""

import numpy as np
import pytest

from loadid.sources import csac, csf, faac, frac, lac, mac, trac
from structures import InputError


def numbers(*shape, seed=0):
    rng = np.random.default_rng(seed)
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def test_mac_is_its_definition_one_pair_at_a_time():
    a, b = numbers(7, 3), numbers(7, 4, seed=1)
    expected = [
        [
            abs(sum(x.conjugate() * y for x, y in zip(p, q, strict=True))) ** 2
            / (sum(abs(x) ** 2 for x in p) * sum(abs(y) ** 2 for y in q))
            for q in b.T
        ]
        for p in a.T
    ]
    np.testing.assert_allclose(mac(a, b), expected, rtol=1e-12)


def test_mac_of_modes_weighted_by_mass_is_the_identity():
    from scipy.linalg import eigh

    masses = np.array([1.0, 5.0, 2.0, 0.3])
    K = np.diag([30.0, 25.0, 40.0, 20.0]) - np.diag([10.0, 15.0, 20.0], 1) - np.diag([10.0, 15.0, 20.0], -1)
    phi = eigh(K, np.diag(masses))[1]
    np.testing.assert_allclose(mac(phi, weights=masses), np.eye(4), atol=1e-20)
    assert np.max(mac(phi) - np.eye(4)) > 0.01  # without the masses they are not orthogonal


@pytest.mark.parametrize("factor", [1e-160, 1e-6, 1.0, 1e6, 1e160])
def test_scaled_copies_correlate_fully_and_nothing_depends_on_units(factor):
    a, b = numbers(50, 4), numbers(50, 4, seed=1)
    turned = factor * np.exp(0.7j)
    np.testing.assert_allclose(np.diag(mac(a, turned * a)), 1, rtol=1e-12)
    np.testing.assert_allclose(frac(a, turned * a), 1, rtol=1e-12)
    np.testing.assert_allclose(csac(a, turned * a), 1, rtol=1e-12)
    np.testing.assert_allclose(trac(a.real, -factor * a.real), 1, rtol=1e-12)
    np.testing.assert_allclose(frac(factor * a, b), frac(a, b), rtol=1e-9)
    np.testing.assert_allclose(faac(factor * a, factor * b), faac(a, b), rtol=1e-9)
    np.testing.assert_allclose(csf(factor * a, factor * b), csf(a, b), rtol=1e-9)
    np.testing.assert_allclose(lac(factor * a, factor * b), lac(a, b), rtol=1e-9)


def test_what_has_nothing_in_common_gives_zero():
    t = np.arange(1000) / 1000
    sine, cosine = np.sin(2 * np.pi * 5 * t), np.cos(2 * np.pi * 5 * t)
    assert trac(sine, cosine) == pytest.approx(0, abs=1e-25)
    assert mac(np.eye(3)) == pytest.approx(np.eye(3))
    assert frac([1, 1j], [1j, 1]) == pytest.approx(0, abs=1e-30)


@pytest.mark.parametrize("phase", [0.0, 0.3, 1.2])
def test_trac_of_a_delayed_sine_is_the_squared_cosine_of_its_phase(phase):
    t = 2 * np.pi * 7 * np.arange(4000) / 4000
    assert trac(np.sin(t), 5 * np.sin(t - phase)) == pytest.approx(np.cos(phase) ** 2, rel=1e-9)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0])
def test_criteria_of_amplitude_see_the_gain(ratio):
    a = numbers(30, 2)
    expected = 2 * ratio / (1 + ratio**2)
    np.testing.assert_allclose(faac(a, ratio * 1j * a), expected, rtol=1e-12)
    np.testing.assert_allclose(csf(a, ratio * 1j * a), expected, rtol=1e-12)
    np.testing.assert_allclose(lac(a, -ratio * a), expected, rtol=1e-12)


def test_criteria_over_lines_and_over_pairs_are_the_same_sum_the_other_way():
    a, b = numbers(12, 5), numbers(12, 5, seed=1)
    np.testing.assert_allclose(csac(a, b), np.diag(mac(a.T, b.T)), rtol=1e-12)
    np.testing.assert_allclose(frac(a, b), csac(a.T, b.T), rtol=1e-12)
    cube = numbers(6, 2, 3), numbers(6, 2, 3, seed=1)
    assert frac(*cube).shape == (2, 3)
    assert csac(*cube).shape == (6,)
    assert lac(np.zeros(2), np.zeros(2)).tolist() == [1, 1]


@pytest.mark.parametrize(
    ("call", "match"),
    [
        (lambda: mac(np.eye(3), np.eye(4)), "fit"),
        (lambda: mac([[1.0, 0.0], [1.0, 0.0]]), "zero throughout"),
        (lambda: mac(np.eye(2), weights=[1.0, -1.0]), "positive"),
        (lambda: mac([1.0, np.nan]), "finite"),
        (lambda: frac(np.ones(3), np.zeros(3)), "zero throughout"),
        (lambda: frac(np.ones(3), np.ones(4)), "fit"),
        (lambda: faac(np.zeros(3), np.zeros(3)), "zero throughout"),
        (lambda: trac(np.ones(3) * 1j, np.ones(3)), "real"),
        (lambda: csac(np.ones((2, 2)), [[1, 1], [0, 0]]), "zero throughout"),
        (lambda: lac(["a"], ["b"]), "finite"),
    ],
)
def test_bad_input_is_refused(call, match):
    with pytest.raises(InputError, match=match):
        call()
