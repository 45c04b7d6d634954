"""Deconvolution of long records in windows: the load of one piece within the bound, which is printed and judged."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Deconvolution, calibrate, read
from loadid._spellings import folded
from structures import ImpulseModel

from ..data import measured

DT = 1e-3


def case(samples, damping=0.02, taps=3000):
    """Model of one mode, record of pulses, and its noise level."""
    t = np.arange(taps)
    h = np.exp(-damping * 0.3 * t) * np.sin(0.3 * (t + 1))
    g = np.zeros(samples)
    for k in range(100, samples - 30, 1500):
        g[k : k + 30] = np.hanning(30)
    y = np.convolve(g, h)[:samples]
    noise = 0.01 * y.std()
    return (
        ImpulseModel(h, DT, kind="held"),
        (y + noise * np.random.default_rng(1).standard_normal(samples))[:, None],
        noise,
    )


def both(model, y, dt=DT, **settings):
    """Estimates in one piece and in windows, and the norm of their difference over that of the std."""
    a, b = (
        Deconvolution(model, **folded(Deconvolution, {"path": path, **settings})).estimate(y, dt)
        for path in ("toeplitz", "windows")
    )
    return a, b, float(np.linalg.norm(b.load - a.load) / np.linalg.norm(a.std))


@pytest.mark.parametrize("penalty", ["identity", "first_difference"])
def test_the_load_is_that_of_one_piece_within_the_bound(penalty):
    model, y, noise = case(9000)
    told: list[float] = []
    settings = {"noise": noise, "penalty": penalty, "choice": 0.01 if penalty == "identity" else 1e-4}
    a, b, off = both(model, y, **settings, progress=lambda f, text: told.append(f))
    assert off <= b.facts["window_bound"] < 0.01
    assert b.std == pytest.approx(a.std, rel=1e-3)
    assert b.residual == pytest.approx(a.residual, abs=1e-3 * noise)
    assert b.facts["edf"] == pytest.approx(a.facts["edf"], rel=1e-3)
    assert b.facts["path"] == "Toeplitz, in windows"
    assert "window_bound" not in a.facts
    assert "W410" not in b.codes
    assert "bound on the error of solving in windows" in b.summary(details=True)
    windows = [f for f in told if 0.9 < f < 1.0]
    assert len(windows) >= 2  # one call for each window
    assert windows == sorted(windows)


def test_windows_that_remember_too_much_are_said():
    model, y, noise = case(9000)
    _, b, off = both(model, y, noise=noise, penalty="second_difference", choice=1e-2)
    flag = next(f for f in b.flags if f.code == "LID-W410")
    assert flag.evidence.value == b.facts["window_bound"] > 0.01
    assert off <= b.facts["window_bound"]
    assert "toeplitz" in flag.advice


def test_long_records_go_by_windows():
    model, y, noise = case(52_000)
    found = Deconvolution(model, noise=noise, choice=0.01).estimate(y, DT)
    assert found.facts["path"] == "Toeplitz, in windows"
    assert found.facts["window_bound"] < 0.01
    short = Deconvolution(model, noise=noise, choice=0.01).estimate(y[:3000], DT)
    assert short.facts["path"] == "Toeplitz, preconditioned CG"


def test_a_measured_model():
    """Two hits one after the other behind measured FRFs, whose tails end in noise: the bound is wide, and is said."""
    paths = [measured("hammer_five_hits", f"measurements_{i}.npy") for i in range(1, 6)]
    told = {"columns": ("time", "force", "acceleration"), "units": {"force": "N", "acceleration": "m/s^2"}}
    model = calibrate(paths[:4], force="force", responses=["acceleration"], **told)
    record = read(paths[4], **told)
    y = np.tile(record.select(["acceleration"]).values[:3500], (2, 1))
    _, b, off = both(model, y, record.dt, choice=0.05)
    assert off <= b.facts["window_bound"]
    assert off < 0.5
    assert ("W410" in b.codes) == (b.facts["window_bound"] > 0.01)
