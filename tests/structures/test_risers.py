"""Risers against closed forms, and the motion of a structure against another integration and its own equation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from structures import ForwardModel, bases, beams, damping, loads, sensors
from structures import beams as risers
from structures._models.motion import motion
from structures.errors import InputError

RISER = {"length": 9.63, "EI": 135.4, "mass_per_length": 0.85}
DT = 1 / 64


def test_the_frequencies_are_those_of_the_closed_form():
    exact = risers.frequencies(**RISER, tension=700.0, count=10)
    assert exact[:6] == pytest.approx([1.51, 3.10, 4.87, 6.87, 9.17, 11.80], abs=0.006)
    model = ForwardModel(risers.riser(**RISER, top_tension=700.0), [sensors.Displacement("30+Z")], [loads.Point("9+Z")])
    assert model.natural_frequencies[:10] == pytest.approx(exact, rel=1e-4)


def test_the_tension_falls_from_the_top_by_the_weight():
    """The static sag of a taut string: under a uniform load w'' T(x) + w' T'(x) = -p where bending is negligible."""
    top, weight, length, p = 700.0, 40.0, 10.0, 2.0
    r = risers.riser(length=length, EI=1e-3, mass_per_length=1.0, top_tension=top, weight_per_length=weight,
                     elements=200)  # fmt: skip
    at = [2.0, 5.0, 8.0]
    model = ForwardModel(r, [sensors.Displacement(at=x) for x in at], bases.patches(r, 1))
    lower = top - weight * length

    def sag(x, c):  # T w' = c - p x, integrated
        T = lower + weight * x
        return (c + p * lower / weight) / weight * np.log(T / lower) - p * x / weight

    slope = np.log(top / lower)
    c = (p * length / weight) * weight / slope - p * lower / weight
    assert sag(length, c) == pytest.approx(0, abs=1e-12)
    assert model.static()[:, 0] * p == pytest.approx([sag(x, c) for x in at], rel=1e-4)
    mirrored = beams.simply_supported(length=length, EI=1e-3, mass_per_length=1.0, elements=200, tension=top)
    assert abs(r.K - mirrored.K).max() > 1


def test_the_loss_factor_on_its_line():
    """K (1 + i eta) on the line, from a direct dense solve."""
    eta, f = 0.03, 5.0
    r = risers.riser(**RISER, top_tension=700.0, elements=12, damping=risers.loss_factor(eta, f))
    model = ForwardModel(r, [sensors.Displacement("4+Z")], [loads.Point("7+Z")])
    dynamic = r.K_free.toarray() * (1 + 1j * eta) - (2 * np.pi * f) ** 2 * r.M_free.toarray()
    unit = r.unit_row("7+Z")[r.free]
    exact = r.unit_row("4+Z")[r.free] @ np.linalg.solve(dynamic, unit)
    assert model.frf([f])[0, 0, 0] == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"top_tension": -1.0}, "top_tension"),
        ({"weight_per_length": 100.0}, "not in tension"),
        ({"weight_per_length": -1.0}, "not in tension"),
        ({"length": 0.0}, "length"),
    ],
)
def test_impossible_risers_are_refused(changed, says):
    with pytest.raises(InputError, match=says):
        risers.riser(**RISER | {"top_tension": 700.0} | changed)


def test_impossible_numbers_are_refused():
    with pytest.raises(InputError, match="loss factor"):
        risers.loss_factor(-0.1, 5.0)
    with pytest.raises(InputError, match="frequency"):
        risers.loss_factor(0.1, 0.0)
    with pytest.raises(InputError, match="buckles"):
        risers.frequencies(**RISER, tension=-100.0, count=3)


def history(samples, count, seed=0):
    return np.cumsum(np.random.default_rng(seed).standard_normal((samples, count)), axis=0)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("kind", [damping.Rayleigh(0.4, 1e-4), damping.Modal(0.02), None])
def test_the_motion_is_that_of_another_integration(kind, hold):
    """One exponential of the finite-element matrices with the load as states, without any mode."""
    r = risers.riser(**RISER, top_tension=700.0, elements=6, damping=kind)
    model = ForwardModel(r, [sensors.Displacement("3+Z")], bases.hats(r, 3))
    g = history(40, 4)
    found = motion(model, g, DT, hold)
    K, M = r.K_free.toarray(), r.M_free.toarray()
    if isinstance(kind, damping.Modal):
        phi = model.modes.phi
        C = M @ phi @ np.diag(2 * 0.02 * np.sqrt(model.modes.lam)) @ phi.T @ M
    else:
        C = 0.4 * M + 1e-4 * K if kind else np.zeros_like(K)
    n, B = len(K), model.columns.toarray()
    F = np.zeros((2 * n + 8, 2 * n + 8))
    F[:n, n : 2 * n] = np.eye(n)
    F[n : 2 * n] = np.linalg.solve(M, np.hstack([-K, -C, B, np.zeros((n, 4))]))
    F[2 * n : 2 * n + 4, 2 * n + 4 :] = np.eye(4) / DT
    E = expm(F * DT)
    before = np.vstack([np.zeros(4), g])
    x, states = np.zeros(2 * n), []
    for k in range(40):
        slope = before[k + 1] - before[k]
        if hold == "zoh":
            slope, first = np.zeros(4), before[k]
        else:
            first = before[k]
        x = (E @ np.concatenate([x, first, slope]))[: 2 * n]
        states.append(x)
    states = np.array(states)
    assert found.displacement[:, r.free] == pytest.approx(states[:, :n], abs=1e-9 * np.abs(states[:, :n]).max())
    assert found.velocity[:, r.free] == pytest.approx(states[:, n:], abs=1e-9 * np.abs(states[:, n:]).max())
    assert np.all(found.displacement[:, r.supported] == 0)


@pytest.mark.parametrize("kind", [damping.Rayleigh(0.4, 1e-4), damping.Modal(0.02)])
def test_the_equation_of_motion_is_obeyed(kind):
    """Forces on every node balance by the finite-element matrices; a wrong load or velocity does not go unnoticed."""
    r = risers.riser(**RISER, top_tension=700.0, damping=kind)
    model = ForwardModel(r, [sensors.Displacement("3+Z")], bases.hats(r, 20))
    found = motion(model, history(300, 21), DT)
    assert found.imbalance() < 1e-10
    if isinstance(kind, damping.Rayleigh):
        u, v, a, f = (x[:, r.free].T for x in (found.displacement, found.velocity, found.acceleration, found.forces))
        residual = (r.M_free @ a + r.C_free @ v + r.K_free @ u - f)[np.isin(r.free, found.along(3))]
        # modes have a backward error of rounding times the norm of K
        rounded = np.finfo(float).eps * len(u) * np.linalg.norm(r.K_free.toarray(), 2) * np.linalg.norm(u)
        assert np.linalg.norm(residual) < rounded < 1e-8 * np.linalg.norm(r.K_free @ u)
    assert replace(found, forces=1.001 * found.forces).imbalance() == pytest.approx(1e-3 / 1.001, rel=1e-6)
    assert replace(found, qd=1.1 * found.qd).imbalance() > 1e-6


def test_few_modes_obey_their_own_equation():
    r = risers.riser(**RISER, top_tension=700.0, damping=0.01)
    model = ForwardModel(r, [sensors.Displacement("3+Z")], bases.hats(r, 20), modes=8)
    assert motion(model, history(200, 21), DT).imbalance() < 1e-10


def test_the_motion_is_what_the_sensors_read():
    r = risers.riser(**RISER, top_tension=700.0, damping=0.01)
    model = ForwardModel(r, [sensors.Accelerometer("17+Z"), sensors.Velocity("40+Z")], bases.hats(r, 5))
    g = history(300, 6)
    found, read = motion(model, g, DT), model.predict(g, DT)
    nodes = found.along(3)
    assert found.acceleration[:, nodes[17]] == pytest.approx(read[:, 0], abs=1e-9 * np.abs(read[:, 0]).max())
    assert found.velocity[:, nodes[40]] == pytest.approx(read[:, 1], abs=1e-9 * np.abs(read[:, 1]).max())


def test_what_has_no_motion_is_refused():
    r = risers.riser(**RISER, top_tension=700.0, elements=10)
    model = ForwardModel(r, [sensors.Displacement("3+Z")], bases.hats(r, 2))
    with pytest.raises(InputError, match="does not fit"):
        motion(model, np.zeros((10, 2)), DT)
    with pytest.raises(InputError, match="does not fit"):
        motion(model, np.full((10, 3), np.nan), DT)
    moving = ForwardModel(r, model.sensors, [loads.MovingPoint(np.linspace(1, 8, 10), label="p")])
    with pytest.raises(InputError, match="stay in place"):
        motion(moving, np.zeros((10, 1)), DT)
