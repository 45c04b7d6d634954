"""Pixels to places on the pad (View), and the eye of a sensor: images in, motion of markers in metres out.

Points are x and y on the pad in m, origin at its centre; heights are measured from the plane of the markers at rest, so
that the height of a marker is its normal motion: negative where the pad is pressed, towards the camera.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from structures._advice import Advice, Spelling
from structures._flags import Flag
from structures.errors import InputError, number, pair, positive, reals

from .._arrays import DISTANCE, PLACE, SIDE, Array, shaped
from .._guards import RAYS, not_tangential, tangential
from ._rays import Homography, Parallel, Window, bend, fitted
from ._tracker import MarkerTracker

if TYPE_CHECKING:
    from .._sensors.observation import DepthMap


class Rays(Protocol):
    """Directions in which the markers are seen."""

    def slope(self, xy: Array, height: Array) -> Array:
        """In-plane motion of the ray through each point per unit of height, shape (N, 2)."""


class Plane(Protocol):
    """Pixels and points of the plane of the markers at rest."""

    def to_plane(self, pixels: Array) -> Array:
        """Points, shape (N, 2)."""

    def to_pixels(self, points: Array) -> Array:
        """Pixels, shape (N, 2)."""


@dataclass(frozen=True)
class Pinhole:
    """A camera without distortion behind a window: focal length and pixel (x, y) of the axis in px.

    Rows of `rotation`: right, down and forward of the camera in the frame of the pad.
    """

    focal: float
    centre: tuple[float, float]
    rotation: Array
    window: Window

    def to_plane(self, pixels: Array) -> Array:
        """Points at rest that pixels show, shape (N, 2)."""
        seen = np.column_stack([(pixels - np.array(self.centre)) / self.focal, np.ones(len(pixels))])
        world = seen @ self.rotation
        if not (world[:, 2] > 0).all():
            raise InputError("a pixel that does not look at the pad", where="camera", hint="tilt the camera less")
        return self.window.reached(world / world[:, 2:])

    def to_pixels(self, points: Array) -> Array:
        """Pixels of points at rest, shape (N, 2)."""
        seen = self.window.direction(points) @ self.rotation.T
        return np.array(self.centre) + self.focal * seen[:, :2] / seen[:, 2:]


@dataclass(frozen=True)
class View:
    """How one camera sees the markers.

    Parameters
    ----------
    image : Homography or Pinhole
        Pixels and points of the plane of the markers at rest.
    rays : Parallel or Window, optional
        Directions in which the markers are seen; without them nothing is known of markers that leave the plane.
    """

    image: Plane
    rays: Rays | None = None

    @classmethod
    def homography(
        cls,
        matrix: ArrayLike,
        *,
        unit: float = 1.0,
        alpha: float | None = None,
        gamma: float | None = None,
        azimuth: float = 0.0,
        window: Window | None = None,
    ) -> View:
        """A view by a homography.

        Parameters
        ----------
        matrix : array, shape (3, 3)
            Maps (x, y, 1) on the pad to (column, row, 1) in px, up to a factor.
        unit : float
            Metres of its unit of length: 1e-3 for a matrix from mm.
        alpha, gamma, azimuth : float, optional
            Viewing angle (rad), index and direction of the rays, for a camera far away; see `Parallel`.
        window : Window, optional
            Instead of these, where the lens is.
        """
        return cls(Homography(reals(matrix, where="homography"), unit), _rays(alpha, gamma, azimuth, window))

    @classmethod
    def fit(
        cls,
        points: ArrayLike,
        pixels: ArrayLike,
        *,
        alpha: float | None = None,
        gamma: float | None = None,
        azimuth: float = 0.0,
        window: Window | None = None,
    ) -> View:
        """A view by the homography that maps points on the pad (m) to pixels, both (n, 2), n at least 4.

        The other settings are those of `homography`.
        """
        return cls(fitted(points, pixels), _rays(alpha, gamma, azimuth, window))

    @classmethod
    def camera(
        cls,
        *,
        focal: float,
        centre: tuple[float, float],
        distance: float,
        depth: float = 0.0,
        gamma: float = 1.0,
        tilt: float = 0.0,
        azimuth: float = 0.0,
        roll: float = 0.0,
    ) -> View:
        """A pinhole camera under the pad, whose axis passes through the centre of the pad at rest.

        Untilted, columns grow along +X and rows along +Y.

        Parameters
        ----------
        focal : float
            Focal length in px.
        centre : (float, float)
            Pixel of the optical axis, x and y.
        distance, depth : float
            From the lens to the face of the window, and from there to the markers at rest, m.
        gamma : float
            Index of gel and window over that outside.
        tilt, azimuth : float
            Angle of the axis from the normal, outside, and its direction in the plane from +X, rad.
        roll : float
            Turn of the camera about its axis, rad.
        """
        beta = float(bend(number("tilt", tilt, where="camera", unit="rad"), gamma))
        run = DISTANCE.positive("distance", distance, where="camera") * np.tan(tilt) + depth * np.tan(beta)
        eye = (-run * np.cos(azimuth), -run * np.sin(azimuth))
        window = Window(eye, distance, depth, gamma)
        middle = pair("centre", centre, where="camera", unit="px")
        turned = _turn(number("roll", roll, where="camera")) @ _tilted(tilt, azimuth)
        return cls(Pinhole(positive("focal", focal, where="camera", unit="px"), middle, turned, window), window)

    @property
    def knows_rays(self) -> bool:
        """Whether the directions are known in which the markers are seen."""
        return self.rays is not None

    def to_pad(self, pixels: ArrayLike) -> Array:
        """Points of the plane at rest that pixels show, m, shape (N, 2); NaN stays NaN."""
        px = _points(pixels, "pixels", 2)
        known = np.isfinite(px).all(axis=1)
        found = np.full((len(px), 2), np.nan)
        found[known] = self.image.to_plane(px[known])
        return found

    def in_plane(self, pixels: ArrayLike, heights: ArrayLike = 0.0) -> Array:
        """Where markers of known height are on the pad, m, shape (N, 2): projection and refraction undone.

        Parameters
        ----------
        pixels : array, shape (N, 2)
        heights : float or array, shape (N,)
            Height above the plane at rest: the normal motion, m, negative where pressed; NaN gives NaN.

        Raises
        ------
        InputError
            E603: heights that are not zero, and no directions of the rays.
        """
        at_rest = self.to_pad(pixels)
        height = _heights(heights, len(at_rest))
        known = np.isfinite(at_rest[:, 0]) & np.isfinite(height)
        found = np.where(known[:, None], at_rest, np.nan)
        if height[known].any():
            found[known] += height[known, None] * self._slope(at_rest[known], np.zeros(int(known.sum())))
        return found

    def to_pixels(self, points: ArrayLike) -> Array:
        """Pixels of points, shape (N, 2); the third coordinate of a point, where it has one, is its height."""
        xyz = _points(points, "points", 2, 3)
        known = np.isfinite(xyz).all(axis=1)
        at_rest = xyz[known, :2]
        height = xyz[known, 2] if xyz.shape[1] == 3 else np.zeros(len(at_rest))
        if height.any():
            at_rest = at_rest - height[:, None] * self._slope(at_rest, height)
        found = np.full((len(xyz), 2), np.nan)
        found[known] = self.image.to_pixels(at_rest)
        return found

    def motion(self, rest: ArrayLike, now: ArrayLike, normal: ArrayLike | None, *, allow: Sequence[str] = ()) -> Array:
        """Tangential motion of markers, m, shape (N, 2).

        Parameters
        ----------
        rest, now : array, shape (N, 2)
            Their pixels at rest and now; NaN = lost.
        normal : float or array, shape (N,), or None
            Their normal motion, m; None where it is not known.
        allow : sequence of str
            ``("E603",)`` gives the motion in the image where normal motion or rays are not known.

        Raises
        ------
        InputError
            E603.
        """
        refused = tangential(self.knows_rays, normal is not None, allow=allow)
        heights: ArrayLike = 0.0 if normal is None or refused is not None else normal
        return self.in_plane(now, heights) - self.to_pad(rest)

    def _slope(self, xy: Array, height: Array) -> Array:
        if self.rays is None:
            raise not_tangential([RAYS])
        return self.rays.slope(xy, height)


def _rays(alpha: float | None, gamma: float | None, azimuth: float, window: Window | None) -> Rays | None:
    if window is not None:
        if alpha is not None or gamma is not None:
            raise InputError("rays stated twice", where="View", expected="either window, or alpha and gamma")
        return window
    if (alpha is None) != (gamma is None):
        raise InputError(
            "viewing angle and index belong together",
            where="View",
            found="alpha alone" if gamma is None else "gamma alone",
            expected="alpha and gamma (1.0 where nothing refracts)",
        )
    return None if alpha is None or gamma is None else Parallel(alpha, gamma, azimuth)


def _tilted(tilt: float, azimuth: float) -> Array:
    """Right, down and forward of a camera along +Z that is tilted towards an azimuth (Rodrigues), rows."""
    c, s = np.cos(azimuth), np.sin(azimuth)
    n = np.array([[0, 0, c], [0, 0, s], [-c, -s, 0]])  # cross product with the axis of the turn, (-s, c, 0)
    return np.asarray((np.eye(3) + np.sin(tilt) * n + (1 - np.cos(tilt)) * (n @ n)).T)


def _turn(roll: float) -> Array:
    c, s = np.cos(roll), np.sin(roll)
    return np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def _heights(heights: ArrayLike, count: int) -> Array:
    found = shaped(heights, (), (count,), where="heights", what="heights do not fit the pixels", lost=True)
    return np.broadcast_to(found, (count,))


def _points(points: ArrayLike, name: str, *columns: int) -> Array:
    return shaped(points, *((None, n) for n in columns), where=name, what="no points", lost=True)


STEP = 0.5  # px, of the difference that tells how large a pixel is on the pad


class Eye:
    """Camera and tracker of a pad.

    An image shows apparent motion: tangential motion, less what the normal motion shifts along the ray. The inversion
    is given that mixture with its slopes, so that no normal motion need be known; where a depth map is, the nonlinear
    part of the projection is taken off with it.

    Parameters
    ----------
    view : View
    reference : image or array (N, 2)
        The unloaded pad; or the places of its dots (px).
    unloaded : iterable of images, optional
        Three or more further frames of the unloaded pad: their jitter is the noise.
    noise : float or (x, y), optional
        Std of a place (px) instead of these.
    size : (a, b), optional
        Sides of the pad (m): markers outside are left out.
    allow : sequence of str
        ``("E603",)``: take apparent for tangential motion where the directions of the rays are not known.
    **tracking
        Settings of `MarkerTracker`.

    Raises
    ------
    InputError
        E603 where the view knows no rays; fewer than three markers; no noise.
    """

    def __init__(
        self,
        view: View,
        reference: Any,
        *,
        unloaded: Iterable[Any] | None = None,
        noise: float | tuple[float, float] | None = None,
        size: tuple[float, float] | None = None,
        allow: Sequence[str] = (),
        **tracking: Any,
    ) -> None:
        self.view = view
        for side in () if size is None else pair("size", size, where="Eye", unit="m"):
            SIDE.positive("a side", side, where="Eye, size")
        self.flags = [tangential(view.knows_rays, True, allow=allow)]
        self.tracker = MarkerTracker(reference, **tracking)
        places = view.to_pad(self.tracker.points)
        what = "View.homography(matrix, unit=1e-3) takes one from mm"
        PLACE.inside("a place of a marker", float(np.nanmax(np.abs(places))), where="Eye, view", hint=what)
        inside = np.ones(len(places), bool) if size is None else np.all(np.abs(places) < np.asarray(size) / 2, axis=1)
        self.kept = np.flatnonzero(inside)
        self.noise_px = self._jitter(unloaded, noise)
        self.noise = self._in_metres(self.noise_px)

    def __repr__(self) -> str:
        return f"<Eye: {len(self.kept)} markers, noise {np.round(self.noise_px, 4)} px>"

    @property
    def markers(self) -> Array:
        """Places of the markers at rest (N, 2) in m."""
        return self.view.to_pad(self.tracker.points[self.kept])

    @cached_property
    def pixel(self) -> float:
        """Side of a pixel on the pad (m)."""
        return float(np.median(self._in_metres(np.ones(2))))

    @property
    def slope(self) -> Array | None:
        """Apparent motion per unit of normal motion (N, 2); None where the rays are not known."""
        return None if self.view.rays is None else -self.view.rays.slope(self.markers, np.zeros(len(self.kept)))

    def read(self, frame: Any, depth: DepthMap | None = None) -> tuple[Array, list[Flag | None]]:
        """Apparent motion of the markers (N, 2) in m, NaN where one is lost, and what was found.

        Raises
        ------
        InputError
            A frame of another size.
        """
        motion = self.tracker.step(frame)
        now, rest = motion.places[self.kept], self.markers
        apparent = self.view.to_pad(now) - rest
        if depth is not None and (slope := self.slope) is not None:
            # what is not linear in the normal motion, by the measured one; its noise cancels to first order
            height = np.where(np.isfinite(at := depth.at(rest)), at, 0.0)
            apparent = self.view.in_plane(now, height) - rest + slope * height[:, None]
        return apparent, [*self.flags, *motion.flags]

    def _jitter(self, unloaded: Iterable[Any] | None, noise: Any) -> Array:
        if noise is not None and np.ndim(noise) == 1:
            return np.array(
                [positive("the noise", n, where="Eye", unit="px") for n in pair("noise", noise, where="Eye")]
            )
        if noise is not None:
            return np.full(2, positive("the noise", noise, where="Eye", unit="px"))
        if unloaded is None:
            raise InputError(
                "the noise of the markers is not known", where="Eye", found="neither unloaded frames nor noise",
                expected=Advice(
                    Spelling("unloaded=[frame, frame, frame, ...] or noise= in px",
                             'unloaded frames (--unloaded), or [markers] noise = "0.02 px" in the pad file')
                ),
                hint="record a second of the sensor while nothing touches it",
            )  # fmt: skip
        frames = list(unloaded)
        found = self.tracker.jitter(frames)
        self.flags += list(found.flags)
        self.tracker.zero(frames)
        if not np.all(found.std > 0):
            raise InputError("the unloaded frames show no noise at all", where="Eye, unloaded", found="repeated frames",
                             expected="frames as the camera gives them",
                             hint=Advice(
                                 "a lossy video freezes still areas; state ",
                                 Spelling("noise= in px", '[markers] noise = "0.02 px" in the pad file'),
                             ))  # fmt: skip
        return found.std

    def _in_metres(self, px: Array) -> Array:
        """Std (N, 2) in m of places whose std is `px` per axis of the image."""
        at = self.tracker.points[self.kept]
        columns = [
            (self.view.to_pad(at + STEP * unit) - self.view.to_pad(at - STEP * unit)) / (2 * STEP) for unit in np.eye(2)
        ]
        return np.asarray(np.sqrt(sum((column * s) ** 2 for column, s in zip(columns, px, strict=True))))
