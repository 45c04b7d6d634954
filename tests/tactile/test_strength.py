"""Lambda goes with the size of a press, from frame to frame."""

from __future__ import annotations

import numpy as np
import pytest

from tactile import Markers, MultilayerPad
from tactile._sensors.strength import MOST, STEP, PressStrength

from .rigs import NOISE, markers, motion, pad


def test_the_size_of_a_frame_is_found_whatever_its_axes() -> None:
    rng = np.random.default_rng(0)
    w, V = np.geomspace(1.0, 1e6, 200), np.linalg.qr(rng.standard_normal((200, 200)))[0]

    def drawn(size: float) -> np.ndarray:
        return np.asarray(V @ (rng.standard_normal(200) * np.sqrt(size**2 * w + 1)))

    known = PressStrength.of((V * w) @ V.T, [drawn(0.1) for _ in range(3)])
    assert known.usual == pytest.approx(10.0, rel=0.2)
    for size in (0.1, 0.02, 0.5):
        assert known.steps(drawn(size)) == pytest.approx(np.log(0.1 / size) / np.log(STEP), abs=1.0)
    assert known.steps(rng.standard_normal(200)) == MOST  # nothing but noise


def test_lambda_goes_with_a_press_and_a_number_stays() -> None:
    rng, y = np.random.default_rng(1), motion(1)
    weak = 0.15 * y + NOISE * rng.standard_normal(y.shape)
    s = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"))
    lam = s.calibrate([y, motion(2)]).lam
    assert s.estimate(y).facts.lam == pytest.approx(lam, rel=1.1 * (STEP - 1))
    found, one = s.estimate(weak), s.follow(weak)
    assert found.facts.lam > 2 * lam
    assert one.facts.lam == lam  # of frames in a loop
    gone = weak.copy()
    gone[::9] = np.nan  # lost markers do not change what a press is
    assert s.estimate(gone).facts.lam == pytest.approx(found.facts.lam, rel=1.1 * (STEP - 1))
    still = MultilayerPad(pad(), Markers(markers(), NOISE, "XYZ"), choice=0.03)
    assert still.estimate(weak).facts.lam == still.estimate(y).facts.lam == 0.03
