"""Four grades of an answer, and how often answers of each were as good as it says.

What the estimate knows of its own error is one number, the error that is expected of it relative to the load. Cuts make
grades of it, cautions lower them, and ``python -m tests.campaigns grades`` measures on random problems with foreign
truths what each grade is worth: `grades.toml` is its output.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from structures._flags import cautions

if TYPE_CHECKING:
    from .estimate import LoadEstimate

LETTERS = ("A", "B", "C", "D")
MEANINGS = {
    "A": "good",
    "B": "fair",
    "C": "size and rough shape only",
    "D": "not determined: do not use the number",
}
CUTS = (0.10, 0.30, 0.90)  # expected relative error between the grades
CONTRADICTED = ("LID-W308", "LID-W412")  # the data speak against the answer itself
FEW, MANY = 2.5, 5.0  # degrees of freedom that explain so many times as many readings: a simple load, confirmed
SHARES = {"A": "19 of 20", "B": "9 of 10", "C": "9 of 10", "D": "half"}  # of what `MEASURED` states


@dataclass(frozen=True)
class GradeOdds:
    """Measured on answers of one family and grade.

    Parameters
    ----------
    answers : int
        How many there were.
    within : float
        Relative error (root mean square over the load) that the share of `SHARES` stays below; of the worst grade, that
        half exceeds.
    """

    answers: int
    within: float


def _stated() -> dict[str, dict[str, GradeOdds]]:
    rows = tomllib.loads(Path(__file__).with_name("grades.toml").read_text("utf-8"))
    return {family: {letter: GradeOdds(**odds) for letter, odds in grades.items()} for family, grades in rows.items()}


MEASURED = _stated()  # family -> grade -> odds


@dataclass(frozen=True)
class Grade:
    """How far an answer can be trusted.

    Parameters
    ----------
    letter : str
        ``A`` to ``D``.
    expected : float
        Relative error that is expected of the load, root mean square; 1 where nothing is known of it.
    odds : GradeOdds or None
        What answers of this family and grade were worth; None where nobody measured it.
    """

    letter: str
    expected: float
    odds: GradeOdds | None

    @property
    def meaning(self) -> str:
        """What the letter stands for."""
        return MEANINGS[self.letter]

    def __str__(self) -> str:
        text = f"grade {self.letter} ({self.meaning})"
        if self.odds is None:
            return f"{text}; an error of about {_percent(self.expected)} is expected, not measured for such answers"
        within = _percent(self.odds.within)
        if self.letter == LETTERS[-1]:
            return f"{text}; half of the answers like this one were off by more than {within}"
        return f"{text}; {SHARES[self.letter]} answers like this one were within {within}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def expected_error(estimate: LoadEstimate) -> float:
    """Relative error that is expected of a load: of the posterior where that says more, else of its std.

    Errors of variance S about a load of squared norm G leave a true load of G + S on average, so that it is below 1.
    Over frequency lines those count that are trusted, where one is.
    """
    if estimate.facts.expected_error is not None:
        return float(estimate.facts.expected_error)
    load, std = np.asarray(estimate.load), np.asarray(estimate.std)
    if estimate.spectrum is not None and estimate.spectrum.load.shape == load.shape:
        trusted = estimate.trust()
        load, std = (load[trusted], std[trusted]) if trusted.any() else (load, std)
    return relative(float(np.sum(std**2)), float(np.sum(np.abs(load) ** 2)))


def relative(error2: float, load2: float) -> float:
    """Expected relative error of a load of squared norm `load2` with errors of that variance."""
    return float(np.sqrt(error2 / (error2 + load2))) if error2 + load2 > 0 else 1.0


def grade(estimate: LoadEstimate) -> Grade:
    """Grade of an estimate by its expected error and its cautions, with what was measured of that grade."""
    expected = expected_error(estimate)
    found = cautions(estimate.flags)
    letter = LETTERS[int(np.searchsorted(CUTS, expected, side="right"))]
    if letter == "D" and _simple(estimate):
        letter = "C"
    if found and letter < "C":
        letter = LETTERS[LETTERS.index(letter) + 1]
    if any(flag.code in CONTRADICTED or flag.code[4] == "E" for flag in found):
        letter = "D"
    family = str(estimate.provenance.get("family", ""))
    return Grade(letter, expected, MEASURED.get(family, {}).get(letter))


def _simple(estimate: LoadEstimate) -> bool:
    """Whether a few degrees of freedom explain many more readings."""
    edf, m = estimate.facts.edf, estimate.facts.m
    if edf is None or m is None:
        return False
    each = edf / (estimate.facts.frames or 1)
    return each <= FEW and m >= MANY * each
