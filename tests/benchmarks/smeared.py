"""When Tikhonov smears impacts: the signs that flag W311 asks for. `python -m tests.benchmarks.smeared [seeds]`.

A half sine on a circular plate (after Jacquelin, Bennani & Hamelin, J. Sound Vib. 265 (2003) 81), hits of one sample
and half sines of some samples on a beam behind accelerations and displacements, and a random load; default lambda,
level of the noise known. "Peak" is the largest load over the true one; each number is the range over the seeds.
"""

from __future__ import annotations

import sys

import numpy as np
from numpy.typing import NDArray

from loadid import Deconvolution, Noise
from loadid._families.histories import half_width, kurtosis
from structures import ForwardModel, loads, sensors

from ..guards.test_expected import beam, blows, impact, plate

DT = 1 / 2000
Setting = tuple[ForwardModel, float, NDArray[np.float64]]


def displacements() -> ForwardModel:
    """Two displacements on the beam of the accelerations."""
    seen = [sensors.Displacement(f"{node}+Z") for node in (8, 26)]
    return ForwardModel(beam(8).structure, seen, [loads.Point("13+Z", label="p")], modes=10)


def pulses(samples: int, width: int, at: tuple[int, ...], heights: tuple[float, ...]) -> Setting:
    """Half sines, or single samples, behind displacements."""
    g, shape = np.zeros(samples), np.ones(1) if width == 1 else np.sin(np.pi * np.arange(width) / (width - 1))
    for start, height in zip(at, heights, strict=True):
        g[start : start + width] += height * shape
    return displacements(), DT, g


def settings() -> dict[str, Setting]:
    """All of them by name."""
    two = {f"half sines of {w}, displacement": pulses(400, w, (60, 280), (300, 400)) for w in (5, 11, 21)}
    return {
        "plate, displacement at centre": plate("displacement", 0.0),
        "plate, displacement": plate("displacement", 0.5),
        "plate, strain": plate("strain", 0.5),
        "hits, acceleration": blows(),
        "half sine of 11, acceleration": impact(5, 17),
        "two hits, displacement": pulses(200, 1, (40, 110), (300, 400)),
        "three hits, displacement": pulses(400, 1, (60, 61, 180), (300, 200, 400)),
        **two,
        "random, displacement": (displacements(), DT, 50 * np.random.default_rng(1).standard_normal(400)),
    }


def signs(setting: Setting, noise: float, seed: int) -> tuple[float, float, float, float, bool]:
    """Kurtosis, width of the pulse over the resolution, share of a peak that is lost, peak, whether it is flagged."""
    model, dt, g = setting
    y = model.predict(g, dt)
    e = np.random.default_rng(seed).standard_normal(y.shape)
    e *= noise * np.linalg.norm(y) / np.linalg.norm(e)
    level = float(np.linalg.norm(e) / np.sqrt(e.size))
    found = Deconvolution(model, noise=Noise(level, source="known")).estimate(y + e, dt)
    load = found.load[:, 0]
    ratio = half_width(load) / (found.facts["resolution"] / dt)
    peak = float(np.abs(load).max() / np.abs(g).max())
    return kurtosis(load), ratio, found.facts["peak_bias"], peak, "W311" in found.codes


def main(seeds: int) -> None:
    """Print the table."""
    print(f"{'':34s}noise   kurtosis      pulse / resolution   lost          peak          W311 of {seeds}")
    for noise in (0.01, 0.05):
        for name, setting in settings().items():
            rows = np.array([signs(setting, noise, seed) for seed in range(seeds)], float)
            ranges = "".join(f"{a:6.2f} -{b:6.2f} " for a, b in zip(rows.min(0)[:4], rows.max(0)[:4], strict=True))
            print(f"{name:34s}{noise:5.0%}  {ranges}{int(rows[:, 4].sum()):6d}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
