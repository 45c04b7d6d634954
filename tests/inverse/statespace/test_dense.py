"""The state-space path against dense least squares: everything that a path says, for every penalty, start and gap."""

import numpy as np
import pytest

from structures import NotIdentifiable

from .cases import PENALTIES, beam, case, holes, off

LAM = 1e-2
MIXES = {  # sensors, hold, missing data, unknown start
    "at rest": ("da", "foh", None, False),
    "gaps": ("dsa", "zoh", holes, False),
    "in motion": ("dvs", "foh", None, True),
    "gaps in motion": ("dvs", "zoh", holes, True),
}


@pytest.mark.parametrize("mix", MIXES)
@pytest.mark.parametrize("penalty", PENALTIES)
def test_everything_equals_the_dense_problem(penalty: str, mix: str) -> None:
    kinds, hold, missing, moving = MIXES[mix]
    record, (name, options) = case(beam(kinds, hold), 90, missing, moving), PENALTIES[penalty]
    dense = record.dense(name, unknown_start=moving, **options)
    path = record.path(name, unknown_start=moving, **options)
    lam, n = LAM * float(path.scale), dense.unknowns
    exact, found, solution = dense.at(lam), path.exact(LAM), path.solution(LAM, 1.3)
    assert path.m == len(dense.y)
    assert off(path.scale, dense.gamma[0]) < 1e-9
    assert off(solution.load, exact.load) < 1e-10

    A, left = exact.influence, np.eye(path.m) - exact.influence
    step = -2 * lam**2 * exact.covariance @ (dense.L.T @ (dense.L @ exact.whole))
    scalars = {
        "residual2": (np.sum(exact.residual**2), 1e-10), "penalty2": (np.sum((dense.L @ exact.whole) ** 2), 1e-10),
        "edf": (np.trace(A), 1e-10), "left": (np.trace(left), 1e-10), "edf2": (np.sum(A * A), 1e-8),
        "rest2": (np.sum(left**2), 1e-8), "rest4": (np.sum((left @ left) ** 2), 1e-7),
        "log_ratio": (dense.log_ratio(lam), 1e-8), "sensitivity": (np.linalg.norm(step[:n]), 1e-7),
        "bend": (2 * exact.whole @ dense.L.T @ (dense.L @ step), 1e-8),
        "objective": (np.sum(exact.residual**2) + lam**2 * np.sum((dense.L @ exact.whole) ** 2), 1e-7),
    }  # fmt: skip
    errors = {key: (off(getattr(found, key), value), limit) for key, (value, limit) in scalars.items()}
    assert {key: error for key, (error, limit) in errors.items() if error > limit} == {}

    posterior, w = solution.posterior, np.random.default_rng(1).standard_normal(record.load.shape)
    weights = np.zeros(len(exact.whole))
    weights[:n] = w.reshape(-1)
    variance = 1.3**2 * np.diag(exact.covariance)[:n]
    assert off(posterior.std, np.sqrt(variance).reshape(w.shape)) < 1e-9
    assert off(posterior.noise_std, 1.3 * np.sqrt(np.diag(exact.noise_covariance)[:n])) < 1e-8
    assert (
        off(posterior.variance(np.array([w, -2 * w])), 1.69 * weights @ exact.covariance @ weights * np.array([1, 4]))
        < 1e-9
    )
    assert off(posterior.noise_variance(w), 1.69 * weights @ exact.noise_covariance @ weights) < 1e-9
    assert off(posterior.bias_weights(w), (exact.resolution.T @ weights - weights)[:n]) < 1e-9
    assert off(path.resolve(record.load, LAM), (exact.resolution[:, :n] @ record.load.reshape(-1))[:n]) < 1e-9
    assert off(path.residual(LAM)[~np.isnan(record.y)], exact.residual) < 1e-9
    assert path.gradient(LAM) < 1e-13


@pytest.mark.parametrize("missing", [None, holes])
@pytest.mark.parametrize("penalty", ["identity", "first", "second", "leaky"])
def test_a_record_of_400_samples_two_loads_three_sensors(penalty: str, missing: object) -> None:
    record, (name, options) = case(beam("dsa"), 400, missing), PENALTIES[penalty]  # type: ignore[arg-type]
    path, dense = record.path(name, **options), record.dense(name, **options)
    stack = np.vstack([dense.H, LAM * float(path.scale) * dense.L])
    Q, R = np.linalg.qr(stack)
    exact = np.linalg.solve(R, Q[: len(dense.y)].T @ dense.y)
    assert off(path.solution(LAM, None).load, exact) < 1e-10
    # trace of the influence matrix: squares of the upper block of Q
    assert off(path.at(LAM).edf, np.sum(Q[: len(dense.y)] ** 2)) < 1e-10


def test_an_error_is_predicted_as_by_the_dense_problem() -> None:
    record = case(beam("dvs"), 90, holes)
    path, dense = record.path("first_difference"), record.dense("first_difference")
    scale, n = float(path.scale), dense.unknowns
    pilot, lams = dense.at(0.03 * scale), np.array([1e-3, 1e-2, 1e-1])
    exact = [
        np.sum((at.resolution @ pilot.whole - pilot.whole)[:n] ** 2) + 1.69 * np.trace(at.noise_covariance[:n, :n])
        for at in (dense.at(lam * scale) for lam in lams)
    ]
    assert np.max(np.abs(path.predicted_error(lams, 0.03, 1.3) / exact - 1)) < 5e-3


def test_what_no_sensor_sees_is_refused_with_advice() -> None:
    """Two static loads and an unknown start, one sensor that sees them at rest."""
    record = case(beam("da"), 90)
    with pytest.raises(NotIdentifiable, match="not seen by the sensors") as told:
        record.path("first_difference", unknown_start=True)
    assert told.value.code == "LID-E306"
    assert record.path("identity", unknown_start=True).null == len(record.system.A)


def test_units_of_the_states_do_not_make_a_start_unseen() -> None:
    """A load whose unit moves the sensors 1e-14 times as much as a unit of state."""
    record = case(beam("dvs"), 90)
    s = record.system
    small = type(s)(s.A, s.B * 1e-14, s.C, s.D * 1e-14, s.dt)
    from .cases import Case

    other = Case(small, record.y, record.noise, record.load)
    load = record.path("first_difference", unknown_start=True).solution(LAM, None).load
    path = other.path("first_difference", unknown_start=True)
    assert off(path.solution(LAM, None).load * 1e-14, load) < 1e-8
