"""No answer moves while the house is rebuilt: the problems of `problems` against their stored answers.

The net says nothing about whether an answer is right, other tests do; it says that it is the one of before, to the
tolerance of its problem: 1e-10 of the largest entry, or what its solver states of itself. Rewrite an answer only in a
commit that changes it on purpose, with ``python -m tests.golden --write NAMES``, and say there why and by how much; an
answer that changes otherwise is a defect of the change. A new problem is added in the same way.
"""

from __future__ import annotations

import numpy as np
import pytest

from . import answers
from .__main__ import main
from .problems import PROBLEMS, TIGHT

STORED = answers.load()


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_answer_is_the_one_of_before(name: str) -> None:
    problem = PROBLEMS[name]
    off, said = answers.changes(problem.solve(), STORED[name])
    assert {key: value for key, value in off.items() if not value <= problem.tolerance} == {}
    assert said == []


def test_all_answers_are_of_problems_and_every_tolerance_has_its_reason() -> None:
    assert STORED.keys() == PROBLEMS.keys()
    assert len(PROBLEMS) >= 60
    assert all(p.loose is None or (p.loose.tolerance > TIGHT and p.loose.why) for p in PROBLEMS.values())
    assert answers.FILE.stat().st_size < 300_000


def test_a_long_array_is_kept_in_part_and_every_entry_counts() -> None:
    x = np.random.default_rng(0).standard_normal((500, 2))
    old = answers.kept(x)
    assert len(old) == answers.KEPT + 3
    for k in (3, 250, 499):
        y = x.copy()
        y[k, 1] += 1e-6
        assert answers.apart(answers.kept(y), old) > 1e-10
    assert answers.apart(answers.kept(x[:-1]), old) > 1e-9
    z = x.astype(complex)
    assert answers.apart(answers.kept(1j * z), answers.kept(z)) > 0.1


def test_gaps_and_lengths_are_compared() -> None:
    x = np.array([1.0, np.nan, 3.0])
    assert answers.apart(x, x) == 0
    assert answers.apart(np.array([1.0, 2.0, 3.0]), x) == np.inf
    assert answers.apart(x[:2], x) == np.inf


def test_nothing_is_overwritten_unasked(tmp_path, monkeypatch, capsys) -> None:
    """The command prints what would change, and writes the named problems only, and only when told."""
    names = ["static/gradient/given", "static/identity/given"]
    file = tmp_path / "answers.npz"
    old = {n: answers.Answer({**STORED[n].arrays, "load": 1.001 * STORED[n].arrays["load"]}, STORED[n].words)
           for n in names}  # fmt: skip
    answers.save(old, file)
    monkeypatch.setattr(answers, "FILE", file)
    monkeypatch.setattr(answers.load, "__defaults__", (file,))
    monkeypatch.setattr(answers.save, "__defaults__", (file,))
    before = file.read_bytes()
    assert main([names[0]]) == 1
    assert "load: 1.0e-03" in capsys.readouterr().out
    assert file.read_bytes() == before
    assert main(["--write", names[0]]) == 0
    found = answers.load()
    assert answers.changes(found[names[0]], STORED[names[0]])[0]["load"] <= 1e-10
    assert answers.apart(found[names[1]].arrays["load"], old[names[1]].arrays["load"]) == 0
    assert main([names[0]]) == 0
