"""The prior picks the method: the same beam under four loads, and every family on each of them.

A simply supported steel beam of 2 m with two accelerometers and a strain gauge, 1 % noise, 400 samples at 500 Hz. The
force is a pair of impacts, a slow push, a harmonic or a random load; the record is made ten times finer than it is
sampled. Every family of the package gets it with its default settings and the noise level, none is tuned to the load.
The table shows the relative error of the force; the prior of each is printed in words, and a method is good where
its prior is true. The last lines are what `recommend` takes from the record alone, run as it says, and how far that is
from the best.

Run ``python -m case_studies.method_map``: prints the table and saves ``method_map.png``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import (
    Deconvolution,
    FrequencyInversion,
    Lambda,
    LoadEstimate,
    LoadTracker,
    Noise,
    SparseDeconvolution,
    recommend,
)
from loadid.constraints import NonNegative
from structures import ForwardModel, beams, damping, loads, sensors

DT, SAMPLES, FINE, NOISE = 2e-3, 400, 10, 0.01
LOADS = ("impact", "slow", "harmonic", "random")
Array = NDArray[np.float64]


@cache
def model(modes: int = 8) -> ForwardModel:
    """The beam, two accelerometers and a strain gauge, the force at 0.65 m."""
    section = beams.Section.rectangle(width=0.05, height=0.01)
    beam = beams.simply_supported(
        length=2.0, section=section, material=beams.materials.steel, elements=40, damping=damping.Modal(0.02)
    )
    rows: list[Any] = [sensors.Accelerometer(at=x, label=f"acc {x:g} m") for x in (0.65, 1.3)]
    rows.append(sensors.StrainGauge(at=1.0, fibre=section.c, length=0.01, label="strain"))
    return ForwardModel(beam, rows, [loads.Point(at=0.65, label="force")], modes=modes)


def force(kind: str, t: Array, seed: int = 0) -> Array:
    """Force (samples,) in N; zero at first."""
    start = 0.5 - 0.5 * np.cos(np.pi * np.clip((t - 0.05) / 0.05, 0, 1))
    if kind == "impact":
        hits = ((0.2, 0.006, 200.0), (0.55, 0.008, 120.0))  # time, duration, height: half sines
        return np.asarray(sum(a * np.sin(np.pi * np.clip((t - at) / long, 0, 1)) for at, long, a in hits))
    if kind == "slow":
        return 60 * np.sin(np.pi * np.clip((t - 0.1) / 0.6, 0, 1)) ** 2
    if kind == "harmonic":
        return 20 * start * np.sin(2 * np.pi * 13 * t)
    rng, dt, length = np.random.default_rng(seed + 100), t[1] - t[0], 0.02
    line = np.fft.rfftfreq(2 * len(t), dt) * 2 * np.pi
    spectrum = (3 / length**2 + line**2) ** -1.0  # root of that of a Matern process of order 3/2
    drawn = np.fft.irfft(spectrum * np.fft.rfft(rng.standard_normal(2 * len(t))))[: len(t)]
    return 20 * start * drawn / drawn.std()


@dataclass(frozen=True, eq=False)
class Case:
    """A record (samples, sensors), its noise std, and the force behind it (samples,)."""

    kind: str
    record: Array
    noise: Array
    force: Array


def case(kind: str, seed: int = 0) -> Case:
    """Record of one load."""
    fine = force(kind, np.arange(SAMPLES * FINE) * DT / FINE, seed)
    clean = model(8).predict(fine[:, None], DT / FINE, "foh")[::FINE]
    noise = NOISE * np.array([clean[:, :2].std()] * 2 + [clean[:, 2].std()])
    record = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    return Case(kind, record, noise, fine[::FINE])


def tracker(smooth: bool, prior: str = "matern32") -> Callable[..., LoadEstimate]:
    """The tracker online, or with what comes later."""

    def run(of: ForwardModel, record: Array, dt: float, **noise: Any) -> LoadEstimate:
        fitted = LoadTracker(of, prior=prior, **noise).fit(record, dt)
        return fitted.smooth(record, dt) if smooth else fitted.track(record, dt)

    return run


def family(kind: Any, **settings: Any) -> Callable[..., LoadEstimate]:
    """A family with its settings."""

    def run(of: ForwardModel, record: Array, dt: float, **noise: Any) -> LoadEstimate:
        estimate: LoadEstimate = kind(of, **settings, **noise).estimate(record, dt)
        return estimate

    return run


METHODS: dict[str, Callable[..., LoadEstimate]] = {
    "FRF inversion": family(FrequencyInversion, signal="transient"),
    "Tikhonov": family(Deconvolution),
    "truncated SVD": family(Deconvolution, choice=Lambda(method="tsvd")),
    "non-negative": family(Deconvolution, constraints=[NonNegative()]),
    "l1, spikes": family(SparseDeconvolution),
    "l1, pulses": family(SparseDeconvolution, dictionary="bspline"),
    "tracker, online": tracker(False),
    "tracker, smoothed": tracker(True),
    "tracker, 5/2 smoothed": tracker(True, "matern52"),
}


@dataclass(frozen=True, eq=False)
class Cell:
    """One method on one load."""

    estimate: LoadEstimate
    error: float
    covered: float

    @property
    def prior(self) -> str:
        """In words."""
        return str(self.estimate.provenance["prior"])


@dataclass(frozen=True, eq=False)
class Column:
    """All methods on one load; what `recommend` takes, in words, and what that gives."""

    case: Case
    cells: dict[str, Cell]
    advice: Any
    recommended: Cell

    @property
    def best(self) -> str:
        """The method with the smallest error."""
        return min(self.cells, key=lambda name: self.cells[name].error)

    @property
    def ratio(self) -> float:
        """Error of what is recommended over the smallest."""
        return self.recommended.error / self.cells[self.best].error


def column(kind: str, seed: int = 0, methods: tuple[str, ...] = tuple(METHODS)) -> Column:
    """All methods on one load."""
    c = case(kind, seed)
    noise = {"noise": Noise(c.noise, source="data sheet")}
    cells = {name: cell(METHODS[name](model(), c.record, DT, **noise), c.force) for name in methods}
    advice = recommend(model(), c.record, DT, **noise)
    return Column(c, cells, advice, cell(advice.estimate(c.record, DT), c.force))


def cell(estimate: LoadEstimate, true: Array) -> Cell:
    """Error of a force, and the share of it inside the 95 % band."""
    load = estimate.load[: len(true), 0]
    covered = float("nan")
    if estimate.std is not None:
        low, high = (b[: len(true), 0] for b in estimate.band())
        covered = float(np.mean((low <= true) & (true <= high)))
    return Cell(estimate, float(np.linalg.norm(load - true) / np.linalg.norm(true)), covered)


def show(columns: list[Column]) -> str:
    """Errors, priors and recommendations as text."""
    lines = [f"{'relative error of the force':28s}" + "".join(f"{c.case.kind:>12s}" for c in columns)]
    for name in columns[0].cells:
        marks = [f"{c.cells[name].error:.4f}{'*' if name == c.best else ' '}" for c in columns]
        lines.append(f"{name:28s}" + "".join(f"{m:>12s}" for m in marks))
    lines.append("recommended" + " " * 17 + "".join(f"{c.recommended.error:>11.4f} " for c in columns))
    lines.append("recommended over best" + " " * 7 + "".join(f"{c.ratio:>11.2f} " for c in columns))
    lines += ["", "share of the force inside the 95 % band"]
    for name in columns[0].cells:
        lines.append(f"{name:28s}" + "".join(f"{c.cells[name].covered:>11.2f} " for c in columns))
    lines += ["", "the priors, on the last load"]
    lines += [f"{name:24s}{found.prior}" for name, found in columns[-1].cells.items()]
    lines += ["", *(f"{c.case.kind}: take {c.advice}" for c in columns)]
    lines += [f"{c.case.kind}: its prior is {c.recommended.prior}" for c in columns]
    return "\n".join(lines)


def picture(columns: list[Column], path: Path) -> None:
    """Every load, with the best method and the worst that is usually taken."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 7), layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    t = np.arange(SAMPLES) * DT
    for ax, c in zip(axes, columns, strict=True):
        shown = dict.fromkeys((c.best, "tracker, online", "Tikhonov"))
        for color, name in zip(("C0", "C1", "C2"), shown, strict=False):
            ax.plot(t, c.cells[name].estimate.load[: len(t), 0], color=color, lw=0.9,
                    label=f"{name}: {c.cells[name].error:.1%}")  # fmt: skip
        ax.plot(t, c.case.force, "k--", lw=0.9, label="true")
        ax.set(title=c.case.kind, xlabel="time [s]", ylabel="force [N]", xlim=(0, t[-1]))
        ax.legend(fontsize=8)
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the table and save the picture."""
    columns = [column(kind) for kind in LOADS]
    sys.stdout.write(show(columns) + "\n")
    target = Path("method_map.png")
    picture(columns, target)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
