"""Digits at condition number 1e10, against extended precision."""

import numpy as np
import pytest

from tests.benchmarks.accuracy import BOUND, LAMBDAS, case, errors, extended, modes, normal, ours, stacked

from .reference import augmented


@pytest.fixture(scope="module")
def worst() -> dict[str, np.ndarray]:
    return errors({"ours": ours, "modes": modes, "stacked": stacked, "normal": normal}, 1)


def test_the_solution_keeps_its_digits_at_every_lambda(worst: dict[str, np.ndarray]) -> None:
    assert np.all(worst["ours"] <= worst[BOUND])
    assert np.all(worst[BOUND] <= [2e-12, 5e-9, 4e-6])  # the problem has these digits, if the method keeps them


def test_the_modes_are_close_behind_and_the_normal_equations_are_not(worst: dict[str, np.ndarray]) -> None:
    assert np.all(worst["modes"] <= worst[BOUND])
    assert worst["normal"][1] > 1e-8
    assert worst["normal"][2] > 1e-3


def test_the_reference_is_right_where_double_precision_is() -> None:
    H, y, L = case(0)
    g = augmented(H, y, L, 0.1).load
    assert np.linalg.norm(extended(H, y, L, 0.1) - g) < 1e-13 * np.linalg.norm(g)
    assert LAMBDAS == (1e-2, 1e-5, 1e-8)
