"""Steady gains: against scipy's Riccati solver where that works, against the filter where it does not, and refused."""

from __future__ import annotations

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from loadid._inverse.gaussian import records
from loadid._inverse.gaussian.loop import Loop, PeriodicLoop
from loadid._inverse.gaussian.model import FilterModel, SquareRoot
from loadid._inverse.gaussian.steady import SteadyFilter, periodic, steady
from structures.errors import InputError, NotIdentifiable

from .gaussian import building, drawn, small

ROOT = Path(__file__).resolve().parents[3]
R_SD = np.array([0.3, 0.3, 0.5, 1e-3])


def with_displacement() -> FilterModel:
    return building().matern(100.0, 0.08, 0.01, R_SD)


def leaking(model: FilterModel, pole: float) -> FilterModel:
    """The load of a random walk forgets."""
    F = model.F.copy()
    F[-1, -1] = pole
    return dataclasses.replace(model, F=F)


def predicted(model: FilterModel) -> np.ndarray:
    """Predicted covariance by scipy."""
    S = None if model.S is None else model.S
    return solve_discrete_are(model.F.T, model.H.T, model.LQ @ model.LQ.T, model.LR @ model.LR.T, s=S)


def run(found: SteadyFilter, Y: np.ndarray, **options: object) -> tuple[Loop, np.ndarray, np.ndarray, int]:
    model = found.model
    loop = Loop(found.rows(), model.p, model.m, model.x0, **options)
    load, e = np.empty((len(Y), model.p)), np.empty(Y.shape)
    return loop, load, e, loop.block(Y, load, e)


@pytest.mark.parametrize(
    "model", [with_displacement(), building().walk(400.0, R_SD), small(0), small(1, correlated=True)]
)
def test_covariances_solve_the_riccati_equation(model: FilterModel) -> None:
    found, P = steady(model, 0.01), predicted(model)
    H, R = model.H, model.LR @ model.LR.T
    Se = H @ P @ H.T + R
    K = np.linalg.solve(Se, H @ P).T
    Pf = P - K @ H @ P
    scale = np.sqrt(np.diag(Pf))
    assert np.max(np.abs(found.L @ found.L.T - Pf) / np.outer(scale, scale)) < 1e-6
    assert np.allclose(found.std, np.sqrt(np.diag(model.Cp @ Pf @ model.Cp.T)), rtol=1e-6)
    assert np.allclose(found.K / scale[:, None] * found.innovation_std, K / scale[:, None] * np.sqrt(np.diag(Se)),
                       rtol=0, atol=1e-6)  # fmt: skip
    radius = np.max(np.abs(np.linalg.eigvals(found.A)))
    assert found.time_constant == pytest.approx(-0.01 / np.log(radius))
    assert found.residual < 1e-9


def test_undetectable_is_refused_where_scipy_answers() -> None:
    model = building(disp=()).walk(100.0, np.full(3, 0.01))
    with pytest.raises(NotIdentifiable, match="grows on") as refused:
        steady(model)
    assert refused.value.code == "LID-E501"
    assert "displacement" in refused.value.advice
    found = steady(leaking(model, 0.999), 0.01)  # a load that forgets hides it: the filter settles, hours later
    assert np.hypot(found.std, 10.0) == pytest.approx(17.3, abs=0.05)  # predicted
    assert found.time_constant > 3600


def test_slow_is_refused_when_it_is_too_slow() -> None:
    model = building(disp=()).walk(100.0, np.full(3, 0.01))
    with pytest.raises(NotIdentifiable, match="does not die"):
        steady(leaking(model, 0.9995))


def test_noise_free_channel_is_named() -> None:
    model = with_displacement()
    with pytest.raises(InputError, match="noise on every channel"):
        steady(dataclasses.replace(model, LR=np.diag([0.0, 1.0, 1.0, 1.0])))


def test_detectable_without_displacement_is_solved() -> None:
    """Accelerometers alone and a Matern load: scipy's pencil fails; the filter itself is the judge."""
    model = building(disp=()).matern(100.0, 0.08, 0.01, np.full(3, 0.3))
    found = steady(model, 0.01)
    core, every = SquareRoot(model), np.ones(3, bool)
    stack, L = core.stack(None, every), core.update_root(core.whole, model.L0)
    for _ in range(6000):
        L = core.covariance(stack, L)[2]
    assert found.radius**12000 < 1e-3
    assert np.linalg.norm(model.Cp @ L, axis=1) == pytest.approx(found.std, rel=1e-3)


def test_gain_in_any_unit() -> None:
    model = with_displacement()
    own = steady(model, 0.01)
    for c in (1e-6, 1e6):
        D = np.r_[np.full(model.nx, c), 1.0, 1.0]  # response and load in other units
        other = steady(dataclasses.replace(
            model, F=model.F * D[:, None] / D, LQ=D[:, None] * model.LQ, LR=c * model.LR, H=c * model.H / D,
            Cp=c * model.Cp / D, L0=D[:, None] * model.L0), 0.01)  # fmt: skip
        assert other.std == pytest.approx(c * own.std, rel=1e-9)
        assert other.radius == pytest.approx(own.radius, rel=1e-9)


@pytest.mark.parametrize("model", [with_displacement(), small(0), small(1, correlated=True)])
def test_loop_is_the_settled_filter(model: FilterModel) -> None:
    Y, P = drawn(model, 1500)
    found, full = steady(model, 0.01), records.filter_record(model, Y)
    loop, load, e, taken = run(found, Y)
    assert taken == len(Y)
    late = slice(1000, None)
    assert np.max(np.abs(load - full.load)[late]) < 1e-8 * np.std(P)
    assert np.allclose(full.std[-1], found.std, rtol=1e-8)
    assert np.allclose(e[late] / found.innovation_std, full.normalised[late], atol=1e-7)
    again = Loop(found.rows(), model.p, model.m, model.x0)
    single = np.array([again.step(y) for y in Y])
    assert np.max(np.abs(single - load)) <= 1e-12 * np.max(np.abs(load))
    assert np.max(np.abs(again.x - loop.x)) <= 1e-12 * np.max(np.abs(loop.x))


def test_sample_that_is_not_taken_leaves_no_trace() -> None:
    model = with_displacement()
    found, (Y, _) = steady(model), drawn(model, 60)
    loop, load, e, _ = run(found, Y[:50], limit=6 * found.innovation_std)
    kept = loop.x
    for bad in (np.nan, np.inf, 1e3):
        y = Y[50].copy()
        y[2] = bad
        assert loop.step(y) is None
        assert np.array_equal(loop.x, kept)
        block = np.array([Y[50], y, Y[51]])
        assert loop.block(block, np.empty((3, 1)), innovations := np.empty((3, 4))) == 1
        assert not abs(innovations[1, 2]) < 6 * found.innovation_std[2]
        loop.x = kept
    assert loop.step(Y[50].astype(np.float32)) is not None
    for wrong in (Y[0, :3], 3.0 * np.ones(1)):
        with pytest.raises(InputError, match="wrong width"):
            loop.step(wrong)
    with pytest.raises(InputError, match="wrong width"):
        loop.block(Y[:, :3], load, e)


def loops() -> list[float]:
    """Loads and states of a stretch, sample by sample and as a block."""
    model = with_displacement()
    loop, load, e, _ = run(steady(model), drawn(model, 300)[0])
    return [*load.reshape(-1), *e.reshape(-1), *loop.x, *loop.step(np.ones(4))]


def test_compiled_loops_change_no_number() -> None:
    code = "import json; from tests.inverse.kalman.test_steady import loops; print(json.dumps(loops()))"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, env=os.environ | {"NUMBA_DISABLE_JIT": "1"},
        capture_output=True, text=True, check=True, timeout=120,
    )  # fmt: skip
    own = np.array(loops())
    assert np.max(np.abs(np.array(json.loads(ran.stdout)) - own)) <= 1e-12 * np.max(np.abs(own))


@pytest.mark.parametrize("correlated", [False, True])
def test_periodic_gains_are_those_of_the_filter(correlated: bool) -> None:
    if correlated:
        model = small(2, correlated=True)
        masks = np.array([[True, True, True], [True, False, True], [False, False, False], [False, True, True]])
    else:
        model = with_displacement()
        masks = np.ones((5, 4), bool)
        masks[1:, 3] = False
    T = len(masks)
    Y, P = drawn(model, 300 * T)
    Y[~np.tile(masks, (300, 1))] = np.nan
    found, full = periodic(model, masks, 0.01), records.filter_record(model, Y)
    assert np.allclose(full.std[-T:], found.std, rtol=1e-8)
    loop = PeriodicLoop(found, model.x0)
    load = np.array([loop.step(y) for y in Y])
    assert np.max(np.abs(load - full.load)[-T:]) < 1e-7 * np.std(P)
    assert loop.step(np.ones(model.m) * np.nan) is None or not masks[0].any()


def test_periodic_with_one_phase_is_steady() -> None:
    model = with_displacement()
    own, other = steady(model, 0.01), periodic(model, np.ones((3, 4), bool), 0.01)
    assert other.std == pytest.approx(np.tile(own.std, (3, 1)), rel=1e-10)
    assert other.time_constant == pytest.approx(own.time_constant, rel=1e-8)
    with pytest.raises(NotIdentifiable, match="grows on"):
        periodic(building().walk(400.0, R_SD), np.array([[True, True, True, False]]))
    with pytest.raises(InputError, match="masks that do not fit"):
        periodic(model, np.ones((3, 2), bool))
