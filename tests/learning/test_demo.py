"""The demonstration of learned maps, small; and the resultant study on few presses."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from loadid import LearnedMap
from loadid._learning.network import Schedule
from tactile import LearnedSensor
from tactile._commands import _skin
from tests.benchmarks import learned_resultant as study
from tests.benchmarks.learned_skin import Sets, drawn, sensor


def test_the_demonstration_tells_and_draws_and_does_without_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # workers cost more than these draws
    monkeypatch.setattr(_skin, "TESTED", 2)
    monkeypatch.setattr(_skin, "DEEP", 1)
    monkeypatch.setattr(_skin, "ASKED", 1)
    monkeypatch.setattr(_skin, "PLAN", Schedule(epochs=1))
    monkeypatch.setattr(_skin, "find_spec", lambda name: None)
    done = _skin.demo(tmp_path, draws=400)
    errors = {(one.presses, one.way): one for one in done.lines}
    assert {one.way for one in done.lines} == {"physics", "linear"}
    assert "torch is not installed" in done.without
    assert "left out: the network" in _skin.text(done)
    assert errors["a plate, far too deep", "linear"].strange == 1.0
    assert errors["presses like these", "linear"].error < 0.9
    assert (tmp_path / "map.png").stat().st_size > 20_000
    assert LearnedSensor.read(tmp_path / "map.h5", _skin.skin(0.1)).fitted.facts["draws"] == 400


def test_the_force_on_bodies_never_seen_from_few_presses(tmp_path: Path) -> None:
    flat = sensor(deep=False)
    sets: Sets = drawn(sensor(deep=True), tmp_path, 120, tested=12, workers=1).without_depth(flat)
    fitted = LearnedMap(flat.model, output="resultant").fit(sets.training)
    rows = study.answered("LMMSE, direct", flat, study.of_resultants(fitted), sets)
    off = np.mean([r.off(study.span(flat, sets)) for r in rows if r.presses in study.UNSEEN], axis=0)
    assert off[:2].max() < 0.03  # .6 % and 3 % of 5000 presses
    assert off[2] < 0.1
    assert "unseen bodies" in study.show(rows, study.span(flat, sets))
