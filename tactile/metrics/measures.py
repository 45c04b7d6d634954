"""Numbers of one map against its truth, each a pure function that knows no units.

Sources: DTMA, DMA, DTMB and SNR after Huang et al., Sci. Rep. 9:539 (2019), eqs 9-12. There and here |.| is the
magnitude of the vector at a point, P_i are the loaded patches of the truth, O is what lies outside all of them, and
means are weighted with the areas of the points.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import number, plain

from .settled import Array, field, pair, places, size, weights

THETA = 0.2  # share of its peak from which a map counts as contact
FLOOR = 1e-9  # share of the truth's peak below which a point is unloaded: rounding
Labels = NDArray[np.intp]


def patches(truth: Any, points: ArrayLike | None = None, *, floor: float = FLOOR) -> Labels:
    """Loaded patches of the truth: 0 outside, 1, 2, ... for each connected patch.

    Parameters
    ----------
    truth : array (points, 3)
    points : array (points, 2 or 3), optional
        Places (m). Points closer than 1.6 times the median distance of neighbours touch. Without places, all loaded
        points are one patch.
    floor : float
        Share of the largest magnitude below which a point is outside.
    """
    magnitude = size(field(truth, "truth"))
    loaded = magnitude > number("floor", floor, where="metrics.patches") * magnitude.max()
    if points is None:
        return loaded.astype(np.intp)
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    at = places(points, len(magnitude))
    near = float(np.median(cKDTree(at).query(at, k=2)[0][:, 1])) if len(at) > 1 else 1.0
    inside = np.flatnonzero(loaded)
    pairs = cKDTree(at[inside]).query_pairs(1.6 * near, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(inside), len(inside)))
    labels = np.zeros(len(magnitude), np.intp)
    labels[inside] = connected_components(graph, directed=False)[1] + 1
    return labels


def relative_error(found: Any, truth: Any, areas: ArrayLike | None = None, component: int | None = None) -> float:
    """Norm of the difference over the norm of the truth, of all components or of one of them.

    A single component is held against its own norm; where the truth has none, against the norm of all components.
    """
    a, b = pair(found, truth)
    w = np.sqrt(weights(areas, len(a)))[:, None]
    whole = float(np.linalg.norm(w * b))
    if component is None:
        return float(np.linalg.norm(w * (a - b))) / whole
    own = float(np.linalg.norm(w[:, 0] * b[:, component]))
    return float(np.linalg.norm(w[:, 0] * (a - b)[:, component])) / (own if own > FLOOR * whole else whole)


def cosine(found: Any, truth: Any, areas: ArrayLike | None = None) -> float:
    """Cosine of the angle between the two maps, 1 for the same shape whatever the gain; 0 for an empty estimate."""
    a, b = pair(found, truth)
    w = np.sqrt(weights(areas, len(a)))[:, None]
    a, b = w * a, w * b
    own, known = np.linalg.norm(a), np.linalg.norm(b)
    return float(np.sum((a / own) * (b / known))) if own > 0 else 0.0


def peak_ratio(found: Any, truth: Any) -> float:
    """Largest magnitude over that of the truth, wherever the two are."""
    a, b = pair(found, truth)
    return float(size(a).max() / size(b).max())


def iou(found: Any, truth: Any, areas: ArrayLike | None = None, *, theta: float = THETA) -> float:
    """Intersection over union of the contact areas: where each map exceeds `theta` times its own peak."""
    a, b = pair(found, truth)
    if not 0 < number("theta", theta, where="metrics.iou") < 1:
        raise InputError("theta is no share", where="metrics.iou", found=theta, expected="a number in (0, 1)")
    w = weights(areas, len(a))
    own, known = size(a), size(b)
    p, q = own > theta * own.max(), known > theta * known.max()
    return float(w[p & q].sum() / w[p | q].sum())


def dtma(found: Any, truth: Any, labels: ArrayLike | None = None, areas: ArrayLike | None = None) -> float:
    """Mean over the patches of the relative error of the mean magnitude there; negative where magnitude is lost.

    Blind to direction, and errors of opposite sign cancel: read it beside `cosine` and `relative_error`.
    """
    a, b, w, sets, _ = _split(found, truth, labels, areas)
    own, known = size(a), size(b)
    return float(np.mean([_mean(own - known, w, p) / _mean(known, w, p) for p in sets]))


def dma(found: Any, truth: Any, labels: ArrayLike | None = None) -> float:
    """Mean over the patches of the relative error of the largest magnitude there."""
    a, b, _, sets, _ = _split(found, truth, labels, None)
    own, known = size(a), size(b)
    return float(np.mean([(own[p].max() - known[p].max()) / known[p].max() for p in sets]))


def dtmb(found: Any, truth: Any, labels: ArrayLike | None = None, areas: ArrayLike | None = None) -> float | None:
    """Leakage: mean magnitude outside all patches over the mean magnitude of the truth inside; None without outside."""
    a, b, w, sets, outside = _split(found, truth, labels, areas)
    if not outside.any():
        return None
    return float(len(sets) * _mean(size(a), w, outside) / sum(_mean(size(b), w, p) for p in sets))


def snr(found: Any, truth: Any, labels: ArrayLike | None = None, areas: ArrayLike | None = None) -> float | None:
    """Mean magnitude in the patches over the std outside, sqrt(var_x + var_y + var_z); None without outside.

    Infinite where the map is constant outside, as a perfect one is.
    """
    a, _, w, sets, outside = _split(found, truth, labels, areas)
    if not outside.any():
        return None
    share = w[outside, None] / w[outside].sum()
    mean = np.sum(share * a[outside], axis=0)
    std = float(np.sqrt(np.sum(share * (a[outside] - mean) ** 2)))
    inside = float(np.mean([_mean(size(a), w, p) for p in sets]))
    return inside / std if std > 0 else np.inf


def centroid(t: Any, points: ArrayLike, areas: ArrayLike | None = None) -> Array:
    """Centre of the map's magnitude (dim,), in the unit of the places.

    Raises
    ------
    InputError
        If the map is empty.
    """
    values = field(t, "map")
    w = weights(areas, len(values)) * size(values)
    if not w.any():
        raise InputError("an empty map has no centre", where="metrics.centroid", found="zero everywhere",
                         expected="a load")  # fmt: skip
    return (w / w.sum()) @ places(points, len(values))


def centroid_error(found: Any, truth: Any, points: ArrayLike, areas: ArrayLike | None = None) -> float | None:
    """Distance of the centres of the two magnitudes, in the unit of the places; None for an empty estimate."""
    a, b = pair(found, truth)
    if not a.any():
        return None
    return float(np.linalg.norm(centroid(a, points, areas) - centroid(b, points, areas)))


def spread(found: Any, truth: Any, points: ArrayLike, areas: ArrayLike | None = None) -> float | None:
    """Rms radius of the squared magnitude about its own centre, over that of the truth: above 1 where a map is smeared.

    Squares, because a floor of noise over the whole pad would dominate the radius of the magnitude itself. None for an
    empty estimate, and for a truth at one point.
    """
    a, b = pair(found, truth)
    known = _radius(b, points, areas)
    return None if known == 0 or not a.any() else _radius(a, points, areas) / known


def _radius(t: Array, points: ArrayLike, areas: ArrayLike | None) -> float:
    w = weights(areas, len(t)) * (size(t) / size(t).max()) ** 2
    x = places(points, len(t))
    away = x - (w / w.sum()) @ x
    return float(np.sqrt(w @ np.sum(away**2, axis=1) / w.sum()))


def _mean(values: Array, w: Array, at: NDArray[np.bool_]) -> float:
    return float(values[at] @ w[at] / w[at].sum())


Split = tuple[Array, Array, Array, list[NDArray[np.bool_]], NDArray[np.bool_]]


def _split(found: Any, truth: Any, labels: ArrayLike | None, areas: ArrayLike | None) -> Split:
    """Estimate, truth, weights, the patches, and what lies outside."""
    a, b = pair(found, truth)
    own = patches(b) if labels is None else np.asarray(plain(labels))
    if own.shape != (len(a),) or own.dtype.kind not in "iub" or (own < 0).any():
        raise InputError(
            "labels of the patches do not fit the map",
            where="metrics, labels",
            found=f"shape {own.shape} of {own.dtype}",
            expected=f"({len(a)},) integers: 0 outside, 1, 2, ... in the patches",
            hint="metrics.patches(truth, points)",
        )
    sets = [own == i for i in np.unique(own) if i > 0]
    if not sets or any(not size(b)[p].any() for p in sets):
        raise InputError(
            "a patch without load in the truth", where="metrics, labels", found=f"{len(sets)} patches",
            expected="patches on which the truth is loaded", hint="metrics.patches(truth, points)",
        )  # fmt: skip
    return a, b, weights(areas, len(a)), sets, own == 0
