"""The case study `cantilever_shaker`: the force of two tests from the acceleration, against the load cell."""

import numpy as np
import pytest

from case_studies import cantilever_shaker as study
from structures import InputError

from .data import measured


@pytest.fixture(scope="module")
def calibration() -> study.Calibration:
    measured("cantilever_shaker", "cantilever_shaker.npz")
    return study.calibrated()


@pytest.fixture(scope="module", params=[2, 3])
def found(request: pytest.FixtureRequest, calibration: study.Calibration) -> study.Identified:
    return study.identified(request.param, calibration)


def test_only_driven_lines_are_calibrated_and_the_others_flagged(calibration: study.Calibration):
    np.testing.assert_array_equal(calibration.lines, [100, 120, 150])
    assert 2 < calibration.start < 4  # the shaker settles
    assert "LID-W211" in {f.code for f in calibration.model.flags}
    with pytest.raises(InputError, match="no line of the table"):
        calibration.model.frf([200.0])


def test_short_time_lines_of_a_tone_are_its_amplitude():
    t = np.arange(6400) / study.RATE
    _, found = study.short_time(3 * np.cos(2 * np.pi * 120 * t + 0.7), np.array([100.0, 120.0, 150.0]))
    np.testing.assert_allclose(found[:, 1], 3 * np.exp(0.7j), rtol=1e-3)
    assert np.abs(found[:, [0, 2]]).max() < 0.01


def test_force_against_the_load_cell(found: study.Identified):
    limit = {"test 2": 0.060, "test 3": 0.047}[found.test.name]
    assert found.error < limit
    assert abs(found.peak_error) < 0.04
    assert found.gain_error > 5 * found.error  # without an FRF
    assert found.raw_error < 0.18  # with the harmonics of the shaker
    assert 0.6 < found.covered <= 1


def test_a_line_that_falls_silent_is_not_trusted(found: study.Identified):
    late = found.time > 10.5
    silent = ~found.trusted[late]
    assert silent[:, 2].all() == (found.test.name == "test 3")
    assert found.trusted[:, :2].all()
    assert found.trusted[found.time < 9].all()


def test_flags_say_what_is_not_calibrated(found: study.Identified):
    assert "LID-W211" in {f.code for f in found.flags}
