"""Deconvolution under a variance that changes with time: when it is used, what the answer holds, what is refused."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from loadid import Deconvolution, LoadEstimate, Noise, Penalty, Record, identify
from loadid.constraints import NonNegative
from structures import ForwardModel, ImpulseModel, beams, damping, loads, sensors
from structures.errors import InputError
from tests.campaigns import hammer, impacts

DT, SAMPLES = 1 / 2000, 300


@lru_cache
def model() -> ForwardModel:
    """A cantilever with an accelerometer and a displacement."""
    structure = beams.cantilever(elements=6, damping=damping.Modal(0.02), length=1.2, EI=800.0, mass_per_length=3.0)
    seen = [sensors.Accelerometer("4+Z"), sensors.Displacement("5+Z")]
    return ForwardModel(structure, seen, [loads.Point("6+Z", label="p")], modes=4)


def data(kind: str) -> tuple[NDArray, NDArray]:
    """A record with 2 % noise and the load behind it."""
    rng, g = np.random.default_rng(4), np.zeros((SAMPLES, 1))
    if kind == "impacts":
        for start, width, height in ((60, 12, 300.0), (190, 8, 500.0)):
            g[start : start + width, 0] = height * np.sin(np.pi * np.arange(width) / (width - 1))
    else:
        g[:, 0] = 100 * np.sin(0.21 * np.arange(SAMPLES)) + 40 * np.sin(0.5 * np.arange(SAMPLES))
    y = model().predict(g, DT)
    return y + 0.02 * np.sqrt(np.mean(y**2, axis=0)) * rng.standard_normal(y.shape), g


@lru_cache
def answer(kind: str, variance: str) -> LoadEstimate:
    """With the settings that matter here."""
    return Deconvolution(model(), penalty=Penalty("identity", variance=variance)).estimate(data(kind)[0], DT)


def error(kind: str, variance: str) -> float:
    """Relative."""
    g = data(kind)[1]
    return float(np.linalg.norm(answer(kind, variance).load - g) / np.linalg.norm(g))


def test_impacts_are_asked_for_and_are_better() -> None:
    found, (_, g) = answer("impacts", "auto"), data("impacts")
    assert np.array_equal(found.load, answer("impacts", "local").load)
    assert error("impacts", "auto") < 0.5 * error("impacts", "constant")
    assert np.mean(np.abs(found.load - g)[g != 0] < 1.96 * found.std[g != 0]) > 0.85
    assert found.std[g == 0].mean() < 0.2 * found.std[g != 0].mean()
    assert found.facts["log_evidence_local"] > found.facts["log_evidence_stationary"]
    assert "variance changes" in found.provenance["prior"]
    assert "W407" not in found.codes
    assert found.choice.verdict == "not asked"  # the rules judged another load


def stepped() -> tuple[ForwardModel, NDArray, NDArray]:
    """A model, a record of two steps by a finer one behind an anti-alias filter, and the load."""

    def beam(elements: int, modes: int) -> ForwardModel:
        structure = beams.cantilever(length=0.5, section=beams.Section.rectangle(0.04, 0.008), elements=elements,
                                     material=beams.materials.steel, damping=damping.Modal(0.01))  # fmt: skip
        seen = [sensors.Accelerometer(at=0.46), sensors.Accelerometer(at=0.3)]
        return ForwardModel(structure, seen, [loads.Point(at=0.45)], modes=modes)

    t = np.arange(8 * 600) / 32_000
    g = 20.0 * (t > 0.045) - 35.0 * (t > 0.105)
    y = sosfiltfilt(butter(8, 1700, fs=32_000, output="sos"), beam(50, 12).predict(g[:, None], 1 / 32_000), axis=0)[::8]
    return beam(25, 8), y + 0.01 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape), g[::8, None]


def test_steps_are_no_pulses() -> None:
    """Accelerometers see little of what stays: pulses that fall before they rise would stand for a step."""
    one, y, g = stepped()
    forced = Deconvolution(one, penalty=Penalty("identity", variance="local")).estimate(y, 1 / 4000)
    assert not forced.facts["local_asked_for"]
    assert np.mean(np.abs(forced.load - g) < 1.96 * forced.std) < 0.6  # which is why
    found = Deconvolution(one).estimate(y, 1 / 4000)
    assert np.mean(np.abs(found.load - g) < 1.96 * found.std) > 0.9
    assert answer("impacts", "local").facts["local_asked_for"]


@pytest.mark.parametrize("kind", [sensors.Accelerometer, sensors.Displacement])
def test_a_record_without_noise_is_answered(kind: type) -> None:
    beam = beams.cantilever(length=1.0, EI=100.0, mass_per_length=1.0, damping=damping.Modal(0.02))
    exact = ForwardModel(beam, [kind(at=0.5), kind(at=0.9)], [loads.Point(at=0.7)], modes=4)
    dt, g = 1 / (3 * exact.modes.frequencies[-1]), np.zeros((SAMPLES, 1))
    g[100:112, 0] = np.sin(np.pi * np.arange(12) / 12)
    found = Deconvolution(exact, penalty=Penalty("identity", variance="local")).estimate(exact.predict(g, dt), dt)
    assert np.linalg.norm(found.load - g) < 0.02 * np.linalg.norm(g)
    assert np.all(np.isfinite(found.std))


def test_a_load_that_acts_throughout_keeps_its_prior() -> None:
    # the default goes by a matrix at this length, the choice over states
    assert answer("harmonic", "auto").load == pytest.approx(answer("harmonic", "constant").load, abs=2.0)
    assert "variance changes" not in answer("harmonic", "auto").provenance["prior"]


def test_the_response_is_that_of_the_load() -> None:
    found, (y, _) = answer("impacts", "local"), data("impacts")
    assert found.residual == pytest.approx(y - model().predict(found.load, DT), abs=1e-9 * np.abs(y).max())


def test_sums_have_a_band_that_a_file_keeps(tmp_path: Path) -> None:
    found, (_, g) = answer("impacts", "local"), data("impacts")
    own = found.functional("impulse")
    assert own.std is not None
    assert abs(own.value - DT * g.sum()) < 3 * own.std < 0.2 * DT * g.sum()
    found.save(tmp_path / "r.h5")
    again = LoadEstimate.read(tmp_path / "r.h5")
    assert again.functional("impulse").std == pytest.approx(own.std, rel=1e-9)
    assert dict(again.facts) == dict(found.facts)


def test_gaps_are_left_out() -> None:
    y, g = data("impacts")
    y[100:120] = np.nan
    record = Record(y, DT, model().sensors)
    found = Deconvolution(model(), penalty=Penalty("identity", variance="local")).estimate(record)
    assert np.linalg.norm(found.load - g) < 0.3 * np.linalg.norm(g)


def test_errors_of_the_model_are_as_large_as_they_are_said_to_be() -> None:
    y = data("impacts")[0]
    others = {"frequency": 0.0, "damping": 0.0, "shape": 0.0}
    none, small, large = (
        Deconvolution(model(), noise=Noise(errors=others | {"gain": gain})).estimate(y, DT) for gain in (0.0, 0.02, 0.1)
    )
    top = np.unravel_index(np.argmax(none.load), none.load.shape)
    assert np.array_equal(none.load, large.load)  # they widen the band and move nothing
    assert none.std[top] < small.std[top] < large.std[top]
    assert 0.07 * large.load[top] < large.std[top] < 0.2 * large.load[top]  # what all sensors share nobody tells
    with pytest.raises(InputError, match="gain, frequency, damping, shape"):
        Deconvolution(model(), noise=Noise(errors={"gian": 0.1}))


def test_errors_of_the_model_are_in_the_band_of_a_constant_variance(tmp_path: Path) -> None:
    """With errors that are said to be none, nothing of them; with gains alone, the load that they scale."""
    y, g = data("waves")
    none, gain = (
        Deconvolution(
            model(), noise=Noise(errors={**dict.fromkeys(("frequency", "damping", "shape"), 0.0), "gain": at})
        ).estimate(y, DT)
        for at in (0.0, 0.03)
    )
    plain, default = answer("waves", "constant"), answer("waves", "auto")
    assert np.all(none.std >= plain.std)
    assert np.all(default.std >= none.std)
    # what is common stays 3 %, the two that are each sensor's own are told apart
    added = np.sqrt(gain.std**2 - none.std**2)[20:-20] / np.sqrt(np.mean(g**2))
    assert 0.03 < np.sqrt(np.mean(added**2)) < 0.03 * np.sqrt(2)
    w = np.random.default_rng(0).standard_normal((2, SAMPLES, 1))
    default.save(tmp_path / "e.h5")
    kept = LoadEstimate.read(tmp_path / "e.h5")
    for one in w:
        of_file, of_answer, of_plain = (e.functional(one).std for e in (kept, default, plain))
        assert of_file == pytest.approx(of_answer, rel=1e-12)
        assert of_answer > of_plain


def test_a_load_that_may_be_smooth_is_in_the_band() -> None:
    """A slow load that an accelerometer tells from noise by its smoothness alone: a white one misses all of it."""
    given = impacts.problem(740_400_032, "slow")
    white, default = (
        given.inversion(penalty=Penalty("identity", variance=variance)).estimate(given.record, given.dt)
        for variance in ("constant", "auto")
    )
    assert default.load == pytest.approx(white.load)
    within = [np.mean(np.abs(found.load - given.truth) < 2 * found.std) for found in (white, default)]
    assert within[0] < 0.1
    assert within[1] > 0.95
    assert np.median(default.std) < 2 * np.std(given.truth)


def test_gains_of_hits_are_in_the_band_of_a_slow_load() -> None:
    given = hammer.problem(2_200_009, "slow")
    found, exact = (
        given.inversion().estimate(given.record, given.dt),
        given.inversion(noise=Noise(errors={"gain": 0.0})),
    )
    plain = exact.estimate(given.record, given.dt)
    assert found.load == pytest.approx(plain.load)
    share = np.sqrt(found.std**2 - plain.std**2) / np.abs(found.load)
    assert share == pytest.approx(np.median(share), rel=1e-3)
    assert 0.003 < np.median(share) < 0.05  # its hits differ by 1 %, its prior by 2
    assert found.grade.letter < plain.grade.letter or found.grade == plain.grade


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match="variance"):
        Penalty("identity", variance="sometimes")
    with pytest.raises(InputError, match="stands for the penalty"):
        Deconvolution(model(), penalty=Penalty("first_difference", variance="local"))
    with pytest.raises(InputError, match="stands for the penalty"):
        Deconvolution(model(), penalty=Penalty("identity", variance="local"), constraints=[NonNegative()])
    h = model().impulse_response(DT, 100)
    alone = ImpulseModel(h, DT, kind="held")
    with pytest.raises(InputError, match="does not know this setting"):
        Deconvolution(alone, penalty=Penalty("identity", variance="local")).estimate(data("impacts")[0][:100], DT)
    Deconvolution(alone, penalty=Penalty("identity", variance="auto")).estimate(data("impacts")[0][:100], DT)


def test_the_command_line_knows_it() -> None:
    y, _ = data("impacts")
    record = Record(y, DT, model().sensors)
    found = identify(record, model(), variance="local")
    assert np.array_equal(found.load, answer("impacts", "local").load)
    with pytest.raises(InputError, match="variance"):
        identify(record, model(), family="sparse", variance="local")
