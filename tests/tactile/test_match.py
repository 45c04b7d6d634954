"""Mutual nearest neighbours against brute force; medians over neighbours against numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from structures.errors import InputError
from tactile.vision import match
from tactile.vision._tracker import Dots, Neighbourhood

from .scenes import PITCH, pattern, pressed


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 40), st.integers(0, 40), st.floats(0.05, 2.0))
def test_matches_are_mutual_nearest_neighbours_within_the_gate(seed: int, n: int, k: int, gate: float) -> None:
    rng = np.random.default_rng(seed)
    expected, found = rng.uniform(0, 5, (n, 2)), rng.uniform(0, 5, (k, 2))
    expected[rng.random(n) < 0.1] = np.nan
    distance = np.hypot(*np.moveaxis(expected[:, None] - found[None], -1, 0))
    distance[np.isnan(distance)] = np.inf
    index = match(expected, found, gate=gate)
    for i in range(n):
        best = int(np.argmin(distance[i])) if k else -1
        good = k > 0 and distance[i, best] <= gate and int(np.argmin(distance[:, best])) == i
        assert index[i] == (best if good else -1)


def test_an_offer_goes_to_the_nearest_that_asks() -> None:
    dots = Dots(np.array([[0.0, 0.0], [10.0, 0.0]]))
    offers = dots.offers(np.array([[1.0, 0.0], [2.0, 0.0], [9.5, 0.5], [30.0, 0.0]]), 5.0)
    np.testing.assert_allclose(offers, [[-1, 0], [np.nan] * 2, [0.5, -0.5], [np.nan] * 2])


def test_the_median_over_neighbours_is_that_of_numpy() -> None:
    points, rng = pattern(), np.random.default_rng(0)
    around = Neighbourhood(points)
    values = rng.standard_normal(points.shape)
    values[rng.random(len(points)) < 0.3] = np.nan
    nearest = np.argsort(np.hypot(*np.moveaxis(points[:, None] - points[None], -1, 0)), axis=1)[:, 1:9]
    chosen = values[nearest]
    enough = np.isfinite(chosen[..., 0]).sum(axis=1) >= 3
    assert enough.mean() > 0.9
    np.testing.assert_allclose(around.median(values)[enough], np.nanmedian(chosen[enough], axis=1), atol=1e-15)
    assert around.pitch == pytest.approx(PITCH, rel=0.06)


def test_a_smooth_motion_is_close_to_the_median_of_its_neighbours() -> None:
    points = pattern()
    moved = pressed(points, 6.0, 5.0) - points
    deviation = np.hypot(*(Neighbourhood(points).median(moved) - moved).T)
    assert deviation.max() < 0.25 * PITCH
    moved[200] += 0.6 * PITCH
    assert np.argmax(np.hypot(*(Neighbourhood(points).median(moved) - moved).T)) == 200


def test_what_is_no_set_of_points() -> None:
    with pytest.raises(InputError, match="no points of a plane"):
        match(np.zeros((3, 3)), np.zeros((3, 2)), gate=1.0)
    with pytest.raises(InputError, match="positive"):
        match(np.zeros((3, 2)), np.zeros((3, 2)), gate=0.0)
    assert (match(np.zeros((3, 2)), [], gate=1.0) == -1).all()
