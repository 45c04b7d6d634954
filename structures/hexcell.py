"""The eight-node brick in closed form: plain, with mean dilatation (B-bar), or with incompatible modes.

All cells of a regular block are equal, so one matrix serves all. Corner a = i + 2 j + 4 k lies at (i, j, k) of the unit
cube and carries the unknowns 3 a + (0, 1, 2) along X, Y, Z. Strains are (xx, yy, zz, yz, xz, xy), shear as angles.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

ELEMENTS = ("bbar", "standard", "incompatible")
Array = NDArray[np.float64]
_CORNERS = np.array([[a & 1, a >> 1 & 1, a >> 2] for a in range(8)])
_SIGNS = 2.0 * _CORNERS - 1
_NODE = 0.5 / np.sqrt(3.0)
# two Gauss points along each side integrate stiffness and bubbles of a brick exactly: eight points of weight 1/8
POINTS = 0.5 + _NODE * _SIGNS


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
        return _SIGNS * others / self.h

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
