"""Records that are wrong, and records with gaps: what is refused, in which words, and what is passed on."""

import numpy as np
import pytest

from loadid import Deconvolution, Record, StaticInversion, read
from loadid._families.data import gather, health
from loadid._families.noise import resolve
from loadid._quality import masked
from loadid.settings import Noise
from structures import Channel, ForwardModel, ImpulseModel, InputError, MatrixModel, StateSpace, loads, sensors
from structures import damping as dampings
from structures._elements.beams import materials, simply_supported
from structures._elements.members import Section

DT, N = 1 / 5000, 120
RNG = np.random.default_rng(0)


def beam(at=(0.65,)) -> ForwardModel:
    structure = simply_supported(
        length=2.0, section=Section.rectangle(0.05, 0.01), material=materials.steel, elements=12,
        damping=dampings.Modal(0.03),
    )  # fmt: skip
    seen = [sensors.Accelerometer(at=x, label=f"s{i}") for i, x in enumerate((0.3, 0.8))]
    return ForwardModel(structure, seen, [loads.Point(at=x, direction="Z", label=f"p{x}") for x in at], modes=4)


MODEL = beam()
SYSTEM = MODEL.state_space(DT)
Y = np.asarray(RNG.standard_normal((N, 2)))


def with_gap(where, what=np.nan) -> np.ndarray:
    y = Y.copy()
    y[where] = what
    return y


def refused(words, model, y, dt=DT, **settings) -> str:
    with pytest.raises(InputError, match=words) as caught:
        Deconvolution(model, **settings).estimate(y, dt)
    return str(caught.value)


# -- steps ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["state space", "impulse response"])
def test_a_step_that_is_not_that_of_the_model(kind):
    h = MODEL.impulse_response(DT, N)
    model = SYSTEM if kind == "state space" else ImpulseModel(h, DT, kind="held", sensors=MODEL.sensors)
    said = refused("different steps", model, Y, 2 * DT)
    assert "dt = 0.0004 s" in said
    assert "dt = 0.0002 s" in said


@pytest.mark.parametrize("dt", ["fast", -1.0, 0.0, np.nan, np.inf])
def test_a_step_that_is_none(dt):
    refused("step", MODEL, Y, dt)
    refused("has its own step", MODEL, Record(Y, DT, MODEL.sensors), dt)


def test_unequal_sampling_is_refused_where_it_happens(tmp_path):
    t = np.arange(60) * 1e-3
    t[31:] += 0.4e-3
    np.savetxt(tmp_path / "log.csv", np.c_[t, t], delimiter=",", header="time,a", comments="", fmt="%.6f")
    with pytest.raises(InputError, match=r"time is not uniform.*0\.0014 s after sample 30.*resample"):
        read(tmp_path / "log.csv", units={"a": "m/s^2"})


# -- models -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("factor", "stable"), [(1.002, False), (1.0, True)])
def test_an_unstable_pole(factor, stable):
    A = SYSTEM.A * factor / SYSTEM.radius
    model = StateSpace(A, SYSTEM.B, SYSTEM.C, SYSTEM.D, DT, hold="foh", sensors=MODEL.sensors)
    if stable:
        assert gather(Y, DT, model, None).values.shape == (N, 2)
    else:
        assert "modulus 1.002" in refused("model is unstable", model, Y)


# -- numbers ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("bad", "words"),
    [
        (Y.astype(str), "texts"),
        ([["a", 1], [2, 3]], "no table of real numbers"),
        ([[1, 2], [2]], "no table of real numbers"),
        (Y * 1j, "complex"),
        (Y > 0, "truth values"),
        (None, "does not fit the model"),
        (np.zeros((0, 2)), "no table"),
        (with_gap((7, 1), np.inf), "channel s1: infinite values; found: 1, the first at sample 7"),
        (with_gap((slice(None), 1)), r"holds no number.*found: s1;.*leave the channel out"),
        (np.full((N, 2), np.nan), "found: s0, s1;"),
        (np.full((N, 2), 1e300), "beyond the range of numbers"),
    ],
)
def test_numbers_that_are_none(bad, words):
    refused(words, MODEL, bad)


@pytest.mark.parametrize("bad", [["1", "2", "3"], {"s0": "1", "s1": 2.0, "s2": 3.0}, [["1", "2", "3"]] * 2])
def test_static_readings_are_no_texts(bad):
    model = MatrixModel(np.eye(3)[:, :2] + 0.1, sensors=[Channel(label=f"s{i}", unit="m") for i in range(3)])
    with pytest.raises(InputError, match="texts"):
        StaticInversion(model).estimate(bad)


@pytest.mark.parametrize("noise", ["loud", [1.0, "x"], [1.0, np.nan], [1.0, 2.0, 3.0], np.inf, 0.0, -1.0, True])
def test_noise_that_is_none(noise):
    refused("noise", MODEL, Y, noise=noise)


@pytest.mark.parametrize("choice", [[], [1.0], {}, 1j, -1.0, np.nan, True, object()])
def test_lambda_that_is_none(choice):
    refused("relative lambda", MODEL, Y[:40], choice=choice)


@pytest.mark.parametrize("chosen", [[np.zeros(2)], [None], ["s9"], ["s0", 0], [True], "s0"])
def test_sensors_that_are_none(chosen):
    refused("sensor", MODEL, Y, sensors=chosen)


def test_static_readings_have_no_step_to_fit():
    """A state space may stand for its static gain: the step of the frames is then free."""
    frames = Record(np.abs(Y[:5]) + 1, 0.5, MODEL.sensors)
    assert gather(frames, None, SYSTEM, None, timed=False).dt == 0.5
    with pytest.raises(InputError, match="different steps"):
        gather(frames, None, SYSTEM, None)


# -- gaps -------------------------------------------------------------------------------------------------------------
def test_gaps_are_marked_and_hold_nothing():
    y = with_gap((slice(10, 14), 0))
    y[50, 1] = np.nan
    data = gather(y, DT, MODEL, None, allow_missing=True)
    np.testing.assert_array_equal(data.missing, np.isnan(y))
    np.testing.assert_array_equal(data.values, np.nan_to_num(y))
    assert data.gaps == "4 of 120 samples of s0, 1 of s1"
    np.testing.assert_allclose(data.rms, np.sqrt(np.nanmean(y**2, axis=0)))
    whole = gather(Y, DT, MODEL, None, allow_missing=True)
    assert whole.gaps == ""
    assert not whole.missing.any()


def test_gaps_of_channels_that_are_not_used_do_not_count():
    assert not gather(with_gap((slice(None), 1)), DT, MODEL, ["s0"]).missing.any()


def test_gaps_are_refused_where_the_family_cannot_take_them():
    record = Record(with_gap((slice(5, 9), 1)), DT, MODEL.sensors)
    with pytest.raises(InputError, match=r"s1: samples 5-8.*window without the gap; Deconvolution .* takes records"):
        gather(record, None, MODEL, None)
    model = MatrixModel(np.eye(2) + 0.1, sensors=MODEL.sensors)
    with pytest.raises(InputError, match="s1: samples 5-8"):
        StaticInversion(model).estimate(record)


def test_health_and_noise_of_a_record_with_gaps():
    """A quiet start, a gap in it and one in the response: findings and noise level as without the gap."""
    quiet, rng = np.zeros((600, 2)), np.random.default_rng(1)
    quiet[300:] = np.exp(-np.arange(300) / 60)[:, None] * np.sin(np.arange(300) / 3)[:, None] * [50.0, 80.0]
    y = quiet + rng.standard_normal(quiet.shape)
    whole = [f.evidence.name for f in health(gather(y, DT, MODEL, None))]
    y[100:130, 0], y[400:420, 1] = np.nan, np.nan
    data = gather(Record(y, DT, MODEL.sensors), None, MODEL, None, allow_missing=True)
    lost = [f for f in health(data) if f.evidence.name == "missing"]
    assert len(lost) == 2
    assert all("left out of the fit" in f.advice for f in lost)
    assert [f.evidence.name for f in health(data) if f not in lost] == whole
    level = resolve(Noise(), MODEL, data)
    assert level.known
    assert level.level == pytest.approx([1.0, 1.0], rel=0.1)


def test_the_scale_of_a_channel_does_not_depend_on_its_gaps():
    """Where no noise is known, channels are scaled by what was recorded, not by the zeros in the gaps."""
    tone = np.sin(np.arange(N)[:, None] * np.array([0.7, 0.9])) * [1.0, 3.0]
    full = resolve(Noise(), MODEL, gather(tone, DT, MODEL, None))
    tone[::2] = np.nan
    half = resolve(Noise(), MODEL, gather(tone, DT, MODEL, None, allow_missing=True))
    assert half.level == pytest.approx(full.level, rel=0.02)


def test_a_record_with_gaps_is_inverted_in_any_unit():
    g = np.zeros((N, 1))
    g[20:40, 0] = 100 * np.hanning(20)
    h = MODEL.impulse_response(DT, N)
    y = np.stack([np.convolve(h[:, i, 0], g[:, 0])[:N] for i in range(2)], axis=1)
    y = y + 0.01 * y.std() * np.random.default_rng(0).standard_normal(y.shape)
    y[np.random.default_rng(1).random(y.shape) < 0.1] = np.nan
    first, small = (
        Deconvolution(
            StateSpace(SYSTEM.A, SYSTEM.B, c * SYSTEM.C, c * SYSTEM.D, DT, SYSTEM.hold), choice=0.03
        ).estimate(c * y, DT).load
        for c in (1.0, 1e-6)
    )  # fmt: skip
    assert np.linalg.norm(first - g) < 0.1 * np.linalg.norm(g)
    assert np.linalg.norm(first - small) < 1e-9 * np.linalg.norm(g)


def test_clipped_and_held_samples_can_be_taken_out():
    """A sensor that clips misleads; without its clipped samples the other sensor and its rest tell the load."""
    g = np.zeros((N, 1))
    g[20:40, 0] = 100 * np.hanning(20)
    y = MODEL.predict(g, DT)
    y = y + 0.005 * y.std() * np.random.default_rng(0).standard_normal(y.shape)
    rail = 0.4 * np.abs(y[:, 0]).max()
    clipped = Record(np.column_stack([np.clip(y[:, 0], -rail, rail), y[:, 1]]), DT, MODEL.sensors)
    rest = masked(clipped)
    assert np.isnan(rest["s0"]).sum() > 5
    assert np.all(np.abs(clipped["s0"][np.isnan(rest["s0"])]) == rail)
    assert not np.isnan(rest["s1"]).any()
    assert "clipped or held samples of s0 were taken out" in rest.notes[-1]
    assert masked(Record(y, DT, MODEL.sensors)).notes == ()
    wrong, right = (
        np.linalg.norm(Deconvolution(MODEL, noise=0.005 * y.std(), choice=1e-2).estimate(x).load - g)
        for x in (clipped, rest)
    )
    assert right < 0.1 * np.linalg.norm(g)
    assert right < 0.3 * wrong


# -- channels that are no response ------------------------------------------------------------------------------------
@pytest.mark.parametrize("value", [0.0, 3.0])
def test_a_channel_that_is_the_same_throughout(value):
    y = Y.copy()
    y[:, 1] = value
    assert "s1" in refused("the same throughout", MODEL, y)
    assert Deconvolution(MODEL, sensors=["s0"]).estimate(y, DT).load.shape == (N, 1)
    assert Deconvolution(MODEL, noise=1.0).estimate(y, DT).std.max() < np.inf  # a stated noise may hide a response


@pytest.mark.parametrize("factor", [1e3, 1e5])
def test_a_channel_far_too_large_beside_a_stated_noise_has_the_worst_grade(factor):
    pulse = np.where((np.arange(N) > 30) & (np.arange(N) < 40), 100.0, 0.0)[:, None]
    y = MODEL.predict(pulse, DT)
    noise = 0.01 * y.std(axis=0)
    y = (y + noise * Y) * [1.0, factor]
    found = Deconvolution(MODEL, noise=noise).estimate(y, DT)
    assert found.grade.letter == "D"
    assert any(f.code == "LID-W412" for f in found.flags)
