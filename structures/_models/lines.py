"""Lines and tables of FRFs: ascending frequencies, the line next to one, what lies between; arrays that fit them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .._channels import Channel
from .._flags import Evidence, Flag
from ..errors import InputError, finite, lines, plain

ON_A_LINE = 1e-6  # of the spacing: how near a frequency must be to a line to be that line
BETWEEN = "spacing of the lines, Hz"
Array = NDArray[np.float64]


def ascending(frequencies: ArrayLike) -> Array:
    """Frequencies in Hz (lines,), each once.

    Raises
    ------
    InputError
        If there is none, one is negative or not finite, or they do not ascend.
    """
    f = lines(frequencies)
    if len(f) == 0 or np.any(np.diff(f) <= 0):
        k = int(np.argmax(np.diff(f) <= 0)) if len(f) else 0
        raise InputError(
            "the lines do not ascend" if len(f) else "no lines",
            where="frequencies",
            found=f"{f[k]:.9g} Hz before {f[k + 1]:.9g} Hz" if len(f) else "an empty list",
            expected="Hz, ascending, each line once",
            hint="sort the lines together with the FRF" if len(f) else "",
        )
    return f


def spacing(own: Array) -> Array:
    """Distance of each line to its nearer neighbour; a single line is measured by itself."""
    if len(own) == 1:
        return np.maximum(own, 1.0)
    step = np.diff(own)
    return np.asarray(np.minimum(np.concatenate([step[:1], step]), np.concatenate([step, step[-1:]])))


def nearest(f: Array, own: Array) -> tuple[NDArray[np.int_], NDArray[np.bool_]]:
    """The line next to each frequency, and whether that is the frequency."""
    if len(own) == 1:
        near = np.zeros(len(f), int)
    else:
        right = np.clip(np.searchsorted(own, f), 1, len(own) - 1)
        near = right - (f - own[right - 1] < own[right] - f)
    return near, np.abs(f - own[near]) <= ON_A_LINE * spacing(own)[near]


def index_of(f: Array, own: Array) -> NDArray[np.int_]:
    """Which lines some frequencies are.

    Raises
    ------
    InputError
        If one is no line: the first is named.
    """
    near, there = nearest(f, own)
    off = ~there
    if np.any(off):
        k = int(np.argmax(off))
        raise InputError(
            "a frequency that is no line of the table",
            where="FrfModel",
            found=f"{f[k]:.9g} Hz" + (f" and {int(off.sum()) - 1} others" if off.sum() > 1 else ""),
            expected=f"one of its {len(own)} lines; the nearest is {own[near[k]]:.9g} Hz",
            hint="ask at model.frequencies, or build it with interpolate=True where the lines are dense enough",
        )
    return near


def between(f: Array, own: Array, table: NDArray[Any]) -> NDArray[Any]:
    """A table (lines, ...) at frequencies (Hz) between its lines, linear; what lies outside is that of the end."""
    right = np.clip(np.searchsorted(own, f), 1, len(own) - 1)
    weight = np.clip((f - own[right - 1]) / (own[right] - own[right - 1]), 0.0, 1.0)
    weight = weight.reshape(-1, *[1] * (table.ndim - 1))
    return np.asarray((1 - weight) * table[right - 1] + weight * table[right])


def interpolated(f: Array, own: Array, table: NDArray[Any]) -> NDArray[Any]:
    """`between`, where nothing lies outside.

    Raises
    ------
    InputError
        If a frequency does.
    """
    slack = ON_A_LINE * spacing(own).min()
    if np.any((f < own[0] - slack) | (f > own[-1] + slack)):
        raise InputError(
            "a frequency outside the lines of the table",
            where="FrfModel",
            found=f"{f.min():.6g} to {f.max():.6g} Hz",
            expected=f"{own[0]:.6g} to {own[-1]:.6g} Hz",
            hint="nothing is extrapolated",
        )
    return between(f, own, table)


def interpolation_flag(own: Array) -> Flag:
    """W211: lines between those of a table are interpolated."""
    step = float(spacing(own).max())
    return Flag(
        "W211",
        Evidence(BETWEEN, step),
        f"between its lines, up to {step:.4g} Hz apart, the FRF is interpolated linearly",
        "trust it where many lines lie on each peak and each antiresonance; measure the lines that you need otherwise",
    )


def checked(name: str, values: ArrayLike, shape: tuple[int, ...], *, where: str, kind: type = float) -> NDArray[Any]:
    """Read-only finite copy of a table of this shape; powers are not negative.

    Raises
    ------
    InputError
        If it is none.
    """
    where = f"{where}, {name}"
    try:
        raw = np.asarray(plain(values))
        if kind is float and np.iscomplexobj(raw):
            raise TypeError("complex numbers")
        found: NDArray[Any] = np.array(raw, kind)
    except (TypeError, ValueError) as error:
        raise InputError("no numbers", where=where, found=str(error)[:200], expected="an array of numbers") from None
    if found.shape != shape or not found.size:
        axes = "(lines, sensors, loads)" if len(shape) == 3 else "(lines, sensors)"
        raise InputError(
            "lines, channels and table do not fit",
            where=where,
            found=f"shape {found.shape}",
            expected=f"{axes} = {shape}",
            hint="lines come first, then sensors, then loads",
        )
    finite(found, where=where, hint="leave out the lines that are not known")
    if kind is float and (np.any(found < 0) or (name == "coherence" and np.any(found > 1 + 1e-9))):
        raise InputError(
            "a coherence outside 0 to 1" if name == "coherence" else "a negative power",
            where=where,
            found=f"{found.min():.6g} to {found.max():.6g}",
            expected="0 to 1" if name == "coherence" else ">= 0",
        )
    found.flags.writeable = False
    return found


def one_name_each(sensors: Sequence[Channel], loads: Sequence[Channel], where: str) -> None:
    """Refuse two sensors, or two loads, of one label.

    Raises
    ------
    InputError
        If there are any.
    """
    for name, own in (("sensors", sensors), ("loads", loads)):
        labels = [c.label for c in own]
        if len(set(labels)) != len(labels):
            raise InputError(f"labels of {name} are not unique", where=where, found=labels, expected="one name each")


def cube(H: NDArray[Any]) -> NDArray[Any]:
    """An FRF (lines,), (lines, sensors) or of three axes as one of three axes."""
    return H.reshape(H.shape + (1,) * (3 - H.ndim))
