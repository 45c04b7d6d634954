"""Faces of cells as a surface of quadrilaterals or triangles: normals, areas, boundary mass, consistent loads."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .hermite import gauss
from .surfaces import Surface

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# integrals over a triangle of area 1 of the quadratic functions (corners, middles of 12, 23, 31) times the linear ones
_TRIANGLE = np.array([[2, -1, -1], [-1, 2, -1], [-1, -1, 2], [8, 8, 4], [4, 8, 8], [8, 4, 8]]) / 60


def flat(name: str, faces: Index, coordinates: Array) -> Surface:
    """Surface of quadrilaterals or triangles between the nodes of `faces` (F, 4 or 3), with its mass."""
    nodes, local = np.unique(faces, return_inverse=True)
    cells = local.reshape(faces.shape)
    p = coordinates[faces]
    if faces.shape[1] == 3:
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]) / 2
        mass = np.linalg.norm(normal, axis=1)[:, None, None] * (np.ones((3, 3)) + np.eye(3)) / 12
    else:
        mass = np.zeros((len(faces), 4, 4))
        points, weights = gauss(4)  # exact in the plane, and to many digits on a curved face
        for a, wa in zip(points, weights, strict=True):
            for b, wb in zip(points, weights, strict=True):
                N = np.array([(1 - a) * (1 - b), a * (1 - b), a * b, (1 - a) * b])
                u = (1 - b) * (p[:, 1] - p[:, 0]) + b * (p[:, 2] - p[:, 3])
                v = (1 - a) * (p[:, 3] - p[:, 0]) + a * (p[:, 2] - p[:, 1])
                mass += wa * wb * np.linalg.norm(np.cross(u, v), axis=1)[:, None, None] * np.outer(N, N)
        normal = np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1]) / 2
    size, corners = len(nodes), faces.shape[1]
    i, j = np.repeat(cells, corners, axis=1).ravel(), np.tile(cells, (1, corners)).ravel()
    M = sparse.coo_array((mass.ravel(), (i, j)), shape=(size, size)).tocsr()
    normals = np.zeros((size, 3))
    np.add.at(normals, cells.ravel(), np.repeat(normal, corners, axis=0))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Surface(name, nodes, coordinates[nodes], cells, normals, np.asarray(M.sum(axis=1)).ravel(), M)


def spread(surface: Surface, faces: Index, size: int) -> sparse.csc_array:
    """Consistent nodal loads (size, P) of tractions that fall linearly from one corner to its neighbours, in m^2.

    Parameters
    ----------
    surface : Surface
        Of quadrilaterals or triangles.
    faces : int array (F, n)
        All nodes of its faces, corners first and in any cyclic order; sides 12, 23, 31 of triangles.
    size : int
        Nodes of the mesh.
    """
    if faces.shape[1] <= 4:
        columns = surface.mass.tocoo()
        where = surface.nodes[columns.coords[0]], columns.coords[1]
        return sparse.coo_array((columns.data, where), shape=(size, len(surface.nodes))).tocsc()
    corners = faces[:, :3]
    local = np.searchsorted(surface.nodes, corners)
    p = surface.coordinates[local]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) / 2
    data = area[:, None, None] * _TRIANGLE
    rows, columns = np.broadcast_arrays(faces[:, :, None], local[:, None])
    return sparse.coo_array((data.ravel(), (rows.ravel(), columns.ravel())), shape=(size, len(surface.nodes))).tocsc()
