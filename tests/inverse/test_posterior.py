"""Posteriors against the dense formula, against Monte Carlo, and against the truth."""

import numpy as np
import pytest

from loadid.inverse.posterior import DensePosterior, Posterior, SpectralPosterior, from_arrays
from loadid.inverse.problem import LinearProblem
from loadid.inverse.svd import SVDPath
from loadid.inverse.toeplitz import SpectralPath, toeplitz
from structures.errors import InputError
from structures.spectra import padded_length

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
    lam, inside = 0.5, []
    for _ in range(60 if dense else 200):
        g = rng.standard_normal((n, 1)) / lam
        y = T @ g[:, 0] + SIGMA * rng.standard_normal((n, 2))
        path = SVDPath(LinearProblem.whitened(T, y, [SIGMA] * 2, shape=(n, 1))) if dense else SpectralPath(H, y, power)
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
