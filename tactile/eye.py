"""The eye of a sensor: images in, apparent motion of markers in metres out, with its noise and what was lost."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from structures.advice import Advice, Spelling
from structures.errors import InputError
from structures.flags import Flag
from structures.values import positive

from .guards.vision import tangential
from .optics import View
from .vision.tracker import MarkerTracker

if TYPE_CHECKING:
    from .reading import DepthMap

Array = NDArray[np.float64]
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
    noise : float, optional
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
        noise: float | None = None,
        size: tuple[float, float] | None = None,
        allow: Sequence[str] = (),
        **tracking: Any,
    ) -> None:
        self.view = view
        self.flags = [tangential(view.knows_rays, True, allow=allow)]
        self.tracker = MarkerTracker(reference, **tracking)
        places = view.to_pad(self.tracker.points)
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

    @property
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
        slope = self.slope
        if depth is not None and slope is not None:
            # what is not linear in the normal motion, by the measured one; its noise cancels to first order
            height = np.where(np.isfinite(at := depth.at(rest)), at, 0.0)
            apparent = self.view.in_plane(now, height) - rest + slope * height[:, None]
        return apparent, [*self.flags, *motion.flags]

    def _jitter(self, unloaded: Iterable[Any] | None, noise: float | None) -> Array:
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
        return np.sqrt(sum((column * s) ** 2 for column, s in zip(columns, px, strict=True)))
