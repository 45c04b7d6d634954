"""W114 of a model that was checked, and failed."""

import numpy as np
import pytest

from loadid import StaticInversion
from structures import Channel, MatrixModel

H = np.array([[1.0, 0.4], [0.7, 1.0], [0.2, 0.9]])
LOAD = np.array([10.0, 5.0])


def estimate(measured, noise=0.01):
    seen = [Channel(label=f"d{i}", quantity="displacement", unit="m", noise=noise) for i in range(3)]
    model = MatrixModel(H, sensors=seen)
    model.verify(LOAD, measured, source="hanging mass")
    return StaticInversion(model).estimate(H @ LOAD)


@pytest.mark.parametrize(("factors", "sensors"), [([-1, -1, -1], 3), ([1, 1, -1], 1), ([1, 4, 1], 1)])
def test_a_model_that_fails_its_check_is_not_verified(factors, sensors):
    found = estimate(np.array(factors) * (H @ LOAD))
    flag = next(f for f in found.flags if f.code == "LID-W114")
    assert f"{sensors} of 3 sensors" in flag.message
    assert "hanging mass" in flag.message
    assert flag.evidence.value > 0.5
    assert "disagrees with hanging mass" in found.verified


def test_a_model_that_passes_is_verified():
    found = estimate(1.2 * (H @ LOAD))
    assert "W114" not in found.codes
    assert found.verified.startswith("forward model verified against hanging mass")


def test_a_residual_within_the_noise_is_no_error_of_the_model():
    assert "W114" not in estimate(np.array([1, 1, -1]) * (H @ LOAD), noise=8.0).codes
