"""The constrained path against closed forms, other solvers, and the conditions that only a solution meets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import nnls

from loadid import constraints as cones
from loadid._inverse.constrained.path import ConstrainedPath
from loadid._inverse.posterior import from_arrays
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.paths import LinearProblem, RegularizationPath, SVDPath, choose

CONTACTS = np.arange(12).reshape(4, 3)
TOTAL = np.kron(np.ones((1, 4)), np.eye(3))


def problem(m: int = 20, n: int = 12, seed: int = 0, L: np.ndarray | None = None, frames: int | None = None) -> SVDPath:
    rng = np.random.default_rng(seed)
    H = rng.standard_normal((m, n)) @ np.diag(np.geomspace(1, 0.05, n))
    y = rng.standard_normal(m if frames is None else (frames, m))
    return SVDPath(LinearProblem.whitened(H, y, L=L)) if frames is None else SVDPath(
        LinearProblem(H, y.T, L, y.shape, (n,))
    )  # fmt: skip


def difference(n: int = 12) -> np.ndarray:
    return np.diff(np.eye(n), axis=0)


def gradient(path: SVDPath, lam: float, g: np.ndarray) -> np.ndarray:
    H, y, L = path.problem.H, path.problem.y, path.problem.L
    x2 = (lam * float(path.scale)) ** 2
    return H.T @ (H @ g - y) + x2 * (g if L is None else L.T @ (L @ g))


def pushed(constraints: list, multipliers: tuple, n: int) -> np.ndarray:
    """What the multipliers make of the gradient, constraint by constraint."""
    out = np.zeros(n)
    for c, push in zip(constraints, multipliers, strict=True):
        if isinstance(c, Resultant):
            out += np.asarray(c.C).T @ push
        elif isinstance(c, FrictionCone):
            np.add.at(out, c.contacts, push)
        elif isinstance(c, Support):
            out += push
        else:
            out[slice(None) if c.loads is None else c.loads] += push
    return out


PARTS = {
    "sign": NonNegative([2, 5]),
    "bounds": Bounds(-0.3, np.linspace(0.1, 0.4, 12)),
    "support": Support(np.arange(3, 12)),
    "exact": Resultant(TOTAL[1:], [0.05, 0.4]),
    "soft": Resultant(TOTAL[:2], [0.1, -0.1], [[0.04, 0.01], [0.01, 0.09]]),
    "cone": FrictionCone(0.4, CONTACTS),
    "pyramid": FrictionCone(0.4, CONTACTS, facets=6),
}
MIXED = [
    names
    for size in (1, 2, 3, 5)
    for names in itertools.combinations(PARTS, size)
    if not {"cone", "pyramid"} <= set(names)
][::2]


def by_clarabel(path: SVDPath, constraints: list, lam: float) -> np.ndarray:
    """Independent: the specs written out for the interior-point solver, objective by its augmented rows."""
    import clarabel
    import scipy.sparse as sp

    H, y, L = path.problem.H, path.problem.y, path.problem.L
    n, x = H.shape[1], lam * float(path.scale)
    rows, right = [H, x * (np.eye(n) if L is None else L)], [y, np.zeros(n if L is None else len(L))]
    zero, below, soc = [], [], []
    for c in constraints:
        loads = np.arange(n) if getattr(c, "loads", None) is None else np.asarray(c.loads)
        if isinstance(c, NonNegative):
            below += [(-np.eye(n)[j], 0.0) for j in loads]
        elif isinstance(c, Bounds):
            below += [(-np.eye(n)[j], -v) for j, v in zip(loads, np.broadcast_to(c.lower, len(loads)), strict=True)]
            below += [(np.eye(n)[j], v) for j, v in zip(loads, np.broadcast_to(c.upper, len(loads)), strict=True)]
        elif isinstance(c, Support):
            zero += [(np.eye(n)[j], 0.0) for j in range(n) if j not in set(loads.tolist())]
        elif isinstance(c, Resultant) and c.hard:
            zero += list(zip(c.C, c.value, strict=True))
        elif isinstance(c, Resultant):
            W = np.linalg.cholesky(np.linalg.solve(c.covariance, np.eye(len(c.C)))).T
            rows.append(W @ c.C)
            right.append(W @ c.value)
        else:
            for i, (k, mu) in enumerate(zip(c.contacts, c.mu, strict=True)):
                Q = np.eye(3) if c.normals is None else cones.frames(c.normals[i : i + 1])[0]
                local = Q.T @ np.eye(n)[k]
                if c.facets is None:
                    soc.append(np.vstack([mu * local[2], local[:2]]))
                else:
                    angle = 2 * np.pi * np.arange(c.facets) / c.facets
                    steep = mu * (np.cos(np.pi / c.facets) if c.inner else 1)
                    below += [(np.cos(a) * local[0] + np.sin(a) * local[1] - steep * local[2], 0.0) for a in angle]
    A, b = np.vstack(rows), np.concatenate(right)
    below = [(row, v) for row, v in below if np.isfinite(v)]
    k = len(A)
    matrix = [np.hstack([A, -np.eye(k)])] + [np.r_[row, np.zeros(k)][None] for row, _ in (*zero, *below)]
    values = [b] + [np.array([v]) for _, v in (*zero, *below)]
    matrix += [np.hstack([-block, np.zeros((3, k))]) for block in soc]
    values += [np.zeros(3)] * len(soc)
    kinds = [clarabel.ZeroConeT(k + len(zero))]
    kinds += [clarabel.NonnegativeConeT(len(below))] if below else []
    kinds += [clarabel.SecondOrderConeT(3)] * len(soc)
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-12
    P = sp.diags(np.r_[np.zeros(n), np.ones(k)]).tocsc()
    found = clarabel.DefaultSolver(
        P, np.zeros(n + k), sp.csc_matrix(np.vstack(matrix)), np.concatenate(values), kinds, settings
    ).solve()
    return np.array(found.x)[:n]


@pytest.mark.parametrize("names", MIXED, ids="+".join)
@pytest.mark.parametrize("smooth", [False, True])
def test_every_mixture_meets_the_conditions_of_a_minimum_and_agrees_with_clarabel(names: tuple, smooth: bool) -> None:
    base = problem(L=difference() if smooth else None)
    constraints = [PARTS[name] for name in names]
    found = ConstrainedPath(base, constraints).solve(0.05)
    assert found.converged
    assert found.violation < 1e-9
    assert found.gap < 1e-10
    g = found.load
    np.testing.assert_allclose(gradient(base, 0.05, g), pushed(constraints, found.multipliers, 12), atol=1e-9)
    for c, push in zip(constraints, found.multipliers, strict=True):
        if isinstance(c, NonNegative):
            assert np.all(push >= 0)
            assert np.all(g[c.loads] >= -1e-9)
            np.testing.assert_allclose(push * g[c.loads], 0, atol=1e-9)
        elif isinstance(c, FrictionCone):
            np.testing.assert_allclose(np.sum(push * g[c.contacts]), 0, atol=1e-9)
        elif isinstance(c, Support):
            assert np.all(g[:3] == 0)
    np.testing.assert_allclose(g, by_clarabel(base, constraints, 0.05), atol=1e-6)


@pytest.mark.parametrize(("m", "n"), [(30, 20), (20, 20), (12, 20)])
@pytest.mark.parametrize("lam", [1e-1, 1e-3, 1e-5])
def test_signs_against_nnls(m: int, n: int, lam: float) -> None:
    base = problem(m, n, L=difference(n))
    g = ConstrainedPath(base, NonNegative()).solve(lam).load
    S = np.vstack([base.problem.H, lam * float(base.scale) * difference(n)])
    expected = nnls(S, np.r_[base.problem.y, np.zeros(n - 1)])[0]
    np.testing.assert_allclose(g, expected, rtol=0, atol=1e-10)  # no digits lost to the Gram matrix


def test_faces_that_cycle_are_left_by_proximal_steps() -> None:
    x = (np.arange(200) + 0.5) / 200
    H = 0.1 / np.pi / (0.01 + (x[:, None] - x) ** 2) / 200
    y = H @ np.exp(-0.5 * ((x - 0.4) / 0.05) ** 2)
    y = y + 0.01 * np.sqrt(np.mean(y**2)) * np.random.default_rng(1).standard_normal(200)
    base = SVDPath(LinearProblem.whitened(H, y))
    for lam in (1e-4, 1e-8):
        found = ConstrainedPath(base, [NonNegative()]).solve(lam)
        S = np.vstack([H, lam * float(base.scale) * np.eye(200)])
        ref = nnls(S, np.r_[y, np.zeros(200)])[0]
        assert found.solver == "active set, proximal"
        assert found.gap < 1e-12
        np.testing.assert_allclose(found.load, ref, atol=1e-7 * ref.max())


def test_orthonormal_operators_have_closed_forms() -> None:
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((15, 12)))[0]
    y = np.random.default_rng(1).standard_normal(15)
    base = SVDPath(LinearProblem.whitened(Q, y))
    seen = Q.T @ y
    np.testing.assert_allclose(ConstrainedPath(base, NonNegative()).solve(0.0).load, np.maximum(seen, 0), atol=1e-14)
    bounded = ConstrainedPath(base, Bounds(-0.2, 0.1)).solve(0.5).load
    np.testing.assert_allclose(bounded, np.clip(seen / 1.25, -0.2, 0.1), atol=1e-14)
    v = (seen / 1.25)[CONTACTS]
    nearest = cones.project(v, cones.faces(v, np.full(4, 0.3), np.zeros(4, int)))
    found = ConstrainedPath(base, FrictionCone(0.3, CONTACTS)).solve(0.5).load
    np.testing.assert_allclose(found[CONTACTS], nearest, atol=1e-13)
    exact = ConstrainedPath(base, Resultant(np.ones((1, 12)), [3.0])).solve(0.5)
    np.testing.assert_allclose(exact.load, seen / 1.25 + (3 - seen.sum() / 1.25) / 12, atol=1e-13)


@pytest.mark.parametrize("name", ["sign", "exact", "cone", "pyramid", "bounds"])
def test_a_warm_start_changes_nothing(name: str) -> None:
    base, constraints = problem(), [PARTS[name], PARTS["soft"]]
    other = base.problem.y + 0.1 * np.random.default_rng(5).standard_normal(20)
    prepared = ConstrainedPath(base, constraints).prepare(0.02)
    first = prepared.solve(base.problem.y)
    np.testing.assert_allclose(prepared.solve(other, warm=first).load, prepared.solve(other).load, atol=1e-10)
    assert prepared.solve(base.problem.y, warm=first).iterations <= 1


@given(st.sampled_from([1e-6, 1e6]), st.sampled_from([1e-6, 1.0, 1e6]), st.sampled_from(["cone", "bounds", "sign"]))
@settings(max_examples=12, deadline=None)
def test_units_change_nothing(model: float, data: float, name: str) -> None:
    base = problem()
    H, y = base.problem.H, base.problem.y
    size = data / model
    C, spec = TOTAL[2:], PARTS[name]
    scaled = Bounds(spec.lower * size, spec.upper * size) if isinstance(spec, Bounds) else spec
    one = ConstrainedPath(base, [spec, Resultant(C, [0.4])])
    two = ConstrainedPath(SVDPath(LinearProblem.whitened(model * H, data * y)), [scaled, Resultant(C, [0.4 * size])])
    a, b = one.solution(0.03, 1.0), two.solution(0.03, data)
    np.testing.assert_allclose(b.load / size, a.load, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(b.posterior.std / size, a.posterior.std, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(two.at([0.03, 0.3]).edf, one.at([0.03, 0.3]).edf, rtol=1e-8)


def test_a_soft_resultant_goes_from_free_to_exact() -> None:
    base, spec = problem(), NonNegative()
    C, r = np.ones((1, 12)), [2.0]
    free = ConstrainedPath(base, [spec]).solve(0.05).load
    exact = ConstrainedPath(base, [spec, Resultant(C, r)]).solve(0.05).load
    loads = [ConstrainedPath(base, [spec, Resultant(C, r, [v])]).solve(0.05).load for v in (1e12, 1e2, 1e0, 1e-2, 1e-9)]
    np.testing.assert_allclose(loads[0], free, atol=1e-9)
    np.testing.assert_allclose(loads[-1], exact, atol=1e-7)
    sums = [g.sum() for g in loads]
    assert sums == sorted(sums, reverse=True)
    weighed = ConstrainedPath(base, [spec, Resultant(C, r, [1.0])], sigma=10.0).solve(0.05).load
    np.testing.assert_allclose(weighed, loads[3], atol=1e-10)  # sigma^2 over the covariance is what counts


def test_pyramids_bracket_the_round_cone() -> None:
    base = problem()
    value = {}
    for facets in (3, 4, 8, 32):
        for inner in (True, False):
            path = ConstrainedPath(base, FrictionCone(0.4, CONTACTS, facets=facets, inner=inner))
            s = path.solve(0.02)
            value[facets, inner] = s.residual2 + (0.02 * float(base.scale)) ** 2 * s.penalty2
            if inner:
                g = s.load[CONTACTS]
                assert cones.excess(g, np.full(4, 0.4), np.zeros(4, int)).max() < 1e-12
    s = ConstrainedPath(base, FrictionCone(0.4, CONTACTS)).solve(0.02)
    round_ = s.residual2 + (0.02 * float(base.scale)) ** 2 * s.penalty2
    for facets in (3, 4, 8, 32):
        assert value[facets, False] <= round_ + 1e-12 <= value[facets, True] + 2e-12
    assert value[32, True] - value[32, False] < 0.02 * (value[4, True] - value[4, False])


def test_normals_turn_the_problem_with_them() -> None:
    base = problem()
    rng = np.random.default_rng(2)
    turns = np.stack([np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(4)])
    T = np.zeros((12, 12))
    for k, Q in zip(CONTACTS, turns, strict=True):
        T[np.ix_(k, k)] = Q
    turned = SVDPath(LinearProblem.whitened(base.problem.H @ T.T, base.problem.y))
    plain = ConstrainedPath(base, [FrictionCone(0.4, CONTACTS), Resultant(TOTAL[2:], [0.4])]).solve(0.03)
    with_normals = ConstrainedPath(
        turned, [FrictionCone(0.4, CONTACTS, normals=3 * turns[:, :, 2]), Resultant(TOTAL[2:] @ T.T, [0.4])]
    ).solve(0.03)
    np.testing.assert_allclose(with_normals.load, T @ plain.load, atol=1e-10)
    np.testing.assert_allclose(with_normals.multipliers[0].ravel(), T @ plain.multipliers[0].ravel(), atol=1e-9)
    np.testing.assert_array_equal(with_normals.active[0], plain.active[0])


def test_contacts_in_the_plane_are_two_half_planes() -> None:
    base, pairs = problem(), np.arange(12).reshape(6, 2)
    found = ConstrainedPath(base, FrictionCone(0.3, pairs)).solve(0.02)
    edges = np.kron(np.eye(6), [[0.3, -0.3], [1, 1]])
    S = np.vstack([base.problem.H, 0.02 * float(base.scale) * np.eye(12)])
    np.testing.assert_allclose(found.load, edges @ nnls(S @ edges, np.r_[base.problem.y, np.zeros(12)])[0], atol=1e-10)
    assert set(found.active[0]) >= {0, 1}


@pytest.mark.parametrize(
    "names", [("sign",), ("cone",), ("pyramid", "exact"), ("cone", "exact", "bounds")], ids="+".join
)
def test_degrees_of_freedom_are_the_divergence_of_the_estimate(names: tuple) -> None:
    base = problem()
    path = ConstrainedPath(base, [PARTS[name] for name in names])
    prepared, y, H, m = path.prepare(0.03), base.problem.y, base.problem.H, 20
    e = 1e-6
    J = np.column_stack([
        H @ (prepared.solve(y + e * d).load - prepared.solve(y - e * d).load) / (2 * e) for d in np.eye(m)
    ])  # fmt: skip
    p = path.at(0.03)
    rest = np.eye(m) - J
    assert p.edf == pytest.approx(np.trace(J), rel=1e-6)
    assert p.edf2 == pytest.approx(np.trace(J @ J), rel=1e-6)
    assert p.left == pytest.approx(m - np.trace(J), rel=1e-6)
    assert p.rest2 == pytest.approx(np.trace(rest @ rest), rel=1e-6)
    assert p.rest4 == pytest.approx(np.trace(np.linalg.matrix_power(rest, 4)), rel=1e-6)
    near = 0.03 * (1 + 1e-6)
    change = np.linalg.norm(path.solve(near).load - path.solve(0.03).load) / 1e-6
    assert p.sensitivity == pytest.approx(change, rel=1e-4, abs=1e-7)
    assert p.log_ratio is None


def test_without_active_constraints_it_is_the_path_without_them() -> None:
    base = problem(L=difference())
    path = ConstrainedPath(base, Bounds(-1e3, 1e3))
    assert isinstance(path, RegularizationPath)
    lam = np.geomspace(1e-3, 1, 7)
    a, b = path.at(lam), base.at(lam)
    for name in ("residual2", "penalty2", "edf", "edf2", "left", "rest2", "rest4", "sensitivity", "objective"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-7, err_msg=name)
    x, z = path.solution(0.05, 0.2), base.solution(0.05, 0.2)
    np.testing.assert_allclose(x.load, z.load, atol=1e-11)
    np.testing.assert_allclose(x.posterior.std, z.posterior.std, rtol=1e-8)
    np.testing.assert_allclose(x.posterior.noise_std, z.posterior.noise_std, rtol=1e-8)
    np.testing.assert_allclose(path.residual(0.05), base.residual(0.05), atol=1e-11)
    g = np.linspace(0, 1, 12)
    np.testing.assert_allclose(path.resolve(g, 0.05), base.resolve(g, 0.05), atol=1e-11)
    drawn = path.sample(0.05, 0.2, 4000)
    np.testing.assert_allclose(drawn.std(axis=0), z.posterior.std, rtol=0.06)
    np.testing.assert_allclose(drawn.mean(axis=0), z.load, atol=5 * z.posterior.std.max() / np.sqrt(4000))


def test_samples_meet_the_constraints_and_spread_where_the_face_does_not() -> None:
    path = ConstrainedPath(problem(), [NonNegative(), Resultant(np.ones((1, 12)), [2.0])])
    drawn, posterior = path.sample(0.05, 0.5, 60), path.solution(0.05, 0.5).posterior
    assert drawn.shape == (60, 12)
    assert drawn.min() >= 0
    np.testing.assert_allclose(drawn.sum(axis=1), 2.0, rtol=1e-9)
    held = path.solve(0.05).active[0]
    assert np.all(posterior.std[held] == 0)
    assert np.any(drawn[:, held].std(axis=0) > 0)
    assert posterior.approximation == "active-set approximation"
    assert posterior.variance(np.ones(12)) == pytest.approx(0, abs=1e-20)  # the exact resultant has no spread


@pytest.mark.parametrize("rule", ["discrepancy", "gcv", "robust_gcv", "l_curve", "upre", "quasi_optimality", "ncp"])
def test_rules_run_on_it(rule: str) -> None:
    x = (np.arange(40) + 0.5) / 40
    H = 0.1 / np.pi / (0.01 + (x[:, None] - x) ** 2) / 40
    g = np.maximum(0, 1 - ((x - 0.5) / 0.15) ** 2)
    y = H @ g + 1e-3 * np.random.default_rng(0).standard_normal(40)
    path = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y, np.full(40, 1e-3))), NonNegative())
    chosen = choose(path, rule, sigma=1.0, source="covariance")
    assert chosen.rule == rule
    error = np.linalg.norm(path.solve(chosen.lam).load - g) / np.linalg.norm(g)
    if rule not in ("l_curve", "quasi_optimality"):  # they run, and are known to err at an end of the sweep
        assert error < 0.35
    refused = {r.rule: r.note for r in chosen.rules if r.lam is None}
    assert "evidence" in refused


def test_frames_are_solved_one_by_one_with_their_own_faces_and_resultants() -> None:
    base = problem(frames=3)
    H, y = base.problem.H, base.problem.y
    totals = np.array([[1.0, 2.0, 0.5]])
    path = ConstrainedPath(
        base, [NonNegative(), Resultant(np.ones((1, 12)), totals), Resultant(TOTAL[:1], [0.1], [1.0])]
    )
    found, solution = path.solve(0.05), path.solution(0.05, 0.3)
    assert found.load.shape == solution.load.shape == (3, 12)
    np.testing.assert_allclose(found.load.sum(axis=1), totals[0], rtol=1e-10)
    stds, scale = [], 0.05 * float(base.scale)
    for k in range(3):
        single = SVDPath(LinearProblem.whitened(H, y[:, k]))
        alone = ConstrainedPath(single, [NonNegative(), Resultant(np.ones((1, 12)), totals[:, k]), path.constraints[2]])
        lam = scale / float(single.scale)
        np.testing.assert_allclose(found.load[k], alone.solve(lam).load, atol=1e-10)
        stds.append(alone.solution(lam, 0.3).posterior.std)
    np.testing.assert_allclose(solution.posterior.std, stds, atol=1e-10)
    assert path.m == 63
    assert path.residual(0.05).shape == (3, 20)
    again = from_arrays(solution.posterior.to_arrays())
    w = np.random.default_rng(0).standard_normal((3, 12))
    assert again.variance(w) == pytest.approx(float(solution.posterior.variance(w)))
    new = path.prepare(0.05).solve(y, warm=found, resultants=[totals + 1, [0.1]])
    np.testing.assert_allclose(new.load.sum(axis=1), totals[0] + 1, rtol=1e-10)


def test_no_regularisation_and_fewer_data_than_loads() -> None:
    base = problem(8, 12)
    found = ConstrainedPath(base, [NonNegative()]).solve(0.0)
    best = nnls(base.problem.H, base.problem.y)[1] ** 2
    assert found.residual2 == pytest.approx(best, rel=1e-6, abs=1e-9)
    assert found.load.min() >= 0


@pytest.mark.parametrize("lam", [1e-2, 1e-4, 1e-6, 1e-8])
def test_rows_alone_on_ill_conditioned_operators_are_solved_in_one_step(lam):
    """Null space of the rows and augmented least squares as the reference; no proximal detour is taken."""
    n, rng = 50, np.random.default_rng(0)
    x, at = (np.arange(n) + 0.5) / n, np.linspace(0, 1, 60)
    H = np.exp(-((at[:, None] - x) ** 2) / 2 / 0.06**2) / n
    y = H @ np.exp(-(((x - 0.4) / 0.05) ** 2)) + 1e-4 * rng.standard_normal(60)
    C, value = np.stack([np.ones(n), x]) / n, np.array([0.09, 0.04])
    path = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y)), [Resultant(C, value)], sigma=1e-4)
    found = path.solve(lam)
    V, fixed = np.linalg.svd(C)[2][2:].T, np.linalg.lstsq(C, value, rcond=None)[0]
    A = np.vstack([H, lam * float(path.scale) * np.eye(n)])
    w = np.linalg.lstsq(A @ V, np.concatenate([y, np.zeros(n)]) - A @ fixed, rcond=None)[0]
    g = fixed + V @ w
    assert found.solver == "active set"
    assert np.linalg.norm(found.load - g) <= 1e-14 / lam**1.5 * np.linalg.norm(g)
    np.testing.assert_allclose(C @ found.load, value, atol=1e-11)
