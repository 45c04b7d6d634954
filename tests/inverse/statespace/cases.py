"""Records of a cantilever beam, and modal systems that are hard on a recursion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid._inverse.gaussian.path import StateSpacePath
from loadid._inverse.gaussian.record import WhitenedRecord, augment, record
from structures import ForwardModel, StateSpace, beams, loads, sensors
from structures._models.discretise import blocks
from structures._system.damping import Modal

from .dense import Dense, problem, starts

DT = 1 / 2000.0
PLACES = {
    "d": sensors.Displacement("5+Z"),
    "v": sensors.Velocity("3+Z"),
    "a": sensors.Accelerometer("4+Z"),
    "s": sensors.StrainGauge(at=0.1, fibre=0.01),
}
PENALTIES: dict[str, tuple[str, dict[str, Any]]] = {
    "identity": ("identity", {}),
    "first": ("first_difference", {}),
    "first from zero": ("first_difference", {"from_zero": True}),
    "second": ("second_difference", {}),
    "second from zero": ("second_difference", {"from_zero": True}),
    "leaky": ("first_difference", {"leak": 0.95}),
}


@lru_cache
def beam(kinds: str, hold: str = "foh", count: int = 2) -> StateSpace:
    """Four modes, one sensor for each letter of `kinds` (displacement, velocity, acceleration, strain)."""
    structure = beams.cantilever(elements=6, damping=Modal(0.02), length=1.2, EI=800.0, mass_per_length=3.0)
    where = [loads.Point("6+Z"), loads.Point("2+Z")][:count]
    return ForwardModel(structure, [PLACES[k] for k in kinds], where, modes=4).state_space(DT, hold)


def modal(f: list[float], zeta: float | list[float], kinds: str, dt: float = 1e-3) -> StateSpace:
    """One load over modes of given frequencies (Hz) and damping ratios, random shapes."""
    omega, rng = 2 * np.pi * np.array(f), np.random.default_rng(0)
    damping, count = 2 * np.broadcast_to(zeta, omega.shape) * omega, 2 * len(omega)
    A, B, C = np.zeros((count, count)), np.zeros((count, 1)), np.zeros((len(kinds), count))
    D, shapes, drive = np.zeros((len(kinds), 1)), rng.uniform(0.5, 1, (len(kinds), len(f))), rng.uniform(0.5, 1, len(f))
    for i, kind in enumerate(kinds):
        parts = blocks(omega**2, damping, dt, "foh", derivative="dva".index(kind))
        for j in range(len(f)):
            at = slice(2 * j, 2 * j + 2)
            A[at, at], B[at, 0], C[i, at] = parts.A[j], drive[j] * parts.B[j], shapes[i, j] * parts.c[j]
        D[i] = shapes[i] * drive @ parts.D
    return StateSpace(A, B, C, D, dt)


def holes(rng: np.random.Generator, shape: tuple[int, int]) -> NDArray[np.bool_]:
    """Single samples, a gap of all channels, a gap of one, and a first sample of which one channel is gone."""
    gone = rng.random(shape) < 0.05
    gone[40:55] = True
    gone[60:75, 0] = True
    gone[0] = False
    gone[0, 0] = True
    return gone


@dataclass(frozen=True)
class Case:
    """A record: data with NaN, their noise std, and the load that made them."""

    system: StateSpace
    y: NDArray
    noise: NDArray
    load: NDArray

    def path(self, penalty: str, *, y: NDArray | None = None, **options: Any) -> StateSpacePath:
        """State-space path."""
        return StateSpacePath(self.record(penalty, self.y if y is None else y, **options))

    def record(self, penalty: str, y: NDArray, **options: Any) -> WhitenedRecord:
        """Whitened record."""
        s, w = self.system, 1 / self.noise
        system = augment(s.A, s.B, w[:, None] * s.C, w[:, None] * s.D, penalty, **options)
        return record(system, y * w, np.isnan(y))

    def dense(self, penalty: str, **options: Any) -> Dense:
        """The same by its definition."""
        return problem(self.system, self.y, self.noise, penalty, **options)


def case(
    system: StateSpace, samples: int, missing: Callable | None = None, moving: bool = False, noise: float = 0.02
) -> Case:
    """A bump and a sine with noise, some data missing, and the structure in motion at the start."""
    rng, t, count = np.random.default_rng(0), np.arange(samples), len(system.loads)
    load = 10 * np.array([np.exp(-0.5 * ((t - samples / 3) / 6) ** 2), np.sin(t / 9)])[:count].T
    y = system.simulate(load)
    if moving:
        free = starts(system, samples) @ rng.standard_normal(len(system.A))
        y = y + free * np.std(y) / np.std(free)
    sigma = noise * y.std(axis=0)
    y = y + sigma * rng.standard_normal(y.shape)
    if missing is not None:
        y[missing(rng, y.shape)] = np.nan
    return Case(system, y, sigma, load)


def off(got: object, exact: object) -> float:
    """Largest difference over the largest value."""
    exact = np.asarray(exact, float)
    return float(np.max(np.abs(np.asarray(got, float).reshape(exact.shape) - exact)) / np.max(np.abs(exact)))
