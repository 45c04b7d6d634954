"""E, nu and thickness by `tactile.material.in_situ`, on gels that no sensor modelled (`case_studies.bodies`).

A gel of 14 x 12 mm, 2.6 to 3.4 mm thick, of any Poisson's ratio from .32 to .49, pressed four to eight times by spheres
or flat punches of several sizes; what is declared of it is drawn from the tolerances. Markers in the plane, with a
depth map, or tracked along all axes, each told the same presses, none of which is held out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from case_studies.bodies import Patch, surfaces
from tactile import DepthMap, Markers, MultilayerPad, Pad, Tolerances, material

from .scores import Z95, Array

SIZE, E = (14e-3, 12e-3), 120e3
PRIOR = Tolerances(E=0.3, nu=0.04, thickness=0.06)
KINDS = ("in the plane", "and depth", "all axes")
NOISES = (2e-6, 5e-6)
PIXEL, PIXEL_NOISE = 0.25e-3, 5e-6
FORCE_STD = 0.01
GRID = np.stack(np.meshgrid(np.arange(-6e-3, 6.1e-3, 1e-3), np.arange(-5e-3, 5.1e-3, 1e-3)), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, eq=False)
class Told:
    """What one set of presses told by one sensor.

    Parameters
    ----------
    kind : str
    away, std : array (3,)
        Errors of log E, nu, log thickness, and their std.
    misfit : float
    contradicted : bool
        Whether W117 came.
    """

    kind: str
    away: Array
    std: Array
    misfit: float
    contradicted: bool


def presses(rng: np.random.Generator, count: int) -> list[tuple[Patch, ...]]:
    """Spheres and flat punches, 1.5 thicknesses off the rim."""
    out: list[tuple[Patch, ...]] = []
    for _ in range(count):
        a = rng.uniform(0.9e-3, 2.3e-3)
        kind = str(rng.choice(["round", "round", "flat"]))
        force = rng.uniform(20e3, 45e3) * 0.7 * a**2
        shear, way = rng.uniform(0, 0.35), rng.uniform(0, 2 * np.pi)
        at = rng.uniform(-1, 1, 2) * (2.6e-3, 1.8e-3)
        pull = force * np.array([shear * np.cos(way), shear * np.sin(way), -1.0])
        out.append((Patch(kind, tuple(at), (a, a), 0.0, tuple(pull)),))
    return out


def one(rng: np.random.Generator, **settings: Any) -> Iterator[Told]:
    """One gel, by every kind of sensor."""
    nu, h = float(rng.uniform(0.32, 0.49)), float(rng.uniform(2.6e-3, 3.4e-3))
    pressed = presses(rng, int(rng.integers(4, 9)))
    noise = float(rng.choice(NOISES))
    true = np.array([np.log(E), nu, np.log(h)])
    points = GRID + rng.uniform(-1e-4, 1e-4, GRID.shape)
    x, y = ((np.arange(round(s / PIXEL)) + 0.5) * PIXEL - s / 2 for s in SIZE)
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    found = surfaces(pressed, "fe", SIZE, h, nu)
    motion = np.array([u(points) for u in found]) / E
    depth = np.array([u(grid.reshape(-1, 2))[:, 2].reshape(grid.shape[:2]) for u in found]) / E
    F = np.array([p[0].force for p in pressed])
    motion = motion + noise * rng.standard_normal(motion.shape)
    depth = depth + PIXEL_NOISE * rng.standard_normal(depth.shape)
    known = F + FORCE_STD * np.abs(F).max() * rng.standard_normal(F.shape)
    declared = true + np.array([PRIOR.E, PRIOR.nu, PRIOR.thickness]) * rng.standard_normal(3)
    declared[1] = np.clip(declared[1], 0.25, 0.495)
    pad = Pad(size=SIZE, elements=(16, 14), E=float(np.exp(declared[0])), nu=float(declared[1]),
              thickness=float(np.exp(declared[2])))  # fmt: skip
    maps = [DepthMap(d, PIXEL, PIXEL_NOISE) for d in depth]
    for kind in KINDS:
        axes, deep = ("XYZ" if kind == "all axes" else "XY"), kind == "and depth"

        def build(pad: Pad, axes: str = axes, deep: bool = deep) -> MultilayerPad:
            return MultilayerPad(pad, Markers(points, noise, axes), depth=maps[0] if deep else None, choice=0.05)

        told = material.in_situ(build, pad, list(motion[..., : len(axes)]), known, depths=maps if deep else None,
                                prior=PRIOR, force_std=FORCE_STD, held=0, **settings)  # fmt: skip
        at = np.array([np.log(told.pad.E), told.pad.nu, np.log(told.pad.thickness)])
        yield Told(kind, at - true, np.sqrt(np.diag(told.covariance)), told.misfit,
                   any(f.code.endswith("W117") for f in told.flags))  # fmt: skip


def run(problems: int, seed: int, error: str = "none", **settings: Any) -> Iterator[Told]:
    """Gels, each from a seed of its own."""
    for number in range(problems):
        yield from one(np.random.default_rng([seed, number, 11]), **settings)


def table(found: Sequence[Told]) -> None:
    """Print a row for each sensor: log E, nu and log thickness in their 95 % bands; rms of errors over their std.

    And the std in the median, over that declared; misfit (median), and how often W117 came.
    """
    prior = np.array([PRIOR.E, PRIOR.nu, PRIOR.thickness])
    print(f"{'':14s} {'n':>4s}  {'in band: E':>10s} {'nu':>5s} {'h':>5s}   {'rms: E':>6s} {'nu':>5s} {'h':>5s}   "
          f"{'left: E':>7s} {'nu':>5s} {'h':>5s}   {'misfit':>6s} {'W117':>5s}")  # fmt: skip
    for kind in dict.fromkeys(t.kind for t in found):
        of = [t for t in found if t.kind == kind]
        z = np.array([t.away / t.std for t in of])
        inside, rms = np.mean(np.abs(z) <= Z95, axis=0), np.sqrt(np.mean(z**2, axis=0))
        left, misfit = np.median([t.std for t in of], axis=0) / prior, np.median([t.misfit for t in of])
        print(f"{kind:14s} {len(of):4d}  {inside[0]:10.0%} {inside[1]:5.0%} {inside[2]:5.0%}   "
              f"{rms[0]:6.2f} {rms[1]:5.2f} {rms[2]:5.2f}   {left[0]:7.2f} {left[1]:5.2f} {left[2]:5.2f}   "
              f"{misfit:6.2f} {np.mean([t.contradicted for t in of]):5.0%}")  # fmt: skip
