"""Which rule decides, when it hands over, how the agreement is graded, and what the guards make of it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from loadid import Deconvolution, NoiseSource
from loadid import _guards as guards
from loadid._inverse import choice as choices
from loadid._inverse import rules
from loadid._inverse import rules as odds
from loadid._inverse.agreement import agreement
from loadid._inverse.choice import DEFAULT_RULES
from loadid._inverse.sweep import LARGEST
from loadid.paths import LinearProblem, PathPoint, RegularizationPath, RuleResult, SVDPath, choose, toeplitz
from loadid.settings import Penalty
from structures.errors import InputError
from tests.benchmarks.fredholm import NOISES, PROBLEMS
from tests.campaigns import impacts, long

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


def test_default_with_a_noise_level_steps_from_the_discrepancy_solution() -> None:
    path, sigma = smooth()
    chosen = choose(path, sigma=sigma, source="quiet segment")
    assert chosen.rule == "predicted_error"
    assert chosen.edf < 0.2 * 64
    assert chosen.sigma_source == "quiet segment"
    # the fixed point: the best lambda if the estimate at that very lambda were the load
    lams = np.geomspace(1e-3, 1, 400)
    steps = [rules.discrepancy(rules.Sweep.over(path, sigma), margin=0.99).lam]
    for _ in range(30):
        steps.append(lams[np.argmin(path.predicted_error(lams, steps[-1], sigma))])
    assert steps[-1] == steps[-2]
    assert steps[1] / steps[-1] > 1.05  # the first step is not there yet
    assert chosen.lam == pytest.approx(steps[-1], rel=0.03)
    note = by_name(chosen)["discrepancy"].note
    assert re.search(r"half, once and twice the noise level: \S+ / \S+ / \S+", note)


def test_a_wide_band_load_is_refined_by_upre() -> None:
    path = impact()
    chosen = choose(path, sigma=SIGMA)
    assert float(path.at(by_name(chosen)["predicted_error"].lam).edf) > 0.2 * path.m
    assert chosen.rule == "upre"
    assert chosen.lam == by_name(chosen)["upre"].lam


@pytest.mark.parametrize(
    ("known", "fails", "expected"),
    [
        (False, {"predicted_error"}, "robust_gcv"),
        (False, {"predicted_error", "robust_gcv"}, "gcv"),
        (False, {"predicted_error", "robust_gcv", "gcv"}, "l_curve"),
        (True, {"predicted_error"}, "discrepancy"),
        (True, {"predicted_error", "discrepancy"}, "upre"),
    ],
)
@pytest.mark.parametrize("how", ["refused", "edge"])
def test_order(monkeypatch: pytest.MonkeyPatch, known: bool, fails: set[str], expected: str, how: str) -> None:
    ask = rules.run

    def run(name: str, sweep: rules.Sweep) -> RuleResult:
        if name not in fails:
            return ask(name, sweep)
        return RuleResult(name, None, note="refused") if how == "refused" else RuleResult(name, 1e-9, True)

    monkeypatch.setattr(rules, "run", run)
    path, sigma = smooth()
    chosen = choose(path, sigma=sigma if known else None)
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
    class Mute(RegularizationPath):
        m, null, scale, smooth, range, coefficients = 400_000, 0, 1.0, False, (1e-3, 1.0), None

        def residual(self, lam: float) -> np.ndarray:
            return np.zeros((2, 1))

        def predicted_error(self, lam: object, pilot: float, sigma: float) -> None:
            return None

        def at(self, lam: object) -> PathPoint:
            return PathPoint(np.ones_like(lam, float), np.ones_like(lam, float))

    with pytest.raises(InputError, match="relative lambda") as caught:
        choose(Mute())
    assert "gcv needs" in str(caught.value)
    assert choose(Mute(), 0.2).lam == 0.2


@pytest.mark.parametrize(
    ("lams", "spread", "verdict"),
    [
        ({"gcv": 1e-3, "quasi_optimality": 2e-3}, 0.30, "determined"),
        ({"gcv": 1e-3, "quasi_optimality": 5e-3}, 0.70, "usable"),
        ({"gcv": 1e-3, "quasi_optimality": 5e-2}, 1.70, "rules disagree"),
        ({"gcv": 1e-5, "quasi_optimality": 5e-2}, 3.70, "not determined"),
        ({"gcv": 1e-3, "quasi_optimality": 2e-3, "discrepancy": 0.5}, 2.70, "not determined"),
        ({"gcv": 1e-3, "robust_gcv": 0.9}, 0.0, "usable"),  # one kind, one voice
        ({"robust_gcv": 1e-3, "quasi_optimality": 1e-3}, 0.0, "determined"),
        ({"l_curve": 1e-1, "evidence": 1e-5}, np.inf, "not determined"),
    ],
)
def test_verdict(lams: dict[str, float], spread: float, verdict: str) -> None:
    found = agreement(results(**lams), lams.get("gcv", 1e-3))
    assert found == (pytest.approx(spread, abs=0.01), verdict)
    assert odds.MEANING[verdict]


def test_a_lambda_far_from_the_rules_is_not_determined_by_them() -> None:
    asked = results(gcv=1e-3, quasi_optimality=1e-3)
    assert agreement(asked, 1e-3)[1] == "determined"
    assert agreement(asked, 0.5)[1] == "not determined"


def test_correlated_noise_leaves_no_good_verdict() -> None:
    asked = results(gcv=1e-3, quasi_optimality=1e-3)
    assert agreement(asked, 1e-3, correlated=True) == (0.0, "rules disagree")


def test_quasi_optimality_at_its_lower_end_has_no_voice() -> None:
    asked = results(gcv=1e-3, quasi_optimality=1e-5)
    asked["quasi_optimality"] = RuleResult("quasi_optimality", 1e-5, True)
    assert agreement(asked, 1e-3) == (0.0, "usable")


def test_distances_do_not_count_where_the_load_no_longer_changes() -> None:
    path, _ = smooth()
    assert agreement(results(gcv=1.0, quasi_optimality=1.0), 1e3, path) == (0.0, "determined")


def test_verdict_travels_with_the_choice_and_the_sweep_draws_it() -> None:
    path, _ = smooth()
    chosen = choose(path)
    spread, verdict = agreement(by_name(chosen), chosen.lam, path)
    assert (chosen.spread, chosen.verdict, chosen.odds) == (spread, verdict, odds.in_words(verdict, False))
    s = chosen.sweep
    assert s is not None
    assert np.all(np.diff(s.residual_norm) >= 0)
    assert np.all(np.diff(s.penalty_norm) <= 0)
    assert np.all(np.diff(s.edf) <= 0)
    assert s.gcv[np.argmin(np.abs(s.lam - by_name(chosen)["gcv"].lam))] == pytest.approx(s.gcv.min(), rel=1e-2)


# -- correlated noise ------------------------------------------------------------------------------------------------
def coloured(seed: int, kind: str = "AR(1) 0.9") -> SVDPath:
    H, g = PROBLEMS["gravity"](200)
    y = H @ g
    noise = NOISES[kind](np.random.default_rng(seed), 200)
    return SVDPath(LinearProblem.whitened(H, y + 0.01 * float(np.sqrt(np.mean(y**2))) * noise))


def test_correlated_noise_hands_over_to_quasi_optimality_and_says_so() -> None:
    found = [choose(coloured(seed)) for seed in range(8)]
    seen = [c for c in found if c.correlated]
    assert len(seen) >= 6
    for chosen in seen:
        assert chosen.verdict in ("rules disagree", "not determined")
        flag = guards.correlated_noise(chosen)
        assert flag is not None
        assert flag.code == "LID-W403"
        assert f"{flag.evidence.value:.1f}"[:3] in flag.message or f"{flag.evidence.value:.1g}" in flag.message
    followed = [c for c in seen if c.whiteness["followed"]]
    assert all(c.rule == "quasi_optimality" for c in followed)
    assert all(c.lam > 5 * by_name(c)["predicted_error"].lam for c in followed)
    white = [choose(coloured(seed, "white")) for seed in range(8)]
    assert not any(c.correlated for c in white)
    assert all(guards.correlated_noise(c) is None for c in white)


# -- guards ----------------------------------------------------------------------------------------------------------
def test_w404_needs_a_word_on_white_noise() -> None:
    path, sigma = smooth()
    rule = "dof_discrepancy"
    chosen = choose(path, rule, sigma=sigma, source="unloaded record")
    assert chosen.whiteness["modes"] >= 40  # shown by the data coefficients
    assert guards.needs_white_noise(chosen) is None
    few = replace(chosen, whiteness={"modes": 12.0, "chance": 0.5})
    flag = guards.needs_white_noise(few)
    assert flag is not None
    assert (flag.code, flag.evidence.value) == ("LID-W404", 12)
    assert guards.needs_white_noise(replace(few, source=NoiseSource("quiet", white=True))) is None
    assert guards.needs_white_noise(choose(path, sigma=sigma)) is None


def test_w405_counts_the_noise_modes() -> None:
    H, g = PROBLEMS["gravity"](24)
    y = H @ g + 1e-3 * np.random.default_rng(0).standard_normal(24)
    chosen = choose(SVDPath(LinearProblem.whitened(H, y)))
    flag = guards.not_testable(chosen)
    assert flag is not None
    assert flag.code == "LID-W405"
    assert str(flag.evidence.value) in flag.message
    assert flag.evidence.value < 24
    assert guards.not_testable(choose(SVDPath(LinearProblem.whitened(H, y)), sigma=1e-3)) is None
    assert guards.not_testable(choose(smooth()[0])) is None


def test_a_registered_rule_says_itself_that_it_needs_white_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "RULES", dict(rules.RULES))
    H, g = PROBLEMS["gravity"](24)
    y = H @ g + 1e-3 * np.random.default_rng(0).standard_normal(24)
    path = SVDPath(LinearProblem.whitened(H, y))
    rules.register_rule(rules.modified_gcv, "silent")
    rules.register_rule(rules.modified_gcv, "stricter", for_white_noise=True)
    silent, flag = (guards.not_testable(choose(path, name)) for name in ("silent", "stricter"))
    rules.FOR_WHITE_NOISE.remove("stricter")
    assert silent is None
    assert flag is not None
    assert flag.code == "LID-W405"


def in_the_null_space(sigma: float = 1e-3) -> tuple[SVDPath, np.ndarray, float]:
    """A linear load under a second difference: the best lambda is infinite."""
    H, g = PROBLEMS["foxgood"](64)
    y = H @ g
    level = sigma * float(np.sqrt(np.mean(y**2)))
    y = y + level * np.random.default_rng(5).standard_normal(64)
    return SVDPath(LinearProblem.whitened(H, y, L=np.diff(np.eye(64), 2, axis=0))), g, level


@pytest.mark.parametrize("known", [True, False])
def test_a_load_in_the_null_space_of_the_penalty_is_found_and_flagged(known: bool) -> None:
    path, g, level = in_the_null_space()
    chosen = choose(path, sigma=level if known else None, source="unloaded record")
    flat = np.column_stack([np.ones(64), np.arange(64)])
    expected = flat @ np.linalg.lstsq(path.problem.H @ flat, path.problem.y, rcond=None)[0]
    load = path.solution(chosen.lam, None).load
    np.testing.assert_allclose(load, expected, rtol=0, atol=1e-5 * np.abs(expected).max())
    assert np.linalg.norm(load - g) < 0.01 * np.linalg.norm(g)
    flag = guards.at_the_end(chosen)
    assert flag is not None
    assert (flag.code, flag.evidence.value) == ("LID-W411", chosen.lam)
    assert "null-space" in flag.message
    assert guards.at_the_end(choose(smooth()[0])) is None


def test_the_whole_set_of_guards_names_what_it_found() -> None:
    codes = {f.code for f in guards.parameter(choose(coloured(0)), lambda factor: None)}
    assert {"LID-W403", "LID-W407"} <= codes


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


@pytest.mark.parametrize("seed", [700039, 700196])
def test_a_load_unlike_its_prior_does_not_contradict_the_noise_level(seed: int) -> None:
    """Impacts on one accelerometer: every fit that smooths much leaves them, and that says nothing of the noise."""
    given = long.problem(seed, samples=(1000, 1600))
    right, wrong = (
        Deconvolution(given.model, noise=s).estimate(given.record, given.model.dt).choice.shown
        for s in (given.sigma, given.sigma / 4)
    )
    assert right is None
    assert 2.5 < wrong < 6


@pytest.mark.parametrize("factor", [0.1, 0.25])
def test_a_noise_level_that_the_data_contradict_is_set_aside(factor: float) -> None:
    """A level far below the true one would let the noise through; the right level raises no alarm."""
    x = (np.arange(48) + 0.5) / 48
    H = 0.1 / np.pi / (0.01 + (x[:, None] - x) ** 2) / 48
    g = np.exp(-(((x - 0.4) / 0.1) ** 2))
    sigma = 0.01 * float(np.sqrt(np.mean((H @ g) ** 2)))
    ratios, alarms = [], 0
    for seed in range(10):
        path = SVDPath(LinearProblem.whitened(H, H @ g + sigma * np.random.default_rng(seed).standard_normal(48)))
        error = [np.linalg.norm(path.solution(lam, None).load - g) for lam in np.geomspace(*path.range, 80)]
        wrong, right = choose(path, sigma=factor * sigma), choose(path, sigma=sigma)
        alarms += right.shown is not None
        assert 0.4 * sigma < wrong.shown < 2 * sigma
        assert wrong.rule == "robust_gcv"
        ratios.append(np.linalg.norm(path.solution(wrong.lam, None).load - g) / min(error))
    assert np.max(ratios) < 2
    assert alarms <= 1


@pytest.mark.parametrize(("error", "number"), [("gain", 700100010), ("slow", 700100033)])
def test_a_fit_that_leaves_a_quarter_of_the_data_gives_way_to_one_that_explains_them(error: str, number: int) -> None:
    given = impacts.problem(number, error)  # as many sensors as loads, noise not stated: predicted error ends at a wall
    estimate = given.inversion(penalty=Penalty(variance="constant")).estimate(given.record, given.dt)
    wall = by_name(estimate.choice)["predicted_error"].lam
    assert wall is not None
    assert estimate.choice.lam < 0.1 * wall
    assert np.linalg.norm(estimate.load - given.truth) < 0.2 * np.linalg.norm(given.truth)
    assert np.linalg.norm(estimate.residual) < np.linalg.norm(given.record) / 4


def test_a_load_that_fits_the_error_of_the_model_gives_way_to_that_of_the_evidence() -> None:
    given = impacts.problem(750000016, "gain")  # gains 3 % wrong: the load that explains them is ten times the true one
    estimate = given.inversion(penalty=Penalty(variance="constant")).estimate(given.record, given.dt)
    assert estimate.choice.rule == "evidence"
    assert np.linalg.norm(estimate.load - given.truth) < 0.6 * np.linalg.norm(given.truth)


def test_a_slow_load_that_accelerometers_hardly_see_is_no_error_of_the_model() -> None:
    given = impacts.problem(760000023, "slow")  # eighteen times that of the evidence, by seventeen degrees of freedom
    estimate = given.inversion(penalty=Penalty(variance="constant")).estimate(given.record, given.dt)
    assert estimate.choice.rule != "evidence"
    assert np.linalg.norm(estimate.load - given.truth) < 0.2 * np.linalg.norm(given.truth)


def test_a_stated_level_may_leave_as_much_as_it_says() -> None:
    H, g = PROBLEMS["gravity"](64)
    sigma = float(np.sqrt(np.mean((H @ g) ** 2)))
    path = SVDPath(LinearProblem.whitened(H, H @ g + sigma * np.random.default_rng(0).standard_normal(64)))
    assert path.energy is not None
    assert path.at(choose(path, sigma=sigma).lam).residual2 > path.energy / 3


def test_the_energy_of_a_path_is_that_of_its_data() -> None:
    path = impact()
    assert path.energy == pytest.approx(np.sum(path.problem.y**2))
    assert path.at(LARGEST).residual2 == pytest.approx(path.energy, rel=1e-4)
