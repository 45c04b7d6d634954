"""Long records with few impacts.

Structures of 3 to 14 modes between 30 and 1500 Hz, 1 to 3 sensors that read displacement, velocity, acceleration,
strain or a mixture, one load, 1 to 20 half sines of 8 to 60 samples, noise of 1 to 10 %, 4000 to 60 000 samples, noise
level stated in every second record. The truth is a bank of second-order sections, one for each mode (hold invariant:
exact for a load held between samples), and not the state space of the inverse. What is judged is lambda: load error
over that of the best one, which is searched with the answer's own penalty over the whole range; so the variance of the
load is held constant.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import lfilter

from loadid import Deconvolution, LoadEstimate, Penalty
from loadid._families.data import gather
from loadid._families.posing import pose
from structures._models.statespace import StateSpace
from structures.errors import InputError, NotIdentifiable

from .scores import Array, Scored, deviations

KINDS = ("displacement", "velocity", "acceleration", "strain", "mixed")
ERRORS = ("none",)
SAMPLES = (4_000, 60_000)


@dataclass(frozen=True, eq=False)
class Problem:
    """One long record with its truth.

    Parameters
    ----------
    model : StateSpace
    record : array (samples, sensors)
    sigma : array (sensors,)
    stated : bool
    truth : array (samples, 1)
    groups : tuple of str
    """

    model: StateSpace
    record: Array
    sigma: Array
    stated: bool
    truth: Array
    groups: tuple[str, ...]

    def inversion(self, **settings: Any) -> Deconvolution:
        """As the user poses it."""
        given = {"noise": self.sigma if self.stated else None, "penalty": Penalty(variance="constant")}
        return Deconvolution(self.model, **given | settings)


@dataclass(frozen=True)
class Mode:
    """One mode: ``q'' + 2 zeta w q' + w^2 q = g``, in rad/s."""

    w: float
    zeta: float

    def matrices(self, dt: float) -> tuple[Array, Array]:
        """Exact step of (q, q') for a load held between samples."""
        w, z = self.w, self.zeta
        wd, decay = w * np.sqrt(1 - z**2), np.exp(-z * w * dt)
        c, s = np.cos(wd * dt), np.sin(wd * dt)
        A = decay * np.array([[c + z * w / wd * s, s / wd], [-(w**2) / wd * s, c - z * w / wd * s]])
        return A, np.linalg.solve(np.array([[0.0, 1.0], [-(w**2), -2 * z * w]]), (A - np.eye(2)) @ [0.0, 1.0])

    def respond(self, g: Array, dt: float) -> Array:
        """Displacement, velocity and acceleration (3, samples) under a held load, by recursion of two poles."""
        A, b = self.matrices(dt)
        poles = [1.0, -np.trace(A), np.linalg.det(A)]
        one, two = b, A @ b - np.trace(A) * b  # numerators of the two states: delay one and two
        q, v = (lfilter([0.0, one[i], two[i]], poles, g) for i in range(2))
        return np.stack([q, v, g - 2 * self.zeta * self.w * v - self.w**2 * q])


def _system(rng: np.random.Generator, kinds: list[str]) -> tuple[list[Mode], Array, float]:
    """Modes, what each sensor reads of each mode (sensors, modes), and the step."""
    top = rng.uniform(300, 1500)
    f = np.sort(np.r_[np.exp(rng.uniform(np.log(30), np.log(top), int(rng.integers(2, 13)))), top])
    modes = [Mode(2 * np.pi * x, 10 ** rng.uniform(-2.5, -1.6)) for x in f]
    at, place = rng.standard_normal((len(kinds), len(f))), rng.standard_normal(len(f))
    bent = np.array([f / top if kind == "strain" else np.ones(len(f)) for kind in kinds])
    return modes, at * place * bent, 1 / (rng.uniform(2.5, 8) * top)


def _impacts(rng: np.random.Generator, samples: int) -> Array:
    load = np.zeros(samples)
    for _ in range(int(np.exp(rng.uniform(0, np.log(20.99))))):
        width, start = int(rng.integers(8, 61)), rng.uniform(0.02, 0.9) * samples
        t = np.arange(samples) - start
        load += np.where((t >= 0) & (t < width), rng.uniform(0.3, 1) * np.sin(np.pi * t / width), 0.0)
    return load * 10 ** rng.uniform(0, 4)


def problem(seed: int, error: str = "none", samples: tuple[int, int] = SAMPLES) -> Problem:
    """Record number `seed`, of so many samples."""
    rng = np.random.default_rng([seed, ERRORS.index(error)])
    kind = KINDS[rng.integers(len(KINDS))]
    kinds = [kind if kind != "mixed" else KINDS[rng.integers(4)] for _ in range(int(rng.integers(1, 4)))]
    modes, parts, dt = _system(rng, kinds)
    count = int(np.exp(rng.uniform(*np.log(samples))))
    load = _impacts(rng, count)
    order = [{"velocity": 1, "acceleration": 2}.get(k, 0) for k in kinds]
    motions = [mode.respond(load, dt) for mode in modes]
    clean = np.column_stack(
        [sum(p * m[o] for p, m in zip(row, motions, strict=True)) for row, o in zip(parts, order, strict=True)]
    )
    sigma = 10 ** rng.uniform(-2, -1) * np.sqrt(np.mean(clean**2, axis=0))
    stated = bool(rng.random() < 0.5)
    record = clean + sigma * rng.standard_normal(clean.shape)
    groups = (kind, f"sigma {'stated' if stated else 'not known'}", f"{len(kinds)} sensors",
              f"{'up to' if count <= 16_000 else 'above'} 16 000 samples")  # fmt: skip
    return Problem(_model(modes, parts, order, dt), record, sigma, stated, load[:, None], groups)


def _model(modes: list[Mode], parts: Array, order: list[int], dt: float) -> StateSpace:
    n = 2 * len(modes)
    A, B = np.zeros((n, n)), np.zeros((n, 1))
    C, D = np.zeros((len(parts), n)), np.zeros((len(parts), 1))
    for k, mode in enumerate(modes):
        two = slice(2 * k, 2 * k + 2)
        A[two, two], B[two, 0] = mode.matrices(dt)
        rows = np.array([[1.0, 0.0], [0.0, 1.0], [-(mode.w**2), -2 * mode.zeta * mode.w]])
        C[:, two] = parts[:, k, None] * rows[order]
        D[:, 0] += parts[:, k] * (np.array(order) == 2)
    return StateSpace(A, B, C, D, dt, "zoh")


def best(given: Problem, found: LoadEstimate) -> float:
    """Load error at the best lambda: every quarter of a decade, then a parabola's worth of finer ones."""
    family = given.inversion()
    path = pose(given.model, gather(given.record, given.model.dt, given.model, None), family.settings).path

    def error(lam: float) -> float:
        load = path.solution(lam, None).load  # without direct feedthrough the last sample is not seen
        truth = given.truth[: len(load)]
        return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))

    lams = np.r_[np.geomspace(1e-6, 1, 19), found.choice.lam]
    errors = [error(x) for x in lams]
    centre = lams[int(np.argmin(errors))]
    return min(*errors, *(error(centre * 10**x) for x in (-0.2, -0.1, 0.1, 0.2)))


def scored(given: Problem, found: LoadEstimate, oracle: float) -> Scored:
    """An answer beside its truth."""
    load, std = np.asarray(found.load), np.asarray(found.std)
    truth = given.truth[: len(load)]
    off, z = load - truth, deviations(load - truth, np.broadcast_to(std, load.shape))
    there = np.abs(truth) > 0.05 * np.abs(truth).max()
    peak = int(np.argmax(np.abs(truth[:, 0])))
    return Scored(
        given.groups, found.choice.verdict, frozenset(found.codes),
        float(np.linalg.norm(off) / np.linalg.norm(truth)), oracle, z[there], z.ravel(), z[peak],
        float(np.median(np.broadcast_to(std, load.shape)[there]) / np.sqrt(np.mean(off[there] ** 2))),
    )  # fmt: skip


def run(
    problems: int, seed: int, error: str = "none", longest: int = SAMPLES[1], **settings: Any
) -> Iterator[Scored | str]:
    """Score of each record, or why it was refused; `longest`: samples that a record may have."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, error, (SAMPLES[0], longest))
        try:
            found = given.inversion(**settings).estimate(given.record, given.model.dt)
            yield scored(given, found, best(given, found))
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]
