"""Faces of solids: their nodes, cells, outward normals, areas, and the boundary mass between tractions and forces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .errors import InputError
from .values import plain

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Surface:
    """A face of a solid, divided into bilinear quadrilaterals.

    Parameters
    ----------
    name : str
        "top", for example.
    nodes : int array (P,)
        Node numbers in the structure.
    coordinates : array (P, 3)
        Places (m).
    cells : int array (F, 4)
        Corners of each quadrilateral as indices into `nodes`, counter-clockwise seen from outside.
    normals : array (P, 3)
        Outward unit normals.
    areas : array (P,)
        Tributary areas (m^2): the row sums of `mass`.
    mass : sparse (P, P)
        Boundary mass of one component (m^2), exact for bilinear functions: consistent forces are ``mass @ tractions``.
    """

    name: str
    nodes: NDArray[np.intp]
    coordinates: Array
    cells: NDArray[np.intp]
    normals: Array
    areas: Array
    mass: sparse.csr_array

    @property
    def area(self) -> float:
        """Area (m^2)."""
        return float(self.areas.sum())

    def _on_nodes(self, values: ArrayLike, what: str) -> Array:
        try:
            found = np.asarray(plain(values), float)
        except (TypeError, ValueError):
            found = np.empty(0)
        if found.shape != (len(self.nodes), 3) or not np.all(np.isfinite(found)):
            raise InputError(
                f"the {what} do not fit the surface",
                where=f"surface {self.name}",
                found=f"shape {found.shape}" if np.all(np.isfinite(found)) else "NaN or infinity",
                expected=f"finite numbers, ({len(self.nodes)}, 3): a vector for each node",
                hint="rows in the order of surface.nodes, columns X, Y, Z",
            )
        return found

    def forces(self, tractions: ArrayLike) -> Array:
        """Consistent nodal forces (P, 3) in N of nodal tractions (P, 3) in Pa.

        Raises
        ------
        InputError
            If the tractions do not fit or are not finite.
        """
        return np.asarray(self.mass @ self._on_nodes(tractions, "tractions"), float)

    def tractions(self, forces: ArrayLike) -> Array:
        """Nodal tractions (P, 3) in Pa whose consistent forces are `forces` (P, 3) in N; inverse of `forces`.

        Raises
        ------
        InputError
            If the forces do not fit or are not finite.
        """
        from .factor import Factor

        return Factor(self.mass).solve(self._on_nodes(forces, "forces"))

    def traction_resultant(self, tractions: ArrayLike, about: ArrayLike | None = None) -> Array:
        """Force and moment of nodal tractions: (Fx, Fy, Fz, Mx, My, Mz) in N and N m.

        Parameters
        ----------
        tractions : array (P, 3)
            Pa.
        about : (x, y, z), optional
            Point of reference (m); the origin of coordinates where not given.

        Raises
        ------
        InputError
            If the tractions or the point do not fit or are not finite.
        """
        f = self.forces(tractions)
        place = np.zeros(3) if about is None else np.asarray(plain(about), float)
        if place.shape != (3,) or not np.all(np.isfinite(place)):
            raise InputError(
                "no point",
                where=f"surface {self.name}, about",
                found=repr(about),
                expected="finite (x, y, z) in m",
                hint="leave it out for the origin of coordinates",
            )
        return np.concatenate([f.sum(axis=0), np.cross(self.coordinates - place, f).sum(axis=0)])
