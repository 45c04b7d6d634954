"""The case studies of learned skins on few presses: what the linear map draws, the forces, and the gel it never saw.

The presses are kept in a file (`tests/learning/skin.py`); the first of each set is drawn anew.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from case_studies import learned_resultant, learned_skin
from case_studies.learned_skin import Row, Sets, drawn, learned, sensor
from loadid import LearnedMap
from loadid.generate import TrainingSet
from tactile import LearnedSensor, MultilayerPad

from .learning import skin


@pytest.fixture(scope="module")
def flat() -> MultilayerPad:
    return sensor(deep=False)


@pytest.fixture(scope="module")
def sets(flat: MultilayerPad) -> Sets:
    return skin.kept(flat)


@pytest.fixture(scope="module")
def linear(flat: MultilayerPad, sets: Sets) -> LearnedSensor:
    return learned(flat, sets, "linear")


@pytest.fixture(scope="module")
def rows(sets: Sets, linear: LearnedSensor) -> dict[tuple[str, str], Row]:
    found = learned_skin.by_map("linear", linear, sets)
    return {(one.way, one.presses): one for one in found}


def test_presses_that_are_kept_are_those_that_are_drawn(flat: MultilayerPad, sets: Sets, tmp_path: Path) -> None:
    anew = drawn(sensor(deep=True, camera=flat.eye), tmp_path, 1, tested=1, workers=1).without_depth(flat)
    assert list(anew.tests) == list(sets.tests)
    for fresh, kept in zip((anew.training, *anew.tests.values()), (sets.training, *sets.tests.values()), strict=True):
        one, same = fresh.read([0]), kept.read([0])
        assert same.data == pytest.approx(one.data, abs=skin.STEP)
        assert same.loads == pytest.approx(one.loads, abs=np.abs(one.loads).max() / skin.STEPS)
        assert same.parameters["E"] == pytest.approx(one.parameters["E"], rel=1e-6)


@pytest.mark.parametrize("presses", ["in the set", *learned_skin.UNSEEN])
def test_force_and_band_of_few_presses(rows: dict[tuple[str, str], Row], presses: str) -> None:
    own = rows["linear", presses]
    assert own.normal < 0.2  # 5 to 7 % of 5000 presses
    assert 0.9 <= own.covered <= 1
    assert own.error < 1


def test_a_map_that_was_learned_from_these_presses_is_kept(
    flat: MultilayerPad, sets: Sets, linear: LearnedSensor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(LearnedSensor, "save", lambda one, path: Path(path).touch())
    monkeypatch.setattr(LearnedSensor, "fit", lambda *_, **__: asked.append("fit") or linear)
    monkeypatch.setattr(LearnedSensor, "read", lambda path, of: asked.append(Path(path).name) or linear)
    part = TrainingSet.of(sets.training.read(slice(0, 300)), sensors=flat.model.sensors, loads=flat.model.loads)
    for one in (sets, sets, replace(sets, training=part)):
        assert learned(flat, one, "linear", folder=tmp_path) is linear
    assert asked == ["fit", "linear, plane.h5", "linear, plane.h5", "fit"]


def test_the_band_does_not_hold_on_another_gel(rows: dict[tuple[str, str], Row]) -> None:
    same, other = rows["linear", "in the set"], rows["linear", "other gel"]
    assert other.normal > 2 * same.normal
    assert other.wrench < same.wrench


def test_what_of_the_force_is_the_gel(linear: LearnedSensor, sets: Sets) -> None:
    gel, rest = learned_skin.of_the_gel(linear, sets.tests["in the set"])
    assert 0.01 < gel < 0.2  # 4 % of 200 presses
    assert rest < 0.2


def test_novelty_is_told_for_each_row(linear: LearnedSensor, sets: Sets) -> None:
    apart = learned_skin.told_apart(linear, sets)
    assert list(apart) == list(sets.tests)[1:]
    assert all(0 <= value <= 1 for value in apart.values())


def test_table_and_picture(rows: dict[tuple[str, str], Row], linear: LearnedSensor, sets: Sets, tmp_path: Path) -> None:
    assert "other gel" in learned_skin.show(list(rows.values()))
    learned_skin.picture([("linear", linear)], sets, tmp_path / "x.png")
    assert (tmp_path / "x.png").stat().st_size > 20_000


def test_the_map_of_the_force_is_within_the_claim(flat: MultilayerPad, sets: Sets) -> None:
    fitted = LearnedMap(flat.model, output="resultant").fit(sets.training)
    rows = learned_resultant.answered("LMMSE, direct", flat, learned_resultant.of_resultants(fitted), sets)
    span = learned_resultant.span(flat, sets)
    off = np.mean([r.off(span) for r in rows if r.presses in learned_skin.UNSEEN], axis=0)
    assert off[:2].max() < 0.03
    assert off[2] < 0.1
    assert "unseen bodies" in learned_resultant.show(rows, span)
