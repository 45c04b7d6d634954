"""The resultant of a contact that only presses, or stays in its friction cone, beside draws from what is posed.

Tractions at the nodes of the contact have a normal law, from dense matrices, cut to the cone. It is sampled one
component after another (S. Geman & D. Geman, IEEE Trans. Pattern Anal. 6 (1984) 721; truncated normal laws: C. P.
Robert, Statistics and Computing 5 (1995) 121), many chains side by side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from tactile._sensors.discs import EVEN, OWN
from tactile._sensors.evidence import Fitted

from .test_local import NOISE, fit, pressed

CHAINS, SWEEPS, BEFORE = 48, 80, 30
FAR = 1e9
FLOOR = 1e-4  # of the variance, that a node has of its own

Array = np.ndarray


def cut(rng: np.random.Generator, low: Array, high: Array, mean: Array, std: float) -> Array:
    """Draws from normal laws within two ends."""
    a, b = ndtr((low - mean) / std), ndtr((high - mean) / std)
    inside = np.clip(a + (b - a) * rng.random(mean.shape), 1e-300, 1 - 1e-16)
    return np.clip(mean + std * ndtri(inside), low, high)


def sampled(precision: Array, mean: Array, friction: float | None, start: Array) -> Array:
    """Draws (sweeps, 3 k, chains) of tractions of a precision and mean, pressures below zero, shears in their cone."""
    rng, t = np.random.default_rng(0), np.tile(start[:, None], (1, CHAINS))
    pull, out = precision @ (t - mean[:, None]), []
    for _ in range(SWEEPS):
        for i in range(len(t)):
            node, axis = divmod(i, 3)
            x, y, z = t[3 * node : 3 * node + 3]
            middle, std = t[i] - pull[i] / precision[i, i], 1 / np.sqrt(precision[i, i])
            if axis == 2:
                least = np.zeros(CHAINS) if friction is None else -np.hypot(x, y) / friction
                new = cut(rng, np.full(CHAINS, -FAR), least, middle, std)
            else:
                most = FAR if friction is None else np.sqrt(np.maximum((friction * z) ** 2 - (x, y)[1 - axis] ** 2, 0))
                new = cut(rng, -most * np.ones(CHAINS), most * np.ones(CHAINS), middle, std)
            pull += precision[:, i, None] * (new - t[i])
            t[i] = new
        out.append(t.copy())
    return np.array(out)


def posed(best: Fitted, z: Array) -> tuple[Array, Array, Array]:
    """Loads (3 k,) of some contacts, and the precision and mean of these of readings z, by dense matrices."""
    f = fit()
    P, n = f.problem, f.problem.H.shape[1]
    C, inside, noise = np.zeros((n, n)), np.zeros(n // 3, bool), np.eye(len(z)) + f.moved @ f.moved.T
    mesh = [e.change * (e.weight / P.noise[:, None]) for e in P.errors() if e.of_mesh]
    for disc, (size, u, v) in zip(best.discs, best.at, strict=True):
        w = f.inside(disc)
        inside |= w > 0
        T = np.exp(2 * size) * (np.outer((u, v, 1), (u, v, 1)) + OWN**2 * np.diag([1, 1, 0]))
        pressure = w[:, None] * (P.prior.matrix + EVEN) * w
        C += np.kron(pressure + FLOOR * np.diag(w > 0), T)
        noise += sum(E @ np.kron(pressure, T) @ E.T for E in mesh)
    loads = (3 * np.flatnonzero(inside)[:, None] + np.arange(3)).ravel()
    H = P.whitened[:, loads]
    precision = H.T @ np.linalg.solve(noise, H) + np.linalg.inv(C[np.ix_(loads, loads)])
    precision = (precision + precision.T) / 2
    return loads, precision, np.linalg.solve(precision, H.T @ np.linalg.solve(noise, z))


def test_the_sampler_knows_a_half_normal_law() -> None:
    found = sampled(np.eye(3), np.zeros(3), None, -np.ones(3))[BEFORE:]
    assert np.isclose(found[:, 2].mean(), -np.sqrt(2 / np.pi), atol=0.05)
    assert np.isclose(found[:, 2].std(), np.sqrt(1 - 2 / np.pi), atol=0.04)
    assert np.allclose(found[:, :2].std(axis=(0, 2)), 1.0, atol=0.06)
    # a cone of half the space in one plane: the mean of a pressure with |x| < p is that of a quarter of a plane
    cone = sampled(np.diag([1.0, 1e8, 1.0]), np.zeros(3), 1.0, np.array([0.0, 0.0, -1.0]))[BEFORE:]
    assert np.isclose(cone[:, 2].mean(), -2 / np.sqrt(np.pi), atol=0.05)


@pytest.mark.parametrize("friction", [None, 0.8])
def test_the_force_of_a_contact_that_only_presses_is_that_of_draws(friction: float | None) -> None:
    f, (y, true) = fit(), pressed()
    z = y.ravel() / NOISE
    local = f(z)
    assert local is not None
    loads, precision, mean = posed(local.best, z / local.wide)
    one = f.within_cone(z, replace(local, likely=((1.0, local.best),)), friction)
    assert np.all(np.flatnonzero(one.load.reshape(-1, 3).any(axis=1)) * 3 == loads[::3])  # the same nodes
    start = one.load[loads].reshape(-1, 3) / local.wide
    start[:, 2] -= 1e-3 * np.abs(start).max()
    draws = local.wide * (f.problem.resultant[:3, loads] @ sampled(precision, mean, friction, start.ravel())[BEFORE:])
    middle, spread = draws.mean(axis=(0, 2)), draws.std(axis=(0, 2))
    force, std = (f.problem.resultant @ one.load)[:3], np.sqrt(np.diag(one.wrench))[:3]
    print(f"friction {friction}: {force} +- {std}, draws {middle} +- {spread}, true {true}")
    assert np.all(np.abs(force - middle) < 1.3 * spread)  # the likeliest beside the mean, of what is cut on one side
    assert np.all(std > 0.9 * spread)
    assert std[2] < 2 * spread[2]
    inside = np.abs(draws - force[:, None]) <= 1.96 * std[:, None]
    assert np.all(inside.mean(axis=(0, 2)) > 0.88)
    assert np.all(np.abs(force - true) <= 1.96 * std)
