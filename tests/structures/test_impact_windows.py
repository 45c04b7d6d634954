"""Windows of impact tests: what they do to damping and noise, and that both are put right."""

import numpy as np
import pytest

from structures import InputError, MeasuredModel
from structures._testing.spectra import exponential, gate, taken_out

from .impacts import DT, blow, hits, record, response, transfer

F0, ZETA, SAMPLES = 60.0, 0.002, 1024  # a memory of 1.3 s, a record of 1 s


def light(samples):
    """Impulse response (samples, 1) that a record of 1024 samples cuts."""
    t = np.arange(samples) * DT
    return (np.exp(-ZETA * 2 * np.pi * F0 * t) * np.cos(2 * np.pi * F0 * t))[:, None]


def closed(f, added=0.0):
    """Transform of `light` without end, its decay rate raised by `added` (1/s)."""
    p = np.exp((-(ZETA * 2 * np.pi * F0 + added) + 2j * np.pi * F0) * DT)
    z = np.exp(-2j * np.pi * np.asarray(f) * DT)
    return 0.5 * (1 / (1 - p * z) + 1 / (1 - p.conj() * z))


def model(tables, **settings):
    return MeasuredModel.from_hits(tables, dt=DT, force=0, responses=[1], **settings)


class TestExponential:
    DECAY = 6.0

    def test_it_shifts_the_axis(self):
        """Windowed force and response have the ratio H(omega - i a): damping grows by a / omega."""
        y = record(blow(6000), light(6000))
        w = exponential(6000, DT, self.DECAY)[:, None]
        f = np.arange(10.0, 400.0, 7.0)
        wave = np.exp(-2j * np.pi * np.outer(f, np.arange(6000) * DT))
        F, Y = (wave @ (y * w)).T
        assert pytest.approx(closed(f, self.DECAY), rel=1e-6) == Y / F
        # the half-power width of the peak is 2 (zeta omega + a)
        g = np.linspace(40, 80, 40001)
        above = g[np.abs(closed(g, self.DECAY)) > np.abs(closed(g, self.DECAY)).max() / np.sqrt(2)]
        assert np.ptp(above) * np.pi == pytest.approx(ZETA * 2 * np.pi * F0 + self.DECAY, rel=0.01)

    def test_the_damping_is_taken_out_again(self):
        tables = [record(blow(SAMPLES, 20 + k, 100.0), light(SAMPLES)) for k in range(3)]
        windowed = model(tables, decay=self.DECAY)
        assert np.abs(windowed.impulse_response(DT, 900) - light(900)[..., None]).max() < 1e-10
        np.testing.assert_allclose(windowed.H, model(tables).H, atol=1e-6 * np.abs(windowed.H).max())

    def test_of_an_imported_frf(self):
        """An analyser's FRF over one record, without padding."""
        h = light(SAMPLES)[:, 0] * exponential(SAMPLES, DT, self.DECAY)
        f = np.fft.rfftfreq(SAMPLES, DT)
        m = MeasuredModel.from_frf(f, np.fft.rfft(h), kind="accelerance", variance=np.ones(len(f)))
        assert np.abs(m.H[:, 0, 0] - closed(f, self.DECAY)).max() < 0.01 * np.abs(m.H).max()
        right = m.without_window(self.DECAY, SAMPLES * DT)
        assert np.abs(right.impulse_response(DT, SAMPLES)[:, 0, 0] - light(SAMPLES)[:, 0]).max() < 1e-10
        assert right.dt == pytest.approx(DT)
        assert right.flags == ()
        assert right.variance.max() == pytest.approx(1 / np.mean(exponential(SAMPLES, DT, self.DECAY) ** 2))

    def test_of_a_padded_frf(self):
        h = np.pad(light(SAMPLES)[:, 0] * exponential(SAMPLES, DT, 3.0), (0, 3 * SAMPLES))
        H = taken_out(np.fft.rfft(h), 3.0 * DT, SAMPLES)
        assert np.fft.irfft(H) == pytest.approx(np.pad(light(SAMPLES)[:, 0], (0, 3 * SAMPLES)), abs=1e-12)

    def test_variance_grows_as_the_scatter(self):
        """Predicted over empirical variance, 200 tests of three hits."""
        rng, tables = np.random.default_rng(0), hits(3, samples=512)
        noisy = [[t + 0.7 * rng.standard_normal(t.shape) * [0, 1] for t in tables] for _ in range(200)]
        found = [model(t, decay=6.0) for t in noisy]
        empirical = np.var([m.H for m in found], axis=0, ddof=1)
        assert np.median(np.mean([m.variance for m in found], axis=0) / empirical) == pytest.approx(1, abs=0.1)
        assert np.mean([m.noise_power for m in found]) == pytest.approx(0.49, rel=0.1)
        assert "exponential window" in found[0].certificate.source

    @pytest.mark.parametrize("decay", [-1.0, 50.0, np.nan, np.inf, "x", None])
    def test_refused(self, decay):
        with pytest.raises(InputError):
            model(hits(2), decay=decay)
        with pytest.raises(InputError):
            model(hits(2)).without_window(decay)

    def test_a_duration_that_the_lines_do_not_hold(self):
        with pytest.raises(InputError, match="longer than the lines"):
            model(hits(2)).without_window(1.0, 5.0)


class TestGate:
    def test_noise_outside_the_blow_no_longer_biases(self):
        """H1 is too small by force noise over force power; behind a gate by less."""
        rng = np.random.default_rng(0)
        noise = [rng.standard_normal(SAMPLES) for _ in range(20)]
        tables = [record(blow(SAMPLES, 30 + k), response()) for k in range(20)]
        noisy = [t + np.column_stack([n, 0 * n]) for t, n in zip(tables, noise, strict=True)]
        plain, gated = model(noisy), model(noisy, gate=0.01)
        exact = transfer(plain.frequencies)[..., None]
        small, right = (np.median((m.H / exact).real) for m in (plain, gated))
        assert small < 0.93
        assert right > 0.985
        assert np.median(np.abs(gated.H / exact - 1)) < 0.2 * np.median(np.abs(plain.H / exact - 1))

    def test_shape(self):
        w = gate(blow(), DT, 0.02)
        assert w[21] == 1
        assert np.all(w[21 - 14 : 21 + 15] > 0.99)
        assert np.all(w[42:] == 0)
        clean = hits(3)
        np.testing.assert_allclose(model(clean, gate=0.02).H, model(clean).H, rtol=1e-9)

    @pytest.mark.parametrize("length", [0.0, -1.0, np.nan, "x"])
    def test_refused(self, length):
        with pytest.raises(InputError):
            model(hits(2), gate=length)
