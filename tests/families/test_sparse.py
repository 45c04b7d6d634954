"""The sparse family on case D4 and the half-sine benchmark: supports, errors, what it says, and what it refuses."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import Deconvolution, LoadEstimate, SparseDeconvolution, Sparsity, recommend
from loadid._families import recommend as advice
from loadid._families.posing import sparsity
from loadid._spellings import folded
from loadid.settings import Noise
from structures import ForwardModel, ImpulseModel, InputError, NotIdentifiable, beams, damping, loads, sensors
from tests import halfsine

DT, STEP = 1 / 2000, 1 / halfsine.RATE
SAID = "unloaded record"


# -- D4: l1 against Tikhonov ------------------------------------------------------------------------------------------
@cache
def beam(kind=sensors.Accelerometer, modes: int = 10, at: tuple[int, ...] = (13,)) -> ForwardModel:
    """The standard beam, sensors at nodes 8 and 26, forces at some nodes."""
    structure = beams.simply_supported(
        length=2.0,
        section=beams.Section.rectangle(0.05, 0.01),
        material=beams.materials.steel,
        elements=40,
        damping=damping.Modal(0.01),
    )
    seen = [kind(at=0.05 * x, direction="Z", label=f"s{x}") for x in (8, 26)]
    applied = [loads.Point(at=0.05 * x, direction="Z", label=f"p{x}") for x in at]
    return ForwardModel(structure, seen, applied, modes=modes)


def impacts(samples: int = 400) -> np.ndarray:
    load = np.zeros(samples)
    if samples == 400:
        load[[60, 61, 180]] = 300, 200, 400
    else:
        load[[40, 110]] = 300, 400
    return load


def recorded(model: ForwardModel, load: np.ndarray, eta: float, seed: int = 0, hold: str = "zoh"):
    """Noisy response (samples, sensors) with noise of exactly `eta`, and its std."""
    table = load if load.ndim == 2 else load[:, None]
    clean = model.predict(table, DT, hold)
    e = np.random.default_rng(seed).standard_normal(clean.shape)
    e *= eta * np.linalg.norm(clean) / np.linalg.norm(e)
    return clean + e, float(np.linalg.norm(e) / np.sqrt(e.size))


def error(estimate: LoadEstimate, load: np.ndarray) -> float:
    return float(np.linalg.norm(estimate.load.reshape(load.shape) - load) / np.linalg.norm(load))


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_impacts_on_accelerometers_are_found_to_the_sample(seed, known):
    y, std = recorded(beam(), impacts(), 0.02, seed)
    settings = {"noise": Noise(std, source=SAID)} if known else {}
    e = SparseDeconvolution(beam(), hold="zoh", **settings).estimate(y, DT)
    assert np.flatnonzero(e.load[:, 0]).tolist() == [60, 61, 180]
    assert error(e, impacts()) <= 0.002
    assert e.facts["gap"] <= 1e-6
    assert e.facts["support"] == 3
    assert not e.codes & {"W311", "W304", "W510", "W407"}


def test_a_slow_load_is_not_sent_to_spikes():
    load = 100 * np.sin(np.pi * np.arange(400) / 400) ** 2
    y, std = recorded(beam(), load, 0.02)
    found = recommend(beam(), y, DT, hold="zoh", noise=Noise(std, source=SAID))
    assert found.prior == "matern52"
    assert found.knots is None
    assert "acts all the time" in str(found)
    plain = Deconvolution(beam(), hold="zoh", noise=Noise(std, source=SAID)).estimate(y, DT)
    assert error(found.estimate(y, DT), load) < 0.8 * error(plain, load)
    assert "W311" in SparseDeconvolution(beam(), hold="zoh", noise=Noise(std, source=SAID)).estimate(y, DT).codes


def test_impacts_are_sent_to_spikes():
    y, std = recorded(beam(), impacts(), 0.02)
    found = recommend(beam(), y, DT, hold="zoh", noise=Noise(std, source=SAID))
    assert (found.prior, found.trusted) == ("spikes", True)


def test_places_that_are_good_and_heights_that_are_not_are_said_so():
    model = beam(sensors.Displacement)
    for seed in range(2):
        y, std = recorded(model, impacts(200), 0.05, seed)
        e = SparseDeconvolution(model, hold="zoh", noise=Noise(std, source=SAID)).estimate(y, DT)
        large = np.flatnonzero(np.abs(e.load[:, 0]) > 0.2 * np.abs(e.load).max())
        assert {40, 110} <= set(range(200)) & {int(k) + d for k in large for d in (-1, 0, 1)}
        assert "W304" in e.codes
        found = recommend(model, y, DT, hold="zoh", noise=Noise(std, source=SAID))
        assert not found.trusted
        assert "places are good, the amplitudes are not" in str(found)


# -- half-sine pulses -------------------------------------------------------------------------------------------------
@cache
def struck() -> ImpulseModel:
    return ImpulseModel(halfsine.impulse_response(), STEP, kind="held")


@cache
def pulses(width: int, noise: float, seed: int = 0, known: bool = True, **settings) -> tuple[LoadEstimate, np.ndarray]:
    y, load = halfsine.record(width, noise, seed)
    if known:
        settings |= {"noise": Noise(halfsine.level(halfsine.respond(load), noise), source=SAID)}
    return SparseDeconvolution(struck(), **folded(SparseDeconvolution, settings)).estimate(y, STEP), load


@pytest.mark.parametrize(
    ("width", "noise", "known", "limit"), [(41, 0.01, True, 0.09), (41, 0.05, False, 0.12), (11, 0.05, True, 0.17)]
)
def test_splines_of_the_right_spacing_are_found(width, noise, known, limit):
    found = [pulses(width, noise, seed, known, dictionary="bspline") for seed in range(2)]
    assert np.mean([error(e, load) for e, load in found]) <= limit
    assert all(width / 6 <= e.facts["knots"] <= width / 2 for e, _ in found)
    assert all(e.facts["gap"] <= 1e-6 for e, _ in found)


def test_spikes_for_wide_pulses_are_flagged_with_the_splines_that_fit():
    y, load = halfsine.record(41, 0.01, 0, 500)
    model = ImpulseModel(halfsine.impulse_response(500), STEP, kind="held")
    std = halfsine.level(halfsine.respond(load), 0.01)
    e = SparseDeconvolution(model, noise=Noise(std, source=SAID)).estimate(y, STEP)
    (flag,) = [f for f in e.flags if f.code == "LID-W311"]
    assert error(e, load) > 1
    assert "bspline" in flag.advice
    assert recommend(model, y, STEP, noise=Noise(std, source=SAID)).prior == "pulses"


def test_a_load_that_only_pushes():
    e, load = pulses(41, 0.05, dictionary="bspline", knots=8, nonnegative=True)
    assert e.load.min() >= 0
    assert error(e, load) <= 0.1


def test_the_width_of_a_pulse_tells_the_knots():
    g = np.zeros(300)
    g[100:140] = np.sin(np.pi * (np.arange(40) + 0.5) / 40)
    assert advice.pulse_width(g) == pytest.approx(40, abs=3)
    assert [advice.knots_for(w) for w in (3, 11, 20, 41, 90)] == [2, 2, 4, 8, 16]


# -- the answer -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("factor", [1e-6, 1e6])
def test_units_do_not_change_the_load(factor):
    h, (y, load) = halfsine.impulse_response(600), halfsine.record(11, 0.01, 0, 600)
    std = halfsine.level(halfsine.respond(load), 0.01)
    one = SparseDeconvolution(ImpulseModel(h, STEP, kind="held"), noise=std).estimate(y, STEP)
    scaled = ImpulseModel(factor * h, STEP, kind="held")
    other = SparseDeconvolution(scaled, noise=factor * std).estimate(factor * y, STEP)
    np.testing.assert_allclose(other.load, one.load, atol=1e-6 * np.abs(one.load).max())
    np.testing.assert_allclose(other.std, one.std, rtol=1e-4)


def test_the_std_on_the_support_is_the_scatter_over_records():
    model, load = beam(), impacts()
    found = []
    for seed in range(8):
        clean = model.predict(load[:, None], DT, "zoh")
        y = clean + 2.0 * np.random.default_rng(seed).standard_normal(clean.shape)
        found.append(SparseDeconvolution(model, hold="zoh", noise=Noise(2.0, source=SAID), choice=0.05).estimate(y, DT))
    at = [60, 61, 180]
    scatter = np.std([e.load[at, 0] for e in found], axis=0, ddof=1)
    np.testing.assert_allclose(scatter / found[0].std[at, 0], 1.0, atol=0.55)
    impulse = found[0].functional("impulse")
    assert 0 < impulse.std < found[0].std.max() * DT * 3
    assert np.all(found[0].std[np.setdiff1d(np.arange(400), at)] == 0)


def test_missing_samples_are_left_out():
    model, load = beam(), impacts()
    y, std = recorded(model, load, 0.02)
    gaps = y.copy()
    gaps[70:90, 0] = gaps[178:182, 1] = np.nan
    e = SparseDeconvolution(model, hold="zoh", noise=Noise(std, source=SAID)).estimate(gaps, DT)
    assert error(e, load) <= 0.004
    assert e.facts["m"] == 800 - 24
    assert np.all(np.isfinite(e.response))
    assert np.all(e.residual[70:90, 0] == 0)


def test_a_correlated_noise_is_whitened():
    model, load = beam(), impacts()
    y, std = recorded(model, load, 0.02)
    alone = SparseDeconvolution(model, hold="zoh", noise=Noise(std, source=SAID)).estimate(y, DT)
    both = SparseDeconvolution(model, hold="zoh", noise=Noise(np.eye(2) * std**2, source=SAID)).estimate(y, DT)
    np.testing.assert_allclose(both.load, alone.load, rtol=1e-8, atol=1e-9)


def test_the_candidate_that_was_hit_is_named():
    model = beam(at=(5, 13, 30))
    load = np.zeros((200, 3))
    load[[50, 120], 1] = 300, 200
    y, std = recorded(model, load, 0.02)
    e = SparseDeconvolution(
        model, hold="zoh", noise=Noise(std, source=SAID), sparsity=Sparsity("loads", nonnegative=True)
    ).estimate(y, DT)
    assert e.facts["acting_loads"] == ["p13"]
    assert np.all(e.load[:, [0, 2]] == 0)
    assert error(e, load) <= 0.02
    assert e.std.shape == load.shape


def test_loads_that_act_together_share_their_times():
    model = beam(at=(5, 13))
    load = np.zeros((200, 2))
    load[60], load[120] = (300, -200), (100, 250)
    y, std = recorded(model, load, 0.01)
    e = SparseDeconvolution(model, hold="zoh", noise=Noise(std, source=SAID), sparsity=Sparsity("slots")).estimate(
        y, DT
    )
    acting = e.load != 0
    np.testing.assert_array_equal(acting[:, 0], acting[:, 1])
    assert np.flatnonzero(acting[:, 0]).tolist() == [60, 120]
    assert error(e, load) <= 0.02


def test_wavelets_and_a_matrix_of_the_user():
    y, load = halfsine.record(41, 0.01, 0, 600)
    model = ImpulseModel(halfsine.impulse_response(600), STEP, kind="held")
    std = halfsine.level(halfsine.respond(load), 0.01)
    wavy = SparseDeconvolution(model, dictionary="wavelet", noise=Noise(std, source=SAID)).estimate(y, STEP)
    assert error(wavy, load) < 0.35
    shape = np.sin(np.pi * (np.arange(41) + 0.5) / 41)
    D = np.column_stack([np.convolve(np.eye(600)[k], shape)[:600] for k in range(0, 600, 5)])
    own = SparseDeconvolution(model, dictionary=D, noise=Noise(std, source=SAID)).estimate(y, STEP)
    assert error(own, load) < 0.02
    assert own.facts["support"] == 1


def test_a_long_record_is_judged_on_its_beginning(monkeypatch):
    monkeypatch.setattr(sparsity, "SEGMENT", 1000)
    e, load = pulses.__wrapped__(41, 0.01, 0, True, dictionary="bspline")
    assert error(e, load) <= 0.09
    assert "ebic" not in {r.rule for r in e.choice.rules if r.lam is not None}


def test_an_estimate_is_kept_whole(tmp_path):
    e, _ = pulses(41, 0.05, dictionary="bspline", knots=8)
    e.save(tmp_path / "e.h5")
    again = LoadEstimate.read(tmp_path / "e.h5")
    np.testing.assert_array_equal(again.load, e.load)
    assert again.functional("impulse").std == pytest.approx(e.functional("impulse").std)
    np.testing.assert_allclose(again.posterior.std, e.std)
    text = e.summary(details=True)
    assert "few cubic B-splines with knots every 8 samples" in text
    assert "gap" in text


# -- refusals ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"dictionary": "fourier"}, "unknown dictionary"),
        ({"knots": 4}, "only B-splines have knots"),
        ({"dictionary": "bspline", "knots": 0}, "no spacing"),
        ({"dictionary": "bspline", "knots": "all"}, "no spacing"),
        ({"dictionary": "wavelet", "nonnegative": True}, "both signs"),
        ({"groups": "sensors"}, "unknown groups"),
        ({"groups": "slots", "nonnegative": True}, "no sign"),
        ({"reweighted": -1}, "number of rounds"),
        ({"choice": "gcvv"}, "unknown rule"),
        ({"choice": 1.5}, "no rule"),
        ({"choice": True}, "no relative lambda"),
        ({"tol": 0.1}, "no tolerance"),
        ({"load_class": "wind"}, "unknown class"),
    ],
)
def test_settings_that_mean_nothing_are_refused(settings, said):
    with pytest.raises(InputError, match=said):
        SparseDeconvolution(struck(), **folded(SparseDeconvolution, settings))


def test_records_that_say_nothing_are_refused():
    y, std = recorded(beam(), impacts(), 0.02)
    with pytest.raises(NotIdentifiable, match="nothing beyond its noise"):
        SparseDeconvolution(beam(), hold="zoh", noise=1e4 * std).estimate(y, DT)
    with pytest.raises(InputError, match="the way of the data"):
        SparseDeconvolution(beam(), hold="zoh", noise=std).estimate(0 * y, DT)
    with pytest.raises(InputError, match="does not fit the record"):
        SparseDeconvolution(beam(), hold="zoh", noise=std, dictionary=np.eye(7)).estimate(y, DT)
    with pytest.raises(InputError, match="no spacing"):
        SparseDeconvolution(beam(), hold="zoh", noise=std, dictionary="bspline", knots=300).estimate(y, DT)


def test_a_run_that_is_stopped_returns_nothing():
    def stop(fraction: float, text: str) -> None:
        if fraction > 0.5:
            raise KeyboardInterrupt

    y, std = recorded(beam(), impacts(), 0.02)
    with pytest.raises(KeyboardInterrupt):
        SparseDeconvolution(beam(), hold="zoh", noise=std, progress=stop).estimate(y, DT)
