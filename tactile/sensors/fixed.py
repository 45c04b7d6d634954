"""Frame after frame at a lambda that is fixed, and whether the markers agree with each other and with the maps.

What the others predict for a reading is known from the inverse alone: its residual over ``1 - A_ii`` (leave-one-out).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from loadid.families.static import StaticInversion
from structures.errors import InputError, plain
from structures.flags import Flag

from ..results import guards
from ..results.forcemap import ForceFacts
from .inversion import Answer, Inverse, Pressed, RegionSolver, carried, prepare
from .observation import Markers, Wrench

if TYPE_CHECKING:
    from ..vision.eye import Eye
    from .observation import DepthMap


def is_image(found: NDArray, markers: int) -> bool:
    """Whether an array is a picture: bytes, three axes, or more columns than a motion has."""
    if found.dtype == np.uint8 or found.ndim == 3:
        return True
    return found.ndim == 2 and found.shape[1] > 3 and len(found) != markers


def readings_of(
    found: ArrayLike, markers: Markers, eye: Eye | None, depth: DepthMap | None
) -> tuple[NDArray[np.float64], list[Flag | None]]:
    """Readings (N axes,) of the markers in m, NaN where one is lost, and what the eye found.

    Raises
    ------
    InputError
        An image for a sensor without an eye; displacements that do not fit.
    """
    seen: Any = np.asarray(plain(found))
    flags: list[Flag | None] = []
    _refuse_turned(seen, len(markers))
    if is_image(seen, len(markers)):
        if eye is None:
            raise InputError(
                "this sensor has no eye: it cannot read images",
                where="frame",
                found=f"an image {seen.shape}",
                expected="displacements (markers, 2 or 3) in m",
                hint="build it with eye=tactile.Eye(view, reference)",
            )
        seen, flags = eye.read(seen, depth)
    return markers.readings(seen), flags


def paired(frames: Iterable[Any], depths: Iterable[DepthMap]) -> Iterator[tuple[Any, DepthMap]]:
    """Frames with their depth maps.

    Raises
    ------
    InputError
        When one of them ends before the other.
    """
    end = object()
    for i, (frame, depth) in enumerate(zip_longest(frames, depths, fillvalue=end)):
        if frame is end or depth is end:
            raise InputError(
                "frames and depth maps do not go together", where=f"frame {i}",
                found=f"no {'frame' if frame is end else 'depth map'} {i}", expected="one depth map for each frame",
            )  # fmt: skip
        yield frame, depth  # type: ignore[misc]


def _refuse_turned(seen: NDArray, markers: int) -> None:
    """Many frames at once, and motions with rows and columns swapped, are no images."""
    if seen.dtype == np.uint8:
        return
    if seen.ndim == 3 and seen.shape[1:] in ((markers, 2), (markers, 3)):
        raise InputError("many frames at once", where="frame", found=f"shape {seen.shape}",
                         expected=f"({markers}, 2 or 3)", hint="sensor.stream(frames)")  # fmt: skip
    if seen.ndim == 2 and seen.shape in ((2, markers), (3, markers)) and seen.shape[0] != markers:
        raise InputError("rows and columns are swapped", where="displacements", found=f"shape {seen.shape}",
                         expected=f"({markers}, {seen.shape[0]})", hint="motion.T")  # fmt: skip


def not_built_for_depth() -> InputError:
    """A depth map for a sensor that expects none."""
    return InputError(
        "this sensor was not built for a depth map",
        where="depth",
        found="a depth map",
        expected="none",
        hint="build it with depth= a map of the kind that it will see",
    )


Array = NDArray[np.float64]
MANY = 12  # markers from which one can be told to contradict the others
STRAYS = 20  # of them that are left out, at most
STRAY, PART = 10.0, 0.6  # distance over its std or the typical one, and over the largest motion
BESIDE = 4.0  # and over the second largest distance of its neighbours, which a contact raises alike
AROUND = 8  # neighbours
TURNS, ALIKE = 4, 0.5  # of them that may be the other half of a swap; its distance over that of the first
FREE = 0.02  # 1 - A_ii below which a reading explains itself: no other tells of it
NORMAL = 1.4826  # standard deviation over median absolute value of a normal law


@dataclass(eq=False)
class Consistency:
    """Leave-one-out errors of the markers of a frozen inverse.

    Parameters
    ----------
    inverse : Inverse
        Readings of markers first, `axes` each.
    places : array (markers, 2)
    axes : int
    """

    inverse: Inverse
    places: Array
    axes: int
    near: NDArray[np.intp] = field(init=False)

    def __post_init__(self) -> None:
        from scipy.spatial import cKDTree

        rows = len(self.places) * self.axes
        count = min(AROUND + 1, len(self.places))
        self.near = np.atleast_2d(cKDTree(self.places).query(self.places, k=count)[1])[:, 1:]
        self.free = np.maximum(1 - np.diagonal(self.inverse.influence)[:rows], 1e-3)
        self.told = np.repeat((self.free.reshape(-1, self.axes) > FREE).all(axis=1), self.axes)
        # single precision where the products of the map are: it is asked for every frame
        self.rows = np.ascontiguousarray(self.inverse.influence[:rows], self.inverse.matrix.dtype)

    def checked(self, y: Array) -> tuple[Array, int, float]:
        """Readings without those of markers that contradict all others, how many these are, and the misfit left.

        One at a time, the worst first, as a stray marker pulls the predictions of its neighbours with it. The misfit is
        the rms residual of the markers over what their noise lets expect: 1 where model and noise are right.
        """
        found, rest = 0, self._rest(y)
        while len(self.places) >= MANY and found < STRAYS and (worst := self._stray(y, *rest)) is not None:
            before, y = y, self._left_out(y, worst)
            partner = self._partner(before, y, worst)
            y = y if partner is None else self._left_out(y, partner)
            found += 1 if partner is None else 2
            rest = self._rest(y)
        return y, found, self._misfit(*rest[1:])

    def _partner(self, before: Array, y: Array, stray: int) -> int | None:
        """The neighbour that was taken for the stray marker in turn: as far from its place, if there is one.

        Alone it might explain itself, so it is held against what all others say without both.
        """
        far = self._missed(before, y, stray)
        seen = [int(j) for j in self.near[stray][:TURNS] if np.isfinite(y[j * self.axes])]
        missed = [self._missed(before, self._left_out(y, j), j) for j in seen]
        return seen[int(np.argmax(missed))] if missed and max(missed) > ALIKE * far else None

    def _missed(self, before: Array, y: Array, marker: int) -> float:
        """Whitened distance of a marker that was left out from what the others predict for it."""
        here = slice(marker * self.axes, (marker + 1) * self.axes)
        return float(np.linalg.norm(before[here] / self.inverse.spread[here] - self.inverse.filled(y)[0][here]))

    def _misfit(self, gone: NDArray[np.bool_], rest: Array) -> float:
        kept = ~gone & self.told
        return float(np.sqrt(np.sum(rest[kept] ** 2) / max(np.sum(self.free[kept]), 1.0))) if kept.any() else 0.0

    def _stray(self, y: Array, z: Array, gone: NDArray[np.bool_], rest: Array) -> int | None:
        apart = self._apart(gone, rest)
        free = self.free.reshape(-1, self.axes)
        size = np.linalg.norm(apart, axis=1)
        scaled = size / np.sqrt(np.sum(1 / free, axis=1))
        worst = int(np.argmax(scaled))
        moved = np.linalg.norm(z.reshape(-1, self.axes), axis=1).max(initial=0.0)
        if not size[worst] > PART * moved or not scaled[worst] > STRAY * max(1.0, NORMAL * float(np.median(scaled))):
            return None
        others = self._apart(*self._rest(self._left_out(y, worst))[1:])[self.near[worst]]
        beside = np.sort(np.linalg.norm(others, axis=1))
        # the second largest: two dots that were swapped are each other's neighbours
        return worst if size[worst] > BESIDE * beside[-2] else None

    def _left_out(self, y: Array, marker: int) -> Array:
        y = y.copy()
        y[marker * self.axes : (marker + 1) * self.axes] = np.nan
        return y

    def _apart(self, gone: NDArray[np.bool_], rest: Array) -> Array:
        """Whitened distance (markers, axes) from what the others predict."""
        return np.where(self.told & ~gone, rest / self.free, 0.0).reshape(-1, self.axes)

    def _rest(self, y: Array) -> tuple[Array, NDArray[np.bool_], Array]:
        """Whitened motion of the markers, which are lost, and the residual."""
        z, lost = self.inverse.filled(y)
        count = len(self.free)
        gone = np.zeros(len(z), bool)
        gone[lost] = True
        rest = z[:count] - self.rows @ z.astype(self.rows.dtype, copy=False)
        return z[:count], gone[:count], np.where(gone[:count], 0.0, rest)


TOUCH = 0.05  # of the peak pressure of the unconstrained map: where the constrained one looks for contact
CLEAR = 2.0  # stds of the unconstrained map


@dataclass(frozen=True, eq=False)
class Found:
    """What came of one frame: load (n,) and std, covariance of the resultant (6, 6), facts, flags."""

    load: Array
    std: Array
    wrench: Array
    facts: ForceFacts
    flags: list[Flag | None]


@dataclass(eq=False)
class QuickMap:
    """The frozen inverse of a sensor, with what it keeps from frame to frame.

    Parameters
    ----------
    family : StaticInversion
        At a calibrated or given lambda.
    resultant : array (6, n)
    places : array (n / 3, 3)
        Nodes that may be loaded (m).
    neighbours : sparse (n / 3, n / 3)
        Which of them share a cell.
    markers : array (N, 2)
        Their places (m); their readings come first.
    axes : int
        Readings of each marker.
    reach : float
        Radius (m) of the press whose recovery is told.
    about : array (3,)
        Middle of the surface.
    pressing : bool
        No pulling.
    friction : float or None
    """

    family: StaticInversion
    resultant: Array
    places: Array
    neighbours: Any
    markers: Array
    axes: int
    reach: float
    about: Array
    pressing: bool = False
    friction: float | None = None
    _solver: RegionSolver | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        family = self.family
        lam = family.calibration.lam if family.calibration is not None else family.choice
        if not isinstance(lam, int | float):
            raise InputError(
                "lambda is not fixed yet", where="sensor", found=f"choice={lam!r}",
                expected="a calibration, or a relative lambda", hint="sensor.calibrate([press, press, ...])",
            )  # fmt: skip
        rule = "given" if family.calibration is None else family.calibration.rule
        self.inverse: Inverse = prepare(family, self.resultant, float(lam), rule)
        self.consistency = Consistency(self.inverse, self.markers, self.axes)
        self.recovery = self.inverse.recovery(self._press())

    @property
    def constrained(self) -> bool:
        """Whether the map may not pull, or not leave its friction cone."""
        return self.pressing or self.friction is not None

    def __call__(self, y: Array, wrench: Wrench | None = None) -> Found:
        """Map of readings (m,), NaN where one is lost."""
        inverse = self.inverse
        y, strays, misfit = self.consistency.checked(y)
        answer = inverse(y, None if self.constrained else wrench)
        load, std, covariance, path = answer.load, answer.std, answer.wrench, "frozen inverse"
        flags: list[Flag | None] = [guards.strays(strays), guards.misfit(misfit)]
        if wrench is None:
            hidden = inverse.hidden(load)
            flags += [guards.unseen(self.recovery), guards.taken(hidden, inverse.resultant @ load, covariance)]
            covariance = covariance + np.outer(hidden, hidden) + self._blind(inverse.resultant @ load)
        if self.constrained:
            found = self.pressed(y, wrench, answer)
            load, std = found.load, found.std
            covariance = found.wrench if wrench is not None or found.touched else covariance
            path = f"active sets on the contact region, {found.steps} steps"
            flags.append(guards.stopped(found.converged, found.steps))
        wide = max(1.0, misfit)  # as far as the markers contradict their noise, so does the map
        std, covariance = wide * std, wide**2 * covariance
        lost = int(np.sum(~np.isfinite(y)))
        facts = ForceFacts(
            path=path, m=len(y) - lost, n=len(load), lost=lost, strays=strays, misfit=misfit, lam=inverse.lam,
            lambda_rule=inverse.rule,
        )  # fmt: skip
        return Found(load, std, covariance, facts, flags)

    def pressed(self, y: Array, wrench: Wrench | None = None, answer: Answer | None = None) -> Pressed:
        """The map that only presses, looked for where the unconstrained answer does.

        Raises
        ------
        InputError
            For penalties that couple loads; a resultant that no contact of this friction carries.
        """
        if wrench is not None:
            carried(wrench, self.friction)
        answer = self.inverse(y) if answer is None else answer
        pressure, spread = -answer.load[2::3], answer.std[2::3]
        touched = pressure > TOUCH * pressure.max()
        if wrench is None:
            touched &= pressure > CLEAR * spread
        return self._region.solve(y / self.inverse.spread, touched, wrench, answer)

    def _blind(self, resultant: Array) -> Array:
        """Variance of a normal force that the readings hardly see: as large as what they may hide."""
        out = np.zeros((6, 6))
        if self.recovery < guards.SEEN:
            out[2, 2] = (resultant[2] * (1 / max(self.recovery, 1e-3) - 1)) ** 2
        return out

    @property
    def _region(self) -> RegionSolver:
        if self._solver is None:
            if self.family.L is not None:
                raise InputError(
                    "constrained maps at a fixed lambda take the identity as their penalty",
                    where="penalty", found=self.family.penalty, expected="'identity'",
                    hint="leave lambda to be chosen per frame, or leave the constraints out",
                )  # fmt: skip
            inverse = self.inverse
            prior = np.full(inverse.shape[0], inverse.lam * inverse.scale)
            H = self.family.H[: inverse.shape[1]] / inverse.spread[:, None]  # markers first, depth after them
            self._solver = RegionSolver(H, prior, inverse.resultant, self.neighbours, self.friction)
        return self._solver

    def _press(self) -> Array:
        """A plain press in the middle of the surface (n,), of no particular size."""
        press = np.zeros((len(self.places), 3))
        press[:, 2] = -np.exp(-np.sum((self.places[:, :2] - self.about[:2]) ** 2, axis=1) / self.reach**2)
        return press.ravel()
