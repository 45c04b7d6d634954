"""One fault among the sensors.

Beams and plates with two to five sensors to spare. Static: one to three point or patch loads, or many patches under a
smooth load and a penalty, one frame or twenty. Deconvolution: records of impacts and of random loads. Frequency: the
same records as transients, long ones averaged into cross spectra. The truth has a finer mesh, more modes and finer
steps, as in the campaigns of static loads and of impacts, whose parts are used. Noise of 0.5 to 5 %, stated in every
second problem; `error` adds errors of the model of 1 to 3 % in the gains or the places of all sensors, or of 1 % in the
frequencies. `fault` is one of `FAULTS`; ``none`` shows the false alarms, ``any`` draws one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loadid import Deconvolution, FrequencyInversion, LoadEstimate, Record, Signal, StaticInversion
from structures import ForwardModel, loads, sensors
from structures.errors import InputError, NotIdentifiable

from . import impacts, static
from .scores import Array, counts

STATIC = ("none", "gain", "unit", "polarity", "swap", "dead", "missing load", "load elsewhere")
DYNAMIC = ("none", "gain", "unit", "polarity", "swap", "dead", "delay", "drift", "missing load", "load elsewhere")
FAULTS = tuple(dict.fromkeys((*STATIC, *DYNAMIC)))
FAMILIES = ("static", "deconvolution", "frequency")
ERRORS = ("none", "gain", "place", "frequency")
UNITS = (9.80665, 1 / 9.80665, 1000.0, 0.001, 100.0, np.sqrt(2.0))
UNNAMED = ("missing load", "load elsewhere")
SAID = {"missing load": "load", "load elsewhere": "load", "drift": "drift"}


@dataclass(frozen=True, eq=False)
class Problem:
    """One problem, sound and with its fault.

    Parameters
    ----------
    inversion : callable
        Family for the sensors of these labels, or all (None).
    sound, faulty : Record or array
    labels : tuple of str
    culprits : frozenset of str
        Sensors at fault.
    fault : str
    truth : array
    groups : tuple of str
    """

    inversion: Callable[[Sequence[str] | None], Any]
    sound: Any
    faulty: Any
    labels: tuple[str, ...]
    culprits: frozenset[str]
    fault: str
    truth: Array
    groups: tuple[str, ...]


@dataclass(frozen=True)
class Found:
    """What was said of one problem.

    Parameters
    ----------
    groups : tuple of str
    fault : str
    said : str
        Kind that was said, "" for nothing.
    named, kind : bool
        The right sensors were named; the right kind.
    tested : bool
        The answer does not say of the sensors at fault that the others do not determine them.
    clean, faulty, corrected : float
        Load error of the sound readings, of the faulty ones, and after correction; NaN where not asked.
    """

    groups: tuple[str, ...]
    fault: str
    said: str
    named: bool
    kind: bool
    tested: bool
    clean: float
    faulty: float
    corrected: float


# -- faults ------------------------------------------------------------------------------------------------------------
def spoilt(rng: np.random.Generator, y: Array, fault: str, sigma: Array) -> tuple[Array, set[int]]:
    """Readings (frames or samples, sensors) with a fault in one sensor, and which sensors those are."""
    out, m = np.array(y), y.shape[1]
    i, j = (int(k) for k in rng.permutation(m)[:2])
    if fault == "gain":
        out[:, i] *= rng.choice([rng.uniform(0.3, 0.7), rng.uniform(1.3, 3.0)])
    elif fault == "unit":
        out[:, i] *= rng.choice(UNITS)
    elif fault == "polarity":
        out[:, i] *= -1
    elif fault == "dead":
        out[:, i] = sigma[i] * rng.standard_normal(len(y))
    elif fault == "delay":
        out[:, i] = _late(y[:, i], rng.uniform(1, 8))
    elif fault == "drift":
        t = np.linspace(0, 1, len(y))
        out[:, i] += rng.uniform(0.5, 2) * np.std(y[:, i]) * rng.choice([-1, 1]) * t ** rng.uniform(0.7, 1.5)
    elif fault == "swap":
        out[:, [i, j]] = out[:, [j, i]]
        return out, {i, j}
    else:
        return out, set()
    return out, {i}


def _late(y: Array, lag: float) -> Array:
    """A channel later by `lag` samples, by linear interpolation of a finer curve."""
    from scipy.interpolate import CubicSpline

    t = np.arange(len(y), dtype=float)
    return np.asarray(np.where(t >= lag, CubicSpline(t, y)(np.maximum(t - lag, 0.0)), y[0]), float)


# -- static ------------------------------------------------------------------------------------------------------------
def _static(rng: np.random.Generator, fault: str, error: str) -> Problem:
    built = static._beam(rng, 0.0) if rng.random() < 0.7 else static._plate(rng, 0.0)
    patches, frames = bool(rng.random() < 0.5), int(rng.choice([1, 20]))
    strains = bool(rng.random() < 0.5)
    dims = len(built.lengths)
    if patches:
        count = int(rng.integers(10, 21))
        grid = (int(rng.integers(10, 25)),) if dims == 1 else (4, 4)
    else:
        n = int(rng.integers(1, 4))
        count = n + int(rng.integers(2, 6))
    places = _apart(rng, count, dims)
    size = rng.uniform(0.01, 0.03)
    moved = np.clip(places + (size * rng.standard_normal(places.shape) if error == "place" else 0.0), 0.02, 0.98)
    labels = tuple(f"s{i}" for i in range(count))

    def gauges(at: Array) -> list[Any]:
        return [_gauge(built, strains, p, label) for p, label in zip(at, labels, strict=True)]

    if patches:
        basis, fine = static._patches(built, grid, built.coarse), tuple(4 * g for g in grid)
        kind = int(rng.choice([0, 1, 2, 3, 8, 9]))
        pieces = [static.shape(kind, rng)[0] for _ in grid]
        one = np.prod([np.ravel(f(s)) for f, s in zip(pieces, static._cells(fine), strict=True)], axis=0)
        load = 1e3 * rng.uniform(0.5, 2, (frames, 1)) * one
        true = ForwardModel(built.fine, gauges(moved), static._patches(built, fine, built.fine)).static()
        truth = np.stack([static._coarse(g, grid, 4) for g in load])
        model, penalty = ForwardModel(built.coarse, gauges(places), basis), str(rng.choice(["gradient", "laplacian"]))
    else:
        at = _apart(rng, n + 1, dims)
        real = at.copy()
        if fault == "load elsewhere":
            real[0] = at[0] + rng.choice([-1, 1]) * rng.uniform(0.15, 0.25) * np.where(at[0] > 0.5, 1, -1)
            real[0] = np.clip(real[0], 0.1, 0.9)
        believed = [loads.Point(at=_at(p, built.lengths), direction="+Z", label=f"F{k}") for k, p in enumerate(at[:n])]
        acting = real if fault == "missing load" else real[:n]
        points = [loads.Point(at=_at(p, built.lengths), direction="+Z", label=f"F{k}") for k, p in enumerate(acting)]
        load = 1e3 * rng.uniform(0.5, 2, (frames, len(points))) * rng.choice([-1, 1], len(points))
        true = ForwardModel(built.fine, gauges(moved), points).static()
        truth = load[:, :n]
        model, penalty = ForwardModel(built.coarse, gauges(places), believed), None
    clean = load @ true.T
    if error == "gain":
        clean = clean * (1 + size * rng.standard_normal(count))
    sigma = np.full(count, 10 ** rng.uniform(np.log10(0.005), np.log10(0.05)) * float(np.sqrt(np.mean(clean**2))))
    sound = clean + sigma * rng.standard_normal(clean.shape)
    faulty, culprits = spoilt(rng, sound, fault, sigma)
    stated = bool(rng.random() < 0.5)

    def inversion(kept: Sequence[str] | None) -> StaticInversion:
        noise = sigma[: len(kept or labels)] if stated else None
        return StaticInversion(model, penalty=penalty, noise=noise, sensors=kept)

    groups = (
        "patches" if patches else "few loads", "strains" if strains else "displacements", f"{frames} frames",
        f"sigma {'stated' if stated else 'not known'}", "patches" if patches else f"spare {count - n}",
    )  # fmt: skip
    pick: Any = 0 if frames == 1 else slice(None)
    return Problem(inversion, sound[pick], faulty[pick], labels, frozenset(labels[k] for k in culprits), fault,
                   truth[pick], groups)  # fmt: skip


def _apart(rng: np.random.Generator, count: int, dims: int) -> Array:
    """Places in the unit interval or square, one in each of as many stretches of the first axis."""
    places = rng.uniform(0.12, 0.88, (count, dims))
    places[:, 0] = 0.08 + 0.84 * (np.arange(count) + rng.uniform(0.15, 0.85, count)) / count
    return rng.permutation(places, axis=0)


def _at(p: Array, lengths: tuple[float, ...]) -> Any:
    return (
        float(p[0] * lengths[0]) if len(lengths) == 1 else tuple(float(a * b) for a, b in zip(p, lengths, strict=True))
    )


def _gauge(built: Any, strains: bool, p: Array, label: str) -> Any:
    if strains:
        return sensors.StrainGauge(at=_at(p, built.lengths), fibre=built.fibre, label=label)
    return sensors.Displacement(at=_at(p, built.lengths), direction="+Z", label=label)


# -- dynamic -----------------------------------------------------------------------------------------------------------
def _dynamic(rng: np.random.Generator, fault: str, error: str, family: str) -> Problem:
    beam, length, width = bool(rng.random() < 0.7), float(rng.uniform(0.6, 2.0)), float(rng.uniform(0.6, 1.0))
    ratio, draw = float(10 ** rng.uniform(-2.3, -1.5)), int(rng.integers(1 << 30))
    extents = (length,) if beam else (0.5 * length, 0.5 * width * length)
    n, modes = int(rng.integers(1, 3)), int(rng.integers(5, 9))
    count = n + int(rng.integers(2, 6))
    averaged = family == "frequency" and fault != "drift" and bool(rng.random() < 0.5)
    samples = 6000 if averaged else int(np.exp(rng.uniform(np.log(300), np.log(2000))))
    kind = impacts.KINDS[rng.integers(4)]
    kinds = [kind if kind != "mixed" else impacts.KINDS[rng.integers(3)] for _ in range(count)]
    dims, size = len(extents), rng.uniform(0.01, 0.03)
    places, at = _apart(rng, count, dims), rng.uniform(0.15, 0.85, (n + 1, dims))
    moved = places + (size * rng.standard_normal(places.shape) if error == "place" else 0.0)
    acts = at.copy()
    if fault == "load elsewhere":
        acts[0] = np.clip(at[0] + np.where(at[0] > 0.5, -1, 1) * rng.uniform(0.15, 0.25), 0.1, 0.9)
    acts = acts if fault == "missing load" else acts[:n]

    def points(where: Array) -> list[Any]:
        return [loads.Point(at=_at(p, extents), direction="+Z", label=f"F{k}") for k, p in enumerate(where)]

    def gauges(where: Array) -> list[Any]:
        return [impacts._sensor(k, _at(p, extents), f"s{i}") for i, (k, p) in enumerate(zip(kinds, where, strict=True))]

    def structure(fine: bool) -> Any:
        return impacts._structure(np.random.default_rng(draw), fine, beam, length, width, ratio)

    model = ForwardModel(structure(False), gauges(places), points(at[:n]), modes=modes)
    truth = ForwardModel(structure(True), gauges(moved), points(acts), modes=2 * modes)
    dt = 1 / (3.0 * float(model.modes.frequencies[-1]))
    hits = "none" if not averaged and rng.random() < 0.6 else "random"
    fine = 10 ** rng.uniform(1, 4) * np.column_stack([impacts._history(rng, samples, hits) for _ in acts])
    stretch = 1 + (0.01 * rng.standard_normal() if error == "frequency" else 0.0)
    clean = impacts._sampled(np.asarray(truth.predict(fine, dt * stretch / impacts.FINER)))
    if error == "gain":
        clean = clean * (1 + size * rng.standard_normal(count))
    sigma = 10 ** rng.uniform(np.log10(0.005), np.log10(0.05)) * np.sqrt(np.mean(clean**2, axis=0))
    sound = clean + sigma * rng.standard_normal(clean.shape)
    faulty, culprits = spoilt(rng, sound, fault, sigma)
    labels, stated = tuple(f"s{i}" for i in range(count)), bool(rng.random() < 0.5)

    def record(values: Array) -> Record:
        return Record(values, dt, list(model.sensors))

    def inversion(kept: Sequence[str] | None) -> Any:
        noise = sigma[[labels.index(k) for k in kept or labels]] if stated else None
        if family == "deconvolution":
            return Deconvolution(model, noise=noise, sensors=kept)
        signal = Signal("stationary", segment=1024) if averaged else "transient"
        return FrequencyInversion(model, noise=noise, sensors=kept, signal=signal)

    load = fine[:: impacts.FINER, :n]
    if averaged:
        load = np.mean(np.abs(load) ** 2, axis=0)  # the band is compared by its total
    groups = ("beam" if beam else "plate", kind, f"sigma {'stated' if stated else 'not known'}", f"spare {count - n}",
              "impacts" if hits == "none" else "random", "averaged" if averaged else "in time",
              f"{n} loads")  # fmt: skip
    return Problem(inversion, record(sound), record(faulty), labels, frozenset(labels[k] for k in culprits), fault,
                   load, groups)  # fmt: skip


def problem(seed: int, fault: str = "none", family: str = "static", error: str = "none") -> Problem:
    """Problem number `seed`."""
    known = STATIC if family == "static" else DYNAMIC
    rng = np.random.default_rng([seed, FAMILIES.index(family), ERRORS.index(error), 0 if fault == "any" else 1])
    if fault == "any":
        fault = str(rng.choice([f for f in known[1:] if f not in UNNAMED]))
    return _static(rng, fault, error) if family == "static" else _dynamic(rng, fault, error, family)


# -- scores ------------------------------------------------------------------------------------------------------------
def _off(estimate: LoadEstimate, truth: Array) -> float:
    load = np.asarray(estimate.load)
    if estimate.axis is not None and estimate.axis.name == "frequency":
        load = np.sum(load, axis=0) * estimate.axis.step
    return float(np.linalg.norm(load - truth) / np.linalg.norm(truth))


def scored(given: Problem, *, corrected: bool = True) -> Found:
    """What an estimate says of the sensors, and the load after what it says was corrected."""
    estimate = given.inversion(None).estimate(given.faulty)
    fault = estimate.faults[0] if estimate.faults else None
    said = "" if fault is None else fault.kind
    who = frozenset() if fault is None else frozenset(fault.channels)
    named = who == given.culprits and (said != "one of") and bool(said or not given.culprits)
    wanted = SAID.get(given.fault, given.fault)
    alike = {wanted, *(("gain", "unit") if wanted in ("gain", "unit") else ())}
    kind = said in alike if given.fault != "none" else not said
    errors = [np.nan] * 3
    if corrected and given.culprits:
        errors[0] = _off(given.inversion(None).estimate(given.sound), given.truth)
        errors[1] = _off(estimate, given.truth)
        if named and fault is not None:
            if fault.correctable:
                again = given.inversion(None).estimate(fault.correct(given.faulty, sensors=given.labels))
            else:
                kept = list(fault.kept)
                found = given.faulty
                if not isinstance(found, Record):
                    found = found[..., [given.labels.index(k) for k in kept]]
                again = given.inversion(kept).estimate(found)
            errors[2] = _off(again, given.truth)
    tested = not given.culprits & set(estimate.facts.untested_sensors or ())
    return Found(given.groups, given.fault, said, named, kind, tested, *errors)


def run(
    problems: int, seed: int, error: str = "none", *, fault: str = "any", family: str = "static", corrected: bool = True
) -> Iterator[Found | str]:
    """Score of each problem, or why it was refused."""
    for number in range(problems):
        given = problem(seed * 100_000 + number, fault, family, error)
        try:
            yield scored(given, corrected=corrected)
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]


def table(given: Sequence[Found | str], told: Callable[[str], None] = print) -> None:
    """Print the share of sensors and kinds named right, and the errors, of all, each fault and each group.

    *tested*: share of the problems whose sensor at fault is determined by the others, as the answer says, and the share
    of the sensors named among these.
    """
    found = [f for f in given if isinstance(f, Found)]
    told(f"refused: {counts(f for f in given if isinstance(f, str))}")
    told(f"{'':22s}    n   said sensor  kind  tested sensor    clean  faulty corrected /clean  <1.3  what is said")
    for name in ("all", *sorted({f.fault for f in found}), *sorted({g for f in found for g in f.groups})):
        some = [f for f in found if name in ("all", f.fault) or name in f.groups]
        tested = [f.named for f in some if f.tested]
        ratio = np.array([f.corrected / f.clean for f in some if np.isfinite(f.corrected)])
        clean, faulty, after = (
            np.nanmedian([getattr(f, k) for f in some] or [np.nan]) for k in ("clean", "faulty", "corrected")
        )
        told(f"{name:22s} {len(some):4d}  {np.mean([bool(f.said) for f in some]):5.0%}"
             f" {np.mean([f.named for f in some]):6.0%} {np.mean([f.kind for f in some]):5.0%}"
             f"  {len(tested):6d} {np.mean(tested) if tested else np.nan:6.0%}   {clean:6.3f}"
             f" {faulty:7.3f} {after:9.3f} {np.median(ratio) if len(ratio) else np.nan:6.2f}"
             f" {np.mean(ratio <= 1.3) if len(ratio) else np.nan:5.0%}  "
             + counts(f.said or "nothing" for f in some))  # fmt: skip
