"""Maps and true tractions as arrays that can be compared, and numbers of one map against its truth, without units.

Sources: DTMA, DMA, DTMB and SNR after Huang et al., Sci. Rep. 9:539 (2019), eqs 9-12. There and here |.| is the
magnitude of the vector at a point, P_i are the loaded patches of the truth, O is what lies outside all of them, and
means are weighted with the areas of the points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from loadid.validate import Known
from structures.errors import InputError, as_array, number, one_of, positive

from .._arrays import Array, Index, Mask, shaped

if TYPE_CHECKING:
    from loadid.validate import Known


def finite(values: Any, name: str, *, where: str = "metrics") -> Array:
    """A finite real array."""
    return shaped(
        values, where=f"{where}, {name}", what=f"{name}: values are NaN or infinite",
        hint="leave out the points that the map does not reach, from the truth too",
    )  # fmt: skip


def field(values: Any, name: str) -> Array:
    """A map (points, components): three components, or fewer of a map that has no others."""
    array = finite(values, name)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or not array.size or array.shape[1] > 3:
        raise InputError(
            f"{name} is no map", where="metrics", found=f"shape {array.shape}",
            expected="(points, 3), or (points,) of one component",
            hint="reshape a flat vector of three components per point with .reshape(-1, 3)",
        )  # fmt: skip
    return array


def pair(found: Any, truth: Any) -> tuple[Array, Array]:
    """An estimate and its truth on the same points, the truth loaded: nothing relative is defined without."""
    a, b = field(found, "found"), field(truth, "truth")
    if a.shape != b.shape:
        raise InputError(
            "estimate and truth are on different points", where="metrics", found=a.shape, expected=b.shape,
            hint="evaluate the truth at the nodes of the estimate",
        )  # fmt: skip
    if not np.any(b):
        raise InputError(
            "the truth is zero everywhere", where="metrics, truth", found="no load", expected="a load",
            hint="judge an unloaded frame by its noise, not by relative errors",
        )  # fmt: skip
    return a, b


def weights(areas: ArrayLike | None, points: int) -> Array:
    """Positive tributary areas (points,), equal ones where none are given; their sum is one."""
    if areas is None:
        return np.full(points, 1 / points)
    hint = "pass surface.areas, or nothing on a regular grid"
    found = shaped(areas, (points,), where="metrics, areas", what="areas do not fit the map", hint=hint)
    if not (found > 0).all():
        raise InputError("areas do not fit the map", where="metrics, areas", found=f"smallest {found.min():.3g}",
                         expected="positive areas", hint=hint)  # fmt: skip
    return np.asarray(found / found.sum())


def places(points: ArrayLike, count: int) -> Array:
    """Places of the map's points (points, dim)."""
    hint = "one place for each point of the map"
    return shaped(points, (count, 2), (count, 3), where="metrics, points", what="places do not fit the map", hint=hint)


def size(t: Array) -> Array:
    """Magnitude of the vector at each point."""
    return np.asarray(np.linalg.norm(t, axis=1))


PARTS = 6  # sub-cells of a pitch along each direction; a hat is taken as constant in each


def means(press: Any, nodes: Array, pitch: float | tuple[float, float], shape: str = "hat") -> Array:
    """Mean tractions of one press (Pa), (P, 3), about nodes (P, 2) of a regular grid.

    Parameters
    ----------
    press : Press
    nodes : array (P, 2)
        Places (m).
    pitch : float or (along X, along Y)
        Distance of the nodes (m).
    shape : {"hat", "patch"}
        Weight of the mean: bilinear, twice as wide as a cell, or constant over the cell.

    Raises
    ------
    InputError
        Another shape, or a pitch that is not positive.
    """
    hint = "nodal forces of finite elements are means over hats"
    one_of("unknown shape", shape, ("hat", "patch"), where="metrics.means", hint=hint)
    d = np.array([positive("pitch", p, where="metrics.means", unit="m") for p in np.broadcast_to(pitch, 2)])
    near = np.all(np.abs(nodes - np.asarray(press.at)) <= press.radius + d, axis=1)
    found = np.zeros((len(nodes), 3))
    if not near.any():
        return found
    if shape == "patch":
        found[near] = press.mean_tractions(_cells(nodes[near], d))
        return found
    steps = (np.arange(2 * PARTS) + 0.5) / PARTS - 1
    for x in steps:
        for y in steps:
            weight = (1 - abs(x)) * (1 - abs(y)) / PARTS**2
            found[near] += weight * press.mean_tractions(_cells(nodes[near] + d * [x, y], d / PARTS))
    return found


def known(
    presses: Sequence[Any],
    nodes: Array,
    areas: ArrayLike,
    *,
    pitch: float | tuple[float, float],
    source: str = "presses of known force and place",
) -> Known:
    """Nodal forces of known presses, as `loadid.validate` takes them: level "distribution".

    A resultant alone (``loadid.validate.ReferenceWrench``) stays partial there.

    Parameters
    ----------
    presses : sequence of Press
        Acting together.
    nodes : array (P, 2 or 3)
        Places of the estimate's nodes (m).
    areas : array (P,)
        Their tributary areas (m^2).
    pitch : float or (along X, along Y)
        Distance of the nodes (m).
    source : str
        What the reference is, in words.
    """
    at = finite(nodes, "nodes")[:, :2]
    total = np.sum([means(p, at, pitch) for p in presses], axis=0) * finite(areas, "areas")[:, None]
    return Known(total.ravel(), source=source)


def _cells(middles: Array, d: Array) -> Array:
    """Corners (P, 4, 2), counter-clockwise."""
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    return middles[:, None] + corners * d


THETA = 0.2  # share of its peak from which a map counts as contact
FLOOR = 1e-9  # share of the truth's peak below which a point is unloaded: rounding
Labels = Index


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
        return np.asarray(loaded.astype(np.intp))
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
    return np.asarray((w / w.sum()) @ places(points, len(values)))


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


def _mean(values: Array, w: Array, at: Mask) -> float:
    return float(values[at] @ w[at] / w[at].sum())


Split = tuple[Array, Array, Array, list[Mask], Mask]


def _split(found: Any, truth: Any, labels: ArrayLike | None, areas: ArrayLike | None) -> Split:
    """Estimate, truth, weights, the patches, and what lies outside."""
    a, b = pair(found, truth)
    own = patches(b) if labels is None else as_array(labels, where="metrics, labels")
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
