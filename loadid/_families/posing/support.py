"""Windows of time outside which a load is zero: its unknowns there are none, and their columns are left out.

A hammer that touches for 6 ms is a load of 6 ms: what is known of it takes unknowns away, where a penalty would only
make them small. The columns of the other samples are removed from the operator and from the penalty, so that a
difference counts the steps from zero at the ends of a window.
"""

from __future__ import annotations

from dataclasses import replace
from math import comb
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, reals, shown

from ..._inverse import penalties
from ..._inverse.gaussian.record import WhitenedRecord

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Windows = tuple[tuple[float, float], ...]

ENTRIES = 40_000_000  # of a matrix of the columns that are left: 320 MB
EDGE = 1e-6  # of a step: rounding of a time that is meant as a sample


def windows(given: Any) -> Windows | None:
    """Windows (s) as a user writes them: one pair, or several; in order, those that overlap made one.

    Raises
    ------
    InputError
        No pairs of numbers, an end before its beginning.
    """
    if given is None:
        return None
    pairs = reals(given, what="no window of the load", where="support")
    pairs = pairs[None] if pairs.ndim == 1 else pairs
    if pairs.ndim != 2 or pairs.shape[1] != 2 or not len(pairs) or not np.all(np.isfinite(pairs)):
        raise InputError("no window of the load", where="support", found=shown(given),
                         expected="(begin, end) in s from the first sample, or several of them")  # fmt: skip
    if np.any(pairs[:, 0] >= pairs[:, 1]):
        raise InputError("a window of the load ends before it begins", where="support", found=shown(given),
                         expected="(begin, end) in s, begin < end")  # fmt: skip
    joined: list[tuple[float, float]] = []
    for begin, end in sorted((float(a), float(b)) for a, b in pairs):
        if joined and begin <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], end)
        else:
            joined.append((begin, end))
    return tuple(joined)


def acting(found: Windows, samples: int, dt: float) -> Mask:
    """Samples (samples,) at which the load may act; the ends of a window belong to it.

    Raises
    ------
    InputError
        A window that holds no sample of the record.
    """
    t = np.arange(samples)
    mask = np.zeros(samples, bool)
    for begin, end in found:
        inside = (t >= begin / dt - EDGE) & (t <= end / dt + EDGE)
        if not inside.any():
            raise InputError("a window of the load holds no sample of the record", where="support",
                             found=f"{begin:g} to {end:g} s", expected=f"0 to {(samples - 1) * dt:.6g} s, at a step "
                             f"of {dt:.6g} s", hint="times count from the first sample, in seconds")  # fmt: skip
        mask |= inside
    return mask


def fits(count: int, samples: int, sensors: int) -> bool:
    """Whether the columns of so many unknowns are a matrix that fits a desk."""
    return count * samples * sensors <= ENTRIES


def columns(h: Array, mask: Mask) -> Array:
    """Operator (samples, sensors, acting samples * loads) of impulse responses (taps, sensors, loads)."""
    samples, at = len(mask), np.flatnonzero(mask)
    T = np.zeros((samples, h.shape[1], len(at), h.shape[2]))
    for i, k in enumerate(at):
        part = h[: samples - k]
        T[k : k + len(part), :, i] = part
    return T.reshape(samples, h.shape[1], -1)


def penalty(L: str | ArrayLike | None, mask: Mask, loads: int) -> Array | None:
    """Columns of the penalty of the samples at which the load acts, without the rows that are empty then.

    Raises
    ------
    InputError
        A matrix of the user for another record.
    """
    samples, at = len(mask), np.flatnonzero(mask)
    if L is None:
        return None
    if not isinstance(L, str):
        matrix = np.asarray(L, float)
        if matrix.ndim != 2 or matrix.shape[1] != samples * loads:
            raise InputError("the penalty matrix does not fit the unknowns", where="penalty",
                             found=f"shape {matrix.shape}", expected=f"(rows, {samples * loads})")  # fmt: skip
        kept = matrix[:, np.repeat(mask, loads)]
        return np.asarray(kept[np.any(kept != 0, axis=1)])
    order = penalties.order(L)
    if order == 0:
        return None
    rows = np.unique([k + j for k in at for j in range(order + 1) if order <= k + j < samples])
    found = np.zeros((len(rows), len(at)))
    place = {int(k): i for i, k in enumerate(rows)}
    for i, k in enumerate(at):
        for j in range(order + 1):
            if (row := place.get(int(k) + j)) is not None:
                found[row, i] = (-1) ** j * comb(order, j)
    return np.asarray(np.kron(found, np.eye(loads)), float)


def gated(record: WhitenedRecord, mask: Mask) -> WhitenedRecord:
    """A record over states, of a load without a penalty on differences, whose inputs act at some samples only.

    At the others neither states nor sensors hear the input: under the identity it is zero, whatever lambda is.
    """
    count, silent = len(record.F), np.zeros_like(record.G)
    return replace(
        record,
        F=np.concatenate([record.F, record.F]), G=np.concatenate([record.G, silent]),
        C=np.concatenate([record.C, record.C]), D=np.concatenate([record.D, np.zeros_like(record.D)]),
        kind=np.where(mask, record.kind, record.kind + count).astype(np.int32),
    )  # fmt: skip


def refuse(found: str, expected: str, hint: str = "") -> NoReturn:
    """A window of the load beside a setting that does not know one.

    Raises
    ------
    InputError
    """
    raise InputError("a window of the load does not go with this setting", where="support", found=found,
                     expected=expected, hint=hint)  # fmt: skip
