"""What the gate of a tracker costs and saves: `python -m tests.benchmarks.gate [CAMPAIGNS] [SEED]`; 1 where it loses.

CAMPAIGNS (50) random campaigns from SEED (0) on: a shear building, a beam or a plate, one to four accelerometers,
displacements and strain gauges, noise of 0.5 to 5 %, an exact model, a truth that is ten times finer than its record.
The tracker is fitted to one record and follows another: with a load of the same kind, or, in every other campaign, of
another one (fitted to a quiet structure that is then hit, pushed or struck many times). Relative load error with the
default gate and with none, their ratio, events taken up, channel samples kept out, guards of the gate. Then the same
record with 5 and 0.5 mg on one accelerometer that were not there at the fit. About three minutes. Worse is where the
default has more than 1.5 times the error without a gate on the clean record; offsets are shown beside it.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import LoadTracker
from loadid._families.tracking.tracker import Tracker
from loadid.settings import Noise
from structures import ForwardModel, beams, chains, loads, plates, sensors

Array = NDArray[np.float64]
SAMPLES, FINE = 800, 10
KINDS = ("walk", "random", "slow", "harmonic", "impacts", "steps", "one impact")
WORSE = 1.5  # times the error without a gate that the default may have
OFFSETS = (0.049, 0.0049)  # m/s^2: 5 and 0.5 mg
GUARDS = ("LID-W521", "LID-W526", "LID-W527")
write = sys.stdout.write


@dataclass(frozen=True, eq=False)
class Campaign:
    """A model, the record of its fit, and another record with its load (samples, 1)."""

    structure: str
    model: ForwardModel
    dt: float
    noise: Array
    stated: bool  # the noise, at the fit
    kinds: tuple[str, str]  # of the loads of both records
    fit: Array
    record: Array
    load: Array

    def tracker(self) -> Tracker:
        """Fitted with default settings."""
        known: dict[str, Any] = {"noise": Noise(self.noise, source="data sheet")} if self.stated else {}
        return LoadTracker(self.model, **known).fit(self.fit, self.dt)

    def offset(self, size: float) -> Array | None:
        """The second record with an offset (m/s^2) on its first accelerometer; None where there is none."""
        found = [i for i, s in enumerate(self.model.sensors) if s.quantity == "acceleration"]
        return self.record + size * (np.arange(self.record.shape[1]) == found[0]) if found else None


def campaign(seed: int) -> Campaign:
    """One draw."""
    rng = np.random.default_rng([2024, seed])
    words, model = structure(rng)
    dt = float(rng.uniform(0.2, 0.4) / np.max(model.natural_frequencies))
    first = second = str(rng.choice(KINDS))
    quiet = 1.0
    if seed % 2:
        first, second = str(rng.choice(["random", "walk"])), str(rng.choice(["impacts", "one impact", "steps"]))
        quiet = float(10 ** rng.uniform(-1.5, 0))
    size = float(10 ** rng.uniform(0, 3))
    forces = quiet * size * force(first, rng), size * force(second, rng)
    clean = [model.predict(p[:, None], dt / FINE, "foh")[::FINE] for p in forces]
    noise = 10 ** rng.uniform(-2.3, -1.3) * np.sqrt(np.mean(clean[0] ** 2, axis=0))
    fit, record = (c + noise * rng.standard_normal(c.shape) for c in clean)
    stated = bool(rng.random() < 0.5)
    return Campaign(words, model, dt, noise, stated, (first, second), fit, record, forces[1][::FINE, None])


def structure(rng: np.random.Generator) -> tuple[str, ForwardModel]:
    """A structure in words and as a model, with one load and one to four sensors."""
    kind, zeta, count = str(rng.choice(["chain", "beam", "plate"])), float(rng.uniform(0.005, 0.03)), rng.integers(1, 5)
    kinds = [str(k) for k in rng.choice(["a", "d", "s"], count, p=[0.5, 0.25, 0.25])]
    if kind == "chain":
        n = int(rng.integers(3, 9))
        k = float(10 ** rng.uniform(2, 5))
        made = chains.shear_building(masses=[1.0] * n, stiffnesses=rng.uniform(0.7, 1.3, n) * k, damping=zeta)
        dofs = [f"{i}+X" for i in rng.choice(np.arange(1, n + 1), min(count, n), replace=False)]
        rows: list[Any] = [
            sensors.Accelerometer(d, label=f"a{d}") if k == "a" else sensors.Displacement(d, label=f"d{d}")
            for k, d in zip(kinds, dofs, strict=False)
        ]
        return f"chain of {n}", ForwardModel(made, rows, [loads.Point(f"{rng.integers(1, n + 1)}+X")])
    if kind == "beam":
        length, ends = float(rng.uniform(0.5, 5)), str(rng.choice(["cantilever", "clamped", "simply_supported"]))
        section = beams.Section.rectangle(width=0.05, height=length / float(rng.uniform(60, 200)))
        made = getattr(beams, ends)(
            length=length, section=section, material=beams.materials.steel, elements=30, damping=zeta
        )
        places: list[Any] = [float(x) * length for x in rng.uniform(0.15, 0.85, count + 1)]
        fibre, words, modes = section.c, ends.replace("_", " "), int(rng.integers(4, 9))
    else:
        a, b = (float(x) for x in rng.uniform(0.3, 1.5, 2))
        thick, edges = min(a, b) / float(rng.uniform(60, 200)), str(rng.choice(["SSSS", "CCCC", "CFFF", "CFCF"]))
        made = plates.plate(
            lengths=(a, b), thickness=thick, material=beams.materials.steel, elements=(8, 8), edges=edges, damping=zeta
        )
        places = [(float(x) * a, float(y) * b) for x, y in rng.uniform(0.2, 0.8, (count + 1, 2))]
        fibre, words, modes = thick / 2, f"plate {edges}", int(rng.integers(4, 9))
    rows = [
        sensor(kind, f"{kind}{i}", place, fibre) for i, (kind, place) in enumerate(zip(kinds, places, strict=False))
    ]
    at = places[-1] if rng.random() < 0.5 else places[0]  # the first sensor beside the load, or none
    return words, ForwardModel(made, rows, [loads.Point(at=at)], modes=modes)


def sensor(kind: str, label: str, place: Any, fibre: float) -> Any:
    """Of a kind, at a place of a beam or a plate."""
    if kind == "s":
        return sensors.StrainGauge(at=place, fibre=fibre, label=label)
    return (sensors.Accelerometer if kind == "a" else sensors.Displacement)(at=place, label=label)


def force(kind: str, rng: np.random.Generator) -> Array:
    """Force of unit size (FINE SAMPLES,), zero at first."""
    k = np.arange(SAMPLES * FINE) / FINE
    start = 0.5 - 0.5 * np.cos(np.pi * np.clip((k - 20) / 20, 0, 1))
    out = np.zeros(len(k))
    if kind in ("walk", "random"):
        from scipy.signal import lfilter

        length = rng.uniform(100, 400) if kind == "walk" else rng.uniform(2, 20)
        keep = np.exp(-1 / (length * FINE))
        out = lfilter([1], [1, -keep], rng.standard_normal(len(k)))
        soft = np.exp(-1 / (rng.uniform(0.5, 2) * FINE))
        out = lfilter([1 - soft], [1, -soft], out)
        return start * out / out.std()
    if kind == "slow":
        for _ in range(rng.integers(1, 4)):
            at, long = rng.uniform(30, 500), rng.uniform(100, 300)
            out += rng.uniform(0.3, 1) * np.sin(np.pi * np.clip((k - at) / long, 0, 1)) ** 2
    elif kind == "harmonic":
        for _ in range(rng.integers(1, 4)):
            out += start * rng.uniform(0.3, 1) * np.sin(2 * np.pi * k / rng.uniform(8, 150) + rng.uniform(0, 6))
    elif kind == "steps":
        for _ in range(rng.integers(1, 7)):
            out += rng.uniform(-1, 1) * (k >= rng.uniform(30, SAMPLES - 30))
    else:
        first, many = (0.6 * SAMPLES, 1) if kind == "one impact" else (30, rng.integers(1, 25))
        for at in rng.uniform(first, SAMPLES - 50, many):
            out += 10 ** rng.uniform(-0.7, 0) * np.sin(np.pi * np.clip((k - at) / rng.uniform(1.5, 10), 0, 1))
    return out


@dataclass(frozen=True)
class Outcome:
    """Relative load errors with the default gate and with none, and what the default says."""

    error: float
    without: float
    events: int
    out: int
    alarms: tuple[str, ...]

    @property
    def ratio(self) -> float:
        return self.error / self.without

    def __str__(self) -> str:
        alarms = ",".join(code.removeprefix("LID-") for code in self.alarms) or "-"
        return f"{self.error:9.3g}{self.without:9.3g}{self.ratio:7.2f}{self.events:5d}{self.out:6d} {alarms:10s}"


def followed(tracker: Tracker, record: Array, load: Array) -> Outcome:
    """A record with its load (samples, 1), from rest."""
    gated, deaf = Tracker(tracker.fitted, tracker.gate), Tracker(tracker.fitted, None)
    found = gated.track(record)
    error, without = (float(np.linalg.norm(x - load) / np.linalg.norm(load)) for x in (found.load, deaf.run(record)[0]))
    alarms = tuple(flag.code for flag in found.flags if flag.code in GUARDS)
    return Outcome(error, without, gated.counts["steps"], gated.counts["gated"], alarms)


def main(arguments: list[str]) -> int:
    """Print the table; 1 where the default is worse."""
    given = [int(a) for a in arguments] + [50, 0][len(arguments) :]
    seeds, worse, ratios = range(given[1], given[1] + given[0]), [], []
    columns = f"{'error':>9s}{'no gate':>9s}{'ratio':>7s}{'ev.':>5s}{'out':>6s} {'alarms':10s}"
    write(f"seed structure        sensors load of the fit > tracked  {columns} | 5 mg {columns} | 0.5 mg {columns}\n")
    for seed in seeds:
        c = campaign(seed)
        tracker = c.tracker()
        clean = followed(tracker, c.record, c.load)
        kinds = "".join(s.quantity[0] for s in c.model.sensors)
        line = f"{seed:4d} {c.structure:16s} {kinds:7s} {c.kinds[0]:>12s} > {c.kinds[1]:12s} {clean}"
        for size in OFFSETS:
            record = c.offset(size)
            line += " | " + ("" if record is None else str(followed(tracker, record, c.load)))
        ratios.append(clean.ratio)
        worse += [seed] * (clean.ratio > WORSE)
        write(line + "\n")
    mean = float(np.exp(np.mean(np.log(ratios))))
    write(f"ratio: largest {max(ratios):.2f}, smallest {min(ratios):.2f}, geometric mean {mean:.3f}\n")
    write(f"worse than {WORSE}: {', '.join(map(str, worse)) or 'none'}\n")
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
