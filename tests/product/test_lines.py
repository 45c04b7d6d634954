"""Every way to ask for loads line by line: each line against its dense problem, or a refusal that names the setting."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from loadid import FrequencyInversion, HarmonicInversion, Noise, Spectra
from loadid._inverse import rules
from loadid._spellings import folded
from structures import ForwardModel, InputError, bases, loads, sensors
from structures._testing.spectra import padded_length

from . import reference
from .histories import BEAM, DT

N, LINES, LAM = 60, 24, 0.05
SEEN = [sensors.Accelerometer(at=x, label=f"s{i}") for i, x in enumerate((0.3, 0.9, 1.2, 1.6))]
MODEL = ForwardModel(BEAM, SEEN, [loads.Point(at=x, direction="Z", label=f"p{x}") for x in (0.65, 1.25)], modes=3)
CHOICES = (*rules.RULES, None, False, 0, 0.0, LAM)
PER_LINE = {"ncp", "ebic"}  # rules that no line can run: the residual of a record, the support of a sparse load
OPTIONS = {"": {}, "size": {"size": [1.0, 3.0]}, "two": {"sensors": ["s0", "s2"]}, "one": {"sensors": ["s0"]},
           "count": {"count": 1}, "gap": {}}  # fmt: skip


def case(kind):
    """Lines (Hz) with FRFs, their data, what is given to the family, and the noise of the data."""
    rng = np.random.default_rng(0)
    if kind == "spectra":
        f = np.linspace(3, 60, LINES)
        H = MODEL.frf(f)
        Y = H @ np.array([2.0, 1 - 1j])
        noise = 0.03 * np.sqrt(np.mean(np.abs(Y) ** 2, axis=0))
        Y = Y + noise * np.sqrt(0.5) * (rng.standard_normal(Y.shape) + 1j * rng.standard_normal(Y.shape))
        return H, Y, Spectra(f, Y), noise
    y = MODEL.predict(np.outer(np.sin(np.arange(N) / 3) * np.hanning(N), [2.0, 1.0]), DT)
    noise = 0.03 * y.std(axis=0)
    y = y + noise * rng.standard_normal(y.shape)
    P = padded_length(N)
    return None, np.fft.rfft(y, P, axis=0), y, noise


def objections(kind, method, choice, over, option):
    """Settings by which a cell is refused."""
    found = {"choice"} if choice is False or choice in PER_LINE else set()
    found |= {"count"} if option == "count" and (method != "tsvd" or choice is not None) else set()
    if option == "size" and method == "tikhonov" and choice is None:
        found |= {"size"}
    if method == "tsvd" and choice in ("quasi_optimality", "evidence", "l_curve"):
        found |= {"choice"}
    return found | ({"record"} if option == "gap" and kind == "transient" else set())


def check(kind, method, choice, over, option=""):
    """One cell."""
    H, Y, given, noise = case(kind)
    if option == "gap" and kind == "transient":
        given = given.copy()
        given[20] = np.nan
    rows = {"two": [0, 2], "one": [0]}.get(option, [0, 1, 2, 3])
    said = {"method": method, "choice": choice, "over": over, "neighbours": 6, "noise": noise[rows]}
    said |= {"signal": "transient"} if kind == "transient" else {}
    expected, refused = objections(kind, method, choice, over, option), None
    try:
        posed = folded(FrequencyInversion, {**said, **OPTIONS[option]})
        posed["noise"] = replace(Noise.of(posed.get("noise")), frf=0.0)  # the FRF is exact
        estimate = FrequencyInversion(MODEL, **posed).estimate(given, *([DT] if H is None else []))
    except InputError as error:
        refused = error
    if refused is not None:
        assert refused.where in expected, f"refused by {refused.where!r}, not by one of {expected or 'none'}: {refused}"
        return
    assert not expected, f"answered, and should be refused by one of {expected}"
    assert np.all(np.isfinite(estimate.load))
    assert np.all(np.isfinite(estimate.std))
    if choice is None and method == "tikhonov":
        return  # by the evidence of the neighbours: its own tests
    if H is None:
        P = padded_length(N)
        H = np.fft.rfft(MODEL.impulse_response(DT, P // 2), P, axis=0)
    found = by_lines(
        H[:, rows] / noise[rows, None], Y[:, rows] / noise[rows], estimate.spectrum.lam, method, choice, option
    )
    if kind == "transient":
        found = np.fft.irfft(found, padded_length(N), axis=0)[:N]
    assert np.linalg.norm(estimate.load - found) <= reference.CLOSE * np.linalg.norm(found)


def by_lines(H, Y, lam, method, choice, option):
    """Loads of whitened lines at the relative lambdas of an estimate, one dense problem after another."""
    size = np.array(OPTIONS["size"]["size"]) if option == "size" else None
    if size is None:
        strength = np.sqrt(np.mean(np.sum(np.abs(H) ** 2, axis=1), axis=0))
        size = strength.max() / strength
    out = []
    for R, y, at in zip(H * size, Y, lam, strict=True):
        U, s, Vh = np.linalg.svd(R, full_matrices=False)
        if method == "tsvd":
            keep = (s >= at * s[0] * (1 - 1e-9)) & (s > 1e-14 * s[0])
            out.append(size * (Vh[keep].conj().T @ (U[:, keep].conj().T @ y / s[keep])))
        elif s[0] == 0:
            out.append(np.zeros(len(size)))
        else:
            A = np.vstack([R, at * s[0] * np.eye(len(size))])
            out.append(size * np.linalg.lstsq(A, np.r_[y, np.zeros(len(size))], rcond=None)[0])
    return np.array(out)


@pytest.mark.parametrize("over", ["neighbours", "line", "band"])
@pytest.mark.parametrize("choice", CHOICES, ids=str)
@pytest.mark.parametrize("method", ["tikhonov", "tsvd"])
def test_rule(method, choice, over):
    check("spectra", method, choice, over)


@pytest.mark.parametrize("option", OPTIONS, ids=lambda x: x or "plain")
@pytest.mark.parametrize("choice", [None, "gcv", "discrepancy", LAM], ids=str)
@pytest.mark.parametrize(("kind", "method"), list(product(("spectra", "transient"), ("tikhonov", "tsvd"))))
def test_option(kind, method, choice, option):
    check(kind, method, choice, "neighbours", option)


# -- one line ---------------------------------------------------------------------------------------------------------
HATS = bases.hats(BEAM, 3)


@pytest.mark.parametrize("space", [None, "gradient", "laplacian", "matrix"], ids=str)
@pytest.mark.parametrize("choice", CHOICES, ids=str)
def test_one_line(choice, space):
    f, length, own = 11.0, 0.5, np.eye(4) - np.eye(4, k=1)
    model = ForwardModel(BEAM, [sensors.Displacement(at=x) for x in np.linspace(0.2, 1.8, 7)], HATS, modes=6)
    H, rng = model.frf([f])[0], np.random.default_rng(0)
    Y = H @ np.array([1.0, 2j, 1.5, -1])
    noise = np.full(7, 0.02 * np.abs(Y).max())
    Y = Y + noise * np.sqrt(0.5) * (rng.standard_normal(7) + 1j * rng.standard_normal(7))
    said, refused = {"space": own if space == "matrix" else space, "length": length if space else None}, None
    try:
        estimate = HarmonicInversion(model, f, choice=choice, noise=noise, **said).estimate(Y)
    except InputError as error:
        refused = error
    assert (refused is not None) == (choice is False or choice in PER_LINE)
    if refused is not None:
        assert refused.where == "choice"
        return
    step = 2.0 / 3
    mass = step / 6 * (np.diag([2.0, 4, 4, 2]) + np.eye(4, k=1) + np.eye(4, k=-1))
    slope = reference.differences(1, 4) / np.sqrt(step)
    bend = reference.differences(2, 4) / step**1.5
    W2 = {
        None: np.eye(4),
        "matrix": np.eye(4) + length**2 * own.T @ own,
        "gradient": (mass + length**2 * slope.T @ slope) * 4 / np.trace(mass),
        "laplacian": (mass + length**4 * bend.T @ bend) * 4 / np.trace(mass),
    }[space]
    lam, level = estimate.choice.lam * estimate.choice.scale, noise[0] / np.sqrt(2)
    both = np.block([[H.real, -H.imag], [H.imag, H.real]]) / level
    problem = reference.Problem(both, np.r_[Y.real, Y.imag] / level, np.kron(np.eye(2), np.linalg.cholesky(W2).T))
    reference.assert_agrees(estimate.load, problem, lam)
    assert choice is None or isinstance(choice, int | float) or estimate.choice.rule == choice
