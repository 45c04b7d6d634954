"""Grey images of 8 bits, the operations on them by OpenCV or scipy.ndimage, and images rendered from known dots.

Both filter with the same kernels and the border continued alike, so that they find the same dots.

They give truth to the tests and the demonstration. A dot is a disc on the pad; through a view it is drawn pixel by
pixel where the pad would be seen, so that perspective and refraction deform it as they do in a camera.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, as_array, number, one_of, plain, positive

from .._arrays import PLANE, SPACE, Array, Shape, UnusableFrame, shaped

if TYPE_CHECKING:
    from ._eye import View


Grey = NDArray[np.uint8]
SMALLEST = 8  # px along an axis, below which there is no image
LUMA = np.array([77, 150, 29], np.uint16)  # of 256: weights of red, green and blue (ITU-R BT.601)


def grey(image: Any, *, where: str = "image") -> Grey:
    """One image as grey uint8, (H, W), of (H, W) or (H, W, 1, 3 or 4): grey, RGB or RGBA.

    Of uint8, uint16, truth values, or real numbers from 0 to 1 or from 0 to 255; `where` is the file or frame in an
    error.
    """
    array = as_array(image, where=where)
    if array.dtype.kind not in "uifb":
        raise UnusableFrame("an image holds no numbers", where=where, found=f"dtype {array.dtype}", expected="uint8")
    if not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (1, 3, 4))) or min(array.shape[:2]) < SMALLEST:
        raise UnusableFrame(
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
    return np.asarray((mixed >> 8).astype(np.uint8))


def _eight_bits(array: NDArray[Any], where: str) -> Grey:
    if array.dtype == np.uint8:
        return array
    if array.dtype == np.uint16:
        return (array >> 8).astype(np.uint8)
    if array.dtype.kind == "b":
        return array.astype(np.uint8) * np.uint8(255)
    if not np.isfinite(array).all():
        raise UnusableFrame("an image holds NaN or infinity", where=where, expected="finite grey levels")
    low, high = float(array.min()), float(array.max())
    if low < 0 or high > 255:
        raise UnusableFrame("grey levels out of range", where=where, found=f"{low:g} to {high:g}", expected="0 to 255",
                            hint="name images of the markers here; depth maps go beside them")  # fmt: skip
    scale = 255.0 if high <= 1.0 and array.dtype.kind == "f" else 1.0
    return np.round(array * scale).astype(np.uint8)


Image = NDArray[np.float32]
REACH = 3.0  # standard deviations at which the Gaussian is cut
NAMES = ("cv2", "scipy")


@dataclass(frozen=True)
class Backend:
    """Two filters on float32 images with a border that is continued, by ``"cv2"`` or ``"scipy"``.

    `smooth` is the Gaussian of some px, cut at three of them; `box` the mean over a square of an odd number of px.
    """

    name: str
    smooth: Callable[[Image, float], Image]
    box: Callable[[Image, int], Image]


def backend(name: str | None = None) -> Backend:
    """The backend of this name, refused where it is not installed; by default OpenCV where it is, else scipy."""
    if name is None:
        return _opencv() if installed() else _scipy()
    one_of("unknown image backend", name, NAMES, where="backend")
    if name == "cv2" and not installed():
        raise InputError(
            "OpenCV is not installed", where="backend", found="backend='cv2'",
            hint='pip install "loadid[vision]", or leave backend out: scipy finds the same dots, more slowly',
        )  # fmt: skip
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
    return np.asarray((weights / weights.sum()).astype(np.float32))


@cache
def _opencv() -> Backend:
    cv2 = opencv()

    def smooth(image: Image, sigma: float) -> Image:
        weights = gaussian(sigma)
        return np.asarray(cv2.sepFilter2D(image, cv2.CV_32F, weights, weights, borderType=cv2.BORDER_REPLICATE))

    def box(image: Image, width: int) -> Image:
        return np.asarray(cv2.blur(image, (width, width), borderType=cv2.BORDER_REPLICATE))

    return Backend("cv2", smooth, box)


@cache
def _scipy() -> Backend:
    from scipy import ndimage

    def smooth(image: Image, sigma: float) -> Image:
        weights = gaussian(sigma)
        return np.asarray(
            ndimage.correlate1d(ndimage.correlate1d(image, weights, axis=0, mode="nearest"), weights, mode="nearest")
        )

    def box(image: Image, width: int) -> Image:
        return np.asarray(ndimage.uniform_filter(image, width, mode="nearest"))

    return Backend("scipy", smooth, box)


EDGE = 3.0  # standard deviations of the blur beyond the rim of a dot that are drawn


@dataclass(frozen=True)
class Scene:
    """How the images look.

    `size` in rows and columns; the radius of a dot in px for `draw`, in m for `photograph`; std of the optical blur in
    px; std of the noise, levels of the gel and of a dot in grey levels; `shading`, by how many the gel is darker at the
    corners.
    """

    size: tuple[int, int] = (480, 640)
    radius: float = 5.0
    blur: float = 1.0
    noise: float = 2.0
    background: float = 160.0
    dot: float = 60.0
    shading: float = 30.0

    def __post_init__(self) -> None:
        for name in ("radius", "blur"):
            object.__setattr__(self, name, positive(name, getattr(self, name), where="Scene"))
        if number("noise", self.noise, where="Scene") < 0:
            raise InputError("noise must not be negative", where="Scene", found=self.noise)

    def draw(self, centres: ArrayLike, *, seed: int | np.random.Generator = 0) -> NDArray[np.uint8]:
        """Image of round dots at places (N, 2) in px, x to the right and y down; NaN draws none."""
        places = _finite(centres, PLANE)
        rows, columns, xy = self._windows(places, np.full(len(places), self.radius))
        distance = np.hypot(*np.moveaxis(xy - places[:, None, None], -1, 0))
        return self._finish(self._cover(rows, columns, distance - self._rim(np.array(self.radius))), seed)

    def photograph(
        self, view: View, markers: ArrayLike, *, seed: int | np.random.Generator = 0, exact: bool = True
    ) -> NDArray[np.uint8]:
        """Image of dots printed on a pad, through a view.

        Their centres (N, 2 or 3) are in m; the third column is the height above the plane at rest. Where a pixel sees
        the pad is asked of the view for each, or with ``exact=False`` for nine about each dot, and biquadratic between
        them: a marker is found then within 0.002 px, in a tenth of the time.
        """
        places = _finite(markers, PLANE, SPACE)
        centres = view.to_pixels(places)
        scale = _scale(view, centres)
        rows, columns, xy = self._windows(centres, self.radius * scale)
        heights = places[:, 2] if places.shape[1] == 3 else np.zeros(len(places))
        w = xy.shape[1]
        asked = xy if exact else xy[:, :: w // 2, :: w // 2]
        n = asked.shape[1]
        pad = view.in_plane(asked.reshape(-1, 2), np.repeat(heights, n * n)).reshape(-1, n, n, 2)
        if not exact:
            along = _quadratic(w)
            pad = np.einsum("ai,kijc,bj->kabc", along, pad, along, optimize=True)
        distance = np.hypot(*np.moveaxis(pad - places[:, None, None, :2], -1, 0))
        px = scale[:, None, None]
        return self._finish(self._cover(rows, columns, distance * px - self._rim(self.radius * px)), seed)

    def _rim(self, radius: Array) -> Array:
        """Radius in px at which a blurred disc is half dark: its area stays that of the disc."""
        return np.sqrt(np.maximum(radius**2 - self.blur**2, (0.1 * radius) ** 2))

    def _windows(self, centres: NDArray[Any], radius: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Rows and columns of the squares around some dots, and their pixels (k, w, w, 2) as x, y."""
        reach = int(np.ceil(1.3 * radius.max(initial=1.0) + EDGE * self.blur)) + 1
        offset = np.arange(-reach, reach + 1)
        middle = np.round(centres).astype(int)
        columns, rows = middle[:, 0, None] + offset, middle[:, 1, None] + offset
        shape = (len(centres), len(offset), len(offset))
        x, y = np.broadcast_to(columns[:, None, :], shape), np.broadcast_to(rows[:, :, None], shape)
        return rows, columns, np.stack([x, y], axis=-1).astype(float)

    def _cover(self, rows: NDArray[Any], columns: NDArray[Any], outside: NDArray[Any]) -> Array:
        """Share of every pixel that dots cover, from the distance outside their rims in px; the blur is in it."""
        from scipy.special import erfc

        h, w = self.size
        share = np.zeros((h, w))
        inside = ((rows >= 0) & (rows < h))[:, :, None] & ((columns >= 0) & (columns < w))[:, None, :]
        y = np.broadcast_to(rows[:, :, None], inside.shape)[inside]
        x = np.broadcast_to(columns[:, None, :], inside.shape)[inside]
        np.maximum.at(share, (y, x), 0.5 * erfc(outside[inside] / (np.sqrt(2) * self.blur)))
        return share

    def _finish(self, share: NDArray[Any], seed: int | np.random.Generator) -> NDArray[np.uint8]:
        h, w = self.size
        y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None, :]
        gel = self.background - 0.5 * self.shading * (x**2 + y**2)
        grey = gel + share * (self.dot - gel)
        grey += self.noise * np.random.default_rng(seed).standard_normal(grey.shape)
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def _quadratic(count: int) -> Array:
    """Weights (count, 3) of the parabola through the first, the middle and the last of so many points."""
    t = np.linspace(-1, 1, count)
    return np.column_stack([t * (t - 1) / 2, 1 - t**2, t * (t + 1) / 2])


def grid(rows: int, columns: int, pitch: float, *, centre: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Places of a regular pattern, shape (rows * columns, 2), row by row, x first."""
    y, x = np.mgrid[:rows, :columns]
    places = np.column_stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2])
    return np.asarray(pitch * places + np.asarray(plain(centre), float))


def _finite(points: ArrayLike, *columns: Shape) -> Array:
    """The places that are finite."""
    found = shaped(points, *columns, where="places of the dots", what="no places of dots", lost=True)
    return found[np.isfinite(found).all(axis=1)]


def _scale(view: View, centres: NDArray[Any]) -> Array:
    """Pixels per metre around some pixels: root of the area that a square pixel covers on the pad, inverted."""
    a, b, c = (view.to_pad(centres + step) for step in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    u, v = b - a, c - a
    return 1 / np.sqrt(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
