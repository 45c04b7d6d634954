"""Friction cones |t| <= mu n: projection, its derivative, and the frames in which a node is normal and tangential."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ConeFaces:
    """Where on their cones some points lie, after projection.

    Parameters
    ----------
    axes : array, shape (k, dim, dim)
        Orthonormal columns: along the ray, (across it,) outward normal. The identity inside and at the apex.
    share : array, shape (k, dim)
        Derivative of the projection along each axis: 1 free, 0 held, between for the curved side of a round cone.
    status : array, shape (k,)
        0 open (apex), 1 sliding (on the side), 2 sticking (inside).
    """

    axes: NDArray[np.float64]
    share: NDArray[np.float64]
    status: NDArray[np.int_]


def frames(normals: NDArray) -> NDArray[np.float64]:
    """Orthogonal frames whose last axis is the normal, (k, dim, dim): global = frame @ local (Householder)."""
    k, dim = normals.shape
    last = np.zeros(dim)
    last[-1] = 1.0
    u = last - normals
    size = np.sum(u**2, axis=1)
    factor = np.divide(2.0, size, out=np.zeros(k), where=size > 0)
    return np.eye(dim) - factor[:, None, None] * u[:, :, None] * u[:, None, :]


def faces(v: NDArray, mu: NDArray, facets: NDArray) -> ConeFaces:
    """Faces of the cones on which the projections of points `v` lie.

    A point is inside if |t| <= mu n; its projection is the apex if mu |t| <= -n, else it lies on the side at
    n* = (n + mu |t|) / (1 + mu^2). A pyramid is taken facet by facet, in the sector of the point.

    Parameters
    ----------
    v : array, shape (k, dim)
        Tangential components, then the normal one; dim is 2 or 3.
    mu : array, shape (k,)
        Friction coefficients (of the facets where there are any).
    facets : array of int, shape (k,)
        Number of facets of a pyramid; 0 is the round cone.
    """
    k, dim = v.shape
    t, n = v[:, :-1], v[:, -1]
    size = np.sqrt(np.sum(t**2, axis=1))
    e = np.zeros_like(t)
    e[:, 0] = 1.0
    np.divide(t, size[:, None], out=e, where=size[:, None] > 0)
    pyramid = facets > 0
    if dim == 3 and np.any(pyramid):
        e, reach, mu, vertex = _sectors(e, t, size, n, mu, facets)
    else:
        reach, vertex = size, np.zeros(k, bool)
    inside = (reach <= mu * n) & ((mu > 0) | (size == 0) & (n > 0))
    along = n + mu * reach  # component on the ray (mu e, 1), times its length
    apex = ~inside & (along <= 0)
    side = ~(inside | apex)
    axes = np.zeros((k, dim, dim))
    axes[:] = np.eye(dim)
    share = np.zeros((k, dim))
    share[inside] = 1.0
    length = np.sqrt(1 + mu**2)
    axes[side] = _side(e[side], mu[side], length[side])
    share[side, 0] = 1.0
    if dim == 3:
        round_ = np.divide(mu * along / length**2, size, out=np.zeros(k), where=size > 0)
        share[side, 1] = np.where(pyramid, np.where(vertex, 0.0, 1.0), round_)[side]
    return ConeFaces(axes, share, 2 * inside + side)


def _side(e: NDArray, mu: NDArray, length: NDArray) -> NDArray[np.float64]:
    """Axes on the side of a cone: ray, across (in space), outward normal."""
    k, flat = e.shape
    axes = np.zeros((k, flat + 1, flat + 1))
    axes[:, :-1, 0], axes[:, -1, 0] = e * (mu / length)[:, None], 1 / length
    if flat == 2:
        axes[:, 0, 1], axes[:, 1, 1] = -e[:, 1], e[:, 0]
    axes[:, :-1, -1], axes[:, -1, -1] = e / length[:, None], -mu / length
    return axes


def _sectors(
    e: NDArray, t: NDArray, size: NDArray, n: NDArray, mu: NDArray, facets: NDArray
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Direction, reach along it and slope of the facet or edge that a point projects to; round cones stay as they are.

    Facet j of K has its normal at the angle 2 pi j / K. By symmetry a point projects into its own sector.
    """
    pyramid = facets > 0
    K = np.where(pyramid, facets, 4)
    step = 2 * np.pi / K
    angle = np.arctan2(t[:, 1], t[:, 0])
    centre = np.round(angle / step) * step
    d = np.stack([np.cos(centre), np.sin(centre)], axis=1)
    reach, across = np.sum(d * t, axis=1), d[:, 0] * t[:, 1] - d[:, 1] * t[:, 0]
    foot = mu * (n + mu * reach) / (1 + mu**2)  # reach of the projection onto the plane of the facet
    outside = reach > mu * n
    vertex = pyramid & outside & (np.abs(across) > np.tan(step / 2) * foot)
    turned = centre + np.where(across < 0, -0.5, 0.5) * step
    corner = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    d = np.where(vertex[:, None], corner, d)
    steep = np.where(vertex, mu / np.cos(step / 2), mu)
    reach = np.sum(d * t, axis=1)
    choose = pyramid[:, None]
    return np.where(choose, d, e), np.where(pyramid, reach, size), np.where(pyramid, steep, mu), vertex


def project(v: NDArray, face: ConeFaces) -> NDArray[np.float64]:
    """Projections of points onto their cones, (k, dim), given their faces."""
    local = np.einsum("kij,ki->kj", face.axes, v)
    return np.einsum("kij,kj->ki", face.axes, face.share * local)


def excess(h: NDArray, mu: NDArray, facets: NDArray) -> NDArray[np.float64]:
    """By how much points lie outside their cones, (k,): |t| - mu n, or -n where that is larger; zero inside."""
    t, n = h[:, :-1], h[:, -1]
    size = np.sqrt(np.sum(t**2, axis=1))
    if h.shape[1] == 3:
        K = np.where(facets > 0, facets, 4)
        step = 2 * np.pi / K
        off = np.arctan2(t[:, 1], t[:, 0])
        off = off - np.round(off / step) * step
        size = np.where(facets > 0, size * np.cos(off), size)
    return np.maximum(np.maximum(size - mu * n, -n), 0.0)
