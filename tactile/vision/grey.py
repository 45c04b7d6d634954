"""Images as users hold them, as grey images of 8 bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.values import as_array

Grey = NDArray[np.uint8]
SMALLEST = 8  # px along an axis, below which there is no image
LUMA = np.array([77, 150, 29], np.uint16)  # of 256: weights of red, green and blue (ITU-R BT.601)


def grey(image: Any, *, where: str = "image") -> Grey:
    """One image as grey uint8, shape (H, W).

    Parameters
    ----------
    image : array, shape (H, W) or (H, W, 1, 3 or 4)
        Grey, RGB or RGBA; uint8, uint16, truth values, or real numbers from 0 to 1 or from 0 to 255.
    where : str
        What an error names: the file or the frame.

    Raises
    ------
    InputError
        No array of this kind, NaN or infinity in it, values out of range.
    """
    array = as_array(image, where=where)
    if array.dtype.kind not in "uifb":
        raise InputError("an image holds no numbers", where=where, found=f"dtype {array.dtype}", expected="uint8")
    if not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3, 4))) or min(array.shape[:2]) < SMALLEST:
        raise InputError(
            "no image", where=where, found=f"shape {array.shape}", expected="(H, W), or (H, W, 3) with red first"
        )
    eight = _eight_bits(array, where)
    if eight.ndim == 2:
        return eight
    if eight.shape[2] == 1:
        return np.ascontiguousarray(eight[..., 0])
    mixed = eight[..., 0] * LUMA[0]
    mixed += eight[..., 1] * LUMA[1]
    mixed += eight[..., 2] * LUMA[2]
    return (mixed >> 8).astype(np.uint8)


def _eight_bits(array: NDArray, where: str) -> Grey:
    if array.dtype == np.uint8:
        return array
    if array.dtype == np.uint16:
        return (array >> 8).astype(np.uint8)
    if array.dtype.kind == "b":
        return array.astype(np.uint8) * np.uint8(255)
    if not np.isfinite(array).all():
        raise InputError("an image holds NaN or infinity", where=where, expected="finite grey levels")
    low, high = float(array.min()), float(array.max())
    if low < 0 or high > 255:
        raise InputError("grey levels out of range", where=where, found=f"{low:g} to {high:g}", expected="0 to 255")
    scale = 255.0 if high <= 1.0 and array.dtype.kind == "f" else 1.0
    return np.round(array * scale).astype(np.uint8)
