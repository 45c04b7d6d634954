"""The case studies of learned skins on few presses: what the linear map draws, the forces, and the gel it never saw.

Functions, not classes: one process draws the presses for all.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from case_studies import learned_resultant, learned_skin
from case_studies.learned_skin import Row, Sets, drawn, learned, sensor
from loadid import LearnedMap
from tactile import LearnedSensor, MultilayerPad

DRAWS, TESTED = 520, 10


@pytest.fixture(scope="module")
def flat() -> MultilayerPad:
    return sensor(deep=False)


@pytest.fixture(scope="module")
def sets(flat: MultilayerPad, tmp_path_factory: pytest.TempPathFactory) -> Sets:
    whole = sensor(deep=True, camera=flat.eye)
    return drawn(whole, tmp_path_factory.mktemp("skin"), DRAWS, tested=TESTED, workers=1).without_depth(flat)


@pytest.fixture(scope="module")
def linear(flat: MultilayerPad, sets: Sets) -> LearnedSensor:
    return learned(flat, sets, "linear")


@pytest.fixture(scope="module")
def rows(sets: Sets, linear: LearnedSensor) -> dict[tuple[str, str], Row]:
    found = learned_skin.by_map("linear", linear, sets)
    return {(one.way, one.presses): one for one in found}


@pytest.mark.parametrize("presses", ["in the set", *learned_skin.UNSEEN])
def test_force_and_band_of_few_presses(rows: dict[tuple[str, str], Row], presses: str) -> None:
    own = rows["linear", presses]
    assert own.normal < 0.2  # 5 to 7 % of 5000 presses
    assert 0.9 <= own.covered <= 1
    assert own.error < 1


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
