"""Which rule decides, when it hands over, and how the agreement is graded."""

import numpy as np
import pytest

from loadid.inverse import choice as choices
from loadid.inverse.choice import DEFAULT_RULES, RuleResult, agreement, choose
from loadid.inverse.path import PathPoint
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath
from loadid.inverse.toeplitz import toeplitz
from structures.errors import InputError
from tests.benchmarks.fredholm import PROBLEMS

from .reference import echo

SIGMA = 0.05


def impact(sensors: int = 1, samples: int = 100, seed: int = 0) -> SVDPath:
    """Wide-band deconvolution: many degrees of freedom."""
    T = toeplitz(echo(samples, sensors, 1, seed=3, decay=15.0))
    g = np.exp(-0.5 * ((np.arange(samples) - 30) / 1.5) ** 2)
    y = T @ g + SIGMA * np.random.default_rng(seed).standard_normal((samples, sensors))
    return SVDPath(LinearProblem.whitened(T, y, shape=(samples, 1)))


def smooth(seed: int = 0) -> tuple[SVDPath, float]:
    """Severely ill-posed: few degrees of freedom."""
    H, g = PROBLEMS["gravity"](64)
    y = H @ g
    sigma = 0.01 * float(np.sqrt(np.mean(y**2)))
    return SVDPath(LinearProblem.whitened(H, y + sigma * np.random.default_rng(seed).standard_normal(64))), sigma


def results(**lams: float | None) -> dict[str, RuleResult]:
    return {name: RuleResult(name, lams.get(name)) for name in DEFAULT_RULES}


def by_name(chosen: choices.Choice) -> dict[str, RuleResult]:
    return {r.rule: r for r in chosen.rules}


def test_default_without_a_noise_level_predicts_the_error_of_the_load() -> None:
    path, _ = smooth()
    chosen = choose(path)
    assert chosen.rule == "predicted_error"
    assert chosen.lam == by_name(chosen)["predicted_error"].lam
    assert tuple(by_name(chosen)) == DEFAULT_RULES  # all are asked, whoever decides
    assert by_name(chosen)["discrepancy"].lam is None
    assert (chosen.sigma, chosen.sigma_source) == (None, "not known")


def test_default_with_a_noise_level_is_discrepancy() -> None:
    path, sigma = smooth()
    chosen = choose(path, sigma=sigma, source="quiet segment")
    assert chosen.rule == "discrepancy"
    assert chosen.edf < 0.2 * 64
    assert chosen.sigma_source == "quiet segment"


def test_discrepancy_hands_over_where_the_solution_spends_the_data() -> None:
    path = impact()
    chosen = choose(path, sigma=SIGMA)
    assert float(path.at(by_name(chosen)["discrepancy"].lam).edf) > 0.2 * path.m
    assert chosen.rule == "upre"
    assert chosen.lam == by_name(chosen)["upre"].lam


@pytest.mark.parametrize(
    ("fails", "expected"),
    [
        ({"predicted_error"}, "robust_gcv"),
        ({"predicted_error", "robust_gcv"}, "gcv"),
        ({"predicted_error", "robust_gcv", "gcv"}, "l_curve"),
    ],
)
@pytest.mark.parametrize("how", ["refused", "edge"])
def test_order_without_a_noise_level(monkeypatch: pytest.MonkeyPatch, fails: set[str], expected: str, how: str) -> None:
    from loadid.inverse import rules

    ask = rules.run

    def run(name: str, sweep: rules.Sweep) -> RuleResult:
        if name not in fails:
            return ask(name, sweep)
        return RuleResult(name, None, note="refused") if how == "refused" else RuleResult(name, 1e-9, True)

    monkeypatch.setattr(rules, "run", run)
    chosen = choose(smooth()[0])
    assert chosen.rule == expected
    assert chosen.lam == by_name(chosen)[expected].lam


def test_a_given_lambda_or_rule_is_obeyed() -> None:
    path, sigma = smooth()
    assert (choose(path, 0.03).lam, choose(path, 0.03).rule) == (0.03, "given")
    assert choose(path, 0).lam == 0.0
    for name in ("l_curve", "ncp", "modified_gcv"):
        chosen = choose(path, name)
        assert chosen.rule == name
        assert chosen.lam == by_name(chosen)[name].lam
    assert choose(path, "dof_discrepancy", sigma=sigma).rule == "dof_discrepancy"


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -0.1, "best", "discrepancy"])
def test_what_cannot_choose_is_refused(wrong: object) -> None:
    with pytest.raises(InputError, match="choice"):
        choose(smooth()[0], wrong)  # discrepancy: no noise level


def test_a_path_on_which_no_rule_runs_needs_a_lambda() -> None:
    class Mute:
        m, null, scale, smooth, range, coefficients = 400_000, 0, 1.0, False, (1e-3, 1.0), None

        def at(self, lam: object) -> PathPoint:
            return PathPoint(np.ones_like(lam, float), np.ones_like(lam, float))

    with pytest.raises(InputError, match="relative lambda") as caught:
        choose(Mute())
    assert "gcv needs" in str(caught.value)
    assert choose(Mute(), 0.2).lam == 0.2


@pytest.mark.parametrize(
    ("lams", "spread", "verdict"),
    [
        ({"gcv": 1e-3, "l_curve": 2e-3}, 0.30, "determined"),
        ({"gcv": 1e-3, "l_curve": 5e-3}, 0.70, "usable"),
        ({"gcv": 1e-3, "l_curve": 5e-2}, 1.70, "rules disagree"),
        ({"gcv": 1e-5, "l_curve": 5e-2}, 3.70, "not determined"),
        ({"gcv": 1e-3, "l_curve": 2e-3, "upre": 0.5}, 2.70, "not determined"),
        ({"gcv": 1e-3, "robust_gcv": 0.9}, 0.0, "usable"),  # one kind, one voice
        ({"robust_gcv": 1e-3, "l_curve": 1e-3}, 0.0, "determined"),
        ({"quasi_optimality": 1e-3, "evidence": 1e-3}, np.inf, "not determined"),
    ],
)
def test_verdict(lams: dict[str, float], spread: float, verdict: str) -> None:
    found = agreement(results(**lams))
    assert found == (pytest.approx(spread, abs=0.01), verdict)
    assert choices.MEANING[verdict]


def test_rules_at_an_end_have_no_voice() -> None:
    asked = results(gcv=1e-9, robust_gcv=0.02, l_curve=0.03)
    asked["gcv"] = RuleResult("gcv", 1e-9, True)
    assert agreement(asked)[1] == "determined"


def test_verdict_travels_with_the_choice_and_the_sweep_draws_it() -> None:
    chosen = choose(smooth()[0])
    spread, verdict = agreement(by_name(chosen), chosen.lam)
    assert (chosen.spread, chosen.verdict, chosen.odds) == (spread, verdict, choices.MEANING[verdict])
    s = chosen.sweep
    assert s is not None
    assert np.all(np.diff(s.residual_norm) >= 0)
    assert np.all(np.diff(s.penalty_norm) <= 0)
    assert np.all(np.diff(s.edf) <= 0)
    assert s.gcv[np.argmin(np.abs(s.lam - by_name(chosen)["gcv"].lam))] == pytest.approx(s.gcv.min(), rel=1e-2)


@pytest.mark.parametrize(("known", "typical"), [(True, 1.1), (False, 1.5)])
def test_default_is_near_the_best_lambda_where_half_the_data_are_spent(known: bool, typical: float) -> None:
    ratio = []
    for seed in range(6):
        path = impact(2, seed=seed)
        g = np.exp(-0.5 * ((np.arange(100) - 30) / 1.5) ** 2)
        error = [np.linalg.norm(path.X @ path.gains(x) - g) for x in np.geomspace(1e-4, 1, 60)]
        lam = choose(path, sigma=SIGMA if known else None).lam
        ratio.append(np.linalg.norm(path.X @ path.gains(lam) - g) / min(error))
    assert np.median(ratio) < typical
    assert max(ratio) < typical + 0.2
