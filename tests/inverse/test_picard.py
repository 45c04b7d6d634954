"""The plateau of the data coefficients against known signals in known noise; laws of decay against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid._inverse.diagnosis.picard import decay, plateau
from structures.errors import InputError

R = 60
I = np.arange(1, R + 1)  # noqa: E741
# level of the signal, level of the noise, where they meet
CASES = {
    "exponential": (0.8**I, 0.8**20.5, 20),
    "fast": (0.5**I, 0.5**12.5, 12),
    "gaussian": (np.exp(-((I / 8.0) ** 2)), float(np.exp(-((18.5 / 8) ** 2))), 18),
    "algebraic": (I**-2.0, 9.5**-2, 9),
}


def coefficients(name: str, seed: int, noise: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    signal, level, _ = CASES[name]
    return signal * rng.standard_normal(R) + noise * level * rng.standard_normal(R)


@pytest.mark.parametrize("name", CASES)
def test_the_plateau_is_found_within_a_few_modes_on_most_draws(name: str) -> None:
    _, level, true = CASES[name]
    found = [plateau(coefficients(name, seed)) for seed in range(24)]
    off = np.array([p.start - true for p in found])
    assert abs(np.median(off)) <= 3, off
    assert np.mean(np.abs(off) <= max(4, 0.35 * true)) >= 0.8, off
    assert np.median([p.floor for p in found]) == pytest.approx(level, rel=0.3)


def test_data_that_are_all_noise_hold_no_mode() -> None:
    starts = [plateau(np.random.default_rng(seed).standard_normal(R)).start for seed in range(40)]
    assert np.mean(np.array(starts) == 0) >= 0.95
    assert plateau(np.zeros(20)).start == 0


@pytest.mark.parametrize("name", ["exponential", "fast", "gaussian"])
def test_data_without_noise_hold_every_mode(name: str) -> None:
    assert plateau(CASES[name][0][:40]).start == 40
    assert plateau(CASES[name][0][:40]).floor == 0.0


def test_what_no_load_can_cause_tells_slow_decay_from_noise() -> None:
    b = 1.0 / np.arange(1, 31)
    assert plateau(b, rest=(1e-20, 30)).start == 30  # nothing outside the range: all of it is signal
    noisy = [plateau(b + 0.1 * np.random.default_rng(k).standard_normal(30), rest=(0.3, 30)).start for k in range(20)]
    assert 3 <= np.median(noisy) <= 13  # signal and noise meet at mode 10


def test_frames_sharpen_the_plateau() -> None:
    signal, level, true = CASES["exponential"]

    def spread(frames: int) -> float:
        off = []
        for seed in range(12):
            rng = np.random.default_rng(seed)
            B = signal[:, None] * rng.standard_normal((R, frames)) + level * rng.standard_normal((R, frames))
            off.append(plateau(np.sqrt(np.mean(B**2, axis=1)), frames=frames).start - true)
        return float(np.sqrt(np.mean(np.square(off))))

    assert spread(8) < 0.75 * spread(1)


@settings(max_examples=12, deadline=None)
@given(st.floats(-200, 200), st.integers(0, 50))
def test_the_plateau_is_scale_free(decades: float, seed: int) -> None:
    b = coefficients("exponential", seed)
    scaled = plateau(b * 10**decades)
    assert scaled.start == plateau(b).start
    assert scaled.floor == pytest.approx(plateau(b).floor * 10**decades, rel=1e-6)


def test_symmetric_loads_whose_every_second_coefficient_vanishes() -> None:
    signal, level, true = CASES["exponential"]
    off = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        off.append(plateau(signal * (I % 2) + level * rng.standard_normal(R)).start - true)
    assert abs(np.median(off)) <= 4


def test_many_modes_are_taken_together() -> None:
    rng = np.random.default_rng(0)
    i = np.arange(1, 2001)
    b = 0.99**i * rng.standard_normal(2000) + 0.99**600 * rng.standard_normal(2000)
    assert plateau(b).start == pytest.approx(600, abs=60)


def test_too_few_coefficients_have_no_plateau() -> None:
    assert plateau([3.0, 2.0, 1.0]).start == 3


@pytest.mark.parametrize("bad", [np.ones((3, 3)), np.array([1.0, np.nan])])
def test_no_coefficients_are_refused(bad: np.ndarray) -> None:
    with pytest.raises(InputError, match="no data coefficients"):
        plateau(bad)


# -- laws of decay ----------------------------------------------------------------------------------------------------
def circulant(kernel: np.ndarray) -> np.ndarray:
    return np.sort(np.abs(np.fft.fft(kernel)))[::-1]


def periodic(n: int = 2048) -> np.ndarray:
    return np.minimum(np.arange(n), n - np.arange(n)) / n


W = 0.02
KERNELS = {
    "gaussian": (circulant(np.exp(-0.5 * (periodic() / W) ** 2)), np.sqrt(np.log(1e4) / np.log(100)), 1.42),
    "exponential": (circulant(W / (W**2 + periodic() ** 2)), np.log(1e4) / np.log(100), 2.03),
    "algebraic": (np.arange(1.0, 4000) ** -2, 10.0, 10.0),
}


@pytest.mark.parametrize("law", KERNELS)
def test_the_law_is_named_and_what_snr_buys_follows(law: str) -> None:
    values, expected, counted = KERNELS[law]
    found = decay(values)
    assert found.law == law
    assert found.r2 > 0.99
    assert found.buys(100, 100) == pytest.approx(expected, rel=0.03)
    above = [np.sum(values >= values[0] / snr) for snr in (100, 1e4)]
    assert above[1] / above[0] == pytest.approx(counted, rel=0.03)  # the fit says what counting says
    assert law in str(found) or "Gaussian" in str(found) or "k^-" in str(found)


@pytest.mark.parametrize("p", [1.0, 2.0, 3.5])
def test_the_power_of_an_algebraic_law(p: float) -> None:
    found = decay(np.arange(1.0, 300) ** -p)
    assert (found.law, found.rate) == ("algebraic", pytest.approx(p, rel=1e-6))
    assert found.buys(100) == pytest.approx(100 ** (1 / p))


def test_the_compliant_surface_of_48_nodes_decays_exponentially() -> None:
    x = (np.arange(48) + 0.5) / 48
    s = np.linalg.svd((0.1 / np.pi) / (0.1**2 + (x[:, None] - x) ** 2) / 48, compute_uv=False)
    assert s[0] == pytest.approx(0.81, abs=0.005)
    assert s[-1] == pytest.approx(6.0e-7, rel=0.01)
    assert s[0] / s[-1] == pytest.approx(1.4e6, rel=0.03)
    found = decay(s)
    assert found.law == "exponential"
    assert found.rate == pytest.approx(0.1 * np.pi, rel=0.05)  # exp(-t k) with k = i pi over unit length


def test_on_a_surface_waves_are_counted_and_not_modes() -> None:
    k = np.sqrt(np.arange(1, 400))  # k^2 modes of up to k waves
    found = decay(np.exp(-0.3 * k**2), dimension=2)
    assert (found.law, found.rate) == ("gaussian", pytest.approx(0.3))
    assert decay(np.exp(-0.3 * k**2)).law == "exponential"


def test_rounding_is_left_out_and_few_values_have_no_law() -> None:
    s = np.concatenate([0.5 ** np.arange(30), np.full(30, 1e-17)])
    assert decay(s).values <= 30
    assert decay(s).law == "exponential"
    assert decay([3.0, 2.0, 1.0]).law == "unknown"
    assert np.isnan(decay([3.0, 2.0, 1.0]).buys())
    assert decay(5 * s).rate == pytest.approx(decay(s).rate)
    with pytest.raises(InputError, match="no singular values"):
        decay([1.0, np.inf])
