"""Records that start in motion: cut from the middle of a longer one, of a finer mesh and step, or at rest as before."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, priors
from loadid._families.tracking.beginning import moving
from loadid.settings import Noise, Priors
from structures import ForwardModel, beams, damping, loads, sensors
from tests.tracked import bm2

MATERN, SECOND = priors.Matern32(100.0, 0.08), 50
N532 = "LID-N532"


@cache
def tracked(seed: int, cut: int):
    """A tracker fitted to 400 samples of a building under wind, the record and its load."""
    c = bm2("matern", seed, samples=900)
    part = slice(cut, cut + 400)
    return (
        LoadTracker(c.setup.space(), prior=MATERN, noise=Noise(c.noise)).fit(c.y[part], c.dt),
        c.y[part],
        c.load[part],
    )


@pytest.mark.parametrize("how", ["smooth", "track"])
def test_the_band_of_the_first_samples_holds_the_load(how):
    errors, inside, later = [], [], []
    for seed in range(3):
        tracker, y, load = tracked(seed, 400)
        tracker.reset()
        found = getattr(tracker, how)(y)
        assert N532 in [f.code for f in found.flags]
        off = np.abs(found.load - load)
        inside.append(np.mean(off[:SECOND] < 1.96 * found.std[:SECOND]))
        later.append(np.mean(off[SECOND:] < 1.96 * found.std[SECOND:]))
        errors.append(np.sqrt(np.mean(off[:SECOND] ** 2)) / 100)
    assert np.mean(inside) >= 0.90
    assert abs(np.mean(inside) - np.mean(later)) < 0.05
    assert np.median(errors) < (0.05 if how == "smooth" else 0.4)


def test_a_record_at_rest_keeps_its_numbers():
    for seed in range(2):
        tracker, y, _ = tracked(seed, 0)
        tracker.reset()
        once = tracker.track(y)
        tracker.reset()
        rows = np.array([tracker.step(row) for row in y])
        np.testing.assert_array_equal(once.load, rows[:, 0])
        assert N532 not in [f.code for f in (*once.flags, *tracker.smooth(y).flags)]


@pytest.mark.parametrize("pieces", [[1] * 400, [2, 1, 97, 300], [3, 397]], ids=["rows", "blocks", "two blocks"])
def test_samples_one_by_one_begin_as_a_record_does(pieces):
    """Whatever the blocks: after five samples state and answers are those of one block, and N532 is told."""
    for seed in range(3):
        tracker, y, load = tracked(seed, 400)
        tracker.reset()
        once = tracker.track(y)
        tracker.reset()
        found, start = [], 0
        for count in pieces:
            part = y[start : start + count]
            found.append(tracker.step(part[0])[0][None] if count == 1 else tracker.run(part)[0])
            start += count
        found = np.vstack(found)
        assert N532 in [f.code for f in tracker.alarms]
        np.testing.assert_array_equal(found[5:], once.load[5:])
        assert tracker.counts["samples"] == 400
        first = [np.sqrt(np.mean((part - load)[:5] ** 2)) for part in (found, once.load)]
        assert first[0] < 1.2 * first[1]


def test_a_tracker_saved_within_its_first_samples_goes_on(tmp_path):
    tracker, y, _ = tracked(0, 400)
    tracker.reset()
    whole = np.array([tracker.step(row)[0] for row in y[:40]])
    tracker.reset()
    for row in y[:2]:
        tracker.step(row)
    tracker.save(tmp_path / "t.h5")
    again = type(tracker).load(tmp_path / "t.h5")
    np.testing.assert_array_equal(np.array([again.step(row)[0] for row in y[2:40]]), whole[2:])


def test_a_start_that_is_stated_is_kept():
    c = bm2("matern", 0, samples=900)
    y = c.y[400:800]
    tracker = LoadTracker(c.setup.space(), prior=Priors(MATERN, start=1.0), noise=Noise(c.noise)).fit(y, c.dt)
    assert N532 not in [f.code for f in tracker.smooth(y).flags]


def test_the_start_is_that_of_a_simulation(tmp_path):
    """Covariance of the states after a long time, and what a file of the tracker says of it."""
    tracker, y, _ = tracked(0, 400)
    model = tracker.fitted.model
    P = model.L0 @ model.L0.T
    for _ in range(4096):
        P = model.F @ P @ model.F.T + model.LQ @ model.LQ.T
    root = moving(model, 1.0)
    np.testing.assert_allclose(root @ root.T, P, rtol=1e-6, atol=1e-9 * np.abs(P).max())
    tracker.reset()
    tracker.track(y[:200])
    tracker.save(tmp_path / "t.h5")
    again = type(tracker).load(tmp_path / "t.h5")
    assert N532 in [f.code for f in again.track(y[200:]).flags]


def test_a_beam_on_a_finer_mesh():
    def beam(elements: int, modes: int) -> ForwardModel:
        structure = beams.beam(
            length=1.2, section=beams.Section.rectangle(0.04, 0.012), material=beams.materials.steel, left="clamped",
            right="free", elements=elements, damping=damping.Modal(0.01),
        )  # fmt: skip
        seen = [sensors.Accelerometer(at=0.9, direction="+Z"), sensors.Displacement(at=0.5, direction="+Z"),
                sensors.Displacement(at=1.1, direction="+Z")]  # fmt: skip
        return ForwardModel(structure, seen, [loads.Point(at=1.0, direction="+Z", label="F")], modes=modes)

    model, dt, fine = beam(30, 4), 1e-3, 10
    for seed in range(2):
        rng = np.random.default_rng(seed)
        t = np.arange(1000 * fine) * dt / fine
        force = sum(rng.normal() * np.sin(2 * np.pi * f * t + rng.uniform(0, 6)) for f in (1.5, 4.0, 7.5, 11.0))
        y = np.asarray(beam(90, 8).predict(force[:, None], dt / fine))[::fine][600:]
        sigma = 0.01 * y.std(axis=0)
        y += sigma * rng.standard_normal(y.shape)
        found = LoadTracker(model, noise=Noise(sigma)).fit(y, dt).smooth(y, dt)
        off, size = (found.load[:, 0] - force[::fine][600:])[:100], np.sqrt(np.mean(force**2))
        assert N532 in [f.code for f in found.flags]
        assert np.sqrt(np.mean(off**2)) < 0.15 * size
        assert np.mean(np.abs(off) < 1.96 * found.std[:100, 0]) > 0.85
