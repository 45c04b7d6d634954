"""FRF estimators against exact responses, closed forms of their bias, and the scatter of simulated tests."""

import numpy as np
import pytest

from structures import Channel, CrossSpectra, InputError, NotIdentifiable, cross_spectra
from structures._flags import codes
from structures._testing.frfs import estimate

N, DT = 128, 1e-3
LINES = np.fft.rfftfreq(N, DT)
FIR = np.random.default_rng(3).standard_normal((6, 3, 2)) * np.exp(-np.arange(6) / 2)[:, None, None]
EXACT = np.fft.rfft(FIR, N, axis=0)
MIX = np.array([[1.0, 0.8], [0.0, 0.6]])  # forces of equal power with a coherence of 0.64


def spectra(count, forces=(0, 1), mix=MIX, force_noise=0.0, response_noise=0.0, seed=0, colour=1.0):
    """Cross spectra of periodic tests, each period a realisation of its own: no leakage. Forces first, then sensors."""
    rng = np.random.default_rng(seed)
    f = rng.standard_normal((count, N, 2)) @ mix
    f = f[..., list(forces)]
    F = np.fft.rfft(f, axis=1) * colour
    f = np.fft.irfft(F, N, axis=1)
    y = np.fft.irfft(np.einsum("kij,tkj->tki", EXACT[..., list(forces)], F), N, axis=1)
    f = f + force_noise * rng.standard_normal(f.shape)
    y = y + response_noise * rng.standard_normal(y.shape)
    names = [*(f"f{j}" for j in forces), "y0", "y1", "y2"]
    noise = [*[force_noise] * len(forces), *[response_noise] * 3]
    channels = [Channel(label=n, noise=s or None) for n, s in zip(names, noise, strict=True)]
    X = np.fft.rfft(np.concatenate([f, y], axis=2), axis=1).transpose(1, 2, 0)
    scale = np.where(np.isin(LINES, LINES[[0, -1]]), 1.0, 2.0) * DT / N / count
    return CrossSpectra(LINES, scale[:, None, None] * (X @ X.conj().transpose(0, 2, 1)), channels, float(count))


class TestExact:
    @pytest.mark.parametrize(
        ("estimator", "forces", "sensors"),
        [
            ("H1", (0,), (0, 1, 2)),
            ("H1", (0, 1), (0, 1, 2)),
            ("H2", (1,), (0, 1, 2)),
            ("H2", (0, 1), (0, 2)),
            ("Hv", (0,), (0, 1, 2)),
            ("Hv", (0, 1), (0, 1, 2)),
        ],
    )
    def test_without_noise(self, estimator, forces, sensors):
        found = estimate(spectra(8, forces), [f"f{j}" for j in forces], [f"y{i}" for i in sensors], estimator)
        expected = EXACT[:, list(sensors)][..., list(forces)]
        assert np.abs(found.H - expected).max() < 1e-7 * np.abs(expected).max()
        assert found.coherence == pytest.approx(1, abs=1e-9)
        assert found.variance.max() < 1e-12
        assert np.all(found.variance >= 0)
        assert found.flags == ()

    def test_ordinary_coherence_of_correlated_forces(self):
        """Each force alone explains less than both, unless there is one."""
        both = estimate(spectra(400), [0, 1], [2, 3, 4])
        assert both.coherence == pytest.approx(1, abs=1e-9)
        S_ff = MIX.T @ MIX
        power = np.einsum("kij,jm,kim->ki", EXACT, S_ff, EXACT.conj()).real
        alone = np.abs(np.einsum("kij,jm->kim", EXACT, S_ff)) ** 2 / (power[..., None] * np.diag(S_ff))
        assert np.mean(np.abs(both.ordinary - alone)) < 0.03
        one = estimate(spectra(40, (0,)), [0], [1, 2, 3])
        assert one.ordinary[..., 0] == pytest.approx(one.coherence)

    def test_one_segment_of_one_force_has_an_frf_and_no_variance(self):
        found = estimate(spectra(1, (0,)), [0], [1, 2, 3])
        assert found.H[..., 0] == pytest.approx(EXACT[..., 0], rel=1e-8)
        assert found.variance is None

    def test_units(self):
        """Forces in mN and responses in km: the same FRF in other units, the same coherence and flags."""
        S = spectra(20, response_noise=0.3)
        d = np.array([1e6, 1e3, 1e-6, 1e-3, 1.0])
        scaled = CrossSpectra(S.frequencies, d[:, None] * S.matrix * d, S.channels, S.averages)
        for estimator in ("H1", "Hv"):
            a, b = (estimate(x, [0, 1], [2, 3, 4], estimator) for x in (S, scaled))
            factor = d[2:, None] / d[:2]
            np.testing.assert_allclose(b.H, a.H * factor, rtol=1e-7)
            np.testing.assert_allclose(b.variance, a.variance * factor**2, rtol=1e-6)
            assert b.coherence == pytest.approx(a.coherence)


class TestBias:
    """Expectations in closed form, from 4000 tests."""

    NY, NF = 0.6, 0.5

    def mean_ratio(self, estimator, **noise):
        """Estimate over truth, the mean over lines weighted by power, for one white force of unit power."""
        found = estimate(spectra(4000, (0,), np.eye(2), **noise), [0], [1, 2, 3], estimator)
        truth = EXACT[..., :1]
        weight = np.abs(truth) ** 2
        assert np.abs(np.sum(weight * (found.H / truth).imag) / weight.sum()) < 0.01
        return np.sum(weight * (found.H / truth).real) / weight.sum(), np.sum(np.abs(truth) ** 2), truth.size

    def test_response_noise(self):
        h1, power, size = self.mean_ratio("H1", response_noise=self.NY)
        h2, *_ = self.mean_ratio("H2", response_noise=self.NY)
        hv, *_ = self.mean_ratio("Hv", response_noise=self.NY)
        assert h1 == pytest.approx(1, abs=0.005)
        assert h2 == pytest.approx(1 + self.NY**2 * size / power, rel=0.01)
        assert h1 < hv < h2

    def test_force_noise(self):
        h1, *_ = self.mean_ratio("H1", force_noise=self.NF)
        h2, *_ = self.mean_ratio("H2", force_noise=self.NF)
        hv, *_ = self.mean_ratio("Hv", force_noise=self.NF)
        assert h1 == pytest.approx(1 / (1 + self.NF**2), abs=0.005)
        assert h2 == pytest.approx(1, abs=0.005)
        assert hv == pytest.approx(np.sqrt(h1 * h2), abs=0.005)

    def test_noise_in_both_that_is_known(self):
        hs, *_ = self.mean_ratio("Hs", force_noise=self.NF, response_noise=self.NY)
        h1, *_ = self.mean_ratio("H1", force_noise=self.NF, response_noise=self.NY)
        assert hs == pytest.approx(1, abs=0.01)
        assert h1 < 0.85

    def test_hv_of_one_force_is_the_geometric_mean(self):
        S = spectra(10, (0,), force_noise=0.4, response_noise=0.5)
        h1, h2, hv = (estimate(S, [0], [1, 2, 3], e).H for e in ("H1", "H2", "Hv"))
        np.testing.assert_allclose(np.abs(hv), np.sqrt(np.abs(h1 * h2)), rtol=1e-9)
        np.testing.assert_allclose(hv / np.abs(hv), h1 / np.abs(h1), rtol=1e-9)

    def test_coherence_of_known_noise(self):
        found = estimate(spectra(4000, response_noise=self.NY), [0, 1], [2, 3, 4])
        power = np.einsum("kij,jm,kim->ki", EXACT, MIX.T @ MIX, EXACT.conj()).real
        assert found.coherence == pytest.approx(power / (power + self.NY**2), abs=0.06)
        density = np.where(np.isin(LINES, LINES[[0, -1]]), 1.0, 2.0)[:, None] * DT * self.NY**2
        assert found.residual / density == pytest.approx(np.ones((len(LINES), 3)), rel=0.15)

    def test_residual_of_few_averages(self):
        """Two of six averages are spent on the fit of two forces; what is left has the level of the noise."""
        found = [estimate(spectra(6, response_noise=self.NY, seed=k), [0, 1], [2, 3, 4]).residual for k in range(100)]
        assert np.mean(found, axis=(0, 2))[1:-1] / (2 * DT * self.NY**2) == pytest.approx(np.ones(63), rel=0.25)
        assert np.mean(np.array(found)[:, 1:-1]) / (2 * DT * self.NY**2) == pytest.approx(1, abs=0.03)


class TestVariance:
    """Predicted over empirical variance, over 200 simulated tests, in the median of lines and entries."""

    @pytest.mark.parametrize(
        ("estimator", "forces", "sensors", "force_noise", "response_noise"),
        [
            ("H1", (0,), (0, 1, 2), 0.0, 0.5),
            ("H1", (0, 1), (0, 1, 2), 0.0, 0.5),
            ("H2", (0,), (0, 1, 2), 0.5, 0.0),
            ("H2", (0, 1), (0, 2), 0.1, 0.0),
            ("Hv", (0,), (0, 1, 2), 0.3, 0.3),
            ("Hv", (0, 1), (0, 1, 2), 0.1, 0.1),
            ("Hs", (0, 1), (0, 1, 2), 0.1, 0.1),
        ],
    )
    def test_independent_segments(self, estimator, forces, sensors, force_noise, response_noise):
        loads, rows = [f"f{j}" for j in forces], [f"y{i}" for i in sensors]
        found = [
            estimate(spectra(40, forces, MIX, force_noise, response_noise, seed), loads, rows, estimator)
            for seed in range(200)
        ]
        self.agrees(found)

    @pytest.mark.parametrize("overlap", [0.5, 0.75])
    def test_overlapping_segments(self, overlap):
        """Effective averages stand for the segments, which are not independent."""
        rng, found = np.random.default_rng(9), []
        for _ in range(200):
            f = rng.standard_normal((2048, 2)) @ MIX
            y = sum(np.stack([np.convolve(f[:, j], FIR[:, i, j])[:2048] for i in range(3)], axis=1) for j in (0, 1))
            x = np.hstack([f, y + 0.5 * rng.standard_normal(y.shape)])
            found.append(estimate(cross_spectra(x, DT, segment=N, overlap=overlap), [0, 1], [2, 3, 4]))
        self.agrees(found)

    def agrees(self, found):
        empirical = np.var([e.H for e in found], axis=0, ddof=1)
        ratio = np.mean([e.variance for e in found], axis=0) / empirical
        assert np.median(ratio[2:-2], axis=0) == pytest.approx(1, abs=0.1)


class TestForces:
    def test_forces_that_are_one(self):
        with pytest.raises(NotIdentifiable, match=r"f0, f1 are one.*65 of 65 lines") as caught:
            estimate(spectra(20, mix=np.array([[1.0, -3.0], [0.0, 0.0]])), [0, 1], [2])
        assert caught.value.code == "LID-E212"
        assert "independent" in caught.value.advice

    def test_fewer_averages_than_forces(self):
        with pytest.raises(NotIdentifiable, match="1 averages do not tell 2 forces"):
            estimate(spectra(1), [0, 1], [2])

    def test_nearly_one(self):
        found = estimate(spectra(50, mix=np.array([[1.0, 1.0], [0.0, 0.05]]), response_noise=0.1), [0, 1], [2])
        assert codes(found.flags) == {"W212"}
        assert np.median(found.inflation) == pytest.approx(400, rel=0.1)  # 1 / (1 - coherence) = 1 + 1 / 0.05^2
        assert codes(estimate(spectra(50, response_noise=0.1), [0, 1], [2]).flags) == set()

    def test_lines_without_force_are_left_out(self):
        colour = np.where((LINES > 100) & (LINES < 300), 1.0, 0.0)[:, None]
        found = estimate(spectra(20, colour=colour), [0, 1], [2, 3, 4])
        np.testing.assert_array_equal(found.kept, colour[:, 0] > 0)
        np.testing.assert_array_equal(found.frequencies, LINES[found.kept])
        assert np.abs(found.H - EXACT[found.kept]).max() < 1e-9

    def test_a_silent_force(self):
        with pytest.raises(InputError, match="no energy"):
            estimate(spectra(20, mix=np.diag([1.0, 0.0])), [0, 1], [2])

    def test_a_silent_sensor(self):
        S = spectra(20)
        d = np.array([1, 1, 0, 1, 1])
        still = CrossSpectra(S.frequencies, d[:, None] * S.matrix * d, S.channels, S.averages)
        for estimator in ("H1", "Hv"):
            found = estimate(still, [0, 1], [2, 3], estimator)
            assert np.all(found.H[:, 0] == 0)
            assert np.all(found.coherence[:, 0] == 0)
            assert np.all(np.isfinite(found.variance))

    @pytest.mark.parametrize(
        ("loads", "sensors", "estimator", "words"),
        [
            ([0, 1], [2], "H3", "unknown estimator"),
            ([0, 1], [1, 2], "H1", "at once"),
            (["f7"], [1, 2], "H1", "no such channel"),
            ([0, 0], [2], "H1", "named twice"),
            ([0, 1], [2], "H2", "as many sensors"),
            ([0, 1], [2], "Hs", "noise of f0, f1, y0"),
        ],
    )
    def test_refused(self, loads, sensors, estimator, words):
        with pytest.raises(InputError, match=words):
            estimate(spectra(10), loads, sensors, estimator)

    def test_responses_that_do_not_tell_the_forces_apart(self):
        S = spectra(20)
        T = np.eye(5)
        T[3] = 2 * T[2]
        same = CrossSpectra(S.frequencies, T @ S.matrix @ T.T, S.channels, S.averages)
        with pytest.raises(NotIdentifiable, match="responses do not tell"):
            estimate(same, [0, 1], [2, 3], "H2")
