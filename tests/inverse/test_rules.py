"""Every rule against a brute-force search on its definition, from dense influence matrices."""

import numpy as np
import pytest
import scipy.stats

from loadid._inverse import rules
from loadid._inverse import rules as odds
from loadid._inverse.agreement import GRADES
from loadid._inverse.convolved.path import SpectralPath
from loadid.paths import LinearProblem, PathPoint, RegularizationPath, SVDPath, toeplitz
from structures._testing.spectra import padded_length
from structures.errors import InputError
from tests.benchmarks.fredholm import PROBLEMS
from tests.benchmarks.rules import PENALTIES, Outcome, Setting, outcomes

from .reference import augmented, echo, penalty

N, SIGMA = 48, 0.05
GRID = np.geomspace(3e-4, 1.0, 700)


def posed(name: str, seed: int = 0, truncated: bool = False) -> tuple[SVDPath, np.ndarray, np.ndarray, np.ndarray]:
    T = toeplitz(echo(N, 1, 1, seed=2, decay=12.0)).reshape(N, N)
    H = np.tril(np.ones((N, N))) @ T / 10
    g = np.exp(-0.5 * ((np.arange(N) - 18) / 3) ** 2)
    y = H @ g + SIGMA * np.random.default_rng(seed).standard_normal(N)
    L = penalty(name, N)
    problem = LinearProblem.whitened(H[:, None], y[:, None], L=None if name == "identity" else L, shape=(N, 1))
    return SVDPath(problem, truncated=truncated), H, y, L


class Brute:
    """Dense answers at many lambdas."""

    def __init__(self, name: str, seed: int = 0) -> None:
        self.path, self.H, self.y, self.L = posed(name, seed)
        self.lam = GRID[self.path.range[0] < GRID]
        at = [augmented(self.H, self.y, self.L, x * float(self.path.scale)) for x in self.lam]
        self.loads = np.array([a.load for a in at])
        self.residuals = np.array([a.residual for a in at])
        self.rho, self.eta = np.sum(self.residuals**2, axis=1), np.array([a.penalty2 for a in at])
        self.edf = np.array([np.trace(a.A) for a in at])
        self.edf2 = np.array([np.trace(a.A @ a.A) for a in at])

    def values(self, rule: str) -> np.ndarray:
        m, left = N, N - self.edf
        x = self.lam * float(self.path.scale)
        if rule == "gcv":
            return m * self.rho / left**2
        if rule == "robust_gcv":
            return (0.1 + 0.9 * self.edf2 / m) * m * self.rho / left**2
        if rule == "modified_gcv":
            d = m - 1.4 * self.edf
            return np.where(d > 0, m * self.rho / d**2, np.inf)
        if rule == "upre":
            return self.rho + 2 * SIGMA**2 * self.edf
        if rule == "quasi_optimality":
            return np.linalg.norm(np.gradient(self.loads, np.log(self.lam), axis=0), axis=1)
        assert rule == "evidence"  # prior on L g, its null space free: ln |H'H / x^2 + L'L| - ln |L'L|+
        HH, LL = self.H.T @ self.H, self.L.T @ self.L
        objective = self.rho + x**2 * self.eta
        free = N - len(self.L)
        logdet = np.array([np.linalg.slogdet(HH / v**2 + LL)[1] + 2 * free * np.log(v) for v in x])
        return logdet + objective / SIGMA**2


@pytest.fixture(scope="module", params=["identity", "first_difference"])
def brute(request: pytest.FixtureRequest) -> Brute:
    return Brute(request.param)


@pytest.mark.parametrize("rule", ["gcv", "robust_gcv", "modified_gcv", "upre", "evidence", "quasi_optimality"])
def test_minimum_is_the_one_of_the_definition(brute: Brute, rule: str) -> None:
    sweep = rules.Sweep.over(brute.path, SIGMA)
    found = rules.run(rule, sweep)
    inside = brute.lam >= (rules.among_modes(sweep, rule).lam[0] if rule == "quasi_optimality" else 0)
    values = np.where(inside, brute.values(rule), np.inf)
    best = brute.lam[np.argmin(values)]
    assert found.edge == (best in (brute.lam[inside][0], brute.lam[-1]))
    assert found.lam == pytest.approx(best, rel=0.03)
    at_found = np.interp(np.log(found.lam), np.log(brute.lam), brute.values(rule))
    assert at_found <= values.min() + 1e-3 * abs(values.min())


def test_evidence_without_a_noise_level_profiles_it_out(brute: Brute) -> None:
    free = N - len(brute.L)
    x = brute.lam * float(brute.path.scale)
    objective = brute.rho + x**2 * brute.eta
    logdet = brute.values("evidence") - objective / SIGMA**2
    best = brute.lam[np.argmin(logdet + (N - free) * np.log(objective))]
    assert rules.run("evidence", rules.Sweep.over(brute.path, None)).lam == pytest.approx(best, rel=0.03)


def test_ncp_against_its_definition(brute: Brute) -> None:
    def distance(residual: np.ndarray) -> float:
        power = np.abs(np.fft.fft(residual))[1 : N // 2 + 1] ** 2
        return float(np.linalg.norm(np.cumsum(power) / power.sum() - np.arange(1, N // 2 + 1) / (N // 2)))

    found = rules.run("ncp", rules.Sweep.over(brute.path, None))
    assert found.lam is not None
    values = np.array([distance(r) for r in brute.residuals])
    assert distance(brute.path.residual(found.lam).ravel()) <= 1.02 * values.min()


def test_ncp_statistic_of_white_noise_and_of_a_walk() -> None:
    noise = np.random.default_rng(0).standard_normal((2000, 3))
    assert rules.ncp_statistic(noise)[1] < 1.36
    assert rules.ncp_statistic(np.cumsum(noise, axis=0))[1] > 10
    power = np.sum([np.abs(np.fft.rfft(c)[1:]) ** 2 for c in noise.T], axis=0)
    expected = np.abs(np.cumsum(power) / power.sum() - np.arange(1, 1001) / 1000).max() * np.sqrt(3000)
    assert rules.ncp_statistic(noise)[1] == pytest.approx(expected)
    several = rules.ncp_statistic(np.stack([noise, np.cumsum(noise, axis=0)], axis=-1))
    each = [rules.ncp_statistic(r) for r in (noise, np.cumsum(noise, axis=0))]
    np.testing.assert_allclose(np.transpose(several), each, rtol=1e-12)
    with pytest.raises(rules.Refusal, match="ncp"):
        rules.ncp_statistic(np.zeros((10, 1)))


# -- discrepancy -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("m", [1, 20, 1000])
def test_discrepancy_level_is_the_chi_square_quantile(m: int) -> None:
    assert rules.discrepancy_level(m, 0.3) == pytest.approx(0.09 * scipy.stats.chi2.ppf(0.95, m), rel=1e-9)


def test_discrepancy_meets_its_level_and_grows_with_the_noise(brute: Brute) -> None:
    assert np.all(np.diff(brute.rho) > 0)  # one crossing
    found = [rules.run("discrepancy", rules.Sweep.over(brute.path, s)) for s in (0.7 * SIGMA, SIGMA, 2 * SIGMA)]
    lams = [r.lam for r in found if r.lam is not None]
    assert len(lams) == 3
    assert lams == sorted(lams)
    level = SIGMA**2 * scipy.stats.chi2.ppf(0.95, N)
    assert float(brute.path.at(lams[1]).residual2) == pytest.approx(level, rel=1e-6)
    doubled = rules.discrepancy(rules.Sweep.over(brute.path, SIGMA), 2.0)
    assert doubled.lam == pytest.approx(lams[2], rel=1e-9)


def test_dof_discrepancy_is_the_largest_crossing(brute: Brute) -> None:
    below = brute.rho < SIGMA**2 * (N - brute.edf)
    expected = brute.lam[np.flatnonzero(below)[-1]]
    assert rules.run("dof_discrepancy", rules.Sweep.over(brute.path, SIGMA)).lam == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(("sigma", "end", "note"), [(1e-9, 0, "stays above"), (1e3, -1, "within the noise")])
def test_discrepancy_without_a_crossing_is_flagged(sigma: float, end: int, note: str) -> None:
    T = np.vstack([posed("identity")[1]] * 2)  # twice the data: a residual remains
    y = np.random.default_rng(0).standard_normal(2 * N)
    sweep = rules.Sweep.over(SVDPath(LinearProblem.whitened(T, y)), sigma)
    found = rules.run("discrepancy", sweep)
    assert found.edge
    assert note in found.note
    assert found.lam == sweep.lam[end]


# -- L-curve ---------------------------------------------------------------------------------------------------------
def test_curvature_against_the_analytic_formula(brute: Brute) -> None:
    path = brute.path
    lam = np.geomspace(3e-3, 0.5, 3000)
    p, x = path.at(lam), lam * float(path.scale)
    f = path.c**2 / (path.c**2 + np.outer(x, path.s) ** 2)
    gain = np.where(path.c > 0, f / np.where(path.c > 0, path.c, 1), 0)
    slope = -4 / x * np.sum((1 - f) * (path.s * gain * path.beta) ** 2, axis=1)
    eta, rho = p.penalty2, p.residual2
    top = x**2 * slope * rho + 2 * x * eta * rho + x**4 * eta * slope
    expected = -2 * eta * rho / slope * top / (x**4 * eta**2 + rho**2) ** 1.5
    inner = slice(20, -20)
    ours = rules.curvature(lam, rho, eta)[inner]
    assert np.abs(ours - expected[inner]).max() < 2e-3 * np.abs(expected).max()
    assert np.any(expected > 0)
    assert np.any(expected < 0)  # the sign matters: the largest magnitude alone may be the wrong bend


def test_curvature_of_a_circle_is_one_over_its_radius_with_the_sign_of_a_corner() -> None:
    t = np.linspace(0.1, np.pi / 2 - 0.1, 400)
    for radius in (0.5, 3.0):
        # down, then to the right: the corner of an L
        corner = rules.curvature(np.exp(t), np.exp(-2 * radius * np.cos(t)), np.exp(-2 * radius * np.sin(t)))
        np.testing.assert_allclose(corner[5:-5], 1 / radius, rtol=1e-3)
        bend = rules.curvature(np.exp(t), np.exp(2 * radius * np.sin(t)), np.exp(2 * radius * np.cos(t)))
        np.testing.assert_allclose(bend[5:-5], -1 / radius, rtol=1e-3)


def test_l_curve_takes_the_largest_positive_curvature(brute: Brute) -> None:
    sweep = rules.Sweep.over(brute.path, None)
    kappa = rules.curvature(sweep.lam, sweep.point.residual2, sweep.point.penalty2)
    found = rules.run("l_curve", sweep)
    k = int(np.argmin(np.abs(sweep.lam - found.lam)))
    assert kappa[k] == kappa[rules.EDGE : -rules.EDGE].max() > 0


def test_an_l_curve_without_a_corner_is_refused() -> None:
    t = np.linspace(0, 1, 50)
    point = PathPoint(np.exp(2 * np.sin(t)), np.exp(2 * np.cos(t)))
    found = rules.run("l_curve", rules.Sweep(posed("identity")[0], np.exp(t), point, None))
    assert found.lam is None
    assert "no corner" in found.note


# -- predicted error -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["identity", "first_difference"])
def test_predicted_error_is_the_parametric_bootstrap(name: str) -> None:
    path, H, _, L = posed(name)
    rng, pilot, lams = np.random.default_rng(3), 0.02, [3e-3, 0.02, 0.1]
    load = path.solution(pilot, None).load.ravel()
    data = (H @ load)[:, None] + SIGMA * rng.standard_normal((N, 4000))
    drawn = []
    for lam in lams:
        error = augmented(H, data, L, lam * float(path.scale)).load - load[:, None]
        drawn.append(np.mean(np.sum(error**2, axis=0)))
    np.testing.assert_allclose(path.predicted_error(lams, pilot, SIGMA), drawn, rtol=0.03)


def test_predicted_error_of_the_fft_path_is_the_one_of_the_dense_path() -> None:
    n, pilot = 160, 0.05
    h = echo(n, 1, 1, seed=1, decay=8.0)
    padded = padded_length(n)
    T = toeplitz(h)
    y = T @ np.exp(-0.5 * ((np.arange(n) - 70) / 3) ** 2) + 0.02 * np.random.default_rng(0).standard_normal((n, 1))
    dense = SVDPath(LinearProblem.whitened(T, y, shape=(n, 1)))
    fast = SpectralPath(np.fft.rfft(h, padded, axis=0), y, np.full((padded // 2 + 1, 1), float(n)))
    x = np.array([0.01, 0.05, 0.2]) * float(dense.scale)
    a = dense.predicted_error(x / float(dense.scale), pilot, 0.02)
    b = fast.predicted_error(x / float(fast.scale), pilot * float(dense.scale / fast.scale), 0.02)
    np.testing.assert_allclose(b, a, rtol=0.1)


# -- refusals, edges -------------------------------------------------------------------------------------------------
class Stub(RegularizationPath):
    """A path that knows its residual and its penalty norm, and nothing else."""

    m, null, scale, smooth, range, coefficients = 30, 0, 1.0, True, (1e-4, 1.0), None

    def __init__(self, **known: object) -> None:
        self.known = known

    def at(self, lam: object) -> PathPoint:
        lam = np.asarray(lam, float)
        given = {name: f(lam) for name, f in self.known.items()}
        return PathPoint(1 + 30 * lam**2, 1 / (lam + 0.01), **given)

    def predicted_error(self, lam: object, pilot: float, sigma: float) -> None:
        return None

    def residual(self, lam: float) -> np.ndarray:
        return np.random.default_rng(0).standard_normal((30, 1))


MISSING = {
    "upre": "edf",
    "gcv": "left",
    "robust_gcv": "edf2",
    "modified_gcv": "edf",
    "quasi_optimality": "sensitivity",
    "evidence": "objective",
    "dof_discrepancy": "left",
    "predicted_error": "",
}


@pytest.mark.parametrize("rule", MISSING)
def test_a_rule_names_what_the_path_lacks(rule: str) -> None:
    found = rules.run(rule, rules.Sweep.over(Stub(), 0.1))
    assert found.lam is None
    assert rule in found.note
    assert MISSING[rule] in found.note


@pytest.mark.parametrize("rule", ["discrepancy", "l_curve", "ncp"])
def test_rules_that_need_no_degrees_of_freedom_run(rule: str) -> None:
    assert rules.run(rule, rules.Sweep.over(Stub(), 0.3)).lam is not None


@pytest.mark.parametrize("rule", ["discrepancy", "dof_discrepancy", "upre"])
def test_rules_of_the_noise_refuse_without_it(rule: str) -> None:
    found = rules.run(rule, rules.Sweep.over(posed("identity")[0], None))
    assert found.lam is None
    assert f"{rule} needs the noise level" == found.note


def test_a_path_that_predicts_no_error_is_refused_by_name() -> None:
    count = {
        "edf": lambda x: 20 / (1 + 100 * x),
        "edf2": lambda x: 15 / (1 + 100 * x),
        "left": lambda x: 30 - 20 / (1 + 100 * x),
    }
    found = rules.run("predicted_error", rules.Sweep.over(Stub(**count), None))
    assert found.lam is None
    assert "predicted_error" in found.note


def test_unknown_rules_are_refused_with_the_list() -> None:
    with pytest.raises(InputError, match="robust_gcv"):
        rules.run("l-curve", rules.Sweep.over(posed("identity")[0], None))


@pytest.mark.parametrize("rule", ["gcv", "robust_gcv", "upre"])
def test_an_answer_at_the_end_of_the_sweep_is_flagged(rule: str) -> None:
    H = np.eye(30) + 0.1 * np.random.default_rng(0).standard_normal((30, 30))
    sweep = rules.Sweep.over(SVDPath(LinearProblem.whitened(H, np.random.default_rng(1).standard_normal(30))), 1e-3)
    pure = Stub(edf=lambda x: x * 0 + 5, edf2=lambda x: x * 0 + 5, left=lambda x: x * 0 + 25)
    assert rules.run(rule, rules.Sweep.over(pure, 1e-3)).edge  # residual falls all the way down
    if rule == "upre":  # almost no noise, well conditioned: next to no regularisation
        assert rules.run(rule, sweep).lam < 0.01


def test_data_of_zero_do_not_break_a_rule() -> None:
    _, H, _, L = posed("first_difference")
    path = SVDPath(LinearProblem.whitened(H, np.zeros(N), L=L))
    for sigma in (None, 0.1):
        sweep = rules.Sweep.over(path, sigma)
        for name in rules.RULES:
            found = rules.run(name, sweep)
            assert found.lam is None or found.lam > 0


@pytest.mark.parametrize("rule", ["gcv", "robust_gcv", "upre", "discrepancy", "ncp"])
def test_truncated_paths_keep_the_rules(rule: str) -> None:
    path, *_ = posed("identity", truncated=True)
    sweep = rules.Sweep.over(path, SIGMA)
    found = rules.run(rule, sweep)
    g = np.exp(-0.5 * ((np.arange(N) - 18) / 3) ** 2)
    error = [np.linalg.norm(path.X @ path.gains(x) - g) for x in (*sweep.lam, found.lam)]
    assert error[-1] < 3 * min(error)


# -- ends of the range -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("rule", ["discrepancy", "upre", "predicted_error"])
def test_a_load_that_the_penalty_does_not_see_gives_the_null_space_solution(rule: str) -> None:
    H, g = PROBLEMS["foxgood"](64)
    L = np.diff(np.eye(64), 2, axis=0)
    path = SVDPath(LinearProblem.whitened(H, H @ g, L=L))
    found = rules.run(rule, rules.Sweep.over(path, 1e-6))
    assert (found.edge, found.free) == (True, True)
    assert "null-space" in found.note
    np.testing.assert_allclose(path.solution(found.lam, None).load, g, atol=1e-5)


def test_only_a_penalty_with_a_null_space_lengthens_the_sweep() -> None:
    plain, bent = (rules.Sweep.over(posed(name)[0], None, 150) for name in ("identity", "second_difference"))
    assert len(plain.lam) == 150
    assert plain.lam[-1] == pytest.approx(1.0)
    assert not plain.ends_free
    assert bent.lam[-1] == pytest.approx(1e3)
    assert bent.ends_free
    assert np.all(np.diff(bent.lam) > 0)


def test_the_sweep_reaches_below_the_smallest_singular_value_of_a_good_problem() -> None:
    H = np.diag(np.linspace(1, 0.2, 20))
    sweep = rules.Sweep.over(SVDPath(LinearProblem.whitened(H, np.ones(20))), None)
    assert sweep.lam[0] == pytest.approx(1e-3 * 0.2)


# -- noise level -----------------------------------------------------------------------------------------------------
def test_sensitivity_to_the_noise_level_is_what_the_rule_says_at_each(brute: Brute) -> None:
    sweep = rules.Sweep.over(brute.path, SIGMA)
    each = [rules.discrepancy(sweep, factor).lam for factor in (0.7, 1.0, 2.0)]
    np.testing.assert_allclose(rules.sensitivity(sweep, (0.7, 1.0, 2.0)), each, rtol=0.02)
    assert rules.sensitivity(sweep, (1e-9, 1e9)) == (None, None)
    with pytest.raises(rules.Refusal, match="noise level"):
        rules.sensitivity(rules.Sweep.over(brute.path, None))


# -- L-curve ---------------------------------------------------------------------------------------------------------
def test_closed_form_of_the_curvature_is_the_derivative(brute: Brute) -> None:
    lam = np.geomspace(2e-3, 0.9, 4000)
    p = brute.path.at(lam)
    closed = rules.curvature(lam, p.residual2, p.penalty2, p.bend, float(brute.path.scale))
    grid = rules.curvature(lam, p.residual2, p.penalty2)
    np.testing.assert_allclose(closed[5:-5], grid[5:-5], rtol=2e-3, atol=2e-3 * np.abs(grid).max())
    np.testing.assert_allclose(p.bend, np.gradient(p.penalty2, np.log(lam)), rtol=1e-3, atol=1e-3 * p.penalty2.max())


def test_curvature_has_no_units(brute: Brute) -> None:
    lam = np.geomspace(2e-3, 0.9, 40)
    big = SVDPath(LinearProblem.whitened(brute.H * 1e6, brute.y * 1e-3, L=brute.path.problem.L))
    p, q = brute.path.at(lam), big.at(lam)
    a = rules.curvature(lam, p.residual2, p.penalty2, p.bend, float(brute.path.scale))
    b = rules.curvature(lam, q.residual2, q.penalty2, q.bend, float(big.scale))
    np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9)


# -- reliability -----------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def sample() -> dict[str, list[Outcome]]:
    """A small part of the benchmark: two draws, the middle size and level."""
    settings = [Setting(p, 64, L) for p in PROBLEMS for L in PENALTIES]
    return {
        kind: [o for s in settings for o in outcomes((s, 4, kind), levels=(1e-3,))] for kind in ("white", "AR(1) 0.9")
    }


def of(found: list[Outcome], rule: str, known: bool = False) -> np.ndarray:
    return np.array([o.ratio[known][rule] for o in found])


def test_default_is_close_to_the_best_lambda(sample: dict[str, list[Outcome]]) -> None:
    for known in (False, True):
        default = of(sample["white"], "default", known)
        assert np.median(default) < (1.35 if known else 1.15)
        assert np.quantile(default, 0.9) < 2.5
        assert np.mean(default > 3) <= 0.07
    assert np.mean(of(sample["white"], "gcv") > 3) > 0.1  # GCV alone fails in a fifth of all cases
    assert np.mean(of(sample["AR(1) 0.9"], "default") > 3) < 0.5 * np.mean(of(sample["AR(1) 0.9"], "gcv") > 3)
    assert np.mean(of(sample["AR(1) 0.9"], "default", True) > 3) < 0.1


def test_verdicts_are_worth_what_the_table_says(sample: dict[str, list[Outcome]]) -> None:
    """The pinned odds, measured again on a small part."""
    for known in (False, True):
        for k, kind in enumerate(("white", "AR(1) 0.9")):
            shares = [odds.MEASURED[grade, known][k].share for grade in GRADES]
            assert sum(shares) == pytest.approx(1, abs=0.01)
            flagged = np.mean([o.verdict[known] in GRADES[2:] for o in sample[kind]])
            assert flagged == pytest.approx(sum(shares[2:]), abs=0.2)
        good = [o.ratio[known]["default"] for o in sample["white"] if o.verdict[known] == "determined"]
        pinned = odds.MEASURED["determined", known][0]
        assert np.median(good) == pytest.approx(pinned.median, abs=0.15)
        assert np.mean(np.array(good) > 3) <= pinned.lost + 0.05


def test_odds_in_words_hold_the_numbers() -> None:
    text = odds.in_words("determined", False)
    o = odds.MEASURED["determined", False][0]
    assert f"{o.share:.0%}" in text
    assert f"{o.median:.2f}x" in text


def error_ratios(H: np.ndarray, g: np.ndarray, eta: float, rule: str, draws: int) -> np.ndarray:
    """Load error of one rule over the smallest error, noise level not known."""
    clean, found = H @ g, []
    for seed in range(draws):
        noise = np.random.default_rng(seed).standard_normal(len(clean))
        path = SVDPath(LinearProblem.whitened(H, clean + eta * np.sqrt(np.mean(clean**2)) * noise))
        lam = rules.run(rule, rules.Sweep.over(path, None)).lam
        error = [np.linalg.norm(path.X @ path.gains(x) - g) for x in (lam, *np.geomspace(*path.range, 60))]
        found.append(error[0] / min(error))
    return np.array(found)


def test_a_residual_that_is_small_by_chance_does_not_win() -> None:
    """All but two modes are needed: the noise shows on two degrees of freedom, and GCV's tail wins every third time."""
    n = 60
    rng = np.random.default_rng(0)
    U, V = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    H = (U * np.concatenate([np.geomspace(1, 3e-2, n - 2), [1e-9, 1e-10]])) @ V.T
    g = V @ np.concatenate([rng.standard_normal(n - 2), [0, 0]])
    assert np.mean(error_ratios(H, g, 0.01, "robust_gcv", 30) > 3) > 0.15
    assert np.mean(error_ratios(H, g, 0.01, "predicted_error", 30) > 3) < 0.05


def test_data_that_need_no_regularisation_get_none() -> None:
    """Robust GCV gives up a factor of ten in the residual to spare degrees of freedom; here they are all needed."""
    H = toeplitz(echo(120, 1, 1, seed=3, decay=20.0)).reshape(120, 120)
    g = np.exp(-0.5 * ((np.arange(120) - 50) / 2.0) ** 2)
    assert np.median(error_ratios(H, g, 0.01, "robust_gcv", 4)) > 3
    assert np.max(error_ratios(H, g, 0.01, "predicted_error", 4)) < 1.1
