"""Force maps of many frames as one result: one file, one axis, every finding once with the number of its frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from loadid.estimate import Axis
from structures.errors import InputError
from structures.flags import Flag
from structures.values import reals

from .forcemap import PROVIDED, ForceMap


def record(
    maps: Iterable[ForceMap], *, numbers: Sequence[int] | None = None, times: ArrayLike | None = None
) -> ForceMap:
    """One force map of the frames of a sensor.

    Parameters
    ----------
    maps : iterable of ForceMap
        Single frames on one surface, in their order.
    numbers : sequence of int, optional
        Of the frames; from 1 where not given.
    times : array, optional
        Seconds of the frames, ascending: the axis is then time.

    Returns
    -------
    ForceMap
        ``load`` and ``std`` (frames, 3 P). What differs between frames in ``facts`` is a list; of a finding that
        several frames share the strongest is kept, with their number. Posterior and residuals stay with the frames.

    Raises
    ------
    InputError
        No frames, sequences among them, frames of different sensors, numbers or times that do not fit.
    """
    frames = list(maps)
    if not frames:
        raise InputError("no frames to record", where="record", found="none", expected="force maps of single frames")
    first = frames[0]
    for k, frame in enumerate(frames):
        _require_alike(frame, first, k)
    known = list(range(1, len(frames) + 1)) if numbers is None else [int(n) for n in numbers]
    assert first.geometry is not None
    spread = np.array([f.geometry["resultant_covariance"] for f in frames if f.geometry is not None])
    return ForceMap(
        load=np.array([f.load for f in frames]),
        std=np.array([f.std for f in frames]),
        bias=_all([f.bias for f in frames]),
        labels=first.labels,
        units=first.units,
        axis=_axis(len(frames), known, times),
        flags=shared([f.flags for f in frames], known),
        allowed=first.allowed,
        certificate=first.certificate,
        choice=first.choice if all(f.choice is first.choice for f in frames) else None,
        provenance=first.provenance,
        geometry={**first.geometry, "resultant_covariance": spread},
        facts=_facts([f.facts for f in frames]),
    )


def shared(flags: Sequence[Iterable[Flag]], numbers: Sequence[int]) -> tuple[Flag, ...]:
    """Every code once: the finding with the largest number, and in which frames.

    Parameters
    ----------
    flags : sequence of sequences of Flag
        Of each frame.
    numbers : sequence of int
        Of the frames.
    """
    found: dict[str, list[tuple[int, Flag]]] = {}
    for number, of_frame in zip(numbers, flags, strict=True):
        for flag in of_frame:
            found.setdefault(flag.code, []).append((number, flag))
    return tuple(_one(listed, len(flags)) for listed in found.values())


def _one(listed: list[tuple[int, Flag]], total: int) -> Flag:
    number, strongest = max(listed, key=lambda pair: _size(pair[1]))
    frames = sorted({n for n, _ in listed})
    if total == 1 or (len(frames) == total and len({f.message for _, f in listed}) == 1):
        return strongest
    same = len({f.message for _, f in listed}) == 1
    most = f"from frame {frames[0]}" if same else f"most in frame {number}"
    where = f"in {len(frames)} of {total} frames, {most}"
    return replace(strongest, message=f"{strongest.message} ({where})")


def _size(flag: Flag) -> float:
    value = flag.evidence.value
    return 0.0 if isinstance(value, str) else abs(float(value))


def _require_alike(frame: ForceMap, first: ForceMap, k: int) -> None:
    if not frame.single:
        raise InputError("a sequence among single frames", where=f"record, frame {k + 1}", found=frame.load.shape,
                         expected="(3 P,)", hint="force.frame(i) gives one")  # fmt: skip
    same = frame.labels == first.labels and frame.units == first.units and np.array_equal(frame.nodes, first.nodes)
    if not same:
        raise InputError("frames of different sensors", where=f"record, frame {k + 1}",
                         found=f"{len(frame.labels)} loads in {frame.units[0]}",
                         expected=f"{len(first.labels)} in {first.units[0]}, on the nodes of frame 1")  # fmt: skip


def _axis(count: int, numbers: list[int], times: ArrayLike | None) -> Axis:
    values = np.asarray(numbers, float) if times is None else reals(times, where="record, times")
    if values.shape != (count,) or not np.all(np.isfinite(values)) or not np.all(np.diff(values) > 0):
        raise InputError("the axis does not fit the frames", where="record, times" if times is not None else "record",
                         found=f"shape {values.shape}", expected=f"{count} finite numbers, ascending")  # fmt: skip
    return Axis("frame", "", values) if times is None else Axis("time", "s", values)


def _all(arrays: list[Any]) -> Any:
    return None if any(a is None for a in arrays) else np.array(arrays)


def _facts(listed: list[Mapping[str, Any]]) -> dict[str, Any]:
    """What all frames share as it is, the rest as a list."""
    out: dict[str, Any] = {}
    for name in dict.fromkeys(key for facts in listed for key in facts):
        values = [facts.get(name) for facts in listed]
        out[name] = values[0] if all(_equal(v, values[0]) for v in values) else values
    return {**out, "provided": _provided([dict(facts.get("provided", {})) for facts in listed]), "frames": len(listed)}


def _provided(listed: list[dict[str, str]]) -> dict[str, str]:
    """Of each component the least that any frame can say: completed, then measured, then tracked."""
    axes = dict.fromkeys(axis for one in listed for axis in one)
    return {axis: max((one[axis] for one in listed if axis in one), key=PROVIDED.index) for axis in axes}


def _equal(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return np.array_equal(a, b)
    return bool(a == b)
