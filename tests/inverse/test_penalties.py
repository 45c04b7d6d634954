"""Penalties against their definitions, in time and over frequency."""

import numpy as np
import pytest

from loadid.inverse import penalties
from structures.errors import InputError

from . import reference


@pytest.mark.parametrize("name", ["first_difference", "second_difference"])
@pytest.mark.parametrize("samples", [3, 4, 11])
def test_matrix_is_the_difference_of_each_load_in_time(name: str, samples: int) -> None:
    L = penalties.matrix(name, samples, loads=3)
    g = np.random.default_rng(1).standard_normal((samples, 3))
    expected = np.diff(g, n=1 if name == "first_difference" else 2, axis=0)
    assert L is not None
    np.testing.assert_allclose((L @ g.ravel()).reshape(-1, 3), expected, atol=1e-14)
    np.testing.assert_allclose(penalties.matrix(name, samples), reference.penalty(name, samples), atol=0)


def test_identity_needs_no_matrix_and_names_have_synonyms() -> None:
    assert penalties.matrix("identity", 7) is None
    np.testing.assert_array_equal(penalties.matrix("gradient", 7), penalties.matrix("first_difference", 7))
    np.testing.assert_array_equal(penalties.matrix("laplacian", 7), penalties.matrix("second_difference", 7))


@pytest.mark.parametrize(("name", "stencil"), [("identity", [1]), ("gradient", [1, -1]), ("laplacian", [1, -2, 1])])
def test_symbol_is_the_transform_of_the_stencil(name: str, stencil: list[float]) -> None:
    padded = 30
    theta = 2 * np.pi * np.arange(padded // 2 + 1) / padded
    np.testing.assert_allclose(penalties.symbol(name, theta), np.abs(np.fft.rfft(stencil, padded)), atol=1e-14)


@pytest.mark.parametrize(
    "wrong", ["ridge", np.eye(4), np.full((2, 6), np.nan), np.ones((2, 6)) * np.inf, np.ones((2, 2, 6))]
)
def test_what_is_no_penalty_is_refused(wrong: object) -> None:
    with pytest.raises(InputError, match="penalty"):
        penalties.matrix(wrong, 3, loads=2)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(InputError, match="too few samples"):
        penalties.matrix("second_difference", 2)
