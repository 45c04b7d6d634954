"""Loads that only push over records, against dense non-negative least squares and against the constrained path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import nnls

from loadid._inverse.constrained.condensed import BlockNormal
from loadid._inverse.constrained.nonnegative import NonNegativeRecord, discrepancy, minimise
from loadid._inverse.constrained.normal import gap
from loadid._inverse.constrained.path import ConstrainedPath
from loadid._inverse.gaussian.record import WhitenedRecord, augment, record
from loadid._inverse.rules import discrepancy_level
from loadid.constraints import NonNegative
from loadid.paths import LinearProblem, SVDPath
from structures.errors import InputError, NotIdentifiable
from tests import halfsine

PENALTIES = ("identity", "first_difference", "second_difference")
ORDER = dict(zip(PENALTIES, range(3), strict=True))


@dataclass
class Case:
    """A record with its dense matrices: unknowns are free states of the model, then loads (samples, loads)."""

    record: WhitenedRecord
    H: NDArray  # (data, unknowns)
    L: NDArray
    y: NDArray
    states: int
    loads: int
    h: NDArray  # (samples, sensors, loads)

    @property
    def scale(self) -> float:
        return float(np.linalg.norm(self.H[:, self.states :], 2))

    def gram(self, lam: float) -> NDArray:
        return self.H.T @ self.H + lam**2 * self.L.T @ self.L

    def minimum(self, lam: float, signed: NDArray | None = None) -> NDArray:
        """Loads and states by scipy's NNLS, unknowns of either sign as differences of two."""
        signed = np.ones(self.loads, bool) if signed is None else signed
        both = np.concatenate([np.ones(self.states, bool), np.tile(~signed, len(self.L.T) // self.loads)])
        both = both[: self.H.shape[1]]
        A = np.vstack([self.H, lam * self.L])
        found = nnls(np.hstack([A, -A[:, both]]), np.r_[self.y, np.zeros(len(self.L))], maxiter=50 * A.shape[1])[0]
        out = found[: A.shape[1]].copy()
        out[both] -= found[A.shape[1] :]
        return out

    def objective(self, v: NDArray, lam: float) -> float:
        return float(np.sum((self.y - self.H @ v) ** 2) + lam**2 * np.sum((self.L @ v) ** 2)) / 2


def case(
    penalty: str, samples: int = 150, *, sensors: int = 1, loads: int = 1, gaps: bool = False, start: bool = False,
    seed: int = 0,
) -> Case:  # fmt: skip
    """A stable random system under pushes, some data missing, moving at the start."""
    rng = np.random.default_rng(seed)
    pairs = [0.97 * np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]]) for a in (0.15, 0.5, 1.1)]
    A = np.zeros((6, 6))
    for k, pair in enumerate(pairs):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = pair
    B, C = rng.standard_normal((6, loads)), rng.standard_normal((sensors, 6))
    D = rng.standard_normal((sensors, loads))
    truth = np.maximum(rng.standard_normal((samples, loads)) - 0.5, 0)
    h = np.zeros((samples, sensors, loads))
    power = B
    h[0] = D
    for k in range(1, samples):
        h[k], power = C @ power, A @ power
    H = np.zeros((samples, sensors, samples, loads))
    for k in range(samples):
        H[k:, :, k] = h[: samples - k]
    states = np.array([C @ np.linalg.matrix_power(A, k) for k in range(samples)])
    x0 = rng.standard_normal(6) if start else np.zeros(6)
    y = np.einsum("kstp,tp->ks", H, truth) + states @ x0
    y += 0.05 * np.std(y) * rng.standard_normal(y.shape)
    missing = rng.random(y.shape) < (0.1 if gaps else 0.0)
    there = ~missing.reshape(-1)
    flat = H.reshape(samples * sensors, samples * loads)[there]
    L = np.kron(np.diff(np.eye(samples), n=ORDER[penalty], axis=0), np.eye(loads))
    if start:
        flat = np.hstack([states.reshape(-1, 6)[there], flat])
        L = np.hstack([np.zeros((len(L), 6)), L])
    data = np.where(missing, np.nan, y)
    made = record(augment(A, B, C, D, penalty, unknown_start=start), data, missing)
    return Case(made, flat, L, y.reshape(-1)[there], 6 if start else 0, loads, h)


@pytest.mark.parametrize("penalty", PENALTIES)
@pytest.mark.parametrize("relative", [1e-1, 1e-3])
def test_it_is_the_non_negative_least_squares_solution(penalty: str, relative: float) -> None:
    c = case(penalty)
    lam = relative * c.scale
    found = NonNegativeRecord(c.record).solve(lam)
    expected = c.minimum(lam)
    np.testing.assert_allclose(found.load[:, 0], expected, atol=1e-8 * expected.max())
    assert found.converged
    assert found.gap < 1e-10
    assert np.all(found.load >= 0)
    assert np.all(found.load[found.held] == 0.0)
    pull = c.gram(lam) @ expected - c.H.T @ c.y
    np.testing.assert_allclose(found.multiplier[:, 0], np.maximum(pull, 0) * found.held[:, 0], atol=1e-8 * c.scale**2)
    assert found.residual2 == pytest.approx(np.sum((c.y - c.H @ expected) ** 2), rel=1e-8)
    assert found.penalty2 == pytest.approx(np.sum((c.L @ expected) ** 2), rel=1e-6)


@pytest.mark.parametrize("penalty", PENALTIES)
def test_several_sensors_and_loads_one_of_either_sign_missing_data_and_an_unknown_start(penalty: str) -> None:
    c = case(penalty, 100, sensors=3, loads=2, gaps=True, start=True)
    lam, signed = 0.05 * c.scale, np.array([True, False])
    expected = c.minimum(lam, signed)
    assert np.any(expected[c.states :].reshape(-1, 2)[:, 1] < 0)
    for given in (signed, [0]):
        found = NonNegativeRecord(c.record, given).solve(lam)
        np.testing.assert_allclose(found.load.reshape(-1), expected[c.states :], atol=1e-8 * np.abs(expected).max())
        np.testing.assert_allclose(found.start[:6], expected[:6], atol=1e-8 * np.abs(expected).max())
        assert not np.any(found.held[:, 1])
        assert found.gap < 1e-10


@pytest.mark.parametrize("penalty", PENALTIES)
def test_the_gap_bounds_how_far_a_load_is_from_the_minimum(penalty: str) -> None:
    c = case(penalty, 90)
    lam = 0.02 * c.scale
    normal = BlockNormal(NonNegativeRecord(c.record).blocks, lam)
    best, free, rng = c.minimum(lam), normal.factor(), np.random.default_rng(3)
    signed = np.arange(normal.size) >= normal.start
    lowest, half = c.objective(best, lam), np.sum(c.y**2) / 2
    for size in (1e-6, 1e-3, 1.0):
        g = np.maximum(best + size * rng.standard_normal(len(best)), 0.0)
        v = np.concatenate([history(g, ORDER[penalty]), g])
        stated = gap(normal, free, v, normal.gradient(v), signed)
        true = (c.objective(g, lam) - lowest) / half
        assert true <= stated * (1 + 1e-9) + 1e-14
        assert stated < 1e3 * true + 1e-5 * size  # and it closes with the distance


def history(g: NDArray, order: int) -> NDArray:
    """Free states before the record for which its first differences are zero: the load, and its slope."""
    return np.array([[], [g[0]], [2 * g[0] - g[1], g[1] - g[0]]][order], float)


@pytest.mark.parametrize("penalty", PENALTIES)
def test_scalars_and_spread_are_those_of_the_constrained_path(penalty: str) -> None:
    c = case(penalty, 120, sensors=2, gaps=True)
    dense = ConstrainedPath(SVDPath(LinearProblem.whitened(c.H, c.y, L=c.L)), NonNegative())
    relative = 0.02
    lam = relative * float(dense.scale)
    mine, point = NonNegativeRecord(c.record), dense.at(relative)
    found = mine.solve(lam)
    np.testing.assert_allclose(found.load[:, 0], dense.solution(relative, None).load, atol=1e-9 * found.load.max())
    assert found.residual2 == pytest.approx(float(point.residual2), rel=1e-9)
    assert found.penalty2 == pytest.approx(float(point.penalty2), rel=1e-9)
    face = mine.face_covariance(lam, found.held)
    assert point.edf is not None
    assert face.edf == pytest.approx(float(point.edf), rel=1e-9)
    free = ~found.held[:, 0]
    covariance = np.linalg.solve(c.gram(lam)[np.ix_(free, free)], np.eye(free.sum()))
    np.testing.assert_allclose(face.variance[free, 0], np.diag(covariance), rtol=1e-8)
    assert np.all(face.variance[~free] == 0)
    whole = np.diag(np.linalg.solve(c.gram(lam), np.eye(120)))
    np.testing.assert_allclose(mine.face_covariance(lam).variance[:, 0], whole, rtol=1e-8)
    assert np.all(face.variance[:, 0] <= whole * (1 + 1e-9))


def test_the_interior_point_route_ends_with_exact_zeros() -> None:
    y, _ = halfsine.record(11, 0.01, 0, 600)
    H = convolution(600)
    made = record(augment(*matrices(), "identity"), y[:, None])
    lam = 1e-4 * float(np.linalg.norm(H, 2))
    found = NonNegativeRecord(made).solve(lam)
    assert found.solver == "interior point, active set"
    expected = nnls(np.vstack([H, lam * np.eye(600)]), np.r_[y, np.zeros(600)], maxiter=30000)[0]
    np.testing.assert_allclose(found.load[:, 0], expected, atol=1e-6 * expected.max())
    assert found.gap < 1e-10
    assert np.array_equal(found.load[:, 0] == 0, found.held[:, 0])


def matrices() -> tuple[NDArray, NDArray, NDArray, NDArray]:
    s = halfsine.system()
    return s.A, s.B, s.C, s.D


def convolution(n: int) -> NDArray:
    from scipy.linalg import toeplitz

    return np.asarray(toeplitz(halfsine.impulse_response(n), np.zeros(n)))


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_no_answer_depends_on_units(factor: float) -> None:
    y, _ = halfsine.record(41, 0.05, 1, 500)
    A, B, C, D = matrices()
    first = NonNegativeRecord(record(augment(A, B, C, D, "first_difference"), y[:, None])).solve(1e-6)
    scaled = record(augment(A, B, factor * C, factor * D, "first_difference"), factor * y[:, None])
    other = NonNegativeRecord(scaled).solve(factor * 1e-6)
    np.testing.assert_allclose(other.load, first.load, rtol=0, atol=1e-9 * first.load.max())
    assert np.array_equal(other.held, first.held)
    assert other.converged


def test_a_long_record_meets_the_conditions_of_the_minimum() -> None:
    """Checked with products by FFT, which share nothing with the solver."""
    n, lam = 20_000, 1e-6
    y, g = halfsine.record(41, 0.01, 0, n)
    found = NonNegativeRecord(record(augment(*matrices(), "identity"), y[:, None])).solve(lam)
    load, held = found.load[:, 0], found.held[:, 0]
    back = halfsine.respond((halfsine.respond(load) - y)[::-1])[::-1]
    gradient = back + lam**2 * load
    size = np.abs(halfsine.respond(y[::-1])).max()
    assert np.abs(gradient[~held]).max() < 1e-10 * size
    assert gradient[held].min() > -1e-10 * size
    assert found.gap < 1e-6
    assert np.linalg.norm(load - g) < 0.1 * np.linalg.norm(g)


def test_lambda_by_discrepancy_reaches_the_noise_and_the_benchmark() -> None:
    errors = []
    for seed in range(3):
        y, g = halfsine.record(41, 0.01, seed)
        sigma = halfsine.level(halfsine.respond(g), 0.01)
        problem = NonNegativeRecord(record(augment(*matrices(), "identity"), y[:, None]))
        chosen = discrepancy(problem, 1e-6, sigma)
        assert chosen.met
        assert chosen.target == discrepancy_level(2000, sigma)
        assert chosen.solution.residual2 == pytest.approx(chosen.target, rel=0.01)
        assert chosen.solution.gap < 1e-6
        lams, residuals = zip(*sorted(chosen.tried), strict=True)
        assert len(lams) <= 12
        assert np.all(np.diff(residuals) >= 0)
        errors.append(np.linalg.norm(chosen.solution.load[:, 0] - g) / np.linalg.norm(g))
    assert np.mean(errors) <= 0.06


def test_a_pull_cannot_be_explained_by_pushes() -> None:
    y, g = halfsine.record(41, 0.01, 0, 600)
    sigma = halfsine.level(halfsine.respond(g), 0.01)
    problem = NonNegativeRecord(record(augment(*matrices(), "identity"), -y[:, None]))
    chosen = discrepancy(problem, 1e-6, sigma)
    assert not chosen.met
    assert chosen.solution.lam == 1e-6
    assert chosen.solution.residual2 > 10 * chosen.target


def test_silence_gives_no_load() -> None:
    A, B, C, D = matrices()
    for penalty in PENALTIES:
        found = NonNegativeRecord(record(augment(A, B, C, D, penalty), np.zeros((50, 1)))).solve(1e-6)
        assert np.all(found.load == 0)
        assert found.converged


def test_loads_of_either_sign_alone_are_the_unconstrained_solution() -> None:
    c = case("identity", 80, loads=2, sensors=2)
    lam = 0.1 * c.scale
    found = NonNegativeRecord(c.record, np.zeros(2, bool)).solve(lam)
    expected = np.linalg.lstsq(np.vstack([c.H, lam * c.L]), np.r_[c.y, np.zeros(160)], rcond=None)[0]
    np.testing.assert_allclose(found.load.reshape(-1), expected, atol=1e-10)
    assert found.gap < 1e-12


def test_warm_starts_change_nothing_but_the_steps() -> None:
    y, _ = halfsine.record(41, 0.01, 0, 1000)
    problem = NonNegativeRecord(record(augment(*matrices(), "identity"), y[:, None]))
    seen: list[float] = []
    near, cold = problem.solve(1.1e-6), problem.solve(1e-6, progress=lambda fraction, text: seen.append(fraction))
    warm = problem.solve(1e-6, near)
    np.testing.assert_allclose(warm.load, cold.load, atol=1e-10)
    assert warm.steps < cold.steps
    assert seen == sorted(seen)
    assert 0 < seen[0] < seen[-1] < 1


@pytest.mark.parametrize("lam", [0.0, -1.0, np.nan])
def test_lambda_is_positive(lam: float) -> None:
    with pytest.raises(InputError, match="lambda"):
        NonNegativeRecord(case("identity", 20).record).solve(lam)


@pytest.mark.parametrize("signed", [[2], [-1], [0.5], [True, False, True]])
def test_signs_belong_to_loads(signed: list) -> None:
    with pytest.raises(InputError, match="signed"):
        NonNegativeRecord(case("identity", 20, loads=2).record, signed)


def test_a_level_is_needed() -> None:
    with pytest.raises(InputError, match="noise"):
        discrepancy(NonNegativeRecord(case("identity", 20).record), 1.0, 0.0)


def test_a_lambda_that_is_lost_in_rounding_is_refused() -> None:
    c = case("identity", 40)
    c.record.D[:] = 0.0
    c.record.C[:] = 0.0
    normal = BlockNormal(NonNegativeRecord(c.record).blocks, 1e-200)
    with pytest.raises(NotIdentifiable, match="lambda"):
        minimise(normal, np.ones(normal.size, bool))


@pytest.mark.parametrize("penalty", PENALTIES)
def test_impulse_responses_give_the_same_loads(penalty: str) -> None:
    c = case(penalty, 120, sensors=2, loads=2, gaps=True)
    lam = 0.05 * c.scale
    seen = np.any(c.record.C[c.record.kind] != 0, axis=2).astype(float)
    h = c.h
    y = np.where(seen > 0, c.record.y, np.nan)
    found = NonNegativeRecord.convolved(h, y, penalty, weight=seen, signed=[1]).solve(lam)
    expected = NonNegativeRecord(c.record, [1]).solve(lam)
    np.testing.assert_allclose(found.load, expected.load, atol=1e-7 * np.abs(expected.load).max())
    assert found.gap < 1e-9
    assert np.array_equal(found.held, expected.held)


def test_impulse_responses_through_the_projected_gradient() -> None:
    y, _ = halfsine.record(3, 0.01, 0, 500)
    lam = 5e-4 * float(np.linalg.norm(convolution(500), 2))
    problem = NonNegativeRecord.convolved(halfsine.impulse_response(500)[:, None, None], y[:, None])
    found = problem.solve(lam)
    expected = NonNegativeRecord(record(augment(*matrices(), "identity"), y[:, None])).solve(lam)
    np.testing.assert_allclose(found.load, expected.load, atol=1e-5 * expected.load.max())
    assert found.converged
    assert found.solver.startswith("projected gradient")
    with pytest.raises(InputError, match="covariance"):
        problem.face_covariance(lam)


def test_loads_that_move() -> None:
    n, rng = 60, np.random.default_rng(4)
    F = np.repeat(0.9 * np.linalg.qr(rng.standard_normal((4, 4)))[0][None], n, 0)
    G, C, D = rng.standard_normal((n, 4, 1)), np.repeat(rng.standard_normal((1, 2, 4)), n, 0), np.zeros((n, 2, 1))
    y, H = rng.standard_normal((n, 2)), np.zeros((n, 2, n))
    for j in range(n):
        x = G[j, :, 0]
        for k in range(j + 1, n):
            H[k, :, j], x = C[k] @ x, F[k] @ x
    kinds = np.arange(n, dtype=np.int32)
    moving = WhitenedRecord(F, G, C, D, np.zeros((1, 4)), kinds, y, np.arange(0), y.size)
    found = NonNegativeRecord(moving).solve(0.5)
    expected = nnls(np.vstack([H.reshape(-1, n), 0.5 * np.eye(n)]), np.r_[y.reshape(-1), np.zeros(n)])[0]
    np.testing.assert_allclose(found.load[:, 0], expected, atol=1e-12)
