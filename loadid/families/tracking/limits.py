"""Ends of the range of a sensor: a sample at them says that the sensor saw more, not how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from structures.errors import InputError
from structures.values import real, shown

from ..data import Data

Array = NDArray[np.float64]
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
