"""Places of hits by evidence: against dense algebra, and on a beam in closed form."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from loadid import LocationSearch, Search
from loadid._inverse.gaussian.record import augment, measured
from loadid._inverse.local_place import EvidentPlace, evident_place
from loadid._inverse.local_prior import local_prior
from loadid._inverse.nuisances import Nuisances
from loadid.paths import toeplitz
from structures import loads, sensors
from tests.benchmarks.analytic import response, user

SAMPLES, DT, SPACING, LEVEL, GAIN = 160, 1 / 4000, 0.04, 0.02, 0.2
SEEN, PLACE = (0.19, 0.36, 0.42), 0.147
BOX = np.array([[0.08, 0.498]])


@cache
def beam(*places: float):
    """A beam of five modes under candidates."""
    return user([sensors.Accelerometer(at=x) for x in SEEN], [loads.Point(at=x) for x in places], modes=5)


def system(place: float):
    """Its state space where it is struck at a place."""
    return beam(PLACE).with_loads([loads.Point(at=float(place))]).state_space(DT, "foh")


def struck(seed: int) -> np.ndarray:
    """Record of a hit of 2 ms."""
    t, rng = np.arange(SAMPLES) * DT, np.random.default_rng(seed)
    pulse = np.where((t > 0.01) & (t < 0.012), 100 * np.sin(np.pi * (t - 0.01) / 0.002), 0.0)
    clean = system(PLACE).predict(pulse[:, None], DT)
    return clean + LEVEL * clean.std(axis=0) * rng.standard_normal(clean.shape)


def records(y: np.ndarray, gains: np.ndarray | None = None):
    """Place -> record, at unit noise."""
    level, scale = LEVEL * y.std(axis=0), np.ones((len(SEEN), 1)) if gains is None else 1 + gains[:, None]

    def record(at):
        one = system(float(np.ravel(at)[0]))
        return measured(augment(one.A, one.B, one.C * scale, one.D * scale), y, level)

    return record


def dense(found, y: np.ndarray) -> float:
    """Variance of a place beside gains, and the square of the step that is not taken, by matrices of all samples."""
    level, place, memory = LEVEL * y.std(axis=0), float(found.place[0, 0]), found.prior.memory
    H, step = toeplitz(system(place).impulse_response(DT, SAMPLES) / level[:, None]).reshape(-1, SAMPLES), 1e-5
    ahead, behind = (toeplitz(system(place + s).impulse_response(DT, SAMPLES) / level[:, None]) for s in (step, -step))
    a = np.exp(-np.sqrt(3) / memory) if memory else 0.0
    shaped = np.linalg.inv(np.eye(SAMPLES) - 2 * a * np.eye(SAMPLES, k=-1) + a**2 * np.eye(SAMPLES, k=-2))
    prior = shaped * found.prior.given.load[:, 0] @ shaped.T
    K = np.diag(found.prior.given.noise.ravel()) + H @ prior @ H.T
    load = prior @ H.T @ np.linalg.solve(K, (y / level).ravel())
    answer = (H @ load).reshape(y.shape)
    slope = ((ahead - behind).reshape(-1, SAMPLES) @ load) / (2 * step)
    S = np.column_stack([slope, *[np.where(np.arange(len(SEEN)) == k, answer, 0.0).ravel() for k in range(len(SEEN))]])
    known, own, left = S.T @ np.linalg.solve(K, S), answer.ravel(), (y / level - answer).ravel()
    beside = np.linalg.solve(K, own)
    known -= np.outer(S.T @ beside, beside @ S) / (own @ beside)  # a factor on the whole is not told
    seen = S.T @ np.linalg.solve(K, left) - S.T @ beside * (beside @ left) / (own @ beside)
    covariance = np.linalg.inv(known + np.diag([1 / (10 * SPACING) ** 2, *[1 / GAIN**2] * len(SEEN)]))
    return covariance[0, 0] + (covariance @ seen)[0] ** 2


def test_the_band_is_that_of_dense_algebra():
    y = struck(0)
    found = evident_place([np.array([[0.16]])], records(y), BOX, SPACING, stated=True)
    assert found is not None
    assert not found.edge
    errors = Nuisances(("g1", "g2", "g3"), GAIN**2 * np.eye(3), lambda at: records(y, at)(found.place))
    covariance = found.covariance(records(y), errors, BOX, SPACING)
    assert covariance[0, 0, 0] == pytest.approx(dense(found, y), rel=0.02)


def test_the_band_at_the_rim_is_that_inside():
    """A place on the upper bound is moved down: its covariance with the other coordinate keeps its sign."""
    y = struck(0)

    def record(at):
        x, s = np.ravel(at)
        seen = [sensors.Accelerometer(at=float(place)) for place in (s, *SEEN[1:])]
        one = user(seen, [loads.Point(at=float(x))], modes=5).state_space(DT, "foh")
        return measured(augment(one.A, one.B, one.C, one.D), y, LEVEL * y.std(axis=0))

    place = np.array([[PLACE, SEEN[0]]])
    found = EvidentPlace(place, False, local_prior(record(place), stated=True))
    inside, rim = (found.covariance(record, None, np.array([[0.08, top], [0.08, 0.49]]), SPACING)[0]
                   for top in (0.49, PLACE))  # fmt: skip
    assert abs(inside[0, 1]) > 0.1 * np.sqrt(inside[0, 0] * inside[1, 1])
    np.testing.assert_allclose(rim, inside, rtol=0.05)


def test_places_scatter_as_their_band_says():
    off = []
    for seed in range(1, 9):
        y = struck(seed)
        found = evident_place([np.array([[0.16]])], records(y), BOX, SPACING, stated=True)
        std = np.sqrt(found.covariance(records(y), None, BOX, SPACING)[0, 0, 0])
        off.append((found.place[0, 0] - PLACE) / std)
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 1.5


@pytest.mark.parametrize("width", [0.002, 0.004])
def test_a_hit_near_the_clamp_is_found_where_it_was(width):
    """The residual of a free history puts them 16 and 26 mm too far out, with a std of 2 mm."""
    fine, t = DT / 16, np.arange(16 * 400) * DT / 16
    pulse = np.where((t > 0.02) & (t < 0.02 + width), 100 * np.sin(np.pi * (t - 0.02) / width), 0.0)
    y = response(pulse, 0.1, [("acceleration", x) for x in SEEN], fine)
    y = sosfiltfilt(butter(8, 0.425, fs=16, output="sos"), y, axis=0)[::16]
    y += 0.01 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)
    found = LocationSearch(beam(0.08, 0.12, 0.16, 0.2, 0.28), search=Search(workers=1)).locate(y, DT)
    assert found.facts["place_by"] == "evidence of hits"
    assert abs(found.found[0, 0] - 0.1) < 1.96 * found.std[0, 0] < 0.02


def test_a_load_that_acts_throughout_is_placed_by_its_residual():
    rng = np.random.default_rng(3)
    model = user(
        [sensors.Accelerometer(at=x) for x in SEEN], [loads.Point(at=0.01 * k) for k in range(20, 41, 4)], modes=5
    )
    y = model.predict(np.outer(rng.standard_normal(SAMPLES), np.eye(6)[2]), DT)
    y += 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    found = LocationSearch(model, search=Search(workers=1)).locate(y, DT)
    assert found.facts["place_by"] == "residual"
