"""Lines: posterior, identifiability, evidence of the neighbours and rules, each against dense formulas of one line."""

import numpy as np
import pytest
from scipy.stats import chi2

from loadid._inverse import rules
from loadid._inverse import spectral as pooled
from loadid._inverse.spectral import Compressed, LinesPath, compress, factor, identifiable, posterior, window
from loadid._results.functionals import nearest_zeros
from loadid.paths import LinearProblem, RuleResult, SVDPath, Sweep
from structures import InputError

from ..linecases import case, normals

SHAPES = [(6, 3), (3, 3), (2, 4), (1, 1)]


def problem(sensors=6, loads=3, lines=4, snapshots=1, seed=0):
    rng = np.random.default_rng(seed)
    return normals(rng, lines, sensors, loads), normals(rng, lines, sensors, snapshots), rng


# -- reduction and posterior ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("sensors", "loads"), SHAPES)
def test_compressed_lines_keep_every_misfit(sensors, loads):
    H, X, rng = problem(sensors, loads, snapshots=3)
    lines = compress(H, X)
    for _ in range(3):
        g = normals(rng, 4, loads, 3)
        whole = np.sum(np.abs(X - H @ g) ** 2, axis=(1, 2))
        rest = lines.b - lines.R @ g
        assert np.sum(np.abs(rest) ** 2, axis=(1, 2)) + lines.outside == pytest.approx(whole, rel=1e-12)
    assert lines.left == max(sensors - loads, 0)


@pytest.mark.parametrize(("sensors", "loads"), SHAPES)
def test_posterior_is_that_of_complex_normals(sensors, loads):
    """Mean and covariance by conditioning the joint normal of loads and data, line by line."""
    H, X, rng = problem(sensors, loads, snapshots=2)
    expected, noise = rng.uniform(0.1, 5, (4, loads)), rng.uniform(0.01, 2, 4)
    found = posterior(factor(compress(H, X), expected), noise)
    for k in range(4):
        P = np.diag(expected[k])
        S = H[k] @ P @ H[k].conj().T + noise[k] * np.eye(sensors)
        K = np.linalg.solve(S, H[k] @ P).conj().T
        assert found.load[k] == pytest.approx(K @ X[k], rel=1e-10)
        assert found.covariance[k] == pytest.approx(P - K @ H[k] @ P, rel=1e-9, abs=1e-12)
        assert found.edf[k] == pytest.approx(np.trace(H[k] @ K).real, rel=1e-10)


def test_truncation_is_the_truncated_pseudo_inverse():
    H, X, _ = problem()
    f = factor(compress(H, X), np.ones((4, 3)))
    for keep in (1, 2, 3):
        cut = f.s[:, keep - 1]
        found = posterior(f, np.full(4, 0.5), cut)
        for k in range(4):
            U, s, Vh = np.linalg.svd(H[k], full_matrices=False)
            dense = Vh[:keep].conj().T @ ((U[:, :keep].conj().T @ X[k]) / s[:keep, None])
            assert found.load[k] == pytest.approx(dense, rel=1e-10)
            noisy = (Vh[:keep].conj().T / s[:keep] ** 2) @ Vh[:keep] * 0.5
            assert found.covariance[k] == pytest.approx(noisy + Vh[keep:].conj().T @ Vh[keep:], rel=1e-9, abs=1e-12)


def test_gain_is_what_no_other_load_can_imitate():
    """The part of each column at right angles to all others; its reciprocal is the std of least squares."""
    H, X, rng = problem(lines=3)
    told = identifiable(factor(compress(H, X), rng.uniform(0.1, 10, (3, 3))))
    for k in range(3):
        for j in range(3):
            others = np.linalg.qr(np.delete(H[k], j, axis=1))[0]
            own = H[k, :, j] - others @ (others.conj().T @ H[k, :, j])
            assert told.gain[k, j] == pytest.approx(np.linalg.norm(own), rel=1e-10)
        assert told.naive[k] == pytest.approx(np.linalg.lstsq(H[k], X[k], rcond=None)[0], rel=1e-10)


def test_gain_of_what_a_line_cannot_tell_is_zero():
    H, X, _ = problem(lines=3)
    H[1, :, 2] = 2j * H[1, :, 0]  # two loads look alike
    H[2] = 0  # nothing moves
    told = identifiable(factor(compress(H, X), np.ones((3, 3))))
    assert told.gain[1] == pytest.approx([0, told.gain[1, 1], 0])
    assert told.gain[1, 1] > 0
    assert not np.any(told.gain[2])
    assert list(np.isfinite(told.condition)) == [True, False, False]


# -- evidence ---------------------------------------------------------------------------------------------------------
def log_evidence(H, X, load, noise):
    """Of one line, snapshots summed."""
    M = (H * load) @ H.conj().T + noise * np.eye(len(H))
    return -np.linalg.slogdet(M)[1] * X.shape[1] - np.sum(X.conj() * np.linalg.solve(M, X)).real


def test_settled_variances_are_where_the_evidence_has_no_slope(monkeypatch):
    """In the mean over the window, weighted by the loads: slopes by differences of the dense evidence of each line."""
    monkeypatch.setattr(pooled, "SWEEPS", 3000)
    monkeypatch.setattr(pooled, "SETTLED", 1e-9)
    c = case(21, 5, 2, noise=0.1)
    noise = np.full(21, c.sigma**2)
    found = pooled.prior(compress(c.H, c.Y), neighbours=6, noise=noise)
    near, _ = pooled.window(21, 6)
    assert found.sweeps < 3000
    slope, told = np.zeros((2, 21, 2))
    for k in range(21):
        M = (c.H[k] * found.probable[k]) @ c.H[k].conj().T + noise[k] * np.eye(5)
        for j in range(2):
            sides = []
            for step in (1e-4, -1e-4):
                load = found.probable[k] * np.where(np.arange(2) == j, np.exp(step), 1.0)
                sides.append(log_evidence(c.H[k], c.Y[k][:, None], load, noise[k]))
            slope[k, j] = (sides[0] - sides[1]) / 2e-4
            told[k, j] = found.probable[k, j] * np.vdot(c.H[k, :, j], np.linalg.solve(M, c.H[k, :, j])).real
    assert near(found.probable * (told + slope)) == pytest.approx(found.probable * near(told), rel=1e-5)


def test_variances_of_the_default_are_close_to_the_largest_evidence():
    c = case(200, 6, 2, noise=0.05)
    found = pooled.prior(compress(c.H / c.sigma, c.Y / c.sigma), known=True)

    def total(factor):
        return sum(
            log_evidence(c.H[k] / c.sigma, c.Y[k][:, None] / c.sigma, found.probable[k] * factor, 1.0)
            for k in range(0, 200, 4)
        )

    assert total(1.0) > max(total(2.0), total(0.5))


def test_size_of_loads_and_noise_are_found():
    size = np.array([5.0, 0.3, 0.0])
    c = case(600, 8, 3, truth=size * normals(np.random.default_rng(5), 600, 3), noise=0.01)
    lines = compress(c.H, c.Y)
    found = pooled.prior(lines)
    assert np.sqrt(np.median(found.noise)) == pytest.approx(c.sigma, rel=0.05)
    assert np.sqrt(np.median(found.probable, axis=0)[:2]) == pytest.approx(size[:2], rel=0.1)
    assert np.sqrt(np.median(found.probable[:, 2])) < 0.1 * size[1]


@pytest.mark.parametrize("known", [True, False])
def test_a_line_that_stands_alone_is_neither_noise_nor_its_neighbours(known):
    """One harmonic in silence, at every third line in turn."""
    worst = 0.0
    for k in range(3, 40, 3):
        truth = np.zeros((40, 2), complex)
        truth[k] = [30.0, 10.0]
        c = case(40, 4, 2, truth=truth, quiet=1.0)
        H = normals(np.random.default_rng(k), 40, 4, 2)
        Y = np.einsum("ksl,kl->ks", H, truth) + 0.5 * normals(np.random.default_rng(k + 99), 40, 4)
        lines = compress(H / 0.5, Y / 0.5) if known else compress(H, Y)
        found = pooled.prior(lines, neighbours=12, known=known)
        answer = posterior(factor(lines, found.load), found.noise)
        worst = max(worst, float(np.max(np.abs(answer.load[k, :, 0] - truth[k]) / np.sqrt(answer.variance[k]))))
        assert c.sigma == 1.0
    assert worst < 4


def test_stated_noise_is_set_aside_where_lines_contradict_it():
    rng = np.random.default_rng(0)
    H, noise = normals(rng, 400, 8, 2), normals(rng, 400, 8)
    assert pooled.contradicted(compress(H, noise))[1] == 1
    v, excess = pooled.contradicted(compress(H, 5 * noise))
    assert excess == pytest.approx(25, rel=0.05)
    assert v == pytest.approx(np.full(400, 25), rel=0.6)
    half = np.where(np.arange(400) < 200, 1.0, 3.0)[:, None]
    v, excess = pooled.contradicted(compress(H, half * noise))
    assert excess == pytest.approx(9, rel=0.1)
    assert np.median(v[:180]) == 1


def test_stated_noise_that_is_right_is_not_contradicted():
    rng = np.random.default_rng(1)
    H = normals(rng, 300, 6, 3)
    found = [pooled.contradicted(compress(H, normals(rng, 300, 6)))[1] > 1 for _ in range(100)]
    assert sum(found) <= 2


# -- paths and rules --------------------------------------------------------------------------------------------------
def real_form(H, y):
    """The complex line as a real problem of twice the size."""
    return np.block([[H.real, -H.imag], [H.imag, H.real]]), np.concatenate([y.real, y.imag])


def test_lines_path_is_the_real_problem_of_each_line():
    H, X, _ = problem(lines=3)
    size = np.array([1.0, 4.0, 0.2])
    path = LinesPath(factor(compress(H, X), np.broadcast_to(size**2, (3, 3))))
    lam = np.geomspace(1e-4, 1, 7)
    at = path.at(lam)
    for k in range(3):
        A, y = real_form(H[k] * size, X[k, :, 0])
        dense = SVDPath(LinearProblem.whitened(A, y))
        assert path.scale[k] == pytest.approx(dense.scale, rel=1e-12)
        one = dense.at(lam)
        assert at.residual2[k] == pytest.approx(one.residual2, rel=1e-9)
        assert at.penalty2[k] == pytest.approx(one.penalty2, rel=1e-9)
        assert 2 * at.edf[k] == pytest.approx(one.edf, rel=1e-10)
        assert rules.gcv_function(path, at)[k] == pytest.approx(2 * rules.gcv_function(dense, one), rel=1e-9)


class Dense:
    """Plain numpy formulas of one line over absolute lambdas."""

    def __init__(self, H, y, lam):
        m, n = H.shape
        self.m, self.lam = m, lam
        self.load, self.r2, self.edf, self.edf2, self.logdet, self.objective = [], [], [], [], [], []
        for x in lam:
            g = np.linalg.lstsq(np.vstack([H, x * np.eye(n)]), np.concatenate([y, np.zeros(n)]), rcond=None)[0]
            A = H @ np.linalg.solve(H.conj().T @ H + x**2 * np.eye(n), H.conj().T)
            r2 = np.sum(np.abs(y - H @ g) ** 2)
            self.load.append(g)
            self.r2.append(r2)
            self.edf.append(np.trace(A).real)
            self.edf2.append(np.trace(A @ A).real)
            self.logdet.append(np.linalg.slogdet(H @ H.conj().T / x**2 + np.eye(m))[1])
            self.objective.append(r2 + x**2 * np.sum(np.abs(g) ** 2))
        self.load = np.array(self.load)
        self.r2, self.edf, self.edf2, self.logdet, self.objective = (
            np.array(v) for v in (self.r2, self.edf, self.edf2, self.logdet, self.objective)
        )

    def value(self, rule, sigma):
        gcv = self.r2 / (self.m - self.edf) ** 2
        t = np.log(self.lam)
        if rule == "l_curve":
            x, y = 0.5 * np.log(self.r2), 0.5 * np.log(np.sum(np.abs(self.load) ** 2, axis=1))
            dx, dy = np.gradient(x, t), np.gradient(y, t)
            return -(dx * np.gradient(dy, t) - np.gradient(dx, t) * dy) / (dx**2 + dy**2) ** 1.5
        left = self.m - 1.4 * self.edf
        return {
            "gcv": gcv,
            "robust_gcv": (0.1 + 0.9 * self.edf2 / self.m) * gcv,
            "modified_gcv": np.where(left > 0, self.r2 / np.where(left > 0, left, 1) ** 2, np.inf),
            "upre": self.r2 + 2 * sigma**2 * self.edf,
            "quasi_optimality": np.linalg.norm(np.gradient(self.load, t, axis=0), axis=1),
            "evidence": self.logdet + self.objective / sigma**2,
        }[rule]

    def crossing(self, rule, sigma):
        level = sigma**2 * (chi2.ppf(0.95, 2 * self.m) / 2 if rule == "discrepancy" else self.m - self.edf)
        below = np.flatnonzero(self.r2 < level)
        return self.lam[below[-1]] if len(below) else self.lam[0]


RULES = ["gcv", "robust_gcv", "modified_gcv", "upre", "quasi_optimality", "evidence", "l_curve", "discrepancy"]


@pytest.mark.parametrize("rule", [*RULES, "dof_discrepancy"])
def test_rule_of_each_line_is_that_of_a_fine_dense_search(rule):
    c = case(6, 6, 3, noise=0.05, seed=4)
    lines = compress(c.H / c.sigma, c.Y / c.sigma)
    path = LinesPath(factor(lines, np.ones((6, 3))))
    chosen = rules.lines(rule, Sweep.over(path, 1.0))
    low, high = max(path.range[0], 1e-8), path.range[1]
    agree = 0
    for k in range(6):
        lam = np.geomspace(low, high, 500)
        dense = Dense(c.H[k] / c.sigma, c.Y[k] / c.sigma, lam * path.scale[k])
        if rule.endswith("discrepancy"):
            best = dense.crossing(rule, 1.0) / path.scale[k]
            assert np.log(chosen[k] / best) == pytest.approx(0, abs=0.2), k
            agree += 1
            continue
        value = dense.value(rule, 1.0)
        if rule == "quasi_optimality":  # among the singular values, where the rule looks
            value = np.where(lam >= path.gamma[k].min() / path.scale[k], value, np.inf)
        if rule == "l_curve":  # where differences of the norms are above rounding, two points of the grid inside
            value = np.where((3 - dense.edf > 1e-4) & (np.arange(500) < 475), value, np.inf)
            if not np.isfinite(np.interp(np.log(chosen[k]), np.log(lam), value)):
                continue  # on the plateau to its left, whose height does not change
        inner = np.where(np.isfinite(value), value, -np.inf).max()
        value = np.where(np.isfinite(value), value, inner)
        here = np.interp(np.log(chosen[k]), np.log(lam), value)
        # as good a value as the best of the fine grid, up to what the coarse grid cannot see
        assert here <= value.min() + 0.05 * (inner - value.min()), k
        agree += abs(np.log(chosen[k] / lam[np.argmin(value)])) < 0.5
    assert agree >= (3 if rule == "l_curve" else 5)


def test_neighbours_share_the_decision_and_a_band_is_one():
    c = case(60, 6, 3, noise=0.05)
    path = LinesPath(factor(compress(c.H / c.sigma, c.Y / c.sigma), np.ones((60, 3))))
    alone, near = (rules.lines("gcv", Sweep.over(path, 1.0, mean=window(60, n)[0])) for n in (0, 20))
    assert np.std(np.diff(np.log(near))) < 0.1 * np.std(np.diff(np.log(alone)))
    joined = path.joined()
    one = rules.answered(rules.run("gcv", Sweep.over(joined, 1.0))) * float(joined.scale)
    blocks = [c.H[k] / c.sigma for k in range(60)]
    lam = np.geomspace(1e-3, 1, 200) * float(joined.scale)

    def gcv(x):
        r2 = edf = 0.0
        for k, H in enumerate(blocks):
            s = np.linalg.svd(H, compute_uv=False)
            A = H @ np.linalg.solve(H.conj().T @ H + x**2 * np.eye(3), H.conj().T)
            r2 += np.sum(np.abs(c.Y[k] / c.sigma - A @ c.Y[k] / c.sigma) ** 2)
            edf += np.sum(s**2 / (s**2 + x**2))
        return r2 / (6 * 60 - edf) ** 2

    values = np.array([gcv(x) for x in lam[::10]])
    assert gcv(one) <= values.min() * (1 + 1e-3)


def test_rules_that_cannot_run_say_so():
    H, X, _ = problem()
    plain = factor(compress(H, X), np.ones((4, 3)))
    smooth, stairs = LinesPath(plain), LinesPath(plain, truncated=True)
    with pytest.raises(InputError, match="needs the noise level"):
        rules.lines("upre", Sweep.over(smooth, None))
    for rule in ("l_curve", "quasi_optimality", "evidence"):
        with pytest.raises(InputError, match=rule):
            rules.lines(rule, Sweep.over(stairs, 1.0))
    with pytest.raises(InputError, match="residual of a record"):
        rules.lines("ncp", Sweep.over(smooth, 1.0))
    with pytest.raises(InputError, match="over='band'"):  # one lambda for all lines is no answer
        rules.lines(lambda sweep: RuleResult("first", float(sweep.lam[0])), Sweep.over(smooth, 1.0))


def test_discrepancy_of_joined_lines_has_the_margin_of_complex_noise():
    c = case(12, 6, 3, noise=0.05)
    joined = LinesPath(factor(compress(c.H / c.sigma, c.Y / c.sigma), np.ones((12, 3)))).joined()
    found = rules.run("discrepancy", Sweep.over(joined, 1.0))
    assert float(joined.at(found.lam).residual2) == pytest.approx(chi2.ppf(0.95, 2 * 72) / 2, rel=1e-6)


def test_bad_lines_are_refused():
    H, X, _ = problem()
    for bad_H, bad_X, words in (
        (H[0], X, "do not fit"), (H, X[:3], "do not fit"), (np.where(np.arange(3) == 1, np.nan, H), X, "NaN"),
        (H, X * np.inf, "NaN"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=words), np.errstate(invalid="ignore"):
            compress(bad_H, bad_X)
    assert isinstance(compress(H, X[..., 0]), Compressed)


# -- antiresonances ---------------------------------------------------------------------------------------------------
def test_nearest_zero_of_every_line():
    f = np.arange(1.0, 101.0)
    gain = np.stack([np.abs((f - 30) * (f - 71)) + 1, np.full(100, 3.0)], axis=1)
    zeros = nearest_zeros(f, gain)
    assert np.all(zeros[:50, 0] == 30)
    assert np.all(zeros[50:, 0] == 71)
    assert np.all(np.isinf(zeros[:, 1]))
