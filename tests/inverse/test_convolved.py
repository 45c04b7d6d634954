"""Long records behind impulse responses: loads, scalars and posterior against the dense path and the augmented QR."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid._inverse import penalties
from loadid._inverse.convolution import PenalizedConvolution
from loadid._inverse.convolved import posterior as probes
from loadid._inverse.convolved.path import ConvolvedPath
from loadid._inverse.convolved.pcg import Circulant, Sides, solve
from loadid._inverse.convolved.posterior import diagonals, profile
from loadid._inverse.posterior import Posterior, from_arrays
from loadid.paths import LinearProblem, RegularizationPath, SVDPath, choose, toeplitz
from structures.errors import InputError, NotIdentifiable

from .reference import augmented, penalty

NAMES = ["identity", "first_difference", "second_difference"]


def ringing(samples: int, sensors: int = 1, loads: int = 1, damping: float = 0.01) -> NDArray:
    """Displacement of modes that still ring at the end of the record, (samples, sensors, loads)."""
    rng = np.random.default_rng(3)
    w = 2 * np.pi * np.array([0.006, 0.02, 0.06, 0.11])[:, None]
    t = np.arange(1, samples + 1)
    shapes = rng.uniform(0.3, 1.0, (sensors, 4)), rng.uniform(0.3, 1.0, (loads, 4))
    if sensors * loads > 1:
        shapes = shapes[0] * rng.choice([-1, 1], (sensors, 4)), shapes[1]
    modes = np.exp(-damping * w * t) * np.sin(w * t) / w
    return np.einsum("sk,lk,kt->tsl", *shapes, modes)


def record(h: NDArray, noise: float = 0.01, seed: int = 1) -> tuple[NDArray, NDArray]:
    """Whitened impulse responses and data of half-sine pulses."""
    samples, loads = len(h), h.shape[2]
    g = np.zeros((samples, loads))
    for j in range(loads):
        g[samples // 3 + 30 * j :][:25, j] = np.sin(np.pi * np.arange(25) / 24)
    clean = np.asarray(PenalizedConvolution(h, samples).apply(g))
    sigma = noise * clean.std()
    return h / sigma, (clean + sigma * np.random.default_rng(seed).standard_normal(clean.shape)) / sigma


def dense(h: NDArray, y: NDArray, name: str, weight: NDArray | None = None) -> tuple[NDArray, NDArray, NDArray]:
    """Operator, data and penalty written out."""
    samples, loads = len(y), h.shape[2]
    H = toeplitz(np.concatenate([h, np.zeros((samples - len(h), *h.shape[1:]))])).reshape(-1, samples * loads)
    w = np.ones(y.size) if weight is None else weight.ravel()
    return w[:, None] * H, w * np.nan_to_num(y).ravel(), np.kron(penalty(name, samples), np.eye(loads))


def paths(samples: int, name: str) -> tuple[ConvolvedPath, SVDPath]:
    """One record of this length on both paths."""
    h, y = record(ringing(samples))
    T, L = toeplitz(h).reshape(samples, 1, samples), penalties.matrix(name, samples)
    return ConvolvedPath(h, y, name), SVDPath(LinearProblem.whitened(T, y, [1.0], L, (samples, 1)))


@pytest.fixture(scope="module")
def both() -> dict[str, tuple[ConvolvedPath, SVDPath]]:
    """One record on both paths, by penalty."""
    return {name: paths(350, name) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(("sensors", "loads", "gaps"), [(1, 1, False), (3, 2, False), (3, 2, True), (2, 2, False)])
def test_load_is_that_of_the_augmented_qr(sensors: int, loads: int, gaps: bool, name: str) -> None:
    h, y = record(ringing(150, sensors, loads))
    weight = np.ones(y.shape)
    if gaps:
        weight[40:60, 0] = weight[::7, 1] = 0.0
        y[weight == 0] = np.nan
    path = ConvolvedPath(h, y, name, weight)
    H, z, L = dense(h, y, name, weight)
    for lam in (1e-4, 1e-2, 1.0):
        ref = augmented(H, z, L, lam * float(path.scale))
        load = path.solution(lam, None).load
        assert np.linalg.norm(load.ravel() - ref.load) < 1e-8 * np.linalg.norm(ref.load)
        np.testing.assert_allclose(path.residual(lam).ravel(), ref.residual, atol=1e-8 * np.linalg.norm(z))
        assert path.gradient(lam) < 1e-10
        resolved = augmented(H, H @ np.ones(150 * loads), L, lam * float(path.scale)).load
        np.testing.assert_allclose(path.resolve(np.ones((150, loads)), lam).ravel(), resolved, atol=1e-5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", ["one", "several", "gaps", "short response"])
def test_variances_come_from_few_solves(case: str, name: str) -> None:
    """Diagonals by displacement against those of the inverse, at a lambda where the ends differ from the middle."""
    h, y = record(ringing(140, *((1, 1) if case in ("one", "short response") else (3, 2))))
    weight = np.ones(y.shape)
    if case == "gaps":
        weight[50:70, 1] = weight[100:, 2] = 0.0
        weight[5, 0] = 0.5
    h = h[:60] if case == "short response" else h
    H, _, L = dense(h, y, name, weight)
    operator = PenalizedConvolution(h, 140, name, weight)
    for lam in (1e-4, 3e-2):
        x = lam * np.linalg.norm(H, 2)
        found = diagonals(operator, Circulant(operator, x))
        Q, R = np.linalg.qr(np.vstack([H, x * L]))
        variance = np.sum(np.linalg.solve(R, np.eye(H.shape[1])) ** 2, axis=1).reshape(140, -1).T
        np.testing.assert_allclose(found.variance, variance, rtol=1e-6)
        np.testing.assert_allclose(found.rough.T.ravel(), np.sum(Q[len(H) :] ** 2, axis=1), atol=1e-9)
        assert found.mismatch < 1e-6
        assert np.ptp(variance) > 0.2 * variance.min()


@pytest.mark.parametrize("name", NAMES)
def test_scalars_are_those_of_the_dense_path(both: dict[str, tuple[ConvolvedPath, SVDPath]], name: str) -> None:
    path, ref = both[name]
    assert isinstance(path, RegularizationPath)
    assert float(path.scale) == pytest.approx(float(ref.scale), rel=1e-6)
    assert (path.m, path.null) == (ref.m, ref.null)
    lam = np.geomspace(100 * path.lowest, 1.0, 25)
    a, b = path.at(lam), ref.at(lam)
    close = {
        "objective": 1e-4, "residual2": 1e-3, "penalty2": 1e-3, "edf": 1e-3, "left": 1e-3, "log_ratio": 1e-3,
        "edf2": 3e-3, "rest2": 1e-3, "rest4": 3e-3, "bend": 0.02, "sensitivity": 0.05 if name == "identity" else 0.25,
    }  # fmt: skip
    for field, tolerance in close.items():
        np.testing.assert_allclose(getattr(a, field), getattr(b, field), rtol=tolerance, err_msg=field)
        off = np.abs(getattr(a, field) / getattr(b, field) - 1)
        assert np.median(off) < 0.1 * tolerance, field
    one, two = path.exact(0.02), ref.at(0.02)
    for field in ("residual2", "penalty2", "edf", "left", "objective", "sensitivity", "bend"):
        assert float(getattr(one, field)) == pytest.approx(float(getattr(two, field)), rel=1e-6), field
    for mine, theirs in zip(path.residuals(lam), lam, strict=True):
        exact = ref.residual(float(theirs))
        assert np.linalg.norm(mine.ravel() - exact.ravel()) < 0.02 * np.linalg.norm(exact)
    pilot = 0.05 if name == "identity" else 1e-3
    expected = ref.predicted_error(lam, pilot, 1.0)
    np.testing.assert_allclose(path.predicted_error(lam, pilot, 1.0), expected, rtol=0.02)


def test_rules_choose_what_they_choose_on_the_dense_path() -> None:
    path, ref = paths(200, "first_difference")
    for sigma in (None, 1.0):
        one, two = (choose(p, None, sigma=sigma, source="given") for p in (path, ref))
        lams = {r.rule: r.lam for r in two.rules}
        for rule in one.rules:
            if rule.rule in ("robust_gcv", "discrepancy", "predicted_error", "upre", "evidence") and rule.lam:
                assert rule.lam == pytest.approx(lams[rule.rule], rel=0.05), rule.rule
        assert one.rule == two.rule
        assert one.lam == pytest.approx(two.lam, rel=0.05)


@pytest.mark.parametrize("name", NAMES)
def test_posterior_is_that_of_the_dense_path(both: dict[str, tuple[ConvolvedPath, SVDPath]], name: str) -> None:
    path, ref = both[name]
    w = np.random.default_rng(0).standard_normal((2, 350, 1))
    for lam in (1e-3, 0.1):
        a, b = path.solution(lam, 0.7).posterior, ref.solution(lam, 0.7).posterior
        assert isinstance(a, Posterior)
        np.testing.assert_allclose(a.std, b.std.reshape(350, 1), rtol=1e-6)
        np.testing.assert_allclose(a.noise_std, b.noise_std.reshape(350, 1), rtol=1e-4)
        np.testing.assert_allclose(a.variance(w), b.variance(w), rtol=1e-6)
        np.testing.assert_allclose(a.noise_variance(w), b.noise_variance(w), rtol=1e-6)
        scale = np.abs(b.bias_weights(w)).max()
        np.testing.assert_allclose(a.bias_weights(w), b.bias_weights(w), atol=1e-6 * scale)
        again = from_arrays(a.to_arrays())
        np.testing.assert_allclose(again.variance(w[0]), a.variance(w[0]), rtol=1e-12)


def test_long_records_take_their_variances_from_short_ones() -> None:
    h, _ = record(ringing(6000, damping=0.02))
    operator = PenalizedConvolution(h, 6000)
    x = 0.05 * np.abs(operator.spectrum).max()
    whole, pieced = diagonals(operator, Circulant(operator, x)), profile(operator, x)
    np.testing.assert_allclose(pieced.variance, whole.variance, rtol=1e-5)
    assert len(np.unique(pieced.variance)) < 2100  # it did come from a record of 2048 samples


def test_probes_stand_in_where_gaps_are_many() -> None:
    h, y = record(ringing(400))
    weight = (np.random.default_rng(0).random(y.shape) > 0.1).astype(float)
    path = ConvolvedPath(h, y, "identity", weight)
    H, z, L = dense(h, y, "identity", weight)
    assert path.m == int(weight.sum())
    for lam in (0.02, 0.1):
        ref = augmented(H, z, L, lam * float(path.scale))
        edf = float(np.trace(ref.A))
        assert float(path.at(lam).edf) == pytest.approx(edf, rel=4 * np.sqrt(2 / (32 * edf)))
        covariance = np.linalg.solve(H.T @ H + (lam * float(path.scale)) ** 2 * np.eye(400), np.eye(400))
        expected = np.sqrt(np.diag(covariance))
        std = path.solution(lam, 1.0).posterior.std[:, 0]
        np.testing.assert_allclose(std[:300], expected[:300], rtol=0.06)
    part, rest, _ = probes.traces(path.operator, float(path.scale) * 0.02, 1e-8)
    assert part + rest == pytest.approx(400)


def test_no_answer_depends_on_units() -> None:
    h, y = record(ringing(200, 2, 1))
    a = ConvolvedPath(h, y, "first_difference")
    for unit in (1e-6, 1e6):
        b = ConvolvedPath(h * unit, y * unit, "first_difference")
        np.testing.assert_allclose(b.solution(0.01, None).load, a.solution(0.01, None).load, rtol=1e-9, atol=1e-10)
        assert b.range[0] == pytest.approx(a.range[0], rel=1e-6)
        assert float(b.at(0.01).edf) == pytest.approx(float(a.at(0.01).edf), rel=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_factorisation_takes_over_from_an_iteration_that_does_not_settle(name: str) -> None:
    """Gaps, two loads, a response that ends before the record: against a QR of all equations."""
    h, y = record(ringing(120, 3, 2))
    h, weight = h[:80], np.ones(y.shape)
    weight[50:70, 1] = 0.0
    weight[5, 0] = 0.5
    H, data, L = dense(h, y, name, weight)
    operator = PenalizedConvolution(h, 120, name, weight)
    for x in (1e-3 * np.linalg.norm(H, 2), 0.1 * np.linalg.norm(H, 2)):  # the second one begins with the factorisation
        found = solve(operator, Circulant(operator, x), Sides(y=(y * weight).T[None]), most=5)
        expected = np.linalg.lstsq(np.vstack([H, x * L]), np.concatenate([data, np.zeros(len(L))]))[0].reshape(-1, 2)
        np.testing.assert_allclose(found.x[0].T, expected, rtol=0, atol=1e-8 * np.abs(expected).max())
        assert found.iterations <= 5


def test_an_iteration_that_does_not_settle_is_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    h, y = record(ringing(200))
    operator = PenalizedConvolution(h, 200)
    circulant = Circulant(operator, 1e-3 * np.abs(operator.spectrum).max())
    monkeypatch.setattr("loadid._inverse.convolved.pcg.FACTORED", 199)
    with pytest.raises(NotIdentifiable, match="do not determine"):
        solve(operator, circulant, Sides(y=y.T[None]), most=5)
    with pytest.raises(InputError, match="too small"):
        ConvolvedPath(h, y).solution(1e-9, None)


def test_bad_input_is_refused() -> None:
    h, y = record(ringing(100))
    with pytest.raises(InputError, match="do not fit"):
        ConvolvedPath(h, y[:, 0])
    with pytest.raises(InputError, match="NaN"):
        ConvolvedPath(h, np.where(np.arange(100)[:, None] == 3, np.nan, y))
    with pytest.raises(InputError, match="zero"):
        ConvolvedPath(np.zeros_like(h), y)
    with pytest.raises(InputError, match="missing"):
        ConvolvedPath(h, y, weight=np.zeros_like(y))
    with pytest.raises(NotIdentifiable, match="constant") as caught:  # two loads that one sensor cannot tell apart
        ConvolvedPath(np.repeat(h, 2, axis=2), y, "first_difference")
    assert caught.value.code == "LID-E306"
