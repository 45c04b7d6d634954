"""Commands alone, from hammer hits to a force: ``loadid modes``, then ``loadid identify`` and ``loadid track``.

The structure is a clamped beam of 48 elements with two dashpots, assembled and solved line by line in numpy, and never
seen by the inversion: its model is the modes of five hits.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import loadid
from loadid import cli
from structures.files._modelfile import load_model
from tests.benchmarks.modes import Real, beam

ELEMENTS, DT, LONG = 48, 1 / 2000, 8192
PLACES = (1.0, 0.75, 0.5)  # of the length; the hammer hits the first
NAMES = ["F [N]", "tip [m/s^2]", "upper [m/s^2]", "middle [m]"]
NOISE = 0.005  # of the rms of each sensor


@cache
def answers() -> Any:
    """FRFs (lines, sensors) of a force at the tip: two accelerations and a displacement."""
    K, M, C = beam(ELEMENTS)
    at = [2 * round(ELEMENTS * x) - 2 for x in PLACES]
    push, f = np.eye(len(K))[at[0]], np.fft.rfftfreq(2 * LONG, DT)
    w = 2 * np.pi * f[f < 700]  # no force has more
    H = np.zeros((len(f), 3), complex)
    for start in range(0, len(w), 512):
        own = w[start : start + 512, None, None]
        H[start : start + len(own)] = np.linalg.solve(K - own**2 * M + 1j * own * C, push[:, None])[:, at, 0]
    H[:, :2] *= -((2 * np.pi * f[:, None]) ** 2)
    return H


def pulse(at: float, width: float, size: float) -> Real:
    """A smooth hit of a hammer at `at` s, `width` s wide."""
    return np.asarray(size * np.exp(-0.5 * ((np.arange(LONG) * DT - at) / width) ** 2))


def write(path: Path, H: Any, force: Real, seed: int, samples: int, *, seen: bool = True) -> None:
    """A log of force and sensors, or of the sensors alone."""
    y = np.fft.irfft(H * np.fft.rfft(force, 2 * LONG)[:, None], 2 * LONG, axis=0)[:LONG]
    y += NOISE * y.std(axis=0) * np.random.default_rng(seed).standard_normal(y.shape)
    columns, names = (np.column_stack([force, y]), NAMES) if seen else (y, NAMES[1:])
    rows = np.column_stack([np.arange(samples) * DT, columns[:samples]])
    np.savetxt(path, rows, delimiter=",", header=",".join(["time [s]", *names]), comments="", fmt="%.9g")


def slow(seed: int) -> Real:
    """A force of 20 N rms that begins at rest and has little above 50 Hz."""
    f, rng = np.fft.rfftfreq(LONG, DT), np.random.default_rng(seed)
    force = np.fft.irfft(np.fft.rfft(rng.standard_normal(LONG)) * np.exp(-0.5 * (f / 25) ** 2), LONG)
    return np.asarray(20 * force / force.std() * np.clip(np.arange(LONG) * DT / 0.2, 0, 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: Any) -> Path:
    """Five hits of the tip, the model that ``loadid modes`` makes of them, and logs of forces that it never saw."""
    where, H = tmp_path_factory.mktemp("force"), answers()
    for k in range(5):
        write(where / f"hit{k}.csv", H, pulse(0.1, 8e-4, 80 + 10 * k), k, 6000)
    write(where / "two.csv", H, pulse(0.15, 1.5e-3, 60) + pulse(0.42, 2e-3, 35), 20, 1600)
    write(where / "fit.csv", H, slow(9), 21, 2000, seen=False)
    write(where / "today.csv", H, slow(10), 22, 3000, seen=False)
    hits = [str(where / f"hit{k}.csv") for k in range(5)]
    words = ["--force", "F", "--response", "tip,upper,middle", "--driven", "tip,F", "--band", "3:300", "-q"]
    assert cli.main(["modes", *hits, *words, "-o", str(where / "modes.h5")]) == 0
    return where


def test_the_model_of_hits_is_the_structure(folder: Path) -> None:
    """Between the peaks too, where errors of lines without energy once leaked: 5 to 15 %."""
    f, model = np.fft.rfftfreq(2 * LONG, DT), load_model(folder / "modes.h5")
    own = (f > 10) & (f < 280)
    off = np.linalg.norm(model.frf(f[own])[..., 0] - answers()[own], axis=0)
    assert np.all(off[:2] < 0.005 * np.linalg.norm(answers()[own][:, :2], axis=0))  # 0.1 %
    assert np.all(np.isfinite(model.frf_variance([0.0, 1.0, 100.0])))


def test_two_hits_of_a_log(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    monkeypatch.chdir(folder)
    assert cli.main(["identify", "two.csv", "--model", "modes.h5", "-o", "force.h5"]) == 0, capsys.readouterr().err
    load = loadid.load("force.h5").load[:, 0]
    given = (pulse(0.15, 1.5e-3, 60) + pulse(0.42, 2e-3, 35))[: len(load)]
    assert np.linalg.norm(load - given) < 0.03 * np.linalg.norm(given)  # 1.0 %


def test_a_slow_force_is_tracked(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """The displacement tells the force down to rest, accelerations the hits in it."""
    monkeypatch.chdir(folder)
    words = "track --idle 0 --model modes.h5 --fit fit.csv --in today.csv --out loads.csv"
    assert cli.main(words.split()) == 0, capsys.readouterr().err
    load = np.genfromtxt("loads.csv", delimiter=",", skip_header=1)[:, 1]
    given = slow(10)[: len(load)]
    assert np.linalg.norm(load - given) < 0.05 * np.linalg.norm(given)  # 1.2 %
