"""Specs of constraints: what is refused, and in which words."""

from __future__ import annotations

import numpy as np
import pytest

from loadid._guards import fighting, stopped
from loadid._inverse.constrained.path import ConstrainedPath
from loadid.constraints import Bounds, FrictionCone, NonNegative, Resultant, Support
from loadid.paths import LinearProblem, SVDPath
from structures.errors import InputError, NotIdentifiable

N = 6


def path(y: np.ndarray | None = None) -> SVDPath:
    H = np.random.default_rng(0).standard_normal((9, N))
    return SVDPath(LinearProblem.whitened(H, H @ np.ones(N) if y is None else y))


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: NonNegative([0, 0]), "twice"),
        (lambda: NonNegative([0.5]), "numbers"),
        (lambda: Bounds(), "without a bound"),
        (lambda: Bounds(np.nan), "NaN"),
        (lambda: Bounds(np.zeros((2, 2))), "one number"),
        (lambda: Support([]), "without any load"),
        (lambda: Resultant(np.ones((2, N)), [1.0]), "do not fit"),
        (lambda: Resultant(np.ones((1, N)), [np.inf]), "NaN or inf"),
        (lambda: Resultant(np.ones((1, N)), [1.0], [-1.0]), "positive definite"),
        (lambda: Resultant(np.ones((1, N)), [1.0], np.ones((2, 2))), "covariance does not fit"),
        (lambda: Resultant(np.ones((1, N)), [1.0], labels=("a", "b")), "labels"),
        (lambda: FrictionCone(-0.1, [[0, 1, 2]]), "friction coefficient"),
        (lambda: FrictionCone([0.1, 0.2], [[0, 1, 2]]), "friction coefficient"),
        (lambda: FrictionCone(0.1, [[0, 1, 2, 3]]), "contacts"),
        (lambda: FrictionCone(0.1, [[0, 1, 2]], facets=2), "facets"),
        (lambda: FrictionCone(0.1, [[0, 1, 2]], normals=[[0, 0, 0]]), "normals"),
    ],
)
def test_a_spec_without_meaning_is_refused(make, text: str) -> None:
    with pytest.raises(InputError, match=text):
        make()


@pytest.mark.parametrize(
    ("constraints", "text"),
    [
        ([NonNegative([N])], "no such load"),
        ([Support([0, 1]), Support([2])], "no load in common"),
        ([Bounds([0.0, 1.0])], "do not fit the loads"),
        ([Resultant(np.ones((1, N + 1)), [1.0])], "do not fit the loads"),
        ([FrictionCone(0.1, [[0, 1, 2]]), FrictionCone(0.1, [[2, 3, 4]])], "two friction cones"),
        ([FrictionCone(0.1, [[0, 1, 2]]), Support([1, 2, 3])], "cuts contacts apart"),
        (["positive"], "no constraint"),
        ([Resultant(np.ones((1, N)), np.ones((1, 3)))], "frames"),
    ],
)
def test_constraints_that_do_not_fit_are_refused(constraints: list, text: str) -> None:
    with pytest.raises(InputError, match=text):
        ConstrainedPath(path(), constraints)


def test_bounds_that_exclude_each_other_are_named() -> None:
    with pytest.raises(InputError, match=r"load 3: lower 0 .*non-negative.* upper -1 .*bounds") as caught:
        ConstrainedPath(path(), [NonNegative(), Bounds(upper=-1.0, loads=[3])])
    assert caught.value.code == "LID-E309"


def test_resultants_that_contradict_each_other_are_named() -> None:
    C = np.vstack([np.ones(N), np.arange(N), 2 * np.ones(N) + np.arange(N)])
    with pytest.raises(InputError, match="Mz follows from Fx, Fy") as caught:
        ConstrainedPath(path(), [Resultant(C, [1.0, 2.0, 5.0], labels=("Fx", "Fy", "Mz"))])
    assert caught.value.code == "LID-E309"
    consistent = ConstrainedPath(path(), [Resultant(C, [1.0, 2.0, 4.0], labels=("Fx", "Fy", "Mz"))])
    np.testing.assert_allclose(C @ consistent.solve(0.1).load, [1, 2, 4], atol=1e-12)


def test_a_resultant_that_no_acting_load_moves_is_named() -> None:
    C = np.eye(N)[:1]
    with pytest.raises(InputError, match="Fx is moved by no load") as caught:
        ConstrainedPath(path(), [Support([1, 2]), Resultant(C, [1.0], labels=("Fx",))])
    assert caught.value.code == "LID-E309"
    ConstrainedPath(path(), [Support([1, 2]), Resultant(C, [0.0], labels=("Fx",))])


@pytest.mark.parametrize(
    ("constraints", "name"),
    [
        ([NonNegative(), Resultant(np.ones((1, N)), [-1.0], labels=("Fz",))], "Fz = -1"),
        ([Bounds(0.0, 1.0), Resultant(np.ones((1, N)), [6.5], labels=("Fz",))], "Fz = 6.5"),
        ([FrictionCone(0.5, np.arange(N).reshape(2, 3)),
          Resultant(np.kron(np.ones((1, 2)), np.eye(3))[[0, 2]], [1.0, 1.0], labels=("Fx", "Fz"))], "Fx = 1"),
        ([FrictionCone(0.5, np.arange(N).reshape(2, 3)), Bounds(0.6, 0.9, [0]), Bounds(upper=1.0, loads=[2])],
         "bound of load"),
    ],
)  # fmt: skip
def test_a_set_without_any_load_is_refused(constraints: list, name: str) -> None:
    with pytest.raises(NotIdentifiable, match="no admissible load has this resultant") as caught:
        ConstrainedPath(path(), constraints)
    assert caught.value.code == "LID-E309"
    assert name in str(caught.value)


def test_a_set_that_is_just_not_empty_is_solved() -> None:
    found = ConstrainedPath(path(), [Bounds(0.0, 1.0), Resultant(np.ones((1, N)), [5.999])]).solve(0.1)
    assert found.load.sum() == pytest.approx(5.999, rel=1e-9)
    assert found.converged


def test_constraints_that_fight_the_data_are_flagged_with_the_number() -> None:
    base = path()
    y = base.problem.H @ -np.ones(N)
    constraints = [NonNegative(), Resultant(np.ones((1, N)), [0.5], [1e4])]
    solution = ConstrainedPath(path(y), constraints).solve(1e-3)
    flag = fighting(solution, constraints, 0.01, 9)
    assert flag is not None
    assert flag.code == "LID-W308"
    assert flag.evidence.value == pytest.approx(solution.change / (0.01 * 3))
    assert "constraint 0 (non-negative" in flag.message
    right = ConstrainedPath(base, constraints).solve(1e-3)
    assert fighting(right, constraints, 0.01, 9) is None


def test_a_solver_that_stops_at_its_cap_is_flagged() -> None:
    rng = np.random.default_rng(3)
    H, y = rng.standard_normal((60, 50)), rng.standard_normal(60)
    prepared = ConstrainedPath(SVDPath(LinearProblem.whitened(H, y)), [NonNegative()]).prepare(1e-3)
    short, full = prepared.solve(y, cap=1), prepared.solve(y)
    flag = stopped(short, 1.0, 60)
    assert flag is not None
    assert flag.code == "LID-W410"
    assert f"{np.sqrt(short.residual2 / 60):.3g} times the noise" in flag.message
    assert short.violation <= 1e-9
    assert stopped(full, 1.0, 60) is None


def test_specs_are_frozen_and_say_what_they_are() -> None:
    spec = Resultant(np.ones((1, N)), [1.0], labels=("Fx",))
    with pytest.raises(AttributeError):
        spec.value = 3  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        spec.C[0, 0] = 2
    assert str(spec) == "resultant Fx (exact)"
    assert str(FrictionCone(0.3, [[0, 1, 2]], facets=8, inner=True)) == "friction cone (1 contacts, 8 facets, inner)"
