"""Impacts by measured FRFs: a hammer test of a structure, then a record of loads at the driven place.

Beams and plates of `tests.campaigns.impacts` with a damping of 1.5 to 6 %, 1 to 3 sensors, one load. Four hits, half
sines of 4 to 10 samples, each with a gain of its own (`GAIN`, 1 %), force and responses with noise, give the model, by
H1; the record that is judged has a gain of its own too, more noise, and 1 to 3 half sines or another load
(`impacts.ERRORS`); "gap": `LOST` samples of all channels are missing anywhere in it. Truth has twice the modes that the
band of the records holds and a step ten times finer, behind an anti-alias filter.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from loadid import Record
from structures import ForwardModel, InputError, MeasuredModel, NotIdentifiable, loads

from .impacts import (
    FINER,
    KINDS,
    Problem,
    _history,
    _place,
    _sampled,
    _sensor,
    _structure,
    scored,
)
from .scores import Array, Scored

ERRORS = ("none", "correlated", "slow", "harmonic", "random", "swept", "gap")
HITS, GAIN, FORCE_NOISE, LOST = 4, 0.01, 5e-4, 12


def _hit(rng: np.random.Generator, samples: int) -> Array:
    """One hit on the fine clock, (FINER * samples,)."""
    t, width, start = np.arange(FINER * samples) / FINER, rng.uniform(4, 10), rng.uniform(20, 40)
    inside = (t >= start) & (t < start + width)
    return np.asarray(np.where(inside, np.sin(np.pi * (t - start) / width), 0.0))


def problem(seed: int, error: str = "none") -> Problem:
    """Problem number `seed` with one of `ERRORS`."""
    rng = np.random.default_rng([seed, 77, ERRORS.index(error)])
    beam, length, width = bool(rng.random() < 0.6), float(rng.uniform(0.6, 2.0)), float(rng.uniform(0.6, 1.0))
    ratio, draw = float(10 ** rng.uniform(-1.8, -1.2)), int(rng.integers(1 << 30))
    structure = _structure(np.random.default_rng(draw), True, beam, length, width, ratio)
    extents = (length,) if beam else (0.5 * length, 0.5 * width * length)
    kind, count, modes = KINDS[rng.integers(4)], int(rng.integers(1, 4)), int(rng.integers(4, 9))
    kinds = [kind if kind != "mixed" else KINDS[rng.integers(3)] for _ in range(count)]
    places = rng.uniform(0.12, 0.88, (count, len(extents)))
    rows = [_sensor(k, _place(p, extents), f"s{i}") for i, (k, p) in enumerate(zip(kinds, places, strict=True))]
    point = loads.Point(at=_place(rng.uniform(0.15, 0.85, len(extents)), extents), direction="+Z", label="F")
    truth = ForwardModel(structure, rows, [point], modes=2 * modes)
    frequencies = truth.modes.frequencies
    dt = 1 / (3.0 * float(frequencies[modes - 1]))
    decayed = 7 / (2 * np.pi * frequencies[0] * ratio * dt)  # response falls to a thousandth
    samples = int(np.clip(2 ** np.ceil(np.log2(decayed + 200)), 1024, 32768))
    sigma_share = 10 ** rng.uniform(np.log10(0.002), -1.5)

    def measured(fine: Array, level: Array | None) -> tuple[Array, Array]:
        clean = _sampled(np.asarray(truth.predict(fine[:, None], dt / FINER))) * (1 + GAIN * rng.standard_normal())
        std = sigma_share * np.sqrt(np.mean(clean**2, axis=0)) if level is None else level
        return clean + std * rng.standard_normal(clean.shape), std

    tests, level = [], None
    for _ in range(HITS):
        fine = 100 * rng.uniform(0.5, 1) * _hit(rng, samples)
        response, std = measured(fine, level)
        level = std if level is None else level
        force = _sampled(fine[:, None])
        force = force + FORCE_NOISE * np.abs(force).max() * rng.standard_normal(force.shape)
        tests.append(np.column_stack([force, response]))
    channels = [truth.loads[0], *truth.sensors]
    hits = [Record(t, dt, channels, name=f"hit {i}") for i, t in enumerate(tests)]
    model = MeasuredModel.from_hits(hits, force="F", responses=[s.label for s in truth.sensors])
    fine = 100 * _history(rng, samples, "none" if error == "gap" else error)
    record, sigma = measured(fine, None)
    if error == "gap":
        at = int(rng.integers(samples - LOST))
        record[at : at + LOST] = np.nan
    groups = ("beam" if beam else "plate", kind, f"{count} sensors", f"error {error}")
    return Problem(model, record, dt, sigma, False, _sampled(fine[:, None]), groups)


def run(problems: int, seed: int, error: str = "none", **settings: Any) -> Iterator[Scored | str]:
    """Score of each problem, or why it was refused."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, error)
        try:
            yield scored(given, given.inversion(**settings).estimate(given.record, given.dt))
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]
