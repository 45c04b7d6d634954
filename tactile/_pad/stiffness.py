"""A bonded body seen from its loaded surface: stiffness, compliance, forces and motion, also of some nodes only."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from structures._elements import meshfield as evaluation
from structures._elements.surfaces import Surface
from structures._flags import Flag
from structures._system import factor, layered
from structures._system.factor import Factor
from structures._system.layered import SymmetricFactor, reflections
from structures._system.structure import Structure
from structures.errors import InputError

from .. import _guards as guards
from .._arrays import PLANE, SPACE, Array, Index, Mask, shaped

if TYPE_CHECKING:
    from .pad import Pad


@dataclass(frozen=True, eq=False)
class Completion:
    """The surface of a pad of which some displacements are given: ``F = K U``, the others condensed as free of load.

    `known` (k,) are the DOFs of the surface, 3 * node + component, whose displacement is given, `stiffness` (k, k) the
    forces on them, `others` (3 P - k,) those without load, `follow` (3 P - k, k) how these move with the known ones.
    """

    known: Index
    stiffness: Any
    others: Index
    follow: Any

    @classmethod
    def of(cls, pad: Pad, known: Mask, K: Any = None) -> Completion:
        """Of a pad, with a mask (P, 3) of the displacements that are given; `K` is its surface stiffness if at hand."""
        K = surface_stiffness(pad) if K is None else K
        flat = np.asarray(known, bool).ravel()
        k, o = np.flatnonzero(flat), np.flatnonzero(~flat)
        if o.size == 0:
            return cls(k, K, o, None)
        rows = K[o]
        follow = -Factor(sparse.csc_array(rows[:, o])).solve(np.asarray(_dense(rows[:, k])))
        return cls(k, _dense(K[k][:, k]) + _dense(K[k][:, o]) @ follow, o, follow)

    def forces(self, U: Array) -> Array:
        """Nodal forces (3 P,) in N from the known displacements (k,) in m."""
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = self.stiffness @ U
        return out

    def displacements(self, U: Array) -> Array:
        """All displacements of the surface (3 P,) in m."""
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = U
        if self.follow is not None:
            out[self.others] = self.follow @ U
        return out

    def spread(self, half: Any) -> Array:
        """Std of the nodal forces (3 P,), where `half` (k, r) is a factor of the covariance of the known motion."""
        moved = self.stiffness @ half
        moved = moved.toarray() if sparse.issparse(moved) else moved
        out = np.zeros(self.known.size + self.others.size)
        out[self.known] = np.sqrt(np.sum(np.asarray(moved) ** 2, axis=1))
        return out


def surface_stiffness(pad: Pad) -> Any:
    """Stiffness of the surface (3 P, 3 P): sparse for a single layer, whose surface has no interior under it."""
    if pad.structure.free.size == pad.dofs.size:
        order = np.searchsorted(pad.structure.free, pad.dofs)
        return pad.structure.K_free[order][:, order].tocsr()
    return pad.stiffness


def _dense(A: Any) -> Array:
    return np.asarray(A.toarray() if sparse.issparse(A) else A, float)


AXES = "XYZ"
STRIP = 256  # right-hand sides at once
NEAR = 0.2  # of a cell: how far from it a point of a curved surface may lie by its interpolated height


class Loaded:
    """What `tactile._pad.pad.Pad` answers about loads on its surface.

    Attributes
    ----------
    structure : Structure
        Base held.
    surface : Surface
        The loaded surface, P nodes.
    thickness : float
        Height of the surface over the base (m).
    """

    structure: Structure
    surface: Surface
    thickness: float
    _levels: Index | None

    # -- geometry -------------------------------------------------------------------------------------------------
    @property
    def nodes2d(self) -> Array:
        """Places (x, y) of the surface nodes (P, 2) in m."""
        return self.surface.coordinates[:, :2]

    @property
    def points(self) -> int:
        """Number of surface nodes, P."""
        return len(self.surface.nodes)

    @property
    def top(self) -> tuple[float, float, float]:
        """Centre of the surface (0, 0, h): the point about which moments are taken."""
        return 0.0, 0.0, self.thickness

    # -- stiffness ------------------------------------------------------------------------------------------------
    @property
    def _quadratic(self) -> bool:
        """Whether the cells are ten-node tetrahedra, whose corners carry no consistent load of their own."""
        cell = getattr(self.structure.field, "cell", None)
        return getattr(cell, "corners", 4) == 3

    @cached_property
    def loads(self) -> sparse.csc_array:
        """Nodal loads of unit forces on the surface, sparse (n, 3 P).

        Of bricks each is a force on its node; of ten-node tetrahedra the consistent load of a traction that falls
        linearly from a corner to its neighbours, of 1 N.
        """
        if self._quadratic:
            mesh: Any = self.structure.field
            hats = mesh.hats(self.surface) @ sparse.diags_array(1 / self.surface.areas)
            return sparse.csc_array(sparse.kron(hats, sparse.eye_array(3)))
        ones, columns = np.ones(self.dofs.size), np.arange(self.dofs.size)
        return sparse.coo_array((ones, (self.dofs, columns)), shape=(self.structure.n, self.dofs.size)).tocsc()

    @cached_property
    def dofs(self) -> Index:
        """DOFs of the surface nodes in the structure (3 P,)."""
        return (3 * self.surface.nodes[:, None] + np.arange(3)).ravel().astype(np.intp)

    @cached_property
    def _split(self) -> tuple[Index, Index]:
        """Rows of `K_free`: those of the surface in the order of `dofs`, and all others."""
        surface = np.searchsorted(self.structure.free, self.dofs)
        return surface, np.setdiff1d(np.arange(self.structure.free.size), surface)

    @cached_property
    def _mirrors(self) -> list[sparse.csr_array]:
        """Mirror planes of the pad; they keep the surface as a whole."""
        s, _ = self._split
        return [G for G in reflections(self.structure) if np.isin(G.indices[s], s).all()]

    @cached_property
    def _interior(self) -> SymmetricFactor | None:
        """Factor of the interior stiffness; None where a single layer has no interior."""
        i = self._split[1]
        if not i.size:
            return None
        return SymmetricFactor(self.structure.K_free[i][:, i], [G[i][:, i] for G in self._mirrors])

    @cached_property
    def _whole(self) -> SymmetricFactor:
        """Factor of the stiffness of all free DOFs."""
        return SymmetricFactor(self.structure.K_free, self._mirrors)

    @cached_property
    def _coupling(self) -> sparse.csr_array:
        """Forces on the interior from displacements of the surface."""
        s, i = self._split
        return self.structure.K_free[i][:, s].tocsr()

    @cached_property
    def _condensed(self) -> tuple[Array, Array]:
        if not self._quadratic:
            return layered.condense(self.structure, self.dofs, self._levels)
        A = self._under_loads(self.loads.T)
        A = np.asfortranarray((A + A.T) / 2)
        return factor.compliance(A.copy(order="F")), A

    def _under_loads(self, rows: Any) -> Array:
        """``rows K^-1 loads`` (rows, 3 P), a strip of loads at a time."""
        kept, B = sparse.csr_array(rows)[:, self.structure.free], self.loads[self.structure.free]
        out = np.empty((kept.shape[0], B.shape[1]))
        for start in range(0, B.shape[1], STRIP):
            out[:, start : start + STRIP] = kept @ self._whole.solve(B[:, start : start + STRIP])
        return out

    @property
    def stiffness(self) -> Array:
        """Nodal forces from displacements of the surface (3 P, 3 P) in N/m, the interior free of load; kept."""
        return self._condensed[0]

    @property
    def compliance(self) -> Array:
        """Displacements from nodal forces on the surface (3 P, 3 P) in m/N; kept."""
        return self._condensed[1]

    # -- forces and motion ----------------------------------------------------------------------------------------
    def forces(self, displacements: ArrayLike) -> Array:
        """Nodal forces (P, 3) in N that hold the surface at `displacements` (P, 3) or (3 P,) in m: F = K U.

        The dense stiffness is formed for ten-node tetrahedra only.

        Raises
        ------
        InputError
            If the displacements do not fit or are not finite.
        """
        s, i = self._split
        U = self._vectors(displacements, "displacements").ravel()
        if self._quadratic:
            return np.asarray(self.stiffness @ U, float).reshape(-1, 3)
        u = np.zeros(self.structure.free.size)
        u[s] = U
        if self._interior is not None:
            u[i] = -self._interior.solve(self._coupling @ U)
        return np.asarray((self.structure.K_free[s] @ u).reshape(-1, 3), float)

    def solve(self, forces: ArrayLike) -> Array:
        """Motion of all DOFs (n,) in m under nodal forces (P, 3) or (3 P,) in N on the surface.

        Raises
        ------
        InputError
            If the forces do not fit or are not finite.
        """
        f = self.loads[self.structure.free] @ self._vectors(forces, "forces").ravel()
        return self.structure.expand(self._whole.solve(f))

    def displacements(self, forces: ArrayLike) -> Array:
        """Motion of the surface (P, 3) in m under nodal forces on it (N).

        That of its nodes; of ten-node tetrahedra the mean over the traction that each force is.
        """
        return np.asarray(self.loads.T @ self.solve(forces), float).reshape(-1, 3)

    def reactions(self, forces: ArrayLike) -> Array:
        """What the base exerts on the pad under nodal forces on the surface: (supported nodes, 3) in N."""
        return self.structure.reactions(self.solve(forces)).reshape(-1, 3)

    def resultant(self, forces: ArrayLike) -> Array:
        """(Fx, Fy, Fz, Mx, My, Mz) of nodal forces in N and N m, moments about (0, 0, h)."""
        f = np.asarray(self.loads @ self._vectors(forces, "forces").ravel(), float).reshape(-1, 3)
        assert self.structure.coordinates is not None
        arms = self.structure.coordinates - np.array(self.top)
        return np.concatenate([f.sum(axis=0), np.cross(arms, f).sum(axis=0)])

    def strain(self, forces: ArrayLike) -> Array:
        """Largest principal strain by size, with sign, at the centre of every cell (cells,) under forces (N)."""
        return evaluation.largest_strain(evaluation.strains(self.structure, self.solve(forces)))

    def strained(self, forces: ArrayLike) -> Flag | None:
        """Guard W112: whether these surface forces strain the pad beyond the linear range."""
        return guards.large_strain(float(np.abs(self.strain(forces)).max()))

    def _vectors(self, values: ArrayLike, what: str) -> Array:
        found = shaped(
            values, (self.points, 3), (3 * self.points,), where=f"Pad, {what}",
            what=f"the {what} do not fit the surface of the pad",
            hint="rows in the order of pad.surface.nodes; interpolate markers onto the nodes first",
        )  # fmt: skip
        return found.reshape(-1, 3)

    # -- points on and under the surface --------------------------------------------------------------------------
    def rows(self, points: ArrayLike) -> sparse.csr_array:
        """Motion of points of the pad from all DOFs: sparse (3 N, n), row 3 * point + axis.

        Parameters
        ----------
        points : array (N, 2) or (N, 3)
            (x, y) on the surface, or (x, y, z) in the pad (m).

        Raises
        ------
        InputError
            If a point is none or lies outside.
        """
        places, on_surface = self._places(points)
        return evaluation.motions(self.structure, places, reach=NEAR if on_surface else None)

    def from_surface(self, points: ArrayLike) -> Any:
        """Motion of points of the pad (3 N,) from that of the surface (3 P,), the interior free of load.

        Sparse for points on the surface, dense for points under it.
        """
        if self._quadratic:
            return self.transfer(points) @ self.stiffness
        rows = self.rows(points)[:, self.structure.free]
        s, i = self._split
        inner = rows[:, i]
        if self._interior is None or inner.nnz == 0:
            return rows[:, s].tocsr()
        return rows[:, s].toarray() - (self._coupling.T @ self._interior.solve(inner.T.tocsc())).T

    def transfer(self, points: ArrayLike, components: str = AXES) -> Array:
        """Motion of points under unit nodal forces on the surface: dense (rows, 3 P) in m/N.

        Parameters
        ----------
        points : array (N, 2) or (N, 3)
            As in `rows`.
        components : str
            Which of "XYZ" to keep, in this order: rows are point * len(components) + component.

        Raises
        ------
        InputError
            If points or components are none.
        """
        names = str(components).upper()
        if not names or any(name not in AXES for name in names) or len(set(names)) != len(names):
            raise InputError(
                "no components of a motion", where="Pad.transfer, components", found=repr(components),
                expected='some of "XYZ", each once', hint='"XY" for markers whose normal motion is not seen',
            )  # fmt: skip
        rows = self.rows(points)
        kept = (np.arange(0, rows.shape[0], 3)[:, None] + [AXES.index(name) for name in names]).ravel()
        if not self._quadratic and ("_condensed" in self.__dict__ or len(kept) > self.dofs.size // 4):
            return np.asarray(self.from_surface(points)[kept] @ self.compliance, float)
        free, B = self.structure.free, self.loads[self.structure.free]
        out = np.empty((len(kept), B.shape[1]))
        for start in range(0, len(kept), STRIP):
            strip = rows[kept[start : start + STRIP]][:, free]
            out[start : start + STRIP] = (B.T @ self._whole.solve(strip.T.tocsc())).T
        return out

    def _places(self, points: ArrayLike) -> tuple[Array, bool]:
        """Points (N, 3), and whether their height was found."""
        hint = "(N, 2) on the surface or (N, 3), in m: x and y from the centre of the pad, z from its bonded base"
        found = shaped(points, PLANE, SPACE, where="Pad, points", what="no points of a pad", lost=True, hint=hint)
        if found.shape[1] == 3:
            return found, False
        return np.column_stack([found, self._height(found)]), True

    def _height(self, points: Array) -> Array:
        """Height of the surface at (x, y); NaN beside it."""
        from scipy.interpolate import LinearNDInterpolator

        z = self.surface.coordinates[:, 2]
        if np.ptp(z) <= 1e-9 * self.thickness or not np.all(np.isfinite(points)):
            return np.full(len(points), self.thickness)
        found = LinearNDInterpolator(self.nodes2d, z)(points)
        return np.where(np.isfinite(found), found, self.thickness)  # beside it: refused where the cell is looked for
