"""Lambda that windows chose and the whole record confirms, against the rule run on the whole record directly."""

import numpy as np
import pytest

from loadid._inverse.choice import DEFAULT_RULES
from loadid._inverse.gaussian.coarse import confirm, windows_of
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.rules import run
from loadid.paths import Choice, RuleResult, Sweep, choose

from .cases import Case, beam

SAMPLES = 30_000


@pytest.fixture(scope="module")
def cornered() -> StateSpacePath:
    """Three knocks in the last twentieth of a record, noise everywhere."""
    system, rng = beam("d", "foh", 1), np.random.default_rng(0)
    load = np.zeros((SAMPLES, 1))
    for at in (28_600, 29_000, 29_500):
        load[at : at + 40, 0] = 20 * np.sin(np.pi * np.arange(40) / 40)
    y = system.simulate(load)
    sigma = 0.05 * y[28_500:].std(axis=0)
    given = Case(system, y + sigma * rng.standard_normal(y.shape), sigma, load)
    return given.path("identity")


@pytest.fixture(scope="module")
def quick(cornered: StateSpacePath) -> StateSpacePath:
    return StateSpacePath(cornered.record, quick=True, scale=float(cornered.scale))


@pytest.mark.parametrize(("rule", "sigma"), [("robust_gcv", None), ("discrepancy", 1.0)])
def test_lambda_is_that_of_the_whole_record(
    rule: str, sigma: float | None, cornered: StateSpacePath, quick: StateSpacePath
) -> None:
    windows = windows_of(cornered)
    assert windows is not None
    guess = choose(windows, rule, sigma=sigma)
    found = confirm(quick, guess, rule, sigma=sigma, source="stated")
    lam = np.geomspace(1e-3, 1, 45)
    direct = run(rule, Sweep(quick, lam, quick.at(lam), sigma))
    assert direct.lam is not None
    assert not direct.edge
    assert abs(np.log(found.lam / direct.lam)) < 0.02
    # what was found between nodes is the optimum of the exact path, too
    lam = np.geomspace(direct.lam / 3, direct.lam * 3, 15)
    fine = run(rule, Sweep(cornered, lam, cornered.at(lam), sigma)).lam
    assert fine is not None
    assert abs(np.log(found.lam / fine)) < 0.02


@pytest.mark.parametrize(("rule", "sigma"), [("robust_gcv", None), ("discrepancy", 1.0)])
def guess(lam: float, rule: str) -> Choice:
    """What windows might say, that know nothing of the other rules."""
    silent = tuple(RuleResult(name, None) for name in DEFAULT_RULES if name != rule)
    return Choice(lam, 1.0, rule, rules=(RuleResult(rule, lam), *silent))


@pytest.mark.parametrize(("rule", "sigma"), [("robust_gcv", None), ("discrepancy", 1.0)])
def test_a_first_guess_far_off_is_left(rule: str, sigma: float | None, quick: StateSpacePath) -> None:
    at = [confirm(quick, guess(lam, rule), rule, sigma=sigma, source="stated").lam for lam in (1e-3, 1.0)]
    assert abs(np.log(at[0] / at[1])) < 0.02


def test_a_wall_is_looked_behind(quick: StateSpacePath) -> None:
    """From the end of the range, where the windows saw no load at all, the default finds the one of the whole."""
    silent = tuple(RuleResult.null_space(r, 1e3) for r in DEFAULT_RULES)
    found = confirm(quick, Choice(1e3, 1.0, "predicted_error", silent), None, sigma=1.0, source="stated")
    direct = choose(quick, None, sigma=1.0)
    assert found.rule == direct.rule
    assert abs(np.log(found.lam / direct.lam)) < 0.02


def test_a_given_lambda_is_kept(quick: StateSpacePath) -> None:
    given = Choice(0.01, 1.0, "given")
    assert confirm(quick, given, 0.01, sigma=1.0, source="stated") is given


def test_a_rule_that_finds_nothing_has_searched_the_whole_range(quick: StateSpacePath) -> None:
    """No lambda leaves a residual of a millionth of the noise."""
    found = confirm(quick, guess(0.02, "discrepancy"), "discrepancy", sigma=1e-6, source="stated")
    assert found.sweep is not None
    assert (found.sweep.lam[0], found.sweep.lam[-1]) == quick.range
    assert next(r for r in found.rules if r.rule == "discrepancy").edge
