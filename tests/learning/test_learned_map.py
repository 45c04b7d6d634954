"""Learned maps: what their band promises, what they do with readings that they do not know, what they refuse."""

import numpy as np
import pytest

import loadid
from loadid import Deconvolution, InputError, LearnedMap, Record, StaticInversion
from loadid._learning.posterior import HistoryPosterior, of_sums, over_time
from loadid.generate import Examples, TrainingSet
from structures import Channel, MatrixModel
from tests.benchmarks.adapted import real, trial

from .made import (
    DT,
    LEVEL,
    NOISE,
    SAMPLES,
    chain,
    history_map,
    plate,
    presses,
    records,
    seen,
    slow,
    static_map,
    static_set,
)


# -- the band ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("output", ["load", "resultant"])
def test_the_band_of_static_loads_covers_what_it_says(output):
    y, x = presses(3000, 77)
    found = static_map(output).predict(y)
    truth = x if output == "load" else x.sum(axis=1, keepdims=True)
    inside = np.abs(found.mean - truth) <= 1.96 * found.std
    assert 0.93 <= inside.mean() <= 0.97
    assert np.mean([v.alarm for v in found.verdicts]) <= 0.01


def test_the_band_of_histories_covers_what_it_says_at_the_ends_too():
    y, x = records(60, 78)
    found = history_map().predict(y)
    inside = np.abs(found.mean - x) <= 1.96 * found.std
    assert 0.93 <= inside.mean() <= 0.97
    assert inside[:, :5].mean() >= 0.85
    assert inside[:, -5:].mean() >= 0.85
    assert np.mean([v.alarm for v in found.verdicts]) <= 0.02  # 1 of 60
    middle = slice(140, -20)  # at its start a record says less
    assert np.linalg.norm((found.mean - x)[:, middle]) / np.linalg.norm(x[:, middle]) < 0.02


def test_it_is_better_than_the_physics_where_the_prior_says_more():
    y, x = presses(200, 79, noise=2 * NOISE)
    plain = StaticInversion(plate()[0]).estimate(y).load
    assert np.linalg.norm(static_map().predict(y).mean - x) <= 1.02 * np.linalg.norm(plain - x)


def test_the_covariance_of_a_static_load_is_that_of_its_errors():
    y, x = presses(3000, 80)
    found = static_map()
    single = found.estimate(y[0])
    weights = np.array([1.0, -0.5, 2.0, 0.3])
    errors = (found.predict(y).mean - x) @ weights
    assert single.functional(weights).std == pytest.approx(np.std(errors), rel=0.12)


def test_a_band_follows_the_size_of_the_load_where_errors_do():
    """Gains within 20 % that nobody reads: large loads err by more (a band of one width holds 62 % of the largest)."""
    model, _ = plate()
    rng = np.random.default_rng(11)

    def drawn(n):
        truth = np.exp(rng.uniform(-2, 1.5, (n, 1))) * (1 + 0.2 * rng.standard_normal((n, 4)))
        read = truth * rng.uniform(0.8, 1.2, (n, 1)) @ model.static().T
        return read + NOISE * rng.standard_normal((n, 8)), truth

    y, x = drawn(1500)
    examples = Examples.measured(y, x, noise=NOISE)
    found = LearnedMap(model).fit(TrainingSet.of(examples, sensors=model.sensors, loads=model.loads))
    y, x = drawn(2000)
    told, size = found.predict(y), np.abs(x).mean(axis=1)
    inside = np.abs(told.mean - x) <= 1.96 * told.std
    small, large = size < np.quantile(size, 0.3), size > np.quantile(size, 0.9)
    for part in (small, large, size > 0):
        assert 0.92 <= inside[part].mean() <= 0.98
    assert np.median(told.std[small]) < 0.2 * np.median(told.std[large])


def test_what_no_reading_tells_is_held_on_either_side_of_its_median():
    """Two gains that nobody reads: where both are low, bands of all draws together hold three loads of four."""
    model, _ = plate()
    rng = np.random.default_rng(3)

    def drawn(n, lowest, highest):
        gains = {name: rng.uniform(lowest, highest, n) for name in ("first", "second")}
        truth = np.exp(rng.uniform(-2, 1.5, (n, 1))) * (1 + 0.1 * rng.standard_normal((n, 4)))
        read = truth * (gains["first"] * gains["second"])[:, None] @ model.static().T
        return Examples.measured(read + NOISE * rng.standard_normal((n, 8)), truth, noise=NOISE, parameters=gains)

    training = TrainingSet.of(drawn(1500, 0.5, 1.5), sensors=model.sensors, loads=model.loads)
    like, low = drawn(1500, 0.5, 1.5), drawn(1500, 0.65, 0.75)

    def held(unseen):
        one = LearnedMap(model).fit(training, unseen=unseen)
        found = [(one.predict(seen.data), seen.loads) for seen in (like, low)]
        return [float(np.mean(np.abs(told.mean - truth) <= 1.96 * told.std)) for told, truth in found]

    (all_, corner), (all_more, corner_more) = held(()), held(("first", "second"))
    assert 0.93 <= all_ <= 0.97
    assert all_more <= 0.99
    assert corner < 0.8
    assert corner_more > 0.85
    for names, what in ((("frist",), "frist"), ("first", "'first'")):
        with pytest.raises(InputError, match=rf"no parameters of the draws.*{what}.*first, second"):
            LearnedMap(model).fit(training, unseen=names)


def test_an_estimate_of_a_static_load_is_kept_with_its_posterior(tmp_path):
    found = static_map().estimate(presses(1, 3)[0][0])
    found.save(tmp_path / "load.h5")
    again = loadid.LoadEstimate.read(tmp_path / "load.h5")
    assert again.functional([1.0, 1.0, 1.0, 1.0]).std == found.functional([1.0, 1.0, 1.0, 1.0]).std


def test_impulses_and_means_of_a_history_are_in_their_band(tmp_path):
    """Errors go along from sample to sample: as if they were independent the bands held 45 to 85 %."""
    y, x = records(60, 78)
    found = [history_map().estimate(Record(one, DT, chain().sensors)) for one in y]
    time = DT * np.arange(SAMPLES)
    for window in ((0.0, 2.0), (0.5, 1.5), (1.0, 1.1), (0.0, 0.1)):
        inside = (time >= window[0] - 1e-9) & (time <= window[1] + 1e-9)
        told = [e.functional("impulse", window=window) for e in found]
        off = [one.value - DT * truth[inside, 0].sum() for one, truth in zip(told, x, strict=True)]
        held = np.mean([abs(a) <= 1.96 * one.std for a, one in zip(off, told, strict=True)])
        assert held >= 0.88, window
    mean, std = found[0].functional("mean"), np.sqrt(np.mean(found[0].std ** 2))
    assert 1.5 * std / np.sqrt(SAMPLES) < mean.std < std
    np.testing.assert_allclose(found[0].posterior.std, found[0].std)
    found[0].save(tmp_path / "load.h5")
    assert loadid.LoadEstimate.read(tmp_path / "load.h5").functional("mean").std == pytest.approx(mean.std, rel=1e-6)


def test_the_correlation_over_time_is_that_of_the_errors():
    """Of two outputs that follow each other by three samples; the variance of a sum is that of its draws."""
    rng = np.random.default_rng(2)

    def drawn(n):
        noise = rng.standard_normal((n, 64, 2))
        first = noise[..., 0] + 0.8 * np.roll(noise[..., 0], 1, axis=1)
        second = np.roll(first, 3, axis=1) + 0.5 * noise[..., 1]
        return np.stack([first / np.std(first), second / np.std(second)], axis=2)

    along = over_time(drawn(400))
    assert np.argmax(along[:, 0, 1]) == 3
    assert along[1, 0, 0] == pytest.approx(0.8 / 1.64, abs=0.05)
    own, w = 1 + rng.random((64, 2)), rng.standard_normal((3, 64, 2)) + 1.0
    posterior = HistoryPosterior(along, own, np.zeros((64, 0, 2)))
    want = np.var(np.einsum("wso,kso->kw", w, own * drawn(4000)), axis=0)
    np.testing.assert_allclose(posterior.variance(w), want, rtol=0.15)


def test_what_sums_over_a_record_lack_is_calibrated():
    """Errors that are constant over 64 samples, where they were taken for independent: eight times as wide."""
    off = np.random.default_rng(3).standard_normal((500, 1, 1)) * np.ones((1, 64, 1))
    white = np.zeros((64, 1, 1))
    white[0] = 1.0
    wider = of_sums(off, np.ones_like(off), white, 0.95)
    assert wider == pytest.approx(8.0, rel=0.1)
    posterior = HistoryPosterior(white, np.ones((64, 1)), np.zeros((64, 0, 1)), wider)
    weights = np.zeros((2, 64, 1))
    weights[0], weights[1, 5] = 1.0, 1.0
    np.testing.assert_allclose(posterior.variance(weights), [(8 * wider) ** 2, 1.0])
    assert of_sums(off / 100, np.ones_like(off), white, 0.95) == 1.0


# -- readings that it does not know ------------------------------------------------------------------------------------
def test_readings_unlike_the_examples_are_answered_by_the_physics():
    y, _ = presses(1, 3)
    strange = y[0] + np.linspace(-3, 3, 8)
    found = static_map().estimate(strange)
    physics = StaticInversion(plate()[0]).estimate(strange)
    np.testing.assert_array_equal(found.load, physics.load)
    np.testing.assert_array_equal(found.std, physics.std)
    assert found.facts.novelty > 1
    assert found.facts.answered_by == "physics"
    flag = next(f for f in found.flags if f.code == "LID-W609")
    assert flag.evidence.value > flag.evidence.threshold
    assert "distance" in str(flag)
    assert found.provenance["learned"]["family"] == "learned map"


def test_readings_like_the_examples_are_answered_by_the_map():
    y, x = presses(1, 3)
    found = static_map().estimate(y[0])
    assert "W609" not in found.codes
    assert found.facts.novelty < 1
    assert found.facts.answered_by == "learned map"
    assert np.linalg.norm(found.load - x[0]) < 0.1 * np.linalg.norm(x[0])
    np.testing.assert_allclose(found.predicted, plate()[0].static() @ found.load, rtol=1e-9)


def test_of_several_frames_those_are_answered_by_the_physics_that_need_it():
    y, _ = presses(5, 4)
    y[2] += np.linspace(-3, 3, 8)
    found = static_map().estimate(y)
    physics, own = StaticInversion(plate()[0]).estimate(y), static_map().predict(y)
    np.testing.assert_array_equal(found.load[2], physics.load[2])
    np.testing.assert_array_equal(np.delete(found.load, 2, 0), np.delete(own.mean, 2, 0))
    assert "in 1 of 5 frames" in str(next(f for f in found.flags if f.code == "LID-W609"))
    np.testing.assert_allclose(found.predicted, found.load @ plate()[0].static().T, atol=1e-9)


@pytest.mark.parametrize("what", ["a fast sine", "an impact", "a stiffer chain"])
def test_records_unlike_the_examples_are_answered_by_the_physics(what):
    rng = np.random.default_rng(5)
    load = slow(rng)
    if what == "a fast sine":
        load = np.sin(2 * np.pi * 40 * DT * np.arange(SAMPLES))
    if what == "an impact":
        load = np.zeros(SAMPLES)
        load[200:202] = 5.0
    y = seen(load, rng, 1.1 if what == "a stiffer chain" else 1.0)
    told = history_map().predict(y[None]).verdicts[0]
    assert told.alarm
    assert told.value > 1.5
    found = history_map().estimate(Record(y, DT, chain().sensors))
    np.testing.assert_array_equal(found.load, Deconvolution(chain()).estimate(Record(y, DT, chain().sensors)).load)
    assert "W609" in found.codes


def test_a_record_with_gaps_is_left_to_the_physics():
    rng = np.random.default_rng(6)
    y = seen(slow(rng), rng)
    y[100:110, 1] = np.nan
    found = history_map().estimate(Record(y, DT, chain().sensors))
    assert "samples are missing" in str(next(f for f in found.flags if f.code == "LID-W609"))


# -- real records ------------------------------------------------------------------------------------------------------
def test_a_few_records_with_known_force_bring_gain_and_bias():
    """A sensor whose structure is 20 % softer, and whose readings do not start at zero."""
    model, spread = plate()
    rng = np.random.default_rng(8)
    offset = np.linspace(-1, 1, 8)

    def real(n):
        truth = rng.standard_normal((n, 4)) @ spread + 1.0
        return 1.2 * truth @ model.static().T + offset + NOISE * rng.standard_normal((n, 8)), truth

    y, x = real(8)
    more = [(one, load) for one, load in zip(y, x, strict=True)]
    more += [(offset + NOISE * rng.standard_normal(8), np.zeros(4)) for _ in range(4)]
    fitted = static_map().adapted(more)
    np.testing.assert_allclose(fitted.adaptation.gain, 1 / 1.2, rtol=0.03)
    np.testing.assert_allclose(fitted.adaptation.bias, offset, atol=4 * NOISE / 2)
    y, x = real(200)
    before, after = static_map().predict(y), fitted.predict(y)
    assert np.linalg.norm(after.mean - x) < 0.2 * np.linalg.norm(before.mean - x)
    assert np.mean([v.alarm for v in after.verdicts]) < 0.1 < np.mean([v.alarm for v in before.verdicts])
    assert np.mean(np.abs(after.mean - x) <= 1.96 * after.std) > 0.85


@pytest.mark.parametrize(("quiet", "pressed"), [(1, 0), (1, 3), (2, 5)])
@pytest.mark.parametrize("summed", [False, True])
def test_the_band_holds_what_gain_and_bias_are_off_by(quiet, pressed, summed):
    """Mean over 60 sensors, each with a gain and a bias of its own; without their errors 0.83 of (1, 0)."""
    known = (lambda load: {"sum": load.sum()}) if summed else None
    noise = np.full(8, NOISE)
    found = [trial(real, static_map(), noise, quiet, pressed, seed, 100, known)[0] for seed in range(1000, 1060)]
    assert 0.93 < np.mean(found) < 0.985


def test_errors_of_gain_and_bias_are_shared_by_all_loads():
    """The posterior knows the std of the sum, which independent loads would give too small."""
    y, x = presses(3, 81)
    more = [(1.2 * one, load) for one, load in zip(y, x, strict=True)] + [(NOISE * np.ones(8), np.zeros(4))]
    fitted = static_map().adapted(more)
    frames = presses(3, 5)[0]
    told = fitted.predict(frames)
    W = fitted.engine.covariance / np.linalg.norm(fitted.engine.covariance, axis=0)
    each = [W * own for own in told.own]
    for k, frame in enumerate(frames):
        want = each[k].T @ each[k] + told.shared[k].T @ told.shared[k]
        posterior = fitted.estimate(frame).posterior
        assert posterior.variance(np.ones(4)) == pytest.approx(want.sum())
        np.testing.assert_allclose(posterior.std, np.sqrt(np.diag(want)))
    together = fitted.estimate(frames).posterior
    both = np.sum([np.sum(one.sum(axis=1) ** 2) for one in each]) + np.sum(told.shared.sum(axis=(0, 2)) ** 2)
    assert together.variance(np.ones((3, 4))) == pytest.approx(both)


def test_gains_that_no_record_tells_stay():
    y, x = presses(1, 81)
    fitted = static_map().adapted([(NOISE * np.zeros(8), np.zeros(4)), (1e-4 * y[0], 1e-4 * x[0])])
    np.testing.assert_array_equal(fitted.adaptation.gain, 1.0)
    np.testing.assert_array_equal(fitted.adaptation.by_gain, 0.0)


def test_known_resultants_bring_a_gain_too():
    y, x = presses(6, 81)
    fitted = static_map().adapted([(1.25 * one, {"sum": load.sum()}) for one, load in zip(y, x, strict=True)])
    np.testing.assert_allclose(fitted.adaptation.gain, 0.8, rtol=0.03)
    assert fitted.adaptation.records == 6


@pytest.mark.parametrize("known", [{"nothing": 1.0}, np.ones(3), np.full(4, np.nan)])
def test_known_loads_that_do_not_fit_are_refused(known):
    with pytest.raises(InputError):
        static_map().adapted([(presses(1, 0)[0][0], known)])


# -- files -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("made", [history_map, lambda: static_map("resultant")])
def test_a_map_and_that_of_its_file_say_the_same(made, tmp_path):
    own = made()
    model = None if own.dt else plate()[0]
    own.save(tmp_path / "map.h5")
    assert b"pickle" not in (tmp_path / "map.h5").read_bytes()
    again = loadid.load_map(tmp_path / "map.h5", model=model)
    y = records(2, 5)[0] if own.dt else presses(3, 5)[0]
    a, b = own.predict(y), again.predict(y)
    np.testing.assert_array_equal(a.mean, b.mean)
    np.testing.assert_array_equal(a.std, b.std)
    for one, other in zip(a.verdicts, b.verdicts, strict=True):
        assert one.scores == pytest.approx(other.scores, rel=1e-9)
        assert one.limits == other.limits
    assert again.facts == own.facts
    assert again.model.fingerprint == own.model.fingerprint


def test_files_that_are_no_map_or_of_another_model_are_refused(tmp_path):
    place = tmp_path / "map.h5"
    history_map().save(place)
    with pytest.raises(InputError, match="learned for another model"):
        loadid.load_map(place, model=chain(1.1))
    names = [Channel(label=n, quantity="strain", unit="1") for n in ("a1", "a3", "u2")]
    with pytest.raises(InputError, match="another sensor"):
        loadid.load_map(place, model=MatrixModel(np.ones((3, 1)), sensors=names, loads=chain().loads))
    data = bytearray(place.read_bytes())
    data[len(data) // 2] ^= 1
    place.write_bytes(data)
    with pytest.raises(InputError, match="damaged"):
        loadid.load_map(place)
    chain().save(tmp_path / "model.h5")
    with pytest.raises(InputError, match="another kind of file"):
        loadid.load_map(tmp_path / "model.h5")
    static_map().save(tmp_path / "static.h5")
    with pytest.raises(InputError, match="not kept in a file"):
        loadid.load_map(tmp_path / "static.h5")


# -- refusals ----------------------------------------------------------------------------------------------------------
def test_training_sets_that_do_not_fit_are_refused():
    model, _ = plate()
    learner = LearnedMap(model)
    others = [Channel(label=f"s{i}", quantity="strain", unit="1") for i in (1, 0, *range(2, 8))]
    with pytest.raises(InputError, match="another sensor"):
        learner.fit(static_set(60, sensors=others))
    with pytest.raises(InputError, match="another load"):
        learner.fit(static_set(60, loads=[Channel(label=f"p{i}", quantity="moment", unit="N m") for i in range(4)]))
    with pytest.raises(InputError, match="too few draws"):
        learner.fit(static_set(60))
    with pytest.raises(InputError, match="no such engine"):
        LearnedMap(model, engine="forest")
    with pytest.raises(InputError, match="no coverage"):
        LearnedMap(model, coverage=1.5)
    y, x = presses(200, 0)
    y[:, 2] = 0.0
    dead = TrainingSet.of(Examples.measured(y, x, noise=NOISE), sensors=model.sensors, loads=model.loads)
    with pytest.raises(InputError, match="reads nothing"):
        learner.fit(dead)


def test_readings_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="NaN"):
        static_map().estimate(np.full(8, np.nan))
    with pytest.raises(InputError, match="different steps"):
        history_map().estimate(np.zeros((SAMPLES, 3)) + LEVEL, dt=2 * DT)
    wrong = [Channel(label=c.label, quantity="velocity", unit="m/s") for c in chain().sensors]
    with pytest.raises(InputError, match="unit of a channel"):
        history_map().estimate(Record(np.zeros((SAMPLES, 3)) + LEVEL, DT, wrong))
