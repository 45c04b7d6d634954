"""Places by the first part of a response: against dense algebra, and on a closed-form beam by a model that is wrong."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from scipy.stats import multivariate_normal

from loadid import LocationSearch, Search
from loadid._guards.families import place_unexplained
from loadid._inverse.convolved import early
from loadid._inverse.convolved.early import EarlyResponse, early_places, early_response
from loadid.paths import toeplitz
from structures import ForwardModel, beams, damping, loads, sensors
from tests.benchmarks.analytic import DAMPING, ELEMENTS, HEIGHT, LENGTH, STEEL, WIDTH, response

DT, FINER, SEEN = 1 / 4000, 16, (0.19, 0.31, 0.42, 0.48)


def test_the_evidence_is_that_of_dense_algebra():
    rng = np.random.default_rng(0)
    y, h = rng.standard_normal((14, 2)), rng.standard_normal((14, 2))
    noise, power = np.array([0.3, 0.7]), rng.random((14, 2))
    H, told = toeplitz(h[:, :, None]).reshape(28, 14), []
    for share in early.SHARES:
        R = (noise + share**2 * power).ravel()
        largest = np.linalg.norm(H / np.sqrt(R)[:, None], 2)
        told += [multivariate_normal(cov=np.diag(R) + v / largest**2 * H @ H.T).logpdf(y.ravel())
                 for v in early.VARIANCES]  # fmt: skip
    own = EarlyResponse(0, y, noise, power).evidence(h) - 14 * np.log(2 * np.pi)
    assert own == pytest.approx(max(told), rel=1e-9)


@pytest.mark.parametrize("known", [False, True])
def test_the_onset_is_found_at_any_scale(known):
    t, rng = np.arange(400), np.random.default_rng(1)
    hit = np.where(t >= 150, np.exp(-(t - 150) / 60) * np.sin(0.3 * (t - 150)), 0.0)
    y = np.outer(hit, [1.0, -0.4, 0.2]) + 0.03 * rng.standard_normal((400, 3))
    for scale in (1e-9, 1.0, 1e9):
        found = early_response(scale * y, (0.03 * scale) ** 2 if known else None)
        assert abs(found.onset - 150) <= 4
        np.testing.assert_allclose(found.noise / scale**2, 0.03**2, rtol=0.5)
        assert found.y.shape == found.power.shape


def test_nothing_begins_in_noise():
    assert early_response(np.random.default_rng(2).standard_normal((400, 3)), None) is None
    assert early_response(np.random.default_rng(2).standard_normal((400, 3)), 1.0) is None


def test_the_best_place_is_refined_inside_its_box():
    """Responses that move with a place: the evidence is the largest where the data were made."""
    t = np.arange(60) * 1.0

    def responses(at, samples):
        return np.stack([np.stack([np.sin(0.2 * (1 + x) * t), np.cos(0.3 * (1 + x) * t)], axis=1)[:samples]
                         for x in np.ravel(at)], axis=2)  # fmt: skip

    pulse = np.where((t > 20) & (t < 26), 1.0, 0.0)
    y = np.einsum("tsk,k->ts", toeplitz(responses([0.43], 60)), pulse) + 1e-3 * np.random.default_rng(3).normal(
        size=(60, 2)
    )
    grid = np.linspace(0, 1, 6)[:, None]
    box = np.array([[0.0, 1.0]])
    told = early_places(early_response(y, 1e-6), grid, responses(grid, 60), responses, box, 0.2)
    assert told == sorted(told, key=lambda one: -one[0])
    assert told[0][1][0] == pytest.approx(0.43, abs=0.005)
    assert all(0 <= at[0] <= 1 for _, at in told)


def test_a_hit_is_found_by_a_model_whose_modulus_is_wrong():
    """The residual of a free history puts it 7 mm off, with a std of less than 1 mm."""
    t = np.arange(FINER * 300) * DT / FINER
    pulse = np.where((t > 0.02) & (t < 0.022), 100 * np.sin(np.pi * (t - 0.02) / 0.002), 0.0)
    y = response(pulse, 0.37, [("acceleration", x) for x in SEEN], DT / FINER)
    y = sosfiltfilt(butter(8, 0.425, fs=FINER, output="sos"), y, axis=0)[::FINER]
    y += 0.01 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)
    soft = beams.Material(E=0.95 * STEEL.E, rho=STEEL.rho, nu=STEEL.nu)
    beam = beams.cantilever(length=LENGTH, section=beams.Section.rectangle(WIDTH, HEIGHT), material=soft,
                            damping=damping.Modal(DAMPING), elements=ELEMENTS)  # fmt: skip
    seen, candidates = [sensors.Accelerometer(at=x) for x in SEEN], [loads.Point(at=0.04 * k) for k in range(5, 12)]
    found = LocationSearch(ForwardModel(beam, seen, candidates, modes=5), search=Search(workers=1)).locate(y, DT)
    assert found.facts["place_by"] == "first part of its response"
    assert abs(found.found[0, 0] - 0.37) < 1.96 * found.std[0, 0] < 0.01
    assert not any(f.code == "LID-W511" for f in found.flags)


def test_what_the_first_part_leaves_is_told():
    assert place_unexplained(10.0, 0.3, 0.1) is None
    assert place_unexplained(10.0, 0.3, 0.2).code == "LID-W511"
    assert place_unexplained(10.0, 0.3, None).code == "LID-W511"
