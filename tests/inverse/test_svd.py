"""The dense path against augmented least squares, every shape and every penalty."""

import numpy as np
import pytest
import scipy.linalg
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid.inverse import rules
from loadid.inverse.choice import choose
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath
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
