"""From the motion of a gel to what its sensor reads: with noise and lost markers, or by an image and its eye."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .._arrays import Array
from .._sensors.observation import Depths, Markers
from ..vision._images import Scene
from ..vision._tracker import MarkerTracker
from ._declared import CameraRange, ImageRange, MarkerRange

if TYPE_CHECKING:
    from ..vision._eye import Eye, View


@dataclass(frozen=True, eq=False)
class Mounted:
    """The plane of a view whose image is moved: pixels of the camera as it sits, from those where it should.

    Parameters
    ----------
    plane : Homography or Pinhole
    matrix : array (3, 3)
        Of pixels.
    """

    plane: Any
    matrix: Array

    def to_plane(self, pixels: Array) -> Array:
        """Points at rest that pixels show, (N, 2)."""
        there = np.linalg.solve(self.matrix, _homogeneous(pixels).T).T
        return np.asarray(self.plane.to_plane(there[:, :2] / there[:, 2:]))

    def to_pixels(self, points: Array) -> Array:
        """Pixels of points at rest, (N, 2)."""
        there = _homogeneous(self.plane.to_pixels(points)) @ self.matrix.T
        return np.asarray(there[:, :2] / there[:, 2:])


def _homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def mounted(view: View, camera: CameraRange, size: tuple[int, int], rng: np.random.Generator) -> tuple[View, Array]:
    """A view after its camera was mounted again, and what was drawn: shift along both axes (px), turn, scale.

    A turn of the camera about its lens moves the image as a homography does, whatever it shows; the focal length is
    taken for the longer side of the image.
    """
    shift = [camera.draw(rng, "shift") for _ in range(2)]
    turn, scale = camera.draw(rng, "turn"), camera.draw(rng, "scale")
    tilt = [camera.draw(rng, "tilt") for _ in range(2)]
    middle = np.array([size[1], size[0]]) / 2
    there, back = np.eye(3), np.eye(3)
    back[:2, 2], there[:2, 2] = middle, -middle
    c, s = scale * np.cos(turn), scale * np.sin(turn)
    moved = np.array(
        [[c, -s, shift[0]], [s, c, shift[1]], [np.tan(tilt[0]) / max(size), np.tan(tilt[1]) / max(size), 1]]
    )
    return type(view)(Mounted(view.image, back @ moved @ there), view.rays), np.array([*shift, turn, scale])


@dataclass(frozen=True, eq=False)
class Taken:
    """An image, with the view and the scene that made it, and which markers are gone (N,)."""

    image: NDArray[np.uint8]
    view: View
    lost: NDArray[np.bool_]
    drawn: Array


def photographed(
    eye: Eye, places: Array, motion: Array, camera: CameraRange, image: ImageRange, markers: MarkerRange,
    rng: np.random.Generator,
) -> Taken:  # fmt: skip
    """An image of markers at places (N, 2) that have moved (N, 3), as a camera sees them that was mounted again."""
    view, drawn = mounted(eye.view, camera, image.size, rng)
    scene = Scene(image.size, **{name: image.draw(rng, name) for name in
                                 ("radius", "blur", "noise", "background", "dot", "shading")})  # fmt: skip
    lost = gone(len(places), markers, rng)
    moved = np.column_stack([places + motion[:, :2], motion[:, 2]])
    return Taken(scene.photograph(view, moved[~lost], seed=rng, exact=False), view, lost, drawn)


def seen(eye: Eye, taken: Taken, places: Array) -> Array:
    """Apparent motion (N, 2) in m that the eye finds in an image; zero was taken with the camera as it sits."""
    rest = taken.view.to_pixels(places)
    all_rest = eye.tracker.points
    all_rest[eye.kept] = rest
    fresh = copy(eye)
    fresh.tracker = MarkerTracker(all_rest, detector=eye.tracker.detector, gate=eye.tracker.gate)
    return fresh.read(taken.image)[0]


def gone(count: int, markers: MarkerRange, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which of the markers are not seen (N,)."""
    return np.asarray(rng.random(count) < markers.draw(rng, "lost"))


def noisy(markers: Markers, motion: Array, ranges: MarkerRange, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings (N axes,) of a motion (N, 3), NaN where a marker is lost, and the noise that is in them."""
    std = ranges.draw(rng, "noise") * markers.noise
    lost = gone(len(markers), ranges, rng)
    read = np.asarray(markers.rows(motion.reshape(-1, 1))).reshape(std.shape)
    read = read + std * rng.standard_normal(std.shape)
    read[lost] = np.nan
    return read.ravel(), std.ravel()


def measured(depth: Depths, motion: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Readings of a depth map (n,) from the motion (4 n, 3) of points in its windows, and their noise."""
    std = depth.averaging.std(depth.template.noise)
    clean = np.asarray(depth.rows(motion.reshape(-1, 1))).ravel()
    return clean + std * rng.standard_normal(std.shape), std
