"""Strain beyond the linear range is said for every frame, and costs a solve only now and then."""

from __future__ import annotations

import threading
import time

import numpy as np
import pytest

from tactile._sensors.posing import REST, StrainWatch

from .rigs import motion, nodal, pad, sensor


def test_maps_of_one_shape_are_judged_as_a_solve_would() -> None:
    watch, unit = StrainWatch(pad()), np.abs(pad().strain(nodal())).max()
    for factor in (0.01, 0.012, 0.05, 0.09 / unit, 0.11 / unit, 0.13 / unit, 0.02 / unit):
        found = watch.check(factor * nodal())
        assert (found is not None) == (factor * unit > 0.1)
        if found is not None:
            assert found.evidence.value == pytest.approx(factor * unit, rel=1e-9)


def test_another_shape_is_solved_for_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    watch, solved, before = StrainWatch(pad()), [], type(pad()).strain
    monkeypatch.setattr(type(pad()), "strain", lambda self, f: solved.append(1) or before(self, f))
    for _ in range(3 * REST):
        watch.check(0.1 * nodal())
    assert len(solved) == 1
    point = np.zeros_like(nodal())
    point[pad().points // 2, 2] = -0.02
    for _ in range(REST + 2):
        found = watch.check(point)
    assert len(solved) <= 3
    assert (found is not None) == (np.abs(before(pad(), point)).max() > 0.1)
    assert watch.check(0 * point) is None


def test_a_frame_of_noise_does_not_speak_for_the_press() -> None:
    watch, rng = StrainWatch(pad()), np.random.default_rng(0)
    assert watch.check(1e-5 * rng.standard_normal(nodal().shape)) is None
    unit = np.abs(pad().strain(nodal())).max()
    assert watch.check(0.09 / unit * nodal()) is None
    assert watch.check(0.11 / unit * nodal()) is not None


def test_sensors_say_it() -> None:
    assert "W112" in sensor().estimate(motion(1)).codes  # a newton on a soft pad: 0.4 mm of motion in 3 mm
    assert "W112" not in sensor().estimate(0.1 * motion(1)).codes


def test_a_loop_does_not_wait_for_a_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside a loop a solve takes its time; when it is done, W112 has its strain."""
    watch, before, free = StrainWatch(pad()), type(pad()).strain, threading.Event()
    press = np.roll(nodal(), 7, axis=0)
    strain = np.abs(pad().strain(press)).max()
    press, strain = press * 0.2 / strain, 0.2
    assert watch.check(1e-3 * nodal()) is None  # the first is waited for
    watch.beside = True
    monkeypatch.setattr(type(pad()), "strain", lambda self, forces: free.wait(30) and before(self, forces))
    first = watch.check(press)  # by the shape of the other, at once
    assert first is None or first.evidence.value != pytest.approx(strain, rel=1e-9)
    free.set()
    until = time.monotonic() + 30
    while (found := watch.check(press)) is None or found.evidence.value != pytest.approx(strain, rel=1e-9):
        assert time.monotonic() < until
        time.sleep(0.01)
