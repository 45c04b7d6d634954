"""What each grade is worth, measured: errors of the answers that received it, all loads and models together.

``python -m tests.campaigns grades --problems 24 --seed 7`` prints it; with ``--write`` the odds that answers state are
set to it (`loadid/_results/grades.toml`), over the seed and the next one: the better grades by the wider of the two
where both gave them to enough answers, else, as the worst one, by all together. Quote them on other seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import loadid._results.facts as stated
from loadid._results.facts import LETTERS, MEASURED, GradeOdds

from . import hammer, impacts, static
from .scores import Scored

LOADS = ("none", "same model", "gain", "frequency", "slow", "harmonic", "swept", "random")
DRAWN: dict[str, list[tuple[Any, str, dict[str, Any]]]] = {  # family -> campaign, error of the model, settings
    "static inversion": [(static, kind, {"oracle": False}) for kind in ("none", "gain", "place", "stiffness")],
    "deconvolution": [*((impacts, kind, {}) for kind in LOADS), *((hammer, kind, {}) for kind in ("none", "slow"))],
}
SHARE = {"A": 0.97, "B": 0.9, "C": 0.9, "D": 0.5}  # that `within` is to hold; A has a margin over 19 of 20
GOOD = 0.1  # relative error of a good answer
LEAST = 5  # answers without which nothing is stated


def drawn(problems: int, seed: int) -> dict[str, list[Scored]]:
    """Scores of each family, of four times as many problems."""

    def of(family: str) -> Iterator[Scored]:
        kinds = DRAWN[family]
        for campaign, error, settings in kinds:
            found = campaign.run(4 * problems // len(kinds), seed, error, **settings)
            yield from (s for s in found if isinstance(s, Scored))

    return {family: list(of(family)) for family in DRAWN}


def measured(found: Sequence[Scored]) -> dict[str, GradeOdds]:
    """Odds of each grade that enough answers received, in steps of a per cent, upwards."""
    odds = {}
    for letter in LETTERS:
        errors = [s.error for s in found if s.letter == letter]
        if len(errors) >= LEAST:
            odds[letter] = GradeOdds(len(errors), float(np.ceil(100 * np.quantile(errors, SHARE[letter])) / 100))
    return odds


def together(one: Sequence[Scored], two: Sequence[Scored]) -> dict[str, GradeOdds]:
    """Odds of two seeds."""
    each, both = [measured(one), measured(two)], measured([*one, *two])
    wider = {k: max(m[k].within for m in each) for k in LETTERS[:-1] if all(k in m for m in each)}
    return {k: GradeOdds(odds.answers, wider.get(k, odds.within)) for k, odds in both.items()}


def table(found: dict[str, list[Scored]], told: Callable[[str], None] = print) -> None:
    """Print each grade of each family: errors, how many lie within what is stated, and what the worst one costs."""
    told(f"{'':18s} grade    n    error 10 %   half  90 %  95 %   stated  within  flags")
    for family, scores in found.items():
        for letter in LETTERS:
            of = [s for s in scores if s.letter == letter]
            if not of:
                continue
            errors = np.array([s.error for s in of])
            odds = MEASURED.get(family, {}).get(letter)
            held = "" if odds is None else f"{odds.within:6.2f}  {np.mean(errors <= odds.within):5.0%}"
            told(
                f"{family:18s}   {letter}  {len(of):5d}        {np.quantile(errors, 0.1):6.3f} {np.median(errors):6.3f}"
                f" {np.quantile(errors, 0.9):5.2f} {np.quantile(errors, 0.95):5.2f}   {held:14s}"
                f"  {np.mean([s.cautions for s in of]):5.2f}"
            )
        good, worst = [s for s in scores if s.error < GOOD], [s for s in scores if s.letter == LETTERS[-1]]
        lost = sum(s.error < GOOD for s in worst)
        told(f"{family}: the worst grade was given to {lost} of {len(good)} good answers; {lost} of its {len(worst)}")


def write(one: dict[str, list[Scored]], two: dict[str, list[Scored]], how: str) -> None:
    """Set the odds that answers state, by two seeds; `how` they were made."""
    lines = [f"# python -m tests.campaigns grades {how} --write"]
    for family in one:
        lines.append(f'["{family}"]')
        lines += [f"{letter} = {{ answers = {o.answers}, within = {o.within:.2f} }}"
                  for letter, o in together(one[family], two[family]).items()]  # fmt: skip
    Path(stated.__file__).with_name("grades.toml").write_text("\n".join(lines) + "\n", "utf-8")
