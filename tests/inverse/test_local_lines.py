"""Loads of local variance over lines: against dense Gaussians of a periodic record, scores, files, choice, hits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import fftconvolve

from loadid import Deconvolution, LoadEstimate, Noise, Penalty
from loadid._inverse.convolved.local_lines import LinesFit, LocalLinesPrior, Spectrum, Weighed, active
from loadid._inverse.convolved.path import SpectralPath
from loadid._inverse.posterior import from_arrays
from structures import InputError, MeasuredModel
from structures._testing.spectra import padded_length
from tests.campaigns import hammer

N, SENSORS, LOADS = 48, 2, 2
ACT = np.r_[8:18, 30:36]


def periodic(memory: float = 2.0) -> tuple[Spectrum, np.ndarray]:
    """A spectrum whose padding is the record itself, so that all Gaussians are exact, and its dense response."""
    rng = np.random.default_rng(3)
    h = rng.standard_normal((N, SENSORS, LOADS)) * np.exp(-np.arange(N) / 6)[:, None, None]
    H = np.fft.rfft(h, axis=0) * np.sqrt(N)
    y = rng.standard_normal((N, SENSORS))
    one = Spectrum(H, np.fft.rfft(y, axis=0), N, N)
    whole = one.with_memory(memory)
    columns = np.empty((N * SENSORS, N * LOADS))
    for i in range(N * LOADS):
        unit = np.zeros(N * LOADS)
        unit[i] = 1.0
        columns[:, i] = whole.pull(whole.respond(unit.reshape(N, LOADS))).ravel()
    return whole, columns


def weighed(whole: Spectrum) -> tuple[Weighed, np.ndarray]:
    """Some variances of it, and those of all samples."""
    rng = np.random.default_rng(5)
    v, floor, r = rng.uniform(0.5, 4, (len(ACT), LOADS)), np.array([0.02, 0.05]), np.array([0.5, 2.0])
    every = np.tile(floor, (N, 1))
    every[ACT] += v
    return Weighed(whole, ACT, v, floor, np.tile(r, (len(whole.H), 1))), every


def dense(whole: Spectrum, columns: np.ndarray, v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
    """Log density of the data, mean and covariance of the white input, and Sigma."""
    y = whole.pull(whole.Y).ravel()
    Sigma = columns @ np.diag(v.ravel()) @ columns.T + np.diag(np.tile([0.5, 2.0], N))
    gain = np.diag(v.ravel()) @ columns.T @ np.linalg.inv(Sigma)
    density = -0.5 * (np.linalg.slogdet(Sigma)[1] + y @ np.linalg.solve(Sigma, y))
    return float(density), gain @ y, np.diag(v.ravel()) - gain @ columns @ np.diag(v.ravel()), Sigma


def test_density_mean_and_scores_are_those_of_the_dense_gaussian() -> None:
    whole, columns = periodic()
    pass_, v = weighed(whole)
    density, mean, _, Sigma = dense(whole, columns, v)
    assert pass_.evidence == pytest.approx(density, rel=1e-10)
    np.testing.assert_allclose(pass_.of_data[2].ravel(), mean, atol=1e-10)
    under = (ACT[:, None] * LOADS + np.arange(LOADS)).ravel()
    rho = columns.T @ np.linalg.solve(Sigma, whole.pull(whole.Y).ravel())
    known = np.einsum("ij,ij->j", columns, np.linalg.solve(Sigma, columns))
    up, down = pass_.scores()
    np.testing.assert_allclose(up.ravel(), rho[under] ** 2, rtol=1e-8)
    np.testing.assert_allclose(down.ravel(), known[under], rtol=1e-8)
    pulled, expected, square, each = pass_.line_scores()
    np.testing.assert_allclose(pulled, np.sum(rho.reshape(N, LOADS) ** 2, axis=0), rtol=1e-8)
    np.testing.assert_allclose(expected, np.sum(known.reshape(N, LOADS), axis=0), rtol=1e-8)
    weighty = np.linalg.solve(Sigma, whole.pull(whole.Y).ravel()).reshape(N, SENSORS)
    np.testing.assert_allclose(whole.weight @ square, np.sum(weighty**2, axis=0), rtol=1e-8)
    inverse = np.diag(np.linalg.inv(Sigma)).reshape(N, SENSORS).sum(axis=0)
    np.testing.assert_allclose(whole.weight @ each, inverse, rtol=1e-8)


def prior_of(whole: Spectrum, memory: float, pass_: Weighed, v: np.ndarray) -> tuple[LocalLinesPrior, np.ndarray]:
    """A prior of given variances, and what makes loads of its white input."""
    plain = replace(whole, H=whole.H / whole.filter(memory)[:, None, None])
    fit = LinesFit(plain, memory, ACT, stated=True)
    fit.floor, fit.r = pass_.floor, np.array([0.5, 2.0])
    object.__setattr__(fit, "weighed", lambda: pass_)
    found = LocalLinesPrior(evidence=0.0, memory=memory, stationary=fit, compared=v, correlation=0.0, misfit=0.0,
                            bumps=1, updates=0, fit=fit)  # fmt: skip
    turn = np.fft.irfft(whole.filter(memory))
    return found, np.kron(np.array([np.roll(turn, k) for k in range(N)]).T, np.eye(LOADS))


@pytest.mark.parametrize("memory", [0.0, 2.0])
def test_what_stands_in_gaps_tells_nothing(memory: float) -> None:
    """Against the dense Gaussian of the samples that were recorded."""
    whole, columns = periodic(memory)
    filled = np.zeros((N, SENSORS), bool)
    filled[12:17], filled[30, 0] = True, True
    whole = replace(whole, filled=filled, weighing=np.ones(whole.Y.shape))
    pass_, v = weighed(whole)
    found, F = prior_of(whole, memory, pass_, v)
    load, band, _ = found.with_gaps().posterior()
    there = ~filled.ravel()
    y, K = whole.pull(whole.Y).ravel()[there], columns[there] @ np.diag(v.ravel())
    Sigma = K @ columns[there].T + np.diag(np.tile([0.5, 2.0], N)[there])
    covariance = F @ (np.diag(v.ravel()) - K.T @ np.linalg.solve(Sigma, K)) @ F.T
    np.testing.assert_allclose(load.ravel(), F @ K.T @ np.linalg.solve(Sigma, y), atol=1e-8)
    np.testing.assert_allclose(band.std.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-6)
    assert found.with_gaps().gaps is not None
    assert found.posterior()[1].std.sum() < band.std.sum()


@pytest.mark.parametrize("memory", [0.0, 2.0])
def test_band_is_that_of_the_dense_gaussian_and_travels(memory: float) -> None:
    whole, columns = periodic(memory)
    pass_, v = weighed(whole)
    found, F = prior_of(whole, memory, pass_, v)
    load, band, _ = found.posterior()
    _, mean, covariance, _ = dense(whole, columns, v)
    covariance = F @ covariance @ F.T
    np.testing.assert_allclose(load.ravel(), F @ mean, atol=1e-9)
    np.testing.assert_allclose(band.std.ravel(), np.sqrt(np.diag(covariance)), rtol=1e-6)
    w = np.random.default_rng(1).standard_normal((3, N, LOADS))
    flat = w.reshape(3, -1)
    np.testing.assert_allclose(band.variance(w), np.einsum("ki,ij,kj->k", flat, covariance, flat), rtol=1e-8)
    again = from_arrays(band.to_arrays())
    np.testing.assert_allclose(again.std, band.std)
    with pytest.raises(InputError, match="weights do not fit"):
        band.variance(np.zeros((N, 5)))


def answers(error: str, seeds: range) -> list[tuple[hammer.Problem, LoadEstimate]]:
    """Records of a hammer test and their answers, as a user gets them."""
    drawn = [hammer.problem(seed, error) for seed in seeds]
    return [(one, one.inversion().estimate(one.record, one.dt)) for one in drawn]


def test_impacts_by_measured_frfs() -> None:
    errors, inside = [], []
    for one, found in answers("none", (9901, 9903, 9906, 9908, 9909, 9911)):
        assert found.facts["variance"] == "local"
        errors.append(np.linalg.norm(found.load - one.truth) / np.linalg.norm(one.truth))
        k = int(np.argmax(np.abs(one.truth[:, 0])))
        inside.append(abs(found.load[k, 0] - one.truth[k, 0]) <= 1.96 * found.std[k, 0])
    assert np.median(errors) < 0.1
    assert sum(inside) >= 5


def test_lines_that_are_no_more_than_errors_tell_no_load() -> None:
    """Accelerometers in noise at the lowest lines: what errors make of a zero FRF hid half of the pulse in silence."""
    for one, found in answers("none", (315, 343, 373)):
        there = np.abs(one.truth) > 0.02 * np.abs(one.truth).max()
        assert np.mean((np.abs(found.load - one.truth) < 1.96 * found.std)[there]) > 0.9
        assert np.linalg.norm(found.load - one.truth) < 0.05 * np.linalg.norm(one.truth)  # was .36 to .52


@pytest.mark.parametrize("seed", [3433, 3439, 3455])
@pytest.mark.parametrize("start", [-200, 15])
def test_a_gap_that_no_hit_is_in_costs_nothing(seed: int, start: int) -> None:
    """From the end of the record, or from the end of the last hit."""
    ((one, whole),) = answers("none", range(seed, seed + 1))
    there = np.abs(one.truth[:, 0]) > 0.05 * np.abs(one.truth).max()
    at = start + (len(one.record) if start < 0 else int(np.flatnonzero(there)[-1]))
    record = one.record.copy()
    record[at : at + 12] = np.nan
    found = one.inversion().estimate(record, one.dt)
    assert found.facts["variance"] == whole.facts["variance"] == "local"
    off, before = (np.linalg.norm((e.load - one.truth)[there]) for e in (found, whole))
    assert off < 1.3 * before
    assert np.mean((np.abs(found.load - one.truth) < 1.96 * found.std)[there]) > 0.85
    assert found.facts["missing"].startswith("12 of 1024 samples of s0")


@pytest.mark.parametrize("error", ["slow", "random"])
def test_loads_that_are_no_impacts_keep_the_constant_variance(error: str) -> None:
    for _, found in answers(error, range(9910, 9913)):
        assert found.facts["variance"] == "constant"


def test_a_second_hit_far_away_is_not_overlooked() -> None:
    rng, t = np.random.default_rng(2), np.arange(4096)
    h = np.array([np.exp(-t / 150) * np.sin(w * t) for w in (0.3, 1.1)]).T
    drawn = [np.where((t >= 20) & (t < 20 + n), np.sin(np.pi * (t - 20) / n), 0.0) for n in (5, 6, 7)]
    hits = [np.column_stack([f, fftconvolve(f[:, None], h, axes=0)[:4096]]) for f in drawn]
    tests = [hit + 1e-5 * rng.standard_normal(hit.shape) for hit in hits]
    model = MeasuredModel.from_hits(tests, dt=1e-3, force=0, responses=[1, 2])
    force = np.zeros(4096)
    force[200:206], force[2500:2506] = 50.0, 0.5
    y = fftconvolve(force[:, None], h, axes=0)[:4096]
    y += 1e-4 * rng.standard_normal(y.shape)
    found = Deconvolution(model).estimate(y, 1e-3)
    assert found.facts["variance"] == "local"
    np.testing.assert_allclose(found.load[200:206, 0], 50.0, rtol=0.05)
    np.testing.assert_allclose(found.load[2500:2506, 0], 0.5, rtol=0.1)


def test_the_band_holds_the_scatter_of_the_hits_and_what_is_stated_of_gains() -> None:
    one = hammer.problem(9901)
    k = int(np.argmax(np.abs(one.truth[:, 0])))
    shares = []
    for gain in (0.0, 0.1):
        found = Deconvolution(one.model, noise=Noise(errors={"gain": gain})).estimate(one.record, one.dt)
        shares.append(found.std[k, 0] / abs(found.load[k, 0]))
    assert shares[0] < 0.06
    assert shares[1] > 0.08
    np.testing.assert_allclose(np.diag(one.model.gain_covariance) ** 0.5, hammer.GAIN, rtol=0.9)
    part = one.model.with_sensors([0])
    np.testing.assert_allclose(part.gain_covariance, one.model.gain_covariance[:1, :1])


def test_a_load_that_acts_throughout_is_not_learned_even_if_asked_for() -> None:
    one = hammer.problem(9910, "random")
    found = one.inversion(penalty=Penalty("identity", variance="local")).estimate(one.record, one.dt)
    assert found.facts["variance"] == "constant"
    assert "too many samples" in found.facts["variance_because"]


def test_active_samples_are_few_or_none() -> None:
    load = np.zeros((5000, 1))
    load[1000:1010] = 1.0
    few = active(load, 600)
    assert few[0] < 1000 <= 1009 < few[-1]
    assert len(few) < 100
    assert len(active(np.ones((5000, 1)), 600)) == 0


def test_a_line_that_was_divided_by_nothing_leaves_its_neighbours() -> None:
    rng = np.random.default_rng(8)
    H = np.exp(2j * np.pi * rng.random((65, 1, 1)))
    variance = np.full(H.shape, 1e-4)
    H[30], variance[30] = 1e12, 1e24
    found = Spectrum.of(SpectralPath(H, rng.standard_normal((64, 1)), np.ones((65, 1)), variance=variance))
    assert found.H[30] == 0
    alone = np.abs(np.delete(found.H, 30)) / np.sqrt(64)
    np.testing.assert_allclose(alone, 1.0, rtol=1e-3)


def test_what_stands_in_gaps_tells_nothing_under_one_variance() -> None:
    """Against the dense ridge of the padded record without the rows that were not recorded."""
    rng = np.random.default_rng(8)
    samples, sigma, lam = 24, 0.3, 0.05
    h = rng.standard_normal((samples, 2, 1)) * np.exp(-np.arange(samples) / 4)[:, None, None]
    y, filled = rng.standard_normal((samples, 2)), np.zeros((samples, 2), bool)
    filled[9:13], filled[20, 1] = True, True
    padded = padded_length(samples)
    H = np.fft.rfft(h, padded, axis=0)
    path = SpectralPath(H, y, np.full((len(H), 2), samples * sigma**2), filled=filled)
    found = path.solution(lam, 1.0)
    full = np.concatenate([h, np.zeros((padded - samples, 2, 1))])
    T = np.stack([np.roll(full, k, axis=0)[..., 0] for k in range(padded)], axis=-1).reshape(-1, padded) / sigma
    data, there = np.zeros((padded, 2)), np.ones((padded, 2), bool)
    data[:samples], there[:samples] = y / sigma, ~filled
    A, b = T[there.ravel()], data.ravel()[there.ravel()]
    stacked = np.vstack([A, lam * path.scale * np.eye(padded)])
    g = np.linalg.lstsq(stacked, np.concatenate([b, np.zeros(padded)]), rcond=None)[0]
    R = np.linalg.qr(stacked, mode="r")
    std = np.linalg.norm(np.linalg.inv(R), axis=1)
    np.testing.assert_allclose(found.load[:, 0], g[:samples], atol=1e-9)
    np.testing.assert_allclose(found.posterior.std[:, 0], std[:samples], rtol=1e-7)
    assert np.all(SpectralPath(H, y, np.full((len(H), 2), samples * sigma**2)).solution(lam, 1.0).posterior.std
                  < found.posterior.std)  # fmt: skip
