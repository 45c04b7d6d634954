"""Digits at small lambda, against extended precision: those of the square-root recursion and of dense least squares."""

import numpy as np
import pytest

from tests.benchmarks.accuracy import BOUND, SQUARED, long_errors


@pytest.fixture(scope="module")
def worst() -> dict[str, dict[str, np.ndarray]]:
    return long_errors(150)


@pytest.mark.parametrize("penalty", ["identity", "first_difference", "second_difference"])
def test_the_digits_of_the_square_root_recursion(penalty: str, worst: dict[str, dict[str, np.ndarray]]) -> None:
    errors = worst[penalty]
    assert np.all(errors["state space"] <= errors[BOUND])
    assert np.all(errors["state space"][2:] <= 1e-3 * errors[SQUARED][2:])  # what normal equations may lose
