"""Tests of the noise: silent on white noise at their stated level, loud on correlated noise; effective data by hand."""

import numpy as np
import pytest
import scipy.stats

from loadid._inverse.sweep import COLOURED, KS, effective_number, ncp_statistic, plateau_test, residual_test
from loadid.paths import LinearProblem, RegularizationPath, SVDPath, toeplitz
from structures.errors import InputError
from tests.benchmarks.fredholm import NOISES, PROBLEMS

from .reference import echo

N = 200


def smooth(kind: str, draws: int, penalty: bool = False) -> list[SVDPath]:
    H, g = PROBLEMS["gravity"](N)
    y = H @ g
    path = SVDPath(LinearProblem.whitened(H, y, L=np.diff(np.eye(N), axis=0) if penalty else None))
    sigma = 0.01 * float(np.sqrt(np.mean(y**2)))
    rng = np.random.default_rng(1)
    return [path.with_data(y + sigma * NOISES[kind](rng, N)) for _ in range(draws)]


# -- residual --------------------------------------------------------------------------------------------------------
def test_residuals_of_a_tile_are_those_of_the_path() -> None:
    T = toeplitz(echo(40, 3, 2, seed=2, decay=12.0))
    y = np.random.default_rng(0).standard_normal((40, 3))
    path = SVDPath(LinearProblem.whitened(T, y, shape=(40, 2)))
    lams = np.geomspace(1e-3, 1, 7)
    for lam, found in zip(lams, path.residuals(lams), strict=True):
        np.testing.assert_allclose(found, path.residual(lam), atol=1e-10)
    frames = SVDPath(LinearProblem.whitened(T.reshape(-1, T.shape[-1]), y.ravel())).with_data(
        np.outer(y.ravel(), [1, 2.0])
    )
    for lam, found in zip(lams, frames.residuals(lams), strict=True):
        np.testing.assert_allclose(found, frames.residual(lam).reshape(2, -1), atol=1e-10)


def test_expected_periodogram_is_that_of_the_projected_noise() -> None:
    """Against the dense (I - A): the power that white noise leaves on each line."""
    path = smooth("white", 1, penalty=True)[0]
    lam = 0.01
    A = path.problem.H @ path.inverse(lam)
    left = np.eye(N) - A
    power = np.sum(np.abs(np.fft.rfft(left, axis=0)[1:]) ** 2, axis=1)
    taken = 1 - path.rejected(np.array([lam]))[0, : path.U.shape[1]] ** 2
    np.testing.assert_allclose(N - path.mode_lines @ taken, power, atol=1e-8 * N)


@pytest.mark.parametrize("lam", [0.05, 3e-4])
def test_white_noise_passes_at_the_stated_level_however_much_the_fit_spends(lam: float) -> None:
    """Noise alone through a wide-band operator: the fit colours the residual, and the test knows how."""
    T = toeplitz(echo(120, 1, 1, seed=3, decay=15.0)).reshape(120, 120)
    path = SVDPath(LinearProblem.whitened(T, np.zeros(120)))
    rng = np.random.default_rng(0)
    found = [residual_test(path.with_data(rng.standard_normal(120)), lam) for _ in range(200)]
    assert found[0].threshold == KS
    assert np.mean([not f.white for f in found]) < 0.09
    if found[0].spent > 0.3:  # the flat expectation is refuted by the fit itself
        flat = [
            ncp_statistic(path.with_data(rng.standard_normal(120)).residual(lam).reshape(120, -1)) for _ in range(50)
        ]
        assert np.mean([s > KS for _, s in flat]) > 0.3


@pytest.mark.parametrize("kind", ["AR(1) 0.9", "interpolated"])
def test_correlated_noise_is_refuted(kind: str) -> None:
    found = [residual_test(path, 0.05) for path in smooth(kind, 30)]
    assert np.mean([not f.white for f in found]) > 0.9


def test_a_path_without_modes_takes_the_wider_limit_once_the_fit_spends() -> None:
    class Plain(RegularizationPath):
        m, null = 60, 0

        def __init__(self, edf: float) -> None:
            self.edf = edf

        def at(self, lam: object) -> object:
            return type("Point", (), {"edf": np.array(self.edf)})()

        def residual(self, lam: float) -> np.ndarray:
            return np.random.default_rng(0).standard_normal((60, 1))

    assert residual_test(Plain(3.0), 0.1).threshold == KS
    assert residual_test(Plain(20.0), 0.1).threshold == COLOURED
    assert residual_test(Plain(20.0), 0.1).spent == pytest.approx(1 / 3)
    Plain.residual = lambda self, lam: np.zeros((1, 60))
    assert residual_test(Plain(3.0), 0.1) is None


# -- data coefficients -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("penalty", [False, True])
def test_plateau_of_white_noise_is_flat_at_the_stated_level(penalty: bool) -> None:
    found = [plateau_test(path, 0.02) for path in smooth("white", 300, penalty)]
    assert all(f.testable for f in found)
    assert np.mean([f.chance < 0.05 for f in found]) == pytest.approx(0.05, abs=0.04)
    assert sum(not f.flat for f in found) <= 2
    assert scipy.stats.kstest([f.chance for f in found], "uniform").pvalue > 1e-3


def test_plateau_of_smooth_noise_is_not_flat() -> None:
    found = [plateau_test(path, 0.02) for path in smooth("AR(1) 0.9", 40)]
    assert np.mean([not f.flat for f in found]) > 0.9
    assert np.median([f.ratio for f in found]) > 3


def test_plateau_is_the_f_test_of_its_definition() -> None:
    path = smooth("white", 1)[0]
    b = (path.U.T @ path.problem.y) ** 2
    rest = b[int(2 * float(path.at(0.02).edf) + 5) :]
    h = len(rest) // 2
    ratio = np.mean(rest[:h]) / np.mean(rest[h:])
    found = plateau_test(path, 0.02)
    assert found.modes == len(rest)
    assert found.ratio == pytest.approx(ratio, rel=1e-9)
    assert found.chance == pytest.approx(scipy.stats.f.sf(ratio, h, len(rest) - h), rel=1e-9)


def test_few_modes_are_not_testable() -> None:
    path = smooth("AR(1) 0.9", 1)[0]
    found = plateau_test(path, 1e-9)  # nearly all modes are used
    assert found.modes < 200
    H, g = PROBLEMS["gravity"](30)
    small = plateau_test(SVDPath(LinearProblem.whitened(H, H @ g)), 0.01)
    assert not small.testable
    assert small.flat


# -- interpolated data -----------------------------------------------------------------------------------------------
def test_effective_number_by_hand() -> None:
    found = effective_number(np.eye(7), 0.3)
    assert (found.nominal, found.rank) == (7, 7)
    assert found.effective == pytest.approx(7)
    repeated = effective_number(np.repeat(np.eye(3), 4, axis=0))  # each of three values four times
    assert (repeated.nominal, repeated.rank) == (12, 3)
    assert repeated.effective == pytest.approx(3)


def test_effective_number_of_interpolated_markers() -> None:
    """60 values from 20 markers: rank 20, and fewer effective data, by the trace formula on the dense covariance."""
    x, knots = np.linspace(0, 1, 60), np.linspace(0, 1, 20)
    W = np.array([np.interp(x, knots, row) for row in np.eye(20)]).T
    cov = np.diag(np.linspace(1, 2, 20))
    cov[0, 1] = cov[1, 0] = 0.5
    C = W @ cov @ W.T
    found = effective_number(W, cov)
    assert (found.nominal, found.rank) == (60, 20)
    assert found.effective == pytest.approx(np.trace(C) ** 2 / np.trace(C @ C), rel=1e-9)
    assert found.effective < 20
    std = effective_number(W, np.sqrt(np.diag(cov)))
    C = W @ np.diag(np.diag(cov)) @ W.T
    assert std.effective == pytest.approx(np.trace(C) ** 2 / np.trace(C @ C), rel=1e-9)


@pytest.mark.parametrize(
    ("W", "noise"),
    [(np.ones(4), 1.0), (np.ones((4, 3)), np.ones(4)), (np.full((4, 3), np.nan), 1.0), (np.zeros((4, 3)), 1.0)],
)
def test_what_is_no_interpolation_is_refused(W: np.ndarray, noise: object) -> None:
    with pytest.raises(InputError, match="interpolation"):
        effective_number(W, noise)
