"""Every way to ask for sparse loads: the conditions of the minimum on dense matrices, or a refusal by a setting."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from loadid import InputError, SparseDeconvolution
from loadid._inverse import rules
from loadid._spellings import folded

from . import histories, reference
from .histories import DT, N

OWN = np.array([np.exp(-0.5 * ((np.arange(N) - k) / 1.5) ** 2) for k in range(0, N, 2)]).T
DICTIONARIES = {"dirac": "dirac", "bspline": "bspline", "wavelet": "wavelet", "matrix": OWN}
OPTIONS = {
    "": {},
    "push": {"nonnegative": True},
    "loads": {"groups": "loads"},
    "slots": {"groups": "slots"},
    "reweighted": {"reweighted": 2},
    "shrunken": {"debias": False},
    "push+shrunken": {"nonnegative": True, "debias": False},
    "gap": {},
    "covariance": {},
    "knots": {"knots": 4},
    "push+slots": {"nonnegative": True, "groups": "slots"},
}
REFUSED = ("robust_gcv", "predicted_error", "l_curve", "quasi_optimality", "evidence")  # no support gives what they ask
CHOICES = (*(name for name in rules.RULES if name not in REFUSED), None, 0.1)


def data(option):
    """Impulse responses, a record of two hits with noise, and that noise."""
    h = histories.responses("impulses")
    g = np.zeros((N, 2))
    g[5:10, 0], g[18:23, 1] = 3 * np.hanning(5), 2 * np.hanning(5)
    clean = (reference.convolution(h) @ g.ravel()).reshape(N, 3)
    noise = 0.02 * clean.std(axis=0)
    y = clean + noise * np.random.default_rng(0).standard_normal(clean.shape)
    if option == "gap":
        y[12:14, 1] = np.nan
    return h, y, np.outer(noise, noise) * histories.CORRELATED if option == "covariance" else noise


def objections(dictionary, choice, option):
    """Settings by which a cell is refused."""
    found = {"choice"} if choice not in CHOICES or choice is False else set()
    found |= {"nonnegative"} if ("push" in option and dictionary == "wavelet") or option == "push+slots" else set()
    return found | ({"knots"} if option == "knots" and dictionary != "bspline" else set())


def check(dictionary, choice, option):
    """One cell."""
    h, y, noise = data(option)
    expected, refused = objections(dictionary, choice, option), None
    try:
        family = SparseDeconvolution(
            histories.model("impulses"), dictionary=DICTIONARIES[dictionary], choice=choice, noise=noise,
            **folded(SparseDeconvolution, {"tol": 1e-12, **OPTIONS[option]}),
        )  # fmt: skip
        estimate = family.estimate(y, dt=DT)
    except InputError as error:
        refused = error
    if refused is not None:
        assert refused.where in expected, f"refused by {refused.where!r}, not by one of {expected or 'none'}: {refused}"
        return
    assert not expected, f"answered, and should be refused by one of {expected}"
    assert np.all(np.isfinite(estimate.load))
    assert np.all(np.isfinite(estimate.std))
    assert estimate.facts["gap"] <= 1e-10
    predicted = (reference.convolution(h) @ estimate.load.ravel()).reshape(N, 3)
    there = ~np.isnan(y)
    assert np.abs(estimate.residual - (y - predicted))[there].max() <= reference.CLOSE * np.abs(y[there]).max()
    if dictionary in ("dirac", "matrix") and "reweighted" not in option and option not in ("loads", "slots"):
        agrees(estimate, h, y, noise, dictionary, option)


def agrees(estimate, h, y, noise, dictionary, option):
    """Amplitudes on the support of the answer, and what the penalty says of all others."""
    D = np.eye(N) if dictionary == "dirac" else OWN
    atoms = np.kron(D, np.eye(2))  # (samples * loads, atoms * loads)
    H, b = reference.whitened(reference.convolution(h), y, noise)
    A = H @ atoms
    x = np.linalg.lstsq(atoms, estimate.load.ravel(), rcond=None)[0]
    used = np.abs(x) > 1e-9 * np.abs(x).max()
    level = estimate.facts["mu"] if "shrunken" in option else 0.0
    # least squares, its gradient moved to the level of the penalty
    inner = A[:, used].T @ A[:, used]
    expected = reference.solved(A[:, used], b) - np.linalg.solve(inner, level * np.sign(x[used]))
    assert np.linalg.norm(x[used] - expected) <= 1e-7 * np.linalg.norm(expected)
    if level:
        slope = A.T @ (b - A @ x)
        assert np.all((slope if "push" in option else np.abs(slope)) <= level * (1 + 1e-5))
    assert "push" not in option or "shrunken" not in option or np.all(x[used] > 0)


def cells():
    """Full over dictionaries and options at a given mu; by the default rule two dictionaries, other rules plain."""
    yield from product(DICTIONARIES, (0.1,), OPTIONS)
    yield from product(("dirac", "matrix"), (None,), OPTIONS)
    yield from product(DICTIONARIES, (*rules.RULES, False, 0, 0.0, 1), ("",))


@pytest.mark.parametrize(("dictionary", "choice", "option"), list(cells()), ids=lambda x: str(x) or "plain")
def test_sparse(dictionary, choice, option):
    check(dictionary, choice, option)
