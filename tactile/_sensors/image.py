"""Motion of the whole image that is no load: told by the markers that no contact reaches, and taken off the readings.

A uniform shift of all markers is fitted by a shear of the whole surface, and a common offset of normal motion by a
pressure all over it: no residual shows either, and a prior of contacts anywhere does not forbid them. But loads act
where a contact is. It stands out of the map once what most markers share is taken off; loads about it, under the
contact prior, and the motion of the image are then estimated together, and all else is noise. Which nodes are touched
and how the image has moved follow from each other in two or three rounds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from structures.errors import positive

from .._arrays import Array, Index, Mask
from .inversion import Inverse

if TYPE_CHECKING:
    from .gaussian import GaussianProblem
    from .observation import Depths, Markers


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

    def typical(self, y: Array) -> Array:
        """The motion (q,) that most readings (m,) share: medians, and neither turn nor stretch."""
        out = np.zeros(len(self.std))
        for k in range(len(self.std)):
            rows = self.columns[:, k] == 1.0
            if k not in TURNING and np.any(seen := rows & np.isfinite(y)):
                out[k] = np.median(y[seen])
        return out


FREEDOMS = 4  # of an image: shift along x and y, turn, stretch
TURNING = (2, 3)
ROUNDS = 4
NEAR = 1.0  # thicknesses about a contact within which loads may act
MODES = 40  # of the loads about a contact, of each component: what markers far from it feel
FREE = 10.0  # times the std of the average over the pad: loads where there is a contact
KEPT = 16  # regions


@dataclass(frozen=True, eq=False)
class ImageShift:
    """How the image of a frame has moved as a whole: `values` (q,) as in `PosedMotion`, and their covariance.

    `ratio` is the mean square of shift, turn and stretch over their covariance, `over` their rms at the markers over
    the noise of one.
    """

    values: Array
    covariance: Array
    ratio: float
    over: float

    @property
    def std(self) -> Array:
        """Of each motion (q,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Told:
    """What tells the image's motion while loads act on one region: `rows` (q, m) of whitened readings, covariance."""

    rows: Array
    covariance: Array
    errors: Array


@dataclass(eq=False)
class ImageFit:
    """Motion of the image beside the loads of a frozen inverse; `thickness` in m, `places` (P, 3) of the nodes."""

    problem: GaussianProblem
    inverse: Inverse
    places: Array
    thickness: float
    _regions: dict[bytes, _Told] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        motion = self.problem.motion
        assert motion is not None
        self.motion: PosedMotion = motion
        self.moved = motion.columns / self.problem.noise[:, None]  # whitened readings per unit
        self.loads = np.asarray(self.inverse.matrix @ self.moved, float)  # what the map makes of a unit

    def __call__(self, y: Array) -> ImageShift:
        """Of readings (m,), NaN where lost."""
        a, before = self.motion.typical(y), None
        for _ in range(ROUNDS):
            z, lost = self.inverse.filled(y - self.motion.columns @ a)
            load = np.asarray(self.inverse.matrix @ z, float)
            touched = self._touched(load)
            if before is not None and np.array_equal(touched, before):
                break
            before = touched
            told = self._told(touched, lost)
            seen = np.where(np.isfinite(y), y, 0.0) / self.problem.noise
            a = told.rows @ seen
        covariance = told.covariance
        for error in told.errors:
            one = error @ load
            covariance = covariance + np.outer(one, one)
        return self._shift(a, covariance, y)

    def _touched(self, load: Array) -> Mask:
        """Nodes about those that carry a load (P,)."""
        from scipy.spatial import cKDTree

        assert self.inverse.band is not None
        loaded = self.inverse.band.loaded(load)
        if not loaded.any():
            return loaded
        return np.asarray(cKDTree(self.places[loaded]).query(self.places)[0] <= NEAR * self.thickness)

    def _told(self, touched: Mask, lost: Index) -> _Told:
        key = touched.tobytes() + lost.tobytes()
        found = self._regions.get(key)
        if found is None:
            if len(self._regions) > KEPT:
                self._regions.clear()
            found = self._regions[key] = self._fitted(np.flatnonzero(touched), lost)
        return found

    def _fitted(self, nodes: Index, lost: Index) -> _Told:
        problem, x = self.problem, self.inverse.lam * self.inverse.scale
        N = self.moved.copy()
        N[lost] = 0.0
        left = N
        if len(nodes):
            modes = FREE / x * problem.prior.modes(nodes, MODES)
            columns = (3 * nodes[:, None] + np.arange(3)).ravel()
            A = problem.whitened[:, columns] @ modes
            A[lost] = 0.0
            Q = np.linalg.qr(np.vstack([A, np.eye(A.shape[1])]))[0][: len(A)]
            left = N - Q @ (Q.T @ N)
        # in units of the prior: shifts, turns and offsets differ in size
        std = self.motion.std
        known = np.eye(len(std)) + (N * std).T @ (left * std)
        covariance = np.linalg.inv((known + known.T) / 2) * np.outer(std, std)
        rows = covariance @ left.T
        errors = [rows @ (e.change / problem.noise[:, None]) for e in problem.errors()]
        return _Told(rows, covariance, np.array(errors).reshape(-1, len(std), problem.H.shape[1]))

    def _shift(self, a: Array, covariance: Array, y: Array) -> ImageShift:
        rigid = slice(0, FREEDOMS)
        size = np.sqrt(np.diag(covariance)[rigid])
        told, together = a[rigid] / size, covariance[rigid, rigid] / np.outer(size, size)
        ratio = float(told @ np.linalg.lstsq(together, told, rcond=1e-10)[0]) / FREEDOMS
        marked = np.any(self.motion.columns[:, rigid], axis=1) & np.isfinite(y)
        field_ = self.motion.columns[marked, rigid] @ a[rigid]
        over = float(np.sqrt(np.mean(field_**2) / np.mean(self.problem.noise[marked] ** 2)))
        return ImageShift(a, covariance, ratio, over)
