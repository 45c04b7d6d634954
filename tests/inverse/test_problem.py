"""Whitening: what it must leave alone, and what it must refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid.inverse.problem import LinearProblem, whiten
from loadid.inverse.svd import SVDPath
from structures.errors import InputError

RNG = np.random.default_rng(3)
H, Y = RNG.standard_normal((9, 3, 5)), RNG.standard_normal((9, 3))  # 9 samples, 3 sensors, 5 unknowns
ROOT = RNG.standard_normal((3, 3))
R = ROOT @ ROOT.T + np.eye(3)


def test_whitened_noise_is_white() -> None:
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), R, 40_000)
    np.testing.assert_allclose(np.cov(whiten(draws, R, axis=1).T), np.eye(3), atol=0.03)


def test_std_is_a_diagonal_covariance() -> None:
    std = np.array([0.1, 2.0, 30.0])
    a, b = (LinearProblem.whitened(H, Y, noise) for noise in (std, np.diag(std**2)))
    np.testing.assert_allclose(a.H, b.H, rtol=1e-13)
    np.testing.assert_allclose(a.y, b.y, rtol=1e-13)
    np.testing.assert_allclose(a.H.reshape(9, 3, 5)[:, 1], H[:, 1] / 2.0, rtol=1e-14)
    assert a.layout == (9, 3)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_mixing_the_channels_changes_nothing(seed: int) -> None:
    mix = np.random.default_rng(seed).standard_normal((3, 3)) + 3 * np.eye(3)
    if np.linalg.cond(mix) > 50:
        return
    plain = SVDPath(LinearProblem.whitened(H, Y, R))
    mixed = SVDPath(
        LinearProblem.whitened(np.einsum("ab,tbu->tau", mix, H), np.einsum("ab,tb->ta", mix, Y), mix @ R @ mix.T)
    )
    np.testing.assert_allclose(mixed.singular_values, plain.singular_values, rtol=1e-9)
    np.testing.assert_allclose(mixed.solution(0.05, None).load, plain.solution(0.05, None).load, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(mixed.at(0.05).residual2, plain.at(0.05).residual2, rtol=1e-9)


def test_covariance_whitening_is_generalised_least_squares() -> None:
    big = np.kron(np.eye(9), np.linalg.solve(R, np.eye(3)))
    flat, y = H.reshape(27, 5), Y.ravel()
    expected = np.linalg.solve(flat.T @ big @ flat, flat.T @ big @ y)
    path = SVDPath(LinearProblem.whitened(H, Y, R))
    np.testing.assert_allclose(path.solution(0.0, None).load, expected, rtol=1e-10)


@pytest.mark.parametrize(
    "noise",
    [
        [0.1, 0.0, 1.0],
        [0.1, -1.0, 1.0],
        [0.1, np.nan, 1.0],
        [0.1, 1.0],
        np.ones((3, 3)),
        np.diag([1.0, 1.0, -1.0]),
        np.eye(3) + 0.3 * np.eye(3, k=1),
        np.full((3, 3), np.nan),
        0.1,
    ],
)
def test_impossible_noise_is_refused(noise: object) -> None:
    with pytest.raises(InputError, match="noise"):
        LinearProblem.whitened(H, Y, noise)


@pytest.mark.parametrize("what", ["H", "y", "L", "shape of y", "shape of L"])
def test_nan_and_misfits_are_refused(what: str) -> None:
    h, y, L = H.copy(), Y.copy(), np.eye(5)
    if what == "H":
        h[2, 1, 0] = np.nan
    elif what == "y":
        y[0, 0] = np.inf
    elif what == "L":
        L[0, 0] = np.nan
    elif what == "shape of y":
        y = y[1:]
    else:
        L = L[:, 1:]
    with pytest.raises(InputError):
        LinearProblem.whitened(h, y, L=L)
