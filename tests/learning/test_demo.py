"""The demonstration of learned maps, small."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from loadid._learning.network import Schedule
from structures import InputError
from tactile import LearnedSensor
from tactile._commands import _skin


def test_the_demonstration_tells_and_draws_and_does_without_torch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # workers cost more than these draws
    monkeypatch.setattr(_skin, "TESTED", 8)
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
    assert 0.8 <= errors["presses like these", "linear"].held <= 1
    assert errors["a ring, never seen", "linear"].strange < 0.5
    assert "chosen to set it off" in _skin.text(done)
    assert (tmp_path / "map.png").stat().st_size > 20_000
    assert LearnedSensor.read(tmp_path / "map.h5", _skin.skin(0.1)).fitted.facts["draws"] == 400


def test_too_few_draws_are_refused_before_any_is_made(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="at least 100"):
        _skin.demo(tmp_path / "demo", draws=_skin.LEAST - 1)
    assert not (tmp_path / "demo").exists()
