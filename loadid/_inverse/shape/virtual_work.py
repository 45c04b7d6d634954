"""Virtual work of a measured field of a thin plate over windows that slide over its grid, and which window serves."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .moving import accelerating, correlation_length
from .plate import ThinPlate

Array = NDArray[np.float64]
REACH = 4  # points on either side of which a difference is made
SMALLEST, LADDER, LARGEST = 7, 1.25, 0.36  # half a window in points, from one to the next, over the shorter side
UNSURE = 2.0  # times the median std of the frames: those that are less certain choose no window
RISEN = 4.0  # of the squared error over its least, where no larger window is tried
SHOWN = 32  # points along each side at which windows are compared


@dataclass(frozen=True, eq=False)
class MadeInertia:
    """Acceleration to be made of deflections: each window smooths its own mean over time.

    Parameters
    ----------
    level : float
        Std of the deflections (m).
    dt : float
        s.
    """

    level: float
    dt: float


@dataclass(frozen=True, eq=False)
class SizedWindow:
    """A window, with what it costs."""

    work: VirtualWork
    half: int
    std: Array
    bias: Array

    @property
    def risk(self) -> float:
        """Squared error, over the frames that are not much less certain than others."""
        fair = self.std <= UNSURE * np.median(self.std)
        return float(np.mean((self.std**2 + self.bias**2)[fair]))


def searched(work: VirtualWork, halves: list[int], largest: int, level: float) -> SizedWindow:
    """The window of the least squared error, up to where this rises."""
    best: SizedWindow | None = None
    at, wider = 0, np.empty(0)
    for half in halves:
        seen = wider if at == half else work.shown(half)
        at = wide = min(int(half * LADDER) + 1, max(largest, half))
        wider = work.shown(wide)
        grown = (wide / half) ** 2 - 1  # of a flat window too: errors of the elements fall no faster
        found = SizedWindow(work, half, work.std(half, level), _apart(seen, wider) / (grown or np.nan))
        if best is not None and found.risk > RISEN * best.risk:  # larger windows agree again on waves that none sees
            break
        best = found if best is None or found.risk < best.risk else best
    assert best is not None
    return best


def ladder(most: int) -> list[int]:
    """Halves of the windows that are tried."""
    steps = int(np.log(most / SMALLEST) / np.log(LADDER))
    return sorted({*(int(SMALLEST * LADDER**k) for k in range(steps + 1)), most})


def _stencil(order: int) -> Array:
    """Differences of nine points that are the derivative of `order` of polynomials up to the eighth degree."""
    at = np.arange(-REACH, REACH + 1.0)
    powers = at[None, :] ** np.arange(len(at))[:, None]
    return np.asarray(np.linalg.solve(powers, math.factorial(order) * (np.arange(len(at)) == order)))


def _bump(half: int, step: float, order: int, flat: bool = False) -> Array:
    """Derivative of ``(1 - s^2)^4``, by differences, over a window of ``2 half + 1`` points.

    Flat: times ``1 - c s^2`` without a second moment, which keeps pressures that are polynomials of the third degree.

    By differences of the virtual field: their sums with the data are those of the differences of the data with it, so
    that polynomials are met exactly however few points the window has.
    """
    inner = half - REACH
    s = np.arange(-inner, inner + 1) / (inner + 1)
    bump = (1 - s * s) ** 4
    if flat:
        bump = bump * (1 - s * s * (bump @ s**2) / (bump @ s**4))
    padded = np.pad(bump, REACH)
    return padded if order == 0 else np.asarray(np.convolve(padded, _stencil(order)[::-1], "same") / step**order)


@dataclass(frozen=True, eq=False)
class VirtualWork:
    """Virtual work of a field over windows of any size.

    Parameters
    ----------
    fields : tuple of arrays (frames, ny, nx)
        The deflection (m), or the slopes along x and along y.
    spacing : (dx, dy)
        m.
    pull : array, shape (frames, ny, nx), optional
        Acceleration (m/s^2).
    rough : float
        Std of its white noise.
    made : MadeInertia, optional
        Without `pull`: it is made of the deflection.
    plate : ThinPlate
    flat : bool
        With virtual deflections that smooth no pressure of the third degree away.
    """

    fields: tuple[Array, ...]
    spacing: tuple[float, float]
    pull: Array | None
    rough: float
    made: MadeInertia | None
    plate: ThinPlate
    flat: bool = False

    def across(self, half: int) -> int:
        """Half a window along y."""
        dx, dy = self.spacing
        return max(round(half * dx / dy), SMALLEST)

    def bumps(self, half: int) -> tuple[list[Array], list[Array], float]:
        """Derivatives of the virtual deflection along x and y, and its volume in points."""
        dx, dy = self.spacing
        x, y = ([_bump(h, d, k, self.flat) for k in range(5)] for h, d in ((half, dx), (self.across(half), dy)))
        return x, y, float(np.sum(x[0]) * np.sum(y[0]))

    def bending(self, half: int) -> list[tuple[Array, list[tuple[Array, Array]]]]:
        """Fields, each with its kernels along x and y, per area of the virtual deflection."""
        x, y, area = self.bumps(half)
        parts = [[(x[4], y[0]), (2 * x[2], y[2]), (x[0], y[4])]]
        if len(self.fields) == 2:
            parts = [[(-x[3], y[0]), (-x[1], y[2])], [(-x[2], y[1]), (-x[0], y[3])]]
        D = self.plate.rigidity / area
        return [(w, [(D * kx, ky) for kx, ky in part]) for w, part in zip(self.fields, parts, strict=True)]

    def inertia(self, half: int) -> list[tuple[Array, Array]]:
        """Kernels of the acceleration: of the mass, and of rotation and shear."""
        x, y, area = self.bumps(half)
        mass, turned = self.plate.mass / area, -self.plate.mass * self.plate.turning / area
        return [(mass * x[0] + turned * x[2], y[0]), (turned * x[0], y[2])]

    def terms(self, half: int) -> list[tuple[Array, Array, Array]]:
        """Fields with their kernels along x and y."""
        out = [(w, kx, ky) for w, part in self.bending(half) for kx, ky in part]
        pull = self.pull
        if self.made is not None:
            pull = np.tensordot(self.accelerating(half)[0], self.fields[0], axes=1)
        return out if pull is None else [*out, *((pull, kx, ky) for kx, ky in self.inertia(half))]

    def accelerating(self, half: int) -> tuple[Array, Array]:
        """Smoother (frames, frames) from deflections to accelerations for this window, and the variance (frames,).

        The mean of a window over the deflections has little noise: it tells how fast what it sees moves, and bears less
        smoothing over time than the deflections do.
        """
        assert self.made is not None
        if half not in self._smoothers:
            kernels = self.inertia(half)
            level = self.made.level * np.sqrt(_squared(kernels))
            means = self._at(half, [(self.fields[0], kx, ky) for kx, ky in kernels]) / level
            series = means[:, np.isfinite(means[0])]
            size = float(np.sqrt(np.mean(series**2)))
            length = correlation_length(series, np.ones(series.shape[1]), size, self.made.dt)
            S, variance = accelerating(size, length, self.made.dt, len(series))
            self._smoothers[half] = S, level**2 * variance
        return self._smoothers[half]

    @cached_property
    def _smoothers(self) -> dict[int, tuple[Array, Array]]:
        return {}

    def std(self, half: int, level: float) -> Array:
        """Of the pressure (frames,), for noise of this level in the field and of the acceleration."""
        variance = np.full(len(self.fields[0]), sum(level**2 * _squared(part) for _, part in self.bending(half)))
        if self.pull is not None:
            variance += self.rough**2 * _squared(self.inertia(half))
        if self.made is not None:
            variance += self.accelerating(half)[1]
        return np.sqrt(variance)

    def pressure(self, half: int) -> Array:
        """Pressure (frames, ny, nx), NaN in the rim."""
        found = np.full((len(self.fields[0]), *self.fields[0].shape[-2:]), np.nan)
        other = self.across(half)
        inside = found[:, other : found.shape[1] - other, half : found.shape[2] - half]
        inside[:] = sum(_correlated(w, kx, ky) for w, kx, ky in self.terms(half))
        return found

    def shown(self, half: int) -> Array:
        """The same at no more than `SHOWN` points along each side, by products of matrices."""
        return self._at(half, self.terms(half))

    def _at(self, half: int, terms: list[tuple[Array, Array, Array]]) -> Array:
        ny, nx = self.fields[0].shape[-2:]
        rows, columns = (np.unique(np.linspace(0, n - 1, min(SHOWN, n)).round().astype(int)) for n in (ny, nx))
        found = np.full((len(terms[0][0]), len(rows), len(columns)), np.nan)
        i, j = (np.flatnonzero((at >= h) & (at < n - h))
                for at, h, n in ((rows, self.across(half), ny), (columns, half, nx)))  # fmt: skip
        kept = []
        for w in {id(w): w for w, _, _ in terms}.values():  # each field is read once for all kernels
            kernels = [(kx, ky) for other, kx, ky in terms if other is w]
            across = np.vstack([_windows(rows[i], ky, ny) for _, ky in kernels]) @ w
            kept += [part @ _windows(columns[j], kx, nx).T for part, (kx, _) in
                     zip(np.split(across, len(kernels), axis=-2), kernels, strict=True)]  # fmt: skip
        found[:, i[:, None], j] = sum(kept)
        return found


def _squared(kernels: list[tuple[Array, Array]]) -> float:
    """Sum of squares of a sum of kernels."""
    return float(np.sum(np.square(sum(np.outer(ky, kx) for kx, ky in kernels))))


def _windows(at: NDArray[np.intp], kernel: Array, count: int) -> Array:
    """Rows (points, count) that hold a kernel about each place."""
    out = np.zeros((len(at), count))
    half = len(kernel) // 2
    for row, middle in zip(out, at, strict=True):
        row[middle - half : middle + half + 1] = kernel
    return out


def _correlated(w: Array, kx: Array, ky: Array) -> Array:
    """Sums of ``w * ky kx`` over every whole window, by products of Fourier transforms along each axis."""
    from scipy.signal import oaconvolve

    once = oaconvolve(w, kx[::-1][None, None, :], mode="valid", axes=2)
    return np.asarray(oaconvolve(once, ky[::-1][None, :, None], mode="valid", axes=1))


def _apart(one: Array, other: Array) -> Array:
    """Rms difference (frames,) where both are."""
    both = np.isfinite(one[0]) & np.isfinite(other[0])
    if not both.any():
        return np.full(len(one), np.nan)
    return np.asarray(np.sqrt(np.mean((one[:, both] - other[:, both]) ** 2, axis=1)))
