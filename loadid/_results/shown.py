"""What a picture shows of an estimate, whatever draws it: a known load in its shape, the largest loads, readable axes,
places of loads on a line or a surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError, plain, reals

from .summary import NOT_VERIFIED, allowed

if TYPE_CHECKING:
    from .estimate import LoadEstimate

PANELS = 6  # loads or sensors that a picture has room for


def label(estimate: LoadEstimate) -> list[str]:
    """What a picture must not travel without: grade, verification, overridden refusals, cautions."""
    words = [
        f"grade {estimate.grade.letter}",
        NOT_VERIFIED if estimate.certificate is None else f"forward model verified {estimate.certificate.date[:10]}",
    ]
    if estimate.allowed:
        words.append(allowed(estimate, "OVERRIDDEN"))
    found = list(dict.fromkeys(f.code.removeprefix("LID-") for f in estimate.cautions))
    words.append("cautions: " + (", ".join(found[:14]) or "none"))
    if len(found) > 14:
        words[-1] += f" and {len(found) - 14} more"
    return words


def known_load(estimate: LoadEstimate, truth: ArrayLike | None) -> NDArray[Any] | None:
    """A known load in the shape of the estimate."""
    if truth is None:
        return None
    array = known_amplitudes(truth) if estimate.load.dtype.kind == "c" else known_numbers(truth)
    array = array[:, None] if array.ndim == 1 and estimate.load.ndim == 2 else array
    if array.shape != estimate.load.shape:
        raise InputError("the known load does not fit", where="truth", found=array.shape, expected=estimate.load.shape)
    return array


def known_numbers(truth: ArrayLike) -> NDArray[np.float64]:
    """A known load as finite numbers."""
    array = reals(truth, where="truth", what="the known load is no real numbers")
    if not np.all(np.isfinite(array)):
        raise InputError("NaN or infinity in the known load", where="truth", expected="finite numbers")
    return array


def known_amplitudes(truth: ArrayLike) -> NDArray[np.complex128]:
    """Known complex amplitudes as finite numbers."""
    try:
        array = np.asarray(plain(truth), complex)
    except (TypeError, ValueError):
        array = np.array([np.nan])
    if not np.all(np.isfinite(array)):
        raise InputError("no finite numbers in the known load", where="truth", expected="complex amplitudes")
    return array


def largest(estimate: LoadEstimate) -> list[int]:
    """Loads to show, in their own order: all, or the largest few."""
    size = np.abs(estimate.load).max(axis=0)
    return sorted(int(j) for j in np.argsort(-size, kind="stable")[:PANELS])


def readable(estimate: LoadEstimate, window: tuple[float, float] | None = None) -> tuple[float, str]:
    """Factor and unit that make the axis, or a part of it, readable."""
    axis = estimate.axis
    assert axis is not None
    first, last = window or (float(axis.values[0]), float(axis.values[-1]))
    if axis.unit != "s" or last - first >= 1:
        return 1.0, axis.unit
    return (1e3, "ms") if last - first >= 1e-3 else (1e6, "µs")


def axis_label(estimate: LoadEstimate) -> str:
    """Name and unit of the first axis."""
    assert estimate.axis is not None
    return titled(estimate.axis.name, readable(estimate)[1])


def titled(name: str, of: str) -> str:
    """``time [ms]``, or the name alone where there is no unit."""
    return f"{name} [{of}]" if of and of != "1" else name


def places(geometry: Mapping[str, Any] | None) -> tuple[NDArray[np.float64], tuple[str, ...]] | None:
    """Places (points, 1 or 2) of loads along the axes in which they differ, and the names of these.

    Axes of the structure where the loads lie along one or two of them, else distances along the line or in the plane
    that fits them best. None where there is no geometry, or all three differ.
    """
    found = None if geometry is None else geometry.get("coordinates")
    if found is None or len(found) < 2:
        return None
    x = np.asarray(found, float)
    x = x[:, None] if x.ndim == 1 else x
    span = np.ptp(x, axis=0)
    used = np.flatnonzero(span > 1e-6 * span.max())
    if len(used) in (1, 2):
        plane = x[:, used]
        if len(used) == 1 or np.linalg.matrix_rank(plane - plane.mean(axis=0), tol=1e-6 * span.max()) == 2:
            return plane, tuple("xyz"[k] for k in used)
    centred = x - x.mean(axis=0)
    values, axes = np.linalg.svd(centred, full_matrices=False)[1:]
    rank = int(np.sum(values > 1e-6 * values[0])) if values[0] > 0 else 0
    if rank not in (1, 2):
        return None
    along = centred @ axes[:rank].T
    return along - along.min(axis=0), ("along",) if rank == 1 else ("along", "across")


def has_field(estimate: LoadEstimate) -> bool:
    """Whether the loads are places of a field on a line or a surface."""
    g = estimate.geometry
    if g is None or g.get("kind") == "polynomials" or g.get("coordinates") is None or len(g["coordinates"]) < 2:
        return False
    return places(g) is not None
