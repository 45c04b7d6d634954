"""Cross spectra against scipy, against closed forms and against their scatter."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy import signal

from structures import Channel, CrossSpectra, InputError, cross_spectra

RNG = np.random.default_rng(0)
X = RNG.standard_normal((3000, 3)) @ np.array([[1.0, 0.5, 0.0], [0.0, 1.0, 2.0], [0.0, 0.0, 0.3]]) + 0.2
DT = 1e-3


@dataclass
class Log:
    values: np.ndarray
    dt: float = DT
    channels: tuple = ("a", "b", "c")


def reference(x, segment, overlap, window, detrend):
    """``E[X conj(Y)]`` by scipy, whose csd conjugates the first of its arguments."""
    own = {"nperseg": segment, "noverlap": round(overlap * segment), "window": window, "detrend": detrend or False}
    f, S = signal.csd(x.T[None], x.T[:, None], fs=1 / DT, **own)
    return f, S.transpose(2, 0, 1)


class TestAgainstScipy:
    @pytest.mark.parametrize("window", ["hann", "boxcar", ("tukey", 0.2)])
    @pytest.mark.parametrize(("segment", "overlap"), [(256, 0.5), (255, 0.5), (256, 0.0), (200, 0.75)])
    @pytest.mark.parametrize("detrend", ["constant", "linear", None])
    def test_one_record(self, window, segment, overlap, detrend):
        S = cross_spectra(X, DT, segment=segment, overlap=overlap, window=window, detrend=detrend)
        f, expected = reference(X, segment, overlap, window, detrend)
        assert S.frequencies == pytest.approx(f, rel=1e-12)
        assert np.abs(S.matrix - expected).max() < 1e-12 * np.abs(expected).max()

    def test_records_weigh_as_many_segments_as_they_give(self):
        parts = [X[:1000], X[1000:1600], X[1600:]]
        S = cross_spectra(parts, DT, segment=256)
        counts = [(len(p) - 256) // 128 + 1 for p in parts]
        each = [reference(p, 256, 0.5, "hann", "constant")[1] for p in parts]
        expected = sum(k * s for k, s in zip(counts, each, strict=True)) / sum(counts)
        assert np.abs(S.matrix - expected).max() < 1e-12 * np.abs(expected).max()

    def test_power_of_a_sine_and_of_white_noise(self):
        """A sine stands as mean square over bandwidth; the area of white noise is its variance."""
        t = np.arange(20000) * DT
        S = cross_spectra(3 * np.sin(2 * np.pi * 125 * t), DT, segment=1000)
        assert S.autospectra.max() * S.bandwidth == pytest.approx(4.5, rel=1e-3)
        assert S.bandwidth == pytest.approx(1.5 / (1000 * DT))
        white = cross_spectra(2 * RNG.standard_normal(200_000), DT, segment=256)
        assert np.mean(white.autospectra) * 500 == pytest.approx(4, rel=0.02)

    def test_several_records_of_one_channel(self):
        S = cross_spectra([X[:1000, 0], X[1000:, 0]], DT, segment=100)
        both = cross_spectra([X[:1000, :1], X[1000:, :1]], DT, segment=100)
        np.testing.assert_array_equal(S.matrix, both.matrix)

    def test_long_records_are_transformed_in_blocks(self, monkeypatch):
        whole = cross_spectra(X, DT, segment=128).matrix
        monkeypatch.setattr("structures._testing.spectra.BLOCK", 1000)
        assert cross_spectra(X, DT, segment=128).matrix == pytest.approx(whole, rel=1e-12)


class TestAverages:
    @pytest.mark.parametrize(("window", "overlap"), [("hann", 0.0), ("hann", 0.5), ("hann", 0.75), ("boxcar", 0.5)])
    def test_scatter_of_autospectra(self, window, overlap):
        """std = S / sqrt(averages), over 150 channels of white noise and all inner lines."""
        white = np.random.default_rng(1).standard_normal((1024, 150))
        S = cross_spectra(white, 1.0, segment=128, overlap=overlap, window=window)
        auto = S.autospectra[3:-3]
        assert np.mean(auto.mean(axis=1) ** 2 / auto.var(axis=1)) == pytest.approx(S.averages, rel=0.06)

    def test_without_overlap_it_is_the_number_of_segments(self):
        assert cross_spectra([X[:1100], X], DT, segment=256, overlap=0.0).averages == pytest.approx(4 + 11)
        assert cross_spectra(X[:256], DT, segment=256).averages == pytest.approx(1)

    def test_default_segments(self):
        S = cross_spectra(X, DT)
        assert S.segment == 256
        assert S.overlap == 0.5


class TestRecords:
    def test_objects_with_values_and_a_step(self):
        S = cross_spectra([Log(X[:1500]), Log(X[1500:])], segment=256)
        assert S.labels == ("a", "b", "c")
        assert cross_spectra(Log(X), segment=256).matrix == pytest.approx(cross_spectra(X, DT, segment=256).matrix)

    @pytest.mark.parametrize(
        ("values", "settings", "words"),
        [
            (X, {"dt": None}, "step"),
            (X, {"dt": -1.0}, "step"),
            (X, {"dt": "x"}, "step"),
            ([], {}, "no records"),
            (np.where(np.abs(X) > 4, np.nan, X), {}, "NaN"),
            (X.astype(complex), {}, "not a real array"),
            (np.zeros((0, 3)), {}, "table"),
            (X, {"segment": 4000}, "shortest record"),
            (X, {"segment": 2}, "no length"),
            (X, {"segment": 100.0}, "no length"),
            ([X, X[:100]], {"segment": 256}, "leave out short records"),
            (X, {"overlap": 1.0}, "no overlap"),
            (X, {"overlap": -0.1}, "no overlap"),
            (X, {"overlap": "half"}, "no overlap"),
            (X, {"window": "hannn"}, "no window"),
            (X, {"detrend": "quadratic"}, "unknown detrend"),
            (X, {"channels": ["a", "b"]}, "labels do not fit"),
            ([Log(X), Log(X, dt=2 * DT)], {"dt": None}, "different steps"),
            (Log(X), {"dt": 2 * DT}, "own step"),
            ([Log(X), Log(X, channels=("a", "c", "b"))], {}, "different channels"),
        ],
    )
    def test_refused(self, values, settings, words):
        with pytest.raises(InputError, match=words):
            cross_spectra(values, **{"dt": DT, **settings})


class TestCrossSpectra:
    S = cross_spectra(X, DT, segment=64, channels=["a", "b", "c"])

    def test_restricted(self):
        part = self.S.restricted(["c", 0])
        assert part.labels == ("c", "a")
        np.testing.assert_array_equal(part.matrix[:, 0, 1], self.S.matrix[:, 2, 0])
        assert part.averages == self.S.averages
        assert self.S.restricted("b").matrix.shape == (33, 1, 1)
        assert self.S.restricted([self.S.channels[1]]).labels == ("b",)
        for bad, words in ((["d"], "no such channel"), ([3], "no such"), (["a", 0], "named twice"), ([], "no channel")):
            with pytest.raises(InputError, match=words):
                self.S.restricted(bad)

    def test_lines(self):
        band = self.S.lines(self.S.frequencies > 200)
        assert band.frequencies.min() > 200
        np.testing.assert_array_equal(band.matrix, self.S.matrix[-len(band) :])
        for bad in (np.zeros(33, bool), np.ones(5, bool), np.ones(33)):
            with pytest.raises(InputError, match="mask"):
                self.S.lines(bad)

    def test_coherence(self):
        """Of x and x + noise of equal power: a half."""
        x = RNG.standard_normal((100_000, 2))
        S = cross_spectra(np.column_stack([x[:, 0], x.sum(axis=1), 0 * x[:, 0]]), DT, segment=128)
        assert np.mean(S.coherence[2:, 0, 1]) == pytest.approx(0.5, abs=0.02)
        assert S.coherence[:, 0, 0] == pytest.approx(1)
        assert np.all(S.coherence[:, 2] == 0)

    @pytest.mark.parametrize(
        ("spoil", "words"),
        [
            (lambda s: {"matrix": s.matrix * np.array([[1, 1, 1], [1.01, 1, 1], [1, 1, 1]])}, "not Hermitian"),
            (lambda s: {"matrix": s.matrix + 1e-3j * np.eye(3)}, "not Hermitian"),
            (lambda s: {"matrix": -s.matrix}, "negative autospectrum"),
            (lambda s: {"matrix": s.matrix - np.diag([0, s.autospectra.max(), 0])}, "b: a negative autospectrum"),
            (lambda s: {"matrix": np.where(s.matrix == s.matrix[4, 0, 0], np.nan, s.matrix)}, "NaN.*1 of"),
            (lambda s: {"matrix": s.matrix * (1 + np.ones((3, 3)) - np.eye(3))}, "coherence above one"),
            (lambda s: {"matrix": s.matrix[:5]}, "do not fit"),
            (lambda s: {"matrix": s.matrix[:, :2]}, "do not fit"),
            (lambda s: {"matrix": np.full(s.matrix.shape, "x")}, "no numbers"),
            (lambda s: {"frequencies": s.frequencies[::-1]}, "ascend"),
            (lambda s: {"frequencies": -s.frequencies}, "frequencies"),
            (lambda s: {"averages": 0.0}, "averages"),
            (lambda s: {"averages": np.nan}, "averages"),
            (lambda s: {"channels": ("a", "b", "b")}, "labels"),
        ],
    )
    def test_refused(self, spoil, words):
        with pytest.raises(InputError, match=words):
            replace(self.S, **spoil(self.S))

    def test_made_by_hand(self):
        rounded = self.S.matrix.astype(np.complex64)
        S = CrossSpectra(self.S.frequencies, rounded, ("a", "b", "c"), np.inf)
        assert S.matrix == pytest.approx(self.S.matrix, rel=1e-5, abs=1e-12)
        np.testing.assert_array_equal(S.matrix, S.matrix.conj().transpose(0, 2, 1))
        assert isinstance(S.channels[0], Channel)


def ringing(damping, samples, rng, frequency=60.0):
    """Response of one oscillator to white noise, past its start."""
    memory = int(8 / (damping * 2 * np.pi * frequency * DT))
    t = np.arange(memory) * DT
    h = np.exp(-damping * 2 * np.pi * frequency * t) * np.sin(2 * np.pi * frequency * t)
    return signal.fftconvolve(rng.standard_normal(samples + memory), h)[memory : memory + samples]


class TestLeakage:
    """W508: what it must see, and what it must not see."""

    def found(self, x, **settings):
        return [f.evidence.name for f in cross_spectra(x, DT, **settings).flags]

    @pytest.mark.parametrize("window", ["hann", "boxcar", "flattop"])
    def test_silent_on_noise(self, window):
        rng = np.random.default_rng(3)
        for segment, overlap in ((256, 0.5), (64, 0.5), (512, 0.75)):
            assert self.found(rng.standard_normal((20_000, 30)), segment=segment, overlap=overlap, window=window) == []

    def test_silent_on_peaks_that_are_resolved(self):
        rng = np.random.default_rng(4)
        x = np.stack([ringing(0.05, 100_000, rng) for _ in range(4)], axis=1)
        for window in ("hann", "boxcar"):
            assert self.found(x, segment=1024, window=window) == []

    def test_a_transient_in_a_long_record(self):
        t = np.arange(2000) * DT
        x = 1e-3 * np.random.default_rng(5).standard_normal(20_000)
        x[5000:7000] += np.exp(-20 * t) * np.sin(2 * np.pi * 60 * t)
        assert self.found(x, segment=512) == ["loudest over middle segment"]

    def test_one_segment_per_hit_is_no_burst(self):
        rng = np.random.default_rng(6)
        t = np.arange(1024) * DT
        hits = [(1 + 0.2 * k) * np.exp(-20 * t) * np.sin(2 * np.pi * 60 * t) for k in range(5)]
        records = [h + 1e-6 * rng.standard_normal(1024) for h in hits]
        assert self.found(records, segment=1024, window="boxcar", detrend=None) == []

    def test_peaks_narrower_than_the_segments(self):
        rng = np.random.default_rng(7)
        x = np.stack([ringing(0.002, 200_000, rng), rng.standard_normal(200_000)], axis=1)
        (flag,) = cross_spectra(x, DT, segment=1024, channels=["narrow", "white"]).flags
        assert flag.code == "LID-W508"
        assert flag.message.endswith("narrow")

    def test_a_sine_without_a_window(self):
        x = np.sin(2 * np.pi * 60.3 * np.arange(100_000) * DT) + 0.01 * np.random.default_rng(8).standard_normal(
            100_000
        )
        assert self.found(x, segment=1024, window="boxcar") == ["share of lines lifted by leakage"]
        assert self.found(x, segment=1024) == ["share that the highest peak misses"]
