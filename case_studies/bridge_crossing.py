"""A vehicle crosses a bridge: its load followed online from strains and accelerations, without its speed or its weight.

The tracker's load places are fixed, and the vehicle is not: a load that moves has an input matrix that changes with
time, which only batch inversion of a known path can take (`Deconvolution` with `loads.MovingPoint`). Online, neither
speed nor lane is known. So the load is tracked as nodal forces at fixed places, between which the axle shares itself;
their sum is the weight on the bridge, their centre the axle's place. What this costs is the difference between an axle
and its two neighbours, which is largest midway between places and near the supports, where part of the axle rests on
the support and no sensor sees it.

The forces of neighbouring places are known together far better than each alone: the std of their sum (`combined_std`)
is a sixth of the sum of their stds. That band speaks of noise and prior; the fixed places are an error of the model,
which it does not know of: it covers the weight in 82 of 100 samples, not 95. The sum of the stds covers all of them.

Set-up of our own: a simply supported girder of 30 m (first frequency 4 Hz, 1 % damping); an axle of 100 kN at 15 m/s,
pulsing by 8 % at 1.8 Hz; five strains of the lower flange, three accelerometers, 1 % noise, 200 Hz. The truth has
twenty modes, runs between the samples, and the axle moves continuously; the tracker has eight modes and five places.
The prior of each place: it is loaded for as long as the slowest vehicle needs from place to place.

Run ``python -m case_studies.bridge_crossing``: prints the figures and saves ``bridge_crossing.png``.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from loadid import LoadEstimate, LoadTracker, Noise
from loadid._inverse.gaussian.steady import combined_std
from loadid.priors import Matern32
from structures import ForwardModel, beams, damping, loads, sensors

LENGTH, SPEED, WEIGHT, PULSE, BEAT = 30.0, 15.0, 100e3, 0.08, 1.8
PLACES = LENGTH * np.arange(1, 6) / 6
DT, FINE, LEAD, SAMPLES = 1 / 200, 10, 0.5, 700  # seconds before the vehicle enters; 3.5 s in all
NOISE = 0.01
Array = NDArray[np.float64]


def bridge() -> Any:
    """The girder: a box of steel with the mass of its deck."""
    section = beams.Section(A=0.12, I=0.065, c=0.9)
    material = beams.materials.Material(E=210e9, rho=22_000.0, nu=0.3)
    return beams.simply_supported(
        length=LENGTH, section=section, material=material, elements=60, damping=damping.Modal(0.01)
    )


def layout() -> list[Any]:
    """Five strains of the lower flange and three accelerometers."""
    rows: list[Any] = [sensors.StrainGauge(at=float(x), fibre=-0.9, label=f"strain {x:g} m") for x in PLACES]
    return rows + [sensors.Accelerometer(at=LENGTH * k / 4, label=f"acc {LENGTH * k / 4:g} m") for k in (1, 2, 3)]


def model() -> ForwardModel:
    """What is tracked: forces at the fixed places, downwards."""
    places = [loads.Point(at=float(x), direction="-Z", label=f"{x:g} m") for x in PLACES]
    return ForwardModel(bridge(), layout(), places, modes=8)


@dataclass(frozen=True, eq=False)
class Crossing:
    """Record (samples, sensors) and its noise std; axle load (N) and place (m) of every sample, NaN off the bridge."""

    record: Array
    noise: Array
    axle: Array
    place: Array

    @property
    def t(self) -> Array:
        """Seconds."""
        return np.arange(len(self.record)) * DT


def crossing(seed: int = 0, speed: float = SPEED) -> Crossing:
    """One vehicle, ten times finer than it is sampled."""
    t = np.arange(SAMPLES * FINE) * DT / FINE
    place = speed * (t - LEAD)
    axle = WEIGHT * (1 + PULSE * np.sin(2 * np.pi * BEAT * t))
    on = (place > 0) & (place < LENGTH)
    moving = loads.MovingPoint(place, direction="-Z", outside="zero", label="axle")
    whole = ForwardModel(bridge(), layout(), [moving], modes=20)
    clean = whole.predict(np.where(on, axle, 0.0)[:, None], DT / FINE)[::FINE]
    kinds = np.r_[np.zeros(5, int), np.ones(3, int)]
    noise = NOISE * np.array([clean[:, kinds == k].std() for k in kinds])
    record = clean + noise * np.random.default_rng(seed).standard_normal(clean.shape)
    return Crossing(record, noise, np.where(on, axle, np.nan)[::FINE], np.where(on, place, np.nan)[::FINE])


@dataclass(frozen=True, eq=False)
class Followed:
    """The track of a crossing, and what is read from it."""

    true: Crossing
    estimate: LoadEstimate
    total_std: float  # of the weight on the bridge where the tracker is settled, N: noise and prior

    @property
    def total(self) -> Array:
        """Weight on the bridge (samples,), N."""
        return self.estimate.load.sum(axis=1)

    @property
    def total_bound(self) -> Array:
        """Bound of its std (samples,), as if the places were wrong together."""
        assert self.estimate.std is not None
        return np.asarray(self.estimate.std.sum(axis=1))

    @property
    def place(self) -> Array:
        """Centre of the forces (samples,), m; NaN where less than a third of the weight is seen."""
        seen = self.total > WEIGHT / 3
        return np.where(seen, self.estimate.load @ PLACES / np.where(seen, self.total, 1.0), np.nan)

    @property
    def middle(self) -> NDArray[np.bool_]:
        """Samples at which the axle stands between the first and the last place."""
        return (self.true.place > PLACES[0]) & (self.true.place < PLACES[-1])

    def figures(self) -> dict[str, float]:
        """Errors while the axle is between the outer places."""
        on = self.middle
        away = (self.total - self.true.axle)[on]
        off = (self.place - self.true.place)[on]
        slope = np.polyfit(self.true.t[on], self.place[on], 1)[0]
        return {
            "weight, relative error": float(np.linalg.norm(away) / np.linalg.norm(self.true.axle[on])),
            "weight, mean over the crossing, relative error": float(abs(np.mean(away)) / WEIGHT),
            "weight inside its 95 % band": float(np.mean(np.abs(away) < 1.96 * self.total_std)),
            "weight inside the sum of the bands": float(np.mean(np.abs(away) < 1.96 * self.total_bound[on])),
            "std of the weight over the sum of the stds": float(self.total_std / np.mean(self.total_bound[on])),
            "place, rms error in m": float(np.sqrt(np.mean(off**2))),
            "speed, relative error": float(abs(slope / np.diff(self.true.place[on]).mean() * DT - 1)),
            "weight before and after, over the axle": float(
                np.max(np.abs(self.total[np.isnan(self.true.place)])) / WEIGHT
            ),
        }


def follow(true: Crossing) -> Followed:
    """Fit to the crossing and follow it sample by sample, as a stream would be."""
    stay = float(np.diff(PLACES)[0]) / SPEED
    tracker = LoadTracker(
        model(), prior=Matern32(WEIGHT, stay), noise=Noise(true.noise, source="data sheet")
    ).fit(true.record, DT)  # fmt: skip
    assert tracker.fitted.settled is not None
    total = combined_std(tracker.fitted.settled, np.ones(len(PLACES)))
    return Followed(true, tracker.track(true.record), float(total[0]))


def show(found: Followed) -> str:
    """Figures as text."""
    lines = [f"{name:50s}{value:9.4f}" for name, value in found.figures().items()]
    return "\n".join([*lines, f"flags: {', '.join(sorted(found.estimate.codes)) or 'none'}"])


def picture(found: Followed, path: Path) -> None:
    """Forces of the places, weight and place over time."""
    from matplotlib.figure import Figure

    true, t, std = found.true, found.true.t, found.estimate.std
    assert std is not None
    figure = Figure(figsize=(10, 8), layout="constrained")
    axes = figure.subplots(3, 1, sharex=True)
    for j, x in enumerate(PLACES):
        p = found.estimate.load[:, j] / 1e3
        axes[0].fill_between(t, p - 1.96 * std[:, j] / 1e3, p + 1.96 * std[:, j] / 1e3, color=f"C{j}", alpha=0.2, lw=0)
        axes[0].plot(t, p, color=f"C{j}", lw=1, label=f"{x:g} m")
    axes[0].set_ylabel("force [kN]")
    axes[0].set_title("nodal forces at the fixed places, 95 % bands", loc="left", fontsize=9)
    axes[0].legend(ncols=5, fontsize=8, loc="upper right")
    total, bound, half = found.total / 1e3, 1.96 * found.total_bound / 1e3, 1.96 * found.total_std / 1e3
    axes[1].fill_between(t, total - bound, total + bound, color="C0", alpha=0.2, lw=0, label="sum of the bands")
    axes[1].fill_between(t, total - half, total + half, color="C0", alpha=0.5, lw=0, label="95 % band of the sum")
    axes[1].plot(t, total, color="C0", lw=1, label="tracked")
    axes[1].plot(t, true.axle / 1e3, "k--", lw=1, label="axle")
    axes[1].set_ylabel("weight on the bridge [kN]")
    axes[1].legend(fontsize=8, loc="upper right")
    axes[2].plot(t, found.place, color="C0", lw=1, label="centre of the tracked forces")
    axes[2].plot(t, true.place, "k--", lw=1, label="axle")
    axes[2].set(xlabel="time [s]", ylabel="place [m]", xlim=(0, t[-1]), ylim=(0, LENGTH))
    axes[2].legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=130)


def main() -> None:
    """Print the figures and save the picture."""
    found = follow(crossing())
    sys.stdout.write(show(found) + "\n")
    target = Path("bridge_crossing.png")
    picture(found, target)
    sys.stdout.write(f"picture: {target}\n")


if __name__ == "__main__":
    main()
