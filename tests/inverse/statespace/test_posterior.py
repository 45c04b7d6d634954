"""The posterior of a long record outlives a result file, and so do the sums that it is asked for."""

from pathlib import Path

import numpy as np

from loadid import Deconvolution, Lambda, LoadEstimate
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
