"""Harmonic loads from records: amplitudes and their noise, what the harmonic explains, records that are none."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import HarmonicInversion, LoadEstimate, Record, datasets
from loadid._families.amplitudes import of_record
from loadid._families.data import gather
from loadid.settings import Noise
from structures import Channel, ForwardModel, InputError, MatrixModel, beams, damping, loads, sensors

from ..guards.cases import Case

RATE, SAMPLES, LINE = 2048, 2048, 31.0
WEAK = "LID-W533"


@cache
def beam(elements: int = 20, modes: int = 4) -> ForwardModel:
    """Three accelerometers on a simply supported beam of 1 m, one load."""
    structure = beams.simply_supported(
        length=1.0, section=beams.Section.rectangle(0.04, 0.01), material=beams.materials.steel, elements=elements,
        damping=damping.Modal(0.02),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"a{k}") for k, x in enumerate((0.25, 0.4, 0.7))]
    return ForwardModel(structure, seen, [loads.Point(at=0.6, label="F")], modes=modes)


def tone(frequency: float, size: float = 1.0) -> np.ndarray:
    """Steady response (samples, sensors) of a finer mesh with more modes to a load ``size cos(2 pi f t)``."""
    t = np.arange(SAMPLES) / RATE
    Y = size * beam(40, 9).frf([frequency])[0, :, 0]
    return np.real(np.exp(2j * np.pi * frequency * t)[:, None] * Y)


def coloured(seed: int, memory: float, std: float = 0.3) -> np.ndarray:
    """Noise of one pole, of unit variance before `std`."""
    from scipy.signal import lfilter

    white = np.random.default_rng([7, seed]).standard_normal((SAMPLES + 500, 3))
    return std * np.sqrt(1 - memory**2) * lfilter([1], [1, -memory], white, axis=0)[500:]


def answered(y: np.ndarray, frequency: float = LINE, noise: float | None = None) -> LoadEstimate:
    return HarmonicInversion(beam(), frequency, noise=noise).estimate(Record(y, 1 / RATE, beam().sensors))


def codes(e: LoadEstimate) -> list[str]:
    return [f.code for f in e.flags]


# -- amplitudes and their noise ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("memory", "frequency"), [(0.0, 31.0), (0.0, 31.4), (0.95, 31.0), (-0.7, 300.0)])
def test_the_noise_of_amplitudes_is_what_they_err_by(memory: float, frequency: float) -> None:
    """White noise, and noise whose level on the line is several times below or above that of white noise."""
    channels = [Channel(label=f"c{i}", quantity="acceleration", unit="m/s^2") for i in range(3)]
    model = MatrixModel(np.eye(3), sensors=channels)
    t, errors, stds = np.arange(SAMPLES) / RATE, [], []
    clean = 2.0 * np.cos(2 * np.pi * frequency * t + 0.4)[:, None] + 5.0
    for seed in range(60):
        data = gather(Record(clean + coloured(seed, memory), 1 / RATE, channels), None, model, None, timed=False)
        line = of_record(data, frequency, Noise())
        errors.append(np.abs(line.values - 2.0 * np.exp(0.4j)) ** 2)
        stds.append(2 * line.noise.level**2)  # of the real and of the imaginary part
    ratio = float(np.sqrt(np.mean(errors) / np.mean(stds)))
    assert 0.85 < ratio < 1.15 if memory >= 0 else ratio < 1.1  # less than white noise is not looked for


def test_a_steady_tone_is_graded_well_and_lies_in_its_band() -> None:
    found = [answered(tone(LINE, 3.0) + coloured(seed, 0.0, 1.0)) for seed in range(30)]
    assert {e.grade.letter for e in found} == {"A"}
    assert all(WEAK not in codes(e) for e in found)
    inside = [abs(e.load[0, 0] - 3.0) < 1.96 * e.std[0, 0] for e in found]
    assert np.mean(inside) > 0.8
    assert found[0].facts.explained == pytest.approx(1 - 1 / (1 + np.mean(tone(LINE, 3.0) ** 2)), abs=0.03)


def test_stated_noise_is_that_of_the_samples() -> None:
    y = tone(LINE, 3.0) + coloured(1, 0.0, 1.0)
    one, other = answered(y, noise=1.0), answered(y)
    np.testing.assert_allclose(one.std, other.std, rtol=0.1)
    assert one.choice is not None
    assert one.choice.source.kind == "stated"


# -- records that one harmonic does not explain ------------------------------------------------------------------------
def test_a_hit_is_no_harmonic_load() -> None:
    """A hit has amplitudes on every line: no good answer at any of them, and the share is said."""
    test = datasets.hammer_test()
    for frequency in (10.0, 25.0, 60.0, 200.0):
        e = HarmonicInversion(test.model, frequency).estimate(test.record)
        assert e.grade.letter in "CD", frequency
        assert WEAK in codes(e)
        assert f"explains {e.facts.explained:.1%} of the record" in e.summary()


@pytest.mark.parametrize("seed", range(5))
def test_noise_alone_has_no_harmonic_load(seed: int) -> None:
    for memory in (0.0, 0.9):
        e = answered(coloured(seed, memory))
        assert e.grade.letter == "D"
        assert "LID-W318" in codes(e)


def test_a_weak_tone_beside_a_strong_one_is_found_and_said() -> None:
    """Two loads of the same frequency ratio 1 to 4: the weak one is found, its share is said, and it is no A."""
    e = answered(tone(LINE, 1.0) + tone(124.0, 4.0) + coloured(3, 0.0, 0.05))
    assert abs(e.load[0, 0] - 1.0) < 0.1
    assert WEAK in codes(e)
    assert e.grade.letter == "B"
    assert WEAK not in codes(answered(tone(LINE, 1.0) + tone(124.0, 4.0) + coloured(3, 0.0, 0.05), 124.0))


def test_what_a_record_cannot_hold_is_refused() -> None:
    for frequency in (0.5, 1024.0, 5000.0):
        with pytest.raises(InputError, match="does not hold this frequency"):
            answered(tone(LINE), frequency)
    still = tone(LINE)
    still[:, 1] = 4.0
    with pytest.raises(InputError, match="does not move"):
        answered(still)


CASES = [
    Case("W533", lambda: answered(tone(LINE) + tone(124.0, 4.0)).flags, lambda: answered(tone(LINE)).flags,
         r"a harmonic of 31 Hz explains \d+\.\d% of the record"),
]  # fmt: skip
