"""Numbers of a tracker by likelihood: where the search ends, what bounds it, and wrong samples of the record."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from case_studies import method_map
from loadid._families.tracking import likelihood as search
from loadid._families.tracking import tuning
from loadid._families.tracking.filters import NAMES, Posing
from loadid._families.tracking.tuning import wrong_samples
from loadid._inverse.gaussian.records import filter_record, smooth_record, smooth_settled
from loadid._inverse.gaussian.steady import steady
from loadid.priors import Matern32
from tests.families.test_tracking import building
from tests.tracked import Tracked, bm2


@cache
def case(kind: str = "matern", samples: int = 1500) -> Tracked:
    return bm2(kind, 0, samples=samples)


def posing(c: Tracked, name: str = "matern32") -> Posing:
    space = c.setup.space()
    return Posing(space, c.dt, np.arange(len(c.noise)), c.noise, (NAMES[name],))


def starts(c: Tracked, name: str = "matern32") -> list[np.ndarray]:
    return NAMES[name].starts(30.0, c.dt, len(c.y))


@pytest.mark.parametrize(("name", "free"), [("matern32", False), ("ou", True), ("random_walk", False)])
def test_the_search_ends_where_that_of_nelder_and_mead_ends(name, free):
    from scipy.optimize import minimize

    c = case()
    build = posing(c, name).build
    found = tuning.tune(build, starts(c, name), c.y, free_scale=free)

    def cost(x):
        return -tuning.likelihood(steady(build(x)), c.y, free)[0]

    away = found.parameters + 0.1
    other = minimize(cost, away, method="Nelder-Mead", options={"xatol": 1e-5, "fatol": 1e-5})
    assert -found.loglik <= other.fun + 1e-3
    assert found.parameters == pytest.approx(other.x, abs=3e-3)
    assert found.evaluations < 60
    assert found.bounded == found.outliers == ()
    if free:
        assert found.scale == pytest.approx(1.0, abs=0.15)


def test_slope_and_information_are_those_of_the_likelihood():
    """Against central differences of the likelihood, and against its curvature at the optimum."""
    c = case()
    likely = tuning.Likelihood(posing(c).build, c.y, False, lambda share: None)
    x = np.log([80.0, 0.1])
    slope, _ = search._expanded(likely, likely(x), np.full(2, 9.0))
    h = 1e-3 * np.eye(2)
    assert slope == pytest.approx([(likely(x + d).cost - likely(x - d).cost) / 2e-3 for d in h], rel=2e-3)
    best = search.climb(likely, likely(x), np.full(2, -9.0), np.full(2, 9.0))
    _, known = search._expanded(likely, best, np.full(2, 9.0))
    h = 0.02 * np.eye(2)
    curved = [(likely(best.x + d).cost + likely(best.x - d).cost - 2 * best.cost) / 4e-4 for d in h]
    assert np.diag(known) == pytest.approx(curved, rel=0.15)


def test_a_length_that_the_record_does_not_tell_stays_within_ten_records():
    c = method_map.case("slow")
    model, dt = method_map.model(), method_map.DT
    for name, at_bound in (("ou", (1,)), ("matern32", ())):
        given = Posing(model, dt, np.arange(3), c.noise, (NAMES[name],), hold="joint")
        found = tuning.tune(given.build, NAMES[name].starts(0.4, dt, len(c.record)), c.record, free_scale=False)
        sd, length = np.exp(found.parameters)
        assert found.bounded == at_bound
        assert length <= 10 * len(c.record) * dt * (1 + 1e-6)
        assert sd < 1e4


@pytest.mark.parametrize("kind", ["matern", "mix"])
def test_wrong_samples_leave_the_numbers_as_they_are(kind):
    c = case(kind)
    bad = c.y.copy()
    rng = np.random.default_rng(0)
    places = rng.choice(np.arange(150, 1450, 20), 8, replace=False)
    channels = rng.integers(0, 4, 8)
    bad[places, channels] += 100 * c.noise[channels] * rng.choice([-1, 1], 8)
    build, begin = posing(c).build, starts(c)
    clean = tuning.tune(build, begin, c.y, free_scale=False)
    found = tuning.tune(build, begin, bad, free_scale=False)
    assert found.outliers == tuple(np.bincount(channels, minlength=4))
    assert clean.outliers == ()
    assert found.parameters == pytest.approx(clean.parameters, abs=0.05)
    first = tuning.Likelihood(build, bad, False, lambda share: None)
    spoilt = search.climb(first, first(clean.parameters), clean.parameters - 5, clean.parameters + 5)
    assert np.abs(spoilt.x - clean.parameters).max() > 0.2


def test_the_others_stand_in_for_a_wrong_sample():
    """What replaces it does not depend on how wrong it was, and is what a filter says that never saw it."""

    c = case(samples=600)
    settled = steady(posing(c).filter(c.setup.space(), [Matern32(100.0, 0.08)]))
    at = (300, 3)
    made = []
    for size in (50.0, -400.0):
        bad = c.y.copy()
        bad[at] += size * c.noise[3]
        found = wrong_samples(settled, bad)
        assert np.argwhere(found.mask).tolist() == [list(at)]
        made.append(found.values[at])
    assert made[0] == pytest.approx(made[1], abs=1e-3 * c.noise[3])
    hole = c.y.copy()
    hole[at] = np.nan
    load = smooth_record(filter_record(settled.model, hole, settled)).load
    filled = np.where(found.mask, made[0], c.y)
    assert smooth_record(filter_record(settled.model, filled, settled)).load == pytest.approx(load, abs=1e-3)
    assert np.abs(smooth_settled(settled, filled)[1][at]) < 1e-4 * c.noise[3]


@pytest.mark.parametrize("seed", [0, 2])
def test_a_step_of_the_load_is_no_wrong_sample(seed):
    """One that comes between two samples surprises the sensor beside it alone."""
    c = bm2("step", seed, samples=1200, fine=20)
    given = Posing(building(), c.dt, np.arange(4), c.noise, (NAMES["matern32"],), hold="joint")
    found = tuning.tune(given.build, starts(c), c.y, free_scale=False)
    assert found.outliers == ()


def test_an_impact_is_no_wrong_sample():
    """All sensors move, however much the impact surprises the filter."""
    c = method_map.case("impact")
    given = Posing(method_map.model(), method_map.DT, np.arange(3), c.noise, (NAMES["matern32"],), hold="joint")
    found = tuning.tune(given.build, NAMES["matern32"].starts(10.0, method_map.DT, 400), c.record, free_scale=False)
    assert found.outliers == ()
