"""A small pad with markers on a coarse mesh, and presses on it, for tests of the generator."""

from __future__ import annotations

from functools import cache

import numpy as np

from tactile import Eye, Markers, MultilayerPad, Pad, View
from tactile.generate import (
    CameraRange,
    ContactRange,
    GelRange,
    ImageRange,
    IndenterRange,
    MarkerRange,
    PressDeclaration,
)
from tactile.vision._images import Scene, grid

SIZE, THICKNESS, E, NU = (12e-3, 12e-3), 2e-3, 150e3, 0.4
DOT, NOISE = 0.18e-3, 1e-6
FRAME = (240, 320)
SHALLOW = (0.02e-3, 0.08e-3)
INDENTERS = (
    IndenterRange("sphere", radius=(2e-3, 5e-3)),
    IndenterRange("cylinder", radius=(2e-3, 4e-3), length=(2e-3, 4e-3)),
    IndenterRange("flat", radius=(0.8e-3, 1.5e-3), depth=SHALLOW),
    IndenterRange("ring", outer=(1.2e-3, 2e-3), inner=(0.5e-3, 0.8e-3), depth=SHALLOW),
    IndenterRange("bar", length=(1.5e-3, 3e-3), width=(0.8e-3, 1.2e-3), depth=SHALLOW),
    IndenterRange("edge", slope=(0.2, 0.5), length=(2e-3, 4e-3)),
    IndenterRange("cone", slope=(0.2, 0.5)),
    IndenterRange("polygon", radius=(1e-3, 2e-3), corners=(3, 6), force=(0.05, 0.2)),
)
DECLARED = PressDeclaration(
    INDENTERS,
    ContactRange(depth=(0.05e-3, 0.2e-3), shear=(0.0, 0.1e-3), twist=(-0.03, 0.03), friction=(0.3, 0.9), bodies=3,
                 several=0.2, apart=(2e-3, 3e-3)),
    GelRange(E=(0.9, 1.1), nu=(0.38, 0.42), thickness=(0.95, 1.05)),
    CameraRange(shift=(-1.0, 1.0), turn=(-0.01, 0.01), tilt=(-0.01, 0.01), scale=(0.99, 1.01)),
    ImageRange(size=FRAME, radius=DOT, noise=(1.0, 2.0), blur=(0.8, 1.2), background=(150.0, 170.0)),
    MarkerRange(lost=(0.0, 0.05)),
)  # fmt: skip


def pad(pitch: float = 1e-3, layers: int = 2) -> Pad:
    return Pad(E=E, nu=NU, size=SIZE, thickness=THICKNESS, pitch=pitch, layers=layers, allow=("W115",))


def dots() -> np.ndarray:
    return grid(9, 10, 1.1e-3)


@cache
def marked() -> MultilayerPad:
    """Motion of markers is read."""
    return MultilayerPad(pad(), Markers(dots(), NOISE), penalty="identity")


@cache
def view() -> View:
    return View.camera(focal=560, centre=(160, 120), distance=22e-3, depth=THICKNESS, gamma=1.4, tilt=0.15)


@cache
def seeing() -> MultilayerPad:
    """Images are read."""
    rest = np.column_stack([dots(), np.zeros(len(dots()))])
    image = Scene(FRAME, DOT).photograph(view(), rest)
    return MultilayerPad(pad(), eye=Eye(view(), image, noise=0.03, size=SIZE), penalty="identity")


def only(kind: IndenterRange, **contact: object) -> PressDeclaration:
    """One kind of body, pressed as said, without errors of any kind."""
    return PressDeclaration([kind], ContactRange(**contact), markers=MarkerRange(noise=0.0))
