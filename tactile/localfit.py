"""Local least-squares quadratics through scattered markers: weights of the nearest ones for each node."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

NEAREST = 12
TERMS = 6
WIDTH = 0.5  # of the Gaussian weight, over the distance of the farthest of the nearest


def fitted_weights(markers: NDArray[np.float64], nodes: NDArray[np.float64]) -> tuple[NDArray[np.intp], NDArray]:
    """The nearest markers of each node, and the weights with which their values make the fitted value there.

    A quadratic is fitted to the nearest twelve markers, those nearby weighted more (moving least squares, Lancaster and
    Salkauskas 1981); with fewer than twelve markers, an affine function.

    Returns
    -------
    index : array of int, shape (n, k)
    weights : array, shape (n, k)
        Rows sum to 1.
    """
    from scipy.spatial import cKDTree

    k = min(NEAREST, len(markers))
    distance, index = cKDTree(markers).query(nodes, k=k)
    reach = distance[:, -1:]
    offset = (markers[index] - nodes[:, None]) / reach[:, :, None]
    x, y = offset[..., 0], offset[..., 1]
    terms = [np.ones_like(x), x, y, x * x, x * y, y * y][: TERMS if k == NEAREST else 3]
    near = np.exp(-0.5 * (distance / (WIDTH * reach)) ** 2)
    q, r = np.linalg.qr(near[..., None] * np.stack(terms, axis=-1))
    first = np.zeros((len(nodes), len(terms), 1))
    first[:, 0] = 1.0  # the value of the polynomial at the node is its constant term
    row = np.linalg.solve(r.transpose(0, 2, 1), first)
    return index, near * (q @ row)[..., 0]
