"""Projections on friction cones and pyramids against least squares on their edges."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from loadid import constraints as cones


def points(count: int, dim: int = 3, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, dim))


def projected(v: np.ndarray, mu: float, K: int = 0) -> np.ndarray:
    k = len(v)
    face = cones.faces(v, np.full(k, mu), np.full(k, K))
    return cones.project(v, face)


def on_edges(v: np.ndarray, mu: float, K: int) -> np.ndarray:
    angle = 2 * np.pi * (np.arange(K) + 0.5) / K
    reach = mu / np.cos(np.pi / K)
    edges = np.stack([reach * np.cos(angle), reach * np.sin(angle), np.ones(K)])
    return np.array([edges @ nnls(edges, x)[0] for x in v])


@pytest.mark.parametrize("K", [3, 4, 5, 8])
def test_projection_on_a_pyramid_is_the_nearest_sum_of_its_edges(K: int) -> None:
    v = points(200)
    np.testing.assert_allclose(projected(v, 0.7, K), on_edges(v, 0.7, K), atol=1e-12)


@given(st.floats(0.05, 2.0), st.integers(0, 1000))
@settings(max_examples=40, deadline=None)
def test_projection_on_the_round_cone_meets_moreau(mu: float, seed: int) -> None:
    """v = P(v) + N with N in the polar cone, at right angles: the property that only the projection has."""
    v = points(30, seed=seed)
    P = projected(v, mu)
    N = v - P
    assert cones.excess(P, np.full(30, mu), np.zeros(30, int)).max() < 1e-14
    np.testing.assert_allclose(np.sum(P * N, axis=1), 0, atol=1e-13)
    assert np.all(mu * np.linalg.norm(N[:, :2], axis=1) <= -N[:, 2] + 1e-13)


@pytest.mark.parametrize(("dim", "K"), [(2, 0), (3, 0), (3, 6)])
def test_the_derivative_is_that_of_the_projection(dim: int, K: int) -> None:
    v, d = points(100, dim), 1e-7 * points(100, dim, 1)
    mu, facets = np.full(100, 0.5), np.full(100, K)
    face = cones.faces(v, mu, facets)
    moved = cones.project(v + d, cones.faces(v + d, mu, facets)) - cones.project(v, face)
    np.testing.assert_allclose(moved, cones.project(d, face), atol=2e-12)


def test_without_friction_only_the_push_is_left() -> None:
    np.testing.assert_allclose(projected(np.array([[1.0, 2, 3], [1, 2, -3], [0, 0, 2]]), 0.0),
                               [[0, 0, 3], [0, 0, 0], [0, 0, 2]], atol=1e-15)  # fmt: skip


def test_frames_end_in_the_normal() -> None:
    N = points(20)
    N /= np.linalg.norm(N, axis=1)[:, None]
    N = np.vstack([N, [0, 0, 1]])
    Q = cones.frames(N)
    np.testing.assert_allclose(Q[:, :, -1], N, atol=1e-14)
    np.testing.assert_allclose(Q @ Q.transpose(0, 2, 1), np.broadcast_to(np.eye(3), Q.shape), atol=1e-14)


def test_excess_of_points_outside() -> None:
    h = np.array([[3.0, 4, 2], [0, 0, -1], [0.1, 0, 1]])
    np.testing.assert_allclose(cones.excess(h, np.full(3, 0.5), np.zeros(3, int)), [4, 1, 0])
    square = cones.excess(h, np.full(3, 0.5), np.full(3, 4))
    np.testing.assert_allclose(square, [4 - 1, 1, 0])
