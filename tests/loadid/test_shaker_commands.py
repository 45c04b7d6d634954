"""The measured cantilever on its shaker by commands alone: calibrated on one test, the force of the two others."""

import numpy as np
import pytest

from case_studies import cantilever_shaker as study
from loadid import LoadEstimate
from tests.data import measured
from tests.loadid.test_cli import installed, run

__all__ = ["installed", "run"]
READ = ["--fs", "3200", "--unit", "drive_V=V", "--unit", "force_lbf=lbf", "--unit", "acc_g=g"]
CALIBRATE = [
    "--record", "test1", "--excitation", "shaker", "--force", "force_lbf", "--response", "acc_g", "--between", "3:19.7",
    "--segment", "320", "--coherence", "0.99", "--band", "80:170", "--frf-error", "0.05", "--interpolate",
]  # fmt: skip
IDENTIFY = ["--family", "frequency", "--signal", "transient", "--choice", "0"]


@pytest.fixture
def log():
    return measured("cantilever_shaker", "cantilever_shaker.npz")


def test_the_force_of_the_shaker_by_commands_alone(run, log, tmp_path):
    """Both histories through the frames of the case study, as it compares them: 6.0 and 4.7 % of the load cell."""
    model = tmp_path / "shaker.h5"
    code, out, err = run("calibrate", log, *CALIBRATE, *READ, "-o", model)
    assert code == 0, err
    assert "8 lines, 90 to 160 Hz" in out
    lines = np.array([100.0, 120.0, 150.0])
    for number, most in ((2, 0.060), (3, 0.047)):
        result = tmp_path / f"test{number}.h5"
        code, _, err = run(
            "identify", log, "--record", f"test{number}", "--model", model, *IDENTIFY, *READ, "-o", result
        )
        assert code == 0, err
        found = LoadEstimate.read(result)
        cell = study.record(number)["force"]
        seen, known = (study.short_time(x, lines)[1] for x in (found.load[:, 0], cell))
        assert study.relative(seen, known) < most
        middle = slice(1280, -1280)  # frames end within the record
        assert study.relative(found.load[middle, 0], cell[middle]) < 0.17  # with the harmonics of the shaker
