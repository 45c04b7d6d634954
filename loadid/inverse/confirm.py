"""Lambda of a long record: found on its windows, confirmed on the whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import rules
from .choice import Choice
from .path import RegularizationPath
from .sweeping import Sweep

REACH = 0.5  # decades to either side of what the windows chose
TRIES = 4  # times that the whole may send the search further


def confirm(path: RegularizationPath, choice: Choice, sigma: float | None) -> Choice:
    """The same rule on the whole record, near the lambda that its windows chose.

    Where its optimum lies at an end of the searched part the search goes on from there. A lambda that was given is
    kept; so is the one of the windows where the rule finds no optimum on the whole, and the rule's note says so.
    """
    if choice.rule == "given":
        return choice
    middle, found = choice.lam, None
    low, high = path.range
    for _ in range(TRIES):
        ends = np.clip([middle * 10**-REACH, middle * 10**REACH], low, high)
        lam = np.geomspace(float(ends[0]), float(ends[1]), 15)
        found = rules.run(choice.rule, Sweep(path, lam, path.at(lam), sigma))
        if found.lam is None or not found.edge or (ends[0] <= low if found.lam < middle else high <= ends[1]):
            break
        middle = found.lam
    assert found is not None
    if found.lam is None or found.edge:
        note = f"chosen on windows; on the whole record: {found.note or 'no optimum near it'}"
        return replace(choice, rules=_noted(choice, None, note))
    note = f"chosen on windows ({choice.lam:.3g}), confirmed on the whole record"
    return replace(choice, lam=found.lam, edf=_edf(path, found.lam), rules=_noted(choice, found.lam, note))


def _edf(path: RegularizationPath, lam: float) -> float | None:
    edf = path.at(lam).edf
    return None if edf is None else float(edf)


def _noted(choice: Choice, lam: float | None, note: str) -> tuple[rules.RuleResult, ...]:
    """The rules, the one in use with its lambda of the whole record and a note."""
    return tuple(
        replace(r, lam=r.lam if lam is None else lam, note=f"{r.note}; {note}" if r.note else note)
        if r.rule == choice.rule
        else r
        for r in choice.rules
    )
