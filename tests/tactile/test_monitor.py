"""Gel monitor: a change of gain told from a change of shape, drift and dates, each with its silent twin."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np
import pytest

from structures._flags import codes
from structures.errors import InputError
from tactile import GelMonitor, Layer, Press
from tactile import _guards as guards
from tactile.material._monitor import tangents

LAYER = Layer(h=3e-3, E=0.147e6, nu=0.45)
PRESSES = [Press(at=(1e-3, 0), radius=r, force=1.0, shear=(0.3, 0.1)) for r in (1e-3, 2.5e-3, 4e-3)]
SIGMA = 5e-6
DAY = datetime(2026, 3, 1, tzinfo=UTC)


def markers() -> np.ndarray:
    x = np.linspace(-9e-3, 9e-3, 15)
    return np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)


POINTS = markers()


@cache
def clean(layer: Layer) -> np.ndarray:
    return np.array([p.displacement(layer, POINTS) for p in PRESSES])


def maps(layer: Layer, seed: int, sigma: float = SIGMA) -> np.ndarray:
    u = clean(layer)
    return u + sigma * np.random.default_rng(seed).standard_normal(u.shape)


MONITOR = GelMonitor(maps(LAYER, 0), noise=SIGMA, calibrated=DAY, rest=POINTS, rest_noise=SIGMA)
SOON = DAY + timedelta(days=2)


def test_nothing_changed_is_silent() -> None:
    rng = np.random.default_rng(9)
    for seed in range(1, 9):
        unloaded = POINTS + SIGMA * rng.standard_normal(POINTS.shape)
        found = MONITOR.check(maps(LAYER, seed), unloaded=unloaded, now=SOON, validated="2026-03-02")
        assert found.verdict == "unchanged"
        assert not found.flags
        assert found.gain == pytest.approx(1, abs=4 * found.gain_std)
        assert abs(found.significance) < 4


def test_a_softer_gel_is_a_gain() -> None:
    softer = replace(LAYER, E=0.8 * LAYER.E)
    found = MONITOR.check(maps(softer, 1), now=SOON)
    assert found.verdict == "gain"
    assert codes(found.flags) == {"W705"}
    assert "recheck E" in found.flags[0].message
    assert found.gain == pytest.approx(1.25, abs=4 * found.gain_std)
    assert found.gain_std < 0.005
    for gain, std in found.gains:  # the same for every press
        assert gain == pytest.approx(1.25, abs=4 * std)


@pytest.mark.parametrize("nu", [0.3223, 0.45, 0.49])
def test_a_worn_gel_is_a_shape(nu: float) -> None:
    """15 % thinner: the correlation stays above .99, and the part that no gain explains tells it."""
    fresh = replace(LAYER, nu=nu)
    worn = replace(fresh, h=0.85 * fresh.h)
    found = GelMonitor(maps(fresh, 0), noise=SIGMA, calibrated=DAY).check(maps(worn, 1), now=SOON)
    assert found.correlation > 0.99
    assert found.verdict == "shape"
    assert codes(found.flags) == {"W705"}
    assert "shape wrong" in found.flags[0].message
    assert found.significance > 20
    assert np.ptp([g for g, _ in found.gains]) > 0.02  # narrow presses feel the thickness less


@pytest.mark.parametrize(
    ("changed", "name", "value"),
    [
        (replace(LAYER, E=0.8 * LAYER.E), "E", 0.8 * LAYER.E),
        (replace(LAYER, h=0.85 * LAYER.h), "thickness", 0.85 * LAYER.h),
        (replace(LAYER, nu=0.42), "nu", 0.42),
    ],
)
def test_the_cause_is_named_with_its_value(changed: Layer, name: str, value: float) -> None:
    best, *others = MONITOR.attribute(maps(changed, 1), LAYER, PRESSES, POINTS)
    assert best.name == name
    assert best.value == pytest.approx(value, abs=4 * best.std)
    assert best.misfit == pytest.approx(1, abs=0.1)
    assert all(other.misfit > 1.5 for other in others)


PLACED = replace(MONITOR, points=POINTS)


@pytest.mark.parametrize("beside", [0.1e-3, 0.15e-3])
def test_a_press_beside_its_place_is_no_worn_gel(beside: float) -> None:
    x = 1e-3 * np.arange(-9, 10)
    points = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    presses = [Press(at=(1e-3, 0), radius=r, force=1.0) for r in (1.5e-3, 2.5e-3, 4e-3)]
    shifts = np.array([[beside, 0], [0, -beside], [-0.5 * beside, 0.5 * beside]])
    rng = np.random.default_rng(0)

    def noisy(pressed: list[Press]) -> np.ndarray:
        u = np.array([p.displacement(LAYER, points) for p in pressed])
        return u + SIGMA * rng.standard_normal(u.shape)

    plain = GelMonitor(noisy(presses), noise=SIGMA, calibrated=DAY)
    now = noisy([replace(p, at=tuple(np.add(p.at, d))) for p, d in zip(presses, shifts, strict=True)])
    found = replace(plain, points=points).check(now, now=SOON)
    assert found.verdict == "unchanged"
    assert np.array(found.shifts) == pytest.approx(shifts, abs=0.15 * beside + 2e-6)
    blind = plain.check(now, now=SOON)
    assert blind.verdict == "shape"
    assert blind.share > 2 * found.share


def test_a_worn_gel_stays_a_shape_where_shifts_are_taken_out() -> None:
    worn = replace(LAYER, h=0.85 * LAYER.h)
    assert PLACED.check(maps(worn, 1), now=SOON).verdict == "shape"
    softer = PLACED.check(maps(replace(LAYER, E=0.8 * LAYER.E), 1), now=SOON)
    assert softer.verdict == "gain"
    assert softer.gain == pytest.approx(1.25, abs=4 * softer.gain_std)


def test_slopes_of_a_quadratic_map_are_exact() -> None:
    x, y = 1e3 * POINTS.T
    maps_ = np.stack([x * x - 2 * x * y, y + 0.5 * y * y], axis=-1)[None]
    found = tangents(POINTS, maps_)[0]
    assert found[:, 0, 0] == pytest.approx(1e3 * (2 * x - 2 * y), abs=1e-5)
    assert found[:, 0, 1] == pytest.approx(1e3 * (-2 * x), abs=1e-6)
    assert found[:, 1, 1] == pytest.approx(1e3 * (1 + y), abs=1e-6)
    with pytest.raises(InputError, match="places do not fit"):
        GelMonitor(MONITOR.reference, noise=SIGMA, points=POINTS[:-1])


def test_noise_of_the_reference_does_not_lower_the_gain() -> None:
    loud = 40e-6
    gains = [
        GelMonitor(maps(LAYER, 100 + s, loud), noise=loud).check(maps(LAYER, 200 + s, loud)).gain for s in range(40)
    ]
    pairs = [(maps(LAYER, 100 + s, loud), maps(LAYER, 200 + s, loud)) for s in range(40)]
    plain = np.mean([np.sum(a * b) / np.sum(a * a) for a, b in pairs])
    assert np.mean(gains) == pytest.approx(1, abs=0.005)
    assert plain < 0.99


def test_a_shape_change_below_the_noise_is_not_claimed() -> None:
    worn = replace(LAYER, h=0.88 * LAYER.h)
    verdicts = [
        GelMonitor(maps(LAYER, 0, s), noise=s, calibrated=DAY).check(maps(worn, 1, s), now=SOON).verdict
        for s in (SIGMA, 60e-6)
    ]
    assert verdicts == ["shape", "unchanged"]


def test_lost_markers_are_left_out() -> None:
    now = maps(LAYER, 1)
    now[:, ::10] = np.nan
    assert MONITOR.check(now, now=SOON).verdict == "unchanged"
    now[1] = np.nan
    with pytest.raises(InputError, match="fewer than three"):
        MONITOR.check(now)


def test_drift_of_the_rest_position_is_seen() -> None:
    found = MONITOR.check(maps(LAYER, 1), unloaded=POINTS + np.array([20e-6, 0]), now=SOON)
    assert codes(found.flags) == {"W607"}
    assert found.offset == pytest.approx(20e-6)
    assert "20 um" in found.flags[0].message


def test_an_old_calibration_and_an_older_validation_are_said() -> None:
    found = MONITOR.check(maps(LAYER, 1), now="2026-04-15")
    assert codes(found.flags) == {"W607"}
    assert "2026-03-01" in found.flags[0].message
    found = MONITOR.check(maps(LAYER, 1), now=SOON, validated="2026-02-01")
    assert codes(found.flags) == {"W706"}
    assert "2026-02-01" in str(found)


def test_units_do_not_matter() -> None:
    a = MONITOR.check(maps(LAYER, 1), now=SOON)
    scaled = GelMonitor(1e6 * MONITOR.reference, noise=1e6 * SIGMA, calibrated=DAY)
    b = scaled.check(1e6 * maps(LAYER, 1), now=SOON)
    assert (b.gain, b.share, b.significance) == pytest.approx((a.gain, a.share, a.significance), rel=1e-9)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"reference": np.zeros(4)}, "no maps"),
        ({"reference": np.full((2, 5, 3), np.nan)}, "no maps"),
        ({"noise": 0.0}, "noise must be positive"),
        ({"calibrated": "last week"}, "no date"),
        ({"rest": np.zeros((4, 5))}, "unloaded markers"),
    ],
)
def test_a_reference_that_is_none_is_refused(change: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        GelMonitor(**({"reference": np.ones((2, 5, 3)), "noise": 1e-6} | change))


def test_maps_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="do not fit"):
        MONITOR.check(maps(LAYER, 1)[:2])
    with pytest.raises(InputError, match="no larger than its noise"):
        GelMonitor(np.full((1, 9, 3), 1e-9), noise=1e-6).check(np.zeros((1, 9, 3)))


def test_notes_on_what_is_completed() -> None:
    flag = guards.completed({"x": "tracked", "y": "tracked", "z": "completed"})
    assert flag is not None
    assert codes([flag]) == {"N606"}
    assert "z completed" in flag.message
    assert guards.completed({"x": "tracked", "y": "tracked", "z": "measured"}) is None
