"""Load histories: models, records, settings by name, and what the product says of each cell."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray

from loadid.constraints import NonNegative
from structures import ForwardModel, ImpulseModel, MeasuredModel, TrainingRecords, beams, damping, loads, sensors

from . import reference
from .reference import Problem

DT, N, LAM = 1 / 150, 32, 0.02
STATES = 6
NOISE = 0.02
CORRELATED = np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 1.0]])
BEAM = beams.simply_supported(
    length=2.0, section=beams.Section.rectangle(0.05, 0.01), material=beams.materials.steel, elements=8,
    damping=damping.Modal(0.05),
)  # fmt: skip

PENALTIES: dict[str, Any] = {
    "identity": "identity",
    "first": "first_difference",
    "second": "second_difference",
    "third": "third_difference",  # registered by the fixture of the same name
    "gradient": "gradient",
    "laplacian": "laplacian",
    "none": None,
}
ORDERS = {"identity": 0, "first": 1, "second": 2, "third": 3, "gradient": 1, "laplacian": 2}
SYNONYMS = ("gradient", "laplacian")


@cache
def model(kind: str, count: int = 2) -> Any:
    """A beam that rings on beyond the record; impulse or measured responses that die out within it."""
    observed = [
        k(at=x, direction="Z", label=f"s{i}")
        for i, (k, x) in enumerate(
            [(sensors.Displacement, 0.3), (sensors.Accelerometer, 0.9), (sensors.Displacement, 1.5)]
        )
    ]
    applied = [loads.Point(at=x, direction="Z", label=f"p{x}") for x in (0.65, 1.25)[:count]]
    own = ForwardModel(BEAM, observed, applied, modes=STATES // 2)
    if kind == "states":
        return own
    t = np.arange(N)[:, None, None]
    f, phase, size = np.random.default_rng(5).uniform(0.1, 1, (3, 1, 3, count))
    h = size * np.exp(-t / 5) * np.cos(0.3 * np.pi * f * t + phase)
    if kind == "impulses":
        return ImpulseModel(h, DT, kind="held", sensors=own.sensors, loads=own.loads)
    f = np.linspace(0, 0.5 / DT, N + 1)
    return MeasuredModel(
        f, np.fft.rfft(h, 2 * N, axis=0), sensors=own.sensors, loads=own.loads, records=TrainingRecords(samples=N)
    )


@cache
def record(kind: str, count: int = 2) -> tuple[NDArray, NDArray]:
    """Data (samples, sensors) with noise, and the std of that noise: pulses of both signs that begin at once."""
    t = np.arange(N)[:, None] - np.array([0, 12])[:count]
    g = np.sin(2 * np.pi * t / 24) * (t >= 0) * (t < 24) * np.array([5.0, 3.0])[:count]
    clean = np.einsum("ksn,n->ks", reference.convolution(responses(kind, count)), g.ravel())
    noise = NOISE * clean.std(axis=0)
    return clean + noise * np.random.default_rng(1).standard_normal(clean.shape), noise


@cache
def responses(kind: str, count: int = 2, hold: str = "foh") -> NDArray:
    """Impulse responses (samples, sensors, loads)."""
    own = model(kind, count)
    return np.fft.irfft(own.H, axis=0)[:N] if kind == "measured" else own.impulse_response(DT, N, hold)


@cache
def user_matrix(count: int = 2) -> NDArray:
    """A penalty of the user: it couples samples and is no difference."""
    return np.eye(N * count) + 0.3 * np.eye(N * count, k=2)


OPTIONS: dict[str, dict[str, Any]] = {
    "gap": {},  # in the record
    "covariance": {},  # of the noise
    "push": {"constraints": [NonNegative()]},
    "push_one": {"constraints": [NonNegative([0])]},
    "unknown": {"initial": "unknown"},
    "known": {"initial": 1e-4 * np.random.default_rng(2).standard_normal(STATES)},
    "leak": {"leak": 0.9},
    "from_zero": {"from_zero": True},
    "size": {"size": 0.3},
    "tsvd": {"method": "tsvd"},
    "zoh": {"hold": "zoh"},
    "some": {"sensors": ["s1", "s2"]},
}


def settings(kind: str, penalty: str, options: tuple[str, ...], count: int = 2) -> tuple[dict[str, Any], NDArray]:
    """Keyword arguments of the family but `path` and `choice`, and the record."""
    y, noise = record(kind, count)
    y = y.copy()
    if "gap" in options:
        y[15:19, 1] = np.nan
        y[30] = np.nan
    level = np.outer(noise, noise) * CORRELATED if "covariance" in options else noise
    if "some" in options:
        level = level[1:] if level.ndim == 1 else level[1:, 1:]
    given = user_matrix(count) if penalty == "matrix" else PENALTIES[penalty]
    found: dict[str, Any] = {"penalty": given, "noise": level}
    for name in options:
        found |= OPTIONS[name]
    return found, y


def objections(kind: str, path: str, penalty: str, free: bool, options: tuple[str, ...]) -> set[str]:
    """Settings by which a cell is refused; it is answered where there are none."""
    has, special = set(options), {"unknown", "known", "leak", "from_zero"} & set(options)
    signs, named = bool(has & {"push", "push_one"}), penalty not in ("matrix", "none")
    found: set[str] = set()
    if "tsvd" in has:
        found |= {"method"} if signs or path in ("statespace", "toeplitz", "windows") else set()
    if "size" in has and (not named or "tsvd" in has or signs):
        found |= {"size"}
    if signs and free:
        found |= {"lambda"}
    if path == "auto":
        each = [
            objections(kind, p, penalty, free, options)
            for p in (("fft", "toeplitz") if kind == "measured" else ("dense", "statespace", "toeplitz"))
        ]
        return set().union(*each) - {"path"} if all(each) else set()
    if path in ("dense", "statespace") and kind == "measured":
        return found | {"path"}
    if path == "statespace" and kind == "impulses":
        return found | {"path"}
    if path == "statespace":
        found |= set() if named else {"penalty"}
        found |= {"lambda"} if free else set()
        found |= {"penalty"} if "leak" in has and ORDERS.get(penalty) != 1 else set()
        found |= {"initial"} if {"size", "unknown"} <= has else set()
        return found
    found |= {"initial" if n in ("unknown", "known") else n for n in special}
    if path == "dense":
        found |= {"record"} if "gap" in has else set()
        found |= {"penalty"} if signs and not named else set()
        return found
    found |= {"size"} if "size" in has else set()
    found |= {"noise"} if "covariance" in has and (kind == "measured" or path == "fft" or "gap" in has) else set()
    if path == "fft":
        found |= {"record"} if "gap" in has else set()
        found |= {"constraints"} if signs else set()
        return found | ({"penalty"} if penalty == "matrix" else set())
    found |= set() if named else {"penalty"}
    return found | ({"lambda"} if free else set())


def problem(kind: str, lines: bool, penalty: str, options: tuple[str, ...], count: int = 2) -> Problem:
    """The cell written out; `lines`: over the zero-padded record in a circle."""
    given, y = settings(kind, penalty, options, count)
    level, order = np.asarray(given["noise"], float), ORDERS.get(penalty, 0)
    h = responses(kind, count, given.get("hold", "foh"))
    kept = slice(1, 3) if "some" in options else slice(None)
    h, y = h[:, kept], y[:, kept]
    if lines:
        P = scipy.fft.next_fast_len(2 * N, real=True)
        P += P % 2
        h = np.concatenate([h, np.zeros((P - N, *h.shape[1:]))])
        y = np.concatenate([y, np.zeros((P - N, y.shape[1]))])
        H, data = reference.whitened(reference.wrapped(h), y, level)
        return Problem(H, data, reference.differences(order, P, count, ends="round"))
    ends = "zero" if {"leak", "from_zero"} & set(options) else "free"
    L = reference.differences(order, N, count, ends=ends, leak=given.get("leak") or 1.0)
    if penalty == "matrix":
        L = user_matrix(count)
    if "size" in options:
        L = np.vstack([L, given["size"] * np.eye(N * count)])
    start = (
        free_motions(kind, count, given.get("hold", "foh"))[:, kept] if {"unknown", "known"} & set(options) else None
    )
    if "known" in options:
        y = y - start @ given["initial"]
    H, data = reference.whitened(reference.convolution(h), y, level)
    found = Problem(H, data, L)
    return reference.with_start(found, start, y, level) if "unknown" in options else found


def free_motions(kind: str, count: int, hold: str) -> NDArray:
    """Responses (samples, sensors, states) to each state at the first sample."""
    system = model(kind, count).state_space(DT, hold)
    rows, power = [], np.eye(STATES)
    for _ in range(N):
        rows.append(system.C @ power)
        power = system.A @ power
    return np.array(rows)


def echoes(samples: int) -> tuple[NDArray, NDArray, NDArray]:
    """Impulse responses of two sensors that die out soon, data with noise, and its std."""
    t = np.arange(samples)
    h = np.stack([np.exp(-t / 2) * np.cos(0.7 * t), np.exp(-t / 3)], axis=1)[..., None]
    clean = np.stack([np.convolve(h[:, s, 0], np.sin(2 * np.pi * t / 53))[:samples] for s in range(2)], axis=1)
    noise = NOISE * clean.std(axis=0)
    return h, clean + noise * np.random.default_rng(3).standard_normal(clean.shape), noise
