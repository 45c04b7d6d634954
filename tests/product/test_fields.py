"""Every way to ask for a field over space and time: both priors written out in one dense problem, or a refusal."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from loadid import FieldDeconvolution
from loadid._inverse import penalties
from loadid._spellings import folded
from loadid.constraints import NonNegative
from structures import ForwardModel, InputError, bases, sensors

from . import histories, reference
from .histories import BEAM, DT

N, LAM, LENGTH, RATIO = 24, 0.02, 0.5, 0.3
HATS = bases.hats(BEAM, 3)
MODEL = ForwardModel(BEAM, [sensors.Displacement(at=x) for x in (0.25, 0.5, 0.75, 1.1, 1.6)], HATS, modes=4)
SPACES = {"none": None, "gradient": "gradient", "matrix": np.array([[1.0, -2, 1, 0], [0, 1, -2, 1]])}
OPTIONS = {
    "": {},
    "gap": {},
    "unknown": {"initial": "unknown"},
    "leak": {"leak": 0.9},
    "push": {"constraints": [NonNegative()]},
    "ratio": {"ratio": RATIO},
    "tsvd": {"method": "tsvd"},
}


@pytest.fixture(autouse=True)
def third_difference(monkeypatch):
    """A penalty as CONTRIBUTING.md adds one, and nothing else."""
    monkeypatch.setitem(penalties.ORDER, "third_difference", 3)


def precision(space):
    """Root of the spatial precision by its definition: size of the field and of LENGTH times its slope."""
    if space == "none":
        return np.eye(4)
    if space == "matrix":
        return np.linalg.cholesky(np.eye(4) + LENGTH**2 * SPACES["matrix"].T @ SPACES["matrix"]).T
    step = 2.0 / 3
    mass = step / 6 * (np.diag([2.0, 4, 4, 2]) + np.eye(4, k=1) + np.eye(4, k=-1))
    slope = reference.differences(1, 4) / np.sqrt(step)
    return np.linalg.cholesky((mass + LENGTH**2 * slope.T @ slope) * 4 / np.trace(mass)).T


def size(space):
    """Root of the size of a field, which is the precision of length zero."""
    step = 2.0 / 3
    mass = step / 6 * (np.diag([2.0, 4, 4, 2]) + np.eye(4, k=1) + np.eye(4, k=-1))
    return np.eye(4) if space == "matrix" else np.linalg.cholesky(mass * 4 / np.trace(mass)).T


def objections(path, time, space, option):
    """Settings by which a cell is refused; it is answered where there are none."""
    signs = {"constraints"} if option == "push" and (space != "none" or path == "fft") else set()
    if option == "ratio" and space == "none":
        return {"ratio"}
    if option == "leak":
        return {"penalty"} if path in ("auto", "statespace") and time != "first_difference" else (
            set() if path in ("auto", "statespace") else {"leak"})  # fmt: skip
    if option == "tsvd":
        return {"method"} if path in ("statespace", "toeplitz") else set()
    beyond = {"gap": {"record"}, "unknown": {"initial"}, "ratio": {"size"}}.get(option, set())
    takes = {
        "auto": {"gap", "unknown", "ratio", "push", ""}, "statespace": {"gap", "unknown", "ratio", "push", ""},
        "dense": {"ratio", "push", ""}, "toeplitz": {"gap", "push", ""}, "fft": {""},
    }  # fmt: skip
    return signs | (set() if option in takes[path] else beyond)


def cells():
    """Full over path, prior in space and option for two of the penalties in time, in part for others."""
    times = ("identity", "first_difference", "second_difference", "third_difference")
    for path, time, space, option in product(
        ("auto", "dense", "statespace", "toeplitz", "fft"), times, SPACES, OPTIONS
    ):
        full = time == "first_difference" or (time == "third_difference" and path in ("dense", "statespace", "fft"))
        if full or (space == "gradient" and option in ("", "ratio") and path not in ("auto", "toeplitz")):
            yield path, time, space, option


@pytest.mark.parametrize(("path", "time", "space", "option"), list(cells()), ids=lambda x: x or "plain")
def test_field(path, time, space, option):
    rng, t = np.random.default_rng(0), np.arange(N)[:, None]
    h = MODEL.impulse_response(DT, N)
    clean = (reference.convolution(h) @ (np.sin(t / 4) * [1.0, 2, 1, 0.5]).ravel()).reshape(N, -1)
    noise = 0.02 * clean.std(axis=0)
    y = clean + noise * rng.standard_normal(clean.shape)
    if option == "gap":
        y[8:11, 1] = np.nan
    said = {"time": time, "space": SPACES[space], "length": None if space == "none" else LENGTH, "noise": noise,
            "choice": LAM, "path": path}  # fmt: skip
    expected, refused = objections(path, time, space, option), None
    try:
        family = FieldDeconvolution(
            MODEL, allow=["LID-E514"], **folded(FieldDeconvolution, {**said, **OPTIONS[option]})
        )
        estimate = family.estimate(y, dt=DT)
    except InputError as error:
        refused = error
    if refused is not None:
        assert refused.where in expected, f"refused by {refused.where!r}, not by one of {expected or 'none'}: {refused}"
        return
    assert not expected, f"answered, and should be refused by one of {expected}"
    assert np.all(np.isfinite(estimate.std))
    assert np.all(np.isfinite(estimate.load))
    problem, lam = written_out(h, y, noise, time, space, option, path), estimate.choice.lam * estimate.choice.scale
    if option == "push":
        reference.assert_minimal(estimate.load, problem, lam, np.ones(4 * N, bool))
    elif option == "tsvd" or path == "fft":
        found = problem.truncated(lam) if option == "tsvd" else problem.solution(lam)
        found = found.reshape(-1, 4)[:N]
        assert np.linalg.norm(estimate.load - found) <= reference.CLOSE * np.linalg.norm(found)
    else:
        reference.assert_agrees(estimate.load, problem, lam)


def written_out(h, y, noise, time, space, option, path):
    """The cell as one dense problem."""
    order, W = histories.ORDERS[time.split("_")[0]], precision(space)
    lines = path == "fft"
    if lines:
        h, y = (np.concatenate([x, np.zeros((len(x), *x.shape[1:]))]) for x in (h, y))
    ends = "round" if lines else "zero" if option == "leak" else "free"
    L = reference.differences(order, len(y), ends=ends, leak=0.9 if option == "leak" else 1.0)
    if option == "ratio":
        penalty = np.vstack([np.kron(L, size(space)), RATIO * np.kron(np.eye(N), W)])
    else:
        penalty = np.kron(L, W)
    H, data = reference.whitened((reference.wrapped if lines else reference.convolution)(h), y, noise)
    problem = reference.Problem(H, data, penalty)
    if option != "unknown":
        return problem
    system, power, rows = MODEL.state_space(DT, "foh"), np.eye(8), []
    for _ in range(N):
        rows.append(system.C @ power)
        power = system.A @ power
    return reference.with_start(problem, np.array(rows), y, noise)
