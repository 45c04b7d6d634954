"""Records of one event by two clocks, against signals that are known at any time: sums of sines, sampled twice."""

import numpy as np
import pytest

from loadid import Record, align
from loadid._readers.resampling import resampled
from structures._channels import Channel
from structures.errors import InputError
from tests.data import measured


def sines(seed, lines=200, band=(5.0, 150.0)):
    """A signal at any times: random sines over a band."""
    rng = np.random.default_rng(seed)
    f, phase, size = rng.uniform(*band, lines), rng.uniform(0, 2 * np.pi, lines), rng.normal(size=lines)
    return lambda t: np.cos(2 * np.pi * np.multiply.outer(t, f) + phase) @ size / np.sqrt(lines / 2)


def pair(seed, ratio, noise=0.1, n=5000, step=1e-3):
    signal, rng = sines(seed), np.random.default_rng(seed + 1000)
    offset = rng.uniform(-1.0, 1.0)
    a, b = signal(np.arange(n) / 1000), 2.0 * signal(offset + ratio * np.arange(round(n * 1e-3 / step)) * step)
    one = Record(a + noise * rng.normal(size=len(a)), 1e-3, ["x"])
    return offset, one, Record(b + 2 * noise * rng.normal(size=len(b)), step, ["x"], name="second log"), signal


@pytest.mark.parametrize("ratio", [1.01, 1 + 1e-4, 1 + 1e-6])
def test_offset_and_ratio_are_within_their_std(ratio):
    scores = []
    for seed in range(3):
        offset, a, b, _ = pair(seed, ratio)
        found = align(a, b, channel="x")
        scores += [(found.offset - offset) / found.offset_std, (found.ratio - ratio) / found.ratio_std]
        assert found.offset_std < 2e-5  # a fiftieth of a sample
        assert found.ratio_std < 1e-5
    assert np.abs(scores).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.6  # coverage, over six of them


def test_the_second_record_comes_on_the_clock_of_the_first():
    offset, a, b, signal = pair(3, 1.01, noise=0.0, step=1 / 1500)
    found = align(a, b, channel=("x", 0))
    assert found.record.labels == ("x", "x (second log)")
    assert found.record.dt == a.dt
    away = found.record.values[:, 1] - 2.0 * signal(a.time)
    inside = np.isfinite(away)
    assert inside.mean() > 0.7
    assert np.abs(away[inside]).max() < 2e-2
    covered = (a.time >= offset + 0.1) & (a.time <= offset + 1.01 * b.duration - 0.1)
    assert inside[covered].all()
    assert not inside[(a.time < offset) | (a.time > offset + 1.01 * b.duration)].any()
    assert abs(found.ratio - 1.01) < 1e-6
    assert found.plot().axes[0].get_lines()
    assert "ratio" in repr(found)


def test_a_turned_channel_and_units_do_not_matter():
    offset, a, b, _ = pair(1, 1.001)
    channel = Channel(label="y", quantity="acceleration", unit="m/s^2")
    found = align(a, Record(-1e-6 * b.values, b.dt, channel), channel=("x", "y"))
    assert abs(found.offset - offset) < 4 * found.offset_std
    assert found.record.channels[1].unit == "m/s^2"


@pytest.mark.parametrize("seed", range(2))
def test_unrelated_records_and_sines_are_refused(seed):
    _, a, _, _ = pair(seed, 1.0)
    _, _, b, _ = pair(seed + 50, 1.0)
    with pytest.raises(InputError, match=r"nothing in common.*by chance"):
        align(a, b, channel="x")
    t = np.arange(5000) / 1000
    hum = Record(np.sin(2 * np.pi * 50 * t), 1e-3, ["x"])
    with pytest.raises(InputError, match="nothing in common"):  # a hum matches itself at every period
        align(hum, Record(np.sin(2 * np.pi * 50 * (t + 0.3)), 1e-3, ["x"]), channel="x")


def test_too_little_is_refused():
    with pytest.raises(InputError, match="too little to align"):
        align(Record(np.ones(5000), 1e-3, "x"), Record(np.arange(5000.0), 1e-3, "x"), channel="x")
    with pytest.raises(InputError, match="no channel"):
        align(Record(np.arange(5000.0), 1e-3, "x"), Record(np.arange(5000.0), 1e-3, "z"), channel="x")


def hit(column, fs=1024.0):
    """A channel of a measured hammer test at any times, by zeros in its spectrum and a spline through eight times as
    many samples: another interpolation than that of `align`."""
    from scipy.interpolate import CubicSpline

    with np.load(measured("hammer_two_hits", "lvm_two_hits.npz")) as held:
        x = np.array(held["hit1"][:, column])
    x = x - x.mean()
    fine = 8 * np.fft.irfft(np.fft.rfft(x), 8 * len(x))
    return x, CubicSpline(np.arange(len(fine)) / (8 * fs), fine)


def test_a_measured_record_by_a_clock_that_runs_one_per_cent_fast():
    """The second log has stamps with jitter, which are resampled, and noise of its own."""
    x, at = hit(2)
    scores, fs = [], 1024.0
    for seed, ratio in ((2, 1.01),):
        rng = np.random.default_rng(seed)
        offset, count = rng.uniform(0.005, 0.04), int(7.5 * 2 * fs)
        t = np.sort((np.arange(count) + 0.2 * rng.uniform(-1, 1, count)) / (2 * fs))
        y = at(offset + ratio * t) + 0.01 * x.std() * rng.normal(size=count)
        grid = np.arange(t[0], t[-1], 1 / (2 * fs))
        second = Record(resampled(t, y[:, None], grid).values, 1 / (2 * fs), ["acc, second logger"])
        first = Record(x + 0.01 * x.std() * rng.normal(size=len(x)), 1 / fs, ["acc"])
        found = align(first, second, channel=("acc", "acc, second logger"))
        scores += [(found.offset - offset - ratio * t[0]) / found.offset_std, (found.ratio - ratio) / found.ratio_std]
        assert found.offset_std < 1e-5  # of a step of 1 ms
        assert found.ratio_std < 5e-6
    assert np.abs(scores).max() < 3.5


def test_the_hammer_of_a_measured_hit_cannot_stand_for_its_answer():
    """A pulse and its ringing correlate at once and at every period after it: no ratio follows."""
    force, _ = hit(0)
    _, at = hit(2)
    second = Record(at(0.01 + 1.01 * np.arange(7900) / 1024), 1 / 1024, ["m"])
    with pytest.raises(InputError, match=r"too unlike; .*found: \d of \d+ windows"):
        align(Record(force, 1 / 1024, ["F"]), second, channel=("F", "m"))


def test_an_accelerometer_against_a_strain_gauge():
    """Two quantities of one motion, whose lines differ by the square of their frequency."""
    scores = []
    for seed, ratio in ((0, 1.01),):
        rng = np.random.default_rng(seed)
        f, p, a = rng.uniform(5, 40, 200), rng.uniform(0, 2 * np.pi, 200), rng.normal(size=200)
        n, offset = 8000, rng.uniform(-1, 1)
        acc = -np.cos(2 * np.pi * np.multiply.outer(np.arange(n) / 500, f) + p) @ (a * (f / 20) ** 2)
        strain = np.cos(2 * np.pi * np.multiply.outer(offset + ratio * np.arange(n) / 400, f) + p) @ a
        first = Channel(label="acc", quantity="acceleration", unit="m/s^2")
        other = Channel(label="gauge", quantity="strain", unit="m/m")
        found = align(
            Record(acc + 0.1 * acc.std() * rng.normal(size=n), 1 / 500, first),
            Record(1e-6 * (strain + 0.1 * strain.std() * rng.normal(size=n)), 1 / 400, other),
            channel=("acc", "gauge"),
        )
        scores += [(found.offset - offset) / found.offset_std, (found.ratio - ratio) / found.ratio_std]
        assert found.ratio_std < 2e-5
        assert found.record.labels == ("acc", "gauge")
    assert np.abs(scores).max() < 3.5
