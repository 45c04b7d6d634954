"""The linear engine against the formulas of its source, written out densely."""

import numpy as np
import pytest

from loadid._learning.calibration import calibrated
from loadid._learning.linear import LinearEngine, solved, windows
from loadid._learning.training import Lesson
from loadid._learning.triangle import Triangle
from loadid.generate import Examples, TrainingSet
from structures import InputError

from .made import presses


def parts(n=400):
    y, x = presses(n, 3)
    return Triangle.of((y[i : i + 37], x[i : i + 37]) for i in range(0, n, 37)), y, x


def test_the_map_is_the_covariance_of_loads_and_readings_over_that_of_readings():
    examples, y, x = parts()
    found = solved(examples, None)
    dy, dx = y - y.mean(axis=0), x - x.mean(axis=0)
    B = np.linalg.solve(dy.T @ dy, dy.T @ dx)
    np.testing.assert_allclose(found.B, B, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(found.intercept, x.mean(axis=0) - y.mean(axis=0) @ B, rtol=1e-8, atol=1e-10)
    left = dx.T @ dx - dx.T @ dy @ B
    np.testing.assert_allclose(found.W.T @ found.W, left / (len(y) - 1 - y.shape[1]), rtol=1e-7, atol=1e-12)


def test_it_tends_to_the_posterior_of_the_ensemble():
    """Against C_xy C_yy^(-1) of the true ensemble, which examples only sample."""
    from .made import NOISE, plate

    model, spread = plate()
    H, C = model.static(), spread.T @ spread
    gain = C @ H.T @ np.linalg.inv(H @ C @ H.T + NOISE**2 * np.eye(8))
    y, x = presses(20_000, 4)
    found = solved(Triangle.of([(y, x)]), None)
    np.testing.assert_allclose(found.B.T, gain, atol=0.02 * np.abs(gain).max())
    np.testing.assert_allclose(found.W.T @ found.W, C - gain @ H @ C, atol=0.06 * np.abs(C - gain @ H @ C).max())


def test_a_ridge_is_that_of_ridge_regression():
    examples, y, x = parts()
    found = solved(examples, None, ridge=0.05)
    dy, dx = y - y.mean(axis=0), x - x.mean(axis=0)
    lam = 0.05 * np.linalg.norm(dy, 2)
    B = np.linalg.solve(dy.T @ dy + lam**2 * np.eye(8), dy.T @ dx)
    np.testing.assert_allclose(found.B, B, rtol=1e-7, atol=1e-10)


def test_some_of_the_features_need_no_second_reading():
    examples, y, x = parts()
    kept = np.array([0, 3, 4, 7])
    direct = solved(Triangle.of([(y[:, kept], x)]), None)
    np.testing.assert_allclose(solved(examples.only(kept), None).B, direct.B, rtol=1e-8, atol=1e-10)


def test_errors_on_other_examples_are_those_of_the_examples():
    examples, _, _ = parts()
    one = solved(examples, None)
    y, x = presses(300, 9)
    other = Triangle.of([(y, x)])
    direct = np.sqrt(np.mean((one.intercept + y @ one.B - x) ** 2, axis=0))
    np.testing.assert_allclose(other.error(one.intercept, one.B), direct, rtol=1e-8)


def test_ends_of_a_record_are_mapped_by_what_lies_inside():
    """Least squares of every example at that sample, features written out."""
    rng = np.random.default_rng(0)
    g = rng.standard_normal((150, 60, 1))
    g[:, 1:] += 0.7 * g[:, :-1]
    y = np.concatenate([g + 0.5 * np.roll(g, 1, axis=1), g - 0.3 * np.roll(g, -2, axis=1)], axis=2)
    y += 0.1 * rng.standard_normal(y.shape)
    whole = TrainingSet.of(Examples.measured(y, g, noise=0.1), dt=0.01)
    a, b, c = whole.split((0.7, 0.15, 0.15))
    engine = LinearEngine.learn(Lesson(a, b, c, np.ones(2), None, 0.01))
    h = engine.half
    assert 2 <= h <= 10
    fitted, truth = a.read().data, a.read().loads
    rows = np.concatenate([w for record in fitted for _, w in windows(record, h)])
    targets = np.concatenate([record[h : 60 - h] for record in truth])
    cut = rows[:, h * 2 :]  # the first sample: nothing before it
    cut = np.column_stack([np.ones(len(cut)), cut])
    first = np.linalg.lstsq(cut, targets, rcond=None)[0]
    mean, std = engine.predict(y[-5:])
    expected = np.column_stack([np.ones(5), y[-5:, : h + 1].reshape(5, -1)]) @ first
    np.testing.assert_allclose(mean[:, 0], expected, atol=0.02 * np.std(g))
    assert np.all(std[:, 0] > std[:, 30])
    assert np.all(std[:, -1] > std[:, 30])
    inside = np.sqrt(np.mean((mean - g[-5:])[:, h:-h] ** 2))
    assert inside == pytest.approx(std[0, 30, 0], rel=0.25)
    with pytest.raises(InputError, match="shorter than the window"):
        engine.predict(y[:1, : 2 * h])


@pytest.mark.parametrize("flaw", ["two loads alike", "too few"])
def test_examples_that_do_not_span_the_loads_are_refused(flaw):
    y, x = presses(400 if flaw == "two loads alike" else 4, 0)
    if flaw == "two loads alike":
        x[:, 1] = 2 * x[:, 0]
    whole = TrainingSet.of(Examples.measured(y, x, noise=0.05))
    parts = (whole, whole, whole)
    with pytest.raises(InputError, match="does not span the loads"):
        LinearEngine.learn(Lesson(*parts, scale=np.full(8, 0.05)))


def test_an_output_that_no_example_loads_spoils_no_factor():
    """Its std is 0 and its errors are not: the factors stay numbers, for each output and for a group."""
    rng = np.random.default_rng(5)
    for draws in (30, 400):
        errors, std = rng.standard_normal((draws, 3)), np.tile([1.0, 1.0, 0.0], (draws, 1))
        found = calibrated(errors, np.ones_like(std), std, np.zeros(3, int), 0.95, None, np.zeros(3))
        assert np.all(np.isfinite(found.inside))
        wide = found.multiplied(np.ones_like(std), std)
        assert np.array_equal(wide[:, 2], np.zeros(draws))
        if draws == 400:
            assert np.all(np.abs(wide[:, :2] - 1) < 0.2)


def test_static_loads_that_act_are_covered_as_often_as_those_that_do_not():
    """Nine of ten carry nothing, with small errors: one factor for all holds a fifth less of those that act."""
    rng, groups = np.random.default_rng(3), np.zeros(100, int)

    def drawn(count):
        acts = rng.random((count, 100)) < 0.1
        truth = np.where(acts, rng.uniform(0.3, 1.0, (count, 100)), 0.0)
        off = np.where(acts, 0.1, 0.02) * rng.standard_normal((count, 100))
        return off, truth + off, acts

    off, mean, acts = drawn(200)
    std = np.full(off.shape, 0.05)
    found = calibrated(off, mean, std, groups, 0.95, None, np.zeros(100))
    off, mean, acts = drawn(400)
    inside = np.abs(off) <= 1.96 * found.applied(mean, np.full(off.shape, 0.05))
    for part in (acts, ~acts):
        assert 0.93 <= inside[part].mean() <= 0.975
    assert np.mean(np.abs(off)[acts] <= np.quantile(np.abs(off), 0.95)) < 0.8
