"""Channels that are missing here and there: one loop gives what the factorisation of every sample gives."""

from functools import cache

import numpy as np
import pytest

from loadid._families.tracking import bank as banks
from loadid._families.tracking.engine import Engine
from loadid._families.tracking.tracker import Tracker
from loadid._inverse.gaussian import loop as loops
from loadid._inverse.gaussian.model import SquareRoot
from structures.errors import InputError
from tests.killed import fitted

SHARES = (0.01, 0.1, 0.3)


@cache
def case():
    """A fitted tracker and a record of its own."""
    return fitted(1200)


def holed(share, seed=1):
    """The record with cells that are missing at random, and a whole sample and a long gap of one channel."""
    y = case()[1].copy()
    y[np.random.default_rng(seed).random(y.shape) < share] = np.nan
    y[300], y[500:560, 1] = np.nan, np.nan
    return y


def made(gate=None):
    return Tracker(case()[0].fitted, gate)


@pytest.mark.parametrize("share", SHARES)
def test_loads_and_std_are_those_of_the_square_root_filter(monkeypatch, share):
    y, model = holed(share), case()[0].fitted.model
    engine = Engine(model, None, None)  # it never settles
    monkeypatch.setattr(engine, "_regular", lambda: None)
    load, std, e = np.empty((len(y), model.p)), np.empty((len(y), model.p)), np.empty(y.shape)
    engine.block(y, load, std, e)
    core = SquareRoot(model)
    state, said = core.update(core.start(), y[0])
    for k in range(len(y)):
        if k:
            state, said = core.advance(state, y[k])
        size = np.linalg.norm(model.Cp @ state.L, axis=1)
        assert np.allclose(std[k], size, rtol=1e-9, atol=0)
        assert np.allclose(load[k], model.Cp @ state.x, rtol=1e-9, atol=1e-9 * size.max())
        assert np.allclose(e[k], said.normalised, rtol=1e-7, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("gate", [None, 6.0])
@pytest.mark.parametrize("share", SHARES)
def test_gate_phases_and_counts_are_those_of_single_factorisations(share, gate):
    y = holed(share)
    y[200, 2] += 1e3 * np.nanstd(y[:, 2])
    y[800:, 0] *= -1
    quick, slow = made(gate), made(gate)
    slow._engine.roots = None
    for a in range(0, len(y), 30):
        (load, std, e), (own, size, other) = (tracker.run(y[a : a + 30]) for tracker in (quick, slow))
        assert np.allclose(load, own, rtol=1e-9, atol=1e-9 * size.max())
        assert np.allclose(std, size, rtol=1e-9, atol=0)
        assert np.array_equal(np.isnan(e), np.isnan(other))
        assert (quick.phase, quick.counts) == (slow.phase, slow.counts)
        assert np.array_equal(quick.row_alarms, slow.row_alarms)
        ears = quick._engine.listener, slow._engine.listener
        assert np.array_equal(ears[0].runs, ears[1].runs)
        assert ears[0].heard == ears[1].heard


@pytest.mark.parametrize("share", SHARES)
def test_samples_blocks_and_a_copy_give_the_same_bits(share, tmp_path):
    y = holed(share)[:700]
    load, std, _ = made(6.0).run(y)
    tracker, k = made(6.0), 0
    for size in (1, 3, 200, 90, 1, 250):
        found = tracker.run(y[k : k + size])
        assert found[0].tobytes() == load[k : k + size].tobytes()
        assert found[1].tobytes() == std[k : k + size].tobytes()
        k += size
        tracker.save(tmp_path / "t.h5")
        tracker = Tracker.load(tmp_path / "t.h5")
    for row, own, size in zip(y[k:], load[k:], std[k:], strict=True):
        one, spread = tracker.step(row)
        assert (one.tobytes(), spread.tobytes()) == (own.tobytes(), size.tobytes())


def test_the_loop_as_it_is_written_gives_the_same_bits(monkeypatch):
    y = holed(0.1)[:60]
    load, std, e = made().run(y)
    for loop in (loops._roots, banks._with_gaps):
        monkeypatch.setattr(loop, "after", lambda products, plain=loop.plain: plain)
    own, size, other = made().run(y)
    assert (load.tobytes(), std.tobytes(), e.tobytes()) == (own.tobytes(), size.tobytes(), other.tobytes())


def test_an_infinite_sample_is_refused_and_not_counted():
    tracker, y = made(), holed(0.1)[:40]
    y[30, 1] = np.inf
    with pytest.raises(InputError, match="infinite"):
        tracker.run(y)
    assert tracker.counts["samples"] == 30


@pytest.mark.parametrize("there", [None, (True, False, True, True)])
def test_the_bank_takes_missing_channels_as_the_others_tell(there):
    """Least squares of the whitened innovations over the missing ones, filter by filter."""
    bank = banks.lifted_of(case()[0].fitted.model, None if there is None else np.array(there))
    rng = np.random.default_rng(0)
    start, Y = rng.standard_normal((len(bank.out), len(bank.x0))), case()[1][:20].copy()
    Y[rng.random(Y.shape) < 0.3], Y[7] = np.nan, np.nan
    kept = start.copy()
    z, ahead = bank.hop(start, Y)
    assert np.array_equal(start, kept)
    for f, x in enumerate(kept):
        for t, y in enumerate(np.where(bank.there, Y, 0.0)):
            e, W = y - bank.H @ x, bank.W[f]
            gone = np.isnan(e)
            e[gone] = 0.0
            e[gone] = np.linalg.lstsq(W[:, gone], -W @ e, rcond=None)[0]
            assert np.allclose(z[f, t], W @ e, rtol=1e-8, atol=1e-8 * np.abs(z[f]).max())
            x = bank.A[f] @ x + bank.B[f] @ (bank.H @ x + e)
        assert np.allclose(ahead[f], x, rtol=1e-8, atol=1e-8 * np.abs(x).max())
