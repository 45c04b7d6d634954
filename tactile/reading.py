"""What reaches a sensor beside the markers: depth maps as measured normal motion, and a force/torque sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from structures.errors import InputError
from structures.values import plain, positive, reals

Array = NDArray[np.float64]
HALF = 0.5  # share of a window's pixels that must be there


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Normal motion of the surface on a grid of pixels.

    Parameters
    ----------
    values : array (H, W)
        Motion u_z (m), outward positive: a press is negative. Row 0 lies at the smallest y, column 0 at the smallest
        x. NaN where there is none.
    pixel : float
        Size of a pixel (m).
    noise : float
        Std of one pixel (m), independent between pixels.
    centre : (x, y)
        Centre of the map in the frame of the pad (m).
    """

    values: Array
    pixel: float
    noise: float
    centre: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        values = reals(self.values, what="the depth map is no real numbers", where="DepthMap")
        if values.ndim != 2 or min(values.shape) < 2 or np.any(np.isinf(values)):
            raise InputError("no depth map", where="DepthMap", found=f"shape {values.shape}, or infinity",
                             expected="(H, W), NaN where there is none")  # fmt: skip
        object.__setattr__(self, "values", values)
        positive("the pixel", self.pixel, where="DepthMap", unit="m")
        positive("the noise", self.noise, where="DepthMap", unit="m")

    @property
    def axes(self) -> tuple[Array, Array]:
        """Places of rows and columns: y (H,) and x (W,) in m."""
        y, x = ((np.arange(n) - (n - 1) / 2) * self.pixel for n in self.values.shape)
        return y + self.centre[1], x + self.centre[0]

    def at(self, points: ArrayLike) -> Array:
        """Motion at points (n, 2), bilinear; NaN outside and beside missing pixels."""
        from scipy.ndimage import map_coordinates

        points = np.asarray(plain(points), float)
        y, x = self.axes
        where = np.array([(points[:, 1] - y[0]) / self.pixel, (points[:, 0] - x[0]) / self.pixel])
        return np.asarray(map_coordinates(self.values, where, order=1, mode="constant", cval=np.nan))


@dataclass(frozen=True, eq=False)
class Averaging:
    """Means of a depth map over square windows about points: built once, one sparse product per frame.

    Parameters
    ----------
    weights : sparse (n, H W)
        Share of each pixel in each window, by the area that they have in common: rows sum to one.
    covered : array (n,)
        Share of each window that the map covers.
    """

    weights: sparse.csr_array
    covered: Array

    @classmethod
    def over(cls, depth: DepthMap, points: ArrayLike, width: float) -> Averaging:
        """Windows of `width` (m) about `points` (n, 2)."""
        points = np.asarray(plain(points), float)
        y, x = depth.axes
        along = [_overlap(a, points[:, k], width, depth.pixel) for k, a in ((1, y), (0, x))]
        rows, columns, data = [], [], []
        for i, ((j, v), (k, w)) in enumerate(zip(*along, strict=True)):
            weight = np.outer(v, w).ravel()
            rows.append(np.full(weight.size, i))
            columns.append((j[:, None] * len(x) + k).ravel())
            data.append(weight)
        owner, values = np.concatenate(rows), np.concatenate(data)
        area = np.bincount(owner, values, minlength=len(points))
        values = values / np.where(area > 0, area, 1.0)[owner]
        shape = (len(points), depth.values.size)
        return cls(sparse.csr_array((values, (owner, np.concatenate(columns))), shape=shape), area / width**2)

    def means(self, depth: DepthMap) -> Array:
        """Mean motion in each window (n,) over the pixels that are there; NaN where less than half of them are."""
        values = depth.values.ravel()
        known = np.isfinite(values)
        if known.all():
            return np.where(self.covered > 0, self.weights @ values, np.nan)
        got = self.weights @ known
        mean = (self.weights @ np.where(known, values, 0.0)) / np.maximum(got, HALF)
        return np.where((got >= HALF) & (self.covered > 0), mean, np.nan)

    def std(self, noise: float) -> Array:
        """Std of the means (n,) for independent pixels; windows that share pixels at their rims count as apart."""
        return noise * np.sqrt(np.asarray(self.weights.multiply(self.weights).sum(axis=1)).ravel())


def _overlap(pixels: Array, centres: Array, width: float, pixel: float) -> list[tuple[NDArray[np.intp], Array]]:
    """Pixels of a line that each window touches, and by how much (m)."""
    half, own = width / 2, pixel / 2
    first = np.searchsorted(pixels + own, centres - half, side="right")
    last = np.searchsorted(pixels - own, centres + half, side="left")
    out = []
    for a, b, c in zip(first, last, centres, strict=True):
        here = np.arange(a, b)
        common = np.minimum(pixels[here] + own, c + half) - np.maximum(pixels[here] - own, c - half)
        keep = common > 1e-9 * pixel
        out.append((here[keep], common[keep]))
    return out


@dataclass(frozen=True, eq=False)
class Wrench:
    """What a force/torque sensor says acts on the pad.

    Parameters
    ----------
    force : array (3,)
        N.
    torque : array (3,), optional
        N m about the centre of the loaded surface; left out where not given.
    std : array (3,) or (6,), optional
        Standard deviations; without them the equality is exact.
    """

    force: Array
    torque: Array | None = None
    std: Array | None = None

    def __post_init__(self) -> None:
        for name, count in (("force", {3}), ("torque", {3}), ("std", {3, 6})):
            value = getattr(self, name)
            if value is None:
                continue
            found = reals(value, what=f"the {name} is no real numbers", where="Wrench")
            if found.shape not in {(c,) for c in count} or not np.all(np.isfinite(found)):
                raise InputError(f"the {name} does not fit", where="Wrench", found=f"shape {found.shape}, or NaN",
                                 expected=f"finite, ({' or '.join(map(str, sorted(count)))},)")  # fmt: skip
            object.__setattr__(self, name, found)
        if self.std is not None and (len(self.std) != len(self.value) or not np.all(self.std > 0)):
            raise InputError("the stds do not fit what was measured", where="Wrench", found=self.std,
                             expected=f"{len(self.value)} numbers > 0")  # fmt: skip

    @property
    def value(self) -> Array:
        """Force, and torque where it was measured, (3,) or (6,)."""
        return self.force if self.torque is None else np.concatenate([self.force, self.torque])
