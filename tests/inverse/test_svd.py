"""The dense path against augmented least squares, every shape and every penalty."""

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid._inverse import rules
from loadid._inverse import svd as gsvd
from loadid.paths import LinearProblem, SVDPath, choose
from structures.errors import InputError, NotIdentifiable

from .reference import augmented, echo, ill_conditioned, penalty

SHAPES = [(14, 9), (9, 9), (7, 10)]
PENALTIES = ["none", "identity", "first_difference", "second_difference", "user"]
LAMS = [1e-5, 1e-3, 0.04, 0.7]


def posed(m: int, n: int, name: str, kappa: float = 1e4) -> tuple[SVDPath, np.ndarray, np.ndarray, np.ndarray]:
    H, y = ill_conditioned(m, n, kappa, seed=m), np.random.default_rng(n).standard_normal(m)
    L = np.eye(n) if name == "none" else penalty(name, n)
    return SVDPath(LinearProblem.whitened(H, y, L=None if name == "none" else L)), H, y, L


@pytest.mark.parametrize("name", PENALTIES)
@pytest.mark.parametrize(("m", "n"), SHAPES)
def test_every_scalar_against_augmented_least_squares(m: int, n: int, name: str) -> None:
    path, H, y, L = posed(m, n, name)
    p = path.at(LAMS)
    for k, lam in enumerate(LAMS):
        x = lam * float(path.scale)
        ref = augmented(H, y, L, x)
        solution = path.solution(lam, None)
        np.testing.assert_allclose(solution.load, ref.load, rtol=1e-8, atol=1e-9 * np.abs(ref.load).max())
        np.testing.assert_allclose(path.residual(lam).ravel(), ref.residual, atol=1e-9)
        assert p.residual2[k] == pytest.approx(ref.residual @ ref.residual, rel=1e-8, abs=1e-13)
        assert p.penalty2[k] == pytest.approx(ref.penalty2, rel=1e-8)
        assert p.edf[k] == pytest.approx(np.trace(ref.A), rel=1e-10)
        assert p.edf2[k] == pytest.approx(np.trace(ref.A @ ref.A), rel=1e-10)
        assert p.left[k] == pytest.approx(m - np.trace(ref.A), rel=1e-6, abs=1e-12)
        assert p.objective[k] == pytest.approx(ref.residual @ ref.residual + x**2 * ref.penalty2, rel=1e-8)
        step = 1e-4
        high, low = (augmented(H, y, L, x * np.exp(s)).load for s in (step, -step))
        assert p.sensitivity[k] == pytest.approx(np.linalg.norm(high - low) / (2 * step), rel=1e-5)
        single = path.at(lam)
        assert single.residual2.shape == ()
        assert float(single.edf) == p.edf[k]


@pytest.mark.parametrize("name", ["none", "first_difference", "user"])
def test_data_left_over_are_counted_without_cancellation(name: str) -> None:
    path, H, _, L = posed(9, 9, name, kappa=100)
    lam = 1e-10  # m - edf is 1e-16 or less of m: subtraction leaves nothing
    x = lam * float(path.scale)
    expected = x**2 * np.linalg.norm(np.linalg.solve(H.T, L.T)) ** 2  # first order in lambda^2
    assert expected < 9 * np.finfo(float).eps
    assert float(path.at(lam).left) == pytest.approx(expected, rel=1e-6)


def test_evidence_is_the_gaussian_marginal_likelihood() -> None:
    path, H, y, _ = posed(14, 9, "none", kappa=50)
    for lam, sigma in [(0.03, 0.4), (0.3, 2.0)]:
        x = lam * float(path.scale)
        S = sigma**2 * (np.eye(14) + H @ H.T / x**2)  # load ~ N(0, sigma^2 / lambda^2)
        p = path.at(lam)
        ours = -0.5 * (p.log_ratio + p.objective / sigma**2 + 14 * np.log(2 * np.pi * sigma**2))
        assert ours == pytest.approx(scipy.stats.multivariate_normal(np.zeros(14), S).logpdf(y), rel=1e-11)


@pytest.mark.parametrize(("name", "null"), [("first_difference", 1), ("second_difference", 2), ("user", 0)])
def test_generalised_singular_values_against_a_symmetric_pencil(name: str, null: int) -> None:
    path, H, _, L = posed(14, 9, name, kappa=20)
    assert path.null == null
    mu = scipy.linalg.eigh(H.T @ H, H.T @ H + L.T @ L, eigvals_only=True)  # c^2, well conditioned here
    mu = mu[: 9 - null]
    gamma = np.sqrt(mu / (1 - mu))
    ours = path.coefficients.gamma
    np.testing.assert_allclose(np.sort(ours[ours > 0]), gamma, rtol=1e-8)
    assert float(path.scale) == pytest.approx(gamma.max(), rel=1e-8)
    expected = np.sum(np.log1p((gamma / (0.1 * gamma.max())) ** 2))
    assert float(path.at(0.1).log_ratio) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("name", ["none", "first_difference"])
def test_small_lambda_keeps_its_digits(name: str) -> None:
    """Normal equations are wrong by 6e-2 here."""
    H = ill_conditioned(150, 120, 1e10)
    g = np.sin(np.arange(120) / 9)
    y, L = H @ g, penalty("identity" if name == "none" else name, 120)
    path = SVDPath(LinearProblem.whitened(H, y, L=None if name == "none" else L))
    lam = 1e-8 / float(path.scale)
    ref = np.linalg.lstsq(np.vstack([H, 1e-8 * L]), np.concatenate([y, np.zeros(len(L))]), rcond=None)[0]
    assert np.linalg.norm(path.solution(lam, None).load - ref) < 1e-6 * np.linalg.norm(ref)


def test_filter_factor_is_one_half_at_sigma_and_falls_as_the_square() -> None:
    path = SVDPath(LinearProblem.whitened(np.diag([2.0, 2.0]), np.array([1.0, 0.0])))
    assert float(path.at(1.0).edf) == pytest.approx(1.0, rel=1e-15)  # two modes, one half each
    assert float(path.at(1e6).edf) == pytest.approx(2e-12, rel=1e-10)
    # the coefficient is phi / sigma times the data, not phi
    np.testing.assert_allclose(path.solution(1.0, None).load, [2 / (2**2 + 2**2), 0], rtol=1e-15)


@pytest.mark.parametrize("shape", [(8, 6), (6, 6), (5, 8)])
def test_sums_run_over_the_rank(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    H = rng.standard_normal((shape[0], 3)) @ rng.standard_normal((3, shape[1]))
    y = rng.standard_normal(shape[0])
    path = SVDPath(LinearProblem.whitened(H, y))
    assert path.rank == 3
    expected = np.linalg.lstsq(H, y, rcond=1e-10)[0]
    for lam in (0.0, 1e-9):
        np.testing.assert_allclose(path.solution(lam, 0.1).load, expected, atol=1e-9)
        assert np.all(np.isfinite(path.solution(lam, 0.1).posterior.std))
    assert float(path.at(0.0).edf) == pytest.approx(3)
    assert float(path.at(0.0).left) == pytest.approx(shape[0] - 3)
    assert np.isfinite(choose(path).lam)


def test_a_load_that_nothing_sees_is_named() -> None:
    H = np.diff(np.random.default_rng(0).standard_normal((9, 8)), axis=1) @ np.diff(np.eye(8), axis=0)
    with pytest.raises(NotIdentifiable, match="constant") as caught:
        SVDPath(LinearProblem.whitened(H, np.ones(9), L=penalty("first_difference", 8)))
    assert caught.value.code == "LID-E306"
    assert SVDPath(LinearProblem.whitened(H, np.ones(9))).rank == 7  # L = I: the prior fills it


def test_a_hidden_unknown_is_named_by_its_number() -> None:
    rng = np.random.default_rng(1)
    H, L = rng.standard_normal((9, 6)), rng.standard_normal((4, 6))
    H[:, 3] = L[:, 3] = 0
    with pytest.raises(NotIdentifiable, match=r"unknowns \[3\]"):
        SVDPath(LinearProblem.whitened(H, np.ones(9), L=L))
    with pytest.raises(NotIdentifiable):  # fewer rows than unknowns
        SVDPath(LinearProblem.whitened(H[:1], np.ones(1), L=L))


def test_problems_without_meaning_are_refused() -> None:
    y = np.ones(5)
    with pytest.raises(InputError, match="forward model is zero"):
        SVDPath(LinearProblem.whitened(np.zeros((5, 3)), y))
    with pytest.raises(InputError, match="penalty matrix is zero"):
        SVDPath(LinearProblem.whitened(np.eye(5), y, L=np.zeros((2, 5))))
    with pytest.raises(InputError, match="complex"):
        SVDPath(LinearProblem.whitened(np.eye(5) * 1j, y))
    with pytest.raises(InputError, match="range of numbers"):
        SVDPath(LinearProblem.whitened(np.eye(5) * 1e-170, y))
    for lam in (np.nan, -0.1, [0.1, np.nan]):
        with pytest.raises(InputError, match="lambda"):
            SVDPath(LinearProblem.whitened(np.eye(5), y)).at(lam)


@pytest.mark.parametrize("name", ["none", "first_difference"])
def test_truncation_keeps_the_modes_above_lambda(name: str) -> None:
    H, y = ill_conditioned(14, 9, 1e4), np.random.default_rng(0).standard_normal(14)
    L = None if name == "none" else penalty(name, 9)
    path = SVDPath(LinearProblem.whitened(H, y, L=L), truncated=True)
    gamma = np.sort(path.coefficients.gamma)[::-1]
    for kept in (1, 4, 7):
        lam = float(np.sqrt(gamma[kept - 1] * gamma[kept]) / gamma[0])
        p = path.at(lam)
        assert float(p.edf) == float(p.edf2) == kept + path.null
        assert (p.sensitivity, p.objective, p.log_ratio) == (None, None, None)
        g = path.solution(lam, None).load
        if L is None:
            U, s, Vt = np.linalg.svd(H)
            np.testing.assert_allclose(g, Vt[:kept].T @ ((U.T @ y)[:kept] / s[:kept]), rtol=1e-9)
        else:  # kept modes fit the data exactly: their residual is orthogonal to what they produce
            assert abs((y - H @ g) @ (H @ g)) < 1e-10
        assert float(p.residual2) == pytest.approx(np.sum((y - H @ g) ** 2))
    assert rules.run("l_curve", rules.Sweep.over(path, None)).lam is None


def test_resolution_is_the_answer_to_a_load_without_noise() -> None:
    for m, n in SHAPES:
        for name in ("none", "first_difference"):
            path, H, _, L = posed(m, n, name)
            g = np.random.default_rng(8).standard_normal(n)
            expected = augmented(H, H @ g, L, 0.02 * float(path.scale)).load
            np.testing.assert_allclose(path.resolve(g, 0.02), expected, rtol=1e-7, atol=1e-9)


@given(st.sampled_from([1e-6, 1e6]), st.sampled_from([1e-6, 1e6]), st.sampled_from(["identity", "second_difference"]))
@settings(max_examples=8, deadline=None)
def test_units_change_nothing(model: float, data: float, name: str) -> None:
    H = scipy.linalg.toeplitz(echo(40)[:, 0, 0], np.zeros(40))
    g = np.exp(-0.5 * ((np.arange(40) - 15) / 3) ** 2)
    y = H @ g + 0.02 * np.random.default_rng(0).standard_normal(40)
    L = None if name == "identity" else penalty(name, 40)
    one, two = SVDPath(LinearProblem.whitened(H, y, L=L)), SVDPath(LinearProblem.whitened(model * H, data * y, L=L))
    for sigma in (None, 0.02):
        a = choose(one, sigma=sigma)
        b = choose(two, sigma=None if sigma is None else sigma * data)
        for first, second in zip(a.rules, b.rules, strict=True):
            assert (first.lam is None) == (second.lam is None)
            if first.lam is not None and first.rule != "l_curve":
                assert second.lam == pytest.approx(first.lam, rel=1e-6), first.rule
        assert b.lam == pytest.approx(a.lam, rel=1e-6)
    x, z = one.solution(0.01, 0.02), two.solution(0.01, 0.02 * data)
    scale = data / model
    np.testing.assert_allclose(z.load, scale * x.load, rtol=1e-9, atol=1e-9 * scale)
    np.testing.assert_allclose(z.posterior.std, scale * x.posterior.std, rtol=1e-9)
    np.testing.assert_allclose(one.at([0.01, 0.1]).edf, two.at([0.01, 0.1]).edf, rtol=1e-9)


@pytest.mark.parametrize(("m", "n"), [(12, 7), (7, 7), (6, 9)])
def test_traces_of_what_a_fit_leaves(m: int, n: int) -> None:
    rng = np.random.default_rng(5)
    H, y = rng.standard_normal((m, n)), rng.standard_normal(m)
    path = SVDPath(LinearProblem.whitened(H, y))
    x = 0.3 * float(path.scale)
    rest = np.eye(m) - H @ np.linalg.lstsq(np.vstack([H, x * np.eye(n)]), np.vstack([np.eye(m), np.zeros((n, m))]))[0]
    point = path.at(0.3)
    assert point.left == pytest.approx(np.trace(rest), rel=1e-10)
    assert point.rest2 == pytest.approx(np.trace(rest @ rest), rel=1e-10)
    assert point.rest4 == pytest.approx(np.trace(rest @ rest @ rest @ rest), rel=1e-10)


# -- frames: one lambda for all --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["none", "second_difference", "user"])
@pytest.mark.parametrize(("m", "n"), SHAPES)
def test_frames_are_sums_over_single_problems(m: int, n: int, name: str) -> None:
    rng = np.random.default_rng(m)
    H, Y = ill_conditioned(m, n, 1e3, seed=m), rng.standard_normal((5, m))
    L = None if name == "none" else penalty(name, n)
    joint = SVDPath(LinearProblem.whitened(H, Y, L=L))
    each = [SVDPath(LinearProblem.whitened(H, y, L=L)) for y in Y]
    assert (joint.m, joint.null) == (5 * m, 5 * each[0].null)
    assert float(joint.scale) == float(each[0].scale)
    a, b = joint.at(LAMS), [p.at(LAMS) for p in each]
    for field in ("residual2", "penalty2", "edf", "edf2", "left", "rest2", "rest4", "objective", "log_ratio"):
        np.testing.assert_allclose(getattr(a, field), sum(getattr(p, field) for p in b), rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(a.sensitivity**2, sum(p.sensitivity**2 for p in b), rtol=1e-8)
    predicted = [p.predicted_error(LAMS, 0.1, 0.3) for p in each]
    np.testing.assert_allclose(joint.predicted_error(LAMS, 0.1, 0.3), np.sum(predicted, axis=0), rtol=1e-8)
    squares = np.mean([p.coefficients.beta**2 for p in each], axis=0)
    np.testing.assert_allclose(joint.coefficients.beta**2, squares, rtol=1e-9, atol=1e-25)
    for lam in LAMS:
        solution = joint.solution(lam, 0.2)
        singles = [p.solution(lam, 0.2) for p in each]
        np.testing.assert_allclose(solution.load, [s.load for s in singles], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(solution.posterior.std, [s.posterior.std for s in singles], rtol=1e-12)
        np.testing.assert_allclose(joint.residual(lam), [p.residual(lam) for p in each], atol=1e-9)
        g = rng.standard_normal((5, n))
        np.testing.assert_allclose(joint.resolve(g, lam), [each[0].resolve(x, lam) for x in g], atol=1e-8)


def test_rules_run_on_frames_and_one_frame_is_the_single_problem() -> None:
    H, Y = ill_conditioned(14, 9, 1e4), np.random.default_rng(1).standard_normal((1, 14))
    for L in (None, penalty("first_difference", 9)):
        one, framed = (SVDPath(LinearProblem.whitened(H, y, L=L)) for y in (Y[0], Y))
        a, b = choose(one, sigma=0.3), choose(framed, sigma=0.3)
        assert b.lam == pytest.approx(a.lam, rel=1e-9)
        assert framed.solution(b.lam, None).load.shape == (1, 9)
    noise = 0.01 * np.random.default_rng(2).standard_normal((40, 14))
    many = SVDPath(LinearProblem.whitened(H, H @ np.sin(np.arange(9) / 2) + noise, L=L))
    said = {r.rule: r for r in choose(many, sigma=0.01).rules}
    for rule in ("discrepancy", "upre", "gcv", "robust_gcv", "ncp", "evidence"):
        assert said[rule].lam is not None, rule


def test_new_data_on_the_same_factors() -> None:
    H, rng = ill_conditioned(14, 9, 1e4), np.random.default_rng(0)
    for truncated in (False, True):
        path = SVDPath(LinearProblem.whitened(H, rng.standard_normal(14), L=penalty("user", 9)), truncated=truncated)
        before = path.solution(0.1, None).load.copy()
        y, Y = rng.standard_normal(14), rng.standard_normal((14, 3))
        for data in (y, Y):
            other, fresh = (
                path.with_data(data),
                SVDPath(LinearProblem.whitened(H, data.T, L=penalty("user", 9)), truncated=truncated),
            )
            assert other.X is path.X
            np.testing.assert_allclose(other.solution(0.1, None).load, fresh.solution(0.1, None).load, rtol=1e-9)
            np.testing.assert_allclose(other.residual(0.1), fresh.residual(0.1), atol=1e-12)
            np.testing.assert_allclose(other.at(LAMS).penalty2, fresh.at(LAMS).penalty2, rtol=1e-10)
            assert (other.smooth, other.m) == (fresh.smooth, fresh.m)
        np.testing.assert_array_equal(path.solution(0.1, None).load, before)
    for wrong in (np.ones(13), np.ones((2, 14)), np.full(14, np.nan), np.ones((14, 0))):
        with pytest.raises(InputError, match="data"):
            path.with_data(wrong)


# -- operators at one lambda -----------------------------------------------------------------------------------------
@pytest.mark.parametrize("truncated", [False, True])
@pytest.mark.parametrize("name", PENALTIES)
@pytest.mark.parametrize(("m", "n"), SHAPES)
def test_operators_at_one_lambda(m: int, n: int, name: str, truncated: bool) -> None:
    H, y = ill_conditioned(m, n, 1e3, seed=m), np.random.default_rng(n).standard_normal(m)
    L = np.eye(n) if name == "none" else penalty(name, n)
    path = SVDPath(LinearProblem.whitened(H, y, L=None if name == "none" else L), truncated=truncated)
    for lam in (1e-2, 0.3):
        G, f = path.inverse(lam), path.filter_factors(lam)
        assert (G.shape, f.shape) == ((n, m), (n,))
        np.testing.assert_allclose(G @ y, path.solution(lam, None).load, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(path.resolution(lam), G @ H, atol=1e-8)
        assert f.sum() == pytest.approx(float(path.at(lam).edf), rel=1e-10)
        if not truncated:
            Q, R = np.linalg.qr(np.vstack([H, lam * float(path.scale) * L]))
            np.testing.assert_allclose(G, np.linalg.solve(R, Q[:m].T), atol=1e-7 * np.abs(G).max())
        np.testing.assert_allclose(path.Y.T @ path.X, np.eye(n), atol=1e-8)


@pytest.mark.parametrize("name", ["none", "second_difference", "user"])
def test_what_no_sensor_sees(name: str) -> None:
    rng = np.random.default_rng(2)
    H = rng.standard_normal((8, 3)) @ rng.standard_normal((3, 6))
    path = SVDPath(LinearProblem.whitened(H, np.ones(8), L=None if name == "none" else penalty(name, 6)))
    N = path.null_space
    np.testing.assert_allclose(N.T @ N, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(H @ N, 0, atol=1e-12)
    seen = np.linalg.svd(H)[2][:3]
    for g in (*seen, N[:, 0], rng.standard_normal(6)):
        assert path.null_share(g) == pytest.approx(
            np.linalg.norm(g - seen.T @ (seen @ g)) / np.linalg.norm(g), abs=1e-10
        )
        assert path.null_share(g) ** 2 + path.seen_share(g) ** 2 == pytest.approx(1.0)
    assert path.null_share(np.zeros(6)) == 0.0
    full = SVDPath(LinearProblem.whitened(np.eye(4), np.ones(4)))
    assert (full.null_space.shape, full.null_share(np.ones(4)), full.seen_share(np.ones(4))) == ((4, 0), 0.0, 1.0)


def test_truncated_gsvd_is_least_squares_over_the_kept_modes() -> None:
    """Modes of the pencil (H^T H, L^T L), which is well conditioned here; null space of L kept throughout."""
    H, y, L = ill_conditioned(14, 9, 20), np.random.default_rng(0).standard_normal(14), penalty("second_difference", 9)
    path = SVDPath(LinearProblem.whitened(H, y, L=L), truncated=True)
    mu, Z = scipy.linalg.eigh(H.T @ H, H.T @ H + L.T @ L)  # c^2 ascending
    gamma = np.sqrt(mu[:-2] / (1 - mu[:-2]))
    for kept in (1, 3, 6):
        lam = float(np.sqrt(gamma[-kept] * gamma[-kept - 1])) / float(path.scale)
        modes = Z[:, -kept - 2 :]
        expected = modes @ np.linalg.lstsq(H @ modes, y)[0]
        np.testing.assert_allclose(path.solution(lam, None).load, expected, rtol=1e-7, atol=1e-9)
        assert np.sum(path.filter_factors(lam)) == kept + 2


# -- null spaces that meet -------------------------------------------------------------------------------------------
def unseen(*patterns: np.ndarray, m: int = 30) -> np.ndarray:
    """Random operator that sees none of some patterns."""
    P = np.linalg.qr(np.array(patterns, float).T)[0]
    H = np.random.default_rng(4).standard_normal((m, len(P)))
    return H - (H @ P) @ P.T


@pytest.mark.parametrize(
    ("patterns", "words"),
    [
        ([np.ones(12)], r"one load pattern is .*: constant over all loads;"),
        ([np.arange(12) - 3.0], r"one load pattern is .*: linear in the order of the loads;"),
        ([np.ones(12), np.arange(12.0)], r"2 load patterns are .*: constant over all loads; linear in the order"),
    ],
)
def test_patterns_that_nothing_sees_are_put_in_words(patterns: list[np.ndarray], words: str) -> None:
    with pytest.raises(NotIdentifiable, match=words) as caught:
        SVDPath(LinearProblem.whitened(unseen(*patterns), np.ones(30), L=penalty("second_difference", 12)))
    assert caught.value.code == "LID-E306"


def test_loads_that_nothing_sees_are_named_by_their_labels() -> None:
    rng, labels = np.random.default_rng(1), [f"P{k}" for k in range(6)]
    H, L = rng.standard_normal((9, 6)), rng.standard_normal((4, 6))
    H[:, [1, 4]] = L[:, [1, 4]] = 0
    with pytest.raises(NotIdentifiable, match=r"2 load patterns .* at loads \[P1, P4\]|at loads \[P4, P1\]"):
        SVDPath(LinearProblem.whitened(H, np.ones(9), L=L), labels=labels)
    assert gsvd.names(np.eye(1)) == "constant over all loads"


@pytest.mark.parametrize("size", [1e-3, 1e-9, 1e-12])
def test_how_nearly_the_null_spaces_meet_is_told(size: float) -> None:
    H, L = unseen(np.ones(12)), penalty("first_difference", 12)
    H = 1e6 * (H + size * np.random.default_rng(0).standard_normal((30, 1)))
    path = SVDPath(LinearProblem.whitened(H, np.ones(30), L=L))
    both = np.vstack([H / np.linalg.norm(H, 2), L / np.linalg.norm(L, 2)])
    assert path.meeting == pytest.approx(np.linalg.svd(both, compute_uv=False)[-1], rel=0.05)
    assert SVDPath(LinearProblem.whitened(H, np.ones(30))).meeting == 1.0
    assert gsvd.norm2(H) == pytest.approx(np.linalg.norm(H, 2), rel=0.02)


@pytest.mark.parametrize("name", ["none", "first_difference", "user"])
@pytest.mark.parametrize("decades", [-12, -7, 6, 12])
def test_scale_invariance_over_twelve_decades(name: str, decades: int) -> None:
    H, y = ill_conditioned(14, 9, 1e3), np.random.default_rng(0).standard_normal(14)
    L = None if name == "none" else penalty(name, 9)
    one = SVDPath(LinearProblem.whitened(H, y, L=L))
    for model, data, prior in ((1.0, 10.0**decades, 1.0), (10.0**decades, 1.0, 1.0), (1.0, 1.0, 10.0**decades)):
        two = SVDPath(LinearProblem.whitened(model * H, data * y, L=None if L is None else prior * L))
        for lam in (1e-3, 0.1):
            a, b = one.solution(lam, 0.1), two.solution(lam, 0.1 * data)
            unit = data / model
            np.testing.assert_allclose(b.load, unit * a.load, rtol=1e-9, atol=1e-9 * unit * np.abs(a.load).max())
            np.testing.assert_allclose(b.posterior.std, unit * a.posterior.std, rtol=1e-9)
            np.testing.assert_allclose(two.filter_factors(lam).sum(), one.filter_factors(lam).sum(), rtol=1e-9)


@pytest.mark.parametrize("name", ["none", "first_difference", "second_difference", "user"])
def test_four_formulas_give_one_answer(name: str) -> None:
    """Filter form, augmented least squares, posterior mean and normal equations, well scaled and small."""
    path, H, y, L = posed(14, 9, name, kappa=20)
    for lam in (0.02, 0.3):
        x = lam * float(path.scale)
        filtered = path.solution(lam, None).load
        stacked = np.linalg.lstsq(np.vstack([H, x * L]), np.r_[y, np.zeros(len(L))])[0]
        normal = np.linalg.solve(H.T @ H + x**2 * L.T @ L, H.T @ y)
        prior = np.linalg.pinv(L.T @ L) / x**2  # covariance over sigma^2; flat along the null space N, estimated beside
        S, N = H @ prior @ H.T + np.eye(14), scipy.linalg.null_space(L)
        F = H @ N
        b = np.linalg.solve(F.T @ np.linalg.solve(S, F), F.T @ np.linalg.solve(S, y))
        mean = N @ b + prior @ H.T @ np.linalg.solve(S, y - F @ b)
        for other in (stacked, normal, mean):
            np.testing.assert_allclose(filtered, other, rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("shape", [(12, 8), (8, 12)])
@pytest.mark.parametrize("lam", [1e-3, 0.1, 3.0])
def test_a_diagonal_penalty_is_a_weighted_identity(shape: tuple[int, int], lam: float) -> None:
    """Against augmented least squares, and against the same penalty in a form that is not seen to be diagonal."""
    rng = np.random.default_rng(7)
    H, y, weights = rng.standard_normal(shape), rng.standard_normal(shape[0]), np.geomspace(0.2, 5, shape[1])
    path = SVDPath(LinearProblem.whitened(H, y, L=np.diag(weights)))
    Q = np.linalg.qr(rng.standard_normal((shape[1], shape[1])))[0]
    other = SVDPath(LinearProblem.whitened(H, y, L=Q * weights))
    x = lam * float(path.scale)
    expected = np.linalg.lstsq(np.vstack([H, x * np.diag(weights)]), np.r_[y, np.zeros(shape[1])], rcond=None)[0]
    np.testing.assert_allclose(path.solution(lam, None).load, expected, rtol=1e-9, atol=1e-12)
    assert float(path.scale) == pytest.approx(float(other.scale), rel=1e-10)
    for name in ("residual2", "penalty2", "edf", "edf2", "sensitivity", "objective"):
        assert getattr(path.at(lam), name) == pytest.approx(getattr(other.at(lam), name), rel=1e-8)
    np.testing.assert_allclose(path.solution(lam, 0.1).posterior.std, other.solution(lam, 0.1).posterior.std, rtol=1e-8)
    np.testing.assert_allclose(path.resolution(lam), other.resolution(lam), atol=1e-9)
