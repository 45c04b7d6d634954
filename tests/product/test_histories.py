"""Every way to ask for load histories: the answer of the dense reference, or a refusal that names the setting.

At a given lambda the product is full over penalties and single options on the dense, state-space and line paths, and
over a first and a third difference and a matrix on all paths. Pruned, as each lambda costs there: other penalties on
these paths, and rules on the Toeplitz and window paths, of which some are asked by name (the others run beside them).
Pairs of options take path and penalty in turn. Models without a state space have the options that they treat in their
own way.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from loadid import Deconvolution, Lambda, NotIdentifiable
from loadid._inverse import penalties, rules
from loadid._inverse.convolved import windows
from loadid._spellings import folded
from structures import ImpulseModel, InputError

from . import histories, reference
from .histories import DT, LAM, N

PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
SOLVERS = {
    "dense": "dense SVD", "statespace": "state space", "toeplitz": "Toeplitz, preconditioned", "windows":
    "Toeplitz, in windows", "fft": "zero-padded FFT",
}  # fmt: skip
NAMED = tuple(name for name in histories.ORDERS if name not in histories.SYNONYMS)


@pytest.fixture(autouse=True)
def third_difference(monkeypatch):
    """A penalty as CONTRIBUTING.md adds one, and nothing else."""
    monkeypatch.setitem(penalties.ORDER, "third_difference", 3)


def check(kind, path, penalty, choice, options, count=2):
    """One cell: the answer of the dense reference, or a refusal by a setting that the cell cannot have."""
    said, y = histories.settings(kind, penalty, options, count)
    given = not isinstance(choice, str | None) and choice is not False
    free = penalty == "none" or (given and choice == 0)
    expected = histories.objections(kind, path, penalty, free, options)
    if choice is False or choice == "ebic" or (penalty == "none" and choice not in (None, 0)):
        expected = {"choice"}
    refused, undetermined = None, False
    try:
        said = folded(Deconvolution, {**said, "choice": choice, "path": path})
        estimate = Deconvolution(histories.model(kind, count), **said).estimate(y, dt=DT)
    except InputError as error:
        refused = error
    except NotIdentifiable:
        undetermined = True
    if refused is not None:
        assert refused.where in expected, f"refused by {refused.where!r}, not by one of {expected or 'none'}: {refused}"
        return
    assert not expected, f"answered, and should be refused by one of {expected}"
    if undetermined:
        assert histories.problem(kind, path == "fft", penalty, options, count).undetermined(free)
        return
    assert all(np.all(np.isfinite(x)) for x in (estimate.load, estimate.std, estimate.residual, estimate.bias))
    assert path == "auto" or estimate.facts["path"].startswith(SOLVERS[path])
    rule = "given" if given or free else choice
    lam = 0.0 if free else choice
    assert "push" in " ".join(options) or rule is None or estimate.choice.rule == rule
    assert rule != "given" or estimate.choice.lam == lam
    agrees(estimate, kind, penalty, options, count)


def agrees(estimate, kind, penalty, options, count):
    """The load is that of the cell written out, at the lambda that the estimate says."""
    lines = estimate.facts["path"] == SOLVERS["fft"]
    problem = histories.problem(kind, lines, penalty, options, count)
    lam, load = estimate.choice.lam * estimate.choice.scale, estimate.load
    if "tsvd" in options or lines:  # what the padded problem puts after the record is dropped
        expected = problem.truncated(lam) if "tsvd" in options else problem.solution(lam)
        expected = expected.reshape(-1, count)[:N]
        error = np.linalg.norm(load - expected) / np.linalg.norm(expected)
        assert error <= reference.CLOSE, f"off the dense reference by {error:.2g}"
    elif {"push", "push_one"} & set(options):
        reference.assert_minimal(load, problem, lam, np.tile([True, "push" in options][:count], N))
    else:
        reference.assert_agrees(load, problem, lam)


def name(value):
    """Part of the name of a cell."""
    return ("+".join(value) or "plain") if isinstance(value, tuple) else str(value)


# -- every option alone, at a given lambda ----------------------------------------------------------------------------
def single():
    """Full over path, penalty and option where a path is cheap; beyond, for two penalties and a matrix."""
    for path, penalty, option in product(PATHS, (*NAMED, "matrix", "none"), ("", *histories.OPTIONS)):
        most = path in ("dense", "statespace", "fft") or option in ("", "gap", "push")
        if penalty in ("first", "third", "matrix") or (most and path != "windows"):
            yield "states", path, penalty, (option,) if option else ()
    yield from (("states", path, penalty, ()) for path in ("dense", "toeplitz") for penalty in histories.SYNONYMS)
    for path, penalty, option in product(
        ("auto", "toeplitz"), ("first", "third", "matrix"), ("", "gap", "push", "size")
    ):
        yield "impulses", path, penalty, (option,) if option else ()
    yield from (("impulses", path, "first", ("tsvd",)) for path in PATHS)
    few = ("", "gap", "push", "size", "tsvd", "unknown", "covariance")
    for path, penalty, option in product(("auto", "toeplitz", "fft"), ("identity", "third", "matrix"), few):
        yield "measured", path, penalty, (option,) if option else ()
    yield from (("measured", path, "first", ()) for path in ("dense", "statespace", "windows"))


@pytest.mark.parametrize(("kind", "path", "penalty", "options"), list(single()), ids=name)
def test_option(kind, path, penalty, options):
    check(
        kind,
        path,
        penalty,
        None if penalty == "none" else LAM,
        options,
        count=1 if kind == "states" and path in ("toeplitz", "windows") else 2,
    )


# -- pairs of options -------------------------------------------------------------------------------------------------
def pairs():
    """Every pair of options with a model that has states; path and penalty run through all their pairs beside it."""
    beside = list(product(("auto", "statespace", "toeplitz", "dense"), NAMED))
    for i, (one, other) in enumerate(combinations(histories.OPTIONS, 2)):
        if histories.OPTIONS[one].keys() & histories.OPTIONS[other].keys():
            continue
        yield *beside[i % len(beside)], (one, other)
        yield "statespace", NAMED[i % len(NAMED)], (one, other)


@pytest.mark.parametrize(("path", "penalty", "options"), sorted(set(pairs())), ids=name)
def test_two_options(path, penalty, options):
    check("states", path, penalty, LAM, options)


# -- rules ------------------------------------------------------------------------------------------------------------
CHOICES = (*rules.RULES, None, False, 0, 0.0, LAM)


def ruled():
    """Full where a path is cheap to ask; elsewhere each rule once, and each penalty."""
    yield from product(("dense", "statespace", "fft"), ("first",), CHOICES)
    yield from product(("dense", "statespace", "fft"), ("identity", "third"), (None, "ncp", "l_curve", "evidence"))
    yield from (("auto", NAMED[i % len(NAMED)], choice) for i, choice in enumerate(CHOICES))
    yield from product(("auto", "dense", "statespace", "fft"), ("second", "none"), (None, "gcv", False, 0))
    asked = ("discrepancy", "modified_gcv", "evidence", None)
    yield from (("toeplitz", "identity", choice) for choice in asked)
    yield from (
        ("toeplitz", "third", "l_curve"),
        ("toeplitz", "second", 0),
        ("windows", "identity", None),
        ("windows", "none", 0),
    )


@pytest.mark.parametrize(("path", "penalty", "choice"), list(ruled()), ids=name)
def test_rule(path, penalty, choice):
    check("impulses" if path in ("toeplitz", "windows") else "states", path, penalty, choice, (), count=1)


@pytest.mark.parametrize(
    "options", [("push",), ("gap",), ("size",), ("unknown",), ("tsvd",), ("covariance",)], ids=name
)
@pytest.mark.parametrize("choice", [None, "discrepancy", 0])
@pytest.mark.parametrize("penalty", ["identity", "third"])
def test_rule_beside_an_option(penalty, choice, options):
    check("states", "auto", penalty, choice, options, count=1)


# -- several windows --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("gap", [False, True], ids=["complete", "gap"])
@pytest.mark.parametrize("penalty", NAMED)
def test_several_windows(monkeypatch, penalty, gap):
    """A record cut into windows is off the reference by no more than the bound that it states."""
    monkeypatch.setattr(windows, "SHORT", 40)
    h, y, noise = histories.echoes(160)
    if gap:
        y[70:74] = np.nan
    lam = 10.0 ** -(2 + histories.ORDERS[penalty])  # of a scale that grows with the order
    said = {"penalty": histories.PENALTIES[penalty], "noise": noise}
    said["choice"] = Lambda(lam, path="windows")
    estimate = Deconvolution(ImpulseModel(h, DT, kind="held"), **said).estimate(y, dt=DT)
    H, data = reference.whitened(reference.convolution(h), y, noise)
    problem = reference.Problem(H, data, reference.differences(histories.ORDERS[penalty], len(y)))
    expected = problem.solution(estimate.choice.lam * estimate.choice.scale)
    bound = estimate.facts["window_bound"] * np.linalg.norm(estimate.posterior.std)
    assert bound < 1e-2 * np.linalg.norm(expected)
    assert np.linalg.norm(estimate.load[:, 0] - expected) <= bound + reference.CLOSE * np.linalg.norm(expected)
