"""L-curve of the variance of a load: its ends, its corner, the choice of the likelihood, the picture."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from loadid import LoadTracker, q_sweep
from loadid._families.tracking.sweep import QSweep, _corner
from loadid._plots.choosing import sweep_figure
from loadid.priors import Matern32, RandomWalk
from loadid.settings import ModelErrors
from structures import InputError
from tests.families.test_tracking import building, case


@cache
def swept(*sensors: str, prior: str = "random_walk") -> QSweep:
    c = case(samples=1500)
    rows = [("a3", "a6", "a10", "d10").index(name) for name in sensors]
    model = building()
    return q_sweep(model, c.y[:, rows], c.dt, noise=c.noise[rows], hold="zoh", sensors=list(sensors), prior=prior)


def test_every_point_is_the_filter_of_its_variance():
    """NIS and likelihood of a point are those of a tracker that is given the prior of that point."""
    c, found = case(samples=1500), swept("a10", "d10")
    k = 10
    (prior,) = found.at(k)
    assert isinstance(prior, RandomWalk)
    settings = {"noise": c.noise[[2, 3]], "hold": "zoh", "sensors": ["a10", "d10"], "gate": None}
    other = LoadTracker(building(), prior=prior, **settings).fit(c.y[:, [2, 3]], c.dt)
    assert found.nis[k] == pytest.approx(other.certificate.nis, rel=0.02)
    tuned = LoadTracker(building(), prior="random_walk", **settings).fit(c.y[:, [2, 3]], c.dt)
    assert found.loglik[found.likely] == pytest.approx(tuned.fitted.numbers["log-likelihood"], abs=1e-3)
    assert found.factors[found.likely] == pytest.approx(1.0)
    assert found.nis[found.likely] == pytest.approx(1.0, abs=0.1)


def test_a_sensor_that_lets_the_load_follow_noise_gives_an_l():
    """The displacement alone: the corner is near the likelihood, and the second arm leaves nothing of the data."""
    found = swept("d10")
    assert np.all(np.diff(found.residual) < 0)
    assert np.all(np.diff(found.roughness) > 0)
    assert found.corner is not None
    assert 0.1 < found.factors[found.corner] < 10
    assert found.residual[-1] < 0.1
    assert "corner" in str(found)
    if found.corner < found.likely:
        assert "too narrow" in str(found)


def test_a_sensor_beside_the_load_leaves_one_arm():
    """An accelerometer there and a displacement tell the load of every sample: more variance changes nothing."""
    found = swept("a10", "d10")
    assert found.corner is None
    assert found.plateau <= found.likely
    assert found.roughness[-1] == pytest.approx(found.roughness[-5], rel=1e-3)
    assert "one arm" in str(found)


def test_the_corner_of_a_curve_that_is_known():
    """Two straight arms, rounded: the corner is where they meet."""
    factors = np.geomspace(1e-3, 1e3, 41)
    residual, roughness = 1 + 1 / factors, 1 + factors
    assert _corner(factors, residual, roughness) == 20
    shifted = _corner(factors, 1 + 30 / factors, 1 + factors / 30)
    assert factors[shifted] == pytest.approx(30, rel=0.5)
    assert _corner(factors, 1 + 1 / factors, np.ones(41) * 3) is None


def test_another_prior_is_swept_too():
    found = swept("a10", "d10", prior="matern32")
    (prior,) = found.at(found.likely)
    assert isinstance(prior, Matern32)
    assert found.at(0)[0].sd == pytest.approx(prior.sd / 100)


def test_bad_settings_are_refused():
    c = case(samples=400)
    for bad in ({"points": 3}, {"points": 9.5}, {"decades": 0.0}, {"model_error": ModelErrors(scales=["stiffness"])}):
        with pytest.raises(InputError):
            q_sweep(building(), c.y, c.dt, noise=c.noise, hold="zoh", **bad)


def test_the_picture(tmp_path):
    for k, sensors in enumerate((("d10",), ("a10", "d10"))):
        path = tmp_path / f"{k}.png"
        sweep_figure(swept(*sensors)).savefig(path)
        assert path.stat().st_size > 15_000
