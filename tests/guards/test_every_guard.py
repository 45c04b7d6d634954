"""Every guard: what triggers it, what it says, and a clean twin without it.

E103, E301, E302 and E408 have no condition at run time; they are rules for the source, in test_source_rules.py.
"""

from __future__ import annotations

import re

import pytest

from loadid.codes import GUARDS
from loadid.commands.check import NAMES

from . import (
    test_frequency,
    test_frfs,
    test_histories,
    test_locations,
    test_offsets,
    test_spacetime,
    test_sparse,
    test_statics,
    test_tactile,
    test_tracking,
    test_unexplained,
)
from .cases import of
from .test_histories import folder

__all__ = ["folder"]  # where the files of some cases go

CASES = [*test_histories.CASES, *test_statics.CASES, *test_locations.CASES, *test_sparse.CASES, *test_spacetime.CASES]
CASES += [*test_frfs.CASES, *test_frequency.CASES, *test_tracking.CASES, *test_tactile.CASES]
CASES += [*test_offsets.CASES, *test_unexplained.CASES]
CODE_RULES = {"E103", "E301", "E302", "E408"}
ELSEWHERE = {"E116"}  # tested with the structure


@pytest.mark.parametrize("case", CASES, ids=str)
def test_triggered(case):
    (flag, *_) = of(case.code, case.trigger())
    assert re.search(case.says, str(flag), re.DOTALL), str(flag)
    assert len(flag.advice) > 8
    assert flag.evidence.name


@pytest.mark.parametrize("case", CASES, ids=str)
def test_silent(case):
    assert of(case.code, case.clean()) == []


def test_every_guard_is_here():
    assert {case.code for case in CASES} | ELSEWHERE == set(GUARDS)
    assert not CODE_RULES & set(GUARDS)
    assert set(NAMES) <= set(GUARDS)


def test_every_guard_of_the_code_is_here():
    """No code stands in the sources that is not in the list."""
    from ..sources import modules

    said = {
        code
        for _, path in modules("structures", "loadid", "tactile")
        for code in re.findall(r"""["'](?:LID-)?([EWN]\d{3})["']""", path.read_text("utf-8"))
    }
    assert said <= set(GUARDS) | CODE_RULES
