"""Pieces of a long record have the load, the std and the residual of the whole."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, Noise, Penalty, Record
from loadid._batch import joined
from structures import ForwardModel, beams, damping, loads, sensors
from tests.halfsine import pulses, respond, system

SAMPLES, PIECE = 24_000, 8000
JOB = {"family": "deconvolution", "choice": 0.01}


def hits(gaps: float = 0.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    y = respond(pulses(41, SAMPLES))
    y = y + 0.02 * y.std() * rng.standard_normal(SAMPLES)
    y[rng.random(SAMPLES) < gaps] = np.nan
    return y[:, None]


def beam(*kinds: type) -> ForwardModel:
    steel = beams.cantilever(length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                             elements=20, damping=damping.Modal(0.02))  # fmt: skip
    seen = [kind(at=x, direction="Z", label=f"s{x}") for kind, x in zip(kinds, (0.3, 0.6, 0.9), strict=False)]
    return ForwardModel(steel, sensors=seen, loads=[loads.Point(at=0.65, direction="Z")], modes=4)


def beam_record(model: ForwardModel, dt: float) -> np.ndarray:
    rng = np.random.default_rng(1)
    y = model.predict(np.cumsum(rng.standard_normal((SAMPLES, 1)), axis=0), dt)
    return y + 0.02 * y.std(axis=0) * rng.standard_normal(y.shape)


def in_pieces(values: np.ndarray, dt: float, model, job, found) -> list[np.ndarray]:
    cuts = pairwise([*range(0, len(values), PIECE), len(values)])
    parts = [joined.solved(values, dt, model, job, found, a, b) for a, b in cuts]
    return [np.concatenate(arrays) for arrays in zip(*parts, strict=True)]


def whole(values: np.ndarray, dt: float, model, found, penalty: str) -> np.ndarray:
    """Load by the public call on all of the record, at the same lambda and noise."""
    record = Record(values - np.array(found.offsets), dt, tuple(model.sensors))
    scale = float(joined.posed(record, model, {"penalty": penalty}, found, "rest").path.scale)
    family = Deconvolution(model, penalty=Penalty(penalty, variance="constant"), noise=Noise(np.array(found.noise)),
                           choice=Lambda(found.lam / scale, path="statespace"))  # fmt: skip
    return family.estimate(record).load


CASES = {
    "hits": lambda: (system(), hits(), "identity"),
    "gaps": lambda: (system(), hits(0.02), "identity"),
    "difference": lambda: (system(), hits(), "first_difference"),
    "accelerometer and strain": lambda: (
        m := beam(sensors.Accelerometer, sensors.Displacement), beam_record(m, 2e-4), "first_difference"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_pieces_are_the_whole(case: str) -> None:
    model, values, penalty = CASES[case]()
    dt = getattr(model, "dt", None) or 2e-4
    job = {**JOB, "penalty": penalty}
    found, _ = joined.settle(Record(values, dt, tuple(model.sensors)), model, job, PIECE)
    assert found.overlap < SAMPLES
    load, std, rest = in_pieces(values, dt, model, job, found)
    one = joined.solved(values, dt, model, job, found, 0, SAMPLES)
    size = np.abs(one[0]).max()
    assert np.abs(load - one[0]).max() <= 1e-10 * size
    assert np.abs(std / one[1] - 1).max() <= 1e-10
    assert np.abs(rest - one[2]).max() <= 1e-10 * np.nanmax(np.abs(values))
    public = whole(values, dt, model, found, penalty)
    assert np.abs(load - public).max() <= 1e-8 * size


def test_too_short_an_overlap_shows() -> None:
    model, values = system(), hits()
    found, _ = joined.settle(Record(values, model.dt, tuple(model.sensors)), model, JOB, PIECE)
    load, _, _ = in_pieces(values, model.dt, model, JOB, replace(found, overlap=found.overlap // 4))
    one, _, _ = joined.solved(values, model.dt, model, JOB, found, 0, SAMPLES)
    assert np.abs(load - one).max() > 1e-6 * np.abs(one).max()


def test_offsets_are_those_of_the_whole_record() -> None:
    model = beam(sensors.Accelerometer, sensors.Accelerometer)
    values = beam_record(model, 2e-4)
    shift = np.array([0.0, 2.0]) * values.std(axis=0)
    found, _ = joined.settle(Record(values + shift, 2e-4, tuple(model.sensors)), model, JOB, PIECE)
    assert found.offsets[1] == pytest.approx(shift[1], rel=0.05)


@pytest.mark.parametrize(
    "job",
    [{"family": "sparse"}, {"penalty": "none"}, {"method": "tsvd"}, {"nonnegative": True}, {"path": "toeplitz"},
     {"variance": "local"}],
)  # fmt: skip
def test_what_is_not_cut(job: dict) -> None:
    assert not joined.divisible(system(), {"family": "deconvolution", **job}, system().dt)
    assert joined.divisible(system(), {"family": "deconvolution"}, system().dt)


def test_what_never_forgets_is_not_cut() -> None:
    free = beams.free(length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel,
                      elements=20, damping=damping.Modal(0.02))  # fmt: skip
    model = ForwardModel(free, sensors=[sensors.Accelerometer(at=0.2, direction="Z")],
                         loads=[loads.Point(at=0.65, direction="Z")], modes=4)  # fmt: skip
    values = beam_record(model, 2e-4)
    found, _ = joined.settle(Record(values, 2e-4, tuple(model.sensors)), model, JOB, PIECE)
    assert found.overlap > SAMPLES


def test_the_loudest_piece() -> None:
    values = np.ones((100, 2)) * [1.0, 1e-6]
    values[45:50, 1] = 1e-4
    assert joined.loudest(values, 20) == (40, 60)
    assert joined.loudest(values[:15], 20) == (0, 15)


def test_overlaps_count_samples_with_data() -> None:
    values = np.zeros((100, 1))
    values[[38, 62, 63]] = np.nan
    assert joined.around(values, 40, 60, 10) == (29, 72)
    assert joined.around(values, 5, 98, 10) == (0, 100)
