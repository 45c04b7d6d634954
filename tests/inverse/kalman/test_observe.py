"""What the sensors allow: the printed table of layouts, zeros of systems that are known, and what must not matter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import ss2zpk

from loadid._guards.tracking import cures
from loadid._inverse.gaussian.observe import UNSEEN, Observability, delay, invariant_zeros, observability
from structures import ForwardModel, InputError, StateSpace, chains, loads, sensors
from tests.tracked import (
    Array,
    Prior,
    Setup,
    Tracked,
    ar1,
    building,
    d2,
    filter_model,
    matern32,
    reference,
    selector,
    together,
    walk,
)


def case(acc=(3, 6, 10), disp=(), at=(10,), prior: Prior | None = None) -> tuple[Tracked, Prior]:
    """The building with noise of .05 m/s^2 and .1 mm, loads of 100 N."""
    setup = replace(building(acc, disp), Sp=selector(at, 10).T)
    noise = np.array([0.05] * len(acc) + [1e-4] * len(disp))
    made = Tracked(setup, np.zeros((2, len(noise))), np.zeros((2, len(at))), noise, np.ones(20), 1e-14 * np.eye(20))
    return made, together(*[walk(100.0) if prior is None else prior] * len(at))


def seen(acc=(3, 6, 10), disp=(), at=(10,), prior: Prior | None = None, hold="zoh") -> Observability:
    made, prior = case(acc, disp, at, prior)
    return observability(filter_model(made, prior, hold), made.setup.space(hold), [100.0] * len(at))


# -- the printed table -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize(
    ("layout", "rank", "lost", "static"),
    [
        ({"acc": (10,)}, 1, 1, [0]),
        ({}, 1, 1, [0]),
        ({"acc": (3, 5, 7)}, 0, 1, [0]),
        ({"prior": ar1(100.0, 0.999)}, 1, 0, [0]),
        ({"prior": matern32(100.0, 0.08, 0.01)}, 1, 0, [0]),
        ({"acc": (), "disp": (10,)}, 0, 0, [4000]),
        ({"disp": (10,)}, 1, 0, [4000]),
        ({"disp": (1,)}, 1, 0, [400]),
        ({"disp": (10,), "at": (10, 5)}, 1, 1, [4472, 0]),
        ({"disp": (10, 5), "at": (10, 5)}, 1, 0, [5236, 764]),
        ({"disp": (10, 9), "at": (10, 9)}, 1, 0, [7406, 194]),
        ({"acc": (3, 10), "disp": (10,), "at": (10, 5, 3)}, 2, 2, [4630, 0, 0]),
        ({"acc": (3, 10), "disp": (10,), "at": (10, 5, 3, 1)}, 2, 3, [4648, 0, 0, 0]),
    ],
)
def test_the_table_of_layouts(layout, rank: int, lost: int, static: list[float], hold: str) -> None:
    found = seen(**layout, hold=hold)
    if hold == "zoh":  # a straight line moves displacements within the sample too
        assert found.immediate == rank
    assert sum(s.lost for s in found.drifting) == sum(s.lost for s in found.unseen) == lost
    assert found.detectable == (lost == 0)
    np.testing.assert_allclose(found.static, static, rtol=3e-3, atol=1e-6)
    least = found.eigenvalues[0]
    assert least.sigma < 1e-13 if lost else least.sigma > 100 * UNSEEN
    assert found.sensors < len(found.loads) or found.static_rank == sum(x > 0 for x in static)
    assert found.lacking().shape[1] == len(static) - found.static_rank


def test_zeros_on_the_circle() -> None:
    """A constant load that accelerometers do not see is the zero at one; one displacement takes it away."""
    for layout in ({"acc": (10,)}, {}, {"prior": ar1(100.0, 0.999)}):
        np.testing.assert_allclose(seen(**layout).outside, [1.0], atol=1e-6)
    outside = seen(acc=(3, 5, 7)).outside
    assert outside is not None
    assert np.abs(outside).max() == pytest.approx(30.5, abs=0.1)
    for layout in ({"disp": (10,)}, {"disp": (1,)}, {"disp": (10, 5), "at": (10, 5)}):
        assert len(seen(**layout).outside) == 0
    alone = seen(acc=(), disp=(10,))
    assert len(alone.outside) == 0
    assert np.abs(alone.zeros).max() == pytest.approx(0.9989, abs=1e-4)
    assert seen(acc=(3, 10), disp=(10,), at=(10, 5, 3, 1)).outside is None


def test_delays() -> None:
    assert seen().delay == 0
    assert seen(acc=(3, 5, 7)).delay == 1
    assert seen(acc=(3, 6), disp=(8,)).delay == 1
    assert seen(acc=(3, 10), disp=(10,), at=(10, 5, 3, 1)).delay is None
    assert seen(disp=(10,)).invertible
    assert not seen().invertible


def test_d2_before_any_data() -> None:
    """Accelerometers alone are told from one displacement by ten orders, from the matrices."""
    blind, sighted = (
        observability(filter_model(c, walk(0.1)), c.setup.space(), [10.0])
        for c in (d2(disp=False, samples=200), d2(disp=True, samples=200))
    )
    assert [s.name for s in blind.drifting] == ["load p0"]
    assert blind.eigenvalues[0].load > 0.9
    assert sighted.detectable
    assert sighted.eigenvalues[0].sigma > 1e5 * UNSEEN


def test_names_and_rows() -> None:
    found = seen()
    assert found.eigenvalues[0].name == "load p0"
    assert {s.name for s in found.eigenvalues} >= {"mode 1 (1.19 Hz)", "mode 10 (15.7 Hz)"}
    table = {check: (number, ok) for check, number, _, ok in found.rows()}
    assert table["static rank"] == ("0 of 1; 0 noise sds per load sd", False)
    assert table["zeros on or outside the circle"] == ("1", False)
    assert all(ok for *_, ok in seen(disp=(10,)).rows())


# -- what an unseen load does ------------------------------------------------------------------------------------------
def test_the_std_grows_where_it_drifts_and_only_there() -> None:
    for disp, grows in (((), True), ((10,), False)):
        made, prior = case(disp=disp, prior=walk(100.0, 1e-6))
        rest = replace(made, y=np.zeros((6000, made.y.shape[1])), x0=np.full(20, 1e-12))
        std = reference(filter_model(rest, prior), rest.y, settle=1e-12).std[:, 0]
        assert (std[-1] > 1.4 * std[3000]) == grows
        assert seen(disp=disp).detectable != grows


def test_a_bias_takes_the_place_of_the_load() -> None:
    """One displacement with a drifting offset shows no constant load; two do, though no longer which sensor lies."""
    for disp, lost in (((10,), 1), ((10, 5), 0)):
        made, prior = case(disp=disp)
        plain = filter_model(made, prior)
        n = plain.n
        row = np.zeros((plain.m, 1))
        row[3] = 1.0
        model = replace(
            plain, F=np.pad(plain.F, (0, 1)) + np.diag([0.0] * n + [1.0]), H=np.hstack([plain.H, row]),
            LQ=np.pad(plain.LQ, ((0, 1), (0, 1))), L0=np.pad(plain.L0, (0, 1)) + np.diag([0.0] * n + [1e-2]),
            Cp=np.pad(plain.Cp, ((0, 0), (0, 1))), x0=np.zeros(n + 1),
        )  # fmt: skip
        found = observability(model, made.setup.space(), [100.0])
        assert sum(s.lost for s in found.unseen) == lost
        assert found.eigenvalues[0].name == "load p0 and bias of sensor 3" or not lost


def test_a_free_structure_shows_its_load_by_moving() -> None:
    """Pushed without supports: accelerometers see the resultant, but not where the structure has gone to."""
    n = 4
    K = 2500 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = 2500
    for sd, detectable in ((np.zeros((0, n)), False), (selector([2], n), True)):
        setup = Setup(np.eye(n), 1e-3 * K, K, selector([1], n).T, selector([1, 3], n), sd, 0.01)
        noise = np.full(2 + len(sd), 1e-3)
        made = Tracked(setup, np.zeros((2, 2)), np.zeros((2, 1)), noise, np.ones(8), 1e-12 * np.eye(8))
        found = observability(filter_model(made, walk(1.0)), setup.space(), [1.0])
        assert found.detectable == detectable
        assert found.static is None
        assert found.static_rank is None
        if not detectable:
            assert not found.drifting  # what is lost is the place, not the load
            assert "mode 1" in found.unseen[0].name


# -- what must not matter ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize("layout", [{}, {"disp": (10,)}, {"disp": (10,), "at": (10, 5)}])
def test_units_do_not_matter(layout) -> None:
    """Of loads, sensors and states: every number stays."""
    made, prior = case(**layout)
    model, space = filter_model(made, prior), made.setup.space()
    p = model.p
    want = observability(model, space, [100.0] * p)
    states = np.concatenate([np.full(10, 1e6), np.full(10, 2.0**20)])
    d = np.concatenate([states, np.full(p, 1e-6)])
    rows = 10.0 ** np.arange(-6, -6 + 3 * model.m, 3)
    other = replace(
        model, F=d[:, None] * model.F / d, LQ=d[:, None] * model.LQ, L0=d[:, None] * model.L0,
        H=rows[:, None] * model.H / d, LR=rows[:, None] * model.LR, Cp=1e-6 * model.Cp / d,
    )  # fmt: skip
    A, B, C, D = space.A, space.B * 1e6, space.C * rows[:, None], space.D * 1e6 * rows[:, None]
    A, B, C = states[:, None] * A / states, states[:, None] * B, C / states
    got = observability(other, StateSpace(A, B, C, D, 0.01), [1e-4] * p)
    np.testing.assert_allclose(got.static, want.static, rtol=1e-9, atol=1e-9 * want.static.max())
    np.testing.assert_allclose(got.at_once, want.at_once, rtol=1e-9, atol=1e-9)
    assert [s.lost for s in got.unseen] == [s.lost for s in want.unseen]
    assert got.delay == want.delay
    assert len(got.outside) == len(want.outside)
    for a, b in zip(got.eigenvalues, want.eigenvalues, strict=True):
        assert a.lost or a.sigma == pytest.approx(b.sigma, rel=0.5)  # states are balanced to powers of two


def test_what_does_not_fit_is_refused() -> None:
    made, prior = case()
    model, space = filter_model(made, prior), made.setup.space()
    for wrong in ([100.0, 1.0], [-1.0], [np.nan]):
        with pytest.raises(InputError):
            observability(model, space, wrong)
    with pytest.raises(InputError, match="does not fit"):
        observability(model, building(disp=(10,)).space(), [100.0])


# -- zeros -------------------------------------------------------------------------------------------------------------
def random_system(rng: np.random.Generator, n: int, m: int, p: int) -> tuple[Array, Array, Array, Array]:
    A = rng.standard_normal((n, n))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    return A, rng.standard_normal((n, p)), rng.standard_normal((m, n)), rng.standard_normal((m, p))


@pytest.mark.parametrize("seed", range(4))
def test_zeros_of_one_load_and_one_sensor(seed: int) -> None:
    A, B, C, D = random_system(np.random.default_rng(seed), 6, 1, 1)
    want = ss2zpk(A, B, C, D)[0]
    got = invariant_zeros(A, B, C, D)
    assert len(got) == len(want)
    assert np.abs(got[:, None] - want).min(axis=1).max() < 1e-8
    assert np.abs(got[:, None] - want).min(axis=0).max() < 1e-8


@pytest.mark.parametrize(("m", "p"), [(2, 2), (3, 2), (4, 1), (2, 1)])
def test_a_zero_that_was_put_in_is_found_and_blocks(m: int, p: int) -> None:
    """``C x0 + D u0 = 0`` for the state that follows ``u0 z^k``: the zero is found, and that load leaves no trace."""
    rng = np.random.default_rng(m + 10 * p)
    A, B, C, D = random_system(rng, 5, m, p)
    z, u = 1.1, rng.standard_normal(p)
    x = np.linalg.solve(z * np.eye(5) - A, B @ u)
    C = C - np.outer(C @ x + D @ u, x) / (x @ x)
    got = invariant_zeros(A, B, C, D)
    assert np.abs(got - z).min() < 1e-8
    if m > p:
        assert len(got) == 1  # more sensors than loads share no others
    response = StateSpace(A, B, C, D, 1.0).simulate(np.outer(z ** np.arange(40), u), x0=x)
    assert np.abs(response).max() < 1e-9 * z**40


def test_two_loads_on_one_point_are_never_told_apart() -> None:
    A, B, C, D = random_system(np.random.default_rng(0), 5, 3, 1)
    assert invariant_zeros(A, np.hstack([B, 2 * B]), C, np.hstack([D, 2 * D])) is None
    assert delay(A, np.hstack([B, 2 * B]), C, np.hstack([D, 2 * D])) is None


def test_delay_counts_samples() -> None:
    """A chain of delays: the sensor hears of the load as many samples later."""
    for late in range(1, 5):
        A, B, C = np.eye(late, k=-1), np.eye(late)[:, :1], np.eye(late)[-1:]
        assert delay(A, B, C, np.zeros((1, 1))) == late


# -- cures -------------------------------------------------------------------------------------------------------------
def test_two_unseen_loads_need_two_sensors() -> None:
    storeys = chains.shear_building(masses=[1.0] * 10, stiffnesses=[2500.0] * 10, damping=0.01)
    model = ForwardModel(storeys, [sensors.Accelerometer("3+X")], [loads.Point("10+X"), loads.Point("5+X")])
    blind = seen(at=(10, 5))
    found = cures(model, blind.lacking(), np.array([100.0, 100.0]))
    nodes = tuple(int(c.dof.split("+")[0]) for c in found)
    assert len(set(nodes)) == 2
    assert seen(disp=nodes, at=(10, 5)).detectable
    half = seen(disp=(10,), at=(10, 5))
    (one,) = cures(model, half.lacking(), np.array([100.0, 100.0]))
    node = int(one.dof.split("+")[0])
    assert seen(disp=(10, node), at=(10, 5)).detectable
    # the best second place: at the lower load, where the difference of the two is largest
    others = [seen(disp=(10, k), at=(10, 5)).static[-1] for k in range(1, 10)]
    assert others[node - 1] > 0.8 * max(others)


def test_nothing_to_offer() -> None:
    blind = seen()
    assert cures(building().space(), blind.lacking(), np.array([100.0])) == ()
    free = chains.chain(masses=[1.0] * 3, springs=[10.0] * 2, left="free", damping=0.01)
    model = ForwardModel(free, [sensors.Accelerometer("1+X")], [loads.Point("3+X")])
    assert cures(model, np.ones((1, 1)), np.array([1.0])) == ()
    assert cures(model, np.zeros((1, 0)), np.array([1.0])) == ()
