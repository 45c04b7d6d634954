"""Grades: what makes them, and what is said of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid import Noise, StaticInversion
from loadid._results.facts import LETTERS, MEASURED, expected_error
from structures import Channel, MatrixModel
from structures._flags import Evidence, Flag
from tests.campaigns import grades

from .made import impact

CAUTION = Flag("W403", Evidence("x", 1.0, 0.0), "the noise is correlated", "measure it")
REFUTED = Flag("W412", Evidence("x", 9.0, 1.0), "the load does not explain its data", "look at the residual")


def of(share: float, *flags: Flag):
    """An estimate whose std is this share of its load everywhere."""
    e = impact(flags=list(flags))
    return replace(e, std=share * abs(e.load), facts={})


@pytest.mark.parametrize(("share", "letter"), [(0.02, "A"), (0.2, "B"), (0.6, "C"), (5.0, "D")])
def test_the_expected_error_makes_the_grade(share, letter):
    e = of(share)
    assert e.grade.letter == letter
    assert expected_error(e) == pytest.approx(share / (1 + share**2) ** 0.5)


@pytest.mark.parametrize(("share", "usable"), [(0.05, True), (0.3, True), (1.0, False)])
def test_a_load_that_is_fitted_whole_has_its_noise_in_its_size(share, usable):
    """Orthogonal readings of 400 loads, nothing regularised: what is found is the true load and the noise."""
    rng = np.random.default_rng(3)
    load, noise = rng.standard_normal((2, 400))
    H = np.linalg.qr(rng.standard_normal((400, 400)))[0]
    model = MatrixModel(H, sensors=[Channel(label=f"s{i}", quantity="strain") for i in range(400)],
                        loads=[Channel(label=f"F{i}", unit="N") for i in range(400)])  # fmt: skip
    e = StaticInversion(model, choice=1e-9, noise=Noise(np.full(400, share))).estimate(H @ load + share * noise)
    assert e.grade.expected == pytest.approx(share, rel=0.1)
    assert e.grade.usable is usable


def test_cautions_lower_it_and_contradiction_is_the_worst():
    assert of(0.02, CAUTION).grade.letter == "B"
    assert of(0.6, CAUTION).grade.letter == "C"
    assert of(0.02, REFUTED).grade.letter == "D"
    assert of(0.02, replace(CAUTION, state=True)).grade.letter == "A"
    held, slow = (replace(CAUTION, code=f"LID-{code}") for code in ("W519", "W520"))
    assert of(0.02, held).grade.letter == of(0.02, slow).grade.letter == "B"
    assert of(0.02, held, slow).grade.letter == "D"  # a track that drifts: 7 to 1000 times the load in three of 16


def test_odds_are_those_of_the_family_and_are_not_made_up():
    e = of(0.02)
    known = replace(e, provenance={"family": "deconvolution"}).grade
    assert known.odds == MEASURED["deconvolution"]["A"]
    assert f"19 of 20 answers like this one were within {100 * known.odds.within:.0f} %" in str(known)
    other = {"family": "harmonic inversion"}
    assert "of about 2 % is expected, not measured" in str(replace(e, provenance=other).grade)
    assert "of about 0.2 % is expected" in str(replace(of(0.002), provenance=other).grade)


def test_better_grades_were_better():
    assert set(MEASURED) == set(grades.DRAWN)
    for odds in MEASURED.values():
        within = [odds[letter].within for letter in LETTERS[:3] if letter in odds]
        assert within == sorted(within)
