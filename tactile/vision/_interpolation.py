"""Marker motion onto the nodes of the pad by local quadratics, with the covariance of its noise.

Interpolated values share markers: their noise is correlated, and more nodes carry no more information. The weights are
therefore kept as a matrix, U = W d, and the covariance W Sigma W^T goes with them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from structures._flags import Flag
from structures.errors import InputError, as_array, one_of, reals

from .._arrays import PLANE, Array, Index, Mask, shaped
from .._guards import interpolation_noise

NEAREST = 12
TERMS = (6, 3, 1)  # of a quadratic, an affine function, a mean
WIDTH = 0.5  # of the Gaussian weight, over the distance of the farthest of the nearest
CARRIED = 1e-6  # of the same distance: a marker so near to a node lies on it
FLAT = 1e-4  # smallest over largest pivot, below which the markers do not determine the terms


def fitted_weights(markers: Array, nodes: Array) -> tuple[Index, NDArray[Any]]:
    """The nearest markers (n, k) of each node, and their weights (n, k) in the fitted value there; rows sum to 1.

    A quadratic is fitted to the nearest twelve markers, those nearby weighted more (moving least squares, Lancaster and
    Salkauskas 1981); an affine function where there are fewer, or where they stand on two lines; their mean on one. A
    node that carries a marker has its value: nothing is smoothed there.
    """
    from scipy.spatial import cKDTree

    k = min(NEAREST, len(markers))
    distance, index = cKDTree(markers).query(nodes, k=k)
    distance, index = distance.reshape(-1, k), index.reshape(-1, k)
    reach = distance[:, -1:]
    offset = (markers[index] - nodes[:, None]) / reach[:, :, None]
    x, y = offset[..., 0], offset[..., 1]
    near = np.exp(-0.5 * (distance / (WIDTH * reach)) ** 2)
    terms = near[..., None] * np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-1)
    weights = np.empty_like(near)
    left = np.arange(len(nodes))
    for count in TERMS:
        if k < NEAREST and count == TERMS[0]:
            continue
        solved, found = _constant(terms[left, :, :count])
        weights[left[solved]] = near[left[solved]] * found
        left = left[~solved]
    weights[distance[:, 0] <= CARRIED * reach[:, 0]] = np.eye(k)[0]
    return index, weights


def _constant(terms: Array) -> tuple[Mask, Array]:
    """Which fits are determined, and the weights of their constant terms: the value of the polynomial at the node."""
    q, r = np.linalg.qr(terms)
    pivots = np.abs(np.diagonal(r, axis1=1, axis2=2))
    solved = pivots.min(axis=1) > FLAT * pivots.max(axis=1)
    first = np.zeros((int(solved.sum()), terms.shape[2], 1))
    first[:, 0] = 1.0
    row = np.linalg.solve(r[solved].transpose(0, 2, 1), first)
    return solved, (q[solved] @ row)[..., 0]


FEWEST = 3
KINDS = ("linear", "local")
ROUNDING = 1e-9  # of a barycentric coordinate: nodes on the hull are inside


@dataclass(frozen=True)
class Interpolation:
    """Weights that carry values at markers to nodes.

    Parameters
    ----------
    markers : array, shape (N, 2)
        Places of the markers, m; NaN = lost.
    nodes : array, shape (n, 2)
    kind : {"linear", "local"}
        Linear on the Delaunay triangles of the markers (exact for affine fields; the noise of a node is that of three
        markers), or a local least-squares quadratic through the twelve nearest (exact for quadratic fields; it smooths,
        but on a node that carries a marker).

    Attributes
    ----------
    W : sparse array, shape (n, N)
        Rows sum to 1; rows of nodes outside the hull of the markers, and columns of lost markers, are empty.
    inside : array of bool, shape (n,)
        Nodes within the hull: the others get no value.
    used : array of bool, shape (N,)
        Markers that are not lost.

    Raises
    ------
    InputError
        Fewer than three markers, or all on a line.
    """

    markers: Array
    nodes: Array
    kind: str = "linear"
    W: Any = field(init=False, repr=False, compare=False)
    inside: Mask = field(init=False, repr=False, compare=False)
    used: Mask = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        from scipy.sparse import csr_array

        markers, nodes = _plane(self.markers, "markers"), _plane(self.nodes, "nodes")
        one_of("unknown interpolation", self.kind, KINDS, where="kind")
        used = np.all(np.isfinite(markers), axis=1)
        if used.sum() < FEWEST:
            raise InputError(
                "too few markers to interpolate", where="markers", found=f"{used.sum()} of {len(used)} seen",
                expected=f"at least {FEWEST}", hint="a frame that lost its markers holds no displacement: leave it out",
            )  # fmt: skip
        if not np.isfinite(nodes).all():
            raise InputError("nodes hold NaN", where="nodes", expected="finite coordinates")
        inside, corners, weights = _triangles(markers[used], nodes)
        if self.kind == "local":
            corners, weights = fitted_weights(markers[used], nodes[inside])
        rows = np.repeat(np.flatnonzero(inside), corners.shape[1])
        columns = np.flatnonzero(used)[corners.ravel()]
        W = csr_array((weights.ravel(), (rows, columns)), shape=(len(nodes), len(markers)))
        for name, value in (("markers", markers), ("nodes", nodes), ("W", W), ("inside", inside), ("used", used)):
            object.__setattr__(self, name, value)

    def __call__(self, values: ArrayLike) -> Array:
        """Values at the nodes, shape (n, components); NaN outside the hull.

        Parameters
        ----------
        values : array, shape (N, components)
            At the markers; where one is NaN its marker is lost, and the others are triangulated without it.
        """
        found = shaped(
            values, (len(self.markers), None), where="values", what="values do not fit the markers", lost=True
        )
        lost = self.used & np.isnan(found).any(axis=1)
        if lost.any():
            return self.without(lost)(found)
        at_nodes = self.W @ np.where(self.used[:, None], found, 0.0)
        at_nodes[~self.inside] = np.nan
        return np.asarray(at_nodes)

    def without(self, lost: ArrayLike) -> Interpolation:
        """The same nodes from the other markers.

        Parameters
        ----------
        lost : array of bool, shape (N,)
        """
        gone = as_array(lost, where="lost markers", dtype=bool)
        if gone.shape != self.used.shape:
            raise InputError("lost does not fit the markers", where="lost", found=gone.shape, expected=self.used.shape)
        if not (gone & self.used).any():
            return self
        last: tuple[bytes, Interpolation] | None = self.__dict__.get("_last")
        if last is None or last[0] != gone.tobytes():  # a marker stays lost for many frames
            rest = np.where(gone[:, None], np.nan, self.markers)
            last = (gone.tobytes(), Interpolation(rest, self.nodes, self.kind))
            object.__setattr__(self, "_last", last)
        return last[1]

    def covariance(self, sigma: ArrayLike) -> Any:
        """Covariance W Sigma W^T of the values at the nodes, sparse.

        Parameters
        ----------
        sigma : float, or array of shape (N,), (N, 2) or (N, 2, 2)
            Noise of the markers, independent from one to the next: one standard deviation for all and each axis; one
            per marker; one per marker and axis; covariance of x and y of each marker.

        Returns
        -------
        sparse array, shape (n, n) or (2 n, 2 n)
            Of each component alike for the first two; else of both, x and y of the first node, of the second, ...
            Rows and columns of nodes outside the hull are empty.
        """
        from scipy.sparse import block_diag, csr_array, diags_array, kron

        count = len(self.markers)
        shapes: tuple[tuple[int, ...], ...] = ((), (count,), (count, 2), (count, 2, 2))
        noise = shaped(sigma, *shapes, where="sigma", what="noise does not fit the markers", lost=True)
        per_marker = np.broadcast_to(noise, (count,)) if noise.ndim < 2 else noise
        if not np.isfinite(per_marker[self.used]).all() or (noise.ndim < 3 and (per_marker[self.used] < 0).any()):
            raise InputError("noise is no standard deviation", where="sigma", expected="finite, not negative")
        settled = np.where(self.used.reshape(-1, *[1] * (per_marker.ndim - 1)), per_marker, 0.0)
        if noise.ndim < 2:
            half = self.W @ diags_array(settled)
            return csr_array(half @ half.T)
        both = csr_array(kron(self.W, np.eye(2)))
        if noise.ndim == 2:
            half = both @ diags_array(settled.ravel())
            return csr_array(half @ half.T)
        return csr_array(both @ block_diag(settled) @ both.T)

    def effective(self, sigma: ArrayLike = 1.0) -> tuple[float, int]:
        """Effective number of interpolated values and rank of their noise covariance.

        With C the correlation matrix of the noise at the nodes inside: (tr C)^2 / tr(C^2), and rank C.

        Parameters
        ----------
        sigma : float or array, shape (N,)
        """
        noise = np.broadcast_to(reals(sigma, where="sigma"), (len(self.markers),))
        half = (self.W[self.inside] * noise)[:, self.used].toarray()
        std = np.linalg.norm(half, axis=1)
        if len(std) == 0 or not (std > 0).all():
            raise InputError("no noise to speak of", where="sigma", expected="nodes inside, and positive noise")
        values = np.linalg.svd(half / std[:, None], compute_uv=False) ** 2
        rank = int((values > len(half) * np.finfo(float).eps * values[0]).sum())
        return float(values.sum() ** 2 / (values**2).sum()), rank

    @cached_property
    def correlated(self) -> Flag | None:
        """`flag` of markers that are all as noisy, found once."""
        return self.flag()

    def flag(self, sigma: ArrayLike = 1.0) -> Flag | None:
        """W605 where interpolation correlates the noise."""
        effective, rank = self.effective(sigma)
        return interpolation_noise(int(self.inside.sum()), effective, rank)


def _triangles(markers: NDArray[Any], nodes: NDArray[Any]) -> tuple[Mask, Index, Array]:
    """Nodes inside the hull; for each of these its three markers and their barycentric weights."""
    from scipy.spatial import Delaunay, QhullError

    centre = markers.mean(axis=0)
    size = np.abs(markers - centre).max()
    try:
        mesh = Delaunay((markers - centre) / (size or 1.0))
    except QhullError:
        raise InputError(
            "the markers lie on a line", where="markers", found=f"{len(markers)} markers", expected="a plane pattern"
        ) from None
    places = (nodes - centre) / (size or 1.0)
    triangle = mesh.find_simplex(places, tol=ROUNDING)
    inside = triangle >= 0
    chosen = triangle[inside]
    affine = mesh.transform[chosen]
    two = np.einsum("kij,kj->ki", affine[:, :2], places[inside] - affine[:, 2])
    weights = np.column_stack([two, 1 - two.sum(axis=1)])
    sound = np.isfinite(weights).all(axis=1)  # a triangle without an area gives no weights
    inside[np.flatnonzero(inside)[~sound]] = False
    return inside, mesh.simplices[chosen[sound]], weights[sound]


def _plane(points: ArrayLike, name: str) -> Array:
    return shaped(points, PLANE, where=name, what="no points of a plane", lost=True)
