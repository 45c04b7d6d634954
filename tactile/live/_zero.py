"""When nothing touches the pad, and what its markers then show as the new zero.

A camera that moves shows the markers as a plane seen anew: to first order ``u = a + A x + x (c . x)``, eight numbers
(the infinitesimal homography). They are fitted to the markers that they explain, and taken off; the motion under a load
is local, and stays. What is left of a marker and its neighbours together is normal noise where nothing touches.

It is held against the rest at the start, not against the last zero: what is taken for rest never wanders further from
that than this noise, camera motion apart, so that a load that grows slowly is not zeroed away. A touch below that noise
(a few hundredths of a pixel over nine markers) cannot be told from none, and is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from .._arrays import Array
from .._sensors.marked import MarkedSensor

TOUCH = 6.0  # stds of a marker and its neighbours together; of a thousand such sums noise exceeds 4.5 once in 25 frames
AROUND = 9  # a marker and its neighbours
FAR = 3.0  # times the median distance, or the noise: markers that do not count in the fit of the camera's motion
FITS = 2
SEEN = 0.5  # share of the markers that tells of a touch
FEWEST = 8  # frames of a zero
STEADY, LARGER = 1.5, 2.0  # over what noise explains: the change within a quiet time; a step that is told
GAP = 1.0  # s without a frame, that end a quiet time


@dataclass(frozen=True)
class ZeroStep:
    """A zero that was taken anew: number and time (s) of its last frame, and how far it lies from the one before.

    `size` is the root mean square over the readings (m), `expected` what noise explains of it.
    """

    number: int
    time: float
    frames: int
    size: float
    expected: float

    @property
    def told(self) -> bool:
        """Whether it is larger than noise."""
        return self.size > LARGER * self.expected


class Rest:
    """Watches the readings of a sensor for quiet times, and keeps its zero.

    Parameters
    ----------
    sensor : MarkedSensor
        Its `offset` is set.
    seconds : float or None
        Quiet time after which the mean of its frames becomes the zero; None for never.
    """

    def __init__(self, sensor: MarkedSensor, seconds: float | None) -> None:
        self.sensor, self.seconds = sensor, seconds
        markers = sensor.markers
        self._shape = len(markers), len(markers.axes)
        self._count = markers.readings_count
        self._noise = np.asarray(markers.noise, float)[:, : self._shape[1]]
        self._level = float(np.sqrt(np.mean(self._noise**2)))
        self._columns = _plane(markers.points[:, :2])
        near = cKDTree(markers.points[:, :2]).query(markers.points[:, :2], k=min(AROUND, len(markers)))[1]
        rows = np.repeat(np.arange(len(markers)), near.shape[1])
        self._sum = sparse.csr_array((np.ones(near.size), (rows, near.ravel())), shape=(len(markers),) * 2)
        self.anchor, self.frames = sensor.offset[: self._count], 1
        self.score = 0.0  # of the last frame, in stds
        self._last: float | None = None
        self._from: float | None = None  # time at which it became quiet
        self._quiet, self._halves = np.zeros(2, int), np.zeros((2, 2, self._count))  # frames, sums and counts of halves

    @property
    def touched(self) -> bool:
        """Whether the last frame shows more than a pad at rest."""
        return self.score > TOUCH

    def anchored(self) -> None:
        """What the sensor has as zero, of one frame, is its rest from now on."""
        self.anchor, self.frames = self.sensor.offset[: self._count], 1
        self._begin()

    def update(self, number: int, time: float, y: NDArray[np.float64], *, hidden: bool = False) -> ZeroStep | None:
        """Take the readings (m,) of the markers in a frame, no zero taken off; the step where a zero was taken.

        Nothing is known of the pad where a part of it is `hidden`: no time with that is quiet.
        """
        self.score = self._scored(y)
        pause = self._last is not None and not 0 <= time - self._last <= GAP
        self._last = time
        if self.seconds is None:
            return None
        if pause or hidden or self.touched:
            self._begin()
        if hidden or self.touched:
            return None
        if self._from is None:
            self._from = time
        known = np.isfinite(y)
        half = int(time - self._from >= 0.5 * self.seconds)
        self._halves[half] += np.where(known, y, 0.0), known
        self._quiet[half] += 1
        if time - self._from < self.seconds or self._quiet.sum() < FEWEST:
            return None
        return self._taken(number, time)

    # -- inside -------------------------------------------------------------------------------------------------------
    def _begin(self) -> None:
        self._from = None
        self._quiet[:], self._halves[:] = 0, 0.0

    def _taken(self, number: int, time: float) -> ZeroStep | None:
        """The zero of the quiet time that has passed; where it was not steady, its second half begins another."""
        (first, n), (second, m) = self._halves.copy()
        both = (n > 0) & (m > 0)
        apart = _rms(first[both] / n[both] - second[both] / m[both])
        frames, later, total, counts = int(self._quiet.sum()), int(self._quiet[1]), first + second, n + m
        self._begin()
        chance = self._level * np.sqrt(float(np.mean(1 / n[both] + 1 / m[both]))) if both.any() else 0.0
        if not both.any() or apart > STEADY * chance:
            self._from, self._quiet[0], self._halves[0] = time - 0.5 * float(self.seconds or 0), later, (second, m)
            return None
        offset = self.sensor.offset
        before = offset[: self._count].copy()
        known = counts > 0
        offset[: self._count][known] = total[known] / counts[known]
        self.sensor.offset = offset
        expected = self._level * float(np.sqrt(1 / frames + 1 / self.frames))
        self.frames = frames
        return ZeroStep(number, time, frames, _rms((offset[: self._count] - before)[known]), expected)

    def _scored(self, y: Array) -> float:
        """Largest motion of a marker and its neighbours that no motion of the camera explains, in stds."""
        moved = (y - self.anchor).reshape(self._shape)
        seen = np.asarray(np.isfinite(moved).all(axis=1))
        if seen.mean() < SEEN:
            return np.inf
        left = moved.copy()
        left[:, :2] -= self._seen_anew(moved[:, :2], seen)
        z = np.where(seen[:, None], left / self._noise, 0.0)
        return float(np.sqrt(np.max(np.sum((self._sum @ z) ** 2, axis=1) / np.maximum(self._sum @ seen, 1.0))))

    def _seen_anew(self, moved: Array, seen: NDArray[np.bool_]) -> Array:
        """Motion (N, 2) by the camera, fitted to the markers that it explains."""
        fitted = np.broadcast_to(np.median(moved[seen], axis=0), moved.shape)
        for _ in range(FITS):
            away = np.hypot(*np.where(seen[:, None], moved - fitted, np.inf).T)
            used = away <= FAR * max(float(np.median(away[seen])), self._level)
            rows = self._columns[used].reshape(-1, self._columns.shape[2])
            found = np.linalg.lstsq(rows, moved[used].ravel(), rcond=None)[0]
            fitted = self._columns @ found
        return np.asarray(fitted)


def _plane(places: Array) -> Array:
    """Motion (N, 2, 8) of places on a plane by the eight numbers of a camera that moves."""
    middle = places.mean(axis=0)
    x, y = ((places - middle) / np.abs(places - middle).max()).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    along = [one, x, y, zero, zero, zero, x * x, x * y]
    across = [zero, zero, zero, one, x, y, x * y, y * y]
    return np.stack([np.column_stack(along), np.column_stack(across)], axis=1)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
