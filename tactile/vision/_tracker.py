"""Markers followed from frame to frame: predicted, matched, held against their neighbours, lost and found again."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._advice import Advice
from structures._flags import Flag
from structures.errors import InputError, as_array, positive, reals

from .._arrays import PLANE, Array, Index, Mask, UnusableFrame, shaped
from .._guards import leapt, vanished
from ._detect import BRIGHT, SIZE, Detected, Detector, size_of_dots
from ._interpolation import NEAREST, fitted_weights
from ._motion import Jitter, MarkerMotion, jitter

NONE = -1  # index of a marker without a dot
NEIGHBOURS = 8
RING = 24  # neighbours asked where fewer than three of the nearest are seen
ENOUGH = 3


def match(predicted: ArrayLike, found: ArrayLike, *, gate: float) -> Index:
    """Dot of every marker: each the nearest of the other, and not farther apart than the gate.

    Parameters
    ----------
    predicted : array, shape (N, 2)
        Where the markers are expected; NaN takes no part.
    found : array, shape (k, 2)
        Where dots were found.
    gate : float
        Largest distance, in the same unit.

    Returns
    -------
    array of int, shape (N,)
        Index of the dot of each marker, -1 for none.
    """
    expected, dots = places(predicted, "predicted"), places(found, "found")
    return Dots(dots).mutual(expected, positive("gate", gate, where="match"))


class Dots:
    """Dots of one frame (k, 2), all finite, ready to be asked for the nearest of them."""

    def __init__(self, points: Array) -> None:
        from scipy.spatial import cKDTree

        self.points = points
        self._tree = cKDTree(points, balanced_tree=False) if len(points) else None

    def mutual(self, expected: Array, gate: float) -> Index:
        """Dot of every marker, each the nearest of the other within the gate; -1 for none, shape (N,)."""
        from scipy.spatial import cKDTree

        index = np.full(len(expected), NONE, np.intp)
        asked = np.flatnonzero(np.isfinite(expected).all(axis=1))
        if len(asked) == 0 or self._tree is None:
            return index
        distance, dot = self._tree.query(expected[asked])
        back = cKDTree(expected[asked], balanced_tree=False).query(self.points)[1]
        both = (back[dot] == np.arange(len(asked))) & (distance <= gate)
        index[asked[both]] = dot[both]
        return index

    def offers(self, expected: Array, gate: float) -> Array:
        """Vector from every marker to its nearest dot within the gate that is no nearer to another one, NaN for none.

        A quicker and looser question than `mutual`, for a first look; all places must be finite.
        """
        offered = np.full_like(expected, np.nan)
        if self._tree is None:
            return offered
        distance, dot = self._tree.query(expected)
        near = np.argsort(-distance, kind="stable")
        owner = np.empty(len(self.points), np.intp)
        owner[dot[near]] = near  # the nearest of those that ask for a dot is written last
        own = (owner[dot] == np.arange(len(expected))) & (distance <= gate)
        offered[own] = self.points[dot[own]] - expected[own]
        return offered


def places(points: ArrayLike, name: str) -> Array:
    """Points of a plane (n, 2); an empty list is none."""
    found = reals(points, where=name)
    found = found.reshape(0, 2) if found.size == 0 else found
    return shaped(found, PLANE, where=name, what="no points of a plane", lost=True)


class Neighbourhood:
    """The neighbours of every marker (N, 2) of a pattern at rest; `pitch` is their median distance."""

    def __init__(self, points: ArrayLike) -> None:
        from scipy.spatial import cKDTree

        rest = places(points, "markers")
        tree, count = cKDTree(rest), min(len(rest), RING + 1)
        distance, index = tree.query(rest, k=count)
        self.pitch = float(np.median(distance[:, 1]))
        self._ring = index[:, 1:]
        self._near = index[:, 1 : NEIGHBOURS + 1]

    def median(self, values: Array) -> Array:
        """Median over the neighbours of each marker of values (N, components), NaN where fewer than three are known."""
        middle = _median(values[self._near])
        alone = np.flatnonzero(np.isnan(middle).any(axis=1))
        if len(alone):
            middle[alone] = _median(values[self._ring[alone]])
        return middle


def _median(values: NDArray[Any]) -> Array:
    """Median over the second axis that leaves NaN out, shape (n, components); NaN where fewer than three are known."""
    ordered = np.sort(values, axis=1)  # NaN last
    count = np.isfinite(values).sum(axis=1, keepdims=True)
    low = np.take_along_axis(ordered, np.maximum(count - 1, 0) // 2, axis=1)
    high = np.take_along_axis(ordered, np.minimum(count // 2, values.shape[1] - 1), axis=1)
    few = (count < min(ENOUGH, values.shape[1]))[:, 0]
    return np.where(few, np.nan, 0.5 * (low + high)[:, 0])


log = logging.getLogger(__name__)
FIRST = 0.75  # gate of the first look, over the pitch: motion of half a pitch in any direction is inside
COMMON = 0.15  # common motion, over the pitch, from which on it is taken off before a second look
GATE = 0.4
RETURN = 0.25  # gate of a marker that was lost, over the pitch: strange dots are not taken for it
DISAGREE = 0.5  # distance from the neighbours' motion since rest, over the pitch
STEP = 0.5  # motion of one frame beyond which a neighbour is as near, over the pitch
EXTRAPOLATED = 3.0  # sum of absolute weights, from which on a fitted value is an extrapolation
FEWEST = 3


class MarkerTracker:
    """Follows the dots of a pattern from a frame at rest.

    The pattern may have any shape and any gaps: no rows and columns are counted. Every frame is matched to the one
    before it, so that a marker must not move by half a pitch between two of them; its total motion may be larger.

    Parameters
    ----------
    reference : image (H, W) or (H, W, 3), or array (N, 2)
        Frame of the unloaded pad; or the places of its dots in px, then frames come as places too unless a
        `detector` is given.
    radius, pitch : float, optional
        Of the dots, px; default estimated from the reference.
    dark, method, threshold, margin, backend
        As in `Detector`.
    detector : Detector, optional
        Instead of these.
    gate : float
        Distance from the prediction at which a dot is still taken, over the pitch.

    Raises
    ------
    InputError
        Fewer than three markers; a gate that is none.
    """

    def __init__(
        self,
        reference: Any,
        *,
        radius: float | None = None,
        pitch: float | None = None,
        dark: bool = True,
        method: str = "parabola",
        threshold: float | None = None,
        margin: float | None = None,
        backend: str | None = None,
        detector: Detector | None = None,
        gate: float = GATE,
    ) -> None:
        if detector is None and not _is_points(reference):
            radius, pitch = size_of_dots(reference, radius=radius, pitch=pitch, dark=dark, backend=backend)
            detector = Detector(radius, pitch, dark, method, margin=margin, backend=backend)
            detector = detector if threshold is None else replace(detector, threshold=threshold)
        self.detector = detector
        self._size: tuple[int, ...] | None = None
        self.gate = positive("gate", gate, where="MarkerTracker")
        rest = self._dots(reference)
        if len(rest) < FEWEST:
            raise UnusableFrame(
                "too few markers", where="reference frame", found=len(rest), expected=f"at least {FEWEST}",
                hint=Advice(BRIGHT, SIZE),
            )  # fmt: skip
        self._rest = rest
        self._around = Neighbourhood(rest)
        self._pattern = rest  # as first seen: what neighbours are compared in
        self._now = rest  # where each marker was last seen, or where its neighbours say it is
        self._found = np.ones(len(rest), bool)
        self._frame = 0
        self._leap: Flag | None = None
        self._fit: tuple[bytes, Index, Array] | None = None

    @property
    def points(self) -> Array:
        """Places of the markers at rest, px, shape (N, 2)."""
        return self._rest.copy()

    @property
    def pitch(self) -> float:
        """Median distance of neighbouring markers at rest, px."""
        return self._around.pitch

    def step(self, frame: Any) -> MarkerMotion:
        """Motion of the markers in the next frame.

        Parameters
        ----------
        frame : image, Detected, or array (k, 2)
            The frame, or the places of the dots in it.
        """
        dots = Dots(self._dots(frame))
        self._frame += 1
        expected, common = self._expected(dots)
        index = dots.mutual(expected, self.gate * self.pitch)
        taken = index != NONE
        place = np.full_like(expected, np.nan)
        place[taken] = dots.points[index[taken]]
        strange = ~self._found & (_length(place - expected) > RETURN * self.pitch)
        rejected = self._odd(place) | strange | (_length(place - self._now) > STEP * self.pitch)
        self._found = taken & ~rejected
        self._now = np.where(self._found[:, None], place, self._without(expected, place))
        self._leap = self._leap or leapt(common, self.pitch, self._frame)
        return self._motion(rejected, len(dots.points) - int(taken.sum()))

    def _motion(self, rejected: Mask, unmatched: int) -> MarkerMotion:
        moved = np.where(self._found[:, None], self._now - self._rest, np.nan)
        lost = np.isnan(moved).any(axis=1) & ~rejected
        gone = vanished(len(lost), int(lost.sum()), int(rejected.sum()), unmatched)
        flags = tuple(flag for flag in (gone, self._leap) if flag is not None)
        return MarkerMotion(self.points, moved, lost, rejected, unmatched, self._frame, flags)

    def zero(self, frames: Iterable[Any] | None = None) -> None:
        """Take the present places as rest; with unloaded frames, their mean.

        A marker that is not seen there has no place at rest: it counts as lost until the next `zero` that sees it.

        Raises
        ------
        InputError
            Fewer than three markers are seen; `frames` is empty.
        """
        sums, counts = np.zeros_like(self._now), np.zeros(len(self._now), int)
        for frame in (None,) if frames is None else frames:
            if frame is not None:
                self.step(frame)
            sums[self._found] += self._now[self._found]
            counts += self._found
        known = counts > 0
        if known.sum() < FEWEST:
            raise InputError(
                "too few markers seen", where="zero", found=int(known.sum()), expected=f"at least {FEWEST}"
            )
        rest = np.full_like(self._now, np.nan)
        rest[known] = sums[known] / counts[known, None]
        self._rest, self._leap = rest, None  # which dot is which begins anew
        log.info("zeroed on %d of %d markers", known.sum(), len(known))

    def jitter(self, frames: Iterable[Any]) -> Jitter:
        """Noise of the places over unloaded frames, per axis; see `tactile.vision._motion.jitter`."""
        return jitter([self._followed(frame) for frame in frames])

    def _followed(self, frame: Any) -> Array:
        """Places in the next frame, whether or not they are known at rest."""
        self.step(frame)
        return np.where(self._found[:, None], self._now, np.nan)

    def _dots(self, frame: Any) -> Array:
        if isinstance(frame, Detected):
            return frame.points
        if self.detector is None or _is_points(frame):
            return _finite(places(frame, "dots"))
        self._size = self._size or np.shape(frame)[:2]
        if np.shape(frame)[:2] != self._size:
            raise UnusableFrame(
                "a frame of another size", where=f"frame {self._frame + 1}", found=np.shape(frame), expected=self._size,
                hint="a tracker follows one camera at one setting; start another one from an unloaded frame",
            )  # fmt: skip
        return self.detector(frame).points

    def _expected(self, dots: Dots) -> tuple[Array, float]:
        """Where the markers should be, as their neighbours moved since the last frame; length of the common motion.

        The first look sees most dots where the pattern moves as one; the second, from there, sees the local motion.
        """
        moved = dots.offers(self._now, FIRST * self.pitch)
        common = _middle(moved)
        if np.hypot(*common) > COMMON * self.pitch:
            moved = common + dots.offers(self._now + common, FIRST * self.pitch)
        local = self._around.median(moved)
        return self._now + np.where(np.isfinite(local), local, common), float(np.hypot(*common))

    def _without(self, expected: Array, place: Array) -> Array:
        """Where the markers that were not found should be: as a smooth motion since rest of those around has it.

        Steps of the neighbours add up to a drift; the motion since rest does not. Where it would have to be
        extrapolated far, the steps are all there is.
        """
        gone = np.flatnonzero(~self._found)
        if len(gone) == 0 or self._found.sum() < NEAREST:
            return expected
        key = self._found.tobytes()
        if self._fit is None or self._fit[0] != key:  # the same markers stay lost for many frames
            index, weights = fitted_weights(self._pattern[self._found], self._pattern[gone])
            self._fit = (key, np.flatnonzero(self._found)[index], weights)
        _, index, weights = self._fit
        near = np.abs(weights).sum(axis=1) < EXTRAPOLATED
        moved = np.einsum("mk,mki->mi", weights[near], (place - self._pattern)[index[near]])
        guessed = expected.copy()
        guessed[gone[near]] = self._pattern[gone[near]] + moved
        return guessed

    def _odd(self, place: Array) -> Mask:
        """Markers whose motion since rest is not like that of their neighbours."""
        moved = place - self._pattern
        middle = self._around.median(moved)
        return _length(moved - middle) > DISAGREE * self.pitch


def _length(vectors: Array) -> Array:
    return np.hypot(vectors[:, 0], vectors[:, 1])


def _middle(vectors: Array) -> Array:
    """Median per axis of those that are known, 0 where none is."""
    known = vectors[np.isfinite(vectors[:, 0])]
    return np.median(known, axis=0) if len(known) else np.zeros(2)


def _finite(points: Array) -> Array:
    return points[np.isfinite(points).all(axis=1)]


def _is_points(frame: Any) -> bool:
    """Whether an array holds places (n, 2) and no image."""
    if isinstance(frame, Detected):
        return False
    shape = as_array(frame, where="frame").shape
    return len(shape) == 2 and shape[1] == 2
