"""Pressure on a thin plate from full-field data: deflections or slopes on a dense grid.

Of deflectometry or image correlation, by the virtual fields method (F. Pierron, M. Grediac, The Virtual Fields Method,
Springer 2012): virtual work over a window that slides over the grid. With the virtual deflection
``(1 - s^2)^4 (1 - t^2)^4``, which has no slope, no curvature and no shear at the rim of its window, all derivatives are
taken from the virtual field, and none from the data.

Behind the front of a blow the waves are no longer long against the thickness: the work of the inertia has the term of
rotation and shear of R. D. Mindlin (J. Appl. Mech. 18 (1951) 31), ``-rho h r^2 nabla^2 w_tt``, with
``r^2 = h^2 / 12 (1 + 2 / (5/6 (1 - nu)))``.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures import Structure, sensors, units
from structures._readonly import ReadOnly
from structures.errors import InputError, finite, one_of, pair, positive, reals

from ._inverse.shape import moving
from ._inverse.shape.plate import thin_plate
from ._inverse.shape.virtual_work import LADDER, LARGEST, SMALLEST, MadeInertia, VirtualWork, ladder, searched

__all__ = ["FieldFrames", "PressureFrames", "acceleration", "blocks", "read", "virtual_fields"]

Array = NDArray[np.float64]
QUANTITIES = {"deflection": "displacement", "slopes": "angle"}  # of their units
AXES = ("yx", "xy")
FEWEST = 8  # frames that an acceleration is made of
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
    std : array, shape (frames,)
        Of every value of a frame, from the noise of the data alone: of the field, and of the acceleration, given or
        made of the frames, which is large at the ends of a record.
    bias : array, shape (frames,)
        How much detail the window smooths away, about (rms): by what a window of 1.25 times the size changes; NaN where
        none fits.
    window : (int, int)
        Points of the window along x and y.
    noise : float
        Std of the data that the answer stands on.
    """

    pressure: Array
    std: Array
    bias: Array
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
        Points along x, odd. Default: that of the least sum of squares of its noise and of what it smooths away, the
        latter by what the next larger one changes. That change is also what sees errors that are no white noise, as
        those of the elements of a computed field (quasi-optimality: A. N. Tikhonov, V. B. Glasko, USSR Comput. Math.
        Math. Phys. 5 (1965) 93).

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
    pull = _inertia(field, level)
    halves = [(window - 1) // 2] if window is not None else ladder(most)
    largest = int(LADDER * LARGEST * min(nx, ny * dy / dx)) if window is None else (int(min(nx, ny * dy / dx)) - 1) // 2
    w = field.values
    fields = (w,) if field.quantity == "deflection" else (w[:, 0], w[:, 1])
    plain, flat = (VirtualWork(fields, field.spacing, *pull, thin, flat) for flat in (False, True))
    best = searched(plain, halves, largest, level)
    other = searched(flat, [half for half in halves if half >= best.half], largest, level)
    best = other if other.risk < best.risk else best
    size = 2 * best.half + 1, 2 * best.work.across(best.half) + 1
    return PressureFrames(best.work.pressure(best.half), best.std, best.bias, size, level)


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
    _, s, V = np.linalg.svd(w, full_matrices=False)
    ratio = min(w.shape) / max(w.shape)
    least = np.sqrt(2 * (ratio + 1) + 8 * ratio / (ratio + 1 + np.sqrt(ratio * ratio + 14 * ratio + 1)))
    heard = np.flatnonzero(s > noise * least * np.sqrt(max(w.shape)))
    rate, variance = np.zeros((2, len(w), len(heard)))
    for n, k in enumerate(heard):
        series = (w @ V[k])[:, None] / noise
        motion = moving.smoothed(series, np.ones(1), float(np.sqrt(np.mean(series**2))), field.dt)
        rate[:, n], variance[:, n] = noise * motion.mean[:, 0, 2], noise**2 * motion.covariance[:, 0, 2, 2]
    found = (rate @ V[heard]).reshape(field.values.shape)
    return found, float(np.sqrt(np.mean(np.sum(variance, axis=1)) / found[0].size))


def blocks(
    field: FieldFrames, *, count: int = 12, corner: tuple[float, float] = (0.0, 0.0), noise: float | None = None
) -> tuple[list[sensors.Displacement], Array, Array]:
    """Means of blocks of a grid of deflections, as gauges: what `ShapeSensing` takes.

    Its functions know the edges of the plate and answer up to them; they hold no detail finer than the blocks. The mean
    of a block stands for the deflection in its middle: a wave of wavenumber k is `(k h)^2 / 24` too low in blocks of
    side h.

    Parameters
    ----------
    field : FieldFrames
        Deflections.
    count : int
        Blocks along the shorter side of the grid.
    corner : (x, y)
        Of the first point of the grid on the plate (m).
    noise : float, optional
        Std of the deflections (m); by their fourth differences where not given.

    Returns
    -------
    gauges : list of Displacement
    readings : array, shape (frames, gauges)
    noise : array, shape (gauges,)

    Raises
    ------
    InputError
        Slopes, or a grid of fewer points.
    """
    ny, nx = field.values.shape[-2:]
    if field.quantity != "deflection" or not 2 <= count <= min(nx, ny):
        raise InputError("blocks are of deflections", where="blocks", found=f"{nx} x {ny} {field.quantity}, {count}",
                         expected=f"deflections, and 2 to {min(nx, ny)} blocks along a side")  # fmt: skip
    level = _noise(field.values) if noise is None else positive("noise", noise, where="blocks")
    sizes = (field.spacing[0] * nx, field.spacing[1] * ny)
    x, y = (_cuts(n, round(count * size / min(sizes))) for n, size in zip((nx, ny), sizes, strict=True))
    means = np.add.reduceat(np.add.reduceat(field.values, y[:-1], axis=1), x[:-1], axis=2)
    points = np.diff(y)[:, None] * np.diff(x)
    at = [c + d * (i[1:] + i[:-1] - 1) / 2 for c, d, i in zip(corner, field.spacing, (x, y), strict=True)]
    places = [(float(a), float(b)) for b in at[1] for a in at[0]]
    found = [sensors.Displacement(at=p, label=f"{p[0]:.6g} {p[1]:.6g}") for p in places]
    return found, (means / points).reshape(len(means), -1), level / np.sqrt(points.ravel())


# -- inside ------------------------------------------------------------------------------------------------------------
def _inertia(field: FieldFrames, level: float) -> tuple[Array | None, float, MadeInertia | None]:
    """Acceleration, given or made; the std of its white noise; what it is made of."""
    if field.acceleration is not None:
        return field.acceleration, _noise(field.acceleration), None
    return None, 0.0, None if field.dt is None else MadeInertia(level, field.dt)


def _cuts(points: int, parts: int) -> NDArray[np.intp]:
    """Ends of even parts of a row of points."""
    return np.round(np.linspace(0, points, min(parts, points) + 1)).astype(np.intp)


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
