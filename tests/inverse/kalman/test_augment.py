"""The augmented model against oversampled simulations, Lyapunov equations, other formulas and the batch path."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import linalg

from loadid import Ambient
from loadid._inverse.gaussian.augment import augment
from loadid._inverse.gaussian.model import FilterModel
from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import of_model, record
from loadid._inverse.gaussian.records import filter_record as filter
from loadid._inverse.gaussian.records import smooth_record as smooth
from loadid.priors import OU, Matern32, Matern52, Periodic, RandomWalk, Sum, White
from structures import Channel, ForwardModel, MeasuredModel, StateSpace, Structure, beams, chains, loads, sensors
from structures._models.discretise import continuous
from structures._models.mapped import MappedModel, mapped
from structures._system.damping import Modal, Rayleigh, Structural
from structures.errors import InputError, NotIdentifiable

from ... import tracked
from ...benchmarks import holds

DT = 0.01
DRAWN = np.random.default_rng(7)


def tower(
    acc: Sequence[int] = (3, 6, 10), disp: Sequence[int] = (10,), at: Sequence[int] = (10,), **settings: Any
) -> ForwardModel:
    """The building of `tracked.building`, built by `structures`."""
    structure = chains.shear_building(masses=np.ones(10), stiffnesses=2500.0, damping=Rayleigh(0.1, 5e-4))
    rows = [sensors.Accelerometer(f"{i}+X") for i in acc] + [
        sensors.Displacement(f"{i}+X", label=f"u{i}") for i in disp
    ]
    return ForwardModel(structure, rows, [loads.Point(f"{i}+X") for i in at], **settings)


def beam(kinds: str, count: int = 2, damping: Any = None, modes: int | None = 4) -> ForwardModel:
    """A cantilever with a sensor for each letter, the small ones behind a high-pass."""
    places: dict[str, Any] = {
        "d": sensors.Displacement("5+Z"), "v": sensors.Velocity("3+Z"), "a": sensors.Accelerometer("4+Z"),
        "s": sensors.StrainGauge(at=0.1, fibre=0.01), "q": sensors.Displacement("6+Z", highpass=3.0, label="d'"),
        "w": sensors.Velocity("6+Z", highpass=3.0, label="v'"), "b": sensors.Accelerometer("6+Z", highpass=3.0),
        "t": sensors.StrainGauge(at=0.3, fibre=0.01, highpass=3.0, label="s'"),
    }  # fmt: skip
    structure = beams.cantilever(elements=6, damping=damping or Modal(0.02), length=1.2, EI=800.0, mass_per_length=3.0)
    where = [loads.Point("6+Z"), loads.Point("2+Z")][:count]
    return ForwardModel(structure, [places[k] for k in kinds], where, modes=modes)


def driven(model: FilterModel, load: NDArray) -> NDArray:
    """Response (samples, m) of a filter model whose loads have white priors of one, driven by a load history."""
    x, out = np.zeros(model.n), []
    x[model.nx :] = load[0]
    for k in range(len(load)):
        out.append(model.H @ x)
        ahead = load[min(k + 1, len(load) - 1)]
        x = model.F @ x
        x[model.nx :] += ahead
    return np.array(out)


# -- held loads -------------------------------------------------------------------------------------------------------
def test_first_order_hold_is_the_oversampled_simulation() -> None:
    """Against the matrices of the building in physical coordinates, at a step twenty times finer."""
    setup = tracked.building()
    fine, t = 20, np.arange(60) * DT
    load = DRAWN.standard_normal((60, 1))
    load[0] = 0.0  # a load that jumps before the record has risen over a sample: no rest at the first
    dense = np.interp(np.arange((len(t) - 1) * fine + 1) * DT / fine, t, load[:, 0])[:, None]
    want = setup.respond(dense, fine, "foh")
    model = augment(tower(), DT, White(1.0), noise=np.ones(4), hold="foh")
    np.testing.assert_allclose(driven(model, load), want, atol=1e-12)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
def test_several_loads_are_the_simulation_of_the_model(hold: str) -> None:
    source = beam("dvasqwbt")
    load = DRAWN.standard_normal((80, 2))
    model = augment(source, 1e-3, White(1.0), noise=np.ones(8), hold=hold)
    want = source.state_space(1e-3, hold).simulate(load)
    np.testing.assert_allclose(driven(model, load), want, atol=1e-12 * np.abs(want).max())
    np.testing.assert_array_equal(model.Cp, np.eye(2, model.n, model.nx))


def test_a_constant_load_gives_the_static_response() -> None:
    """The residual of the modes left out is in the displacement and strain rows."""
    source = beam("ds", modes=1)
    for hold in ("foh", "zoh", "joint"):
        model = augment(source, 1e-3, RandomWalk(2.0), noise=np.ones(2), hold=hold)
        nx, p = model.nx, np.array([3.0, -5.0])
        z = np.linalg.solve(model.Cp[:, nx:], p)
        x = np.linalg.solve(np.eye(nx) - model.F[:nx, :nx], model.F[:nx, nx:] @ z)
        np.testing.assert_allclose(model.H @ np.concatenate([x, z]), source.static() @ p, rtol=1e-9)


@pytest.mark.parametrize("hold", ["foh", "zoh", "joint"])
def test_a_static_start_carries_the_first_load(hold: str) -> None:
    """Its covariance is that of loads that have been constant: sensors read the static response, and it stays."""
    source = beam("da")
    model = augment(source, 1e-3, RandomWalk(1.0, start=3.0), noise=np.ones(2), hold=hold, start="static")
    rounded = 2 * model.n * np.finfo(float).eps * (np.abs(model.H) @ np.abs(model.L0)).max()  # of L0 and of the product
    np.testing.assert_allclose(model.H @ model.L0, 3.0 * source.static(), rtol=1e-9, atol=rounded)
    np.testing.assert_allclose(model.F @ model.L0, model.L0, atol=1e-12 * np.abs(model.L0).max())
    free = augment(source, 1e-3, RandomWalk(1.0, start=3.0), noise=np.ones(2), hold=hold)
    assert not (free.L0[: free.nx]).any()


def test_priors_stand_side_by_side() -> None:
    kinds = [Matern52(2.0, 0.1), Sum((OU(3.0, 0.2), RandomWalk(1.0)))]
    source = beam("da")
    model = augment(source, 1e-3, kinds, noise=np.ones(2), hold="zoh")
    known, nx = [kind.discrete(1e-3) for kind in kinds], model.nx
    np.testing.assert_array_equal(model.F[nx:, nx:], linalg.block_diag(*(k.F for k in known)))
    np.testing.assert_array_equal(model.LQ[nx:], linalg.block_diag(*(k.LQ for k in known)))
    np.testing.assert_array_equal(model.L0[nx:], linalg.block_diag(*(k.L0 for k in known)))
    np.testing.assert_array_equal(model.Cp[:, nx:], linalg.block_diag(*(k.H for k in known)))
    assert not model.L0[:nx].any()  # at rest


def test_settings_of_the_structure() -> None:
    source, cov = beam("da"), np.array([[4.0, 0.3e-3], [0.3e-3, 1e-6]])
    sd = np.arange(8.0)
    model = augment(source, 1e-3, OU(1.0, 0.1), noise=cov, state_noise=sd, start=0.5)
    np.testing.assert_allclose(model.LR @ model.LR.T, cov, rtol=1e-14)
    plain = augment(source, 1e-3, OU(1.0, 0.1), noise=cov, start=0.5)
    added = (model.LQ @ model.LQ.T - plain.LQ @ plain.LQ.T)[:8, :8]
    np.testing.assert_allclose(added, np.diag(sd**2), atol=1e-8)
    np.testing.assert_allclose((model.L0 @ model.L0.T)[:8, :8], 0.25 * np.eye(8))
    assert augment(source, 1e-3, OU(1.0, 0.1), noise=np.ones(2), start=np.ones((8, 1))).L0.shape == (10, 3)


def test_combinations_of_loads_and_bare_matrices_are_models_too() -> None:
    source, T = beam("da"), np.array([[1.0], [2.0]])
    under = mapped(source, T)
    for hold in ("foh", "zoh", "joint"):
        one = augment(under, 1e-3, Matern32(1.0, 0.1), noise=np.ones(2), hold=hold)
        two = augment(source, 1e-3, Matern32(1.0, 0.1), noise=np.ones(2), hold=hold)
        nx = one.nx
        np.testing.assert_allclose(one.F[:nx, nx:], two.F[:nx, nx:] @ np.kron(T, np.eye(2)), atol=1e-15)
        np.testing.assert_allclose(one.H[:, nx:], two.H[:, nx:] @ np.kron(T, np.eye(2)), atol=1e-15)
    bare = source.state_space(1e-3, "zoh")  # its own hold is taken
    want = augment(source, 1e-3, Matern32(1.0, 0.1), noise=np.ones(2), hold="zoh")
    np.testing.assert_array_equal(augment(bare, 1e-3, Matern32(1.0, 0.1), noise=np.ones(2)).F, want.F)


# -- the joint hold ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("damping", [Modal(0.02), Rayleigh(2.0, 1e-4), "coupled"])
def test_continuous_matrices_are_the_model(damping: Any) -> None:
    """Their exponential is the transition, their frequency response that of the reduced model."""
    source = beam("dvasqwbt", damping=Modal(0.02) if damping == "coupled" else damping)
    reduced = source.reduced
    if damping == "coupled":
        X = 0.3 * DRAWN.standard_normal((4, 4))
        reduced = replace(reduced, damping=np.diag(reduced.damping) + X @ X.T)
    A, B, C, D = continuous(reduced)
    f = np.array([0.5, 7.0, 40.0, 300.0])
    s = 2j * np.pi * f[:, None, None]
    H = C @ np.linalg.solve(s * np.eye(len(A)) - A, np.broadcast_to(B, (4, *B.shape))) + D
    if reduced.residual is not None:  # in the time domain it belongs to displacement and strain
        reduced = replace(reduced, residual=np.where(reduced.derivative[:, None] == 0, reduced.residual, 0.0))
    want = reduced.frf(f)
    np.testing.assert_allclose(H / np.abs(want), want / np.abs(want), atol=1e-9)
    if damping != "coupled":
        np.testing.assert_allclose(linalg.expm(A * 1e-3), source.state_space(1e-3).A, atol=1e-12)


def free_body() -> ForwardModel:
    structure = Structure.from_matrices(
        [[50.0, -50.0], [-50.0, 50.0]], np.diag([1.0, 2.0]), dofs=["1+X", "2+X"], damping=Modal(0.05)
    )
    return ForwardModel(structure, [sensors.Displacement("2+X"), sensors.Accelerometer("1+X")], [loads.Point("1+X")])


def test_a_free_body_in_continuous_time() -> None:
    source = free_body()
    A, *_ = continuous(source.reduced)
    np.testing.assert_allclose(linalg.expm(A * 0.01), source.state_space(0.01).A, atol=1e-13)


@pytest.mark.parametrize("prior", [OU(3.0, 0.05), Matern32(3.0, 0.08), Matern52(3.0, 0.3)])
@pytest.mark.parametrize("dt", [1e-4, 0.01, 0.1])
def test_joint_noise_is_what_the_stationary_covariance_asks(prior: Any, dt: float) -> None:
    """F P F^T + Q = P with P of the continuous Lyapunov equation, and F its exponential."""
    source = tower()
    model = augment(source, dt, prior, noise=np.ones(4), hold="joint")
    A, B, _, _ = continuous(source.reduced)
    known = prior.continuous()
    rates = np.block([[A, B @ known.H], [np.zeros((len(known.F), len(A))), known.F]])
    push = np.vstack([np.zeros((len(A), 1)), known.b])
    P = linalg.solve_continuous_lyapunov(rates, -push @ push.T)
    np.testing.assert_allclose(model.F, linalg.expm(rates * dt), atol=1e-11)
    size = np.sqrt(np.diag(P))
    residue = (model.F @ P @ model.F.T + model.LQ @ model.LQ.T - P) / np.outer(size, size)
    np.testing.assert_allclose(residue, 0, atol=1e-10)


def test_joint_noise_of_a_short_step_keeps_its_digits() -> None:
    """The noise of the structure's states is of high order in the step: a few of its powers in long double."""
    source, prior, dt = tower(), Matern32(3.0, 0.08), 1e-5
    model = augment(source, dt, prior, noise=np.ones(4), hold="joint")
    A, B, _, _ = continuous(source.reduced)
    known = prior.continuous()
    rates = np.block([[A, B @ known.H], [np.zeros((2, len(A))), known.F]]).astype(np.longdouble)
    terms = [np.vstack([np.zeros((len(A), 1)), known.b]).astype(np.longdouble)]
    for k in range(1, 14):
        terms.append(rates @ terms[-1] / k)
    Q = sum(
        (a @ b.T) * np.longdouble(dt) ** (i + j + 1) / (i + j + 1)
        for i, a in enumerate(terms) for j, b in enumerate(terms)
    )  # fmt: skip
    got = model.LQ @ model.LQ.T
    scale = np.sqrt(np.outer(np.diag(Q), np.diag(Q)))
    assert float(np.diag(Q).min() / np.diag(Q).max()) < 1e-20  # what a subtraction would lose
    np.testing.assert_allclose((got / scale).astype(float), (Q / scale).astype(float), atol=1e-12)


@pytest.mark.parametrize("kind", [OU, Matern32, Matern52])
def test_what_a_load_does_beside_its_straight_line_is_noise(kind: type) -> None:
    """Against a quadrature of its covariance; a walk, whose numbers are those of Tikhonov, is taken as straight."""
    source, dt = tower(), 0.02
    prior = kind(3.0, 0.1)
    model = augment(source, dt, prior, noise=np.ones(4), hold="foh")
    got = (model.LQ @ model.LQ.T)[: model.nx, : model.nx]
    A, B, _, _ = continuous(source.reduced)
    nodes, weights = np.polynomial.legendre.leggauss(40)
    s, w = dt * (nodes + 1) / 2, dt * weights / 2
    pushed = np.array([linalg.expm(A * (dt - one)) @ B[:, 0] for one in s]).T * w
    ends = np.array([pushed @ (1 - s / dt), pushed @ (s / dt)]).T
    at, push = np.r_[s, 0.0, dt], np.hstack([pushed, -ends])
    lag = np.abs(at[:, None] - at)
    a = lag * {OU: 1.0, Matern32: np.sqrt(3), Matern52: np.sqrt(5)}[kind] / 0.1
    shape = {OU: 1.0, Matern32: 1 + a, Matern52: 1 + a + a**2 / 3}[kind]
    wanted = push @ (9.0 * shape * np.exp(-a)) @ push.T
    size = np.sqrt(np.diag(wanted))
    rough = 2e-2 if kind is OU else 1e-3  # the kernel has a kink, and the quadrature no node on it
    np.testing.assert_allclose(got / np.outer(size, size), wanted / np.outer(size, size), atol=rough)
    assert not augment(source, dt, RandomWalk(2.0), noise=np.ones(4), hold="foh").LQ[: model.nx].any()
    assert not augment(source, dt, prior, noise=np.ones(4), hold="zoh").LQ[: model.nx].any()


def test_joint_hold_is_the_limit_of_fine_steps() -> None:
    """Covariance of the sensors over lags: a hundred held steps to one joint step."""
    source, prior = tower(), Matern52(3.0, 0.1)
    coarse = augment(source, DT, prior, noise=np.ones(4), hold="joint")
    fine = augment(source, DT / 100, prior, noise=np.ones(4), hold="foh")
    lags = []
    for model, per in ((coarse, 1), (fine, 100)):
        P = linalg.solve_discrete_lyapunov(model.F, model.LQ @ model.LQ.T)
        step = np.linalg.matrix_power(model.F, per)
        lags.append([model.H @ np.linalg.matrix_power(step, k) @ P @ model.H.T for k in (0, 1, 7)])
    np.testing.assert_allclose(lags[0], lags[1], rtol=1e-3, atol=1e-3 * np.abs(lags[1][0]).min())


def test_the_band_holds_for_a_load_that_runs_continuously() -> None:
    """Truth at a twentieth of the step: right with the joint hold, cautious with the first order, not with stairs."""
    cases = [holds.record("matern", DT, seed, "foh") for seed in range(2)]
    held, linear, joint = (np.mean([holds.judged(case, hold) for case in cases], axis=0) for hold in holds.HOLDS)
    assert joint[0] < linear[0] < 0.04 < 0.1 < held[0]
    assert held[1] < 0.5
    assert 0.94 < linear[1] < 0.98
    assert abs(linear[2] - 1) < 0.05
    assert 0.925 < joint[1] < 0.975
    assert abs(joint[2] - 1) < 0.05
    assert held[2] > 5


# -- disturbances -----------------------------------------------------------------------------------------------------
def test_ambient_loads_correlate_the_noises() -> None:
    """BM3 from bare matrices: the covariances that its formulas give."""
    case = tracked.bm3(samples=10)
    A, B, G, J = case.setup.matrices()
    around = StateSpace(A, *_ambient_of(case), case.dt)
    prior = OU(10.0, 1 / (2 * np.pi * 0.05))
    model = augment(
        StateSpace(A, B, G, J, case.dt), case.dt, prior, noise=np.full(4, 1e-4), state_noise=1e-8,
        ambient=Ambient(around, 1.0),
    )  # fmt: skip
    want = tracked.filter_model(case, tracked.ar1(10.0, np.exp(-2 * np.pi * 0.05 * case.dt)))
    np.testing.assert_allclose(model.LR @ model.LR.T, want.LR @ want.LR.T, rtol=1e-12)
    np.testing.assert_allclose(model.S, want.S, atol=1e-14 * np.abs(want.S).max())
    cov, its = model.Cp @ model.LQ, want.Cp @ want.LQ
    np.testing.assert_allclose(cov @ cov.T, its @ its.T, rtol=1e-10)
    Q, Q_want = (m.LQ[:16] @ m.LQ[:16].T for m in (model, want))
    np.testing.assert_allclose(Q, Q_want, atol=1e-14 * np.abs(Q_want).max())
    y = case.y
    np.testing.assert_allclose(
        tracked.reference(replace_start(model, want), y).load, tracked.reference(want, y).load, rtol=1e-7
    )


def _ambient_of(case: tracked.Tracked) -> tuple[NDArray, NDArray, NDArray]:
    """B, C and D of the ambient loads of BM3, from its modes."""
    x = (np.array([25, 45, 80])[:, None] - 1) * 30.0 / 100
    around = (np.sqrt(2 / 1500.0) * np.sin(np.arange(1, 9) * np.pi * x / 30.0)).T
    _, E0, E1 = case.setup.held(around, case.dt)
    return E0 + E1, case.setup.G, case.setup.through(around)


def replace_start(model: FilterModel, other: FilterModel) -> FilterModel:
    """With the start of another model of the load in its own units."""
    L0 = other.L0.copy()
    L0[model.nx :] /= model.Cp[0, model.nx]
    return replace(model, L0=L0)


@pytest.mark.parametrize("hold", ["foh", "zoh", "joint"])
def test_ambient_loads_of_a_structure(hold: str) -> None:
    """Together with the priors they are what white loads of their covariance do; correlated ones too."""
    source = tower(at=(10,))
    around, cov = source.with_loads([loads.Point("4+X"), loads.Point("7+X")]), np.array([[4.0, 1.0], [1.0, 9.0]])
    model = augment(source, DT, OU(1.0, 1.0), noise=np.full(4, 0.1), hold=hold, ambient=Ambient(around, cov))
    known = around.state_space(DT, "zoh" if hold == "joint" else hold)
    nx = model.nx
    assert model.S is not None
    np.testing.assert_allclose(model.S[:nx], known.B @ cov @ known.D.T, atol=1e-14)
    np.testing.assert_allclose(model.LR @ model.LR.T, 0.01 * np.eye(4) + known.D @ cov @ known.D.T, atol=1e-13)
    rest = augment(source, DT, OU(1.0, 1.0), noise=np.full(4, 0.1), hold=hold)
    added = model.LQ @ model.LQ.T - rest.LQ @ rest.LQ.T
    np.testing.assert_allclose(added[:nx, :nx], known.B @ cov @ known.B.T, atol=1e-14)
    np.testing.assert_allclose(added[nx:], 0, atol=1e-16)


def test_an_offset_is_told_from_the_load() -> None:
    """A biased roof accelerometer beside a displacement: without its state the load is wrong, with it it is not."""
    case = tracked.bm2("mix", samples=2000)
    y = case.y.copy()
    y[:, 2] += 40 * case.noise[2]
    prior, off = RandomWalk(200.0, start=100.0), np.array([0.0, 0.0, 1.0, 0.0])
    told, errors = None, []
    for start in (0.0, 1e3 * off * case.noise):
        model = augment(case.setup.space(), DT, prior, noise=case.noise, bias_start=start)
        got = filter(model, y)
        rest = slice(1000, None)
        errors.append(float(np.sqrt(np.mean((got.load - case.load)[rest] ** 2) / np.mean(case.load[rest] ** 2))))
        told = got.last.x, model
    assert errors[1] < 0.02 < 0.05 < errors[0]
    x, model = told
    found = model.H[2, -1] * x[-1] / case.noise[2]
    sd = model.H[2, -1] / case.noise[2] * np.linalg.norm(got.last.L[-1])
    assert abs(found - 40) < 4 * sd < 4


def test_a_drifting_offset() -> None:
    model = augment(tower(), DT, OU(1.0, 1.0), noise=np.full(4, 0.5), bias=[0.0, 2.0, 0.0, 3.0])
    offsets = model.n - 2
    np.testing.assert_array_equal(model.H[:, offsets:] != 0, [[0, 0], [1, 0], [0, 0], [0, 1]])
    seen = model.H[:, offsets:] @ model.LQ[offsets:]
    np.testing.assert_allclose(np.sum(seen**2, axis=1), [0, 4 * DT, 0, 9 * DT])
    wide = model.H[:, offsets:] @ model.L0[offsets:]
    np.testing.assert_allclose(np.linalg.norm(wide, axis=1), [0, 500, 0, 500])


# -- relatives --------------------------------------------------------------------------------------------------------
def gillijns(model: StateSpace, R: NDArray, Q: NDArray, P: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    """Filter without a prior: S. Gillijns, B. De Moor, Automatica 43 (2007) 934-937; loads and their variances."""
    A, B, G, J = model.A, model.B, model.C, model.D
    x, out = np.zeros(len(A)), []
    for sample in y:
        Rt = G @ P @ G.T + R
        gain = np.linalg.solve(Rt, G @ P).T
        D = np.linalg.inv(J.T @ np.linalg.solve(Rt, J))
        e = sample - G @ x
        p = D @ J.T @ np.linalg.solve(Rt, e)
        x = x + gain @ (e - J @ p)
        Px = P - gain @ (Rt - J @ D @ J.T) @ gain.T
        cross = -gain @ J @ D
        P = np.hstack([A, B]) @ np.block([[Px, cross], [cross.T, D]]) @ np.vstack([A.T, B.T]) + Q
        x = A @ x + B @ p
        out.append((p[0], D[0, 0]))
    return np.array(out).T


def test_a_white_load_without_a_std_is_the_filter_of_gillijns_and_de_moor() -> None:
    case = tracked.bm1(samples=400)
    space = case.setup.space()
    load, variance = gillijns(space, np.diag(case.noise**2), case.Qx, np.diag(case.x0), case.y)
    root = np.sqrt(np.diag(case.Qx))
    model = augment(space, case.dt, White(math.inf), noise=case.noise, state_noise=root, start=1e-6)
    got = filter(model, case.y)
    np.testing.assert_allclose(got.load[:, 0], load, atol=1e-7 * 5)
    np.testing.assert_allclose(got.std[:, 0] ** 2, variance, rtol=1e-6)


@pytest.mark.parametrize("hold", ["foh", "zoh"])
@pytest.mark.parametrize("penalty", ["first_difference", "identity"])
def test_the_smoother_of_a_walk_is_tikhonov_of_first_differences(penalty: str, hold: str) -> None:
    """The batch path solves the same problem another way: loads and their std, with a gap. White loads: L = I."""
    source, sigma, lam, dt = beam("dsa"), np.array([1e-5, 2e-7, 0.3]), 1e-2, 1e-3
    y = source.state_space(dt, hold).simulate(np.cumsum(DRAWN.standard_normal((120, 2)), axis=0))
    y += sigma * DRAWN.standard_normal(y.shape)
    missing = np.zeros(y.shape, bool)
    missing[40:47, 0] = missing[60, :] = missing[80:85, 2] = True
    posed = of_model(source.state_space(dt, hold), np.arange(3), np.diag(1 / sigma), penalty)
    path = StateSpacePath(record(posed, y / sigma, missing))
    want, step = path.solution(lam, 1.0), 1 / (lam * float(path.scale))
    prior = White(step) if penalty == "identity" else RandomWalk(step / math.sqrt(dt), start=1e6 * step)
    model = augment(source, dt, prior, noise=sigma, hold=hold)
    got = smooth(filter(model, np.where(missing, np.nan, y)))
    assert want.posterior is not None
    np.testing.assert_allclose(got.load, want.load, rtol=0, atol=1e-9 * np.abs(want.load).max())
    np.testing.assert_allclose(got.std[1:], want.posterior.std[1:], rtol=1e-8)
    spread = 1e6 * step * float(path.scale)  # of the first data before they come, over their noise: what roots lose
    np.testing.assert_allclose(got.std[0], want.posterior.std[0], rtol=4 * np.finfo(float).eps * spread)


def test_loads_that_no_sample_tells_need_a_prior() -> None:
    noise = np.ones(1)
    with pytest.raises(NotIdentifiable, match="tell 0"):
        augment(tower(acc=(), disp=(10,)), DT, White(math.inf), noise=noise, hold="zoh")
    with pytest.raises(NotIdentifiable, match="2 loads"):
        augment(tower(acc=(10,), disp=(), at=(10, 9)), DT, White(math.inf), noise=noise)
    one = augment(tower(acc=(10,), disp=(), at=(10, 9)), DT, [White(math.inf), OU(1.0, 1.0)], noise=noise)
    assert np.all(np.isfinite(one.Cp))


@pytest.mark.parametrize("hold", ["foh", "zoh", "joint"])
@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_units_do_not_count(unit: float, hold: str) -> None:
    """Record, noise and model in another unit: the same load. Load in another unit: the same multiple of it."""
    source, y = tower(), 0.1 * DRAWN.standard_normal((60, 4))
    prior = Sum((Matern32(30.0, 0.05), RandomWalk(10.0, start=1e3)))
    first = filter(augment(source, DT, prior, noise=np.ones(4) * 0.01, hold=hold), y)
    per = mapped(source, [[unit]])
    scaled = filter(augment(per, DT, prior.scaled(1 / unit), noise=np.ones(4) * 0.01, hold=hold), y)
    np.testing.assert_allclose(scaled.load * unit, first.load, rtol=1e-9, atol=1e-9 * np.abs(first.load).max())
    np.testing.assert_allclose(scaled.std * unit, first.std, rtol=1e-9)
    if hold != "joint":
        s = source.state_space(DT, hold)
        loud = StateSpace(s.A, s.B, unit * s.C, unit * s.D, DT, hold)
        again = filter(augment(loud, DT, prior, noise=unit * np.ones(4) * 0.01), unit * y)
        np.testing.assert_allclose(again.load, first.load, rtol=1e-9, atol=1e-9 * np.abs(first.load).max())


# -- refusals ---------------------------------------------------------------------------------------------------------
def measured() -> MeasuredModel:
    f = np.linspace(0, 100, 51)
    return MeasuredModel(
        f, np.ones((51, 1, 1)), sensors=[Channel(label="a")], loads=[Channel(label="p")]
    )  # fmt: skip


def moving() -> ForwardModel:
    structure = beams.cantilever(elements=6, damping=Modal(0.02), length=1.2, EI=800.0, mass_per_length=3.0)
    return ForwardModel(structure, [sensors.Displacement("5+Z")], [loads.MovingPoint(path=np.linspace(0.2, 1.0, 50))])


def structural() -> ForwardModel:
    return beam("d", count=1, damping=Structural(0.02))


ONE = np.ones(1)
REFUSED: dict[str, tuple[Callable[[], object], str]] = {
    "measured": (lambda: augment(measured(), DT, OU(1, 1), noise=ONE), "MeasuredModel has no state_space"),
    "measured, joint": (
        lambda: augment(MappedModel(measured(), [[1.0]]), DT, OU(1, 1), noise=ONE, hold="joint"),
        "MeasuredModel has no state_space",
    ),
    "bare, joint": (
        lambda: augment(beam("d").state_space(1e-3), 1e-3, OU(1, 1), noise=ONE, hold="joint"), "StateSpace exists",
    ),
    "bare, another step": (lambda: augment(beam("d").state_space(1e-3), DT, OU(1, 1), noise=ONE), "one step"),
    "moving": (lambda: augment(moving(), 1e-3, OU(1, 1), noise=ONE), "moves"),
    "moving, joint": (lambda: augment(moving(), 1e-3, OU(1, 1), noise=ONE, hold="joint"), "moves"),
    "structural": (lambda: augment(structural(), 1e-3, OU(1, 1), noise=ONE), "causal"),
    "structural, joint": (lambda: augment(structural(), 1e-3, OU(1, 1), noise=ONE, hold="joint"), "structural"),
    "white, joint": (lambda: augment(beam("d"), 1e-3, White(1), noise=ONE, hold="joint"), "White"),
    "aliased, joint": (
        lambda: augment(beam("d"), 1e-3, Periodic(1, 1.5e-3, 1), noise=ONE, hold="joint"), "Nyquist",
    ),
    "no model": (lambda: augment("beam", DT, OU(1, 1), noise=ONE), "no forward model"),  # type: ignore[arg-type]
    "hold": (lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, hold="cubic"), "no such hold"),
    "step": (lambda: augment(beam("d"), -1.0, OU(1, 1), noise=ONE, hold="joint"), "positive"),
    "priors": (lambda: augment(beam("d"), DT, [OU(1, 1)], noise=ONE), "priors do not fit"),
    "no prior": (lambda: augment(beam("d"), DT, 3.0, noise=ONE), "priors do not fit"),  # type: ignore[arg-type]
    "noise length": (lambda: augment(beam("d"), DT, OU(1, 1), noise=np.ones(2)), "noise"),
    "noise zero": (lambda: augment(beam("d"), DT, OU(1, 1), noise=np.zeros(1)), "without noise"),
    "noise NaN": (lambda: augment(beam("d"), DT, OU(1, 1), noise=[math.nan]), "noise"),
    "noise negative": (lambda: augment(beam("d"), DT, OU(1, 1), noise=[-1.0]), "noise"),
    "noise asymmetric": (lambda: augment(beam("da"), DT, OU(1, 1), noise=[[1, 0.5], [0, 1]]), "no covariance"),
    "noise indefinite": (lambda: augment(beam("da"), DT, OU(1, 1), noise=[[1, 2], [2, 1]]), "positive definite"),
    "state noise": (lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, state_noise=[1, 2]), "state_noise"),
    "start": (lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, start="warm"), "no such start"),
    "start of a free body": (lambda: augment(free_body(), DT, OU(1, 1), noise=np.ones(2), start="static"), "settles"),
    "ambient": (lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, ambient=beam("d")), "ambient"),  # type: ignore[arg-type]
    "ambient elsewhere": (
        lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, ambient=Ambient(beam("d", damping=Modal(0.03)), 1.0)),
        "another structure",
    ),
    "bias": (lambda: augment(beam("d"), DT, OU(1, 1), noise=ONE, bias=[-1.0]), "bias"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name: str) -> None:
    ask, words = REFUSED[name]
    with pytest.raises(InputError, match=words):
        ask()
