"""Records solved in windows: near the solution in one piece, and never farther from it than the bound says."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid._inverse.convolved.path import ConvolvedPath
from loadid._inverse.convolved.windows import solve_in_windows
from structures.errors import InputError

from .test_convolved import ringing

N = 6000


@pytest.fixture(scope="module")
def case() -> tuple[NDArray, NDArray]:
    h = ringing(2500, damping=0.08)  # forgotten within its length
    g = np.zeros(N)
    for k in range(100, N, 700):
        g[k : k + 25] = np.sin(np.pi * np.arange(25) / 24)
    y = np.convolve(g, h[:, 0, 0])[:N]
    y += 0.01 * y.std() * np.random.default_rng(0).standard_normal(N)
    return h, y[:, None]


@pytest.mark.parametrize("penalty", ["identity", "first_difference", "second_difference"])
@pytest.mark.parametrize("overlap", [40, 400])
def test_bound_holds(case: tuple[NDArray, NDArray], penalty: str, overlap: int) -> None:
    h, y = case
    path = ConvolvedPath(h, y, penalty)
    lam = (0.02 if penalty == "identity" else 1e-4) * float(path.scale)
    whole = path.solution(lam / float(path.scale), None).load
    size = np.linalg.norm(whole)
    for sweeps in (1, 3):
        found = solve_in_windows(h, y, lam, penalty, window=1500, overlap=overlap, sweeps=sweeps, tolerance=1e-7)
        off = np.linalg.norm(found.load - whole)
        assert found.count > 3
        assert off <= found.bound
        if overlap == 400:
            settled = 2e-4 if penalty == "identity" else 5e-3  # differences: sweeps that do not help are not taken
            assert off < (0.02 if sweeps == 1 else settled) * size
            assert found.bound < 1e3 * off or found.bound < 1e-6 * size  # and it is no empty statement


def test_windows_find_their_own_length_and_bear_gaps(case: tuple[NDArray, NDArray]) -> None:
    h, y = case
    weight = np.ones(y.shape)
    weight[2000:2030] = weight[::53] = 0.0
    gappy = np.where(weight == 0, np.nan, y)
    path = ConvolvedPath(h, gappy, weight=weight)
    told: list[float] = []
    found = solve_in_windows(
        h, gappy, 0.05 * float(path.scale), weight=weight, progress=lambda share, text: told.append(share)
    )
    whole = path.solution(0.05, None).load
    off = np.linalg.norm(found.load - whole)
    assert off <= found.bound
    assert off < 1e-3 * np.linalg.norm(whole)
    assert found.window < N
    assert told == sorted(told)
    assert told[-1] == 1.0


def test_bad_input_is_refused(case: tuple[NDArray, NDArray]) -> None:
    h, y = case
    with pytest.raises(InputError, match="overlap"):
        solve_in_windows(h, y, 1.0, window=1000, overlap=600)
    with pytest.raises(InputError, match="lambda"):
        solve_in_windows(h, y, 0.0)
    with pytest.raises(InputError, match="NaN"):
        solve_in_windows(h, np.where(np.arange(N)[:, None] == 5, np.nan, y), 1.0)
    with pytest.raises(InputError, match="do not fit"):
        solve_in_windows(h[:, :, 0], y, 1.0)
