"""Guards of the inversion: each fires on its mistake, holds the number, and is silent otherwise."""

import pytest

from loadid import _guards as flags
from loadid._inverse.diagnosis.identifiability import Refinement


def test_nodal_forces_are_no_pressure():
    for asked in ("Pa", "kPa", "N/m^2", "pressure", "traction"):
        flag = flags.nodal_as_pressure("nodal", asked)
        assert flag is not None
        assert flag.code == "LID-W106"
        assert "scale with element size" in flag.message
        assert "to_traction()" in flag.advice
    assert flags.nodal_as_pressure("nodal", "N") is None
    assert flags.nodal_as_pressure("patches", "Pa") is None


def test_refining_beyond_the_data():
    flag = flags.refined(Refinement(100, 400, 17, 17, 1e-3))
    assert flag is not None
    assert flag.code == "LID-W107"
    assert "n rose from 100 to 400; modes above noise stayed 17" in flag.message
    assert flags.refined(Refinement(8, 16, 8, 12, 1e-3)) is None


def test_detail_beyond_the_plateau():
    flag = flags.recoverable(12, 40, requested=20)
    assert flag is not None
    assert (flag.code, flag.evidence.value, flag.evidence.threshold) == ("LID-W304", 20.0, 12.0)
    assert "i* = 12 recoverable modes of 40" in flag.message
    assert flags.recoverable(12, 40, edf=30.0) is not None  # under-smoothed: more than twice what the data hold
    noise = flags.recoverable(0, 40, edf=3.0)
    assert noise is not None
    assert "all noise" in noise.message
    assert flags.recoverable(12, 40, edf=14.0, requested=12) is None
    assert flags.recoverable(12, 40) is None


def test_over_smoothing():
    flag = flags.over_smoothed(1.4, 9, 4.0)
    assert flag is not None
    assert (flag.code, flag.evidence.value) == ("LID-W310", 4.0)
    biased = flags.over_smoothed(12.0, 9, 0.1, [1.0, 70.0], [1.1, 100.0], [0.1, 5.0], ["Fx", "Fz"])
    assert biased is not None
    assert "Fz 70, measured 100" in biased.message
    assert biased.evidence.value == pytest.approx(6.0)
    assert flags.over_smoothed(12.0, 9, 0.1, [1.0, 99.0], [1.1, 100.0], [0.1, 5.0]) is None
    assert flags.over_smoothed(1.4, 9, 2.0) is None  # few degrees of freedom alone do no harm
    assert flags.over_smoothed(2.999, 3) is None
    assert flags.over_smoothed(None, 9) is None
