"""Differences and size held small together, against dense least squares with both penalties stacked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid._inverse.gaussian.sized import SizedPath
from loadid._inverse.posterior import from_arrays
from structures import InputError

from .cases import PENALTIES, beam, case, holes, off

LAM, SIZE = 1e-2, np.array([0.3, 0.05])


def problem(penalty: str, samples: int = 90, missing: object = None):
    """Path and dense problem of one record."""
    own, (name, options) = case(beam("dsa"), samples, missing), PENALTIES[penalty]  # type: ignore[arg-type]
    dense = own.dense(name, **options)
    both = np.vstack([dense.L, np.kron(np.eye(samples), np.diag(SIZE))])
    return own, SizedPath(own.record(name, own.y, **options), SIZE), replace(dense, L=both)


@pytest.mark.parametrize("missing", [None, holes])
@pytest.mark.parametrize("penalty", ["identity", "first", "second", "second from zero", "leaky"])
def test_everything_equals_the_dense_problem(penalty: str, missing: object) -> None:
    own, path, dense = problem(penalty, missing=missing)
    lam = LAM * float(path.scale)
    exact, found, solution = dense.at(lam), path.exact(LAM), path.solution(LAM, 1.3)
    assert (path.m, path.null) == (len(dense.y), 0)
    assert off(path.scale, dense.gamma[0]) < 1e-8
    assert off(solution.load, exact.load) < 1e-10

    A, left = exact.influence, np.eye(path.m) - exact.influence
    step = -2 * lam**2 * exact.covariance @ (dense.L.T @ (dense.L @ exact.whole))
    scalars = {
        "residual2": (np.sum(exact.residual**2), 1e-9), "penalty2": (np.sum((dense.L @ exact.whole) ** 2), 1e-9),
        "edf": (np.trace(A), 1e-9), "left": (np.trace(left), 1e-9), "edf2": (np.sum(A * A), 1e-7),
        "rest2": (np.sum(left**2), 1e-7), "log_ratio": (dense.log_ratio(lam), 1e-8),
        "sensitivity": (np.linalg.norm(step), 1e-7),
        "bend": (2 * exact.whole @ dense.L.T @ (dense.L @ step), 1e-7),
        "objective": (np.sum(exact.residual**2) + lam**2 * np.sum((dense.L @ exact.whole) ** 2), 1e-7),
    }  # fmt: skip
    errors = {key: (off(getattr(found, key), value), limit) for key, (value, limit) in scalars.items()}
    assert {key: error for key, (error, limit) in errors.items() if error > limit} == {}

    posterior, w = solution.posterior, np.random.default_rng(1).standard_normal(own.load.shape)
    flat, shape = w.reshape(-1), w.shape
    assert off(posterior.std, 1.3 * np.sqrt(np.diag(exact.covariance)).reshape(shape)) < 1e-9
    assert off(posterior.noise_std, 1.3 * np.sqrt(np.diag(exact.noise_covariance)).reshape(shape)) < 1e-7
    assert off(posterior.variance(w), 1.69 * flat @ exact.covariance @ flat) < 1e-9
    assert off(posterior.noise_variance(w), 1.69 * flat @ exact.noise_covariance @ flat) < 1e-9
    assert off(posterior.bias_weights(w), exact.resolution.T @ flat - flat) < 1e-8
    assert off(path.resolve(own.load, LAM), exact.resolution @ own.load.reshape(-1)) < 1e-9
    assert off(path.residual(LAM)[~np.isnan(own.y)], exact.residual) < 1e-9
    assert path.gradient(LAM) < 1e-12
    assert off(from_arrays(posterior.to_arrays()).std, posterior.std) < 1e-12


def test_an_error_is_predicted_as_by_the_dense_problem() -> None:
    _, path, dense = problem("first")
    scale, lams = float(path.scale), np.array([3e-3, 3e-2])
    pilot = dense.at(0.03 * scale)
    exact = []
    for lam in lams:
        one = dense.at(lam * scale)
        lost = pilot.load.reshape(-1) - one.resolution @ pilot.load.reshape(-1)
        exact.append(np.sum(lost**2) + 1.69 * np.trace(one.noise_covariance))
    assert off(path.predicted_error(lams, 0.03, 1.3), exact) < 1e-5


def test_sizes_must_be_positive_and_fit() -> None:
    own = case(beam("dsa"), 40)
    record = own.record("first_difference", own.y)
    for wrong in (np.array([0.1, 0.0]), np.array([0.1]), np.array([0.1, np.nan])):
        with pytest.raises(InputError, match="sizes"):
            SizedPath(record, wrong)
