"""Images of a dotted pad as a camera would take them: dots at known places, blur, shading, noise, 8 bits.

They give truth to the tests and the demonstration. A dot is a disc on the pad; through a view it is drawn pixel by
pixel where the pad would be seen, so that perspective and refraction deform it as they do in a camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import number, plain, positive, reals

if TYPE_CHECKING:
    from .optics import View

EDGE = 3.0  # standard deviations of the blur beyond the rim of a dot that are drawn


@dataclass(frozen=True)
class Scene:
    """How the images look.

    Parameters
    ----------
    size : (int, int)
        Rows and columns of an image.
    radius : float
        Radius of a dot: px in `draw`, m in `photograph`.
    blur : float
        Standard deviation of the optical blur, px.
    noise : float
        Standard deviation of the noise, grey levels.
    background, dot : float
        Grey levels of the gel and of a dot.
    shading : float
        Grey levels by which the gel is darker at the corners than at the centre.
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
        """Image of round dots at given places.

        Parameters
        ----------
        centres : array, shape (N, 2)
            Places in px, x to the right and y down; NaN draws none.
        seed : int or Generator
            Of the noise.
        """
        places = _seen(centres, 2)
        rows, columns, xy = self._windows(places, np.full(len(places), self.radius))
        distance = np.hypot(*np.moveaxis(xy - places[:, None, None], -1, 0))
        return self._finish(self._cover(rows, columns, distance - self._rim(np.array(self.radius))), seed)

    def photograph(self, view: View, markers: ArrayLike, *, seed: int | np.random.Generator = 0) -> NDArray[np.uint8]:
        """Image of dots printed on a pad, through a view.

        Parameters
        ----------
        view : View
            Camera or homography.
        markers : array, shape (N, 2 or 3)
            Where the centres of the dots are now, m; the third column is the height above the plane at rest.
        seed : int or Generator
            Of the noise.
        """
        places = _seen(markers, None)
        centres = view.to_pixels(places)
        scale = _scale(view, centres)
        rows, columns, xy = self._windows(centres, self.radius * scale)
        heights = places[:, 2] if places.shape[1] == 3 else np.zeros(len(places))
        k, w = xy.shape[0], xy.shape[1]
        pad = view.in_plane(xy.reshape(-1, 2), np.repeat(heights, w * w)).reshape(k, w, w, 2)
        distance = np.hypot(*np.moveaxis(pad - places[:, None, None, :2], -1, 0))
        px = scale[:, None, None]
        return self._finish(self._cover(rows, columns, distance * px - self._rim(self.radius * px)), seed)

    def _rim(self, radius: NDArray[np.float64]) -> NDArray[np.float64]:
        """Radius in px at which a blurred disc is half dark: its area stays that of the disc."""
        return np.sqrt(np.maximum(radius**2 - self.blur**2, (0.1 * radius) ** 2))

    def _windows(self, centres: NDArray, radius: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Rows and columns of the squares around some dots, and their pixels (k, w, w, 2) as x, y."""
        reach = int(np.ceil(1.3 * radius.max(initial=1.0) + EDGE * self.blur)) + 1
        offset = np.arange(-reach, reach + 1)
        middle = np.round(centres).astype(int)
        columns, rows = middle[:, 0, None] + offset, middle[:, 1, None] + offset
        shape = (len(centres), len(offset), len(offset))
        x, y = np.broadcast_to(columns[:, None, :], shape), np.broadcast_to(rows[:, :, None], shape)
        return rows, columns, np.stack([x, y], axis=-1).astype(float)

    def _cover(self, rows: NDArray, columns: NDArray, outside: NDArray) -> NDArray[np.float64]:
        """Share of every pixel that dots cover, from the distance outside their rims in px; the blur is in it."""
        from scipy.special import erfc

        h, w = self.size
        share = np.zeros((h, w))
        inside = ((rows >= 0) & (rows < h))[:, :, None] & ((columns >= 0) & (columns < w))[:, None, :]
        y = np.broadcast_to(rows[:, :, None], inside.shape)[inside]
        x = np.broadcast_to(columns[:, None, :], inside.shape)[inside]
        np.maximum.at(share, (y, x), 0.5 * erfc(outside[inside] / (np.sqrt(2) * self.blur)))
        return share

    def _finish(self, share: NDArray, seed: int | np.random.Generator) -> NDArray[np.uint8]:
        h, w = self.size
        y, x = np.linspace(-1, 1, h)[:, None], np.linspace(-1, 1, w)[None, :]
        gel = self.background - 0.5 * self.shading * (x**2 + y**2)
        grey = gel + share * (self.dot - gel)
        grey += self.noise * np.random.default_rng(seed).standard_normal(grey.shape)
        return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def grid(rows: int, columns: int, pitch: float, *, centre: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    """Places of a regular pattern, shape (rows * columns, 2), row by row, x first."""
    y, x = np.mgrid[:rows, :columns]
    places = np.column_stack([x.ravel() - (columns - 1) / 2, y.ravel() - (rows - 1) / 2])
    return pitch * places + np.asarray(plain(centre), float)


def _seen(points: ArrayLike, columns: int | None) -> NDArray[np.float64]:
    """The places that are finite."""
    array = reals(points, where="places of the dots")
    if array.ndim != 2 or array.shape[1] not in ((columns,) if columns else (2, 3)):
        raise InputError("no places of dots", where="Scene", found=f"shape {array.shape}", expected="(N, 2)")
    return array[np.isfinite(array).all(axis=1)]


def _scale(view: View, centres: NDArray) -> NDArray[np.float64]:
    """Pixels per metre around some pixels: root of the area that a square pixel covers on the pad, inverted."""
    a, b, c = (view.to_pad(centres + step) for step in ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    u, v = b - a, c - a
    return 1 / np.sqrt(np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))
