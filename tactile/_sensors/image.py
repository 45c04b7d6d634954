"""Motion of the whole image that is no load: told by the markers that no contact reaches, and taken off the readings.

A uniform shift of all markers is fitted by a shear of the whole surface, and an offset of normal motion by a pressure
all over it: no residual shows either, and a prior of contacts anywhere does not forbid them. But loads act
where a contact is. It stands out of the map once what most markers share is taken off; loads about it, under the
contact prior, and the motion of the image are then estimated together, and all else is noise. Which nodes are touched
and how the image has moved follow from each other in two or three rounds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import solve_triangular

from structures.errors import positive

from .._arrays import Array, Index, Mask
from .._guards import MOVED
from .inversion import Inverse
from .lattice import Lattice

if TYPE_CHECKING:
    from .gaussian import GaussianProblem
    from .observation import Depths, Markers


SHARE = 0.02  # of the longer side of the pattern: std of what camera and gel may have moved


@dataclass(frozen=True)
class ImageMotion:
    """Motion of the whole image that is no load: camera or gel have slipped, or the gel has crept.

    Shift, turn and scale of the image, and an offset of the normal motion, are unknowns beside the load, told by the
    markers that no contact reaches; what they leave open is in the band.

    Parameters
    ----------
    shift : float, optional
        Std of the shift along x and y (m); turn and scale move the rim of the pattern as far. 2 % of the longer side of
        the pattern, where not given.
    offset : float, optional
        Std of an offset of all normal motion (m): tracked, or of a depth map whose brightness drifts. Still where not
        given: what a pad near to incompressible shows of a press far from it is like an offset, and a tenth of a
        micrometre of one is some per cent of the force.

    Raises
    ------
    InputError
        Numbers that are not positive.
    """

    shift: float | None = None
    offset: float | None = None

    def __post_init__(self) -> None:
        if self.shift is not None:
            object.__setattr__(self, "shift", positive("the shift", self.shift, where="ImageMotion", unit="m"))
        if self.offset is not None:
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
        if markers.axes == "XYZ" and self.offset is not None:
            columns.append((zero, zero, one))
            std.append(self.offset)
        rows = np.array([np.column_stack(c)[:, : len(markers.axes)].ravel() for c in columns]).T
        if depth is not None:
            count = len(depth.points)
            rows = np.pad(rows, ((0, count), (0, 0)))
            if self.offset is not None:
                rows = np.pad(rows, ((0, 0), (0, 1)))
                rows[-count:, -1] = 1.0
                std.append(self.offset)
        return PosedMotion(rows, np.array(std))


@dataclass(frozen=True, eq=False)
class PosedMotion:
    """What a unit of each unknown motion makes of the readings, `columns` (m, q), and its `std` (q,).

    The first four are the shift along x and y (m), the turn (rad) and the stretch of the image.
    """

    columns: Array
    std: Array

    def of(self, rows: Index | slice) -> PosedMotion:
        """That of some readings."""
        return PosedMotion(self.columns[rows], self.std)

    def typical(self, y: Array) -> Array:
        """The motion (q,) that most readings (m,) share: medians, and neither turn nor stretch."""
        out = np.zeros(len(self.std))
        for k in range(len(self.std)):
            rows = self.columns[:, k] == 1.0
            if k not in TURNING and np.any(seen := rows & np.isfinite(y)):
                out[k] = np.median(y[seen])
        return out

    def shared(self, y: Array, start: Array) -> Array:
        """The motion (q,), turn and stretch too, that most readings (m,) share, from what is typical of them.

        Least squares by the biweight (A. E. Beaton & J. W. Tukey, Technometrics 16 (1974) 147).
        """
        out, rigid = start.copy(), slice(0, FREEDOMS)
        rows = np.any(self.columns[:, rigid], axis=1) & np.isfinite(y)
        M, size = self.columns[rows, rigid], self.std[rigid]
        for _ in range(REWEIGHTED):
            rest = y[rows] - M @ out[rigid]
            reach = BIWEIGHT * float(np.median(np.abs(rest)))
            weight = np.clip(1 - (rest / max(reach, np.finfo(float).tiny)) ** 2, 0.0, None)
            step = size * np.linalg.lstsq(weight[:, None] * M * size, weight * rest, rcond=1e-10)[0]
            out[rigid] += step
            if np.abs(M @ step).max(initial=0.0) < SETTLED * reach:
                break
        return out


FREEDOMS = 4  # of an image: shift along x and y, turn, stretch
TURNING = (2, 3)
ROUNDS = 4
BIWEIGHT, REWEIGHTED = 7.0, 8  # median absolute values from which a reading counts for nothing; passes
SETTLED = 0.02  # of these, that the last pass moves a marker by
NOISE = 0.5  # of the noise of one marker
ERRING = 0.03  # of the largest motion of a marker: what errors of the model make of it far from a contact, at most
FAR = 0.005  # and their std
MODES = 40  # of the loads about a contact, of each component: what markers far from it feel
KEPT = 64  # regions
SEEN = 1e4  # stds of the noise: no motion of a marker is larger
FREE = 10.0  # times the std of the average over the pad: loads where there is a contact


@dataclass(frozen=True, eq=False)
class ImageShift:
    """How the image of a frame has moved as a whole: `values` (q,) as in `PosedMotion`, and their covariance.

    `ratio` is the mean square of shift, turn and stretch over their covariance, `size` their rms at the markers (m);
    below `chance` (m) that is the noise of a marker, or a small share of its motion.
    """

    values: Array
    covariance: Array
    ratio: float
    size: float
    chance: float

    @property
    def std(self) -> Array:
        """Of each motion (q,)."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, eq=False)
class _Read:
    """Readings `y` (m,) of a frame, motions (q,) to start from, whitened readings `seen` without gaps, their load."""

    y: Array
    starts: tuple[Array, Array]
    seen: Array
    load: Array


@dataclass(frozen=True, eq=False)
class _Told:
    """What tells the image's motion while loads act on one region: `rows` (q, m) of whitened readings, covariance.

    `errors` (errors, q, n) are what errors of the gel make of it.
    """

    rows: Array
    covariance: Array
    errors: Array


@dataclass(eq=False)
class ImageFit:
    """Motion of the image beside the loads of a frozen inverse; `thickness` in m, `places` (P, 3) of the nodes."""

    problem: GaussianProblem
    motion: PosedMotion
    inverse: Inverse
    places: Array
    thickness: float
    _known: dict[bytes, _Told] = field(default_factory=dict, init=False)
    _last: _Read | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self.moved = self.motion.columns / self.problem.noise[:, None]  # whitened readings per unit
        self.loads = np.asarray(self.inverse.matrix @ self.moved, float)  # what the map makes of a unit

    def __call__(self, y: Array, wide: float = 1.0) -> ImageShift:
        """Of readings (m,), NaN where lost, whose noise is `wide` times as large as stated."""
        read, told = self._read(y), None
        load = read.load
        a = min(read.starts, key=lambda one: self._loaded(load - self.loads @ one, wide).sum())
        for _ in range(ROUNDS):
            before, told = told, self._told(self._loaded(load - self.loads @ a, wide))
            if told is before:
                break
            a = told.rows @ read.seen
        assert told is not None
        covariance, load = told.covariance, load - self.loads @ a
        for error in told.errors:
            one = error @ load
            covariance = covariance + np.outer(one, one) / wide**2
        return self._shift(a, covariance, y, wide)

    def _read(self, y: Array) -> _Read:
        """What readings (m,) say whatever their noise; once, as a frame is asked again where it shows another one."""
        last = self._last
        if last is None or not np.array_equal(last.y, y, equal_nan=True):
            a = self.motion.typical(y)
            z = self.inverse.filled(y - self.motion.columns @ a)[0]  # a lost marker moves as the others say
            seen = z + self.moved @ a
            load = np.asarray(self.inverse.matrix @ seen.astype(self.inverse.matrix.dtype, copy=False), float)
            last = self._last = _Read(y.copy(), (a, self.motion.shared(y, a)), seen, load)
        return last

    def steadied(self, y: Array, found: ImageShift) -> Array:
        """Readings (m,) without what moved all of them."""
        return y - self.motion.columns @ found.values

    def steady_load(self, y: Array, found: ImageShift) -> Array | None:
        """Loads (n,) of readings (m,) without what moved all of them; None where one is lost."""
        return self._read(y).load - self.loads @ found.values if np.isfinite(y).all() else None

    def open(self, found: ImageShift) -> Array:
        """Loads (n, q) whose outer products are what the image's motion leaves open of the map."""
        return self.loads @ np.linalg.cholesky(found.covariance)

    def _loaded(self, load: Array, wide: float) -> Mask:
        """Nodes that carry a load (P,)."""
        assert self.inverse.band is not None
        return self.inverse.band.loaded(load, wide)

    def _told(self, loaded: Mask) -> _Told:
        """What tells the motion while these nodes are loaded: alike for all of the same blocks."""
        near = self._lattice.near[self._lattice.block[loaded]].any(axis=0)
        key = near.tobytes()
        found = self._known.get(key)
        if found is None:
            found = self._fitted(np.flatnonzero(near))
            while len(self._known) >= KEPT:
                self._known.pop(next(iter(self._known)), None)
            self._known[key] = found
        return found

    @cached_property
    def _lattice(self) -> Lattice:
        return Lattice.over(self.places[:, :2], self.thickness)

    @cached_property
    def _made(self) -> list[list[Array]]:
        """What hats of the lattice make of the whitened readings: by the model and its errors, of each component."""
        problem, hats = self.problem, self._lattice.hats
        parts = [problem.whitened]
        parts += [e.change * (e.weight / problem.noise[:, None]) for e in problem.errors() if e.of_mesh]
        roots = np.sqrt(problem.prior.share)
        return [[np.asfortranarray(roots[c] * (hats.T @ part[:, c::3].T).T) for c in range(3)] for part in parts]

    @cached_property
    def _alike(self) -> Array:
        """Covariance of the hats (k, k) under the prior: of means over them."""
        W = self._lattice.hats / self._lattice.hats.sum(axis=0)
        return np.asarray(W.T @ (W.T @ self.problem.prior.matrix).T)

    def prepare(self) -> None:
        """All that does not depend on where a load is."""
        _ = self._made, self._alike

    def _fitted(self, near: Index) -> _Told:
        """What tells the motion beside loads on some hats of the lattice."""
        std = self.motion.std
        unknown = [self.moved * std]
        if near.size:
            w, V = np.linalg.eigh(self._alike[np.ix_(near, near)])
            modes = np.sqrt(np.maximum(w[::-1][:MODES], 0.0)) * V[:, ::-1][:, :MODES]
            made = [[columns[:, near] @ modes for columns in part] for part in self._made]
            largest = max(float(np.abs(one).max()) for one in made[0])
            free = min(FREE / (self.inverse.lam * self.inverse.scale), SEEN / largest)
            unknown += [free * one for part in made for one in part]
        A = np.hstack(unknown)
        R = np.linalg.qr(np.vstack([A, np.eye(A.shape[1])]), mode="r")
        back = solve_triangular(R, np.eye(len(R), len(std)), trans="T", check_finite=False)
        back = solve_triangular(R, back, check_finite=False).T * std[:, None]
        rows = back @ A.T
        gel = [(rows / self.problem.noise) @ e.change for e in self.problem.errors() if not e.of_mesh]
        errors = np.array(gel).reshape(-1, len(std), self.problem.H.shape[1])
        return _Told(rows, back[:, : len(std)] * std, errors)

    def _shift(self, a: Array, covariance: Array, y: Array, wide: float) -> ImageShift:
        """What stands clear of chance; the rest is no motion: a camera stands still until something says otherwise."""
        motion, rigid = self.motion, slice(0, FREEDOMS)
        std = np.sqrt(np.diag(covariance))
        told, together = (a / std)[rigid], covariance[rigid, rigid] / np.outer(std[rigid], std[rigid])
        ratio = float(told @ np.linalg.lstsq(together, told, rcond=1e-10)[0]) / FREEDOMS / wide**2
        marked = np.any(motion.columns[:, rigid], axis=1) & np.isfinite(y)
        size = float(np.sqrt(np.mean((motion.columns[marked, rigid] @ a[rigid]) ** 2)))
        noise = float(np.sqrt(np.mean(self.problem.noise[marked] ** 2)))
        largest = float(np.abs(y[marked]).max(initial=0.0))
        chance = max(NOISE * wide * noise, ERRING * largest)
        sure = np.ones(len(a), bool)  # an offset is asked for where there is one
        sure[rigid] = ratio > MOVED and size > chance
        covariance = covariance.copy()
        covariance[rigid, rigid] += np.diag((FAR * largest / motion.std[0] * motion.std[rigid]) ** 2)
        left = np.where(sure, 0.0, a) / wide
        return ImageShift(np.where(sure, a, 0.0), covariance + np.outer(left, left), ratio, size, chance)
