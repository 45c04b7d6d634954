"""Parameters beside the load: marginalised as a dense Gaussian has it; learned, or in the band."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid._inverse.gaussian.local_variance import Smoother
from loadid._inverse.gaussian.record import WhitenedRecord
from loadid._inverse.local_prior import LocalPrior, local_prior, with_errors, with_misfit
from loadid._inverse.nuisances import Nuisances, marginal

from .test_local_variance import dense, impacts, random_record


@pytest.mark.parametrize("memory", [0.0, 3.5])
def test_the_marginal_is_the_dense_gaussian(memory: float) -> None:
    own, given = random_record(memory)
    rng, smoother = np.random.default_rng(1), Smoother(own, given)
    there = own.y != 0
    columns = rng.standard_normal((3, *own.y.shape)) * there
    prior = np.array([[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 0.5]])
    at, residual = np.array([0.3, -0.2, 0.1]), rng.standard_normal(own.y.shape) * there

    def solve(data: NDArray) -> tuple[NDArray, NDArray]:
        _, load, _, weighed, _ = smoother.means(data)
        return weighed, load

    found = marginal(columns, solve, residual, prior, at)

    # K^-1 and the estimate of the load, column by column, from the Gaussian written out
    def loads(data: NDArray) -> NDArray:
        return dense(replace(own, y=data), given).load

    def evidence(data: NDArray) -> float:
        return dense(replace(own, y=data), given).evidence

    def product(a: NDArray, b: NDArray) -> float:  # a' K^-1 b, by the likelihoods of sums
        return -0.5 * (evidence(a + b) - evidence(a - b))

    K = np.array([[product(a, b) for b in columns] for a in columns])
    after = np.linalg.inv(np.linalg.inv(prior) + K)
    mean = after @ (np.array([product(a, residual) for a in columns]) + K @ at)
    assert found.covariance == pytest.approx(after, rel=1e-6)
    assert found.mean == pytest.approx(mean, rel=1e-6, abs=1e-9)
    pulled = np.array([loads(a) for a in columns])
    assert found.pulled == pytest.approx(pulled, abs=1e-8 * np.abs(pulled).max())
    assert found.shift == pytest.approx(np.einsum("i,iks->ks", mean - at, pulled), abs=1e-7 * np.abs(pulled).max())
    # loads of a size that nobody knows are parameters with a wide prior of their own, and take what only scales them
    each = rng.standard_normal((2, *own.y.shape)) * there
    sized = marginal(columns, solve, residual, prior, at, each)
    wide = np.diag([*np.zeros(3), 1e10, 1e10])
    wide[:3, :3] = prior
    beside = marginal(np.concatenate([columns, each]), solve, residual, wide, np.r_[at, 0, 0])
    assert sized.covariance == pytest.approx(beside.covariance[:3, :3], rel=1e-6, abs=1e-9)
    assert sized.mean == pytest.approx(beside.mean[:3], rel=1e-6, abs=1e-8)
    # the load of the fit is kept: what it is off by on the mean counts beside the scatter
    step = mean - at
    added = np.einsum("iks,ij,jks->ks", pulled, after + np.outer(step, step), pulled)
    assert np.sum(found.spread**2, axis=0) == pytest.approx(added, rel=1e-6)


def gains(own: WhitenedRecord, common: float, each: float) -> Nuisances:
    """Of the three sensors of a record whose noise is not correlated."""

    def record(at: NDArray) -> WhitenedRecord:
        factor = np.exp(at)[None, :, None]
        return replace(own, C=own.C * factor, D=own.D * factor)

    return Nuisances(("a", "b", "c"), common**2 * np.ones((3, 3)) + each**2 * np.eye(3), record)


def test_spare_sensors_teach_gains_and_what_is_common_stays_in_the_band() -> None:
    own, g, _ = impacts()
    wrong = np.array([1.04, 0.97, 1.0])
    own = replace(own, y=own.y * wrong)
    prior = with_misfit(local_prior(own))
    found = with_errors(prior, gains(own, 0.02, 0.03))
    assert found.errors is not None
    told = np.log(wrong) - np.log(wrong).mean()
    assert found.errors.mean - found.errors.mean.mean() == pytest.approx(told, abs=0.008)
    assert np.sqrt(np.diag(found.errors.covariance)).min() > 0.02  # the scale of all is told by nothing
    load, band, _ = found.posterior(found.errors)
    assert np.all(np.abs(load - g)[g > 0.2 * g.max()] < 3 * band.std[g > 0.2 * g.max()])
    top = np.unravel_index(np.argmax(load), load.shape)
    assert band.std[top] > 0.02 * load[top]
    own_band = found.posterior()[1]
    w = np.ones((300, 1))
    assert float(band.variance(w)) > float(own_band.variance(w)) + (0.02 * load.sum()) ** 2


def test_an_exact_model_is_left_alone() -> None:
    own, _, prior = impacts()
    found = with_errors(prior, gains(own, 0.02, 0.02))
    assert found.errors is not None
    assert np.abs(found.errors.mean).max() < 0.02
    load, moved = prior.posterior()[0], found.posterior(found.errors)[0]
    assert np.linalg.norm(load - moved) < 0.02 * np.linalg.norm(load)


def test_parameters_that_are_not_seen_do_nothing() -> None:
    own, _, prior = impacts()
    found: LocalPrior = with_errors(prior, Nuisances(("none",), np.eye(1), lambda at: own))
    assert found.errors is not None
    assert not found.errors.shift.any()
    assert not found.errors.spread.any()
    assert found.errors.odds == 1.0
    assert not found.contradicted
    load = prior.posterior()[0]
    assert np.linalg.norm(found.posterior(found.errors)[0] - load) < 0.03 * np.linalg.norm(load)


def test_an_error_beyond_its_prior_contradicts_the_model() -> None:
    own, _, _ = impacts()
    own = replace(own, y=own.y * np.array([1.3, 1.0, 1.0]))
    assert with_errors(with_misfit(local_prior(own)), gains(own, 0.02, 0.02)).contradicted
