"""One frame as a user hands it over: an image, or the motion of the markers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag
from structures.values import plain

from .observation import Markers

if TYPE_CHECKING:
    from .eye import Eye
    from .reading import DepthMap


def is_image(found: NDArray, markers: int) -> bool:
    """Whether an array is a picture: bytes, three axes, or more columns than a motion has."""
    if found.dtype == np.uint8 or found.ndim == 3:
        return True
    return found.ndim == 2 and found.shape[1] > 3 and len(found) != markers


def readings_of(
    found: ArrayLike, markers: Markers, eye: Eye | None, depth: DepthMap | None
) -> tuple[NDArray[np.float64], list[Flag | None]]:
    """Readings (N axes,) of the markers in m, NaN where one is lost, and what the eye found.

    Raises
    ------
    InputError
        An image for a sensor without an eye; displacements that do not fit.
    """
    seen: Any = np.asarray(plain(found))
    flags: list[Flag | None] = []
    _refuse_turned(seen, len(markers))
    if is_image(seen, len(markers)):
        if eye is None:
            raise InputError(
                "this sensor has no eye: it cannot read images",
                where="frame",
                found=f"an image {seen.shape}",
                expected="displacements (markers, 2 or 3) in m",
                hint="build it with eye=tactile.Eye(view, reference)",
            )
        seen, flags = eye.read(seen, depth)
    return markers.readings(seen), flags


def paired(frames: Iterable[Any], depths: Iterable[DepthMap]) -> Iterator[tuple[Any, DepthMap]]:
    """Frames with their depth maps.

    Raises
    ------
    InputError
        When one of them ends before the other.
    """
    end = object()
    for i, (frame, depth) in enumerate(zip_longest(frames, depths, fillvalue=end)):
        if frame is end or depth is end:
            raise InputError(
                "frames and depth maps do not go together", where=f"frame {i}",
                found=f"no {'frame' if frame is end else 'depth map'} {i}", expected="one depth map for each frame",
            )  # fmt: skip
        yield frame, depth  # type: ignore[misc]


def _refuse_turned(seen: NDArray, markers: int) -> None:
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
        "this sensor was not built for a depth map",
        where="depth",
        found="a depth map",
        expected="none",
        hint="build it with depth= a map of the kind that it will see",
    )
