"""Shaker records to models: on excited lines, and on a whole grid that can be deconvolved."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from structures import Channel, FrfModel, InputError, MeasuredModel, NotIdentifiable, cross_spectra
from structures._flags import codes
from structures.errors import digests

from .impacts import DT, response, transfer

SAMPLES, SEGMENT = 40_000, 2048
H1 = response(400, sensors=3)  # load 1 at its three sensors
H2 = H1[:, ::-1] * [1.0, -0.5, 0.7]
CHANNELS = (
    Channel(label="f1", quantity="force", unit="N"),
    Channel(label="f2", quantity="force", unit="N"),
    *(Channel(label=f"a{i}", quantity="acceleration", unit="m/s^2") for i in (1, 2, 3)),
)
WHO = {"forces": ["f1", "f2"], "responses": ["a1", "a2", "a3"], "channels": CHANNELS, "dt": DT, "segment": SEGMENT}


def run(seed=0, noise=0.5, samples=SAMPLES, colour=None):
    """Table of two correlated random forces and three responses, already in motion at its start."""
    rng = np.random.default_rng(seed)
    f = rng.standard_normal((samples + 400, 2)) @ np.array([[1.0, 0.5], [0.0, 1.0]])
    f = f if colour is None else signal.lfilter(*colour, f, axis=0)
    y = sum(signal.fftconvolve(h, f[:, j, None], axes=0)[: len(f)] for j, h in enumerate((H1, H2)))
    return np.hstack([f, y + noise * rng.standard_normal(y.shape)])[400:]


def exact(lines):
    one = transfer(lines, sensors=3)
    return np.stack([one, one[:, ::-1] * [1.0, -0.5, 0.7]], axis=-1)


@pytest.fixture(scope="module")
def table():
    return run()


@pytest.fixture(scope="module")
def model(table):
    return MeasuredModel.from_random(table, **WHO)


class TestTable:
    def test_lines_channels_and_flags(self, table):
        m = FrfModel.from_records(table, **WHO)
        assert m.frequencies[0] > 0
        np.testing.assert_allclose(m.frequencies, np.fft.rfftfreq(SEGMENT, DT)[1:])
        assert m.sensors == CHANNELS[2:]
        assert m.loads == CHANNELS[:2]
        assert m.flags == ()
        assert m.coherence.shape == (1024, 3)

    def test_error_is_what_the_variance_says(self, table):
        m = FrfModel.from_records(table, **WHO)
        ratio = np.abs(m.H - exact(m.frequencies)) ** 2 / m.variance
        assert np.mean(ratio[2:-2]) == pytest.approx(1, abs=0.15)

    def test_several_records_and_spectra(self, table):
        parts = [table[:15_000], table[15_000:]]
        m = FrfModel.from_records(parts, **WHO)
        settings = {k: WHO[k] for k in ("channels", "dt", "segment")}
        spectra = cross_spectra(parts, **settings)
        same = FrfModel.from_spectra(spectra.lines(spectra.frequencies > 0), forces=[0, 1], responses=[2, 3, 4])
        np.testing.assert_array_equal(m.H, same.H)
        assert np.mean(np.abs(m.H - exact(m.frequencies)) ** 2 / m.variance) == pytest.approx(1, abs=0.15)

    def test_kind_of_channels_that_do_not_say(self, table):
        plain = {**WHO, "channels": None, "forces": [0, 1], "responses": [2, 3, 4]}
        m = FrfModel.from_records(table, kind="accelerance", **plain)
        assert [s.quantity for s in m.sensors] == ["acceleration"] * 3
        assert m.as_kind("mobility").sensors[0].quantity == "velocity"
        assert codes(FrfModel.from_records(table, **{**WHO, "kind": "mobility"}).flags) == {"W208"}

    def test_lines_without_coherence_are_left_out(self):
        """Forces below 150 Hz only, and what is above is noise."""
        low = run(1, noise=0.02, colour=signal.butter(8, 150 * 2 * DT))
        m = FrfModel.from_records(low, **WHO, least_coherence=0.9)
        assert 150 < m.frequencies.max() < 400
        (flag,) = (x for x in m.flags if x.code == "LID-W211")
        assert f"{1024 - len(m.frequencies)} of 1024 lines" in flag.message
        assert np.median(np.abs(m.H - exact(m.frequencies)) / np.abs(exact(m.frequencies))) < 0.05

    def test_sine_excitation_on_three_lines(self):
        """Whole periods without a window: exact on the excited lines, and nothing elsewhere."""
        n, bins = 1000, np.array([40, 85, 170])
        rng, records = np.random.default_rng(2), []
        for _ in range(4):
            F = np.zeros((n // 2 + 1, 2), complex)
            F[bins] = rng.standard_normal((3, 2)) + 1j * rng.standard_normal((3, 2))
            Y = np.einsum("kij,kj->ki", exact(np.fft.rfftfreq(n, DT)), F)
            records.append(np.fft.irfft(np.hstack([F, Y]), n, axis=0))
        m = FrfModel.from_records(records, **{**WHO, "segment": n}, window="boxcar", overlap=0.0, detrend=None)
        np.testing.assert_allclose(m.frequencies, bins / (n * DT))
        np.testing.assert_allclose(m.H, exact(m.frequencies), rtol=1e-8)
        assert codes(m.flags) == {"W211", "N207"}

    @pytest.mark.parametrize(
        ("change", "error", "words"),
        [
            ({"forces": ["a1"], "responses": ["f1"]}, InputError, "no unit of a force"),
            ({"responses": ["f2", "a1"], "forces": ["f1"]}, InputError, "response channel is a force"),
            ({"forces": ["f3"]}, InputError, "no such channel"),
            ({"responses": []}, InputError, "no channel"),
            ({"kind": "inertance"}, InputError, "W208"),
            ({"least_coherence": 1.5}, InputError, "no coherence"),
            ({"least_coherence": 0.999999}, InputError, "no line is coherent"),
            ({"segment": SAMPLES}, NotIdentifiable, "averages do not tell"),
        ],
    )
    def test_refused(self, table, change, error, words):
        with pytest.raises(error, match=words):
            FrfModel.from_records(table, **{**WHO, **change})


class TestWholeGrid:
    def test_impulse_response(self, model):
        h = model.impulse_response(DT, 400)
        truth = np.stack([H1, H2], axis=-1)
        assert model.dt == pytest.approx(DT)
        assert np.linalg.norm(h - truth) < 0.05 * np.linalg.norm(truth)
        assert model.flags == ()
        assert np.all(model.H[0] == 0)  # the mean was taken off, and no acceleration is constant

    def test_errors(self, model):
        ratio = np.abs(model.H - exact(model.frequencies)) ** 2 / model.variance
        assert np.mean(ratio[2:-2]) == pytest.approx(1, abs=0.15)
        assert model.noise_power.mean(axis=0) == pytest.approx(0.25, rel=0.05)
        assert model.samples == SEGMENT

    def test_certificate_of_the_halves(self, model, table):
        found = model.certificate
        signal_power = np.mean(table[:, 2:] ** 2, axis=0)
        assert "halves" in found.source
        assert found.gain == pytest.approx([1, 1, 1], abs=0.02)
        assert np.array(found.error) ** 2 == pytest.approx(0.25 / signal_power, rel=0.25)
        wrong = np.concatenate([table[: SAMPLES // 2], 2 * table[SAMPLES // 2 :] * [0.5, 0.5, 1, 1, 1]])
        assert min(MeasuredModel.from_random(wrong, **WHO).certificate.error) > 0.4

    def test_records_are_remembered(self, model, table):
        assert model.training == set(digests(table[:, 2:]))
        several = MeasuredModel.from_random([table[:20_000], table[20_000:]], **WHO)
        assert len(several.hits) == 2
        assert "2 records, each predicted" in several.certificate.source

    def test_written_and_read(self, model, tmp_path):
        model.save(tmp_path / "m.h5")
        read = MeasuredModel.load(tmp_path / "m.h5")
        assert read.fingerprint == model.fingerprint
        assert read.certificate == model.certificate

    def test_the_load_of_another_run(self, model):
        """As near to forces that the model has not seen as with the exact FRF, where noise is what limits both.

        Where the variance of impacts is learned, noise limits less, and the measured FRF's own 5 % more.
        """
        from loadid import Deconvolution, Record
        from loadid.settings import Penalty

        force = np.zeros((1500, 2))
        force[300:320, 0], force[700:715, 1] = 20 * np.hanning(20), -10 * np.hanning(15)
        y = sum(signal.fftconvolve(h, force[:, j, None], axes=0)[:1500] for j, h in enumerate((H1, H2)))
        y = y + 0.5 * np.random.default_rng(1).standard_normal(y.shape)
        known = [replace(c, noise=0.5) for c in CHANNELS[2:]]
        lines = model.frequencies
        true = MeasuredModel.from_frf(lines, exact(lines), kind="accelerance", sensors=known, loads=CHANNELS[:2])
        (error, least), (learned, best) = (
            [
                np.linalg.norm(Deconvolution(m, penalty=penalty).estimate(Record(y, DT, c)).load - force)
                for m, c in ((model, CHANNELS[2:]), (true, known))
            ]
            for penalty in (Penalty(variance="constant"), Penalty())
        )
        size = np.linalg.norm(force)
        assert error < 1.1 * least < 0.7 * size
        assert best < learned < 0.1 * size

    @pytest.mark.parametrize(
        ("change", "words"),
        [
            ({"segment": 1001}, "odd length"),
            ({"forces": ["a1"], "responses": ["a2"]}, "no unit of a force"),
            ({"kind": "x"}, "W208"),
        ],
    )
    def test_refused(self, table, change, words):
        with pytest.raises(InputError, match=words):
            MeasuredModel.from_random(table, **{**WHO, **change})

    def test_forces_on_few_lines(self):
        rng, records = np.random.default_rng(2), []
        for _ in range(6):
            X = np.zeros((501, 5), complex)
            X[50:300] = rng.standard_normal((250, 5)) + 1j * rng.standard_normal((250, 5))
            records.append(np.fft.irfft(X, 1000, axis=0))
        settings = {**WHO, "segment": 1000, "window": "boxcar", "overlap": 0.0}
        with pytest.raises(InputError, match=r"no energy on many lines.*250 of 501"):
            MeasuredModel.from_random(records, **settings)
