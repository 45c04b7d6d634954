"""Whitening: what it must leave alone, and what it must refuse."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from loadid._inverse.problem import Cholesky, whiten, whitener
from loadid.paths import LinearProblem, SVDPath
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


# -- other ways to state the noise -----------------------------------------------------------------------------------
def test_a_cholesky_factor_is_its_covariance() -> None:
    a, b = (LinearProblem.whitened(H, Y, noise) for noise in (R, Cholesky(np.linalg.cholesky(R))))
    np.testing.assert_allclose(b.H, a.H, rtol=1e-12)
    np.testing.assert_allclose(b.y, a.y, rtol=1e-12)
    W = whiten(np.eye(3), Cholesky(np.linalg.cholesky(R)), 0)
    np.testing.assert_allclose(W @ R @ W.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize(
    "factor", [np.linalg.cholesky(R).T, -np.linalg.cholesky(R), np.eye(2), np.ones(3), np.full((3, 3), np.nan)]
)
def test_what_is_no_cholesky_factor_is_refused(factor: np.ndarray) -> None:
    with pytest.raises(InputError, match="noise"):
        LinearProblem.whitened(H, Y, Cholesky(factor))


def interpolated(units: np.ndarray | float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Operator and data of 4 markers, the weights that make 9 readings of them, and the std of the markers."""
    rng = np.random.default_rng(8)
    W = np.array([np.interp(np.linspace(0, 3, 9), np.arange(4), e) for e in np.eye(4)]).T * np.reshape(units, (-1, 1))
    return rng.standard_normal((4, 6)), rng.standard_normal(4), W, np.array([0.1, 0.2, 0.3, 0.4])


@pytest.mark.parametrize("units", [1.0, np.geomspace(1e-6, 1e6, 9)])
def test_interpolated_data_say_what_the_raw_data_say(units: np.ndarray | float) -> None:
    """Whitened on the range of W S W^T, they give the least squares of the markers; no reading counts twice."""
    raw, z, W, std = interpolated(units)
    problem = LinearProblem.whitened(W @ raw, W @ z, W @ np.diag(std**2) @ W.T)
    assert problem.H.shape == (4, 6)
    assert problem.dropped < 1e-9
    a, b = SVDPath(problem), SVDPath(LinearProblem.whitened(raw, z, std))
    np.testing.assert_allclose(a.singular_values, b.singular_values, rtol=1e-8)
    np.testing.assert_allclose(a.solution(0.1, 1.0).load, b.solution(0.1, 1.0).load, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(a.at(0.1).residual2, b.at(0.1).residual2, rtol=1e-8)
    assert a.residual(0.1).shape == (4,)


def test_data_that_leave_the_range_of_a_singular_covariance_are_refused() -> None:
    raw, z, W, std = interpolated()
    C, y = W @ np.diag(std**2) @ W.T, W @ z
    outside = np.linalg.svd(W)[0][:, -1] * np.linalg.norm(y)
    LinearProblem.whitened(W @ raw, y + 1e-9 * outside, C)  # rounding
    with pytest.raises(InputError, match=r"leave the range.*0\.0\d"):
        LinearProblem.whitened(W @ raw, y + 0.03 * outside, C)
    H = W @ raw + np.outer(outside, np.ones(6))
    kept = LinearProblem.whitened(H, y, C).dropped  # the model may leave it: that part meets no data, and is told
    assert kept == pytest.approx(np.linalg.norm(whitener(C, 9).outside(H, 0)), rel=1e-9)
    assert kept > 0.1


def test_a_full_covariance_has_no_outside() -> None:
    assert whitener(R, 3).outside(Y, axis=-1) == 0.0
    assert LinearProblem.whitened(H, Y, R).dropped == 0.0


@pytest.mark.parametrize("factor", [1e-30, 1e30])
def test_units_of_the_noise_do_not_matter_to_the_checks(factor: float) -> None:
    for noise in (R, np.diag([1e-12, 1.0, 1e12])):
        W = whiten(np.eye(3), factor * noise, 0)
        np.testing.assert_allclose(W @ (factor * noise) @ W.T, np.eye(3), atol=1e-9)


# -- frames ----------------------------------------------------------------------------------------------------------
def test_frames_come_first_and_are_kept_apart() -> None:
    flat, frames = H[0], np.random.default_rng(1).standard_normal((7, 3))
    problem = LinearProblem.whitened(flat, frames, R)
    assert (problem.frames, problem.layout, problem.shape, problem.load_shape) == (7, (7, 3), (5,), (7, 5))
    for k, y in enumerate(frames):
        np.testing.assert_allclose(problem.y[:, k], LinearProblem.whitened(flat, y, R).y, rtol=1e-12)
    records = np.random.default_rng(1).standard_normal((4, 9, 3))  # frames of records
    problem = LinearProblem.whitened(H, records, R, shape=(5, 1))
    assert (problem.frames, problem.layout, problem.load_shape) == (4, (4, 9, 3), (4, 5, 1))
    np.testing.assert_allclose(problem.y[:, 2], LinearProblem.whitened(H, records[2], R).y, rtol=1e-12)
    assert SVDPath(problem).residual(0.1).shape == (4, 9, 3)
    single = LinearProblem.whitened(flat, frames[0])
    assert (single.frames, single.load_shape) == (None, (5,))


@pytest.mark.parametrize("y", [np.ones((3, 7)), np.ones((0, 3)), np.ones((2, 2, 3))])
def test_frames_that_do_not_fit_are_refused(y: np.ndarray) -> None:
    with pytest.raises(InputError, match=r"frames|invert"):
        LinearProblem.whitened(H[0], y)


def test_a_sparse_penalty_is_taken() -> None:
    from scipy.sparse import csr_array

    L = np.diff(np.eye(5), axis=0)
    np.testing.assert_array_equal(LinearProblem.whitened(H, Y, L=csr_array(L)).L, L)
