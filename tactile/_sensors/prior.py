"""What is known before any reading: that loads are contacts, and that a camera or a gel may move as a whole.

The contact prior is the covariance of an ensemble of presses: anywhere on the surface, of any radius between two, flat
or round, with a shear of its own. Over places it is stationary, and a function of distance alone,

    k(d) = integral S(k) J0(k d) k dk,   S(k) = mean over the radii of |p(k)|^2,

with p(k) the transform of the pressure under one press. As `penalty=` it is one like any other: ``|L t|^2`` with
``L' L`` the inverse of this covariance. A ridge is the ensemble of presses that are points, a gradient that of presses
without bound; where normal motion is not seen, or hardly (in-plane markers on a nearly incompressible gel), what is
found of a press is what its prior says of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from structures.errors import InputError, pair, positive

from .._arrays import Array, Index

if TYPE_CHECKING:
    from .observation import Depths, Markers


RADII = 12  # of the ensemble, evenly on a logarithmic scale
WAVES, REACH = 6000, 60.0  # numbers over which S is summed, up to this over the smallest radius
DISTANCES = 600
NUGGET = 1e-3  # share of presses smaller than any cell


@dataclass(frozen=True)
class ContactPrior:
    """Loads are contacts: the covariance of an ensemble of presses, as a penalty.

    Parameters
    ----------
    radii : (smallest, largest), optional
        Radii of the presses (m), all sizes between them as likely on a logarithmic scale, and of like force over
        radius. A sixth of the thickness and the thickness, where not given.
    shear : float
        Std of the shear along each axis over that of the pressure.

    Raises
    ------
    InputError
        Radii that are not positive and ascending, a shear that is not positive.
    """

    radii: tuple[float, float] | None = None
    shear: float = 0.35

    def __post_init__(self) -> None:
        if self.radii is not None:
            low, high = pair("radii", self.radii, where="ContactPrior", unit="m")
            if not 0 < low < high:
                raise InputError("no range of radii", where="ContactPrior, radii", found=self.radii,
                                 expected="two radii in m, 0 < smallest < largest")  # fmt: skip
            object.__setattr__(self, "radii", (low, high))
        object.__setattr__(self, "shear", positive("the shear", self.shear, where="ContactPrior"))

    def correlation(self, distance: Array, thickness: float) -> Array:
        """Of pressures at such distances (m), on a gel of such thickness (m)."""
        low, high = self.radii or (thickness / 6, thickness)
        at, values = _correlations(high / low)
        return np.asarray(np.interp(np.asarray(distance) / low, at, values, right=0.0))

    def on(self, places: Array, thickness: float) -> PosedPrior:
        """The prior of tractions at places (P, 3) of a surface."""
        from scipy.spatial.distance import cdist

        C = self.correlation(cdist(places, places), thickness)
        C[np.diag_indices_from(C)] += NUGGET
        return PosedPrior(C, np.array([self.shear**2, self.shear**2, 1.0]))


@lru_cache(maxsize=16)
def _correlations(ratio: float) -> tuple[Array, Array]:
    """Distances over the smallest radius, up to twice the largest, and the correlation there; `ratio` of the radii."""
    from scipy.special import j0, j1

    k = (np.arange(WAVES) + 0.5) * REACH / WAVES
    S = np.zeros(WAVES)
    for a in np.geomspace(1.0, ratio, RADII):
        s = k * a
        flat, round_ = 2 * j1(s) / s, 2 * (np.sin(s) - s * np.cos(s)) / s**3
        S += a**2 * (flat**2 + round_**2)
    d = np.linspace(0.0, 2 * ratio, DISTANCES)
    values = j0(np.outer(d, k)) @ (S * k)
    values = values / values[0]
    values[-1] = 0.0
    return d, values


@dataclass(frozen=True, eq=False)
class PosedPrior:
    """Covariance of tractions (3 P,) up to a factor: `matrix` (P, P) between places, `share` (3,) of the components."""

    matrix: Array
    share: Array

    @cached_property
    def variance(self) -> Array:
        """Of each traction (3 P,)."""
        return np.outer(np.diag(self.matrix), self.share).ravel()

    @cached_property
    def _root(self) -> Array:
        return np.linalg.cholesky(self.matrix)

    def times(self, rows: Array) -> Array:
        """Rows (k, 3 P) times the covariance."""
        return self._each(rows, self.matrix, self.share)

    def roots(self, rows: Array) -> Array:
        """Rows (k, 3 P) times a root of the covariance, whose coefficients are white."""
        return self._each(rows, self._root, np.sqrt(self.share))

    def penalty(self, nodes: Index) -> Array:
        """L (3 k, 3 k) of the tractions at some nodes (k,), where all others carry none."""
        W = solve_triangular(np.linalg.cholesky(self.matrix[np.ix_(nodes, nodes)]), np.eye(len(nodes)), lower=True)
        return np.kron(W, np.diag(1 / np.sqrt(self.share)))

    @staticmethod
    def _each(rows: Array, matrix: Array, factor: Array) -> Array:
        out = np.empty_like(rows)
        for c, f in enumerate(factor):
            out[:, c::3] = f * (rows[:, c::3] @ matrix)
        return out


SHARE = 0.02  # of the longer side of the pattern: std of what camera and gel may have moved
CREEP = 2e-5  # m, of normal motion that all markers or pixels share


@dataclass(frozen=True)
class ImageMotion:
    """Motion of the whole image that is no load: camera or gel have slipped, or the gel has crept.

    Shift, turn and scale of the image and a common offset of the normal motion are unknowns beside the load, told by
    the markers that no contact reaches; what they leave open is in the band.

    Parameters
    ----------
    shift : float, optional
        Std of the shift along x and y (m); turn and scale move the rim of the pattern as far. 2 % of the longer side of
        the pattern, where not given.
    offset : float
        Std of the offset of normal motion (m): tracked, or of a depth map, whose brightness drifts.

    Raises
    ------
    InputError
        Numbers that are not positive.
    """

    shift: float | None = None
    offset: float = CREEP

    def __post_init__(self) -> None:
        if self.shift is not None:
            object.__setattr__(self, "shift", positive("the shift", self.shift, where="ImageMotion", unit="m"))
        object.__setattr__(self, "offset", positive("the offset", self.offset, where="ImageMotion", unit="m"))

    def over(self, markers: Markers, depth: Depths | None) -> PosedMotion:
        """The motion in the readings of markers, and of a depth map after them."""
        places = markers.points[:, :2]
        about = (places.min(axis=0) + places.max(axis=0)) / 2
        x, y = (places - about).T
        side = float(np.ptp(places, axis=0).max())
        shift = SHARE * side if self.shift is None else self.shift
        turn = shift / (side / 2)
        one, zero = np.ones(len(places)), np.zeros(len(places))
        columns = [(one, zero, zero), (zero, one, zero), (-y, x, zero), (x, y, zero)]
        std = [shift, shift, turn, turn]
        if markers.axes == "XYZ":
            columns.append((zero, zero, one))
            std.append(self.offset)
        rows = np.array([np.column_stack(c)[:, : len(markers.axes)].ravel() for c in columns]).T
        if depth is not None:
            count = len(depth.points)
            rows = np.pad(rows, ((0, count), (0, 1)))
            rows[-count:, -1] = 1.0
            std.append(self.offset)
        return PosedMotion(rows, np.array(std), about)


@dataclass(frozen=True, eq=False)
class PosedMotion:
    """What a unit of each unknown motion makes of the readings, `columns` (m, q), its `std` (q,), and about what place.

    The first four are the shift along x and y (m), the turn (rad) and the stretch of the image.
    """

    columns: Array
    std: Array
    about: Array

    @property
    def scaled(self) -> Array:
        """Readings (m, q) that one std of each makes."""
        return self.columns * self.std

    def of(self, rows: Index | slice) -> PosedMotion:
        """That of some readings."""
        return PosedMotion(self.columns[rows], self.std, self.about)


RIGID: Sequence[str] = ("shift x", "shift y", "turn", "stretch")
