"""Faces of few data for many loads, against dense matrices written out here."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import csr_array

from loadid._inverse.constrained.few import Band, FewFace, FewRows, Scales
from loadid._inverse.constrained.path import ConstrainedPath
from loadid._inverse.constrained.quadratic import Quadratic
from loadid._inverse.constrained.solver import FEW
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.paths import LinearProblem, SVDPath

Array = NDArray[np.float64]
LOADS, DATA = 40, 9
FIELDS = ("residual2", "penalty2", "edf", "edf2", "left", "rest2", "rest4", "sensitivity")


def second(n: int) -> Array:
    """Second differences, (n - 2, n)."""
    return np.diff(np.eye(n), 2, axis=0)


def made(rng: np.random.Generator, L: Array | None) -> tuple[Array, Array, Array, FewFace]:
    """Rows, the prior's rows, two held rows, and the face."""
    C, E = rng.standard_normal((DATA, LOADS)), rng.standard_normal((2, LOADS))
    if L is None:
        own = rng.uniform(0.5, 2, LOADS)
        return C, np.diag(own), E, FewFace(C, Scales(own), E)
    prior = np.vstack([0.3 * L, np.diag(np.zeros(LOADS))])
    return C, prior, E, FewFace(C, Band.of(csr_array(L), np.arange(LOADS), 0.3, np.zeros(LOADS)), E)


@pytest.mark.parametrize("L", [None, second(LOADS), np.diff(np.eye(LOADS), axis=0)[[*range(20), *range(21, 39)]]])
def test_step_is_the_minimum_on_the_rows(L: Array | None) -> None:
    """Kuhn-Tucker system, solved as one; the penalties leave one or two patterns free, the last one two."""
    rng = np.random.default_rng(1)
    C, prior, E, face = made(rng, L)
    rest, slope, short = rng.standard_normal(DATA), rng.standard_normal(LOADS), rng.standard_normal(2)
    M = C.T @ C + prior.T @ prior
    whole = np.block([[M, E.T], [E, np.zeros((2, 2))]])
    want = np.linalg.solve(whole, np.r_[-C.T @ rest - slope, short])
    x, nu = face.step(rest, slope, short)
    np.testing.assert_allclose(x, want[:LOADS], atol=1e-9 * np.abs(want).max())
    np.testing.assert_allclose(nu, want[LOADS:], atol=1e-9 * np.abs(want).max())


@pytest.mark.parametrize("L", [None, second(LOADS)])
def test_modes_are_those_of_the_covariance(L: Array | None) -> None:
    """F F^T is the inverse of the Hessian, and what passes are the eigenvalues of the influence of the data."""
    rng = np.random.default_rng(2)
    C, prior, _, _ = made(rng, L)
    root = Scales(np.diag(prior)) if L is None else Band.of(csr_array(L), np.arange(LOADS), 0.3, np.zeros(LOADS))
    face = FewFace(C, root, np.zeros((0, LOADS)))
    inverse = np.linalg.inv(C.T @ C + prior.T @ prior)
    np.testing.assert_allclose(face.factor @ face.factor.T, inverse, atol=1e-9 * np.abs(inverse).max())
    shares = np.sort(np.linalg.eigvalsh(C @ inverse @ C.T))
    np.testing.assert_allclose(np.sort(face.passed), shares, atol=1e-10)
    np.testing.assert_allclose(np.sort(1 - face.left), shares, atol=1e-10)
    slope = rng.standard_normal(LOADS)
    assert face.change(slope) == pytest.approx(np.linalg.norm(inverse @ slope), rel=1e-9)


def test_band_is_the_triangle_of_a_dense_qr_also_where_pivots_vanish() -> None:
    """R^T R = L^T L on some columns, with rows in no order; what it grounds is the null space."""
    L = np.zeros((6, 6))
    L[[0, 1], 0], L[[0, 1], 1], L[1, 2], L[2, 3], L[2, 4] = 1.0, -1.0, 1.0, 1.0, -1.0
    band = Band.of(csr_array(L), np.arange(6), 2.0, np.zeros(6))
    assert len(band.free) == 6 - np.linalg.matrix_rank(L)
    R = np.zeros((6, 6))
    for j, row in enumerate(band.R):
        R[j, j : j + len(row)] = 0.0 if j in band.free else row[: 6 - j]
    np.testing.assert_allclose(R.T @ R, 4 * L.T @ L, atol=1e-14)
    z = np.random.default_rng(0).standard_normal(6)
    np.testing.assert_allclose(band.rows(np.eye(6)) @ z, band.up(z), atol=1e-13)


@pytest.mark.parametrize("L", [None, np.diff(np.eye(60), axis=0)])
def test_a_face_is_kept_for_its_unknowns_alone(L: Array | None) -> None:
    """Another set of free unknowns, or a weight on them, has factors of its own."""
    q = ConstrainedPath(SVDPath(problem(L, False)), [NonNegative()]).prepare(0.05).quadratic
    rng, dense = np.random.default_rng(4), q.A.T @ q.A
    f, other = np.arange(0, 60, 2), np.arange(1, 60, 2)
    assert q.face(f) is q.face(f.copy())
    assert q.face(other) is not q.face(f)
    for free, weight in ((f, 0.0), (other, 0.0), (other, 0.3), (other, 0.0)):
        right, held = rng.standard_normal(60), np.full(60, np.inf)
        held[free] = weight
        want = np.linalg.solve(dense[np.ix_(free, free)] + weight * np.eye(len(free)), right[free])
        np.testing.assert_allclose(q.factor(held).solve(right)[free], want, atol=1e-8 * np.abs(want).max())
    assert not q.factor(np.full(60, np.inf)).solve(rng.standard_normal(60)).any()  # all are held


def problem(L: Array | None, cones: bool) -> LinearProblem:
    """Two pushes seen through a blurred line, or contacts that slide."""
    rng, x = np.random.default_rng(5), np.linspace(0, 1, 60)
    at = np.linspace(0.05, 0.95, 14)
    H = 0.05 / (0.05**2 + (at[:, None] - x) ** 2)
    g = np.exp(-((x - 0.3) ** 2) / 0.004) + 0.5 * np.exp(-((x - 0.75) ** 2) / 0.002)
    if cones:
        g = g.reshape(-1, 3) * [0.3, 0.1, 1.0]
    y = H @ g.ravel()
    return LinearProblem.whitened(H, y + 0.01 * np.std(y) * rng.standard_normal(len(y)), np.ones(len(y)), L)


CASES = {
    "signs": ([NonNegative()], None),
    "bounds": ([Bounds(0.0, 0.6), Support(np.arange(5, 55))], None),
    "resultant": ([Resultant(np.ones((1, 60)), [9.0])], None),
    "both": ([NonNegative(), Resultant(np.ones((1, 60)), [9.0])], None),
    "cones": ([FrictionCone(0.4, np.arange(60).reshape(-1, 3))], None),
    "signs, gradient": ([NonNegative()], np.diff(np.eye(60), axis=0)),
    "signs, second differences": ([NonNegative()], second(60)),
    "resultant, gradient": ([Resultant(np.ones((1, 60)), [9.0])], np.diff(np.eye(60), axis=0)),
}


@pytest.mark.parametrize("name", CASES)
def test_path_is_that_of_the_dense_objective(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Scalars, load, std and the gap of a path, with and without the faces of few data."""
    constraints, L = CASES[name]
    given = problem(L, name == "cones")
    lam = np.geomspace(1e-5, 2.0, 9)
    few = ConstrainedPath(SVDPath(given), constraints)
    assert isinstance(few.prepare(0.01).quadratic, FewRows)
    monkeypatch.setattr("loadid._inverse.constrained.solver.FEW", 0.0)
    dense = ConstrainedPath(SVDPath(given), constraints)
    assert FEW > 0
    assert not isinstance(dense.prepare(0.01).quadratic, FewRows)
    one, other = few.at(lam), dense.at(lam)
    for field in FIELDS:
        a, b = getattr(one, field), getattr(other, field)
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-8 * np.abs(b).max(), err_msg=field)
    for x in (1e-3, 1e-1):
        a, b = few.solution(x, 1.0), dense.solution(x, 1.0)
        assert a.posterior is not None
        assert b.posterior is not None
        np.testing.assert_allclose(a.load, b.load, atol=1e-8 * np.abs(b.load).max())
        np.testing.assert_allclose(a.posterior.std, b.posterior.std, atol=1e-8 * b.posterior.std.max())
        np.testing.assert_allclose(a.posterior.noise_std, b.posterior.noise_std, atol=1e-8 * b.posterior.std.max())
        assert few.solve(x).gap < 1e-10


def test_interior_point_of_few_rows_is_that_of_the_whole() -> None:
    """The conic program with the rows as unknowns of their own has the answer of the one with the whole matrix."""
    from loadid._inverse.constrained.activeset import interior_point

    rng = np.random.default_rng(3)
    path = ConstrainedPath(SVDPath(problem(None, True)), [FrictionCone(0.4, np.arange(60).reshape(-1, 3))])
    prepared = path.prepare(0.02)
    b = prepared.compress(rng.standard_normal(14))[0]
    few = interior_point(prepared.quadratic, b, prepared.feasible)
    whole = interior_point(Quadratic(prepared.quadratic.A, prepared.feasible), b, prepared.feasible)
    assert few is not None
    assert whole is not None
    np.testing.assert_allclose(few.h, whole.h, atol=1e-6 * np.abs(whole.h).max())
