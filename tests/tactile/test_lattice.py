"""Loads on a lattice: what they are, and that the motion of an image beside them is that of dense algebra."""

from __future__ import annotations

import numpy as np

from tactile import Markers, MultilayerPad
from tactile._sensors.image import FREE, MODES, ImageFit
from tactile._sensors.lattice import NEAR, PITCH, Lattice

from .rigs import markers, pad

THICK = 3e-3


def test_hats_are_linear_between_their_points() -> None:
    places = np.random.default_rng(0).uniform(-8e-3, 8e-3, (300, 2))
    lattice = Lattice.over(places, THICK)
    hats = lattice.hats.toarray()
    assert np.allclose(hats.sum(axis=1), 1)
    assert (hats >= 0).all()
    points = np.linalg.lstsq(hats, places, rcond=None)[0]  # a linear function is met exactly
    assert np.allclose(hats @ points, places, atol=1e-12)


def test_near_a_node_are_the_hats_about_its_square() -> None:
    x = np.arange(0, 9.1e-3, 0.25e-3)
    places = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    lattice = Lattice.over(places, THICK)
    (node,) = np.flatnonzero(np.all(np.isclose(places, 4.0e-3), axis=1))
    near = lattice.near[lattice.block[node]]
    felt = places[lattice.hats[:, near].sum(axis=1) > 0]
    reach = np.abs(felt - 4.0e-3).max()
    assert PITCH * THICK < reach <= (NEAR + 2 * PITCH) * THICK + 1e-12


def test_the_motion_beside_loads_is_that_of_their_covariance() -> None:
    """By the dense covariance of the readings, which no code of the sensor forms."""
    pad_sensor = MultilayerPad(pad(), Markers(markers(), 2e-6), choice=0.05)
    fit = pad_sensor._quick_map(True).image
    assert isinstance(fit, ImageFit)
    near = np.flatnonzero(fit._lattice.near[fit._lattice.block[pad().points // 2]])
    assert 0 < len(near) < MODES
    found = fit._fitted(near)
    problem, hats = fit.problem, fit._lattice.hats.toarray()
    mean = hats / hats.sum(axis=0)
    C = (mean.T @ problem.prior.matrix @ mean)[np.ix_(near, near)]
    C *= (FREE / (fit.inverse.lam * fit.inverse.scale)) ** 2
    S = np.eye(len(problem.noise))
    for rows in (problem.whitened, *(e.change * e.weight / problem.noise[:, None] for e in problem.errors())):
        for axis, share in enumerate(problem.prior.share):
            made = rows[:, axis::3] @ hats[:, near]
            S += share * made @ C @ made.T
    M = fit.moved * fit.motion.std
    rows = fit.motion.std[:, None] * np.linalg.solve(S + M @ M.T, M).T
    left = np.diag(fit.motion.std**2) - rows @ (fit.moved * fit.motion.std**2)
    assert np.allclose(found.rows, rows, atol=1e-6 * np.abs(rows).max())
    assert np.allclose(found.covariance, left, atol=1e-6 * np.abs(left).max())
