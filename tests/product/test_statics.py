"""Every way to ask for static loads: the answer of the dense reference, or a refusal that names the setting."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from loadid import Absolute, StaticInversion
from loadid._inverse import penalties, rules
from loadid._spellings import folded
from loadid.constraints import Bounds, NonNegative, Resultant, Support
from structures import ForwardModel, InputError, MatrixModel, bases, beams, sensors

from . import reference

LAM, LOADS, SENSORS = 0.03, 7, 10
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=16
)
GAUGES = [sensors.StrainGauge(at=x, fibre=0.005) for x in np.linspace(0.13, 1.91, SENSORS)]
RNG = np.random.default_rng(0)
TOTAL = np.ones((1, LOADS))
HATS = bases.hats(BEAM, LOADS - 1)
MODELS = {
    "matrix": MatrixModel(RNG.standard_normal((SENSORS, LOADS)) @ np.diag(np.geomspace(1, 0.05, LOADS))),
    "hats": ForwardModel(BEAM, GAUGES, HATS),
}
TRUTH = np.array([3.0, -1.0, 4.0, 2.0, -0.5, 1.0, 2.5])
NAMED = ("identity", "gradient", "laplacian", "first_difference", "second_difference", "third_difference")
PENALTIES = (*NAMED, "matrix", "none")
OWN = np.eye(LOADS) + 0.4 * np.eye(LOADS, k=1)
BOUND = {"lower": -0.2, "upper": 2.2}
CONSTRAINTS = {
    "": (),
    "push": (NonNegative(),),
    "push_some": (NonNegative([1, 4]),),
    "bounds": (Bounds(**BOUND),),
    "total": (Resultant(TOTAL, [12.0]),),
    "measured_total": (Resultant(TOTAL, [12.0], covariance=[[0.04]]),),
    "support": (Support([0, 2, 3, 5, 6]),),
    "push+total": (NonNegative(), Resultant(TOTAL, [12.0])),
    "bounds+support": (Bounds(**BOUND), Support([0, 2, 3, 5, 6])),
}


@pytest.fixture(autouse=True)
def third_difference(monkeypatch):
    """A penalty as CONTRIBUTING.md adds one, and nothing else."""
    monkeypatch.setitem(penalties.ORDER, "third_difference", 3)


def readings(kind, frames=1):
    """Readings (frames, sensors), and the std of their noise."""
    clean = MODELS[kind].static() @ TRUTH
    noise = 0.02 * np.abs(clean).max() * np.linspace(0.5, 1.5, SENSORS)
    return clean + noise * np.random.default_rng(1).standard_normal((frames, SENSORS)), noise


def penalty_matrix(kind, penalty):
    """The penalty written out; over the evenly spaced places of the hats a gradient is a slope, with its length."""
    if penalty in ("matrix", "none"):
        return OWN if penalty == "matrix" else np.zeros((0, LOADS))
    order = {"identity": 0, "gradient": 1, "first_difference": 1, "third_difference": 3}.get(penalty, 2)
    step = float(np.diff(HATS.coordinates[:2, 0])[0]) if HATS.coordinates.ndim == 2 else 1.0
    slopes = kind == "hats" and penalty in ("gradient", "laplacian")
    return reference.differences(order, LOADS) * (step ** (0.5 - order) if slopes else 1.0)


def check(kind, penalty, choice, constraints=(), *, method="tikhonov", frames=1, correlated=False):
    """One cell."""
    y, noise = readings(kind, frames)
    level = np.outer(noise, noise) * (0.6 + 0.4 * np.eye(SENSORS)) if correlated else noise
    expected = set()
    if method == "tsvd" and constraints:
        expected |= {"method"}
    if choice is False or choice == "ebic" or (penalty == "none" and choice not in (None, 0)):
        expected |= {"choice"}
    if constraints and choice in ("evidence", "predicted_error"):
        expected |= {"choice"}
    given = {"matrix": OWN, "none": None}.get(penalty, penalty)
    refused = None
    try:
        said = {"penalty": given, "choice": choice, "method": method, "noise": level}
        estimate = StaticInversion(MODELS[kind], constraints=constraints, **folded(StaticInversion, said)).estimate(
            y[0] if frames == 1 else y
        )
    except InputError as error:
        refused = error
    if refused is not None:
        assert refused.where in expected, f"refused by {refused.where!r}, not by one of {expected or 'none'}: {refused}"
        return
    assert not expected, f"answered, and should be refused by one of {expected}"
    assert np.all(np.isfinite(estimate.load))
    assert np.all(np.isfinite(estimate.std))
    if isinstance(choice, str):
        assert estimate.choice.rule == choice
    lam = estimate.choice.lam * estimate.choice.scale
    if isinstance(choice, Absolute):
        assert lam == pytest.approx(choice.lam, rel=1e-12)
    for load, row in zip(np.atleast_2d(estimate.load), y, strict=True):
        H, data = reference.whitened(MODELS[kind].static()[None], row[None], level)
        agrees(load, reference.Problem(H, data, penalty_matrix(kind, penalty)), lam, constraints, method)


def agrees(load, problem, lam, constraints, method):
    """The load of one frame is that of the problem written out."""
    if method == "tsvd":
        expected = problem.truncated(lam)
        assert np.linalg.norm(load - expected) <= reference.CLOSE * np.linalg.norm(expected)
        return
    if not constraints:
        reference.assert_agrees(load, problem, lam)
        return
    lower, upper = np.full(LOADS, -np.inf), np.full(LOADS, np.inf)
    C, value, acting = np.zeros((0, LOADS)), np.zeros(0), np.ones(LOADS, bool)
    for one in constraints:
        match one:
            case NonNegative():
                lower[slice(None) if one.loads is None else one.loads] = 0.0
            case Bounds():
                lower[:], upper[:] = BOUND["lower"], BOUND["upper"]
            case Support():
                acting = np.isin(np.arange(LOADS), one.loads)
            case Resultant() if one.hard:
                C, value = one.C, one.value
            case Resultant():
                root = np.sqrt(one.covariance[0, 0])
                problem = reference.Problem(
                    np.vstack([problem.H, one.C / root]), np.r_[problem.y, one.value / root], problem.L
                )
    assert np.all(load[~acting] == 0)
    own = reference.Problem(problem.H[:, acting], problem.y, problem.L[:, acting])
    reference.assert_constrained(load[acting], own, lam, C[:, acting], value, (lower[acting], upper[acting]))


def name(value):
    """Part of the name of a cell."""
    return str(value) or "none"


def constrained():
    """Full for two penalties, and every penalty with signs; over places what differs there."""
    yield from product(("matrix",), ("identity", "third_difference"), CONSTRAINTS)
    yield from product(("matrix",), PENALTIES, ("", "push_some"))
    yield from product(("hats",), ("gradient", "laplacian", "second_difference", "third_difference"), ("", "bounds"))


@pytest.mark.parametrize(("kind", "penalty", "constraints"), sorted(set(constrained())), ids=name)
def test_constraint(kind, penalty, constraints):
    check(kind, penalty, None if penalty == "none" else LAM, CONSTRAINTS[constraints])


CHOICES = (*rules.RULES, None, False, 0, 0.0, Absolute(2.0))


def ruled():
    """Full without constraints; with them, where every lambda costs a solution, each rule once."""
    yield from product(("identity", "laplacian", "third_difference", "none"), CHOICES, ("",))
    for i, choice in enumerate(CHOICES):
        yield ("identity", "third_difference")[i % 2], choice, ("push", "total", "bounds")[i % 3]


@pytest.mark.parametrize(("penalty", "choice", "constraints"), list(ruled()), ids=name)
def test_rule(penalty, choice, constraints):
    check("hats", penalty, choice, CONSTRAINTS[constraints])


SAID = [
    {"frames": 3}, {"correlated": True}, {"method": "tsvd"}, {"frames": 3, "correlated": True, "method": "tsvd"},
]  # fmt: skip


@pytest.mark.parametrize("said", SAID, ids=lambda said: "+".join(said))
@pytest.mark.parametrize("penalty", PENALTIES)
def test_frames_noise_and_method(penalty, said):
    check("matrix", penalty, None if penalty == "none" else LAM, **said)


@pytest.mark.parametrize("said", SAID, ids=lambda said: "+".join(said))
def test_frames_noise_and_method_beside_constraints(said):
    check("matrix", "third_difference", LAM, CONSTRAINTS["push+total"], **said)
