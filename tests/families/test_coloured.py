"""Measured models on the paths in time: their noise, which differs from line to line, made white."""

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, NoiseSource
from loadid._families.data import gather
from loadid._families.posing import PosingSettings
from loadid._families.posing.paths import coloured
from loadid.settings import Noise, Penalty
from structures import MeasuredModel

DT, N = 1e-3, 1024


@pytest.fixture(scope="module")
def case():
    n, rng = np.arange(N), np.random.default_rng(0)
    h = 0.97**n * np.sin(0.3 * (n + 1))
    model = MeasuredModel.from_frf(np.fft.rfftfreq(2 * N, DT), np.fft.rfft(h, 2 * N)[:, None, None], kind="receptance")
    g = np.zeros((N, 1))
    g[100:120, 0] = np.hanning(20)
    white = rng.standard_normal(N)
    noise = 0.2 * np.convolve(white, 0.9**n)[:N]  # strong at low frequencies
    return model, h, g, np.convolve(h, g[:, 0])[:N][:, None] + noise[:, None]


def test_what_is_known_of_the_noise_is_white_afterwards(case):
    model, h, _, y = case
    data = gather(y, DT, model, None)
    found = coloured(model, data, PosingSettings(Noise(0.5, NoiseSource("stated")), Lambda(), Penalty(), ()))
    assert found.raw[:, 0, 0] == pytest.approx(h, abs=1e-9)
    assert found.h[:, 0, 0] == pytest.approx(h / 0.5, abs=1e-6)  # the same level on all lines: nothing but a factor
    assert found.y == pytest.approx(y / 0.5, abs=1e-6)


def test_a_record_that_ends_in_motion(case):
    g = case[2]
    n = np.arange(N)
    h = 0.999**n * np.sin(0.3 * (n + 1))
    lively = MeasuredModel.from_frf(np.fft.rfftfreq(2 * N, DT), np.fft.rfft(h, 2 * N)[:, None, None], kind="receptance")
    load = g + 0.5 * np.sin(n / 40)[:, None]
    y = np.convolve(h, load[:, 0])[:N][:, None]
    y = y + 0.01 * y.std() * np.random.default_rng(1).standard_normal(y.shape)
    error = {
        path: np.linalg.norm(
            Deconvolution(lively, noise=0.01 * y.std(), choice=Lambda(path=path)).estimate(y, dt=DT).load - load
        )
        for path in ("fft", "toeplitz")
    }
    assert error["toeplitz"] < 0.7 * error["fft"]  # the ends of the record
