"""Gels that no sensor modelled: motion of markers and depth maps of presses whose tractions are known.

Three truths (`case_studies.bodies`): a bonded pad with free edges ("fe"), an endless bonded layer ("layer"), and a
pad that bears a spherical cap, which a user takes for flat ("dome").
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from case_studies.bodies import Array, Bricks, Patch, Surface, surfaces

E = 147e3
GELS = ((20e-3, 16e-3, 3e-3), (24e-3, 24e-3, 3e-3))  # sides and thickness (m)
RATIOS = (0.32, 0.45, 0.49)
SHAPES = ("round", "flat", "ring", "bar", "two")
NOISES = (2e-6, 5e-6, 20e-6)
NUISANCES = ("none", "shift", "rotation", "scale", "creep")
IMAGE = 70e-6  # side of a pixel of the camera on the pad (m)
PIXEL, PIXEL_NOISE = 0.1e-3, 10e-6  # of a depth map
SPACING = 0.9e-3  # of the markers


@dataclass(frozen=True, eq=False)
class Case:
    """One press on a gel, as a camera sees it, and what is true of it; SI.

    Parameters
    ----------
    truth, shape : str
    E, nu : float
    size : (a, b)
    thickness : float
    points : array (N, 2)
        Markers at rest, the same for every case of a gel.
    exact, motion : array (N, 3)
        Motion of the markers by the press; and as it is seen, with noise and nuisance.
    noise : float
        Std of each component of `motion`.
    depth : (values (H, W), pixel, noise) or None
        Normal motion as `tactile.DepthMap` takes it.
    patches : tuple of Patch
        What presses, forces in N.
    force, torque : array (3,)
        On the gel; about the middle of its surface.
    nuisance : dict
        What was added to the motion: kind, and shift (m), turn (rad), scale, creep (m).
    """

    truth: str
    shape: str
    E: float
    nu: float
    size: tuple[float, float]
    thickness: float
    points: Array
    exact: Array
    motion: Array
    noise: float
    depth: tuple[Array, float, float] | None
    patches: tuple[Patch, ...]
    force: Array
    torque: Array
    nuisance: dict[str, Any] = field(default_factory=dict)

    @property
    def gel(self) -> tuple[float, float, float]:
        """Sides and thickness (m)."""
        return (*self.size, self.thickness)

    def traction(self, points: Array, width: float = 0.0) -> Array:
        """Tractions (n, 3) in Pa at places (n, 2); with a width (m), their means over squares of that side."""
        steps = (np.arange(12) + 0.5) / 12 - 0.5 if width else np.zeros(1)
        places = points[:, None, None, :] + width * np.stack(np.meshgrid(steps, steps), axis=-1)
        flat = places.reshape(-1, 2)
        return sum(p.density(flat).reshape(len(points), -1).mean(axis=1)[:, None] * np.array(p.force)
                   for p in self.patches)  # type: ignore[return-value] # fmt: skip

    def inside(self, points: Array) -> NDArray[np.bool_]:
        """Which places (n, 2) are pressed."""
        return np.asarray(sum(p.density(points) for p in self.patches) > 0)


def markers(size: tuple[float, float]) -> Array:
    """Places (N, 2) of the markers of a gel: a grid with some disorder, half a spacing off the rim."""
    x, y = ((np.arange(int(s / SPACING)) - (int(s / SPACING) - 1) / 2) * SPACING for s in size)
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    return grid + np.random.default_rng(round(1e6 * sum(size))).uniform(-0.1, 0.1, grid.shape) * SPACING


def pixels(size: tuple[float, float]) -> Array:
    """Places (H, W, 2) of the pixels of a depth map over a gel."""
    x, y = ((np.arange(round(s / PIXEL)) - (round(s / PIXEL) - 1) / 2) * PIXEL for s in size)
    return np.stack(np.meshgrid(x, y), axis=-1)


def drawn(rng: np.random.Generator, shape: str, size: tuple[float, float], thickness: float) -> tuple[Patch, ...]:
    """Patches of one press, of unit force in all: mostly one and a half thicknesses from the rim."""
    near = (1.5 if rng.random() < 0.85 else 0.9) * thickness
    room = np.array(size) / 2 - near

    def patch(kind: str, largest: float, share: float) -> Patch:
        a = rng.uniform(1.2e-3 if kind == "ring" else 0.6e-3, largest)
        b = a * (rng.uniform(0.5, 0.75) if kind == "ring" else rng.uniform(0.25, 0.6))
        shear, way = rng.uniform(0, 0.5), rng.uniform(0, 2 * np.pi)
        force = share * np.array([shear * np.cos(way), shear * np.sin(way), -1.0])
        return Patch(kind, tuple(rng.uniform(-room, room)), (a, b), rng.uniform(0, np.pi), tuple(force))

    if shape != "two":
        return (patch(shape, 2.5e-3, 1.0),)
    share = rng.uniform(0.35, 0.65)
    while True:
        one, other = (patch(rng.choice(["round", "flat"]), 1.4e-3, s) for s in (share, 1 - share))
        if np.hypot(*np.subtract(one.centre, other.centre)) > one.sides[0] + other.sides[0] + 1e-3:
            return one, other


def cases(
    problems: int,
    seed: int,
    truth: str = "fe",
    *,
    gel: tuple[float, float, float] | None = None,
    nu: float | None = None,
    shape: str | None = None,
    noise: float | None = None,
    nuisance: str = "none",
    depth: bool = True,
) -> Iterator[Case]:
    """Presses on gels, each from a seed of its own; what is not given is drawn, or taken in turn (gel and nu).

    Parameters
    ----------
    truth : {"fe", "layer", "dome"}
    gel : (a, b, h), optional
        m; one of `GELS`.
    nu : float, optional
        One of `RATIOS`.
    shape : str, optional
        One of `SHAPES`.
    noise : float, optional
        m; one of `NOISES`.
    nuisance : str
        One of `NUISANCES`.
    depth : bool
        Whether depth maps are made.
    """
    rngs = [np.random.default_rng([seed, number, 7]) for number in range(problems)]
    known = [((g := gel or GELS[i % 2])[:2], g[2], nu or RATIOS[(i // 2) % 3]) for i in range(problems)]
    shapes = [shape or str(rng.choice(SHAPES)) for rng in rngs]
    presses = [drawn(r, s, k[0], k[1]) for r, s, k in zip(rngs, shapes, known, strict=True)]
    found: dict[int, Surface] = {}
    for k in dict.fromkeys(known):
        which = [i for i, other in enumerate(known) if other == k]
        found |= dict(zip(which, surfaces([presses[i] for i in which], truth, *k), strict=True))
    for i, (rng, (size, thickness, ratio)) in enumerate(zip(rngs, known, strict=True)):
        yield seen(rng, presses[i], found[i], truth, shapes[i], size, thickness, ratio, noise, nuisance, depth)


def seen(
    rng: np.random.Generator, unit: tuple[Patch, ...], surface: Surface, truth: str, shape: str,
    size: tuple[float, float], thickness: float, nu: float, noise: float | None, nuisance: str, depth: bool,
) -> Case:  # fmt: skip
    """A press scaled so that the surface moves 0.05 to 0.25 mm, and what is seen of it."""
    points, grid = markers(size), pixels(size)
    whole = surface(grid.reshape(-1, 2))
    scale = rng.uniform(0.05e-3, 0.25e-3) / np.abs(whole[:, 2]).max()
    patches = tuple(Patch(p.kind, p.centre, p.sides, p.turn, tuple(E * scale * np.array(p.force))) for p in unit)
    arms = np.array([[*p.centre, 0.0] for p in patches])
    arms[:, 2] = Bricks.of(size, thickness, nu, 1.0, cap=truth == "dome").top(arms[:, :2]) - thickness
    forces = np.array([p.force for p in patches])
    exact = scale * surface(points)
    level = noise or float(rng.choice(NOISES))
    moved, words = disturbed(rng, nuisance, points)
    image = None
    if depth:
        values = scale * whole[:, 2].reshape(grid.shape[:2])
        image = values + PIXEL_NOISE * rng.standard_normal(values.shape), PIXEL, PIXEL_NOISE
    motion = exact + moved + level * rng.standard_normal(exact.shape)
    return Case(truth, shape, E, nu, size, thickness, points, exact, motion, level, image, patches,
                forces.sum(axis=0), np.cross(arms, forces).sum(axis=0), words)  # fmt: skip


def disturbed(rng: np.random.Generator, kind: str, points: Array) -> tuple[Array, dict[str, Any]]:
    """Motion (N, 3) that no press made, and its size: camera shift 0.25 to 1 pixel, turn, scale, creep of the gel."""
    out, way = np.zeros((len(points), 3)), rng.uniform(0, 2 * np.pi)
    words: dict[str, Any] = {"kind": kind}
    reach = float(np.hypot(*points.T).max())
    if kind == "shift":
        words["shift"] = rng.uniform(0.25, 1) * IMAGE * np.array([np.cos(way), np.sin(way)])
        out[:, :2] = words["shift"]
    elif kind == "rotation":
        words["turn"] = float(rng.choice([-1, 1]) * rng.uniform(0.25, 1) * IMAGE / reach)
        out[:, :2] = words["turn"] * np.column_stack([-points[:, 1], points[:, 0]])
    elif kind == "scale":
        words["scale"] = float(rng.choice([-1, 1]) * rng.uniform(0.25, 1) * IMAGE / reach)
        out[:, :2] = words["scale"] * points
    elif kind == "creep":
        words["creep"] = 5e-6
        field_ = np.array([np.cos(way), np.sin(way)]) + 0.5 * points / reach @ rng.uniform(-1, 1, (2, 2))
        out[:, :2] = words["creep"] * field_ / np.sqrt(np.mean(np.sum(field_**2, axis=1)))
    return out, words
