"""Raw records: correlated noise with missing channels, and loads that move, against the dense problem."""

import numpy as np
import pytest

from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import augment, measured, moving
from loadid._inverse.problem import Cholesky
from structures import ForwardModel, InputError, beams, loads
from structures._system.damping import Modal

from .cases import DT, PENALTIES, PLACES, beam, case, holes, off
from .dense import problem

CORRELATION = np.array([[1, 0.6, 0.2], [0.6, 1, -0.3], [0.2, -0.3, 1]])
LAM = 1e-2


@pytest.mark.parametrize("form", ["std", "covariance", "factor"])
def test_noise_is_whitened_for_each_pattern_of_missing_channels(form: str) -> None:
    record = case(beam("dvs"), 80, holes, moving=True)
    s, covariance = record.system, CORRELATION * np.outer(record.noise, record.noise)
    noise = {"std": record.noise, "covariance": covariance, "factor": Cholesky(np.linalg.cholesky(covariance))}[form]
    system = augment(s.A, s.B, s.C, s.D, "second_difference", unknown_start=True)
    path = StateSpacePath(measured(system, record.y, noise))
    exact = problem(s, record.y, record.noise if form == "std" else covariance, "second_difference", unknown_start=True)
    assert path.m == len(exact.y)
    assert off(path.solution(LAM, None).load, exact.at(LAM * float(path.scale)).load) < 1e-10


def test_a_singular_covariance_counts_its_range_only() -> None:
    """Two channels, the second of which repeats the first with the same noise: one datum for each sample."""
    record = case(beam("d"), 80)
    s, twice = record.system, np.ones((2, 1))
    noise = float(record.noise[0]) ** 2 * np.ones((2, 2))
    path = StateSpacePath(measured(augment(s.A, s.B, twice * s.C, twice * s.D), np.hstack([record.y] * 2), noise))
    assert path.m == 80
    assert off(path.solution(LAM, None).load, record.path("identity").solution(LAM, None).load) < 1e-10
    with pytest.raises(InputError, match="range of the singular"):
        measured(augment(s.A, s.B, twice * s.C, twice * s.D), np.hstack([record.y, -record.y]), noise)


@pytest.mark.parametrize("penalty", ["identity", "first", "second", "leaky"])
def test_a_load_that_moves_over_a_beam(penalty: str) -> None:
    """Entering, passing and leaving, beside a load that stays; a gap in one channel."""
    samples, (name, options), rng = 80, PENALTIES[penalty], np.random.default_rng(0)
    structure = beams.cantilever(elements=6, damping=Modal(0.02), length=1.2, EI=800.0, mass_per_length=3.0)
    passing = loads.MovingPoint(np.linspace(-0.1, 1.3, samples), outside="zero")
    model = ForwardModel(structure, [PLACES["a"], PLACES["s"]], [passing, loads.Point("2+Z")], modes=4)
    system = model.state_space(DT)
    load = np.array([np.full(samples, 3.0), np.sin(np.arange(samples) / 5)]).T
    y = system.simulate(load)
    noise = 0.02 * y.std(axis=0)
    y = y + noise * rng.standard_normal(y.shape)
    y[20:25, 0] = np.nan
    each = moving(system.A, system.B, system.C, system.D, samples, name, **options)
    path, dense = StateSpacePath(measured(each, y, noise)), problem(system, y, noise, name, **options)
    exact, found = dense.at(LAM * float(path.scale)), path.solution(LAM, 1.0)
    assert off(path.scale, dense.gamma[0]) < 1e-9
    assert off(found.load, exact.load) < 1e-10
    assert off(found.posterior.std, np.sqrt(np.diag(exact.covariance)).reshape(load.shape)) < 1e-9
    assert off(path.exact(LAM).edf2, np.sum(exact.influence**2)) < 1e-8
    assert off(path.exact(LAM).log_ratio, dense.log_ratio(exact.lam)) < 1e-8


def test_bad_records_are_refused() -> None:
    s = beam("d")
    system = augment(s.A, s.B, s.C, s.D)
    with pytest.raises(InputError, match="do not fit"):
        measured(system, np.zeros((10, 2)))
    with pytest.raises(InputError, match="do not fit"):
        measured([system] * 9, np.zeros((10, 1)))
    with pytest.raises(InputError, match="inf"):
        measured(system, np.full((10, 1), np.inf))
    with pytest.raises(InputError, match="noise"):
        measured(system, np.zeros((10, 1)), np.array([-1.0]))
    with pytest.raises(InputError, match="no data"):
        StateSpacePath(measured(system, np.full((10, 1), np.nan)))
