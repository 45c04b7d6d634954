"""Loads some samples late: innovations, covariances and the smoother of a record that ends there say the same."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from loadid._inverse.gaussian import records
from loadid._inverse.gaussian.lag import LagLine, delayed, fixed_lag, phased, resumed
from loadid._inverse.gaussian.loop import Loop
from loadid._inverse.gaussian.model import FilterModel, FilterState, SquareRoot
from loadid._inverse.gaussian.roots import lower
from loadid._inverse.gaussian.steady import SteadyFilter, periodic, steady
from structures.errors import InputError

from .gaussian import building, conditioned, drawn, small


def away() -> FilterModel:
    """No sensor at the load."""
    return building(acc=(2, 5), disp=(7,)).matern(100.0, 0.08, 0.01, np.array([0.3, 0.3, 1e-3]))


def settled(model: FilterModel, last: SteadyFilter | None = None) -> FilterModel:
    """The model that starts with the covariance on which its filter settles."""
    last = steady(model) if last is None else last
    return dataclasses.replace(model, L0=lower(last.part.F @ last.L, last.part.LQ))


def looped(model: FilterModel, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    loop = Loop(steady(model).rows(), model.p, model.m, model.x0)
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    assert loop.block(Y, load, e) == len(Y)
    return load, e


@pytest.mark.parametrize("model", [settled(away()), settled(small(1, correlated=True))])
def test_late_loads_are_those_of_the_smoother(model: FilterModel) -> None:
    Y, P = drawn(model, 400)
    load, e = looped(model, Y)
    late, std = fixed_lag(steady(model), 20).apply(load, e)
    for end in (200, 380):  # the last samples of a record that ends there
        whole = records.smooth_record(records.filter_record(model, Y[: end + 1]))
        line = fixed_lag(steady(model), 20).apply(load[: end + 1], e[: end + 1])
        assert np.max(np.abs(whole.load - line[0])[-20:]) < 1e-9 * np.std(P)
        assert np.allclose(whole.std[-21:], line[1][-21:], rtol=1e-9)
        assert np.allclose(whole.load[end - 20], late[end - 20], rtol=0, atol=1e-9 * np.std(P))
    assert np.allclose(std[:-20], fixed_lag(steady(model), 20).std[20])


def test_band_is_honest_at_every_lag() -> None:
    model = settled(away())
    fixed = fixed_lag(steady(model), 20)
    assert fixed.std[0] > 8 * fixed.std[10]
    enough = fixed.enough()
    assert fixed.std[enough] <= 1.05 * fixed.std[20] < fixed.std[enough - 1]
    inside = {lag: [] for lag in (0, 1, 3, 5, 10, 20)}
    for seed in range(6):
        Y, P = drawn(model, 1500, seed)
        load, e = looped(model, Y)
        for lag, found in inside.items():
            late, std = fixed_lag(steady(model), lag).apply(load, e)
            part = slice(0, 1500 - lag)
            found.append(np.mean(np.abs(late - P)[part] < 1.96 * std[part]))
    for lag, found in inside.items():
        assert 0.93 < np.mean(found) < 0.97, lag


def test_line_and_covariances_say_the_same_and_resume_each_other() -> None:
    model, lag = settled(away()), 12
    Y, P = drawn(model, 300)
    load, e = looped(model, Y)
    fixed = fixed_lag(steady(model), lag)
    late, _ = fixed.apply(load, e)
    line = LagLine(fixed)
    pushed = [line.push(load[k], e[k]) for k in range(300)]
    assert all(value is None for value in pushed[:lag])
    assert np.max(np.abs(np.array(pushed[lag:]) - late[:-lag])) < 1e-12 * np.max(np.abs(late))
    chunks = LagLine(fixed)
    parts = np.split(np.arange(300), [3, 20, 21, 150, 180])
    in_blocks = np.concatenate([chunks.block(load[part], e[part]) for part in parts])
    assert np.max(np.abs(in_blocks - late[:-lag])) < 1e-12 * np.max(np.abs(late))
    assert np.array_equal(chunks.last()[0], load[-lag:])
    assert np.array_equal(chunks.last()[1], line.last()[1])
    # the covariance form from the first sample, and resumed from the steady one
    core = SquareRoot(model)
    state, _ = core.update(core.start(), Y[0])
    slow = delayed(core, state, lag)
    for k in range(1, 200):
        before = state
        state, said = core.advance(before, Y[k])
        slow = slow.advance(core, before, state, said)
    assert np.max(np.abs(slow.load[-1] - late[199 - lag])) < 1e-8 * np.std(P)
    assert np.allclose(slow.std, fixed.std, rtol=1e-9)
    fast = resumed(fixed, load[199 - lag : 200], e[199 - lag : 200])
    assert np.max(np.abs(fast.load - slow.load)) < 1e-8 * np.std(P)
    state = FilterState(state.x, steady(model).L)
    Y[205:208, 2] = np.nan  # the gap that it is for
    for k in range(200, 230):
        before = state
        state, said = core.advance(before, Y[k])
        slow, fast = (d.advance(core, before, state, said) for d in (slow, fast))
        assert np.allclose(slow.load, fast.load, rtol=0, atol=1e-8 * np.std(P))
        assert np.allclose(slow.std, fast.std, rtol=1e-7)
    whole = records.smooth_record(records.filter_record(model, Y[:230]))
    assert np.allclose(whole.load[-lag - 1 :][::-1], fast.load, rtol=0, atol=1e-7 * np.std(P))
    assert np.allclose(whole.std[-lag - 1 :][::-1], fast.std, rtol=1e-7)


@pytest.mark.parametrize("correlated", [False, True])
def test_covariance_form_is_the_conditional_gaussian(correlated: bool) -> None:
    model, lag = small(2, correlated=correlated), 3
    Y, _ = drawn(model, 8)
    Y[2, :2] = Y[4] = np.nan
    core = SquareRoot(model)
    state, _ = core.update(core.start(), Y[0])
    found = delayed(core, state, lag)
    for k in range(1, 8):
        before = state
        state, said = core.advance(before, Y[k])
        found = found.advance(core, before, state, said)
        for j in range(min(k, lag) + 1):
            mean, P = conditioned(model, Y, k + 1, k - j)
            assert np.allclose(found.load[j], model.Cp @ mean, rtol=0, atol=1e-9)
            assert np.allclose(found.variance[j], np.diag(model.Cp @ P @ model.Cp.T), rtol=1e-8)
    assert len(found.load) == lag + 1


def test_a_block_of_any_length_gives_the_same_bits() -> None:
    model = away()
    fixed, rng = fixed_lag(steady(model), 6), np.random.default_rng(0)
    load, e = 100 * rng.standard_normal((400, model.p)), rng.standard_normal((400, model.m))
    whole = LagLine(fixed).block(load, e)
    for seed in range(4):
        line, cuts = LagLine(fixed), np.sort(np.random.default_rng(seed).integers(0, 400, 60))
        parts = [line.block(a, b) for a, b in zip(np.split(load, cuts), np.split(e, cuts), strict=True)]
        assert np.array_equal(np.concatenate(parts), whole)


def test_lags_of_a_periodic_filter() -> None:
    model, lag = away(), 6
    masks = np.array([[True, True, True], [True, True, False], [True, False, False]])
    found = periodic(model, masks).phases
    model = settled(model, found[-1])
    Y, _ = drawn(model, 120)
    Y[~np.tile(masks, (40, 1))] = np.nan
    for phase in range(3):
        start = 90 + phase  # a sample of that phase, the record cut `lag` later
        whole = records.smooth_record(records.filter_record(model, Y[: start + lag + 1]))
        fixed = phased(found, phase, lag)
        assert np.allclose(whole.std[start], fixed.std[-1], rtol=1e-9)
        load = records.filter_record(model, Y[: start + lag + 1])
        e = np.array([np.nan_to_num(said.e) for said in load.stretches[0].innovations])
        assert np.allclose(load.load[start] + sum(fixed.taps[j - 1] @ e[start + j] for j in range(1, lag + 1)),
                           whole.load[start], rtol=0, atol=1e-9 * np.std(whole.load))  # fmt: skip


def test_a_lag_counts() -> None:
    for wrong in (-1, 1.5):
        with pytest.raises(InputError, match="counts samples"):
            fixed_lag(steady(small()), wrong)
    with pytest.raises(InputError, match="needs a lag"):
        LagLine(fixed_lag(steady(small()), 0))
