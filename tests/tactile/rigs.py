"""Small pads, markers and presses that the tests of the sensors share."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tactile import ContactLaw, DepthMap, Markers, MultilayerPad, Pad, Press

NOISE = 2e-6
PRESS = Press(at=(0.4e-3, -0.3e-3), radius=2.5e-3, force=1.0, shear=(0.25, 0.0))


@cache
def pad(layers: int = 3, element: str = "bbar") -> Pad:
    """A pad of 14 x 12 x 3 mm on a 1 mm grid."""
    return Pad(
        size=(14e-3, 12e-3), thickness=3e-3, E=147e3, nu=0.3223, elements=(14, 12), layers=layers, element=element,
        allow=("W115",),
    )  # fmt: skip


@cache
def markers(nx: int = 15, ny: int = 13) -> NDArray[np.float64]:
    """Places of markers on a grid."""
    x, y = np.meshgrid(np.linspace(-6.5e-3, 6.5e-3, nx), np.linspace(-5.5e-3, 5.5e-3, ny))
    return np.column_stack([x.ravel(), y.ravel()])


@cache
def nodal() -> NDArray[np.float64]:
    """Nodal forces (P, 3) of the press on the pad's own mesh."""
    here = pad()
    return here.surface.forces(PRESS.traction(here.nodes2d))


@cache
def motion(seed: int | None = None, noise: float = NOISE) -> NDArray[np.float64]:
    """Motion of the markers (N, 3) under those forces, on the pad's own mesh."""
    here = pad()
    U = here.displacements(nodal())
    u = np.asarray(here.from_surface(markers()) @ U.ravel()).reshape(-1, 3)
    return u if seed is None else u + noise * np.random.default_rng(seed).standard_normal(u.shape)


NO_PULL = ContactLaw(no_pull=True)


@cache
def sensor(choice: float = 0.01, axes: str = "XYZ", **settings: object) -> MultilayerPad:
    """A multilayer pad with a frozen lambda and a ridge, whose answers are those of plain least squares."""
    given = {"penalty": "identity", **settings}
    return MultilayerPad(pad(), Markers(markers(), NOISE, axes), choice=choice, **given)  # type: ignore[arg-type]


@cache
def lifted(pixel: float) -> NDArray[np.float64]:
    """Normal motion of the surface on the pixels of a depth map, on the pad's own mesh."""
    here, shape = pad(), (round(12e-3 / pixel), round(14e-3 / pixel))
    y, x = (((np.arange(n) - (n - 1) / 2) * pixel) for n in shape)
    places = np.array(np.meshgrid(x, y)).reshape(2, -1).T
    moved = np.asarray(here.from_surface(places) @ here.displacements(nodal()).ravel())
    return moved.reshape(-1, 3)[:, 2].reshape(shape)


def depth(seed: int = 0, noise: float = 1e-5, pixel: float = 2e-4) -> DepthMap:
    """Depth map of the press."""
    z = lifted(pixel)
    return DepthMap(z + noise * np.random.default_rng(seed).standard_normal(z.shape), pixel, noise)


@cache
def moved_by(press: Press) -> NDArray[np.float64]:
    """Motion of the markers (N, 3) under a press, on the pad's own mesh."""
    here = pad()
    U = here.displacements(here.surface.forces(press.traction(here.nodes2d)))
    return np.asarray(here.from_surface(markers()) @ U.ravel()).reshape(-1, 3)


def fresh(axes: str = "XYZ", **settings: object) -> MultilayerPad:
    """A sensor of one's own, whose zero may be moved."""
    given = {"penalty": "identity", **settings}
    return MultilayerPad(pad(), Markers(markers(), NOISE, axes), choice=0.01, **given)  # type: ignore[arg-type]
