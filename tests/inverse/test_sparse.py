"""Sparse problems: the operator against dense columns, the minimum against an interior-point solver, the gap itself."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._inverse import rules
from loadid._inverse.sparse import groups, lasso
from loadid._inverse.sparse import lasso as workingset
from loadid._inverse.sparse import path as debias
from loadid._inverse.sparse.atoms import (
    DenseAtoms,
    Dictionary,
    MatrixAtoms,
    ShiftedAtoms,
    bspline,
    daubechies,
    dirac,
    wavelet,
)
from loadid._inverse.sparse.path import SparsePath, log_supports
from structures import InputError
from tests import halfsine

SHORT = 90


def decaying(samples: int = SHORT, sensors: int = 2, loads: int = 2) -> np.ndarray:
    """Impulse responses (samples, sensors, loads), some of which die away within the record."""
    t = np.arange(samples)
    return np.stack(
        [
            [np.exp(-t * (0.3 + 0.1 * s + 0.4 * p)) * np.cos(0.5 * t * (1 + s + p)) for p in range(loads)]
            for s in range(sensors)
        ]
    ).transpose(2, 0, 1)


def dictionary(name: str, samples: int = SHORT) -> Dictionary:
    if name == "bspline":
        return bspline(samples, 5)
    return dirac(samples) if name == "dirac" else wavelet(samples)


def matrix_of(h: np.ndarray, D: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """H D by plain convolution, the loads of an atom side by side."""
    samples, sensors, loads = h.shape
    columns = [
        (np.column_stack([np.convolve(h[:, s, p], d)[:samples] for s in range(sensors)]) * weight).reshape(-1)
        for d in D.T
        for p in range(loads)
    ]
    return np.column_stack(columns)


# -- operator ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("name", ["dirac", "bspline", "wavelet"])
def test_products_columns_and_gram_blocks_are_those_of_the_matrix(name, missing):
    h, words = decaying(), dictionary(name)
    weight = np.ones((SHORT, 2))
    if missing:
        weight[30:33, 1] = weight[61] = weight[-1, 0] = 0
    atoms = ShiftedAtoms(h, words, weight if missing else None)
    A = matrix_of(h, words.synthesise(np.eye(words.atoms)), weight)
    rng = np.random.default_rng(0)
    x, r = rng.standard_normal(atoms.n), rng.standard_normal(atoms.m)
    np.testing.assert_allclose(atoms.apply(x), A @ x, atol=1e-12)
    np.testing.assert_allclose(atoms.adjoint(r), A.T @ r, atol=1e-12)
    np.testing.assert_allclose(atoms.columns(np.arange(atoms.n)), A, atol=1e-12)
    rows, columns = rng.permutation(atoms.n), rng.permutation(atoms.n)[: atoms.n // 3]
    dies = atoms._dies(rows)
    assert dies.any()
    assert not dies.all()  # both ways of forming products are used
    np.testing.assert_allclose(atoms.gram(rows, columns), A[:, rows].T @ A[:, columns], atol=1e-8)
    support = np.array([0, atoms.n // 2, atoms.n - 1])
    single = np.column_stack([atoms.history(np.eye(atoms.n)[j]).reshape(-1) for j in support])
    np.testing.assert_allclose(atoms.histories(support).toarray(), single, atol=1e-14)


@pytest.mark.parametrize(("samples", "knots"), [(200, 1), (203, 3), (130, 16)])
def test_running_sums_are_the_products_of_columns(samples, knots, monkeypatch):
    """Responses that never die away, at every remainder of the record over the spacing."""
    h = np.random.default_rng(1).standard_normal((samples, 2, 2))
    words = dirac(samples) if knots == 1 else bspline(samples, knots)
    atoms = ShiftedAtoms(h, words)
    rng = np.random.default_rng(0)
    rows, columns = rng.permutation(atoms.n), rng.permutation(atoms.n)[: atoms.n // 2]
    A = atoms.columns(np.arange(atoms.n))
    expected = A[:, rows].T @ A[:, columns]
    np.testing.assert_allclose(atoms.gram(rows, columns), expected, atol=1e-13 * np.abs(expected).max())
    assert len(atoms._sums) == 4
    monkeypatch.setattr("loadid._inverse.sparse.atoms.TABLE", 0)
    few = ShiftedAtoms(h, words)
    np.testing.assert_allclose(few.gram(rows, columns), expected, atol=1e-13 * np.abs(expected).max())
    assert not few._sums


def test_a_matrix_of_the_user_is_a_dictionary():
    h, D = decaying(), np.random.default_rng(0).standard_normal((SHORT, 7))
    atoms = MatrixAtoms(h, D)
    A = matrix_of(h, D, np.ones((SHORT, 2)))
    np.testing.assert_allclose(atoms.columns(np.arange(14)), A, atol=1e-12)
    x = np.arange(14.0)
    np.testing.assert_allclose(atoms.history(x), D @ x.reshape(7, 2), atol=1e-12)
    np.testing.assert_allclose(atoms.histories(np.array([3])).toarray()[:, 0], atoms.history(np.eye(14)[3]).ravel())


def test_a_matrix_that_does_not_fit_in_memory_is_refused(monkeypatch):
    monkeypatch.setattr("loadid._inverse.sparse.atoms.LARGEST", 1000)
    with pytest.raises(InputError, match="too large"):
        MatrixAtoms(decaying(), np.eye(SHORT))


def test_the_daubechies_filter_of_two_moments_is_the_closed_form():
    root = np.sqrt(3)
    expected = np.array([1 + root, 3 + root, 3 - root, 1 - root]) / (4 * np.sqrt(2))
    np.testing.assert_allclose(daubechies(2), expected, atol=1e-12)


def test_wavelets_are_orthonormal_inside_the_record_and_complete():
    words = wavelet(512)
    W = words.synthesise(np.eye(words.atoms))
    inside = np.abs(np.sum(W**2, axis=0) - 1) < 1e-8
    assert inside.sum() > 400
    np.testing.assert_allclose(W[:, inside].T @ W[:, inside], np.eye(inside.sum()), atol=1e-8)
    assert np.linalg.matrix_rank(W) == 512


def test_splines_sum_to_a_constant_and_bend_like_cubics():
    words = bspline(200, 8)
    g = words.synthesise(np.ones((words.atoms, 1)))[:, 0]
    np.testing.assert_allclose(g[16:176], 1.5, atol=1e-12)
    single = words.families[0].waveform
    assert len(single) == 31
    assert np.ptp(np.diff(single[:8], 3)) < 1e-12  # one cubic between two knots


# -- minimum ----------------------------------------------------------------------------------------------------------
def interior_point(A, y, mu, *, labels=None, nonnegative=False) -> float:
    """Minimum of the problem by clarabel."""
    clarabel = pytest.importorskip("clarabel")
    from scipy import sparse

    m, n = A.shape
    count = n if labels is None else int(labels.max()) + 1
    P = sparse.block_diag([sparse.csc_matrix((n, n)), sparse.eye(m), sparse.csc_matrix((count, count))], format="csc")
    q = np.concatenate([np.zeros(n + m), np.full(count, mu)])
    eye, none = sparse.eye(n), sparse.csc_matrix((n, m))
    rows = [sparse.hstack([sparse.csc_matrix(A), sparse.eye(m), sparse.csc_matrix((m, count))])]
    cones, right = [clarabel.ZeroConeT(m)], [y]
    if labels is None:
        other = sparse.hstack([-eye, none, sparse.csc_matrix((n, n)) if nonnegative else -eye])
        rows += [sparse.hstack([eye, none, -eye]), other]
        right, cones = [*right, np.zeros(2 * n)], [*cones, clarabel.NonnegativeConeT(2 * n)]
    else:
        for g in range(count):
            members = np.flatnonzero(labels == g)
            block = sparse.lil_matrix((len(members) + 1, n + m + count))
            block[0, n + m + g] = -1
            for k, j in enumerate(members):
                block[k + 1, j] = -1
            rows.append(block)
            right.append(np.zeros(len(members) + 1))
            cones.append(clarabel.SecondOrderConeT(len(members) + 1))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    solver = clarabel.DefaultSolver(P, q, sparse.vstack(rows, format="csc"), np.concatenate(right), cones, settings)
    x = np.array(solver.solve().x[:n])
    size = np.abs(x).sum() if labels is None else sum(np.linalg.norm(x[labels == g]) for g in range(count))
    return float(0.5 * np.sum((A @ x - y) ** 2) + mu * size)


def struck(samples: int = 500, noise: float = 0.05):
    """Spikes on the first samples of the half-sine benchmark, its noise and the whitened data."""
    y, _ = halfsine.record(11, noise, 0, samples)
    return ShiftedAtoms(halfsine.impulse_response(samples)[:, None, None], dirac(samples)), y


@pytest.mark.parametrize("nonnegative", [False, True])
def test_the_minimum_is_that_of_an_interior_point_method(nonnegative):
    atoms, y = struck()
    mu = 0.02 * lasso.largest(atoms, y, nonnegative=nonnegative)
    found = workingset.solve(atoms, y, lasso.L1(mu, nonnegative=nonnegative), tol=1e-9)
    assert found.converged
    assert found.gap < 1e-9
    assert len(found.support) > 3
    assert not nonnegative or found.x.min() == 0
    size = np.linalg.norm(y)  # the interior-point method measures its gap in absolute terms too
    other = interior_point(atoms.columns(np.arange(atoms.n)) / size, y / size, mu / size**2, nonnegative=nonnegative)
    assert 0.5 * found.objective == pytest.approx(other, rel=1e-6)


def test_the_minimum_is_that_of_celer():
    celer = pytest.importorskip("celer")
    atoms, y = struck()
    mu = 0.02 * lasso.largest(atoms, y)
    found = workingset.solve(atoms, y, lasso.L1(mu), tol=1e-9)
    A = np.asfortranarray(atoms.columns(np.arange(atoms.n)))
    other = celer.Lasso(alpha=mu / len(y), tol=1e-9, fit_intercept=False).fit(A, y).coef_
    value = 0.5 * np.sum((A @ other - y) ** 2) + mu * np.abs(other).sum()
    assert found.objective * 0.5 * (y @ y) <= value * (1 + 1e-9)
    assert found.objective * 0.5 * (y @ y) == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("of", ["slot", "load"])
def test_the_minimum_over_groups_is_that_of_an_interior_point_method(of):
    h = decaying(60)
    atoms = ShiftedAtoms(h, bspline(60, 3))
    g = np.zeros((60, 2))
    g[20:26, 0], g[40:43, 1] = 3, -2
    y = atoms.operator.apply(g).reshape(-1) + 0.05 * np.random.default_rng(0).standard_normal(atoms.m)
    partition = groups.Groups(getattr(atoms, of))
    for share in (0.3, 0.02):
        mu = share * groups.largest(atoms, y, partition)
        found = groups.solve(atoms, y, mu, partition, tol=1e-9)
        assert found.converged
        other = interior_point(atoms.columns(np.arange(atoms.n)), y, mu, labels=partition.labels)
        assert found.objective * 0.5 * (y @ y) == pytest.approx(other, rel=1e-7)


def test_weights_are_a_scaling_of_the_columns():
    rng = np.random.default_rng(0)
    A, y, w = rng.standard_normal((40, 60)), rng.standard_normal(40), rng.uniform(0.5, 2, 60)
    found = workingset.solve(DenseAtoms(A), y, lasso.L1(1.5, w), tol=1e-12)
    scaled = workingset.solve(DenseAtoms(A / w), y, lasso.L1(1.5), tol=1e-12)
    np.testing.assert_allclose(found.x, scaled.x / w, atol=1e-9)


def test_the_gap_bounds_the_distance_from_the_minimum_and_is_zero_there_only():
    atoms, y = struck(300)
    penalty = lasso.L1(0.05 * lasso.largest(atoms, y))
    best = workingset.solve(atoms, y, penalty, tol=1e-12)
    rng = np.random.default_rng(0)
    for size in (1e-1, 1e-3, 1e-5):
        x = best.x + size * np.abs(best.x).max() * rng.standard_normal(atoms.n)
        r = y - atoms.apply(x)
        value, gap = lasso.gap(y, r, penalty.value(x, np.arange(atoms.n)), penalty.dual_scale(atoms.adjoint(r)))
        assert gap >= value - best.objective > 0
    assert best.gap < 1e-12


def test_an_iterate_that_has_not_converged_says_so(monkeypatch):
    atoms, y = struck(300)
    monkeypatch.setattr(workingset, "ROUNDS", 2)
    found = workingset.solve(atoms, y, lasso.L1(1e-3 * lasso.largest(atoms, y)))
    assert not found.converged
    assert found.gap > 1e-6


@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_do_not_change_a_solution(factor):
    atoms, y = struck(300)
    scaled = ShiftedAtoms(factor * halfsine.impulse_response(300)[:, None, None], dirac(300))
    first = SparsePath(atoms, y).solve(0.01, 1e-10)
    second = SparsePath(scaled, factor * y).solve(0.01, 1e-10)
    np.testing.assert_allclose(second.x, first.x, atol=1e-7 * np.abs(first.x).max())
    assert second.gap < 1e-10


def test_a_long_record_is_solved_as_its_own_convolution_certifies():
    """20000 samples, which no matrix is made for: the gap from numpy's convolution alone."""
    samples, taps = 20_000, 6000
    h = halfsine.impulse_response(taps)
    y, _ = halfsine.record(11, 0.05, 0, samples)
    atoms = ShiftedAtoms(h[:, None, None], dirac(samples))
    mu = 0.02 * lasso.largest(atoms, y)
    found = workingset.solve(atoms, y, lasso.L1(mu), tol=1e-8)
    from scipy.signal import oaconvolve

    r = y - oaconvolve(found.x, h)[:samples]
    c = oaconvolve(r[::-1], h)[:samples][::-1]
    theta = r * min(1, mu / np.abs(c).max())
    half = 0.5 * y @ y
    gap = 0.5 * r @ r + mu * np.abs(found.x).sum() - (half - 0.5 * np.sum((y - theta) ** 2))
    assert gap / half < 1e-7
    assert len(found.support) > 50


# -- path, amplitudes -------------------------------------------------------------------------------------------------
def test_the_discrepancy_rule_meets_the_noise():
    atoms, y = struck()
    sigma = halfsine.level(halfsine.respond(halfsine.pulses(11, 500)), 0.05)
    along = SparsePath(atoms, y)
    found = rules.discrepancy(along.to_noise(sigma))
    r = along.solve(found.lam).residual
    assert not found.edge
    assert 0.98 < r @ r / (sigma**2 * 500) <= 1.0 + 1e-3


def test_every_rule_runs_on_the_path_or_refuses_by_name():
    """The size of the support is the number of degrees of freedom; what that does not give is refused."""
    atoms, y = struck()
    sigma = halfsine.level(halfsine.respond(halfsine.pulses(11, 500)), 0.05)
    sweep = SparsePath(atoms, y).sweep(sigma)
    asked = {name: rules.run(name, sweep) for name in rules.RULES}
    refused = {name for name, found in asked.items() if found.lam is None}
    assert refused == {"robust_gcv", "predicted_error", "l_curve", "quasi_optimality", "evidence"}
    assert all(name in asked[name].note for name in refused)
    p, m = sweep.point, 500
    assert asked["upre"].lam == sweep.lam[np.argmin(p.residual2 + 2 * sigma**2 * p.edf)]
    assert asked["gcv"].lam == sweep.lam[np.argmin(p.residual2 / (m - p.edf) ** 2)]


def test_the_extended_criterion_counts_the_supports():
    from math import comb, log

    supports = log_supports(40, 3)
    assert rules.information(50.0, 3, supports, 100, 1.0) == pytest.approx(50 + 3 * log(100) + 2 * log(comb(40, 3)))
    assert rules.information(50.0, 3, supports, 100, None) == pytest.approx(
        100 * log(0.5) + 3 * log(100) + 2 * log(comb(40, 3))
    )


def test_amplitudes_are_least_squares_with_their_covariance(monkeypatch):
    atoms, y = struck(300)
    support = np.array([60, 90, 91, 200])
    A = atoms.columns(support)
    expected = np.linalg.lstsq(A, y, rcond=None)[0]
    found = debias.fit(atoms, y, support)
    np.testing.assert_allclose(found.x, expected, rtol=1e-9)
    covariance = np.linalg.solve(A.T @ A, np.eye(4))
    np.testing.assert_allclose(found.std, np.sqrt(np.diag(covariance)), rtol=1e-6)
    monkeypatch.setattr(debias, "FACTORISED", 0)  # as if the columns did not fit in memory
    again = debias.fit(atoms, y, support)
    np.testing.assert_allclose(again.x, expected, rtol=1e-8)
    np.testing.assert_allclose(again.std, found.std, rtol=1e-4)


def test_amplitudes_keep_their_signs():
    from scipy.optimize import nnls

    rng = np.random.default_rng(0)
    A, y = rng.standard_normal((30, 8)), rng.standard_normal(30)
    found = debias.fit(DenseAtoms(A), y, np.arange(8), signs=np.ones(8))
    np.testing.assert_allclose(found.full(8), nnls(A, y)[0], atol=1e-10)


def test_reweighting_holds_small_coefficients_down():
    atoms, y = struck()
    along = SparsePath(atoms, y)
    first = along.solve(0.01)
    second = along.reweighted(first.x).solve(0.01)
    assert len(second.support) < len(first.support)
    assert np.abs(second.x).max() >= np.abs(first.x).max()  # less shrinkage of what is large
