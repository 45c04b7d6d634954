"""The path in windows beside the path in one piece, and the beginning on which its lambda is sought."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._inverse.convolved import windows as windowed
from loadid._inverse.convolved.path import ConvolvedPath
from loadid._inverse.convolved.windows import WindowedPath, beginning_of
from loadid._inverse.gaussian.coarse import confirm
from loadid.paths import LinearProblem, SVDPath, choose, toeplitz
from structures.errors import InputError

from .test_convolved import ringing

N, FIRST = 6000, 2048


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Beginnings of these short records."""
    monkeypatch.setattr(windowed, "FIRST", FIRST)


def record(quiet: int = 0, samples: int = N):
    """Whitened impulse responses and data of pulses that begin after a quiet time; the load."""
    h, g = ringing(1500, damping=0.1), np.zeros(samples)
    for k in range(quiet + 100, samples - 25, 700):
        g[k : k + 25] = np.sin(np.pi * np.arange(25) / 24)
    y = np.convolve(g, h[:, 0, 0])[:samples]
    sigma = 0.01 * y.std()
    return h / sigma, (y / sigma + np.random.default_rng(0).standard_normal(samples))[:, None], g


@pytest.mark.parametrize(("penalty", "lam"), [("identity", 0.02), ("second_difference", 1e-5)])
def test_scalars_and_loads_are_those_of_one_piece(penalty, lam):
    h, y, _ = record()
    whole, windows = ConvolvedPath(h, y, penalty), WindowedPath(h, y, penalty)
    one, found = whole.solution(lam, 1.0), windows.solution(lam, 1.0)
    assert np.linalg.norm(found.load - one.load) <= windows.solve(lam).bound
    assert windows.solve(lam).bound <= 2e-3 * np.linalg.norm(one.load)
    assert windows.solve(lam).count >= 2
    assert found.posterior.std == pytest.approx(one.posterior.std, rel=1e-12)
    assert windows.residual(lam) == pytest.approx(whole.residual(lam), abs=1e-3)
    for asked, close in ((lam, 2e-3), (lam * np.array([0.6, 1.7]), 3e-3)):
        a, b = whole.at(asked), windows.at(asked)
        for name in ("residual2", "penalty2", "edf", "left", "sensitivity", "objective", "bend"):
            assert getattr(b, name) == pytest.approx(getattr(a, name), rel=close), name
    clear = np.exp(-0.5 * ((np.arange(N) - 3500) / 20) ** 2)[:, None]
    assert windows.resolve(clear, lam) == pytest.approx(whole.resolve(clear, lam), abs=2e-4)


def test_missing_samples():
    h, y, _ = record(samples=6000)
    weight = np.ones(y.shape)
    weight[2000:2040] = 0.0
    whole, windows = (
        kind(h, np.where(weight == 0, np.nan, y), weight=weight) for kind in (ConvolvedPath, WindowedPath)
    )
    one, found = whole.solution(0.05, 1.0), windows.solution(0.05, 1.0)
    assert np.linalg.norm(found.load - one.load) <= windows.solve(0.05).bound
    assert windows.residual(0.05) == pytest.approx(whole.residual(0.05), abs=1e-3)
    assert np.all(windows.residual(0.05)[2000:2040] == 0)
    assert beginning_of(windows) is None
    with pytest.raises(InputError, match="missing data"):
        WindowedPath(h, y, weight=0.5 + 0 * y)


def test_lambda_is_sought_at_the_beginning_and_confirmed_on_the_whole():
    h, y, _ = record()
    path = WindowedPath(h, y)
    first = beginning_of(path)
    assert first.samples == FIRST
    assert float(first.scale) == float(path.scale)
    guess = choose(first, "discrepancy", sigma=1.0)
    found = confirm(path, guess, "discrepancy", sigma=1.0, source="stated")
    whole = choose(ConvolvedPath(h, y), "discrepancy", sigma=1.0)
    assert found.lam == pytest.approx(whole.lam, rel=2e-3)


def test_a_quiet_beginning_does_not_stand_for_the_record():
    h, y, _ = record(quiet=FIRST + 1000, samples=4 * FIRST)
    assert beginning_of(WindowedPath(h, y)).samples == 2 * FIRST
    h, y, _ = record(quiet=2 * FIRST + 1000, samples=9000)
    assert beginning_of(WindowedPath(h, y)) is None


@pytest.mark.parametrize("factored", [True, False])
def test_the_sweep_begins_where_the_iteration_settles(factored, monkeypatch):
    """A response with a tail of noise, as measured ones have: the scalars are those of a dense SVD."""
    if not factored:
        monkeypatch.setattr("loadid._inverse.convolved.pcg.FACTORED", 0)
    n, rng = 600, np.random.default_rng(0)
    t = np.arange(n)
    h = np.diff(np.exp(-0.002 * t) * np.sin(0.3 * (t + 1)), prepend=0.0) + 0.015 * rng.standard_normal(n)
    y = np.convolve(h, np.hanning(20))[:n]
    sigma = 0.01 * y.std()
    h, y = (h / sigma)[:, None, None], (y / sigma + rng.standard_normal(n))[:, None]
    path, dense = ConvolvedPath(h, y), SVDPath(LinearProblem.whitened(toeplitz(h), y, noise=[1.0]))
    assert 1e-4 <= path.range[0] < 0.05  # below, the iteration does not settle, whether or not another takes over
    lams = np.geomspace(*path.range, 7)
    assert path.at(lams).residual2 == pytest.approx(dense.at(lams).residual2, rel=1e-4)
    assert path.at(lams).edf == pytest.approx(dense.at(lams).edf, rel=1e-3)
