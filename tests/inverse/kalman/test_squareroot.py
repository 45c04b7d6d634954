"""The square-root filter against conditioning of everything at once, filterpy, and Gillijns & De Moor."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from loadid._inverse.gaussian import records
from loadid._inverse.gaussian.model import FilterModel, SquareRoot
from loadid._inverse.gaussian.roots import joined, lower, square
from structures.errors import InputError

from .gaussian import building, conditioned, drawn, gillijns_de_moor, joseph, long_double, small

R_SD = np.array([0.3, 0.3, 0.5, 1e-3])


def gappy(Y: np.ndarray) -> np.ndarray:
    """Some channels lost, some samples whole."""
    Y = np.array(Y)
    Y[0, 1] = Y[2, :2] = Y[3] = Y[5, 2] = np.nan
    return Y


@pytest.mark.parametrize("correlated", [False, True])
def test_filter_is_the_conditional_gaussian(correlated: bool) -> None:
    for seed in range(3):
        model = small(seed, correlated=correlated)
        Y = gappy(drawn(model, 8, seed)[0])
        found = records.filter_record(model, Y)
        for k in range(8):
            mean, P = conditioned(model, Y, k + 1, k)
            assert np.allclose(found.stretches[0].states[k].x, mean, rtol=0, atol=1e-9)
            L = found.stretches[0].states[k].L
            assert np.allclose(L @ L.T, P, rtol=0, atol=1e-9)
            assert np.allclose(found.std[k] ** 2, np.diag(model.Cp @ P @ model.Cp.T), atol=1e-9)
        assert found.count.tolist() == np.isfinite(Y).sum(axis=1).tolist()


@pytest.mark.parametrize("correlated", [False, True])
def test_likelihood_is_that_of_the_joint_density(correlated: bool) -> None:
    from scipy.linalg import block_diag
    from scipy.stats import multivariate_normal

    model = small(3, correlated=correlated)
    Y = gappy(drawn(model, 6)[0])
    found = records.filter_record(model, Y)
    # the same number of sensors' rows, read off the joint Gaussian of states made observable: a wide prior of the data
    N, n, m = 6, model.n, model.m
    S = np.zeros((n, m)) if model.S is None else model.S
    noise = block_diag(model.L0 @ model.L0.T,
                       *([np.block([[model.LQ @ model.LQ.T, S], [S.T, model.LR @ model.LR.T]])] * N))  # fmt: skip
    rows, mean, state, x = [], [], np.eye(n, len(noise)), model.x0
    for k in range(N):
        at = n + k * (n + m)
        rows.append(model.H @ state + np.eye(m, len(noise), at + n))
        mean.append(model.H @ x)
        state, x = model.F @ state + np.eye(n, len(noise), at), model.F @ x
    A, seen = np.concatenate(rows), np.isfinite(Y.reshape(-1))
    covariance = (A @ noise @ A.T)[np.ix_(seen, seen)]
    expected = multivariate_normal.logpdf(Y.reshape(-1)[seen], np.concatenate(mean)[seen], covariance)
    assert np.sum(found.loglik) == pytest.approx(expected, rel=1e-10)


def test_fused_step_is_prediction_and_update() -> None:
    for correlated in (False, True):
        model = small(1, correlated=correlated)
        core, Y = SquareRoot(model), gappy(drawn(model, 8)[0])
        a = b = core.start()
        a, b = core.update(a, Y[0])[0], core.update(b, Y[0])[0]
        for y in Y[1:]:
            a, told = core.update(core.predict(a), y)
            b, fused = core.advance(b, y)
            assert np.allclose(a.x, b.x, rtol=0, atol=1e-11)
            assert np.allclose(a.L @ a.L.T, b.L @ b.L.T, rtol=0, atol=1e-11)
            assert told.nis == pytest.approx(fused.nis, rel=1e-9, abs=1e-12)
            assert np.allclose(told.normalised, fused.normalised, atol=1e-10, equal_nan=True)


def test_equals_filterpy_with_masks_as_reduced_matrices() -> None:
    from filterpy.kalman import KalmanFilter

    model = building().walk(400.0, R_SD)
    Y, P = drawn(model, 1000)
    rng = np.random.default_rng(1)
    Y[rng.random(Y.shape) < 0.1] = np.nan
    Y[300:320, 3], Y[500:510] = np.nan, np.nan
    found = records.filter_record(model, Y)
    other = KalmanFilter(model.n, model.m)
    other.F, other.Q, other.P = model.F.copy(), model.LQ @ model.LQ.T, model.L0 @ model.L0.T
    other.x, R = model.x0.copy(), model.LR @ model.LR.T
    load, variance, loglik = [], [], 0.0
    for k, y in enumerate(Y):
        if k:
            other.predict()
        ok = np.isfinite(y)
        if ok.any():
            other.update(y[ok], R=R[ok][:, ok], H=model.H[ok])
            loglik += other.log_likelihood if k else 0.0  # at the first, scipy takes its wide covariance for singular
        load.append(model.Cp @ other.x)
        variance.append(np.diag(model.Cp @ other.P @ model.Cp.T))
    scale = np.sqrt(np.mean(P**2))
    assert np.max(np.abs(found.load - load)) < 1e-8 * scale
    assert np.max(np.abs(found.std**2 / np.array(variance) - 1)) < 1e-8
    assert np.sum(found.loglik[1:]) == pytest.approx(loglik, rel=1e-8)


@pytest.mark.parametrize("correlated", [False, True])
def test_a_white_load_without_bound_is_gillijns_and_de_moor(correlated: bool) -> None:
    model = building(acc=(2, 9), disp=(9,))
    rng = np.random.default_rng(0)
    ambient, feed = 1e-2 * rng.standard_normal((20, 2)), rng.standard_normal((3, 2)) * np.array([[0.1], [0.1], [1e-3]])
    R, Q = np.diag([0.01, 0.01, 1e-6]) + feed @ feed.T, ambient @ ambient.T + 1e-10 * np.eye(20)
    S = ambient @ feed.T if correlated else None
    Y, _ = drawn(model.white(30.0, R, Q, S), 300, 2)
    load, variance = gillijns_de_moor(model, Y, R, Q, 1e-12 * np.eye(20), S)
    gaps = []
    for sd in (1e3, 1e4, 1e5):
        found = records.filter_record(model.white(sd, R, Q, S), Y)
        gaps.append(np.max(np.abs(found.load - load)) / np.sqrt(np.mean(load**2)))
    assert gaps[2] < 1e-5
    assert 50 < gaps[0] / gaps[1] < 200  # as one over the variance
    assert 50 < gaps[1] / gaps[2] < 200
    assert np.max(np.abs(found.std**2 / variance - 1)) < 1e-4


QUIET = {
    "quiet sensors": (building((0, 3, 9), (), at=8), 1e4, 1e-6),
    "small steps": (building((0, 3, 9), (), at=8, dt=1e-3), 1e4, 1e-4),
    "stiff in SI": (building((0, 3, 9), (), at=8, k=5e8, mass=2e4, dt=2e-3), 1e8, 1e-4),
}


@pytest.mark.parametrize("name", QUIET)
def test_no_variance_is_lost_in_20_000_samples(name: str) -> None:
    """Accelerometers alone, away from the load, start of unit variance."""
    model, q, r = QUIET[name]
    model = model.walk(q, np.full(3, r**0.5), states=1e-20, start=1.0, load=1.0)
    core, whole = SquareRoot(model), np.ones(3, bool)
    stack, L = core.stack(None, whole), core.update_root(core.whole, model.L0)
    variances = np.empty(20_000)
    for k in range(len(variances)):
        variances[k] = float(np.sum((model.Cp @ L) ** 2))
        L = core.covariance(stack, L)[2]
    assert np.all(np.isfinite(variances))
    assert variances.min() > 0
    assert np.max(np.abs(np.diff(np.log(variances[2000:])))) < 1e-3  # nothing jumps once the start is forgotten
    assert np.max(np.abs(variances[:300] / long_double(model, 300) - 1)) < 1e-4


def test_joseph_form_fails_where_the_root_does_not() -> None:
    model, q, r = QUIET["quiet sensors"]
    with np.errstate(all="ignore"):
        assert joseph(model.walk(q, np.full(3, r**0.5), states=1e-20, start=1.0, load=1.0), 1000).min() < 0


def test_answers_in_any_unit() -> None:
    model = building().walk(400.0, R_SD)
    Y, _ = drawn(model, 200)
    own = records.filter_record(model, Y)
    for c in (1e-6, 1e6):
        scaled = dataclasses.replace(model, LQ=c * model.LQ, LR=c * model.LR, L0=c * model.L0)
        other = records.filter_record(scaled, c * Y)
        assert np.allclose(other.load, c * own.load, rtol=1e-9, atol=1e-9 * c)
        assert np.allclose(other.std, c * own.std, rtol=1e-9)
    D = np.r_[np.full(model.nx, 1.0), 1e-6]  # the load in other units than the structure
    other = records.filter_record(
        dataclasses.replace(model, F=model.F * D[:, None] / D, LQ=D[:, None] * model.LQ, H=model.H / D,
                            Cp=model.Cp / D, L0=D[:, None] * model.L0), Y)  # fmt: skip
    assert np.allclose(other.load, own.load, rtol=0, atol=1e-9 * np.max(np.abs(own.load)))
    assert np.allclose(other.std, own.std, rtol=1e-9)


def test_single_precision_is_raised() -> None:
    model = building().walk(400.0, R_SD)
    Y, _ = drawn(model, 50)
    Y = Y.astype(np.float32)
    assert records.filter_record(model, Y).load.dtype == np.float64
    assert np.array_equal(records.filter_record(model, Y).load, records.filter_record(model, Y.astype(float)).load)
    raised = FilterModel(**{**vars(model), "F": model.F.astype(np.float32)})
    assert raised.F.dtype == np.float64


@pytest.mark.parametrize("n", [1, 3, 60, 130])
def test_roots_are_roots(n: int) -> None:
    rng = np.random.default_rng(n)
    wide, more = rng.standard_normal((n, n + 2)), rng.standard_normal((n, max(n - 1, 1)))
    L = square(lower(wide[:, : max(n // 2, 1)], wide[:, max(n // 2, 1) :]))
    assert np.allclose(L @ L.T, wide @ wide.T, rtol=0, atol=1e-12 * n)
    both = joined(L, more.copy())
    assert np.allclose(both @ both.T, wide @ wide.T + more @ more.T, rtol=0, atol=1e-12 * n)
    assert not np.triu(both, 1).any()
    assert np.allclose(L @ L.T, wide @ wide.T, rtol=0, atol=1e-12 * n)  # not overwritten


def test_what_is_wrong_is_named() -> None:
    model = small()
    core = SquareRoot(model)
    with pytest.raises(InputError, match="wrong width"):
        core.update(core.start(), np.zeros(4))
    with pytest.raises(InputError, match="channel 1: an infinite number"):
        core.update(core.start(), [0.0, np.inf, 0.0])
    with pytest.raises(InputError, match="does not fit the model"):
        records.filter_record(model, np.zeros((5, 2)))
    with pytest.raises(InputError, match="channel 2, sample 3: an infinite number"):
        records.filter_record(model, np.where(np.arange(15).reshape(5, 3) == 11, np.inf, 0.0))
    with pytest.raises(InputError, match="no pair of noises"):
        SquareRoot(dataclasses.replace(small(correlated=True), LQ=1e-3 * model.LQ))
    with pytest.raises(InputError, match="without noise"):
        SquareRoot(dataclasses.replace(small(correlated=True), LR=np.diag([1.0, 0.0, 1.0])))
    said: list[float] = []
    records.filter_record(model, np.zeros((600, 3)), progress=lambda share, text: said.append(share))
    assert said == sorted(said)
    assert len(said) == 3
