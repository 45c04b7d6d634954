"""One frame as a user hands it over: an image, or the motion of the markers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.flags import Flag

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
    seen: Any = np.asarray(found)
    flags: list[Flag | None] = []
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


def not_built_for_depth() -> InputError:
    """A depth map for a sensor that expects none."""
    return InputError(
        "this sensor was not built for a depth map",
        where="depth",
        found="a depth map",
        expected="none",
        hint="build it with depth= a map of the kind that it will see",
    )
