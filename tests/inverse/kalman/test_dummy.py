"""Dummy displacements as a prior: against pseudo-measurements of zero, and what they make of a drift."""

from __future__ import annotations

import numpy as np
import pytest

from loadid import Ambient
from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.model import FilterModel, words
from loadid._inverse.gaussian.records import filter_record as filtered
from loadid._inverse.gaussian.records import smooth_record as smooth
from loadid._inverse.gaussian.steady import steady
from loadid.priors import Matern32, RandomWalk
from structures import ForwardModel, InputError, NotIdentifiable, chains, damping, loads, sensors
from structures._models.mapped import mapped

DT, STD = 0.01, 0.02


def building(*, disp: bool, at: tuple[int, ...] = (5,)) -> ForwardModel:
    storeys = chains.shear_building(masses=[1.0] * 5, stiffnesses=2500.0, damping=damping.Rayleigh(0.1, 5e-4))
    rows = [sensors.Accelerometer(f"{k}+X", label=f"a{k}") for k in (2, 5)]
    rows += [sensors.Displacement(f"{k}+X", label=f"d{k}") for k in at] if disp else []
    return ForwardModel(storeys, rows, [loads.Point(f"{k}+X", label=f"p{k}") for k in at])


@pytest.mark.parametrize("hold", ["foh", "zoh", "joint"])
@pytest.mark.parametrize("prior", [RandomWalk(300.0, 20.0), Matern32(50.0, 0.1)])
def test_the_smoother_is_that_of_zeros_before_during_and_after(hold, prior):
    """Zeros as data of a displacement sensor of that noise, long after the last reading too."""
    rng, N, after = np.random.default_rng(0), 60, 400
    y = rng.standard_normal((N, 2))
    believed = augment(building(disp=False), DT, prior, noise=np.ones(2), hold=hold, dummy=STD)
    fed = augment(building(disp=True), DT, prior, noise=np.array([1.0, 1.0, STD]), hold=hold)
    long = np.full((N + after, 3), np.nan)
    long[:N, :2], long[:, 2] = y, 0.0
    ours = smooth(filtered(believed, y))
    other = smooth(filtered(fed, long))
    size = np.abs(other.load[:N]).max()
    assert ours.load == pytest.approx(other.load[:N], abs=1e-6 * size)
    assert ours.std == pytest.approx(other.std[:N], rel=1e-6)


def test_a_drift_is_held_by_belief_alone():
    """Accelerometers under a walk: without it refused; with it a finite std, which is the wider the weaker it is."""
    model, walk = building(disp=False), RandomWalk(300.0)
    with pytest.raises(NotIdentifiable):
        steady(augment(model, DT, walk, noise=np.ones(2)), DT)
    stds = [steady(augment(model, DT, walk, noise=np.ones(2), dummy=std), DT).std[0] for std in (0.005, 0.05, 0.5)]
    assert stds[0] < stds[1] < stds[2]
    with_sensor = steady(augment(building(disp=True), DT, walk, noise=np.array([1.0, 1.0, 1e-3])), DT)
    assert with_sensor.std[0] < stds[1]


def test_units_and_maps():
    model, walk = building(disp=False, at=(5, 3)), RandomWalk(300.0)
    plain = augment(model, DT, walk, noise=np.ones(2), dummy=STD)
    assert isinstance(plain, FilterModel)
    T = np.array([[1.0, 0.0], [0.0, 1.0]])
    same = augment(mapped(model, T), DT, walk, noise=np.ones(2), dummy=STD)
    np.testing.assert_allclose(same.F, plain.F, atol=1e-9)
    kilo = augment(mapped(model, 1e3 * T), DT, RandomWalk(0.3), noise=np.ones(2), dummy=1e3 * STD)
    np.testing.assert_allclose(kilo.F[: kilo.nx, : kilo.nx], plain.F[: plain.nx, : plain.nx], atol=1e-7)


def test_what_is_refused_and_said():
    model, walk = building(disp=False), RandomWalk(300.0)
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(InputError, match="dummy"):
            augment(model, DT, walk, noise=np.ones(2), dummy=bad)
    with pytest.raises(InputError, match="ambient"):
        augment(model, DT, walk, noise=np.ones(2), dummy=STD, ambient=Ambient(model, 1.0))
    with pytest.raises(InputError, match="no modes"):
        augment(model.state_space(DT, "foh"), DT, walk, noise=np.ones(2), dummy=STD)
    assert "not measured" in words(STD)
