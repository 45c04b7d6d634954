"""What a tracker is given: blocks of samples in, estimates out; ends of range; samples that come late.

Two anchors, a window apart, hold the whole state of the tracker; the samples since the older one are kept. That is one
copy of a row a sample, and a window behind the newest sample is always within reach.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from structures._flags import Flag
from structures.errors import InputError, number, real, shown

from ... import _guards as guards
from ..._inverse.gaussian.roots import Array
from ..._record import Record
from ..._results.estimate import Axis, LoadEstimate
from ..._results.facts import Facts, provenance
from ..answer import SolvedLoad, labelled
from ..data import Data, numbers
from ..detection import NotTold, of_track
from .fit import TrackerFit

EXPECTED = "a positive number, or (low, high) with low < high"


def ranges(given: Any, labels: Sequence[str]) -> Array | None:
    """Low and high end (sensors, 2) of each sensor; None where none is given.

    Parameters
    ----------
    given : None, number, sequence (sensors,) or mapping of label to one
        A number L is the range -L to L; a pair is (low, high); None a sensor without an end.
    labels : sequence of str

    Raises
    ------
    InputError
        No such sensor, no range.
    """
    if given is None:
        return None
    if isinstance(given, Mapping):
        unknown = [str(k) for k in given if k not in labels]
        if unknown:
            raise InputError("no such sensor", where="limits", found=", ".join(unknown), expected=", ".join(labels))
        listed = [given.get(label) for label in labels]
    elif real(given) is not None:
        listed = [given] * len(labels)
    else:
        try:
            listed = list(given)
        except TypeError:
            raise InputError("no ranges of sensors", where="limits", found=shown(given), expected=EXPECTED) from None
        if len(listed) != len(labels):
            raise InputError("one range for each sensor", where="limits", found=f"{len(listed)}",
                             expected=f"{len(labels)}, for {', '.join(labels)}",
                             hint="a mapping of labels takes some of them")  # fmt: skip
    return np.array([_range(one, label) for one, label in zip(listed, labels, strict=True)], float)


def inside(Y: Array, limits: Array | None) -> Array:
    """Samples (..., sensors), NaN where they are at the end of a range or beyond; infinite ones stay as they are."""
    if limits is None:
        return Y
    at_end = np.isfinite(Y) & ((limits[:, 0] >= Y) | (limits[:, 1] <= Y))
    return np.where(at_end, np.nan, Y) if at_end.any() else Y


def within(data: Data, limits: Array | None) -> Data:
    """Data whose samples at the end of a range are missing."""
    found = inside(np.where(data.missing, np.nan, data.values), limits)
    missing = np.isnan(found)
    if limits is None or np.array_equal(missing, data.missing):
        return data
    if missing.all(axis=0).any():
        raise InputError("a channel is at the end of its range in every sample", where="limits",
                         found=data.channels[int(np.argmax(missing.all(axis=0)))].label,
                         expected="samples within the range")  # fmt: skip
    return replace(data, values=np.where(missing, 0.0, found), missing=missing)


def _range(one: Any, label: str) -> tuple[float, float]:
    if one is None:
        return -np.inf, np.inf
    if (size := real(one)) is not None:
        low, high = -size, size
    else:
        try:
            low, high = (_end(x, open_end) for x, open_end in zip(one, (-np.inf, np.inf), strict=True))
        except (TypeError, ValueError):
            low = high = np.nan
    if not low < high:
        raise InputError("no range of a sensor", where=f"limits of {label}", found=shown(one), expected=EXPECTED)
    return float(low), float(high)


def _end(given: Any, without: float) -> float:
    """One end of a range: None for `without`, NaN for what is no number."""
    found = without if given is None else real(given)
    return np.nan if found is None else float(found)


class Replay:
    """Anchors and samples.

    Parameters
    ----------
    window : int
        Samples behind the newest one that a late sample may lie.
    """

    def __init__(self, window: int) -> None:
        self.window = window
        self.count = 0  # samples taken
        self.anchors: list[tuple[int, dict[str, Any]]] = []  # samples taken before it, and the state then
        self.samples: list[Array] = []  # since the older anchor

    def cuts(self, more: int) -> list[int]:
        """Where a block of `more` samples is cut: at the anchors that single samples would leave behind, and there."""
        stop = self.count + more
        last = stop - 1 - (stop - 1) % self.window
        wanted = [k for k in (last - self.window, last) if self.count <= k < stop]
        if not self.anchors:
            wanted.append(self.count)
        return [*sorted({k - self.count for k in wanted}), more]

    def anchor(self, tree: dict[str, Any]) -> None:
        """The state before the next sample."""
        if self.anchors and self.anchors[-1][0] == self.count:
            return
        self.anchors = [*self.anchors[-1:], (self.count, tree)]
        self.samples = self.samples[self.anchors[0][0] - self._first :]
        self._first = self.anchors[0][0]

    _first = 0

    def push(self, rows: Array) -> None:
        """Samples (samples, sensors) that the tracker has taken."""
        self.samples.extend(np.array(rows, float))
        self.count += len(rows)

    def place(self, ago: int) -> int | None:
        """Index among the kept samples of the one with `ago` samples after it; None where it is out of reach."""
        found = len(self.samples) - 1 - ago
        return found if ago < self.window and found >= 0 else None

    def to_tree(self) -> dict[str, Any]:
        """Everything that changes, as plain arrays and numbers."""
        return {
            "count": self.count, "first": self._first, "samples": np.array(self.samples),
            "anchors": [[k, tree] for k, tree in self.anchors],
        }  # fmt: skip

    def restore(self, tree: dict[str, Any]) -> None:
        """Go on from what `to_tree` gave."""
        self.count, self._first = int(tree["count"]), int(tree["first"])
        self.samples = list(np.asarray(tree["samples"], float))
        self.anchors = [(int(k), anchor) for k, anchor in tree["anchors"]]


def values(f: TrackerFit, block: Any, dt: float | None) -> tuple[Array, dict[str, str]]:
    """Samples (samples, sensors) of a block in the order of the sensors, and the digest of its record.

    Raises
    ------
    InputError
        Channels, units or a step that are not those of the fit; infinite numbers.
    """
    labels = [c.label for c in f.sensors]
    if isinstance(block, Record):
        picked = block.select(labels)
        step, values = picked.dt, picked.values
        inputs = {block.source or block.name or "record": block.sha256}
        wrong = [
            f"{c.label} in {c.unit}, not {s.unit}"
            for c, s in zip(picked.channels, f.sensors, strict=True)
            if "arbitrary" not in (c.unit, s.unit) and c.unit != s.unit
        ]
        if wrong:
            raise InputError("a channel is in another unit than its sensor", where="track", found="; ".join(wrong),
                             expected="the units of the fit", hint="state the units of the record")  # fmt: skip
    else:
        values, inputs = numbers(block, "the block is no table of real numbers"), {}
        step = f.dt if dt is None else number("dt", dt, where="track", unit="s")
    if not abs(step / f.dt - 1) <= 1e-6:
        raise InputError("the samples have another step than those of the fit", where="track",
                         found=f"dt = {step:.9g} s", expected=f"dt = {f.dt:.9g} s",
                         hint="resample, or fit a tracker for this step")  # fmt: skip
    if values.ndim != 2 or values.shape[1] != len(labels) or not len(values):
        raise InputError("the block does not fit the sensors", where="track", found=f"shape {values.shape}",
                         expected=f"(samples, {len(labels)}): {', '.join(labels[:8])}")  # fmt: skip
    if np.isinf(values).any():
        raise InputError("an infinite number in the block", where="track",
                         found=labels[int(np.argmax(np.isinf(values).any(axis=0)))],
                         expected="finite numbers, NaN where a sample is missing")  # fmt: skip
    return np.ascontiguousarray(values, float), inputs


def not_told(f: TrackerFit, Y: Array) -> NotTold | None:
    """What is said of samples that tell no load from noise; None where they do, or are too few to be asked."""
    return of_track(f.model, Y, f.noise_source.kind not in ("residual", "unknown"), f.loads)


def estimate(
    f: TrackerFit, counts: Mapping[str, int], load: Array, std: Array, Y: Array | None, rest: Array | None,
    inputs: dict[str, str], first: int, path: str, flags: Iterable[Flag], said: NotTold | None = None,
) -> LoadEstimate:  # fmt: skip
    """Estimate of a block from sample `first` on; Y, rest (samples, sensors): data and what is left of them.

    `said`: of samples that tell no load from noise.
    """
    there = np.ones((len(load), len(f.sensors)), bool) if Y is None else np.isfinite(Y)
    lost = int(np.sum(~there))
    facts = Facts(
        path=path, m=there.size - lost, n=int(load.size), **f.noise_source.facts,
        time_constant=None if f.settled is None else f.settled.time_constant, tuned=f.numbers, counts=counts,
    )  # fmt: skip
    if lost:
        facts = replace(facts, missing=f"{lost} of {there.size} channel samples")
    if said is not None:
        facts, flags = replace(facts, **said.facts), (*flags, said.flag)
    found = SolvedLoad(
        load=load, std=std, axis=Axis("time", "s", np.asarray((first + np.arange(len(load))) * f.dt, float)),
        response=None if Y is None else np.where(there, Y, 0.0), facts=facts,
        residual=None if rest is None else np.where(there & np.isfinite(rest), rest, 0.0),
    )  # fmt: skip
    history = provenance(
        "load tracking", settings=dict(f.settings), inputs={**f.inputs, **inputs}, model=f.fingerprint, prior=f.words,
    )  # fmt: skip
    return labelled(found, f.loads, f.sensors, flags=guards.collect(flags), provenance=history)
