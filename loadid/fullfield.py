"""Pressure on a thin plate from full-field data: deflections or slopes on a dense grid.

Of deflectometry or image correlation, by the virtual fields method (F. Pierron, M. Grediac, The Virtual Fields Method,
Springer 2012): virtual work over a window that slides over the grid. With the virtual deflection
``(1 - s^2)^4 (1 - t^2)^4``, which has no slope, no curvature and no shear at the rim of its window, all derivatives are
taken from the virtual field, and none from the data.
"""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import Structure, units
from structures._readonly import ReadOnly
from structures.errors import InputError, finite, one_of, pair, positive, reals

from ._inverse.shape import moving
from ._inverse.shape.plate import thin_plate

__all__ = ["FieldFrames", "PressureFrames", "acceleration", "read", "virtual_fields"]

Array = NDArray[np.float64]
QUANTITIES = {"deflection": "displacement", "slopes": "angle"}  # of their units
AXES = ("yx", "xy")
FEWEST = 8  # frames that an acceleration is made of
REACH = 4  # points on either side of which a difference is made
SMALLEST, LADDER, LARGEST = 7, 1.25, 0.45  # half a window in points, from one to the next, over the shorter side
CLEAR = 2.0  # stds that two windows may differ by
SHOWN = 48  # points along each side at which windows are compared
ROUNDING = 4e-16  # of the largest reading: noise that is always there


@dataclass(frozen=True, eq=False)
class FieldFrames(ReadOnly):
    """Deflections (frames, ny, nx) in m, or slopes (frames, 2, ny, nx) w_x, w_y in rad; y rises along the rows.

    Parameters
    ----------
    values : array
    quantity : {"deflection", "slopes"}
    spacing : (dx, dy)
        Of the grid, m.
    acceleration : array, shape (frames, ny, nx), optional
        m/s^2.
    dt : float, optional
        Step of the frames (s): deflections without their acceleration are then smoothed over time for it. Without
        either the plate is at rest.
    """

    values: Array
    quantity: str
    spacing: tuple[float, float]
    acceleration: Array | None = None
    dt: float | None = None

    def __post_init__(self) -> None:
        one_of("unknown quantity of a field", self.quantity, QUANTITIES, where="FieldFrames")
        put = object.__setattr__
        put(self, "spacing", pair("spacing", self.spacing, where="FieldFrames", unit="m"))
        for step in self.spacing:
            positive("spacing", step, where="FieldFrames", unit="m")
        rank = 3 if self.quantity == "deflection" else 4
        values = _frames(self.values, rank, "values")
        if rank == 4 and values.shape[1] != 2:
            raise InputError("slopes come in pairs", where="FieldFrames", found=f"shape {values.shape}",
                             expected="(frames, 2, ny, nx): w_x and w_y")  # fmt: skip
        put(self, "values", values)
        if self.dt is not None:
            positive("dt", self.dt, where="FieldFrames", unit="s")
            if self.acceleration is None and (rank == 4 or len(values) < FEWEST):
                raise InputError("no acceleration follows from these frames", where="FieldFrames",
                                 found=f"{len(values)} frames of {self.quantity}",
                                 expected=f"at least {FEWEST} frames of deflections, or acceleration=")  # fmt: skip
        if self.acceleration is not None:
            put(self, "acceleration", _frames(self.acceleration, 3, "acceleration"))
            if self.acceleration.shape != (len(values), *values.shape[-2:]):
                raise InputError("acceleration and field have different grids", where="FieldFrames",
                                 found=f"{self.acceleration.shape}",
                                 expected=f"{(len(values), *values.shape[-2:])}")  # fmt: skip


@dataclass(frozen=True, eq=False)
class PressureFrames(ReadOnly):
    """Pressure (frames, ny, nx) in Pa, positive along the deflection; NaN in the rim of half a window.

    Parameters
    ----------
    pressure : array
    std : float
        Of every value, from the noise of the data alone; that of an acceleration made of the frames is in it.
    bias : float
        Rms of what a window of 1.25 times the size changes: how much detail the window smooths away, about.
    window : (int, int)
        Points of the window along x and y.
    noise : float
        Std of the data that the answer stands on.
    """

    pressure: Array
    std: float
    bias: float
    window: tuple[int, int]
    noise: float


def read(
    source: Any, *, quantity: str, unit: str, spacing: tuple[float, float], axes: str, up: bool,
    dataset: str | None = None, acceleration: Any = None, dt: float | None = None,
) -> FieldFrames:  # fmt: skip
    """Frames from an array, or from a data set of an HDF5 file. Units and orientation are asked, never guessed.

    Parameters
    ----------
    source : array, or path
        (ny, nx) or (frames, ny, nx); slopes with an axis of two, w_x and w_y, before the grid.
    quantity : {"deflection", "slopes"}
    unit : str
        Of the values: ``"m"``, ``"mm"``, ``"um"``; ``"rad"``, ``"mrad"``.
    spacing : (dx, dy)
        m.
    axes : {"yx", "xy"}
        What the last two axes are.
    up : bool
        Whether y rises with its index; False of images, whose first row is the top one. Slopes w_y are those along the
        rising y in either case.
    dataset : str, optional
        Of an HDF5 file.
    acceleration : array, optional
        In m/s^2, laid out as the deflection.
    dt : float, optional
        Step of the frames (s), for the acceleration of deflections.

    Raises
    ------
    InputError
        What is missing or does not fit, NaN, no such file or data set.
    """
    one_of("the axes of the grid are not stated", axes, AXES, where="fullfield.read")
    one_of("unknown quantity of a field", quantity, QUANTITIES, where="fullfield.read")
    if isinstance(source, str | os.PathLike):
        source = _hdf5(source, dataset)
    values = units.to_si(reals(source, where="fullfield.read"), unit, quantity=QUANTITIES[quantity])
    values = _turned(values, axes, up)
    shape = 2 if quantity == "deflection" else 3
    values = values[None] if values.ndim == shape else values
    rate = None
    if acceleration is not None:
        rate = _turned(reals(acceleration, where="fullfield.read"), axes, up)
        rate = rate[None] if rate.ndim == 2 else rate
    return FieldFrames(values, quantity, spacing, rate, dt)


def virtual_fields(
    field: FieldFrames, plate: Structure, *, noise: float | None = None, window: int | None = None
) -> PressureFrames:
    """Pressure by the virtual fields method, over a window that a rule chooses.

    Parameters
    ----------
    field : FieldFrames
    plate : Structure
        Of `structures.plates.plate`: its rigidity and mass; the grid may be any part of it.
    noise : float, optional
        Std of the data (m or rad); by their fourth differences where not given.
    window : int, optional
        Points along x, odd. Default: the largest window that agrees, to within twice its noise, with every smaller one
        (O. V. Lepskii, Theory Probab. Appl. 35 (1990) 454).

    Raises
    ------
    InputError
        A grid of too few points, or a window that does not fit it.
    """
    thin = thin_plate(plate, moving=False)
    dx, dy = field.spacing
    ny, nx = field.values.shape[-2:]
    most = int(LARGEST * min(nx, ny * dy / dx))
    if window is not None and (window % 2 == 0 or not 2 * SMALLEST + 1 <= window <= min(nx, ny * dy / dx)):
        raise InputError("the window does not fit the grid", where="virtual_fields", found=window,
                         expected=f"an odd number from {2 * SMALLEST + 1} to {int(min(nx, ny * dy / dx))}")  # fmt: skip
    if most < SMALLEST:
        raise InputError("the grid has too few points", where="virtual_fields", found=f"{nx} x {ny}",
                         expected=f"at least {int(SMALLEST / LARGEST) + 1} along each side")  # fmt: skip
    level = _noise(field.values) if noise is None else positive("noise", noise, where="virtual_fields")
    level = max(level, ROUNDING * float(np.abs(field.values).max()))
    pull, loose = field.acceleration, 0.0
    if pull is None and field.dt is not None:
        pull, loose = acceleration(field, level)
    work = _Work(field, pull, thin.rigidity, thin.mass)
    halves = [(window - 1) // 2] if window is not None else _ladder(most)
    half, seen, std = 0, np.zeros(0), 0.0
    smaller: list[tuple[Array, float]] = []
    for tried in halves:
        shown, gain = work.shown(tried), level * work.gain(tried)
        if any(_apart(shown, p) > CLEAR * s for p, s in smaller):
            break
        half, seen, std = tried, shown, gain
        smaller.append((shown, gain))
    wide = min(int(half * LADDER) + 1, (int(min(nx, ny * dy / dx)) - 3) // 2)
    bias = _apart(seen, work.shown(wide))
    std = float(np.hypot(std, thin.mass * loose))
    return PressureFrames(work.pressure(half), std, bias, (2 * half + 1, 2 * work.across(half) + 1), level)


def acceleration(field: FieldFrames, noise: float) -> tuple[Array, float]:
    """Acceleration (frames, ny, nx) of deflections, and its rms std, both in m/s^2.

    The singular directions of the frames above the noise (threshold of M. Gavish, D. L. Donoho, IEEE Trans. Inf. Theory
    60 (2014) 5040) are smoothed over time, each by its own correlation length. A state-space smoother of a Matern
    process answers the second derivative; nothing is differenced.

    Parameters
    ----------
    field : FieldFrames
        Deflections, with dt.
    noise : float
        Std of the deflections (m).
    """
    w = field.values.reshape(len(field.values), -1)
    assert field.dt is not None
    U, s, V = np.linalg.svd(w, full_matrices=False)
    ratio = min(w.shape) / max(w.shape)
    least = np.sqrt(2 * (ratio + 1) + 8 * ratio / (ratio + 1 + np.sqrt(ratio * ratio + 14 * ratio + 1)))
    heard = np.flatnonzero(s > noise * least * np.sqrt(max(w.shape)))
    found, variance = np.zeros(w.shape), 0.0
    for k in heard:
        series = U[:, k : k + 1] * s[k] / noise
        size = float(np.sqrt(np.mean(series**2)))
        motion = moving.smoothed(series, np.ones(1), size, field.dt)
        found += noise * motion.mean[:, :, 2] * V[k]
        variance += noise**2 * float(np.mean(motion.covariance[:, 0, 2, 2])) / w.shape[1]
    return found.reshape(field.values.shape), float(np.sqrt(variance))


# -- inside ------------------------------------------------------------------------------------------------------------
def _frames(values: ArrayLike, rank: int, what: str) -> Array:
    array = reals(values, where=f"FieldFrames, {what}")
    if array.ndim != rank or 0 in array.shape:
        raise InputError("the frames have another shape", where=f"FieldFrames, {what}", found=f"shape {array.shape}",
                         expected="(frames, ny, nx), slopes (frames, 2, ny, nx)")  # fmt: skip
    finite(array, where=f"FieldFrames, {what}", hint="cut the grid to where there are data")
    array.setflags(write=False)
    return array


def _turned(values: Array, axes: str, up: bool) -> Array:
    values = np.swapaxes(values, -1, -2) if axes == "xy" else values
    return values if up else values[..., ::-1, :]


def _hdf5(path: str | os.PathLike[str], dataset: str | None) -> Array:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            names = [name for name in file if isinstance(file[name], h5py.Dataset)]
            if dataset is None or not isinstance(file.get(dataset), h5py.Dataset):
                raise InputError("no such data set", where=os.fspath(path), found=dataset, expected=names[:12],
                                 hint="dataset= names it")  # fmt: skip
            return np.asarray(file[dataset][()], float)
    except OSError as error:
        raise InputError(
            "the file is no HDF5", where=os.fspath(path), found=str(error)[:120], expected="a file of arrays"
        ) from None


def _noise(values: Array) -> float:
    """Std of white noise by fourth differences along the rows, robust against what is smooth."""
    fourth = np.diff(values, 4, axis=-1)
    return float(np.median(np.abs(fourth)) / 0.6745 / np.sqrt(70.0))


def _ladder(most: int) -> list[int]:
    """Halves of the windows that are tried."""
    steps = int(np.log(most / SMALLEST) / np.log(LADDER))
    return sorted({int(SMALLEST * LADDER**k) for k in range(steps + 1)})


def _stencil(order: int) -> Array:
    """Differences of nine points that are the derivative of `order` of polynomials up to the eighth degree."""
    at = np.arange(-REACH, REACH + 1.0)
    powers = at[None, :] ** np.arange(len(at))[:, None]
    return np.asarray(np.linalg.solve(powers, math.factorial(order) * (np.arange(len(at)) == order)))


def _bump(half: int, step: float, order: int) -> Array:
    """Derivative of ``(1 - s^2)^4``, by differences, over a window of ``2 half + 1`` points.

    By differences of the virtual field: their sums with the data are those of the differences of the data with it, so
    that polynomials are met exactly however few points the window has.
    """
    inner = half - REACH
    s = np.arange(-inner, inner + 1) / (inner + 1)
    padded = np.pad((1 - s * s) ** 4, REACH)
    return padded if order == 0 else np.asarray(np.convolve(padded, _stencil(order)[::-1], "same") / step**order)


@dataclass(frozen=True, eq=False)
class _Work:
    """Virtual work of a field over windows of any size."""

    field: FieldFrames
    pull: Array | None
    rigidity: float
    mass: float

    def across(self, half: int) -> int:
        """Half a window along y."""
        dx, dy = self.field.spacing
        return max(round(half * dx / dy), SMALLEST)

    def terms(self, half: int) -> tuple[list[tuple[Array, Array, Array]], float]:
        """Fields with their kernels along x and y, over the area of the virtual deflection, and the gain of noise."""
        dx, dy = self.field.spacing
        x, y = ([_bump(h, d, k) for k in range(5)] for h, d in ((half, dx), (self.across(half), dy)))
        size = self.rigidity / float(np.sum(x[0]) * np.sum(y[0]))
        if self.field.quantity == "deflection":
            parts = [[(x[4], y[0]), (2 * x[2], y[2]), (x[0], y[4])]]
            fields = [self.field.values]
        else:
            parts = [[(-x[3], y[0]), (-x[1], y[2])], [(-x[2], y[1]), (-x[0], y[3])]]
            fields = [self.field.values[:, 0], self.field.values[:, 1]]
        kernels = [sum(np.outer(ky, kx) for kx, ky in part) for part in parts]
        gain = size * float(np.sqrt(sum(np.sum(np.square(kernel)) for kernel in kernels)))
        out = [(w, size * kx, ky) for w, part in zip(fields, parts, strict=True) for kx, ky in part]
        if self.pull is not None:
            out.append((self.pull, x[0] * (size * self.mass / self.rigidity), y[0]))
        return out, gain

    def gain(self, half: int) -> float:
        """Std of the pressure per std of the data."""
        return self.terms(half)[1]

    def pressure(self, half: int) -> Array:
        """Pressure (frames, ny, nx), NaN in the rim."""
        found = np.full((len(self.field.values), *self.field.values.shape[-2:]), np.nan)
        other = self.across(half)
        inside = found[:, other : found.shape[1] - other, half : found.shape[2] - half]
        inside[:] = sum(_correlated(w, kx, ky) for w, kx, ky in self.terms(half)[0])
        return found

    def shown(self, half: int) -> Array:
        """The same at no more than `SHOWN` points along each side, by products of matrices."""
        ny, nx = self.field.values.shape[-2:]
        rows, columns = (np.unique(np.linspace(0, n - 1, min(SHOWN, n)).round().astype(int)) for n in (ny, nx))
        found = np.full((len(self.field.values), len(rows), len(columns)), np.nan)
        i, j = (np.flatnonzero((at >= h) & (at < n - h))
                for at, h, n in ((rows, self.across(half), ny), (columns, half, nx)))  # fmt: skip
        found[:, i[:, None], j] = sum(
            _windows(rows[i], ky, ny) @ w @ _windows(columns[j], kx, nx).T for w, kx, ky in self.terms(half)[0]
        )
        return found


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


def _apart(one: Array, other: Array) -> float:
    """Rms difference where both are."""
    both = np.isfinite(one) & np.isfinite(other)
    return float(np.sqrt(np.mean((one[both] - other[both]) ** 2))) if both.any() else 0.0
