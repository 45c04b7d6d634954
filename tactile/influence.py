"""Influence matrices without a mesh: motion of points under unit tractions at the nodes of a square grid.

The half-space answers in closed form for patches (`tactile.patches`); a hat, bilinear over four cells, is the mean of
the patch over one cell. What the base of a layer takes from that is smooth, and short rules average it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures.errors import InputError
from structures.values import positive, reals, shown

from .halfspace import point_forces
from .layer import HalfSpace, Layer
from .patches import rectangle
from .quadrature import drawn, gauss
from .radial import matrices, unit_point

Array = NDArray[np.float64]
BATCH = 200_000  # pairs of point and node at a time


def influence(
    ground: Layer | HalfSpace, points: ArrayLike, nodes: ArrayLike, pitch: float, shape: str = "patch"
) -> Array:
    """Motion of points per traction at the nodes of a grid (m/Pa).

    Parameters
    ----------
    ground : Layer or HalfSpace
        The body.
    points : array_like, (m, 2) or (m, 3)
        Points on the surface, or anywhere in the body with their heights (m).
    nodes : array_like, (n, 2)
        Nodes on the surface (m).
    pitch : float
        Side of a cell (m).
    shape : {"patch", "hat"}
        Unit traction over the square cell about its node, or falling linearly to zero at the next nodes.

    Returns
    -------
    ndarray, (3 m, 3 n)
        Rows and columns point-major (X, Y, Z of the first, ...).

    Raises
    ------
    InputError
        If an argument is not possible.

    Notes
    -----
    Patches are exact to rounding on a half-space and to 3e-7 of the largest entry on the surface of a layer, hats to
    1e-5.
    """
    points, nodes = np.atleast_2d(reals(points, where="points")), np.atleast_2d(reals(nodes, where="nodes"))
    pitch = positive("pitch", pitch, where="influence", unit="m")
    if shape not in ("patch", "hat"):
        raise InputError("no shape of a traction", where="shape", found=shown(shape), expected="'patch' or 'hat'")
    for name, value, columns in (("points", points, (2, 3)), ("nodes", nodes, (2,))):
        if value.ndim != 2 or value.shape[1] not in columns or not np.isfinite(value).all():
            raise InputError(
                f"{name} must be finite rows of {' or '.join(map(str, columns))} coordinates",
                where=name,
                found=f"an array of shape {value.shape}",
                expected="metres",
            )
    heights = points[:, 2] if points.shape[1] == 3 else np.full(len(points), ground.top)
    found = np.empty((len(points), 3, len(nodes), 3))
    step = max(1, BATCH // max(1, len(nodes)))
    for i in range(0, len(points), step):
        part = slice(i, i + step)
        offsets = points[part, None, :2] - nodes
        z = np.broadcast_to(heights[part, None], offsets.shape[:2])
        flat = _pairs(ground, offsets.reshape(-1, 2), z.ravel(), pitch, shape)
        found[part] = flat.reshape(*offsets.shape[:2], 3, 3).transpose(0, 2, 1, 3)
    return found.reshape(3 * len(points), 3 * len(nodes))


def _pairs(ground: Layer | HalfSpace, offsets: Array, z: Array, pitch: float, shape: str) -> Array:
    """Motion per traction of each pair of a point and a node, (pairs, 3, 3)."""
    half_space = ground.half_space if isinstance(ground, Layer) else ground
    sunk = np.column_stack([offsets, np.minimum(z - ground.top, 0.0)])
    found = rectangle(half_space, sunk, (pitch, pitch)) if shape == "patch" else _hats(half_space, sunk, pitch)
    if isinstance(ground, Layer):
        # the image of the load in the base lies h + z below the point
        share = pitch / (ground.h + float(np.min(z, initial=ground.h)))
        s, w = _rule(shape, 3 if share <= 0.26 else 5 if share <= 0.7 else 16)
        for i, wi in zip(s, w, strict=True):
            for j, wj in zip(s, w, strict=True):
                at = offsets - pitch * np.array([i, j])
                found += wi * wj * pitch**2 * matrices(unit_point(ground, np.hypot(*at.T), z), at)
    return found


def _rule(shape: str, n: int) -> tuple[Array, Array]:
    """Places and weights, in pitches, of the mean over a patch or over a hat."""
    x, w = gauss(n)
    if shape == "patch":
        return x - 0.5, w
    if n == 3:  # meets the moments of a hat up to the fifth
        return np.sqrt(0.4) * np.array([-1.0, 0.0, 1.0]), np.array([5.0, 14.0, 5.0]) / 24
    return np.concatenate([-x, x]), np.tile(w * (1 - x), 2)


def _hats(ground: HalfSpace, offsets: Array, pitch: float) -> Array:
    """Motion per hat on a half-space: by the distance with a fine, a coarse, or a rule over point forces."""
    far = np.sqrt((offsets**2).sum(axis=1)) / pitch
    found = np.empty((len(offsets), 3, 3))
    near, middle, rest = far < 3, (far >= 3) & (far < 6), far >= 6
    if near.any():
        # on a grid most pairs see the same few offsets
        unique, back = np.unique(np.round(offsets[near] / pitch, 9), axis=0, return_inverse=True)
        found[near] = _near_hats(ground, unique * pitch, pitch)[back.ravel()]
    for here, (s, w), motion, area in (
        (middle, _rule("patch", 3), lambda at: rectangle(ground, at, (pitch, pitch)), 1.0),
        (rest, _rule("hat", 3), lambda at: point_forces(ground, at), pitch**2),
    ):
        if here.any():
            found[here] = area * sum(
                wi * wj * motion(offsets[here] - pitch * np.array([i, j, 0.0]))
                for i, wi in zip(s, w, strict=True)
                for j, wj in zip(s, w, strict=True)
            )
    return found


def _near_hats(ground: HalfSpace, offsets: Array, pitch: float, nodes: int = 8) -> Array:
    """Mean of the patch over a cell, by rules drawn to the lines on which the point meets the edge of the patch."""
    t, dt = drawn(nodes)
    places, weights = [], []
    for c in offsets[:, :2].T / pitch:
        edge = np.clip(c - np.copysign(0.5, c), -0.5, 0.5)[:, None]
        places.append(np.hstack([-0.5 + t * (edge + 0.5), edge + t * (0.5 - edge)]))
        weights.append(np.hstack([dt * (edge + 0.5), dt * (0.5 - edge)]))
    total = np.zeros((len(offsets), 3, 3))
    for i in range(2 * nodes):
        at = np.repeat(offsets[:, None, :], 2 * nodes, axis=1)
        at[..., 0] -= pitch * places[0][:, i, None]
        at[..., 1] -= pitch * places[1]
        both = weights[0][:, i, None] * weights[1]
        total += np.einsum("pj,pjab->pab", both, rectangle(ground, at, (pitch, pitch)))
    return total
