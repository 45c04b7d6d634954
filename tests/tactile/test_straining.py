"""Strain beyond the linear range is said for every frame, and costs a solve only where it must."""

from __future__ import annotations

import numpy as np
import pytest

from tactile.straining import StrainWatch

from .rigs import motion, nodal, pad, sensor


def test_it_says_what_a_solve_says_of_every_frame() -> None:
    watch, unit = StrainWatch(pad()), np.abs(pad().strain(nodal())).max()
    for factor in (0.01, 0.012, 0.05, 0.09 / unit, 0.11 / unit, 0.13 / unit, 0.02 / unit):
        found = watch.check(factor * nodal())
        assert (found is not None) == (factor * unit > 0.1)
        if found is not None:
            assert found.evidence.value == pytest.approx(factor * unit, rel=1e-9)


def test_frames_alike_cost_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    watch, solved, before = StrainWatch(pad()), [], type(pad()).strain
    monkeypatch.setattr(type(pad()), "strain", lambda self, f: solved.append(1) or before(self, f))
    for factor in np.linspace(0.1, 0.13, 20):
        watch.check(factor * nodal())
    assert len(solved) == 1
    watch.check(0 * nodal())
    assert len(solved) == 1


def test_sensors_say_it() -> None:
    assert "W112" in sensor().estimate(motion(1)).codes  # a newton on a soft pad: 0.4 mm of motion in 3 mm
    assert "W112" not in sensor().estimate(0.1 * motion(1)).codes
