"""The table of all rules: complete, consistent with the path, and honest about what it is worth."""

import numpy as np
import pytest

from loadid._inverse import rules
from loadid.paths import LinearProblem, SVDPath, choose, compare
from tests.benchmarks.fredholm import NOISES, PROBLEMS


def posed(name: str = "gravity", n: int = 64, level: float = 1e-2, kind: str = "white") -> tuple[SVDPath, float]:
    H, g = PROBLEMS[name](n)
    y = H @ g
    sigma = level * float(np.sqrt(np.mean(y**2)))
    return SVDPath(LinearProblem.whitened(H, y + sigma * NOISES[kind](np.random.default_rng(3), n))), sigma


@pytest.mark.parametrize("known", [True, False])
def test_every_rule_has_a_row_that_the_path_confirms(known: bool) -> None:
    path, sigma = posed()
    found = compare(path, sigma if known else None, "unloaded record" if known else "not known")
    assert tuple(r.rule for r in found.rows) == tuple(rules.RULES)
    for row in found.rows:
        if row.lam is None:
            assert row.note
            assert (row.residual, row.edf) == (None, None)
            continue
        g = path.solution(row.lam, None).load
        norm = np.linalg.norm(path.problem.y - path.problem.H @ g)
        assert row.residual == pytest.approx(norm / (sigma * np.sqrt(path.m) if known else 1.0), rel=1e-4)
        assert row.edf == pytest.approx(float(np.sum(path.filter_factors(row.lam))), rel=1e-9)
    refused = {r.rule for r in found.rows if r.lam is None}
    assert refused == {"ebic"} | (set() if known else {"discrepancy", "dof_discrepancy", "upre"})


def test_it_agrees_with_choose() -> None:
    path, sigma = posed()
    found, chosen = compare(path, sigma, "repeatability"), choose(path, sigma=sigma, source="repeatability")
    assert (found.choice.lam, found.choice.rule) == (chosen.lam, chosen.rule)
    assert (found.spread, found.verdict, found.odds) == (chosen.spread, chosen.verdict, chosen.odds)
    assert found.source.kind == "repeatability"


def test_spread_of_all_rules() -> None:
    found = compare(*posed())
    lams = [r.lam for r in found.rows if r.lam is not None and not r.edge]
    assert found.full_spread == pytest.approx(np.log10(max(lams) / min(lams)))
    assert found.full_spread >= found.spread - 1e-9 or any(r.edge for r in found.rows)


def test_sensitivity_to_the_noise_level_is_there_where_it_decides() -> None:
    path, sigma = posed()
    half, once, twice = compare(path, sigma, "a guess").sensitivity
    assert once == pytest.approx(rules.discrepancy(rules.Sweep.over(path, sigma)).lam, rel=0.02)
    assert twice > once
    assert half is None or half < once
    assert compare(path).sensitivity == ()


def test_the_table_can_be_printed_and_names_everything() -> None:
    path, sigma = posed()
    text = str(compare(path, sigma, "a guess"))
    lines = text.splitlines()
    assert lines[0].split() == ["rule", "lambda", "edge", "residual", "edf", "note"]
    assert all(any(line.startswith(name) for line in lines) for name in rules.RULES)
    assert "a guess" in text
    assert "verdict:" in text
    assert "half, once and twice" in text
    assert "needs the noise level" in str(compare(path))
    assert max(map(len, lines)) < 400


@pytest.mark.parametrize(("kind", "share"), [("white", 0.0), ("AR(1) 0.9", 1.0)])
def test_only_bad_verdicts_are_warnings(kind: str, share: float) -> None:
    found = compare(posed(n=200, kind=kind)[0])
    assert found.warning == (found.verdict in ("rules disagree", "not determined"))
    assert float(found.warning) == share
