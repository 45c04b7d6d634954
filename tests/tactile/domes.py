"""A domed gel as sensors have them, on a finer mesh than any sensor models: forces, motion of markers, depth.

A gel of 16 mm across and 4 mm high on a plinth of 1.5 mm, as on fingertips. The truth is a mesh of its own, of
0.5 mm in the plane and 6 layers, so that a model of it is never its own truth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from tactile import Pad

RADIUS, HEIGHT, PLINTH = 8e-3, 4e-3, 1.5e-3
GEL = {"E": 147e3, "nu": 0.45}
Array = NDArray[np.float64]


@cache
def dome(pitch: float = 0.5e-3, layers: int = 6, **settings: float) -> Pad:
    """The domed gel; the defaults are the truth."""
    return Pad.dome(RADIUS, HEIGHT, plinth=PLINTH, pitch=pitch, layers=layers, **{**GEL, **settings})


@dataclass(frozen=True)
class DomePress:
    """A round press on a dome: Hertz pressure along the local normal, shear in the tangent plane along X.

    `at` (x, y) and `radius` in the plane (m); `force` (N) is the resultant along -Z, `shear` that along X beside what
    the pressure makes of it on a slope.
    """

    at: tuple[float, float] = (0.0, 0.0)
    radius: float = 2.5e-3
    force: float = 1.0
    shear: float = 0.0

    def tractions(self, pad: Pad) -> Array:
        """Tractions (P, 3) in Pa at the nodes of the surface, scaled to these resultants on its mesh."""
        r2 = np.sum((pad.nodes2d - np.asarray(self.at)) ** 2, axis=1) / self.radius**2
        shape, n = np.sqrt(np.maximum(1 - r2, 0.0)), pad.surface.normals
        along = np.array([1.0, 0.0, 0.0]) - n[:, :1] * n
        pressed, sheared = -shape[:, None] * n, shape[:, None] * along
        down = -pad.surface.forces(pressed).sum(axis=0)[2]
        side = pad.surface.forces(sheared).sum(axis=0)[0]
        return self.force / down * pressed + self.shear / side * sheared

    def forces(self, pad: Pad) -> Array:
        """Consistent nodal forces (P, 3) in N."""
        return pad.surface.forces(self.tractions(pad))

    def resultant(self, pad: Pad) -> Array:
        """Force on the pad (3,) in N."""
        return np.asarray(self.forces(pad).sum(axis=0))


@cache
def moved(press: DomePress, pad: Pad | None = None) -> Array:
    """Motion of all DOFs of the truth under a press (m)."""
    pad = dome() if pad is None else pad
    return pad.solve(press.forces(pad))


def motion(points: Array, *presses: DomePress, pad: Pad | None = None) -> Array:
    """Motion (N, 3) of markers at places (N, 2) on the dome under presses (m)."""
    pad = dome() if pad is None else pad
    whole = np.sum([moved(press, pad) for press in presses], axis=0)
    return np.asarray(pad.rows(points) @ whole).reshape(-1, 3)


def markers(pitch: float = 1e-3, inside: float = 0.92) -> Array:
    """Places of markers (N, 2) on a grid, within a share of the radius."""
    line = np.arange(-RADIUS, RADIUS + pitch / 2, pitch)
    places = np.array([(x, y) for y in line for x in line])
    return places[np.hypot(*places.T) < inside * RADIUS]


def calibration(count: int = 6, seed: int = 0) -> list[DomePress]:
    """Presses about the middle of the dome, as a calibration makes them."""
    rng, first = np.random.default_rng(seed), DomePress()
    return [
        replace(first, at=(float(x), float(y)), radius=float(r), force=float(f))
        for (x, y), r, f in zip(
            rng.uniform(-2.5e-3, 2.5e-3, (count, 2)), rng.uniform(1.5e-3, 2.5e-3, count), rng.uniform(0.3, 1.0, count),
            strict=True,
        )
    ]  # fmt: skip
