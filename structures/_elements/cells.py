"""Cells of solids: the brick in closed form, the isoparametric hexahedron and the ten-node tetrahedron.

All cells of a regular block are equal, so one matrix serves all. Corner a = i + 2 j + 4 k lies at (i, j, k) of the unit
cube and carries the unknowns 3 a + (0, 1, 2) along X, Y, Z. Strains are (xx, yy, zz, yz, xz, xy), shear as angles.

Node orders are those of Abaqus (C3D8, C3D10) and VTK: one face in cyclic order, the opposite one above it; corners of
a tetrahedron, then the middles of its sides 12, 23, 31, 14, 24, 34. Strains: xx, yy, zz, yz, xz, xy, shear as angles.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

ELEMENTS = ("bbar", "standard", "incompatible")
Array = NDArray[np.float64]
_CORNERS = np.array([[a & 1, a >> 1 & 1, a >> 2] for a in range(8)])
_BRICK_SIGNS = 2.0 * _CORNERS - 1
_BRICK_NODE = 0.5 / np.sqrt(3.0)
# two Gauss points along each side integrate stiffness and bubbles of a brick exactly: eight points of weight 1/8
POINTS = 0.5 + _BRICK_NODE * _BRICK_SIGNS


def shape(xi: Array) -> Array:
    """Trilinear functions of the corners at `xi` in the unit cube, (8,)."""
    return np.asarray(np.prod(np.where(_CORNERS, xi, 1 - xi), axis=1), float)


def strain_matrix(gradients: Array) -> Array:
    """Strains (6, 3 m) of m functions with `gradients` (m, 3), each moving along X, Y and Z."""
    B = np.zeros((6, len(gradients), 3))
    for k in range(3):
        B[k, :, k] = gradients[:, k]
    for row, (k, m) in enumerate(((1, 2), (0, 2), (0, 1)), start=3):
        B[row, :, k], B[row, :, m] = gradients[:, m], gradients[:, k]
    return B.reshape(6, -1)


def elasticity(E: float, nu: float) -> Array:
    """Stresses from strains of an isotropic material (6, 6)."""
    mu = E / 2 / (1 + nu)
    D = np.diag(np.repeat([2 * mu, mu], 3))
    D[:3, :3] += E * nu / (1 + nu) / (1 - 2 * nu)
    return D


def mass_matrix(h: Array, rho: float) -> Array:
    """Consistent mass of one brick with sides `h` (m) and density `rho` (kg/m^3), (24, 24).

    That of the plain brick for every element: bubbles carry none.
    """
    x, y, z = (side / 6 * np.array([[2.0, 1.0], [1.0, 2.0]]) for side in h)
    return np.asarray(np.kron(rho * np.kron(z, np.kron(y, x)), np.eye(3)), float)


@dataclass(frozen=True, eq=False)
class Brick:
    """One cell.

    Parameters
    ----------
    h : array (3,)
        Sides (m).
    nu : float
        Poisson's ratio.
    element : {"bbar", "standard", "incompatible"}
        Mean dilatation, plain trilinear, or with three bubbles for each component.

    Notes
    -----
    T. J. R. Hughes, "Generalization of selective integration procedures to anisotropic and nonlinear media", Int. J.
    Numer. Meth. Eng. 15 (1980) 1413-1418. E. L. Wilson et al., "Incompatible displacement models", in *Numerical and
    Computer Methods in Structural Mechanics* (1973); on a rectangular cell they pass the patch test as they are.
    """

    h: Array
    nu: float
    element: str = "bbar"

    def gradients(self, xi: Array) -> Array:
        """Gradients (8, 3) of the trilinear functions at `xi` (1/m)."""
        along = np.where(_CORNERS, xi, 1 - xi)
        others = np.column_stack([along[:, 1] * along[:, 2], along[:, 0] * along[:, 2], along[:, 0] * along[:, 1]])
        return np.asarray(_BRICK_SIGNS * others / self.h)

    def _bubbles(self, xi: Array) -> Array:
        """Strains (6, 9) of the bubbles 4 xi_k (1 - xi_k)."""
        return strain_matrix(np.diag(4 * (1 - 2 * xi) / self.h))

    @cached_property
    def _full(self) -> tuple[Array, Array]:
        """Stiffness (24, 24) for E = 1, and the bubbles (9, 24) that the corners bring with them."""
        D, weight = elasticity(1.0, self.nu), float(np.prod(self.h)) / 8
        B = np.array([strain_matrix(self.gradients(xi)) for xi in POINTS])
        if self.element == "incompatible":
            B = np.concatenate([B, np.array([self._bubbles(xi) for xi in POINTS])], axis=2)
        if self.element == "bbar":
            kappa = 1 / 3 / (1 - 2 * self.nu)
            D[:3, :3] -= kappa
            dilatation = B[:, :3].sum(axis=1).mean(axis=0)
            K = 8 * weight * kappa * np.outer(dilatation, dilatation)
        else:
            K = np.zeros((B.shape[2],) * 2)
        for b in B:
            K += weight * (b.T @ D @ b)
        if self.element != "incompatible":
            return (K + K.T) / 2, np.zeros((9, 24))
        # the bubbles have no mass and no load: each cell condenses its own, exactly
        bubbles = np.asarray(-np.linalg.solve(K[24:, 24:], K[24:, :24]), float)
        K = K[:24, :24] + K[:24, 24:] @ bubbles
        return (K + K.T) / 2, bubbles

    @property
    def stiffness(self) -> Array:
        """Stiffness for E = 1 Pa, (24, 24)."""
        return self._full[0]

    def strain(self, xi: Array) -> Array:
        """Strains (6, 24) at `xi` of the unit cube, bubbles included."""
        B = strain_matrix(self.gradients(xi))
        return B + self._bubbles(xi) @ self._full[1] if self.element == "incompatible" else B


Index = NDArray[np.intp]
_NODE = 1 / math.sqrt(3)
CHUNK = 2048  # cells at once: a few ten MB


@dataclass(frozen=True, eq=False)
class Cell:
    """One kind of cell.

    Attributes
    ----------
    name : str
        As Abaqus calls it.
    nodes : int
        Nodes of a cell.
    shape : callable
        Functions (Q, nodes) at reference coordinates (Q, 3).
    slopes : callable
        Their derivatives (Q, nodes, 3).
    points, weights : array (Q, 3), (Q,)
        Quadrature of the stiffness, and `mass_points`, `mass_weights` that of the mass.
    centre : array (3,)
    faces : int array (faces, n)
        Nodes of every face, counter-clockwise from outside, corners first.
    corners : int
        Corners of a face: 4 or 3.
    beyond : callable
        How far reference coordinates (Q, 3) lie outside, in sizes of the cell; 0 inside.
    """

    name: str
    nodes: int
    shape: Callable[[Array], Array]
    slopes: Callable[[Array], Array]
    points: Array
    weights: Array
    mass_points: Array
    mass_weights: Array
    centre: Array
    faces: Index
    corners: int
    beyond: Callable[[Array], Array]

    def __reduce__(self) -> tuple[Any, ...]:
        return _cell, (self.name,)


def _cell(name: str) -> Cell:
    return CELLS[name]


# -- hexahedron -------------------------------------------------------------------------------------------------------
_SIGNS = np.array(
    [[-1, -1, -1], [1, -1, -1], [1, 1, -1], [-1, 1, -1], [-1, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1]], float
)


def _hex_shape(xi: Array) -> Array:
    return np.asarray(np.prod(1 + _SIGNS * xi[:, None], axis=2) / 8, float)


def _hex_slopes(xi: Array) -> Array:
    factor = 1 + _SIGNS * xi[:, None]
    out = np.empty((len(xi), 8, 3))
    for k in range(3):
        a, b = (m for m in range(3) if m != k)
        out[:, :, k] = _SIGNS[:, k] * factor[:, :, a] * factor[:, :, b] / 8
    return out


# -- tetrahedron ------------------------------------------------------------------------------------------------------
_SIDES = np.array([[0, 1], [1, 2], [2, 0], [0, 3], [1, 3], [2, 3]])
_BARY = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])  # slopes of the four barycentric coordinates


def _bary(xi: Array) -> Array:
    return np.column_stack([1 - xi.sum(axis=1), xi])


def _tet_shape(xi: Array) -> Array:
    b = _bary(xi)
    return np.concatenate([b * (2 * b - 1), 4 * b[:, _SIDES[:, 0]] * b[:, _SIDES[:, 1]]], axis=1)


def _tet_slopes(xi: Array) -> Array:
    b = _bary(xi)
    corner = (4 * b - 1)[:, :, None] * _BARY
    i, j = _SIDES.T
    side = 4 * (b[:, i, None] * _BARY[j] + b[:, j, None] * _BARY[i])
    return np.concatenate([corner, side], axis=1)


def _tet_rule(order: int) -> tuple[Array, Array]:
    """Gauss points of a tetrahedron: the cube collapsed, exact to degree 2 order - 3 and more."""
    x, w = np.polynomial.legendre.leggauss(order)
    x, w = (x + 1) / 2, w / 2
    a, b, c = (m.ravel() for m in np.meshgrid(x, x, x, indexing="ij"))
    weight = np.multiply.outer(np.multiply.outer(w, w), w).ravel()
    points = np.column_stack([a, (1 - a) * b, (1 - a) * (1 - b) * c])
    return points, weight * (1 - a) ** 2 * (1 - b)


def _gauss_cube() -> tuple[Array, Array]:
    return _NODE * _SIGNS, np.ones(8)


_A, _B = (5 + 3 * math.sqrt(5)) / 20, (5 - math.sqrt(5)) / 20
HEX8 = Cell(
    name="C3D8",
    nodes=8,
    shape=_hex_shape,
    slopes=_hex_slopes,
    points=_gauss_cube()[0],
    weights=_gauss_cube()[1],
    mass_points=_gauss_cube()[0],
    mass_weights=_gauss_cube()[1],
    centre=np.zeros(3),
    faces=np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]]),
    corners=4,
    beyond=lambda xi: np.maximum(np.abs(xi).max(axis=1) - 1, 0) / 2,
)
TET10 = Cell(
    name="C3D10",
    nodes=10,
    shape=_tet_shape,
    slopes=_tet_slopes,
    points=np.where(np.eye(4, dtype=bool), _A, _B)[:, 1:],
    weights=np.full(4, 1 / 24),
    mass_points=_tet_rule(4)[0],
    mass_weights=_tet_rule(4)[1],
    centre=np.full(3, 0.25),
    faces=np.array([[0, 2, 1, 6, 5, 4], [0, 1, 3, 4, 8, 7], [1, 2, 3, 5, 9, 8], [2, 0, 3, 6, 7, 9]]),
    corners=3,
    beyond=lambda xi: np.maximum(-_bary(xi).min(axis=1), 0),
)
CELLS = {cell.name: cell for cell in (HEX8, TET10)}


# -- matrices ---------------------------------------------------------------------------------------------------------
def determinants(cell: Cell, X: Array, xi: Array) -> Array:
    """Jacobian determinants (F, Q) of cells with nodes at `X` (F, nodes, 3) at reference points (Q, 3)."""
    a, b, c = (np.tensordot(X, slopes, axes=(1, 1)) for slopes in cell.slopes(xi).transpose(2, 0, 1))  # (F, 3, Q)
    return np.asarray(np.sum(np.cross(a, b, axis=1) * c, axis=1), float)


def gradients(cell: Cell, X: Array, xi: Array) -> tuple[Array, Array]:
    """Slopes of the functions in space (F, Q, nodes, 3), and Jacobian determinants (F, Q), at points (Q, 3)."""
    local = cell.slopes(xi)
    J = np.einsum("qnr,fnx->fqrx", local, X, optimize=True)
    right = np.broadcast_to(local.transpose(0, 2, 1), (*J.shape[:2], 3, cell.nodes))
    return np.linalg.solve(J, right).swapaxes(-1, -2), np.linalg.det(J)


def strain_matrices(g: Array) -> Array:
    """Strains (..., 6, 3 n) of functions with slopes (..., n, 3)."""
    B = np.zeros((*g.shape[:-2], 6, g.shape[-2], 3))
    for k in range(3):
        B[..., k, :, k] = g[..., k]
    for row, (k, m) in enumerate(((1, 2), (0, 2), (0, 1)), start=3):
        B[..., row, :, k], B[..., row, :, m] = g[..., m], g[..., k]
    return B.reshape(*g.shape[:-2], 6, -1)


def stiffnesses(cell: Cell, X: Array, nu: float, *, bbar: bool) -> Array:
    """Stiffness of cells with nodes at `X` (F, nodes, 3) for E = 1 Pa, (F, 3 nodes, 3 nodes).

    Parameters
    ----------
    cell : Cell
    X : array (F, nodes, 3)
    nu : float
    bbar : bool
        Mean dilatation over the cell instead of the local one.

    Notes
    -----
    T. J. R. Hughes, Int. J. Numer. Meth. Eng. 15 (1980) 1413-1418: the mean is taken over the volume.
    """
    D, kappa = elasticity(1.0, nu), 1 / 3 / (1 - 2 * nu)
    if bbar:
        D[:3, :3] -= kappa
    out = np.empty((len(X), 3 * cell.nodes, 3 * cell.nodes))
    for start in range(0, len(X), CHUNK):
        part = slice(start, start + CHUNK)
        g, det = gradients(cell, X[part], cell.points)
        B, volume = strain_matrices(g), det * cell.weights
        K = np.einsum("fqki,fqkj->fij", np.einsum("fq,kl,fqli->fqki", volume, D, B, optimize=True), B, optimize=True)
        if bbar:
            mean = np.einsum("fq,fqki->fi", volume, B[:, :, :3], optimize=True)
            K += kappa * mean[:, :, None] * mean[:, None] / volume.sum(axis=1)[:, None, None]
        out[part] = (K + K.swapaxes(1, 2)) / 2
    return out


def masses(cell: Cell, X: Array, rho: float) -> Array:
    """Consistent mass of one component of cells with nodes at `X` (F, nodes, 3), (F, nodes, nodes)."""
    N = cell.shape(cell.mass_points)
    det = determinants(cell, X, cell.mass_points)
    return np.asarray(np.einsum("fq,qi,qj->fij", rho * det * cell.mass_weights, N, N, optimize=True), float)


def upright(cell: Cell, X: Array, names: Index | None = None, where: str = "mesh") -> None:
    """Refuse cells that are turned inside out or have no volume, naming the first.

    Raises
    ------
    InputError
        If a Jacobian determinant is not positive at a quadrature point.
    """
    det = determinants(cell, X, cell.points)
    mean = np.abs(det).mean()
    bad = np.flatnonzero(np.any(~(det > 1e-9 * mean), axis=1))
    if not bad.size:
        return
    first = int(bad[0])
    name = first if names is None else int(names[first])
    x, y, z = X[first].mean(axis=0)
    raise InputError(
        f"{bad.size} of {len(X)} cells are inverted or have no volume",
        where=f"{where}, cell {name}",
        found=f"Jacobian determinant {det[first].min():.3g} at ({x:.6g}, {y:.6g}, {z:.6g}), {mean:.3g} on average",
        expected="nodes in the order of Abaqus and VTK, a positive determinant everywhere",
        hint="check the node order, and cells that the mesher crushed",
    )
