"""The image operations that detection needs, by OpenCV where it is installed and by scipy.ndimage where it is not.

Both filter with the same kernels and the border continued alike, so that they find the same dots.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError

Image = NDArray[np.float32]
REACH = 3.0  # standard deviations at which the Gaussian is cut
NAMES = ("cv2", "scipy")


@dataclass(frozen=True)
class Backend:
    """Two filters on float32 images with a border that is continued.

    Parameters
    ----------
    name : str
        ``"cv2"`` or ``"scipy"``.
    smooth : callable (image, sigma) -> image
        Gaussian of standard deviation sigma px, cut at three of them.
    box : callable (image, width) -> image
        Mean over a square of `width` px, an odd number.
    """

    name: str
    smooth: Callable[[Image, float], Image]
    box: Callable[[Image, int], Image]


def backend(name: str | None = None) -> Backend:
    """The backend of this name; by default OpenCV where it is installed, else scipy.

    Raises
    ------
    InputError
        Unknown name; ``"cv2"`` asked for and not installed.
    """
    if name is None:
        return _opencv() if installed() else _scipy()
    if name not in NAMES:
        raise InputError("unknown image backend", where="backend", found=repr(name), expected=" or ".join(NAMES))
    if name == "cv2" and not installed():
        raise InputError(
            "OpenCV is not installed",
            where="backend",
            found="backend='cv2'",
            hint='pip install "loadid[vision]", or leave backend out: scipy finds the same dots, more slowly',
        )
    return _opencv() if name == "cv2" else _scipy()


@cache
def installed() -> bool:
    """Whether OpenCV can be imported."""
    return importlib.util.find_spec("cv2") is not None


def opencv() -> Any:
    """The module cv2."""
    import cv2

    return cv2


@cache
def gaussian(sigma: float) -> NDArray[np.float32]:
    """Weights of the Gaussian, sum 1, shape (2 r + 1,)."""
    reach = max(1, math.ceil(REACH * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return (weights / weights.sum()).astype(np.float32)


@cache
def _opencv() -> Backend:
    cv2 = opencv()

    def smooth(image: Image, sigma: float) -> Image:
        weights = gaussian(sigma)
        return cv2.sepFilter2D(image, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REPLICATE)

    def box(image: Image, width: int) -> Image:
        return cv2.blur(image, (width, width), borderType=cv2.BORDER_REPLICATE)

    return Backend("cv2", smooth, box)


@cache
def _scipy() -> Backend:
    from scipy import ndimage

    def smooth(image: Image, sigma: float) -> Image:
        weights = gaussian(sigma)
        return ndimage.correlate1d(ndimage.correlate1d(image, weights, axis=0, mode="nearest"), weights, mode="nearest")

    def box(image: Image, width: int) -> Image:
        return ndimage.uniform_filter(image, width, mode="nearest")

    return Backend("scipy", smooth, box)
