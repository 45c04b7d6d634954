"""What all sensors share: frames to readings, their zero, and streams."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures.errors import InputError, plain

from .._arrays import Array
from .._results.forcemap import ForceMap
from .observation import DepthMap, Depths, Markers
from .settings import ContactLaw, unknown_markers

if TYPE_CHECKING:
    from ..vision._eye import Eye


class MarkedSensor:
    """A pad with markers: frames to readings, zero, streams; `estimate` is that of each kind.

    Parameters
    ----------
    markers : Markers, optional
        Those of the eye where not given; places alone take its noise.
    eye : Eye, optional
        Turns images into motion.
    depth : Depths, optional
        Windows of a depth map that is measured beside the markers.
    contact : ContactLaw
    """

    name = "tactile sensor"

    def __init__(
        self, markers: Markers | ArrayLike | None, eye: Eye | None, depth: Depths | None, contact: ContactLaw
    ) -> None:
        self.markers, self.eye, self.depth, self.contact = observed(markers, eye), eye, depth, contact
        self._offset = np.zeros(self.markers.readings_count + (0 if depth is None else len(depth.points)))

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.contact.constrains

    def estimate(self, found: ArrayLike, depth: DepthMap | None = None) -> ForceMap:
        """Force map of one frame."""
        raise NotImplementedError

    def stream(self, frames: Iterable[Any], depths: Iterable[DepthMap] | None = None) -> Iterator[ForceMap]:
        """Force maps of frames, one after another, as they come."""
        if depths is None:
            yield from (self.estimate(frame) for frame in frames)
            return
        end = object()
        for i, (frame, depth) in enumerate(zip_longest(frames, depths, fillvalue=end)):
            if frame is end or depth is end:
                raise InputError(
                    "frames and depth maps do not go together", where=f"frame {i}",
                    found=f"no {'frame' if frame is end else 'depth map'} {i}", expected="one depth map for each frame",
                )  # fmt: skip
            yield self.estimate(frame, depth)  # type: ignore[arg-type]

    def zero(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None = None) -> Self:
        """Take the mean of unloaded frames as zero. Returns the sensor.

        Raises
        ------
        InputError
            Without frames.
        """
        self._offset = np.zeros_like(self._offset)
        listed = self._listed(frames, depths)
        if not listed:
            raise InputError("no frames to take zero from", where="zero", found="none", expected="unloaded frames")
        stack = np.array(listed)
        known = np.isfinite(stack)
        self._offset = np.where(known, stack, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return self

    def readings(self, found: ArrayLike, depth: DepthMap | None = None) -> Array:
        """Readings (m,) of a frame, markers first, zero taken off; NaN where lost."""
        return self._readings(found, depth)[0]

    def _listed(self, frames: Sequence[Any], depths: Sequence[DepthMap] | None) -> list[Array]:
        return [self.readings(f, None if depths is None else depths[i]) for i, f in enumerate(frames)]

    def _readings(self, found: ArrayLike, depth: DepthMap | None) -> tuple[Array, list[Flag | None]]:
        """Readings, NaN where there is none, and what was found on the way."""
        seen: Any = np.asarray(plain(found))
        flags: list[Flag | None] = []
        count = len(self.markers)
        _refuse_turned(seen, count)
        if is_image(seen, count):
            if self.eye is None:
                raise InputError(
                    "this sensor has no eye: it cannot read images", where="frame", found=f"an image {seen.shape}",
                    expected="displacements (markers, 2 or 3) in m",
                    hint="build it with eye=tactile.Eye(view, reference)",
                )  # fmt: skip
            seen, flags = self.eye.read(seen, depth)
        parts = [self.markers.readings(seen)]
        if self.depth is not None:
            parts.append(np.full(len(self.depth.points), np.nan) if depth is None else self.depth.readings(depth))
        elif depth is not None and self.eye is None:
            raise not_built_for_depth()
        return np.concatenate(parts) - self._offset, flags


def observed(markers: Markers | ArrayLike | None, eye: Eye | None) -> Markers:
    """Markers as a user gave them, or as an eye sees them; refused where neither gives them, or their noise."""
    if isinstance(markers, Markers):
        return markers
    if eye is None:
        raise unknown_markers(markers is not None)
    return Markers(eye.markers if markers is None else markers, eye.noise, slope=eye.slope)  # type: ignore[arg-type]


def is_image(found: NDArray[Any], markers: int) -> bool:
    """Whether an array is a picture: bytes, three axes, or more columns than a motion has."""
    if found.dtype == np.uint8 or found.ndim == 3:
        return True
    return found.ndim == 2 and found.shape[1] > 3 and len(found) != markers


def _refuse_turned(seen: NDArray[Any], markers: int) -> None:
    """Many frames at once, and motions with rows and columns swapped, are no images."""
    if seen.dtype == np.uint8:
        return
    if seen.ndim == 3 and seen.shape[1:] in ((markers, 2), (markers, 3)):
        raise InputError("many frames at once", where="frame", found=f"shape {seen.shape}",
                         expected=f"({markers}, 2 or 3)", hint="sensor.stream(frames)")  # fmt: skip
    if seen.ndim == 2 and seen.shape in ((2, markers), (3, markers)) and seen.shape[0] != markers:
        raise InputError("rows and columns are swapped", where="displacements", found=f"shape {seen.shape}",
                         expected=f"({markers}, {seen.shape[0]})", hint="motion.T")  # fmt: skip


def not_built_for_depth() -> InputError:
    """A depth map for a sensor that expects none."""
    return InputError(
        "this sensor was not built for a depth map", where="depth", found="a depth map", expected="none",
        hint="build it with depth= a map of the kind that it will see",
    )  # fmt: skip
