"""Priors of loads against their covariance functions, matrix exponentials and series in long double."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import linalg

from loadid._inverse.gaussian import roots as quadrature
from loadid.priors import OU, Matern32, Matern52, Periodic, Prior, RandomWalk, Sum, White
from structures.errors import InputError
from tests.sources import ROOT

SD, LENGTH, PERIOD = 3.0, 0.08, 0.5
COMPANIONS = (OU, Matern32, Matern52)


def ou(t: NDArray) -> NDArray:
    return SD**2 * np.exp(-t / LENGTH)


def matern32(t: NDArray) -> NDArray:
    a = math.sqrt(3) * t / LENGTH
    return SD**2 * (1 + a) * np.exp(-a)


def matern52(t: NDArray) -> NDArray:
    a = math.sqrt(5) * t / LENGTH
    return SD**2 * (1 + a + a**2 / 3) * np.exp(-a)


def periodic(t: NDArray) -> NDArray:
    return SD**2 * np.exp(-2 * np.sin(np.pi * t / PERIOD) ** 2 / 0.7**2)


CASES: dict[str, tuple[Prior, Callable[[NDArray], NDArray], float]] = {
    "white": (White(SD), lambda t: SD**2 * (t == 0), 1e-14),
    "OU": (OU(SD, LENGTH), ou, 1e-13),
    "Matern 3/2": (Matern32(SD, LENGTH), matern32, 1e-13),
    "Matern 5/2": (Matern52(SD, LENGTH), matern52, 1e-13),
    "periodic": (Periodic(SD, PERIOD, 0.7), periodic, 1.1e-6),
    "periodic, many harmonics": (Periodic(SD, PERIOD, 0.7, harmonics=20), periodic, 1e-13),
    "quasi-periodic": (
        Periodic(SD, PERIOD, 0.7, decay=2.0, harmonics=20), lambda t: periodic(t) * np.exp(-t / 2.0), 1e-13,
    ),
    "sum": (Sum((Matern32(SD, LENGTH), OU(SD, LENGTH))), lambda t: matern32(t) + ou(t), 1e-13),
    "sum in a sum": (
        Sum((Sum((Matern52(SD, LENGTH), White(SD))), OU(SD, LENGTH))),
        lambda t: matern52(t) + ou(t) + SD**2 * (t == 0), 1e-13,
    ),
}  # fmt: skip
STATIONARY = {name: case[0] for name, case in CASES.items()}


@pytest.mark.parametrize("name", CASES)
def test_covariance_over_any_lag_is_the_closed_form(name: str) -> None:
    prior, covariance, tolerance = CASES[name]
    dt = 0.01
    known = prior.discrete(dt)
    P, read = known.L0 @ known.L0.T, known.H
    got, F = [], np.eye(len(P))
    for _ in range(60):
        got.append((read @ F @ P @ read.T)[0, 0])
        F = known.F @ F
    np.testing.assert_allclose(got, covariance(dt * np.arange(60)), atol=tolerance * SD**2)
    assert prior.sd**2 == pytest.approx(covariance(np.zeros(1))[0], rel=1e-12)


@pytest.mark.parametrize("dt", [1e-4, 0.01, 0.09])
@pytest.mark.parametrize("name", STATIONARY)
def test_stationary(name: str, dt: float) -> None:
    """F P F^T + Q = P: what a step forgets it adds."""
    if name == "periodic, many harmonics" or "quasi" in name:
        dt = min(dt, 0.01)
    prior = STATIONARY[name]
    if isinstance(prior, Periodic) and dt > 0.05:
        prior = Periodic(SD, PERIOD, 2.0, harmonics=2)
    known = prior.discrete(dt)
    P = known.L0 @ known.L0.T
    np.testing.assert_allclose(known.F @ P @ known.F.T + known.LQ @ known.LQ.T, P, atol=1e-14)


@pytest.mark.parametrize("name", [n for n in STATIONARY if "white" not in n and n != "sum in a sum"])
def test_discrete_is_the_continuous_form_over_a_step(name: str) -> None:
    prior, dt = STATIONARY[name], 0.011
    known, slow = prior.discrete(dt), prior.continuous()
    np.testing.assert_allclose(known.F, linalg.expm(slow.F * dt), atol=1e-13)
    E, L = quadrature.step(slow.F, slow.b, dt)
    np.testing.assert_allclose(E, known.F, atol=1e-13)
    np.testing.assert_allclose(L @ L.T, known.LQ @ known.LQ.T, atol=1e-13)
    np.testing.assert_array_equal(known.H, slow.H)
    # the continuous form is stationary: F P + P F^T + b b^T = 0
    P = slow.L0 @ slow.L0.T
    np.testing.assert_allclose(slow.F @ P + P @ slow.F.T + slow.b @ slow.b.T, 0, atol=1e-12 * np.abs(slow.F).max())


def long_double_noise(unit: NDArray, density: float, a: float) -> NDArray:
    """Noise of a step of a companion form, term by term in long double: ``sum F^i b b^T F^jT a^(i+j+1) / ...``."""
    F, q = unit.astype(np.longdouble), np.longdouble(density)
    n, terms = len(F), 40
    columns = [np.eye(n, dtype=np.longdouble)[:, -1]]
    for k in range(1, terms):
        columns.append(F @ columns[-1] / k)
    Q = np.zeros((n, n), np.longdouble)
    for i in reversed(range(terms)):
        for j in reversed(range(terms)):
            Q += q * np.outer(columns[i], columns[j]) * np.longdouble(a) ** (i + j + 1) / (i + j + 1)
    return Q


@pytest.mark.parametrize("a", [1e-6, 1e-4, 1e-2, 0.1, 1.0])
@pytest.mark.parametrize("kind", COMPANIONS)
def test_noise_of_a_short_step_keeps_its_digits(kind: type[OU | Matern32 | Matern52], a: float) -> None:
    prior = kind(1.0, 1.0)
    known = prior.discrete(a / prior.rate)
    want = long_double_noise(prior._unit, prior._density, a)
    error = np.abs(known.LQ.astype(np.longdouble) @ known.LQ.T.astype(np.longdouble) / want - 1)
    assert float(error.max()) < (1e-12 if a <= 0.1 else 5e-12)


def test_the_subtraction_has_lost_them() -> None:
    """The check above can fail: ``P - F P F^T`` at a thousandth of the length."""
    prior = Matern52(1.0, 1.0)
    known, want = prior.discrete(1e-3 / prior.rate), long_double_noise(prior._unit, prior._density, 1e-3)
    P = known.L0 @ known.L0.T
    assert abs(float((P - known.F @ P @ known.F.T)[0, 0] / want[0, 0]) - 1) > 0.1


@settings(max_examples=20, deadline=None)
@given(st.floats(-5, 2.5), st.sampled_from(COMPANIONS))
def test_two_half_steps_are_a_step(decades: float, kind: type[OU | Matern32 | Matern52]) -> None:
    dt = 10.0**decades
    half, whole = kind(2.0, 1.0).discrete(dt / 2), kind(2.0, 1.0).discrete(dt)
    Q, twice = half.LQ @ half.LQ.T, whole.LQ @ whole.LQ.T
    scale = np.sqrt(np.outer(np.diag(twice), np.diag(twice)))
    np.testing.assert_allclose((half.F @ Q @ half.F.T + Q) / scale, twice / scale, atol=1e-11)
    np.testing.assert_allclose(half.F @ half.F, whole.F, atol=1e-13)


@pytest.mark.parametrize("name", [*STATIONARY, "walk"])
def test_scale_is_in_the_reading_alone(name: str) -> None:
    prior = RandomWalk(2.0, 7.0) if name == "walk" else STATIONARY[name]
    small, large = prior.discrete(0.01), prior.scaled(1e6).discrete(0.01)
    np.testing.assert_array_equal(small.F, large.F)
    np.testing.assert_array_equal(small.LQ, large.LQ)
    np.testing.assert_allclose(small.L0, large.L0, rtol=1e-15)
    np.testing.assert_allclose(1e6 * small.H, large.H, rtol=1e-14)
    assert prior.words
    assert prior.scaled(1e6).sd == pytest.approx(1e6 * prior.sd)


def test_walk_adds_its_rate_each_second() -> None:
    known = RandomWalk(20.0, start=5.0).discrete(0.01)
    assert ((known.H @ known.LQ) ** 2)[0, 0] == pytest.approx(400 * 0.01)
    assert (known.H @ known.L0)[0, 0] == pytest.approx(5.0)
    assert RandomWalk(20.0).discrete(0.01).L0[0, 0] > 1e4 * math.sqrt(0.01)  # the start is open


def variance(prior: Prior, dt: float, steps: int) -> NDArray:
    """Covariance (load at 0, load at `steps`) of a prior."""
    known = prior.discrete(dt)
    P, F = known.L0 @ known.L0.T, known.F
    cross = (known.H @ np.linalg.matrix_power(F, steps) @ P @ known.H.T)[0, 0]
    first = (known.H @ P @ known.H.T)[0, 0]
    for _ in range(steps):
        P = F @ P @ F.T + known.LQ @ known.LQ.T
    return np.array([first, cross, (known.H @ P @ known.H.T)[0, 0]])


def test_parts_that_cannot_be_separated_are_one_state() -> None:
    """Two walks and the constant of a period: the same process with one eigenvalue of one."""
    wave = Periodic(SD, PERIOD, 0.7)
    parts = (RandomWalk(3.0, 10.0), wave, RandomWalk(4.0, 20.0))
    got, want = variance(Sum(parts), 0.01, 7), sum(variance(part, 0.01, 7) for part in parts)
    np.testing.assert_allclose(got, want, rtol=1e-12)
    roots = np.linalg.eigvals(Sum(parts).discrete(0.01).F)
    assert int(np.sum(np.abs(roots - 1) < 1e-9)) == 1
    assert Sum(parts).sd == math.inf
    assert "walk" in Sum(parts).words


def test_a_damped_period_has_noise_and_another_does_not() -> None:
    assert Periodic(1.0, 0.5, 1.0, decay=3.0).discrete(0.01).LQ.any()
    assert Periodic(1.0, 0.5, 1.0).discrete(0.01).LQ.size == 0


@pytest.mark.parametrize("bad", [
    lambda: OU(0.0, 1.0), lambda: Matern32(1.0, -1.0), lambda: Matern52(math.nan, 1.0), lambda: RandomWalk(math.inf),
    lambda: RandomWalk(1.0, 0.0), lambda: White("loud"), lambda: Periodic(1.0, 1.0, 0.01).orders,
    lambda: Periodic(1.0, 1.0, 1.0, harmonics=0), lambda: Periodic(1.0, 1.0, 1.0, decay=0.0), lambda: Sum(()),
    lambda: Sum((1.0,)), lambda: Sum(RandomWalk(1.0)), lambda: OU(1.0, 1.0).discrete(0.0),
    lambda: White(1.0).continuous(), lambda: White(math.inf).discrete(0.1),
    lambda: Periodic(1.0, 0.1, 0.5).discrete(0.05),
])  # fmt: skip
def test_bad_settings_are_refused(bad: Callable[[], object]) -> None:
    with pytest.raises(InputError):
        bad()


def test_priors_come_from_where_release_0_1_has_them() -> None:
    code = (
        "import warnings\n"
        "with warnings.catch_warnings(record=True) as said:\n"
        "    warnings.simplefilter('always')\n"
        "    from loadid.inverse.constraints import NonNegative\n"
        "    from loadid.inverse.kalman.augment import Ambient\n"
        "    from loadid.inverse.kalman.priors import Matern32\n"
        "import loadid\n"
        "from loadid import constraints, priors\n"
        "assert Ambient is loadid.Ambient\n"
        "assert NonNegative is constraints.NonNegative and Matern32 is priors.Matern32\n"
        "assert [w.category for w in said] == [DeprecationWarning]\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT, timeout=120)
