"""The convolution operator: all back ends against numpy's direct convolution, and each against its transpose."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse.linalg import aslinearoperator

from loadid._inverse.convolution import Convolution, PenalizedConvolution
from loadid.paths import toeplitz
from structures.errors import InputError

SHAPES = [(1, 1, 1, 1), (61, 61, 1, 1), (64, 23, 3, 2), (97, 1, 2, 3), (50, 80, 2, 2), (75, 40, 1, 4)]
BLOCKS = [None, 1, 7, 32, 1000]


def direct(h: NDArray, g: NDArray) -> NDArray:
    """Response (samples, sensors) sample by sample."""
    (samples, loads), sensors = g.shape, h.shape[1]
    out = np.zeros((samples, sensors))
    for s in range(sensors):
        for j in range(loads):
            out[:, s] += np.convolve(h[:, s, j], g[:, j])[:samples]
    return out


def case(samples: int, taps: int, sensors: int, loads: int) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Impulse responses, load, response and weights."""
    rng = np.random.default_rng(samples)
    weight = rng.uniform(0.5, 2.0, (samples, sensors)) * (rng.random((samples, sensors)) > 0.2)
    sizes = (taps, sensors, loads), (samples, loads), (samples, sensors)
    return (*(rng.standard_normal(size) for size in sizes), weight)


@pytest.mark.parametrize("block", BLOCKS)
@pytest.mark.parametrize("shape", SHAPES)
def test_every_back_end_is_the_direct_convolution(shape: tuple[int, int, int, int], block: int | None) -> None:
    h, g, r, weight = case(*shape)
    plain, weighted = Convolution(h, shape[0], block=block), Convolution(h, shape[0], weight, block=block)
    expected = direct(h, g)
    size = np.linalg.norm(h) * np.linalg.norm(g)
    np.testing.assert_allclose(plain.apply(g), expected, rtol=0, atol=1e-12 * size)
    np.testing.assert_allclose(weighted.apply(g), weight * expected, rtol=0, atol=1e-12 * size)
    for operator, w in ((plain, 1.0), (weighted, weight)):
        left, right = np.sum(operator.apply(g) * r), np.sum(g * operator.apply_transposed(r))
        assert abs(left - right) <= 1e-12 * size * np.linalg.norm(r)
        back = direct(np.swapaxes(h, 1, 2), (w * r)[::-1])[::-1]
        np.testing.assert_allclose(operator.apply_transposed(r), back, rtol=0, atol=1e-12 * size * np.linalg.norm(r))


@pytest.mark.parametrize("block", [None, 16])
def test_it_is_a_linear_operator_of_scipy(block: int | None) -> None:
    h, g, r, weight = case(51, 51, 3, 2)
    operator = Convolution(h, 51, weight, block=block)
    H = weight.reshape(-1, 1) * toeplitz(h).reshape(153, 102)
    assert aslinearoperator(operator) is operator
    assert operator.shape == H.shape
    assert operator.dtype == float
    many = np.stack([g, 2 * g - 1, g**2], axis=-1)
    close = {"rtol": 0, "atol": 1e-11}
    np.testing.assert_allclose(operator.matvec(g.ravel()), H @ g.ravel(), **close)
    np.testing.assert_allclose(operator.rmatvec(r.ravel()), H.T @ r.ravel(), **close)
    np.testing.assert_allclose(operator @ many.reshape(-1, 3), H @ many.reshape(-1, 3), **close)
    np.testing.assert_allclose(operator.H @ np.outer(r.ravel(), [1, 2]), H.T @ np.outer(r.ravel(), [1, 2]), **close)
    np.testing.assert_allclose(operator.apply(many).reshape(153, 3), H @ many.reshape(-1, 3), **close)


def test_time_may_be_last_and_a_window_may_ask_for_its_part() -> None:
    h, g, r, _ = case(70, 20, 2, 3)
    operator, expected = Convolution(h, 70, block=30), direct(h, g)
    np.testing.assert_allclose(operator.convolve(np.stack([g.T, -g.T])), [expected.T, -expected.T], atol=1e-11)
    np.testing.assert_allclose(operator.response(g.T, 25, 50), expected[25:50].T, atol=1e-11)
    early = np.where(np.arange(70)[:, None] < 25, g, 0.0)
    np.testing.assert_allclose(operator.response(g.T, 25, 50, before=25), direct(h, early)[25:50].T, atol=1e-11)
    np.testing.assert_allclose(operator.correlation(r.T, 40, 70), operator.correlate(r.T)[:, 40:], atol=1e-11)


def test_a_long_record_behind_short_responses_goes_in_blocks() -> None:
    h = np.ones((100, 1, 1))
    assert Convolution(h, 100_000).block < 100_000
    assert Convolution(h, 5000).block == 5000
    assert Convolution(np.ones((60_000, 1, 1)), 100_000).block == 100_000
    g = np.random.default_rng(0).standard_normal((100_000, 1))
    expected = np.convolve(g[:, 0], h[:, 0, 0])[:100_000]
    np.testing.assert_allclose(Convolution(h, 100_000).apply(g)[:, 0], expected, atol=1e-10)


@pytest.mark.parametrize("penalty", ["identity", "first_difference", "second_difference"])
def test_differences_and_their_transpose(penalty: str) -> None:
    operator = PenalizedConvolution(np.ones((5, 1, 2)), 40, penalty)
    rng = np.random.default_rng(0)
    g, d = rng.standard_normal((3, 2, 40)), rng.standard_normal((3, 2, operator.rows))
    np.testing.assert_array_equal(operator.rough(g), np.diff(g, n=operator.order))
    assert np.sum(operator.rough(g) * d) == pytest.approx(np.sum(g * operator.rough_adjoint(d)), rel=1e-12)


def test_weights_fit_the_record() -> None:
    with pytest.raises(InputError, match="weights do not fit"):
        Convolution(np.ones((5, 2, 1)), 10, np.ones((10, 1)))
