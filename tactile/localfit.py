"""Local least-squares quadratics through scattered markers: weights of the nearest ones for each node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NEAREST = 12
TERMS = (6, 3, 1)  # of a quadratic, an affine function, a mean
WIDTH = 0.5  # of the Gaussian weight, over the distance of the farthest of the nearest
FLAT = 1e-4  # smallest over largest pivot, below which the markers do not determine the terms


def fitted_weights(markers: NDArray[np.float64], nodes: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray]:
    """The nearest markers of each node, and the weights with which their values make the fitted value there.

    A quadratic is fitted to the nearest twelve markers, those nearby weighted more (moving least squares, Lancaster and
    Salkauskas 1981); an affine function where there are fewer, or where they stand on two lines; their mean on one.

    Parameters
    ----------
    markers : array, shape (N, 2)
    nodes : array, shape (n, 2)

    Returns
    -------
    index : array of int, shape (n, k)
    weights : array, shape (n, k)
        Rows sum to 1.
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
    return index, weights


def _constant(terms: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Which fits are determined, and the weights of their constant terms: the value of the polynomial at the node."""
    q, r = np.linalg.qr(terms)
    pivots = np.abs(np.diagonal(r, axis1=1, axis2=2))
    solved = pivots.min(axis=1) > FLAT * pivots.max(axis=1)
    first = np.zeros((int(solved.sum()), terms.shape[2], 1))
    first[:, 0] = 1.0
    row = np.linalg.solve(r[solved].transpose(0, 2, 1), first)
    return solved, (q[solved] @ row)[..., 0]
