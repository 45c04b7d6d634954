"""Bands of a track: spectra of its error and of its prior, against variances, long runs and a closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import Ambient
from loadid._families.tracking.certificate import banded, certify, in_words, spectra, told_bands
from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.model import FilterModel
from loadid._inverse.gaussian.steady import SteadyFilter, steady
from loadid.priors import Matern32, RandomWalk
from tests.families.test_tracking import building

DT = 0.01


@cache
def settled(noise: float = 1.0, walk: bool = False, hold: str = "joint", ambient: bool = False) -> SteadyFilter:
    model = building(at=(10, 5), disp=(10, 5))
    around = Ambient(model, 3.0) if ambient else None
    prior = RandomWalk(1000.0) if walk else Matern32(100.0, 0.08)
    sd = noise * np.array([1.0, 1.0, 1.0, 0.01, 0.01])
    return steady(augment(model, DT, [prior, Matern32(40.0, 0.2)], noise=sd, hold=hold, ambient=around), DT)


@pytest.mark.parametrize("ambient", [False, True])
def test_over_all_frequencies_they_are_the_variances(ambient):
    found = settled(ambient=ambient, hold="foh" if ambient else "joint")
    turns = 2 * np.pi * (np.arange(8192) + 0.5) / 8192
    error, prior = (part.mean(axis=0) for part in spectra(found, turns))
    assert np.sqrt(error) == pytest.approx(found.std, rel=1e-6)
    assert np.sqrt(prior) == pytest.approx([100.0, 40.0], rel=1e-6)


def test_a_load_that_a_sensor_shows_alone():
    """One static sensor of an OU load: the classical scalar filter, by hand."""
    length, sd, noise = 0.5, 2.0, 3.0
    f = np.exp(-DT / length)
    q = sd * np.sqrt(1 - f**2)
    one = np.eye(1)
    model = FilterModel(F=f * one, LQ=q * one, H=one, LR=noise * one, Cp=one, x0=np.zeros(1), L0=sd * one, nx=0)
    found = steady(model, DT)
    turns = np.linspace(0.01, np.pi, 50)
    P = found.std[0] ** 2
    k = P / noise**2
    gain = 1 / np.abs(1 - (1 - k) * f * np.exp(-1j * turns)) ** 2
    error, prior = spectra(found, turns)
    assert error[:, 0] == pytest.approx(gain * ((1 - k) ** 2 * q**2 + k**2 * noise**2), rel=1e-9)
    assert prior[:, 0] == pytest.approx(q**2 / np.abs(1 - f * np.exp(-1j * turns)) ** 2, rel=1e-9)
    (bands,) = told_bands(found, DT)
    crossing = turns[np.argmax(error[:, 0] > prior[:, 0])] / (2 * np.pi * DT)
    assert bands[0][0] == 0.0
    assert bands[-1][1] == pytest.approx(crossing, abs=turns[1] / (2 * np.pi * DT))


def test_less_noise_widens_the_band_and_words_say_it():
    quiet, loud = (told_bands(settled(noise), DT)[0] for noise in (0.3, 30.0))
    assert quiet[0][0] == loud[0][0] == 0.0
    assert sum(b - a for a, b in quiet) > sum(b - a for a, b in loud) > 0
    said = banded(certify(np.zeros((50, 5)), np.zeros(50), [None] * 5, "abcde", 1.0), settled(30.0), ("p", "q"), DT)
    assert f"p: the data tell more than the prior from 0 to {loud[-1][1]:.3g} Hz" in str(said)
    assert "elsewhere the track is its prior" in str(said)
    assert in_words((), 50.0).startswith("at no frequency")
    everywhere = told_bands(settled(0.01), DT)[0]
    assert "all frequencies" in in_words(everywhere, 0.5 / DT)
    assert told_bands(settled(walk=True), DT)[0][0][0] == 0.0  # a walk knows nothing of a constant


def test_bands_do_not_depend_on_units():
    found = settled()
    m = found.model
    small = FilterModel(m.F, m.LQ, 1e-6 * m.H, 1e-6 * m.LR, 1e6 * m.Cp, m.x0, m.L0, m.nx)
    assert told_bands(steady(small, DT), DT) == told_bands(found, DT)
