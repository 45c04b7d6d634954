"""Loads in service, sample by sample.

Beams, plates and chains, 2 to 6 sensors (acceleration, strain, displacement, mixed), 1 or 2 loads (slow, random,
harmonic, impacts), noise of 0.5 to 5 %. A tracker is fitted to one record and follows another of the same structure.
The truth has a finer mesh, twice the modes and a step ten times finer, and is sampled behind an anti-alias filter
without phase. `error` adds what the model does not know (stiffness, damping) or what happens to one sensor in service;
with "exact" the truth has the modes of the model and no others.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from loadid import LoadTracker
from loadid._families.tracking.tracker import Tracker
from structures import ForwardModel, chains, loads, sensors
from structures.errors import InputError, NotIdentifiable

from .impacts import FINER, KINDS, _place, _sampled, _sensor, _structure
from .scores import Z95, Array, counts

MODELS = ("none", "exact", "stiffness", "damping")
FAULTS = ("offset", "drift", "stuck", "swapped", "dead", "spikes")
ERRORS = MODELS + FAULTS
LOADS = ("slow", "random", "harmonic", "impacts")
SAMPLES, BEGIN, SOON = 1000, 400, 200  # of each record; at which a fault begins; within which it is to be named


@dataclass(frozen=True, eq=False)
class Service:
    """Two records of one structure, and what is true of the second.

    Parameters
    ----------
    model : ForwardModel
    dt : float
    fit, record : array (samples, sensors)
    clean : array (samples, sensors)
        The second record without the fault.
    sigma : array (sensors,)
    stated : bool
    truth : array (samples, loads)
    wrong : tuple of int
        Channels that have the fault.
    groups : tuple of str
    """

    model: ForwardModel
    dt: float
    fit: Array
    record: Array
    clean: Array
    sigma: Array
    stated: bool
    truth: Array
    wrong: tuple[int, ...]
    groups: tuple[str, ...]

    def tracker(self, **settings: Any) -> Tracker:
        """Fitted as the user does."""
        return LoadTracker(self.model, **{"noise": self.sigma if self.stated else None} | settings).fit(
            self.fit, self.dt
        )


def history(rng: np.random.Generator, kind: str, samples: int, machine: int) -> Array:
    """One load on the fine clock (FINER * samples,), of unit size, from rest; a `machine` has its own frequencies."""
    t = np.arange(FINER * samples) / FINER
    start = 0.5 - 0.5 * np.cos(np.pi * np.clip(t / 40, 0, 1))
    if kind == "slow":
        waves = [(rng.uniform(0.3, 1), rng.uniform(100, 600), rng.uniform(0, 6)) for _ in range(3)]
        return np.asarray(start * sum(a * np.sin(2 * np.pi * t / long + at) for a, long, at in waves))
    if kind == "harmonic":
        own = np.random.default_rng(machine)
        waves = [(rng.uniform(0.8, 1) * own.uniform(0.4, 1), own.uniform(10, 100), rng.uniform(0, 6)) for _ in "ab"]
        return np.asarray(start * sum(a * np.sin(2 * np.pi * t / long + at) for a, long, at in waves))
    if kind == "random":
        knots = np.arange(0, samples + 4, 4)
        return np.asarray(start * np.interp(t, knots, rng.standard_normal(len(knots))))
    load = np.zeros(len(t))
    for at in rng.uniform(20, samples - 20, samples // 60):
        width = rng.uniform(6, 20)
        inside = (t >= at) & (t < at + width)
        load[inside] += rng.uniform(0.3, 1) * np.sin(np.pi * (t[inside] - at) / width)
    return load


def chain(rng: np.random.Generator, ratio: float, stiffness: float = 1.0) -> Any:
    """A shear building; draws the same from any generator in the same state."""
    n = int(rng.integers(4, 10))
    return chains.shear_building(
        masses=[1.0] * n, stiffnesses=stiffness * rng.uniform(0.7, 1.3, n) * 10 ** rng.uniform(2, 5), damping=ratio
    )


def service(seed: int, error: str = "none") -> Service:
    """Problem number `seed` with one of `ERRORS`."""
    rng = np.random.default_rng([seed, 7])
    kind, ratio = str(rng.choice(["beam", "plate", "chain"])), float(10 ** rng.uniform(-2.3, -1.5))
    length, width, draw = float(rng.uniform(0.6, 2.0)), float(rng.uniform(0.6, 1.0)), int(rng.integers(1 << 30))
    off = 1 + (rng.choice([-1, 1]) * rng.uniform(0.01, 0.05))  # of the stiffness, where it is wrong
    true_ratio = 2 * ratio if error == "damping" else ratio

    def structure(fine: bool, ratio: float) -> Any:
        own = np.random.default_rng(draw)
        return chain(own, ratio) if kind == "chain" else _structure(own, fine, kind == "beam", length, width, ratio)

    measured = KINDS[rng.integers(4)]
    count = int(rng.integers(2, 7))
    kinds = [measured if measured != "mixed" else KINDS[rng.integers(3)] for _ in range(count)]
    p = int(rng.integers(1, 3))
    believed = structure(False, ratio)
    if kind == "chain":
        n = int(np.random.default_rng(draw).integers(4, 10))
        kinds = ["displacement" if k == "strain" else k for k in kinds]
        dofs = [f"{i}+X" for i in rng.permutation(np.arange(1, n + 1))]
        kinds = kinds[: len(dofs)]
        rows: list[Any] = [
            (sensors.Accelerometer if k == "acceleration" else sensors.Displacement)(d, label=f"s{i}")
            for i, (k, d) in enumerate(zip(kinds, dofs, strict=False))
        ]
        points = [loads.Point(dofs[int(j)], label=f"F{j}") for j in rng.permutation(len(dofs))[:p]]
        modes = max(3, n - int(rng.integers(0, 3)))
        model = ForwardModel(believed, rows, points, modes=modes)
        true = model if error == "exact" else ForwardModel(structure(True, true_ratio), rows, points)
    else:
        extents = (length,) if kind == "beam" else (0.5 * length, 0.5 * width * length)
        places = rng.uniform(0.12, 0.88, (count, len(extents)))
        points = [loads.Point(at=_place(x, extents), direction="+Z", label=f"F{j}")
                  for j, x in enumerate(rng.uniform(0.15, 0.85, (p, len(extents))))]  # fmt: skip
        rows = [_sensor(k, _place(x, extents), f"s{i}") for i, (k, x) in enumerate(zip(kinds, places, strict=True))]
        modes = int(rng.integers(4, 9))
        model = ForwardModel(believed, rows, points, modes=modes)
        finer = ForwardModel(structure(True, true_ratio), rows, points, modes=2 * modes)
        true = model if error == "exact" else finer
    acting = [LOADS[rng.integers(4)] for _ in range(p)]
    size = 10 ** rng.uniform(0, 3)
    fine = [size * np.column_stack([history(rng, k, SAMPLES, draw + j) for j, k in enumerate(acting)]) for _ in "ab"]
    dt = 1 / (4.0 * float(model.modes.frequencies[-1]))
    stretch = np.sqrt(off) if error == "stiffness" else 1.0  # a slower clock is a softer structure
    inertia = np.array([1.0 if k == "acceleration" else stretch**-2 for k in kinds])  # static motion of a softer one
    first, second = (_sampled(np.asarray(true.predict(f, dt * stretch / FINER))) * inertia for f in fine)
    sigma = 10 ** rng.uniform(np.log10(0.005), np.log10(0.05)) * np.sqrt(np.mean(first**2, axis=0))
    noisy = [y + sigma * rng.standard_normal(y.shape) for y in (first, second)]
    stated = bool(rng.random() < 0.5)
    record, wrong = faulty(rng, noisy[1], sigma, error if error in FAULTS else "none")
    groups = (kind, measured, f"sigma {'stated' if stated else 'not known'}", f"{p} loads",
              f"{min(len(kinds) - p, 3)} spare", *(f"load {k}" for k in sorted(set(acting))))  # fmt: skip
    return Service(model, dt, noisy[0], record, noisy[1], sigma, stated, fine[1][::FINER], wrong, groups)


def faulty(rng: np.random.Generator, Y: Array, sigma: Array, fault: str) -> tuple[Array, tuple[int, ...]]:
    """A record one channel of which (two, where they are swapped) goes wrong at `BEGIN`; which."""
    Y, m = Y.copy(), Y.shape[1]
    i, j = (int(k) for k in rng.permutation(m)[:2])
    late, rms = Y[BEGIN:], float(np.std(Y[:BEGIN, i]))
    if fault == "offset":
        late[:, i] += rng.choice([-1, 1]) * rng.uniform(0.3, 2.0) * rms
    elif fault == "drift":
        late[:, i] += rng.choice([-1, 1]) * rng.uniform(0.5, 2.0) * rms * np.arange(len(late)) / SOON
    elif fault == "stuck":
        late[:, i] = late[0, i]
    elif fault == "swapped":
        late[:, [i, j]] = late[:, [j, i]]
    elif fault == "dead":
        late[:, i] = sigma[i] * rng.standard_normal(len(late))
    elif fault == "spikes":
        at = rng.random(len(late)) < 0.02
        late[at, i] += rng.choice([-1, 1], at.sum()) * rng.uniform(3, 20, at.sum()) * rms
    return Y, () if fault == "none" else (i, j) if fault == "swapped" else (i,)


# -- scores ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Followed:
    """One record in service beside its truth.

    Parameters
    ----------
    groups : tuple of str
    verdict : str
        Of the certificate.
    codes : frozenset of str
    covered : array (loads,)
        Share of the samples in the 95 % band, from `BEGIN` on.
    error, over, late : float
        Norm of the error over that of the load from `BEGIN` on; over that without the fault, and the same from
        `BEGIN + SOON` on.
    gate : float
        Error over that without a gate.
    width : float
        Rms std over rms error.
    alarmed : float
        Share of the rows from `BEGIN + SOON` on with an alarm.
    named : tuple of (int, str, int)
        Channels that were named, as what, and samples after `BEGIN`.
    wrong : tuple of int
        Channels that were to be named.
    """

    groups: tuple[str, ...]
    verdict: str
    codes: frozenset[str]
    covered: Array
    error: float
    over: float
    late: float
    gate: float
    width: float
    alarmed: float
    named: tuple[tuple[int, str, int], ...]
    wrong: tuple[int, ...]

    @property
    def right(self) -> bool:
        """Some wrong channel is named in time, and no other one."""
        found = {i for i, _, after in self.named if after <= SOON}
        return bool(found & set(self.wrong)) and not {i for i, *_ in self.named} - set(self.wrong)


def followed(given: Service, **settings: Any) -> Followed:
    """Fit, follow, compare."""
    fitted = given.tracker(**settings)
    errors: list[Array] = []
    results: list[tuple[Array, Array]] = []
    runs: list[Tracker] = []
    for gate, record in ((fitted.gate, given.record), (fitted.gate, given.clean), (None, given.record)):
        if results and record is given.record and gate == fitted.gate:
            continue
        run = Tracker(fitted.fitted, gate)
        load, std, *_ = run.run(record)
        results.append((load, std))
        errors.append(load - given.truth)
        runs.append(run)
    part, end = slice(BEGIN, None), slice(BEGIN + SOON, None)
    norm = [float(np.linalg.norm(e[part])) for e in errors]
    late = [float(np.linalg.norm(e[end])) for e in errors]
    std = results[0][1]
    alarms = alarms_of(runs[0])
    return Followed(
        given.groups, "none" if fitted.certificate is None else fitted.certificate.verdict,
        frozenset(f.code.removeprefix("LID-") for f in runs[0].flags),
        np.mean(np.abs(errors[0][part]) <= Z95 * std[part], axis=0),
        norm[0] / float(np.linalg.norm(given.truth[part])), norm[0] / norm[1], late[0] / late[1], norm[0] / norm[2],
        float(np.sqrt(np.mean(std[part] ** 2) / np.mean(errors[0][part] ** 2))),
        float(np.mean(alarms[end] > 0)) if len(alarms) else 0.0, named_in(runs[0]), given.wrong,
    )  # fmt: skip


def alarms_of(run: Tracker) -> Array:
    """Alarm of each row."""
    return run.row_alarms[:, 0]


def named_in(run: Tracker) -> tuple[tuple[int, str, int], ...]:
    """Channels that were named, as what, and samples after `BEGIN`."""
    return tuple((i, f.kind, f.sample - BEGIN) for f in run.faults for i in (f.channel, f.other) if i >= 0)


def run(problems: int, seed: int, error: str = "none", **settings: Any) -> Iterator[Followed | str]:
    """Score of each problem, or why it was refused."""
    for number in range(problems):
        try:
            yield followed(service(seed * 100_000 + number, error), **settings)
        except (InputError, NotIdentifiable) as refused:
            yield f"{getattr(refused, 'code', '')} {refused}".splitlines()[0]


HEADING = (
    f"{'':22s} {'n':>4s}  {'>=.90':>5s} {'<.50':>5s} {'said':>5s}  {'cover':>5s} {'width':>5s}  {'error':>6s} "
    f"{'/clean':>6s} {'90 %':>6s} {'late':>6s} {'90 %':>6s}  {'gate':>5s} {'most':>6s}  {'named':>5s} {'other':>5s} "
    f"{'delay':>5s}  {'alarm':>5s} {'calib':>5s}"
)


def line(name: str, found: Sequence[Followed]) -> str:
    """One row of the table."""
    covered = np.concatenate([f.covered for f in found])
    bad = [f for f in found if f.covered.min() < 0.5]
    good = [f for f in found if f.covered.min() >= 0.9]
    faults = [f for f in found if f.wrong]
    delays = [min(after for i, _, after in f.named if i in f.wrong) for f in found if f.right]

    def of(what: Callable[[Followed], float], at: float) -> float:
        return float(np.quantile([what(f) for f in found], at))

    return (
        f"{name:22s} {len(found):4d}  {np.mean(covered >= 0.9):5.0%} {np.mean(covered < 0.5):5.1%} "
        f"{np.mean([f.alarmed > 0.5 for f in bad]) if bad else np.nan:5.0%}  {np.median(covered):5.2f} "
        f"{of(lambda f: f.width, 0.5):5.2f}  {of(lambda f: f.error, 0.5):6.3f} {of(lambda f: f.over, 0.5):6.2f} "
        f"{of(lambda f: f.over, 0.9):6.2f} {of(lambda f: f.late, 0.5):6.2f} {of(lambda f: f.late, 0.9):6.2f}  "
        f"{of(lambda f: f.gate, 0.5):5.2f} {of(lambda f: f.gate, 1.0):6.2f}  "
        f"{np.mean([f.right for f in faults]) if faults else np.nan:5.0%} "
        f"{np.mean([bool({i for i, *_ in f.named} - set(f.wrong)) for f in found]):5.1%} "
        f"{np.median(delays) if delays else np.nan:5.0f}  {np.mean([f.alarmed > 0.5 for f in found]):5.1%} "
        f"{np.mean([f.verdict == 'calibrated' for f in good]) if good else np.nan:5.0%}"
    )


def table(found: Sequence[Followed], told: Callable[[str], None] = print) -> None:
    """Print all and each group.

    Columns: loads covered in 90 % of the samples or more, and in less than half; of the latter those with an alarm in
    most rows; median coverage; std over rms error; relative error, over that of the clean record (median, 90 %), the
    same 200 samples after the fault began; error over that without a gate (median, largest); the channel was named in
    time and no other; another was named; delay in samples; records with an alarm in most rows; good ones that are
    certified.
    """
    told(HEADING)
    told(line("all", found))
    for group in sorted({g for f in found for g in f.groups}):
        told(line(group, [f for f in found if group in f.groups]))
    told(f"flags: {counts(code for f in found for code in f.codes)}")
