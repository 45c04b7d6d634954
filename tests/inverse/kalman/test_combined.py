"""Sums of loads: against the dense covariance of a textbook filter, and against their errors."""

import numpy as np
import pytest

from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.loop import Loop
from loadid._inverse.gaussian.steady import combined_std, steady
from loadid.priors import OU
from structures.errors import InputError
from tests.tracked import Setup, reference, selector, tridiagonal

DT, SD = 0.01, 20.0


@pytest.fixture(scope="module")
def case():
    """Two neighbouring loads on a chain, a displacement beside each and one between others."""
    n, rng = 6, np.random.default_rng(0)
    M, K = np.eye(n), 2500 * tridiagonal(n)
    setup = Setup(M, 0.1 * M + 1e-3 * K, K, selector([3, 4], n).T, selector([2], n), selector([3, 5], n), DT)
    pole = np.exp(-DT / 0.2)
    load = np.zeros((20_000, 2))
    for k in range(1, len(load)):
        load[k] = pole * load[k - 1] + SD * np.sqrt(1 - pole**2) * rng.standard_normal(2)
    clean = setup.respond(load)
    noise = 0.05 * clean.std(axis=0)
    model = augment(setup.space(), DT, [OU(SD, 0.2)] * 2, noise=noise)
    return steady(model, DT), load, clean + noise * rng.standard_normal(clean.shape)


def test_against_the_dense_covariance(case):
    settled, _, y = case
    dense = reference(settled.model, y[:1500]).P
    weights = np.array([[1.0, 1.0], [1.0, -1.0], [1.0, 0.0], [0.3, -2.0]])
    P = settled.model.Cp @ dense @ settled.model.Cp.T
    expected = np.sqrt(np.einsum("ki,ij,kj->k", weights, P, weights))
    assert np.allclose(combined_std(settled, weights), expected, rtol=1e-6)
    assert combined_std(settled, [1.0, 0.0])[0] == pytest.approx(settled.std[0], rel=1e-12)
    assert combined_std(settled, 1e6 * weights[0])[0] == pytest.approx(1e6 * expected[0], rel=1e-6)


def test_the_total_is_known_far_better_than_its_parts(case):
    settled, load, y = case
    found, e = np.empty_like(load), np.empty_like(y)
    model = settled.model
    Loop(settled.rows(), model.p, model.m, model.x0).block(y, found, e)
    off = (found - load)[200:]
    total, difference = combined_std(settled, [[1, 1], [1, -1]])
    assert off.sum(axis=1).std() == pytest.approx(total, rel=0.05)
    assert (off[:, 0] - off[:, 1]).std() == pytest.approx(difference, rel=0.05)
    assert total < 0.8 * np.linalg.norm(settled.std) < 0.8 * settled.std.sum()


def test_weights_that_do_not_fit(case):
    for wrong in ([1.0], [[1.0, 2.0, 3.0]], [1.0, np.nan], "total"):
        with pytest.raises(InputError, match="weights"):
            combined_std(case[0], wrong)
