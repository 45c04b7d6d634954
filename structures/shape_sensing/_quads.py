"""Plates of four-node elements: strains and deflection of Kirchhoff's and of Mindlin's theory at points inside.

A node has w, a = w_x and b = w_y (of the normal under Mindlin's theory: minus the rotation of the section), and u, v
where the mid-plane stretches. The strains of the fibre at z are ``e - z k``, with k = (a_x, b_y, a_y + b_x).

kirchhoff: the discrete Kirchhoff quadrilateral (J. L. Batoz, M. Ben Tahar, Int. J. Numer. Meth. Eng. 18 (1982) 1655):
slopes of eight nodes, those of the mid-sides from a cubic deflection along each edge.
mindlin: bilinear slopes, and a deflection of one order more, whose shear is constant along each edge (A. Tessler,
T. J. R. Hughes, Comput. Methods Appl. Mech. Eng. 39 (1983) 311), as in the inverse element of A. Kefal, E. Oterkus,
A. Tessler, J. L. Spangler, Eng. Sci. Technol. 19 (2016) 1299.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
CORNERS = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
NEXT = np.array([1, 2, 3, 0])
BENDING, SHEAR, MEMBRANE = slice(0, 3), slice(3, 5), slice(5, 8)
POINTS = CORNERS / np.sqrt(3)


def bilinear(xi: float, eta: float) -> tuple[Array, Array]:
    """Functions (4,) of the corners and their derivatives (2, 4) in xi and eta."""
    x, y = CORNERS.T
    return (1 + xi * x) * (1 + eta * y) / 4, np.array([x * (1 + eta * y), y * (1 + xi * x)]) / 4


def serendipity(xi: float, eta: float) -> tuple[Array, Array]:
    """Functions (8,) of corners and mid-sides and their derivatives (2, 8)."""
    mid = np.array([1 - xi * xi, 1 - eta * eta]) / 2
    sides = np.array([mid[0] * (1 - eta), mid[1] * (1 + xi), mid[0] * (1 + eta), mid[1] * (1 - xi)])
    along = np.array(
        [[-xi * (1 - eta), mid[1], -xi * (1 + eta), -mid[1]], [-mid[0], -eta * (1 + xi), mid[0], -eta * (1 - xi)]]
    )
    N, dN = bilinear(xi, eta)
    before = np.roll(np.arange(4), 1)
    corner = N - (sides + sides[before]) / 2
    return np.r_[corner, sides], np.hstack([dN - (along + along[:, before]) / 2, along])


def edges(nodes: Array) -> tuple[Array, Array]:
    """Vectors (4, 2) of the four edges and their lengths (4,)."""
    d = nodes[NEXT] - nodes
    return d, np.linalg.norm(d, axis=1)


def kirchhoff_slopes(nodes: Array) -> Array:
    """Slopes a, b of the eight nodes (2, 8, 12) from w, a, b of the corners, node by node."""
    d, length = edges(nodes)
    S = np.zeros((2, 8, 12))
    for i in range(4):
        S[0, i, 3 * i + 1] = S[1, i, 3 * i + 2] = 1.0
        j, t = NEXT[i], d[i] / length[i]
        n = np.array([t[1], -t[0]])
        # along the edge the slope of a cubic, across it the mean
        along = np.zeros(12)
        along[3 * j], along[3 * i] = 1.5 / length[i], -1.5 / length[i]
        across = np.zeros(12)
        for end in (i, j):
            along[3 * end + 1 : 3 * end + 3] -= t / 4
            across[3 * end + 1 : 3 * end + 3] += n / 2
        S[:, 4 + i] = np.outer(t, along) + np.outer(n, across)
    return S


def deflection(nodes: Array, xi: float, eta: float) -> Array:
    """Row of w (12,): bilinear in the corners, and what the slopes along each edge add to it (a parabola)."""
    N, _ = bilinear(xi, eta)
    sides = serendipity(xi, eta)[0][4:]
    d, _ = edges(nodes)
    row = np.zeros(12)
    row[::3] = N
    for i in range(4):
        row[3 * i + 1 : 3 * i + 3] += sides[i] * d[i] / 8
        row[3 * NEXT[i] + 1 : 3 * NEXT[i] + 3] -= sides[i] * d[i] / 8
    return row


def strains(nodes: Array, xi: float, eta: float, theory: str) -> Array:
    """Rows (8, 20) of k_x, k_y, k_xy, shear g_x, g_y = w_x - a, w_y - b (0 in Kirchhoff's theory), e_x, e_y, e_xy.

    Columns: w, a, b, u, v of the four corners, node by node.
    """
    N, dN = bilinear(xi, eta)
    J = dN @ nodes  # (2, 2): derivatives of x, y
    bend, out = np.zeros((5, 12)), np.zeros((8, 20))
    if theory == "kirchhoff":
        slopes = kirchhoff_slopes(nodes)
        g = np.linalg.solve(J, serendipity(xi, eta)[1])
        ax, bx = g[0] @ slopes[0], g[0] @ slopes[1]
        ay, by = g[1] @ slopes[0], g[1] @ slopes[1]
        bend[:3] = ax, by, ay + bx
    else:
        g = np.linalg.solve(J, dN)
        bend[0, 1::3], bend[1, 2::3] = g[0], g[1]
        bend[2, 1::3], bend[2, 2::3] = g[1], g[0]
        bend[3:] = np.linalg.solve(J, _deflection_slopes(nodes, xi, eta))
        bend[3, 1::3] -= N
        bend[4, 2::3] -= N
    flat = np.linalg.solve(J, dN)
    corners = np.arange(4) * 5
    for k in range(3):
        out[:5, corners + k] = bend[:, k::3]
    out[5, corners + 3], out[6, corners + 4] = flat[0], flat[1]
    out[7, corners + 3], out[7, corners + 4] = flat[1], flat[0]
    return out


def _deflection_slopes(nodes: Array, xi: float, eta: float) -> Array:
    """Derivatives of the deflection in xi and eta, (2, 12)."""
    rows = np.zeros((2, 12))
    rows[:, ::3] = bilinear(xi, eta)[1]
    along, (d, _) = serendipity(xi, eta)[1][:, 4:], edges(nodes)
    for i in range(4):
        part = along[:, i, None] * d[i] / 8
        rows[:, 3 * i + 1 : 3 * i + 3] += part
        rows[:, 3 * NEXT[i] + 1 : 3 * NEXT[i] + 3] -= part
    return rows


def natural(nodes: Array, point: Array) -> Array | None:
    """Coordinates (xi, eta) of a point by Newton's method, None where it lies outside the element."""
    at = np.zeros(2)
    for _ in range(25):
        N, dN = bilinear(float(at[0]), float(at[1]))
        step = np.linalg.solve((dN @ nodes).T, point - N @ nodes)
        at = at + step
        if np.max(np.abs(step)) < 1e-13:
            break
        if np.max(np.abs(at)) > 10:
            return None
    return at if np.all(np.abs(at) <= 1 + 1e-9) else None
