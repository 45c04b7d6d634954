"""W207: FRFs that are conjugated or of reversed polarity, on whole grids, on bands and on a few lines."""

import numpy as np
import pytest

from structures import ForwardModel, FrfModel, MeasuredModel, chains, loads, sensors
from structures._flags import codes
from structures._testing.kinds import BAND, before_zero, drive_point, feeds_back, uniform_run
from tests.benchmarks.causality import rates

CHAIN = chains.chain(masses=[1.0, 1.5, 2.0, 1.0], springs=[4e4, 6e4, 3e4, 5e4], dashpots=8.0)
SENSORS = {"receptance": sensors.Displacement, "mobility": sensors.Velocity, "accelerance": sensors.Accelerometer}


def frf(lines, kind="accelerance", read=(1, 2, 3, 4), push=(2, 4)):
    model = ForwardModel(
        CHAIN, [SENSORS[kind](f"{i}+X") for i in read], [loads.Point(f"{i}+X") for i in push], modes=None
    )
    return model.frf(lines)


def table(lines, H, kind="accelerance", read=None, push=None):
    return FrfModel.from_frf(lines, H, kind=kind, sensors=read, loads=push)


LINES = np.linspace(5.0, 80.0, 300)


class TestBand:
    @pytest.mark.parametrize("kind", list(SENSORS))
    def test_conjugated(self, kind):
        H = frf(LINES, kind)
        assert table(LINES, H, kind).flags == ()
        (flag,) = table(LINES, H.conj(), kind).flags
        assert flag.code == "LID-W207"
        assert "conjugate" in flag.advice
        assert codes(table(LINES, -H, kind).flags) == set()  # causal still; no drive point is named

    def test_one_entry_of_many_is_named(self):
        H = frf(LINES)
        H[:, 2, 1] = 1e-6 * H[:, 2, 1].conj()
        (flag,) = table(LINES, H).flags
        assert "sensor 3 / load 2" in flag.message
        assert "sensor 1" not in flag.message

    def test_a_response_ahead_of_the_force(self):
        ahead = np.exp(2j * np.pi * LINES * 0.2)[:, None, None]
        assert codes(table(LINES, frf(LINES) * ahead).flags) == {"W207"}
        assert table(LINES, frf(LINES) / ahead).flags == ()

    def test_units_do_not_matter(self):
        for factor in (1e-9, 1e9):
            assert codes(table(LINES, factor * frf(LINES).conj()).flags) == {"W207"}
            assert table(LINES, factor * frf(LINES)).flags == ()

    def test_the_longest_uniform_run_decides(self):
        some = np.concatenate([[1.0, 2.5], LINES, [99.0, 140.0]])
        assert uniform_run(some) == (2, 302)
        assert uniform_run(np.array([3.0])) == (0, 1)
        assert codes(table(some, frf(some).conj()).flags) == {"W207"}

    @pytest.mark.parametrize(
        "lines", [np.array([10.0, 20.0, 45.0]), np.linspace(5, 80, BAND - 1), np.linspace(200, 400, 300)]
    )
    def test_what_cannot_be_told_is_a_note(self, lines):
        for H in (frf(lines), frf(lines).conj()):
            (flag,) = table(lines, H).flags
            assert flag.level == "note"
            assert flag.code == "LID-N207"

    @pytest.mark.parametrize("noise", [0.0, 0.3])
    def test_alarms_and_misses_over_random_models(self, noise):
        """The benchmark's figures, on fewer models."""
        told, alarms, missed = rates(400, 300, noise, seed=5)
        assert told > 0.8
        assert alarms == 0
        assert missed < 0.03

    def test_noise_alone_is_not_judged(self):
        rng = np.random.default_rng(0)
        noise = rng.standard_normal((400, 50, 4)) + 1j * rng.standard_normal((400, 50, 4))
        share, told = before_zero(np.arange(1.0, 401.0), noise)
        assert np.mean(told & (share > 0.75)) < 0.01


class TestDrivePoints:
    FEW = np.array([11.0, 23.0, 37.0])
    NAMES = ("1+X", "2+X", "3+X", "4+X")

    @pytest.mark.parametrize("kind", list(SENSORS))
    def test_wrong_sign_on_a_few_lines(self, kind):
        H = frf(self.FEW, kind)
        assert table(self.FEW, H, kind, self.NAMES, ("2+X", "4+X")).flags == ()
        H[:, 3] *= -1
        (flag,) = table(self.FEW, H, kind, self.NAMES, ("2+X", "4+X")).flags
        assert flag.code == "LID-W207"
        assert "4+X / 4+X" in flag.message
        assert "2+X /" not in flag.message
        assert "or is conjugated" in flag.message

    def test_wrong_sign_and_not_conjugated_where_a_band_tells(self):
        for make in (FrfModel, MeasuredModel):
            f = np.linspace(0, 80, 600) if make is MeasuredModel else LINES
            H = frf(f)
            H[:, 1] *= -1
            (flag,) = make.from_frf(f, H, kind="accelerance", sensors=self.NAMES, loads=("2+X", "4+X")).flags
            assert "2+X / 2+X has the wrong sign" in flag.message
            assert "conjugate" not in flag.advice

    def test_declared_polarity(self):
        """A sensor that points against the force of its node reads minus."""
        H = frf(self.FEW)
        H[:, 1] *= -1
        assert table(self.FEW, H, "accelerance", ("1+X", "2-X", "3+X", "4+X"), ("2+X", "4+X")).flags == ()

    def test_conjugated_is_said_once(self):
        (flag,) = table(LINES, frf(LINES).conj(), "accelerance", self.NAMES, ("2+X", "4+X")).flags
        assert "8 of the 8 entries that tell ring before zero" in flag.message

    def test_which_pairs_are_drive_points(self):
        m = FrfModel.from_frf(
            [1.0], np.ones((1, 4, 1)), kind="mobility", sensors=["2+X", "2-X", "2+Y", "a"], loads=["2X+"]
        )
        assert [drive_point(s, m.loads[0]) for s in m.sensors] == [1, -1, 0, 0]
        assert np.isnan(feeds_back(m.frequencies, m.H, m.sensors, m.loads)[2:]).all()

    def test_noise_on_a_drive_point(self):
        rng = np.random.default_rng(1)
        H = frf(LINES)
        H += 0.1 * np.sqrt(np.mean(np.abs(H) ** 2)) * rng.standard_normal(H.shape)
        assert table(LINES, H, "accelerance", self.NAMES, ("2+X", "4+X")).flags == ()
