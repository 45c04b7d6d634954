"""A rule and a penalty of the user, from outside, in every family that has a lambda."""

from __future__ import annotations

import numpy as np
import pytest

import loadid
from loadid import (
    Deconvolution,
    FieldDeconvolution,
    FrequencyInversion,
    HarmonicInversion,
    InputError,
    Lambda,
    LocationSearch,
    NotIdentifiable,
    SparseDeconvolution,
    Spectra,
    StaticInversion,
)
from loadid._inverse import penalties, rules
from loadid.constraints import NonNegative
from loadid.paths import RuleResult, Sweep, minimum
from structures import ForwardModel, chains, damping, loads, sensors

DT, N = 1e-2, 80
CHAIN = chains.chain(masses=[1.0, 1.5, 2.0, 1.0], springs=[4e4, 3e4, 5e4, 4e4], damping=damping.Modal(0.04))
SEEN = [sensors.Displacement(f"{k}+X", label=f"u{k}") for k in (1, 2, 3, 4)]
MODEL = ForwardModel(CHAIN, SEEN, [loads.Point("2+X", label="a"), loads.Point("4+X", label="b")])
OWN = f"{__name__}.stricter"


def stricter(sweep: Sweep) -> RuleResult:
    """Modified GCV written as a user would: each degree of freedom counts 1.4 times."""

    def value(p):
        left = sweep.path.m - 1.4 * rules.need(p, "edf", "stricter")
        return p.residual2 / np.where(left > 0, left, np.nan) ** 2

    return minimum("stricter", sweep, value)


def noisy(clean):
    level = 0.02 * float(np.sqrt(np.mean(np.abs(clean) ** 2)))
    rng = np.random.default_rng(0)
    errors = rng.standard_normal(clean.shape)
    return clean + level * (errors + (1j * rng.standard_normal(clean.shape) if np.iscomplexobj(clean) else 0)), level


def record():
    pulse = np.zeros((N, 2))
    pulse[20:30, 0], pulse[45:52, 1] = 30 * np.hanning(10), 20 * np.hanning(7)
    return noisy(MODEL.predict(pulse, DT))


def in_time(family, lam=None, **settings):
    y, level = record()
    how = {} if lam is None else lam
    return lambda choice: family(
        MODEL, choice=Lambda(choice, **how) if how else choice, noise=level, **settings
    ).estimate(y, DT)


def on_lines(**how):
    f = np.linspace(5, 40, 30)
    Y, level = noisy(MODEL.frf(f) @ np.array([2.0, 1 - 1j]))
    given = Spectra(f, Y, noise=level * np.sqrt(2))
    return lambda choice: FrequencyInversion(MODEL, choice=Lambda(choice, neighbours=5, **how)).estimate(given)


def on_one_line():
    Y, level = noisy(MODEL.frf([9.0])[0] @ np.array([2.0, 1 - 1j]))
    return lambda choice: HarmonicInversion(MODEL, 9.0, choice=choice, noise=level * np.sqrt(2)).estimate(Y)


def at_rest(**settings):
    y, level = noisy(MODEL.static() @ np.array([20.0, 10.0]))
    return lambda choice: StaticInversion(MODEL, choice=choice, noise=level, **settings).estimate(y)


FAMILIES = {
    "deconvolution, dense": lambda: in_time(Deconvolution, {"path": "dense"}),
    "deconvolution, state space": lambda: in_time(Deconvolution, {"path": "statespace"}),
    "deconvolution, spectrum": lambda: in_time(Deconvolution, {"path": "fft"}),
    "deconvolution, truncated": lambda: in_time(Deconvolution, {"path": "dense", "method": "tsvd"}),
    "deconvolution, pushing": lambda: in_time(Deconvolution, constraints=[NonNegative()]),
    "field": lambda: in_time(FieldDeconvolution),
    "sparse": lambda: in_time(SparseDeconvolution),
    "lines": lambda: on_lines(),
    "lines alone": lambda: on_lines(over="line"),
    "band": lambda: on_lines(over="band"),
    "lines, truncated": lambda: on_lines(method="tsvd"),
    "one line": on_one_line,
    "static": at_rest,
    "static, pushing": lambda: at_rest(constraints=[NonNegative()]),
}


@pytest.fixture
def registered(monkeypatch):
    monkeypatch.setattr(rules, "RULES", dict(rules.RULES))
    assert loadid.register_rule(stricter) is stricter
    return "stricter"


@pytest.mark.parametrize("family", FAMILIES)
def test_a_rule_of_the_user_goes_through_every_family_that_has_a_lambda(registered, family):
    """By name and as it is: the load of the built-in rule with the same formula."""
    solve = FAMILIES[family]()
    built_in, named = solve("modified_gcv"), solve(registered)
    assert np.array_equal(named.load, built_in.load)
    assert np.array_equal(named.std, built_in.std)
    assert named.choice.rule == registered
    assert named.provenance["settings"]["choice"] == registered


@pytest.mark.parametrize("family", FAMILIES)
def test_a_function_is_taken_as_it_is(family):
    solve = FAMILIES[family]()
    found = solve(stricter)
    assert np.array_equal(found.load, solve("modified_gcv").load)
    assert found.choice.rule == OWN
    assert found.provenance["settings"]["choice"] == OWN


@pytest.mark.parametrize("family", FAMILIES)
def test_what_a_path_does_not_give_is_refused_by_name(family):
    def bold(sweep):
        raise rules.Refusal("bold needs what no path gives")

    with pytest.raises(InputError, match="bold needs what no path gives") as refused:
        FAMILIES[family]()(bold)
    assert refused.value.where == "choice"


@pytest.mark.parametrize("family", FAMILIES)
def test_an_unknown_name_lists_what_there_is(registered, family):
    with pytest.raises(InputError, match=r"gcv.*stricter") as refused:
        FAMILIES[family]()("balancing")
    assert refused.value.where == "choice"


def test_a_search_over_places_takes_no_rule():
    with pytest.raises(NotIdentifiable, match="stricter"):
        LocationSearch(MODEL, choice=stricter)


def test_another_distribution_adds_a_rule(monkeypatch):
    class Entry:
        @staticmethod
        def load():
            return stricter

    asked = []
    monkeypatch.setattr(rules, "RULES", dict(rules.RULES))
    monkeypatch.setattr(
        "importlib.metadata.entry_points",
        lambda **what: asked.append(what) or ([Entry] if what["name"] == "theirs" else []),
    )
    assert at_rest()("theirs").choice.rule == "theirs"
    assert asked == [{"group": "loadid.rules", "name": "theirs"}]


@pytest.mark.parametrize(("function", "name"), [(stricter, "gcv"), (stricter, ""), (3, "three")])
def test_a_rule_that_is_none_is_refused(function, name):
    with pytest.raises(InputError, match="rule"):
        loadid.register_rule(function, name)


def test_a_penalty_of_the_user(monkeypatch):
    monkeypatch.setattr(penalties, "ORDER", dict(penalties.ORDER))
    loadid.register_penalty("jerk", 3)
    y, level = record()
    found = {
        path: Deconvolution(MODEL, penalty="jerk", choice=Lambda(1e-4, path=path), noise=level).estimate(y, DT).load
        for path in ("dense", "statespace")
    }
    assert found["dense"] == pytest.approx(found["statespace"], abs=1e-6 * np.abs(found["dense"]).max())
    for order, name in ((-1, "other"), (True, "other"), (2, "jerk"), (2, "")):
        with pytest.raises(InputError):
            loadid.register_penalty(name, order)
    with pytest.raises(InputError, match="jerk"):
        penalties.order("snap")
