"""Every way to ask for load histories: the answer of the dense reference, or a refusal that names the setting.

The product is full over models, paths, penalties and single options at a given lambda, and over rules on the quick
paths; pairs of options, and rules where a path asks each lambda anew, are covered pair by pair.
"""

from __future__ import annotations

from itertools import combinations, product

import numpy as np
import pytest

from loadid import Deconvolution, NotIdentifiable
from loadid.inverse import penalties, rules, windows
from structures import InputError

from . import histories, reference
from .histories import DT, LAM, N

PATHS = ("auto", "dense", "statespace", "toeplitz", "windows", "fft")
KINDS = ("states", "impulses", "measured")
NAMED = ("identity", "first", "second", "third")


@pytest.fixture(autouse=True)
def third_difference(monkeypatch):
    """A penalty as CONTRIBUTING.md adds one, and nothing else."""
    monkeypatch.setitem(penalties.ORDER, "third_difference", 3)


def check(kind, path, penalty, choice, options, count=2):
    """One cell."""
    said, y = histories.settings(kind, penalty, options, count)
    free = penalty == "none" or (not isinstance(choice, str | None) and choice == 0)
    expected = histories.objections(kind, path, penalty, free, options)
    if choice is False or (penalty == "none" and choice not in (None, 0)):
        expected |= {"choice"}
    try:
        family = Deconvolution(histories.model(kind, count), path=path, choice=choice, **said)
        estimate = family.estimate(y, dt=DT)
    except InputError as error:
        assert error.where in expected, f"refused by {error.where!r}, not by one of {expected or 'none'}: {error}"
        return None
    assert not expected, f"answered, and should be refused by one of {expected}"
    assert np.all(np.isfinite(estimate.load))
    assert np.all(np.isfinite(estimate.std))
    assert np.all(np.isfinite(estimate.residual))
    agrees(estimate, kind, estimate.facts["path"], penalty, options, count)
    return estimate


def agrees(estimate, kind, solved_by, penalty, options, count):
    """The load is that of the cell written out, at the lambda that the estimate says."""
    problem = histories.problem(kind, "fft" if solved_by == "zero-padded FFT" else "", penalty, options, count)
    lam, load = estimate.choice.lam * estimate.choice.scale, estimate.load
    if solved_by == "zero-padded FFT":  # what the padded problem puts after the record is dropped
        whole = problem.truncated(lam) if "tsvd" in options else problem.solution(lam)
        expected = whole.reshape(-1, count)[:N]
        assert np.linalg.norm(load - expected) <= reference.CLOSE * np.linalg.norm(expected)
    elif "tsvd" in options:
        expected = problem.truncated(lam).reshape(-1, count)
        assert np.linalg.norm(load - expected) <= reference.CLOSE * np.linalg.norm(expected)
    elif {"push", "push_one"} & set(options):
        pushing = np.tile([True, "push" in options][:count], N)
        reference.assert_minimal(load, problem, lam, pushing)
    else:
        reference.assert_agrees(load, problem, lam)


def cells():
    """Model, path, penalty and option at a given lambda; synonyms and what has no state space with fewer options."""
    few = ("", "gap", "push", "size", "tsvd")
    for kind, path in product(KINDS, PATHS):
        for penalty in (*NAMED, "matrix", "none"):
            for option in ("", *histories.OPTIONS) if kind == "states" and path != "windows" else few:
                yield kind, path, penalty, (option,) if option else ()
        if kind == "states":
            yield from ((kind, path, penalty, ()) for penalty in ("gradient", "laplacian"))


def name(value):
    """Part of the name of a cell."""
    return ("+".join(value) or "plain") if isinstance(value, tuple) else str(value)


@pytest.mark.parametrize(("kind", "path", "penalty", "options"), list(cells()), ids=name)
def test_single_options(kind, path, penalty, options):
    check(kind, path, penalty, None if penalty == "none" else LAM, options)
