"""Impacts on beams and plates.

Beams of 0.6 to 2 m and plates, 1 to 4 sensors (acceleration, strain, displacement, mixed), 1 to 3 loads, half sines of
6 to 20 samples, noise of 0.5 to 10 % of each channel, 120 to 1600 samples. The truth has a finer mesh, twice the modes
and a step ten times finer, and is sampled behind an anti-alias filter without phase. `error` adds what the model does
not know or the record should not have: gains, correlated noise, frequencies, damping, places of sensors, a channel
that is late, one that clips, an offset, a load beyond the end of the record; cuts the record to its first quarter; or
gives a load that is no impact.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import firwin, lfilter

from loadid import Deconvolution, LoadEstimate
from structures import ForwardModel, beams, damping, loads, plates, sensors
from structures.errors import InputError, NotIdentifiable

from .scores import Array, Scored, deviations

FINER = 10
ERRORS = (
    "none", "same model", "gain", "correlated", "frequency", "damping", "place", "late", "clipped", "offset",
    "overlong", "slow", "harmonic", "random", "swept", "cut",
)  # fmt: skip
KINDS = ("acceleration", "strain", "displacement", "mixed")


@dataclass(frozen=True, eq=False)
class Problem:
    """One record as a user has it, with its truth.

    Parameters
    ----------
    model : ForwardModel
    record : array (samples, sensors)
    dt : float
    sigma : array (sensors,)
        True noise std.
    stated : bool
    truth : array (samples, loads)
    groups : tuple of str
    """

    model: ForwardModel
    record: Array
    dt: float
    sigma: Array
    stated: bool
    truth: Array
    groups: tuple[str, ...]

    def inversion(self, **settings: Any) -> Deconvolution:
        """As the user poses it."""
        return Deconvolution(self.model, **{"noise": self.sigma if self.stated else None} | settings)


def _sampled(fine: Array) -> Array:
    """Every tenth sample behind a low-pass at .8 of the new Nyquist frequency, without delay."""
    taps = firwin(20 * FINER + 1, 0.8 / FINER)
    padded = np.vstack([np.zeros((10 * FINER, fine.shape[1])), fine, np.repeat(fine[-1:], 10 * FINER, axis=0)])
    return np.asarray(lfilter(taps, 1.0, padded, axis=0)[20 * FINER :: FINER][: len(fine) // FINER])


def _structure(rng: np.random.Generator, fine: bool, beam: bool, length: float, width: float, ratio: float) -> Any:
    """The same structure on a coarse or a fine mesh; draws the same from any generator."""
    steel = beams.materials.steel
    if beam:
        ends = (("clamped", "free"), ("pinned", "pinned"), ("clamped", "clamped"))[rng.integers(3)]
        section = beams.Section.rectangle(0.04, 0.012)
        return beams.beam(length=length, section=section, material=steel, left=ends[0], right=ends[1],
                          elements=120 if fine else 40, damping=damping.Modal(ratio))  # fmt: skip
    edges = ("SSSS", "CCCC", "CFFF")[rng.integers(3)]
    return plates.plate(lengths=(0.5 * length, 0.5 * width * length), thickness=0.006, material=steel, edges=edges,
                        elements=(20, 16) if fine else (10, 8), damping=damping.Modal(ratio))  # fmt: skip


def _sensor(kind: str, at: Any, label: str) -> Any:
    if kind == "strain":
        return sensors.StrainGauge(at=at, fibre=0.003, label=label)
    return (sensors.Accelerometer if kind == "acceleration" else sensors.Displacement)(
        at=at, direction="+Z", label=label
    )


def _place(at: Array, extents: tuple[float, ...]) -> Any:
    return (
        float(at[0] * extents[0])
        if len(extents) == 1
        else tuple(float(a * e) for a, e in zip(at, extents, strict=True))
    )


def _history(rng: np.random.Generator, samples: int, error: str) -> Array:
    """One load on the fine clock, (FINER * samples,), of unit size."""
    t, n = np.arange(FINER * samples) / FINER, samples
    if error == "slow":
        return np.asarray(np.sin(2 * np.pi * t / n * rng.uniform(0.5, 2) + rng.uniform(0, 6)) * np.minimum(t / 20, 1))
    if error == "harmonic":
        return np.asarray(np.sin(2 * np.pi * t * rng.uniform(0.02, 0.1)) * np.minimum(t / 20, 1))
    if error == "random":
        return np.interp(t, np.arange(0, n + 4, 4), rng.standard_normal(len(np.arange(0, n + 4, 4))))
    if error == "swept":
        rate = np.linspace(rng.uniform(0.002, 0.02), rng.uniform(0.04, 0.15), len(t))
        return np.asarray(np.sin(2 * np.pi * np.cumsum(rate) / FINER) * np.minimum(t / 20, 1))
    load = np.zeros(len(t))
    for _ in range(int(rng.integers(1, 4))):
        width = rng.uniform(6, 20)
        start = rng.uniform(0.08, 0.6) * n * (0.4 if error == "cut" else 1.0)
        if error == "overlong":
            start = rng.uniform(n - 0.6 * width, n - 0.3 * width)
        inside = (t >= start) & (t < start + width)
        load[inside] += rng.uniform(0.5, 1) * np.sin(np.pi * (t[inside] - start) / width)
    return load


def problem(seed: int, error: str = "none", size: float = 0.03) -> Problem:
    """Problem number `seed` with one of `ERRORS`, of relative `size` where that means something."""
    rng = np.random.default_rng([seed, ERRORS.index(error)])
    beam, length, width = bool(rng.random() < 0.6), float(rng.uniform(0.6, 2.0)), float(rng.uniform(0.6, 1.0))
    ratio, draw = float(10 ** rng.uniform(-2.3, -1.5)), int(rng.integers(1 << 30))

    def structure(fine: bool, ratio: float) -> Any:
        return _structure(np.random.default_rng(draw), fine, beam, length, width, ratio)

    extents = (length,) if beam else (0.5 * length, 0.5 * width * length)
    modes, samples = int(rng.integers(4, 9)), int(np.exp(rng.uniform(np.log(120), np.log(1600))))
    kind = KINDS[rng.integers(4)]
    kinds = [kind if kind != "mixed" else KINDS[rng.integers(3)] for _ in range(int(rng.integers(1, 5)))]
    count = int(rng.integers(1, min(3, len(kinds)) + 1))
    places = rng.uniform(0.12, 0.88, (len(kinds), len(extents)))
    moved = places + (size * rng.standard_normal(places.shape) if error == "place" else 0.0)
    points = [loads.Point(at=_place(p, extents), direction="+Z", label=f"F{j}")
              for j, p in enumerate(rng.uniform(0.15, 0.85, (count, len(extents))))]  # fmt: skip
    believed = [_sensor(k, _place(p, extents), f"s{i}") for i, (k, p) in enumerate(zip(kinds, places, strict=True))]
    real = [_sensor(k, _place(p, extents), f"s{i}") for i, (k, p) in enumerate(zip(kinds, moved, strict=True))]
    model = ForwardModel(structure(False, ratio), believed, points, modes=modes)
    dt = 1 / (3.0 * float(model.modes.frequencies[-1]))
    same = error == "same model"
    true_ratio = 2 * ratio if error == "damping" else ratio
    truth = model if same else ForwardModel(structure(True, true_ratio), real, points, modes=2 * modes)
    fine = 10 ** rng.uniform(1, 4) * np.column_stack([_history(rng, samples, error) for _ in range(count)])
    stretch = 1 + (size * rng.standard_normal() if error == "frequency" else 0.0)  # a slower clock lowers frequencies
    clean = _sampled(np.asarray(truth.predict(fine, dt * stretch / FINER)))
    load = fine[::FINER]
    if error == "gain":
        clean = clean * (1 + size * rng.standard_normal(clean.shape[1]))
    if error == "late":
        clean[:, 0] = np.roll(clean[:, 0], int(rng.integers(1, 4)))
    sigma = 10 ** rng.uniform(np.log10(0.005), -1) * np.sqrt(np.mean(clean**2, axis=0))
    record = _measured(rng, clean, sigma, error)
    if error == "cut":
        record, load = record[: samples // 4], load[: samples // 4]
    stated = bool(rng.random() < 0.5)
    groups = ("beam" if beam else "plate", kind, f"sigma {'stated' if stated else 'not known'}", f"{count} loads",
              "overdetermined" if len(kinds) > count else "as many sensors as loads", f"error {error}")  # fmt: skip
    return Problem(model, record, dt, sigma, stated, load, groups)


def _measured(rng: np.random.Generator, clean: Array, sigma: Array, error: str) -> Array:
    """The clean record with its noise and the faults of its channels."""
    noise = rng.standard_normal(clean.shape)
    if error == "correlated":
        noise = np.asarray(lfilter([np.sqrt(1 - 0.81)], [1, -0.9], noise, axis=0))
    record = clean + sigma * noise
    if error == "clipped":
        top = 0.6 * np.abs(record[:, 0]).max()
        record[:, 0] = np.clip(record[:, 0], -top, top)
    if error == "offset":
        record[:, 0] += rng.uniform(0.1, 0.5) * np.std(record[:, 0])
    return np.asarray(record)


# -- scores ----------------------------------------------------------------------------------------------------------
def scored(given: Problem, estimate: LoadEstimate) -> Scored:
    """An estimate beside the truth: `there` is in the pulses, the totals are the peak and the impulse of each load."""
    load, std, truth = np.asarray(estimate.load), np.asarray(estimate.std), given.truth
    off = load - truth
    there = np.abs(truth) > 0.05 * np.abs(truth).max()
    peaks = tuple(np.abs(truth).argmax(axis=0)), tuple(range(truth.shape[1]))
    z = deviations(off, std)
    totals = []
    for j in range(truth.shape[1]):
        w = np.zeros(truth.shape)
        w[:, j] = given.dt
        total = estimate.functional(w)
        totals.append(float(deviations(np.array(total.value - np.sum(w * truth)), np.array(total.std))))
    prior = f"{estimate.facts.get('variance', 'constant')} variance"
    return Scored(
        (*given.groups, prior), estimate.choice.verdict, frozenset(estimate.codes),
        float(np.linalg.norm(off) / np.linalg.norm(truth)), float("nan"), z[there], z.ravel(),
        np.concatenate([z[peaks], totals]), float(np.median(std[there]) / np.sqrt(np.mean(off[there] ** 2))),
        estimate.grade.letter, len(estimate.cautions),
    )  # fmt: skip


def run(problems: int, seed: int, error: str = "none", **settings: Any) -> Iterator[Scored | str]:
    """Score of each problem, or why it was refused."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, error)
        try:
            yield scored(given, given.inversion(**settings).estimate(given.record, given.dt))
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]
