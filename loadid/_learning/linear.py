"""The best linear map of an ensemble of examples (LMMSE), in closed form, with its posterior covariance.

With examples y of readings and x of outputs, both less their mean, it is ``B = C_xy C_yy^(-1)``, and what it leaves has
the covariance ``C_xx - B C_yx`` (S. Kay, Fundamentals of Statistical Signal Processing: Estimation Theory, 1993,
chapter 12). Both come from one triangular factor of all examples and an SVD of a part of it, with a ridge that examples
choose which were kept apart. Histories are mapped by a centred window, the shortest that predicts these as well as any;
at the ends of a record by the window's part that lies inside, which the same factor gives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from structures.errors import InputError

from .training import Lesson, Training
from .triangle import Triangle, triangular

Array = NDArray[np.float64]

MOST = 480  # features of a window
ENOUGH = 60  # rows for each feature, beyond which nothing more is read
RIDGES = np.concatenate([[0.0], np.geomspace(1e-6, 1e-1, 11)])  # relative to the largest singular value
AS_GOOD = 1.02  # of the smallest error, up to which a window is as good as any
ENOUGH_RANK = 0.9  # of the loads that act: some at a rim act together with others alone
SPANNED = 1e-6  # singular value of the outputs, each over its norm, from which a direction is in the set: shards keep
# seven figures, so that loads that are multiples of each other differ by 1e-7
SPAN = ("still", "tied", "rank", "wanted")  # facts of it
NAMED = 200  # outputs, up to which those of a direction that is not in the set are named
ROWS = 20_000  # of features that are held at once


@dataclass(frozen=True, eq=False)
class Solved:
    """One map: outputs = intercept + features @ B, and a factor W with covariance W^T W of what it leaves."""

    intercept: Array
    B: Array
    W: Array
    ridge: float


@dataclass(frozen=True, eq=False)
class Span:
    """What of the outputs the examples span.

    Parameters
    ----------
    still : array of int
        Outputs that never vary.
    rank, wanted : int
        Directions in which they vary together, and in how many sensors could tell them apart.
    tied : array of int
        Outputs that act in the directions that lack, where they are few enough to be named.
    """

    still: NDArray[np.int_]
    rank: int
    wanted: int
    tied: NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class LinearEngine:
    """A linear map of readings, or of windows of them.

    Parameters
    ----------
    centre : Solved
        Of static readings, or of samples whose window lies inside the record.
    ends : tuple of Solved
        Of the first `half` samples of a record, then of the last; empty for static readings.
    half : int
        Samples of the window before and after its middle.
    sensors : int
    span : Span, optional
        What of the loads the examples span; known where the map was learned.
    """

    centre: Solved
    ends: tuple[Solved, ...]
    half: int
    sensors: int
    name: str = "linear"
    span: Span | None = None

    @classmethod
    def learn(cls, lesson: Lesson, progress: Callable[[float, str], None] | None = None) -> Self:
        """Fit to the examples of a lesson; the ridge and the window by those kept for choosing.

        Raises
        ------
        InputError
            The examples do not span the loads, or are too few or too short.
        """
        say = progress or (lambda _fraction, _text: None)
        sensors = len(lesson.fitting.sensors)
        most = 0 if lesson.dt is None else _widest(lesson, sensors)
        say(0.0, "reading examples")
        fitting = Triangle.of(_rows(lesson, lesson.fitting, most, sensors))
        choosing = Triangle.of(_rows(lesson, lesson.choosing, most, sensors))
        span = require_span(fitting, sensors)
        say(0.6, "choosing the window" if most else "choosing the ridge")
        half = _shortest(fitting, choosing, most, sensors)
        inside = fitting.only(_columns(most, half, sensors))
        centre = solved(inside, choosing.only(_columns(most, half, sensors)))
        ends = []
        for before, after in [*((i, half) for i in range(half)), *((half, half - 1 - i) for i in range(half))]:
            kept = _part(half, before, after, sensors)
            ends.append(solved(inside.only(kept), None, centre.ridge))
            say(0.7 + 0.3 * len(ends) / (2 * half), "the ends of records")
        return cls(centre, tuple(ends), half, sensors, span=span)

    @property
    def reach(self) -> int:
        """Samples before and after one that its load depends on."""
        return self.half

    def predict(self, data: Array) -> tuple[Array, Array]:
        """Outputs and their std (n, [samples,] outputs) of whitened data (n, [samples,] sensors)."""
        if data.ndim == 2:
            mean = self.centre.intercept + data @ self.centre.B
            return mean, np.broadcast_to(_std(self.centre), mean.shape)
        n, samples, half = len(data), data.shape[1], self.half
        if samples < 2 * half + 1:
            raise InputError(
                "the record is shorter than the window of the map", where="estimate", found=f"{samples} samples",
                expected=f"at least {2 * half + 1}", hint="give the whole record, or learn from shorter ones",
            )  # fmt: skip
        mean = np.empty((n, samples, len(self.centre.intercept)))
        std = np.empty_like(mean)
        for k, one in enumerate(data):
            for inside, rows in windows(one, half):
                mean[k, inside] = self.centre.intercept + rows @ self.centre.B
        std[:] = _std(self.centre)
        for i, end in enumerate(self.ends):
            first = i < half
            at = i if first else samples - half + (i - half)
            stretch = slice(0, at + half + 1) if first else slice(at - half, samples)
            mean[:, at] = end.intercept + data[:, stretch].reshape(n, -1) @ end.B
            std[:, at] = _std(end)
        return mean, std

    @property
    def of_constant(self) -> Array:
        """What outputs make of readings that are 1 all the time (sensors, outputs), less those of readings of 0."""
        B = self.centre.B
        return np.asarray(B.reshape(-1, self.sensors, B.shape[1]).sum(axis=0))

    @property
    def noise_std(self) -> Array:
        """Std (outputs,) inside a record of what white noise of unit std makes of the outputs."""
        return np.asarray(np.linalg.norm(self.centre.B, axis=0))

    @cached_property
    def weights(self) -> Array:
        """How much an output over its `noise_std` counts (outputs,): little where noise is little of its own std."""
        size = self.noise_std
        return np.asarray(size / np.where(size > 0, np.hypot(size, _std(self.centre)), 1.0))

    @cached_property
    def together(self) -> Array:
        """Sum of squares (lags,), of the covariance of weighted outputs of unit noise, from one sample on."""
        size = self.noise_std
        B = self.centre.B * (self.weights / np.where(size > 0, size, 1.0))
        step = self.sensors if self.ends else len(B)
        return np.array([np.sum((B[: len(B) - k].T @ B[k:]) ** 2) for k in range(0, len(B), step)])

    def over_noise(self, data: Array) -> Array:
        """Outputs (n, [samples,] outputs) less those of no readings, over what unit noise makes of them; 0 of none."""
        size = np.broadcast_to(self.noise_std, (*data.shape[:-1], len(self.noise_std))).copy()
        for i, end in enumerate(self.ends):
            size[:, i if i < self.half else data.shape[1] - 2 * self.half + i] = np.linalg.norm(end.B, axis=0)
        found = self.predict(data)[0] - self.predict(np.zeros_like(data))[0]
        return np.divide(found, size, out=np.zeros_like(found), where=size > 0)

    @property
    def covariance(self) -> Array:
        """Factor W (k, outputs) of the posterior covariance W^T W: of a static load, or of one sample inside."""
        return self.centre.W

    def arrays(self) -> dict[str, Any]:
        """What a file keeps."""
        return {
            "half": self.half, "sensors": self.sensors, "centre": _kept(self.centre),
            "ends": {str(i): _kept(end) for i, end in enumerate(self.ends)},
        }  # fmt: skip

    @classmethod
    def from_arrays(cls, tree: Mapping[str, Any]) -> Self:
        """Inverse of `arrays`."""
        ends = tuple(Solved(**tree["ends"][str(i)]) for i in range(len(tree["ends"])))
        return cls(Solved(**tree["centre"]), ends, int(tree["half"]), int(tree["sensors"]))


def solved(examples: Triangle, held_out: Triangle | None, ridge: float = 0.0) -> Solved:
    """The map of examples, at the ridge (relative to the largest singular value) that predicts others best."""
    U, s, Vt = np.linalg.svd(examples.own)
    along = U.T @ examples.shared
    largest = float(s[0]) if len(s) else 0.0

    def at(value: float) -> tuple[Array, Array]:
        floor = max(value, np.finfo(float).eps * len(s)) * largest
        B = Vt.T @ (_inverse(s, floor, value > 0)[:, None] * along)
        p = examples.features
        return np.asarray(examples.mean[p:] - examples.mean[:p] @ B), B

    if held_out is not None:
        size = np.linalg.norm(examples.targets, axis=0) / np.sqrt(max(examples.rows, 1))
        weight = np.where(size > 0, 1 / np.where(size > 0, size, 1.0), 0.0)
        ridge = float(min(RIDGES, key=lambda value: float(np.linalg.norm(weight * held_out.error(*at(value))))))
    intercept, B = at(ridge)
    passed = s**2 / (s**2 + (ridge * largest) ** 2) if largest > 0 else np.zeros_like(s)
    free = max(examples.rows - 1 - float(np.sum(passed)), 1.0)
    left = np.vstack([examples.shared - examples.own @ B, examples.rest])
    return Solved(intercept, B, triangular(left / np.sqrt(free)), ridge)


def windows(record: Array, half: int) -> Iterator[tuple[slice, Array]]:
    """Samples whose centred window lies inside a record (samples, sensors), and the windows (k, width * sensors)."""
    width, columns = 2 * half + 1, record.shape[1]
    views = sliding_window_view(record, width, axis=0).transpose(0, 2, 1)
    step = max(ROWS // 4, 1)
    for start in range(0, len(views), step):
        part = views[start : start + step]
        yield slice(half + start, half + start + len(part)), part.reshape(len(part), width * columns)


def require_span(examples: Triangle, sensors: int) -> Span:
    """What the examples span, if their loads vary in about as many directions as the sensors could tell apart.

    Raises
    ------
    InputError
        They do not.
    """
    span = span_of(examples.targets, sensors)
    wanted = int(np.ceil(ENOUGH_RANK * span.wanted))
    if span.rank < wanted or examples.rows <= wanted:
        vary = examples.targets.shape[1] - len(span.still)
        raise InputError(
            "the training set does not span the loads", where="training",
            found=f"{examples.rows} examples of rank {span.rank}", expected=f"rank {wanted} or more: {vary} loads act",
            hint="draw more examples, with loads that act independently of each other",
        )  # fmt: skip
    return span


def span_of(targets: Array, sensors: int) -> Span:
    """What a factor of outputs (rows, outputs) spans, each output over its norm."""
    size = np.linalg.norm(targets, axis=0)
    acts = size > SPANNED * np.linalg.norm(targets)
    vary = int(np.count_nonzero(acts))
    each = targets[:, acts] / size[acts]
    s = np.linalg.svd(each, compute_uv=False)
    rank = int(np.count_nonzero(s > SPANNED * s[0])) if vary else 0
    wanted = min(max(vary, 1), sensors)
    tied = np.zeros(0, int)
    if rank < wanted and 0 < vary <= NAMED:
        lacking = np.linalg.svd(each)[2][rank:]
        tied = np.flatnonzero(acts)[np.linalg.norm(lacking, axis=0) > 0.1]
    return Span(np.flatnonzero(~acts), rank, wanted, tied)


def span_facts(learned: Any, labels: Sequence[str]) -> dict[str, Any]:
    """What of the outputs the examples of an engine span, by name: of a network, those of the map below it."""
    span = getattr(getattr(learned, "linear", learned), "span", None)
    if span is None:
        return {}
    still, tied = ([labels[i] for i in at] for at in (span.still, span.tied))
    return dict(zip(SPAN, (still, tied, span.rank, span.wanted), strict=True))


# -- helpers ----------------------------------------------------------------------------------------------------------
def _inverse(s: Array, floor: float, ridge: bool) -> Array:
    """Of singular values, s / (s^2 + floor^2); without a ridge 1 / s of what is above the floor."""
    if ridge:
        return np.asarray(s / (s**2 + floor**2))
    seen = s > floor
    return np.where(seen, 1 / np.where(seen, s, 1.0), 0.0)


def _std(one: Solved) -> Array:
    return np.asarray(np.linalg.norm(one.W, axis=0))


def _kept(one: Solved) -> dict[str, Any]:
    return {"intercept": one.intercept, "B": one.B, "W": one.W, "ridge": one.ridge}


def _widest(lesson: Lesson, sensors: int) -> int:
    """Half of the widest window: within `MOST` features, and a third of a record."""
    samples = lesson.fitting.samples or min(batch[0].shape[1] for batch in lesson.batches(lesson.fitting))
    return int(max(1, min((MOST // sensors - 1) // 2, (samples - 1) // 6)))


def _columns(most: int, half: int, sensors: int) -> NDArray[np.int_]:
    """Columns of a window in those of the widest."""
    return _part(most, half, half, sensors)


def _part(half: int, before: int, after: int, sensors: int) -> NDArray[np.int_]:
    """Columns of `before` samples before the middle of a window to `after` behind it."""
    return np.arange((half - before) * sensors, (half + after + 1) * sensors)


def _rows(lesson: Lesson, part: Training, half: int, sensors: int) -> Iterator[tuple[Array, Array]]:
    """Features and outputs of a part of the set: of histories as many as are enough."""
    if lesson.dt is None:
        yield from lesson.batches(part, ROWS)
        return
    enough, have = ENOUGH * (2 * half + 1) * sensors, 0
    for data, outputs in lesson.batches(part):
        for record, output in zip(data, outputs, strict=True):
            for at, rows in windows(record, half):
                yield rows, output[at]
                have += len(rows)
            if have >= enough:
                return


def _shortest(fitting: Triangle, choosing: Triangle, most: int, sensors: int) -> int:
    """Half of the shortest window that predicts examples kept apart about as well as any."""
    if most == 0:
        return 0
    halves = sorted({int(h) for h in np.round(np.geomspace(min(2, most), most, 7))})
    errors = []
    for half in halves:
        kept = _columns(most, half, sensors)
        held_out = choosing.only(kept)
        one = solved(fitting.only(kept), held_out)
        errors.append(float(np.linalg.norm(held_out.error(one.intercept, one.B))))
    return next(h for h, error in zip(halves, errors, strict=True) if error <= AS_GOOD * min(errors))
