"""filterpy on our model, and back: the same numbers as dense covariances and as the square roots, gaps included."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from loadid._inverse.gaussian.exports import FilterpyEngine, from_filterpy, to_filterpy
from loadid._inverse.gaussian.model import FilterModel, SquareRoot
from structures import InputError
from tests.tracked import ar1, bm2, bm3, filter_model, matern32, reference, walk

POLE = float(np.exp(-2 * np.pi * 0.05 * 0.01))


def correlated(samples=400):
    case = bm3(samples=samples)
    return case, filter_model(case, ar1(10.0, POLE))


def holed(y: np.ndarray, share: float = 0.1) -> np.ndarray:
    """A tenth of the values missing, one whole sample, one channel for a while."""
    out = np.where(np.random.default_rng(5).random(y.shape) < share, np.nan, y)
    out[50], out[100:150, 0] = np.nan, np.nan
    return out


def rooted(model: FilterModel, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loads, their std and the log-likelihood of the square-root recursion."""
    core = SquareRoot(model)
    state = core.start()
    out = []
    for k, sample in enumerate(y):
        state, said = core.update(core.predict(state) if k else state, sample)
        out.append((model.Cp @ state.x, np.linalg.norm(model.Cp @ state.L, axis=1), said.loglik))
    return tuple(np.array(part) for part in zip(*out, strict=True))  # type: ignore[return-value]


@pytest.mark.parametrize("gaps", [False, True])
@pytest.mark.parametrize("kind", ["walk", "matern", "correlated"])
def test_filterpy_agrees_with_dense_covariances_and_with_roots(kind: str, gaps: bool) -> None:
    if kind == "correlated":
        case, model = correlated()
    else:
        case = bm2("matern", samples=600)
        model = filter_model(case, walk(404.0) if kind == "walk" else matern32(100.0, 0.08, 0.01))
    y = holed(case.y) if gaps else case.y
    got, dense = FilterpyEngine(model).track(y), reference(model, y)
    size = np.sqrt(np.mean(case.load**2))
    for load, std, loglik in ((dense.load, dense.std, dense.loglik), rooted(model, y)):
        np.testing.assert_allclose(got.load, load, rtol=0, atol=1e-8 * size)
        np.testing.assert_allclose(got.std, std, rtol=1e-8)
        np.testing.assert_allclose(got.loglik, loglik, rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(got.nis, dense.nis, rtol=1e-7, atol=1e-8)


def test_a_user_of_filterpy_takes_over() -> None:
    """The configured filter, driven by filterpy's own calls, in the order that it documents."""
    case, model = correlated(200)
    kf = to_filterpy(model)
    loads = []
    for k, y in enumerate(case.y):
        if k:
            kf.predict(u=case.y[k - 1])
        kf.update(y)
        loads.append(model.Cp @ kf.x)
    np.testing.assert_allclose(loads, reference(model, case.y).load, rtol=0, atol=1e-8)


@pytest.mark.parametrize("kind", ["plain", "correlated"])
def test_there_and_back(kind: str) -> None:
    if kind == "correlated":
        case, model = correlated(200)
    else:
        case = bm2("mix", samples=200)
        model = filter_model(case, matern32(100.0, 0.08, 0.01))
    back = from_filterpy(to_filterpy(model), model.Cp, nx=model.nx, sample_input=True)
    for name in ("F", "H", "x0", "Cp"):
        np.testing.assert_allclose(getattr(back, name), getattr(model, name), rtol=1e-9, atol=1e-12)
    for name in ("LQ", "LR", "L0"):
        want, got = getattr(model, name), getattr(back, name)
        np.testing.assert_allclose(got @ got.T, want @ want.T, rtol=1e-9, atol=1e-12 * np.abs(want).max() ** 2)
    np.testing.assert_allclose(reference(back, case.y).load, reference(model, case.y).load, rtol=0, atol=1e-7)
    assert (back.S is None) == (model.S is None)


def test_a_filter_of_filterpys_own_examples() -> None:
    """A column state, a scalar sensor: the constant-velocity filter, its position taken for the load."""
    from filterpy.common import Q_discrete_white_noise
    from filterpy.kalman import KalmanFilter

    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.x = np.array([[2.0], [0.0]])
    kf.F, kf.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    kf.P *= 1000.0
    kf.R = np.array([[5.0]])
    kf.Q = Q_discrete_white_noise(dim=2, dt=0.1, var=0.13)
    model = from_filterpy(kf, [1.0, 0.0])
    y = np.cumsum(np.random.default_rng(0).standard_normal((50, 1)), axis=0)
    means = []
    for k, z in enumerate(y):
        if k:
            kf.predict()
        kf.update(z)
        means.append(float(kf.x[0, 0]))
    np.testing.assert_allclose(rooted(model, y)[0][:, 0], means, rtol=1e-9, atol=1e-9)
    assert model.nx == 1


def _spoilt(**changes):
    kf = to_filterpy(filter_model(bm2("mix", samples=20), walk(82.0)))
    for name, value in changes.items():
        setattr(kf, name, value)
    return kf


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"alpha": 1.02}, "fading memory"),
        ({"M": np.ones((21, 4))}, "two times"),
        ({"B": np.ones((21, 1))}, "an input"),
        ({"R": np.zeros((4, 4))}, "positive definite"),
        ({"Q": -np.eye(21)}, "no covariance"),
        ({"F": np.full((21, 21), np.nan)}, "F"),
    ],
)
def test_what_our_model_cannot_is_refused(changes, says) -> None:
    with pytest.raises(InputError, match=says):
        from_filterpy(_spoilt(**changes), np.eye(21)[-1:])


def test_bad_samples_are_refused() -> None:
    engine = FilterpyEngine(filter_model(bm2("mix", samples=20), walk(82.0)))
    for bad in (np.zeros(3), np.array([0, np.inf, 0, 0.0]), np.zeros((4, 1))):
        with pytest.raises(InputError, match="sample"):
            engine.step(bad)


def test_units_change_nothing() -> None:
    """Sensors in other units: the load and its band stay."""
    case = bm2("mix", samples=300)
    factors = np.array([1e3, 1.0, 1e-3, 1e6])
    same = replace(case, y=case.y * factors, noise=case.noise * factors)
    model = filter_model(case, walk(82.0))
    other = replace(model, H=model.H * factors[:, None], LR=np.diag(same.noise))
    a, b = FilterpyEngine(model).track(case.y), FilterpyEngine(other).track(same.y)
    np.testing.assert_allclose(a.load, b.load, rtol=0, atol=1e-7)
