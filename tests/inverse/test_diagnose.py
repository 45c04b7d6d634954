"""Diagnostics: conditioning with its rank, widths of known shapes, resolution of known operators."""

import numpy as np
import pytest
import scipy.linalg

from loadid.inverse import diagnose
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath
from loadid.inverse.toeplitz import SpectralPath, toeplitz
from structures.spectra import padded_length

FWHM = 2 * np.sqrt(2 * np.log(2))


@pytest.mark.parametrize("std", [1.0, 2.5, 7.0])
@pytest.mark.parametrize("centre", [40, 43])
def test_width_of_a_gaussian(std: float, centre: int) -> None:
    t = np.arange(100)
    spread = -3 * np.exp(-0.5 * ((t - centre) / std) ** 2)
    assert diagnose.width(spread, centre) == pytest.approx(FWHM * std, rel=0.06)  # linear between samples


def test_width_is_local_at_least_one_sample_and_at_most_what_is_there() -> None:
    spike = np.zeros(20)
    spike[7] = 2.0
    assert diagnose.width(spike, 7) == 1.0
    two = spike.copy()
    two[15] = 2.0  # a second peak far away does not widen the first
    assert diagnose.width(two, 7) == 1.0
    assert diagnose.width(np.ones(20), 7) == 21.0


def test_layout_tells_lost_modes_from_a_better_condition() -> None:
    s = np.array([10.0, 5.0, 1e-3])
    assert diagnose.layout(s, 3) == (pytest.approx(1e4), 3, 0)
    kappa, rank, nullity = diagnose.layout(np.array([10.0, 5.0, 1e-17]), 4)  # kappa fell because a mode was lost
    assert (kappa, rank, nullity) == (pytest.approx(2.0), 2, 2)


def gaussian(n: int, std: float) -> np.ndarray:
    t = np.arange(n)
    return scipy.linalg.toeplitz(np.exp(-0.5 * (t / std) ** 2))


def test_resolution_follows_the_blur_and_the_noise() -> None:
    load = np.zeros((80, 1))
    load[33] = 1.0
    path = SVDPath(LinearProblem.whitened(gaussian(80, 3.0), gaussian(80, 3.0) @ load[:, 0], shape=(80, 1)))
    widths, losses = zip(*(diagnose.resolution(path, lam, load) for lam in (1e-6, 1e-3, 0.1, 0.9)), strict=True)
    assert list(widths) == sorted(widths)
    assert list(losses) == sorted(losses)
    assert widths[-1] == pytest.approx(np.sqrt(2) * 3.0 * FWHM, rel=0.15)  # large lambda: the blur twice
    assert 0 <= losses[0] < losses[-1] < 1
    sharp = SVDPath(LinearProblem.whitened(np.eye(80), load[:, 0], shape=(80, 1)))
    assert diagnose.resolution(sharp, 1e-6, load) == (1.0, pytest.approx(0, abs=1e-9))


def test_resolution_is_the_same_on_both_paths() -> None:
    n = 120
    h = np.exp(-0.5 * ((np.arange(n) - 8) / 2.0) ** 2)[:, None, None]
    padded = padded_length(n)
    load = np.zeros((n, 1))
    load[50] = 2.0
    y = (toeplitz(h) @ load[:, 0]).reshape(n, 1)
    dense = SVDPath(LinearProblem.whitened(toeplitz(h), y, shape=(n, 1)))
    fast = SpectralPath(np.fft.rfft(h, padded, axis=0), y, np.full((padded // 2 + 1, 1), float(n)))
    for lam in (0.01, 0.2):
        a = diagnose.resolution(dense, lam, load)
        b = diagnose.resolution(fast, lam * float(dense.scale / fast.scale), load)
        np.testing.assert_allclose(b, a, rtol=0.01)


def test_resolution_of_two_loads_looks_at_the_larger() -> None:
    H = np.zeros((30, 30))
    H[:15, 0::2], H[15:, 1::2] = np.eye(15), gaussian(15, 2.0)  # first load sharp, second blurred
    load = np.zeros((15, 2))
    load[7] = [1.0, 0.5]
    path = SVDPath(LinearProblem.whitened(H, H @ load.ravel(), shape=(15, 2)))
    assert diagnose.resolution(path, 0.05, load)[0] == 1.0
    assert diagnose.resolution(path, 0.05, load[:, ::-1])[0] > 2.0
