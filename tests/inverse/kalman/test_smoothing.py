"""Smoothers: against conditioning of everything at once, each other, and the batch Tikhonov of the same prior."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._inverse.gaussian import records
from loadid._inverse.gaussian.model import FilterModel
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import augment, record
from loadid._inverse.gaussian.records import smooth_record
from loadid._inverse.gaussian.steady import steady

from .gaussian import building, conditioned, drawn, rts, small

R_SD = np.array([0.3, 0.3, 0.5, 1e-3])


@pytest.mark.parametrize("correlated", [False, True])
def test_smoother_is_the_conditional_gaussian(correlated: bool) -> None:
    for seed in range(3):
        model = small(seed, correlated=correlated)
        Y, _ = drawn(model, 8, seed)
        Y[0, 1] = Y[2, :2] = Y[3] = Y[7, 2] = np.nan
        found = smooth_record(records.filter_record(model, Y))
        for k in range(8):
            mean, P = conditioned(model, Y, 8, k)
            assert np.allclose(found.load[k], model.Cp @ mean, rtol=0, atol=1e-9)
            assert np.allclose(found.residual[k], Y[k] - model.H @ mean, rtol=0, atol=1e-9, equal_nan=True)
            assert np.allclose(found.std[k] ** 2, np.diag(model.Cp @ P @ model.Cp.T), rtol=1e-8, atol=1e-9)


def test_two_smoothers_agree_on_a_building_with_gaps() -> None:
    for model in (building().walk(400.0, R_SD), building().matern(100.0, 0.08, 0.01, R_SD)):
        Y, P = drawn(model, 300)
        Y[100:120, 3] = Y[150:153] = np.nan
        filtered = records.filter_record(model, Y)
        (_, load, std), own = rts(filtered), smooth_record(filtered)
        assert np.max(np.abs(own.load - load)) < 1e-9 * np.std(P)
        assert np.max(np.abs(own.std / std - 1)) < 1e-9
        assert np.all(own.std <= filtered.std * (1 + 1e-9))
        assert np.mean((own.load - P) ** 2) < np.mean((filtered.load - P) ** 2)


def test_states_known_exactly_are_smoothed_all_the_same() -> None:
    """At rest for certain, no model noise: the predicted covariance is singular, and a hair of noise the judge."""
    model = building().walk(400.0, R_SD, states=0.0, start=0.0)
    Y, P = drawn(model, 200)
    filtered = records.filter_record(model, Y)
    with pytest.raises(np.linalg.LinAlgError):
        rts(filtered)
    found = smooth_record(filtered)
    near = building().walk(400.0, R_SD, states=1e-18, start=1e-18)
    other = smooth_record(records.filter_record(near, Y))
    assert np.max(np.abs(found.load - other.load)) < 1e-5 * np.std(P)
    assert np.allclose(found.std, other.std, rtol=1e-4)


@pytest.mark.parametrize("gaps", [False, True])
def test_random_walk_is_tikhonov_with_first_difference(gaps: bool) -> None:
    house, q = building(storeys=4, acc=(1, 3), disp=(3,)), 400.0
    R = np.array([0.3, 0.5, 1e-3])
    model = house.walk(q, R, states=0.0, start=0.0, load=q)  # the first difference counts from zero too
    Y, _ = drawn(house.walk(q, R), 250)
    if gaps:
        Y[60:80, 2] = Y[100:103] = np.nan
    filtered = records.filter_record(model, Y)
    system = augment(house.A, house.B, house.G / R[:, None], house.J / R[:, None], "first_difference", from_zero=True)
    missing = np.isnan(Y)
    path = StateSpacePath(record(system, np.where(missing, 0.0, Y / R), missing if gaps else None))
    batch = path.solution(1 / np.sqrt(q) / float(path.scale), 1.0)
    found = smooth_record(filtered)
    assert np.max(np.abs(found.load - batch.load)) < 1e-9 * np.max(np.abs(batch.load))
    assert np.allclose(found.std, batch.posterior.std.reshape(found.std.shape), rtol=1e-7)


def test_a_free_start_is_a_wide_one() -> None:
    house, R = building(storeys=4, acc=(1, 3), disp=(3,)), np.array([0.3, 0.5, 1e-3])
    Y, _ = drawn(house.walk(400.0, R), 200)
    system = augment(house.A, house.B, house.G / R[:, None], house.J / R[:, None], "first_difference")
    path = StateSpacePath(record(system, Y / R))
    batch = path.solution(1 / 20.0 / float(path.scale), None).load
    wide = smooth_record(records.filter_record(house.walk(400.0, R, states=0.0, start=0.0, load=1e14), Y))
    assert np.max(np.abs(wide.load - batch)) < 1e-7 * np.max(np.abs(batch))


@pytest.mark.parametrize("model", [building().matern(100.0, 0.08, 0.01, R_SD), small(1, correlated=True)])
def test_a_settling_record_has_the_same_numbers(model: FilterModel) -> None:
    Y, P = drawn(model, 1600)
    Y[900:903, 1] = Y[1000] = Y[1599, 2] = np.nan
    full = records.filter_record(model, Y)
    fast = records.filter_record(model, Y, steady(model))
    assert sum(part.count for part in fast.stretches if part.e is not None) > 500
    found, scale = fast, np.std(P)
    assert np.allclose(records.log_density(model, Y, steady(model)), full.loglik, rtol=1e-7, atol=1e-7)
    few = np.where(np.random.default_rng(0).random(Y.shape) < 0.4, np.nan, Y)
    walked = records.filter_record(model, few).loglik
    assert np.allclose(records.log_density(model, few, steady(model)), walked, rtol=1e-9, atol=1e-9)
    for name in ("std", "nis", "loglik", "normalised"):
        assert np.allclose(getattr(found, name), getattr(full, name), rtol=1e-7, atol=1e-7, equal_nan=True), name
    assert np.max(np.abs(found.load - full.load)) < 1e-9 * scale
    assert np.allclose(found.last.x, full.last.x, rtol=0, atol=1e-9 * np.max(np.abs(full.last.x)))
    (states, load, std), late = rts(full), smooth_record(fast)
    assert np.max(np.abs(late.load - load)) < 1e-9 * scale
    assert np.allclose(late.std, std, rtol=1e-8)
    sd = np.linalg.norm(model.LR, axis=1)
    assert np.allclose(late.residual / sd, (Y - states @ model.H.T) / sd, rtol=0, atol=1e-7, equal_nan=True)


def test_a_smoother_tells_how_far_it_is() -> None:
    model, said = small(), list[float]()
    smooth_record(records.filter_record(model, np.zeros((5, 3))), progress=lambda share, text: said.append(share))
    assert said[-1] == 1.0
