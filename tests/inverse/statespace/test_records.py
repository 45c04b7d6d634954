"""One-sample loads, units, sums and bands of records over a state space."""

import numpy as np
import pytest

from loadid._inverse.gaussian.coarse import COUNT, LENGTH, windows_of
from loadid._inverse.gaussian.gains import gains
from loadid._inverse.gaussian.passes import solve
from structures import StateSpace

from .cases import PENALTIES, Case, beam, case, off
from .dense import Dense, problem


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("kind", ["d", "v", "a", "s"])
def test_a_one_sample_load_is_found_where_it_is(kind: str, hold: str) -> None:
    """At the first sample and in the middle; late, with little or nothing of its response left, as the dense one."""
    system, samples, lam = beam(kind, hold, 1), 60, 1e-6
    for at in (0, samples // 2, samples - 2, samples - 1):
        load = np.zeros((samples, 1))
        load[at] = 1.0
        y = system.simulate(load)
        if not y.any():  # no feedthrough: the last load is not seen at all
            continue
        record = Case(system, y, np.array([np.abs(y).max()]), load)
        path = record.path("identity")
        found = path.solution(lam, None).load
        assert off(found, record.dense("identity").at(lam * float(path.scale)).load) < 1e-8
        if at < samples - 2:
            assert int(np.argmax(found)) == at
            assert abs(found[at, 0] - 1) < 1e-2


@pytest.mark.parametrize("penalty", ["identity", "second"])
@pytest.mark.parametrize(("model", "data"), [(1e6, 1.0), (1e-6, 1.0), (1e6, 1e6), (1.0, 1e-6)])
def test_units_change_nothing(penalty: str, model: float, data: float) -> None:
    """Load in other units (model), readings in other units (model and noise and data)."""
    plain, (name, options) = case(beam("da"), 300), PENALTIES[penalty]
    s = plain.system
    other = StateSpace(s.A, s.B * model, s.C * data, s.D * model * data, s.dt)
    scaled = Case(other, plain.y * data, plain.noise * data, plain.load)
    path, same = scaled.path(name, **options), plain.path(name, **options)
    a, b = path.solution(1e-3, 1.0), same.solution(1e-3, 1.0)
    assert off(a.load * model, b.load) < 1e-9
    assert off(a.posterior.std * model, b.posterior.std) < 1e-9
    assert off(path.at(np.geomspace(1e-4, 1, 5)).edf, same.at(np.geomspace(1e-4, 1, 5)).edf) < 1e-9


def test_solutions_add_up() -> None:
    """Of two records with one operator; the mean of the data has the mean of the loads."""
    one = case(beam("dsa"), 500)
    y = np.random.default_rng(3).standard_normal(one.y.shape) * one.noise
    parts = [one.path("first_difference", y=d).solution(1e-2, None).load for d in (one.y, y, 2 * one.y - 3 * y)]
    assert off(2 * parts[0] - 3 * parts[1], parts[2]) < 1e-11


def test_windows_are_the_weighted_sum_of_their_dense_problems() -> None:
    record = case(beam("ds", "foh", 1), LENGTH * COUNT)
    path = record.path("identity")
    windows, lam = windows_of(path), 1e-2
    assert windows is not None
    assert list(windows.weights) == [1, 1, 2, 2]
    dense: Dense = problem(record.system, record.y[:LENGTH], record.noise, "identity", unknown_start=True)
    at = dense.at(lam * float(path.scale))
    point, residual2, penalty2 = windows.exact(lam), 0.0, 0.0
    for weight, y in zip(windows.weights, windows.windows, strict=True):
        one = Dense(dense.H, y.reshape(-1), dense.L, dense.shape).at(at.lam)
        residual2 += weight * float(np.sum(one.residual**2))
        penalty2 += weight * float(np.sum((dense.L @ one.whole) ** 2))
    assert off(point.residual2, residual2) < 1e-9
    assert off(point.penalty2, penalty2) < 1e-9
    assert off(point.edf, COUNT * np.trace(at.influence)) < 1e-9
    assert off(point.left, COUNT * np.trace(np.eye(len(dense.y)) - at.influence)) < 1e-9
    assert windows.m == COUNT * len(dense.y)
    assert windows_of(case(beam("ds", "foh", 1), LENGTH * COUNT - 1).path("identity")) is None


@pytest.mark.parametrize("penalty", ["identity", "first from zero"])
def test_the_band_holds_its_share_of_loads_from_the_prior(penalty: str) -> None:
    """500 records with white loads, and with random walks, at the lambda of that prior."""
    (name, options), samples, draws = PENALTIES[penalty], 100, 500
    system, rng = beam("da", "foh", 1), np.random.default_rng(7)
    load = rng.standard_normal((samples, draws))
    if name != "identity":
        load = np.cumsum(load, axis=0)
    clean = np.array([system.simulate(g[:, None]) for g in load.T[:20]])
    sigma = 0.05 * clean.std(axis=(0, 1))
    # the posterior belongs to the operator: one path, and its solution for the data of every draw
    path = Case(system, clean[0], sigma, load).path(name, **options)
    lam = 1.0 / float(path.scale)  # noise and increments of unit level
    std = path.solution(lam, 1.0).posterior.std
    inside, held = 0, gains(path.record, 1.0)
    for g in load.T:
        y = path.response(g[:, None]) + rng.standard_normal(clean[0].shape)
        found = solve(path.record, held, y).load
        inside += int(np.sum(np.abs(found[:, 0] - g) <= 1.959964 * std[:, 0]))
    assert 0.94 < inside / load.size < 0.96
