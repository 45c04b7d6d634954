"""The search for the place of a load against brute force, closed forms and itself in other units."""

from __future__ import annotations

import json
import time
from functools import cache

import numpy as np
import pytest

from case_studies.impact_location import DT, NODES, SAMPLES, beam, half_sine, noisy, recorded
from loadid import LocationResult, LocationSearch, NotIdentifiable, Search
from loadid._families.posing import locating as posed_module
from loadid._families.posing.locating import CandidateLoads, grid_of, shared
from loadid._inverse.convolved import fits
from loadid._inverse.convolved import fits as alike
from loadid._inverse.convolved import fits as scan
from loadid._inverse.convolved import places as several
from loadid._inverse.convolved.places import refine
from loadid._spellings import folded
from loadid.paths import toeplitz
from structures import Channel, ForwardModel, ImpulseModel, InputError, MatrixModel, beams, damping, loads, sensors

CLEAR = (5, 17, 29)
SPACING = 0.1


@cache
def search(**settings) -> LocationSearch:
    """Factors are made once for all tests of the same settings."""
    return LocationSearch(beam(CLEAR), hold="zoh", **folded(LocationSearch, {"workers": 1, **settings}))


@cache
def struck(place: float = 0.637, level: float = 0.02, seed: int = 0, seen: tuple[int, ...] = CLEAR):
    """Record of an impact anywhere on the beam."""
    model = beam(seen)
    one = model.with_loads([loads.Point(at=place, direction="+Z")])
    values, std = noisy(one.predict(half_sine(SAMPLES, DT, 0.010, 0.005), DT, "zoh"), level, seed)
    return recorded(model, values, DT, std)


# -- fits -------------------------------------------------------------------------------------------------------------
def responses(samples=60, count=2, seed=3, derivative=2):
    """Impulse responses (samples, 3, count) of a few decaying modes."""
    rng = np.random.default_rng(seed)
    t = np.arange(samples)[:, None, None]
    h = np.zeros((samples, 3, count))
    for f in (0.03, 0.11, 0.23):
        phase = np.pi / 2 if derivative == 2 else 0.0
        h += rng.standard_normal((3, count)) * np.exp(-0.01 * t) * np.sin(2 * np.pi * f * (t + 1) + phase)
    return h


def stacked(h, lam):
    """The augmented matrix, and the data beside zeros."""
    H = toeplitz(h).reshape(-1, h.shape[0] * h.shape[2])
    return np.vstack([H, np.diag(np.tile(lam, h.shape[0]))]), H


@pytest.mark.parametrize("kind", [fits.JointFit, fits.LongFit])
@pytest.mark.parametrize("derivative", [0, 2])
def test_a_joint_fit_is_the_least_squares_solution(kind, derivative):
    h, lam = responses(derivative=derivative), np.array([0.3, 0.05])
    y = np.random.default_rng(1).standard_normal((60, 3))
    K, H = stacked(h, lam)
    g = np.linalg.lstsq(K, np.concatenate([y.ravel(), np.zeros(120)]), rcond=None)[0]
    found = kind(h, lam).solve(y)
    assert found.exact
    np.testing.assert_allclose(found.load.ravel(), g, rtol=0, atol=1e-7 * np.abs(g).max())
    np.testing.assert_allclose(found.residual.ravel(), y.ravel() - H @ g, atol=1e-7)
    np.testing.assert_allclose(np.sum(found.penalty**2), np.sum((np.tile(lam, 60) * g) ** 2), rtol=1e-6)


@pytest.mark.parametrize("kind", [fits.DenseFit, fits.LongFit])
def test_a_relative_lambda_is_over_the_largest_singular_value(kind):
    h = responses(count=1)
    one, y = kind(h, relative=1e-2), np.random.default_rng(1).standard_normal((60, 3))
    sigma = np.linalg.svd(toeplitz(h).reshape(-1, 60), compute_uv=False)
    assert one.lam[0] == pytest.approx(1e-2 * sigma[0], rel=1e-9 if kind is fits.DenseFit else 1e-4)
    same = fits.JointFit(h, one.lam)
    np.testing.assert_allclose(
        one.solve(y).load, same.solve(y).load, rtol=0, atol=1e-6 * np.abs(one.solve(y).load).max()
    )
    exact = np.sum(sigma**2 / (sigma**2 + one.lam[0] ** 2))
    assert same.edf == pytest.approx(exact, rel=1e-9)
    assert one.edf == pytest.approx(exact, rel=1e-9 if kind is fits.DenseFit else 0.15)  # estimated for long records


def test_a_model_under_other_loads_is_the_model_made_anew():
    model = beam(CLEAR)
    kept = model.modes
    other = [loads.Point(at=0.637, direction="-Z"), loads.Point("7+Z")]
    moved = model.with_loads(other)
    fresh = ForwardModel(model.structure, model.sensors, other, modes=10, residual=False)
    np.testing.assert_allclose(moved.impulse_response(DT, 50), fresh.impulse_response(DT, 50), rtol=1e-9, atol=1e-12)
    assert moved.fingerprint == fresh.fingerprint
    assert moved.modes is kept
    with pytest.raises(InputError, match="LID-E104"):
        model.with_loads([loads.Point("0+Z")])


# -- candidates alike -------------------------------------------------------------------------------------------------
def test_differences_of_responses():
    h = responses(count=3)
    h[..., 2] = -2.5 * h[..., 0]
    found = alike.difference(h)
    a, b = h[..., 0].ravel(), h[..., 1].ravel()
    assert found[0, 1] == pytest.approx(np.linalg.norm(a - (a @ b) / (b @ b) * b) / np.linalg.norm(a), rel=1e-9)
    assert found[0, 2] < 1e-7
    assert alike.groups(h) == ((0, 2),)


def test_neighbours_on_a_fine_grid_are_no_group():
    t = np.linspace(0, 1, 50)[:, None, None]
    x = np.array([0.3, 0.3001, 0.3002, 0.7])
    h = np.sin(np.pi * x) * np.cos(20 * t) + np.sin(2 * np.pi * x) * np.sin(40 * t)
    near = np.abs(x[:, None] - x) < 0.00015
    assert alike.groups(h, near) == ()
    assert alike.groups(h) == ((0, 1, 2),)
    symmetric = np.sin(np.pi * x) * np.cos(20 * t)  # a sensor that sees the mirror places alike
    assert alike.groups(symmetric, near) == ((0, 1, 2, 3),)


def test_the_mirror_place_is_refused_and_reported():
    model, values = beam((20,)), struck(seen=(20,))
    with pytest.raises(NotIdentifiable, match=r"2\+Z and 38\+Z.*impulse responses differ") as refused:
        LocationSearch(model, hold="zoh", search=Search(workers=1)).locate(values)
    assert refused.value.code == "LID-E512"
    found = LocationSearch(model, hold="zoh", search=Search(refine=False, workers=1), allow=["E512"]).locate(values)
    assert found.ratio == pytest.approx(1.0, abs=1e-6)
    assert {"E512", "W511"} <= found.codes
    assert ("12+Z", "28+Z") in found.alike
    assert found.allowed == ("LID-E512",)


# -- the place --------------------------------------------------------------------------------------------------------
def test_the_scores_are_residuals_of_least_squares():
    record = struck()
    found = search(refine=False).locate(record)
    h = beam(CLEAR).impulse_response(DT, SAMPLES, "zoh")
    for j in (0, 5, 11):
        H = toeplitz(h[:, :, j, None]).reshape(-1, SAMPLES)
        lam = 1e-3 * np.linalg.norm(H, 2)
        y = record.values.ravel()
        g = np.linalg.lstsq(np.vstack([H, lam * np.eye(SAMPLES)]), np.r_[y, np.zeros(SAMPLES)], rcond=None)[0]
        assert found.scores[0, j] == pytest.approx(np.linalg.norm(y - H @ g) / np.linalg.norm(y), rel=1e-9)
    assert found.ranking[0] == (found.labels[found.best[0]], found.scores.min())
    second = np.sort(found.scores[0])[1]
    assert found.ratio == pytest.approx(second / found.scores.min(), rel=1e-12)


def refined(place=0.637, level=0.02, seed=0, gains=1.0):
    """The refined place, and the objective as a function of the place by an independent fit."""
    record = struck(place, level, seed)
    model, y = beam(CLEAR), record.values * gains
    grid = grid_of(model, None)
    between = CandidateLoads(model, grid, DT, SAMPLES, "zoh")
    lam = search().choice * np.linalg.norm(toeplitz(between.h[:, :, 5:6]).reshape(-1, SAMPLES), 2) * np.ones(1)
    found = refine(np.array([[0.6]]), y, lam, between.responses, fits.JointFit, grid.bounds, grid.spacing)

    def objective(x):
        K, _ = stacked(model.with_loads([loads.Point(at=x, direction="+Z")]).impulse_response(DT, SAMPLES, "zoh"), lam)
        augmented = np.concatenate([y.ravel(), np.zeros(SAMPLES)])
        return np.sum((augmented - K @ np.linalg.lstsq(K, augmented, rcond=None)[0]) ** 2)

    return found, objective


def test_the_refined_place_is_the_minimum_and_its_std_the_curvature():
    found, objective = refined(level=0.005)
    x = found.place[0, 0]
    assert found.settled
    assert found.objective == pytest.approx(objective(x), rel=1e-6)
    step = 3e-4
    low, mid, high = (objective(x + d) for d in (-step, 0, step))
    assert low > mid < high
    assert abs((high - low) / (high + low - 2 * mid)) * step / 2 < 1e-3 * SPACING  # Newton's step from here
    curvature = (high + low - 2 * mid) / step**2 / 2
    small = 1e-6 * np.sqrt(curvature)
    assert found.covariance(small)[0, 0, 0] == pytest.approx(small**2 / curvature, rel=0.05)


def test_the_stated_std_is_the_scatter_of_the_places():
    """Noise makes a part of the curvature by itself: with that part left in, the std would be too small."""
    found = [refined(0.637, 0.2, seed)[0] for seed in range(16)]
    off = np.array([r.place[0, 0] - 0.637 for r in found])
    sigma = struck(0.637, 0.2).channels[0].noise
    std = np.array([np.sqrt(r.covariance(sigma)[0, 0, 0]) for r in found])
    naive = np.array([sigma / abs(r.curvature[0, 0]) for r in found])
    assert 0.7 < np.median(std) / np.sqrt(np.mean(off**2)) < 1.5
    assert np.median(std / naive) > 1.2
    assert np.isinf(found[0].covariance(1e9)).all()


def test_gains_of_sensors_are_in_the_band_of_the_place():
    """Gains 2 % off, next to no noise: the places scatter as is said of gains, and far beyond what is of noise."""
    count, rng = len(struck().values[0]), np.random.default_rng(2)
    found = [refined(0.637, 1e-3, 0, 1 + 0.02 * rng.standard_normal(count))[0] for _ in range(16)]
    off, sigma = np.array([r.place[0, 0] - 0.637 for r in found]), struck(0.637, 1e-3).channels[0].noise
    std, by_noise = (np.array([np.sqrt(r.covariance(sigma, g)[0, 0, 0]) for r in found]) for g in (0.02, 0.0))
    assert 0.7 < np.median(std) / np.sqrt(np.mean(off**2)) < 1.5
    assert np.median(by_noise) < 0.3 * np.median(std)


def test_residuals_far_beyond_the_noise_count_for_more_than_themselves():
    assert shared(2.0, None) == 2.0  # of noise that nobody stated the residual is all that is known
    assert shared(1.1, 1.0) == 1.1  # by chance
    assert shared(3.0, 1.0) == pytest.approx(np.sqrt(1 + 4 * 8))
    assert shared(3e6, 1e6) == pytest.approx(1e6 * shared(3.0, 1.0))


@pytest.mark.parametrize("place", [0.15, 0.637, 1.05, 1.849])
def test_places_between_candidates_are_found(place):
    found = search().locate(struck(place))
    assert found.found[0, 0] == pytest.approx(place, abs=0.02 * SPACING)
    assert abs(found.found[0, 0] - place) < 4 * found.std[0, 0]
    assert not found.ambiguous
    assert 0.75 < found.facts["residual_to_noise"] < 0.9  # a third of the data is spent: 0.82
    assert np.abs(np.array(NODES)[list(found.best)] * 0.05 - found.found[0, 0]) <= SPACING / 2 + 1e-9


def test_no_answer_depends_on_units():
    record, model = struck(), beam(CLEAR)
    plain = search().locate(record)
    for factor in (1e-6, 1e6):
        values = record.values * factor
        scaled = LocationSearch(
            _scaled(model, factor), hold="zoh", search=Search(refine=False, places=NODES_AT, workers=1)
        )
        once = scaled.locate(values, DT)
        np.testing.assert_allclose(once.scores, plain.scores, rtol=1e-9)
        louder = LocationSearch(model, hold="zoh", search=Search(workers=1), noise=record.channels[0].noise * factor)
        again = louder.locate(values, DT)
        np.testing.assert_allclose(again.found, plain.found, rtol=1e-9)
        np.testing.assert_allclose(again.covariance, plain.covariance, rtol=1e-6)


NODES_AT = np.array(NODES) * 0.05


def _scaled(model, factor):
    h = factor * model.impulse_response(DT, SAMPLES, "zoh")
    return ImpulseModel(h, DT, kind="held", hold="zoh", sensors=model.sensors, loads=model.loads)


def test_impulse_responses_are_interpolated_over_given_places():
    found = LocationSearch(_scaled(beam(CLEAR), 1.0), search=Search(places=NODES_AT, workers=1)).estimate(struck())
    assert found.facts["responses"] == "interpolated"
    assert found.found[0, 0] == pytest.approx(0.637, abs=0.1 * SPACING)
    assert found.estimate.labels == (f"load at ({found.found[0, 0]:.4g}) m",)


def test_candidates_without_places_are_compared_only():
    found = LocationSearch(_scaled(beam(CLEAR), 1.0), search=Search(workers=1)).estimate(struck(0.6))
    assert (found.refined, found.found, found.std) == (False, None, None)
    assert found.where == ("candidate 12+Z",)
    assert found.estimate.labels == ("12+Z",)
    with pytest.raises(InputError, match="places of the candidates are not known"):
        found.plot("map")


def test_a_state_space_keeps_its_states():
    model, record = beam(CLEAR).state_space(DT, "zoh"), struck()
    found = LocationSearch(model, search=Search(places=NODES_AT, workers=1)).estimate(record)
    assert found.found[0, 0] == pytest.approx(0.637, abs=0.1 * SPACING)
    assert found.estimate.load.max() == pytest.approx(100, rel=0.2)
    between = CandidateLoads(model, grid_of(model, NODES_AT), DT, SAMPLES, "zoh")
    place = np.array([[0.637], [1.211]])
    made = between.at(place)
    assert len(made.A) == len(model.A)
    np.testing.assert_allclose(made.impulse_response(DT, SAMPLES), between.responses(place), atol=1e-9)
    one = between.chosen([5, 2])
    assert [c.label for c in one.loads] == ["12+Z", "6+Z"]
    np.testing.assert_allclose(one.impulse_response(DT, SAMPLES), between.h[..., [5, 2]], atol=1e-12)


def test_two_impacts_at_once():
    seen = (3, 9, 14, 23, 31, 37)
    model = beam(seen)
    both = model.with_loads([loads.Point(at=x, direction="+Z") for x in (0.9, 1.43)])  # a pursuit alone misses them
    pulses = np.column_stack([half_sine(SAMPLES, DT, 0.010, 0.005), half_sine(SAMPLES, DT, 0.012, 0.004, 70.0)])
    values, std = noisy(both.predict(pulses, DT, "zoh"), 0.02, 0)
    record = recorded(model, values, DT, std)
    found = LocationSearch(model, hold="zoh", search=Search(2, workers=1)).estimate(record)
    np.testing.assert_allclose(np.sort(found.found[:, 0]), [0.9, 1.43], atol=0.05 * SPACING)
    assert found.scores.shape == (2, len(NODES))
    assert found.estimate.load.shape == (SAMPLES, 2)
    assert not found.ambiguous
    one = LocationSearch(model, hold="zoh", search=Search(workers=1)).locate(record)
    assert any("no place explains the data" in f.message for f in one.flags)


def test_the_group_lasso_meets_its_conditions():
    """At the minimum: correlation mu x / |x| in groups in use, at most mu in the others."""
    h = responses(samples=40, count=4)
    y = np.random.default_rng(5).standard_normal((40, 3))
    H = [toeplitz(h[:, :, j, None]).reshape(-1, 40) for j in range(4)]
    mu = 0.3 * max(np.linalg.norm(A.T @ y.ravel()) for A in H)
    size = several.group_norms(h, y, share=0.3)

    def objective(x):
        left = y.ravel() - sum(A @ part for A, part in zip(H, x, strict=True))
        return 0.5 * left @ left + mu * sum(np.linalg.norm(part) for part in x)

    x = [np.zeros(40)] * 4
    for _ in range(400):  # block coordinate descent with the largest singular value of each block as its bound
        for j, A in enumerate(H):
            bound = np.linalg.norm(A, 2) ** 2
            left = y.ravel() - sum(B @ part for B, part in zip(H, x, strict=True))
            g = x[j] + A.T @ left / bound
            x = [*x[:j], g * max(1 - mu / bound / np.linalg.norm(g), 0.0), *x[j + 1 :]]
    assert objective(x) < objective([np.zeros(40)] * 4)
    np.testing.assert_allclose(size, [np.linalg.norm(part) for part in x], rtol=0.02, atol=0.01 * size.max())


# -- length, threads, stopping ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", [sensors.Accelerometer, sensors.Displacement])
def test_long_records_give_the_scores_of_short_ones(monkeypatch, kind):
    structure = beam(CLEAR).structure
    seen = [kind(f"{k}+Z") for k in CLEAR]
    model = ForwardModel(structure, seen, [loads.Point(f"{k}+Z") for k in (6, 12, 20, 30)], modes=10)
    clean = model.with_loads([loads.Point(at=0.637)]).predict(half_sine(SAMPLES, DT, 0.010, 0.005), DT)
    values, std = noisy(clean, 0.02, 0)
    record = recorded(model, values, DT, std)
    dense = LocationSearch(model, search=Search(workers=1)).locate(record)
    monkeypatch.setattr(posed_module, "DENSE", 10)
    monkeypatch.setattr("loadid._families.location.DENSE", 10)
    long = LocationSearch(model, search=Search(workers=1)).locate(record)
    assert (dense.facts["path"], long.facts["path"]) == ("dense SVD", "FFT and conjugate gradients")
    assert long.facts["exact"]
    np.testing.assert_allclose(long.scores, dense.scores, rtol=1e-5)
    np.testing.assert_allclose(long.found, dense.found, atol=1e-4 * SPACING)
    np.testing.assert_allclose(long.std, dense.std, rtol=0.2)


def test_threads_change_nothing():
    alone, threads = (
        search().locate(struck()),
        LocationSearch(beam(CLEAR), hold="zoh", search=Search(workers=3)).locate(struck()),
    )
    np.testing.assert_allclose(threads.scores, alone.scores, rtol=1e-12)  # BLAS rounds by where its arrays lie
    np.testing.assert_array_equal(threads.found, alone.found)


@pytest.mark.parametrize("fraction", [0.1, 0.62, 0.75])
def test_a_run_that_is_stopped_leaves_nothing(fraction):
    class Stopped(Exception):
        pass

    def stop(done, text):
        if done > fraction:
            raise Stopped

    one = LocationSearch(beam(CLEAR), hold="zoh", search=Search(workers=2), progress=stop)
    with pytest.raises(Stopped):
        one.estimate(struck())
    assert (one._kept is None) == (fraction < 0.6)  # whole factors, or none
    one._progress = lambda done, text: None
    np.testing.assert_array_equal(one.locate(struck()).found, search().locate(struck()).found)


def test_work_that_fails_stops_what_has_not_begun():
    begun = []

    def work(k):
        begun.append(k)
        time.sleep(1e-3)  # time to be told
        if k == 2:
            raise ValueError(k)
        return k

    with pytest.raises(ValueError, match="2"):
        scan.over(work, range(500), workers=2, text="working")
    assert len(begun) < 500
    assert scan.over(lambda k: 2 * k, range(5), workers=3, text="working") == [0, 2, 4, 6, 8]
    told = []
    scan.over(lambda k: k, range(4), workers=1, progress=lambda f, t: told.append((f, t)), text="working")
    assert told == [(0.25, "working"), (0.5, "working"), (0.75, "working"), (1.0, "working")]


# -- answers ----------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def answer():
    return LocationSearch(beam(CLEAR), hold="zoh", search=Search(workers=1), settings={"choice": "gcv"}).estimate(
        struck()
    )


def test_the_load_is_rebuilt_at_the_place(answer):
    load = answer.estimate
    assert load.choice.rule == "gcv"
    assert load.labels == (f"load at ({answer.found[0, 0]:.4g}) m",)
    truth = half_sine(SAMPLES, DT, 0.010, 0.005)
    assert np.linalg.norm(load.load[:, 0] - truth) < 0.15 * np.linalg.norm(truth)


def test_flags_of_the_place_travel_with_the_load():
    unsure = LocationSearch(beam((17,)), hold="zoh", search=Search(refine=False, workers=1)).estimate(
        struck(seen=(17,))
    )
    assert "W511" in unsure.codes & unsure.estimate.codes


def test_a_saved_answer_is_read_back(answer, tmp_path):
    answer.save(tmp_path / "place.h5")
    back = LocationResult.read(tmp_path / "place.h5")
    assert back.summary() == answer.summary()
    np.testing.assert_array_equal(back.covariance, answer.covariance)
    np.testing.assert_array_equal(back.estimate.load, answer.estimate.load)
    with pytest.raises(ValueError, match="read-only"):
        back.scores[0, 0] = 0
    said = json.loads(json.dumps(answer.to_dict(), allow_nan=False))
    assert said["found"] == answer.found.tolist()
    assert said["ambiguous"] is False


def test_pictures(answer, tmp_path):
    for kind in ("map", "residual"):
        answer.plot(kind, truth=[[0.637]] if kind == "map" else None, path=tmp_path / f"{kind}.png")
        assert (tmp_path / f"{kind}.png").stat().st_size > 5000
    with pytest.raises(InputError, match="no such picture"):
        answer.plot("pie")
    with pytest.raises(InputError, match="known places do not fit"):
        answer.plot("map", truth=[np.nan])


def test_the_summary_says_what_a_user_must_know(answer):
    text = answer.summary()
    assert f"({answer.found[0, 0]:.4g} ± " in text
    assert f"residual ratio {answer.ratio:.4f} (ambiguous below 1.05)" in text
    assert "candidates within chi-square of the best: 12+Z" in text


# -- bad input --------------------------------------------------------------------------------------------------------
def test_candidates_on_supports_are_named():
    structure = beams.simply_supported(
        length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=10,
        damping=damping.Modal(0.01),
    )  # fmt: skip
    with pytest.raises(InputError, match=r"LID-E104.*2 loads act on supported.*found: 0\+Z, 10\+Z"):
        ForwardModel(structure, [sensors.Accelerometer("3+Z")], [loads.Point(f"{k}+Z") for k in (0, 2, 4, 10)])


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        ({"choice": 0}, "no relative lambda"),
        ({"choice": -1e-3}, "no relative lambda"),
        ({"choice": float("nan")}, "no relative lambda"),
        ({"choice": True}, "no relative lambda"),
        ({"method": "lasso"}, "unknown method"),
        ({"impacts": 0}, "no number of loads"),
        ({"impacts": 19}, "no number of loads"),
        ({"impacts": 1.5}, "no number of loads"),
        ({"workers": 0}, "no number of threads"),
        ({"family": "deconvolution"}, "no family"),
        ({"places": np.zeros(19)}, "two candidates at one place"),
        ({"places": [[0.1, 0.2]]}, "places do not fit"),
        ({"places": np.full(19, np.nan)}, "places do not fit"),
        ({"allow": ["E999"]}, "no such guard code"),
    ],
)
def test_settings_that_are_none(settings, what):
    with pytest.raises(InputError, match=what):
        LocationSearch(beam(CLEAR), **folded(LocationSearch, settings))


def test_models_that_are_none():
    with pytest.raises(InputError, match="no forward model"):
        LocationSearch(np.eye(3))
    with pytest.raises(InputError, match="no candidates"):
        LocationSearch(beam(CLEAR, [12]))
    with pytest.raises(InputError, match=r"no impulse_response\(\): LocationSearch"):
        LocationSearch(MatrixModel(np.ones((3, 2))))
    mixed = beam(CLEAR).with_loads([loads.Point("12+Z"), loads.Moment("14+RY")])
    with pytest.raises(InputError, match="candidates of different kinds"):
        LocationSearch(mixed)


def test_records_that_are_none():
    values = np.array(struck().values)
    with pytest.raises(InputError, match="zero throughout"):
        search(noise=1.0).locate(0 * values, DT)
    values[7, 1] = np.nan
    with pytest.raises(InputError, match="NaN"):
        search().locate(values, DT)
    with pytest.raises(InputError, match="record does not fit the model"):
        search().locate(values[:, :2], DT)


def test_a_candidate_that_no_sensor_sees_is_named():
    h = np.repeat(responses(samples=30, count=3), 1, axis=2)
    h[..., 1] = 0.0
    named = [Channel(label=f"p{j}", quantity="force", unit="N") for j in range(3)]
    model = ImpulseModel(h, 1e-3, kind="held", loads=named)
    with pytest.raises(InputError, match=r"1 candidates move no sensor.*p1"):
        LocationSearch(model, search=Search(workers=1)).locate(np.ones((30, 3)), 1e-3)
