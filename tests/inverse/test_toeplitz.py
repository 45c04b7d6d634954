"""The convolution operator, and the FFT path against dense circulants and against the dense path."""

import numpy as np
import pytest
import scipy.linalg

from loadid._inverse.convolved.path import SpectralPath
from loadid.paths import LinearProblem, SVDPath, toeplitz
from structures._testing.spectra import padded_length
from structures.errors import InputError, NotIdentifiable

from .reference import augmented, echo, penalty

N, SIGMA = 20, 0.3
P = padded_length(N)


def test_operator_is_convolution() -> None:
    rng = np.random.default_rng(0)
    h, g = rng.standard_normal((9, 3, 2)), rng.standard_normal((9, 2))
    T = toeplitz(h)
    assert T.shape == (9, 3, 18)
    for s in range(3):
        for j in range(2):
            expected = scipy.linalg.toeplitz(h[:, s, j], np.zeros(9))
            np.testing.assert_array_equal(T[:, s].reshape(9, 9, 2)[..., j], expected)
        mixed = sum(np.convolve(h[:, s, j], g[:, j])[:9] for j in range(2))
        np.testing.assert_allclose((T @ g.ravel())[:, s], mixed, atol=1e-13)
    assert toeplitz(h[:1]).shape == (1, 3, 2)


def circulant(h: np.ndarray) -> np.ndarray:
    """Dense (P * sensors, P * loads) circular convolution over the padded length, time first."""
    samples, sensors, loads = h.shape
    padded = np.concatenate([h, np.zeros((P - samples, sensors, loads))])
    lag = (np.arange(P)[:, None] - np.arange(P)[None]) % P
    return padded[lag].transpose(0, 2, 1, 3).reshape(P * sensors, P * loads)


def periodic(name: str, loads: int) -> np.ndarray:
    D = np.eye(P) - np.roll(np.eye(P), 1, axis=1)
    D = {"identity": np.eye(P), "first_difference": D, "second_difference": D @ D}[name]
    return np.kron(D, np.eye(loads))


def spectral(h: np.ndarray, y: np.ndarray, name: str = "identity", truncated: bool = False) -> SpectralPath:
    power = np.full((P // 2 + 1, y.shape[1]), N * SIGMA**2)
    return SpectralPath(np.fft.rfft(h, P, axis=0), y, power, penalty=name, truncated=truncated)


def record(sensors: int, loads: int) -> tuple[np.ndarray, np.ndarray]:
    h = echo(N, sensors, loads, seed=7, decay=5.0)
    return h, np.random.default_rng(1).standard_normal((N, sensors))


@pytest.mark.parametrize("name", ["identity", "first_difference", "second_difference"])
@pytest.mark.parametrize(("sensors", "loads"), [(1, 1), (3, 2), (2, 2), (1, 2)])
def test_path_is_the_dense_padded_circulant(sensors: int, loads: int, name: str) -> None:
    h, y = record(sensors, loads)
    if name != "identity" and sensors < loads:
        with pytest.raises(NotIdentifiable, match="constant"):
            spectral(h, y, name)
        return
    path = spectral(h, y, name)
    H, L = circulant(h) / SIGMA, periodic(name, loads)
    z = np.concatenate([y, np.zeros((P - N, sensors))]).ravel() / SIGMA
    for lam in (1e-3, 0.05, 0.6):
        x, p = lam * float(path.scale), path.at(lam)
        ref = augmented(H, z, L, x)
        solution = path.solution(lam, 1.0)
        np.testing.assert_allclose(solution.load, ref.load.reshape(P, loads)[:N], atol=1e-8)
        np.testing.assert_allclose(path.residual(lam), ref.residual.reshape(P, sensors)[:N], atol=1e-8)
        assert float(p.residual2) == pytest.approx(ref.residual @ ref.residual, rel=1e-8)
        assert float(p.penalty2) == pytest.approx(ref.penalty2, rel=1e-8)
        # noise that fills the record makes N / P of the lines independent
        assert float(p.edf) == pytest.approx(N / P * np.trace(ref.A), rel=1e-9)
        assert float(p.edf2) == pytest.approx(N / P * np.trace(ref.A @ ref.A), rel=1e-9)
        assert float(p.left) == pytest.approx(N * sensors - N / P * np.trace(ref.A), rel=1e-8)
        covariance = np.linalg.solve(H.T @ H + x**2 * L.T @ L, np.eye(P * loads))
        expected = np.sqrt(np.diag(covariance)).reshape(P, loads)[:N]
        np.testing.assert_allclose(solution.posterior.std, expected, rtol=1e-6)
        w = np.random.default_rng(2).standard_normal((3, N, loads))
        flat = np.concatenate([w, np.zeros((3, P - N, loads))], axis=1).reshape(3, -1)
        expected = np.einsum("ki,ij,kj->k", flat, covariance, flat)
        np.testing.assert_allclose(solution.posterior.variance(w), expected, rtol=1e-6)


def test_truncation_keeps_whole_lines() -> None:
    h, y = record(2, 2)
    path, H = spectral(h, y, truncated=True), circulant(h) / SIGMA
    z = np.concatenate([y, np.zeros((P - N, 2))]).ravel() / SIGMA
    U, s, Vt = np.linalg.svd(H)
    for lam in (0.1, 0.35):
        keep = s >= lam * s[0]
        expected = Vt[keep].T @ ((U.T @ z)[keep] / s[keep])
        np.testing.assert_allclose(path.solution(lam, None).load, expected.reshape(P, 2)[:N], atol=1e-9)
        assert float(path.at(lam).edf) == pytest.approx(N / P * keep.sum())


@pytest.mark.parametrize("name", ["identity", "first_difference"])
@pytest.mark.parametrize("seed", range(4))
def test_decayed_records_have_one_answer_on_both_paths(seed: int, name: str) -> None:
    n, sigma = 200, 0.05
    h = echo(n, 2, 1, seed, decay=10.0)
    g = 5 * np.exp(-0.5 * ((np.arange(n) - 90) / 4) ** 2)[:, None]
    T = toeplitz(h)
    y = T @ g[:, 0] + sigma * np.random.default_rng(seed).standard_normal((n, 2))
    dense = SVDPath(LinearProblem.whitened(T, y, [sigma] * 2, None if name == "identity" else penalty(name, n), (n, 1)))
    lines = padded_length(n) // 2 + 1
    fast = SpectralPath(np.fft.rfft(h, padded_length(n), axis=0), y, np.full((lines, 2), n * sigma**2), penalty=name)
    x = 0.03 * float(dense.scale) if name == "identity" else 30.0
    a, b = dense.solution(x / float(dense.scale), 1.0), fast.solution(x / float(fast.scale), 1.0)
    assert np.linalg.norm(a.load - b.load) < 0.03 * np.linalg.norm(a.load)
    middle = slice(60, 140)
    assert np.linalg.norm((a.load - b.load)[middle]) < 1e-3 * np.linalg.norm(a.load)
    np.testing.assert_allclose(a.posterior.std[middle], b.posterior.std[middle], rtol=0.01)
    p, q = dense.at(x / float(dense.scale)), fast.at(x / float(fast.scale))
    assert float(q.edf) == pytest.approx(float(p.edf), rel=0.05)
    assert float(q.residual2) == pytest.approx(float(p.residual2), rel=0.05)
    w = np.exp(-0.5 * ((np.arange(n) - 100) / 10) ** 2)[:, None]
    assert b.posterior.variance(w) == pytest.approx(a.posterior.variance(w), rel=0.02)


def test_a_sensor_with_less_noise_counts_more() -> None:
    h, y = record(2, 1)
    H = np.fft.rfft(h, P, axis=0)
    power = np.full((P // 2 + 1, 2), 1e-4)
    power[:, 1] = 1e8
    both, one = SpectralPath(H, y, power), SpectralPath(H[:, :1], y[:, :1], power[:, :1])
    np.testing.assert_allclose(both.solution(0.1, None).load, one.solution(0.1, None).load, rtol=1e-4, atol=1e-6)


def test_variance_of_the_model_widens_the_band() -> None:
    """Scatter of the estimate over draws of a noisy FRF, against the stated std."""
    n = 128
    padded = padded_length(n)
    h = echo(n, 1, 1, seed=3, decay=4.0)
    rng, H = np.random.default_rng(0), np.fft.rfft(h, padded, axis=0)
    g = np.exp(-0.5 * ((np.arange(n) - 40) / 2.0) ** 2)[:, None]
    y = np.fft.irfft(H[:, 0] * np.fft.rfft(g, padded, axis=0), padded, axis=0)[:n]
    variance = np.full(H.shape, (0.03 * np.abs(H).mean()) ** 2)
    power = np.full(H.shape[:2], n * 1e-6)
    loads, stated = [], []
    for _ in range(120):
        # errors of the FRF come from records as long as this one: their impulse response lasts n samples
        error = np.fft.rfft(rng.standard_normal((n, 1, 1)), padded, axis=0) * np.sqrt(variance / n)
        path = SpectralPath(H + error, y, power, variance=variance)
        solution = path.solution(0.02, 1.0)
        loads.append(solution.load)
        stated.append(float(np.median(solution.posterior.std)))
    noise_only = float(np.median(SpectralPath(H, y, power).solution(0.02, 1.0).posterior.std))
    scatter = float(np.sqrt(np.mean(np.var(loads, axis=0))))
    assert scatter > 3 * noise_only
    assert 0.7 < np.median(stated) / scatter < 1.5


def test_a_constant_that_accelerometers_do_not_see_is_refused() -> None:
    h, y = record(1, 1)
    H = np.fft.rfft(h, P, axis=0)
    H[0] = 1e-17
    power = np.full((P // 2 + 1, 1), 1.0)
    with pytest.raises(NotIdentifiable, match="constant") as caught:
        SpectralPath(H, y, power, penalty="first_difference")
    assert caught.value.code == "LID-E306"
    assert np.all(np.isfinite(SpectralPath(H, y, power).solution(1e-3, 1.0).load))


@pytest.mark.parametrize("where", ["H", "y", "power", "variance", "zero power", "lines"])
def test_nan_and_misfits_are_refused(where: str) -> None:
    h, y = record(2, 1)
    parts = {"H": np.fft.rfft(h, P, axis=0), "y": y, "power": np.ones((P // 2 + 1, 2))}
    parts["variance"] = np.ones(parts["H"].shape)
    if where == "zero power":
        parts["power"][3] = 0
    elif where == "lines":
        parts["H"] = parts["H"][1:]
    else:
        parts[where][0] = np.nan
    with pytest.raises(InputError, match="spectral path"):
        SpectralPath(parts["H"], parts["y"], parts["power"], variance=parts["variance"])
