"""Loads of local variance: the smoother against dense Gaussians, scores, evidence, coverage, and the choice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import pytest
from numpy.typing import NDArray

from loadid._inverse.gaussian.local_variance import Smoother, Variances, smoothed
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import WhitenedRecord, augment, measured
from loadid._inverse.local_prior import (
    Fit,
    LocalPrior,
    LocalVariancePosterior,
    bumps,
    input_variance,
    local_prior,
    with_memory,
)
from loadid._inverse.posterior import WidenedPosterior, from_arrays

from .cases import beam, holes

SAMPLES = 60


def random_record(memory: float, gaps: bool = True, samples: int = SAMPLES) -> tuple[WhitenedRecord, Variances]:
    """Noise as data over a beam with two loads and three kinds of sensors, variances of all sizes."""
    rng, system = np.random.default_rng(3), beam("das")
    size = np.std(system.impulse_response(system.dt, samples), axis=(0, 2))
    y = rng.standard_normal((samples, 3))
    if gaps:
        y[holes(rng, y.shape) & (np.arange(samples) < 30)[:, None]] = np.nan
    own = measured(augment(system.A, system.B, system.C, system.D, unknown_start=True), y * size, size)
    own = with_memory(own, memory)
    there = np.any(own.C != 0, axis=2)[own.kind] | np.any(own.D != 0, axis=2)[own.kind]
    noise = np.where(there, rng.uniform(0.5, 2, y.shape), 1.0)
    start = np.zeros(own.n)
    start[own.free] = 1e-6 * rng.uniform(0.5, 2, len(own.free))
    return own, Variances(10 ** rng.uniform(-4, 1, (samples, 2)), noise, np.diag(start))


@dataclass(frozen=True)
class Dense:
    """The same Gaussian written out."""

    evidence: float
    load: NDArray
    covariance: NDArray


def dense(own: WhitenedRecord, given: Variances) -> Dense:
    """Mean, covariance and likelihood by matrices of the whole record."""
    samples, m, p, n = own.samples, own.m, own.p, own.n
    H, T = np.zeros((samples, m, n + samples * p)), np.zeros((samples, p, n + samples * p))
    X = np.hstack([np.eye(n), np.zeros((n, samples * p))])
    for k, j in enumerate(own.kind):
        at = slice(n + k * p, n + (k + 1) * p)
        H[k], T[k] = own.C[j] @ X, own.E @ X
        H[k][:, at] += own.D[j]
        T[k][:, at] += np.eye(p)
        X = own.F[j] @ X
        X[:, at] += own.G[j]
    H, T = H.reshape(samples * m, -1), T.reshape(samples * p, -1)
    keep = np.any(H != 0, axis=1)
    prior = np.zeros((n + samples * p,) * 2)
    prior[:n, :n], prior[range(n, len(prior)), range(n, len(prior))] = given.start, given.load.ravel()
    H, y = H[keep], own.y.ravel()[keep]
    S, cross = H @ prior @ H.T + np.diag(given.noise.ravel()[keep]), T @ prior @ H.T
    evidence = -0.5 * (np.linalg.slogdet(S)[1] + y @ np.linalg.solve(S, y) + len(y) * np.log(2 * np.pi))
    covariance = T @ prior @ T.T - cross @ np.linalg.solve(S, cross.T)
    return Dense(float(evidence), (cross @ np.linalg.solve(S, y)).reshape(samples, p), covariance)


@pytest.mark.parametrize("memory", [0.0, 3.5])
def test_the_smoother_is_the_dense_gaussian(memory: float) -> None:
    own, given = random_record(memory)
    found, known = Smoother(own, given), dense(own, given)
    s = found.smooth()
    assert s.evidence == pytest.approx(known.evidence, abs=1e-8)
    assert s.load == pytest.approx(known.load, abs=1e-8 * np.abs(known.load).max())
    assert found.variance.ravel() == pytest.approx(np.diag(known.covariance), rel=1e-8)


@pytest.mark.parametrize("memory", [0.0, 3.5])
def test_weighted_sums_have_the_dense_variance_and_survive_a_file(memory: float) -> None:
    own, given = random_record(memory)
    known = dense(own, given)
    w = np.random.default_rng(0).standard_normal((2, SAMPLES, 2))
    kept = WidenedPosterior(LocalVariancePosterior(Smoother(own, given)), 0.1 * known.load[None])
    for one in (kept, from_arrays(kept.to_arrays())):
        added = (0.1 * np.einsum("ksp,sp->k", w, known.load)) ** 2
        expected = np.einsum("ki,ij,kj->k", w.reshape(2, -1), known.covariance, w.reshape(2, -1)) + added
        assert one.variance(w) == pytest.approx(expected, rel=1e-8)
        variance = np.diag(known.covariance).reshape(SAMPLES, 2) + (0.1 * known.load) ** 2
        assert one.std**2 == pytest.approx(variance, rel=1e-8)


@pytest.mark.parametrize("memory", [0.0, 3.5])
def test_the_score_is_the_slope_of_the_evidence(memory: float) -> None:
    own, given = random_record(memory)
    s = Smoother(own, given).smooth()

    def slope(name: str, at: tuple[int, int]) -> float:
        step, values = 1e-4 * getattr(given, name)[at], []
        for sign in (1, -1):
            moved = np.array(getattr(given, name))
            moved[at] += sign * step
            values.append(Smoother(own, replace(given, **{name: moved})).smooth().evidence)
        return (values[0] - values[1]) / (2 * step)

    scores = {
        "load": s.rho**2 - s.rho_variance,
        "noise": s.e**2 - s.e_variance,
        "start": s.start[:, None] ** 2 - s.start_information,
    }
    for name, places in {"load": [(5, 0), (40, 1), (59, 0)], "noise": [(31, 0), (45, 2)], "start": [(0, 0)]}.items():
        for at in places:
            assert slope(name, at) == pytest.approx(0.5 * scores[name][at], rel=1e-4)


@pytest.mark.parametrize("memory", [0.0, 3.5])
def test_a_constant_variance_has_the_pass_of_any_other(memory: float) -> None:
    """From rest, where nothing changes with time: by least squares, and by the smoother of all variances."""
    own, _ = random_record(memory, gaps=False)
    v, r = np.tile([0.7, 2e-3], (SAMPLES, 1)), np.tile([0.5, 1.5, 3.0], (SAMPLES, 1))
    given = Variances(v, r, np.zeros((own.n, own.n)))
    one, other = smoothed(own, given), Smoother(own, given, loads=False).smooth()
    assert one.evidence == pytest.approx(other.evidence, rel=1e-10)
    for name in ("load", "rho", "e", "rho_variance", "e_variance"):
        expected = getattr(other, name)
        np.testing.assert_allclose(
            getattr(one, name), expected, rtol=0, atol=1e-8 * np.abs(expected).max(), err_msg=name
        )


def test_a_constant_variance_is_tikhonov() -> None:
    own, _ = random_record(0.0)
    own = replace(own, free=own.free[:0])
    path = StateSpacePath(own)
    lam = 0.05
    v = np.full((SAMPLES, 2), 1 / (lam * float(path.scale)) ** 2)
    found = Smoother(own, Variances(v, np.ones(own.y.shape), np.zeros((own.n, own.n))))
    known = path.solution(lam, 1.0)
    assert known.posterior is not None
    assert found.smooth().load == pytest.approx(known.load, abs=1e-9 * np.abs(known.load).max())
    assert np.sqrt(found.variance) == pytest.approx(known.posterior.std, rel=1e-9)


def test_a_memory_keeps_the_variance_and_bumps_cover_the_record() -> None:
    a = np.exp(-np.sqrt(3) / 3.5)
    g = np.zeros(400)
    for k in range(400):
        g[k] = (k == 0) + 2 * a * g[k - 1] * (k > 0) - a**2 * g[k - 2] * (k > 1)
    assert np.sum(g**2) * input_variance(3.5) == pytest.approx(1.0)
    assert bumps(37).sum(axis=1) == pytest.approx(2.0)


@lru_cache
def impacts(samples: int = 300, gap: bool = False) -> tuple[WhitenedRecord, NDArray, LocalPrior]:
    """Two half sines on a beam, three kinds of sensors, 2 % noise."""
    rng, system = np.random.default_rng(5), beam("das", count=1)
    g = np.zeros((samples, 1))
    for start, width, height in ((40, 12, 300.0), (170, 8, 500.0)):
        g[start : start + width, 0] = height * np.sin(np.pi * np.arange(width) / (width - 1))
    y = system.simulate(g)
    rms = np.sqrt(np.mean(y**2, axis=0))
    y = y + 0.02 * rms * rng.standard_normal(y.shape)
    if gap:
        y[60:80] = np.nan
        y[165:175, 0] = np.nan
    own = measured(augment(system.A, system.B, system.C, system.D), y, rms)
    return own, g, local_prior(own)


@pytest.mark.parametrize("gap", [False, True])
def test_impacts_of_an_exact_model_are_covered(gap: bool) -> None:
    _, g, found = impacts(gap=gap)
    load, band, _ = found.posterior()
    still = found.stationary.posterior()[0]
    on = g != 0
    error = np.linalg.norm(load - g) / np.linalg.norm(g)
    assert found.asked_for
    assert error < 0.1
    assert error < 0.7 * np.linalg.norm(still - g) / np.linalg.norm(g)
    assert np.mean(np.abs(load - g)[on] < 1.96 * band.std[on]) >= 0.85
    assert np.mean(np.abs(load - g) < 1.96 * band.std) > 0.9
    assert np.sqrt(np.mean(band.std[on] ** 2)) < 2 * np.sqrt(np.mean((load - g)[on] ** 2))
    assert np.sqrt(found.noise) == pytest.approx(0.02, rel=0.25)


def test_the_evidence_climbs() -> None:
    own, _, found = impacts()
    fit, values = Fit(with_memory(own, 3.5), stated=False), []
    fit.b[:], fit.floor[:] = found.given.load.mean(), 0.1 * found.given.load.mean()
    fit.r = 10 * found.noise
    for _ in range(15):
        fit.climb(1)
        values.append(fit.evidence)
    assert np.all(np.diff(values) > -0.5)
    assert values[-1] > values[0] + 100


def test_units_change_nothing() -> None:
    own, _, found = impacts()
    other = replace(own, G=own.G * 1e-6, D=own.D * 1e-6, y=own.y * 1e-3, C=own.C, E=own.E)
    again = local_prior(replace(other, y=own.y))
    load, scaled = found.posterior()[0], again.posterior()[0]
    assert scaled * 1e-6 == pytest.approx(load, abs=1e-4 * np.abs(load).max())
    assert again.gain == pytest.approx(found.gain, rel=1e-3)


@pytest.mark.parametrize("kind", ["slow", "harmonic", "random"])
def test_loads_that_act_throughout_keep_the_stationary_prior(kind: str) -> None:
    rng, system, t = np.random.default_rng(8), beam("das", count=1), np.arange(300)
    window = np.hanning(41)
    g = {
        "slow": np.convolve(rng.standard_normal(340), window, "valid"),
        "harmonic": np.sin(0.21 * t) + 0.4 * np.sin(0.5 * t),
        "random": rng.standard_normal(300),
    }[kind][:, None]
    y = system.simulate(g)
    y = y + 0.02 * np.sqrt(np.mean(y**2, axis=0)) * rng.standard_normal(y.shape)
    found = local_prior(measured(augment(system.A, system.B, system.C, system.D), y, np.std(y, axis=0)))
    assert not found.asked_for


def test_an_unknown_start_is_learned() -> None:
    rng, system = np.random.default_rng(2), beam("da", count=1)
    g = np.zeros((250, 1))
    g[100:112, 0] = 100 * np.sin(np.pi * np.arange(12) / 11)
    first = np.zeros((200, 1))
    first[:20] = 100.0
    y = system.simulate(np.concatenate([first, g]))[200:]
    y = y + 0.01 * np.sqrt(np.mean(y**2, axis=0)) * rng.standard_normal(y.shape)
    errors = []
    for unknown in (True, False):
        own = measured(augment(system.A, system.B, system.C, system.D, unknown_start=unknown), y, np.std(y, axis=0))
        errors.append(np.linalg.norm(local_prior(own).posterior()[0] - g) / np.linalg.norm(g))
    assert errors[0] < 0.15 < errors[1]
