"""What a sensor is given: markers, depth maps, a force/torque sensor; one row per marker and direction or window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structures._advice import Advice, Spelling
from structures._channels import Channel
from structures.errors import InputError, one_of, pair, plain

from .._arrays import JITTER, MOTION, NOISE, PIXEL, PLACE, PLANE, SPACE, Array, Index, Mask, shaped, squashed

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
        values = shaped(self.values, (None, None), where="DepthMap", what="no depth map", fewest=2, lost=True)
        if values.shape[1] < 2:
            raise InputError("no depth map", where="DepthMap", found=f"shape {values.shape}", expected="(H, W)")
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "centre", pair("centre", self.centre, where="DepthMap", unit="m"))
        PIXEL.positive("the pixel", self.pixel, where="DepthMap")
        NOISE.positive("the noise", self.noise, where="DepthMap")

    @property
    def axes(self) -> tuple[Array, Array]:
        """Places of rows and columns: y (H,) and x (W,) in m."""
        y, x = ((np.arange(n) - (n - 1) / 2) * self.pixel for n in self.values.shape)
        return y + self.centre[1], x + self.centre[0]

    def at(self, points: ArrayLike) -> Array:
        """Motion at points (n, 2), bilinear; NaN outside and beside missing pixels."""
        from scipy.ndimage import map_coordinates

        points = shaped(points, PLANE, where="DepthMap, points", lost=True)
        y, x = self.axes
        where = np.array([(points[:, 1] - y[0]) / self.pixel, (points[:, 0] - x[0]) / self.pixel])
        return np.asarray(map_coordinates(self.values, where, order=1, mode="constant", cval=np.nan))


@dataclass(frozen=True, eq=False)
class Averaging:
    """Means of a depth map over square windows about points: built once, one sparse product per frame.

    `weights` (n, H W) are the share of each pixel in each window, by the area in common, rows sum to one; `covered`
    (n,) is the share of each window that the map covers.
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
        return np.asarray(noise * np.sqrt(np.asarray(self.weights.multiply(self.weights).sum(axis=1)).ravel()))


def _overlap(pixels: Array, centres: Array, width: float, pixel: float) -> list[tuple[Index, Array]]:
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
        for name, shapes in (("force", ((3,),)), ("torque", ((3,),)), ("std", ((3,), (6,)))):
            value = getattr(self, name)
            if value is not None:
                found = shaped(value, *shapes, where="Wrench", what=f"the {name} does not fit")
                object.__setattr__(self, name, found)
        if self.std is not None and (len(self.std) != len(self.value) or not np.all(self.std > 0)):
            raise InputError("the stds do not fit what was measured", where="Wrench", found=self.std,
                             expected=f"{len(self.value)} numbers > 0")  # fmt: skip

    def require_scale(self, E: float, nu: float, size: tuple[float, float], thickness: float) -> None:
        """Refuse what no pad of this modulus (Pa), Poisson's ratio, size and thickness (m) bears."""
        most = squashed(E, nu, size, thickness)
        arm = float(np.hypot(*size))
        for name, value, limit, unit, others in (
            ("force", self.force, most, "N", (("mN", 1e-3), ("grams", 9.81e-3))),
            ("torque", self.torque, most * arm, "N m", (("N mm", 1e-3),)),
        ):
            if value is not None and (large := float(np.abs(value).max())) > limit:
                typed = " or ".join(f"{f * large:.3g} {unit} if it was given in {other}" for other, f in others)
                raise InputError(
                    f"a {name} that would press the whole pad flat", where="wrench", found=f"{large:.4g} {unit}",
                    expected=f"less than {limit:.3g} {unit}", hint=f"convert it: it is {typed}",
                )  # fmt: skip

    @property
    def value(self) -> Array:
        """Force, and torque where it was measured, (3,) or (6,)."""
        return self.force if self.torque is None else np.concatenate([self.force, self.torque])


FEWEST = 3  # markers
COVERED = 0.999  # share of a window that a depth map must cover: a part of it lies beside its node
QUARTERS = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]) / 4


@dataclass(frozen=True, eq=False)
class Markers:
    """Markers on or under the surface, and what of their motion is seen.

    Parameters
    ----------
    points : array (N, 2) or (N, 3)
        Places at rest (m) in the frame of the pad; two columns are on the surface.
    noise : float or array (N,), (axes,) or (N, axes)
        Std of their motion (m), independent of each other.
    axes : str
        ``"XY"`` for in-plane motion, ``"XYZ"`` where all of it is tracked.
    slope : array (N, 2), optional
        Apparent in-plane motion per unit of normal motion: projection and refraction of a camera. The readings are
        then apparent motions, and the inversion tells tangential from normal motion.

    Raises
    ------
    InputError
        Fewer than three markers, shapes that do not fit, NaN.
    """

    points: Array
    noise: Any
    axes: str = "XY"
    slope: Array | None = None

    def __post_init__(self) -> None:
        hint = "finite places (N, 2) on the surface, or (N, 3), in m: three are the least that make a map of anything"
        points = shaped(
            self.points, PLANE, SPACE, where="markers", what="no markers, or too few markers", fewest=FEWEST, hint=hint
        )
        PLACE.inside("a place", float(np.abs(points).max()), where="markers")
        one_of("no axes of a motion", self.axes, ("XY", "XYZ"), where="axes")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "noise", self._spread(points))
        if self.slope is not None:
            what = "the slopes do not fit the markers"
            slope = shaped(self.slope, (len(points), 2), where="markers, slope", what=what)
            object.__setattr__(self, "slope", slope)

    def _spread(self, points: Array) -> Array:
        count, axes = len(points), len(self.axes)
        what, hint = (
            "the noise does not fit the markers",
            "the std > 0 of the motion of markers of the unloaded sensor, in m",
        )
        shapes: tuple[tuple[int, ...], ...] = ((), (axes,), (count,), (count, 1), (count, axes))
        noise = shaped(self.noise, *shapes, where="markers, noise", what=what, hint=hint)
        if noise.shape == (count,) and count != axes:
            noise = noise[:, None]
        if not np.all(noise > 0):
            raise InputError(what, where="markers, noise", found=noise.min(), expected="stds > 0", hint=hint)
        JITTER.inside("the noise", float(noise.max()), where="markers, noise")
        return np.broadcast_to(noise, (count, axes)).copy()

    def __len__(self) -> int:
        return len(self.points)

    @property
    def readings_count(self) -> int:
        """Readings of a frame: markers times axes."""
        return len(self) * len(self.axes)

    @cached_property
    def channels(self) -> list[Channel]:
        """A sensor for each marker and axis."""
        return [
            Channel(label=f"m{i}+{a}", quantity="displacement", unit="m", noise=float(self.noise[i, k]))
            for i in range(len(self))
            for k, a in enumerate(self.axes)
        ]

    def rows(self, motion: Any) -> Any:
        """Rows of what is read from rows (3 N, n) of the motion of the markers."""
        count = len(self)
        if self.slope is None:
            keep = (3 * np.arange(count)[:, None] + np.arange(len(self.axes))).ravel()
            return motion[keep]
        z = motion[2::3]
        parts = [motion[k::3] + sparse.diags_array(self.slope[:, k]) @ z for k in range(2)]
        if self.axes == "XYZ":
            parts.append(z)
        order = np.arange(count * len(parts)).reshape(len(parts), count).T.ravel()
        stacked = sparse.vstack(parts).tocsr() if sparse.issparse(motion) else np.vstack(parts)
        return stacked[order]

    def readings(self, motion: ArrayLike) -> Array:
        """Readings (N axes,) of a motion (N, 2 or 3); NaN where a marker is lost.

        Raises
        ------
        InputError
            If it does not fit, or holds infinity.
        """
        axes = len(self.axes)
        found = shaped(
            motion, (len(self), axes), (len(self), 3), where="displacements", lost=True,
            what="the displacements do not fit the markers",
            hint="one row per marker in m, in the order in which the sensor was built, NaN where one is lost",
        )  # fmt: skip
        found = found[:, :axes]
        self._require_scale(found)
        return np.where(np.isnan(found).any(axis=1, keepdims=True), np.nan, found).ravel()

    @cached_property
    def _extent(self) -> float:
        """Longer side of the rectangle around the markers (m)."""
        return float(np.ptp(self.points[:, :2], axis=0).max())

    def _require_scale(self, motion: Array) -> None:
        """Refuse motion (N, axes) of which half is longer than the whole pattern, as that of one in mm is."""
        size = np.abs(motion)
        if np.nanmax(size, initial=0.0) <= self._extent:
            return
        middle = float(np.median(size[np.isfinite(size).all(axis=1)].max(axis=1)))
        if middle > self._extent:
            raise InputError(
                "the markers move farther than their pattern is wide", where="displacements",
                found=f"{middle:.4g} m for half of them", expected=f"less than {self._extent:.3g} m",
                hint=f"{MOTION.likely(middle)}; motion from rest is meant, no places",
            )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Depths:
    """A depth map as readings: the mean normal motion in a window of side `width` about each of points (n, 2), m.

    Of maps of the size, pixel and noise of the `template`, whose values do not matter. Points that it does not cover
    are dropped: `inside` says which of those that were given stay.
    """

    template: DepthMap
    points: Array
    width: float
    inside: Mask = field(init=False, repr=False)

    def __post_init__(self) -> None:
        inside = Averaging.over(self.template, self.points, self.width).covered > COVERED
        if not inside.any():
            raise InputError(
                "the depth map does not lie on the pad", where="depth", found=f"{self.template.axes}",
                expected="pixels over the surface",
                hint=Advice(Spelling("centre=", "in the pad file, [depth] centre"), " places it"),
            )  # fmt: skip
        object.__setattr__(self, "points", np.asarray(self.points, float)[inside])
        object.__setattr__(self, "inside", inside)

    @cached_property
    def averaging(self) -> Averaging:
        """The windows over the pixels."""
        return Averaging.over(self.template, self.points, self.width)

    @cached_property
    def channels(self) -> list[Channel]:
        """A sensor for each window; those that overlap share pixels, and count for less."""
        spread = self.averaging.std(self.template.noise) * self.overlap
        return [Channel(label=f"z{i}", quantity="displacement", unit="m", noise=float(s)) for i, s in enumerate(spread)]

    @cached_property
    def noise(self) -> float:
        """Largest std of a mean (m)."""
        return float(self.averaging.std(self.template.noise).max())

    @cached_property
    def overlap(self) -> float:
        """How many windows share a pixel, along a line: their side over the distance of their centres."""
        from scipy.spatial import cKDTree

        if len(self.points) < 2:
            return 1.0
        return max(1.0, self.width / float(np.median(cKDTree(self.points).query(self.points, k=2)[0][:, 1])))

    @property
    def samples(self) -> Array:
        """Four points in each window (4 n, 2), whose mean is that of a bilinear motion over it."""
        return (self.points[:, None, :] + self.width * QUARTERS).reshape(-1, 2)

    def rows(self, motion: Any) -> Any:
        """Rows of the means from rows (12 n, columns) of the motion of `samples`."""
        z = motion[2::3]
        count = z.shape[0] // 4
        mean = sparse.kron(sparse.eye_array(count), np.full((1, 4), 0.25)).tocsr()
        return mean @ z

    def readings(self, depth: DepthMap) -> Array:
        """Mean motion in every window (n,), NaN where pixels are missing, of a map of the template's size and scale."""
        t = self.template
        same = isinstance(depth, DepthMap) and depth.values.shape == t.values.shape
        if not same or depth.pixel != t.pixel or tuple(depth.centre) != tuple(t.centre):
            raise InputError(
                "the depth map is of another kind than the one the sensor was built for", where="depth",
                found=f"{depth.values.shape}, pixel {depth.pixel:g} m" if isinstance(depth, DepthMap) else type(depth),
                expected=f"{t.values.shape}, pixel {t.pixel:g} m, centre {tuple(t.centre)}",
                hint="build the sensor with depth= a map of the kind that it will see",
            )  # fmt: skip
        return self.averaging.means(depth)


def stacked(parts: Sequence[Any]) -> Any:
    """Rows under each other, sparse where all of them are."""
    if all(sparse.issparse(p) for p in parts):
        return sparse.vstack(parts).tocsr()
    return np.vstack([p.toarray() if sparse.issparse(p) else p for p in parts])
