"""The posterior of a long record outlives a result file, and so do the sums that it is asked for."""

from pathlib import Path

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, LoadEstimate
from loadid._inverse.gaussian import posterior
from loadid._inverse.gaussian.gains import gains
from loadid._inverse.posterior import from_arrays

from .cases import DT, beam, case, holes


def test_it_comes_back_from_its_arrays() -> None:
    path = case(beam("dv"), 120, holes).path("second_difference")
    first = path.solution(1e-2, 1.3).posterior
    again = from_arrays(first.to_arrays())  # type: ignore[union-attr]
    w = np.ones(first.std.shape)  # type: ignore[union-attr]
    assert np.array_equal(again.std, first.std)  # type: ignore[union-attr]
    assert np.array_equal(again.variance(w), first.variance(w))  # type: ignore[union-attr]
    assert np.array_equal(again.noise_variance(w), first.noise_variance(w))  # type: ignore


def test_an_estimate_comes_back_from_its_file(tmp_path: Path) -> None:
    given = case(beam("da"), 600, holes)
    estimate = Deconvolution(given.system, noise=given.noise, choice=Lambda(1e-2, path="statespace")).estimate(
        given.y, DT
    )
    estimate.save(tmp_path / "load.h5")
    again = LoadEstimate.read(tmp_path / "load.h5")
    w = np.ones(estimate.load.shape)
    assert estimate.posterior is not None
    assert again.posterior is not None
    assert estimate.posterior.to_arrays()["kind"] == "statespace"
    assert np.array_equal(again.load, estimate.load)
    assert np.array_equal(again.posterior.std, estimate.posterior.std)
    assert np.array_equal(again.posterior.variance(w), estimate.posterior.variance(w))


@pytest.mark.parametrize("start", [False, True])
@pytest.mark.parametrize("penalty", ["identity", "first_difference", "second_difference"])
@pytest.mark.parametrize("passes", [False, True])
@pytest.mark.parametrize("relative", [1e-2, 1e-6])
def test_variances_are_those_of_the_dense_inverse(
    relative: float, passes: bool, penalty: str, start: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of samples, of combinations of their loads, and their sums, by the recursion and by passes."""
    monkeypatch.setattr(posterior, "_is_cheap", lambda *_: passes)
    given = case(beam("dsa"), 70, moving=start)
    record, dense = given.record(penalty, given.y, unknown_start=start), given.dense(penalty, unknown_start=start)
    lam = relative * float(given.path(penalty, unknown_start=start).scale)
    covariance, (samples, p) = dense.at(lam).covariance, dense.shape
    of_load = covariance[: samples * p, : samples * p].reshape(samples, p, samples, p)
    within = np.array([of_load[k, :, k] for k in range(samples)])
    T, held = np.array([[1.0, 1.0], [0.3, -2.0], [0.0, 1.0]]), gains(record, lam)
    each, sums = posterior.variances(record, held), posterior.variances(record, held, every_sample=False)
    combined = posterior.variances(record, held, combined=T).variance
    np.testing.assert_allclose(each.variance, np.diagonal(within, axis1=1, axis2=2), rtol=1e-7)
    np.testing.assert_allclose(combined, np.einsum("ia,kab,ib->ki", T, within, T), rtol=1e-7)
    np.testing.assert_allclose(sums.trace, np.trace(covariance[: samples * p, : samples * p]), rtol=1e-8)
    free = samples * p - len(dense.L)  # differences that a free load before the record leaves to their prior
    np.testing.assert_allclose(sums.penalty, lam**2 * np.sum((dense.L @ covariance) * dense.L) + free, rtol=1e-8)
