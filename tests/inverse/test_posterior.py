"""Posteriors against the dense formula, against Monte Carlo, and against the truth."""

import numpy as np
import pytest

from loadid._inverse.convolved.path import SpectralPath
from loadid._inverse.posterior import DensePosterior, Posterior, SpectralPosterior, from_arrays
from loadid.paths import LinearProblem, SVDPath, toeplitz
from structures._testing.spectra import padded_length
from structures.errors import InputError

from .reference import augmented, echo, ill_conditioned, penalty

N, SIGMA = 24, 0.2


@pytest.mark.parametrize("name", ["identity", "first_difference", "second_difference", "user"])
@pytest.mark.parametrize("m", [10, 24, 40])
def test_dense_formula(m: int, name: str) -> None:
    H, L = ill_conditioned(m, N, 50, seed=m), penalty(name, N)
    path = SVDPath(LinearProblem.whitened(H, np.ones(m), L=None if name == "identity" else L, shape=(12, 2)))
    x = 0.2 * float(path.scale)
    covariance = SIGMA**2 * np.linalg.solve(H.T @ H + x**2 * L.T @ L, np.eye(N))
    posterior = path.solution(0.2, SIGMA).posterior
    np.testing.assert_allclose(posterior.std, np.sqrt(np.diag(covariance)).reshape(12, 2), rtol=1e-7)
    w = np.random.default_rng(0).standard_normal((5, 12, 2))
    expected = [v.ravel() @ covariance @ v.ravel() for v in w]
    np.testing.assert_allclose(posterior.variance(w), expected, rtol=1e-7)
    assert posterior.variance(w[0]).shape == ()
    assert posterior.variance(w[0]) == pytest.approx(expected[0], rel=1e-7)


def test_error_of_the_estimate_has_the_stated_covariance() -> None:
    """Loads drawn from the prior: a random walk with a known start."""
    rng = np.random.default_rng(1)
    H = ill_conditioned(30, N, 100)
    L = np.vstack([np.eye(N)[:1], penalty("first_difference", N)])
    lam = 0.3
    path = SVDPath(LinearProblem.whitened(H, np.zeros(30), L=L))
    posterior = path.solution(lam / float(path.scale), SIGMA).posterior
    loads = np.linalg.solve(L, rng.standard_normal((N, 6000)) * SIGMA / lam)
    data = H @ loads + SIGMA * rng.standard_normal((30, 6000))
    error = augmented(H, data, L, lam).load - loads
    inside = np.mean(np.abs(error) < 1.96 * posterior.std[:, None])
    assert 0.94 < inside < 0.96
    np.testing.assert_allclose(error.std(axis=1), posterior.std, rtol=0.05)
    mean = np.full(N, 1 / N)
    assert np.std(mean @ error) == pytest.approx(np.sqrt(posterior.variance(mean)), rel=0.04)


@pytest.mark.parametrize("dense", [True, False])
def test_bands_cover_loads_drawn_from_the_prior(dense: bool) -> None:
    rng, n = np.random.default_rng(2), 80
    padded = padded_length(n)
    h = echo(n, 2, 1, seed=5, decay=4.0)
    T = toeplitz(h)
    H, power = np.fft.rfft(h, padded, axis=0), np.full((padded // 2 + 1, 2), n * SIGMA**2)
    lam, inside, whitened = 0.5, [], SVDPath(LinearProblem.whitened(T, np.zeros((n, 2)), [SIGMA] * 2, shape=(n, 1)))
    for _ in range(60 if dense else 200):
        g = rng.standard_normal((n, 1)) / lam
        y = T @ g[:, 0] + SIGMA * rng.standard_normal((n, 2))
        path = whitened.with_data(y.ravel() / SIGMA) if dense else SpectralPath(H, y, power)
        solution = path.solution(lam / float(path.scale), 1.0)
        inside.append(np.abs(solution.load - g) < 1.96 * solution.posterior.std)
    # the FFT path lets a load ring on after the record: its last samples are less sure than it says
    inside = np.array(inside) if dense else np.array(inside)[:, : n - 15]
    assert 0.94 < inside.mean() < 0.96


def test_truncated_posterior_is_the_noise_of_the_kept_modes() -> None:
    H = ill_conditioned(30, N, 1e6)
    path = SVDPath(LinearProblem.whitened(H, np.zeros(30)), truncated=True)
    _, s, Vt = np.linalg.svd(H)
    kept = s >= 0.01 * s[0]
    expected = SIGMA * np.sqrt(np.sum((Vt[: len(s)][kept].T / s[kept]) ** 2, axis=1))
    np.testing.assert_allclose(path.solution(0.01, SIGMA).posterior.std, expected, rtol=1e-9)


@pytest.mark.parametrize("dense", [True, False])
def test_round_trip(dense: bool) -> None:
    rng = np.random.default_rng(0)
    posterior: Posterior
    if dense:
        posterior = DensePosterior(rng.standard_normal((12, 5)), (6, 2))
    else:
        half = rng.standard_normal((7, 2, 3)) + 1j * rng.standard_normal((7, 2, 3))
        posterior = SpectralPosterior(half @ half.conj().swapaxes(1, 2), 6, 12)
    assert isinstance(posterior, Posterior)
    again, w = from_arrays(posterior.to_arrays()), rng.standard_normal((3, 6, 2))
    assert type(again) is type(posterior)
    np.testing.assert_array_equal(again.std, posterior.std)
    np.testing.assert_array_equal(again.variance(w), posterior.variance(w))
    assert posterior.std.shape == (6, 2)


def test_variance_of_one_sample_is_its_std_squared() -> None:
    h = echo(N, 2, 2)
    padded = padded_length(N)
    path = SpectralPath(np.fft.rfft(h, padded, axis=0), np.ones((N, 2)), np.ones((padded // 2 + 1, 2)))
    posterior = path.solution(0.1, 0.7).posterior
    w = np.zeros((2, N, 2))
    w[0, 3, 0] = w[1, -1, 1] = 1
    np.testing.assert_allclose(posterior.variance(w), posterior.std[[3, -1], [0, 1]] ** 2, rtol=1e-10)


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="posterior"):
        from_arrays({"kind": "pickled"})


# -- what is noise, what is prior ------------------------------------------------------------------------------------
PENALTIES = ["identity", "first_difference", "second_difference", "user"]


def posed(m: int, name: str, truncated: bool = False, frames: int | None = None) -> tuple[SVDPath, np.ndarray]:
    H, L = ill_conditioned(m, N, 50, seed=m), penalty(name, N)
    y = np.ones(m) if frames is None else np.random.default_rng(0).standard_normal((frames, m))
    return SVDPath(LinearProblem.whitened(H, y, L=None if name == "identity" else L), truncated=truncated), H


@pytest.mark.parametrize("truncated", [False, True])
@pytest.mark.parametrize("name", PENALTIES)
@pytest.mark.parametrize("m", [10, 24, 40])
def test_share_of_the_noise_and_of_the_prior(m: int, name: str, truncated: bool) -> None:
    path, _ = posed(m, name, truncated)
    posterior, G = path.solution(0.2, SIGMA).posterior, path.inverse(0.2)
    noise = SIGMA**2 * G @ G.T  # the noise through the regularised inverse, and nothing else
    np.testing.assert_allclose(posterior.noise_std, np.sqrt(np.diag(noise)), rtol=1e-8)
    w = np.random.default_rng(1).standard_normal((3, N))
    np.testing.assert_allclose(posterior.noise_variance(w), np.einsum("ki,ij,kj->k", w, noise, w), rtol=1e-8)
    assert np.all(posterior.noise_std <= posterior.std * (1 + 1e-12))
    if truncated:  # a cut has no prior
        np.testing.assert_allclose(posterior.noise_std, posterior.std, rtol=1e-12)
    else:  # the rest is the prior seen through what regularisation leaves out: (R - I) C (R - I)^T with C = the prior
        hidden = posterior.factor @ posterior.factor.T - noise
        lost = np.eye(N) - path.resolution(0.2)
        if path.null == 0:
            x, L = 0.2 * float(path.scale), np.eye(N) if name == "identity" else penalty(name, N)
            prior = SIGMA**2 / x**2 * np.linalg.solve(L.T @ L, np.eye(N))
            np.testing.assert_allclose(hidden, lost @ prior @ lost.T, atol=1e-8 * np.abs(hidden).max())


@pytest.mark.parametrize("truncated", [False, True])
@pytest.mark.parametrize("name", PENALTIES)
@pytest.mark.parametrize("m", [10, 24, 40])
def test_worst_case_bias_is_reached_and_never_exceeded(m: int, name: str, truncated: bool) -> None:
    path, H = posed(m, name, truncated)
    posterior, rng = path.solution(0.2, SIGMA).posterior, np.random.default_rng(2)
    w = rng.standard_normal(N)
    lost = posterior.bias_weights(w)
    np.testing.assert_allclose(lost, (path.resolution(0.2) - np.eye(N)).T @ w, atol=1e-8)

    def bias(g: np.ndarray) -> float:
        return float(w @ (path.with_data(H @ g).solution(0.2, None).load - g))

    assert bias(3.0 * np.sign(lost)) == pytest.approx(3.0 * np.abs(lost).sum(), rel=1e-7)  # |g_j| <= 3
    assert bias(3.0 * lost / np.linalg.norm(lost)) == pytest.approx(3.0 * np.linalg.norm(lost), rel=1e-7)  # |g| <= 3
    for g in rng.uniform(-3, 3, (50, N)):
        assert abs(bias(g)) <= 3.0 * np.abs(lost).sum() * (1 + 1e-9)
    stack = rng.standard_normal((4, N))
    np.testing.assert_allclose(
        posterior.bias_weights(stack)[2], posterior.bias_weights(stack[2]), rtol=1e-9, atol=1e-12
    )


def test_bias_vanishes_where_the_data_decide() -> None:
    path, _ = posed(40, "first_difference")
    posterior = path.solution(1e-9, SIGMA).posterior
    assert np.abs(posterior.bias_weights(np.eye(N))).max() < 1e-12
    path, H = posed(10, "identity")  # without lambda: what no sensor sees is lost, and nothing else
    posterior = path.solution(0.0, SIGMA).posterior
    seen = np.linalg.svd(H)[2][:10]
    np.testing.assert_allclose(posterior.bias_weights(np.eye(N)), seen.T @ seen - np.eye(N), atol=1e-9)


def test_a_prior_that_is_flat_along_constants_leaves_the_mean_to_the_data() -> None:
    """However strong, it takes nothing from the mean: its variance is that of plain least squares for one number."""
    path, H = posed(40, "first_difference")
    posterior, mean = path.solution(1e6, SIGMA).posterior, np.full(N, 1 / N)
    expected = SIGMA**2 / np.sum(H.sum(axis=1) ** 2)
    assert posterior.variance(mean) == pytest.approx(expected, rel=1e-6)
    assert posterior.noise_variance(mean) == pytest.approx(expected, rel=1e-6)
    assert posterior.bias_weights(mean).sum() == pytest.approx(0, abs=1e-9)
    tied = posed(40, "identity")[0].solution(1e6, SIGMA).posterior
    assert tied.variance(mean) < 1e-9 * expected


def test_noise_levels_at_the_edge() -> None:
    path, _ = posed(24, "first_difference")
    silent = path.solution(0.2, 0.0).posterior
    assert np.all(silent.std == 0)
    assert silent.noise_std is None
    for sigma in (-1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="noise level"):
            path.solution(0.2, sigma)


# -- frames ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", ["identity", "first_difference"])
def test_frames_have_one_posterior_and_independent_noise(name: str) -> None:
    framed, _ = posed(40, name, frames=6)
    single, _ = posed(40, name)
    many, one = framed.solution(0.2, SIGMA).posterior, single.solution(0.2, SIGMA).posterior
    for a, b in ((many.std, one.std), (many.noise_std, one.noise_std)):
        assert a.shape == (6, N)
        np.testing.assert_allclose(a, np.tile(b, (6, 1)), rtol=1e-10)
    w = np.random.default_rng(3).standard_normal((6, N))
    for name_of in ("variance", "noise_variance"):
        each = [getattr(one, name_of)(v) for v in w]
        assert getattr(many, name_of)(w) == pytest.approx(sum(each), rel=1e-10)
        assert getattr(many, name_of)(w[0]) == pytest.approx(each[0], rel=1e-10)
        np.testing.assert_allclose(
            getattr(many, name_of)(np.stack([w, 2 * w])), np.array([1, 4]) * sum(each), rtol=1e-9
        )
    np.testing.assert_allclose(many.bias_weights(w), [one.bias_weights(v) for v in w], atol=1e-10)
    for wrong in (np.ones(N + 1), np.ones((5, N)), np.ones(()), np.ones((6, N, 1))):
        with pytest.raises(InputError, match="weights"):
            many.variance(wrong)


@pytest.mark.parametrize("truncated", [False, True])
@pytest.mark.parametrize("frames", [None, 4])
def test_round_trip_keeps_the_shares(frames: int | None, truncated: bool) -> None:
    path, _ = posed(40, "first_difference", truncated, frames)
    posterior = path.solution(0.2, SIGMA).posterior
    again = from_arrays(posterior.to_arrays())
    w = np.random.default_rng(0).standard_normal(posterior.shape)
    assert again.shape == posterior.shape
    np.testing.assert_array_equal(again.std, posterior.std)
    np.testing.assert_array_equal(again.noise_std, posterior.noise_std)
    np.testing.assert_array_equal(again.noise_variance(w), posterior.noise_variance(w))
    np.testing.assert_array_equal(again.bias_weights(w), posterior.bias_weights(w))


def test_files_from_before_hold_the_factor_only() -> None:
    factor = np.random.default_rng(0).standard_normal((6, 6))
    old = from_arrays({"kind": "dense", "factor": factor, "shape": [3, 2]})
    assert old.std.shape == (3, 2)
    assert (old.noise_std, old.noise_variance(np.ones((3, 2))), old.bias_weights(np.ones((3, 2)))) == (None, None, None)


def test_the_spectral_posterior_says_what_it_does_not_know() -> None:
    posterior = SpectralPosterior(np.ones((7, 1, 1)), 6, 12)
    w = np.ones((6, 1))
    assert (posterior.noise_std, posterior.noise_variance(w), posterior.bias_weights(w)) == (None, None, None)


# -- coverage --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("m", [12, 40])
@pytest.mark.parametrize("name", ["identity", "first_difference", "second_difference"])
def test_two_thousand_loads_from_the_prior_are_covered(name: str, m: int) -> None:
    """Random loads with L g ~ N(0, sigma^2 / lambda^2), and anything at all along ker(L), where the prior is flat."""
    rng, draws, L = np.random.default_rng(m), 2000, penalty(name, N)
    H = ill_conditioned(m, N, 100, seed=1)
    empty = SVDPath(LinearProblem.whitened(H / SIGMA, np.zeros(m), L=None if name == "identity" else L))
    x = 0.3 * float(empty.scale)
    rough = np.linalg.lstsq(L, rng.standard_normal((len(L), draws)))[0] / x
    loads = rough + np.vander(np.arange(N) / N, N - len(L)) @ rng.uniform(-50, 50, (N - len(L), draws))
    path = empty.with_data(H / SIGMA @ loads + rng.standard_normal((m, draws)))
    solution = path.solution(0.3, 1.0)
    inside = np.abs(solution.load - loads.T) < 1.96 * solution.posterior.std
    assert 0.94 < inside.mean() < 0.96
    w = rng.standard_normal(N)
    error = (solution.load - loads.T) @ w
    assert 0.93 < np.mean(np.abs(error) < 1.96 * np.sqrt(solution.posterior.variance(w))) < 0.97
