"""Basis: many loads as one object, with the geometry that penalties, constraints, resultants and plots ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from .._elements.beams import BeamField
from .._elements.plates import PlateField
from .._readonly import ReadOnly
from .._system.loads import Load, refuse_supported
from ..errors import InputError, numbers, shown

if TYPE_CHECKING:
    from .._system.structure import Structure


Array = NDArray[np.float64]
Index = NDArray[np.intp]
ROUNDING = 1e-12  # of a column's largest entry: below, an entry is none
LABELS = ("Fx", "Fy", "Fz", "Mx", "My", "Mz")


@dataclass(frozen=True)
class BasisLoad(Load):
    """One load of a basis: a channel that knows its column.

    Parameters
    ----------
    basis : Basis
    index : int
        Load index, ``point * len(components) + component``.
    """

    _: KW_ONLY
    basis: Any = field(default=None, repr=False, compare=False)
    index: int = 0

    def shape(self, structure: Structure) -> Array:
        """Consistent nodal forces of one unit, shape (n,)."""
        return np.asarray(self.basis.all_columns(structure)[:, [self.index]].toarray()[:, 0])

    def region(self, structure: Structure) -> None:
        """None: the basis answers for the supports near its loads."""


@dataclass(frozen=True, eq=False)
class Basis(ReadOnly, Sequence[Load]):
    """A load basis: what `ForwardModel` takes as ``loads=`` and then keeps as ``model.basis``.

    Load index = point * len(components) + component. The functions of `structures.bases` build it.

    Attributes
    ----------
    kind : {"nodal", "patches", "hats", "polynomials"}
    components : tuple of str
        Directions: ``"+X", "+Y", "+Z"``, or in the frame of a face ``"+N"`` (outward), ``"+T1"``, ``"+T2"``.
    coordinates : array (P, dim)
        Places (m): nodes, centroids of patches; of polynomials, P times the centre of the region.
    normals : array (P, 3) or None
        Outward unit normals, on faces of solids.
    cells : int array or None
        Cells over the points, each with its points in cyclic order.
    edges : int array (E, 2)
        Pairs of neighbours; may be empty.
    unit : str
        ``"N"`` for nodal, ``"N/m"`` on beams, else ``"Pa"``.
    traction_unit : str
        Unit after `to_traction`.
    measures : array (P,) or None
        Tributary length (m) or area (m^2); None where no mesh is known.
    mass : sparse array (P, P) or None
        Gram matrix of the (traction) functions of one component over the loaded region.
    directions : array (P, components, 3)
        Unit vectors of the components at the points.
    shape : tuple of int or None
        Shape of the points where they form a grid (C order: the last axis is x).
    extents : array (P, axes, 2) or None
        Spans or rectangles of patches.
    """

    kind: str
    components: tuple[str, ...]
    coordinates: Array
    unit: str
    traction_unit: str
    quantity: str
    labels: tuple[str, ...]
    directions: Array
    normals: Array | None
    cells: Index | None
    edges: Index
    measures: Array | None
    mass: sparse.csr_array | None
    shape: tuple[int, ...] | None
    extents: Array | None
    own_structure: Any
    matrix: sparse.csc_array
    reach: sparse.csr_array
    force: Array
    moment: Array | None
    values: Callable[[Array], sparse.csr_array] | None

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def __repr__(self) -> str:
        parts = f"{self.points} points x {', '.join(self.components)}"
        return f"Basis({self.kind}, {parts}, {len(self)} loads in {self.unit})"

    # -- a sequence of loads ---------------------------------------------------------------------------------------
    @property
    def points(self) -> int:
        """Number of scalar functions, P."""
        return len(self.coordinates)

    def __len__(self) -> int:
        return self.points * len(self.components)

    @cached_property
    def loads(self) -> tuple[BasisLoad, ...]:
        """All loads, in order."""
        count = len(self.components)
        sized = self.kind != "polynomials" and self.measures is not None and self.kind != "nodal"
        measures = np.repeat(self.measures, count).tolist() if sized else [None] * len(self)  # type: ignore[arg-type]
        return tuple(
            BasisLoad(label=label, quantity=self.quantity, unit=self.unit, measure=size or None, basis=self, index=i)
            for i, (label, size) in enumerate(zip(self.labels, measures, strict=True))
        )

    @overload
    def __getitem__(self, index: int) -> Load: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Load, ...]: ...
    def __getitem__(self, index: Any) -> Any:
        return self.loads[index]

    def __iter__(self) -> Iterator[Load]:
        return iter(self.loads)

    # -- the structure ---------------------------------------------------------------------------------------------
    def all_columns(self, structure: Structure) -> sparse.csc_array:
        """Consistent nodal forces of every unit load, sparse (n, loads), not judged.

        Raises
        ------
        InputError
            If the structure is not the one of the basis, or a copy with other supports or parameters.
        """
        own = self.own_structure
        if structure is not own and structure.dofs is not own.dofs:
            same = structure.dofs == own.dofs and _same(structure.coordinates, own.coordinates)
            if not same:
                raise InputError(
                    "the basis belongs to another structure",
                    where=f"Basis ({self.kind})",
                    found=f"{structure.n} DOFs, or other places",
                    expected=f"the structure of the basis ({own.n} DOFs), or a changed copy of it",
                    hint="build the basis again on this structure",
                )
        return self.matrix

    def columns(self, structure: Structure) -> sparse.csc_array:
        """Consistent nodal forces of every unit load over all DOFs, sparse (n, loads).

        Raises
        ------
        InputError
            Code LID-E104, naming all loads that act on supported DOFs only; without code if the structure is another.
        """
        B = self.all_columns(structure)
        if len(structure.supported):
            acts = np.asarray(abs(B.tocsr()[structure.free]).sum(axis=0)).ravel() > 0
            if not np.all(acts):
                refuse_supported([self.labels[i] for i in np.flatnonzero(~acts)])
        return B

    def near(self, structure: Structure) -> tuple[Index, Index]:
        """Loads that share an element with a supported DOF, and these DOFs: two index arrays."""
        self.all_columns(structure)
        held = structure.supported
        reach = self.reach[held]
        points = np.unique(reach.indices)
        count = len(self.components)
        loads = (points[:, None] * count + np.arange(count)).ravel()
        return loads, held[np.diff(reach.indptr) > 0]

    # -- resultants ------------------------------------------------------------------------------------------------
    @property
    def resultant_labels(self) -> tuple[str, ...]:
        """What the rows of `resultant` are: F and M on a beam, Fz, Mx, My on a plate, six elsewhere."""
        dim = self.coordinates.shape[1] if self.coordinates.size else 0
        return {"a beam": ("F", "M"), "a plate": ("Fz", "Mx", "My")}.get(self._place, LABELS if dim else LABELS[:3])

    @property
    def _place(self) -> str:
        own = self.own_structure.field
        return "a beam" if isinstance(own, BeamField) else "a plate" if isinstance(own, PlateField) else ""

    def resultant(self, about: ArrayLike | None = None) -> Array:
        """Force and moment of every unit load, exact, (R, loads): weights for constraints and functionals.

        Parameters
        ----------
        about : array (dim,) or float, optional
            Point (m) about which moments are taken; the origin of the coordinates where not given.

        Returns
        -------
        array
            Rows as in `resultant_labels`, N and N m per unit. Moments are right-handed, but for M on a beam, which is
            the integral of (x - about) p: positive where a +Z load acts at larger x, that is about -Y.

        Raises
        ------
        InputError
            If `about` is no point, or moments are asked for where the places are not known.
        """
        F = self.force
        if self.moment is None:
            if about is not None:
                raise InputError(
                    "no moment: the places of the nodes are not known",
                    where="Basis.resultant",
                    found=f"about={shown(about)}",
                    expected="a structure with coordinates",
                    hint="give coordinates= to the structure, or leave about out for the forces alone",
                )
            return F.copy()
        x0 = np.zeros(3)
        if about is not None:
            x0[: self.coordinates.shape[1]] = _point(about, self.coordinates.shape[1])
        M = self.moment - np.cross(x0, F.T).T
        if self._place == "a beam":
            return np.vstack([F[2], -M[1]])
        return np.vstack([F[2], M[:2]]) if self._place == "a plate" else np.vstack([F, M])

    # -- tractions -------------------------------------------------------------------------------------------------
    @cached_property
    def _factor(self) -> Any:
        from .._system.factor import SparseLU

        if self.mass is None:
            raise InputError(
                "no tractions: it is not known over which area the nodal forces act",
                where="Basis.to_traction",
                found="a nodal basis without a mesh",
                expected="a basis on a beam, a plate or a face of a solid",
                hint="divide by a tributary area of your own",
            )
        return SparseLU(self.mass)

    def to_traction(self, loads: ArrayLike, *, lumped: bool = False) -> Array:
        """Tractions of nodal forces, by the boundary mass; distributed bases come back as they are.

        Parameters
        ----------
        loads : array (..., loads)
            Coefficients of this basis.
        lumped : bool
            Divide by the tributary length or area instead of solving with the consistent mass matrix: smoother, and
            less exact where the traction is curved.

        Returns
        -------
        array (..., loads)
            In `traction_unit`, in the same order. A refined mesh leaves it, where nodal forces fall with the area.

        Raises
        ------
        InputError
            If the loads do not fit, or no mesh is known.
        """
        values = self._fitting(loads, "to_traction")
        if self.kind != "nodal":
            return values.copy()
        solve = self._factor
        count = len(self.components)
        each = values.reshape(-1, self.points, count)
        if lumped:
            assert self.measures is not None
            return (each / self.measures[:, None]).reshape(values.shape)
        columns = np.ascontiguousarray(each.transpose(1, 0, 2).reshape(self.points, -1))
        tractions = solve.solve(columns).reshape(self.points, -1, count).transpose(1, 0, 2)
        return np.ascontiguousarray(tractions).reshape(values.shape)

    def evaluate(self, loads: ArrayLike, at: ArrayLike | None = None) -> Array:
        """Traction field at points, (..., points, components), zero outside the loaded region.

        Parameters
        ----------
        loads : array (..., loads)
            Coefficients of this basis; nodal forces become tractions first.
        at : array (m, dim), or (m,) on a beam, optional
            Places (m); the points of the basis where not given. Places beside a flat face are taken normal to it.

        Raises
        ------
        InputError
            If loads or places do not fit, or the face is curved and `at` is given.
        """
        values = self.to_traction(loads)
        dim, count = self.coordinates.shape[1], len(self.components)
        each = values.reshape(*values.shape[:-1], self.points, count)
        if at is None and self.kind != "polynomials":
            return each
        places = numbers(self.coordinates if at is None else at)
        places = places[:, None] if places.ndim == 1 and dim == 1 else places
        if places.ndim != 2 or places.shape[1] != dim or not np.all(np.isfinite(places)):
            raise InputError(
                "no places",
                where="Basis.evaluate, at",
                found=f"shape {places.shape}",
                expected=f"finite coordinates in m, (points, {dim})",
                hint="basis.coordinates has this form",
            )
        if self.values is None:
            raise InputError(
                "no field between the points of this basis",
                where="Basis.evaluate, at",
                found="a curved face, or nodes without a mesh",
                expected="at=None: the values at the points of the basis",
                hint="leave at out",
            )
        flat = each.reshape(-1, self.points, count).transpose(1, 0, 2).reshape(self.points, -1)
        out = (self.values(places) @ flat).reshape(len(places), -1, count).transpose(1, 0, 2)
        return np.asarray(out.reshape(*values.shape[:-1], len(places), count), float)

    def _fitting(self, loads: ArrayLike, where: str) -> Array:
        values = numbers(loads)
        if values.ndim == 0 or values.shape[-1] != len(self) or not np.all(np.isfinite(values)):
            raise InputError(
                "the loads do not fit the basis",
                where=f"Basis.{where}",
                found=f"shape {values.shape}" if values.ndim else shown(loads),
                expected=f"finite numbers, (..., {len(self)})",
                hint="one coefficient per point and component, components of a point together",
            )
        return values


def _same(a: Array | None, b: Array | None) -> bool:
    return a is b or (a is not None and b is not None and np.array_equal(a, b))


def _point(about: ArrayLike, dim: int) -> Array:
    x = np.atleast_1d(numbers(about))
    if x.shape != (dim,) or not np.all(np.isfinite(x)):
        raise InputError(
            "no point",
            where="Basis.resultant, about",
            found=shown(about),
            expected=f"{dim} finite coordinate{'s' if dim > 1 else ''} in m",
            hint="the place of the force/torque sensor, or of the root",
        )
    return x
