"""Every guard: what triggers it, what it says, and a clean twin without it.

E103, E301, E302 and E408 have no condition at run time; they are rules for the source, in test_source_rules.py.
"""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator

import pytest

from loadid._commands.check import NAMES
from loadid.codes import GUARDS, explained
from structures import Flag
from structures._flags import Evidence, table

from ..families import test_amplitudes
from ..sources import PACKAGES, called, modules, parsed, walked
from . import (
    page,
    test_faults,
    test_frequency,
    test_frfs,
    test_histories,
    test_learned,
    test_locations,
    test_modes,
    test_not_told,
    test_offsets,
    test_shape,
    test_spacetime,
    test_sparse,
    test_statics,
    test_tactile,
    test_tracking,
    test_unexplained,
    test_vibration,
)
from .cases import of
from .test_histories import folder

__all__ = ["folder"]  # where the files of some cases go

CASES = [*test_histories.CASES, *test_statics.CASES, *test_locations.CASES, *test_sparse.CASES, *test_spacetime.CASES]
CASES += [*test_frfs.CASES, *test_frequency.CASES, *test_tracking.CASES, *test_tactile.CASES]
CASES += [*test_modes.CASES, *test_offsets.CASES, *test_unexplained.CASES, *test_faults.CASES]
CASES += [*test_amplitudes.CASES, *test_vibration.CASES, *test_not_told.CASES, *test_learned.CASES, *test_shape.CASES]
FIRST = {case.code: case for case in reversed(CASES)}
CODE_RULES = {"E103", "E301", "E302", "E408"}
ELSEWHERE = {"E116"}  # tested with the structure


def raised() -> dict[str, set[str]]:
    """Code -> functions that raise it: a flag, an error with ``code=``, or a refusal that was overridden."""
    found = defaultdict(set)
    for _, path in modules(*PACKAGES):
        for name, node in _within(parsed(path), ""):
            if isinstance(node, ast.Call) and called(node) in ("Flag", "overridden", "above"):
                given = node.args[:1]
            elif isinstance(node, ast.Call):
                given = [k.value for k in node.keywords if k.arg == "code"]
            else:
                given = [node.value] if isinstance(node, ast.Assign) and _is_code(node.value) else []
            for value in filter(_is_code, given):
                found[value.value.removeprefix("LID-")].add(name)
    return found


def _within(node: ast.AST, name: str) -> Iterator[tuple[str, ast.AST]]:
    """Every node, with the name of the function that it stands in."""
    for child in ast.iter_child_nodes(node):
        inside = child.name if isinstance(child, ast.FunctionDef) else name
        yield inside, child
        yield from _within(child, inside)


def _is_code(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and bool(re.fullmatch(r"(LID-)?[EWN]\d{3}", str(node.value)))


def asked() -> set[str]:
    """Names that the packages use, besides those of a definition, an import or a text."""
    nodes = [node for _, path in modules(*PACKAGES) for node in walked(parsed(path))]
    used = {node.id for node in nodes if isinstance(node, ast.Name)}
    return used | {node.attr for node in nodes if isinstance(node, ast.Attribute)}


@pytest.mark.parametrize("case", CASES, ids=str)
def test_triggered(case):
    (flag, *_) = of(case.code, case.trigger())
    assert re.search(case.says, str(flag), re.DOTALL), str(flag)
    assert len(flag.advice) > 8
    assert flag.evidence.name
    if case is FIRST[case.code]:  # the example of the table, up to its numbers, as far as its first words go
        stored = table()[case.code].example
        assert page.shape(page.example(flag))[:60] == page.shape(stored)[:60], "python -m tests.guards.page --examples"
        assert flag.evidence.name == "refusal" or f"[{flag.evidence.name} = " in stored


@pytest.mark.parametrize("case", CASES, ids=str)
def test_silent(case):
    assert of(case.code, case.clean()) == []


def test_every_guard_is_here():
    assert {case.code for case in CASES} | ELSEWHERE == set(GUARDS)
    assert not CODE_RULES & set(GUARDS)
    assert set(NAMES) <= set(GUARDS)


def test_what_the_code_raises_is_the_table():
    """Every code that is raised is in the table; every code of the table is raised by a function that is used."""
    by, used = raised(), asked() | {""}
    assert set(by) <= set(table())
    assert {code for code, functions in by.items() if functions & used} == set(table())


def test_every_code_in_the_sources_is_in_the_table():
    said = {
        code
        for _, path in modules(*PACKAGES)
        for code in re.findall(r"""["'](?:LID-)?([EWN]\d{3})["']""", path.read_text("utf-8"))
    }
    assert said <= set(table()) | CODE_RULES


def test_a_flag_does_not_repeat_the_advice_of_the_table():
    again = [
        f"{path.name}:{call.lineno}"
        for _, path in modules("structures", "loadid")
        if path.name != "choice.py"
        for call in walked(parsed(path))
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "Flag"
        and len(call.args) == 4 and isinstance(call.args[0], ast.Constant) and isinstance(call.args[3], ast.Constant)
        and call.args[3].value == table()[call.args[0].value].advice
    ]  # fmt: skip
    assert again == []


def test_the_table_is_whole():
    assert list(table()) == sorted(table(), key=lambda code: code[1:])
    for code, guard in table().items():
        assert min(len(guard.title), len(guard.condition), len(guard.advice), len(guard.example)) > 8, code
        assert not guard.condition.endswith("."), code


def test_the_page_is_the_table():
    assert page.PATH.read_text("utf-8") == page.text(), "python -m tests.guards.page writes it"


def test_json_says_what_the_table_says():
    flag = explained(Flag("W505", Evidence("response left", 0.3, 0.01), "short").to_dict())
    assert flag["title"] == GUARDS["W505"]
    assert (flag["stage"], flag["docs"]) == ("dynamics", "docs/guards.md#w505")
    assert flag["advice"] == table()["W505"].advice
    assert f"### {flag['docs'].partition('#')[2].upper()}\n" in page.text()
