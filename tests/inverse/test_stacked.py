"""Stacked complex lines against one dense solve for each line."""

import numpy as np
import pytest

from loadid.inverse.stacked import StackedPath
from structures.errors import InputError

from .reference import augmented

RNG = np.random.default_rng(4)


def lines(sensors: int, loads: int, count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    H = RNG.standard_normal((count, sensors, loads)) + 1j * RNG.standard_normal((count, sensors, loads))
    Y = RNG.standard_normal((count, sensors)) + 1j * RNG.standard_normal((count, sensors))
    return H * np.geomspace(1, 1e3, count)[:, None, None], Y


@pytest.mark.parametrize(("sensors", "loads"), [(4, 2), (3, 3), (2, 4)])
def test_each_line_with_its_own_lambda(sensors: int, loads: int) -> None:
    H, Y = lines(sensors, loads)
    path = StackedPath(H, Y)
    lam = np.geomspace(1e-3, 0.9, len(H))
    load, residual, p = path.solution(lam, None).load, path.residual(lam), path.at(lam[:, None])
    assert p.edf.shape == (len(H), 1)
    for k, (h, y) in enumerate(zip(H, Y, strict=True)):
        scale = np.linalg.norm(h, 2)
        assert path.scale[k] == pytest.approx(scale)
        ref = augmented(h, y, np.eye(loads), lam[k] * scale)
        np.testing.assert_allclose(load[k], ref.load, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(residual[k], ref.residual, atol=1e-10)
        assert p.edf[k, 0] == pytest.approx(np.trace(ref.A).real, rel=1e-10)
        assert p.left[k, 0] == pytest.approx(sensors - np.trace(ref.A).real, rel=1e-8)
        assert p.residual2[k, 0] == pytest.approx(np.linalg.norm(ref.residual) ** 2, rel=1e-8, abs=1e-14)
        assert p.penalty2[k, 0] == pytest.approx(ref.penalty2, rel=1e-9)


def test_one_lambda_for_all_and_a_grid_broadcast_over_the_lines() -> None:
    H, Y = lines(3, 2)
    path, grid = StackedPath(H, Y), np.array([0.01, 0.1, 0.5])
    table = path.at(grid)
    assert table.residual2.shape == (6, 3)
    np.testing.assert_allclose(path.at(0.1).residual2, table.residual2[:, 1])
    np.testing.assert_allclose(path.solution(0.1, None).load, path.solution(np.full(6, 0.1), None).load)


def test_a_silent_line_carries_no_load() -> None:
    H, Y = lines(3, 2)
    H[0] = 0  # accelerometers at zero frequency
    path = StackedPath(H, Y)
    p = path.at([1e-6, 0.1])
    assert np.all(path.solution(0.1, None).load[0] == 0)
    np.testing.assert_array_equal(p.edf[0], 0)
    np.testing.assert_allclose(p.left[0], 3)
    np.testing.assert_allclose(p.residual2[0], np.linalg.norm(Y[0]) ** 2)
    assert all(np.all(np.isfinite(x)) for x in (p.sensitivity, p.objective, p.log_ratio, path.range))


@pytest.mark.parametrize("where", ["H", "Y", "shape"])
def test_nan_and_misfits_are_refused(where: str) -> None:
    H, Y = lines(3, 2)
    if where == "H":
        H[1, 0, 0] = np.nan
    elif where == "Y":
        Y[2, 1] = np.inf
    else:
        Y = Y[:, :2]
    with pytest.raises(InputError, match="stacked problem"):
        StackedPath(H, Y)
