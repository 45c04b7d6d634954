"""The case studies of tracking, pinned: the figures that they print."""

import numpy as np
import pytest

from case_studies import beam_tracking, bridge_crossing, method_map


@pytest.fixture(scope="module")
def crossing():
    return bridge_crossing.follow(bridge_crossing.crossing())


@pytest.fixture(scope="module")
def rows():
    true = beam_tracking.truth(offset=beam_tracking.OFFSET)
    whole = beam_tracking.tracked(true, "random_walk", True)
    walk = beam_tracking.RandomWalk(whole.estimate.facts.tuned["rate of load 1"])
    return beam_tracking.tracked(true, "random_walk", False, walk), whole


class TestBeam:
    def test_accelerometers_alone_are_refused_and_drift(self, rows):
        alone = rows[0]
        assert alone.refused == "LID-E501"
        assert "E501" in alone.flags
        assert alone.error > 1
        std = alone.estimate.std[:, 0]
        assert std[-1] > 1.2 * std[len(std) // 2] > 2 * std[1000]

    def test_one_gauge_holds_the_force(self, rows):
        whole = rows[1]
        assert not whole.refused
        assert whole.error <= 0.004
        assert abs(whole.last) <= 0.05
        assert whole.covered >= 0.88
        assert whole.time_constant < 1

    def test_text_and_picture(self, rows, tmp_path):
        assert "refused LID-E501, overruled" in beam_tracking.show(list(rows))
        beam_tracking.picture(list(rows), tmp_path / "x.png")
        assert (tmp_path / "x.png").stat().st_size > 20_000


class TestBridge:
    def test_weight_place_and_speed(self, crossing):
        found = crossing.figures()
        assert found["weight, relative error"] <= 0.015
        assert found["weight, mean over the crossing, relative error"] <= 0.002
        assert found["place, rms error in m"] <= 0.15
        assert found["speed, relative error"] <= 0.005
        assert 0.78 <= found["weight inside its 95 % band"] <= 0.9  # the fixed places are no part of it
        assert found["weight inside the sum of the bands"] >= 0.99
        assert found["std of the weight over the sum of the stds"] == pytest.approx(0.155, abs=0.03)
        assert found["weight before and after, over the axle"] <= 0.05

    def test_the_axle_rests_on_one_place_as_it_passes(self, crossing):
        true, load = crossing.true, crossing.estimate.load
        for j, x in enumerate(bridge_crossing.PLACES):
            k = int(np.nanargmin(np.abs(true.place - x)))
            assert load[k, j] == pytest.approx(true.axle[k], rel=0.06)

    def test_picture(self, crossing, tmp_path):
        bridge_crossing.picture(crossing, tmp_path / "x.png")
        assert "flags" in bridge_crossing.show(crossing)
        assert (tmp_path / "x.png").stat().st_size > 20_000


class TestMethodMap:
    @staticmethod
    def errors(kind, *methods):
        found = method_map.column(kind, methods=(*methods, "Tikhonov"))
        return {name: found.cells[name].error for name in methods}, found

    def test_a_harmonic_pulls_and_is_smooth(self):
        ways = ("non-negative", "l1, spikes", "tracker, online", "tracker, 5/2 smoothed")
        error, found = self.errors("harmonic", *ways)
        assert error["tracker, online"] <= 0.012
        assert min(error["non-negative"], error["l1, spikes"]) >= 0.2
        assert found.advice.prior == "matern52"
        assert found.ratio <= 1.2

    def test_a_random_load_is_a_process(self):
        error, found = self.errors("random", "tracker, smoothed", "truncated SVD")
        assert error["tracker, smoothed"] <= 0.018
        assert error["tracker, smoothed"] <= 0.6 * error["truncated SVD"]
        assert found.cells["tracker, smoothed"].covered >= 0.92
        assert "Matern" in found.cells["tracker, smoothed"].prior
        assert found.ratio <= 1.2

    def test_impacts_are_recognised_by_evidence(self):
        """Of another draw than the printed one; the methods that can be best."""
        _, found = self.errors("impact", "truncated SVD", "l1, spikes", "tracker, smoothed", "tracker, 5/2 smoothed")
        assert found.ratio <= 1.2
        assert found.recommended.covered >= 0.85
        assert found.advice.evidence[found.advice.prior] == 0

    def test_text(self):
        found = method_map.column("slow", methods=("Tikhonov", "truncated SVD"))
        assert found.ratio <= 1.2
        text = method_map.show([found])
        assert "white in time" in text
        assert "recommended over best" in text
